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


NO_FORCE = 1e6
"""N, from which on a number is no force of a sensor but damaged."""

_NUMBER = {axis: number for number, axis in enumerate(NORMAL_AXES)}


def opposite(normal_axis: str) -> str:
    """The same axis with the other sign."""
    return normal_axis.translate(str.maketrans("+-", "-+"))


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


def usable(force: np.ndarray) -> np.ndarray:
    """Which forces (…) in N a sensor may have given: finite ones below NO_FORCE."""
    return np.abs(force) < NO_FORCE


def directed(force: np.ndarray) -> np.ndarray:
    """Sum (6,) in N² of the squares of forces (n, 3) along each of NORMAL_AXES: presses outweigh
    noise and offsets. Forces that are not `usable` are left out."""
    known = np.asarray(force, dtype=float)
    known = known[usable(known).all(axis=-1)]
    along = np.stack([normal_force(known, axis) for axis in NORMAL_AXES])
    return (np.clip(along, 0.0, None) ** 2).sum(axis=1)


def mostly_pulls(squares: np.ndarray, normal_axis: str) -> bool:
    """Whether forces, `directed`, pull rather than press along the normal axis."""
    return bool(squares[_NUMBER[opposite(normal_axis)]] > squares[_NUMBER[normal_axis]])


def other_axis(squares: np.ndarray, normal_axis: str) -> str:
    """Sentence on forces, `directed`, of which most lie along another axis; "" where they do
    not."""
    most = NORMAL_AXES[int(np.argmax(squares))]
    if most == normal_axis or not squares.any():
        return ""
    return (
        f"the force acts mostly along {most}, not along normal_axis {normal_axis}: give "
        f"--normal-axis {most}, or tare the force"
    )
