# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Time stamps: kernel stamps, increasing stamps, device clocks mapped to host time."""

from __future__ import annotations

import socket
import struct
import sys
from collections import deque
from typing import Any

import numpy as np

from finger_common.stamps import NANOSECONDS, nanoseconds, seconds

_SO_TIMESTAMPNS = 35


def request_kernel_stamps(connection: socket.socket) -> None:
    """Have the kernel stamp what the socket receives, on Linux."""
    if sys.platform.startswith("linux"):
        connection.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)


def receive_stamped(connection: socket.socket, size: int) -> tuple[bytes, int | None, Any]:
    """A datagram, the kernel's stamp of its arrival (wall clock, ns; or None) and its sender."""
    if not hasattr(connection, "recvmsg"):
        data, sender = connection.recvfrom(size)
        return data, None, sender
    data, ancillary, _, sender = connection.recvmsg(size, socket.CMSG_SPACE(16))
    for _level, kind, value in ancillary:
        if kind == _SO_TIMESTAMPNS and len(value) == 16:
            whole, rest = struct.unpack("@ll", value)
            return data, whole * NANOSECONDS + rest, sender
    return data, None, sender


class IncreasingStamps:
    """Lets only increasing stamps through."""

    def __init__(self) -> None:
        self.last: int | None = None

    def accept(self, stamp_ns: int) -> bool:
        """True, and remembered, when `stamp_ns` is later than every stamp before."""
        if self.last is not None and stamp_ns <= self.last:
            return False
        self.last = stamp_ns
        return True


LATE = 3e-3
"""s above the line below all blocks from which a block counts as late."""
CLOCK_DRIFT = 5e-4
"""s/s; clocks of crystals differ by a fifth of it at most."""
SURE = 8.0
"""s of blocks from which a larger drift is believed, as of a device with another rate than it
states."""
AGREEING, SCATTER = 3, 0.1
"""Before that it is believed where at least so many blocks lie on one rising line: their scatter
about it is at most this share of the rise, which is more than LATE."""
ANOTHER_RATE = 2e-3
"""s/s; a device of a larger drift has another rate than it states, and receipt is the better
stamp."""
JUMP = 10e-3
"""s by which a delay must lie below all that is known to show that the device's clock jumped."""


def _line_below(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Slope and intercept (2,) of the line below all points (n,), n > 1, that is nearest to them:
    the edge of their lower convex hull at the mean of x."""
    hull: list[int] = []
    for k in range(len(x)):
        while len(hull) > 1:
            i, j = hull[-2:]
            if (y[j] - y[i]) * (x[k] - x[i]) < (y[k] - y[i]) * (x[j] - x[i]):
                break
            hull.pop()
        hull.append(k)
    right = min(max(int(np.searchsorted(x[hull], x.mean())), 1), len(hull) - 1)
    i, j = hull[right - 1], hull[right]
    slope = (y[j] - y[i]) / (x[j] - x[i])
    return np.array([slope, y[i] - slope * x[i]])


def _agree(device: np.ndarray, delay: np.ndarray, line: np.ndarray) -> bool:
    """Whether delays (n,) at device times (n,) rise along a line (slope, intercept), all s."""
    rise = float(line[0] * (device[-1] - device[0]))
    scatter = float(np.abs(delay - np.polyval(line, device)).max())
    return len(device) >= AGREEING and rise > LATE and scatter <= SCATTER * rise


class ClockMapper:
    """Maps a device's clock to host time from pairs (device time, host time of receipt).

    Receipt is late by a delay that is never negative: in each block of `block` seconds of device
    time the pair with the least delay is kept, and a line through the last `blocks` of them (least
    squares) gives offset and drift. A block in which every pair was late, as under load, lies above
    the others and is left out. Before the second block is complete, and while the line drifts by
    more than a clock does and few blocks do not agree on it, the least delay so far is used without
    drift. With a drift of `another_rate` the result is the time of receipt.

    A delay far below all others shows that the device's clock jumped forward, or that receipt was
    late since the beginning: the result is the time of receipt, and the mapping begins anew when
    the next delay is as short.

    nominal_rate: device ticks per second. `drift` is in s/s (device clock slow: positive), `jitter`
    the standard deviation of receipt about the mapped time, in s, `jumps` how often the mapping
    began anew by itself.
    """

    def __init__(self, nominal_rate: float, block: float = 1.0, blocks: int = 30) -> None:
        if not nominal_rate > 0:
            raise ValueError("nominal_rate must be positive")
        self.nominal_rate = nominal_rate
        self._block = block
        self._minima: deque[tuple[float, float]] = deque(maxlen=blocks)
        self._recent: deque[float] = deque(maxlen=500)
        self.jumps = 0
        self.restart()

    def restart(self) -> None:
        """Forget everything, as after the device's clock was reset."""
        self._last_ticks: int | None = None
        self._last_stamp: int | None = None
        self._begin()

    def _begin(self) -> None:
        self._origin: tuple[int, int] | None = None
        self._minima.clear()
        self._recent.clear()
        self._current: tuple[float, float] | None = None
        self._block_end = self._block
        self._jumped = False
        self.drift = 0.0
        self._offset = 0.0
        self._centre = 0.0

    def update(self, ticks: int, host_ns: int) -> int:
        """Host time (ns) at which the device took the sample of `ticks`.

        Ticks that go back restart the mapping. Results increase until then and, but for that, are
        not later than `host_ns`.
        """
        if self._last_ticks is not None and ticks <= self._last_ticks:
            self.restart()
        self._last_ticks = ticks
        device, delay = self._of_origin(ticks, host_ns)
        if self._far_below(device, delay):
            # One alone may be a wrong time of receipt.
            if not self._jumped:
                self._jumped = True
                return self._increasing(host_ns)
            self.jumps += 1
            self._begin()
            device, delay = self._of_origin(ticks, host_ns)
        self._jumped = False
        if self._current is None or delay < self._current[1]:
            self._current = (device, delay)
        if device >= self._block_end:
            self._minima.append(self._current)
            self._current = None
            self._block_end = device + self._block
            self._fit()
        if len(self._minima) > 1:
            mapped = self._line(device)
        else:
            known = [m[1] for m in self._minima] + ([self._current[1]] if self._current else [])
            mapped = min(known)
        mapped = min(mapped, delay)
        self._recent.append(delay - mapped)
        if self.another_rate:
            return self._increasing(host_ns)
        return self._increasing(host_ns - nanoseconds(delay - mapped))

    def _of_origin(self, ticks: int, host_ns: int) -> tuple[float, float]:
        """Device time and delay of a pair, s from the first one."""
        if self._origin is None:
            self._origin = (ticks, host_ns)
        device = (ticks - self._origin[0]) / self.nominal_rate
        return device, seconds(host_ns - self._origin[1]) - device

    def _far_below(self, device: float, delay: float) -> bool:
        """Whether a delay is JUMP below the present block, the last one and the line."""
        limit, current, minima = delay + JUMP, self._current, self._minima
        if current is not None and current[1] <= limit:
            return False
        if minima and minima[-1][1] <= limit:
            return False
        if len(minima) > 1 and self._line(device) <= limit:
            return False
        return current is not None or bool(minima)

    def _line(self, device: float) -> float:
        return self._offset + self.drift * (device - self._centre)

    def _increasing(self, stamp: int) -> int:
        """The stamp, or the next after the last one: a new line may lie a little earlier."""
        stamp = max(stamp, self._last_stamp + 1) if self._last_stamp is not None else stamp
        self._last_stamp = stamp
        return stamp

    def _fit(self) -> None:
        if len(self._minima) < 2:
            return
        device, delay = np.array(self._minima).T
        line = _line_below(device, delay)
        near = delay - np.polyval(line, device) <= LATE
        if near.sum() > 1:
            line = np.polyfit(device[near], delay[near], 1)
        sure = len(device) * self._block >= SURE or _agree(device, delay, line)
        if abs(line[0]) > CLOCK_DRIFT and not sure:
            line = np.array([0.0, delay.min()])
        self._centre = float(device.mean())
        self.drift, self._offset = float(line[0]), float(np.polyval(line, self._centre))

    def notes(self) -> dict[str, str]:
        """Drift, jitter and jumps for diagnostics."""
        return {
            "clock_drift_ppm": f"{self.drift * 1e6:.1f}",
            "clock_jitter_ms": f"{self.jitter * 1e3:.3f}",
            "clock_jumps": str(self.jumps),
        }

    @property
    def another_rate(self) -> bool:
        """Whether the device has another rate than the nominal one."""
        return abs(self.drift) > ANOTHER_RATE

    @property
    def jitter(self) -> float:
        """Standard deviation of receipt about the mapped time, s."""
        return float(np.std(self._recent)) if self._recent else 0.0


class StampStatistics:
    """Intervals between stamps since the last `take_notes`. One thread adds, another takes."""

    def __init__(self) -> None:
        self._stamps: list[int] = []

    def add(self, stamp_ns: int) -> None:
        """Add a stamp."""
        # Bounded also without a reader.
        if len(self._stamps) < 20_000:
            self._stamps.append(stamp_ns)

    def take_notes(self) -> dict[str, str]:
        """Standard deviation and maximum of the intervals in ms; empty below three stamps."""
        stamps = self._stamps
        if len(stamps) < 3:
            return {}
        self._stamps = stamps[-1:]
        intervals = np.diff(np.array(stamps)) * 1e-6
        return {
            "interval_jitter_ms": f"{intervals.std():.3f}",
            "interval_longest_ms": f"{intervals.max():.3f}",
        }
