# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Clocks of force, probe and protocol that differ or are stepped."""

from __future__ import annotations

from pathlib import Path

import pytest
from study_rig import SECOND, START, Rig

from finger_bag.streams import TrialEvent
from finger_common.trial_phases import TrialPhase
from finger_operator.limits import Limits
from finger_operator.steps import Step


@pytest.mark.parametrize(
    ("offset", "late", "remedy"),
    [
        (-60, 58, "restart all nodes, or synchronise"),
        (0, 58, "take another. If it was taken now, the clock of the probe is late"),
        (0, 3598, "of the moisture node is behind: restart all nodes, or set the clock of the pr"),
    ],
)
def test_a_reading_is_late_by_itself_or_with_the_force(
    rig: Rig, offset: float, late: int, remedy: str
) -> None:
    rig.force_offset = offset * SECOND
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.run(2.0)
    rig.protocol.moisture(rig.now - (late + 2) * SECOND + 1, 50.0)
    assert f"stamped {late}.0 s before this step and does not count" in rig.last.note
    assert remedy in rig.last.note
    assert ("force driver and the protocol are 60.0 s apart" in rig.last.note) == bool(offset)
    assert rig.attempt.moisture_before == []


def test_a_reading_of_the_future_does_not_count(rig: Rig) -> None:
    """A moisture node that was started again after a step of the clock."""
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.run(2.0)
    for _ in range(3):
        rig.protocol.moisture(rig.now + 3600 * SECOND, 50.0)
    assert "stamped 3600.0 s ahead of the protocol's clock and does not count" in rig.last.note
    remedy = "the clock of the moisture node is ahead: restart all nodes, or set the clock of the"
    assert remedy in rig.last.note
    assert rig.attempt.moisture_before == []
    # Rounded up to a whole second, as of a table.
    rig.protocol.moisture(rig.now + -rig.now % SECOND, 50.0)
    assert rig.attempt.moisture_before == [50.0]


@pytest.mark.parametrize("offset", [-3600, -2, 2, 3600])
def test_no_press_begins_while_the_clocks_of_camera_and_force_are_apart(
    rig: Rig, offset: int
) -> None:
    """It would be thrown away, as no frame was at its force."""
    rig.camera_offset = offset * SECOND
    rig.run(3.0)
    rig.protocol.start(rig.now)
    rig.readings(37.0, 38.0, 39.0)
    rig.run(3.0)
    assert rig.protocol.step is Step.CLEAR and rig.protocol.trials[0].attempts == [rig.attempt]
    apart = f"the clocks of camera and force are {offset}.0 s apart"
    if offset < 0:
        apart = f"contact areas are stamped {-offset}.0 s before the force that comes with them: "
        apart += "they take that long to come"
    assert apart in rig.protocol.waiting_for() and "restart" in rig.protocol.waiting_for()
    rig.protocol.check_clocks()
    assert apart in clock_warnings(rig)[0]
    rig.camera_offset = -SECOND // 2  # as of a slow computer
    rig.run(4.0)
    assert rig.protocol.step is Step.PRESS


def test_each_step_of_the_system_clock_is_an_event(rig: Rig) -> None:
    for step in (0.0, 1e-4, 3600.0, 3600.001, 7200.0, 0.0):
        rig.protocol.clock_stepped(step, f"stepped by {step:g} s" if step > 1.0 else "")
    texts = [event.text for event in rig.protocol.log.events if event.kind == "warning"]
    assert texts[:2] == ["stepped by 3600 s", "stepped by 7200 s"]
    assert texts[2:] == ["the system clock is where it was when this node began"]


def test_stamps_of_another_clock_do_not_make_a_sensor_silent(tmp_path: Path) -> None:
    """The system clock was stepped by an hour after the drivers began, and before this node."""
    rig = Rig(tmp_path, readings=0, limits=Limits(need_recorder=False, need_camera=False))
    step, protocol = 3600 * SECOND, rig.protocol
    protocol.start(START + step)
    protocol.start(START + step)
    for k in range(1, 300):
        protocol.wrench(START + k * SECOND // 100, 0.0)
        protocol.tick(START + step + k * SECOND // 100)
    assert protocol.step is Step.PRESS
    protocol.tick(START + step + 5 * SECOND)
    assert protocol.step is Step.FAILED


@pytest.mark.parametrize("offset", [-3600, -11, -9, 0, 5, 12, 3600])
def test_a_press_is_timed_on_one_clock_whatever_that_of_the_force(
    tmp_path: Path, offset: float
) -> None:
    """Force or protocol was started anew after a step of the system clock; s, of force stamps."""
    rig = Rig(tmp_path, limits=Limits(need_camera=False))
    rig.force_offset = offset * SECOND
    rig.protocol.start(rig.now)
    rig.trial()
    assert rig.attempt.time_to_target == pytest.approx(1.30 / 1.45, abs=0.004)
    assert rig.attempt.cue_ns - rig.now == pytest.approx(offset * SECOND, abs=5 * SECOND)
    cue = next(e for e in rig.effects if getattr(e, "phase", None) is TrialPhase.LIFT)
    assert cue.stamp_ns == rig.attempt.cue_ns  # as those of the wrench in the bag
    # The limits of time hold on any clock.
    rig.run(2.0)
    rig.to_press()
    rig.run(0.5, 0.5, ramp=True)
    rig.run(9.0)
    assert rig.protocol.step is Step.PRESS
    rig.run(1.0)
    assert "target not reached within 10 s: 0.50 of 1.35 N" in rig.last.note


@pytest.mark.parametrize("offset", [-3600, -5, 0, 5, 3600])
def test_phases_are_announced_by_the_clock_of_the_force(tmp_path: Path, offset: float) -> None:
    """By which a reader looks for the press."""
    rig = Rig(tmp_path, limits=Limits(need_camera=False))
    rig.force_offset = offset * SECOND
    rig.protocol.start(rig.now)
    rig.trial()
    events = [e for e in rig.effects if isinstance(e, TrialEvent)]
    stamps = {e.phase: e.stamp_ns - rig.force_offset for e in events}
    onset, lifted = (t - rig.force_offset for t in (rig.attempt.onset_ns, rig.attempt.lifted_ns))
    assert stamps[TrialPhase.PRESS] < onset < stamps[TrialPhase.LIFT] < lifted
    assert stamps[TrialPhase.MOISTURE_AFTER] - lifted == pytest.approx(0.5 * SECOND, abs=0.05e9)
    assert stamps[TrialPhase.DONE] - rig.now == pytest.approx(0.0, abs=0.5e9)


def clock_warnings(rig: Rig) -> list[str]:
    return [event.text for event in rig.protocol.log.events if "the clocks of" in event.text]


@pytest.mark.parametrize("offset", [-3600.0, -0.5, 0.5, 7.0])
def test_clocks_of_force_and_protocol_that_differ_are_named_with_the_remedy(
    rig: Rig, offset: float
) -> None:
    rig.protocol.check_clocks()
    rig.force_offset = round(offset * SECOND)
    rig.run(1.5)
    rig.protocol.check_clocks()
    (told,) = clock_warnings(rig)
    assert f"{abs(offset):.1f} s apart: the system clock was stepped" in told
    assert "restart all nodes" in told
    rig.force_offset = -SECOND // 5  # as a message takes on a busy computer
    rig.run(1.5)
    rig.protocol.check_clocks()
    assert clock_warnings(rig) == [told]


def test_a_force_that_comes_late_once_is_no_other_clock(rig: Rig) -> None:
    rig.force_offset = -2 * SECOND
    rig.run(0.1)
    rig.protocol.check_clocks()
    assert not clock_warnings(rig)


def test_a_replay_that_begins_again_is_no_other_clock(rig: Rig) -> None:
    rig.run(3.0)
    for tick in range(30):
        now = rig.now - 60 * SECOND + tick * SECOND // 10
        rig.protocol.wrench(now, 0.0)
        rig.protocol.tick(now)
    rig.protocol.check_clocks()
    assert not clock_warnings(rig)
