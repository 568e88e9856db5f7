# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tangential stiffness of a finger whose contact sticks, under a sudden small load.

That of linear theory (`LinearShear`) for the contact that linear theory (`LinearContact`) has at
the same indentation δ, its radius being a, times exp(SPREADING (a/L)²): this is K₀. The load P
takes a part of it, as a pressed pillar leans easily: exp(−SOFTENING P/(K₀ L)) is left. It is the
present load, so that what the tissue has relaxed of P takes nothing. `scripts/shear_stiffness.py`
has the error against the three-dimensional model.
"""

from __future__ import annotations

import functools

import numpy as np

from ..fem.linear_contact import LinearContact
from ..fem.linear_shear import LinearShear
from ..geometry import Geometry
from ..laws import MaxwellLaw
from ..laws.law import NAIL_MODULUS_RANGE
from ..material import Material

DEPTHS = 0.01 * np.exp(np.linspace(0.0, np.log(40.0), 32))
"""δ/L of the curves; their logarithms are evenly spaced."""
MIDDLE = 18
"""Number of the depth, 0.085 L, whose stiffness tells what relaxes of it."""
SKIN_RATIOS = np.exp(np.linspace(np.log(4.0), np.log(1500.0), 6))
"""E₂/E0 of the curves of a table; beyond them the last one holds."""
NAIL_STEP = 0.25
"""Step of the logarithm of nail over skin; half of it changes K by 1 to 3 %."""
SPREADING, SOFTENING = 0.66, 0.82
"""Least squares over 28 fingers of the population box, elastic ones and ones that relax, at δ/L of
0.05 to 0.15 in the three-dimensional model."""


@functools.lru_cache(maxsize=16)
def _elements(geometry: Geometry) -> tuple[LinearContact, LinearShear]:
    return LinearContact(geometry), LinearShear(geometry)


@functools.lru_cache(maxsize=256)
def _table(geometry: Geometry, nail_ratio: float) -> np.ndarray:
    """ln(K/(E L)) without load (skin ratios, depths); nail_ratio: modulus of the nail over the
    skin's."""
    contact, shear = _elements(geometry)
    skin = Material().E2
    nail = float(np.clip(nail_ratio * skin, *NAIL_MODULUS_RANGE))
    found = []
    materials = [Material(E0=m, E1=m, nail_modulus=nail) for m in skin / SKIN_RATIOS]
    for material, curve in zip(materials, contact.curves(materials, [1.0] * len(materials))):
        modulus = material.instantaneous_modulus
        _, area, depth = curve.T
        radius = contact.length * np.sqrt(np.exp(area) / np.pi)
        stiffness = np.interp(radius, *shear.curve(material).T) / (modulus * contact.length)
        spread = SPREADING * (radius / contact.length) ** 2
        found.append(np.interp(np.log(DEPTHS), depth, np.log(stiffness) + spread))
    return np.array(found)


def shear_curve(geometry: Geometry, material: MaxwellLaw, share: float = 1.0) -> np.ndarray:
    """Tangential stiffness (n,) in N/m at DEPTHS, without load, of a finger that has `share` of its
    tissue's modulus left."""
    modulus, skin = share * material.instantaneous_modulus, material.epidermis_modulus
    # In steps, so that a table serves all skins that moisture makes.
    nail = np.exp(NAIL_STEP * np.round(np.log(material.nail_modulus / skin) / NAIL_STEP))
    table, at = _table(geometry, float(nail)), np.log(SKIN_RATIOS)
    ratio = np.clip(np.log(skin / modulus), at[0], at[-1])
    k = min(int((ratio - at[0]) / (at[1] - at[0])), len(at) - 2)
    along = (ratio - at[k]) / (at[1] - at[0])
    line = (1.0 - along) * table[k] + along * table[k + 1]
    return np.exp(line) * modulus * geometry.pad_semi_axis_radial


def set_finger(finger: np.ndarray, geometry: Geometry, material: MaxwellLaw) -> None:
    """Let a record of `elements.FINGER` be of this finger.

    The skin does not relax, so that more is left of the stiffness than of the tissue's modulus.
    """
    rest = material.long_term_fraction
    sudden, slow = (shear_curve(geometry, material, share) for share in (1.0, rest))
    relaxing = 1.0 - slow[MIDDLE] / sudden[MIDDLE]
    total = sum(branch.fraction for branch in material.branches)
    finger["length"], finger["shear"] = geometry.pad_semi_axis_radial, sudden
    finger["fractions"], finger["times"] = 0.0, 1.0
    for k, branch in enumerate(material.branches):
        finger["fractions"][k] = branch.fraction / total * relaxing
        finger["times"][k] = branch.relaxation_time
