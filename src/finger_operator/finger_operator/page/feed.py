"""What the page draws: a short memory of force, and pairs of force and area, as plain data.

Areas go to the browser in mm² and forces in N; everything else here is SI.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from typing import Any

from finger_common.diagnostics import STALE
from finger_common.flags import AreaFlag
from finger_common.stamps import NANOSECONDS

MEMORY = 4 * NANOSECONDS
"""ns of force kept to give an image its force; more than any camera and vision take."""


class ForceMemory:
    """Force samples of the last seconds, by stamp."""

    def __init__(self) -> None:
        self._stamps: deque[int] = deque()
        self._forces: deque[float] = deque()

    def add(self, stamp_ns: int, force: float) -> None:
        """One sample in N; a stamp that went back starts the memory again."""
        if self._stamps and stamp_ns <= self._stamps[-1]:
            if self._stamps[-1] - stamp_ns < MEMORY:
                return
            self._stamps.clear()
            self._forces.clear()
        self._stamps.append(stamp_ns)
        self._forces.append(force)
        while stamp_ns - self._stamps[0] > MEMORY:
            self._stamps.popleft()
            self._forces.popleft()

    def at(self, stamp_ns: int) -> float | None:
        """Force in N at a time, linear between samples; None outside what is remembered."""
        stamps = list(self._stamps)
        if not stamps or not stamps[0] <= stamp_ns <= stamps[-1]:
            return None
        right = bisect_left(stamps, stamp_ns)
        if stamps[right] == stamp_ns:
            return self._forces[right]
        t0, t1 = stamps[right - 1], stamps[right]
        f0, f1 = self._forces[right - 1], self._forces[right]
        return f0 + (f1 - f0) * (stamp_ns - t0) / (t1 - t0)


def measured_point(
    memory: ForceMemory, stamp_ns: int, area: float, flags: int
) -> list[float] | None:
    """[force N, area mm²] of one measured area (m²); None without contact or force."""
    force = memory.at(stamp_ns)
    if force is None or flags & AreaFlag.NO_CONTACT or not math.isfinite(area) or force <= 0:
        return None
    return [round(force, 4), round(area * 1e6, 3)]


def model_point(force: float, area: float) -> list[float] | None:
    """[force N, area mm²] of one modelled area (m²), or None without contact."""
    if not (math.isfinite(force) and math.isfinite(area)) or force <= 0 or area <= 0:
        return None
    return [round(force, 4), round(area * 1e6, 3)]


class HealthBoard:
    """Newest status of every node and device of /diagnostics; one silent for 3 s is stale."""

    STALE_AFTER = 3.0
    LIMIT = 64

    def __init__(self) -> None:
        self._entries: dict[str, tuple[float, dict[str, Any]]] = {}

    def add(self, now: float, name: str, level: int, message: str, values: dict[str, str]) -> None:
        """One status at time `now` (s, steady)."""
        if name not in self._entries and len(self._entries) >= self.LIMIT:
            return
        entry = {
            "name": name,
            "level": min(max(level, 0), STALE),
            "message": message,
            "values": values,
        }
        self._entries[name] = (now, entry)

    def snapshot(self, now: float) -> list[dict[str, Any]]:
        """All entries by name."""
        result = []
        for name in sorted(self._entries):
            last, entry = self._entries[name]
            if now - last > self.STALE_AFTER:
                age = f"silent for {now - last:.0f} s"
                entry = {**entry, "level": STALE, "message": age}
            result.append(entry)
        return result
