"""Bias of a fit, and estimates without it: bootstrap bias correction.

Least squares of a curved model lean even in the middle of the box, and a bound of the box that cuts off part of an
estimate's spread leans it further (Box 1971 gives the first of the two in closed form, not the second). Both are measured
here: data made at the fitted parameters, with the fit's own residuals as noise, are fitted in the same box, and how far
those fits lie from the parameters that made their data is the bias (Efron and Tibshirani 1993, chapter 10). It is taken
from the estimate's logarithm, once.

The noise is a wild cluster bootstrap (Cameron, Gelbach and Miller 2008): a trial's residuals are kept whole and their
sign is drawn, so that errors which a trial's frames share stay shared, with no assumption about their size. Every draw is
used with both signs: the part of an error that is odd in the noise cancels, and what is left is the bias. Twenty pairs
know it to 0.02–0.11 standard deviations of the estimate (docs/study.md).

A corrected value may lie outside the box by a fraction of a deviation. Cut off at the bound it would lean again: an
estimate in a corner of the box can err to one side only.

Sources: M. J. Box, J. R. Stat. Soc. B 33 (1971) 171–201; B. Efron and R. J. Tibshirani, An Introduction to the
Bootstrap, 1993; A. C. Cameron, J. B. Gelbach and D. L. Miller, Rev. Econ. Stat. 90 (2008) 414–427.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from .identifiability import QUANTITIES, Profile, quantity
from .local import refine, whole_box
from .problem import FitProblem


@dataclass(frozen=True)
class Unbiased:
    """A quantity without the bias of its estimate: value (SI), the bias in logarithm that was taken from it, and the
    bias's own standard error from the finite number of pairs."""

    value: float
    bias: float
    bias_error: float


def bias_pair(problem: FitProblem, best: np.ndarray, seed: int, index: int) -> np.ndarray:
    """Parameters (2, 4) refitted to the `index`-th pair of synthetic data sets around the best (4,); the same for
    every machine."""
    rng = np.random.default_rng([seed, index, 1])
    areas = problem.areas(best)[0]
    number = len(problem)
    # A fit takes up its share of the trials' scatter: as in `identifiability.covariance`.
    residual = (problem.measured - areas) * np.sqrt(number / max(number - 1, 1))
    noise = residual * rng.choice([-1.0, 1.0], number)[problem.trial_of]
    synthetic = copy.copy(problem)
    fits = []
    for sign in (1.0, -1.0):
        synthetic.measured = areas + sign * noise
        fit = refine(synthetic, whole_box(problem.box), np.log(best), tolerance=1e-5, iterations=25)
        fits.append(fit.parameters)
    return np.array(fits)


def unbiased(best: np.ndarray, pairs: np.ndarray) -> dict[str, Unbiased]:
    """Every quantity's corrected value from the best parameters (4,) and pairs (B, 2, 4)."""
    out = {}
    for name in QUANTITIES:
        centre = np.log(quantity(name, best))
        leans = np.log(quantity(name, pairs)).mean(axis=1) - centre
        bias = float(leans.mean())
        error = float(leans.std(ddof=1) / np.sqrt(len(leans))) if len(leans) > 1 else np.nan
        out[name] = Unbiased(float(np.exp(centre - bias)), bias, error)
    return out


def shifted_interval(profile: Profile, bias: float) -> tuple[float, float]:
    """The profile's interval moved with the corrected value; an end that runs to a bound of the box moves outwards only."""
    # As `unbiased` computes the value: an estimate on a bound is its interval's end, which rounding must not part.
    low, high = (np.exp(np.log(end) - bias) for end in profile.interval)
    if profile.open_low:
        low = min(low, profile.interval[0])
    if profile.open_high:
        high = max(high, profile.interval[1])
    return float(low), float(high)
