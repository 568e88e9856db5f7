"""Bounded local least squares in the logarithm of the parameters, several candidates per batch.

A damped Gauss–Newton method (Levenberg–Marquardt): every step solves the linearised problem within the bounds
exactly (scipy's lsq_linear), for three dampings at once, and keeps the best. Bounds become active exactly, which
is what a report on active bounds needs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from .problem import MM2, FitProblem

DIFFERENCE = 2e-3
"""Step of the finite differences in logarithm: far above rounding, far below the curvature of the area."""


@dataclass(frozen=True)
class Coordinates:
    """Free coordinates u of a search: box (D, 2) in logarithm, and the map from u (P, D) to parameters (P, 4)."""

    box: np.ndarray
    parameters: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class LocalFit:
    """Result: free coordinates u (D,), parameters (4,), J in m⁴ (with the weights of the trials), and the
    evaluations spent."""

    free: np.ndarray
    parameters: np.ndarray
    cost: float
    evaluations: int


def whole_box(box: np.ndarray) -> Coordinates:
    """All four parameters free inside box (4, 2), given in SI."""
    low, high = box[:, 0], box[:, 1]
    return Coordinates(np.log(box), lambda u: np.clip(np.exp(u), low, high))


def with_fixed(box: np.ndarray, index: int, value: float) -> Coordinates:
    """Parameter `index` held at value, the other three free inside box (4, 2)."""
    others = [i for i in range(len(box)) if i != index]
    low, high = box[:, 0], box[:, 1]

    def parameters(u: np.ndarray) -> np.ndarray:
        out = np.empty((len(u), len(box)))
        out[:, others] = np.clip(np.exp(u), low[others], high[others])
        out[:, index] = value
        return out

    return Coordinates(np.log(box[others]), parameters)


def with_composite(box: np.ndarray, composite: float) -> Coordinates | None:
    """Composite modulus held at a value (Pa): E0, tau1 and E2 free, E1 follows. None where the box has no such E."""
    (low0, high0), (low1, high1) = box[0], box[1]
    # 1/E0 = 1/E − 1/E1 must lie between the bounds' reciprocals.
    least = max(1.0 / high0, 1.0 / composite - 1.0 / low1)
    most = min(1.0 / low0, 1.0 / composite - 1.0 / high1)
    if not 0 < least <= most:
        return None
    inner = np.array([[1.0 / most, 1.0 / least], box[2], box[3]])

    def parameters(u: np.ndarray) -> np.ndarray:
        free = np.clip(np.exp(u), inner[:, 0], inner[:, 1])
        first = 1.0 / np.clip(1.0 / composite - 1.0 / free[:, 0], 1.0 / high1, 1.0 / low1)
        return np.column_stack([free[:, 0], first, free[:, 1], free[:, 2]])

    return Coordinates(np.log(inner), parameters)


def refine(
    problem: FitProblem,
    coordinates: Coordinates,
    start: np.ndarray,
    trial_weights: np.ndarray | None = None,
    iterations: int = 40,
    tolerance: float = 1e-7,
    offset: np.ndarray | None = None,
) -> LocalFit:
    """Minimise J from start u (D,).

    trial_weights (T,): multiplicity of every trial (bootstrap), ones when None; offset (n,) m² is added to the
    model's areas (the difference of another model); tolerance: relative decrease of J that ends the search.
    """
    weight = problem.weight
    if trial_weights is not None:
        weight = weight * np.asarray(trial_weights, dtype=float)[problem.trial_of]
    shift = 0.0 if offset is None else offset
    box = coordinates.box
    span = box[:, 1] - box[:, 0]
    dimension = len(box)
    spent = 0

    def areas(u: np.ndarray) -> np.ndarray:
        nonlocal spent
        spent += len(u)
        return problem.areas(coordinates.parameters(u)) + shift

    def total(area: np.ndarray) -> np.ndarray:
        return (weight * problem.losses(area)).sum(axis=-1)

    u = np.clip(np.asarray(start, dtype=float), box[:, 0], box[:, 1])
    if dimension == 0 or not np.any(span > 0):
        area = areas(u[None])
        return LocalFit(u, coordinates.parameters(u[None])[0], float(total(area)[0]), spent)
    damping = 1e-3
    base = None
    cost = np.inf
    for _ in range(iterations):
        # Differences point into the box.
        step = np.where(u + DIFFERENCE <= box[:, 1], DIFFERENCE, -DIFFERENCE)
        moved = u + np.diag(step)
        if base is None:
            rows = areas(np.vstack([u, moved]))
            base, moved_areas = rows[0], rows[1:]
            cost = float(total(base))
        else:
            moved_areas = areas(moved)
        residual = base - problem.measured
        root = np.sqrt(weight * robust_factor(problem, residual))
        jacobian = (root * (moved_areas - base) / step[:, None]).T * MM2
        target = -root * residual * MM2
        scale = np.sqrt((jacobian**2).sum(axis=0))
        scale = np.maximum(scale, 1e-6 * max(scale.max(), 1e-30))
        improved = False
        for _attempt in range(3):
            trials = []
            for factor in (0.1, 1.0, 10.0):
                system = np.vstack([jacobian, np.diag(np.sqrt(damping * factor) * scale)])
                move = lsq_linear(
                    system,
                    np.concatenate([target, np.zeros(dimension)]),
                    bounds=_open(box - u[:, None]),
                    method="bvls" if dimension > 1 else "trf",
                ).x
                trials.append(np.clip(u + move, box[:, 0], box[:, 1]))
            candidates = np.array(trials)
            found = areas(candidates)
            costs = total(found)
            pick = int(np.argmin(costs))
            damping *= (0.1, 1.0, 10.0)[pick]
            if costs[pick] < cost:
                improved = True
                break
            damping *= 100.0
        if not improved:
            break
        gain = (cost - costs[pick]) / max(cost, 1e-300)
        u, base, cost = candidates[pick], found[pick], float(costs[pick])
        damping = max(damping, 1e-9)
        if gain < tolerance:
            break
    return LocalFit(u, coordinates.parameters(u[None])[0], cost, spent)


def _open(limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (D, 2) of a step for lsq_linear, which refuses equal ones."""
    low, high = np.minimum(limits[:, 0], 0.0), np.maximum(limits[:, 1], 0.0)
    return low - 1e-12, high + 1e-12


def robust_factor(problem: FitProblem, residual: np.ndarray) -> np.ndarray:
    """Weights (n,) that turn squares into the options' robust loss near these residuals (m²); ones for squares."""
    if problem.options.loss != "huber":
        return np.ones_like(residual)
    return np.minimum(1.0, problem.options.huber_scale / np.maximum(np.abs(residual), 1e-30))
