# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the page draws: a short memory of force, and pairs of force and area, as plain data.

Areas go to the browser in mm² and forces in N; everything else here is SI.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Collection, Sequence
from typing import Any

from finger_common.diagnostics import STALE, node_within
from finger_common.flags import AreaFlag, StateFlag, flag_names
from finger_common.stamps import NANOSECONDS, seconds

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
    """[time s, force N, area mm²] of one measured area (m²); None without contact or force."""
    force = memory.at(stamp_ns)
    if force is None or flags & AreaFlag.NO_CONTACT or not math.isfinite(area) or not force > 0:
        return None
    return [round(seconds(stamp_ns), 3), round(force, 4), round(area * 1e6, 3)]


ESTIMATE = ("area", "area_stddev", "indentation", "mean_pressure", "peak_pressure")
"""Fields of an estimate that the page draws."""

ESTIMATE_SCALES = (1e6, 1e6, 1e3, 1e-3, 1e-3)
"""To mm², mm², mm, kPa and kPa."""


def estimate_point(
    stamp_ns: int, force: float, values: Sequence[float]
) -> list[float | None] | None:
    """[time s, force N, then `ESTIMATE` in the page's units]; None without contact.

    values: as `ESTIMATE`, SI. A value that is not known is None.
    """
    if not math.isfinite(force) or force <= 0 or not values[0] > 0:
        return None
    scaled = (value * scale for value, scale in zip(values, ESTIMATE_SCALES))
    shown = [round(value, 3) if math.isfinite(value) else None for value in scaled]
    return [round(seconds(stamp_ns), 3), round(force, 4), *shown]


AREA_DOUBTS = (
    AreaFlag.NO_BACKGROUND,
    AreaFlag.LOW_CONTRAST,
    AreaFlag.SATURATED,
    AreaFlag.SPARSE,
    AreaFlag.CLIPPED,
    AreaFlag.MULTIPLE_REGIONS,
    AreaFlag.UNCALIBRATED,
)
"""Flags for which the page doubts a measured area, the gravest first."""

ESTIMATE_DOUBTS = (
    StateFlag.MODEL_FAILED,
    StateFlag.FORCE_INVALID,
    StateFlag.FORCE_OUT_OF_RANGE,
    StateFlag.FORCE_OFFSET,
    StateFlag.MODEL_MISMATCH,
    StateFlag.PARAMETERS_OUT_OF_RANGE,
    StateFlag.POSE_OUT_OF_RANGE,
    StateFlag.LATERAL_LOAD,
    StateFlag.MOISTURE_OUT_OF_RANGE,
    StateFlag.AREA_REJECTED,
)
"""Those of an estimate. What a rig without camera or moisture probe always has is none of them."""


def doubt(flags: int, doubts: Sequence[AreaFlag] | Sequence[StateFlag]) -> str:
    """Name of the gravest flag set, in words; empty for none."""
    return next((flag_names(flag).replace("_", " ") for flag in doubts if flags & flag), "")


Curves = dict[str, list[Sequence[float | None]]]
"""Points of the curves "force", "measured" and "model", each beginning with its time in s."""


class CurveMemory:
    """What a browser that is opened again still shows: the last seconds, and the last press."""

    SPAN = 30.0
    """s of the live curves."""
    PRESS_LIMIT = 60.0
    """s of a press that are kept at most."""

    def __init__(self) -> None:
        self._live: dict[str, deque[Sequence[float | None]]] = {
            kind: deque() for kind in ("force", "measured", "model")
        }
        self._press: tuple[int, float] | None = None
        self._last: dict[str, Any] | None = None

    def add(self, kind: str, point: Sequence[float | None]) -> None:
        """A point of a curve; a time that went back begins the curve again."""
        points = self._live[kind]
        time = point[0] or 0.0
        if points and time < (points[-1][0] or 0.0) - 1.0:
            points.clear()
        points.append(point)
        keep = self.PRESS_LIMIT if self._press else self.SPAN
        while points and (points[0][0] or 0.0) < time - keep:
            points.popleft()

    def press_begins(self, index: int, time: float) -> None:
        """The cue to press was given."""
        self._press = (index, time)

    def press_ends(self, time: float) -> None:
        """The press is over, with a trial kept or not."""
        if self._press is not None:
            (index, began), self._press = self._press, None
            self._last = {"index": index, "began": began, "ended": time, **self._since(began)}

    def snapshot(self) -> dict[str, Any]:
        """{"live": curves, "press": begin of the press under way or None, "last": of the last}."""
        began = None if self._press is None else self._press[1]
        return {"live": self._since(0.0), "press": began, "last": self._last}

    def _since(self, began: float) -> Curves:
        return {
            kind: [point for point in points if (point[0] or 0.0) >= began]
            for kind, points in self._live.items()
        }


class HealthBoard:
    """Newest status of every node and device of /diagnostics; one silent for 3 s is stale."""

    STALE_AFTER = 3.0
    LIMIT = 64

    def __init__(self, namespace: str = "/") -> None:
        self._namespace = namespace
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

    def snapshot(self, now: float, dead: Collection[str] = ()) -> list[dict[str, Any]]:
        """All entries by name; those of `dead` nodes are stale at once."""
        result = []
        for name in sorted(self._entries):
            last, entry = self._entries[name]
            if now - last > self.STALE_AFTER or node_within(name, self._namespace) in dead:
                age = f"silent for {now - last:.0f} s"
                entry = {**entry, "level": STALE, "message": age}
            result.append(entry)
        return result
