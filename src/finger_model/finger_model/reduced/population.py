# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The population box: which fingers the shipped reduced model serves, and what it sees of one.

Everything over the pad's radial semi-axis L and the instantaneous modulus E0 of the bulk tissue: a
finger is ten numbers, the context, beside the load F/(E0 L²) and the state of the tissue.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from finger_common.errors import InputError

from ..geometry import Geometry
from ..laws import ConstitutiveLaw, MaxwellLaw, StandardLinearSolid
from ..laws.generalized_maxwell import STIFFENING_RANGE
from ..paper import SEARCH_BOX

CONTEXT = (
    "pad aspect",
    "ln epidermis thickness",
    "bone width",
    "bone depth",
    "nail radius",
    "ln nail bending stiffness",
    "friction",
    "ln E2/E0",
    "stiffening",
    "stiffening share",
)
"""What the networks see of a finger, in this order."""

MIDDLE_FRICTION = 0.15
MIDDLE_STIFFENING = 3.0
"""Friction μ enters as μ/(μ + MIDDLE_FRICTION), stiffening b as b/(b + MIDDLE_STIFFENING)."""

LEAST_NAIL, MOST_NAIL = 1e-2, 1e4
"""Bending stiffness E_n (t/L)³/E0 of the nail: beyond these, more changes nothing."""


@dataclass(frozen=True)
class Range:
    """Lowest and highest value of a length ratio or length, and the words for it."""

    low: float
    high: float
    what: str
    unit: str = ""

    def __contains__(self, value: float) -> bool:
        """Whether a value lies inside, but for rounding."""
        return self.low * (1 - 1e-9) <= value <= self.high * (1 + 1e-9)


BOX = {
    "pad_semi_axis_radial": Range(5e-3, 12e-3, "half the width of the pad", "mm"),
    "aspect": Range(0.55, 1.0, "'pad_semi_axis_axial' over 'pad_semi_axis_radial'"),
    "epidermis_thickness": Range(0.25e-3, 1e-3, "thickness of the epidermis", "mm"),
    "bone_radial": Range(0.25, 0.55, "'bone_semi_axis_radial' over 'pad_semi_axis_radial'"),
    "bone_axial": Range(0.25, 0.55, "'bone_semi_axis_axial' over 'pad_semi_axis_axial'"),
    "nail_radius": Range(0.58, 0.97, "'nail_radius' over 'pad_semi_axis_radial'"),
}
"""Lengths of the fingers that the model is trained on."""


LARGEST_LOAD = (10.0, 0.3)
"""F/(E∞ L²) up to which the model is used, and its relative rise by one of stiffening b."""


def largest_force(slow_scale: float, stiffening: float) -> float:
    """Largest force (N) that the model is used for; slow_scale: E∞ L² (N)."""
    soft, rise = LARGEST_LOAD
    return slow_scale * soft * (1.0 + rise * stiffening)


MIDDLE_LENGTHS = (6e-3, 10e-3)
"""m, `pad_semi_axis_radial` of the middle of the box: fingers 12 to 20 mm wide."""
MIDDLE = {name: (low / 1.5, high * 1.5) for name, (low, high) in SEARCH_BOX.items()}
"""Moduli of the middle: the paper's box, widened by half."""
MIDDLE_FORCE = 2.0
"""N, largest force for which the stated error of the middle holds."""

FRICTION = (0.0, 1.0)
NAIL_MODULUS = (1e7, 2e9)

OUTSIDE = (
    "build a reduced model of this finger with 'finger-model reduce' and give its file with "
    "--model (simulate: --reduced-model, or --solver full)"
)


def lengths_of(geometry: Geometry) -> dict[str, float]:
    """A finger's lengths and ratios, as BOX names them."""
    a, c = geometry.pad_semi_axis_radial, geometry.pad_semi_axis_axial
    return {
        "pad_semi_axis_radial": a,
        "aspect": c / a,
        "epidermis_thickness": geometry.epidermis_thickness,
        "bone_radial": geometry.bone_semi_axis_radial / a,
        "bone_axial": geometry.bone_semi_axis_axial / c,
        "nail_radius": geometry.nail_reach / a,
    }


def check_geometry(geometry: Geometry) -> None:
    """Raise InputError naming the length that lies outside the box."""
    for name, value in lengths_of(geometry).items():
        limits = BOX[name]
        if value not in limits:
            factor = 1e3 if limits.unit else 1.0
            unit = f" {limits.unit}" if limits.unit else ""
            raise InputError(
                f"geometry: {limits.what} is {value * factor:.3g}{unit}, outside the population "
                f"box of the shipped reduced model ({limits.low * factor:g} … "
                f"{limits.high * factor:g}{unit}); {OUTSIDE}"
            )
    if geometry.bone_center_height != 0.0:
        raise InputError(
            f"geometry: 'bone_center_height' is {geometry.bone_center_height:g} m, the shipped "
            f"reduced model is for 0; {OUTSIDE}"
        )
    if geometry.nail_thickness <= 0.0:
        raise InputError(
            f"geometry: 'nail_thickness' is 0, the shipped reduced model is for a finger with a "
            f"nail; {OUTSIDE}"
        )


def check_fixed(fixed: dict[str, float]) -> None:
    """Raise InputError naming the fixed property of the material that the model does not serve."""
    limits = {"friction": FRICTION, "nail_modulus": NAIL_MODULUS, "stiffening": STIFFENING_RANGE}
    default = StandardLinearSolid().to_dict()
    for name, value in fixed.items():
        low, high = limits.get(name, (default.get(name, value),) * 2)
        if not low <= value <= high:
            span = f"{low:g}" if low == high else f"{low:g} … {high:g}"
            raise InputError(
                f"material: '{name}' is {value:g}, the shipped reduced model is for {span}; use "
                "--solver full"
            )


def region_of(geometry: Geometry, material: MaxwellLaw, force: float) -> str:
    """ "middle" or "whole": the part of the box whose stated error holds for a finger up to a force
    (N)."""
    low, high = MIDDLE_LENGTHS
    inside = within(material, MIDDLE) and low <= geometry.pad_semi_axis_radial <= high
    return "middle" if inside and force <= MIDDLE_FORCE else "whole"


def within(material: MaxwellLaw, box: Mapping[str, tuple[float, float]]) -> bool:
    """Whether the moduli of a material lie in a box of E0, E1 and E2 (Pa); E1 is that of a standard
    linear solid of the same long-term modulus."""
    share = material.long_term_fraction
    E0 = material.instantaneous_modulus
    moduli = {"E0": E0, "E2": material.epidermis_modulus}
    if share < 1.0:
        moduli["E1"] = E0 * share / (1.0 - share)
    return all(
        box[name][0] * (1 - 1e-9) <= value <= box[name][1] * (1 + 1e-9)
        for name, value in moduli.items()
    )


def context_of(geometry: Geometry, material: ConstitutiveLaw) -> np.ndarray:
    """Context (10,) of a finger, as CONTEXT names it."""
    assert isinstance(material, MaxwellLaw)
    length, axial = geometry.pad_semi_axis_radial, geometry.pad_semi_axis_axial
    modulus = material.instantaneous_modulus
    bending = material.nail_modulus * (geometry.nail_thickness / length) ** 3 / modulus
    stiffening = material.stiffening / (material.stiffening + MIDDLE_STIFFENING)
    return np.array(
        [
            axial / length,
            math.log(geometry.epidermis_thickness / length),
            geometry.bone_semi_axis_radial / length,
            geometry.bone_semi_axis_axial / axial,
            geometry.nail_reach / length,
            math.log(min(max(bending, LEAST_NAIL), MOST_NAIL)),
            material.friction / (material.friction + MIDDLE_FRICTION),
            math.log(material.epidermis_modulus / modulus),
            stiffening,
            stiffening * material.long_term_fraction,
        ]
    )
