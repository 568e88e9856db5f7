# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a fit found, and the files fit.json and parameters.yaml."""

from .contrasts import Contrast, contrasts
from .files import (
    check_folder,
    check_writable,
    condition_dict,
    failing,
    fit_dict,
    parameter_files,
    too_near,
    write,
)
from .fits import ConditionFit, CrossCheck, DeformedFinger, FitResult, QuantityResult, codes_of
from .indentation import IndentationFit, indentation_fit
