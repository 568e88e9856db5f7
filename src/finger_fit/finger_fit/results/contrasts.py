# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Do two conditions of one finger differ? Difference, ratio and probability, by quantity."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .fits import ConditionFit

FEWEST_SAMPLES = 40
"""Bootstrap samples below which the covariance is sampled instead."""

DRAWS = 400
"""Samples of a condition that are drawn from its covariance."""


@dataclass(frozen=True)
class Contrast:
    """A quantity in `first` against `second`, two conditions of one subject.

    ratio: first over second; difference: first less second (SI); each with its 95 % interval;
    probability_greater: that first is greater; separated: the interval of the ratio leaves out 1;
    source: "bootstrap" over trials, or "covariance" of the logarithms.
    """

    subject: str
    first: str
    second: str
    quantity: str
    ratio: float
    ratio_95: tuple[float, float]
    difference: float
    difference_95: tuple[float, float]
    probability_greater: float
    separated: bool
    source: str


def contrasts(fits: Mapping[str, ConditionFit], subject: str = "") -> list[Contrast]:
    """Every pair of conditions of one subject, for every quantity; the conditions' errors are
    taken as independent.

    Nothing for conditions without bootstrap and covariance.
    """
    drawn = {name: _samples(fit) for name, fit in fits.items()}
    found = []
    for first, second in itertools.combinations(fits, 2):
        if drawn[first] is None or drawn[second] is None:
            continue
        (a, source_a), (b, source_b) = drawn[first], drawn[second]
        space = fits[first].space
        for name in space.quantity_names:
            # Every sample of one with every sample of the other.
            x = space.quantity(name, a)[:, None]
            y = space.quantity(name, b)[None, :]
            ratio, difference = _ends(x / y), _ends(x - y)
            one, other = fits[first].quantity(name), fits[second].quantity(name)
            found.append(
                Contrast(
                    subject,
                    first,
                    second,
                    name,
                    one / other,
                    ratio,
                    one - other,
                    difference,
                    float(np.mean((x > y) + 0.5 * (x == y))),
                    not ratio[0] <= 1.0 <= ratio[1],
                    source_a if source_a == source_b else f"{source_a}, {source_b}",
                )
            )
    return found


def _ends(values: np.ndarray) -> tuple[float, float]:
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def _samples(fit: ConditionFit) -> Any:
    """Parameters (S, N) of a condition and where they come from; None without either."""
    # No resampling of the presses shows what they share: with nuisances, the covariance does.
    resampled = fit.samples is not None and len(fit.samples) >= FEWEST_SAMPLES
    if resampled and fit.nuisance is None:
        return fit.samples, "bootstrap"
    if fit.covariance is None:
        return None
    rng = np.random.default_rng([fit.problem.options.seed, len(fit.problem)])
    centre = fit.space.to_log(fit.parameters)
    drawn = rng.multivariate_normal(centre, fit.covariance.covariance, DRAWS, method="eigh")
    low, high = fit.space.to_log(fit.problem.box.T)
    return fit.space.from_log(np.clip(drawn, low, high)), "covariance"
