# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fits beyond one condition's own parameters.

Parameters shared by all conditions, the epidermis thickness, and the other mode of the force.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from finger_model.geometry import LENGTHS
from finger_model.laws import ParameterSpace, ParameterSpec

from ..full_order import FullOrder
from ..nuisance_names import absorber_of
from ..problem import FitProblem, Goal, material_of, prepare_all
from ..report_units import MM4
from ..results import ConditionFit
from ..search import Coordinates, all_free, refine
from ..uncertainty import covariance

EPIDERMIS = "epidermis_thickness"
"""Key of the fitted length in geometry.yaml, and its name in fit.json."""

THICKNESS_FACTORS = (0.75, 1.0, 1.25)
"""Epidermis thicknesses of the full-order runs, over the geometry's own."""

THICKNESS_BOX = (0.6, 1.6)
"""Bounds of the fitted thickness over the geometry's own."""


class JointProblem:
    """Several conditions as one problem.

    Parameters (P, C N) of C conditions side by side; the frames of all conditions one after the
    other.
    """

    def __init__(self, problems: Sequence[FitProblem]) -> None:
        self._problems = problems
        self._splits = np.cumsum([len(p.observed) for p in problems])[:-1]

    def outputs(self, parameters: np.ndarray) -> np.ndarray:
        """Rows (P, n) in m² of all conditions."""
        parts = np.split(parameters, len(self._problems), axis=1)
        return np.concatenate([p.outputs(v) for p, v in zip(self._problems, parts)], axis=1)

    def goal(self, weight: np.ndarray | None = None) -> JointGoal:
        """The sum over the conditions."""
        weights = [None] * len(self._problems) if weight is None else np.split(weight, self._splits)
        return JointGoal([p.goal(w) for p, w in zip(self._problems, weights)], self._splits)


class JointGoal:
    """The goals of several conditions, added."""

    def __init__(self, goals: Sequence[Goal], splits: np.ndarray) -> None:
        self._goals, self._splits = goals, splits

    def cost(self, outputs: np.ndarray) -> np.ndarray:
        """Cost (…,) in m⁴ of outputs (…, n)."""
        parts = np.split(outputs, self._splits, axis=-1)
        return np.sum([goal.cost(part) for goal, part in zip(self._goals, parts)], axis=0)

    def rows(self, outputs: np.ndarray) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        """Terms as of `Goal.rows`, those of the conditions one after the other."""
        parts = np.split(outputs, self._splits)
        found = [goal.rows(part) for goal, part in zip(self._goals, parts)]

        def linear(change: np.ndarray) -> np.ndarray:
            pieces = np.split(change, self._splits, axis=-1)
            return np.concatenate([f(piece) for (_, f), piece in zip(found, pieces)], axis=-1)

        return np.concatenate([rows for rows, _ in found]), linear


def shared_fit(
    problems: dict[str, FitProblem], best: dict[str, np.ndarray], shared: Sequence[str]
) -> dict[str, Any]:
    """Joint fit with the named parameters equal in all conditions, from the separate fits' (N,).

    Returns J (mm⁴) of the joint and the separate fits, and the parameters by condition.
    """
    names = list(problems)
    first = next(iter(problems.values()))
    space, number = first.space, len(names)
    common = [space.index(name) for name in shared]
    own = [i for i in range(len(space)) if i not in common]
    single = all_free(first)

    def parameters(u: np.ndarray) -> np.ndarray:
        full = np.empty((len(u), number, len(space)))
        full[:, :, common] = u[:, None, : len(common)]
        full[:, :, own] = u[:, len(common) :].reshape(len(u), number, len(own))
        return single.parameters(full.reshape(-1, len(space))).reshape(len(u), -1)

    def of(vectors: np.ndarray) -> np.ndarray:
        logs = single.of(vectors.reshape(number, len(space)))
        return np.concatenate([logs[0, common], logs[:, own].ravel()])

    box = np.vstack([single.box[common], np.tile(single.box[own], (number, 1))])
    joint = JointProblem([problems[name] for name in names])
    vectors = np.array([best[name] for name in names])
    # From the mean, and from each condition's own value: J may have several local minima.
    logs = space.to_log(vectors)
    starts = []
    for value in (logs.mean(axis=0), *logs):
        start = logs.copy()
        start[:, common] = value[common]
        starts.append(space.from_log(start))
    fits = [refine(joint, Coordinates(box, parameters, of), start) for start in starts]
    fit = min(fits, key=lambda found: found.cost)
    found = dict(zip(names, fit.parameters.reshape(number, -1)))
    return {
        "parameters": list(shared),
        "J": sum(problems[n].area_cost(found[n]) for n in names) * MM4,
        "J_separate": sum(problems[n].area_cost(best[n]) for n in names) * MM4,
        "conditions": {
            name: {**space.mapping(v), "J": problems[name].area_cost(v) * MM4}
            for name, v in found.items()
        },
    }


class ThicknessProblem(FitProblem):
    """A problem with the epidermis thickness h (m) as an additional, last parameter.

    The model has one geometry; h enters through the ratio of full-order areas at three
    thicknesses: at given parameters, ln ratio is a parabola in ln h, row by row. Of the nuisances
    those that stand for h are left out.
    """

    def __init__(self, problem: FitProblem, thickness: float, log_ratio: np.ndarray) -> None:
        vars(self).update(vars(problem))
        low, high = (thickness * factor for factor in THICKNESS_BOX)
        own = ParameterSpec(
            EPIDERMIS, "m", LENGTHS[EPIDERMIS], "h", "mm", 1e3,
            default=thickness, bounds=(low, high),
        )  # fmt: skip
        self.space = ParameterSpace([*problem.space, own])
        self.box = np.vstack([problem.box, own.bounds])
        if problem.nuisances is not None:
            self.nuisances = problem.nuisances.without(EPIDERMIS, absorber_of(EPIDERMIS))
        self._thickness = thickness
        x = np.log(THICKNESS_FACTORS)
        below, above = log_ratio[0], log_ratio[2]
        # Parabola through 0 at x = 0 and the two outer points.
        determinant = x[0] * x[2] ** 2 - x[2] * x[0] ** 2
        self._slope = (below * x[2] ** 2 - above * x[0] ** 2) / determinant
        self._bend = (x[0] * above - x[2] * below) / determinant

    def corrected(self, parameters: np.ndarray) -> np.ndarray:
        """Areas and indentations as in the base class, for parameters (P, N + 1), h last."""
        parameters = np.atleast_2d(np.asarray(parameters, dtype=float))
        x = np.log(parameters[:, -1:] / self._thickness)
        factor = np.exp(x * self._slope + x * x * self._bend)
        return super().corrected(parameters[:, :-1]) * factor


def thickness_fit(problem: FitProblem, best: np.ndarray, full_order: FullOrder) -> dict[str, Any]:
    """Fit the thickness besides, from the best parameters (N,); each round renews the ratios."""
    geometry = full_order.geometry
    h0 = geometry.epidermis_thickness
    vector = np.append(best, h0)
    for _ in range(2):
        areas = []
        for factor in THICKNESS_FACTORS:
            changed = replace(geometry, epidermis_thickness=h0 * factor)
            model = replace(full_order, geometry=changed, refinement=1.0)
            areas.append(model.areas(problem, vector[None, :-1])[0])
        logs = np.log(np.maximum(np.array(areas), 1e-12))
        # Frames of a run that failed do not depend on the thickness.
        extended = ThicknessProblem(problem, h0, np.nan_to_num(logs - logs[1]))
        vector = refine(extended, all_free(extended), vector).parameters
    return {
        **extended.space.mapping(vector),
        "sd_log": covariance(extended, vector).deviation(EPIDERMIS),
        "J": extended.area_cost(vector) * MM4,
    }


def force_modes(fit: ConditionFit) -> dict[str, dict[str, float]]:
    """J (mm⁴) and the headline quantity with the force at its full rate and as in the paper.

    The mode that the fit did not use is refitted locally to the same trials.
    """
    options, headline = fit.problem.options, fit.space.headline
    other = "paper" if options.force == "full" else "full"
    changed = replace(options, force=other)
    records = [trial.record for trial in fit.problem.trials]
    memory = changed.memory(fit.problem.space, material_of(fit.problem.model))
    trials, _ = prepare_all(records, changed, memory)
    problem = FitProblem(trials, fit.problem.model, changed, fit.problem.known)
    problem.weigh(fit.problem.area_noise)
    if len(problem.observed) == len(fit.problem.observed):
        problem.correction = fit.problem.correction
        if fit.problem.nuisances is not None:
            problem.nuisances = fit.problem.nuisances
            drives = zip(problem.trials, fit.problem.trials)
            problem.redrive(
                [t.with_drive(known.drive.tare, known.drive.lag, changed) for t, known in drives]
            )
    free = all_free(problem)
    found = refine(problem, free, fit.parameters, tolerance=1e-5)
    return {
        options.force: {"J": fit.cost * MM4, headline: fit.quantity(headline)},
        other: {
            "J": problem.area_cost(found.parameters) * MM4,
            headline: float(fit.space.quantity(headline, found.parameters)),
        },
    }
