# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tare: the mean of a still, unloaded signal, refused when the signal moves, and when it is far
from the zero in force: then something is held, or the sensor has drifted. A lost connection may end
it: another sensor may be there afterwards."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from finger_common.errors import DeviceError

from .force.source import GOOD, ForceSource, WrenchSample


class TareCollector:
    """Collects samples for one tare.

    duration: s of signal to average. force_limit N, torque_limit N m: the greatest peak-to-peak
    movement of any axis that counts as still, measured on means of a tenth of the duration so that
    noise does not count.
    """

    PARTS, FILLED = 10, 8
    """Parts of the duration, and how many of them must have samples."""
    MOST_BAD = 10
    """Samples that are not good beyond which the tare ends."""

    def __init__(self, duration: float, force_limit: float, torque_limit: float) -> None:
        self._duration = duration
        self._limits = np.array([force_limit] * 3 + [torque_limit] * 3)
        self._stamps: list[int] = []
        self._channels: list[np.ndarray] = []
        self._bad = 0

    def add(self, sample: WrenchSample) -> bool:
        """Take a sample; true when the duration is covered."""
        if sample.quality != GOOD:
            self._bad += 1
            return self._bad > self.MOST_BAD
        self._stamps.append(sample.stamp_ns)
        self._channels.append(sample.channels)
        return (self._stamps[-1] - self._stamps[0]) * 1e-9 >= self._duration

    def result(self, source: ForceSource) -> tuple[np.ndarray, np.ndarray]:
        """Bias (6,) in the source's channels and offset (6,) in N and N m of what was collected.

        Raises DeviceError with the reason where that is no tare.
        """
        if self._bad > self.MOST_BAD:
            raise DeviceError("the sensor reports faults")
        if len(self._channels) < 2 * self.PARTS:
            raise DeviceError(
                f"{len(self._channels)} samples came in {self._duration:g} s, "
                f"{2 * self.PARTS} are needed; check the sensor, or make 'tare_duration' longer"
            )
        channels, time = np.array(self._channels), np.array(self._stamps) - self._stamps[0]
        part = np.minimum(time * 1e-9 * self.PARTS / self._duration, self.PARTS - 1).astype(int)
        filled = np.unique(part)
        if len(filled) < self.FILLED:
            raise DeviceError(
                f"samples came in {len(filled) / self.PARTS:.0%} of {self._duration:g} s only; "
                "check the sensor and try again"
            )
        wrenches = np.array([source.wrench_of(channels[part == p].mean(axis=0)) for p in filled])
        moved = np.ptp(wrenches, axis=0)
        if np.any(moved > self._limits):
            raise DeviceError(
                f"the signal moved by up to {moved[:3].max():.3g} N and {moved[3:].max():.3g} N m; "
                "take the finger off and try again"
            )
        bias = channels.mean(axis=0)
        return bias, source.wrench_of(bias)


class ZeroCheck:
    """Whether a zero may still be used after the connection was lost, of a sensor whose serial
    number is not known: where the force reads as before, or as that of a plate that nobody touches.

    before: (3,) N, last force before the loss, with that zero. limit: N.
    """

    DURATION = 0.1
    """s after the loss whose mean is compared."""

    def __init__(self, before: np.ndarray, limit: float) -> None:
        self._before = before
        self._limit = limit
        self._forces: list[np.ndarray] = []
        self._begin: int | None = None

    def add(self, stamp_ns: int, force: np.ndarray) -> bool | None:
        """Take the force (3,) in N with that zero; whether the zero holds, None while that is not
        known yet."""
        if self._begin is None:
            self._begin = stamp_ns
        self._forces.append(force)
        if (stamp_ns - self._begin) * 1e-9 < self.DURATION:
            return None
        now = self.now
        return any(np.linalg.norm(now - usual) <= self._limit for usual in (self._before, 0.0))

    @property
    def now(self) -> np.ndarray:
        """Force (3,) in N after the loss, with that zero."""
        return np.mean(self._forces, axis=0)


AGAIN = 30.0
"""s after a refusal within which a second tare is taken as meant."""


class FarTares:
    """Refuses a tare far from the one in force, as while an object is held, unless it is asked for
    twice. clock: s."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._refused: tuple[float, np.ndarray] | None = None

    def check(self, shift: np.ndarray, limit: float) -> None:
        """Look at the force (3,) in N from the zero in force to a new one; limit: N.

        Raises DeviceError with what to do for one beyond the limit, unless such a one, alike within
        the limit, was refused less than AGAIN before.
        """
        now, before, self._refused = self._clock(), self._refused, None
        size = float(np.linalg.norm(shift))
        if size <= limit:
            return
        if before is not None and now - before[0] <= AGAIN:
            if np.linalg.norm(shift - before[1]) <= limit:
                return
        self._refused = now, np.array(shift)
        raise DeviceError(
            f"the force moved by {size:.2f} N since the last tare, as by a finger or an object; "
            "take it off and tare again; where nothing touches the sensor, which has drifted, tare "
            f"again within {AGAIN:.0f} s"
        )
