# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Order of the inputs of an offline run: by log time, each kind after a wait of its own."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator
from typing import Any

from finger_bag.reader import BagMessage

WRENCH_WAIT_NS = 2_000_000_000
"""Log time after which a wrench is used; areas later than this were late in a live run too."""

BACKLOG_NS = 30_000_000_000
"""The same where recorded events say what was late: so far the model node may have been behind."""

HEAD_START_NS = 1_000_000_000
"""Log time that areas and readings are used before a wrench logged with them."""

BLOCK = 4000
"""Wrenches that are handed over at once."""


MAXIMUM_WAITING = 50_000
"""Wrenches that wait at most."""


class InputOrder:
    """Holds wrenches, areas and readings until no later message of the bag can precede them.

    follow_events: recorded events tell which inputs were late and when settings changed. A model
    node that had no processor for seconds published them as much later than the bag holds the
    inputs.
    """

    def __init__(self, follow_events: bool) -> None:
        self.wait_ns = BACKLOG_NS if follow_events else WRENCH_WAIT_NS
        """Log time after which a wrench is used."""
        self._wrenches: deque[BagMessage] = deque()
        # Log time, number of the input, whether it is a reading, arguments for the estimator.
        self._inputs: list[tuple[int, int, bool, tuple[Any, ...]]] = []
        self._count = 0

    @property
    def full(self) -> bool:
        """Whether more wrenches wait than any sensor sends within the wait."""
        return len(self._wrenches) > MAXIMUM_WAITING

    def add_wrench(self, item: BagMessage) -> None:
        """Add a wrench; they come in order of log time."""
        self._wrenches.append(item)

    def add_area(self, log_ns: int, stamp: int, area: float, sd: float, flags: int) -> None:
        """Add an area (m²) with its standard deviation."""
        self._add(log_ns, False, (stamp, area, sd, flags))

    def add_moisture(self, log_ns: int, stamp: int, value: float) -> None:
        """Add a reading (a.u.)."""
        self._add(log_ns, True, (stamp, value))

    def _add(self, log_ns: int, moisture: bool, values: tuple[Any, ...]) -> None:
        # The number keeps inputs of equal log time in the order they came.
        self._count += 1
        heapq.heappush(self._inputs, (log_ns, self._count, moisture, values))

    def inputs_due(self, now_ns: int) -> Iterator[tuple[bool, tuple[Any, ...]]]:
        """Take areas and readings that have waited: (is a reading, estimator's arguments)."""
        log_ns = now_ns - self.wait_ns + HEAD_START_NS
        while self._inputs and self._inputs[0][0] <= log_ns:
            _, _, moisture, values = heapq.heappop(self._inputs)
            yield moisture, values

    def wrenches_due(self, now_ns: int) -> Iterator[list[BagMessage]]:
        """Take wrenches that have waited, in blocks; earlier when too many wait."""
        log_ns = now_ns - self.wait_ns
        waiting = self._wrenches
        while waiting and ((full := self.full) or waiting[0].log_time_ns <= log_ns):
            block: list[BagMessage] = []
            while waiting and len(block) < BLOCK and (full or waiting[0].log_time_ns <= log_ns):
                block.append(waiting.popleft())
            yield block
