# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Free coordinates of a search: which parameters may vary, and inside which box."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import brentq

from finger_model.laws import ParameterSpace


@dataclass(frozen=True)
class Coordinates:
    """Free coordinates u of a search, on the space's logarithmic scale.

    box (D, 2): lowest and highest u; parameters: from u (P, D) to parameters (P, N) in SI units;
    of: from parameters (…, N) to u (…, D).
    """

    box: np.ndarray
    parameters: Callable[[np.ndarray], np.ndarray]
    of: Callable[[np.ndarray], np.ndarray]


class Boxed(Protocol):
    """A parameter space and a search box (N, 2) in SI units, such as a FitProblem."""

    space: ParameterSpace
    box: np.ndarray


def all_free(problem: Boxed) -> Coordinates:
    """All parameters free inside the box."""
    space, (low, high) = problem.space, problem.box.T
    return Coordinates(
        space.to_log(problem.box.T).T,
        lambda u: np.clip(space.from_log(u), low, high),
        space.to_log,
    )


def held(problem: Boxed, name: str, value: float) -> Coordinates | None:
    """A quantity held at a value (SI), the rest free inside the box.

    One parameter follows from the held value: the quantity itself, or the one that the derived
    quantity is solved for. None where the box holds no parameters with that value.
    """
    space, box = problem.space, problem.box
    follows = space.derived[name].solves_for if name in space.derived else name
    dependent = space.index(follows)
    free = [i for i in range(len(space)) if i != dependent]
    inner = np.array(box, dtype=float)
    if name in space.derived:
        others = [space.index(n) for n in space.derived[name].of if n != follows]
        # With one other parameter its feasible values form an interval; with more, the clipping
        # below keeps the box.
        if len(others) == 1:
            found = _feasible(problem, name, value, others[0], dependent)
            if found is None:
                return None
            inner[others[0]] = found
    low, high = inner.T

    def parameters(u: np.ndarray) -> np.ndarray:
        full = np.zeros((len(u), len(space)))
        full[:, free] = u
        out = np.clip(space.from_log(full), low, high)
        out = space.with_quantity(name, out, np.full(len(u), value))
        if name in space.derived:
            out[:, dependent] = np.clip(out[:, dependent], low[dependent], high[dependent])
        return out

    return Coordinates(
        space.to_log(inner.T).T[free],
        parameters,
        lambda vectors: space.to_log(vectors)[..., free],
    )


def _feasible(
    problem: Boxed, name: str, value: float, other: int, dependent: int
) -> tuple[float, float] | None:
    """Values of parameter `other` for which `dependent` stays in its bounds, the quantity held."""
    space, box = problem.space, problem.box
    vector = np.sqrt(box[:, 0] * box[:, 1])

    def difference(at: float, end: float) -> float:
        vector[[other, dependent]] = np.exp(at), end
        return float(np.log(space.quantity(name, vector) / value))

    low, high = np.log(box[other])
    inside = []
    for end in box[dependent]:
        if difference(low, end) * difference(high, end) < 0:
            inside.append(brentq(difference, low, high, args=(end,), xtol=1e-15, rtol=1e-15))
    for at in (low, high):
        if difference(at, box[dependent, 0]) * difference(at, box[dependent, 1]) <= 0:
            inside.append(at)
    if not inside:
        return None
    return float(np.exp(min(inside))), float(np.exp(max(inside)))
