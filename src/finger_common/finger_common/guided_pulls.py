# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Trials that find the friction: press, then pull sideways until the finger slips.

Protocol, participant and bags know such a trial by its condition: `natural_pull` is a pull of a
finger in the condition `natural`.
"""

from __future__ import annotations

import math

from .guided_presses import GuidedPress

SUFFIX = "_pull"

LOAD = 1.0
"""N, normal force that is asked for."""

HOLD = 0.3
"""s from the target to the cue to pull: what the finger creeps meanwhile is small beside it."""

PRESS_TEXT = "Press to the target and keep the force until the cue to pull."
PULL_TEXT = "Keep the force, and pull sideways, evenly, until the cue to lift."


def is_pull(condition: str) -> bool:
    """Whether the trials of a condition are pulls."""
    return condition.endswith(SUFFIX)


def skin_of(condition: str) -> str:
    """Condition of the finger in a trial: that of a pull without its suffix."""
    return condition.removesuffix(SUFFIX)


def press_before_pull(condition: str) -> GuidedPress:
    """The press with which a pull begins."""
    return GuidedPress(condition, LOAD, HOLD, (0.0, math.inf), PRESS_TEXT)
