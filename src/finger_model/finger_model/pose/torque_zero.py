# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Zero of the torque: what a sensor gives in the air."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from finger_common.stamps import nanoseconds

from ..sensor_air import BLOCK, BLOCKS, LEAST_BLOCKS

PERIOD = nanoseconds(BLOCK)
LARGEST = 10.0
"""N m; a larger moment is no rest of a tare, and is left out."""


class TorqueZero:
    """Means over blocks of samples in the air, as for the lateral force (`slip.forces`).

    `mean` (2,): what is taken off in this contact (N m); `sd`: its standard deviation (N m), that
    of the settings as long as the air has not told more.
    """

    def __init__(self, sd: float) -> None:
        self._unseen = sd
        self._blocks: deque[np.ndarray] = deque(maxlen=int(BLOCKS))
        self.leave(0)
        self.touch()

    def leave(self, stamp_ns: int) -> None:
        """A contact has ended; the block that follows it is left out."""
        self._sum, self._count = np.zeros(2), 0
        self._since = self._newest = stamp_ns + PERIOD

    def see_air(self, stamp_ns: int, moment: tuple[float, float]) -> None:
        """A moment (2,) in N m in the air."""
        if not -PERIOD <= stamp_ns - self._newest < 2 * PERIOD:
            self.leave(stamp_ns)
        if stamp_ns < self._since or not math.hypot(*moment) <= LARGEST:
            return
        self._newest = stamp_ns
        self._sum += moment
        self._count += 1
        if stamp_ns - self._since >= PERIOD:
            self._blocks.append(self._sum / self._count)
            self._sum, self._count, self._since = np.zeros(2), 0, stamp_ns

    def touch(self) -> None:
        """A contact begins."""
        self.mean, self.sd = (0.0, 0.0), self._unseen
        if len(self._blocks) >= LEAST_BLOCKS:
            blocks = np.array(self._blocks)
            x, y = blocks.mean(axis=0)
            self.mean = float(x), float(y)
            self.sd = math.sqrt(float(blocks.var(axis=0).mean()))
