# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Areas or readings that come too late to be used: whether most do, and by how much."""

from __future__ import annotations

from .estimator import EstimatorSettings

LONGEST_DELAY = EstimatorSettings.parameters()["fusion_delay"].maximum
"""s"""

YEAR = 365.25 * 86400.0
"""s; stamps that differ by more are of clocks that count from other times."""


class Lateness:
    """Counts late inputs of one kind since the last `look`. kind: plural name, for messages."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._came = self._late = 0
        self._lag = 0.0

    def add(self, late: bool, lag: float) -> None:
        """Count one; lag: s by which its stamp is behind that of the newest force."""
        self._came += 1
        if late:
            self._late += 1
            self._lag = lag

    def look(self) -> str:
        """What is wrong and what to do where most were late, else empty; counts anew."""
        most = 2 * self._late > self._came
        self._came = self._late = 0
        if not most:
            return ""
        lag = abs(self._lag)
        by = f"{lag:.3g} s" if lag < 100.0 else f"{lag:.0f} s"
        if lag > YEAR:
            by = f"{lag / YEAR:.0f} years"
        where, remedy = "ahead of", ""
        if self._lag >= 0.0:
            where = "behind"
            if LONGEST_DELAY is not None and lag < LONGEST_DELAY:
                remedy = ", or raise fusion_delay"
        return (
            f"{self._kind} are stamped {by} {where} the force and left out: set the clocks of both "
            f"alike{remedy}"
        )
