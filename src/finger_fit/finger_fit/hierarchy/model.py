# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A hierarchical model of one quantity over subjects and conditions.

With y the logarithm of the fitted quantity of subject i in condition j,

    y_ij = x_ij β + u_i + v_ij + Σ_k a_ijk z_ik + g_ij z + e_ij,

where β are the population's means of the conditions (or level and slope over moisture), u_i ~ N(0,
σ_u²) what subject i has in all conditions, v_ij ~ N(0, σ_v²) what one condition of it has alone,
e_ij ~ N(0, s_ij²) the error of the fit, a_ijk what one deviation of assumed length k does to the
estimate (z_ik ~ N(0, 1), the same in all conditions of a subject), and g_ij what one deviation of
the gain of all areas does (z ~ N(0, 1), the same for all subjects: one plate). So every fit enters
as a Gaussian in the logarithm (Laplace). Priors: β ~ N(level, level_sd²), slopes N(0, slope_sd²), σ
half-normal.

Given both σ everything else is Gaussian and integrated in closed form. Over the two σ a grid of
equal prior mass is summed, so that draws are independent: no chain has to converge. What is to be
watched instead is that the grid resolves the posterior (`Posterior.cells`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from finger_common.errors import InputError

POINTS = 48
"""Points of the grid per standard deviation."""

FEWEST_CELLS = 10.0
"""Effective number of grid cells below which the grid is too coarse for the posterior."""

_ABSENT = 1e8
"""Variance of what was not measured."""


@dataclass(frozen=True)
class HierarchyPriors:
    """Priors of the logarithms (assumptions); all standard deviations.

    level, level_sd: of the conditions' means; slope_sd: per unit of the further columns;
    subject_sd, condition_sd: scales of the half-normal σ_u, σ_v.
    """

    level: float = 0.0
    level_sd: float = 2.0
    slope_sd: float = 1.0
    subject_sd: float = 0.5
    condition_sd: float = 0.3


@dataclass(frozen=True)
class Estimates:
    """Fitted logarithms of n subjects in m conditions.

    value (n, m): NaN where there is none; sd (n, m): of the fit alone; shared (n, m, k): change by
    one deviation of each assumed length; common (n, m): by one of the gain of all areas; design
    (n, m, p): columns of β, of which the first `levels` are levels.
    """

    value: np.ndarray
    sd: np.ndarray
    shared: np.ndarray
    common: np.ndarray
    design: np.ndarray
    levels: int

    @classmethod
    def of_conditions(
        cls, value: np.ndarray, sd: np.ndarray, shared: np.ndarray, common: np.ndarray
    ) -> Estimates:
        """Give each condition a mean of its own."""
        number, conditions = value.shape
        design = np.broadcast_to(np.eye(conditions), (number, conditions, conditions))
        return cls(value, sd, shared, common, design, conditions)

    @classmethod
    def of_covariate(
        cls,
        value: np.ndarray,
        sd: np.ndarray,
        shared: np.ndarray,
        common: np.ndarray,
        covariate: np.ndarray,
    ) -> Estimates:
        """Let the mean follow a covariate (n, m): a level and a slope."""
        design = np.stack([np.ones_like(covariate), np.nan_to_num(covariate)], axis=-1)
        known = np.where(np.isfinite(covariate), value, np.nan)
        return cls(known, sd, shared, common, design, 1)


@dataclass(frozen=True)
class Posterior:
    """Independent draws: beta (d, p), subject_sd, condition_sd (d,), effect (d, n): u_i.

    cells: effective number of grid cells that hold the posterior; edge: its mass in the outermost
    cells of a σ, which the prior alone keeps from growing.
    """

    beta: np.ndarray
    subject_sd: np.ndarray
    condition_sd: np.ndarray
    effect: np.ndarray
    cells: float
    edge: float

    @property
    def problems(self) -> list[str]:
        """Why the numbers should not be trusted; empty when they can be."""
        found = []
        if self.cells < FEWEST_CELLS:
            found.append(
                f"the posterior of the spreads lies in {self.cells:.0f} cells of the grid: too "
                "coarse for these data"
            )
        if self.edge > 0.05:
            found.append(
                "the spread between people is as large as its prior allows: too few subjects, or a "
                "wider prior is needed"
            )
        return found


def posterior(
    data: Estimates, priors: HierarchyPriors | None = None, draws: int = 4000, seed: int = 0
) -> Posterior:
    """Posterior of the model; raises InputError for fewer than three subjects."""
    priors = priors or HierarchyPriors()
    present = np.isfinite(data.value)
    number, conditions = data.value.shape
    if int(present.any(axis=1).sum()) < 3:
        raise InputError(
            f"population: {int(present.any(axis=1).sum())} subjects, at least three are needed to "
            "tell the spread between people"
        )
    columns = data.design.shape[2]
    y = np.where(present, data.value, 0.0)
    # The gain of all areas is one more coefficient, with a standard normal prior.
    x = np.concatenate([data.design, data.common[..., None]], axis=2) * present[..., None]
    mean = np.array([priors.level] * data.levels + [0.0] * (columns - data.levels + 1))
    deviation = np.array(
        [priors.level_sd] * data.levels + [priors.slope_sd] * (columns - data.levels) + [1.0]
    )
    known = data.shared * present[..., None]
    own = known @ np.swapaxes(known, 1, 2)
    own = own + np.where(present, data.sd, _ABSENT**0.5)[:, :, None] ** 2 * np.eye(conditions)

    places = (np.arange(POINTS) + 0.5) / POINTS
    first = priors.subject_sd * norm.ppf(0.5 + 0.5 * places)
    second = priors.condition_sd * norm.ppf(0.5 + 0.5 * places)
    both = present[:, :, None] & present[:, None, :]
    unit = np.eye(conditions) * present[:, :, None]
    weights = np.empty((POINTS, POINTS))
    means = np.empty((POINTS, POINTS, columns + 1))
    roots = np.empty((POINTS, POINTS, columns + 1, columns + 1))
    inverses = {}
    for i, a in enumerate(first):
        blocks = own + a * a * both + second[:, None, None, None] ** 2 * unit
        inverse = np.linalg.inv(blocks)  # (POINTS, n, m, m)
        _, logs = np.linalg.slogdet(blocks)
        precision = np.einsum("nmp,gnmk,nkq->gpq", x, inverse, x) + np.diag(deviation**-2.0)
        pull = np.einsum("nmp,gnmk,nk->gp", x, inverse, y) + mean / deviation**2
        square = np.einsum("nm,gnmk,nk->g", y, inverse, y)
        covariance = np.linalg.inv(precision)
        means[i] = np.einsum("gpq,gq->gp", covariance, pull)
        roots[i] = np.linalg.cholesky(covariance)
        gain = np.einsum("gp,gp->g", pull, means[i])
        weights[i] = -0.5 * (logs.sum(axis=1) + np.linalg.slogdet(precision)[1] + square - gain)
        inverses[i] = inverse
    weights = np.exp(weights - weights.max())
    weights /= weights.sum()

    rng = np.random.default_rng(seed)
    cell = rng.choice(POINTS * POINTS, size=draws, p=weights.reshape(-1))
    rows, cols = np.divmod(cell, POINTS)
    normal = rng.normal(size=(draws, columns + 1))
    beta = means[rows, cols] + np.einsum("dpq,dq->dp", roots[rows, cols], normal)
    # u_i given β: the part of the residual that all conditions of the subject share.
    effect = np.empty((draws, number))
    for i in np.unique(rows):
        chosen = rows == i
        inverse = inverses[i][cols[chosen]]
        residual = y - np.einsum("nmp,dp->dnm", x, beta[chosen])
        reach = present.astype(float)
        pulled = np.einsum("nm,dnmk,dnk->dn", reach, inverse, residual) * first[i] ** 2
        left = first[i] ** 2 - first[i] ** 4 * np.einsum("nm,dnmk,nk->dn", reach, inverse, reach)
        effect[chosen] = pulled + np.sqrt(np.maximum(left, 0.0)) * rng.normal(size=pulled.shape)
    inside = (rng.random(size=(2, draws)) - 0.5) / POINTS
    edge = max(weights[-1].sum(), weights[:, -1].sum())
    return Posterior(
        beta[:, :columns],
        priors.subject_sd * norm.ppf(0.5 + 0.5 * (places[rows] + inside[0])),
        priors.condition_sd * norm.ppf(0.5 + 0.5 * (places[cols] + inside[1])),
        effect,
        float(1.0 / (weights**2).sum()),
        float(edge),
    )


def ends(values: Sequence[float] | np.ndarray) -> dict[str, float]:
    """Median and 95 % interval of draws."""
    low, middle, high = np.quantile(values, [0.025, 0.5, 0.975])
    return {"median": float(middle), "low": float(low), "high": float(high)}
