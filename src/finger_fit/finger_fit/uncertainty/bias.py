# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bias of the estimates, and bias-corrected values (bootstrap bias correction).

A least-squares estimate of a nonlinear model is biased, even in the middle of the box (Box 1971). A
bound of the box that cuts off part of the estimate's spread adds to the bias. Both are measured
here. Synthetic data are made at the fitted parameters, with the fit's own residuals as noise, and
are fitted in the same box. The mean difference between these fits and the parameters that made
their data is the bias (Efron and Tibshirani 1993, chapter 10). It is subtracted once from the
logarithm of the estimate.

The noise is a wild cluster bootstrap (Cameron, Gelbach and Miller 2008): the residuals of a trial
are kept together and get one random sign, so that errors shared by a trial's frames stay shared.
Nothing is assumed about their size. Every draw is used with both signs (antithetic pairs): the part
of the error that is odd in the noise cancels, and the bias is left. Twenty pairs give it to
0.02–0.11 standard deviations of the estimate (docs/study.md).

A corrected value may lie outside the box by part of a standard deviation. Clipped to the bound it
would be biased again: an estimate in a corner of the box can err to one side only.

Sources: M. J. Box, J. R. Stat. Soc. B 33 (1971) 171–201; B. Efron and R. J. Tibshirani, An
Introduction to the Bootstrap, 1993; A. C. Cameron, J. B. Gelbach and D. L. Miller, Rev. Econ. Stat.
90 (2008) 414–427.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from finger_model.laws import ParameterSpace

from ..problem import FitProblem
from ..search import all_free, refine
from .profiles import Profile


@dataclass(frozen=True)
class BiasCorrected:
    """A quantity corrected for bias.

    value: SI; bias: subtracted from the logarithm of the estimate; bias_error: standard error of
    the bias, from the finite number of pairs.
    """

    value: float
    bias: float
    bias_error: float


def bias_pair(problem: FitProblem, best: np.ndarray, seed: int, index: int) -> np.ndarray:
    """Parameters (2, N) refitted to the `index`-th antithetic pair of synthetic data sets.

    The data are made at the best parameters (N,); the result is the same on every machine.
    """
    rng = np.random.default_rng([seed, index, 1])
    rows = problem.outputs(best)[0]
    number = len(problem)
    goal = problem.goal()
    residual = goal.residuals(rows)
    if problem.nuisances is not None:
        residual = residual + problem.nuisances.slope @ goal.moves(residual)
    # The fit has absorbed part of the scatter of the trials.
    residual = -residual * np.sqrt(number / max(number - 1, 1))
    signs = rng.choice([-1.0, 1.0], number)
    synthetic = copy.copy(problem)
    coordinates = all_free(problem)
    fits = []
    for sign in (1.0, -1.0):
        made = rows
        if problem.nuisances is not None:
            # The gains of the presses flip with their residuals.
            synthetic.nuisances = problem.nuisances.with_gains(sign * signs, problem.trial_of)
            made = rows * synthetic.nuisances.factor
        synthetic.observed = made + sign * (residual * signs[problem.row_trial])
        fits.append(refine(synthetic, coordinates, best, tolerance=1e-5, iterations=25).parameters)
    return np.array(fits)


def bias_corrected(
    space: ParameterSpace, best: np.ndarray, pairs: np.ndarray
) -> dict[str, BiasCorrected]:
    """Every quantity's corrected value from the best parameters (N,) and pairs (B, 2, N)."""
    out = {}
    for name in space.quantity_names:
        centre = float(space.log_quantity(name, best))
        biases = space.log_quantity(name, pairs).mean(axis=1) - centre
        bias = float(biases.mean())
        error = float(biases.std(ddof=1) / np.sqrt(len(biases))) if len(biases) > 1 else np.nan
        out[name] = BiasCorrected(
            float(np.exp(centre - bias)) - space.log_offset(name), bias, error
        )
    return out


def shifted_interval(profile: Profile, bias: float) -> tuple[float, float]:
    """The profile's interval shifted with the corrected value.

    An end at a bound of the box moves outwards only.
    """
    # Computed as in `bias_corrected`: an estimate on a bound is also the end of its interval, and
    # rounding must not separate the two.
    low, high = (
        np.exp(np.log(end + profile.log_offset) - bias) - profile.log_offset
        for end in profile.interval
    )
    if profile.open_low:
        low = min(low, profile.interval[0])
    if profile.open_high:
        high = max(high, profile.interval[1])
    return float(low), float(high)
