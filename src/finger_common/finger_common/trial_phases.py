# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Phases of a guided trial, as in Trial.msg (a test keeps them equal)."""

from __future__ import annotations

from enum import IntEnum

TARGET_FORCE = 1.35
"""N, default normal force at which the cue to lift is given (Nam and Kuchenbecker 2021)."""


class TrialPhase(IntEnum):
    """What the participant and the operator do now."""

    IDLE = 0
    PREPARE = 1
    MOISTURE_BEFORE = 2
    PRESS = 3
    LIFT = 4
    MOISTURE_AFTER = 5
    DONE = 6
    FAILED = 7
    PAUSED = 8
    PULL = 9
