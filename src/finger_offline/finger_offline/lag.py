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
"""s of lag that is noted: about the error of this measure on simulated presses."""

MAXIMUM_LAG = 0.1
"""s of lag with which a recording is not fit for use."""

LONGEST_LAG = 0.4
"""s, largest lag that is looked for."""

LOWEST_FORCE = 0.1
"""N below which areas do not count: an outline of few ridges is uncertain."""

CREEP = (0.1, 0.2, 0.45)
"""E1 over E0 of the fingers that a press is compared with."""

CREEP_TIMES = (0.01, 0.05, 0.15, 0.4, 1.0)
"""s, tau1 of those fingers."""

STEP = 0.01
"""s between the samples of force and model, and between the lags tried."""

_LAGS = np.arange(-LONGEST_LAG, LONGEST_LAG + 1e-9, STEP)


def force_image_lag(trials: Iterable[TrialRecord]) -> float | None:
    """Time (s) by which the areas of presses lag the force, positive when the areas come late; None
    when unclear.

    Against model fingers that creep more or less, faster or slower, and one without creep; the best
    of them for all presses together counts. On simulated presses of such fingers and others, with
    1.5 mm² of noise, four presses give the lag within 0.04 s, or 0.07 s where tau1 is 1 s.
    """
    total, frames = None, 0
    for trial in trials:
        costs = _costs_of(trial)
        if costs is not None:
            number = int((np.isfinite(trial.area) & (trial.area > 0)).sum())
            total = number * costs if total is None else total + number * costs
            frames += number
    return None if total is None else _lowest(total / frames)


def _costs_of(trial: TrialRecord) -> np.ndarray | None:
    if len(trial.stamp_ns) < 50:
        return None
    origin = int(trial.stamp_ns[0])
    time, frames = (trial.stamp_ns - origin) * 1e-9, (trial.area_stamp_ns - origin) * 1e-9
    steps = np.arange(0.0, time[-1], STEP)
    force = np.maximum(np.interp(steps, time, trial.force), 0.0)
    model, parameters = _fingers()
    curves = model.batch(parameters, [(steps, force, np.arange(len(steps)))])[0]
    # Without creep, the area is a power of the force.
    return _lag_costs(steps, force, np.vstack([curves, force]), frames, trial.area)


@functools.cache
def _fingers() -> tuple[ReducedModel, np.ndarray]:
    """The shipped model, and fingers of much and little, of fast and slow creep."""
    model = ReducedModel.load()
    space = model.space
    grid = itertools.product(CREEP, CREEP_TIMES)
    natural = space.default
    fingers = [
        space.with_quantity("tau1", space.with_quantity("E1", natural, natural[0] * part), tau)
        for part, tau in grid
    ]
    return model, np.array(fingers)


def log_lag(
    time: np.ndarray,
    force: np.ndarray,
    curve: np.ndarray,
    frame_time: np.ndarray,
    area: np.ndarray,
) -> float | None:
    """Lag (s) at which ln area over the logarithm of a model's areas is most nearly a line.

    time, force, curve (n,): of the press, and areas of a model under that force; frame_time, area
    (k,): as measured, NaN and 0 do not count. None with fewer than 6 areas, or where the force
    changes by less than a factor of two. The line's slope and offset are free, so neither the
    scale of the areas nor the stiffness of the finger matters much.
    """
    costs = _lag_costs(time, force, curve[None], frame_time, area)
    return None if costs is None else _lowest(costs)


def _lag_costs(
    time: np.ndarray,
    force: np.ndarray,
    curves: np.ndarray,
    frame_time: np.ndarray,
    area: np.ndarray,
) -> np.ndarray | None:
    """Mean squared distance (P, L) from the line for P curves and the lags of `_LAGS`."""
    usable = np.isfinite(area) & (area > 0)
    frames, log_area = frame_time[usable], np.log(area[usable])
    if len(frames) < 6:
        return None
    costs = np.full((len(curves), len(_LAGS)), np.nan)
    log_curves = np.log(np.maximum(curves, 1e-12))
    for column, lag in enumerate(_LAGS):
        at = frames - lag
        pressing = np.interp(at, time, force)
        good = pressing >= LOWEST_FORCE
        if good.sum() < 6 or np.ptp(np.log(pressing[good])) < 0.7:
            continue
        y = log_area[good] - log_area[good].mean()
        x = np.array([np.interp(at[good], time, curve) for curve in log_curves])
        x -= x.mean(axis=1, keepdims=True)
        slope = (x @ y) / np.maximum((x * x).sum(axis=1), 1e-12)
        rest = y - slope[:, None] * x
        costs[:, column] = np.mean(rest**2, axis=1) / np.maximum(slope, 0.05) ** 2
    return costs


def _lowest(costs: np.ndarray) -> float | None:
    """The lag of the lowest of costs (P, L), between the steps by a parabola."""
    if np.isfinite(costs).any(axis=0).sum() < 10:
        return None
    best = costs[int(np.nanargmin(np.nanmin(costs, axis=1)))]
    place = int(np.nanargmin(best))
    if 0 < place < len(_LAGS) - 1 and np.isfinite(best[place - 1 : place + 2]).all():
        below, middle, above = best[place - 1 : place + 2]
        bend = below - 2.0 * middle + above
        if bend > 0:
            return float(_LAGS[place] + 0.5 * STEP * (below - above) / bend)
    return float(_LAGS[place])
