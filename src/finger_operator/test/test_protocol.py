# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The guided study, walked through its steps and commands on simulated time, without ROS."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest
from study_rig import SECOND, Rig, on_another_day

from finger_bag.streams import TrialEvent
from finger_common.errors import InputError
from finger_common.trial_phases import TrialPhase
from finger_operator.limits import Limits
from finger_operator.protocol import Protocol
from finger_operator.recording import StartRecording, StopRecording
from finger_operator.status import session_status
from finger_operator.steps import Step


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
        (("force", -0.2), ("force", 0.0), "-0.20 N on the plate: lift the finger, or tare"),
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


def test_a_probe_in_the_air_gives_no_reading(rig: Rig) -> None:
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.readings(0.0, 0.0, 0.0, 0.4)
    assert rig.protocol.step is Step.MOISTURE_BEFORE and rig.attempt.moisture_before == []
    assert rig.last.note == "Reading 0.4: no contact with the skin; take another."
    assert rig.last.note in session_status(rig.protocol)["instruction"]
    rig.readings(2.0, 3.0, 4.0)
    assert rig.attempt.moisture_before == [2.0, 3.0, 4.0], "skin may be dry"


def test_a_source_that_reads_nothing_on_skin_may_be_allowed(tmp_path: Path) -> None:
    rig = Rig(tmp_path, limits=Limits(least_moisture=0.0))
    rig.protocol.start(rig.now)
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.readings(0.0, 0.0, 0.0)
    assert rig.attempt.moisture_before == [0.0, 0.0, 0.0]


def test_readings_that_lie_far_apart_are_named_and_kept(rig: Rig) -> None:
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.readings(5.0, 120.0, 37.0)
    said = "The readings before the press are 115 a.u. apart (5, 120, 37)."
    assert session_status(rig.protocol)["warnings"][0].startswith(said)
    rig.run(1.0)
    rig.press()
    rig.readings(36.0, 37.0, 55.0)
    rig.run(0.3)
    assert rig.attempt.verdict == "done"
    warned = [e for e in rig.protocol.log.events if e.kind == "warning"]
    assert len(warned) == 1 and warned[0].text.startswith(said) and warned[0].index == 0
    rig.run(2.0)
    assert session_status(rig.protocol)["warnings"] == [], "the next trial"


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
