# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""By how much the areas of a press come later than its force.

The tissue creeps, so its area lags the force by itself. The areas are therefore compared with those
of a finger model under the same force; what is left is the lag of the clocks.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable

import numpy as np

from finger_model.reduced import ReducedModel

from .trial_records import TrialRecord

WORTH_A_NOTE = 0.05
"""s of lag that is noted: more than the error of this measure on simulated presses."""

MAXIMUM_LAG = 0.1
"""s of lag with which a recording is not fit for use."""

LONGEST_LAG = 0.4
"""s, largest lag that is looked for."""

AREA_NOISE, MODEL_ERROR = 2e-6, 0.03
"""m² of a measured area, and share by which a finger differs from the models."""

SMALLEST_PART = 0.08
"""Of a press's largest area, below which areas do not count: their relative noise is large."""

CREEP = (0.1, 0.2, 0.45, 1.2)
"""E1 over E0 of the fingers that a press is compared with."""

CREEP_TIMES = (0.01, 0.05, 0.15, 0.4, 1.0)
"""s, tau1 of those fingers."""

STEP = 0.01
"""s between the samples of force and model, and between the lags tried."""

SLOPE, POWER = (1.0, 0.3), (0.7, 0.3)
"""Mean and standard deviation of the exponent of the measured area over a model's area, and over
the force."""

UNCLEAR = 0.1
"""s of standard deviation from which a lag is unclear."""

_LAGS = np.arange(-LONGEST_LAG, LONGEST_LAG + 1e-9, STEP)

Sums = np.ndarray
"""Weighted sums (3, P, L) of x x, x y and y y of presses, for P curves and the lags of `_LAGS`."""


def force_image_lag(trials: Iterable[TrialRecord]) -> float | None:
    """Time (s) by which the areas of presses lag the force, positive when the areas come late; None
    when unclear.

    Against model fingers that creep more or less, faster or slower, and a power of the force
    without creep: the mean over all of them, weighted by their likelihood. On simulated presses of
    such fingers and others, with 1.5 mm² of noise, four presses give the lag within 0.03 s, a
    single one within 0.05 s.
    """
    total: Sums | None = None
    frames = 0
    for trial in trials:
        if len(trial.stamp_ns) < 50:
            continue
        origin = int(trial.stamp_ns[0])
        time, seen = (trial.stamp_ns - origin) * 1e-9, (trial.area_stamp_ns - origin) * 1e-9
        steps = np.arange(0.0, time[-1], STEP)
        force = np.maximum(np.interp(steps, time, trial.force), 0.0)
        model, parameters, limit = _fingers()
        # A larger force on a stiffer finger: their ratio is what the model knows.
        force *= min(1.0, limit / max(force.max(), limit))
        curves = model.batch(parameters, [(steps, force, np.arange(len(steps)))])[0]
        found = _sums(steps, force, np.vstack([curves, force]), seen, trial.area)
        if found is not None:
            total = found[0] if total is None else total + found[0]
            frames += found[1]
    if total is None:
        return None
    exponents = np.array([SLOPE] * (total.shape[1] - 1) + [POWER])
    return _mean_lag(total, frames, exponents)


@functools.cache
def _fingers() -> tuple[ReducedModel, np.ndarray, float]:
    """The shipped model, fingers of much and little, of fast and slow creep, and the force (N) to
    which it knows all of them."""
    model = ReducedModel.load()
    space = model.space
    grid = itertools.product(CREEP, CREEP_TIMES)
    natural = space.default
    fingers = [
        space.with_quantity("tau1", space.with_quantity("E1", natural, natural[0] * part), tau)
        for part, tau in grid
    ]
    return model, np.array(fingers), min(map(model.force_limit, fingers))


def log_lag(
    time: np.ndarray,
    force: np.ndarray,
    curve: np.ndarray,
    frame_time: np.ndarray,
    area: np.ndarray,
) -> float | None:
    """Lag (s) of measured areas behind the areas of one model under the same force.

    time, force, curve (n,): of the press, and the model's areas; frame_time, area (k,): as
    measured, NaN and 0 do not count. The measured area is a power of the model's, of free scale, so
    that the stiffness of the finger matters little. None with fewer than 6 areas, where the force
    changes by less than a factor of two, or where the lag stays unclear.
    """
    found = _sums(time, force, curve[None], frame_time, area)
    return None if found is None else _mean_lag(*found, np.array([SLOPE]))


def _sums(
    time: np.ndarray,
    force: np.ndarray,
    curves: np.ndarray,
    frame_time: np.ndarray,
    area: np.ndarray,
) -> tuple[Sums, int] | None:
    """Sums of one press for curves (P, n), and its number of frames."""
    usable = np.isfinite(area) & (area > 0)
    usable[usable] = area[usable] > SMALLEST_PART * area[usable].max(initial=0.0)
    at = frame_time[usable]
    pressing = np.interp(at, time, force)
    if len(at) < 6 or pressing.max() < 2.0 * max(pressing.min(), 1e-3):
        return None
    y = np.log(area[usable])
    weight = 1.0 / ((AREA_NOISE / area[usable]) ** 2 + MODEL_ERROR**2)
    # Before and after the press a curve is 0; a part of its peak keeps the logarithm finite.
    peak = np.maximum(curves.max(axis=1, keepdims=True), 1e-12)
    logs = np.log(np.maximum(curves, 0.3 * SMALLEST_PART * peak))
    shifted = at[:, None] - _LAGS
    x = np.array([np.interp(shifted, time, log) for log in logs])
    share = (weight / weight.sum())[:, None]
    x = x - (share * x).sum(axis=1, keepdims=True)
    y = (y - share[:, 0] @ y)[:, None]
    heavy = weight[:, None]
    square = np.broadcast_to((heavy * y * y).sum(), x.shape[::2])
    return np.stack([(heavy * x * x).sum(axis=1), (heavy * x * y).sum(axis=1), square]), len(at)


def _mean_lag(sums: Sums, frames: int, exponents: np.ndarray) -> float | None:
    """Mean lag (s) over all curves and lags by their likelihood; exponents (P, 2): mean and SD."""
    xx, xy, yy = sums
    mean, precision = exponents[:, :1], exponents[:, 1:] ** -2.0
    slope = (xy + precision * mean) / (xx + precision)
    misfit = yy - 2.0 * slope * xy + slope**2 * xx + precision * (slope - mean) ** 2
    # Where no model fits to within the noise, what is left of the best one is the noise.
    noise = max(float(misfit.min()) / max(frames - 5, 1), 1.0)
    chance = np.exp(-0.5 * (misfit - misfit.min()) / noise).sum(axis=0)
    chance /= chance.sum()
    found = float(chance @ _LAGS)
    return found if chance @ (_LAGS - found) ** 2 < UNCLEAR**2 else None
