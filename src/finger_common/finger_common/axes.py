# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The normal axis of a force sensor, and the projection of a force on it."""

from __future__ import annotations

import numpy as np

from .errors import InputError

NORMAL_AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
"""Names of sensor axes along which a pressing finger can give a positive force."""

DEFAULT_NORMAL_AXIS = "-z"
"""A finger on a plate above an ATI sensor pushes the sensor down: Fz is negative under a press."""


def axis_of(normal_axis: str) -> tuple[int, float]:
    """Index (0 x, 1 y, 2 z) and sign (±1) of a normal axis; raises InputError for another name."""
    if normal_axis not in NORMAL_AXES:
        raise InputError(f"normal axis is '{normal_axis}', choose one of {', '.join(NORMAL_AXES)}")
    return "xyz".index(normal_axis[1]), -1.0 if normal_axis[0] == "-" else 1.0


def lateral_axes(normal_axis: str) -> tuple[int, int]:
    """The two axes that follow the normal one (x, y, z in a circle); raises InputError."""
    index, _ = axis_of(normal_axis)
    return (index + 1) % 3, (index + 2) % 3


def normal_force(force: np.ndarray, normal_axis: str) -> np.ndarray:
    """Normal force (…) in N, positive in compression, of forces (…, 3) in sensor axes."""
    index, sign = axis_of(normal_axis)
    return sign * np.asarray(force, dtype=float)[..., index]


def lateral_force(force: np.ndarray, normal_axis: str) -> np.ndarray:
    """Magnitude (…) in N of the force in the plate's plane, of forces (…, 3) in sensor axes."""
    first, second = lateral_axes(normal_axis)
    force = np.asarray(force, dtype=float)
    return np.hypot(force[..., first], force[..., second])
