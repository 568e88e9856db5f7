# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Host time that steps of the system clock do not reach."""

from __future__ import annotations

import time
from collections.abc import Callable

from .stamps import nanoseconds, seconds

NOTABLE_STEP = 0.05
"""s of a step of the system clock that is worth a warning."""


class HostClock:
    """Nanoseconds since the epoch that only ever increase.

    The offset between the steady clock and the wall clock is taken once. Slewing (NTP) moves both
    alike; a *step* of the wall clock does not reach the stamps and is reported by `step`. A suspend
    is one too: the steady clock stands still in it.
    """

    def __init__(
        self, wall: Callable[[], int] = time.time_ns, steady: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._wall = wall
        self._steady = steady
        self._offset = wall() - steady()

    def now(self) -> int:
        """Time now, ns since the epoch."""
        return self._steady() + self._offset

    def of_stamp(self, wall_ns: int | None, earliest: int) -> int:
        """This clock's time of an event that an interface stamped with wall time a moment ago.

        The time now, where there is no stamp or it lies before `earliest` or in the future: some
        adapters count from their own start.
        """
        now = self.now()
        if wall_ns is None:
            return now
        stamp = now - (self._wall() - wall_ns)
        return stamp if earliest <= stamp <= now else now

    def of_wall(self, wall_ns: int) -> int:
        """This clock's time of a moment in wall time as it is now; the same without a step."""
        step = self.step()
        return wall_ns - nanoseconds(step) if abs(step) > NOTABLE_STEP else wall_ns

    def step(self) -> float:
        """Seconds by which the wall clock has been stepped since this clock was made."""
        before, wall, after = self.now(), self._wall(), self.now()
        # A busy machine may take long between two readings.
        return seconds(wall - min(max(wall, before), after))

    def step_warning(self, what: str) -> str:
        """Sentence that names a step of the wall clock; empty where there is none to speak of.

        what: the times that do not follow it, such as "stamps".
        """
        step = self.step()
        if abs(step) <= NOTABLE_STEP:
            return ""
        suspended = " or the computer was suspended" if step > 0.0 else ""
        return (
            f"the system clock was stepped by {step:+.3f} s{suspended}; {what} continue as before, "
            "restart all nodes to follow it"
        )
