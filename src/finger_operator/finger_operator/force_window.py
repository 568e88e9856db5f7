# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The newest forces of a stream, and their mean. No ROS."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

from finger_common.stamps import nanoseconds

PARTS = 4
"""Parts of a window whose means tell whether the force is steady: a single sample is noisy."""


class ForceWindow:
    """Forces in N of the last `span` s."""

    def __init__(self, span: float) -> None:
        self._span = nanoseconds(span)
        self._samples: deque[tuple[int, float]] = deque()
        self._sum = 0.0

    def add(self, stamp_ns: int, force: float) -> None:
        """One sample."""
        self._samples.append((stamp_ns, force))
        self._sum += force
        while self._samples[0][0] <= stamp_ns - self._span:
            self._sum -= self._samples.popleft()[1]

    def clear(self) -> None:
        """Forget all samples."""
        self._samples.clear()
        self._sum = 0.0

    @property
    def mean(self) -> float:
        """Of all samples, at little cost; NaN without any."""
        return self._sum / len(self._samples) if self._samples else math.nan

    def mean_since(self, stamp_ns: int) -> float:
        """Of the samples from a stamp on; NaN without any."""
        found = [force for stamp, force in self._samples if stamp >= stamp_ns]
        return sum(found) / len(found) if found else math.nan

    @property
    def unrest(self) -> float:
        """Largest difference of the means of `PARTS` parts of the window; NaN where it is not
        filled."""
        forces = [force for _, force in self._samples]
        size = len(forces) / PARTS
        if size < 1 or self._samples[-1][0] - self._samples[0][0] < 0.8 * self._span:
            return math.nan
        ends = [round(part * size) for part in range(PARTS + 1)]
        means = [sum(forces[a:b]) / (b - a) for a, b in pairwise(ends)]
        return max(means) - min(means)
