# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""By how much the areas and indentations of presses come later than their force, whether that
changes over a recording, and how far a press travels beside a finger model.

The tissue creeps, so area and indentation lag the force by themselves. They are therefore compared
with those of finger models under the same force; what is left is the lag of the clocks.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterable

import numpy as np
from scipy.special import stdtr

from finger_model.reduced import ReducedModel

from .trial_records import TrialRecord

WORTH_A_NOTE = 0.05
"""s of lag that is noted: more than the error of this measure on simulated presses."""

MAXIMUM_LAG = 0.1
"""s of lag with which a recording is not fit for use."""

LONGEST_LAG = 0.4
"""s, largest lag that is looked for."""

AREA_NOISE, MODEL_ERROR = 2e-6, 0.03
"""m² of a measured area, more than is typical since the camera of a recording may be any; and share
by which a finger differs from the models."""

TRAVEL_ERROR, FEWEST_READINGS = 0.03, 6
"""Error of an indentation as a share of the travel of its press, and readings that tell a lag."""

SMALLEST_PART = 0.08
"""Of a press's largest area, below which areas do not count: their relative noise is large."""

CREEP = (0.1, 0.2, 0.45, 1.2)
"""E1 over E0 of the fingers that a press is compared with."""

CREEP_TIMES = (0.01, 0.05, 0.15, 0.4, 1.0)
"""s, tau1 of those fingers."""

STEP = 0.01
"""s between the samples of force and model, and between the lags tried."""

WITHOUT_CREEP = (0.4, 0.6, 0.8)
"""Powers of the force that are the indentations of fingers without creep."""

SLOPE, POWER = (1.0, 0.3), (0.7, 0.3)
"""Mean and standard deviation of the exponent of the measured area over a model's area, and over
the force."""

CONTACT_PART = 0.1
"""Of the largest area, above which a frame shows a press."""

FEWEST_PRESSES = 4
"""Presses from which a lag that changes is told from the scatter of the frames."""

CHANGE = 0.1
"""s by which a lag must change over a recording."""

GROSS_CHANGE = 0.5
"""s of change that no shape of a press explains, of however few presses."""

CHANGE_FRAMES, CHANCE = 1.5, 1e-3
"""Frames by which a lag must change too; and how rarely presses of other shapes may look so."""

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
        curves, _, force = _contacts(steps, force)
        found = _sums(steps, force, np.vstack([curves, force]), seen, trial.area)
        if found is not None:
            total = found[0] if total is None else total + found[0]
            frames += found[1]
    if total is None:
        return None
    exponents = np.array([SLOPE] * (total.shape[1] - 1) + [POWER])
    return _mean_lag(total, frames, exponents)


def _contacts(steps: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Areas (P, n) in m² and indentations (P, n) in m of the model fingers under a force (n,) in N,
    and that force within the range of all of them."""
    model, parameters, limit = _fingers()
    # A larger force on a stiffer finger: their ratio is what the model knows.
    force = force * min(1.0, limit / max(force.max(), limit))
    areas, indentations = model.contacts(parameters, [(steps, force, np.arange(len(steps)))])[0]
    return areas, indentations, force


Press = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Stamps (n,) in ns and force (n,) in N from onset to lift-off; stamps (k,) in ns and values (k,)
in m of indentations."""


def indentation_lag(presses: Iterable[Press]) -> float | None:
    """Time (s) by which the indentations of presses come later than their force, positive when they
    come late; None when unclear. Found as `force_image_lag` finds that of areas."""
    total: Sums | None = None
    readings = 0
    for stamp, pressing, reading_stamp, reading in presses:
        inside = (reading_stamp >= stamp[0]) & (reading_stamp <= stamp[-1]) & np.isfinite(reading)
        y = reading[inside]
        if len(stamp) < 50 or len(y) < FEWEST_READINGS or not np.ptp(y) > 0.0:
            continue
        time, at = (stamp - stamp[0]) * 1e-9, (reading_stamp[inside] - stamp[0]) * 1e-9
        steps = np.arange(0.0, time[-1], STEP)
        _, creeping, force = _contacts(steps, np.maximum(np.interp(steps, time, pressing), 0.0))
        curves = np.vstack([creeping, *(force**power for power in WITHOUT_CREEP)])
        shifted = at[:, None] - _LAGS
        x = np.array([np.interp(shifted, steps, c / max(c.max(), 1e-9)) for c in curves])
        weight = np.full(len(y), TRAVEL_ERROR**-2.0)
        found = _weighted_sums(x, y / np.ptp(y), weight)
        total = found if total is None else total + found
        readings += len(y)
    if total is None:
        return None
    return _mean_lag(total, readings, np.array([SLOPE] * total.shape[1]))


def travel_ratio(press: Press, frame_stamp: np.ndarray, area: np.ndarray) -> float:
    """Travel of a press from half its largest area on, over that of the default finger between the
    same areas; NaN where it is not measured, or this finger does not reach the area.

    frame_stamp (m,) in ns, area (m,) in m²: measured.
    """
    stamp, _, reading_stamp, reading = press
    seen = (frame_stamp >= stamp[0]) & (frame_stamp <= stamp[-1]) & np.isfinite(area)
    known = np.isfinite(reading)
    if np.count_nonzero(seen) < FEWEST_READINGS or np.count_nonzero(known) < FEWEST_READINGS:
        return math.nan
    peak = int(np.argmax(area[seen]))
    rise = area[seen][: peak + 1]
    ends = np.array([0.5, 1.0]) * rise[-1]
    at = np.interp(ends, np.maximum.accumulate(rise), frame_stamp[seen][: peak + 1] - stamp[0])
    travel = np.diff(np.interp(at, reading_stamp[known] - stamp[0], reading[known]))
    steps = np.arange(0.0, 1.0, STEP)
    areas, indentations, _ = _contacts(steps, steps / steps[-1] * _fingers()[2])
    return float((travel / np.diff(np.interp(ends, areas[0], indentations[0], right=np.nan)))[0])


def press_lags(presses: np.ndarray, frame_time: np.ndarray, area: np.ndarray) -> np.ndarray | None:
    """Time (n,) in s by which the areas of each press come late, of any size, within a frame or so;
    None where the areas do not show as many presses as the force.

    presses (n, 2): begin and end in s; frame_time (k,), area (k,): in their order, NaN is no
    contact.
    """
    if not len(area) or not np.nanmax(area, initial=0.0) > 0.0:
        return None
    pressed = np.nan_to_num(area) > CONTACT_PART * np.nanmax(area)
    frames = np.flatnonzero(pressed)
    steps = np.diff(frame_time)
    # A gap without frames parts two presses as frames without a contact do.
    longest = max(5.0 * float(np.median(steps)), 0.3) if len(steps) else 0.0
    ends = np.flatnonzero((np.diff(frames) > 1) | (np.diff(frame_time[frames]) > longest))
    groups = [group for group in np.split(frames, ends + 1) if len(group) > 1]
    if len(groups) != len(presses):
        return None
    middles = [0.5 * (frame_time[group[0]] + frame_time[group[-1]]) for group in groups]
    return np.array(middles) - presses.mean(axis=1)


def lag_change(presses: np.ndarray, lags: np.ndarray, period: float) -> str:
    """How the lags (n,) of presses (n, 2) in s change over a recording, in words; empty where they
    do not. period: s between frames."""
    if len(lags) < FEWEST_PRESSES:
        if float(np.ptp(lags)) <= GROSS_CHANGE:
            return ""
        return (
            f"the lag is {lags[0]:.2f} s in the first press and {lags[-1]:.2f} s in the last: the "
            "clocks run at different rates, or frames are missing; correct the times of the areas"
        )
    at, number = presses.mean(axis=1), len(lags)
    least = max(CHANGE, CHANGE_FRAMES * period)

    def clear(change: float, misfit: float, share: float, tries: int) -> bool:
        """Whether a change is large, and not the scatter of presses of other shapes; share: of the
        presses' variance in its regressor."""
        error = math.sqrt(max(misfit, 1e-12) / (number - 2) / (share * number))
        return abs(change) > least and 2 * tries * stdtr(number - 2, -abs(change) / error) < CHANCE

    slope, start = np.polyfit(at, lags, 1)
    growth = float(slope * np.ptp(at))
    straight = float(((lags - start - slope * at) ** 2).sum())
    stepped, after = min(
        (float(lags[:k].var() * k + lags[k:].var() * (number - k)), k) for k in range(1, number)
    )
    jump = float(lags[after:].mean() - lags[:after].mean())
    if straight <= stepped:
        if not clear(growth, straight, float(at.var()) / np.ptp(at) ** 2, 1):
            return ""
        return (
            f"the lag {'grows' if slope > 0 else 'falls'} by {abs(slope) * 1e3:.0f} ms a second: "
            "the clocks run at different rates; correct the frame rate or the times of the areas"
        )
    part = after / number
    if not clear(jump, stepped, part * (1.0 - part), number - 1):
        return ""
    return (
        f"the lag jumps by {jump:.2f} s after press {after - 1}: frames or samples are missing; "
        "give each frame its time"
    )


def lag_text(what: str, lag: float) -> str:
    """A lag (s) in words; what: has it."""
    side = "late" if lag >= 0 else "early"
    return f"{what} come {abs(lag) * 1e3:.0f} ms {side} beyond the creep of the skin"


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
    return _weighted_sums(x, y, weight), len(at)


def _weighted_sums(x: np.ndarray, y: np.ndarray, weight: np.ndarray) -> Sums:
    """Sums of curves x (P, k, L) at values y (k,) of weight (k,), each about its mean."""
    share = (weight / weight.sum())[:, None]
    x = x - (share * x).sum(axis=1, keepdims=True)
    y = (y - share[:, 0] @ y)[:, None]
    heavy = weight[:, None]
    square = np.broadcast_to((heavy * y * y).sum(), x.shape[::2])
    return np.stack([(heavy * x * x).sum(axis=1), (heavy * x * y).sum(axis=1), square])


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
