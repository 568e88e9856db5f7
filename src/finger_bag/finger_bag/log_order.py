# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Messages of blocks that overlap in time, in the order of their log time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

import numpy as np

from .mcap_file import RECORD_HEAD, WHOLE_MESSAGE

_AT_ONCE = 1 << 16  # messages whose places become Python numbers at once


class Part:
    """Messages of one block that were not given yet, in the order of log time.

    times (n,): ns; messages of equal time stay in the order written.
    """

    def __init__(self, number: int, data: bytes, times: np.ndarray, offsets: np.ndarray) -> None:
        self.number = number
        self._data = data
        if (np.diff(times.astype(np.int64)) < 0).any():
            order = np.argsort(times, kind="stable")
            times, offsets = times[order], offsets[order]
        self.times, self._offsets = times, offsets
        self.size = len(data) + times.nbytes + offsets.nbytes

    def take(self, bound: int) -> tuple[np.ndarray, np.ndarray]:
        """Times and offsets of messages before a time, which are then no longer in the part."""
        ready = int(np.searchsorted(self.times, np.uint64(bound)))
        taken = self.times[:ready], self._offsets[:ready]
        self.times, self._offsets = self.times[ready:], self._offsets[ready:]
        return taken

    def head(self, offset: int) -> tuple[int, ...]:
        """Fields of a message's record before its content, as in `WHOLE_MESSAGE`."""
        return WHOLE_MESSAGE.unpack_from(self._data, offset)

    def content(self, offset: int, length: int) -> bytes:
        """CDR bytes of a message; length: of its record."""
        begin = offset + WHOLE_MESSAGE.size
        return self._data[begin : offset + RECORD_HEAD + length]


class Pending:
    """Parts that wait for what may come before their messages; size: their bytes.

    A part is looked at when some of its messages are due, not for each of the parts that follow: a
    small file can have ten thousand that overlap.
    """

    def __init__(self) -> None:
        self.size = 0
        self._added = 0
        self._parts: list[tuple[int, int, Part]] = []  # heap: first time, number of the part

    def add(self, part: Part) -> None:
        """Let a part wait."""
        self.size += part.size
        self._added += 1
        heapq.heappush(self._parts, (int(part.times[0]), self._added, part))

    def reach(self, bound: int) -> bool:
        """Whether a message is at a time (ns) or later."""
        return any(int(part.times[-1]) >= bound for _, _, part in self._parts)

    def before(self, bound: int) -> Iterator[tuple[Part, int]]:
        """Messages before a time (ns), in its order; they no longer wait then."""
        due = []
        while self._parts and self._parts[0][0] < bound:
            due.append(heapq.heappop(self._parts)[1:])
        due.sort(key=lambda item: item[0])
        taken = [(part, *part.take(bound)) for _, part in due]
        for number, part in due:
            if len(part.times):
                heapq.heappush(self._parts, (int(part.times[0]), number, part))
            else:
                self.size -= part.size
        if not taken:
            return
        offsets = np.concatenate([item[2] for item in taken])
        if len(taken) == 1:
            part = taken[0][0]
            for begin in range(0, len(offsets), _AT_ONCE):
                for offset in offsets[begin : begin + _AT_ONCE].tolist():
                    yield part, offset
            return
        # Stable: of equal times, the one of the earlier part is first.
        order = np.argsort(np.concatenate([item[1] for item in taken]), kind="stable")
        owner = np.repeat(np.arange(len(taken)), [len(item[1]) for item in taken])
        for begin in range(0, len(order), _AT_ONCE):
            now = order[begin : begin + _AT_ONCE]
            for place, offset in zip(owner[now].tolist(), offsets[now].tolist()):
                yield taken[place][0], offset
