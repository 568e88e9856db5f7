# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled: a sensor that is not level. A tilt t (rad) of its normal axis brings t P into Q.

So slip in the direction u shows the ratio μ + (1 + μ²) u·t, not μ: slips in several directions tell
both. The tilt is a normal distribution for each ln μ, with a mean that is linear in ln μ. After one
slip what is sure is only the ratio in its direction; the opposite one is then the less sure.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit

PRIOR_TILTED = 0.05
"""Probability that a sensor is not level."""
LARGEST = 3.0
"""Standard deviations beyond which no tilt is believed."""
LEAST_ERROR = 0.2
"""Of the standard deviation of the tilt, what is left of it where it is known."""
LEAST = 0.2
"""Of μ, ratio that slip shows at the least, whatever the tilt."""

LEVEL = np.dtype(
    [
        ("sd", "f8"),  # rad, before any slip
        ("tilted", "f8"),  # probability that the sensor is not level, before any slip
        ("at", "f8"),  # ln μ at which `tilt` is the mean
        ("tilt", "f8", (2,)),  # rad
        ("slope", "f8", (2,)),  # of the mean, over ln μ
        ("variance", "f8", (2, 2)),  # rad², at a known μ
    ]
)


@njit(cache=True)
def begin(level, sd):
    """Nothing is known but the standard deviation (rad) of the tilt."""
    level.sd, level.tilted, level.at = sd, PRIOR_TILTED, 0.0
    level.tilt[:] = 0.0
    level.slope[:] = 0.0
    level.variance[:] = 0.0
    level.variance[0, 0] = level.variance[1, 1] = sd * sd


@njit(cache=True)
def copy(level, to):
    """Copy one record to another."""
    to.sd, to.tilted, to.at = level.sd, level.tilted, level.at
    to.tilt[:] = level.tilt
    to.slope[:] = level.slope
    to.variance[:] = level.variance


@njit(cache=True)
def _is_near(level, log_friction):
    """Whether this ln μ may be that of the slips that were seen, not of another surface."""
    change = math.hypot(level.slope[0], level.slope[1]) * abs(log_friction - level.at)
    return change <= LARGEST * level.sd


@njit(cache=True)
def _tilt(level, log_friction):
    """Mean of the tilt at this ln μ."""
    t0, t1 = level.tilt[0], level.tilt[1]
    if _is_near(level, log_friction):
        t0 += level.slope[0] * (log_friction - level.at)
        t1 += level.slope[1] * (log_friction - level.at)
    return t0, t1


@njit(cache=True)
def slip_ratio(level, log_friction, u0, u1):
    """Ratio that slip shows in the direction u at this ln μ, and its standard deviation."""
    friction = math.exp(log_friction)
    t0, t1 = _tilt(level, log_friction)
    gain = 1.0 + friction * friction
    c = level.variance
    variance = u0 * (c[0, 0] * u0 + c[0, 1] * u1) + u1 * (c[0, 1] * u0 + c[1, 1] * u1)
    ratio = max(friction + gain * (t0 * u0 + t1 * u1), LEAST * friction)
    return ratio, gain * math.sqrt(max(variance, 0.0))


@njit(cache=True)
def tilt_likelihood(level, ratio, u0, u1):
    """Likelihood, of ln r in the direction u, that Q follows P at this ratio r since the sensor is
    not level, and nothing pulls."""
    if level.sd == 0.0:
        return 0.0
    d0, d1 = ratio * u0 - level.tilt[0], ratio * u1 - level.tilt[1]
    least = (LEAST_ERROR * level.sd) ** 2
    a, b, c = level.variance[0, 0] + least, level.variance[0, 1], level.variance[1, 1] + least
    det = a * c - b * b
    far = (c * d0 * d0 - 2.0 * b * d0 * d1 + a * d1 * d1) / det
    return ratio * ratio / math.sqrt(det) * math.exp(-0.5 * far)


@njit(cache=True)
def add_moments(level, log_friction, weight, mean, square):
    """Add the tilt at this ln μ, by its weight, to sums of it (2,) and of its square (2, 2)."""
    t = _tilt(level, log_friction)
    for i in range(2):
        mean[i] += weight * t[i]
        for k in range(2):
            square[i, k] += weight * (t[i] * t[k] + level.variance[i, k])


@njit(cache=True)
def _refer(level, log_friction):
    """Let `tilt` be the mean at this ln μ; nothing is known of it on another surface."""
    if not _is_near(level, log_friction):
        tilted = level.tilted
        begin(level, level.sd)
        level.tilted = tilted
    for i in range(2):
        level.tilt[i] += level.slope[i] * (log_friction - level.at)
    level.at = log_friction


@njit(cache=True)
def update(level, log_friction, ratio, u0, u1, sd):
    """Update by a slip at this ratio ± sd in the direction u; log_friction: mean ln μ then."""
    _refer(level, log_friction)
    friction = math.exp(log_friction)
    # The ratio changes by h·t with the tilt t.
    h0, h1 = (1.0 + friction * friction) * u0, (1.0 + friction * friction) * u1
    v = level.variance
    g0, g1 = v[0, 0] * h0 + v[0, 1] * h1, v[0, 1] * h0 + v[1, 1] * h1
    total = g0 * h0 + g1 * h1 + sd * sd
    gap = ratio - friction - level.tilt[0] * h0 - level.tilt[1] * h1
    turn = -friction - level.slope[0] * h0 - level.slope[1] * h1
    k0, k1 = g0 / total, g1 / total
    if math.hypot(level.tilt[0] + k0 * gap, level.tilt[1] + k1 * gap) > LARGEST * level.sd:
        return  # no tilt makes this: what follows P is no slip, or another surface
    for i in range(2):
        gain = k0 if i == 0 else k1
        level.tilt[i] += gain * gap
        level.slope[i] += gain * turn
        v[i, 0] -= gain * g0
        v[i, 1] -= gain * g1


@njit(cache=True)
def predict(level, log_friction, variance, change):
    """ln μ, known by its mean and variance, has changed by a random step; change: its variance."""
    _refer(level, log_friction)
    keep = variance / max(variance + change, 1e-12)
    slope = level.slope.copy()
    for i in range(2):
        for k in range(2):
            level.variance[i, k] += slope[i] * slope[k] * variance * (1.0 - keep)
        level.slope[i] = keep * slope[i]
