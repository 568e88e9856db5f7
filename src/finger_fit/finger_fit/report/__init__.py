# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The report of a fit: figures, tables and the page. It draws results and computes none."""

from .figures import figure
from .page import remove_figures, write_report
from .pdf import find_browser, write_pdf
