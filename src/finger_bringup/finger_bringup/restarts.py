# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How long a process that ended by itself stays down before it is started again. No ROS.

Read by `finger-rig up` and by the launch files alike.
"""

from __future__ import annotations

from finger_common.cli import EXIT_BAD_INPUT
from finger_common.retry import Pauses

FIRST_DELAY = 1.0
"""s before the first restart; doubled for each further one."""

LONGEST_DELAY = 15.0
"""s, where the doubling ends."""

BEGINS_WITHIN = 30.0
"""s within which a process that cannot begin ends."""

STABLE_AFTER = 60.0
"""s without an end after which the delay is FIRST_DELAY again."""


class RestartDelay(Pauses):
    """Delays of one process."""

    def __init__(self, first: float = FIRST_DELAY, longest: float = LONGEST_DELAY) -> None:
        super().__init__(first, longest)
        self._ends = 0

    def note_end(self, code: int, duration: float) -> bool:
        """Note an end of the process with this exit code after `duration` (s); whether it stays
        down: it could not begin at its first start, as with a parameter file that cannot be read.
        """
        self._ends += 1
        return code == EXIT_BAD_INPUT and self._ends == 1 and duration < BEGINS_WITHIN

    def after_running(self, duration: float) -> float:
        """Delay in s before the restart of a process that ran for `duration` (s)."""
        if duration > STABLE_AFTER:
            self.reset()
        return self.next()
