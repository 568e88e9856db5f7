# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Delays of a fast stream, counted without memory that grows."""

from __future__ import annotations

from array import array

import numpy as np


class LatencyHistogram:
    """Counts of delays in steps of 10 µs up to 100 ms."""

    STEP = 10_000
    SIZE = 10_000

    def __init__(self) -> None:
        # An array, since turning a long list into one holds up every thread for a millisecond.
        self.counts = array("q", bytes(8 * (self.SIZE + 1)))

    def add(self, nanoseconds: int) -> None:
        """Count one delay (ns)."""
        self.counts[min(max(nanoseconds, 0) // self.STEP, self.SIZE)] += 1

    def percentile(self, percent: float) -> float:
        """Upper edge (ms) of the step that holds the percentile; NaN without samples."""
        counts = np.array(memoryview(self.counts))
        total = counts.sum()
        if not total:
            return float("nan")
        at = int(np.searchsorted(np.cumsum(counts), total * percent / 100.0))
        return (at + 1) * self.STEP * 1e-6

    def text(self, percent: float) -> str:
        """The same in words; a delay of more than the last step is "> 100"."""
        value = self.percentile(percent)
        most = self.SIZE * self.STEP * 1e-6
        return f"> {most:g}" if value > most else f"{value:.3f}"
