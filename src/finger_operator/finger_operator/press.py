# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""One press of a guided trial: its events, and every reason for which it is not valid. No ROS."""

from __future__ import annotations

import math
from enum import Enum

from finger_common.contact_threshold import in_contact
from finger_common.flags import AreaFlag
from finger_common.guided_presses import LET_GO, TOO_HARD, GuidedPress
from finger_common.stamps import seconds

from .attempt import Attempt
from .limits import Limits


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

    def add_problem(self, text: str) -> None:
        """Note why the press is not valid; one problem of a kind is enough."""
        if not any(p.split(" ")[:3] == text.split(" ")[:3] for p in self.problems):
            self.problems.append(text)

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
        if attempt.onset_ns is None and in_contact(False, normal_force, limits.onset_force):
            # Before the check for gaps: a gap that ends at the first touch counts.
            attempt.onset_ns = stamp_ns
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
            cue = self._cue(stamp_ns, normal_force, tangential_force)
            if cue is not None:
                self._below_since = None
                return cue
        if in_contact(True, normal_force, liftoff_force=limits.liftoff_force):
            self._below_since = None
        elif self._below_since is None:
            self._below_since = stamp_ns
        elif seconds(stamp_ns - self._below_since) >= limits.release_time:
            attempt.lifted_ns = self._below_since
            return PressEvent.FINGER_OFF
        return None

    def _cue(
        self, stamp_ns: int, normal_force: float, tangential_force: float
    ) -> PressEvent | None:
        """The cue that a sample before the cue to lift brings."""
        if not self._is_held(stamp_ns, normal_force):
            return None
        self.attempt.cue_ns = stamp_ns
        return PressEvent.TARGET_REACHED

    def _is_held(self, stamp_ns: int, normal_force: float) -> bool:
        """Whether the target was reached, and held as long as is asked for."""
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
        self,
        stamp_ns: int,
        area: float,
        flags: int,
        previous_ns: int | None,
        stick_ratio: float = math.nan,
    ) -> None:
        """One contact area in m². previous_ns: stamp of the one before. stick_ratio: NaN if the
        camera does not tell."""
        attempt = self.attempt
        if attempt.onset_ns is None or stamp_ns < attempt.onset_ns:
            return
        began = max(previous_ns or 0, attempt.onset_ns)
        released = self._below_since if attempt.cue_ns is not None else None
        if released is None or stamp_ns < released:
            self._note_frame_gap(seconds(stamp_ns - began))
            if not flags & AreaFlag.NO_CONTACT and area > 0:
                attempt.frames += 1

    def _note_frame_gap(self, gap: float) -> None:
        self.attempt.longest_frame_gap = max(self.attempt.longest_frame_gap, gap)
        if self.limits.need_camera and gap > self.limits.frame_gap_limit:
            self.add_problem(f"camera frames missing for {gap:.2f} s")

    def overdue(self, now_ns: int, in_step: float) -> str:
        """Which limit of time has passed; empty when none.

        now_ns: by the protocol's clock, from call to call. in_step: s since the last cue.
        """
        attempt, limits = self.attempt, self.limits
        if attempt.cue_ns is not None:
            late = in_step > limits.lift_timeout
            return f"finger not lifted within {limits.lift_timeout:g} s of the cue" if late else ""
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

    def verdict(self, newest_area_ns: int | None) -> str:
        """Why the press is not valid, empty when it is; once the finger is off the plate."""
        attempt = self.attempt
        if attempt.cue_ns is None and self._reached is not None:
            return f"lifted before the cue: the force must be held for {self.guided.hold:g} s"
        if attempt.cue_ns is None:
            return (
                f"lifted at {attempt.peak_force:.2f} N, before the target of "
                f"{self.target_force:.2f} N"
            )
        if self.guided.text and attempt.peak_force > TOO_HARD * self.target_force:
            self.add_problem(
                f"pressed too hard: {attempt.peak_force:.2f} N, {self.target_force:.2f} N are asked"
            )
        if self.limits.need_camera:
            assert attempt.lifted_ns is not None and attempt.onset_ns is not None
            # Frames up to lift-off have come by now (release_time), unless the camera stopped.
            newest = max(newest_area_ns or 0, attempt.onset_ns)
            self._note_frame_gap(seconds(attempt.lifted_ns - newest))
            if attempt.frames < self.limits.minimum_frames:
                self.add_problem(
                    f"contact seen in {attempt.frames} frames, "
                    f"{self.limits.minimum_frames} are needed"
                )
        return "; ".join(self.problems)
