# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What happened in a session, with clock times: events.csv beside the bags. Only ever appended."""

from __future__ import annotations

import csv
import errno
import io
import os
from dataclasses import astuple, dataclass, fields
from datetime import datetime, timezone
from pathlib import Path

from finger_common.errors import InputError
from finger_common.files import make_folder
from finger_common.stamps import seconds

EVENTS_FILE = "events.csv"
LONGEST_NOTE = 500


@dataclass(frozen=True)
class Event:
    """One line of the log.

    kind: session, step, command, kept, failed, fault, warning, note or marker. index, attempt: of
    the trial that it belongs to, −1 for the session as a whole.
    """

    stamp_ns: int
    kind: str
    text: str
    index: int = -1
    attempt: int = -1


COLUMNS = ("time_utc", *(field.name for field in fields(Event)))


class EventLog:
    """The events of a session in memory and in its file."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / EVENTS_FILE
        self._written = 0
        self.events: list[Event] = []
        self._by_trial: dict[tuple[str, int], list[Event]] = {}

    @classmethod
    def load(cls, folder: Path) -> EventLog:
        """Log of a session that goes on; lines that are damaged are left out, the file is kept."""
        log = cls(folder)
        try:
            text = log._path.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return log
        for line in text.splitlines()[1:]:
            try:
                ((_, stamp, kind, note, index, attempt),) = csv.reader([line])
                event = Event(int(stamp), kind, note, int(index), int(attempt))
                utc_time(event.stamp_ns)
                log.add(event)
            except (ValueError, OverflowError, OSError, csv.Error):
                continue
        log._written = len(log.events)
        return log

    def add(self, event: Event) -> None:
        """Remember an event; `save` writes it."""
        self.events.append(event)
        self._by_trial.setdefault((event.kind, event.index), []).append(event)

    def save(self) -> None:
        """Append what is new to the file; raises OSError."""
        new = self.events[self._written :]
        if not new:
            return
        make_folder(self._path.parent)
        with self._path.open("a+b", buffering=0) as file:
            end = file.seek(0, os.SEEK_END)
            text = io.StringIO()
            rows = csv.writer(text, lineterminator="\n")
            if end == 0:
                rows.writerow(COLUMNS)
            elif os.pread(file.fileno(), 1, end - 1) != b"\n":
                text.write("\n")  # after a line that was cut
            for event in new:
                rows.writerow((utc_time(event.stamp_ns), *astuple(event)))
            data = text.getvalue().encode()
            if file.write(data) != len(data):
                file.truncate(end)
                raise OSError(errno.ENOSPC, "no space left on the disk")
        self._written = len(self.events)

    def of(self, kind: str, index: int = -1, attempt: int | None = None) -> list[Event]:
        """Events of one kind of a trial, or of one attempt at it; −1 for the session as a whole."""
        of_trial = self._by_trial.get((kind, index), [])
        return [e for e in of_trial if attempt is None or e.attempt == attempt]

    def remarks(self, index: int, attempt: int) -> list[str]:
        """Notes and markers of an attempt, each with its time."""
        events = self.of("note", index, attempt) + self.of("marker", index, attempt)
        return [f"{event.text} ({utc_time(event.stamp_ns)})" for event in events]


def utc_time(stamp_ns: int) -> str:
    """ISO 8601 with milliseconds."""
    time = datetime.fromtimestamp(seconds(stamp_ns), timezone.utc)
    return time.isoformat(timespec="milliseconds")


def note_text(text: str) -> str:
    """A note in one line; raises InputError for an empty, long or unwritable one."""
    line = " ".join(text.split())
    if not line or len(line) > LONGEST_NOTE:
        raise InputError(f"a note has 1 to {LONGEST_NOTE} characters; this one has {len(line)}")
    if not line.isprintable():
        raise InputError("the note holds characters that cannot be written; type it again")
    return line
