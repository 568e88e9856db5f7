# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Area, outline and centre of pressure of an elliptical pad on a tilted plate.

The round pad on a level plate, with the same force and history, is known (the reduced model). What
aspect and tilt change is a correction of it: sums of terms of what the plate first touches (Hertz's
contact would need no more; `touch`) times powers of the depth s = √(A₀/π)/a, contact radius over
half the width of the round pad. Their coefficients depend on finger and pose (`networks`). They are
learned from the three-dimensional model (`scripts/pose_truth.py`, `scripts/pose_linear.py`), with
fingers from all over the population box. Without aspect and tilt the correction is none.
"""

from __future__ import annotations

import functools
import math
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np

from finger_common.files import load_json

from ..geometry import Geometry
from ..reduced.population import BOX, Range, lengths_of
from .networks import SKIN_RATIOS, inputs, outputs
from .pose import Pose
from .touch import Touch, first_touch

FILE = Path(str(resources.files("finger_model") / "data" / "pose_correction.json"))
"""Learned networks; `scripts/pose_correction.py` writes it."""

LARGEST_DEPTH = 0.65
"""s from which on the correction stays as it is: few of those learned from are larger."""

POWERS = 3
"""Powers 0, 1 and 2 of s."""

LARGEST_ASPECT, LARGEST_LEARNED_TILT = 1.6, math.radians(30.0)
"""Up to which the correction was learned."""
STEEP = 0.5
"""How far aside the first touch lies (see `Touch`) from which the correction is worse."""
AREA_SD, STEEP_AREA_SD = 0.012, 0.08
"""Of ln of the area, before STEEP and beyond: root mean square errors of the fingers kept aside."""
SMALLEST_ASPECT = 0.95
"""Learned was 1 and more, but the estimate of a round pad is now and then below. There the default
finger's areas are within 1.4 % of those in three dimensions, at 0.92 within 1.9 %."""


class Outline(NamedTuple):
    """Contact of a pad in a pose (SI); vectors in axes of the plate, from the foot of the normal
    through the pad's centre.

    semi_axes: of the ellipse with the contact's second moments, the larger first; orientation
    (rad): of the larger one from x, −π/2…π/2; center (2,): of the contact; center_of_pressure
    (2,): point without torque of the pressure.
    """

    area: float
    semi_axes: tuple[float, float]
    orientation: float
    center: np.ndarray
    center_of_pressure: np.ndarray


@functools.cache
def layers() -> list[np.ndarray]:
    """Layers of the learned networks, see `networks.outputs`. They give coefficients (POWERS, 12):
    of the `area_terms`, the `shape_terms`, and the `center_terms` of centre and of pressure."""
    return [np.array(layer) for layer in load_json(FILE, "pose correction")["layers"]]


def area_terms(touch: Touch) -> np.ndarray:
    """Terms (n,) of ln(area over that of the round pad)."""
    b, k, u = touch.bluntness, touch.thickness, _size(touch.aside)
    long, along = touch.elongation @ touch.elongation, touch.elongation @ touch.aside
    return np.array([b, float(long), u, u * u, k, float(along)])


def shape_terms(touch: Touch) -> np.ndarray:
    """Terms (n, 2) of ln(a/b) times cosine and sine of twice the orientation."""
    return np.array([touch.elongation, touch.aside])


def center_terms(touch: Touch) -> np.ndarray:
    """Terms (n,) of the centre's coordinates over those of the first touch, and of the centre of
    pressure's."""
    return np.array([1.0, _size(touch.aside)])


@functools.lru_cache(maxsize=64)
def is_learned(geometry: Geometry) -> bool:
    """Whether a finger's proportions lie in the population box; its size does not matter."""
    skin, width = BOX["epidermis_thickness"], BOX["pad_semi_axis_radial"]
    lengths = lengths_of(geometry)
    thickness = lengths.pop("epidermis_thickness") / lengths.pop("pad_semi_axis_radial")
    inside = thickness in Range(skin.low / width.high, skin.high / width.low, "")
    inside = inside and all(value in BOX[name] for name, value in lengths.items())
    return inside and geometry.bone_center_height == 0.0 and geometry.nail_thickness > 0.0


def _size(vector: np.ndarray) -> float:
    return math.hypot(vector[0], vector[1])


class PoseCorrection:
    """Correction for one finger and one pose; `area_polynomial` (3,): coefficients of 1, s, s² in
    ln(area over that of the round pad on a level plate). skin_ratio: of the finger's material, see
    `ConstitutiveLaw.skin_ratio`. stretch_sd: what the lengths leave unknown, see `lengths`."""

    def __init__(
        self, geometry: Geometry, pose: Pose, skin_ratio: float, stretch_sd: float = 0.0
    ) -> None:
        self.geometry, self.pose, self.skin_ratio = geometry, pose, skin_ratio
        self.stretch_sd = stretch_sd
        self.touch = first_touch(geometry, pose)
        self.half_width = geometry.pad_semi_axis_radial
        of_terms = outputs(layers(), inputs(geometry, skin_ratio, pose, self.touch))
        of_terms = of_terms.reshape(POWERS, -1)
        self.area_polynomial = of_terms[:, :6] @ area_terms(self.touch)
        self._shape = of_terms[:, 6:8] @ shape_terms(self.touch)
        terms = center_terms(self.touch)
        self._center, self._pressure = of_terms[:, 8:10] @ terms, of_terms[:, 10:] @ terms
        self._polynomial: list[float] = self.area_polynomial.tolist()

    @property
    def inside(self) -> bool:
        """Whether the correction was learned for such a finger and pose."""
        fits = SMALLEST_ASPECT * (1 - 1e-9) <= self.pose.aspect <= LARGEST_ASPECT * (1 + 1e-9)
        return fits and self.inside_but_for_aspect(self.pose.tilt)

    def inside_but_for_aspect(self, tilt: float) -> bool:
        """Whether one was learned for such a finger at this tilt (rad), with some aspect."""
        low_tilt = tilt <= LARGEST_LEARNED_TILT * (1 + 1e-9)
        low, high = SKIN_RATIOS
        known_skin = low * (1 - 1e-9) <= self.skin_ratio <= high * (1 + 1e-9)
        return low_tilt and known_skin and is_learned(self.geometry)

    @property
    def area_sd(self) -> float:
        """Standard deviation of the correction of ln of the area; 0 where there is none."""
        if not self.area_polynomial.any():
            return 0.0
        return AREA_SD if _size(self.touch.aside) <= STEEP else STEEP_AREA_SD

    def depth(self, round_area: float) -> float:
        """s of a round pad on a level plate with this area (m²)."""
        return min(math.sqrt(max(round_area, 0.0) / math.pi) / self.half_width, LARGEST_DEPTH)

    def log_area(self, round_area: float) -> float:
        """ln of the area in this pose over that of the round pad, round_area (m²)."""
        s = self.depth(round_area)
        first, linear, square = self._polynomial
        return first + s * (linear + s * square)

    def round_area(self, area: float) -> float:
        """Area (m²) of the round pad on a level plate where this pad has `area`."""
        found = area
        for _ in range(20 if self.area_polynomial.any() else 0):
            found = area * math.exp(-self.log_area(found))
        return found

    def outline(self, round_area: float) -> Outline:
        """Contact where the round pad on a level plate has `round_area` (m²)."""
        s = self.depth(round_area)
        powers = s ** np.arange(POWERS)
        area = round_area * math.exp(self.log_area(round_area))
        double = powers @ self._shape
        ratio = math.exp(_size(double))
        minor = math.sqrt(area / (math.pi * ratio))
        return Outline(
            area,
            (minor * ratio, minor),
            0.5 * math.atan2(double[1], double[0]),
            self.touch.place * float(powers @ self._center),
            self.touch.place * float(powers @ self._pressure),
        )
