# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The fit's problem: trials, the model, and the cost of a parameter set."""

from .cost import (
    SMALLEST_FORCE,
    AreaCorrection,
    AreaModel,
    DataError,
    FitProblem,
    force_limit_of,
    material_of,
)
from .goal import Goal, Nuisance, Nuisances, losses, robust_factor
from .outputs import batch_areas, batch_contacts, in_rows, slope_between, trial_outputs
from .power_law import PowerLaw, fit_power_law, power_law_of
from .trials import (
    Exclusion,
    FitTrial,
    Recording,
    TrialRejected,
    by_reason,
    finger_of,
    prepare,
    prepare_all,
)
