# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is known of the friction: a distribution over a grid of ln μ.

It begins as a prior, is widened a little at every contact, has nothing below the largest ratio
r = |Q|/P that was carried (a soft edge), and learns from two kinds of evidence:

- *A plateau of r*: slip, so that r = μ, or a pull that is held, at any r below μ. The likelihood of
  a friction is a mixture of both.
- *A stick ratio seen by a camera*, s ± σ in a first pull at known forces: s = s(ρ), ρ = r/μ or,
  where a part of Q came with P (`elements`), (r − c/P)/(μ − c/P).
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from .elements import first_pull
from .plateau import CLEAR_SLIP, SPREAD, mean_log_ratio, slip_share

GRID = 96
LOG_FRICTION = np.linspace(math.log(0.08), math.log(2.5), GRID)
NATURAL_MOISTURE = 69.0
"""Moisture (a.u.) at which the prior's median friction holds."""
LARGEST_SHIFT = 1.0
"""Largest change of the prior's ln μ by moisture."""
EDGE = SPREAD
"""Of ln μ: softness of the edge, since the largest ratio carried scatters as one in slip does."""
HOLD_DENSITY = 0.6
"""Of ln r of a held plateau, below μ: what is held is chosen by who holds it, not by friction."""
NEAR = 2
"""Steps of LOG_FRICTION within which two plateaus have one ratio."""
NEW_SURFACE = 0.01
"""Probability that the next contact is with another surface, of which only the prior is known."""
FRAME_SHARE = 0.3
"""Share of a frame's evidence that counts: frames of one pull err alike where s(r) is not exact."""

PRIOR = np.dtype(
    [
        ("mean", "f8"),  # of ln μ, at natural moisture
        ("sd", "f8"),
        ("moisture_slope", "f8"),  # of ln μ
    ]
)
LEARNED = np.dtype(
    [
        ("log_weight", "f8", (GRID,)),  # prior and evidence, without edge and present plateau
        ("unclear", "u1", (GRID,)),  # ln r of plateaus that did not show slip by themselves
        ("slips", "i8"),
        ("told", "?"),  # the weights hold more than the prior
    ],
    align=True,
)
FRICTION = np.dtype(
    [
        ("known", LEARNED),
        ("before", LEARNED),  # at the onset of this contact
        ("carried", "f8"),  # largest ratio carried in this contact
        ("moisture", "f8"),  # of the prior
        ("mean", "f8"),  # of μ, as last given
        ("stddev", "f8"),
    ],
    align=True,
)


@njit(cache=True)
def _normal(x):
    """Distribution function of the normal distribution."""
    return 0.5 * math.erfc(-x * 0.7071067811865476)


@njit(cache=True)
def _log_prior(prior, moisture):
    """Log weights (GRID,) of a moisture (a.u., NaN where it is not known)."""
    shift = 0.0
    if math.isfinite(moisture):
        shift = prior.moisture_slope * (moisture - NATURAL_MOISTURE)
        shift = min(max(shift, -LARGEST_SHIFT), LARGEST_SHIFT)
    z = (LOG_FRICTION - prior.mean - shift) / prior.sd
    return -0.5 * z * z


@njit(cache=True)
def set_prior(prior, friction, moisture):
    """The prior of a moisture (a.u., NaN where it is not known), where nothing was told yet."""
    friction.moisture = moisture
    friction.known.log_weight[:] = _log_prior(prior, moisture)
    friction.carried = 0.0
    friction.mean = friction.stddev = math.nan


@njit(cache=True)
def _copy(learned, to):
    to.log_weight[:] = learned.log_weight
    to.unclear[:] = learned.unclear
    to.slips, to.told = learned.slips, learned.told


@njit(cache=True)
def begin_contact(friction):
    """Keep what is known, in case this contact is none of a finger."""
    _copy(friction.known, friction.before)


@njit(cache=True)
def forget_contact(friction):
    """Forget what was learned since the contact began."""
    _copy(friction.before, friction.known)
    friction.carried = 0.0


@njit(cache=True)
def end_contact(friction, prior, drift):
    """Fold the edge into the weights; ln μ may differ in the next contact, by this drift."""
    known = friction.known
    if friction.carried > 0.0:
        known.told = True
        for g in range(GRID):
            edge = _normal((LOG_FRICTION[g] - math.log(friction.carried)) / EDGE)
            known.log_weight[g] += math.log(edge + 1e-6)
    friction.carried = 0.0
    # Widen by a Gaussian of the drift.
    width = drift / (LOG_FRICTION[1] - LOG_FRICTION[0])
    reach = int(3.0 * width) + 1
    weight = np.exp(known.log_weight - known.log_weight.max())
    weight /= weight.sum()
    another = _log_prior(prior, friction.moisture)
    another = np.exp(another - another.max())
    another /= another.sum()
    for g in range(GRID):
        total, norm = 0.0, 0.0
        for k in range(max(g - reach, 0), min(g + reach + 1, GRID)):
            share = math.exp(-0.5 * ((k - g) / max(width, 1e-3)) ** 2)
            total += share * weight[k]
            norm += share
        known.log_weight[g] = math.log(
            (1.0 - NEW_SURFACE) * total / norm + NEW_SURFACE * another[g]
        )


@njit(cache=True)
def _cell(log_friction):
    """Index of the nearest of LOG_FRICTION."""
    step = (LOG_FRICTION[-1] - LOG_FRICTION[0]) / (GRID - 1)
    return min(max(round((log_friction - LOG_FRICTION[0]) / step), 0), GRID - 1)


@njit(cache=True)
def _is_news(known, plateau):
    """Whether the plateau tells of friction what none before it did. A thing that is held again, or
    whose load dips and returns, stands still at the same ratio."""
    at = _cell(mean_log_ratio(plateau))
    seen = known.unclear[max(at - NEAR, 0) : at + NEAR + 1].max() > 0
    return plateau.odds >= CLEAR_SLIP or not seen


@njit(cache=True)
def _likelihood(share, log_ratio, log_friction):
    """Likelihood of a plateau under a friction, and the part of it that is slip; share: that of
    slip before friction is asked."""
    z = (log_ratio - log_friction) / SPREAD
    slip = share * math.exp(-0.5 * z * z) / (SPREAD * 2.5066282746)
    hold = (1.0 - share) * HOLD_DENSITY * _normal(-z)
    return slip + hold + 1e-9, slip


@njit(cache=True)
def learn(known, plateau):
    """Keep what a plateau that ends has told; whether it was a slip that is news."""
    known.told = True
    share, log_ratio = slip_share(plateau), mean_log_ratio(plateau)
    news = _is_news(known, plateau)
    if plateau.odds < CLEAR_SLIP:
        known.unclear[_cell(log_ratio)] = 1
    total, slip_total = 0.0, 0.0
    top = known.log_weight.max()
    for g in range(GRID):
        likelihood, slip = _likelihood(share, log_ratio, LOG_FRICTION[g])
        weight = math.exp(known.log_weight[g] - top)
        total += weight * likelihood
        slip_total += weight * slip
        if news:
            known.log_weight[g] += math.log(likelihood)
    return news and slip_total > 0.5 * total


@njit(cache=True)
def _first_stick(beyond, with_load, friction):
    """Stick ratio of a first pull; `beyond` and `with_load`: see `elements.shares`."""
    return first_pull(beyond / max(friction - with_load, 1e-6))


@njit(cache=True)
def see_stick(known, beyond, with_load, stick, sd):
    """Learn from a stick ratio ± sd seen in a first pull, at these `elements.shares`."""
    spread = math.hypot(sd, 0.04)
    known.told = True
    for g in range(GRID):
        z = (_first_stick(beyond, with_load, math.exp(LOG_FRICTION[g])) - stick) / spread
        known.log_weight[g] += FRAME_SHARE * math.log(math.exp(-0.5 * z * z) + 1e-3)


@njit(cache=True)
def weigh(friction, plateau, stands, judged, beyond, with_load, ahead, spread, out):
    """Friction, and the probability of slip, by all weights; whether it slips, the mean stick ratio
    of a first pull at these `elements.shares`, and its standard deviation.

    stands: the plateau lasts; judged: r = |Q|/P tells something, and is to be `ahead` ± `spread` of
    ln r within the horizon.
    """
    share, log_ratio, news = 0.0, 0.0, False
    if stands:
        share, log_ratio = slip_share(plateau), mean_log_ratio(plateau)
        news = _is_news(friction.known, plateau)
    # A ratio beyond all frictions that are thought of leaves the largest of them.
    edge_at = min(math.log(max(friction.carried, 1e-3)), LOG_FRICTION[-1])
    log_weight = np.empty(GRID)
    for g in range(GRID):
        edge = _normal((LOG_FRICTION[g] - edge_at) / EDGE)
        log_weight[g] = friction.known.log_weight[g] + (math.log(edge) if edge > 0.0 else -math.inf)
    top = log_weight.max()
    total, mean, square, slip_total, probability = 0.0, 0.0, 0.0, 0.0, 0.0
    stick_mean, stick_square = 0.0, 0.0
    log_ahead = math.log(max(ahead, 1e-6))
    for g in range(GRID):
        x = LOG_FRICTION[g]
        weight = math.exp(log_weight[g] - top)
        slip = 0.0
        if stands:
            likelihood, slip_part = _likelihood(share, log_ratio, x)
            slip = slip_part / likelihood
            if news:
                weight *= likelihood
        mu = math.exp(x)
        total += weight
        mean += weight * mu
        square += weight * mu * mu
        slip_total += weight * slip
        if judged:
            coming = _normal((log_ahead - x) / spread)
            probability += weight * max(slip, coming)
            s = (1.0 - slip) * _first_stick(beyond, with_load, mu)
            stick_mean += weight * s
            stick_square += weight * s * s
    mean /= total
    friction.mean = mean
    friction.stddev = math.sqrt(max(square / total - mean * mean, 0.0))
    if friction.carried > 0.95 * math.exp(LOG_FRICTION[-1]):
        friction.stddev = mean
    out.friction, out.friction_stddev = friction.mean, friction.stddev
    out.slip_probability = min(probability / total, 1.0)
    stick_mean /= total
    stick_spread = math.sqrt(max(stick_square / total - stick_mean * stick_mean, 0.0))
    return slip_total > 0.5 * total, stick_mean, stick_spread
