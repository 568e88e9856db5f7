# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Columns of numbers and times from table files of many kinds.

A reader is a function of a path and a part (sheet, group, dataset; may be empty) that gives a
`Table`; `READERS` finds it by the file's ending.
"""

from __future__ import annotations

import codecs
import csv
import io
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date, datetime, time, timezone
from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.xdf import read_xdf
from finger_common.errors import InputError, known_names
from finger_common.files import (
    MAXIMUM_FILE,
    bounded_memory,
    exists,
    parse_npz,
    read_bytes,
)
from finger_common.stamps import NANOSECONDS, check_stamp
from finger_common.units import AREA_UNITS, FORCE_UNITS, LENGTH_UNITS, TIME_UNITS, unit_named

EPOCH_SECONDS = 1e8
"""s; a time beyond this (three years) counts from 1970, as computers do."""

FREE_VALUES, VALUES_PER_BYTE = 4_000_000, 4
"""Values that any table may hold, and further ones for each byte of its file."""

FREE_CELLS, CELLS_PER_BYTE = 200_000, 0.5
"""The same for cells of a workbook, which take at least five bytes of its archive."""

MOST_ROWS_LOOKED_AT = 200
"""Rows by which it is judged whether a table is one of numbers."""

MAXIMUM_ROWS = 1_048_576
"""Rows of a sheet, Excel's own limit."""

FREE_UNPACKED, UNPACKED_PER_BYTE = 10_000_000, 20
"""Bytes that a workbook may unpack to, and further ones for each of its own."""

MISSING = frozenset({"", "-", "--", "na", "n/a", "#n/a", "#nv", "nan", "null", "none"})
"""What programs write into a cell without a value, in lower case."""

_UNITS = (FORCE_UNITS, LENGTH_UNITS, AREA_UNITS, TIME_UNITS)


@dataclass(frozen=True)
class Times:
    """Times (n,) in ns. absolute: they count from 1970 UTC, else from the recording's start."""

    ns: np.ndarray
    absolute: bool


@dataclass(frozen=True)
class Table:
    """Columns by heading: arrays, or sequences of cells as read; they may differ in length.

    units: a row of units below the headings, where there was one. first_row: number of the first
    row of values, for errors. twice: headings of several columns, none of which is in `columns`.
    problems: what of the file could not be read. parts: names of the file's other parts, where
    none was named.
    """

    where: str
    columns: Mapping[str, Sequence[Any] | np.ndarray]
    units: Mapping[str, str] = field(default_factory=dict)
    first_row: int = 1
    twice: frozenset[str] = frozenset()
    problems: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()

    @property
    def others(self) -> str:
        """Words that name the other parts of the file; empty without any."""
        return f", or another part as FILE::PART ({', '.join(self.parts)})" if self.parts else ""

    def heading(self, name: str, option: str) -> str:
        """The heading that a name means: equal, or equal but for case and a unit at its end.

        Raises InputError that names the option to choose another.
        """
        if name in self.columns:
            return name
        alike = [h for h in self.columns if _bare(h) == name.strip().casefold()]
        if len(alike) == 1:
            return alike[0]
        reason = "is there twice" if alike or name in self.twice else "does not exist"
        raise InputError(
            f"{self.where}: column '{name}' {reason} ({known_names(name, self.columns)}); "
            f"name it with {option}{self.others}"
        )

    def unit(self, heading: str, units: Mapping[str, float]) -> str | None:
        """The unit that a column states: in the row of units, as "Force [N]" or as "force_n"."""
        for text in (self.units.get(heading, ""), *_endings(heading)):
            found = unit_named(text, units)
            if found is not None:
                return found
        return None

    def numbers(self, heading: str, gaps: bool = False) -> np.ndarray:
        """A column (n,) as floats; gaps: empty cells and NaN are allowed.

        Raises InputError naming row and column.
        """
        cells = self.columns[heading]
        try:
            values = np.asarray(cells, dtype=float).reshape(-1)
        except (TypeError, ValueError):
            values = np.array([self._number(heading, row) for row in range(len(cells))])
        bad = np.isinf(values) if gaps else ~np.isfinite(values)
        if bad.any():
            self._refuse(
                heading,
                int(np.flatnonzero(bad)[0]),
                "is no finite number; correct it or leave the row out",
            )
        return values

    def times(self, heading: str, unit: str = "") -> Times:
        """A column of times: numbers, or dates with time.

        unit: of numbers; empty for the one that the heading states, else s.
        """
        cells = self.columns[heading]
        first = cells[0] if len(cells) else None
        if isinstance(cells, np.ndarray) and cells.dtype.kind == "M":
            stamps = cells.astype("datetime64[ns]")
            wrong = stamps.astype(cells.dtype) != cells  # none, or beyond what 64 bits hold
            if wrong.any():
                self._refuse(heading, int(np.argmax(wrong)), "is no time; correct it")
            return Times(stamps.astype(np.int64), True)
        if isinstance(first, (datetime, time)) or (isinstance(first, str) and ":" in first):
            found = [self._date(heading, row) for row in range(len(cells))]
            clock = isinstance(first, time) or (isinstance(first, str) and "-" not in first)
            return Times(np.array(found, np.int64), not clock)
        factor = TIME_UNITS[unit or self.unit(heading, TIME_UNITS) or "s"]
        seconds = self.numbers(heading) * factor
        absolute = bool(len(seconds) and abs(seconds[0]) > EPOCH_SECONDS)
        if len(seconds) and np.abs(seconds).max() > 9e9:
            row = int(np.argmax(np.abs(seconds)))
            self._refuse(heading, row, "is no time in seconds; name its unit with --time-unit")
        return Times(np.round(seconds * NANOSECONDS).astype(np.int64), absolute)

    def _refuse(self, heading: str, row: int, reason: str) -> None:
        raise InputError(
            f"{self.where}, row {row + self.first_row}, column '{heading}': "
            f"{str(self.columns[heading][row])[:40]!r} {reason}"
        )

    def _number(self, heading: str, row: int) -> float:
        cell = self.columns[heading][row]
        if _is_missing(cell):
            return float("nan")
        try:
            return float(cell)
        except (TypeError, ValueError):
            pass
        text = str(cell).strip()
        if text.rfind(",") > text.rfind("."):  # 1.234,5
            text = text.replace(".", "").replace(",", ".")
        else:
            text = text.replace(",", "")
        try:
            return float(text)
        except ValueError:
            self._refuse(heading, row, "is no number; correct it")
            raise

    def _date(self, heading: str, row: int) -> int:
        cell = self.columns[heading][row]
        try:
            if isinstance(cell, str):
                text = cell.strip().replace(",", ".")
                cell = datetime.fromisoformat(text if "-" in text else f"1970-01-01T{text}")
            elif isinstance(cell, time):
                cell = datetime.combine(date(1970, 1, 1), cell)
            if cell.tzinfo is None:
                cell = cell.replace(tzinfo=timezone.utc)
            since = cell - datetime(1970, 1, 1, tzinfo=timezone.utc)
        except (AttributeError, TypeError, ValueError):
            self._refuse(heading, row, "is no time as in 2024-05-01 13:45:10.250; correct it")
        stamp = (since.days * 86400 + since.seconds) * NANOSECONDS + since.microseconds * 1000
        check_stamp(stamp, f"{self.where}, row {row + self.first_row}, column '{heading}'")
        return stamp


def _endings(heading: str) -> list[str]:
    """Texts in a heading that may be its unit: "N" of "Fz [N]", "Fz (N)", "fz_N"."""
    text = heading.strip()
    found = []
    for opening, closing in ("[]", "()"):
        if text.endswith(closing) and opening in text:
            found.append(text[text.rindex(opening) + 1 : -1])
    if "/" in text:  # Fz/N
        found.append(text.rsplit("/", 1)[1])
    if "_" in text:
        found.append(text.rsplit("_", 1)[1])
    return found


def _bare(heading: str) -> str:
    """A heading in lower case without a unit in brackets or behind a slash."""
    text = heading.strip().casefold()
    for sign in "[(/":
        text = text.split(sign, 1)[0] if not text.startswith(sign) else text
    return text.strip()


# Files ---------------------------------------------------------------------------------------


def read_table(name: str) -> Table:
    """The table in FILE or FILE::PART; raises InputError naming it."""
    file, _, part = name.partition("::")
    path = Path(file)
    if not exists(path):
        raise InputError(f"{file}: no such file; check the path")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"{file}: no table of a known kind; give a file of one of {', '.join(READERS)}"
        )
    size = path.stat().st_size
    with bounded_memory(path):
        table = reader(path, part)
        if sum(map(len, table.columns.values())) > FREE_VALUES + VALUES_PER_BYTE * size:
            raise InputError(f"{file}: holds more values than {size} bytes explain; not read")
    if not table.columns or not len(next(iter(table.columns.values()))):
        raise InputError(f"{name}: holds no row of values; export it again{table.others}")
    return table


def _read_text(path: Path, part: str) -> Table:
    _no_part(path, part)
    content = read_bytes(path, "table", MAXIMUM_FILE)
    return of_rows(str(path), _text_rows(_decoded(content, str(path)), str(path)))


def _decoded(content: bytes, where: str) -> str:
    """Text as programs for tables save it: UTF-8, UTF-16 with its mark, else Windows-1252; raises
    InputError for what is no text."""
    marked = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = content.decode("utf-16" if marked else "utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")
    if "\0" in text:
        raise InputError(f"{where}: table is not text; save it as CSV in UTF-8")
    return text


def _text_rows(text: str, where: str) -> list[tuple[int, list[Any]]]:
    """Numbered rows of cells; the delimiter is the one that gives the most regular rows."""
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    sample = [line for _, line in lines[:200]]

    def regular(delimiter: str) -> int:
        counts = Counter(line.count(delimiter) for line in sample)
        counts.pop(0, None)
        return max(counts.values(), default=0)

    # A comma may be the decimal one: it counts last.
    delimiter = next((d for d in ";\t," if 2 * regular(d) >= len(sample)), ",")
    rows = csv.reader(io.StringIO("\n".join(line for _, line in lines)), delimiter=delimiter)
    try:
        cells = [[cell.strip() for cell in row] for row in rows]
    except csv.Error as error:
        raise InputError(f"{where}: cannot be read as CSV ({error}); export it again") from None
    numbers = [n for n, _ in lines] if len(cells) == len(lines) else list(range(1, len(cells) + 1))
    return list(zip(numbers, cells))


def of_rows(where: str, rows: Sequence[tuple[int, Sequence[Any]]]) -> Table:
    """Table of numbered rows of cells: lines of text, then headings, perhaps units, then values.

    Without headings, columns are named "1", "2", ….
    """
    wide = max((_filled(row) for _, row in rows[-1000:]), default=1)
    start = next((i for i, (_, row) in enumerate(rows) if _filled(row) >= wide), len(rows))
    if start == len(rows):
        return Table(where, {})
    start = _headings_of_numbers(rows, start, wide)
    header = [str(cell if cell is not None else "").strip() for cell in rows[start][1]]
    units: dict[str, str] = {}
    if any(_is_value(cell) for cell in rows[start][1]):
        header = [str(i) for i in range(1, len(header) + 1)]
    else:
        start += 1
        below = rows[start][1] if start < len(rows) else ()
        if _are_units(below):
            units = dict(zip(header, map(_bracketless, below)))
            start += 1
    body = rows[start:]
    twice = _twice(header)
    columns = {
        name: [row[i] if i < len(row) else None for _, row in body]
        for i, name in enumerate(header)
        if name and name not in twice
    }
    return Table(where, columns, units, body[0][0] if body else 1, twice)


def _headings_of_numbers(rows: Sequence[tuple[int, Sequence[Any]]], start: int, wide: int) -> int:
    """The row of headings above the first row of numbers; `start`, the first row as wide as the
    table, where there is none: what a program writes before the headings may be as wide."""
    first = next((i for i in range(start + 1, len(rows)) if _is_numbers(rows[i][1])), len(rows))
    before, after = first - start, rows[first : first + MOST_ROWS_LOOKED_AT]
    # Texts with some numbers, as a table of trials, have their headings first.
    if len(after) < before or sum(_is_numbers(row) for _, row in after) < 0.8 * len(after):
        return start
    above = first - 1 - (before > 1 and _are_units(rows[first - 1][1]))
    texts = [cell for cell in rows[above][1] if not _is_missing(cell)]
    fits = _filled(rows[above][1]) >= wide and not any(map(_is_value, texts))
    return above if texts and fits else start


def _is_numbers(row: Sequence[Any]) -> bool:
    cells = [cell for cell in row if not _is_missing(cell)]
    return bool(cells) and all(map(_is_value, cells))


def _are_units(row: Sequence[Any]) -> bool:
    """Whether a row below the headings states units. A first row of values may hold a unit too, as
    the option of a table of trials."""
    stated = [text for text in map(_bracketless, row) if text]
    named = [any(unit_named(text, known) for known in _UNITS) for text in stated]
    return bool(named) and 2 * sum(named) >= len(named)


def _bracketless(cell: Any) -> str:
    return str(cell or "").strip(" []()")


def _is_missing(cell: Any) -> bool:
    return cell is None or (isinstance(cell, str) and cell.strip().casefold() in MISSING)


def _twice(headings: Sequence[str]) -> frozenset[str]:
    return frozenset(name for name, count in Counter(headings).items() if name and count > 1)


def _filled(row: Sequence[Any]) -> int:
    """Cells of a row up to the last one that is not empty."""
    return max((i for i, c in enumerate(row, 1) if c is not None and str(c).strip()), default=0)


def _is_value(cell: Any) -> bool:
    """Whether a cell is a number or a time rather than a heading."""
    if not isinstance(cell, str):
        return cell is not None
    text = cell.strip().replace(",", ".")
    if text[:1].isdigit() and ":" in text:
        return True
    try:
        float(text)
    except ValueError:
        return False
    return True


def _no_part(path: Path, part: str) -> None:
    if part:
        raise InputError(f"{path}::{part}: a file of this kind has no parts; leave out '::{part}'")


def _read_excel(path: Path, part: str) -> Table:
    import openpyxl

    content = read_bytes(path, "workbook")
    size = len(content)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            unpacked = sum(member.file_size for member in archive.infolist())
        if unpacked > FREE_UNPACKED + UNPACKED_PER_BYTE * size:
            raise InputError(f"{path}: {size} bytes unpack to {unpacked}; not read")
        book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        names = book.sheetnames
        if part and part not in names:
            raise InputError(f"{path}: sheet '{part}' does not exist; {known_names(part, names)}")
        sheet = book[part] if part else book.worksheets[0]
        # Programs state the size of their sheets wrongly; what is beyond it would be left out.
        sheet.reset_dimensions()
        rows, left = [], FREE_CELLS + CELLS_PER_BYTE * size
        for number, cells in enumerate(sheet.iter_rows(values_only=True), 1):
            left -= len(cells)
            if left < 0 or number > MAXIMUM_ROWS:
                raise InputError(f"{path}: holds more cells than {size} bytes explain; not read")
            if any(cell is not None for cell in cells):
                rows.append((number, cells))
    except (InputError, MemoryError):
        raise
    except Exception as error:
        # A damaged archive makes openpyxl raise almost anything.
        raise InputError(
            f"{path}: not a workbook that can be read ({type(error).__name__}); save it as .xlsx"
        ) from None
    found = of_rows(f"{path}, sheet {part or names[0]}", rows)
    return found if part else replace(found, parts=tuple(names[1:]))


def _read_parquet(path: Path, part: str) -> Table:
    _no_part(path, part)
    try:
        from pyarrow import ArrowException, parquet
    except ImportError:
        raise InputError(f"{path}: Parquet needs pyarrow; pip install pyarrow") from None
    try:
        # In this thread alone: under the reader's limit of memory pyarrow's pool can wait for ever.
        with parquet.ParquetFile(path, pre_buffer=False) as file:
            found = file.read(use_threads=False)
        columns = {str(n): found.column(n).to_numpy() for n in found.column_names}
    except MemoryError:
        raise
    except (ArrowException, OSError, ValueError) as error:
        raise InputError(f"{path}: not a Parquet file that can be read ({error})") from None
    return Table(str(path), columns)


def _read_npz(path: Path, part: str) -> Table:
    _no_part(path, part)
    arrays = parse_npz(read_bytes(path, "NPZ file"), str(path))
    return _of_arrays(str(path), arrays)


def _read_hdf5(path: Path, part: str) -> Table:
    try:
        import h5py
    except ImportError:
        raise InputError(f"{path}: HDF5 needs h5py; pip install h5py") from None
    where = f"{path}::{part}" if part else str(path)
    try:
        with h5py.File(path, "r") as file:
            names: list[str] = []
            file.visit(names.append)
            key = part.strip("/") or "/"
            if key != "/" and key not in file:
                raise InputError(f"{path}: '{part}' does not exist; {known_names(part, names)}")
            node = file[key]
            members = node.items() if isinstance(node, h5py.Group) else [(key, node)]
            found = {n: v for n, v in members if isinstance(v, h5py.Dataset) and v.shape}
            arrays = {n: v[()] for n, v in found.items()}
    except InputError:
        raise
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(f"{path}: not an HDF5 file that can be read ({error})") from None
    if not arrays:
        raise InputError(
            f"{where}: holds groups only; name one as {path}::GROUP ({', '.join(names[:8])})"
        )
    if len(arrays) == 1:
        only = next(iter(arrays.values()))
        if only.dtype.names:  # a table of records
            arrays = {name: only[name] for name in only.dtype.names}
        elif only.ndim == 2 and min(only.shape) > 1:  # a matrix: columns by number
            arrays = {str(i): column for i, column in enumerate(only.T, 1)}
    return _of_arrays(where, arrays)


def _read_matlab(path: Path, part: str) -> Table:
    content = read_bytes(path, "MATLAB file")
    if content.startswith(b"MATLAB 7.3"):
        return _read_hdf5(path, part)
    from scipy.io import loadmat

    try:
        found = loadmat(io.BytesIO(content), squeeze_me=True, struct_as_record=True)
    except MemoryError:
        raise
    except Exception as error:
        # A damaged file makes loadmat raise almost anything.
        raise InputError(f"{path}: not a MATLAB file that can be read ({error})") from None
    arrays = {name: value for name, value in found.items() if not name.startswith("__")}
    if part:
        if part not in arrays:
            raise InputError(f"{path}: '{part}' does not exist; {known_names(part, arrays)}")
        record = arrays[part]
        if record.dtype.names:
            arrays = {name: record[name].item() for name in record.dtype.names}
        else:
            arrays = {str(i): column for i, column in enumerate(np.atleast_2d(record.T), 1)}
    return _of_arrays(f"{path}::{part}" if part else str(path), arrays)


def _read_xdf(path: Path, part: str) -> Table:
    """A stream by its name or type: `time_s`, and its channels by label or number."""
    file = read_xdf(path)
    if not part:
        numbers = [s for s in file.streams if s.values.dtype.kind in "iuf"]
        if len(numbers) != 1:
            names = ", ".join(s.name for s in file.streams)
            raise InputError(
                f"{path}: holds {len(numbers)} streams of numbers; name one as {path}::STREAM "
                f"({names})"
            )
        part = numbers[0].name
    stream = file.stream(part)
    # All streams count from the same moment: which one that was is known to the second.
    first = min((s.time[0] for s in file.streams if len(s.time)), default=0.0)
    since = np.round((stream.time - first) * NANOSECONDS).astype(np.int64)
    times = since * 1e-9 if file.begun_ns is None else _datetime(since + file.begun_ns)
    headings = [label or str(i) for i, label in enumerate(stream.labels, 1)]
    twice = _twice(["time_s", *headings])
    named = {h: column for h, column in zip(headings, stream.values.T) if h not in twice}
    units = dict(zip(headings, stream.units))
    where = f"{path}::{part}"
    return Table(where, {"time_s": times, **named}, units, twice=twice, problems=file.problems)


def _datetime(stamps_ns: np.ndarray) -> np.ndarray:
    return stamps_ns.astype("datetime64[ns]")


def _of_arrays(where: str, arrays: Mapping[str, Any]) -> Table:
    """Table of the arrays that are columns: one dimension of more than one value."""
    columns = {}
    for name, value in arrays.items():
        array = np.squeeze(np.asarray(value))
        if array.ndim == 1 and array.dtype.kind in "biufSUOM":
            columns[str(name)] = array.astype(str) if array.dtype.kind == "S" else array
    return Table(where, columns)


READERS: dict[str, Callable[[Path, str], Table]] = {
    ".csv": _read_text,
    ".tsv": _read_text,
    ".txt": _read_text,
    ".xlsx": _read_excel,
    ".xlsm": _read_excel,
    ".parquet": _read_parquet,
    ".h5": _read_hdf5,
    ".hdf5": _read_hdf5,
    ".mat": _read_matlab,
    ".npz": _read_npz,
    ".xdf": _read_xdf,
}
"""Ending of a file -> what reads it."""
