# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Stick, slip and friction of a contact from force, at the force rate."""

from .estimate import SlipEstimate
from .estimator import SlipEstimator
from .settings import SlipSettings

__all__ = ["SlipEstimate", "SlipEstimator", "SlipSettings"]
