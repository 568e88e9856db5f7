# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether the ratio r = |Q|/P stands still, by forecasts over LAG.

Three forecasts are compared with what comes: Q = r P (slip), Q as it was (a pull that is held), Q
at its rate (a pull).
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from .forces import tangential

LAG, EVERY, MEMORY = 0.04, 0.01, 0.1
"""s: over which forces are forecast, how often, and how long the comparison is remembered."""
LEAST_ODDS = -4.0
"""Log of the odds of standing still that a pull leaves: more would hide a slip for longer."""
KEPT = 4
"""Newest forecasts kept."""
OLD = LAG - 0.5 * EVERY
"""s, age from which a forecast is compared."""

FORECAST = np.dtype(
    [
        ("made", "f8"),  # s
        ("ratio", "f8"),
        ("force", "f8"),  # N, Q
        ("rate", "f8"),  # N/s, of Q
    ]
)
FORECASTS = np.dtype(
    [
        ("made_at", "i8"),  # ns, the newest one
        ("count", "i8"),  # in this contact
        ("past", FORECAST, (KEPT,)),
        ("odds", "f8"),  # log, of standing still against pulling
    ]
)


@njit(cache=True)
def begin(forecasts):
    """A contact begins: nothing was forecast."""
    forecasts.count = 0
    forecasts.odds = -3.0


@njit(cache=True)
def due(forecasts, stamp):
    """Whether it is time for the next forecast; stamps may lie before 0, where none was made."""
    return abs(stamp - forecasts.made_at) * 1e-9 >= EVERY


@njit(cache=True)
def back(forecasts, stamp):
    """How many forecasts back the newest one is that is old enough."""
    n = 1
    while n < KEPT and stamp * 1e-9 - forecasts.past[(forecasts.count - n) % KEPT].made < OLD:
        n += 1
    return n


@njit(cache=True)
def compare(forecasts, forces, stamp):
    """Compare what was forecast LAG ago with what came, and forecast anew."""
    p, q = forces.fast.value[0], tangential(forces.fast)
    slow, rate = forces.slow, 0.0
    slow_q = tangential(slow)
    if slow_q > 1e-9:
        rate = (slow.value[1] * slow.rate[1] + slow.value[2] * slow.rate[2]) / slow_q
    n = back(forecasts, stamp)
    if forecasts.count >= n:
        past = forecasts.past[(forecasts.count - n) % KEPT]
        lag = stamp * 1e-9 - past.made
        if 0.5 * LAG < lag < 2.0 * LAG:
            # Noise of the filtered forces, and what a slip's friction and a pull's rate vary.
            noise = forces.filtered_noise * forces.filtered_noise
            slip = q - past.ratio * p
            hold = q - past.force
            pull = q - past.force - past.rate * lag
            slip_variance = 2.0 * noise * (1.0 + past.ratio * past.ratio) + (0.008 * q) ** 2
            hold_variance = 2.0 * noise + (0.008 * q) ** 2
            pull_variance = 4.0 * noise + (0.3 * past.rate * lag) ** 2 + (0.004 * q) ** 2
            log_slip = -0.5 * (slip * slip / slip_variance + math.log(slip_variance))
            log_hold = -0.5 * (hold * hold / hold_variance + math.log(hold_variance))
            log_pull = -0.5 * (pull * pull / pull_variance + math.log(pull_variance))
            keep = math.exp(-EVERY / MEMORY)
            gain = max(log_slip, log_hold) - log_pull
            odds = keep * forecasts.odds + min(max(gain, -3.0), 3.0)
            forecasts.odds = max(odds, LEAST_ODDS)
    now = forecasts.past[forecasts.count % KEPT]
    now.made, now.ratio, now.force, now.rate = stamp * 1e-9, q / max(p, 1e-6), q, rate
    forecasts.count += 1
    forecasts.made_at = stamp
