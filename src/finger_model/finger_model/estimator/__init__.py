# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The streaming estimator of the contact state."""

from .estimate import ContactEstimate, EstimateBlock
from .estimator import ContactEstimator, replay
from .events import EstimatorEvent, EventType
from .settings import EstimatorSettings
