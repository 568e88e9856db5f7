# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Notes, markers and faults in the event log, and its file."""

from __future__ import annotations

import csv
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from study_rig import SECOND, START, Rig

from finger_bag.streams import TrialEvent
from finger_common.errors import InputError
from finger_common.trial_phases import TrialPhase
from finger_operator.event_log import Event, EventLog
from finger_operator.protocol import Protocol
from finger_operator.status import session_status


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


def test_another_fault_of_a_device_is_logged_while_the_first_lasts(rig: Rig) -> None:
    told = ("no frame for 2 s", "no frame for 3 s", "lens cap on", "no frame for 4.5 s")
    for text in told:
        rig.protocol.health("camera", 2, text, rig.now)
    rig.protocol.health("camera", 0, "", rig.now)
    rig.protocol.health("camera", 2, "lens cap on", rig.now)
    faults = [e.text for e in rig.protocol.log.events if e.kind == "fault"]
    assert faults == [
        "camera: no frame for 2 s",
        "camera: lens cap on",
        "camera: over",
        "camera: lens cap on",
    ]
