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
import re
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from finger_common.errors import InputError, known_names
from finger_common.files import MAXIMUM_FILE, bounded_memory, exists, read_bytes

from .array_files import no_part, read_hdf5, read_matlab, read_npy, read_npz
from .cells import is_missing, is_value
from .table import Table, Times, of_rows
from .xdf import read_xdf_table

__all__ = ["READERS", "Table", "Times", "of_rows", "read_table"]

FREE_VALUES, VALUES_PER_BYTE = 4_000_000, 4
"""Values that any table may hold, and further ones for each byte of its file."""

FREE_CELLS, CELLS_PER_BYTE = 200_000, 0.5
"""The same for cells of a workbook, which take at least five bytes of its archive."""

MAXIMUM_ROWS = 1_048_576
"""Rows of a sheet, Excel's own limit."""

FREE_UNPACKED, UNPACKED_PER_BYTE = 10_000_000, 20
"""Bytes that a workbook may unpack to, and further ones for each of its own."""

FORMULAS = (
    "; where it holds formulas, open the workbook in a spreadsheet program and save it, so that "
    "their values are stored"
)
"""Why a column of a workbook may be empty: only formulas were written."""


def read_table(name: str) -> Table:
    """The table in FILE or FILE::PART; raises InputError naming it."""
    file, _, part = name.partition("::")
    path = Path(file)
    if not exists(path):
        raise InputError(f"{file}: no such file; check the path")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        known = ", ".join(READERS)
        remedy = f"give a file of one of {known}"
        if path.suffix.lower() in OTHER_WORKBOOKS:
            remedy = "save it as .xlsx or .csv"
        elif path.suffix.lower() in PACKED:
            remedy = "unpack it"
        raise InputError(f"{file}: no table of a known kind; {remedy}")
    size = path.stat().st_size
    with bounded_memory(path):
        table = reader(path, part)
        if sum(map(len, table.columns.values())) > FREE_VALUES + VALUES_PER_BYTE * size:
            raise InputError(f"{file}: holds more values than {size} bytes explain; not read")
    if not table.columns or not len(next(iter(table.columns.values()))):
        raise InputError(f"{name}: holds no row of values; export it again{table.others}")
    return table


def _read_text(path: Path, part: str) -> Table:
    no_part(path, part)
    content = read_bytes(path, "table", MAXIMUM_FILE)
    rows = _text_rows(_decoded(content, str(path)), str(path))
    _check_commas(str(path), rows)
    return of_rows(str(path), rows)


def _check_commas(where: str, rows: list[tuple[int, list[Any]]]) -> None:
    """Refuse decimal commas between commas: each number gives two cells, each heading one."""
    widths = Counter(len(row) for _, row in rows[1:201])
    usual = widths.most_common(1)[0][0] if widths else 0
    number, first = rows[0] if rows else (0, [])
    if len(first) > 1 and usual == 2 * len(first) and not any(map(is_value, first)):
        raise InputError(
            f"{where}, row {number}: {len(first)} headings above rows of {usual} cells; the comma "
            "seems to be decimal mark and separator at once, export with semicolons"
        )


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
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    comments = [line for line in lines if line[1].lstrip().startswith("#")]
    lines = [line for line in lines if not line[1].lstrip().startswith("#")]
    sample = [line for _, line in lines[:200]]

    def regular(delimiter: str) -> int:
        counts = Counter(line.count(delimiter) for line in sample)
        counts.pop(0, None)
        return max(counts.values(), default=0)

    # A comma may be the decimal one: it counts last. Blanks separate where nothing else does.
    delimiter = next((d for d in ";\t|," if 2 * regular(d) >= len(sample)), "")
    if not delimiter and 2 * sum(len(_words(line)) > 1 for line in sample) < len(sample):
        delimiter = ","
    if delimiter:
        rows = csv.reader(
            io.StringIO("\n".join(line for _, line in lines)),
            delimiter=delimiter,
            skipinitialspace=True,
        )
        try:
            cells = [[cell.strip() for cell in row] for row in rows]
        except csv.Error as error:
            raise InputError(f"{where}: cannot be read as CSV ({error}); export it again") from None
    else:
        cells = [_words(line) for _, line in lines]
    numbers = [n for n, _ in lines] if len(cells) == len(lines) else list(range(1, len(cells) + 1))
    if comments and cells and lines[0][0] > comments[0][0] and all(map(is_value, cells[0])):
        # NumPy writes the headings as a comment.
        number, line = max(c for c in comments if c[0] < lines[0][0])
        text = line.lstrip("# \t")
        names = [n.strip() for n in text.split(delimiter)] if delimiter else _words(text)
        if len(names) == len(cells[0]) and not any(map(is_value, names)):
            cells.insert(0, names)
            numbers.insert(0, number)
    return [(n, row) for n, row in zip(numbers, cells) if not all(map(is_missing, row))]


def _words(line: str) -> list[str]:
    """Cells between blanks; a unit in brackets belongs to the heading before it."""
    return re.split(r"\s+(?![\[(])", line.strip())


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
    return replace(found, hint=FORMULAS, parts=() if part else tuple(names[1:]))


def _read_parquet(path: Path, part: str) -> Table:
    no_part(path, part)
    try:
        from pyarrow import ArrowException, float64, parquet, types
    except ImportError:
        raise InputError(f"{path}: Parquet needs pyarrow; pip install pyarrow") from None
    try:
        # In this thread alone: under the reader's limit of memory pyarrow's pool can wait for ever.
        with parquet.ParquetFile(path, pre_buffer=False) as file:
            found = file.read(use_threads=False)
        columns = {}
        for name in found.column_names:
            column = found.column(name)
            decimal = types.is_decimal(column.type)
            columns[str(name)] = (column.cast(float64()) if decimal else column).to_numpy()
    except MemoryError:
        raise
    except (ArrowException, OSError, ValueError) as error:
        raise InputError(f"{path}: not a Parquet file that can be read ({error})") from None
    return Table(str(path), columns)


OTHER_WORKBOOKS = (".xls", ".xlsb", ".ods", ".numbers")
"""Workbooks that are not read."""

PACKED = (".gz", ".zip", ".bz2", ".xz", ".zst", ".7z")
"""Endings of packed files, which are not read."""

READERS: dict[str, Callable[[Path, str], Table]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm"), _read_text),
    **dict.fromkeys((".xlsx", ".xlsm"), _read_excel),
    ".parquet": _read_parquet,
    **dict.fromkeys((".h5", ".hdf5"), read_hdf5),
    ".mat": read_matlab,
    ".npz": read_npz,
    ".npy": read_npy,
    ".xdf": read_xdf_table,
}
"""Ending of a file -> what reads it."""
