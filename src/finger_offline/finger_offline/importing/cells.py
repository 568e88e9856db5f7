# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Numbers and times in the cells of a table, as programs of many countries write them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import date, datetime, time, timedelta, timezone
from typing import Any

from finger_common.stamps import NANOSECONDS

MISSING = frozenset({"", "-", "--", "na", "n/a", "#n/a", "#nv", "nan", "null", "none", "nat"})
"""What programs write into a cell without a value, in lower case."""

TIME_TEXT = "2024-05-01 13:45:10.250 or 01.05.2024 13:45:10,250"
"""Times of a day as they are read, for errors."""

_GROUPED = {  # 1.234, 12.345.678: thousands, or three decimals
    mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:\{mark}\d{{3}})+") for mark in ".,"
}
_WITH_GROUPS = {  # by decimal mark: a number with the other mark between thousands
    decimal: re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:\{mark}\d{{3}})+(?:\{decimal}\d*)?")
    for decimal, mark in ((".", ","), (",", "."))
}
_MINUTES = re.compile(r"\d+:\d{1,2}[.,]\d+")
"""Minutes and seconds: a fraction belongs to seconds."""

_COMPACT = re.compile(r"((?:19|20)\d\d)(\d\d)(\d\d)[_T -]?(\d\d)(\d\d)(\d\d)(?:[.,_](\d+))?")
"""As in names of files: 20240501_134510.250."""

_SLASHED = re.compile(r"(\d{1,2})/(\d{1,2})/(\d{4})(?=\D|$)")
"""A date whose order of day and month is that of its country."""

_NOON = re.compile(r"\s*([ap])\.?m\.?", re.IGNORECASE)

_ZONES = {"UTC": "+00:00", "GMT": "+00:00", "CET": "+01:00", "CEST": "+02:00"}
"""Names of time zones with one meaning."""

_ZONE = re.compile(r"(:\d\d(?:\.\d+)?[+-]\d\d)(\d\d)?$")
"""A time with a difference from UTC that has no colon."""

_DAY_FIRST = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})(?=\D|$)")
_YEAR_FIRST = re.compile(r"(\d{4})[-/](\d{1,2})[-/](\d{1,2})(?=\D|$)")

LARGEST_UNGROUPED = 100.0
"""Numbers from here on without a mark show that others of three decimals may have thousands."""


class NoNumber(ValueError):
    """A text that is no number; the message says what is wrong with it."""


def is_missing(cell: Any) -> bool:
    """Whether a cell holds no value: empty, NaN of a date, or one of `MISSING`."""
    if isinstance(cell, str):
        return cell.strip().casefold() in MISSING
    return cell is None or (hasattr(cell, "isoformat") and cell != cell)


def is_value(cell: Any) -> bool:
    """Whether a cell is a number or a time rather than a heading."""
    if not isinstance(cell, str):
        return cell is not None
    text = cell.strip().replace(",", ".")
    if (text[:1].isdigit() and ":" in text) or _COMPACT.fullmatch(text):
        return True
    try:
        plain_float(text)
    except ValueError:
        return False
    return True


def plain_float(text: str) -> float:
    """A number without the marks between digits that Python knows; raises ValueError."""
    if "_" in text:
        raise ValueError(text)
    return float(text)


def decimal_mark(texts: Iterable[str]) -> str:
    """The decimal mark of a column of numbers; "" where a mark may stand between thousands too."""
    ambiguous, largest = "", 0.0
    for text in texts:
        cell = text.strip()
        point, comma = cell.rfind("."), cell.rfind(",")
        if point >= 0 and comma >= 0:
            return "." if point > comma else ","
        mark = "." if point >= 0 else "," if comma >= 0 else ""
        if not mark:
            try:
                largest = max(largest, abs(plain_float(cell)))
            except ValueError:
                pass
        elif not _GROUPED[mark].fullmatch(cell):
            return mark
        elif cell.count(mark) > 1:
            return "," if mark == "." else "."
        else:
            ambiguous = mark
    # Were these thousands, numbers of four digits would have a mark.
    if LARGEST_UNGROUPED <= largest < 1000.0 and ambiguous:
        return ""
    return ambiguous or "."


def number_of(cell: Any, decimal: str) -> float:
    """A cell as a float, NaN where it is missing; decimal: of `decimal_mark`. Raises NoNumber."""
    if is_missing(cell):
        return float("nan")
    if not isinstance(cell, str):
        try:
            return float(cell)
        except (TypeError, ValueError):
            raise NoNumber("is no number; correct it") from None
    text = cell.strip()
    if not decimal and ("." in text or "," in text):
        raise NoNumber(
            "may have a mark between thousands, or three decimals; export numbers without marks "
            "between thousands"
        )
    other = "," if decimal == "." else "."
    if other in text:
        if not _WITH_GROUPS[decimal or "."].fullmatch(text):
            raise NoNumber(f"is no number with the decimal mark '{decimal}' of this column")
        text = text.replace(other, "")
    try:
        return plain_float(text.replace(",", "."))
    except ValueError:
        raise NoNumber("is no number; correct it") from None


def is_clock(cell: Any) -> bool:
    """Whether a cell is a date with time, or a time of day."""
    if isinstance(cell, str):
        return ":" in cell or bool(_COMPACT.fullmatch(cell.strip()))
    return isinstance(cell, (datetime, time))


def has_date(cell: Any) -> bool:
    """Whether a time has a date."""
    if isinstance(cell, str):
        dates = (_DAY_FIRST, _YEAR_FIRST, _SLASHED, _COMPACT)
        return any(date.match(cell.strip()) for date in dates)
    return not isinstance(cell, time)


@dataclass(frozen=True)
class TimeStyle:
    """How the times of a column are written, where one cell does not tell.

    minutes: with one colon, as minutes and seconds. month_first: of dates between slashes; None
    where no cell tells.
    """

    minutes: bool = False
    month_first: bool | None = None

    @classmethod
    def of(cls, cells: Iterable[Any]) -> TimeStyle:
        """The style of a column."""
        minutes, month_first = False, None
        for cell in cells:
            if not isinstance(cell, str):
                continue
            text = cell.strip()
            minutes = minutes or bool(_MINUTES.fullmatch(text))
            slashed = _SLASHED.match(text)
            if slashed and month_first is None:
                # Countries that write am and pm behind such dates write the month first.
                if int(slashed[1]) > 12:
                    month_first = False
                elif int(slashed[2]) > 12 or _NOON.search(text):
                    month_first = True
        return cls(minutes, month_first)


def stamp_of(cell: Any, style: TimeStyle | None = None) -> int:
    """A date with time, or a time of day, in ns since 1970 or midnight; UTC where it names no time
    zone.

    style: of its column. Raises ValueError for what is none, NoNumber with the reason where a
    reader cannot see it.
    """
    if isinstance(cell, str):
        cell = _datetime_of(cell.strip(), style or TimeStyle.of([cell]))
    elif isinstance(cell, time):
        cell = datetime.combine(date(1970, 1, 1), cell)
    if not isinstance(cell, datetime):
        raise ValueError("no time")
    if cell.tzinfo is None:
        cell = cell.replace(tzinfo=timezone.utc)
    since = cell - datetime(1970, 1, 1, tzinfo=timezone.utc)
    return (since.days * 86400 + since.seconds) * NANOSECONDS + since.microseconds * 1000


def from_iso(text: str) -> datetime:
    """A date with time in ISO 8601, read alike by every Python; ValueError for what is none.

    Python 3.10 itself takes six decimals only, and a difference from UTC with a colon only.
    """
    text = re.sub(r"\.(\d{1,6})\d*", lambda m: "." + m[1].ljust(6, "0"), text)
    text = re.sub(r"[zZ]$", "+00:00", text)
    text = _ZONE.sub(lambda m: f"{m[1]}:{m[2] or '00'}", text)
    return datetime.fromisoformat(text)


def _datetime_of(text: str, style: TimeStyle) -> datetime:
    if style.minutes and text.count(":") == 1:
        minutes, seconds = text.split(":")
        left = plain_float(seconds.replace(",", "."))
        return datetime(1970, 1, 1) + timedelta(minutes=int(minutes), seconds=left)
    text = _COMPACT.sub(_spread, text)
    text = text.replace(",", ".")
    slashed = _SLASHED.match(text)
    if slashed:
        if style.month_first is None:
            raise NoNumber(
                "may have its day or its month first; export dates with the year first, as in "
                "2024-05-01"
            )
        month, day = (slashed[1], slashed[2]) if style.month_first else (slashed[2], slashed[1])
        text = f"{slashed[3]}-{month:0>2}-{day:0>2}{text[slashed.end() :]}"
    text = _DAY_FIRST.sub(lambda m: f"{m[3]}-{m[2]:0>2}-{m[1]:0>2}", text, count=1)
    text = _YEAR_FIRST.sub(lambda m: f"{m[1]}-{m[2]:0>2}-{m[3]:0>2}", text, count=1)
    text = re.sub(r"^(\d{4}-\d\d-\d\d)?[ T]*(\d):", r"\1 0\2:", text).strip()
    # Three digits behind a colon are milliseconds; two may be the number of a frame.
    text = re.sub(r"(:\d\d:\d\d):(\d{3,})", r"\1.\2", text)
    text, afternoon = _without_noon(text)
    zone = re.search(r"\s*([A-Za-z]{2,5})$", text)
    if zone:
        if zone[1].upper() not in _ZONES:
            raise NoNumber(
                f"names the time zone '{zone[1]}'; give it as a difference from UTC, as in +02:00"
            )
        text = text[: zone.start()] + _ZONES[zone[1].upper()]
    found = from_iso(text if "-" in text[:5] else f"1970-01-01T{text}")
    if afternoon is None:
        return found
    if not 1 <= found.hour <= 12:
        raise ValueError("no hour of a clock of twelve hours")
    return found.replace(hour=found.hour % 12 + (12 if afternoon else 0))


def _spread(found: re.Match[str]) -> str:
    year, month, day, hour, minute, second, part = found.groups()
    return f"{year}-{month}-{day} {hour}:{minute}:{second}" + (f".{part}" if part else "")


def _without_noon(text: str) -> tuple[str, bool | None]:
    """A time without am or pm behind it, and whether that was pm; None without either."""
    found = _NOON.search(text)
    if found is None:
        return text, None
    return text[: found.start()] + text[found.end() :], found[1].lower() == "p"
