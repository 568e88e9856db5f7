"""The stages of a fit: bags, conditions, one condition's fit, additional fits, files."""

from .bags import load
from .condition import fit_condition, polish
from .grouping import group_trials
from .progress import Report
from .study import fit_bags, fit_records
