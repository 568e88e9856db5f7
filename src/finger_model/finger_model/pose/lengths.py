# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the lengths of a finger leave unknown of how far a tilt moves its contact.

A plate tilted by a small angle t first touches a pad, of half the width a and the height c, at
t (a²/c − c) from the foot of the normal through the pad's centre. Of two fingers that are pressed
alike in the same pose the distances of the contacts, and of the centres of pressure, differ by
nearly the same factor in every pose and at every force.
"""

from __future__ import annotations

import math

from ..geometry import Geometry, StatedGeometry

PEOPLE_SD = 0.21
"""Of the logarithm of that factor, between the fingers of people and the default one: what a tilt
found by the contact's place is wrong by, as a share of it (`scripts/pose_people.py`)."""

PAD = "pad_semi_axis_radial", "pad_semi_axis_axial"


def stretch_sd(geometry: Geometry, stated: StatedGeometry | None) -> float:
    """Standard deviation of the logarithm of that factor, for a finger taken to have these lengths.

    stated: what a geometry.yaml states, None without. The deviations of the pad's width and height
    count, as independent ones, where it states both for this finger; or else those between people.
    """
    if stated is None or stated.geometry.hash() != geometry.hash():
        return PEOPLE_SD
    if not set(PAD) <= set(stated.deviations):
        return PEOPLE_SD
    radial, axial = (stated.deviations[name] for name in PAD)
    a, c = geometry.pad_semi_axis_radial, geometry.pad_semi_axis_axial
    distance = abs(a * a / c - c)
    error = math.hypot(2.0 * a / c * radial, (a * a / (c * c) + 1.0) * axial)
    # A pad nearly as deep as wide rolls like a ball, and has no such factor.
    return error / max(distance, error) if error else 0.0
