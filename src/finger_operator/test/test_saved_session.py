# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a session leaves on the disk: it resumes after any crash, and a full disk ends nothing."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import pytest
from study_rig import SECOND, START, Rig

from finger_bag.streams import TrialEvent
from finger_common.errors import InputError
from finger_operator.event_log import EventLog
from finger_operator.limits import Limits
from finger_operator.protocol import Effect, Protocol
from finger_operator.recording import StartRecording, StopRecording
from finger_operator.session_store import STATE_FILE
from finger_operator.status import session_status
from finger_operator.steps import Step
from finger_operator.study_plan import StudyPlan


def test_no_cue_of_a_press_waits_for_the_state_of_a_long_session(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved: list[Step] = []
    monkeypatch.setattr(
        "finger_operator.session_files.save_state", lambda folder, state: saved.append(state.step)
    )
    rig.trial()
    assert saved[:2] == [Step.MOISTURE_BEFORE] * 2 and saved[-1] is Step.DONE
    assert not {Step.PRESS, Step.LIFT} & set(saved)
    steps = [e.text for e in EventLog.load(rig.folder).events if e.kind == "step"]
    assert {"press", "lift"} <= set(steps)


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
    rig.protocol.files.save()
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


@pytest.mark.parametrize(
    ("step", "reason"),
    [("nowhere", "step is 'nowhere'"), ("lift", "step without attempt is 'lift'")],
)
def test_a_step_that_cannot_be_is_refused_with_the_remedy(rig: Rig, step: str, reason: str) -> None:
    path = rig.folder / STATE_FILE
    path.write_text(json.dumps({**json.loads(path.read_text()), "step": step}))
    whole = f"{path}: not a session state ({reason}); move it away to start a new session"
    with pytest.raises(InputError, match=re.escape(whole)):
        Protocol.resume_from(rig.folder, rig.take, rig.now)


def test_session_goes_on_and_warns_while_its_folder_cannot_be_written(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    import finger_operator.session_files as module

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
    import finger_operator.session_files as module

    def refuse(*_: Any) -> None:
        raise OSError(28, "no room")

    rig.trial()
    with monkeypatch.context() as full:
        place, name = (rig.protocol.log, "save") if refused == "log" else (module, refused)
        full.setattr(place, name, refuse)
        rig.protocol.note(rig.now, "the window is open")
        rig.protocol.end(rig.now)
        rig.run(12.0)
        with pytest.raises(InputError, match=r"cannot be saved in .*no room; make room"):
            rig.protocol.files.write_all()
    assert session_status(rig.protocol)["warnings"]
    rig.run(6.0)
    assert rig.protocol.step is Step.FINISHED and session_status(rig.protocol)["warnings"] == []
    assert json.loads((rig.folder / STATE_FILE).read_text())["step"] == "finished"
    assert [e.text for e in EventLog.load(rig.folder).of("note")] == ["the window is open"]
    with (rig.folder / "trials.csv").open() as file:
        assert [row["verdict"] for row in csv.DictReader(file)] == ["done"]
    rig.protocol.files.write_all()


def test_a_session_whose_folder_is_gone_is_not_begun_anew_on_another_disk(
    rig: Rig, tmp_path: Path
) -> None:
    rig.trial()
    rig.folder.rename(tmp_path / "away")
    rig.run(6.0)
    begun = sum(isinstance(e, StartRecording) for e in rig.effects)
    rig.protocol.start(rig.now)
    rig.run(6.0)
    assert rig.protocol.paused and "the folder is gone" in rig.protocol.message
    assert "the folder is gone" in session_status(rig.protocol)["warnings"][0]
    assert not rig.folder.exists()
    assert sum(isinstance(e, StartRecording) for e in rig.effects) == begun
    (tmp_path / "away").rename(rig.folder)
    rig.protocol.resume(rig.now)
    rig.trial()
    assert not rig.protocol.files.problem
    saved = json.loads((rig.folder / STATE_FILE).read_text())
    assert [t["verdict"] for t in saved["trials"]][:2] == ["done", "done"]


def test_a_session_whose_folder_is_gone_for_good_is_closed_in_a_new_folder(
    rig: Rig, tmp_path: Path
) -> None:
    rig.trial()
    rig.folder.rename(tmp_path / "away")
    rig.protocol.end(rig.now)
    rig.run(6.0)
    with pytest.raises(InputError, match=r"make this folder anew .*, then try again$") as error:
        rig.protocol.files.write_all()
    assert "make room" not in f"{error.value} {session_status(rig.protocol)['warnings'][0]}"
    rig.folder.mkdir()
    rig.protocol.files.write_all()
    saved = json.loads((rig.folder / STATE_FILE).read_text())
    assert saved["trials"][0]["verdict"] == "done" and saved["ended"]


def test_the_log_of_a_press_hides_no_state_that_could_not_be_saved(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    import finger_operator.session_files as module

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "save_state", full)
    rig.to_press()
    rig.run(0.5, 0.7, ramp=True)
    rig.protocol.mark(rig.now)
    assert rig.protocol.step is Step.PRESS and "No space left" in rig.protocol.files.problem


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
