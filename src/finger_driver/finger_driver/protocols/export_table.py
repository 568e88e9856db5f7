# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Readings in a table that the moisture probe's program exports: CSV or XLSX.

No public format of the maker's program is known, so columns, decimal comma, encoding and time
format are settings.
"""

from __future__ import annotations

import csv
import datetime
import io
import math
import zipfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from finger_common.errors import DeviceError, InputError
from finger_common.settings import Settings, setting

MAX_BYTES = 20_000_000
"""Size of a file beyond which it is refused."""
MAX_UNPACKED = 40_000_000
"""Bytes that an XLSX file may unpack to."""

_SHOWN = 40
"""Characters of a cell that are shown where it cannot be read."""

_OLE = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
"""Begin of an XLS file (MS-CFB)."""

_MAX_ROWS, _MAX_COLUMNS, _SHEET_ROWS = 100_000, 50, 1_048_576


@dataclass(frozen=True)
class TableFormat(Settings):
    """How the table is written; columns are named by their headings."""

    export_value_column: str = setting("value", "export: heading of the readings' column.")
    export_time_column: str = setting(
        "", "export: heading of the column with the time of the reading; empty for the file's time."
    )
    export_time_format: str = setting(
        "%Y-%m-%d %H:%M:%S", "export: format of that time, local time."
    )
    export_phase_column: str = setting(
        "", "export: heading of a column that holds before or after; or empty."
    )
    export_delimiter: str = setting(";", "export: character between the columns of a CSV file.")
    export_decimal_comma: bool = setting(True, "export: numbers are written 42,0 instead of 42.0.")
    export_encoding: str = setting("utf-8-sig", "export: encoding of a CSV file, such as cp1252.")
    export_sheet: str = setting("", "export: sheet of an XLSX file; empty for the first.")

    def validate(self) -> None:
        try:
            "".encode(self.export_encoding)
        except LookupError:
            raise InputError(
                f"export_encoding '{self.export_encoding}' is not known; try utf-8-sig, utf-16 or "
                "cp1252"
            ) from None
        if len(self.export_delimiter) != 1:
            raise InputError(f"export_delimiter '{self.export_delimiter}' must be one character")
        if not self.export_value_column:
            raise InputError("export_value_column is empty; name the column of the readings")


@dataclass(frozen=True)
class Row:
    """One reading. time_ns None where the table has no time."""

    value: float
    time_ns: int | None = None
    phase: str = ""


@dataclass(frozen=True)
class Unreadable:
    """Rows that hold a value or a time that is none: their number, and what is wrong in the first
    one."""

    rows: int = 0
    first: str = ""


class _BadCell(Exception):
    """A cell that cannot be read; says which, what stands there and how it would be read."""


def parse_table(data: bytes, name: str, form: TableFormat) -> tuple[tuple[Row, ...], Unreadable]:
    """Readings of an export in its order, and the rows that hold a value or time that is none.

    XLSX when `name` ends so, else CSV. Rows without a value are passed over. Raises DeviceError
    when the file as a whole cannot be read, is XLS or lacks a column.
    """
    if len(data) > MAX_BYTES:
        raise DeviceError(f"{name} is larger than {MAX_BYTES // 1_000_000} MB; export less at once")
    read = _xlsx if name.lower().endswith(".xlsx") else _csv
    lines = [
        [c.strip() if isinstance(c, str) else c for c in row] for row in read(data, name, form)
    ]
    start = next((i for i, row in enumerate(lines) if form.export_value_column in row), None)
    if start is None:
        raise DeviceError(
            f"{name} has no column '{form.export_value_column}'; set export_value_column"
        )
    header = lines[start]
    for key, column in (("time", form.export_time_column), ("phase", form.export_phase_column)):
        if column and column not in header:
            raise DeviceError(f"{name} has no column '{column}'; set export_{key}_column")
    rows, malformed, first = [], 0, ""
    for line in lines[start + 1 :]:
        cells = dict(zip(header, line))
        if cells.get(form.export_value_column) in ("", None):
            continue
        try:
            rows.append(_row(cells, form))
        except _BadCell as error:
            malformed, first = malformed + 1, first or str(error)
    return tuple(rows), Unreadable(malformed, first)


def _row(cells: dict[Any, Any], form: TableFormat) -> Row:
    """A row as a reading; raises _BadCell."""
    time_ns = None
    column, needed = form.export_value_column, "a number"
    if form.export_decimal_comma:
        needed += " with a decimal comma or point"
    try:
        value = _number(cells[column], form)
        if form.export_time_column:
            column = form.export_time_column
            needed = f"a time of the form '{form.export_time_format}'; set export_time_format"
            time_ns = _time_ns(cells.get(column), form)
    except (ValueError, TypeError, OverflowError, OSError):
        cell = cells.get(column)
        shown = "" if cell is None else str(cell)[:_SHOWN]
        raise _BadCell(f"column '{column}' has '{shown}', which is not {needed}") from None
    return Row(value, time_ns, str(cells.get(form.export_phase_column) or "").lower())


def _number(cell: Any, form: TableFormat) -> float:
    if isinstance(cell, str) and form.export_decimal_comma and "," in cell:
        cell = cell.replace(".", "").replace(",", ".")
    if isinstance(cell, bool) or not math.isfinite(value := float(cell)):
        raise ValueError("not a finite number")
    return value


def _time_ns(cell: Any, form: TableFormat) -> int:
    if isinstance(cell, str):
        cell = datetime.datetime.strptime(cell, form.export_time_format)
    if not isinstance(cell, datetime.datetime):
        raise ValueError("not a time")
    # A time without a zone is local time.
    return round(cell.timestamp() * 1e6) * 1000


def _csv(data: bytes, name: str, form: TableFormat) -> list[list[Any]]:
    if data.startswith(_OLE) or name.lower().endswith(".xls"):
        raise DeviceError(f"{name} is an XLS table, which is not read; save it as XLSX or CSV")
    try:
        text = data.decode(form.export_encoding)
    except UnicodeError:
        raise DeviceError(
            f"{name} is not {form.export_encoding} text; set export_encoding, for example cp1252"
        ) from None
    try:
        return list(csv.reader(io.StringIO(text, newline=""), delimiter=form.export_delimiter))
    except (csv.Error, ValueError) as error:
        raise DeviceError(f"{name} is not a CSV file ({error}); check export_delimiter") from None


def _xlsx(data: bytes, name: str, form: TableFormat) -> list[list[Any]]:
    import openpyxl

    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(member.file_size for member in archive.infolist()) > MAX_UNPACKED:
                raise ValueError("it unpacks to more than any export")
        book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        sheet = book[form.export_sheet] if form.export_sheet else book.worksheets[0]
        # Programs state the size of their sheets wrongly; what is beyond it would be left out.
        sheet.reset_dimensions()
        lines = []
        rows = sheet.iter_rows(max_col=_MAX_COLUMNS, values_only=True)
        for number, cells in enumerate(rows, 1):
            if any(cell is not None for cell in cells):
                lines.append(list(cells))
            if len(lines) > _MAX_ROWS or number > _SHEET_ROWS:
                raise ValueError("it has more rows than any export")
        return lines
    except Exception as error:
        # A damaged archive makes openpyxl raise almost anything.
        raise DeviceError(f"{name} is not a readable XLSX file ({type(error).__name__})") from None


def new_rows(old: Sequence[Row], now: Sequence[Row]) -> tuple[list[Row], bool]:
    """Rows of a table that were not there before, in their order, and whether that is in doubt.

    They are those that occur more often in `now` than in `old`, the last ones of each. Without
    times, a table that begins otherwise and is not longer is another one, whose rows are all new;
    and in doubt is one in which some rows equal old ones, while other old ones are gone.
    """
    timed = all(row.time_ns is not None for row in now)
    if old and not timed and now[0] != old[0] and len(now) <= len(old):
        return list(now), False
    seen = Counter(old)
    fresh = []
    for row in now:
        if seen[row]:
            seen[row] -= 1
        else:
            fresh.append(row)
    gone = sum(seen.values())
    return fresh, bool(fresh) and not timed and 0 < gone < len(old)
