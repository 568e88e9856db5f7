"""A moisture program's export: a table that grows with each reading.

Models: CSV with decimal comma and any encoding, XLSX, appending and rewriting in place (as a spreadsheet saves),
faults (FAULTS). Does not model: any maker's own layout (none is public), files locked by another program, network
drives.
"""

from __future__ import annotations

import datetime
import time
from pathlib import Path

from finger_common.errors import InputError

from .faults import Faults

FAULTS = {
    "half_row": "writes the first half of a row, the rest a tenth of a second later",
    "rewrite": "empties the file and writes all rows again, with a tenth of a second in the middle",
    "wrong_header": "names the value column otherwise",
    "garbage": "writes bytes that are neither",
}
HEADER = ("time", "value", "phase")


class ExportFileSimulator:
    """Writes readings to `path`: CSV (`;`, decimal comma) or, when it ends so, XLSX."""

    def __init__(self, path: str | Path, encoding: str = "utf-8") -> None:
        self.faults = Faults(FAULTS)
        self.path = Path(path)
        self._encoding = encoding
        self._rows: list[tuple[datetime.datetime, float, str]] = []
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._write_all()
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from None

    def send(self, value: float, phase: str = "before") -> None:
        """Add a reading taken now."""
        now = datetime.datetime.now().replace(microsecond=0)
        self._rows.append((now, value, phase))
        if self.path.suffix.lower() == ".xlsx":
            self._write_all()
            return
        if self.faults.take("garbage"):
            self.path.write_bytes(bytes(range(128, 256)) * 10 + b"\n")
        elif self.faults.take("wrong_header"):
            self._write_all(header=("time", "wert", "phase"))
        elif self.faults.take("rewrite"):
            self._write_all(pause=0.1)
        else:
            self._append(self._line(self._rows[-1]))

    def _line(self, row: tuple[datetime.datetime, float, str]) -> str:
        value = f"{row[1]:.1f}".replace(".", ",")
        return f"{row[0]:%Y-%m-%d %H:%M:%S};{value};{row[2]}\n"

    def _append(self, line: str) -> None:
        data = line.encode(self._encoding)
        with self.path.open("ab") as file:
            if self.faults.take("half_row"):
                file.write(data[: len(data) // 2])
                file.flush()
                time.sleep(0.1)
                data = data[len(data) // 2 :]
            file.write(data)

    def _write_all(self, header: tuple[str, ...] = HEADER, pause: float = 0.0) -> None:
        if self.path.suffix.lower() == ".xlsx":
            self._write_xlsx(header)
            return
        lines = [";".join(header) + "\n", *(self._line(row) for row in self._rows)]
        half = len(lines) // 2
        with self.path.open("wb") as file:
            file.write("".join(lines[:half]).encode(self._encoding))
            file.flush()
            time.sleep(pause)
            file.write("".join(lines[half:]).encode(self._encoding))

    def _write_xlsx(self, header: tuple[str, ...]) -> None:
        import openpyxl

        book = openpyxl.Workbook()
        book.active.append(header)
        for row in self._rows:
            book.active.append(row)
        book.save(self.path)
