# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A moisture program's export: a table that grows with each reading.

Models: CSV with decimal comma, XLSX, appending, and rewriting in place as a spreadsheet saves;
faults (FAULTS). Does not model: any maker's own layout (none is public), files locked by another
program, network drives.
"""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from finger_common.errors import InputError
from finger_common.files import make_folder
from finger_common.settings import Settings, setting

from .simulator import Simulator
from .values import numbers

FAULTS = {
    "half_row": "writes the first half of a row, the rest a tenth of a second later",
    "rewrite": "empties the file and writes all rows again, with a pause of a tenth of a second",
    "wrong_header": "gives the value column another name",
    "garbage": "writes bytes that are not text",
}
HEADER = ("time", "value", "phase")


@dataclass(frozen=True)
class ExportOptions(Settings):
    """Options of the simulated export."""

    path: str = setting("", "File to write, .csv or .xlsx.")
    encoding: str = setting("utf-8", "Encoding of a CSV file.")
    values: str = setting("", "Readings to write in turn, repeatedly, separated by commas.")
    period: float = setting(5.0, "Time between readings.", unit="s", minimum=0.01)


class ExportFileSimulator(Simulator):
    """Export file of a moisture program.

    CSV (`;`, decimal comma) or, by its suffix, XLSX.
    """

    NAME = "export"
    SETTINGS = ExportOptions
    POSITIONAL = "path"
    FAULTS = FAULTS

    def __init__(self, settings: ExportOptions) -> None:
        super().__init__()
        self.path = Path(settings.path)
        self._encoding = settings.encoding
        self._values = numbers(settings.values, "--values")
        self._period = settings.period
        self._rows: list[tuple[datetime.datetime, float, str]] = []
        try:
            make_folder(self.path.parent)
            self._write_all()
        except (OSError, LookupError) as error:
            detail = getattr(error, "strerror", None) or error
            raise InputError(
                f"{self.path}: cannot be written ({detail}); choose another file or encoding"
            ) from None

    def describe(self) -> str:
        return f"in {self.path}"

    def commands(self) -> dict[str, Callable[..., None]]:
        return {"send": lambda value, phase="before": self.send(float(value), phase)}

    def run(self) -> None:
        for number in self.each(lambda: self._period if self._values else 0.0):
            self.send(self._values[number % len(self._values)])

    def send(self, value: float, phase: str = "before") -> None:
        """Add a reading of this moment; phase is "before", "after" or ""."""
        now = datetime.datetime.now().replace(microsecond=0)
        self._rows.append((now, value, phase))
        if self.path.suffix.lower() == ".xlsx":
            self._write_all()
        elif self.faults.take("garbage"):
            self.path.write_bytes(bytes(range(128, 256)) * 10 + b"\n")
        elif self.faults.take("wrong_header"):
            self._write_all(("time", "wert", "phase"))
        elif self.faults.take("rewrite"):
            self._write_all(pause=0.1)
        else:
            self._append(self._line(self._rows[-1]))

    def _line(self, row: tuple[datetime.datetime, float, str]) -> str:
        value = f"{row[1]:.1f}".replace(".", ",")
        return f"{row[0]:%Y-%m-%d %H:%M:%S};{value};{row[2]}\n"

    def _append(self, line: str) -> None:
        half = len(line) // 2 if self.faults.take("half_row") else 0
        with self.path.open("a", encoding=self._encoding) as file:
            file.write(line[:half])
            file.flush()
            time.sleep(0.1 if half else 0.0)
            file.write(line[half:])

    def _write_all(self, header: tuple[str, ...] = HEADER, pause: float = 0.0) -> None:
        if self.path.suffix.lower() == ".xlsx":
            import openpyxl

            book = openpyxl.Workbook()
            for row in (header, *self._rows):
                book.active.append(row)
            book.save(self.path)
            return
        lines = [";".join(header) + "\n", *map(self._line, self._rows)]
        half = len(lines) // 2
        with self.path.open("w", encoding=self._encoding) as file:
            file.writelines(lines[:half])
            file.flush()
            time.sleep(pause)
            file.writelines(lines[half:])
