# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Lubkin: a sphere pressed on a rough plate that turns about its normal."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import quad
from scipy.special import ellipe, ellipk

from .check import Check, Curve, Measure, Panel, largest
from .pulled_spheres import CONTACT, FRICTION, MODULUS, RADIUS, RATIO, Theory, half_ball, rubber

TORQUE_OF_SLIP = 3.0 * math.pi / 16.0
"""Torque of a Hertzian contact that slips throughout, over μ P a."""

FAR = 9.0
"""Angle over that of slip at which all has slipped."""


def lubkin(stick: float) -> tuple[float, float]:
    """Angle over that of slip and torque over that of slip where the skin sticks within the radius
    `stick` (0 … 1, over that of the contact).

    The angle is relative to that at which a contact that sticks throughout has the torque of slip,
    T = 16/3 G a³ β (E. Reissner and H. F. Sagoci, J. Appl. Phys. 15, 1944). Half-space on a rigid
    plate (J. L. Lubkin, J. Appl. Mech. 18, 1951): with u(r) = ∫ t φ(t)/√(r² − t²) dt/(r G) over
    t < r, the pressure gives φ where skin slips, and φ grows with t where it sticks.
    """

    def density(t: float) -> float:
        return quad(lambda x: 2.0 * ellipe(1.0 - x * x) - ellipk(1.0 - x * x), t, 1.0)[0]

    slope = density(stick) / stick
    torque = slope * stick**3 / 3.0 + quad(lambda t: t * density(t), stick, 1.0)[0]
    whole = quad(lambda t: t * density(t), 0.0, 1.0)[0]
    return slope / (3.0 * whole), torque / whole


def twisted() -> Check:
    """Torque over angle until all slips, and on the way back."""
    model = half_ball(6, half=False)
    load, edge = Theory.load, Theory.radius(Theory.load)
    torque = TORQUE_OF_SLIP * FRICTION * load * edge
    unit = torque / (16.0 / 3.0 * MODULUS / (2.0 * (1.0 + RATIO)) * edge**3)
    stepper = model.start(rubber())
    for part in (0.5, 1.0):
        stepper.step(stepper.state.time + 1.0, part * load)

    def turn(angles: np.ndarray) -> np.ndarray:
        """Torques at angles, both over those of slip."""
        steps = [stepper.step(stepper.state.time + 1.0, load, twist=a * unit) for a in angles]
        return np.array([point.twist_torque for point in steps]) / torque

    forth = np.array([lubkin(stick) for stick in (0.9, 0.8, 0.7, 0.6, 0.5, 0.35, 0.2)])
    found, (end,) = turn(forth[:, 0]), turn(np.array([FAR]))
    # On the way back friction turns, so that a change of angle counts half.
    half = forth[::2]
    back = np.column_stack([FAR - 2.0 * half[:, 0], 1.0 - 2.0 * half[:, 1]])
    returned = turn(back[:, 0])
    dense = np.array([lubkin(stick) for stick in np.linspace(0.98, 0.12, 40)])
    return Check(
        "solid_twist",
        "Third dimension: twisted sphere",
        f"The half-ball of the pulled sphere (R = {1e3 * RADIUS:g} mm, ν = {RATIO:g}, friction "
        f"{FRICTION:g}, a = {CONTACT:g} R; spacing of the nodes 0.22 a) under a plate that turns "
        "about its normal until all slips, T = 3π/16 μPa, and back (Lubkin 1951; on the way back "
        "with twice the angle and the torque).",
        [
            Measure(
                f"{name}: largest error of the torque over that of slip",
                largest(error) * 100.0,
                "%",
                high=2.0,
            )
            for name, error in (
                ("forth", found - forth[:, 1]),
                ("all slips", np.array([end - 1.0])),
                ("way back", returned - back[:, 1]),
            )
        ],
        [
            Panel(
                "angle over that of slip without micro-slip",
                "torque over that of slip",
                [
                    Curve(dense[:, 0], dense[:, 1], "C0-"),
                    Curve(forth[:, 0], found, "C0o", "forth"),
                    Curve(FAR - 2.0 * dense[:, 0], 1.0 - 2.0 * dense[:, 1], "C1-"),
                    Curve(back[:, 0], returned, "C1o", "back"),
                ],
                legend="lines: theory",
            ),
        ],
    )
