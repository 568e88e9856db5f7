# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The stages of a fit: bags, conditions, one condition's fit, additional fits, files."""

from .bags import load, reading
from .condition import fit_condition, polish
from .grouping import group_trials
from .progress import Report
from .provenance import provenance
from .study import NotWritten, draw, fit_bags, fit_records
