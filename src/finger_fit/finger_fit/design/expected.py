# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Expected deviations of a plan's fit, by linearisation around a guess.

The covariance is that of a fit (`uncertainty.covariance`) with the noise and scatter of the plan in
place of residuals: Gauss–Newton curvature, the nuisances with their priors. A bound of the search
box is not felt; where a deviation is as wide as the box, a real fit is narrower and biased inwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from finger_model.finger import serving

from ..fingers import KnownLengths
from ..nuisance.estimate import NuisanceModel
from ..nuisance.geometry import PopulationGeometry
from ..options import FitOptions
from ..problem import FitProblem
from ..uncertainty import Covariance, covariance
from .plan import Plan

MOST_PRESSES = 1000
"""Presses above which no number is looked for."""


@dataclass(frozen=True)
class Expected:
    """Expected deviations of the logarithm of each quantity.

    total: with all that is unknown; data: with the finger's lengths and the gain of all areas
    known exactly; parts: of the total, by nuisance, and "data". covariance: for `power`.
    """

    plan: Plan
    total: dict[str, float]
    data: dict[str, float]
    parts: dict[str, dict[str, float]]
    covariance: Covariance


def expected(
    plan: Plan,
    model: Any,
    parameters: np.ndarray,
    options: FitOptions | None = None,
    known: KnownLengths | None = None,
) -> Expected:
    """Predict what a plan will tell of a finger of parameters (N,); options: priors of the
    nuisances; known: of the finger's lengths. A force beyond the model takes that of the population
    box, as in a fit."""
    options = options or FitOptions()
    model = serving(model, plan.peak, parameters[None])
    return expected_of(plan.problem(model, parameters, options, known=known), plan, parameters)


def expected_of(problem: FitProblem, plan: Plan, parameters: np.ndarray) -> Expected:
    """Predict as `expected` does, from a problem that was made by the plan."""
    options = problem.options
    if options.nuisances:
        lengths = problem.lengths
        nuisances = NuisanceModel(
            problem, options, population=PopulationGeometry.like(problem.model) if lengths else None
        )
        nuisances.noise = plan.area_noise
        if options.press_gain:
            nuisances.scatter = plan.scatter
        nuisances.apply(parameters)
    known = covariance(problem, parameters, plan.area_noise)
    names = problem.space.quantity_names
    return Expected(
        plan,
        {n: known.deviation(n) for n in names},
        {n: known.data_deviation(n) for n in names},
        {n: known.budget(n) for n in names},
        known,
    )


def presses_for(found: Expected, name: str, wanted: float, total: bool = False) -> int | None:
    """Fewest presses of this kind for a deviation `wanted` of a quantity's logarithm.

    From the data alone, or in all. None above `MOST_PRESSES`.
    """
    known = found.covariance

    def deviation(presses: int) -> float:
        of_so_many = known.with_presses(presses / found.plan.presses)
        return of_so_many.deviation(name) if total else of_so_many.data_deviation(name)

    low, high = 3, MOST_PRESSES
    if deviation(high) > wanted:
        return None
    while low < high:
        middle = (low + high) // 2
        if deviation(middle) <= wanted:
            high = middle
        else:
            low = middle + 1
    return low
