# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Measurements that take effect at a sample which their stamp decides, whenever they come."""

from __future__ import annotations

import bisect
from collections import deque
from operator import itemgetter
from typing import Generic, TypeVar

from finger_common.stamps import NANOSECONDS, nanoseconds

REMEMBERED = 8192
"""Samples that are remembered for measurements that come late: `delay` may be 1 s at 8 kHz."""

T = TypeVar("T")

_stamp = itemgetter(0)


class Delayed(Generic[T]):
    """Holds measurements until they are due: at the first sample stamped like them plus `delay` (s)
    or later. The delay may change while they wait."""

    def __init__(self) -> None:
        self.delay = 0.0
        self._waiting: list[tuple[int, T]] = []
        self._stamps: deque[int] = deque(maxlen=64)

    def add(self, stamp_ns: int, value: T) -> bool:
        """Let a measurement of this stamp wait; false for a second one of a stamp."""
        if stamp_ns in self._stamps:
            return False
        self._stamps.append(stamp_ns)
        bisect.insort(self._waiting, (stamp_ns, value), key=_stamp)
        return True

    @property
    def next_due(self) -> int | None:
        """Stamp (ns) of a sample from which the next one is due, None where none waits."""
        return self._waiting[0][0] + nanoseconds(self.delay) if self._waiting else None

    def due(self, stamp_ns: int) -> list[tuple[int, T]]:
        """Remove and return, with their stamps, those that are due at a sample of this stamp."""
        if not self._waiting:
            return []
        until = stamp_ns - nanoseconds(self.delay)
        number = bisect.bisect_right(self._waiting, until, key=_stamp)
        found, self._waiting = self._waiting[:number], self._waiting[number:]
        return found

    def leave_out(self, first_ns: int, last_ns: int) -> None:
        """Remove those of stamps from first to last (ns)."""
        self._waiting = [w for w in self._waiting if not first_ns <= w[0] <= last_ns]

    def jump_back(self, stamp_ns: int) -> None:
        """Time jumped back to this stamp: keep what is near it, which is still to come."""
        self._stamps.clear()
        self._waiting = [w for w in self._waiting if abs(w[0] - stamp_ns) < NANOSECONDS]
