# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A calibration as the protocol guides it: each press as it is asked for, and the result."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from finger_bag.streams import TrialEvent
from finger_common.guided_presses import CALIBRATION_PRESSES
from finger_common.trial_phases import TrialPhase
from finger_operator.protocol import FIT_TIME, GUIDANCE_TIME, Effect, Protocol
from finger_operator.status import session_status
from finger_operator.steps import Step
from finger_operator.study_plan import StudyPlan

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


class Session:
    """Finger, sensor and camera on simulated time; the recorder answers at once."""

    def __init__(self, folder: Path, readings: int = 0) -> None:
        self.now, self.force = START, 0.0
        self.events: list[TrialEvent] = []
        plan = StudyPlan("S01", "S01_a", readings=readings).for_calibration("S01_cal")
        self.protocol = Protocol(plan, folder, self._take)
        self.run(0.5)
        self.protocol.start(self.now)

    def _take(self, effect: Effect) -> None:
        if isinstance(effect, TrialEvent):
            self.events.append(effect)

    def run(self, seconds: float, to: float | None = None) -> None:
        """The force goes in a straight line to `to`, or stays."""
        begin, first = self.now, self.force
        last = first if to is None else to
        end = begin + round(seconds * SECOND)
        while self.now < end:
            self.now += SECOND // 100
            self.force = first + (last - first) * (self.now - begin) / (end - begin)
            self.protocol.wrench(self.now, self.force)
            if self.now % (SECOND // 10) == 0:
                touching = self.force > 0.02
                self.protocol.area(self.now, 40e-6 * self.force, 0 if touching else 1)
            if self.now % (SECOND // 20) == 0:
                self.protocol.tick(self.now)
            if self.protocol.recording.state.value == "starting":
                self.protocol.recorder_started(True, "", self.now)
            elif self.protocol.recording.state.value == "stopping":
                self.protocol.recorder_stopped(True, "", self.now)

    def to_press(self) -> None:
        self.run(GUIDANCE_TIME + 1.0)
        assert self.protocol.step is Step.PRESS, self.protocol.step

    def press(
        self, rise: float | None = None, hold: float | None = None, over: float = 1.1
    ) -> None:
        """As it is asked for, unless told otherwise."""
        guided = CALIBRATION_PRESSES[self.protocol.current]
        fast, slow = guided.rise
        self.run(0.5 * (fast + slow) * 0.6 if rise is None else rise, over * guided.target_force)
        self.run(guided.hold + 0.2 if hold is None else hold)
        self.run(0.2, 0.0)
        self.run(0.7)

    @property
    def verdict(self) -> str:
        return self.protocol.trials[self.protocol.current].attempts[-1].reason


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session(tmp_path / "session")


def test_the_presses_are_guided_without_a_key(session: Session) -> None:
    for number, guided in enumerate(CALIBRATION_PRESSES):
        assert session.protocol.current == number
        status = session_status(session.protocol)
        assert status["instruction"] == guided.text
        assert status["target_force"] == guided.target_force
        session.to_press()
        assert session.events[-1].target_force == guided.target_force
        session.press()
        assert session.verdict == "", session.verdict
        session.run(2.0)
    assert session.protocol.step is Step.FINISHED
    assert session.events[-1].phase is TrialPhase.IDLE
    assert "being fitted" in session_status(session.protocol)["instruction"]
    session.protocol.calibrated(True, "area under 1 N 46 ± 1 mm²", session.now)
    assert (
        "Calibrated: area under 1 N 46 ± 1 mm²." in session_status(session.protocol)["instruction"]
    )


def test_a_hold_is_held_before_the_cue_to_lift(session: Session) -> None:
    session.to_press()
    session.run(0.5, 1.4)
    session.run(2.0)
    assert session.protocol.step is Step.PRESS
    session.run(1.5)
    assert session.protocol.step is Step.LIFT


@pytest.mark.parametrize(
    ("trial", "wrong", "said"),
    [
        (0, lambda s: s.press(hold=1.0), "held for 3 s"),
        (0, lambda s: s.press(over=0.6, hold=1.0), "before the target"),
        (0, lambda s: s.press(over=3.0), "too hard"),
        (1, lambda s: s.press(rise=0.3), "too fast"),
        (2, lambda s: s.press(rise=3.0), "too slowly"),
    ],
)
def test_a_press_that_is_not_the_one_asked_for_is_repeated(
    tmp_path: Path, trial: int, wrong: Callable[[Session], None], said: str
) -> None:
    session = Session(tmp_path / "session")
    for _ in range(trial):
        session.to_press()
        session.press()
        session.run(2.0)
    session.to_press()
    wrong(session)
    assert said in session.verdict
    session.run(2.0)
    assert session.protocol.current == trial
    session.to_press()
    session.press()
    assert session.verdict == ""


def test_a_tap_may_be_too_quick_for_a_fit_of_its_loading(session: Session) -> None:
    """Two frames until the target; the calibration uses the release, too."""
    for _ in range(2):
        session.to_press()
        session.press()
        session.run(2.0)
    session.to_press()
    session.press(rise=0.1)
    assert session.verdict == "" and session.protocol.step is not Step.FAILED


def test_without_an_answer_the_model_node_is_named(session: Session) -> None:
    for _ in CALIBRATION_PRESSES:
        session.to_press()
        session.press()
        session.run(2.0)
    session.run(FIT_TIME + 1.0)
    assert "model node" in session_status(session.protocol)["instruction"]


def test_an_aborted_calibration_says_so(session: Session) -> None:
    session.to_press()
    session.protocol.abort(session.now)
    assert session.protocol.step is Step.FINISHED
    assert "Not calibrated" in session_status(session.protocol)["instruction"]


def test_a_session_of_calibration_is_found_again(session: Session, tmp_path: Path) -> None:
    session.to_press()
    session.press()
    events: list[Any] = []
    again = Protocol.resume_from(session.protocol.folder, events.append, session.now)
    assert again.plan.is_calibration and again.trials[0].verdict == "done"
    assert again.plan.readings == 0


def test_one_reading_is_asked_for_where_the_study_takes_some(tmp_path: Path) -> None:
    assert Session(tmp_path / "session", readings=3).protocol.plan.readings == 1
