# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What came last from force sensor, camera and diagnostics: whether it is fresh, and counts."""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from finger_common.diagnostics import ERROR
from finger_common.flags import AreaFlag
from finger_common.moisture import MOISTURE_RANGE, is_moisture
from finger_common.stamps import NANOSECONDS, seconds

from .limits import Limits

REPORT_MEMORY = 3.0
"""s for which a report in /diagnostics counts; each node repeats it once a second."""

CLOCKS_APART = 0.3
"""s between the stamp of a force and its arrival from which the nodes disagree on the time."""

CAMERA_APART = 1.0
"""The same of a contact area against the force: an image takes its time to be measured."""

AHEAD = 1.0
"""s by which a reading may be stamped ahead of the protocol's clock."""

STALE_READING = 60.0
"""s before a step from which a reading tells of a clock, and not of one that was taken early."""

NUMBER = re.compile(r"\d+([.,]\d+)*")

LOGGED_SILENCE = 1.0
"""s without a sample from which silence is an event of the log."""


@dataclass(frozen=True)
class _Sample:
    """The newest one of a stream: its stamp, and when it came by the protocol's own clock (ns),
    None before that clock's first reading."""

    stamp_ns: int
    came_ns: int | None
    value: float
    flags: int = 0


class _Lag:
    """s by which the stamps of a stream are behind the protocol's clock. A delay on the way adds to
    it, so that the smallest one of the last samples counts; None before the first one."""

    def __init__(self) -> None:
        self._compared: _Sample | None = None
        self._lags: deque[float] = deque(maxlen=20)

    def compare(self, newest: _Sample | None, now_ns: int) -> None:
        """Note the lag of the newest sample."""
        if newest is not None and newest is not self._compared:
            self._compared = newest
            self._lags.append(seconds(now_ns - newest.stamp_ns))

    @property
    def least(self) -> float | None:
        return min(self._lags, default=None)


class Inputs:
    """Newest force (N), contact area (m²) and errors. `now_ns`: by the protocol's own clock; 0
    before its first reading."""

    def __init__(self) -> None:
        self._force: _Sample | None = None
        self._area: _Sample | None = None
        self._errors: dict[str, tuple[int, str]] = {}
        self._told: dict[str, set[str]] = {}
        """Messages of the errors that last, without their numbers, which may count the seconds."""
        self._lag_of_force, self._lag_of_area = _Lag(), _Lag()
        self._silent: set[str] = set()
        self._zero = ""

    @property
    def force_stamp(self) -> int | None:
        """Stamp of the newest force."""
        return None if self._force is None else self._force.stamp_ns

    def add_force(self, stamp_ns: int, force: float, now_ns: int) -> None:
        """One normal force."""
        self._force = _Sample(stamp_ns, now_ns or None, force)

    def compare_clocks(self, now_ns: int) -> None:
        """Note the lags of force and area; to be called when all that has come was added."""
        self._lag_of_force.compare(self._force, now_ns)
        self._lag_of_area.compare(self._area, now_ns)

    @property
    def force_lag(self) -> float:
        """s by which the stamps of the force are behind the protocol's clock."""
        return self._lag_of_force.least or 0.0

    def clocks_apart(self) -> str:
        """That force and protocol disagree on the time, and the remedy; empty where they agree."""
        if abs(self.force_lag) <= CLOCKS_APART:
            return ""
        return (
            f"the clocks of the force driver and the protocol are {abs(self.force_lag):.1f} s "
            "apart: the system clock was stepped between their starts, or the force comes from "
            "another computer; restart all nodes, or synchronise the computers"
        )

    def camera_apart(self, limits: Limits) -> str:
        """That camera and force disagree on the time, or areas come late, and the remedy; empty
        where neither is so, and where no camera is needed."""
        force, area = self._lag_of_force.least, self._lag_of_area.least
        if not limits.need_camera or force is None or area is None:
            return ""
        apart = abs(area - force)
        if apart <= CAMERA_APART:
            return ""
        if area > force:
            return (
                f"contact areas are stamped {apart:.1f} s before the force that comes with them: "
                "they take that long to come, or the clocks of camera and force are apart; use a "
                "smaller picture or a faster area sensor, or restart all nodes and synchronise the "
                "computers"
            )
        return (
            f"the clocks of camera and force are {apart:.1f} s apart: the system clock was stepped "
            "between the starts of their drivers, or one of them is on another computer; restart "
            "all nodes, or synchronise the computers"
        )

    def set_zero(self, zero: str) -> float | None:
        """The zero of the force, as its driver tells it; N by which it was moved, 0 where that is
        not known, None where it is that of before."""
        if zero == self._zero:
            return None
        before, self._zero = self._zero, zero
        try:
            first, second = ([float(v) for v in z.split(",")[:3]] for z in (before, zero))
            return math.dist(first, second)
        except ValueError:
            return 0.0

    def add_area(self, stamp_ns: int, area: float, flags: int, now_ns: int) -> None:
        """One contact area with its quality flags."""
        self._area = _Sample(stamp_ns, now_ns or None, area, flags)

    def refuse_reading(
        self, value: float, stamp_ns: int, since_ns: int, now_ns: int, limits: Limits
    ) -> str:
        """Why a moisture reading (a.u.) does not count in a step that began at `since_ns`; empty
        where it does."""
        reading, age = f"Reading {value:g}", seconds(now_ns - stamp_ns)
        early = seconds(since_ns - stamp_ns)
        wrong = clock = ""
        # Tables have whole seconds.
        if early > (0.0 if stamp_ns % NANOSECONDS else 1.0):
            wrong = f"{early:.1f} s before this step"
            clock = "behind" if early > STALE_READING else ""
        elif age < -AHEAD:
            wrong, clock = f"{-age:.1f} s ahead of the protocol's clock", "ahead"
        if wrong:
            apart = self.clocks_apart()
            if apart and abs(age - self.force_lag) <= 1.0:
                remedy = f"{apart}."
            elif clock:
                remedy = (
                    f"the clock of the moisture node is {clock}: restart all nodes, or set the "
                    "clock of the probe."
                )
            else:
                remedy = "take another. If it was taken now, the clock of the probe is late."
            return f"{reading} is stamped {wrong} and does not count; {remedy}"
        if not is_moisture(value):
            low, high = MOISTURE_RANGE
            return f"{reading} is outside {low:g}–{high:g} a.u. and does not count; take another."
        if value < limits.least_moisture:
            return f"{reading}: no contact with the skin; take another."
        return ""

    def add_health(self, name: str, level: int, message: str, now_ns: int) -> str:
        """State of a device or node; the news of it for the event log, empty for none."""
        if level < ERROR:
            self._told.pop(name, None)
            return f"{name}: over" if self._errors.pop(name, None) else ""
        self._errors[name] = (now_ns, message)
        told, words = self._told.setdefault(name, set()), NUMBER.sub("", message)
        if words in told:
            return ""
        told.add(words)
        return f"{name}: {message}"

    def force_fell_silent(self, now_ns: int, limits: Limits) -> bool:
        """Whether no force comes any longer."""
        return self._force is not None and _is_old(self._force, now_ns, limits)

    def silences(self, now_ns: int, limits: Limits) -> Iterator[str]:
        """News for the event log: force or camera has fallen silent, or is back."""
        newest = {"force sensor": self._force}
        if limits.need_camera:
            newest["camera"] = self._area
        for name, sample in newest.items():
            came = None if sample is None else sample.came_ns
            age = 0.0 if came is None else seconds(now_ns - came)
            silent = age > max(limits.stale_after, LOGGED_SILENCE)
            if silent != (name in self._silent):
                self._silent ^= {name}
                yield f"{name}: {'silent' if silent else 'over'}"

    def waiting_for(self, now_ns: int, limits: Limits) -> str:
        """Why the press does not begin yet; empty when nothing is in the way."""
        for name, (stamp, message) in self._errors.items():
            if seconds(now_ns - stamp) < REPORT_MEMORY:
                return f"{name}: {message}"
        force, area = self._force, self._area
        if force is None or _is_old(force, now_ns, limits):
            return "the force sensor is silent"
        if not abs(force.value) < limits.onset_force:
            return f"{force.value:.2f} N on the plate: lift the finger, or tare"
        if limits.need_camera:
            if area is None or _is_old(area, now_ns, limits):
                return "no contact area comes from the camera"
            if area.value > 0.0 and not area.flags & AreaFlag.NO_CONTACT:
                return "something is on the plate: lift the finger and clean the plate"
        return self.camera_apart(limits)


def _is_old(sample: _Sample, now_ns: int, limits: Limits) -> bool:
    return sample.came_ns is None or seconds(now_ns - sample.came_ns) > limits.stale_after
