# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""One trial of the simulated study: press, true contact, and what the sensors measure of them.

Everything is drawn from the seed, the condition and the index: equal arguments give equal trials.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

import numpy as np

from finger_common.guided_pulls import LOAD
from finger_common.usable_press import TYPICAL_AREA_NOISE
from finger_model.geometry import Geometry
from finger_model.paper import TARGET_FORCE

from . import pull
from .conditions import condition
from .finger import SimulatedFinger, area_at
from .press import Press, plan_press

REFINEMENT = 1.5
"""Of the finger's mesh; reduced model and full-order check of a fit use 1."""

FORCE_RESOLUTION = 1.0 / 171.0
"""N, resolution of the Nano17 Titanium SI-32-0.2 (paper)."""

FORCE_NOISE = 0.004
"""N, standard deviation of a force sample before rounding; an assumption below the resolution."""

FORCE_RATE = 500.0
FRAME_RATE = 10.0

AREA_SCATTER = 0.05
"""Standard deviation of a trial's area factor in a study with misfit (logarithm)."""

ELLIPSE_ASPECT = 1.3
EPIDERMIS_FACTORS = (0.75, 1.25)
"""The epidermis of a study with misfit is this much thinner or thicker, the same in all its trials:
it is one finger."""


@dataclass(frozen=True)
class Misfit:
    """How one trial differs from what a fit assumes.

    area_factor: contact angle and pad size change the area of a trial by 5 % (standard deviation).
    aspect: real contacts are ellipses. epidermis_factor: thickness of the finger's epidermis over
    the fit's.
    """

    area_factor: float = 1.0
    aspect: float = 1.0
    epidermis_factor: float = 1.0


@dataclass(frozen=True)
class StudyTrial:
    """One press of the study with its truth (SI).

    press: from 0 s; frame_time (k,), area (k,): frames and true areas at them, misfit included;
    moisture (6,) a.u.; pull: sideways while the press is held.
    """

    condition: str
    index: int
    press: Press
    frame_time: np.ndarray
    area: np.ndarray
    moisture: np.ndarray
    misfit: Misfit
    pull: pull.Pull | None = None

    @property
    def target_force(self) -> float:
        """Normal force in N that the participant is asked for."""
        return TARGET_FORCE if self.pull is None else LOAD


def stream(seed: int, name: str, index: int, purpose: str) -> np.random.Generator:
    """Random numbers of one trial for one purpose; independent of every other trial."""
    words = [seed, index, zlib.crc32(name.encode()), zlib.crc32(purpose.encode())]
    return np.random.default_rng(words)


def misfit_of(seed: int, name: str, index: int) -> Misfit:
    """Drawn misfit of one trial; the epidermis is the same for a whole seed."""
    factor = float(np.exp(stream(seed, name, index, "misfit").normal(0.0, AREA_SCATTER)))
    return Misfit(factor, ELLIPSE_ASPECT, EPIDERMIS_FACTORS[seed % 2])


def plan_study_trial(
    seed: int,
    name: str,
    index: int,
    misfit: bool | Misfit = False,
    refinement: float = REFINEMENT,
    slip: bool = False,
) -> StudyTrial:
    """Press and contact of one trial. misfit: drawn when True, or as given. slip: the press is held
    and pulled sideways until it slips."""
    setting = condition(name)
    rng, rate = stream(seed, name, index, "press"), FRAME_RATE
    pulled = None
    if slip:
        rate = pull.FRAME_RATE
        press, pulled = pull.pressed_and_pulled(
            rng, stream(seed, name, index, "pull"), study_friction(seed, name)
        )
    else:
        press = plan_press(rng)
    phase = stream(seed, name, index, "camera").uniform(0.0, 1.0 / rate)
    frame_time = np.arange(phase, press.duration, 1.0 / rate)
    if not isinstance(misfit, Misfit):
        misfit = misfit_of(seed, name, index) if misfit else Misfit()
    thickness = Geometry().epidermis_thickness * misfit.epidermis_factor
    geometry = replace(Geometry(), epidermis_thickness=thickness)
    finger = SimulatedFinger(setting.material, geometry, refinement)
    history = finger.plan(press.time, press.force, frame_time)
    area = area_at(history, frame_time) * misfit.area_factor
    area[np.interp(frame_time, press.time, press.force) <= 0] = 0.0
    moisture = setting.draw_moisture(stream(seed, name, index, "moisture"))
    return StudyTrial(name, index, press, frame_time, area, moisture, misfit, pulled)


def study_friction(seed: int, name: str) -> float:
    """Friction of the study's finger in a condition, before it changes from pull to pull."""
    return pull.finger_friction(stream(seed, name, 0, "friction"), name)


def measured_force(trial: StudyTrial, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) in s and force (n, 3) in N as the sensor gives it: noise, then rounding.

    The finger presses along −z of the sensor; x and y are those of the plate.
    """
    rng = stream(seed, trial.condition, trial.index, "force")
    time = np.arange(0.0, trial.press.duration, 1.0 / FORCE_RATE)
    force = rng.normal(0.0, FORCE_NOISE, (len(time), 3))
    force[:, 2] -= np.interp(time, trial.press.time, trial.press.force)
    if trial.pull is not None:
        force[:, :2] += trial.pull.force_on_plate(time).T
    return time, np.round(force / FORCE_RESOLUTION) * FORCE_RESOLUTION


def measured_area(trial: StudyTrial, seed: int, noise: float = TYPICAL_AREA_NOISE) -> np.ndarray:
    """True areas (k,) in m² with measurement noise; exactly zero without contact."""
    rng = stream(seed, trial.condition, trial.index, "area")
    noisy = trial.area + rng.normal(0.0, noise, len(trial.area))
    return np.where(trial.area > 0, np.maximum(noisy, 0.0), 0.0)
