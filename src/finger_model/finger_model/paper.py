# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What Nam and Kuchenbecker (IEEE Trans. Haptics 14(2), 303–309, 2021) print, and the study truth.

This is the one home of these numbers: search box, target force, moisture of the conditions, moduli.
A value that the paper does not print is an assumption and marked as such.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from finger_common.trial_phases import TARGET_FORCE as TARGET_FORCE

FRICTION = 0.25
"""Friction coefficient between skin and plate."""

PRESS_DURATION = (0.5, 2.0)
"""s, shortest and longest press from first touch to the target force."""

TRIALS_PER_CONDITION = 15

READINGS_PER_TRIAL = 6
"""Moisture readings of a trial: three before the press, three after it."""

SEARCH_BOX = {
    "E0": (50e3, 160e3),
    "E1": (15e3, 60e3),
    "tau1": (0.01, 0.80),
    "E2": (700e3, 2200e3),
}
"""Search box of the paper's fit: lowest and highest value in Pa, Pa, s, Pa."""


@dataclass(frozen=True)
class PaperCondition:
    """One moisture condition.

    Printed: moisture and moisture_sd (mean and standard deviation of the readings, a.u.),
    composite_E (Pa), the exponent m and the cost of the power law A = k F^m (m⁴, over 15 trials).

    parameters: E0, E1 (Pa), tau1 (s), E2 (Pa) of the simulated finger, the truth of every simulated
    study. E2 is printed, and so is tau1 of the moist condition. E0 and the two other tau1 are
    chosen inside the search box so that the default geometry has the printed exponents and order of
    the areas (scripts/default_finger.py); E1 follows from composite_E = 1/(1/E0 + 1/E1).
    """

    name: str
    moisture: float
    moisture_sd: float
    composite_E: float
    power_law_exponent: float
    power_law_cost: float
    parameters: dict[str, float] = field(hash=False)


CONDITIONS = {
    condition.name: condition
    for condition in (
        PaperCondition(
            name="dry",
            moisture=37.56,
            moisture_sd=3.34,
            composite_E=30.23e3,
            power_law_exponent=0.67,
            power_law_cost=2650e-12,
            parameters={"E0": 140e3, "E1": 38.56e3, "tau1": 0.20, "E2": 1652e3},
        ),
        PaperCondition(
            name="natural",
            moisture=69.31,
            moisture_sd=6.54,
            composite_E=19.27e3,
            power_law_exponent=0.68,
            power_law_cost=4767e-12,
            parameters={"E0": 80e3, "E1": 25.38e3, "tau1": 0.50, "E2": 1795e3},
        ),
        PaperCondition(
            name="moist",
            moisture=105.33,
            moisture_sd=4.93,
            composite_E=13.71e3,
            power_law_exponent=0.50,
            power_law_cost=1807e-12,
            parameters={"E0": 160e3, "E1": 15e3, "tau1": 0.01, "E2": 700e3},
        ),
    )
}
"""The conditions in the order of the paper's blocks: dry, natural, moist."""

NATURAL = CONDITIONS["natural"]
"""The condition whose parameters and moisture are the suite's defaults."""
