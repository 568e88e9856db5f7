# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The guided study, walked through every path on simulated time, without ROS."""

from __future__ import annotations

import csv
import json
import math
import re
import shutil
from collections import Counter
from dataclasses import replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml

from finger_bag.reader import open_bag
from finger_bag.streams import TrialEvent
from finger_bag.writer import BagWriter
from finger_common.errors import InputError
from finger_common.guided_presses import PRESS_BY_NAME
from finger_common.trial_phases import TrialPhase
from finger_operator.event_log import Event, EventLog
from finger_operator.limits import Limits
from finger_operator.protocol import Effect, Protocol, Step
from finger_operator.recording import StartRecording, StopRecording
from finger_operator.session_store import STATE_FILE, earlier_sessions, sessions_by_subject
from finger_operator.status import session_status
from finger_operator.study_plan import PREPARATIONS, StudyPlan, parse_preparations
from finger_operator.trial_order import ORDERS, order_text, trial_conditions

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
        self.force_offset = 0
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
                self.protocol.wrench(self.now + self.force_offset, self.force)
            if self.now >= self.next_frame:
                self.next_frame += 100_000_000
                if self.camera_on:
                    touching = self.force > 0.02 or self.print_left
                    area = 40e-6 * max(self.force, 0.1) ** 0.7 if touching else 0.0
                    self.protocol.area(self.now, area, 0 if touching else 1)
            if self.now >= self.next_tick:
                self.next_tick += 50_000_000
                self.protocol.tick(self.now)
                self.answer_recorder()
        self.force = target

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


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    rig = Rig(tmp_path / "session")
    rig.run(0.5)
    rig.protocol.start(rig.now)
    return rig


def test_a_good_trial_goes_through_all_phases_and_is_recorded(rig: Rig) -> None:
    rig.trial()
    assert rig.phases == [
        TrialPhase.PREPARE,
        TrialPhase.MOISTURE_BEFORE,
        TrialPhase.PRESS,
        TrialPhase.LIFT,
        TrialPhase.MOISTURE_AFTER,
        TrialPhase.DONE,
    ]
    started = next(e for e in rig.effects if isinstance(e, StartRecording))
    assert started.path.endswith("000_dry_0") and started.trial.condition == "dry"
    assert isinstance([e for e in rig.effects if not isinstance(e, TrialEvent)][-1], StopRecording)
    attempt = rig.attempt
    assert attempt.verdict == "done"
    assert attempt.moisture_before == [37, 38, 39] and attempt.moisture_after == [36, 37, 38]
    assert attempt.peak_force == pytest.approx(1.45)
    # 1.45 N in 1 s: from 0.05 N to 1.35 N takes 1.30 / 1.45 s.
    assert attempt.time_to_target == pytest.approx(1.30 / 1.45, abs=0.004)
    assert attempt.longest_gap == pytest.approx(0.002)


def test_cue_to_lift_comes_with_the_first_sample_at_the_target(rig: Rig) -> None:
    rig.to_press()
    rig.run(1.0, 1.3499, ramp=True)
    assert rig.last.phase is TrialPhase.PRESS
    stamp = rig.now + 2_000_000
    rig.protocol.wrench(stamp, 1.35)
    assert rig.last.phase is TrialPhase.LIFT
    assert rig.last.stamp_ns == stamp == rig.attempt.cue_ns


def test_no_cue_of_a_press_waits_for_the_state_of_a_long_session(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved: list[Step] = []
    monkeypatch.setattr(
        "finger_operator.protocol.save_state", lambda folder, state: saved.append(Step(state.step))
    )
    rig.trial()
    assert saved[:2] == [Step.MOISTURE_BEFORE] * 2 and saved[-1] is Step.DONE
    assert not {Step.PRESS, Step.LIFT} & set(saved)
    steps = [e.text for e in EventLog.load(rig.folder).events if e.kind == "step"]
    assert {"press", "lift"} <= set(steps)


def test_whole_session_runs_in_blocks_and_finishes(rig: Rig) -> None:
    for _ in range(4):
        rig.trial()
        rig.run(2.0)
    assert rig.protocol.step is Step.FINISHED
    assert [t.condition for t in rig.protocol.trials] == ["dry", "dry", "natural", "natural"]
    assert rig.last.phase is TrialPhase.IDLE
    with (rig.folder / "trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [r["verdict"] for r in rows] == ["done"] * 4
    assert [r["moisture_before_au"] for r in rows] == ["38.00"] * 4
    assert [r["bag"] for r in rows] == ["000_dry_0", "001_dry_0", "002_natural_0", "003_natural_0"]
    with pytest.raises(InputError, match="finished"):
        rig.protocol.start(rig.now)


@pytest.mark.parametrize(
    ("spoil", "restore", "words"),
    [
        (("print_left", True), ("print_left", False), "on the plate"),
        (("force", 0.4), ("force", 0.0), "0.40 N on the plate"),
        (("force_on", False), ("force_on", True), "force sensor is silent"),
        (("camera_on", False), ("camera_on", True), "no contact area"),
        (("recorder_answers", False), None, "recorder is not running"),
    ],
)
def test_press_is_not_asked_for_until_the_frame_is_empty_and_all_is_well(
    rig: Rig, spoil: Any, restore: Any, words: str
) -> None:
    setattr(rig, *spoil)
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.run(0.2)
    rig.readings(1.0, 2.0, 3.0)
    rig.run(3.0)
    assert rig.protocol.step is Step.CLEAR
    assert words in rig.protocol.waiting_for()
    assert words in session_status(rig.protocol)["waiting_for"]
    if restore:
        setattr(rig, *restore)
    else:
        rig.protocol.recorder_started(True, "", rig.now)
    rig.run(1.0)
    assert rig.protocol.step is Step.PRESS


def test_clear_frame_must_last_before_the_press(rig: Rig) -> None:
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.readings(1.0, 2.0, 3.0)
    rig.run(0.4)
    assert rig.protocol.step is Step.CLEAR
    rig.run(0.1, 0.3)
    rig.run(0.45, 0.0)
    assert rig.protocol.step is Step.CLEAR, "the touch begins the wait again"
    rig.run(0.5)
    assert rig.protocol.step is Step.PRESS


def expect_failure(rig: Rig, words: str) -> None:
    failed = [e for e in rig.effects if isinstance(e, TrialEvent) and e.phase is TrialPhase.FAILED]
    assert failed and words in failed[-1].note, failed
    assert rig.protocol.trials[0].attempts[0].verdict == "failed"
    assert StopRecording() in rig.effects


def test_press_lifted_too_early_fails_and_is_redone(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 0.8, ramp=True)
    rig.run(0.1, 0.0)
    rig.run(0.7)
    expect_failure(rig, "lifted at 0.80 N")
    rig.run(2.0)
    assert rig.protocol.step is Step.PREPARE and rig.last.index == 0 and rig.last.attempt == 1
    rig.trial()
    assert [a.verdict for a in rig.protocol.trials[0].attempts] == ["failed", "done"]
    assert rig.attempt.bag.endswith("000_dry_1")


def test_no_press_at_all_fails(rig: Rig) -> None:
    rig.to_press()
    rig.run(30.2)
    expect_failure(rig, "no press within 30 s")


def test_target_never_reached_fails(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 1.0, ramp=True)
    rig.run(10.5)
    expect_failure(rig, "1.00 of 1.35 N")


def test_finger_not_lifted_fails(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 1.4, ramp=True)
    rig.run(10.5)
    expect_failure(rig, "not lifted")


def test_dropped_force_samples_fail_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 0.7, ramp=True)
    rig.force_on = False
    rig.run(0.12)
    rig.force_on = True
    rig.press()
    expect_failure(rig, "force samples missing for 0.12 s")


def test_samples_missing_at_the_first_touch_fail_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.force_on = False
    rig.run(0.12, 0.15, ramp=True)
    rig.force_on = True
    rig.press()
    expect_failure(rig, "force samples missing for 0.12 s")


def test_missing_frames_fail_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 0.7, ramp=True)
    rig.camera_on = False
    rig.run(0.6)
    rig.camera_on = True
    rig.press()
    expect_failure(rig, "camera frames missing for 0.")


def test_camera_that_stops_before_lift_off_fails_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.run(1.0, 1.2, ramp=True)
    rig.camera_on = False
    rig.run(0.8)
    rig.press()
    expect_failure(rig, "camera frames missing")


def test_contact_not_seen_fails_the_trial(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.to_press()
    area = rig.protocol.area
    monkeypatch.setattr(rig.protocol, "area", lambda stamp, *_: area(stamp, 0.0, 1))
    rig.press()
    expect_failure(rig, "contact seen in 0 frames")


def test_sensor_silent_during_the_press_fails_at_once_and_waits_until_it_is_back(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 0.7, ramp=True)
    rig.force_on = False
    rig.run(0.8)
    expect_failure(rig, "force sensor fell silent")
    rig.force = 0.0
    rig.run(2.0)
    rig.protocol.start(rig.now)
    rig.readings(1.0, 2.0, 3.0)
    rig.run(2.0)
    assert rig.protocol.step is Step.CLEAR
    rig.force_on = True
    rig.run(1.0)
    assert rig.protocol.step is Step.PRESS


def test_invalid_force_and_device_errors_fail_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 0.7, ramp=True)
    rig.protocol.wrench(rig.now + 1_000_000, math.nan)
    rig.protocol.health("force", 2, "gauge saturated", rig.now)
    rig.press()
    expect_failure(rig, "invalid samples")
    expect_failure(rig, "force: gauge saturated")
    rig.protocol.health("force", 2, "gauge saturated", rig.now)
    assert "gauge saturated" in rig.protocol.waiting_for()
    rig.protocol.health("force", 0, "", rig.now)
    assert "gauge" not in rig.protocol.waiting_for()


def test_messages_lost_by_the_recorder_fail_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.press()
    rig.lost = 7
    rig.readings(1.0, 2.0, 3.0)
    rig.run(0.2)
    expect_failure(rig, "recorder lost 7")
    rig.lost = 0
    rig.run(2.0)
    assert rig.protocol.step is Step.PREPARE and rig.last.attempt == 1


def test_recorder_that_refuses_holds_the_session(rig: Rig) -> None:
    rig.recorder_answers = False
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.protocol.recorder_started(False, "disk is full", rig.now)
    assert rig.protocol.paused and "recorder" in session_status(rig.protocol)["message"]
    expect_failure(rig, "disk is full")


def test_recorder_that_never_answers_holds_the_session(rig: Rig) -> None:
    rig.recorder_answers = False
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.readings(1.0, 2.0, 3.0)
    rig.run(11.0)
    assert rig.protocol.paused
    expect_failure(rig, "did not start: no answer")


def test_a_trial_that_failed_when_its_bag_was_closed_is_marked_in_the_bag(rig: Rig) -> None:
    rig.protocol.plan = replace(rig.protocol.plan, hand="right", finger="index")
    rig.to_press()
    rig.press()
    with BagWriter(Path(rig.attempt.bag), maximum_duration=1.0) as bag:
        for stamp in (rig.now, rig.now + 2 * SECOND):
            bag.write("wrench", {"header": {"stamp": stamp}})
        bag.write("trial", {"header": {"stamp": rig.now}, "phase": int(TrialPhase.DONE)})
    rig.lost = 7
    rig.readings(1.0, 2.0, 3.0)
    rig.run(0.2)
    assert rig.protocol.step is Step.FAILED
    with open_bag(rig.attempt.bag) as reader:
        last = list(reader.messages())[-1].message
        assert reader.info.message_count == 4 and reader.all_problems() == []
    assert (last.phase, last.note) == (TrialPhase.FAILED, "the recorder lost 7 messages")
    assert (last.index, last.attempt, last.session) == (0, 0, "S01_test")
    assert last.header.frame_id == rig.last.finger == "right_index"
    metadata = yaml.safe_load((Path(rig.attempt.bag) / "metadata.yaml").read_text())
    (found,) = metadata.values()
    topics = found["topics_with_message_count"]
    assert {t["topic_metadata"]["name"]: t["message_count"] for t in topics} == {
        "/finger/wrench": 2, "/finger/trial": 2,
    }  # fmt: skip


@pytest.mark.parametrize("recorder_crashed", [False, True])
def test_an_attempt_that_a_crash_ended_is_failed_wherever_it_is_told(
    rig: Rig, recorder_crashed: bool
) -> None:
    """After its press; the bag is closed, or as a computer that lost its power leaves it."""
    rig.to_press()
    rig.press()
    assert rig.protocol.step is Step.MOISTURE_AFTER
    bag = Path(rig.attempt.bag)
    with BagWriter(bag) as writer:
        phase = int(TrialPhase.MOISTURE_AFTER)
        writer.write("trial", {"header": {"stamp": rig.now}, "phase": phase})
    if recorder_crashed:
        (bag / "metadata.yaml").unlink()
    again = Protocol.resume_from(rig.folder, rig.take, rig.now + SECOND, rig.limits)
    again.recorder_stopped(not recorder_crashed, "", rig.now + 2 * SECOND)
    why = "interrupted: the protocol ended during it"
    with open_bag(bag) as reader:
        last = list(reader.messages())[-1].message
    assert (last.phase, last.note) == (TrialPhase.FAILED, why)
    assert (last.index, last.attempt, last.session) == (0, 0, "S01_test")
    with (rig.folder / "trials.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["verdict"], row["reason"]) == ("failed", why)
    (failed,) = (e for e in EventLog.load(rig.folder).events if e.kind == "failed")
    assert (failed.text, failed.index, failed.attempt) == (why, 0, 0)
    assert again.paused and again.step is Step.PREPARE and rig.last.attempt == 1


def mark_where_the_session_is_now(rig: Rig, folder: Path) -> Protocol:
    """The session goes on in `folder`, after a crash in a press."""
    again = Protocol.resume_from(folder, rig.take, rig.now + SECOND, rig.limits)
    again.recorder_stopped(True, "", rig.now + 2 * SECOND)
    return again


@pytest.mark.parametrize("how", ["moved", "copied"])
@pytest.mark.parametrize("written", ["by name", "by absolute path, as older versions"])
def test_in_a_folder_that_was_moved_after_a_crash_its_own_bag_is_marked(
    rig: Rig, tmp_path: Path, how: str, written: str
) -> None:
    rig.to_press()
    bag, new = Path(rig.attempt.bag), tmp_path / "elsewhere" / rig.folder.name
    with BagWriter(bag) as writer:
        phase = int(TrialPhase.PRESS)
        writer.write("trial", {"header": {"stamp": rig.now}, "phase": phase})
    state = json.loads((rig.folder / STATE_FILE).read_text())
    attempt = state["trials"][0]["attempts"][0]
    assert attempt["bag"] == "000_dry_0"
    if written != "by name":
        attempt["bag"] = str(bag)
        (rig.folder / STATE_FILE).write_text(json.dumps(state))
    (shutil.move if how == "moved" else shutil.copytree)(rig.folder, new)
    again = mark_where_the_session_is_now(rig, new)
    assert Path(again.trials[0].attempts[0].bag) == new / bag.name
    with open_bag(new / bag.name) as reader:
        assert list(reader.messages())[-1].message.phase == TrialPhase.FAILED
    if how == "copied":
        with open_bag(bag) as reader:
            assert reader.info.message_count == 1, "that of another session stays as it is"


def test_a_bag_of_an_interrupted_attempt_that_is_gone_is_named_in_the_log(rig: Rig) -> None:
    rig.to_press()
    again = mark_where_the_session_is_now(rig, rig.folder)
    (text,) = (e.text for e in again.log.events if e.kind == "warning")
    assert text == f"{rig.folder / '000_dry_0'} is not there, and is not marked as failed"


def test_bags_that_cannot_be_marked_are_marked_as_soon_as_they_can_be(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    import finger_operator.protocol as module

    def refuse(bag: Path, event: TrialEvent) -> None:
        raise OSError(28, f"No space left on device: {len(bags)}")

    bags: list[Path] = []
    monkeypatch.setattr(module, "mark_in_bag", refuse)
    rig.lost = 7
    for _ in range(2):
        rig.to_press()
        rig.press()
        bags.append(Path(rig.attempt.bag))
        with BagWriter(bags[-1]) as bag:
            bag.write("trial", {"header": {"stamp": rig.now}, "phase": int(TrialPhase.DONE)})
        rig.readings(1.0, 2.0, 3.0)
        rig.run(2.0)
    rig.run(20.0)
    told = [e.text for e in rig.protocol.log.events if "not marked" in e.text]
    assert [text[:11] for text in told] == ["000_dry_0 i", "000_dry_1 i"], "each is told once"
    monkeypatch.undo()
    rig.run(6.0)
    for path in bags:
        with open_bag(path) as reader:
            assert [m.message.phase for m in reader.messages()][1:] == [TrialPhase.FAILED]


def test_a_bag_that_its_recorder_has_not_closed_is_not_marked_yet(rig: Rig) -> None:
    rig.to_press()
    bag = Path(rig.attempt.bag)
    with BagWriter(bag) as writer:
        writer.write("trial", {"header": {"stamp": rig.now}, "phase": int(TrialPhase.PRESS)})
    whole = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").unlink()
    again = Protocol.resume_from(rig.folder, rig.take, rig.now + SECOND, rig.limits)
    for second in range(2, 20):
        again.tick(rig.now + second * SECOND)
    again.write_all()
    assert len(list(bag.iterdir())) == 1 and again.unmarked
    (bag / "metadata.yaml").write_text(whole)
    again.recorder_stopped(True, "", rig.now + 20 * SECOND)
    with open_bag(bag) as reader:
        assert list(reader.messages())[-1].message.phase == TrialPhase.FAILED
    assert not again.unmarked


@pytest.mark.parametrize("when", ["moisture_before", "clear", "press"])
def test_a_trial_whose_recorder_writes_it_no_longer_fails_at_once(rig: Rig, when: str) -> None:
    """Such as one that died and came back, which knows nothing of the trial."""
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.run(0.2)
    rig.print_left = when == "clear"
    if when != "moisture_before":
        rig.readings(1.0, 2.0, 3.0)
        rig.run(1.0)
    assert rig.protocol.step.value == when
    bag = rig.attempt.bag
    with BagWriter(Path(bag)) as writer:
        writer.write("trial", {"header": {"stamp": rig.now}, "phase": int(TrialPhase.PREPARE)})
    for _ in range(3):  # of before the bag was begun, read at last
        rig.protocol.recorder_writes("no", rig.now)
    for _ in range(3):
        rig.run(1.0)
        rig.protocol.recorder_writes(bag, rig.now)
    assert rig.protocol.step.value == when
    rig.protocol.recorder_writes("no", rig.now)
    rig.run(1.0)
    rig.protocol.recorder_writes("no", rig.now)
    expect_failure(rig, "the recorder no longer writes the bag of this trial")
    rig.run(0.2)
    with open_bag(bag) as reader:
        last = list(reader.messages())[-1].message
    assert last.phase == TrialPhase.FAILED, "its bag says so"
    rig.run(2.0)
    assert rig.protocol.step is Step.PREPARE and rig.last.attempt == 1


def test_no_press_begins_while_the_recorder_is_silent(rig: Rig) -> None:
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.run(0.2)
    rig.protocol.recorder_writes(rig.attempt.bag, rig.now)
    rig.run(3.2)
    rig.readings(1.0, 2.0, 3.0)
    rig.run(1.0)
    assert rig.protocol.step is Step.CLEAR
    assert rig.protocol.waiting_for() == "the recorder is silent"
    rig.protocol.recorder_writes(rig.attempt.bag, rig.now)
    rig.run(1.0)
    assert rig.protocol.step is Step.PRESS


@pytest.mark.parametrize("when", ["moisture_before", "clear", "moisture_after"])
def test_a_trial_that_nobody_goes_on_with_ends_its_recording(rig: Rig, when: str) -> None:
    rig.run(0.2)
    if when == "moisture_after":
        rig.to_press()
        rig.press()
    else:
        rig.protocol.start(rig.now)
        rig.print_left = True
        rig.readings(*[1.0, 2.0, 3.0][: 3 if when == "clear" else 2])
    assert rig.protocol.step.value == when
    protocol = rig.protocol

    def wait(seconds: float) -> None:
        for _ in range(round(seconds)):
            rig.now += SECOND
            protocol.wrench(rig.now, 0.0)
            protocol.tick(rig.now)
            rig.answer_recorder()

    wait(295.0)
    assert protocol.step.value == when
    if when == "moisture_after":  # a reading begins the wait again
        protocol.moisture(rig.now, 40.0)
        wait(295.0)
        assert protocol.step.value == when
    wait(10.0)
    if when == "moisture_after":
        attempt = protocol.trials[0].attempts[-1]
        assert attempt.verdict == "done" and attempt.moisture_after == [40.0], "a press is kept"
        assert any("readings so far" in event.text for event in protocol.log.events)
        return
    expect_failure(rig, "nobody went on for 5 min")
    assert protocol.paused and protocol.recording.state.value == "off"
    assert "Nobody went on" in session_status(protocol)["instruction"]
    protocol.resume(rig.now)
    assert protocol.step is Step.PREPARE


def test_a_pause_after_the_press_ends_the_recording_too_and_lasts(rig: Rig) -> None:
    """The operator goes to lunch: the bag would grow until the disk is full."""
    rig.to_press()
    rig.press()
    rig.readings(40.0)
    protocol, attempt = rig.protocol, rig.attempt
    protocol.pause(rig.now)
    for _ in range(3600):
        rig.now += SECOND
        protocol.wrench(rig.now, 0.0)
        protocol.tick(rig.now)
        rig.answer_recorder()
    assert protocol.recording.state.value == "off" and protocol.paused
    assert attempt.verdict == "done" and attempt.moisture_after == [40.0]
    (stop,) = (n for n, effect in enumerate(rig.effects) if isinstance(effect, StopRecording))
    assert rig.effects[stop - 1].phase is TrialPhase.DONE, "the bag says that it is done"
    assert rig.last.phase is TrialPhase.PAUSED
    protocol.resume(rig.now)
    rig.next_force = rig.next_frame = rig.next_tick = rig.now
    rig.run(2.0)
    assert protocol.step is Step.PREPARE and rig.last.index == 1


def test_after_its_end_a_session_does_not_wait_for_a_trial_that_nobody_goes_on_with(
    rig: Rig,
) -> None:
    rig.to_press()
    rig.press()
    rig.protocol.end(rig.now)
    for _ in range(310):
        rig.now += SECOND
        rig.protocol.tick(rig.now)
        rig.answer_recorder()
    assert rig.protocol.step is Step.FINISHED


def test_recorder_that_does_not_close_fails_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.press()
    rig.recorder_answers = False
    rig.readings(1.0, 2.0, 3.0)
    assert rig.protocol.step is Step.CLOSING
    rig.run(11.0)
    expect_failure(rig, "did not close the bag: no answer")


@pytest.mark.parametrize(
    ("bag", "message_count", "why"),
    [
        ("000_dry_0", 900, ""),
        ("foreign", 900, "the recording was stopped by somebody else"),
        ("000_dry_0", 0, "the bag holds no message"),
    ],
)
def test_a_trial_counts_only_with_its_own_recording(
    rig: Rig, bag: str, message_count: int, why: str
) -> None:
    rig.to_press()
    rig.press()
    rig.recorder_answers = False
    rig.readings(1.0, 2.0, 3.0)
    counts = {"message_count": message_count, "bag": str(rig.folder / bag)}
    rig.protocol.recorder_stopped(True, "", rig.now, **counts)
    assert (rig.attempt.verdict, rig.attempt.reason) == ("failed" if why else "done", why)
    if why:
        expect_failure(rig, why)


def test_late_answer_to_an_old_stop_leaves_the_next_recording_alone(rig: Rig) -> None:
    rig.to_press()
    rig.recorder_answers = False
    rig.protocol.redo(rig.now)
    rig.protocol.start(rig.now)
    rig.protocol.recorder_stopped(True, "", rig.now)
    rig.protocol.recorder_started(True, "", rig.now)
    assert session_status(rig.protocol)["recording"] == "on"


def test_late_answer_to_an_old_start_is_not_that_of_the_next_recording(rig: Rig) -> None:
    """Start, stop and start wait while the recorder is started again, and are answered in order."""
    rig.recorder_answers = False
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.protocol.redo(rig.now)
    rig.protocol.start(rig.now)
    first, second = (e.path for e in rig.effects if isinstance(e, StartRecording))
    rig.protocol.recorder_started(True, "", rig.now, bag=first, asked=first)
    assert session_status(rig.protocol)["recording"] == "starting"
    rig.protocol.recorder_stopped(True, "", rig.now)
    rig.protocol.recorder_started(True, "", rig.now, bag=second, asked=second)
    assert session_status(rig.protocol)["recording"] == "on"
    assert rig.protocol.trials[0].attempts[-1].bag == second


def test_a_repetition_that_is_given_up_leaves_the_attempt_before(rig: Rig) -> None:
    rig.to_press()
    rig.press()
    rig.readings(1.0, 2.0, 3.0)
    rig.run(2.0)
    trial = rig.protocol.trials[0]
    assert trial.verdict == "done"
    rig.protocol.repeat(0, rig.now)
    assert trial.attempts[0].verdict == "superseded"
    rig.protocol.skip(rig.now)
    assert (trial.verdict, trial.attempts[0].verdict) == ("done", "done")


def test_an_edited_preparation_keeps_those_of_other_sessions(rig: Rig) -> None:
    """The page writes all texts that the status has."""
    texts = {"dry": "Wipe.", "greasy": "Oil."}
    plan = StudyPlan("S01", "S01_a", conditions=("dry",), preparations=texts)
    protocol = Protocol(plan, rig.folder / "other", rig.take, rig.limits)
    assert session_status(protocol)["preparations"] == texts


@pytest.mark.parametrize(("offset", "culprit"), [(-60, "restart all nodes"), (0, "of the probe")])
def test_a_reading_is_late_by_itself_or_with_the_force(
    rig: Rig, offset: float, culprit: str
) -> None:
    rig.force_offset = offset * SECOND
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.run(2.0)
    rig.protocol.moisture(rig.now - 60 * SECOND + 1, 50.0)
    assert "stamped 58.0 s before this step and does not count" in rig.last.note
    assert culprit in rig.last.note
    assert ("force driver and the protocol are 60.0 s apart" in rig.last.note) == bool(offset)
    assert rig.attempt.moisture_before == []


def test_readings_outside_the_scale_or_of_another_time_do_not_count(rig: Rig) -> None:
    rig.run(0.2)
    rig.protocol.moisture(rig.now, 50.0)  # no reading is expected yet
    rig.protocol.start(rig.now)
    rig.run(0.2)
    rig.protocol.moisture(rig.now - SECOND, 50.0)  # taken before the trial began
    assert "before this step and does not count" in rig.last.note
    # A table has whole seconds: this one may be of now.
    whole = rig.now // SECOND * SECOND
    rig.protocol.moisture(whole, 50.0)
    assert rig.protocol.trials[0].attempts[-1].moisture_before == [50.0]
    rig.protocol.trials[0].attempts[-1].moisture_before.clear()
    rig.protocol.moisture(rig.now, 131.0)
    assert "131" in rig.last.note
    assert rig.attempt.moisture_before == []
    rig.readings(50.0)
    assert rig.attempt.moisture_before == [50.0]


def test_study_without_moisture_goes_straight_to_the_press(tmp_path: Path) -> None:
    rig = Rig(tmp_path, readings=0, trials=1, conditions=("natural",))
    rig.protocol.start(rig.now)
    rig.run(0.1)
    rig.protocol.start(rig.now)
    rig.run(1.5)
    rig.press()
    rig.run(2.0)
    assert rig.protocol.step is Step.FINISHED


def test_trials_begin_by_themselves_when_no_confirmation_is_wanted(tmp_path: Path) -> None:
    rig = Rig(tmp_path, limits=Limits(confirm_preparation=False), readings=0, trials=1)
    rig.protocol.start(rig.now)
    rig.run(4.0)
    assert rig.protocol.step is Step.PRESS


def test_rig_without_camera_and_recorder(tmp_path: Path) -> None:
    limits = Limits(need_camera=False, need_recorder=False)
    rig = Rig(tmp_path, limits=limits, trials=1, conditions=("natural",))
    rig.camera_on = False
    rig.protocol.start(rig.now)
    rig.trial()
    assert not any(isinstance(e, (StartRecording, StopRecording)) for e in rig.effects)


@pytest.mark.parametrize("when", ["prepare", "moisture_before", "clear", "press", "lift"])
def test_pause_before_the_press_is_over_begins_the_trial_again(rig: Rig, when: str) -> None:
    rig.run(0.2)
    if when in ("press", "lift"):
        rig.to_press()
        rig.run(1.0, 1.4 if when == "lift" else 0.7, ramp=True)
    elif when != "prepare":
        rig.protocol.start(rig.now)
        if when == "clear":
            rig.print_left = True
            rig.readings(1.0, 2.0, 3.0)
    assert rig.protocol.step.value == when
    rig.protocol.pause(rig.now)
    assert rig.last.phase is TrialPhase.PAUSED
    with pytest.raises(InputError, match="paused"):
        rig.protocol.start(rig.now)
    with pytest.raises(InputError, match="already"):
        rig.protocol.pause(rig.now)
    rig.print_left = False
    rig.run(60.0, 0.0)
    assert rig.last.phase is TrialPhase.PAUSED, "nothing happens during a pause"
    rig.protocol.resume(rig.now)
    assert rig.protocol.step is Step.PREPARE
    assert rig.last.index == 0 and rig.last.attempt == (0 if when == "prepare" else 1)
    rig.trial()


def test_pause_after_the_press_keeps_the_press(rig: Rig) -> None:
    rig.to_press()
    rig.press()
    rig.readings(36.0)
    rig.protocol.pause(rig.now)
    rig.readings(99.0)
    rig.run(30.0)
    rig.protocol.resume(rig.now)
    assert rig.protocol.step is Step.MOISTURE_AFTER
    rig.readings(37.0, 38.0)
    rig.run(0.2)
    assert rig.attempt.verdict == "done" and rig.attempt.moisture_after == [36, 37, 38]


def test_redo_in_the_middle_and_after_the_verdict(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 0.5, ramp=True)
    rig.protocol.redo(rig.now)
    assert rig.protocol.step is Step.PREPARE and rig.last.attempt == 1
    rig.run(0.5, 0.0)
    rig.trial()
    rig.protocol.redo(rig.now)
    assert rig.protocol.step is Step.PREPARE and rig.last.index == 0 and rig.last.attempt == 2
    assert [a.verdict for a in rig.protocol.trials[0].attempts] == ["failed", "superseded"]
    rig.trial()
    rig.run(2.0)
    assert rig.last.index == 1


def test_redo_after_the_next_trial_was_announced_redoes_the_last_one_done(rig: Rig) -> None:
    with pytest.raises(InputError, match="no trial was done"):
        rig.protocol.redo(rig.now)
    rig.trial()
    rig.run(2.0)
    assert rig.last.index == 1
    rig.protocol.redo(rig.now)
    assert rig.last.index == 0 and rig.last.attempt == 1


def on_another_day(rig: Rig, later: float) -> None:
    """The session goes on after a restart, `later` (s) by its clock."""
    rig.now += round(later * SECOND)
    rig.protocol = Protocol.resume_from(rig.folder, rig.take, rig.now, rig.limits)
    rig.answered = len([e for e in rig.effects if not isinstance(e, TrialEvent)])
    rig.next_frame = rig.next_tick = rig.now
    rig.run(0.5)
    rig.protocol.resume(rig.now)


def test_redo_takes_the_trial_that_was_kept_last_whatever_the_clock_said(rig: Rig) -> None:
    for later in (0.0, -7200.0):
        if later:
            on_another_day(rig, later)
        rig.trial()
        rig.run(2.0)
    assert rig.protocol.current == 2
    rig.protocol.redo(rig.now)
    assert rig.protocol.current == 1
    rig.trial()
    rig.run(2.0)
    rig.protocol.repeat(0, rig.now)
    rig.trial()
    rig.run(2.0)
    rig.protocol.redo(rig.now)
    assert rig.protocol.current == 0, "the first trial, which was repeated last"


def test_a_trial_that_begins_again_takes_no_kept_trial_with_it(rig: Rig) -> None:
    for _ in range(2):
        rig.trial()
        rig.run(2.0)
    rig.protocol.redo(rig.now)
    for _ in range(2):
        with pytest.raises(InputError, match="trial 2 begins again already"):
            rig.protocol.redo(rig.now)
    assert [t.verdict for t in rig.protocol.trials] == ["done", *["pending"] * 3]
    row = session_status(rig.protocol)["trials"][1]
    assert (row["verdict"], row["attempts"], row["reason"]) == ("pending", 1, ""), "no failure"
    rig.to_press()
    rig.run(0.3, 0.5, ramp=True)
    rig.run(0.7, 0.0)
    rig.run(2.0)
    assert rig.protocol.step is Step.PREPARE
    with pytest.raises(InputError, match="begins again already"):
        rig.protocol.redo(rig.now)
    assert "lifted at 0.50 N" in session_status(rig.protocol)["trials"][1]["reason"]


def test_repeat_of_an_earlier_trial_and_return(rig: Rig) -> None:
    for _ in range(3):
        rig.trial()
        rig.run(2.0)
    rig.protocol.repeat(1, rig.now)
    assert rig.last.index == 1 and rig.last.attempt == 1
    rig.trial()
    rig.run(2.0)
    assert rig.last.index == 3
    with pytest.raises(InputError, match="0 to 3"):
        rig.protocol.repeat(4, rig.now)
    rig.to_press()
    with pytest.raises(InputError, match="under way"):
        rig.protocol.repeat(0, rig.now)


def test_repeat_after_the_end_of_the_session(rig: Rig) -> None:
    for _ in range(4):
        rig.trial()
        rig.run(2.0)
    rig.protocol.repeat(2, rig.now)
    rig.trial()
    rig.run(2.0)
    assert rig.protocol.step is Step.FINISHED


def test_skip_leaves_the_trial_out(rig: Rig) -> None:
    rig.protocol.skip(rig.now)
    assert rig.last.index == 1 and rig.protocol.trials[0].verdict == "skipped"
    rig.to_press()
    rig.protocol.skip(rig.now)
    assert rig.last.index == 2
    rig.protocol.repeat(0, rig.now)
    rig.run(0.2)
    rig.trial()
    rig.run(2.0)
    assert rig.last.index == 2, "a skipped trial stays skipped until it is repeated"
    for _ in range(2):
        rig.protocol.skip(rig.now)
    assert rig.protocol.step is Step.FINISHED
    with pytest.raises(InputError, match="no open trial"):
        rig.protocol.skip(rig.now)


def test_trial_that_fails_again_and_again_holds_the_session(rig: Rig) -> None:
    for _ in range(5):
        rig.to_press()
        rig.run(0.3, 0.5, ramp=True)
        rig.run(0.7, 0.0)
        rig.run(2.0)
    assert rig.protocol.paused and "failed 5 times" in session_status(rig.protocol)["message"]
    rig.protocol.resume(rig.now)
    assert rig.protocol.step is Step.PREPARE


@pytest.mark.parametrize(
    "when",
    ["idle", "prepare", "moisture_before", "clear", "press", "lift", "moisture_after", "closing",
     "done", "failed", "finished"],
)  # fmt: skip
def test_crash_at_any_moment_resumes_at_the_same_trial(tmp_path: Path, when: str) -> None:
    rig = Rig(tmp_path / "session", trials=1 if when == "finished" else 2, conditions=("dry",))
    rig.run(0.2)
    if when != "idle":
        rig.protocol.start(rig.now)
    if when in ("moisture_before", "clear"):
        rig.protocol.start(rig.now)
        rig.readings(1.0)
        if when == "clear":
            rig.print_left = True
            rig.readings(2.0, 3.0)
    elif when == "failed":
        rig.to_press()
        rig.run(0.3, 0.5, ramp=True)
        rig.run(0.7, 0.0)
    elif when not in ("idle", "prepare"):
        rig.to_press()
        if when == "lift":
            rig.run(1.0, 1.4, ramp=True)
        elif when != "press":
            rig.press()
            if when != "moisture_after":
                rig.recorder_answers = when != "closing"
                rig.readings(36.0, 37.0, 38.0)
                rig.run(2.5 if when == "finished" else 0.2)
    assert rig.protocol.step.value == when
    before = json.loads((rig.folder / "session.json").read_text()) if when != "idle" else None
    rig.protocol.save()
    effects: list[Effect] = []
    again = Protocol.resume_from(rig.folder, effects.append, rig.now + 60 * SECOND, rig.limits)
    assert effects[0] == StopRecording(), "what the recorder still writes is closed"
    if when == "idle":
        assert again.step is Step.IDLE
        return
    assert before is not None
    if when == "finished":
        assert again.step is Step.FINISHED and not again.paused
        return
    assert again.paused and again.step is Step.PREPARE
    kept = when in ("closing", "done")
    assert again.current == (1 if kept else 0)
    assert again.trials[0].verdict == ("done" if kept else "pending")
    attempts = again.trials[0].attempts
    expected = {"prepare": [], "closing": ["done"], "done": ["done"]}.get(when, ["failed"])
    assert [a.verdict for a in attempts] == expected
    if expected == ["failed"] and when != "failed":
        assert "interrupted" in attempts[0].reason
    # The session runs on to its end with the same machine.
    rig.protocol = again
    rig.effects = effects
    rig.answered = 1
    rig.recorder_answers, rig.print_left = True, False
    rig.now += 61 * SECOND
    rig.next_tick = rig.next_frame = rig.now
    rig.force = 0.0
    rig.run(0.5)
    again.resume(rig.now)
    while again.step is not Step.FINISHED:
        rig.trial()
        rig.run(2.0)
    assert [t.verdict for t in again.trials] == ["done", "done"]


def test_state_file_is_whole_at_every_effect(tmp_path: Path) -> None:
    """A crash during any change leaves the file from before or after it, never a broken one."""
    rig = Rig(tmp_path / "session", trials=1, conditions=("dry",))
    seen = []

    def take(effect: Effect) -> None:
        rig.effects.append(effect)
        file = rig.protocol.folder / STATE_FILE
        if file.exists():
            seen.append(json.loads(file.read_text())["step"])

    rig.protocol._effects = rig.protocol.recording._ask = take
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.trial()
    assert {"prepare", "clear", "moisture_after"} <= set(seen)
    assert not [f for f in rig.folder.iterdir() if f.name.startswith(".")]


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", "not json", '{"version": 1}', '{"version": 99}', '{"version": 1, "plan": 3}'],
)
def test_unusable_state_file_is_refused_in_one_sentence(tmp_path: Path, text: str) -> None:
    (tmp_path / "session.json").write_text(text)
    with pytest.raises(InputError, match=re.escape("session.json")):
        Protocol.resume_from(tmp_path, lambda effect: None, START)


def test_commands_that_make_no_sense_are_refused(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    for command in (rig.protocol.pause, rig.protocol.resume, rig.protocol.skip, rig.protocol.redo):
        with pytest.raises(InputError):
            command(rig.now)
    rig.protocol.start(rig.now)
    rig.to_press()
    with pytest.raises(InputError, match="under way"):
        rig.protocol.start(rig.now)
    assert rig.protocol.step is Step.PRESS


def test_a_calibration_keeps_the_texts_of_the_study(tmp_path: Path) -> None:
    plan = StudyPlan("S01", "S01_a", preparations={"dry": "Wash."}).for_calibration("S01_b")
    assert plan.preparations == {"dry": "Wash."}
    press = plan.conditions[0]
    assert plan.preparation(press) == PRESS_BY_NAME[press].text
    protocol = Protocol(plan, tmp_path, lambda effect: None)
    with pytest.raises(InputError, match="presses are fixed"):
        protocol.set_preparation(press, "Press as you like.")


def test_preparation_texts_can_be_edited_and_survive(rig: Rig) -> None:
    assert session_status(rig.protocol)["preparation"] == PREPARATIONS["dry"]
    rig.protocol.set_preparation("dry", "Talcum powder.")
    assert session_status(rig.protocol)["preparation"] == "Talcum powder."
    again = Protocol.resume_from(rig.folder, lambda e: None, rig.now)
    assert again.plan.preparation("dry") == "Talcum powder."
    with pytest.raises(InputError, match="moist"):
        rig.protocol.set_preparation("moist", "x")
    with pytest.raises(InputError, match="characters"):
        rig.protocol.set_preparation("dry", " ")
    assert parse_preparations(["wet: Dip in water."])["wet"] == "Dip in water."
    with pytest.raises(InputError, match="condition: text"):
        parse_preparations(["no colon"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"subject": "Maria"}, "never a name"),
        ({"subject": "../S1"}, "code"),
        ({"session": "a/b"}, "folder"),
        ({"conditions": ()}, "no condition"),
        ({"conditions": ("dry", "dry")}, "twice"),
        ({"conditions": ("d y",)}, "not a valid name"),
        ({"trials": 0}, "trials"),
        ({"readings": -1}, "readings"),
        ({"target_force": 0.0}, "target_force"),
    ],
)
def test_plans_that_cannot_be_run_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        StudyPlan(**{"subject": "S01", "session": "a", **change})


# Orders, ends, notes, markers and the event log --------------------------------------------------


def test_counterbalanced_orders_put_every_condition_equally_often_at_each_place() -> None:
    for number in (2, 3, 4):
        conditions = [f"c{i}" for i in range(number)]
        rows = number if number % 2 == 0 else 2 * number
        orders = [
            trial_conditions(conditions, 1, "counterbalanced", 0, f"S{i + 1:02d}")
            for i in range(rows)
        ]
        places = Counter((place, c) for order in orders for place, c in enumerate(order))
        pairs = Counter(pair for order in orders for pair in pairwise(order))
        assert len(places) == number**2 and len(set(places.values())) == 1
        assert len(pairs) == number * (number - 1) and len(set(pairs.values())) == 1


@pytest.mark.parametrize("code", ["2026_S{:02d}", "E2_P{}", "G1S{:02d}", "S{}", "S{}_1"])
def test_the_last_number_of_a_code_counterbalances(code: str) -> None:
    def of(number: int) -> list[str]:
        return trial_conditions("abc", 1, "counterbalanced", 0, code.format(number))

    assert Counter("".join(of(n)) for n in range(1, 13)) == dict.fromkeys(
        ("abc", "bca", "cab", "bac", "cba", "acb"), 2
    )
    given = {"subject": code.format(2), "conditions": ["a", "b", "c"], "order_seed": 0}
    assert order_text({**given, "order": "counterbalanced"}) == (
        f"Blocks: {', '.join(of(2))}, by the number 2."
    )
    assert order_text({**given, "order": "as_given"}) == "Blocks: a, b, c."
    assert order_text({**given, "order": "as_given", "subject": "Maria"}) == ""


@pytest.mark.parametrize("order", ORDERS)
def test_orders_hold_every_trial_and_follow_from_seed_and_subject(order: str) -> None:
    conditions = ["dry", "natural", "moist"]

    def of(seed: int, subject: str) -> list[str]:
        return trial_conditions(conditions, 5, order, seed, subject)

    assert Counter(of(1, "S01")) == dict.fromkeys(conditions, 5)
    assert of(1, "S01") == of(1, "S01")
    different = {tuple(of(seed, f"S{n:02d}")) for seed in range(5) for n in range(1, 6)}
    assert len(different) == 1 if order == "as_given" else len(different) >= 3
    if order != "shuffled_trials":
        assert all(len(set(of(2, "S03")[i : i + 5])) == 1 for i in (0, 5, 10)), "blocks"


def test_end_completes_the_trial_under_way_and_keeps_what_was_done(rig: Rig) -> None:
    rig.trial()
    rig.run(2.0)
    rig.to_press()
    rig.protocol.end(rig.now)
    assert rig.protocol.step is Step.PRESS
    rig.press()
    rig.readings(36.0, 37.0, 38.0)
    rig.run(2.0)
    assert rig.protocol.step is Step.FINISHED
    assert [t.verdict for t in rig.protocol.trials] == ["done", "done", "pending", "pending"]
    told = session_status(rig.protocol)
    assert told["summary"]["text"].startswith(
        "Session ended early by the operator: 2 of 4 trials kept, 2 not done."
    )
    assert told["instruction"] == told["summary"]["text"]
    # After a restart the session is still at its end; it can be taken up again.
    again = Protocol.resume_from(rig.folder, rig.take, rig.now, rig.limits)
    assert again.step is Step.FINISHED and not again.paused
    rig.protocol = again
    rig.answered = len([e for e in rig.effects if not isinstance(e, TrialEvent)])
    again.resume(rig.now)
    assert again.step is Step.PREPARE and again.current == 2
    rig.trial()


@pytest.mark.parametrize(
    "when", ["idle", "prepare", "press", "moisture_after", "closing", "paused"]
)
def test_abort_ends_at_once_and_keeps_every_bag(tmp_path: Path, when: str) -> None:
    rig = Rig(tmp_path / "session")
    rig.run(0.2)
    if when != "idle":
        rig.protocol.start(rig.now)
    if when in ("press", "moisture_after", "closing"):
        rig.to_press()
    if when in ("moisture_after", "closing"):
        rig.press()
    if when == "closing":
        rig.recorder_answers = False
        rig.readings(36.0, 37.0, 38.0)
    if when == "paused":
        rig.protocol.pause(rig.now)
    else:
        assert rig.protocol.step.value == when
    rig.protocol.abort(rig.now)
    rig.recorder_answers = True
    rig.run(2.5)
    assert rig.protocol.step is Step.FINISHED and rig.last.phase is TrialPhase.IDLE
    attempts = rig.protocol.trials[0].attempts
    expected = {"press": ["failed"], "moisture_after": ["failed"], "closing": ["done"]}
    assert [a.verdict for a in attempts] == expected.get(when, [])
    if attempts:
        assert attempts[0].bag and StopRecording() in rig.effects
    with pytest.raises(InputError, match="finished already"):
        rig.protocol.abort(rig.now)
    assert "aborted" in session_status(rig.protocol)["summary"]["text"]


def test_summary_after_a_session_in_which_everything_was_skipped(rig: Rig) -> None:
    for _ in range(4):
        rig.protocol.skip(rig.now)
    told = session_status(rig.protocol)["summary"]
    assert (told["kept"], told["skipped"], told["planned"]) == (0, 4, 4)
    assert told["text"] == (
        "Finished: 0 of 4 trials kept, 4 skipped. Repeat the skipped trials from the list, or "
        "press Space to close the session."
    )


def test_notes_and_markers_are_kept_with_their_time_trial_and_bag(rig: Rig) -> None:
    rig.protocol.note(rig.now, "room at 23 °C,\nquiet")
    rig.to_press()
    rig.run(0.5, 0.7, ramp=True)
    marked = rig.now
    assert rig.protocol.mark(marked) == "marker 1"
    rig.protocol.note(rig.now, 'slipped, "a bit"', 0)
    rig.press()
    rig.readings(36.0, 37.0, 38.0)
    rig.run(0.2)
    done = next(e for e in rig.effects if isinstance(e, TrialEvent) and e.phase is TrialPhase.DONE)
    assert 'slipped, "a bit" (2023-' in done.note and "marker 1 (2023-" in done.note
    again = Protocol.resume_from(rig.folder, rig.take, rig.now, rig.limits)
    told = session_status(again)
    assert [n["text"] for n in told["notes"]] == ["room at 23 °C, quiet"]
    assert told["trials"][0]["markers"][0]["time"] == pytest.approx(marked / SECOND, abs=1e-3)
    with (rig.folder / "trials.csv").open() as file:
        row = next(csv.DictReader(file))
    assert row["notes"] == 'slipped, "a bit"' and row["markers"] == "1"
    with (rig.folder / "events.csv").open() as file:
        rows = list(csv.DictReader(file))
    marker = next(r for r in rows if r["kind"] == "marker")
    assert int(marker["stamp_ns"]) == marked
    assert datetime.fromisoformat(marker["time_utc"]).timestamp() == pytest.approx(
        marked / SECOND, abs=2e-3
    )
    kinds = [r["kind"] for r in rows]
    assert {"session", "step", "note", "marker", "kept"} <= set(kinds)
    for text, index in (("", 0), ("x" * 501, 0), ("\ud800", 0), ("fine", 4)):
        with pytest.raises(InputError):
            rig.protocol.note(rig.now, text, index)


def test_event_log_goes_on_after_a_line_was_cut(tmp_path: Path) -> None:
    log = EventLog(tmp_path)
    for number in range(3):
        log.add(Event(START + number, "note", f"n{number}", number, 0))
    log.save()
    path = tmp_path / "events.csv"
    path.write_bytes(path.read_bytes()[:-6])
    log = EventLog.load(tmp_path)
    assert [e.text for e in log.events] == ["n0", "n1"]
    log.add(Event(START + 9, "marker", "marker 1"))
    log.save()
    assert [e.text for e in EventLog.load(tmp_path).events] == ["n0", "n1", "marker 1"]


def test_the_log_of_a_full_disk_is_read_and_goes_on_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its last line was cut; nothing is written to read it."""
    log = EventLog(tmp_path)
    for number in range(3):
        log.add(Event(START + number, "note", f"n{number}"))
    log.save()
    path = tmp_path / "events.csv"
    cut = path.read_bytes()[:-6]
    path.write_bytes(cut)
    with monkeypatch.context() as full:

        def refuse(*_: Any, **__: Any) -> int:
            raise OSError(28, "No space left on device")

        full.setattr(Path, "write_text", refuse)
        log = EventLog.load(tmp_path)
    assert path.read_bytes() == cut
    log.add(Event(START + 9, "note", "n9"))
    log.save()
    log.add(Event(START + 10, "note", "n10"))
    log.save()
    assert path.read_bytes().startswith(cut + b"\n")
    assert [e.text for e in EventLog.load(tmp_path).events] == ["n0", "n1", "n9", "n10"]


def test_an_empty_log_gets_its_header(tmp_path: Path) -> None:
    """As a full disk leaves it at the first event."""
    path = tmp_path / "events.csv"
    path.touch()
    log = EventLog.load(tmp_path)
    log.add(Event(START, "note", "n0"))
    log.save()
    with path.open() as file:
        assert [row["text"] for row in csv.DictReader(file)] == ["n0"]
    assert [e.text for e in EventLog.load(tmp_path).events] == ["n0"]


def test_session_goes_on_and_warns_while_its_folder_cannot_be_written(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    import finger_operator.protocol as module

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "save_state", full)
    rig.trial()
    assert "No space left" in session_status(rig.protocol)["warnings"][0]
    monkeypatch.undo()
    rig.run(2.0)
    assert session_status(rig.protocol)["warnings"] == []
    assert json.loads((rig.folder / STATE_FILE).read_text())["trials"][0]["verdict"] == "done"


@pytest.mark.parametrize("refused", ["save_state", "save_table", "log"])
def test_a_finished_session_is_saved_as_soon_as_it_can_be(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, refused: str
) -> None:
    import finger_operator.protocol as module

    def refuse(*_: Any) -> None:
        raise InputError("no room")

    rig.trial()
    with monkeypatch.context() as full:
        place, name = (rig.protocol.log, "save") if refused == "log" else (module, refused)
        full.setattr(place, name, refuse)
        rig.protocol.note(rig.now, "the window is open")
        rig.protocol.end(rig.now)
        rig.run(12.0)
        with pytest.raises(InputError, match=r"cannot be saved in .*no room; make room"):
            rig.protocol.write_all()
    assert session_status(rig.protocol)["warnings"]
    rig.run(6.0)
    assert rig.protocol.step is Step.FINISHED and session_status(rig.protocol)["warnings"] == []
    assert json.loads((rig.folder / STATE_FILE).read_text())["step"] == "finished"
    assert [e.text for e in EventLog.load(rig.folder).of("note")] == ["the window is open"]
    with (rig.folder / "trials.csv").open() as file:
        assert [row["verdict"] for row in csv.DictReader(file)] == ["done"]
    rig.protocol.write_all()


def test_the_log_of_a_press_hides_no_state_that_could_not_be_saved(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    import finger_operator.protocol as module

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "save_state", full)
    rig.to_press()
    rig.run(0.5, 0.7, ramp=True)
    rig.protocol.mark(rig.now)
    assert rig.protocol.step is Step.PRESS and "No space left" in rig.protocol.save_problem


def test_each_step_of_the_system_clock_is_an_event(rig: Rig) -> None:
    for step in (0.0, 1e-4, 3600.0, 3600.001, 7200.0, 0.0):
        rig.protocol.clock_stepped(step, f"stepped by {step:g} s" if step > 1.0 else "")
    texts = [event.text for event in rig.protocol.log.events if event.kind == "warning"]
    assert texts[:2] == ["stepped by 3600 s", "stepped by 7200 s"]
    assert texts[2:] == ["the system clock is where it was when this node began"]


def test_time_left_and_disk_space_follow_from_the_trials_that_were_kept(rig: Rig) -> None:
    assert session_status(rig.protocol, 10**9)["disk"]["enough"] is None
    for _ in range(2):
        rig.trial()
        bag = Path(rig.attempt.bag)
        rig.run(2.0)
        bag.mkdir(parents=True)
    for trial in rig.protocol.trials[:2]:
        trial.attempts[-1].size = 200_000_000
    told = session_status(rig.protocol, 10**9)
    assert told["disk"] == {"free_gb": 1.0, "needed_gb": 0.4, "trials_left": 5, "enough": True}
    ends = [t.attempts[-1].ended_ns for t in rig.protocol.trials[:2]]
    assert told["time_left"] == pytest.approx(2 * (ends[1] - ends[0]) / SECOND, abs=0.1)
    told = session_status(rig.protocol, 300_000_000)
    assert told["disk"]["enough"] is False
    assert "room for only 1 more trial. Delete" in told["warnings"][0]
    # What the recorder leaves free is no room.
    told = session_status(rig.protocol, 10**9, reserve=700_000_000)
    assert (told["disk"]["free_gb"], told["disk"]["trials_left"]) == (1.0, 1)
    assert session_status(rig.protocol, 10**9, reserve=2 * 10**9)["disk"]["trials_left"] == 0


@pytest.mark.parametrize("later", [-7200.0, 12 * 3600.0])
@pytest.mark.parametrize("before", [1, 2])
def test_a_night_or_a_change_of_the_clock_is_not_in_the_time_left(
    tmp_path: Path, before: int, later: float
) -> None:
    rig = Rig(tmp_path, trials=4)
    rig.run(0.5)
    rig.protocol.start(rig.now)
    for trial in range(before + 1):
        if trial == before:
            on_another_day(rig, later)
        rig.trial()
        took = rig.attempt.ended_ns - rig.attempt.began_ns
        rig.run(2.0)
    left = session_status(rig.protocol)["time_left"]
    assert left == pytest.approx((7 - before) * took / SECOND, rel=0.5)


def test_a_disk_without_room_for_a_first_trial_is_warned_of(rig: Rig) -> None:
    told = session_status(rig.protocol, 300_000_000, reserve=268_435_456)
    assert "no room for another trial" in told["warnings"][0]
    assert session_status(rig.protocol, 10**9, reserve=268_435_456)["warnings"] == []
    rig.protocol.limits = Limits(need_recorder=False)
    assert session_status(rig.protocol, 300_000_000, reserve=268_435_456)["warnings"] == []


def test_one_huge_bag_does_not_hide_the_room_for_usual_ones(rig: Rig) -> None:
    for size in (50_000_000, 1_000_000_000, 50_000_000):
        rig.trial()
        rig.attempt.size = size
        rig.run(2.0)
    assert session_status(rig.protocol, 10**9)["disk"]["trials_left"] == 20


def test_size_of_a_bag_is_measured_when_the_trial_is_kept(rig: Rig) -> None:
    rig.to_press()
    bag = Path(rig.attempt.bag)
    bag.mkdir(parents=True)
    (bag / "a.mcap").write_bytes(bytes(1234))
    rig.press()
    rig.readings(36.0, 37.0, 38.0)
    rig.run(0.2)
    assert rig.attempt.size == 1234


def test_silence_of_force_and_camera_is_logged_with_its_end(rig: Rig) -> None:
    rig.protocol.start(rig.now)
    rig.run(0.5)
    rig.force_on = False
    rig.run(0.5)
    assert not [e for e in rig.protocol.log.events if e.kind == "fault"], "a hiccup"
    rig.run(3.0)
    rig.force_on, rig.camera_on = True, False
    rig.protocol.pause(rig.now)
    rig.run(3.0)
    rig.camera_on = True
    rig.run(1.0)
    faults = [e.text for e in rig.protocol.log.events if e.kind == "fault"]
    sensor, camera = (
        [text for text in faults if text.startswith(name)] for name in ("force", "camera")
    )
    assert sensor == ["force sensor: silent", "force sensor: over"]
    assert camera == ["camera: silent", "camera: over"]


def test_device_faults_are_logged_once_with_their_end(rig: Rig) -> None:
    for _ in range(3):
        rig.protocol.health("camera", 2, "no frame for 2 s", rig.now)
    rig.protocol.health("camera", 0, "", rig.now)
    faults = [e.text for e in rig.protocol.log.events if e.kind == "fault"]
    assert faults == ["camera: no frame for 2 s", "camera: over"]


def test_subject_codes_that_were_used_are_found_and_warned_of(rig: Rig, tmp_path: Path) -> None:
    rig.protocol.save()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / STATE_FILE).write_text("{")
    assert sessions_by_subject(tmp_path) == {"S01": ["session"]}
    told = session_status(rig.protocol, None, ["S01_old"])
    assert "S01 was used before (S01_old)" in told["warnings"][0]


@pytest.mark.parametrize("code", ["S01", "s01", "S1", "S001"])
def test_codes_that_may_be_one_person_are_warned_of(rig: Rig, tmp_path: Path, code: str) -> None:
    rig.protocol.save()
    used = sessions_by_subject(tmp_path)
    plan = StudyPlan(code, "another")
    named = "session" if code == "S01" else "session as S01"
    assert earlier_sessions(used, plan) == [named]
    for other in ("S11", "S010", "S02", "S0_1"):
        assert earlier_sessions(used, StudyPlan(other, "another")) == []
    assert earlier_sessions(used, StudyPlan(code, "session")) == [], "itself"


def test_instructions_say_what_to_do(rig: Rig) -> None:
    def told() -> str:
        return str(session_status(rig.protocol)["instruction"])

    assert told() == "Prepare finger and plate, then press Space."
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.readings(36.0)
    assert told() == "Hold the probe to the fingertip (2 of 3)."
    again = Protocol.resume_from(rig.folder, rig.take, rig.now, rig.limits)
    assert session_status(again)["instruction"] == (
        "Restarted. Trial 1 will begin again: press Space."
    )


def test_state_of_an_older_version_without_the_newer_fields_is_read(rig: Rig) -> None:
    rig.trial()
    path = rig.folder / STATE_FILE
    state = json.loads(path.read_text())
    del state["ended"]
    for name in ("age", "hand", "finger", "finger_width", "finger_depth", "order", "order_seed"):
        del state["plan"][name]
    for trial in state["trials"]:
        for attempt in trial["attempts"]:
            del attempt["ended_ns"], attempt["size"]
    path.write_text(json.dumps(state))
    (rig.folder / "events.csv").unlink()
    again = Protocol.resume_from(rig.folder, rig.take, rig.now, rig.limits)
    assert again.trials[0].verdict == "done" and again.plan.order == "as_given"


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


def test_an_area_of_zero_is_no_contact_whatever_its_flags(tmp_path: Path) -> None:
    """As from a stream that has no flags."""
    rig = Rig(tmp_path, readings=0, limits=Limits(need_recorder=False))
    rig.protocol.start(rig.now)
    rig.protocol.start(rig.now)
    rig.protocol.wrench(rig.now, 0.0)
    rig.protocol.area(rig.now, 0.0, 0)
    assert rig.protocol.waiting_for() == ""
    rig.protocol.area(rig.now, 30e-6, 0)
    assert "something is on the plate" in rig.protocol.waiting_for()


@pytest.mark.parametrize("command", ["end", "abort"])
def test_a_good_trial_counts_when_its_repetition_is_given_up(tmp_path: Path, command: str) -> None:
    rig = Rig(tmp_path, conditions=("dry",), trials=1)
    rig.protocol.start(rig.now)
    rig.trial()
    rig.protocol.redo(rig.now)
    assert rig.protocol.trials[0].verdict == "pending"
    getattr(rig.protocol, command)(rig.now)
    assert rig.protocol.step is Step.FINISHED
    assert rig.protocol.trials[0].verdict == "done"
    assert rig.protocol.trials[0].attempts[0].verdict == "done"


def test_a_calibration_that_was_fitted_is_not_asked_for_again_after_a_restart(
    tmp_path: Path,
) -> None:
    plan = StudyPlan("S01", "S01_test").for_calibration("S01_calibration")
    protocol = Protocol(plan, tmp_path, lambda effect: None, Limits())
    protocol.start(START)
    for trial in protocol.trials:
        trial.verdict = "done"
    protocol._enter(Step.FINISHED)
    protocol.calibrated(True, "area under 1 N 60 mm²", START + SECOND)
    effects: list[Effect] = []
    again = Protocol.resume_from(tmp_path, effects.append, START + 9 * SECOND)
    assert again.message == protocol.message == "Calibrated: area under 1 N 60 mm²."
    notes = [e.note for e in effects if isinstance(e, TrialEvent)]
    assert not any("fit" in note.lower() for note in notes)
    again.calibrated(False, "the model node was started meanwhile", START + 10 * SECOND)
    assert again.message == protocol.message
