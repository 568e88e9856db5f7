# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables that hold several recordings, told apart by columns: one recording after the other."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from finger_common.errors import InputError, listed
from finger_common.stamps import nanoseconds

from ..force_history import LONGEST
from .cells import is_missing
from .series import FORCE, times_of
from .settings import ImportSettings
from .tables import Table, read_table

Key = tuple[str, ...]
"""Texts of the grouping columns."""

WHOLE_CONTACT = 3
"""Areas above zero, one after the other, that show a press in rows without a label."""

MOST_RECORDINGS = 10_000
"""Recordings of one table; more are values of a column that tells rows apart."""


@dataclasses.dataclass(frozen=True)
class Part:
    """One recording of tables that hold several: what tells it apart, in words; its settings; its
    tables by their files; the rows of the force that one clock counts before it, None without."""

    words: str
    settings: ImportSettings
    tables: dict[str, Table]
    before: Table | None = None


def recordings(settings: ImportSettings) -> Iterator[Part]:
    """The recordings of the tables; one without words where no column is named. Raises
    InputError."""
    grouping = settings.grouping
    if not grouping:
        yield Part("", settings, {})
        return
    names = dict.fromkeys(n for n in (settings.force, settings.area, settings.indentation) if n)
    tables = {name: read_table(name) for name in names}
    rows, notes = {}, {}
    for name, table in tables.items():
        rows[name], left = _rows(table, grouping)
        notes[name] = _left_out(table, left, grouping, settings if name == settings.area else None)
    keys = rows[settings.force]
    if len(keys) > MOST_RECORDINGS:
        raise InputError(
            f"{settings.force}: {len(keys)} recordings, {MOST_RECORDINGS} at most are read; name "
            "a column with one value for each of them"
        )
    for name in tables:
        for key in rows[name]:
            if key not in keys:
                words = _words(grouping, key)
                raise InputError(f"{settings.force}: has no row with {words}, as {name} has")
    force = tables[settings.force]
    begins = _continuous(settings, force)
    for key in keys:
        about = dict(zip(grouping, key))
        words = _words(grouping, key)
        changed: dict[str, Any] = {name: "" for name in grouping}
        for name in ("subject", "condition"):
            if f"{name}_column" in about:
                changed[name] = about[f"{name}_column"]
        chosen = {}
        for name, table in tables.items():
            if key not in rows[name]:
                raise InputError(f"{table.where}: has no row with {words}, as {settings.force} has")
            part = table.rows(np.array(rows[name][key]))
            # What is said of the whole table is said once.
            chosen[name] = dataclasses.replace(part, notes=notes.pop(name, ()))
        first = keys[key][0]
        before = force.rows(np.arange(begins[first], first)) if begins[first] < first else None
        try:
            yield Part(words, dataclasses.replace(settings, **changed), chosen, before)
        except InputError as error:
            raise InputError(f"{settings.force}, {words}: {error}") from None


def _continuous(settings: ImportSettings, table: Table) -> np.ndarray:
    """For each row (n,) of the force, the first one of its subject from which on one clock counts
    without a step back, `force_history.LONGEST` at most before."""
    length = min(map(len, table.columns.values()))
    rows = np.arange(length)
    if settings.force_rate:
        return rows
    ns = times_of(FORCE, settings, table, "")[1].ns[:length]
    parted = np.diff(ns, prepend=ns[:1]) <= 0
    if settings.subject_column:
        cells = table.columns[table.heading(settings.subject_column, "--subject-column")]
        subjects = np.array([cell_text(cell) for cell in cells[:length]])
        parted[1:] |= subjects[1:] != subjects[:-1]
    begins = np.maximum.accumulate(np.where(parted, rows, 0))
    for part in np.split(rows, np.flatnonzero(parted[1:]) + 1):
        own = ns[part]
        begins[part] += np.searchsorted(own, own - nanoseconds(LONGEST))
    return begins


def _words(grouping: dict[str, str], key: Key) -> str:
    return ", ".join(f"{column} {value}" for column, value in zip(grouping.values(), key))


def _headings(table: Table, grouping: dict[str, str]) -> list[str]:
    return [
        table.heading(column, f"--{option.replace('_', '-')}")
        for option, column in grouping.items()
    ]


def _rows(table: Table, grouping: dict[str, str]) -> tuple[dict[Key, list[int]], np.ndarray]:
    """Rows of each combination of values, in the order in which these come; and the rows (k,)
    without one of the values, which belong to none."""
    columns = [table.columns[heading] for heading in _headings(table, grouping)]
    found: dict[Key, list[int]] = {}
    left = []
    for row in range(min(map(len, columns))):
        cells = [column[row] for column in columns]
        if any(map(_is_empty, cells)):
            left.append(row)
        else:
            found.setdefault(tuple(map(cell_text, cells)), []).append(row)
    return found, np.array(left, dtype=int)


def _is_empty(cell: Any) -> bool:
    """Whether a cell holds no label. NA, none and nat may be labels: of natural skin, or a code."""
    return cell is None or cell != cell or cell_text(cell).casefold() in ("", "nan")


def _left_out(
    table: Table, left: np.ndarray, grouping: dict[str, str], settings: ImportSettings | None
) -> tuple[str, ...]:
    """What to say of rows (k,) without a label; settings: of a table with areas.

    Raises InputError where their areas show a press.
    """
    headings = _headings(table, grouping)
    others = [cells for heading, cells in table.columns.items() if heading not in headings]
    held = [r for r in left if any(r < len(c) and not _is_missing(c[r]) for c in others)]
    if not held:
        return ()
    rows = np.array(held)
    where = _ranges(rows + table.first_row)
    empty = next(h for h in headings if any(_is_empty(table.columns[h][r]) for r in rows))
    if settings is not None:
        areas = table.numbers(table.heading(settings.area_column, "--area-column"), gaps=True)
        seen = rows[(rows < len(areas)) & np.isfinite(areas[np.minimum(rows, len(areas) - 1)])]
        touched = np.append(np.pad(areas[seen] > 0, 1), False).astype(int)
        steps = np.flatnonzero(np.diff(touched))
        if np.diff(steps.reshape(-1, 2)).max(initial=0) >= WHOLE_CONTACT:
            raise InputError(
                f"{table.where}: column '{empty}' is empty in {len(rows)} rows with values, which "
                f"hold a press ({where}); fill it in, or delete these rows"
            )
    return (
        f"{table.where}: {len(rows)} rows with values have nothing in column '{empty}', left out "
        f"({where})",
    )


def _is_missing(cell: Any) -> bool:
    return is_missing(cell) or cell != cell


def _ranges(rows: Sequence[int] | np.ndarray) -> str:
    """Numbers (k,) of rows in words."""
    parts = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    shown = [f"{p[0]} to {p[-1]}" if len(p) > 1 else f"{p[0]}" for p in parts]
    return f"row{'s' * (len(rows) > 1)} {listed(shown, 5)}"


def cell_text(cell: object) -> str:
    """Text of a cell; whole numbers of spreadsheets without '.0'."""
    if cell is None or (isinstance(cell, float) and np.isnan(cell)):
        return ""
    if isinstance(cell, (float, np.floating)) and float(cell).is_integer():
        cell = int(cell)
    return str(cell).strip()
