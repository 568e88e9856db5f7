# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Time stamps: an `int` of nanoseconds since the epoch in the cores, seconds and nanoseconds in
messages.
"""

from __future__ import annotations

import math
import operator
from typing import Any, overload

import numpy as np

from .errors import InputError

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second."""

LAST_STAMP = (1 << 31) * NANOSECONDS - 1
"""Last stamp that a message can hold: its seconds have 32 bits, which end in January 2038."""


def stamp_of(time: Any) -> int:
    """Nanoseconds of a builtin_interfaces/Time: of rclpy, of a bag reader, or with `nanoseconds`
    for `nanosec`. At most LAST_STAMP, whatever the nanoseconds claim.
    """
    nanoseconds = time.nanosec if hasattr(time, "nanosec") else time.nanoseconds
    return min(int(time.sec) * NANOSECONDS + int(nanoseconds), LAST_STAMP)


def check_stamp(stamp_ns: int, where: str) -> None:
    """Raise InputError, naming `where`, for a stamp before 1970 or after the last one of a
    message.
    """
    if not 0 <= stamp_ns <= LAST_STAMP:
        year = math.floor(1970 + stamp_ns / NANOSECONDS / 86400 / 365.2425)
        raise InputError(
            f"{where}: a time is in the year {year}, messages hold 1970 to 2037; correct the "
            "times or their unit"
        )


def whole_stamp(stamp_ns: Any) -> int:
    """A stamp as an int; raises InputError for a number with a point, as `stamp_array` does."""
    try:
        return operator.index(stamp_ns)
    except TypeError:
        raise InputError(
            f"stamp_ns is {stamp_ns!r}; whole nanoseconds are needed: round(seconds * 1e9)"
        ) from None


def stamp_array(stamps_ns: Any) -> np.ndarray:
    """Stamps (n,) of nanoseconds as 64-bit integers, contiguous. Raises InputError for numbers with
    a point: they are seconds, and would be cut down to whole nanoseconds."""
    found = np.asarray(stamps_ns)
    if found.size and found.dtype.kind not in "iu":
        raise InputError(
            f"stamps_ns has numbers of type {found.dtype}; whole nanoseconds are needed: "
            "np.round(seconds * 1e9).astype(np.int64)"
        )
    return np.ascontiguousarray(found, np.int64)


def header_stamp(message: Any) -> int:
    """Nanoseconds of a message's header stamp."""
    return stamp_of(message.header.stamp)


def time_fields(stamp_ns: int) -> dict[str, int]:
    """Fields of a builtin_interfaces/Time: sec and nanosec (0 … 999,999,999, also before 1970)."""
    seconds, nanoseconds = divmod(int(stamp_ns), NANOSECONDS)
    return {"sec": seconds, "nanosec": nanoseconds}


def fill_time(time: Any, stamp_ns: int) -> None:
    """Set sec and nanosec of a Time message."""
    time.sec, time.nanosec = divmod(int(stamp_ns), NANOSECONDS)


@overload
def seconds(duration_ns: int) -> float: ...
@overload
def seconds(duration_ns: np.ndarray) -> np.ndarray: ...
def seconds(duration_ns: Any) -> Any:
    """Seconds of durations (…) in nanoseconds."""
    return duration_ns / NANOSECONDS


def nanoseconds(duration: float) -> int:
    """Whole nanoseconds of a duration in seconds, rounded."""
    return round(duration * NANOSECONDS)
