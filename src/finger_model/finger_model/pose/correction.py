# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Area, outline and centre of pressure of an elliptical pad on a tilted plate.

The round pad on a level plate, with the same force and history, is known (the reduced model). What
aspect and tilt change is a correction of it: products of what the plate first touches (`touch`;
Hertz's contact would need no more), of the finger's proportions, and of powers of the depth
s = √(A₀/π)/a, contact radius over half the width of the round pad. Their coefficients are learned
from the three-dimensional model (`scripts/pose_truth.py`), with fingers from all over the
population box. Without aspect and tilt the correction is none.
"""

from __future__ import annotations

import functools
import itertools
import math
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np

from finger_common.files import load_json

from ..geometry import Geometry
from ..reduced.population import BOX, NAIL_INSIDE, Range, lengths_of
from .pose import Pose
from .touch import Touch, first_touch

FILE = Path(str(resources.files("finger_model") / "data" / "pose_correction.json"))
"""Learned coefficients; `scripts/pose_correction.py` writes it."""

LARGEST_DEPTH = 0.65
"""s from which on the correction stays as it is: few of those learned from are larger."""

SKIN_RATIOS = (12.0, 120.0)
"""Moduli of the epidermis over that of the tissue, E₂/E, of the fingers learned from; a ratio
outside is held at the end."""

MIDDLE_SKIN_RATIO = 60.0
"""By which the proportions are scaled."""

POWERS = 3
"""Powers 0, 1 and 2 of s."""

LARGEST_ASPECT, LARGEST_TILT = 1.6, math.radians(30.0)
"""Up to which the correction was learned."""
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
def coefficients() -> dict[str, np.ndarray]:
    """Learned coefficients (POWERS, terms, proportions) by the names "area", "shape", "center" and
    "pressure"."""
    data = load_json(FILE, "pose correction")
    return {name: np.array(values) for name, values in data["coefficients"].items()}


def proportions(geometry: Geometry, skin_ratio: float) -> np.ndarray:
    """1, the finger's proportions, about −1 to 1 in the population box, and their products (n,):
    depth of the pad, the length over which the skin bends, t (E₂/E)^⅓, width and depth of the bone,
    and width of the nail, which holds the pad's sides. `DEGREES` are theirs."""
    a, c = geometry.pad_semi_axis_radial, geometry.pad_semi_axis_axial
    nail = min(geometry.nail_radius, NAIL_INSIDE * geometry.bulk_semi_axes[0])
    ratio = min(max(skin_ratio, SKIN_RATIOS[0]), SKIN_RATIOS[1])
    bending = geometry.epidermis_thickness * (ratio / MIDDLE_SKIN_RATIO) ** (1 / 3)
    single = [
        2.0 * math.log(c / (0.7 * a)),
        0.7 * math.log(bending / (0.06 * a)),
        4.0 * (geometry.bone_semi_axis_radial / a - 0.4),
        4.0 * (geometry.bone_semi_axis_axial / c - 0.4),
        5.0 * (nail / a - 0.78),
    ]
    pairs = itertools.combinations_with_replacement(single, 2)
    return np.array([1.0, *single, *(x * y for x, y in pairs)])


DEGREES = np.array([0] + 5 * [1] + 15 * [2])
"""Of the `proportions` as polynomials."""


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


def is_learned(geometry: Geometry) -> bool:
    """Whether a finger's proportions lie in the population box; its size does not matter."""
    skin, width = BOX["epidermis_thickness"], BOX["pad_semi_axis_radial"]
    lengths = lengths_of(geometry)
    thickness = lengths.pop("epidermis_thickness") / lengths.pop("pad_semi_axis_radial")
    inside = thickness in Range(skin.low / width.high, skin.high / width.low, "")
    inside = inside and all(value in BOX[name] for name, value in lengths.items())
    return inside and geometry.bone_center_height == 0.0 and geometry.nail_thickness > 0.0


@functools.lru_cache(maxsize=64)
def of_finger(geometry: Geometry, skin_ratio: float) -> tuple[dict[str, np.ndarray], bool]:
    """Coefficients (POWERS, terms) of a finger by the names of `coefficients`, and whether it is
    among those that were learned."""
    low, high = SKIN_RATIOS
    known_skin = low * (1 - 1e-9) <= skin_ratio <= high * (1 + 1e-9)
    finger = proportions(geometry, skin_ratio)
    learned = {name: values @ finger for name, values in coefficients().items()}
    return learned, known_skin and is_learned(geometry)


def _size(vector: np.ndarray) -> float:
    return math.hypot(vector[0], vector[1])


class PoseCorrection:
    """Correction for one finger and one pose; `area_polynomial` (3,): coefficients of 1, s, s² in
    ln(area over that of the round pad on a level plate). skin_ratio: of the finger's material, see
    `ConstitutiveLaw.skin_ratio`."""

    def __init__(self, geometry: Geometry, pose: Pose, skin_ratio: float) -> None:
        self.geometry, self.pose, self.skin_ratio = geometry, pose, skin_ratio
        self.touch = first_touch(geometry, pose)
        self.half_width = geometry.pad_semi_axis_radial
        learned, self._known_finger = of_finger(geometry, skin_ratio)
        self.area_polynomial = learned["area"] @ area_terms(self.touch)
        self._shape = learned["shape"] @ shape_terms(self.touch)
        terms = center_terms(self.touch)
        self._center, self._pressure = learned["center"] @ terms, learned["pressure"] @ terms
        self._polynomial: list[float] = self.area_polynomial.tolist()

    @property
    def inside(self) -> bool:
        """Whether the correction was learned for such a finger and pose."""
        low_tilt = self.pose.tilt <= LARGEST_TILT * (1 + 1e-9)
        fits = SMALLEST_ASPECT * (1 - 1e-9) <= self.pose.aspect <= LARGEST_ASPECT * (1 + 1e-9)
        return self._known_finger and low_tilt and fits

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
