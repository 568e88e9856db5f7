# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Do two conditions of one finger differ? Difference, ratio and probability, by quantity."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from finger_model.geometry import LENGTHS

from ..nuisance.names import AREA_GAIN
from .fits import ConditionFit

FEWEST_SAMPLES = 40
"""Bootstrap samples below which the covariance is sampled instead."""

DRAWS = 4000
"""Samples of a condition, drawn from its bootstrap or covariance."""


@dataclass(frozen=True)
class Contrast:
    """A quantity in `first` against `second`, two conditions of one subject, or of pooled ones.

    ratio: first over second, NaN for what may be zero; difference: first less second (SI); each
    with its 95 % interval;
    probability_greater: that first is greater; separated: the interval of the difference leaves out
    0; on_bound: the conditions whose estimate lies on a bound of the search box, or follows from
    such parameters alone: their samples have no spread of it, so that they are never called
    separated; source: "bootstrap" over trials, or "covariance" of the logarithms.
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
    drawn = {name: _samples(fit) for name, fit in fits.items()}
    found = []
    for first, second in itertools.combinations(fits, 2):
        if drawn[first] is None or drawn[second] is None:
            continue
        (a, source_a), (b, source_b) = drawn[first], drawn[second]
        space = fits[first].space
        for name in space.quantity_names:
            x, y = space.quantity(name, a), space.quantity(name, b)
            # A quantity that may be zero has no ratio.
            whole = space.log_offset(name) == 0.0
            ratio, difference = _ends(x / y) if whole else (math.nan, math.nan), _ends(x - y)
            held = tuple(n for n in (first, second) if _on_bound(fits[n], name))
            one, other = fits[first].quantity(name), fits[second].quantity(name)
            found.append(
                Contrast(
                    subject,
                    first,
                    second,
                    name,
                    one / other if whole else math.nan,
                    ratio,
                    one - other,
                    difference,
                    float(np.mean((x > y) + 0.5 * (x == y))),
                    not held and not difference[0] <= 0.0 <= difference[1],
                    source_a if source_a == source_b else f"{source_a}, {source_b}",
                    held,
                )
            )
    return found


def _on_bound(fit: ConditionFit, name: str) -> bool:
    return fit.covariance is not None and fit.covariance.holds(name)


def _ends(values: np.ndarray) -> tuple[float, float]:
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def _samples(fit: ConditionFit) -> Any:
    """Parameters (`DRAWS`, N) of a condition and where they come from; None without either.

    Row k of two conditions has the same errors of what they share: the lengths of the finger and
    the gain of all areas.
    """
    own = np.random.default_rng([fit.problem.options.seed, *fit.condition.encode()])
    # No resampling of the presses shows what they share: with nuisances, the covariance does.
    samples = fit.samples
    if samples is not None and len(samples) >= FEWEST_SAMPLES and fit.nuisance is None:
        return samples[own.integers(len(samples), size=DRAWS)], "bootstrap"
    known = fit.covariance
    if known is None:
        return None
    free = [i for i, n in enumerate(fit.space.names) if n not in known.active]
    moves = known.responses(free)
    shared = np.random.default_rng(fit.problem.options.seed).normal(size=(len(LENGTHS) + 1, DRAWS))
    place = dict(zip((AREA_GAIN, *LENGTHS), shared))
    drawn = fit.space.to_log(fit.parameters) + np.zeros((DRAWS, 1))
    left = known.covariance.copy()
    for name, move in zip(np.array(known.nuisances)[known.assumed], moves[known.assumed]):
        drawn = drawn + place[str(name)][:, None] * move
        left -= np.outer(move, move)
    values, vectors = np.linalg.eigh(left)
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = drawn + own.normal(size=(DRAWS, len(values))) @ spread.T
    low, high = fit.space.to_log(fit.problem.box.T)
    return fit.space.from_log(np.clip(drawn, low, high)), "covariance"
