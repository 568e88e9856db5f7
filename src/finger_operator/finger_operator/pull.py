# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A guided pull: a press that is held, then pulled sideways until the finger slips. No ROS.

While the skin sticks, an even pull lets the ratio |Q|/P of tangential to normal force grow; in slip
it stays at the friction. So the finger slips when the ratio has stood still for a while. Where the
camera follows the ridges and sees skin that sticks, a ratio that stands still is a pull that was
held; where it sees the whole contact slide for as long, the ratio may waver. It sees that a little
before the last skin lets go, and by itself would give too small a friction.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import fmean, stdev

from finger_common.flags import AreaFlag
from finger_common.guided_presses import LET_GO, GuidedPress
from finger_common.stamps import nanoseconds, seconds

from .attempt import Attempt
from .limits import Limits
from .press import Press, PressEvent

STAND_STILL = 0.25
"""s for which the ratio stands still in slip."""

RISE, RISE_SLIDING = 0.03, 0.1
"""Relative change of the ratio within STAND_STILL from which it does not stand still: a pull that
would take 8 s to the slip grows by the first. The second is for a contact that is seen to slide."""

SMALLEST_RATIO = 0.08
"""Below it the pull has not begun: less friction than that of skin on any plate."""

STICKS = 0.3
"""Stick ratio seen by the camera from which the finger does not slip."""

SLIDING_FRAMES = 2
"""Pictures in a row that show the whole contact slide."""


class Pull(Press):
    """Follows a pull as `Press` follows a press; the cue to lift comes with the slip."""

    def __init__(self, attempt: Attempt, guided: GuidedPress, limits: Limits) -> None:
        super().__init__(attempt, guided, limits)
        self._ratios: deque[tuple[int, float]] = deque()
        self._sliding_frames = self._sliding_since = 0
        self._sticks_at: int | None = None
        self.ratio = 0.0

    def _give_cue(
        self, stamp_ns: int, normal_force: float, tangential_force: float
    ) -> PressEvent | None:
        attempt = self.attempt
        if attempt.pull_ns is None:
            if not self._hold_target(stamp_ns, normal_force):
                return None
            attempt.pull_ns = stamp_ns
            return PressEvent.PULL_BEGINS
        if normal_force < LET_GO * self.target_force:
            self._ratios.clear()
            return None
        ratio = tangential_force / normal_force
        if not math.isfinite(ratio):
            self.add_problem("the force sensor reported invalid samples")
            return None
        self.ratio = max(self.ratio, ratio)
        self._ratios.append((stamp_ns, ratio))
        while self._ratios[0][0] < stamp_ns - nanoseconds(STAND_STILL):
            self._ratios.popleft()
        values = self._ratios_in_slip(stamp_ns)
        if not values:
            return None
        attempt.cue_ns = attempt.slip_ns = stamp_ns
        attempt.friction = fmean(values)
        attempt.friction_stddev = stdev(values)
        return PressEvent.TARGET_REACHED

    def _ratios_in_slip(self, stamp_ns: int) -> list[float]:
        """The newest ratios where they stand still, the later half; empty where they do not."""
        begin, _ = self._ratios[0]
        if seconds(stamp_ns - begin) < 0.95 * STAND_STILL or len(self._ratios) < 8:
            return []
        if self._sticks_at is not None and self._sticks_at >= begin:
            return []
        slides = self._sliding_frames >= SLIDING_FRAMES and self._sliding_since <= begin
        # Means over quarters: a single sample is noisy.
        values = [value for _, value in self._ratios]
        part = len(values) // 4
        quarters = [fmean(values[k * part : (k + 1) * part]) for k in range(4)]
        level = quarters[-1]
        change = max(quarters) - min(quarters)
        if level <= SMALLEST_RATIO or change >= (RISE_SLIDING if slides else RISE) * level:
            return []
        return values[2 * part :]

    def add_area(
        self, stamp_ns: int, area: float, flags: int, stick_ratio: float = math.nan
    ) -> None:
        super().add_area(stamp_ns, area, flags, stick_ratio)
        begin = self.attempt.pull_ns
        if begin is None or stamp_ns < begin:
            return
        slides = bool(flags & AreaFlag.SLIDING)
        if slides and not self._sliding_frames:
            self._sliding_since = stamp_ns
        self._sliding_frames = self._sliding_frames + 1 if slides else 0
        if not slides and stick_ratio > STICKS:
            self._sticks_at = stamp_ns

    def see_time(self, now_ns: int, in_step: float) -> str:
        attempt, limits = self.attempt, self.limits
        if attempt.pull_ns is None or attempt.cue_ns is not None:
            return super().see_time(now_ns, in_step)
        if in_step > limits.pull_timeout:
            return f"not slipped within {limits.pull_timeout:g} s: {self._reached_ratio}"
        return ""

    def _unfinished(self) -> str:
        if self.attempt.pull_ns is not None and self.attempt.cue_ns is None:
            return f"lifted before it slipped: {self._reached_ratio}"
        return super()._unfinished()

    @property
    def _reached_ratio(self) -> str:
        return f"the pull reached {self.ratio:.2f} of the normal force"
