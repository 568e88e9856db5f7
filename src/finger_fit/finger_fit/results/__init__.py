"""What a fit found, and the files fit.json and parameters.yaml."""

from .files import condition_dict, fit_dict, parameter_sets, write
from .fits import ConditionFit, CrossCheck, DeformedFinger, FitResult
