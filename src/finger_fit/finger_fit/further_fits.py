"""Fits beyond the paper's four parameters per condition: shared parameters, and the epidermis thickness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from finger_model.geometry import Geometry
from finger_model.material import Material
from finger_model.parameter_sets import PARAMETER_NAMES

from .engine import DaskEngine, LocalEngine
from .full_order_check import full_order_areas
from .identifiability import inverse_of
from .local import Coordinates, refine
from .options import FitOptions
from .problem import MM4, FitProblem

THICKNESS_FACTORS = (0.75, 1.0, 1.25)
"""Epidermis thicknesses at which the full-order model is run, over the geometry's own."""

THICKNESS_BOX = (0.6, 1.6)
"""Bounds of the fitted thickness over the geometry's own."""


class Stacked:
    """Several problems as one: parameters (P, 4 C) of C conditions side by side, frames one after the other."""

    def __init__(self, problems: Sequence[FitProblem]) -> None:
        self._problems = problems
        self.options: FitOptions = problems[0].options
        self.measured = np.concatenate([p.measured for p in problems])
        self.weight = np.concatenate([p.weight for p in problems])

    def areas(self, parameters: np.ndarray) -> np.ndarray:
        """Areas (P, n) in m² of all conditions."""
        return np.concatenate(
            [p.areas(parameters[:, 4 * c : 4 * c + 4]) for c, p in enumerate(self._problems)],
            axis=1,
        )

    def losses(self, areas: np.ndarray) -> np.ndarray:
        """Loss in m⁴ of every frame."""
        starts = np.cumsum([0, *(len(p.measured) for p in self._problems)])
        return np.concatenate(
            [p.losses(areas[..., a:b]) for p, a, b in zip(self._problems, starts[:-1], starts[1:])],
            axis=-1,
        )


def shared_fit(
    problems: dict[str, FitProblem], best: dict[str, np.ndarray], shared: Sequence[str]
) -> dict[str, Any]:
    """Joint fit with the named parameters equal in all conditions, from the separate fits' parameters (4,).

    Returns J (mm⁴) of the joint and the separate fits, and the parameters by condition.
    """
    names = list(problems)
    box = next(iter(problems.values())).box
    common = [PARAMETER_NAMES.index(name) for name in shared]
    own = [i for i in range(4) if i not in common]
    free_box = np.log(np.vstack([box[common], *[box[own] for _ in names]]))

    def parameters(u: np.ndarray) -> np.ndarray:
        values = np.exp(u)
        out = np.empty((len(u), 4 * len(names)))
        for c in range(len(names)):
            out[:, [4 * c + i for i in common]] = values[:, : len(common)]
            first = len(common) + c * len(own)
            out[:, [4 * c + i for i in own]] = values[:, first : first + len(own)]
        return np.clip(out, np.tile(box[:, 0], len(names)), np.tile(box[:, 1], len(names)))

    logs = np.array([np.log(best[name]) for name in names])
    stacked = Stacked([problems[name] for name in names])
    # From the mean, and from each condition's own value: the shared valley may have several low places.
    starts = [logs[:, common].mean(axis=0), *logs[:, common]]
    fits = [
        refine(
            stacked,  # type: ignore[arg-type]
            Coordinates(free_box, parameters),
            np.concatenate([start, logs[:, own].ravel()]),
        )
        for start in starts
    ]
    fit = min(fits, key=lambda found: found.cost)
    conditions = {}
    for c, name in enumerate(names):
        vector = fit.parameters[4 * c : 4 * c + 4]
        conditions[name] = {
            **dict(zip(PARAMETER_NAMES, map(float, vector))),
            "J": float(problems[name].cost(vector)[0]) * MM4,
        }
    separate = sum(float(problems[name].cost(best[name])[0]) for name in names)
    return {
        "parameters": list(shared),
        "J": fit.cost * MM4,
        "J_separate": separate * MM4,
        "conditions": conditions,
    }


class WithThickness:
    """A problem with a fifth parameter, the epidermis thickness h (m).

    The reduced model knows one geometry; h enters through the ratio of full-order areas at three thicknesses, at
    given parameters: ln ratio is a parabola in ln h, frame by frame.
    """

    def __init__(self, problem: FitProblem, thickness: float, log_ratio: np.ndarray) -> None:
        self._problem = problem
        self._thickness = thickness
        self.options, self.measured, self.weight = (
            problem.options, problem.measured, problem.weight
        )  # fmt: skip
        self.losses = problem.losses
        x = np.log(THICKNESS_FACTORS)
        low, high = log_ratio[0], log_ratio[2]
        # Parabola through 0 at x = 0 and the two outer points.
        determinant = x[0] * x[2] ** 2 - x[2] * x[0] ** 2
        self._slope = (low * x[2] ** 2 - high * x[0] ** 2) / determinant
        self._bend = (x[0] * high - x[2] * low) / determinant

    def areas(self, parameters: np.ndarray) -> np.ndarray:
        """Areas (P, n) in m² of parameters (P, 5): E0, E1, tau1, E2, h."""
        x = np.log(parameters[:, 4:5] / self._thickness)
        return self._problem.areas(parameters[:, :4]) * np.exp(x * self._slope + x * x * self._bend)


def thickness_fit(
    problem: FitProblem,
    best: np.ndarray,
    geometry: Geometry,
    engine: LocalEngine | DaskEngine,
    rounds: int = 2,
) -> dict[str, Any]:
    """Fit five parameters from the four-parameter best (4,); the ratios are renewed at each round's result."""
    h0 = geometry.epidermis_thickness
    box = np.vstack([problem.box, [h0 * THICKNESS_BOX[0], h0 * THICKNESS_BOX[1]]])
    coordinates = Coordinates(np.log(box), lambda u: np.clip(np.exp(u), box[:, 0], box[:, 1]))
    vector = np.append(best, h0)
    for _ in range(rounds):
        log_ratio = _log_ratios(problem, vector[:4], geometry, engine)
        extended = WithThickness(problem, h0, log_ratio)
        fit = refine(extended, coordinates, np.log(vector))  # type: ignore[arg-type]
        vector = fit.parameters
    step = 5e-3
    shifts = np.eye(5) * step
    areas = extended.areas(np.exp(np.vstack([np.log(vector) + shifts, np.log(vector) - shifts])))
    slope = (areas[:5] - areas[5:]) / (2 * step)
    residual = extended.areas(vector[None])[0] - problem.measured
    noise = np.sqrt((residual**2).sum() / max(len(residual) - 5, 1))
    deviation = np.sqrt(np.diag(inverse_of(slope @ slope.T / noise**2)))
    return {
        **dict(zip(PARAMETER_NAMES, map(float, vector))),
        "epidermis_thickness": float(vector[4]),
        "sd_log": float(deviation[4]),
        "J": fit.cost * MM4,
    }


def _log_ratios(
    problem: FitProblem,
    parameters: np.ndarray,
    geometry: Geometry,
    engine: LocalEngine | DaskEngine,
) -> np.ndarray:
    """ln of full-order area over that of the geometry's own thickness (3, n), at each frame."""
    rows = []
    for factor in THICKNESS_FACTORS:
        changed = replace(geometry, epidermis_thickness=geometry.epidermis_thickness * factor)
        items = [(tuple(map(float, parameters)), k) for k in range(len(problem))]
        shared = (changed, 1.0, Material(), problem.trials)
        rows.append(np.concatenate(engine.spread(full_order_areas, shared, items)))
    logs = np.log(np.maximum(np.array(rows), 1e-12))
    # A run that failed has no say: the frame then does not depend on the thickness.
    return np.nan_to_num(logs - logs[1])
