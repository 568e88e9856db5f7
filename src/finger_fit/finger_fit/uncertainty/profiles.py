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
from scipy.special import stdtrit

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
    value of the quantity in the search box; parameters (n, N); log_offset: see `ParameterSpec`.
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
    log_offset: float = 0.0

    @property
    def identifiable(self) -> bool:
        """Whether the data narrow the quantity down inside the box."""
        interval, box = np.diff(np.log(np.array([self.data_interval, self.box]) + self.log_offset))
        return bool(interval[0] < LARGEST_IDENTIFIABLE_SHARE * box[0])


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
    offset = space.log_offset(name)
    first, last = np.log([low + offset, high + offset])
    middle = float(space.log_quantity(name, best))
    deviation = min(max(found.data_deviation(name), 1e-4), last - first)
    near = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
    logs = np.concatenate(
        [
            middle + deviation * np.concatenate([-near, near]),
            np.linspace(first, last, points),
        ]
    )
    logs = np.unique(logs[(logs >= first - 1e-12) & (logs <= last + 1e-12)])
    places, costs, parameters = [float(middle)], [best_cost], [best]
    # Outwards from the best, each refit from its neighbour.
    for side in (logs[logs < middle - 1e-9][::-1], logs[logs > middle + 1e-9]):
        start = best
        for log in side:
            coordinates = held(problem, name, float(np.clip(np.exp(log) - offset, low, high)))
            if coordinates is None:
                continue
            fit = refine(problem, coordinates, start, tolerance=1e-5)
            start = fit.parameters
            places.append(float(log))
            costs.append(fit.cost)
            parameters.append(fit.parameters)
    order = np.argsort(places)
    all_places, all_costs = np.array(places)[order], np.array(costs)[order]
    threshold = best_cost + _allowed_rise(problem, name, found)
    reach = _student(problem) * found.data_deviation(name)
    shared = (all_places, all_costs, middle, best_cost, threshold, reach)
    lower, open_low = _crossing(*shared, -1)
    upper, open_high = _crossing(*shared, +1)
    added = NORMAL_95 * found.assumed_deviation(name)
    wide = middle + np.hypot([middle - lower, upper - middle], added) * [-1.0, 1.0]

    def values(logs: np.ndarray | list[float]) -> np.ndarray:
        return np.clip(np.exp(logs) - offset, low, high)

    return Profile(
        name,
        values(all_places),
        all_costs,
        threshold,
        (float(values([lower])[0]), float(values([upper])[0])),
        (float(values(wide)[0]), float(values(wide)[1])),
        (low, high),
        bool(open_low or wide[0] < first),
        bool(open_high or wide[1] > last),
        np.array(parameters)[order],
        offset,
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
    log = np.log(value + space.log_offset(name))
    distance = abs(float(log - space.log_quantity(name, best)))
    data = distance * np.sqrt(allowed / rise)
    if np.isinf(rise):
        data = _student(problem) * found.data_deviation(name)
    return bool(distance <= np.hypot(data, NORMAL_95 * found.assumed_deviation(name)))


def _allowed_rise(problem: FitProblem, name: str, found: Covariance) -> float:
    """Rise of J (m⁴) above its minimum at the ends of the 95 % interval."""
    return float(_student(problem) ** 2 * found.rise(name))


def _student(problem: FitProblem) -> float:
    return student_95(len(problem))


def degrees_of_freedom(presses: int) -> int:
    """Of the scatter between presses."""
    return max(presses - 1, 1)


def student_95(presses: int) -> float:
    """Deviations from an estimate of so many presses to an end of its 95 % interval."""
    return float(stdtrit(degrees_of_freedom(presses), 0.975))


def _crossing(
    logs: np.ndarray,
    costs: np.ndarray,
    centre: float,
    base: float,
    threshold: float,
    reach: float,
    side: int,
) -> tuple[float, bool]:
    """Logarithm at which the profile first exceeds the threshold going outwards, and whether it
    never does.

    The root of the rise is nearly linear in the logarithm and is interpolated there. Where the
    model cannot follow the presses any more (an infinite cost), the data exclude nothing: the end
    is that of the curvature, at the distance `reach`.
    """
    beyond = logs[logs <= centre][::-1] if side < 0 else logs[logs >= centre]
    rises = costs[logs <= centre][::-1] if side < 0 else costs[logs >= centre]
    root = np.sqrt(np.maximum(rises - base, 0.0))
    limit = np.sqrt(max(threshold - base, 0.0))
    above = np.flatnonzero(root > limit)
    if not len(above):
        return float(beyond[-1]), True
    k = int(above[0])
    if k == 0:
        return float(centre), False
    if np.isinf(root[k]):
        return centre + side * max(abs(float(beyond[k - 1]) - centre), reach), False
    share = (limit - root[k - 1]) / (root[k] - root[k - 1])
    return float(beyond[k - 1] + share * (beyond[k] - beyond[k - 1])), False
