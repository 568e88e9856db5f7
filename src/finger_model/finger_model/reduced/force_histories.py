# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Random parameter sets and force histories for training and verifying the reduced model.

A history is (time, force), (n,) each, fine enough for the full-order model: force changes by at
most a given share of the peak from row to row. All draws come from the generator that is passed in.
"""

from __future__ import annotations

import numpy as np

from ..laws.standard_linear_solid import PARAMETERS
from ..paper import TARGET_FORCE

KINDS = ("ramp", "hold", "release", "reload", "tapping", "human")
"""Kinds of history in the held-out set."""


def random_parameters(rng: np.random.Generator, box: np.ndarray) -> np.ndarray:
    """Parameters (n,), log-uniform in a box (n, 2)."""
    low, high = np.log(box).T
    return np.exp(rng.uniform(low, high))


def training_parameters(rng: np.random.Generator) -> np.ndarray:
    """Parameters (n,) in and a little beyond the paper's box.

    Values near its edges are frequent: a fit errs most there.
    """
    low, high = np.log(PARAMETERS.box).T
    number = len(PARAMETERS)
    share = rng.uniform(-0.1, 1.1, number)
    near = rng.uniform(-0.12, 0.06, number)
    edge = rng.random(number)
    share = np.where(edge < 0.18, near, np.where(edge > 0.82, 1.0 - near, share))
    return np.clip(np.exp(low + share * (high - low)), *PARAMETERS.range.T)


def _fine(time: list[float], force: list[float], step: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows between the corners of a piecewise linear history so that force and time change little
    from row to row.

    The rise from zero is cut finer: rows at force shares of (i/n)^1.5.
    """
    times, forces = [np.array([time[0]])], [np.array([force[0]])]
    length = time[-1] - time[0]
    for t0, t1, f0, f1 in zip(time[:-1], time[1:], force[:-1], force[1:]):
        rows = max(1, round(abs(f1 - f0) / step), int(np.ceil((t1 - t0) / (0.06 * length))))
        s = np.arange(1, rows + 1) / rows
        if f0 == f1:
            # Holding: rows close together first, where most creep is.
            s = s**1.7
        elif f0 <= 0 < f1:
            s = s**1.4
        elif f1 <= 0 < f0:
            s = 1 - (1 - s) ** 1.4
        times.append(t0 + s * (t1 - t0))
        forces.append(f0 + s * (f1 - f0))
    return np.concatenate(times), np.concatenate(forces)


def human_press(
    rng: np.random.Generator, peak: float = TARGET_FORCE, rate: float = 40.0
) -> tuple[np.ndarray, np.ndarray]:
    """A human-like press: rise of 0.5–2 s, overshoot, tremor of 8–12 Hz, short hold, release."""
    rise, hold, release = rng.uniform(0.5, 2.0), rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.6)
    time = np.arange(0.0, rise + hold + release + 0.1, 1.0 / rate)
    overshoot = 1 + rng.uniform(0.0, 0.12)
    s = np.clip(time / rise, 0, 1)
    shape = rng.uniform(0, 1)
    force = peak * overshoot * (shape * s + (1 - shape) * s * s * (3 - 2 * s))
    force *= np.clip(1 - (time - rise - hold) / release, 0, 1)
    phase, frequency = rng.uniform(0, 2 * np.pi), rng.uniform(8, 12)
    tremor = rng.uniform(0.005, 0.03) * np.sin(2 * np.pi * frequency * time + phase)
    force = np.maximum(force * (1 + tremor), 0.0)
    force[0] = 0.0
    return time, force


def random_history(
    rng: np.random.Generator, kind: str, peak: float = TARGET_FORCE
) -> tuple[np.ndarray, np.ndarray]:
    """Time (s) and force (N) of one history of KINDS, "random" (corners at random) or "taps"."""
    step = 0.05 * peak
    rise = np.exp(rng.uniform(np.log(0.3), np.log(3.0)))
    if kind == "human":
        return human_press(rng, peak)
    if kind == "tapping":
        # 2 Hz: 0.25 s down and up, 0.25 s without contact.
        time, force = [0.0], [0.0]
        for tap in range(3):
            height = peak * rng.uniform(0.5, 1.0)
            time += [0.5 * tap + 0.11, 0.5 * tap + 0.14, 0.5 * tap + 0.25, 0.5 * tap + 0.5]
            force += [height, height, 0.0, 0.0]
        return _fine(time, force, 1.6 * step)
    if kind == "taps":
        # One after the other without a pause: strain is left from tap to tap, until it settles.
        period, share, taps = rng.uniform(0.25, 1.0), rng.uniform(0.3, 0.7), rng.integers(4, 8)
        corners = period * (np.arange(taps)[:, None] + np.array([share, 1.0]))
        peaks = peak * rng.uniform(0.7, 1.0, taps)[:, None] * np.array([1.0, 0.0])
        return _fine([0.0, *corners.ravel()], [0.0, *peaks.ravel()], 3.0 * step)
    if kind == "random":
        time, force = [0.0], [0.0]
        for _ in range(int(rng.integers(3, 6))):
            time.append(time[-1] + np.exp(rng.uniform(np.log(0.1), np.log(2.5))))
            force.append(peak * rng.choice([rng.uniform(0, 1), 1.0, 0.0, force[-1] / peak]))
        if max(force) == 0:
            force[1] = peak
        return _fine(time, force, step)
    time, force = [0.0, rise], [0.0, peak]
    if kind in ("hold", "release", "reload"):
        time.append(time[-1] + np.exp(rng.uniform(np.log(0.2), np.log(3.0))))
        force.append(peak)
    if kind in ("release", "reload"):
        time.append(time[-1] + np.exp(rng.uniform(np.log(0.15), np.log(2.0))))
        force.append(0.0 if kind == "release" else peak * rng.choice([0.0, rng.uniform(0.1, 0.5)]))
        if force[-1] == 0.0:
            time.append(time[-1] + np.exp(rng.uniform(np.log(0.1), np.log(1.0))))
            force.append(0.0)
    if kind == "reload":
        time.append(time[-1] + np.exp(rng.uniform(np.log(0.3), np.log(2.0))))
        force.append(peak * rng.uniform(0.7, 1.0))
    return _fine(time, force, step)
