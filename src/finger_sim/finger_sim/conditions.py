# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The simulated skin conditions: the study truth of `finger_model.paper`, and moisture readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from finger_common.errors import InputError
from finger_common.guided_presses import PRESS_BY_NAME
from finger_common.guided_pulls import skin_of
from finger_common.moisture import MOISTURE_RANGE
from finger_model import paper
from finger_model.material import Material

READING_SD = 2.0
"""a.u., scatter of single readings about the trial's level; about 3 % of the natural level, an
assumption below the 5.6–9.2 % within-person variation reported for the instrument over days."""


@dataclass(frozen=True)
class Condition:
    """Material of the simulated finger in a condition, moisture of the trials (mean, SD) in a.u."""

    name: str
    material: Material
    moisture: float
    moisture_sd: float

    def draw_moisture(
        self, rng: np.random.Generator, readings: int = paper.READINGS_PER_TRIAL
    ) -> np.ndarray:
        """Readings (readings,) of one trial in a.u.: a level of the trial, and scatter about it."""
        spread = max(self.moisture_sd**2 - READING_SD**2 / max(readings, 1), 0.0) ** 0.5
        level = rng.normal(self.moisture, spread)
        return np.clip(rng.normal(level, READING_SD, readings), *MOISTURE_RANGE)


STUDY: dict[str, Condition] = {
    name: Condition(name, Material(**c.parameters), c.moisture, c.moisture_sd)
    for name, c in paper.CONDITIONS.items()
}
"""The study truth, in the paper's order of blocks."""


def condition(name: str) -> Condition:
    """The condition of that name; raises InputError naming the known ones.

    The presses of a calibration are those of the natural finger; a pull is one of its condition.
    """
    try:
        return STUDY["natural" if name in PRESS_BY_NAME else skin_of(name)]
    except KeyError:
        known = ", ".join(STUDY)
        raise InputError(f"condition '{name}' is not simulated; choose one of {known}") from None
