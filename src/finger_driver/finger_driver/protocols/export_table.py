"""Readings in a table that the moisture probe's program exports: CSV or XLSX.

No public format of the maker's program is known, so columns, decimal comma, encoding and time format are settings.
"""

from __future__ import annotations

import csv
import datetime
import io
import math
import zipfile
from collections import Counter
from dataclasses import dataclass
from typing import Any

from finger_common.errors import DeviceError, InputError

MAX_BYTES = 20_000_000
MAX_ROWS = 100_000


@dataclass(frozen=True)
class TableFormat:
    """How the table is written. Columns are named by their heading; empty time or phase: there is none."""

    value_column: str = "value"
    time_column: str = ""
    phase_column: str = ""
    delimiter: str = ";"
    decimal_comma: bool = True
    encoding: str = "utf-8-sig"
    time_format: str = "%Y-%m-%d %H:%M:%S"
    sheet: str = ""

    def check(self) -> TableFormat:
        """Itself; raises InputError for an encoding, delimiter or column that cannot be."""
        try:
            "".encode(self.encoding)
        except LookupError:
            raise InputError(
                f"export_encoding '{self.encoding}' is not known; try utf-8-sig, utf-16 or cp1252"
            ) from None
        if len(self.delimiter) != 1:
            raise InputError(f"export_delimiter '{self.delimiter}' must be one character")
        if not self.value_column:
            raise InputError("export_value_column is empty; name the column of the readings")
        return self


@dataclass(frozen=True)
class Row:
    """One reading. time_ns None where the table has no time."""

    value: float
    time_ns: int | None = None
    phase: str = ""


@dataclass(frozen=True)
class Table:
    """Readings of a table in its order, and how many rows held none."""

    rows: tuple[Row, ...]
    malformed: int = 0


def parse_table(data: bytes, name: str, form: TableFormat) -> Table:
    """Readings of an export; XLSX when `name` ends so, else CSV.

    Rows without a value are passed over; rows whose value or time cannot be read count as malformed. Raises
    DeviceError when the file as a whole cannot be read or lacks a column.
    """
    if len(data) > MAX_BYTES:
        raise DeviceError(f"{name} is larger than {MAX_BYTES // 1_000_000} MB; export less at once")
    lines = _xlsx(data, name, form) if name.lower().endswith(".xlsx") else _csv(data, name, form)
    header: list[str] | None = None
    rows: list[Row] = []
    malformed = 0
    for cells in lines:
        if header is None:
            if any(str(c).strip() == form.value_column for c in cells):
                header = [str(c).strip() for c in cells]
                columns = _columns(header, name, form)
            continue
        value = _cell(cells, columns["value"])
        if value in ("", None):
            continue
        row = _row(cells, columns, form)
        if row is None:
            malformed += 1
        else:
            rows.append(row)
        if len(rows) + malformed > MAX_ROWS:
            raise DeviceError(f"{name} has more than {MAX_ROWS} rows; export less at once")
    if header is None:
        raise DeviceError(f"{name} has no column '{form.value_column}'; set export_value_column")
    return Table(tuple(rows), malformed)


def _columns(header: list[str], name: str, form: TableFormat) -> dict[str, int]:
    columns = {}
    for key, column in (
        ("value", form.value_column),
        ("time", form.time_column),
        ("phase", form.phase_column),
    ):
        if not column:
            continue
        if column not in header:
            raise DeviceError(f"{name} has no column '{column}'; set export_{key}_column")
        columns[key] = header.index(column)
    return columns


def _cell(cells: list[Any], index: int | None) -> Any:
    if index is None or index >= len(cells):
        return ""
    cell = cells[index]
    return cell.strip() if isinstance(cell, str) else cell


def _row(cells: list[Any], columns: dict[str, int], form: TableFormat) -> Row | None:
    try:
        value = _number(_cell(cells, columns["value"]), form)
        time_ns = _time(_cell(cells, columns.get("time")), form) if "time" in columns else None
    except (ValueError, TypeError, OverflowError, OSError):
        return None
    phase = str(_cell(cells, columns.get("phase")) or "").lower()
    return Row(value, time_ns, phase) if math.isfinite(value) else None


def _number(cell: Any, form: TableFormat) -> float:
    if isinstance(cell, str) and form.decimal_comma:
        cell = cell.replace(".", "").replace(",", ".") if "," in cell else cell
    if isinstance(cell, (bool, datetime.datetime, datetime.time, datetime.date)):
        raise ValueError("not a number")
    return float(cell)


def _time(cell: Any, form: TableFormat) -> int:
    """ns since the epoch; a time without zone is local time."""
    if isinstance(cell, str):
        cell = datetime.datetime.strptime(cell, form.time_format)
    if not isinstance(cell, datetime.datetime):
        raise ValueError("not a time")
    return round(cell.timestamp() * 1e6) * 1000


def _csv(data: bytes, name: str, form: TableFormat) -> list[list[Any]]:
    try:
        text = data.decode(form.encoding)
    except (UnicodeError, ValueError):
        raise DeviceError(
            f"{name} is not {form.encoding} text; set export_encoding, for example cp1252"
        ) from None
    try:
        return list(csv.reader(io.StringIO(text), delimiter=form.delimiter))
    except (csv.Error, ValueError) as error:
        raise DeviceError(f"{name} is not a CSV file ({error}); check export_delimiter") from None


def _xlsx(data: bytes, name: str, form: TableFormat) -> list[list[Any]]:
    try:
        import openpyxl
    except ImportError:
        raise InputError(f"{name}: XLSX needs openpyxl; install it or export CSV") from None
    _check_archive(data, name)
    try:
        book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        sheet = book[form.sheet] if form.sheet else book.worksheets[0]
        rows: list[list[Any]] = []
        for cells in sheet.iter_rows(max_row=MAX_ROWS + 100, max_col=200, values_only=True):
            rows.append(["" if c is None else c for c in cells])
        book.close()
        return rows
    except Exception as error:
        # A damaged archive makes openpyxl raise almost anything.
        raise DeviceError(f"{name} is not a readable XLSX file ({type(error).__name__})") from None


def _check_archive(data: bytes, name: str) -> None:
    """Refuse an archive that swells beyond reason."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
    except Exception:
        raise DeviceError(
            f"{name} is not a readable XLSX file; is it still being written?"
        ) from None
    if size > 20 * MAX_BYTES:
        raise DeviceError(f"{name} unpacks to {size // 1_000_000} MB; export less at once")


def new_rows(old: tuple[Row, ...], now: tuple[Row, ...]) -> list[Row]:
    """Rows that are in `now` and were not in `old`, in their order.

    A table that only grew gives its tail. One that was rewritten gives every row that occurs more often than before.
    """
    if now[: len(old)] == old:
        return list(now[len(old) :])
    seen = Counter(old)
    fresh = []
    for row in now:
        if seen[row]:
            seen[row] -= 1
        else:
            fresh.append(row)
    return fresh
