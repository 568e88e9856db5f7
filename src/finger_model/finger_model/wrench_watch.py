# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is wrong with a stream of wrenches that its estimates do not show: stamps, frames, axis."""

from __future__ import annotations

import time
from collections.abc import Callable

from finger_common.axes import opposite
from finger_common.stamps import seconds

DROPPED = 0.1
"""Share of samples left out from which it is said; single ones are late by accident."""

ACROSS, ALONG = 0.5, 0.1
"""N of lateral force that lasts, and the share of it that a normal force has at least: a friction
coefficient of 10 is none of a finger."""

ACROSS_FOR = 2.0
"""s for which such forces have lasted, in all, when it is told."""

PULLS, PULLS_FOR = 3, 1.0
"""Forces below -ACROSS with rest between them, and the s they have lasted in all, when they are
told: an untared sensor does not rest near zero, and a finger that sticks was pressed before."""
REST = 0.1
"""N below zero at which such a force has ended."""

PRESSED = 0.2
"""N along the axis that show a press, which lets these forces be forgotten: a plate that sticks
pulls less as a finger leaves it."""
FORGOTTEN = 60.0
"""s after the last of them in which they are forgotten."""

LONGEST_STEP = 0.1
"""s; a sample stands for no longer."""

SHOWN, SHORT = 3, 40
"""Frames that are named of several, and characters of each."""


class WrenchWatch:
    """Counts faults of a stream of wrenches since the last `look`. clock: time in s."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._looked = clock()
        self._came = self._dropped = 0
        self._stamps: tuple[int, int] | None = None
        self._frames: dict[str, None] = {}
        """In the order seen."""
        self._newest_frame: str | None = None
        self.largest = 0.0
        """N, largest normal force since the last `look`."""
        self._seen = 0
        self.forget()

    def forget(self) -> None:
        """Forget forces across the normal axis or against it: it may be another one now."""
        self._doubted = 0
        """ns, stamp of the newest."""
        self._across_for = self._pulled_for = 0.0
        self._across = (0.0, 0.0)
        self._pulls, self._pulling, self._pull = 0, False, 0.0

    def add(self, stamp_ns: int, frame: str, dropped: bool) -> None:
        """Count a sample; dropped: whether it gave no estimate."""
        self._came += 1
        self._dropped += dropped
        known = self._stamps
        if known is None:
            self._stamps = stamp_ns, stamp_ns
        elif not known[0] <= stamp_ns <= known[1]:
            self._stamps = min(known[0], stamp_ns), max(known[1], stamp_ns)
        if frame != self._newest_frame:
            self._newest_frame = frame
            self._frames[frame] = None

    def see(self, stamp_ns: int, normal: float, lateral: float) -> None:
        """Look at the force of an estimate, N along and across the normal axis."""
        passed = min(max(seconds(stamp_ns - self._seen), 0.0), LONGEST_STEP)
        self._seen = stamp_ns
        if normal > self.largest:
            self.largest = normal
        if lateral > ACROSS and abs(normal) < ALONG * lateral:
            self._doubted = stamp_ns
            self._across_for += passed
            self._across = normal, lateral
        elif normal < -ACROSS:
            self._doubted = stamp_ns
            self._pulls += not self._pulling
            self._pulling = True
            self._pulled_for += passed
            self._pull = min(self._pull, normal)
        elif normal > PRESSED or not 0.0 <= seconds(stamp_ns - self._doubted) <= FORGOTTEN:
            self.forget()
        elif normal > -REST:
            self._pulling = False

    def look(self, normal_axis: str) -> dict[str, str]:
        """What is wrong and what to do, empty where nothing is, by the keys "wrench_stamps",
        "wrench_frames" and "normal_axis"; counts anew."""
        now = self._clock()
        found = {
            "wrench_stamps": self._of_stamps(max(now - self._looked, 1e-3)),
            "wrench_frames": self._of_frames(),
            "normal_axis": self._of_axis(normal_axis),
        }
        self._looked, self._came, self._dropped, self._stamps = now, 0, 0, None
        self.largest = 0.0
        self._frames = {} if self._newest_frame is None else {self._newest_frame: None}
        return found

    def _of_stamps(self, passed: float) -> str:
        if self._stamps is None or self._dropped <= DROPPED * self._came or self._came < 3:
            return ""
        first, last = self._stamps
        came = f"{self._came / passed:.0f} wrench messages a second arrive"
        remedy = "give each the time of its measurement"
        if first == last:
            how = "0" if last == 0 else "alike"
            return f"{came}, all stamped {how}, and are left out: {remedy}"
        return (
            f"{came}, and {self._dropped / self._came:.0%} are stamped no later than the one "
            f"before, or far ahead, and are left out: {remedy}, from one publisher"
        )

    def _of_frames(self) -> str:
        frames = list(self._frames)
        if len(frames) < 2:
            return ""
        shown = [repr(f if len(f) <= SHORT else f"{f[:SHORT]}…") for f in frames[:SHOWN]]
        if len(frames) > SHOWN:
            shown.append(f"{len(frames) - SHOWN} more")
        return (
            f"wrench messages come in the frames {' and '.join(shown)}: let one sensor publish the "
            "topic"
        )

    def _of_axis(self, normal_axis: str) -> str:
        if self._across_for >= ACROSS_FOR:
            normal, lateral = self._across
            return (
                f"a force of {lateral:.2f} N lies across normal_axis ({normal_axis}), "
                f"{normal:.2f} N along it: set normal_axis to the sensor's axis that the finger "
                "presses along, or tare"
            )
        if self._pulls >= PULLS and self._pulled_for >= PULLS_FOR:
            return (
                f"the normal force went below zero {self._pulls} times, to {self._pull:.2f} N, "
                f"without a press: has normal_axis ({normal_axis}) the opposite sign? Set it to "
                f"{opposite(normal_axis)}, or tare"
            )
        return ""
