# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A zero of the force that moves, or is set, during a press."""

from __future__ import annotations

from pathlib import Path

import pytest
from study_rig import Rig, expect_failure

from finger_bag.streams import TrialEvent
from finger_common.trial_phases import TrialPhase
from finger_operator.steps import Step


@pytest.mark.parametrize(
    ("moves", "said"), [(0.1, "the zero moved by -0.10 N: tare"), (0.2, "by -0.20 N"), (0.03, "")]
)
def test_a_zero_that_falls_during_the_press_is_noticed(rig: Rig, moves: float, said: str) -> None:
    rig.to_press()
    rig.run(1.0, 1.45, ramp=True)
    rig.zero = moves
    rig.run(0.3)
    rig.run(0.2, 0.0, ramp=True)
    rig.run(0.7)
    if said:
        expect_failure(rig, said)
    else:
        assert rig.protocol.step is Step.MOISTURE_AFTER


def test_a_drift_before_the_press_is_none_of_it(rig: Rig) -> None:
    rig.zero = 0.04
    rig.to_press()
    rig.press()
    assert rig.protocol.step is Step.MOISTURE_AFTER


def test_a_zero_that_rises_is_named_where_the_finger_seems_to_stay(rig: Rig) -> None:
    rig.to_press()
    rig.run(1.0, 1.45, ramp=True)
    rig.zero = -0.04
    rig.run(0.2, 0.0, ramp=True)
    rig.run(10.5)
    expect_failure(rig, "the force stays at 0.04 N; if the finger is off the plate, the zero moved")
    expect_failure(rig, "by +0.04 N: tare")


def test_a_finger_that_stays_is_no_moved_zero(rig: Rig) -> None:
    rig.to_press()
    rig.run(1.0, 1.45, ramp=True)
    rig.run(10.5)
    expect_failure(rig, "finger not lifted within 10 s of the cue")
    assert "zero" not in rig.protocol.trials[0].attempts[0].reason


@pytest.mark.parametrize("readings", [3, 0])
@pytest.mark.parametrize("late", [0.3, 0.9])
def test_a_zero_that_is_set_with_the_finger_on_voids_the_trial(
    tmp_path: Path, readings: int, late: float
) -> None:
    """It reads as lift-off; the driver tells of it up to a second later."""
    rig = Rig(tmp_path / "session", readings=readings)
    rig.protocol.start(rig.now)
    rig.run(0.2)
    rig.tell_zero()
    if readings:
        rig.to_press()
    else:
        rig.protocol.start(rig.now)
        rig.run(1.0)
    rig.run(1.0, 1.45, ramp=True)
    rig.run(0.2, 1.2, ramp=True)
    rig.zero = 1.2
    rig.run(late)
    rig.tell_zero()
    expect_failure(rig, "the zero was changed during the press")
    rig.run(2.0)
    assert rig.protocol.step is Step.PREPARE and rig.protocol.current == 0
    assert rig.protocol.trials[0].verdict == "pending"


def test_a_zero_that_is_set_when_the_finger_is_off_spoils_nothing(rig: Rig) -> None:
    rig.zero = -0.4
    rig.tell_zero()
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.readings(37.0, 38.0, 39.0)
    rig.run(1.0)
    assert "0.40 N on the plate" in rig.protocol.waiting_for()
    rig.zero = 0.0
    rig.run(0.7)
    assert rig.protocol.step is Step.PRESS
    rig.run(0.2, 0.4, ramp=True)
    rig.tell_zero()  # the driver's report of the zero from before the press
    rig.run(0.8, 1.45, ramp=True)
    rig.run(0.3)
    rig.run(0.2, 0.0, ramp=True)
    rig.run(0.7)
    rig.zero = 0.08
    rig.tell_zero()
    assert rig.protocol.step is Step.MOISTURE_AFTER
    rig.readings(36.0, 37.0, 38.0)
    rig.run(0.3)
    assert rig.attempt.verdict == "done"


def test_the_bag_of_a_trial_that_is_voided_late_says_so(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "session", readings=0)
    rig.protocol.start(rig.now)
    rig.tell_zero()
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.run(1.0)
    rig.run(1.0, 1.45, ramp=True)
    rig.zero = 1.45
    rig.run(0.8)
    assert rig.protocol.step is Step.DONE
    rig.tell_zero()
    assert rig.protocol.step is Step.FAILED
    last = [e for e in rig.effects if isinstance(e, TrialEvent)][-1]
    assert last.phase is TrialPhase.FAILED and "zero" in last.note
    # As soon as the recorder has closed it.
    (waits,) = rig.protocol.files.unmarked
    assert waits[0].name == "000_dry_0" and waits[1].phase is TrialPhase.FAILED
