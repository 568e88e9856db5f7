# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A session on simulated time: finger, sensors, probe and recorder, for the tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from finger_bag.streams import TrialEvent
from finger_common.trial_phases import TrialPhase
from finger_operator.limits import Limits
from finger_operator.protocol import Effect, Protocol
from finger_operator.recording import StartRecording, StopRecording
from finger_operator.steps import Step
from finger_operator.study_plan import StudyPlan

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


class Rig:
    """Finger, force sensor (500 Hz), camera (10 Hz), probe and recorder on simulated time."""

    def __init__(self, folder: Path, **plan: Any) -> None:
        self.limits = plan.pop("limits", Limits())
        plan = {"conditions": ("dry", "natural"), "trials": 2, **plan}
        self.now = START
        self.effects: list[Effect] = []
        self.recorder_answers = True
        self.lost = 0
        self.force_on = self.camera_on = True
        self.print_left = False
        self.force = 0.0
        self.zero = 0.0
        """N, what the sensor reads as none; the camera sees the finger all the same."""
        self.force_offset = 0
        self.camera_offset = 0
        self.folder = folder
        self.protocol = Protocol(
            StudyPlan("S01", "S01_test", **plan), folder, self.take, self.limits
        )
        self.next_force = self.next_frame = self.next_tick = self.now

    def take(self, effect: Effect) -> None:
        self.effects.append(effect)

    @property
    def phases(self) -> list[TrialPhase]:
        return [e.phase for e in self.effects if isinstance(e, TrialEvent)]

    @property
    def last(self) -> TrialEvent:
        return [e for e in self.effects if isinstance(e, TrialEvent)][-1]

    def answer_recorder(self) -> None:
        pending = [e for e in self.effects if not isinstance(e, TrialEvent)]
        for effect in pending[getattr(self, "answered", 0) :]:
            if self.recorder_answers:
                if isinstance(effect, StartRecording):
                    self.protocol.recorder_started(True, "", self.now)
                else:
                    self.protocol.recorder_stopped(True, "", self.now, lost=self.lost)
        self.answered = len(pending)

    def run(self, seconds: float, force: float | None = None, ramp: bool = False) -> None:
        """Let time pass with the force held at, or going in a straight line to, `force` (N)."""
        begin, first = self.now, self.force
        end = begin + round(seconds * SECOND)
        target = first if force is None else force
        while self.now < end:
            self.now += 2_000_000
            share = (self.now - begin) / (end - begin)
            self.force = first + (target - first) * share if ramp else target
            if self.force_on:
                self.protocol.wrench(self.now + self.force_offset, self.force - self.zero)
            if self.now >= self.next_frame:
                self.next_frame += 100_000_000
                if self.camera_on:
                    touching = self.force > 0.02 or self.print_left
                    area = 40e-6 * max(self.force, 0.1) ** 0.7 if touching else 0.0
                    stamp = self.now + self.camera_offset
                    self.protocol.area(stamp, area, 0 if touching else 1)
            if self.now >= self.next_tick:
                self.next_tick += 50_000_000
                self.protocol.tick(self.now)
                self.answer_recorder()
        self.force = target

    def tell_zero(self) -> None:
        """What the force driver reports of its zero each second."""
        self.protocol.tared(f"0, 0, {-self.zero:.5g}, 0, 0, 0", self.now)

    def readings(self, *values: float) -> None:
        for value in values:
            self.run(0.2)
            self.protocol.moisture(self.now, value)

    def to_press(self) -> None:
        """From prepare to the cue to press."""
        self.run(0.2)
        self.protocol.start(self.now)
        self.run(0.2)
        self.readings(37.0, 38.0, 39.0)
        self.run(1.0)
        assert self.protocol.step is Step.PRESS

    def press(self, peak: float = 1.45) -> None:
        """Press over the target, hold for a moment, lift."""
        self.run(1.0, peak, ramp=True)
        self.run(0.3)
        self.run(0.2, 0.0, ramp=True)
        self.run(0.7)

    def trial(self) -> None:
        """A good trial from prepare to its verdict."""
        self.to_press()
        self.press()
        self.readings(36.0, 37.0, 38.0)
        self.run(0.2)
        assert self.protocol.step is Step.DONE

    @property
    def attempt(self) -> Any:
        return self.protocol.trials[self.protocol.current].attempts[-1]


def expect_failure(rig: Rig, words: str) -> None:
    failed = [e for e in rig.effects if isinstance(e, TrialEvent) and e.phase is TrialPhase.FAILED]
    assert failed and words in failed[-1].note, failed
    assert rig.protocol.trials[0].attempts[0].verdict == "failed"
    assert StopRecording() in rig.effects


def on_another_day(rig: Rig, later: float) -> None:
    """The session goes on after a restart, `later` (s) by its clock."""
    rig.now += round(later * SECOND)
    rig.protocol = Protocol.resume_from(rig.folder, rig.take, rig.now, rig.limits)
    rig.answered = len([e for e in rig.effects if not isinstance(e, TrialEvent)])
    rig.next_frame = rig.next_tick = rig.now
    rig.run(0.5)
    rig.protocol.resume(rig.now)
