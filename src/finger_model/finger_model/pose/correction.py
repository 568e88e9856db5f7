# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Area, outline and centre of pressure of an elliptical pad on a tilted plate.

The round pad on a level plate, with the same force and history, is known (the reduced model). What
aspect and tilt change is a correction of it, in two parts: how the unloaded pad is curved where the
plate touches it (`touch`; Hertz's contact would need no more), and smooth functions of the depth
s = √(A₀/π)/a, contact radius over half the width of the round pad, learned from the
three-dimensional model (`scripts/pose_truth.py`). Without aspect and tilt the correction is none.
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
from .pose import Pose
from .touch import Touch, first_touch

FILE = Path(str(resources.files("finger_model") / "data" / "pose_correction.json"))
"""Learned coefficients; `scripts/pose_correction.py` writes it."""

LARGEST_DEPTH = 0.65
"""s from which on the correction stays as it is: it was learned to 0.6."""

AREA_TERMS = tuple("b,b s,b s²,e²,e² s,u,u s,u s²,u²,u² s,u² s²,b u,b u s".split(","))
"""Of ln(area over that of the round pad): b bluntness, e elongation, u aside of `Touch`."""

SHAPE_TERMS = tuple("e,e s,e s²,u,u s,|u| u,|u| u s,|u| e,|u| e s".split(","))
"""Of ln(a/b) times cosine and sine of twice the orientation."""

CENTER_TERMS = tuple("1,s,s²,u,u s,u s²,b,b s".split(","))
"""Of the centre's coordinates over those of the first touch, and of the centre of pressure's."""

LARGEST_ASPECT, LARGEST_TILT = 1.6, math.radians(30.0)
"""Up to which the correction was learned; a smaller aspect than 1 was not."""

LEARNED, OTHER_HEIGHT, OTHER_SKIN = Geometry(), 0.1, 1.9
"""The finger that it was learned for, and by how much (relative) another one's height over width,
and by which factor its skin over width, may differ. Fingers of the same proportions have the same
correction."""


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
    """Learned coefficients by the names "area", "shape", "center" and "pressure"."""
    data = load_json(FILE, "pose correction")
    return {name: np.array(values) for name, values in data["coefficients"].items()}


def area_terms(touch: Touch, s: float) -> np.ndarray:
    """Values of AREA_TERMS."""
    b, e, u = touch.bluntness, float(touch.elongation @ touch.elongation), _size(touch.aside)
    of_depth = np.array([1.0, s, s * s])
    return np.concatenate(
        [b * of_depth, e * of_depth[:2], u * of_depth, u * u * of_depth, b * u * of_depth[:2]]
    )


def shape_terms(touch: Touch, s: float) -> np.ndarray:
    """Values (2, n) of SHAPE_TERMS."""
    e, u = touch.elongation, touch.aside
    far = _size(u)
    return np.stack(
        [e, e * s, e * s * s, u, u * s, far * u, far * u * s, far * e, far * e * s], axis=1
    )


def center_terms(touch: Touch, s: float) -> np.ndarray:
    """Values (n,) of CENTER_TERMS."""
    u, b = _size(touch.aside), touch.bluntness
    return np.array([1.0, s, s * s, u, u * s, u * s * s, b, b * s])


def _has_learned_proportions(geometry: Geometry) -> bool:
    def proportions(finger: Geometry) -> np.ndarray:
        lengths = np.array([finger.pad_semi_axis_axial, finger.epidermis_thickness])
        return lengths / finger.pad_semi_axis_radial

    height, skin = proportions(geometry) / proportions(LEARNED)
    return abs(height - 1.0) < OTHER_HEIGHT and 1.0 / OTHER_SKIN < skin < OTHER_SKIN


def _size(vector: np.ndarray) -> float:
    return math.hypot(vector[0], vector[1])


class PoseCorrection:
    """Correction for one finger and one pose; `area_polynomial` (3,): coefficients of 1, s, s² in
    ln(area over that of the round pad on a level plate)."""

    def __init__(self, geometry: Geometry, pose: Pose) -> None:
        self.pose = pose
        self.touch = first_touch(geometry, pose)
        self.half_width = geometry.pad_semi_axis_radial
        self._known_finger = _has_learned_proportions(geometry)
        learned = coefficients()
        at = [float(area_terms(self.touch, s) @ learned["area"]) for s in (0.0, 1.0, -1.0)]
        linear, square = 0.5 * (at[1] - at[2]), 0.5 * (at[1] + at[2]) - at[0]
        self.area_polynomial = np.array([at[0], linear, square])
        self._polynomial: tuple[float, float, float] = (at[0], linear, square)

    @property
    def inside(self) -> bool:
        """Whether the correction was learned for such a finger and pose."""
        low_tilt = self.pose.tilt <= LARGEST_TILT * (1 + 1e-9)
        fits = 1.0 <= self.pose.aspect <= LARGEST_ASPECT * (1 + 1e-9)
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
        learned, s = coefficients(), self.depth(round_area)
        area = round_area * math.exp(self.log_area(round_area))
        double = shape_terms(self.touch, s) @ learned["shape"]
        ratio = math.exp(math.hypot(double[0], double[1]))
        minor = math.sqrt(area / (math.pi * ratio))
        terms = center_terms(self.touch, s)
        return Outline(
            area,
            (minor * ratio, minor),
            0.5 * math.atan2(double[1], double[0]),
            self.touch.place * float(terms @ learned["center"]),
            self.touch.place * float(terms @ learned["pressure"]),
        )
