# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Does the model hold? What is left of the areas once noise and scatter of the presses are out.

Residuals that depend on the force in the same way in all presses, or gains of presses that follow
their duration, are no noise: another law of the tissue, another finger, a wrong unit. The intervals
of a fit do not allow for them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, ndtri

from ..results import ConditionFit

OUTLYING, FEW = 6.0, 0.1
"""Median-based deviations of the residuals beyond which a frame is an outlier, and the part of the
frames up to which outliers are few."""

BINS = 4
"""Parts of the loading by force, each with as many frames."""

SMALLEST_AREA = 1e-9
"""m² of the model, for ratios."""

SIGNIFICANT = 1e-3
"""Probability of chance below which a trend counts."""


@dataclass(frozen=True)
class Trend:
    """Mean residual over mean area (B,) of B parts of the presses, in the order of the force.

    force (B, 2): N, span of each part; loading (B,): false for frames after the peak; chance:
    probability of so much without a trend.
    """

    force: np.ndarray
    loading: np.ndarray
    residual: np.ndarray
    chance: float

    @property
    def size(self) -> float:
        """Largest mean residual over mean area; 0 where it may be chance."""
        return float(np.abs(self.residual).max()) if self.chance < SIGNIFICANT else 0.0


@dataclass(frozen=True)
class Misfit:
    """What of one condition's areas the model does not explain.

    gain: measured area over the model's, geometric mean of the presses; residual: RMS difference
    within a press over the RMS area; outliers: the few frames that carry most of it, worst first,
    empty where it is that of all frames; trend: None with too few frames; duration: change of the
    logarithm of a press's gain between the shortest and the longest loading, 0 where it may be
    chance.
    """

    gain: float
    residual: float
    outliers: np.ndarray
    trend: Trend | None
    duration: float


def misfit(fit: ConditionFit, gains: np.ndarray) -> Misfit:
    """Compare areas and model of a fitted condition; gains (T,): measured area over the model's of
    each press, NaN of one that does not count."""
    problem = fit.problem
    measured, trial = problem.measured, problem.trial_of
    left = measured - gains[trial] * fit.areas
    counted = np.isfinite(left)
    residual = float(np.sqrt((left[counted] ** 2).sum() / (measured[counted] ** 2).sum()))
    return Misfit(
        float(np.exp(np.nanmean(np.log(gains)))),
        residual,
        _outliers(fit),
        _trend(fit, left),
        _by_duration(fit, gains),
    )


def _outliers(fit: ConditionFit) -> np.ndarray:
    """Indices of the few frames whose residuals carry more than half of the squares; by medians,
    which they do not move."""
    problem = fit.problem
    measured, trial = problem.measured, problem.trial_of
    ratio = measured / np.maximum(fit.areas, SMALLEST_AREA)
    gains = np.array([np.median(ratio[trial == t]) for t in range(len(problem))])
    left = measured - gains[trial] * fit.areas
    size = np.abs(left)
    found = np.flatnonzero(size > OUTLYING * np.median(size) / ndtri(0.75))
    squares = left**2
    if len(found) > FEW * len(left) or 2.0 * squares[found].sum() < squares.sum():
        return np.zeros(0, dtype=int)
    return found[np.argsort(-size[found], kind="stable")]


def _trend(fit: ConditionFit, left: np.ndarray) -> Trend | None:
    """Look for a trend of residuals (n,) in m² over the force, above the low force: below it an
    outline loses area."""
    problem = fit.problem
    force, trial = problem.force, problem.trial_of
    high = force >= problem.options.low_force
    loading = np.concatenate([t.frame_time <= t.loading for t in problem.trials])
    parts: list[tuple[np.ndarray, bool]] = []
    for side in (True, False):
        rows = np.flatnonzero(high & (loading == side))
        number = min(BINS, len(rows) // max(len(problem), 1))
        if number:
            order = rows[np.argsort(force[rows], kind="stable")]
            parts += [(part, side) for part in np.array_split(order, number)]
    means: list[float] = []
    weight: list[int] = []
    between, degrees = 0.0, 0
    for part, _ in parts:
        presses = np.unique(trial[part])
        own = np.array([left[part[trial[part] == t]].mean() for t in presses])
        means.append(float(own.mean()))
        weight.append(len(own))
        between += float(((own - own.mean()) ** 2).sum())
        degrees += len(own) - 1
    if degrees < 2 or between <= 0.0:
        return None
    ratio = float(np.array(weight) @ np.square(means)) / len(parts) / (between / degrees)
    return Trend(
        np.array([[force[p].min(), force[p].max()] for p, _ in parts]),
        np.array([side for _, side in parts]),
        np.array([m / problem.measured[p].mean() for m, (p, _) in zip(means, parts)]),
        float(fdtrc(len(parts), degrees, ratio)),
    )


def _by_duration(fit: ConditionFit, gains: np.ndarray) -> float:
    """Change of log gains (T,) between the shortest and the longest loading."""
    durations = np.array([trial.loading for trial in fit.problem.trials])
    known = np.isfinite(gains)
    gains, durations = gains[known], durations[known]
    if len(gains) < 4 or not durations.min() > 0 or durations.max() < 1.2 * durations.min():
        return 0.0
    from scipy.stats import linregress  # half a second

    found = linregress(np.log(durations), np.log(gains))
    span = float(np.log(durations.max() / durations.min()))
    return float(found.slope) * span if found.pvalue < SIGNIFICANT else 0.0
