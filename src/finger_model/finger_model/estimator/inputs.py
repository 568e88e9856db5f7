# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Measured areas and moisture readings that wait for the wrench sample at which they enter."""

from __future__ import annotations

import bisect
import math
from collections import Counter, deque
from collections.abc import Iterable
from operator import itemgetter

import numpy as np

from finger_common.flags import AreaFlag
from finger_common.moisture import is_moisture
from finger_common.stamps import NANOSECONDS

from . import stream
from .events import EstimatorEvent

HELD_STEP, LONGEST_HOLD = 50_000_000, 250_000_000
"""ns. Equal areas in steps of up to HELD_STEP are one picture, which a recorder wrote again and
again; after LONGEST_HOLD it counts once more, for the contact before a fast camera may rest."""

_UNSEEN = AreaFlag.NO_CONTACT | AreaFlag.LOW_CONTRAST
"""Flags of a picture in which a contact may be all the same, such as one of a dim plate."""

_stamp = itemgetter(0)
_NO_AREAS = np.zeros(0, stream.AREA)


class InputQueue:
    """Areas and readings in the order of their stamps (ns), until they are due.

    An input of stamp t is due at the first wrench sample stamped t + `delay` (ns) or later; one
    that comes after such a sample is late and is not used. `counters` counts what was left out.
    `fuse` and `rejected_flags` say what becomes of areas that are due.
    """

    def __init__(self, counters: Counter[str]) -> None:
        self.delay = 0
        self.fuse = True
        self.rejected_flags = 0
        self.counters = counters
        self._areas: list[tuple[int, float, float, int]] = []
        self._moistures: list[tuple[int, float]] = []
        self._area_stamps: deque[int] = deque(maxlen=64)
        self._last_area: tuple[int, float, float, int] | None = None
        self._last_seen = 0
        self._known_late: set[tuple[str, int]] = set()
        self._pauses: list[tuple[int, ...]] = []

    def is_late(self, stamp_ns: int, newest: int | None) -> bool:
        """Whether an input of this stamp is late; newest: stamp of the newest wrench sample."""
        return newest is not None and stamp_ns + self.delay <= newest

    def knows_late(self, kind: str, stamp_ns: int) -> bool:
        """Whether, by a recorded event, this "area" or "moisture" came too late."""
        paused = kind == "area" and any(a <= stamp_ns <= b for a, b in self._pauses)
        return paused or (kind, stamp_ns) in self._known_late

    def expect_late(self, events: Iterable[EstimatorEvent]) -> None:
        """Leave out the inputs that came too late according to these recorded events."""
        for event in events:
            if event.is_pause:
                self._pauses.append(event.late_areas)
            self._known_late.update(("area", stamp) for stamp in event.late_areas)
            self._known_late.update(("moisture", stamp) for stamp in event.late_moistures)
        # A pause is told at its end, when some of its areas wait already.
        self._areas = [area for area in self._areas if not self.knows_late("area", area[0])]

    def count_duplicate(self, stamp_ns: int) -> bool:
        """Count an area of a stamp that came before; whether this is one."""
        if stamp_ns not in self._area_stamps:
            return False
        self.counters["duplicate_areas"] += 1
        return True

    def add_area(self, stamp_ns: int, area: float, sd: float, flags: int) -> None:
        """Let an area (m²) wait. What its flags mean is decided when it is due."""
        self._area_stamps.append(stamp_ns)
        bisect.insort(self._areas, (int(stamp_ns), float(area), float(sd), int(flags)), key=_stamp)

    def take_areas(self, other: InputQueue) -> None:
        """Let the areas that wait in another queue wait here."""
        self._areas, self._area_stamps = other._areas.copy(), other._area_stamps.copy()
        self._last_area, self._last_seen = other._last_area, other._last_seen

    def forget_areas_before(self, stamp_ns: int) -> None:
        """Remove areas of earlier stamps, which no wrench sample will need."""
        del self._areas[: bisect.bisect_left(self._areas, stamp_ns, key=_stamp)]

    def add_moisture(self, stamp_ns: int, value: float) -> bool:
        """Let a reading (a.u.) wait; false for a value that is not on the scale of the probe."""
        if not is_moisture(value):
            self.counters["bad_moistures"] += 1
            return False
        bisect.insort(self._moistures, (int(stamp_ns), float(value)))
        return True

    def take_due_areas(self, stamp_ns: int) -> np.ndarray:
        """Remove and return the areas (k,) due at a wrench sample of this stamp, but for repeated
        ones. Rejected ones are NO_CONTACT where the picture shows none, and NaN otherwise, as where
        none could be seen."""
        number = bisect.bisect_right(self._areas, stamp_ns - self.delay, key=_stamp)
        if not number:
            return _NO_AREAS
        due = [area for area in self._areas[:number] if not self._count_repeated(area)]
        del self._areas[:number]
        if not self.fuse:
            return _NO_AREAS
        found = np.array([area[:3] for area in due], stream.AREA)
        for row, (*_, flags) in enumerate(due):
            if flags & self.rejected_flags:
                self.counters["flagged_areas"] += 1
                empty = flags & _UNSEEN == AreaFlag.NO_CONTACT
                found["area"][row] = stream.NO_CONTACT if empty else math.nan
        return found

    def _count_repeated(self, area: tuple[int, float, float, int]) -> bool:
        """Count an area that is the last one once more; whether this is one. Called for each, in
        the order of stamps."""
        stamp, seen, last = area[0], self._last_seen, self._last_area
        self._last_seen = stamp
        equal = last is not None and area[1:] == last[1:] and stamp - last[0] < LONGEST_HOLD
        if equal and stamp - seen <= HELD_STEP:
            self.counters["duplicate_areas"] += 1
            return True
        self._last_area = area
        return False

    def take_due_moisture(self, stamp_ns: int) -> tuple[int, float] | None:
        """Remove and return the next reading that is due at this stamp, None without one."""
        if self._moistures and self._moistures[0][0] + self.delay <= stamp_ns:
            return self._moistures.pop(0)
        return None

    def next_moisture_due(self) -> int | None:
        """Stamp of a wrench sample from which the next reading is due."""
        return self._moistures[0][0] + self.delay if self._moistures else None

    def jump_back(self, stamp_ns: int) -> None:
        """Keep only the inputs within one second of `stamp_ns`, to which time jumped back."""

        def near(item: tuple) -> bool:
            return abs(item[0] - stamp_ns) < NANOSECONDS

        self._area_stamps.clear()
        self._last_area = None
        self._pauses.clear()
        self._areas = [area for area in self._areas if near(area)]
        self._moistures = [reading for reading in self._moistures if near(reading)]
