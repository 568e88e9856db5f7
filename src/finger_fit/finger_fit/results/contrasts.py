# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Do two conditions of one finger differ? Difference, ratio and probability, by quantity."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from finger_model.geometry import LENGTHS

from ..nuisance_names import AREA_GAIN
from ..uncertainty import degrees_of_freedom
from .fits import ConditionFit

FEWEST_SAMPLES = 40
"""Bootstrap samples below which the covariance is sampled instead."""

FEWEST_PRESSES = 10
"""So are presses of a condition: few of them, resampled, do not show how much they err."""

DRAWS = 4000
"""Samples of a condition, drawn from its bootstrap or covariance."""

_FLOATS = -300.0, 300.0
"""Logarithms of which differences are numbers."""


@dataclass(frozen=True)
class Contrast:
    """A quantity in `first` against `second`, two conditions of one subject, or of pooled ones.

    ratio: first over second, NaN for what may be zero; difference: first less second (SI); each
    with its 95 % interval;
    probability_greater: that first is greater; separated: the interval of the difference leaves out
    0; on_bound: the conditions whose estimate lies on a bound of the search box, or follows from
    such parameters alone: the box holds it back, so that they are never called separated; source:
    "bootstrap" over trials, or "covariance" of the logarithms.
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
    on_bound: tuple[str, ...] = ()


def contrasts(fits: Mapping[str, ConditionFit], subject: str = "") -> list[Contrast]:
    """Every pair of conditions of one subject, for every quantity.

    The conditions share the errors of the finger's lengths and of the gain of all areas, which
    cancel for the larger part; their other errors are taken as independent. Nothing for conditions
    without bootstrap and covariance.
    """
    found = []
    for first, second in itertools.combinations(fits, 2):
        one, other = fits[first], fits[second]
        if one.covariance is None or other.covariance is None:
            continue
        space = one.space
        for name in space.quantity_names:
            (x, source), (y, other_source) = _logarithms(one, name), _logarithms(other, name)
            a, b = one.quantity(name), other.quantity(name)
            low, high = space.quantity_bounds(name, one.problem.box)
            # A quantity that may be zero has no ratio.
            whole = space.log_offset(name) == 0.0
            more = _ends(x - y)
            held = tuple(n for n in (first, second) if _on_bound(fits[n], name))
            found.append(
                Contrast(
                    subject,
                    first,
                    second,
                    name,
                    a / b if whole else math.nan,
                    _within(np.exp(more), low / high, high / low)
                    if whole
                    else (math.nan, math.nan),
                    a - b,
                    _within(_ends(np.exp(x) - np.exp(y)), low - high, high - low),
                    float(np.mean((x > y) + 0.5 * (x == y))),
                    not held and not more[0] <= 0.0 <= more[1],
                    source if source == other_source else f"{source}, {other_source}",
                    held,
                )
            )
    return found


def _on_bound(fit: ConditionFit, name: str) -> bool:
    return fit.covariance is not None and fit.covariance.holds(name)


def _ends(values: np.ndarray) -> np.ndarray:
    return np.quantile(values, [0.025, 0.975])


def _within(ends: np.ndarray, low: float, high: float) -> tuple[float, float]:
    """An interval inside what the search box allows."""
    first, last = np.clip(ends, low, high)
    return float(first), float(last)


def _logarithms(fit: ConditionFit, name: str) -> tuple[np.ndarray, str]:
    """Draws (`DRAWS`,) of a quantity's logarithm and where they come from.

    Of the bootstrap without nuisances and from `FEWEST_PRESSES` presses and `FEWEST_SAMPLES`
    samples on; else of the covariance, as the report's intervals are: linear in the logarithm of
    the quantity itself, with Student's t for the errors of few presses. One that is drawn from its
    parameters is skewed where the box holds one of them back, and of errors that are cut off at the
    box those that two conditions share do not cancel. Row k of two conditions has the same errors
    of what they share.
    """
    assert fit.covariance is not None
    known, seed = fit.covariance.released, fit.problem.options.seed
    own = np.random.default_rng([seed, *fit.condition.encode()])
    # No resampling of the presses shows what they share: with nuisances, the covariance does.
    samples, many = fit.samples, len(fit.problem) >= FEWEST_PRESSES
    if samples is not None and len(samples) >= FEWEST_SAMPLES and many and fit.nuisance is None:
        rows = own.integers(len(samples), size=DRAWS)
        return fit.space.log_quantity(name, samples[rows]), "bootstrap"
    drawn = own.standard_t(degrees_of_freedom(len(fit.problem)), DRAWS) * known.data_deviation(name)
    shared = np.random.default_rng(seed).normal(size=(len(LENGTHS) + 1, DRAWS))
    errors = dict(zip((AREA_GAIN, *LENGTHS), shared))
    for nuisance, move in known.assumed_moves(name).items():
        drawn += move * errors[nuisance]
    return np.clip(fit.space.log_quantity(name, fit.parameters) + drawn, *_FLOATS), "covariance"
