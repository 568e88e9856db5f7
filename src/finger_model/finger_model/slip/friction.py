# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is known of the friction: a distribution over a grid of ln μ.

It begins as a prior, is widened a little at every contact and within long ones, has nothing below
the largest ratio r = |Q|/P that was carried (an edge that softens with time), and learns from two
kinds of evidence:

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
DRIFT_TIME, DRIFT_STEP = 3.0, 1.0
"""s of a contact in which friction may change as much as from contact to contact, and steps in
which it does so."""
HOLD_DENSITY = 0.6
"""Of ln r of a held plateau, below μ: what is held is chosen by who holds it, not by friction."""
NEAR = 2
"""Steps of LOG_FRICTION within which two plateaus have one ratio."""
NEW_SURFACE = 0.01
"""Probability that the next contact is with another surface, of which only the prior is known."""
CLEAR, AGREES = 0.99, 2.0 * SPREAD
"""Probability from which a slip is clear, and difference of ln r up to which two agree."""
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
        ("slip_ratio", "f8"),  # ln r of the newest one
        ("shown", "?"),  # slip was seen beyond doubt
        ("told", "?"),  # the weights hold more than the prior
    ],
    align=True,
)
FRICTION = np.dtype(
    [
        ("known", LEARNED),
        ("before", LEARNED),  # at the onset of this contact
        ("carried", "f8"),  # largest ratio carried in this contact, of those that still tell most
        ("age", "f8"),  # s since then
        ("contact_time", "f8"),  # s, of this contact
        ("drifted", "f8"),  # s of it for which the weights were widened
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
    to.slip_ratio, to.shown = learned.slip_ratio, learned.shown


@njit(cache=True)
def begin_contact(friction):
    """Keep what is known, in case this contact is none of a finger."""
    _copy(friction.known, friction.before)


@njit(cache=True)
def forget_contact(friction):
    """Forget what was learned since the contact began."""
    _copy(friction.before, friction.known)
    friction.carried = friction.drifted = 0.0


@njit(cache=True)
def _edge_width(friction, drift):
    """Softness of the edge, of ln μ: friction may have changed since the ratio was carried."""
    return math.hypot(EDGE, drift * math.sqrt(friction.age / DRIFT_TIME))


@njit(cache=True)
def carry(friction, ratio, drift):
    """A ratio that is carried now: it tells more than a larger one of long ago."""
    slack = 2.0 * (_edge_width(friction, drift) - EDGE)
    if ratio > friction.carried * math.exp(-slack):
        friction.carried, friction.age = ratio, 0.0


@njit(cache=True)
def pass_time(friction, drift, dt):
    """dt (s) of a contact, in which ln μ may change by this drift in DRIFT_TIME."""
    friction.contact_time += dt
    if friction.contact_time < friction.drifted + DRIFT_STEP:
        return
    step = friction.contact_time - friction.drifted
    friction.drifted += step
    friction.age += step
    known = friction.known
    if known.told:
        cells = drift / (LOG_FRICTION[1] - LOG_FRICTION[0])
        share = min(0.5 * cells * cells * step / DRIFT_TIME, 0.3)
        weight = np.exp(known.log_weight - known.log_weight.max())
        for g in range(GRID):
            below, above = weight[max(g - 1, 0)], weight[min(g + 1, GRID - 1)]
            widened = weight[g] + share * (below - 2.0 * weight[g] + above)
            known.log_weight[g] = math.log(max(widened, 1e-300))


@njit(cache=True)
def end_contact(friction, prior, drift):
    """Fold the edge into the weights; ln μ may differ in the next contact, by what is left of this
    drift."""
    known = friction.known
    if friction.carried > 0.0:
        known.told = True
        width = _edge_width(friction, drift)
        for g in range(GRID):
            edge = _normal((LOG_FRICTION[g] - math.log(friction.carried)) / width)
            known.log_weight[g] += math.log(edge + 1e-6)
    friction.carried = 0.0
    # Widen by a Gaussian of the drift.
    left = max(0.0, 1.0 - friction.drifted / DRIFT_TIME)
    friction.contact_time = friction.drifted = 0.0
    width = math.sqrt(left) * drift / (LOG_FRICTION[1] - LOG_FRICTION[0])
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
def _likelihood(share, log_ratio, spread, log_friction):
    """Likelihood of a plateau under a friction, and the part of it that is slip; share: that of
    slip before friction is asked; spread: of ln r in slip."""
    z = (log_ratio - log_friction) / spread
    slip = share * math.exp(-0.5 * z * z) / (spread * 2.5066282746)
    hold = (1.0 - share) * HOLD_DENSITY * _normal(-z)
    return slip + hold + 1e-9, slip


@njit(cache=True)
def learn(known, plateau):
    """Keep what a plateau that ends has told; the probability that it was a slip that is news."""
    known.told = True
    share, log_ratio = slip_share(plateau), mean_log_ratio(plateau)
    news = _is_news(known, plateau)
    if plateau.odds < CLEAR_SLIP:
        known.unclear[_cell(log_ratio)] = 1
    total, slip_total = 0.0, 0.0
    top = known.log_weight.max()
    for g in range(GRID):
        likelihood, slip = _likelihood(share, log_ratio, plateau.spread, LOG_FRICTION[g])
        weight = math.exp(known.log_weight[g] - top)
        total += weight * likelihood
        slip_total += weight * slip
        if news:
            known.log_weight[g] += math.log(likelihood)
    return slip_total / total if news else 0.0


@njit(cache=True)
def count_slip(known, log_ratio, probability):
    """A slip at this ln r, of this probability: one that is clear, or two that agree, leave no
    doubt."""
    agrees = known.slips > 0 and abs(log_ratio - known.slip_ratio) < AGREES
    known.shown = known.shown or probability > CLEAR or agrees
    known.slip_ratio = log_ratio
    known.slips += 1


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
def _moments(weighted, squared, total):
    """Mean and standard deviation, of weighted sums of a value and of its square."""
    mean = weighted / total
    return mean, math.sqrt(max(squared / total - mean * mean, 0.0))


@njit(cache=True)
def weigh(friction, drift, plateau, stands, judged, ratio, beyond, with_load, ahead, spread, out):
    """Friction, probability of slip and margin, by all weights; whether it slips, the mean stick
    ratio of a first pull at these `elements.shares`, and its standard deviation.

    stands: the plateau lasts; judged: `ratio` r = |Q|/P tells something, and is to be `ahead` ±
    `spread` of ln r within the horizon.
    """
    share, log_ratio, news = 0.0, 0.0, False
    if stands:
        share, log_ratio = slip_share(plateau), mean_log_ratio(plateau)
        news = _is_news(friction.known, plateau)
    # A ratio beyond all frictions that are thought of leaves the largest of them.
    edge_at = min(math.log(max(friction.carried, 1e-3)), LOG_FRICTION[-1])
    edge_width = _edge_width(friction, drift)
    log_weight = np.empty(GRID)
    for g in range(GRID):
        edge = _normal((LOG_FRICTION[g] - edge_at) / edge_width)
        log_weight[g] = friction.known.log_weight[g] + (math.log(edge) if edge > 0.0 else -math.inf)
    top = log_weight.max()
    total, mean, square, slip_total, probability = 0.0, 0.0, 0.0, 0.0, 0.0
    stick_mean, stick_square, margin_mean, margin_square = 0.0, 0.0, 0.0, 0.0
    log_ahead = math.log(max(ahead, 1e-6))
    for g in range(GRID):
        x = LOG_FRICTION[g]
        weight = math.exp(log_weight[g] - top)
        slip = 0.0
        if stands:
            likelihood, slip_part = _likelihood(share, log_ratio, plateau.spread, x)
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
            margin = (1.0 - slip) * max(0.0, 1.0 - ratio / mu)
            margin_mean += weight * margin
            margin_square += weight * margin * margin
    friction.mean, friction.stddev = _moments(mean, square, total)
    if friction.carried > 0.95 * math.exp(LOG_FRICTION[-1]):
        friction.stddev = friction.mean
    out.friction, out.friction_stddev = friction.mean, friction.stddev
    out.slip_probability = min(probability / total, 1.0)
    out.slip_margin, out.slip_margin_stddev = _moments(margin_mean, margin_square, total)
    stick_mean, stick_spread = _moments(stick_mean, stick_square, total)
    return slip_total > 0.5 * total, stick_mean, stick_spread
