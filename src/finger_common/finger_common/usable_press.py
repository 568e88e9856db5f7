# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a recorded press must have to be fitted: `finger_fit` leaves out a trial without it, and the
guided protocol repeats it at once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .flags import AreaFlag

LONGEST_GAP = 0.05
"""s without force during the contact that a trial may have; a slow sensor's period is no gap."""

FEWEST_FRAMES = 3
"""Frames with a measured area from first touch to the target."""

LONGEST_HOLE = 1.5
"""Periods of the camera between two frames from which a frame was dropped."""

TYPICAL_AREA_NOISE = 1.5e-6
"""m², standard deviation of a measured area, independent from frame to frame; an assumption that
stands where the noise is not known."""


@dataclass(frozen=True)
class Frames:
    """Measured areas (m,) in m² of a recording, with their times in s and flags, in their order."""

    time: np.ndarray
    area: np.ndarray
    flags: np.ndarray

    @property
    def empty(self) -> np.ndarray:
        """Mask (m,) of the frames without a contact."""
        # An area of 0 is none, also from a segmenter that sets no flags.
        return ((self.flags & AreaFlag.NO_CONTACT) != 0) | (self.area <= 0.0)

    @property
    def measured(self) -> np.ndarray:
        """Mask (m,) of the frames with an area."""
        return np.isfinite(self.area) & ~self.empty

    @property
    def period(self) -> float:
        """Time (s) between frames; infinite where there are not two."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else math.inf


def frames_of_press(
    frames: Frames,
    onset: float,
    liftoff: float,
    reached: float | None = None,
    longest: float = 0.0,
    fewest: int = FEWEST_FRAMES,
) -> tuple[np.ndarray, str]:
    """Find the frames (k,) of a press, as indices, and why they cannot be fitted, empty where they
    can.

    onset, liftoff: times in s of the contact's begin and end. reached: of its target force, for the
    frames up to the first one at or after it; None for all. longest: s between two frames, 0 for
    LONGEST_HOLE. fewest: frames that are needed.
    """
    time, longest = frames.time, longest or LONGEST_HOLE * frames.period
    inside = (time >= onset) & (time <= liftoff)
    if reached is not None:
        after = time[time >= reached]
        if not len(after) or after[0] > reached + longest:
            return np.flatnonzero(inside), "no frame at the target force"
        inside &= time <= after[0]
    found = np.flatnonzero(inside)
    if len(found) < fewest:
        return found, f"{len(found)} frames in the contact, at least {fewest} are needed"
    hole = float(np.diff(time[found]).max(initial=0.0))
    if hole > longest:
        number = max(round(hole / frames.period) - 1, 1)
        words = "1 frame was" if number == 1 else f"{number} frames in a row were"
        return found, f"{words} dropped during the press"
    clipped = int(((frames.flags[found] & AreaFlag.CLIPPED) != 0).sum())
    if clipped:
        return found, f"the contact runs over the image border in {clipped} frames"
    measured = int(frames.measured[found].sum())
    if measured < fewest:
        return found, (
            f"areas were measured in {measured} frames of the contact, at least {fewest} are needed"
        )
    return found, ""
