# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The handshake with the recorder, and trials that end with it."""

from __future__ import annotations

import pytest

from finger_bag.streams import TrialEvent
from finger_common.trial_phases import TrialPhase
from finger_operator.recording import (
    LATE_REPORT,
    Recording,
    RecordingState,
    Request,
    StartRecording,
    StopRecording,
)

SECOND = 1_000_000_000
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
