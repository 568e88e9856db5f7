# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A finger and tissue inside the population box that the reduced model cannot follow to the force
limit: a slow load reaches the bone before it."""

from finger_model.geometry import Geometry
from finger_model.laws import StandardLinearSolid

THIN = Geometry(
    pad_semi_axis_radial=6.8e-3,
    pad_semi_axis_axial=4.9e-3,
    epidermis_thickness=0.3e-3,
    bone_semi_axis_radial=3.2e-3,
    bone_semi_axis_axial=2.2e-3,
    nail_radius=5.6e-3,
)
YIELDING = StandardLinearSolid(E0=273e3, E1=19.7e3, tau1=0.0046, E2=109e3, friction=0.05)
