# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Messages that are missing between the stamps of a stream of constant rate."""

from __future__ import annotations

from collections import deque
from statistics import median

_BATCH = 250
"""Steps judged together; many more than a catch-up or a burst at the start holds."""
_GAP, _SHORT = 1.5, 0.75
"""Steps, in periods, that are longer than a jittering one, and shorter."""
_CLOCK_STEP = 1.0
"""s by which stamps may move against the time of arrival before their clock was stepped."""


class StampGaps:
    """Counts messages that are missing between the stamps of a stream.

    The period is the median of the last steps, in batches, so that a burst at the start does not
    pass for the stream's period. A gap that the next messages make up for, as those of a driver
    that catches up, misses nothing. Stamps that jump while no such time passes come from a clock
    that was stepped; they are counted in `clock_steps`.
    """

    def __init__(self) -> None:
        self.clock_steps = 0
        self._recent: deque[int] = deque(maxlen=4 * _BATCH)
        self._batch: list[int] = []
        self._last: tuple[int, float] | None = None
        self._missing, self._behind = 0, 0.0

    def add(self, stamp_ns: int, arrival: float) -> None:
        """Take the next stamp, and its arrival on a steady clock (s).

        Repeated stamps and ones a little older are ignored.
        """
        last, self._last = self._last, (stamp_ns, arrival)
        if last is None:
            return
        step = stamp_ns - last[0]
        if step < -_CLOCK_STEP * 1e9 or step * 1e-9 > arrival - last[1] + _CLOCK_STEP:
            self.clock_steps += 1
        elif step <= 0:
            self._last = last
        else:
            self._batch.append(step)
            self._recent.append(step)
            if len(self._batch) == _BATCH:
                self._missing, self._behind = self._judge()
                self._batch = []

    @property
    def missing(self) -> int:
        """Messages missing so far."""
        missing, behind = self._judge()
        return missing + round(behind)

    def _judge(self) -> tuple[int, float]:
        """Messages missing, and those that may still be made up for, with the batch."""
        missing, behind = self._missing, self._behind
        period = median(self._recent) if self._batch else 0.0
        for step in self._batch:
            periods = step / period
            if periods > _GAP:
                behind += periods - 1
            elif periods < _SHORT:
                behind = max(0.0, behind - (1 - periods))
            else:
                missing += round(behind)
                behind = 0.0
        return missing, behind
