"""The three moisture conditions of the study: what the paper prints, and the truth chosen where it is silent.

Source: Nam and Kuchenbecker, IEEE Trans. Haptics 14(2):303–309, 2021. Printed there: moisture (mean, standard
deviation), E2 and the composite modulus 1/(1/E0 + 1/E1): 30.23, 19.27 and 13.71 kPa. E0 and the two larger τ1
are not printed; the values here are assumptions inside the paper's search box, and E1 follows from the composite.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from finger_common.errors import InputError
from finger_model.material import Material

MOISTURE_MAXIMUM = 130.0
"""a.u., end of the Corneometer CM 825 scale."""

READING_SD = 2.0
"""a.u., scatter of single readings about the trial's level; about 3 % of the natural level, an assumption
below the 5.6–9.2 % within-person variation reported for the instrument over days."""


@dataclass(frozen=True)
class Condition:
    """One condition: name, material of the simulated finger, moisture of the trials (mean, SD in a.u.)."""

    name: str
    material: Material
    moisture: float
    moisture_sd: float

    def draw_moisture(self, rng: np.random.Generator, readings: int = 6) -> np.ndarray:
        """Readings (readings,) of one trial in a.u.: a level of the trial, and scatter about it."""
        spread = max(self.moisture_sd**2 - READING_SD**2 / max(readings, 1), 0.0) ** 0.5
        level = rng.normal(self.moisture, spread)
        return np.clip(rng.normal(level, READING_SD, readings), 0.0, MOISTURE_MAXIMUM)


STUDY: dict[str, Condition] = {
    "dry": Condition("dry", Material(E0=100e3, E1=43.33e3, tau1=0.10, E2=1652e3), 37.56, 3.34),
    "natural": Condition(
        "natural", Material(E0=140e3, E1=22.35e3, tau1=0.50, E2=1795e3), 69.31, 6.54
    ),
    "moist": Condition("moist", Material(E0=160e3, E1=15e3, tau1=0.01, E2=700e3), 105.33, 4.93),
}
"""The study truth, in the paper's order of blocks."""


def condition(name: str) -> Condition:
    """The condition of that name; raises InputError naming the known ones."""
    try:
        return STUDY[name]
    except KeyError:
        known = ", ".join(STUDY)
        raise InputError(f"condition '{name}' is not simulated; choose one of {known}") from None
