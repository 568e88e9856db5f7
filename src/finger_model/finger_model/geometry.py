# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Shape of the finger: what `geometry.yaml` holds, its checks and its hash."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError
from finger_common.files import from_numbers, load_yaml, number, sha256_of

LENGTHS = {
    "pad_semi_axis_radial": "half the width of the pad",
    "pad_semi_axis_axial": "height of the pad, from its flat top down to its tip",
    "epidermis_thickness": "thickness of the stiff outer skin",
    "bone_semi_axis_radial": "half the width of the bone",
    "bone_semi_axis_axial": "height of the bone's lower half",
    "bone_center_height": "height of the bone's centre above the flat top; default 0",
    "nail_radius": "half the width of the nail",
    "nail_thickness": "thickness of the nail",
}
"""Keys of `geometry.yaml`, all in m, and what they mean (drawing: docs/your_finger.md)."""

DEVIATIONS = "deviations"
"""Key of `geometry.yaml` below which the standard deviations (m) of its lengths stand."""

SMALLEST = {
    "pad_semi_axis_radial": 1e-3,
    "pad_semi_axis_axial": 1e-3,
    "bone_semi_axis_radial": 1e-4,
    "bone_semi_axis_axial": 1e-4,
}
"""m; a mesh of smaller ones is none. Other lengths are at least a micrometre, or zero."""

LARGEST = 0.1
"""m; of any length."""

NAIL_INSIDE = 0.97
"""The nail holds the tissue to at most this share of the inner face of the epidermis."""


@dataclass(frozen=True)
class Geometry:
    """Axisymmetric fingertip: half-ellipsoid pad with epidermis, rigid bone and nail disc. Lengths
    in m.

    The axis of symmetry is z, pointing up. The pad is the lower half of an ellipsoid centred at the
    origin, its flat top at z = 0; the plate comes from below. The epidermis has its thickness on
    both semi-axes: inside it is bounded by the half-ellipsoid with semi-axes smaller by the
    thickness. The bone is the lower half of an ellipsoid centred at height `bone_center_height`; a
    centre below the top is continued upwards by a cylinder of the bone's radius, a centre above it
    is cut by the top. The nail is a disc on the top.

    The paper's Table I is not available. The defaults are the typical adult index finger, 17 mm
    wide and 11 mm deep (Dandekar, Raju, Srinivasan 2003), by the rules of `anthropometry`; with
    them the paper's exponents are met (docs/published.md).

    Raises InputError for lengths that are not positive or a bone that does not fit into the pad.
    """

    pad_semi_axis_radial: float = 8.5e-3  # half the width
    pad_semi_axis_axial: float = 5.5e-3  # half the depth
    epidermis_thickness: float = 0.3e-3  # stratum corneum of a finger pad (Adams 2013)
    bone_semi_axis_radial: float = 4.0e-3  # 0.47 of the pad (tuft: Mintalucci 2014)
    bone_semi_axis_axial: float = 2.5e-3  # 0.45 of the pad, an assumption
    bone_center_height: float = 0.0  # assumption
    nail_radius: float = 7.0e-3  # 0.82 of the pad, an assumption
    nail_thickness: float = 0.5e-3  # assumption

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
                raise InputError(f"geometry: '{field.name}' is {value!r}, a length in m is needed")
            object.__setattr__(self, field.name, float(value))
            if not math.isfinite(value):
                raise InputError(f"geometry: '{field.name}' is {value}, a finite length is needed")
        for name in (
            "pad_semi_axis_radial",
            "pad_semi_axis_axial",
            "epidermis_thickness",
            "bone_semi_axis_radial",
            "bone_semi_axis_axial",
        ):
            if getattr(self, name) <= 0:
                raise InputError(
                    f"geometry: '{name}' is {getattr(self, name):g} m, a positive length is needed"
                )
        for name in ("nail_radius", "nail_thickness"):
            if getattr(self, name) < 0:
                raise InputError(
                    f"geometry: '{name}' is {getattr(self, name):g} m, zero or more is needed"
                )
        for name, value in self.to_dict().items():
            least = SMALLEST.get(name, 1e-6)
            if abs(value) > LARGEST or 0 < abs(value) < least:
                raise InputError(
                    f"geometry: '{name}' is {value:g} m, outside {least:g} … {LARGEST:g} m; give "
                    "lengths in metres"
                )
        if self.nail_radius > self.pad_semi_axis_radial:
            raise InputError(
                f"geometry: 'nail_radius' {self.nail_radius:g} m is larger than "
                f"'pad_semi_axis_radial' {self.pad_semi_axis_radial:g} m; make it smaller"
            )
        inner_radial, inner_axial = self.bulk_semi_axes
        smallest = min(self.pad_semi_axis_radial, self.pad_semi_axis_axial)
        if self.epidermis_thickness > 0.5 * smallest:
            raise InputError(
                f"geometry: 'epidermis_thickness' {self.epidermis_thickness:g} m is more than half "
                "the smaller semi-axis of the pad; make it thinner"
            )
        if self.bone_center_height >= self.bone_semi_axis_axial:
            raise InputError(
                f"geometry: 'bone_center_height' {self.bone_center_height:g} m lifts the whole "
                "bone out of the pad; keep it below 'bone_semi_axis_axial'"
            )
        r, z = self.bone_profile(np.linspace(0.0, 1.0, 101))
        # At least 5 % of bulk tissue between bone and epidermis, for a mesh that can be squeezed.
        if np.any((r / inner_radial) ** 2 + (z / inner_axial) ** 2 > 0.95**2):
            raise InputError(
                "geometry: the bone reaches the epidermis (bone larger than the pad); make "
                "'bone_semi_axis_radial' or 'bone_semi_axis_axial' smaller, or raise "
                "'bone_center_height'"
            )

    @property
    def bulk_semi_axes(self) -> tuple[float, float]:
        """Radial and axial semi-axis of the inner face of the epidermis (m)."""
        return (
            self.pad_semi_axis_radial - self.epidermis_thickness,
            self.pad_semi_axis_axial - self.epidermis_thickness,
        )

    @property
    def nail_reach(self) -> float:
        """Radius (m) to which the nail holds the tissue: a wider nail is not grown together with
        the skin at the finger's side."""
        return min(self.nail_radius, NAIL_INSIDE * self.bulk_semi_axes[0])

    @property
    def tip_radius(self) -> float:
        """Radius of curvature of the pad at its lowest point (m)."""
        return self.pad_semi_axis_radial**2 / self.pad_semi_axis_axial

    def bone_profile(self, fraction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (r, z) (n,) in m of the bone's face at fractions (n,) from its tip to the top."""
        fraction = np.asarray(fraction, dtype=float)
        a, b, height = (
            self.bone_semi_axis_radial,
            self.bone_semi_axis_axial,
            self.bone_center_height,
        )
        if height >= 0:
            angle = fraction * math.acos(height / b)
            return a * np.sin(angle), height - b * np.cos(angle)
        arc = 0.5 * math.pi * math.sqrt(0.5 * (a * a + b * b))
        split = arc / (arc - height)
        angle = 0.5 * math.pi * np.minimum(fraction / split, 1.0)
        rise = np.maximum(fraction - split, 0.0) / (1.0 - split)
        return a * np.sin(angle), height - b * np.cos(angle) - height * rise

    @classmethod
    def from_dict(cls, data: dict[str, Any], where: str = "geometry") -> Geometry:
        """From a mapping; keys left out keep their default, unknown keys raise InputError."""
        return from_numbers(cls, data, where)

    @classmethod
    def load(cls, path: str | Path) -> Geometry:
        """Geometry from a YAML file (SI); raises InputError naming file and key."""
        return StatedGeometry.load(path).geometry

    def to_dict(self) -> dict[str, float]:
        """The keys of `geometry.yaml` and their values (m)."""
        return asdict(self)

    def hash(self) -> str:
        """Digest (hexadecimal) of the lengths rounded to 1 nm; names the geometry of a model."""
        return sha256_of({key: round(value * 1e9) for key, value in self.to_dict().items()})


@dataclass(frozen=True)
class StatedGeometry:
    """What a `geometry.yaml` states: the geometry, and the standard deviations (m) of its lengths
    by their keys, of those that it names."""

    geometry: Geometry
    deviations: dict[str, float]

    @classmethod
    def load(cls, path: str | Path) -> StatedGeometry:
        """From a YAML file (SI); raises InputError naming file and key."""
        return cls.from_dict(load_yaml(path, "geometry file"), str(path))

    @classmethod
    def from_dict(cls, data: dict[str, Any], where: str = "geometry") -> StatedGeometry:
        """From the content of such a file; raises InputError for unknown keys and for deviations
        that are none."""
        lengths = {key: value for key, value in data.items() if key != DEVIATIONS}
        stated = data.get(DEVIATIONS, {})
        if not isinstance(stated, dict):
            raise InputError(
                f"{where}: '{DEVIATIONS}' is {stated!r}; give standard deviations in m below it, "
                "as 'key: value' lines"
            )
        geometry = Geometry.from_dict(lengths, where)
        for key in stated:
            if key not in LENGTHS:
                raise InputError(
                    f"{where}: unknown key '{key}' in '{DEVIATIONS}'; the keys are "
                    f"{', '.join(LENGTHS)}"
                )
        deviations = {key: number(stated, key, f"{where}: {DEVIATIONS}") for key in stated}
        for key, value in deviations.items():
            length = abs(getattr(geometry, key))
            if not 0.0 <= value <= (length or LARGEST):
                raise InputError(
                    f"{where}: the deviation of '{key}' is {value:g} m, of a length of "
                    f"{length:g} m; give the standard deviation in m, zero or more"
                )
        return cls(geometry, deviations)
