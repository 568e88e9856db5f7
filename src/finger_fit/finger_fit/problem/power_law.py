# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The power law A = k Fᵐ fitted to the same frames, with the same weights and loss, as the
model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from ..report_units import MM2, MM4
from .goal import huber_factor, losses

if TYPE_CHECKING:
    from .cost import FitProblem


@dataclass(frozen=True)
class PowerLaw:
    """A = k F^m.

    k in m²/N^m, cost in m⁴ on the fit's frames; log_m: slope of a log–log regression.
    """

    k: float
    m: float
    cost: float
    log_m: float

    def area(self, force: np.ndarray) -> np.ndarray:
        """Area in m² at force in N."""
        return self.k * np.maximum(force, 0.0) ** self.m


def fit_power_law(problem: FitProblem) -> PowerLaw:
    """The power law that minimises J (nonlinear least squares in area, all trials together)."""
    force, measured = problem.force, problem.measured
    usable = (measured > 0) & (force > 0)
    log_m = float(np.polyfit(np.log(force[usable]), np.log(measured[usable]), 1)[0])
    k, m = power_law_of(problem, problem.weight)
    cost = float((problem.weight * losses(k * force**m - measured, problem.options)).sum())
    return PowerLaw(k, m, cost, log_m)


def power_law_of(problem: FitProblem, weight: np.ndarray) -> tuple[float, float]:
    """k (m²/N^m) and m that minimise J under weights (n,) of the frames."""
    force, measured = problem.force, problem.measured

    def best_k(m: float) -> float:
        shape = force**m
        return float((weight * shape * measured).sum() / (weight * shape * shape).sum())

    def cost(m: float, k: float) -> float:
        return float((weight * losses(k * force**m - measured, problem.options)).sum())

    # Under squared residuals k follows from m in closed form, which leaves one dimension.
    found = minimize_scalar(
        lambda m: cost(m, best_k(m)) * MM4,
        bounds=(0.05, 2.0),
        method="bounded",
        options={"xatol": 1e-10},
    )
    m = float(found.x)
    k = best_k(m)
    return _reweighted(problem, weight, k, m) if problem.options.loss == "huber" else (k, m)


def _reweighted(problem: FitProblem, weight: np.ndarray, k: float, m: float) -> tuple[float, float]:
    """k and m under the Huber loss, by iteratively reweighted least squares."""
    force, measured = problem.force, problem.measured * MM2
    scale = problem.options.huber_scale * MM2
    found = np.array([k * MM2, m])
    for _ in range(50):
        before = found
        residual = found[0] * force ** found[1] - measured
        robust = huber_factor(residual, scale)
        found = least_squares(
            lambda v, r=robust: np.sqrt(weight * r) * (v[0] * force ** v[1] - measured), before
        ).x
        if np.allclose(before, found, rtol=1e-9):
            break
    return float(found[0]) / MM2, float(found[1])
