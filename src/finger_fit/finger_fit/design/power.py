# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Power of a contrast of two conditions, measured in each of n subjects.

Every subject gives ln(first / second) of a quantity. It scatters by what differs between people,
and by what a fit leaves open. Of the latter the assumed lengths and the gain of all areas, shared
by both conditions of a subject, cancel for the larger part. A paired two-sided t-test of the n
logarithms decides (noncentral t distribution; Cohen 1988, chapter 2).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import nct
from scipy.stats import t as student

from .expected import Expected

LEVEL = 0.05
"""Chance that the test sees a difference where there is none."""

MOST_SUBJECTS = 1000
"""Subjects above which no number is looked for."""


def contrast_deviation(first: Expected, second: Expected, name: str) -> float:
    """Deviation of ln(first / second) of a quantity in one subject, from the fits."""
    moves = []
    for found in (first, second):
        known = found.covariance
        gradient = known.space.log_gradient(name, known.parameters)
        answer = known.responses(range(len(known.space))) @ gradient
        names = zip(known.nuisances, answer, known.assumed)
        moves.append({n: move for n, move, assumed in names if assumed})
    shared = sum((moves[0].get(n, 0.0) - moves[1].get(n, 0.0)) ** 2 for n in {*moves[0], *moves[1]})
    own = sum(
        part**2
        for found in (first, second)
        for n, part in found.parts[name].items()
        if n not in moves[0] and n not in moves[1]
    )
    return math.sqrt(own + shared)


def power(difference: float, within: float, between: float, subjects: int) -> float:
    """Chance that n subjects show a difference of the logarithm.

    within: deviation of one subject's contrast from its fits (`contrast_deviation`); between:
    standard deviation of the true contrast between people.
    """
    if subjects < 2:
        return 0.0
    scatter = math.hypot(within, between)
    if scatter == 0.0:
        return 1.0 if difference else LEVEL
    degrees = subjects - 1
    limit = float(student.ppf(1.0 - 0.5 * LEVEL, degrees))
    shift = abs(difference) / scatter * math.sqrt(subjects)
    found = nct.sf(limit, degrees, shift) + nct.cdf(-limit, degrees, shift)
    # Far in the tail the distribution's series gives NaN: the difference is certain there.
    return float(np.clip(found, 0.0, 1.0)) if math.isfinite(found) else 1.0


def subjects_for(wanted: float, difference: float, within: float, between: float) -> int | None:
    """Fewest subjects for a power; None above `MOST_SUBJECTS`."""
    for number in range(2, MOST_SUBJECTS + 1):
        if power(difference, within, between, number) >= wanted:
            return number
    return None
