# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""One press of a guided trial: its events, and every reason for which it is not valid. No ROS."""

from __future__ import annotations

import math
from enum import Enum

import numpy as np

from finger_common.contact_threshold import in_contact
from finger_common.guided_presses import LET_GO, TOO_HARD, GuidedPress
from finger_common.stamps import nanoseconds, seconds
from finger_common.usable_press import Frames, frames_of_press

from .attempt import Attempt
from .force_window import ForceWindow
from .limits import Limits

SHORT = 0.02
"""s over whose mean a force counts as reached, so that no single sample does: as much as a fit
smooths."""

REST = 0.5
"""s over which the force of the free plate is averaged, and over which a force is steady."""

STEADY = 0.02
"""N by which a steady force changes within REST."""

LONGEST_EDGE = 3.5
"""Periods of the camera at begin and end of a press without a frame: the last ones of a slow
computer may still be on their way."""

LARGEST_REST = 0.15
"""N; a steady force beyond it is that of a finger, where the camera does not say otherwise."""


class PressEvent(Enum):
    """What a force sample brings about."""

    TARGET_REACHED = 1
    FINGER_OFF = 2
    PULL_BEGINS = 3


class Press:
    """Follows the press of an attempt and writes its stamps, forces and counts into it.

    guided: what is asked for. limits: may be replaced during the press.
    """

    def __init__(self, attempt: Attempt, guided: GuidedPress, limits: Limits) -> None:
        self.attempt = attempt
        self.guided = guided
        self.target_force = guided.target_force
        self.limits = limits
        self._reached: int | None = None
        self._touch_came: int | None = None
        self.problems: list[str] = []
        self._below_since: int | None = None
        self._touching = False
        self._began: int | None = None
        """Stamp of the first sample of the contact, the last one where it was interrupted."""
        self._peak_before: float | None = None
        """N, largest force until the finger was off the plate after the cue to lift."""
        self._newest: float | None = None
        self._largest_fall = 0.0
        self._short, self._recent = ForceWindow(SHORT), ForceWindow(REST)
        self._highest = 0.0
        self._rest_before = math.nan
        self._frames: list[tuple[int, float, int]] = []

    def add_problem(self, text: str) -> None:
        """Note why the press is not valid; one problem of a kind is enough."""
        if not any(p.split(" ")[:3] == text.split(" ")[:3] for p in self.problems):
            self.problems.append(text)

    def add_rest(self, stamp_ns: int, normal_force: float) -> None:
        """One force in N of the free plate, before the cue to press."""
        self._recent.add(stamp_ns, normal_force)
        self._rest_before = self._recent.mean

    def forget_rest(self) -> None:
        """The plate was not free."""
        self._recent.clear()
        self._rest_before = math.nan

    def add_force(
        self,
        stamp_ns: int,
        normal_force: float,
        previous_ns: int | None,
        tangential_force: float = 0.0,
    ) -> PressEvent | None:
        """One force sample in N, NaN for an invalid one. previous_ns: stamp of the one before."""
        attempt, limits = self.attempt, self.limits
        if not math.isfinite(normal_force):
            self.add_problem("the force sensor reported invalid samples")
            return None
        self._follow(stamp_ns, normal_force)
        if attempt.onset_ns is None:
            # Before the check for gaps: a gap that ends at the first touch counts.
            attempt.onset_ns = self._began
        if attempt.onset_ns is not None and previous_ns is not None:
            gap = seconds(stamp_ns - previous_ns)
            attempt.longest_gap = max(attempt.longest_gap, gap)
            if gap > limits.gap_limit:
                self.add_problem(f"force samples missing for {gap:.2f} s")
            elif gap <= 0:
                self.add_problem("force stamps went back")
        attempt.samples += 1
        attempt.peak_force = max(attempt.peak_force, normal_force)
        if attempt.onset_ns is None:
            return None
        if attempt.cue_ns is None:
            cue = self._give_cue(stamp_ns, normal_force, tangential_force)
            if cue is not None:
                self._below_since = None
                return cue
        if in_contact(True, normal_force, liftoff_force=limits.liftoff_force):
            self._below_since = None
        elif self._below_since is None:
            self._below_since = stamp_ns
            if attempt.cue_ns is not None:
                self._peak_before = attempt.peak_force
        elif seconds(stamp_ns - self._below_since) >= limits.release_time:
            attempt.lifted_ns = self._below_since
            return PressEvent.FINGER_OFF
        return None

    def _follow(self, stamp_ns: int, normal_force: float) -> None:
        """Note what is judged when the finger is off."""
        limits = self.limits
        was = self._touching
        self._touching = in_contact(was, normal_force, limits.onset_force, limits.liftoff_force)
        if self._touching and not was and self.attempt.cue_ns is None:
            self._began = stamp_ns
        if self._newest is not None:
            self._largest_fall = max(self._largest_fall, self._newest - normal_force)
        if self._peak_before is not None and normal_force > self._peak_before:
            self.add_problem("pressed again, and harder, before the finger was off")
        self._newest = normal_force
        for window in (self._short, self._recent):
            window.add(stamp_ns, normal_force)
        self._highest = max(self._highest, self._short.mean)

    def fell_by(self, force: float) -> bool:
        """Whether the force fell by about as much (N) from one sample to the next, as no finger
        lets it: the zero was set to a force."""
        return self._largest_fall >= 0.5 * force

    def _give_cue(
        self, stamp_ns: int, normal_force: float, tangential_force: float
    ) -> PressEvent | None:
        """Give the cue that a sample before the cue to lift brings, and note its stamp."""
        if not self._hold_target(stamp_ns, normal_force):
            return None
        self.attempt.cue_ns = stamp_ns
        return PressEvent.TARGET_REACHED

    def _hold_target(self, stamp_ns: int, normal_force: float) -> bool:
        """Follow the force to the target and while it is held, and note what was not as is asked
        for; whether it was held long enough."""
        guided, onset = self.guided, self.attempt.onset_ns
        assert onset is not None
        if self._reached is None and normal_force >= self.target_force:
            self._reached = stamp_ns
            rise = seconds(stamp_ns - onset)
            fastest, slowest = guided.rise
            if rise < fastest:
                self.add_problem(
                    f"pressed too fast: {rise:.1f} s, at least {fastest:g} s are asked"
                )
            elif rise > slowest:
                self.add_problem(f"pressed too slowly: {rise:.1f} s, {slowest:g} s at most")
        if self._reached is None:
            return False
        if normal_force < LET_GO * self.target_force:
            held = seconds(stamp_ns - self._reached)
            self.add_problem(f"let go after {held:.1f} of {guided.hold:g} s")
        return seconds(stamp_ns - self._reached) >= guided.hold

    def add_area(
        self, stamp_ns: int, area: float, flags: int, stick_ratio: float = math.nan
    ) -> None:
        """One contact area in m². stick_ratio: NaN if the camera does not tell."""
        self._frames.append((stamp_ns, area, flags))

    def see_time(self, now_ns: int, in_step: float) -> str:
        """Tell the press the time; which of its limits has passed, empty when none.

        now_ns: by the protocol's clock, from call to call. in_step: s since the last cue.
        """
        attempt, limits = self.attempt, self.limits
        if attempt.cue_ns is not None:
            if in_step <= limits.lift_timeout:
                return ""
            return f"finger not lifted within {limits.lift_timeout:g} s of the cue{self._stays()}"
        if attempt.onset_ns is None:
            late = in_step > limits.press_timeout
            return f"no press within {limits.press_timeout:g} s" if late else ""
        if self._touch_came is None:  # stamps may be of another clock
            self._touch_came = now_ns
        if seconds(now_ns - self._touch_came) > limits.target_timeout + self.guided.hold:
            return (
                f"target not reached within {limits.target_timeout:g} s: "
                f"{attempt.peak_force:.2f} of {self.target_force:.2f} N"
            )
        return ""

    def _stays(self) -> str:
        """That the force stands still as on a free plate, to be added to a sentence; empty where it
        does not."""
        level = self._recent.mean
        seen = self._sorted_frames().measured[-2:]
        free = len(seen) == 2 and not seen.any()
        if not self._recent.unrest <= STEADY or not (free or abs(level) <= LARGEST_REST):
            return ""
        moved = level if math.isnan(self._rest_before) else level - self._rest_before
        return (
            f": the force stays at {level:.2f} N; if the finger is off the plate, the zero moved "
            f"by {moved:+.2f} N: tare"
        )

    def with_problems(self, reason: str) -> str:
        """Why the press is not valid: what was noticed on the way, then the reason for its end."""
        return "; ".join(filter(None, [*self.problems, reason]))

    def judge(self) -> str:
        """Judge the press once the finger is off the plate: count its frames, compare the zeros;
        why it is not valid, empty when it is."""
        attempt, target = self.attempt, self.target_force
        self._judge_zero()
        if self.guided.text and attempt.peak_force > TOO_HARD * target:
            self.add_problem(
                f"pressed too hard: {attempt.peak_force:.2f} N, {target:.2f} N are asked"
            )
        # Frames up to lift-off have come by now (release_time), unless the camera stopped.
        self._judge_frames()
        return self.with_problems(self._unfinished())

    def _unfinished(self) -> str:
        """Why the finger was off too early; empty where it was not."""
        attempt = self.attempt
        if attempt.cue_ns is not None:
            return ""
        if self._reached is not None:
            return f"lifted before the cue: the force must be held for {self.guided.hold:g} s"
        return (
            f"lifted at {attempt.peak_force:.2f} N, before the target of {self.target_force:.2f} N"
        )

    def _judge_zero(self) -> None:
        """Compare the free plate after the press with that before it, and both with the target."""
        assert self._below_since is not None
        # The second half: the finger leaves the plate in the first one.
        free_since = self._below_since + nanoseconds(0.5 * self.limits.release_time)
        after, before = self._recent.mean_since(free_since), self._rest_before
        if abs(after - before) > self.limits.zero_limit:
            self.add_problem(f"the zero moved by {after - before:+.2f} N: tare")
        known = [level for level in (before, after) if math.isfinite(level)]
        zero = sum(known) / len(known) if known else 0.0
        # A fit takes a zero off only where it is steady: a negative one gives no press its target.
        zero = max(zero, 0.0)
        reached = self._highest - zero
        if self.attempt.cue_ns is not None and reached < self.target_force:
            self.add_problem(
                f"the force reached {reached:.2f} of {self.target_force:.2f} N where single "
                f"samples and the zero of {zero:.2f} N are left out"
            )

    def _sorted_frames(self) -> Frames:
        """All frames since the cue to press, times in s from the first contact."""
        frames = sorted(self._frames)
        stamps = np.array([stamp for stamp, _, _ in frames], np.int64)
        return Frames(
            (stamps - (self._began or 0)) * 1e-9,
            np.array([area for _, area, _ in frames], float),
            np.array([flags for _, _, flags in frames], np.int64),
        )

    def _judge_frames(self) -> None:
        """By the rules of a fit, and to the end of the press."""
        attempt, limits, began = self.attempt, self.limits, self._began
        assert began is not None and attempt.lifted_ns is not None
        frames, lifted = self._sorted_frames(), seconds(attempt.lifted_ns - began)
        pressed = (frames.time >= 0.0) & (frames.time <= lifted)
        attempt.frames = int(np.count_nonzero(frames.measured & pressed))
        times = np.concatenate([[0.0], frames.time[pressed], [lifted]])
        attempt.longest_frame_gap = gap = float(np.diff(times).max())
        if not limits.need_camera or attempt.cue_ns is None:
            return
        # A fit uses the frames up to the target, where a calibration uses all of the press.
        windows: list[float | None] = [None]
        if self._reached is not None and not self.guided.text:
            windows.insert(0, seconds(self._reached - began))
        for until in windows:
            _, fault = frames_of_press(
                frames, 0.0, lifted, until, limits.frame_gap_limit, limits.minimum_frames
            )
            if fault:
                self.add_problem(fault)
                return
        if gap > (limits.frame_gap_limit or LONGEST_EDGE * frames.period):
            self.add_problem(f"camera frames missing for {gap:.2f} s")
