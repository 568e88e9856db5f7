# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The handshake with the recorder, and trials that end with it."""

from __future__ import annotations

from pathlib import Path

import pytest
from study_rig import SECOND, Rig, expect_failure

from finger_bag.reader import open_bag
from finger_bag.streams import TrialEvent
from finger_bag.writer import BagWriter
from finger_common.trial_phases import TrialPhase
from finger_operator.limits import Limits
from finger_operator.recording import (
    LATE_REPORT,
    Recording,
    RecordingState,
    Request,
    StartRecording,
    StopRecording,
)
from finger_operator.status import session_status
from finger_operator.steps import Step

TRIAL = TrialEvent(0, "S01_test", "S01", "dry", 0, 0, TrialPhase.MOISTURE_BEFORE, 1.35, "")


@pytest.fixture
def asked() -> list[Request]:
    return []


@pytest.fixture
def recording(asked: list[Request]) -> Recording:
    """Of a bag that was asked for."""
    recording = Recording(asked.append)
    recording.start("bag", TRIAL, 0)
    return recording


def test_a_bag_is_begun_and_closed_by_answers(recording: Recording, asked: list[Request]) -> None:
    assert (recording.state, recording.is_open) == (RecordingState.STARTING, True)
    assert recording.waiting_for(0) == "the recorder is not running yet"
    assert not recording.started(True, asked="another bag")
    assert recording.started(True, asked="bag")
    assert (recording.state, recording.waiting_for(0)) == (RecordingState.ON, "")
    assert not recording.started(True, asked="bag")
    recording.stop(SECOND)
    assert (recording.state, recording.is_open) == (RecordingState.STOPPING, False)
    assert recording.stopped() and not recording.stopped()
    assert recording.state is RecordingState.OFF
    assert asked == [StartRecording("bag", TRIAL), StopRecording()]


def test_a_refused_start_leaves_the_recorder_off(recording: Recording) -> None:
    assert not recording.stopped(), "the answer to a stop before"
    assert recording.started(False)
    assert recording.state is RecordingState.OFF


def test_an_answer_is_waited_for_from_the_newest_request(recording: Recording) -> None:
    assert not recording.is_late(10 * SECOND, 10.0)
    assert recording.is_late(10 * SECOND + 1, 10.0)
    recording.stop(10 * SECOND)
    assert not recording.is_late(20 * SECOND, 10.0)


def test_another_bag_counts_when_it_is_still_reported_after_a_while(recording: Recording) -> None:
    late = round(LATE_REPORT * SECOND)
    assert not any(recording.reported("no", "bag", now) for now in (0, late + 1)), "not begun yet"
    recording.started(True)
    assert not any(recording.reported("no", "bag", now) for now in (0, late))
    assert not recording.reported("bag", "bag", late)
    assert not any(recording.reported("no", "bag", now) for now in (late, 2 * late))
    assert not recording.reported("no", None, 2 * late), "no attempt is under way"
    assert not recording.reported("no", "bag", 2 * late)
    assert recording.reported("no", "bag", 3 * late + 1)


def test_a_recorder_that_reported_once_must_go_on(recording: Recording) -> None:
    recording.started(True)
    assert recording.waiting_for(9 * SECOND) == ""
    recording.reported("bag", "bag", 9 * SECOND)
    assert recording.waiting_for(12 * SECOND) == ""
    assert recording.waiting_for(12 * SECOND + 1) == "the recorder is silent"


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


@pytest.mark.parametrize(
    ("limit", "lost", "verdict"), [(0, 1, "failed"), (1, 1, "done"), (1, 2, "failed")]
)
def test_a_trial_may_lose_as_many_messages_as_its_limit(
    tmp_path: Path, limit: int, lost: int, verdict: str
) -> None:
    rig = Rig(tmp_path, limits=Limits(lost_limit=limit))
    rig.lost = lost
    rig.run(0.5)
    rig.protocol.start(rig.now)
    rig.to_press()
    rig.press()
    rig.readings(1.0, 2.0, 3.0)
    rig.run(0.2)
    assert rig.attempt.verdict == verdict


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
