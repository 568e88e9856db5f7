# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A table of named columns, its units, numbers and times."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from finger_common.errors import InputError, known_names
from finger_common.stamps import NANOSECONDS, check_stamp
from finger_common.units import AREA_UNITS, FORCE_UNITS, LENGTH_UNITS, TIME_UNITS, unit_named

from .cells import (
    TIME_TEXT,
    NoNumber,
    TimeStyle,
    decimal_mark,
    has_date,
    is_clock,
    is_missing,
    is_value,
    number_of,
    stamp_of,
)

EPOCH_SECONDS = 1e8
"""s; a time beyond this (three years) counts from 1970, as computers do."""

DAY_COUNTS = ((25_000.0, 60_000.0, 25_569.0), (700_000.0, 800_000.0, 719_529.0))
"""Days since 1899-12-30 (Excel) and since year 0 (MATLAB): first, last, and that of 1970-01-01."""

DAY_NS = 86_400 * NANOSECONDS
"""ns of a day."""

MOST_ROWS_LOOKED_AT = 200
"""Rows by which it is judged whether a table is one of numbers."""

_UNITS = (FORCE_UNITS, LENGTH_UNITS, AREA_UNITS, TIME_UNITS)


@dataclass(frozen=True)
class Times:
    """Times (n,) in ns, 0 where they are not known (n,).

    absolute: they count from 1970 UTC, else from the recording's start. daily: they are times of
    day, which count from midnight.
    """

    ns: np.ndarray
    absolute: bool
    known: np.ndarray
    daily: bool = False

    @classmethod
    def of(cls, ns: np.ndarray, absolute: bool) -> Times:
        """Times that are all known."""
        return cls(ns, absolute, np.ones(len(ns), bool))

    def at(self, rows: np.ndarray) -> Times:
        """The times of some rows (a mask or indices)."""
        return Times(self.ns[rows], self.absolute, self.known[rows], self.daily)


@dataclass(frozen=True)
class Table:
    """Columns by heading: arrays, or sequences of cells as read; they may differ in length.

    units: a row of units below the headings, where there was one. first_row: number of the first
    row of values, for errors. Columns of one heading have it with " #1", " #2", … behind it.
    problems: what of the file could not be read; notes: what a reader of its data should know.
    parts: names of the file's other parts, where none was named. hint: why a column of it may hold
    no number.
    """

    where: str
    columns: Mapping[str, Sequence[Any] | np.ndarray]
    units: Mapping[str, str] = field(default_factory=dict)
    first_row: int = 1
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()
    hint: str = ""

    @property
    def others(self) -> str:
        """Words that name the other parts of the file; empty without any."""
        if not self.parts:
            return ""
        shown = ", ".join(self.parts[:8]) + (", …" if len(self.parts) > 8 else "")
        return f", or another part as FILE::PART ({shown})"

    def heading(self, name: str, option: str) -> str:
        """The heading that a name means: equal, or equal but for case and a unit at its end.

        Raises InputError that names the option to choose another.
        """
        alike = self.alike(name)
        if len(alike) == 1:
            return alike[0]
        if alike:
            raise InputError(
                f"{self.where}: column '{name}' is there twice; name one of "
                f"{', '.join(map(repr, alike[:4]))} with {option}"
            )
        raise InputError(
            f"{self.where}: column '{name}' does not exist ({known_names(name, self.columns)}); "
            f"name it with {option}{self.others}"
        )

    def alike(self, name: str) -> list[str]:
        """The headings that a name may mean; one where it is equal."""
        if name in self.columns:
            return [name]
        wanted = name.strip().casefold()
        return [h for h in self.columns if wanted in (_bare(h), _unnumbered(h).casefold())]

    def unit(self, heading: str, units: Mapping[str, float]) -> str | None:
        """The unit that a column states: in the row of units, as "Force [N]" or as "force_n"."""
        for text in (self.units.get(heading, ""), *_endings(_unnumbered(heading))):
            found = unit_named(text, units)
            if found is not None:
                return found
        return None

    def numbers(self, heading: str, gaps: bool = False) -> np.ndarray:
        """A column (n,) as floats; gaps: empty cells and NaN are allowed.

        Raises InputError naming row and column, or a column without any number.
        """
        cells = self.columns[heading]
        values = self._floats(heading, cells)
        bad = np.isinf(values) if gaps else ~np.isfinite(values)
        if len(values) and not np.isfinite(values).any() and not np.isinf(values).any():
            raise InputError(
                f"{self.where}: column '{heading}' holds no number; name another one{self.hint}"
                f"{self.others}"
            )
        if bad.any():
            self._refuse(
                heading,
                int(np.flatnonzero(bad)[0]),
                "is no finite number; correct it or leave the row out",
            )
        return values

    def _floats(self, heading: str, cells: Sequence[Any] | np.ndarray) -> np.ndarray:
        if isinstance(cells, np.ndarray) and cells.dtype.kind in "biuf":
            return np.asarray(cells, dtype=float).reshape(-1)
        texts = [cell for cell in cells if isinstance(cell, str)]
        decimal = decimal_mark(texts)
        if decimal == "." and not any("_" in text for text in texts):
            try:
                return np.asarray(cells, dtype=float).reshape(-1)
            except (TypeError, ValueError):
                pass
        values = np.empty(len(cells))
        for row, cell in enumerate(cells):
            try:
                values[row] = number_of(cell, decimal)
            except NoNumber as fault:
                self._refuse(heading, row, str(fault))
        return values

    def times(self, heading: str, unit: str = "") -> Times:
        """A column of times: numbers, or dates with time; rows may be without one.

        unit: of numbers; empty for the one that the heading states, else s.
        """
        cells = self.columns[heading]
        if isinstance(cells, np.ndarray) and cells.dtype.kind in "mM":
            kind = cells.dtype.kind
            known = ~np.isnat(cells)
            # Seconds first: what 64 bits do not hold in ns wraps, or raises by the NumPy.
            name = "datetime" if kind == "M" else "timedelta"
            whole = np.where(known, cells.astype(f"{name}64[s]").astype(np.int64), 0)
            wrong = np.abs(whole.astype(float)) > 9.2e9
            if wrong.any():
                self._refuse(heading, int(np.argmax(wrong)), "is no time; correct it")
            stamps = cells.astype(f"{name}64[ns]")
            ns = np.where(known, stamps.astype(np.int64), 0)
            return self._some(heading, Times(ns, kind == "M", known))
        first = next((cell for cell in cells if not is_missing(cell)), None)
        if is_clock(first):
            known = np.array([not is_missing(cell) for cell in cells])
            style = TimeStyle.of(cells)
            found = [
                self._stamp(heading, row, style) if known[row] else 0 for row in range(len(cells))
            ]
            ns, dated = np.array(found, np.int64), has_date(first)
            if not dated:
                # A time of day that runs back by nearly a day is that of the next one.
                steps = np.diff(ns[known], prepend=ns[known][:1])
                ns[known] += DAY_NS * np.cumsum(steps < -DAY_NS // 2)
            return Times(ns, dated, known, not dated and not style.minutes)
        unit = unit or self._time_unit(heading)
        values = self.numbers(heading, gaps=True)
        known = np.isfinite(values)
        values = np.where(known, values, 0.0)
        start = values[known][0] if known.any() else 0.0
        if unit == "d":
            for low, high, origin in DAY_COUNTS:
                if low <= start <= high:
                    values = np.where(known, values - origin, 0.0)
        seconds = values * TIME_UNITS[unit]
        start = seconds[known][0] if known.any() else 0.0
        if len(seconds) and np.abs(seconds).max() > 9e9:
            row = int(np.argmax(np.abs(seconds) > 9e9))
            self._refuse(heading, row, "is no time in seconds; name its unit with --time-unit")
        ns = np.round(seconds * NANOSECONDS).astype(np.int64)
        return self._some(heading, Times(ns, bool(abs(start) > EPOCH_SECONDS), known))

    def _time_unit(self, heading: str) -> str:
        """The unit that a column of numbers states, s where it states none; raises InputError for
        one that is not known."""
        known = self.unit(heading, TIME_UNITS)
        if known is not None:
            return known
        text = _unnumbered(heading).strip()
        stated = [self.units.get(heading, ""), *(_endings(text) if text[-1:] in ")]）" else ())]
        for unit in filter(str.strip, stated):
            raise InputError(
                f"{self.where}: column '{heading}' has its times in '{unit}', which is not known; "
                f"name the unit with --time-unit: {', '.join(TIME_UNITS)}"
            )
        return "s"

    def _some(self, heading: str, times: Times) -> Times:
        if not times.known.any():
            raise InputError(f"{self.where}: column '{heading}' holds no time; name another one")
        return times

    def _refuse(self, heading: str, row: int, reason: str) -> None:
        cell = self.columns[heading][row]
        text = "an empty cell" if cell is None else repr(str(cell)[:40])
        raise InputError(
            f"{self.where}, row {row + self.first_row}, column '{heading}': {text} {reason}"
        )

    def _stamp(self, heading: str, row: int, style: TimeStyle) -> int:
        stamp = 0
        try:
            stamp = stamp_of(self.columns[heading][row], style)
        except NoNumber as fault:
            self._refuse(heading, row, str(fault))
        except (AttributeError, TypeError, ValueError):
            self._refuse(heading, row, f"is no time as in {TIME_TEXT}; correct it")
        check_stamp(stamp, f"{self.where}, row {row + self.first_row}, column '{heading}'")
        return stamp

    def rows(self, chosen: np.ndarray) -> Table:
        """The table with some rows alone, by their indices (k,); raises InputError for a column
        that is too short."""
        last = int(chosen.max())
        for name, cells in self.columns.items():
            if last >= len(cells):
                raise InputError(
                    f"{self.where}: column '{name}' has {len(cells)} rows, and row {last + 1} is "
                    "needed; give columns of other lengths in a file of their own"
                )
        columns = {
            name: cells[chosen] if isinstance(cells, np.ndarray) else [cells[i] for i in chosen]
            for name, cells in self.columns.items()
        }
        return replace(self, columns=columns, first_row=self.first_row + int(chosen[0]))


def numbered(headings: Sequence[str]) -> list[str]:
    """Headings of which each is there once: " #1", " #2", … behind those of several columns."""
    count, seen = Counter(h for h in headings if h), Counter[str]()
    found = []
    for heading in headings:
        seen[heading] += 1
        found.append(f"{heading} #{seen[heading]}" if count[heading] > 1 else heading)
    return found


def _unnumbered(heading: str) -> str:
    return re.sub(r" #\d+$", "", heading)


def _endings(heading: str) -> list[str]:
    """Texts in a heading that may be its unit: "N" of "Fz [N]", "Fz (N)", "Fz, N", "fz_N"."""
    text = heading.strip().replace("（", "(").replace("）", ")")
    found = []
    for opening, closing in ("[]", "()"):
        if text.endswith(closing) and opening in text:
            found.append(text[text.rindex(opening) + 1 : -1])
    found += [text.rsplit(sign, 1)[1] for sign in "/,_" if sign in text]  # Fz/N
    return found


def _bare(heading: str) -> str:
    """A heading in lower case without a unit in brackets, behind a slash or a comma."""
    text = _unnumbered(heading).strip().casefold().replace("（", "(")
    for sign in "[(/,":
        text = text.split(sign, 1)[0] if not text.startswith(sign) else text
    return text.strip()


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
    if any(is_value(cell) for cell in rows[start][1]):
        header = [str(i) for i in range(1, len(header) + 1)]
    else:
        start += 1
        header = numbered(header)
        below = rows[start][1] if start < len(rows) else ()
        if _are_units(below):
            units = dict(zip(header, map(_bracketless, below)))
            start += 1
    body = _without_footer(rows[start:], wide)
    columns = {
        name: [row[i] if i < len(row) else None for _, row in body]
        for i, name in enumerate(header)
        if name
    }
    return Table(where, columns, units, body[0][0] if body else 1)


def _headings_of_numbers(rows: Sequence[tuple[int, Sequence[Any]]], start: int, wide: int) -> int:
    """The row of headings above the first row of numbers; `start`, the first row as wide as the
    table, where there is none: what a program writes before the headings may be as wide."""
    first = next((i for i in range(start + 1, len(rows)) if _is_numbers(rows[i][1])), len(rows))
    before, after = first - start, rows[first : first + MOST_ROWS_LOOKED_AT]
    # Texts with some numbers, as a table of trials, have their headings first.
    if len(after) < before or sum(_is_numbers(row) for _, row in after) < 0.8 * len(after):
        return start
    above = first - 1 - (before > 1 and _are_units(rows[first - 1][1]))
    texts = [cell for cell in rows[above][1] if not is_missing(cell)]
    fits = _filled(rows[above][1]) >= wide and not any(map(is_value, texts))
    return above if texts and fits else start


def _without_footer(
    rows: Sequence[tuple[int, Sequence[Any]]], wide: int
) -> Sequence[tuple[int, Sequence[Any]]]:
    """The rows without lines of text behind the last numbers, as "End of file"."""
    end = len(rows)
    while end and wide > 1:
        cells = [cell for cell in rows[end - 1][1] if not is_missing(cell)]
        if len(cells) != 1 or is_value(cells[0]):
            break
        end -= 1
    before = rows[max(end - MOST_ROWS_LOOKED_AT, 0) : end]
    numbers = sum(_is_numbers(row) for _, row in before)
    return rows[:end] if before and numbers >= 0.8 * len(before) else rows


def _is_numbers(row: Sequence[Any]) -> bool:
    cells = [cell for cell in row if not is_missing(cell)]
    return bool(cells) and all(map(is_value, cells))


def _are_units(row: Sequence[Any]) -> bool:
    """Whether a row below the headings states units. A first row of values may hold a unit too, as
    the option of a table of trials."""
    stated = [text for text in map(_bracketless, row) if text]
    named = [any(unit_named(text, known) for known in _UNITS) for text in stated]
    return bool(named) and 2 * sum(named) >= len(named)


def _bracketless(cell: Any) -> str:
    return str(cell or "").strip(" []()")


def _filled(row: Sequence[Any]) -> int:
    """Cells of a row up to the last one that is not empty."""
    return max((i for i, c in enumerate(row, 1) if c is not None and str(c).strip()), default=0)
