# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How far a finger is from its model, and which way."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from . import area_filter
from .sensitivities import DIRECTION_NAMES

TYPICAL_FORCE = 0.5
"""N, at which areas of fingers are compared."""


@dataclass(frozen=True)
class Mismatch:
    """What the filters found of a finger, against what was expected before it was seen.

    surprise: mean square of the latest innovations over their expected variance, 1 for the right
    model; flagged: as MODEL_MISMATCH; deviation: of the finger from the mean of the prior, in
    standard deviations; probability: share of fingers of the prior that are farther away;
    area: factor of all areas; stiffness, time: factors of the moduli and of the relaxation times.
    """

    surprise: float
    flagged: bool
    deviation: float
    probability: float
    area: float
    stiffness: float
    time: float

    def sentence(self) -> str:
        """Which way, such as "1.4 times as stiff, 1.2 times as slow"."""
        words = []
        for factor, more, less in (
            (self.area, "larger", "smaller"),
            (self.stiffness, "stiffer", "softer"),
            (self.time, "slower", "faster"),
        ):
            if abs(math.log(factor)) > math.log(1.1):
                words.append(f"{more if factor > 1 else less} (x {factor:.2g})")
        return ", ".join(words) or "as expected"


def mismatch_of(bank: np.ndarray, noise: np.ndarray) -> Mismatch:
    """From the filters and their noise, records of `area_filter`."""
    from scipy.special import chdtrc  # a tenth of a first estimate's time; scipy.stats: a third

    weights = np.exp(bank["log_weight"])
    weights /= weights.sum()
    n = area_filter.FINGER_STATES
    found = (weights @ bank["mean"])[:n]
    change = found - noise["prior_mean"]
    covariance = noise["prior_covariance"]
    # Coordinates that the prior holds fixed say nothing.
    free = np.diag(covariance) > 1e-12
    square = 0.0
    if free.any():
        part = covariance[np.ix_(free, free)]
        square = float(change[free] @ np.linalg.solve(part, change[free]))
    area = change[0] + change[1] * math.log(TYPICAL_FORCE)
    tissue = dict(zip(DIRECTION_NAMES, change[area_filter.TISSUE]))
    return Mismatch(
        float(bank["mean_nis"]),
        bool(bank["mismatch"]),
        math.sqrt(max(square, 0.0)),
        float(chdtrc(max(int(free.sum()), 1), square)),
        math.exp(area),
        math.exp(tissue["stiffness"]),
        math.exp(tissue["time"]),
    )
