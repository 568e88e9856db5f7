# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Numbers and times in the cells of a table, as programs of many countries write them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import date, datetime, time, timezone
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
    if text[:1].isdigit() and ":" in text:
        return True
    try:
        float(text)
    except ValueError:
        return False
    return True


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
                largest = max(largest, abs(float(cell)))
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
        return float(text.replace(",", "."))
    except ValueError:
        raise NoNumber("is no number; correct it") from None


def is_clock(cell: Any) -> bool:
    """Whether a cell is a date with time, or a time of day."""
    return isinstance(cell, (datetime, time)) or (isinstance(cell, str) and ":" in cell)


def has_date(cell: Any) -> bool:
    """Whether a time has a date."""
    if isinstance(cell, str):
        return bool(_DAY_FIRST.match(cell.strip()) or _YEAR_FIRST.match(cell.strip()))
    return not isinstance(cell, time)


def stamp_of(cell: Any) -> int:
    """A date with time, or a time of day, in ns since 1970 or midnight; UTC where it names no time
    zone. Raises ValueError for what is none."""
    if isinstance(cell, str):
        text = cell.strip().replace(",", ".")
        text = _DAY_FIRST.sub(lambda m: f"{m[3]}-{m[2]:0>2}-{m[1]:0>2}", text, count=1)
        text = _YEAR_FIRST.sub(lambda m: f"{m[1]}-{m[2]:0>2}-{m[3]:0>2}", text, count=1)
        text = re.sub(r"^(\d{4}-\d\d-\d\d)?[ T]*(\d):", r"\1 0\2:", text).strip()
        # As Python 3.10 takes them, too: six decimals, no letter for UTC.
        text = re.sub(r"\.(\d{1,6})\d*", lambda m: "." + m[1].ljust(6, "0"), text)
        text = re.sub(r"[zZ]$", "+00:00", text)
        cell = datetime.fromisoformat(text if "-" in text[:5] else f"1970-01-01T{text}")
    elif isinstance(cell, time):
        cell = datetime.combine(date(1970, 1, 1), cell)
    if not isinstance(cell, datetime):
        raise ValueError("no time")
    if cell.tzinfo is None:
        cell = cell.replace(tzinfo=timezone.utc)
    since = cell - datetime(1970, 1, 1, tzinfo=timezone.utc)
    return (since.days * 86400 + since.seconds) * NANOSECONDS + since.microseconds * 1000
