# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Correction of a fit's areas to a better model (space mapping)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from finger_model.laws import ParameterSpace

from ..engine import Done
from ..problem import AreaCorrection, FitProblem
from ..search import LocalFit, all_free, refine
from .areas import BetterModel

FAR = 0.5
"""Move of a correction coordinate after which the slope is computed again."""

SETTLED = 0.03
"""Move of a correction coordinate below which the correction ends; far below the spread of a fit of
15 presses."""

LARGEST_SHIFT = 1.0
"""Largest change of a parameter's logarithm that a step of the slope may make."""


@dataclass(frozen=True)
class Correction:
    """What the correction changed.

    cost_before: J (m⁴) of the uncorrected fit; parameters_before (N,): its parameters; rounds;
    largest_factor: largest relative change of the area at a frame.
    """

    cost_before: float
    parameters_before: np.ndarray
    rounds: int
    largest_factor: float


def shifted(space: ParameterSpace, parameters: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Parameters (N + 1, N): as given, and with one correction coordinate moved by its step each.

    The moves go towards the middle of box (N, 2), or away from it where a parameter would change by
    more than LARGEST_SHIFT, as near the end of a derived quantity's range.
    """
    centre = space.correction_coordinates(parameters)
    middle = space.correction_coordinates(space.from_log(space.to_log(box.T).mean(axis=0)))
    points = [np.array(parameters, dtype=float)]
    for k, step in enumerate(space.correction_steps):
        inwards = 1.0 if centre[k] < middle[k] else -1.0
        for sign in (inwards, -inwards):
            moved = centre.copy()
            moved[k] += sign * step
            point = space.from_correction_coordinates(moved)
            if np.abs(space.to_log(point) - space.to_log(parameters)).max() < LARGEST_SHIFT:
                break
        points.append(point)
    return np.array(points)


def correction_around(
    problem: FitProblem,
    centre: np.ndarray,
    better: BetterModel,
    slope: np.ndarray | None = None,
    done: Done | None = None,
) -> AreaCorrection:
    """Ratio of the better model's areas to the fit's around parameters `centre` (N,).

    slope (N, n + q): as given, or by differences. Frames of a trial that the better model cannot
    simulate keep the fit's own area.
    """
    space = problem.space
    points = shifted(space, centre, problem.box) if slope is None else centre[None]
    found = better.areas(problem, points, done)
    raw = problem.raw(points)
    usable = (np.isfinite(found) & (found > 0) & (raw > 0)).all(axis=0)
    log_ratio = np.log(np.where(usable, found / raw, 1.0))
    if slope is None:
        places = space.correction_coordinates(points)
        slope = np.linalg.solve(places[1:] - places[0], log_ratio[1:] - log_ratio[0])
    return AreaCorrection(space, centre, log_ratio[0], slope)


def correct(
    problem: FitProblem,
    best: np.ndarray,
    better: BetterModel,
    rounds: int = 3,
    done: Callable[[int], Done] | None = None,
) -> tuple[LocalFit, Correction]:
    """Refit with areas corrected to a better model around the best parameters (N,).

    Each frame's area is multiplied by the ratio of the two models, linear around the best
    parameters (space mapping with the fine model's derivatives: Bandler et al. 2004). The fit is
    polished, and the ratio renewed at the result. The slope matters as much as the ratio: in the
    direction of E0 against E1 of the default law, the reduced model's error changes as fast as the
    area does, and a fit with the ratio alone stays where it started. The problem keeps the last
    correction. done: gives the callback of a pass, from 1.
    """
    space = problem.space

    def moved(to: np.ndarray, since: np.ndarray) -> float:
        place = space.correction_coordinates
        return float(np.abs(place(to) - place(since)).max())

    before = float(problem.cost(best)[0])
    start, slope_at, slope = best, best, None
    used = 0
    while used < rounds:
        used += 1
        if moved(start, slope_at) > FAR:
            slope, slope_at = None, start
        correction = correction_around(problem, start, better, slope, done and done(used))
        problem.correction, slope = correction, correction.slope
        fit = refine(problem, all_free(problem), start)
        change, start = moved(fit.parameters, start), fit.parameters
        if change < SETTLED:
            break
    factor = correction.factor(start)[:, : len(problem.measured)]
    largest = float(np.abs(factor - 1.0).max())
    return fit, Correction(before, best, used, largest)
