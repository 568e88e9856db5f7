# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bounded local least squares in the logarithm of the parameters, several candidates per batch.

A damped Gauss–Newton method (Levenberg–Marquardt). Every step solves the linearised problem within
the bounds (scipy's lsq_linear) for three dampings at once and keeps the best. A bound that is
active is reached exactly, so that the report can name the active bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import lsq_linear

from .coordinates import Coordinates

DIFFERENCE = 2e-3
"""Step of the finite differences in logarithm: far above rounding, far below the curvature of the
area."""

DAMPINGS = (0.1, 1.0, 10.0)
"""Factors on the damping that are tried at once."""

WAY = np.linspace(0.0, 1.0, 9)[1:]
"""Parts of a way at which parameters are looked for that carry the load."""


class Target(Protocol):
    """What is minimised, as a function of a problem's outputs: a `problem.Goal`, or several."""

    def cost(self, outputs: np.ndarray) -> np.ndarray:
        """Cost (…,) in m⁴ of outputs (…, n)."""
        ...

    def rows(self, outputs: np.ndarray) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        """The cost near outputs (n,) as a sum of squares; see `problem.Goal.rows`."""
        ...


class Problem(Protocol):
    """What a local fit needs of a problem: a FitProblem, or one that is built from FitProblems."""

    def outputs(self, parameters: np.ndarray) -> np.ndarray:
        """Rows (P, n) in m², areas and others, for parameters (P, N)."""
        ...

    def goal(self, weight: np.ndarray | None = None) -> Target:
        """What is minimised, under weights (n,) of the rows in place of the problem's own."""
        ...


@dataclass(frozen=True)
class LocalFit:
    """Result: parameters (N,) in SI units, J in m⁴ (with the weights given), evaluations made."""

    parameters: np.ndarray
    cost: float
    evaluations: int


def carrying(
    problem: Problem, coordinates: Coordinates, parameters: np.ndarray
) -> np.ndarray | None:
    """Parameters (N,) if the model carries the load with them, else the nearest ones that do on the
    way to the middle of the box or, where none do, to its upper end; None where none of them does.
    """
    box, start = coordinates.box, coordinates.of(parameters)
    ways = [start + WAY[:, None] * (end - start) for end in (box.mean(axis=1), box[:, 1])]
    for points in (parameters[None], *map(coordinates.parameters, ways)):
        carried = np.isfinite(problem.outputs(points)).all(axis=1)
        if carried.any():
            return points[int(np.argmax(carried))]
    return None


def refine(
    problem: Problem,
    coordinates: Coordinates,
    start: np.ndarray,
    frame_weights: np.ndarray | None = None,
    iterations: int = 40,
    tolerance: float = 1e-7,
) -> LocalFit:
    """Minimise J from the parameters `start` (N,).

    frame_weights (n,): in place of the problem's own, as the bootstrap has them; tolerance:
    relative decrease of J that ends the search. A start that cannot carry the load gives way as in
    `carrying`; where nothing can carry it, J stays infinite.
    """
    goal = problem.goal(frame_weights)
    box = coordinates.box
    span = box[:, 1] - box[:, 0]
    dimension = len(box)
    spent = 0

    def outputs(u: np.ndarray) -> np.ndarray:
        nonlocal spent
        spent += len(u)
        return problem.outputs(coordinates.parameters(u))

    u = np.clip(coordinates.of(np.asarray(start, dtype=float)), box[:, 0], box[:, 1])
    if dimension == 0 or not np.any(span > 0):
        cost = float(goal.cost(outputs(u[None]))[0])
        return LocalFit(coordinates.parameters(u[None])[0], cost, spent)
    damping = 1e-3
    base = None
    cost = np.inf
    for _ in range(iterations):
        # The steps of the differences point into the box.
        step = np.where(u + DIFFERENCE <= box[:, 1], DIFFERENCE, -DIFFERENCE)
        moved = u + np.diag(step)
        if base is None:
            rows = outputs(np.vstack([u, moved]))
            base, neighbours = rows[0], rows[1:]
            cost = float(goal.cost(base))
            if not np.isfinite(cost):
                nearest = carrying(problem, coordinates, coordinates.parameters(u[None])[0])
                if nearest is None:
                    break
                u, base = coordinates.of(nearest), None
                continue
        else:
            neighbours = outputs(moved)
        residual, linear = goal.rows(base)
        # A neighbour that cannot carry the load tells nothing.
        neighbours = np.where(np.isfinite(neighbours), neighbours, base)
        jacobian = (linear(neighbours - base) / step[:, None]).T
        scale = np.sqrt((jacobian**2).sum(axis=0))
        scale = np.maximum(scale, 1e-6 * max(scale.max(), 1e-30))
        improved = False
        for _attempt in range(3):
            limits = box - u[:, None]
            moves = [
                _damped_move(jacobian, residual, np.sqrt(damping * factor) * scale, limits)
                for factor in DAMPINGS
            ]
            candidates = np.clip(u + np.array(moves), box[:, 0], box[:, 1])
            found = outputs(candidates)
            costs = goal.cost(found)
            pick = int(np.argmin(costs))
            damping *= DAMPINGS[pick]
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
    return LocalFit(coordinates.parameters(u[None])[0], cost, spent)


def _damped_move(
    jacobian: np.ndarray, residual: np.ndarray, damping: np.ndarray, limits: np.ndarray
) -> np.ndarray:
    """Step (D,) within limits (D, 2) that minimises the linearised problem and its damping (D,)."""
    return lsq_linear(
        np.vstack([jacobian, np.diag(damping)]),
        np.concatenate([-residual, np.zeros(len(damping))]),
        bounds=_open(limits),
        method="bvls" if len(damping) > 1 else "trf",
    ).x


def _open(limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (D, 2) of a step for lsq_linear, which refuses equal ones."""
    low, high = np.minimum(limits[:, 0], 0.0), np.maximum(limits[:, 1], 0.0)
    return low - 1e-12, high + 1e-12
