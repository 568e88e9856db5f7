# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A pull sideways until the pressed finger slips: the tangential force, and how the skin moves.

The finger presses, the plate is then moved sideways at a constant speed until the finger has slid
for a while. The tissue is a spring of constant stiffness; friction is Coulomb's with one
coefficient. Not modelled: creep under the tangential load, twist, a pull that turns back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from finger_common.errors import InputError
from finger_common.guided_pulls import HOLD, LOAD, skin_of
from finger_model.slip.backbone import SLIP_COMPLIANCE

from .press import Press, PressStyle, plan_press
from .skin_slip import SkinSlip

STYLE = PressStyle(ramp=(0.4, 0.8), hold=(3.0, 3.0))
"""Of a press that is held while the plate moves."""

FRAME_RATE = 30.0
"""Images per s: ridges move by less than half their distance between two of them."""

STIFFNESS = 400.0
"""N/m, of the finger's tissue to a tangential load: some 0.25 N at 0.7 mm (CalculiX, 8.5 ×
6.5 mm, 0.5 N), more under a larger load."""

FRICTION = {"dry": 0.35, "natural": 0.5, "moist": 0.8}
"""Median of a finger's friction by condition: moist skin holds better on glass; an assumption."""

FRICTION_SD, FRICTION_CHANGE = 0.2, 0.02
"""Standard deviations of its logarithm between fingers, and from pull to pull; assumptions."""

PAUSE, RISE, SLIDE = HOLD + 0.3, (0.5, 1.2), 0.5
"""s from the target to the pull's begin (hold and reaction), from there to the slip, and of
sliding."""

LAG = 0.35
"""Shift of the stick zone towards the trailing side (docs/vision_method.md)."""


@dataclass(frozen=True)
class Pull:
    """Samples (n,) of a pull at the times of its press.

    time (s); tangential: force on the plate along `direction` (rad, plate frame) in N; ratio:
    |Q|/(μP), 0 without contact; slid (m): by which the whole contact has slid; friction: μ of this
    pull; reach (m): see `SkinSlip`; slip (s): when the contact begins to slide.
    """

    time: np.ndarray
    tangential: np.ndarray
    ratio: np.ndarray
    slid: np.ndarray
    direction: float
    friction: float
    reach: float
    slip: float

    def force_on_plate(self, time: float | np.ndarray) -> np.ndarray:
        """Force (2,) or (2, k) in N on the plate along its x and y at a time or times (k,) in s;
        zero beyond the record."""
        size = np.interp(time, self.time, self.tangential, left=0.0, right=0.0)
        return np.array([math.cos(self.direction) * size, math.sin(self.direction) * size])

    def skin(self, time: float, origin: tuple[float, float]) -> SkinSlip:
        """How the skin of a finger that touched at `origin` (m) lies at a time in s."""
        ratio = float(np.interp(time, self.time, self.ratio))
        slid = float(np.interp(time, self.time, self.slid))
        return SkinSlip(
            origin, 1.0 if slid > 0 else ratio, self.direction, self.reach, LAG, slid=slid
        )


def finger_friction(rng: np.random.Generator, condition: str) -> float:
    """Friction of a finger; raises InputError for a condition without one."""
    skin = skin_of(condition)
    if skin not in FRICTION:
        raise InputError(f"no friction for condition '{skin}'; known are {', '.join(FRICTION)}")
    return FRICTION[skin] * math.exp(rng.normal(0.0, FRICTION_SD))


def pressed_and_pulled(
    press_rng: np.random.Generator, pull_rng: np.random.Generator, friction: float
) -> tuple[Press, Pull]:
    """A press that is held, and its pull; friction: of the finger."""
    press = plan_press(press_rng, STYLE, LOAD)
    return press, plan_pull(pull_rng, press, friction)


def plan_pull(rng: np.random.Generator, press: Press, friction: float) -> Pull:
    """A pull during the hold of a press; friction: of the finger, of which a pull's differs."""
    friction *= math.exp(rng.normal(0.0, FRICTION_CHANGE))
    direction = float(rng.uniform(0.0, 2.0 * math.pi))
    begin = press.cue + PAUSE
    rise = float(rng.uniform(*RISE))
    most = friction * press.force
    far = friction * LOAD / STIFFNESS
    plate = far * np.clip((press.time - begin) / rise, 0.0, 1.0 + SLIDE / rise)
    tangential, slid = np.zeros(len(plate)), np.zeros(len(plate))
    for i in range(1, len(plate)):
        slid[i] = max(slid[i - 1], plate[i] - most[i] / STIFFNESS)
        tangential[i] = min(STIFFNESS * (plate[i] - slid[i]), most[i])
    # The first touch and the release slide too; there is nothing to see then.
    slid[press.time < begin] = 0.0
    ratio = np.divide(tangential, most, out=np.zeros_like(most), where=most > 0)
    sliding = np.flatnonzero(slid > 0)
    slip = float(press.time[sliding[0]]) if len(sliding) else math.nan
    return Pull(
        press.time, tangential, ratio, slid, direction, friction, SLIP_COMPLIANCE * far, slip
    )
