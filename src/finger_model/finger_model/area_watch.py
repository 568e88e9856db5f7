# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether measured areas and the force show the same contacts, at the same times."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from finger_common.stamps import nanoseconds, seconds

LARGE = 20e-6
"""m²; a finger that rests with less than the onset force touches less."""

ALONE, AFTER = 2.0, 1.0
"""s for which areas have shown a contact without a force, in all, when it is told, and s after the
end of a force in which they may."""
LONGEST_STEP, FORGOTTEN = 0.5, 60.0
"""s that an area stands for at most, and s after the last of them in which they are forgotten."""

LAG, CONTACTS = 0.2, 3
"""s by which begin and end of a contact differ, both in one direction, and how many contacts in a
row, when it is told: an area that is seen late, but not long, is that of a weak print."""

SHORTEST, SETTLED = 0.3, 2.0
"""s that a contact lasts at least, and s after which both ends of it are known."""


@dataclass
class _Contacts:
    """Contacts of one source: (begin, end) in ns of those that are over, and begin and newest
    stamp of the present one."""

    over: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=8))
    present: tuple[int, int] | None = None

    def add(self, stamp_ns: int, touching: bool) -> None:
        """Follow a contact."""
        if touching:
            self.present = (stamp_ns if self.present is None else self.present[0]), stamp_ns
        elif self.present is not None:
            if seconds(self.present[1] - self.present[0]) >= SHORTEST:
                self.over.append(self.present)
            self.present = None


class AreaWatch:
    """Compares the contacts of the force with those of the areas."""

    def __init__(self) -> None:
        self._newest = 0
        """ns, stamp of the newest force."""
        self._forget()

    def _forget(self) -> None:
        self._force, self._areas = _Contacts(), _Contacts()
        self._touched: int | None = None
        """ns, stamp of the newest force in contact."""
        self._normal = 0.0
        self._alone: tuple[int, float] | None = None
        """Stamp (ns) of the newest area without a force, and the area (m²)."""
        self._alone_for = 0.0
        """s in all, since a force showed a contact."""
        self._pictured = 0
        """ns, stamp of the newest area."""
        self._lags: deque[float] = deque(maxlen=CONTACTS)

    def see_force(self, stamp_ns: int, normal: float, touching: bool) -> None:
        """Look at an estimate: its force (N) and whether it is in contact."""
        if stamp_ns < self._newest:
            self._forget()
        self._newest, self._normal = stamp_ns, normal
        if touching:
            self._touched, self._alone, self._alone_for = stamp_ns, None, 0.0
        self._force.add(stamp_ns, touching)

    def see_area(self, stamp_ns: int, area: float) -> None:
        """Look at an area (m²) that may be used, 0 where the picture shows no contact."""
        self._areas.add(stamp_ns, area > 0.0)
        touched, step = self._touched, seconds(stamp_ns - self._pictured)
        self._pictured = stamp_ns
        if area >= LARGE and (touched is None or seconds(stamp_ns - touched) >= AFTER):
            self._alone = stamp_ns, area
            self._alone_for += min(max(step, 0.0), LONGEST_STEP)

    def look(self) -> dict[str, str]:
        """What is wrong and what to do, empty where nothing is, by the keys "area_alone" and
        "area_lag"."""
        self._compare()
        return {"area_alone": self._of_alone(), "area_lag": self._of_lag()}

    def _compare(self) -> None:
        """Lags of the contacts whose ends are known."""
        settled = self._newest - nanoseconds(SETTLED)
        while self._areas.over and self._areas.over[0][1] < settled:
            seen = self._areas.over.popleft()
            near = [c for c in self._force.over if abs(sum(c) - sum(seen)) < nanoseconds(4.0)]
            if not near:
                continue
            felt = min(near, key=lambda contact: abs(sum(contact) - sum(seen)))
            begin, end = (seconds(a - f) for a, f in zip(seen, felt))
            lag = 0.5 * (begin + end)
            both = min(begin, end) > LAG or max(begin, end) < -LAG
            self._lags.append(lag if both else 0.0)

    def _of_alone(self) -> str:
        if self._alone is None:
            return ""
        stamp, area = self._alone
        if seconds(self._newest - stamp) > FORGOTTEN:
            self._alone, self._alone_for = None, 0.0
        # The silence of a force is told as such.
        if self._alone_for < ALONE or seconds(stamp - self._newest) > AFTER:
            return ""
        return (
            f"contact_area has shown a contact for {self._alone_for:.0f} s, of {area * 1e6:.0f} "
            f"mm², and the force none ({self._normal:.3f} N now): check sensor, its unit (N), "
            "normal_axis and tare; where no finger is, clean the plate"
        )

    def _of_lag(self) -> str:
        lags = sorted(self._lags)
        if len(lags) < CONTACTS or not (lags[0] > 0.0 or lags[-1] < 0.0):
            return ""
        lag = lags[CONTACTS // 2]
        later = "later" if lag > 0.0 else "earlier"
        return (
            f"contact_area shows contacts {abs(lag):.1f} s {later} than the force, by the stamps "
            "of both: stamp each image when it is taken, and each force when it is measured"
        )
