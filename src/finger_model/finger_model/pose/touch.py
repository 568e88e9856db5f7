# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Where a level or tilted plate first touches an ellipsoidal pad, and how the pad is curved there.

The unloaded pad is the lower half of an ellipsoid, (x/aR)² + (y/a)² + (z/c)² = 1. The plate, of
normal n, touches it where the gradient is parallel to n. With S = diag(aR, a, c) that is at
−S² n / h, h² = nᵀ S² n, and the curvature there, in the axes e₁, e₂ of the plate, is
h eᵢᵀ S⁻² eⱼ.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..geometry import Geometry
from .pose import Pose


class Touch(NamedTuple):
    """First touch of a pad and a plate; vectors in axes of the plate, see `Pose`.

    place (2,): m, from the foot of the normal through the pad's centre. bluntness: logarithm of
    the curvature of a round pad on a level plate over the geometric mean of the two curvatures.
    elongation (2,): half the logarithm of the larger over the smaller curvature, times cosine and
    sine of twice the direction of the smaller one, along which the contact is longer. aside
    (2,): squared distance of the place from the pad's axis over that of the pad's side in its
    direction, 0 at the tip and 1 at the side, times cosine and sine of twice its direction.
    thickness: logarithm of the distance between the planes along the plate that touch pad and bone,
    over that on a level plate.
    """

    place: np.ndarray
    bluntness: float
    elongation: np.ndarray
    aside: np.ndarray
    thickness: float


def first_touch(geometry: Geometry, pose: Pose) -> Touch:
    """First touch of a finger and a plate in this pose."""
    a, c = geometry.pad_semi_axis_radial, geometry.pad_semi_axis_axial
    squares = np.array([a * pose.aspect, a, c]) ** 2
    axes = pose.axes
    lateral, normal = axes[:2], axes[2]
    height = math.sqrt(normal @ (squares * normal))
    place = lateral @ (-squares * normal / height)
    curvature = height * (lateral / squares) @ lateral.T
    smaller, larger = np.linalg.eigvalsh(curvature)
    long = 0.5 * math.log(larger / smaller)
    # The direction of the smaller curvature, from the traceless part.
    difference = np.array([curvature[1, 1] - curvature[0, 0], -2.0 * curvature[0, 1]])
    size = float(np.hypot(*difference))
    elongation = long * difference / size if size > 1e-12 * larger else np.zeros(2)
    on_pad = -squares * normal / height
    far = float((on_pad[:2] ** 2 / squares[:2]).sum())
    x, y = place
    way = float(x * x + y * y)
    double = np.array([x * x - y * y, 2.0 * x * y]) / way if way > 0 else np.zeros(2)
    flat = c / a**2
    bluntness = -0.5 * math.log(smaller * larger / flat**2)
    return Touch(place, bluntness, elongation, far * double, _thickness(geometry, pose, height))


def _thickness(geometry: Geometry, pose: Pose, height: float) -> float:
    across, up = geometry.bone_semi_axis_radial, geometry.bone_semi_axis_axial
    bone, normal = np.array([across * pose.aspect, across, up]), pose.axes[2]
    raised = geometry.bone_center_height
    level = geometry.pad_semi_axis_axial - up + raised
    return math.log((height - float(np.linalg.norm(bone * normal)) + raised * normal[2]) / level)
