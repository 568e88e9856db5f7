# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How a pad that is not round lies on a plate that is not level."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from finger_common.errors import InputError

LARGEST_TILT = math.radians(45.0)
ASPECTS = (0.5, 2.0)


@dataclass(frozen=True)
class Pose:
    """Third dimension of a pad and of its plate.

    aspect: lateral semi-axis of pad, skin, bone and nail along x over the one along y, which is
    that of the geometry. pitch, roll: tilt of the plate in rad; the plate's normal is turned about
    y by pitch (its side at +x rises), then about x by roll (its side at +y rises). Raises
    InputError for what is no number, for an aspect outside 0.5 … 2, and for pitch, roll or tilt
    beyond 45°.
    """

    aspect: float = 1.0
    pitch: float = 0.0
    roll: float = 0.0

    def __post_init__(self) -> None:
        for name in ("aspect", "pitch", "roll"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
                raise InputError(f"pose: '{name}' is {value!r}; give a number")
        low, high = ASPECTS
        if not low <= self.aspect <= high:
            raise InputError(f"pad aspect is {self.aspect:g}, outside {low:g} … {high:g}")
        most = math.degrees(LARGEST_TILT)
        # An angle in degrees may look like a small tilt after whole turns.
        for name, angle in (("pitch", self.pitch), ("roll", self.roll)):
            if abs(angle) > LARGEST_TILT:
                raise InputError(
                    f"plate {name} is {angle:.4g} rad, which is {math.degrees(angle):.4g}°, beyond "
                    f"{most:g}°; tilt the plate less"
                )
        if not self.tilt <= LARGEST_TILT:
            raise InputError(
                f"plate tilt is {math.degrees(self.tilt):g}°, beyond {most:g}°; tilt the plate less"
            )

    @cached_property
    def axes(self) -> np.ndarray:
        """Axes x', y', z' of the plate (rows, 3 × 3) in axes of the finger; z' is its normal."""
        cp, sp = math.cos(self.pitch), math.sin(self.pitch)
        cr, sr = math.cos(self.roll), math.sin(self.roll)
        about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, sr], [0.0, -sr, cr]])
        return about_y @ about_x

    @property
    def tilt(self) -> float:
        """Angle (rad) between the plate's normal and the finger's axis; NaN if not finite."""
        normal = self.axes[2]
        return math.atan2(math.hypot(normal[0], normal[1]), normal[2])

    @property
    def symmetric(self) -> bool:
        """Whether y = 0 is a plane of symmetry of finger and plate."""
        return self.roll == 0.0
