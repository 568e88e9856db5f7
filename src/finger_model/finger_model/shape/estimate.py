# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What goes into the estimate of shape and pose, an outline, and what comes out of it."""

from __future__ import annotations

import math
from typing import NamedTuple

FARTHEST = 0.25
"""m from the plate's origin, along x and y: no outline lies beyond, since a pad's place
(`PoseSettings.pad_x`, `pad_y`) is at most 0.1 m from it."""

SMALLEST_AXIS, LARGEST_AXIS = 1e-4, 0.06
"""m, of the outlines of fingers; the widest pad of the population box measures 24 mm."""


class MeasuredOutline(NamedTuple):
    """Outline of a contact in the plate's axes: centre (2,) (m), major and minor full axis (m),
    angle (rad) of the major one from +x towards +y, and their standard deviations."""

    center: tuple[float, float]
    major: float
    minor: float
    angle: float
    center_sd: float
    major_sd: float
    minor_sd: float

    @property
    def known(self) -> bool:
        """Whether there is an outline: no number is NaN, and the axes are not both 0."""
        return not any(map(math.isnan, (*self.center, *self[1:]))) and any((self.major, self.minor))

    @property
    def implausible(self) -> str:
        """What shows that a known outline is not a finger's in SI units, as in "center 640 m";
        empty where nothing does."""
        for value in self.center:
            if not abs(value) <= FARTHEST:
                return f"center {value:.3g} m"
        for name, axis in (("major", self.major), ("minor", self.minor)):
            if not SMALLEST_AXIS <= axis <= LARGEST_AXIS:
                return f"{name} axis {axis:.3g} m"
        if self.minor > self.major:
            return f"minor axis {self.minor:.3g} m, longer than the major one"
        if not abs(self.angle) <= 2.0 * math.pi:
            return f"angle {self.angle:.3g} rad"
        for name in ("center_sd", "major_sd", "minor_sd"):
            if not 0.0 < getattr(self, name) <= FARTHEST:
                return f"{name} {getattr(self, name):.3g} m"
        return ""

    @property
    def usable(self) -> bool:
        """Whether all numbers are known and may be a finger's."""
        return self.known and not self.implausible


NO_OUTLINE = MeasuredOutline((math.nan, math.nan), *(math.nan,) * 6)


class ShapeEstimate(NamedTuple):
    """Shape of the contact at one instant (SI): the fields of ContactShape.msg, in its order.

    The message is made of these by name: to add a field, add it here and there, and to the copy in
    src/finger_bag/finger_bag/data/finger_msgs. center, center_of_pressure (2,): in the plate.
    """

    stamp_ns: int
    area: float
    semi_axis_major: float
    semi_axis_minor: float
    angle: float
    center: tuple[float, float]
    center_of_pressure: tuple[float, float]
    pad_aspect: float
    pad_aspect_stddev: float
    pitch: float
    pitch_stddev: float
    roll: float
    roll_stddev: float
    flags: int
