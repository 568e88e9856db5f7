# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Profile likelihoods and the 95 % intervals that follow from them.

The interval from the data alone is where the profile of a quantity stays below J_min + t² V /
(H⁻¹), with Student's t for as many degrees of freedom as trials less one, V the quantity's variance
and H the curvature of J (`covariance`). What the assumed nuisances add does not get less with more
trials: 1.96 of their deviation is added to both ends of the logarithm, as squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from ..problem import FitProblem
from ..search import held, refine
from .covariance import AT_BOUND, Covariance

NORMAL_95 = 1.96
LARGEST_IDENTIFIABLE_SHARE = 0.9
"""A quantity is identifiable when its interval covers less than this part of the box
(logarithm)."""


@dataclass(frozen=True)
class Profile:
    """J along one quantity, everything else refitted.

    values (n,): SI; costs (n,): m⁴; threshold: J in m⁴ below which a value lies in data_interval,
    the 95 % interval from the data alone; interval: with all that is unknown; their ends lie at the
    box's where they run to a bound (open_low, open_high: of interval); box: lowest and highest
    value of the quantity in the search box; parameters (n, N).
    """

    name: str
    values: np.ndarray
    costs: np.ndarray
    threshold: float
    data_interval: tuple[float, float]
    interval: tuple[float, float]
    box: tuple[float, float]
    open_low: bool
    open_high: bool
    parameters: np.ndarray

    @property
    def identifiable(self) -> bool:
        """Whether the data narrow the quantity down inside the box."""
        low, high = self.data_interval
        limit = LARGEST_IDENTIFIABLE_SHARE * np.log(self.box[1] / self.box[0])
        return bool(np.log(high / low) < limit)


def profile(
    problem: FitProblem,
    name: str,
    best: np.ndarray,
    best_cost: float,
    found: Covariance,
    points: int = 9,
) -> Profile:
    """Profile likelihood of one quantity around the best parameters (N,)."""
    space = problem.space
    low, high = space.quantity_bounds(name, problem.box)
    centre = float(space.quantity(name, best))
    deviation = found.data_deviation(name)
    deviation = min(max(deviation, 1e-4), np.log(high / low))
    near = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
    logs = np.concatenate(
        [
            np.log(centre) + deviation * np.concatenate([-near, near]),
            np.linspace(np.log(low), np.log(high), points),
        ]
    )
    logs = np.unique(logs[(logs >= np.log(low) - 1e-12) & (logs <= np.log(high) + 1e-12)])
    values, costs, parameters = [centre], [best_cost], [best]
    # Outwards from the best, each refit from its neighbour.
    for side in (logs[logs < np.log(centre) - 1e-9][::-1], logs[logs > np.log(centre) + 1e-9]):
        start = best
        for log in side:
            value = float(np.clip(np.exp(log), low, high))
            coordinates = held(problem, name, value)
            if coordinates is None:
                continue
            fit = refine(problem, coordinates, start, tolerance=1e-5)
            start = fit.parameters
            values.append(value)
            costs.append(fit.cost)
            parameters.append(fit.parameters)
    order = np.argsort(values)
    all_values, all_costs = np.array(values)[order], np.array(costs)[order]
    threshold = best_cost + _allowed_rise(problem, name, found)
    lower, open_low = _crossing(all_values, all_costs, centre, best_cost, threshold, -1)
    upper, open_high = _crossing(all_values, all_costs, centre, best_cost, threshold, +1)
    added = NORMAL_95 * found.assumed_deviation(name)
    wide_low = centre * float(np.exp(-np.hypot(np.log(centre / lower), added)))
    wide_high = centre * float(np.exp(np.hypot(np.log(upper / centre), added)))
    return Profile(
        name,
        all_values,
        all_costs,
        threshold,
        (lower, upper),
        (max(wide_low, low), min(wide_high, high)),
        (low, high),
        open_low or wide_low < low,
        open_high or wide_high > high,
        np.array(parameters)[order],
    )


def in_interval(
    problem: FitProblem,
    name: str,
    value: float,
    best: np.ndarray,
    best_cost: float,
    found: Covariance,
) -> bool:
    """Whether a value (SI) lies in the interval of `profile`, by one refit in place of a profile.

    A value on a bound of the box counts as inside the box.
    """
    space = problem.space
    low, high = space.quantity_bounds(name, problem.box)
    if not low * (1 - AT_BOUND) <= value <= high * (1 + AT_BOUND):
        return False
    inside = float(np.clip(value, low * (1 + 1e-9), high * (1 - 1e-9)))
    coordinates = held(problem, name, inside)
    if coordinates is None:
        return False
    fit = refine(problem, coordinates, best, tolerance=1e-5)
    allowed, rise = _allowed_rise(problem, name, found), max(fit.cost - best_cost, 0.0)
    if rise <= allowed:
        return True
    # The root of the rise is nearly linear in the logarithm.
    distance = abs(float(np.log(value / space.quantity(name, best))))
    data = distance * np.sqrt(allowed / rise)
    return bool(distance <= np.hypot(data, NORMAL_95 * found.assumed_deviation(name)))


def _allowed_rise(problem: FitProblem, name: str, found: Covariance) -> float:
    """Rise of J (m⁴) above its minimum at the ends of the 95 % interval."""
    return float(student.ppf(0.975, max(len(problem) - 1, 1)) ** 2 * found.rise(name))


def _crossing(
    values: np.ndarray, costs: np.ndarray, centre: float, base: float, threshold: float, side: int
) -> tuple[float, bool]:
    """Where the profile first exceeds the threshold going outwards, and whether it never does.

    The root of the rise is nearly linear in the logarithm and is interpolated there.
    """
    beyond = values[values <= centre][::-1] if side < 0 else values[values >= centre]
    rises = costs[values <= centre][::-1] if side < 0 else costs[values >= centre]
    root = np.sqrt(np.maximum(rises - base, 0.0))
    limit = np.sqrt(max(threshold - base, 0.0))
    above = np.flatnonzero(root > limit)
    if not len(above):
        return float(beyond[-1]), True
    k = int(above[0])
    if k == 0:
        return float(centre), False
    share = (limit - root[k - 1]) / (root[k] - root[k - 1])
    log = np.log(beyond[k - 1]) + share * np.log(beyond[k] / beyond[k - 1])
    return float(np.exp(log)), False
