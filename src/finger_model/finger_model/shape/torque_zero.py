# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Zero of the torque: what a sensor gives in the air."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from finger_common.contact_threshold import ONSET_FORCE
from finger_common.stamps import nanoseconds

from ..sensor_air import BLOCK, BLOCKS, LEAST_BLOCKS, is_tared

PERIOD = nanoseconds(BLOCK)
LARGEST = 10.0
"""N m and N; a larger moment or force is no rest of a tare, and is left out."""

TINY = 1e-20
"""N² m²; moments without noise have equal weights."""


class TorqueZero:
    """Means over blocks of samples in the air, as for the lateral force (`slip.forces`).

    `mean` (2,): what is taken off in this contact (N m); `sd`: its standard deviation (N m), that
    of the settings as long as the air has not told more.
    """

    def __init__(self, sd: float) -> None:
        self._unseen = sd
        self._blocks: deque[np.ndarray] = deque(maxlen=int(BLOCKS))
        self.forget()
        self.touch(0.0)

    def forget(self) -> None:
        """The sensor may have another zero from now on."""
        self._blocks.clear()
        self._jump, self._before = 0.0, np.zeros(0)
        self.leave(0)

    def leave(self, stamp_ns: int) -> None:
        """A contact has ended; the block that follows it is left out."""
        self._sum, self._count = np.zeros(3), 0
        self._since = self._newest = stamp_ns + PERIOD

    def see_air(self, stamp_ns: int, moment: tuple[float, float], force: float, arm: float) -> None:
        """A moment (2,) in N m and the force along the normal axis (N) in the air; arm: as of
        `touch`."""
        if not -PERIOD <= stamp_ns - self._newest < 2 * PERIOD:
            self.leave(stamp_ns)
        if stamp_ns < self._since or not math.hypot(*moment, force) <= LARGEST:
            return
        self._newest = stamp_ns
        self._sum += *moment, force
        self._count += 1
        if stamp_ns - self._since >= PERIOD:
            self._take(self._sum / self._count, arm)
            self._sum, self._count, self._since = np.zeros(3), 0, stamp_ns

    def _take(self, block: np.ndarray, arm: float) -> None:
        """Remember a block (3,), but for the first one of another zero, which may be of both."""
        if self._blocks:
            blocks = np.array(self._blocks)
            mean = blocks.mean(axis=0)
            jump, variance = math.dist(block[:2], mean[:2]), float(blocks[:, :2].var(axis=0).sum())
            # A finger that begins to rest there moves the moment, too.
            least = self._unseen + arm * min(abs(block[2] - mean[2]), ONSET_FORCE)
            if is_tared(len(blocks), jump, variance, least):
                self._blocks.clear()
                self._jump, self._before = jump, mean
                return
        elif len(self._before):
            self._jump = max(self._jump, math.dist(block[:2], self._before[:2]))
        self._blocks.append(block)

    def touch(self, arm: float) -> None:
        """A contact begins, at most `arm` (m) from the torque's origin.

        A finger may have rested there before, too lightly for a contact: what its force makes of
        the moment counts as not known.
        """
        self.mean, self.sd = (0.0, 0.0), max(self._unseen, self._jump)
        if len(self._blocks) >= LEAST_BLOCKS:
            blocks = np.array(self._blocks)
            moments, resting = blocks[:, :2], arm * blocks[:, 2]
            scatter = float(moments.var(axis=0).mean())
            weights = 1.0 / (scatter + resting**2 + TINY)
            weights /= weights.sum()
            x, y = weights @ moments
            self.mean = float(x), float(y)
            self.sd = math.sqrt(scatter + float(weights @ resting**2))
