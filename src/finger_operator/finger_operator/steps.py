# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The steps of a guided session."""

from __future__ import annotations

from enum import Enum

from finger_common.trial_phases import TrialPhase


class Step(str, Enum):
    """State of the machine; finer than the announced phases."""

    IDLE = "idle"
    PREPARE = "prepare"
    MOISTURE_BEFORE = "moisture_before"
    CLEAR = "clear"
    PRESS = "press"
    PULL = "pull"
    LIFT = "lift"
    MOISTURE_AFTER = "moisture_after"
    CLOSING = "closing"
    DONE = "done"
    FAILED = "failed"
    FINISHED = "finished"


PHASE_OF = {
    Step.CLEAR: TrialPhase.MOISTURE_BEFORE,
    Step.CLOSING: TrialPhase.DONE,
    Step.FINISHED: TrialPhase.IDLE,
}
"""Announced phases of the steps that are no phase of their own."""

PRESSING = (Step.PRESS, Step.PULL, Step.LIFT)
"""Steps in which a finger may be on the plate."""

UNDER_WAY = (Step.MOISTURE_BEFORE, Step.CLEAR, *PRESSING, Step.MOISTURE_AFTER)
"""Steps of an attempt that is being recorded."""

BETWEEN = (Step.PREPARE, Step.DONE, Step.FAILED, Step.FINISHED)
"""Steps in which no attempt is under way, of a session that has begun."""
