# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bags of failed attempts say that they failed, however the attempt ended."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from study_rig import SECOND, Rig

from finger_bag.reader import open_bag
from finger_bag.streams import TrialEvent
from finger_bag.writer import BagWriter
from finger_common.trial_phases import TrialPhase
from finger_operator.event_log import EventLog
from finger_operator.protocol import Protocol
from finger_operator.session_store import STATE_FILE
from finger_operator.steps import Step


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
    import finger_operator.session_files as module

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


def test_a_failed_trial_is_marked_when_the_disk_that_was_pulled_in_its_press_is_back(
    rig: Rig, tmp_path: Path
) -> None:
    rig.to_press()
    path = Path(rig.attempt.bag)
    with BagWriter(path) as bag:
        bag.write("trial", {"header": {"stamp": rig.now}, "phase": int(TrialPhase.PRESS)})
    rig.run(0.3, 0.8, ramp=True)
    rig.folder.rename(tmp_path / "pulled")
    for _ in range(60):
        rig.run(0.1)
        rig.protocol.recorder_writes("", rig.now)
    rig.protocol.files.mark_bags(left=True)
    (tmp_path / "pulled").rename(rig.folder)
    rig.run(12.0)
    assert not [e.text for e in rig.protocol.log.events if "not marked" in e.text]
    with open_bag(path) as reader:
        assert list(reader.messages())[-1].message.phase == TrialPhase.FAILED


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
    again.files.write_all()
    assert len(list(bag.iterdir())) == 1 and again.files.unmarked
    (bag / "metadata.yaml").write_text(whole)
    again.recorder_stopped(True, "", rig.now + 20 * SECOND)
    with open_bag(bag) as reader:
        assert list(reader.messages())[-1].message.phase == TrialPhase.FAILED
    assert not again.files.unmarked
