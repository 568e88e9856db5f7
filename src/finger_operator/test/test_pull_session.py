# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Guided pulls on simulated time: press, pull until slip, the verdict and the friction found."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from finger_bag.streams import TrialEvent
from finger_common.flags import AreaFlag
from finger_common.trial_phases import TrialPhase
from finger_operator.limits import Limits
from finger_operator.protocol import Protocol
from finger_operator.status import session_status
from finger_operator.steps import Step
from finger_operator.study_plan import PREPARATIONS, StudyPlan

SECOND = 1_000_000_000
FRICTION = 0.46
NOISE = 0.005
"""N, of a sample of either force."""


class Rig:
    """A finger with friction on a plate: force at 500 Hz with noise, areas at 10 Hz.

    ridges: the camera follows them, and sees the contact slide from a share `sees` of the friction
    on; tremor: relative, of the normal force.
    """

    def __init__(
        self, folder: Path, ridges: bool = False, sees: float = 1.0, tremor: float = 0.0
    ) -> None:
        self.now = 1_700_000_000 * SECOND
        self.rng = np.random.default_rng(3)
        self.events: list[TrialEvent] = []
        self.ridges, self.sees, self.tremor = ridges, sees, tremor
        plan = StudyPlan("S01", "S01_pulls", conditions=["natural_pull"], trials=2, readings=0)
        limits = Limits(need_recorder=False, confirm_preparation=False)
        self.protocol = Protocol(plan, folder, self.take, limits)
        self.run(0.5)
        self.protocol.start(self.now)
        self.run(2.5)
        assert self.protocol.step is Step.PRESS

    def take(self, effect: object) -> None:
        assert isinstance(effect, TrialEvent)
        self.events.append(effect)

    def run(self, seconds: float, force: tuple = (0, 0), pull: tuple = (0, 0)) -> None:
        """Forces go from the first to the second value; the pull slips at the friction."""
        steps = round(seconds * 500)
        for k in range(1, steps + 1):
            self.now += 2_000_000
            share = k / steps
            normal = force[0] + share * (force[1] - force[0])
            normal *= 1.0 + self.tremor * math.sin(2 * math.pi * 1.1e-9 * (self.now % (1 << 40)))
            wanted = pull[0] + share * (pull[1] - pull[0])
            across = min(wanted, FRICTION * normal)
            noise = NOISE * self.rng.standard_normal(2)
            self.protocol.wrench(self.now, normal + noise[0], abs(across + noise[1]))
            if k % 50 == 0:
                slides = normal > 0.05 and wanted >= self.sees * FRICTION * normal
                flags = 0 if normal > 0.02 else int(AreaFlag.NO_CONTACT)
                ratio = math.nan
                if self.ridges and flags == 0:
                    ratio = 0.0 if slides else 1.0
                    flags |= int(AreaFlag.SLIDING) if slides else 0
                self.protocol.area(self.now, 40e-6 if normal > 0.02 else 0.0, flags, ratio)
                self.protocol.tick(self.now)

    def hold(self) -> None:
        """Press to the target until the cue to pull."""
        self.run(0.5, (0, 1.05))
        assert self.protocol.step is Step.PRESS
        self.run(0.4, (1.05, 1.05))
        assert self.protocol.step is Step.PULL

    def lift(self) -> None:
        self.run(0.2, (1.05, 0))
        self.run(0.8)

    @property
    def attempt(self):
        return self.protocol.trials[self.protocol.current].attempts[-1]


@pytest.mark.parametrize("ridges", [False, True])
@pytest.mark.parametrize("duration", [0.5, 4.0])
def test_a_pull_that_slips_is_kept_with_its_friction(
    tmp_path: Path, ridges: bool, duration: float
) -> None:
    rig = Rig(tmp_path, ridges)
    rig.hold()
    assert session_status(rig.protocol)["instruction"].startswith("Keep the force, and pull")
    rig.run(duration, (1.05, 1.05), (0, 0.97 * FRICTION * 1.05))
    assert rig.protocol.step is Step.PULL
    # One third more at the same speed.
    rig.run(0.6, (1.05, 1.05), (0.97 * FRICTION * 1.05, 1.0))
    assert rig.protocol.step is Step.LIFT
    rig.lift()
    assert rig.attempt.verdict == "done"
    assert rig.attempt.friction == pytest.approx(FRICTION, rel=0.03)
    assert 0.0 < rig.attempt.friction_stddev < 0.02
    phases = [event.phase for event in rig.events if event.index == 0]
    pressed = phases.index(TrialPhase.PRESS)
    assert phases[pressed : pressed + 4] == [
        TrialPhase.PRESS,
        TrialPhase.PULL,
        TrialPhase.LIFT,
        TrialPhase.DONE,
    ]
    done = next(event for event in rig.events if event.phase is TrialPhase.DONE)
    assert done.condition == "natural_pull" and done.target_force == 1.0
    assert done.note.startswith("slipped, friction 0.4")
    rig.run(2.0)
    row = next(csv.DictReader((tmp_path / "trials.csv").open()))
    assert float(row["friction"]) == pytest.approx(
        rig.protocol.trials[0].attempts[0].friction, abs=1e-4
    )


def test_the_friction_is_that_of_the_slip_though_the_camera_sees_it_early(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ridges=True, sees=0.85, tremor=0.03)
    rig.hold()
    rig.run(1.5, (1.05, 1.05), (0, 1.3 * FRICTION * 1.05))
    rig.run(0.4, (1.05, 1.05), (1.3 * FRICTION * 1.05, 1.3 * FRICTION * 1.05))
    rig.lift()
    assert rig.attempt.verdict == "done"
    assert rig.attempt.friction == pytest.approx(FRICTION, rel=0.015)


def test_a_finger_that_is_lifted_before_it_slips_is_asked_again(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.hold()
    rig.run(0.4, (1.05, 1.05), (0, 0.3))
    rig.lift()
    assert rig.protocol.step is Step.FAILED
    assert "lifted before it slipped: the pull reached 0.2" in rig.attempt.reason
    assert rig.attempt.friction == 0.0


def test_a_press_without_pull_ends_in_time(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.hold()
    rig.run(11.0, (1.05, 1.05))
    assert rig.protocol.step is not Step.LIFT
    assert "not slipped within 10 s" in rig.protocol.trials[0].attempts[0].reason


def test_the_camera_tells_a_held_pull_from_a_slip(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ridges=True)
    rig.hold()
    rig.run(0.5, (1.05, 1.05), (0, 0.3))
    rig.run(1.0, (1.05, 1.05), (0.3, 0.3))
    assert rig.protocol.step is Step.PULL
    rig.run(0.6, (1.05, 1.05), (0.3, 1.0))
    assert rig.protocol.step is Step.LIFT


def test_a_session_of_pulls_is_resumed_from_its_file(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.hold()
    rig.run(1.0, (1.05, 1.05), (0, 1.0))
    rig.lift()
    again = Protocol.resume_from(tmp_path, lambda effect: None, rig.now)
    assert again.trials[0].attempts[0].friction == rig.attempt.friction
    assert again.plan.preparation("natural_pull") == PREPARATIONS["natural"]
