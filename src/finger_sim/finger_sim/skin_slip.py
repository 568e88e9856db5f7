# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How skin has moved over the plate under tangential load, for rendered frames.

The camera is fixed to the plate: skin that sticks stands still in its picture. A first pull at
r = |Q|/(μP) leaves a stick zone of the area share s(r), the slip law's (`finger_model.slip`): the
outline shrunk about a point towards `lag`. A place of the contact slips from the ratio on at which
the shrinking zone has passed it. How far it has slipped since is what the elements of the law say,
the same for all: `reach` · (U(r) − U(r₀)) with U = ∫ dr/s. The three-dimensional solution has
this slip at its nodes too (docs/vision_method.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from finger_model.slip.backbone import STICK_CURVE

_RATIO = np.linspace(0.0, 1.0, 2001)
_STICK = np.interp(_RATIO, *STICK_CURVE.T)
_MOVED = np.concatenate([[0.0], np.cumsum(np.diff(_RATIO) / (0.5 * (_STICK[1:] + _STICK[:-1])))])


@dataclass(frozen=True)
class SkinSlip:
    """Where the skin in a contact has moved to over the plate. Lengths in m, angles in rad.

    origin: plate coordinates at which the print's centre touched. ratio: r of the pull, 0…1; at 1
    the whole contact slides. direction: of the skin's slip over the plate. reach: slip for each
    unit of U, `SLIP_COMPLIANCE` μP/K with the finger's tangential stiffness K. lag: shift of the
    stick zone's centre along `direction` over its distance from the rim, −1…1. slid: further slip
    of the whole contact. turned: its further rotation about `origin`. twist: whether the ratio is
    that of a torque, so that skin slips around the centre, at the rim by `reach` times U.
    """

    origin: tuple[float, float] = (0.0, 0.0)
    ratio: float = 0.0
    direction: float = 0.0
    reach: float = 0.0
    lag: float = 0.0
    slid: float = 0.0
    turned: float = 0.0
    twist: bool = False

    @property
    def stick_ratio(self) -> float:
        """Share of the contact's area that has not slipped."""
        slides = self.ratio >= 1.0 or self.slid != 0.0 or self.turned != 0.0
        return 0.0 if slides else float(np.interp(self.ratio, _RATIO, _STICK))

    def touched_at(self, x: np.ndarray, y: np.ndarray, rho: np.ndarray) -> tuple:
        """Plate coordinates (m), two arrays, at which the skin that is at x, y now first touched.

        rho (…, 2): x, y in the frame of the outline, scaled so that its rim is the unit circle,
        turned so that its first axis is `direction`.
        """
        along = np.stack([rho[..., 0] - self.lag, rho[..., 1]])
        dot, square = self.lag * along[0], along[0] ** 2 + along[1] ** 2
        free = 1.0 - self.lag**2
        # The zone of scale m: its rim has the distance m from the centre lag (1 − m).
        scale = (dot + np.sqrt(dot**2 + free * square)) / free
        began = np.interp(np.minimum(scale, 1.0) ** 2, _STICK[::-1], _MOVED[::-1])
        now = float(np.interp(self.ratio, _RATIO, _MOVED))
        way = self.reach * np.maximum(now - began, 0.0).astype(np.float32)
        if self.twist:
            ox, oy = x - self.origin[0], y - self.origin[1]
            far = max(float(np.hypot(ox, oy)[scale <= 1.0].max(initial=0.0)), 1e-6)
            x, y = x + way * oy / far, y - way * ox / far
        else:
            way = way + np.float32(self.slid)
            x = x - way * math.cos(self.direction)
            y = y - way * math.sin(self.direction)
        if self.turned:
            c, s = math.cos(self.turned), math.sin(self.turned)
            ox, oy = x - self.origin[0], y - self.origin[1]
            x, y = self.origin[0] + c * ox + s * oy, self.origin[1] - s * ox + c * oy
        return x, y
