# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How well the data determine the parameters: covariance, profiles, bootstrap, bias."""

from .bias import BiasCorrected, bias_corrected, bias_pair, shifted_interval
from .bootstrap import bootstrap_sample
from .covariance import Covariance, active_bounds, covariance, cramer_rao
from .frame_errors import FrameErrors
from .goodness import Goodness, Interval, goodness
from .profiles import (
    NORMAL_95,
    Profile,
    degrees_of_freedom,
    in_interval,
    profile,
    student_95,
)
