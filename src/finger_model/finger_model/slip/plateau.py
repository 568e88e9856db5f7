# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A plateau: r = |Q|/P stands still, since the skin slips at r = μ or a pull is held below it.

`forecasts` tell that it stands still, `windows` of its samples how likely slip is. Where it is
looked for slip often enough, chance shows it: each window costs, also those of the plateaus before.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from . import windows
from .forces import calm, is_releasing, ratio_of, tangential
from .forecasts import KEPT, back, compare, due

STILL, GONE = -1.0, -3.0
"""Log of the odds of slip and holding against pulling above which r stands still, and below which
it does so no more."""
LEAST_TIME = 0.02
"""s that r must stand still."""
SLIP_ODDS = -1.5
"""Log of the odds of slip against holding of a plateau that shows neither: held things are more."""
FADED, FADE = -1.5, 1.0
"""Log of the odds, from windows, to which those of a plateau without a clear slip fade, and s in
which they do: what is held lasts longer than a slide that nothing shows."""
CLEAR_SLIP = 2.0
"""Log of the odds of slip against holding from which a plateau tells of slip by itself."""
GROWN = 1.3
"""By which r must have grown in a contact before it can be slip: a force that is oblique from the
first touch on, or a sensor that is not level, has Q in proportion to P too."""
SPREAD = 0.03
"""Of ln r in slip, where Q's zero is exact."""
SLIDE = 100
"""Forecasts of a slide after which its newest ones tell its ratio."""
LOOK_MEMORY = 30.0
"""s between plateaus in which windows of those before cost e times less."""
EARLIER = 0.5
"""Share of what the windows before tell that is kept."""

PLATEAU = np.dtype(
    [
        ("present", "?"),
        ("begin", "i8"),  # ns
        ("least", "f8"),  # ratio in this contact
        ("sum", "f8", (3,)),  # of ln r and Q's direction, of the time that looked most like slip
        ("count", "f8"),  # weight of that sum
        ("spread", "f8"),  # of ln r in slip
        ("odds", "f8"),  # largest log of the odds of slip in it
        ("past_odds", "f8", (KEPT,)),  # the same, at the newest forecasts
        ("window", "f8", (windows.LENGTH, 2)),  # P, Q, newest samples, one with each forecast
        ("seen", "i8"),  # samples so far
        ("looks", "f8"),  # times in this contact that it was looked for slip, of those that cost
        ("window_odds", "f8"),  # log, of slip against holding, in the newest window
        ("earlier_odds", "f8"),  # of slip, of windows before
        ("letting_go", "?"),  # at the newest forecast
        ("kept_odds", "f8"),  # `odds` before the finger began to let go
        ("kept_ratio", "f8"),  # ln r then
    ],
    align=True,
)


@njit(cache=True)
def begin_contact(plateau):
    """Nothing was seen of this contact."""
    plateau.least = math.inf
    plateau.looks = 0.0


@njit(cache=True)
def mean_log_ratio(plateau):
    """ln r of the plateau."""
    return plateau.sum[0] / max(plateau.count, 1.0)


@njit(cache=True)
def direction(plateau):
    """Of Q, a unit vector; zeros without samples."""
    size = max(math.hypot(plateau.sum[1], plateau.sum[2]), 1e-9)
    return plateau.sum[1] / size, plateau.sum[2] / size


@njit(cache=True)
def slip_share(plateau):
    """Probability, before friction is asked, that the plateau is slip."""
    if mean_log_ratio(plateau) < math.log(max(GROWN * plateau.least, 1e-6)):
        return 0.0
    return 1.0 / (1.0 + math.exp(-min(max(SLIP_ODDS + plateau.odds, -30.0), 30.0)))


@njit(cache=True)
def lasts(plateau, stamp):
    """Whether r has stood still for long enough at this stamp."""
    return plateau.present and (stamp - plateau.begin) * 1e-9 >= LEAST_TIME


@njit(cache=True)
def _begin(plateau, stamp):
    plateau.present = True
    plateau.begin = stamp
    plateau.count = 0.0
    plateau.sum[:] = 0.0
    plateau.odds = plateau.window_odds = plateau.earlier_odds = 0.0
    plateau.past_odds[:] = 0.0
    plateau.seen = 0


@njit(cache=True)
def _window_odds(plateau, n, noise, coupled):
    """As `odds_of_slip`, of the newest n samples."""
    normal, pull = np.empty(n), np.empty(n)
    for i in range(n):
        normal[i], pull[i] = plateau.window[(plateau.seen - n + i) % windows.LENGTH]
    return windows.odds_of_slip(normal, pull, noise, coupled)


@njit(cache=True)
def _keep(plateau, share):
    """Let what came so far tell less of the ratio."""
    for i in range(3):
        plateau.sum[i] *= share
    plateau.count *= share


@njit(cache=True)
def _look_for_slip(plateau, forces, coupled, dt, log_ratio, judged):
    """Keep the newest sample, at this ln r, and, where it may be judged, the odds of slip; dt: s
    since the one before."""
    newest = plateau.window[plateau.seen % windows.LENGTH]
    newest[0] = forces.fast.value[0]
    newest[1] = tangential(forces.fast)
    plateau.seen += 1
    if plateau.seen >= windows.LEAST and judged:
        # What has just begun to slip was held in the longer window: each second one is short.
        n = windows.LENGTH // 2 if plateau.seen % 2 else windows.LENGTH
        odds, slipped = _window_odds(plateau, min(plateau.seen, n), forces.filtered_noise, coupled)
        if odds > 0.0:
            log_ratio = slipped
        plateau.window_odds = plateau.earlier_odds + odds
        plateau.looks += 1.0
        if plateau.seen % windows.LENGTH == 0:
            # What was held before may slip now.
            plateau.earlier_odds = max(EARLIER * plateau.window_odds, 0.0)
    odds = plateau.window_odds - math.log(1.0 + plateau.looks / windows.LEAST)
    if plateau.seen <= windows.LEAST:
        # The cost is of what windows show: else a new plateau is as likely slip as the first one.
        odds = min(plateau.window_odds, max(odds, 0.0))
    if odds > plateau.odds + 0.5:
        _keep(plateau, 0.5 if plateau.odds > 0.0 else 0.0)
    # Friction may change in a slide that goes on.
    slides = plateau.odds >= CLEAR_SLIP and plateau.window_odds > 0.0 and plateau.seen > SLIDE
    if slides and plateau.count > SLIDE:
        _keep(plateau, SLIDE / plateau.count)
    if slides or odds > plateau.odds - 0.5 or plateau.count == 0.0:
        q = max(newest[1], 1e-9)
        plateau.sum[0] += log_ratio
        plateau.sum[1] += forces.fast.value[1] / q
        plateau.sum[2] += forces.fast.value[2] / q
        plateau.count += 1.0
    if plateau.seen <= windows.LEAST:
        plateau.odds = odds
    if FADED < plateau.odds < CLEAR_SLIP:
        plateau.odds += (FADED - plateau.odds) * (1.0 - math.exp(-dt / FADE))
    plateau.odds = max(plateau.odds, odds)


@njit(cache=True)
def judge(plateau, forecasts, forces, coupled, stamp):
    """Find whether r stands still, and since when; True when a plateau that lasted has ended."""
    if not due(forecasts, stamp):
        return False
    dt = abs(stamp - forecasts.made_at) * 1e-9
    if not plateau.present:
        plateau.looks *= math.exp(-dt / LOOK_MEMORY)
    compare(forecasts, forces, stamp)
    load, q = forces.fast.value[0], tangential(forces.fast)
    ratio = ratio_of(forces.slow)
    log_ratio = math.log(max(ratio, 1e-6))
    if load > 20.0 * forces.noise:
        plateau.least = min(plateau.least, ratio + 2.0 * (forces.filtered_noise / load))
    still = forecasts.odds > (GONE if plateau.present else STILL)
    still = still and ratio > 0.05 and q > 6.0 * forces.noise
    still = still and forecasts.count > 2 * KEPT and calm(forces, stamp)
    # Q falls with P then, also where what was held is put down, but at another ratio than before.
    letting_go = is_releasing(forces)
    if letting_go and not plateau.letting_go:
        plateau.kept_odds = plateau.past_odds[(forecasts.count - back(forecasts, stamp)) % KEPT]
        plateau.kept_ratio = mean_log_ratio(plateau)
    plateau.letting_go = letting_go
    begun = mean_log_ratio(plateau)
    if letting_go:
        begun = plateau.kept_ratio
        still = still and plateau.present
    away = abs(log_ratio - begun) - forces.filtered_noise / max(q, 1e-6)
    if plateau.present and (letting_go or slip_share(plateau) > 0.5):
        # What slips leaves its ratio when it is caught, what is held when it is put down.
        still = still and away < 2.0 * SPREAD
    ended = False
    if plateau.present and not still:
        if letting_go and away > SPREAD:
            # Its beginning looked like slip: both forces began to fall.
            plateau.odds = min(plateau.odds, plateau.kept_odds)
        ended = lasts(plateau, stamp)
        plateau.present = False
    elif still and not plateau.present:
        _begin(plateau, stamp)
    if plateau.present:
        plateau.spread = math.hypot(SPREAD, forces.zero_error / max(q, 1e-6))
        _look_for_slip(plateau, forces, coupled, dt, log_ratio, not letting_go or away < SPREAD)
        plateau.past_odds[forecasts.count % KEPT] = plateau.odds
    return ended
