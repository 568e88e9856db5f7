"""Moisture readings from an export file that is watched.

The file is read when it has stayed the same for two looks, so that a table just being written is not taken for
whole. Rows that are there at the start are not new. A reading's stamp is its own time where the table has one, else
the file's time of modification: never the time of the look.
"""

from __future__ import annotations

import time
from collections import deque
from pathlib import Path

from finger_common.cli import one_line
from finger_common.diagnostics import ERROR, Health
from finger_common.errors import DeviceError

from ..protocols.export_table import MAX_BYTES, Row, TableFormat, new_rows, parse_table
from .source import PHASES, MoistureSource, Reading, range_flag

_UNENDED = 2.0
"""Seconds to wait for the end of a last line, or of a table that got shorter; some programs never write one."""


class ExportSource(MoistureSource):
    """Watches one CSV or XLSX file, which need not exist yet. period: s between looks."""

    def __init__(
        self, path: str | Path, form: TableFormat, health: Health, period: float = 0.25
    ) -> None:
        super().__init__(health)
        self._path = Path(path)
        self._form = form.check()
        self._is_text = self._path.suffix.lower() != ".xlsx"
        self._period = period
        self._rows: tuple[Row, ...] | None = None
        self._seen: object = None
        self._parsed: object = None
        self._ready: deque[tuple[Row, int]] = deque()
        self._index = 0

    def connect(self) -> None:
        if not self._path.parent.is_dir():
            raise DeviceError(f"{self._path.parent}: no such folder; correct 'path'")
        self.health.hardware_id = str(self._path)
        if self._rows is None:
            # Only at the first connection: what is added during a disturbance is new.
            self._rows = ()
            if self._path.exists():
                self._seen = self._state()
                self._look(announce=False)

    def flush(self) -> None:
        self._ready.clear()

    def close(self) -> None:
        """Nothing is held open."""

    def read(self, timeout: float = 1.0) -> Reading | None:
        end = time.monotonic() + timeout
        while not self._ready:
            state = self._state()
            # Unchanged since the last look, and not yet read as it is now.
            if state is not None and state == self._seen and state != self._parsed:
                self._look(announce=True)
            self._seen = state
            if not self._ready:
                left = end - time.monotonic()
                if left <= 0:
                    return None
                time.sleep(min(left, self._period))
        row, stamp = self._ready.popleft()
        phase = PHASES.get(row.phase, 0)
        reading = Reading(stamp, row.value, self._index, phase, range_flag(row.value), "export")
        self._index += 1
        return reading

    def _state(self) -> tuple[int, int, int] | None:
        """What changes when the file does; None while it is absent."""
        try:
            info = self._path.stat()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise DeviceError(f"{self._path}: {error.strerror}; check path and rights") from None
        return (info.st_mtime_ns, info.st_size, info.st_ino)

    def _look(self, announce: bool) -> None:
        state = self._seen
        try:
            with self._path.open("rb") as file:
                data = file.read(MAX_BYTES + 1)
        except OSError as error:
            self.note(
                "unreadable", f"{self._path}: cannot be read ({error.strerror}); close it elsewhere"
            )
            return
        modified = state[0] * 1e-9 if isinstance(state, tuple) else 0.0
        if self._is_text and not data.endswith(b"\n") and time.time() - modified < _UNENDED:
            return
        self._parsed = state
        try:
            table = parse_table(data, self._path.name, self._form)
        except DeviceError as error:
            self.note("malformed", one_line(error), ERROR)
            return
        for key in ("unreadable", "malformed"):
            self.cleared(key)
        if table.malformed:
            self.note("malformed", f"{self._path.name}: {table.malformed} rows cannot be read")
        old = self._rows or ()
        shrunk = len(table.rows) < len(old) and old[: len(table.rows)] == table.rows
        if shrunk and time.time() - modified < _UNENDED:
            # Most likely being written anew; what was read before would seem new afterwards.
            self._parsed = None
            return
        fresh = new_rows(old, table.rows)
        if table.rows[: len(old)] != old:
            self.health.count("rewritten")
        self._rows = table.rows
        if announce and isinstance(state, tuple):
            stamped = [
                (row, state[0] + number if row.time_ns is None else row.time_ns)
                for number, row in enumerate(fresh)
            ]
            self._ready.extend(sorted(stamped, key=lambda pair: pair[1]))
