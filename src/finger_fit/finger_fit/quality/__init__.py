# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Is the data fit to be fitted? What is refused before a fit (`screen`), and what is noted of it
(`checks`)."""

from .checks import quality_of
from .screen import screen
from .verdict import judge
