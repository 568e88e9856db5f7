# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a fit found, and the files fit.json and parameters.yaml."""

from .contrasts import Contrast, contrasts
from .files import alone_in, check_folder, remove_pages, write
from .fit_json import condition_dict, fit_dict
from .fits import (
    AssumedLengths,
    ConditionFit,
    CrossCheck,
    DeformedFinger,
    Finger,
    FitResult,
    QuantityResult,
    codes_of,
)
from .indentation import IndentationFit, indentation_fit
from .parameter_files import failing, parameter_files, too_near
from .quality import Quality, TrialQuality
