# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Messages that are missing between the stamps of a stream of constant rate."""

from __future__ import annotations

from collections import deque
from statistics import fmean, median

_BATCH = 250
"""Steps judged together; many more than a catch-up or a burst at the start holds."""
_WITHIN = 100
"""Messages in which a driver catches up; what they do not make up for is missing."""
_EARLY = 0.25
"""Periods by which the newest message may be early."""
_DRIFT = 0.1
"""Part of a delay that lasts which is taken for an error of the period, with each message."""
_NEAR, _SHARE = 0.2, 0.2
"""Steps this near the expected period, relatively, and the share of them that shows it."""
_BETWEEN = 1.6
"""Expected periods, up to which a longer step is one of a slower stream and no gap."""
_USUAL = (0.75, 1.5)
"""Steps, in their usual length, whose mean is the period: stamps may be rounded."""
_CLOCK_STEP = 1.0
"""s by which stamps may move against the time of arrival before their clock was stepped."""


class StampGaps:
    """Counts messages that are missing between the stamps of a stream.

    rate: expected, Hz; 0 where it is not known. The period is the mean of the steps near the median
    of the last ones, in batches, so that a burst at the start does not pass for the stream's
    period. In a stream slowed by gaps it is the expected one where enough steps still have it.
    A message may be late, and the next ones make up for it, as those of a driver that catches up;
    what they do not make up for soon is missing. Stamps that jump while no such time passes
    come from a clock that was stepped; nothing is missing there.
    """

    def __init__(self, rate: float = 0.0) -> None:
        self._expected = 1e9 / rate if rate else 0.0
        self._recent: deque[int] = deque(maxlen=4 * _BATCH)
        self._batch: list[int] = []
        self._last: tuple[int, float] | None = None
        self._missing, self._earliest = 0, 0.0
        self._newest = deque([0.0], maxlen=_WITHIN)

    def add(self, stamp_ns: int, arrival: float) -> None:
        """Take the next stamp, and its arrival on a steady clock (s).

        Repeated stamps and ones a little older are ignored.
        """
        last, self._last = self._last, (stamp_ns, arrival)
        if last is None:
            return
        step = stamp_ns - last[0]
        stepped = step < -_CLOCK_STEP * 1e9 or step * 1e-9 > arrival - last[1] + _CLOCK_STEP
        if step <= 0 and not stepped:
            self._last = last
        elif not stepped:
            self._batch.append(step)
            self._recent.append(step)
            if len(self._batch) == _BATCH:
                self._missing, self._earliest, self._newest = self._judge()
                self._batch = []

    @property
    def missing(self) -> int:
        """Messages missing so far."""
        missing, earliest, newest = self._judge()
        return missing + int(newest[-1] - earliest + _EARLY)

    def _period(self) -> float:
        """ns"""
        usual, expected = median(self._recent), self._expected
        if usual > (1 + _NEAR) * expected > 0.0:
            near = sum(abs(step - expected) < _NEAR * expected for step in self._recent)
            slower = sum((1 + _NEAR) * expected < s <= _BETWEEN * expected for s in self._recent)
            if near >= max(_SHARE * len(self._recent), 2 * slower):
                return expected
        low, high = _USUAL
        return fmean([s for s in self._batch if low * usual <= s <= high * usual] or [usual])

    def _judge(self) -> tuple[int, float, deque[float]]:
        """Messages missing, with the batch; and, in periods by which messages lag behind one for
        each, the least lag of what is not missing, and those of the last messages."""
        missing, earliest, newest = self._missing, self._earliest, self._newest.copy()
        period = self._period() if self._batch else 0.0
        for step in self._batch:
            newest.append(newest[-1] + step / period - 1)
            earliest = min(earliest, newest[-1])
            late = min(newest) - earliest
            lost = round(late) if len(newest) == _WITHIN else 0
            missing += lost
            earliest += lost or _DRIFT * late
        return missing, earliest, newest
