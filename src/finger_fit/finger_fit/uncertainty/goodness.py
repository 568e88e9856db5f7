# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How well the model and the power law describe the areas: R², and intervals over the trials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..problem import FitProblem, PowerLaw, power_law_of

RESAMPLINGS = 200

FEWEST_TRIALS = 3
"""Trials below which no interval is given."""


@dataclass(frozen=True)
class Interval:
    """A value and its 95 % percentile interval of a bootstrap over trials; NaN ends without one."""

    value: float
    low: float = float("nan")
    high: float = float("nan")


@dataclass(frozen=True)
class Goodness:
    """k (m²/N^m) and m of the power law, R² of model and power law on the fit's frames, and the
    root mean square of the model's residuals there (m²), every trial weighing alike."""

    k: Interval
    m: Interval
    model: Interval
    power_law: Interval
    rms: Interval


def r_squared(problem: FitProblem, areas: np.ndarray, weight: np.ndarray) -> float:
    """Weighted coefficient of determination of areas (n,) in m² at the frames."""
    measured = problem.measured
    mean = (weight * measured).sum() / weight.sum()
    total = (weight * (measured - mean) ** 2).sum()
    return float(1.0 - (weight * (measured - areas) ** 2).sum() / total) if total > 0 else np.nan


def goodness(problem: FitProblem, areas: np.ndarray, law: PowerLaw, seed: int) -> Goodness:
    """Measure how well the fitted model's areas (n,) and the power law describe the frames.

    The power law is fitted again to each resampling of the trials; the model is not.
    """

    def values(weight: np.ndarray, k: float, m: float) -> tuple[float, ...]:
        by_law = k * np.maximum(problem.force, 0.0) ** m
        rms = np.sqrt((weight * (areas - problem.measured) ** 2).sum() / weight.sum())
        r2, law_r2 = r_squared(problem, areas, weight), r_squared(problem, by_law, weight)
        return k, m, r2, law_r2, float(rms)

    found = values(problem.weight, law.k, law.m)
    number = len(problem)
    if number < FEWEST_TRIALS:
        return Goodness(*map(Interval, found))
    rng = np.random.default_rng([seed, number])
    samples = []
    for _ in range(RESAMPLINGS):
        multiplicity = np.bincount(rng.integers(0, number, number), minlength=number)
        weight = problem.weight * multiplicity[problem.trial_of]
        samples.append(values(weight, *power_law_of(problem, weight)))
    ends = np.nanquantile(np.array(samples), [0.025, 0.975], axis=0)
    return Goodness(*(Interval(v, float(a), float(b)) for v, a, b in zip(found, *ends)))
