# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Moisture readings from an export file that is watched.

The file is read when it has stayed the same for two checks, so that a table just being written is
not read half. Rows that are there at the start are not new. A reading's stamp is its own time where
the table has one, else the file's time of modification: never the time of the check. Both are wall
times; a step of the system clock is taken out of them.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

from finger_common.cli import one_line
from finger_common.diagnostics import ERROR
from finger_common.errors import DeviceError
from finger_common.settings import setting
from finger_common.stamps import NANOSECONDS

from ..protocols.export_table import MAX_BYTES, Row, TableFormat, new_rows, parse_table
from .source import PHASE_UNKNOWN, PHASES, MoistureSettings, MoistureSource, Reading

_SETTLING = 2.0
"""s at most that a file is waited for which somebody writes when it is first looked at."""


@dataclass(frozen=True)
class ExportSettings(TableFormat, MoistureSettings):
    """Settings of an export file."""

    export_period: float = setting(
        0.25,
        "export: time between checks; a file is read when two checks find it the same.",
        unit="s",
        minimum=0.02,
        maximum=60.0,
    )

    def validate(self) -> None:
        self.need_path("the export file")
        super().validate()


class ExportSource(MoistureSource):
    """Export file that is watched.

    One CSV or XLSX file, which need not exist yet.
    """

    NAME = "export"
    SETTINGS = ExportSettings
    SIMULATOR = "finger_driver.simulators.export:ExportFileSimulator"

    settings: ExportSettings

    def __init__(self, settings: ExportSettings) -> None:
        super().__init__(settings)
        self._path = Path(settings.path)
        self._rows: tuple[Row, ...] | None = None
        self._seen: tuple[int, int, int] | None = None
        self._parsed: tuple[int, int, int] | None = None
        self._ready: deque[tuple[int, Row]] = deque()
        self._next_check = 0.0

    def connect(self) -> None:
        if not self._path.parent.is_dir():
            raise DeviceError(f"{self._path.parent}: no such folder; correct 'path'")
        self.health.hardware_id = str(self._path)
        if self._rows is None:
            # Only at the first connection: what is added during a disturbance is new.
            self._seen = self._settled()
            if self._seen is None:
                self._rows = ()
            else:
                self._check(self._seen)

    def _settled(self) -> tuple[int, int, int] | None:
        """The state of the file once nobody writes it, or after a while."""
        state, end = self._state(), time.monotonic() + _SETTLING
        while time.monotonic() < end:
            time.sleep(0.2)
            before, state = state, self._state()
            if state == before:
                break
        return state

    def flush(self) -> None:
        self._ready.clear()

    def close(self) -> None:
        """Nothing is held open."""

    def read(self, timeout: float = 1.0) -> Reading | None:
        end = time.monotonic() + timeout
        while not self._ready:
            now = time.monotonic()
            if now < self._next_check:
                if now >= end:
                    return None
                time.sleep(max(0.0, min(end, self._next_check) - now))
                continue
            self._next_check = now + self.settings.export_period
            state = self._state()
            if state == self._seen and state != self._parsed:
                self._check(state)
            self._seen = state
        stamp, row = self._ready.popleft()
        return self.reading(stamp, row.value, PHASES.get(row.phase, PHASE_UNKNOWN))

    def _state(self) -> tuple[int, int, int] | None:
        """What changes when the file does; None while it is absent."""
        try:
            info = self._path.stat()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise DeviceError(f"{self._path}: {error.strerror}; check path and rights") from None
        return (info.st_mtime_ns, info.st_size, info.st_ino)

    def _check(self, state: tuple[int, int, int] | None) -> None:
        """Read the file in this state; its new rows become readings."""
        if state is None:
            return
        try:
            with self._path.open("rb") as file:
                data = file.read(MAX_BYTES + 1)
        except OSError as error:
            self.note(
                "unreadable", f"{self._path}: cannot be read ({error.strerror}); close it elsewhere"
            )
            return
        self._parsed = state
        try:
            rows, malformed = parse_table(data, self._path.name, self.settings)
        except DeviceError as error:
            self.note("malformed", one_line(error), ERROR)
            return
        self.cleared("unreadable")
        self.note_if(
            malformed.rows > 0,
            "malformed",
            f"{self._path.name}: {malformed.rows} of {len(rows) + malformed.rows} rows cannot be "
            f"read; in the first of them {malformed.first}",
        )
        if self._rows is None:
            # Its rows were there before anybody listened, however long it could not be read.
            self._rows = rows
            return
        old = self._rows
        if rows[: len(old)] != old:
            self.health.count("rewritten")
        self._rows = rows
        fresh, in_doubt = new_rows(old, rows)
        self.note_if(
            in_doubt,
            "in_doubt",
            f"{self._path.name}: rows equal to earlier ones are taken for these, but others are "
            "gone; set export_time_column, or append to the table",
        )
        stamped = [
            (self._host_time(state[0] + number if row.time_ns is None else row.time_ns), row)
            for number, row in enumerate(fresh)
        ]
        self._ready.extend(sorted(stamped, key=lambda pair: pair[0]))

    def _host_time(self, wall_ns: int) -> int:
        """Host time of a wall time. Whole seconds stay whole: it shows that there is no more in
        them."""
        stamp = self.clock.of_wall(wall_ns)
        return stamp if wall_ns % NANOSECONDS else stamp + -stamp % NANOSECONDS
