# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The nine presses that calibrate a subject, and what each of them tells.

Protocol, participant and fit know a press by the name of its trial's condition. docs/people.md
has the comparison with other choices.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GuidedPress:
    """One press to a target force.

    name: condition of its trial. target_force: N. hold: s from the target to the cue to lift.
    rise: s from touch to the target, least and most. text: for the participant.
    """

    name: str
    target_force: float
    hold: float
    rise: tuple[float, float]
    text: str


_HOLD = "Press to the target in about half a second, and keep the force until the cue to lift."
_SLOW = "Press slowly, evenly, for two seconds or more, until the cue to lift."
_TAP = "Tap: press to the target at once, and let go at the cue to lift."

CALIBRATION_PRESSES = (
    # What has crept after seconds, and how fast: creep and its time.
    GuidedPress("calibration_hold", 1.3, 3.0, (0.0, 2.0), _HOLD),
    # Every force in one press: how the area grows with the force.
    GuidedPress("calibration_slow", 1.3, 0.0, (1.0, 8.0), _SLOW),
    # Before anything crept: the stiffness at once.
    GuidedPress("calibration_tap", 1.3, 0.0, (0.0, 1.0), _TAP),
    # Again, since presses of one finger differ, and with smaller forces.
    GuidedPress("calibration_light_hold", 0.6, 3.0, (0.0, 2.0), _HOLD),
    GuidedPress("calibration_light_slow", 0.9, 0.0, (1.0, 8.0), _SLOW),
    GuidedPress("calibration_light_tap", 0.8, 0.0, (0.0, 1.0), _TAP),
    # And again: the mean of nine presses is nearer to the finger than that of six.
    GuidedPress("calibration_middle_hold", 0.9, 3.0, (0.0, 2.0), _HOLD),
    GuidedPress("calibration_small_slow", 0.6, 0.0, (1.0, 8.0), _SLOW),
    GuidedPress("calibration_middle_tap", 1.1, 0.0, (0.0, 1.0), _TAP),
)

PRESS_BY_NAME = {press.name: press for press in CALIBRATION_PRESSES}

FITTING = "The presses are being fitted."
"""Note of the announcement with which the last press of a calibration is over."""


def is_fitting(note: str) -> bool:
    """Whether an announcement with this note, or a status with this message, says that all presses
    are made."""
    return note == FITTING


TOO_HARD = 2.5
"""Force over the target from which a press is not the one that was asked for; a tap overshoots."""

LET_GO = 0.5
"""Force over the target below which a press is not held any more."""
