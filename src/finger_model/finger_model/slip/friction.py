# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is known of the friction: a distribution over a grid of ln μ, and over whether the force
sensor is level.

The weights tell of μ. What is seen tells of the ratio at which it slips in the direction of Q,
which is μ where the sensor is level: `_aim` gives the distribution of that ratio.

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
from ..paper import NATURAL
from . import level
from .elements import first_pull
from .plateau import CLEAR_SLIP, SPREAD, direction, mean_log_ratio, slip_share

LEVEL, TILTED = 0, 1
"""Kinds of force sensors."""
KINDS = (LEVEL, TILTED)
GRID = 96
LOG_FRICTION = np.linspace(math.log(0.08), math.log(2.5), GRID)
NATURAL_MOISTURE = NATURAL.moisture
"""Moisture (a.u.) at which the prior's median friction holds."""
LARGEST_SHIFT = 1.0
"""Largest change of the prior's ln μ by moisture."""
EDGE = SPREAD
"""Of ln μ: softness of the edge, since the largest ratio carried scatters as one in slip does."""
TURN = 0.15
"""Change of the direction of Q, a unit vector, that is looked at."""
TILT_SLIP = 0.9
"""Probability of a slip from which it tells of the sensor's tilt."""
SUREST = 1e-3
"""Least probability, on another surface, of either kind of sensor."""
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
        ("log_weight", "f8", (2, GRID)),  # of KINDS; evidence without edge and present plateau
        ("level", level.LEVEL),  # of TILTED
        ("unclear", "u1", (GRID,)),  # ln r of plateaus that did not show slip by themselves
        ("slips", "i8"),
        ("slip_ratio", "f8"),  # ln r of the newest one
        ("shown", "?"),  # slip was seen beyond doubt
        ("told", "?"),  # the weights hold more than the prior
    ],
    align=True,
)
AIM = np.dtype(
    [
        ("true", "?"),  # of what is known now
        ("along", "f8", (2,)),  # a direction of Q
        ("log_weight", "f8", (GRID,)),  # of the ratio at which it slips in it, by LOG_FRICTION
        ("tilted", "f8"),  # probability of TILTED
        ("friction", "f8", (GRID,)),  # mean of μ, where this is the ratio
        ("square", "f8", (GRID,)),  # and of its square
        ("tilt", "f8", (2,)),  # rad, mean
        ("variance", "f8", (2, 2)),  # rad²
    ],
    align=True,
)
FRICTION = np.dtype(
    [
        ("known", LEARNED),
        ("before", LEARNED),  # at the onset of this contact
        ("carried", "f8"),  # largest ratio carried in this contact, of those that still tell most
        ("along", "f8", (2,)),  # its direction
        ("age", "f8"),  # s since then
        ("contact_time", "f8"),  # s, of this contact
        ("drifted", "f8"),  # s of it for which the weights were widened
        ("moisture", "f8"),  # of the prior
        ("mean", "f8"),  # of μ, as last given
        ("stddev", "f8"),
        ("limit", "f8"),  # mean of the ratio at which it slips in the direction `aim.along`
        ("aim", AIM),
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
    known = friction.known
    known.log_weight[LEVEL] = known.log_weight[TILTED] = _log_prior(prior, moisture)
    known.log_weight[LEVEL] += math.log(1.0 - known.level.tilted)
    known.log_weight[TILTED] += math.log(known.level.tilted)
    friction.aim.true = False
    friction.carried = 0.0
    friction.mean = friction.stddev = friction.limit = math.nan


@njit(cache=True)
def _copy(learned, to):
    to.log_weight[:] = learned.log_weight
    to.unclear[:] = learned.unclear
    to.slips, to.told = learned.slips, learned.told
    to.slip_ratio, to.shown = learned.slip_ratio, learned.shown
    level.copy(learned.level, to.level)


@njit(cache=True)
def begin_contact(friction):
    """Keep what is known, in case this contact is none of a finger."""
    _copy(friction.known, friction.before)


@njit(cache=True)
def forget_contact(friction):
    """Forget what was learned since the contact began."""
    _copy(friction.before, friction.known)
    friction.aim.true = False
    friction.carried = friction.drifted = 0.0


@njit(cache=True)
def _shares(known, kind, g, u0, u1, share):
    """Cells of LOG_FRICTION, from the first to before the last one returned, of the ratios at which
    it may slip in the direction u at the friction of cell g; their probabilities in `share`."""
    if kind == LEVEL or known.level.sd == 0.0:
        share[g] = 1.0
        return g, g + 1
    ratio, error = level.shown(known.level, LOG_FRICTION[g], u0, u1)
    step = LOG_FRICTION[1] - LOG_FRICTION[0]
    at = (math.log(ratio) - LOG_FRICTION[0]) / step
    width = max(error / ratio / step, 0.5)
    first = min(max(int(at - 3.0 * width), 0), GRID - 1)
    last = min(max(int(at + 3.0 * width) + 2, first + 1), GRID)
    total = 0.0
    for k in range(first, last):
        share[k] = math.exp(-0.5 * ((k - at) / width) ** 2) + 1e-30
        total += share[k]
    for k in range(first, last):
        share[k] /= total
    return first, last


@njit(cache=True)
def _aim(aim, known, u0, u1):
    """What is known of the ratio at which it slips in the direction u."""
    aim.true = True
    aim.along[0], aim.along[1] = u0, u1
    aim.friction[:] = aim.square[:] = aim.tilt[:] = 0.0
    aim.variance[:] = 0.0
    aim.tilted = 0.0
    weights, share = np.zeros(GRID), np.empty(GRID)
    top, total = known.log_weight.max(), 0.0
    for kind in KINDS:
        for g in range(GRID):
            weight = math.exp(known.log_weight[kind, g] - top)
            if weight == 0.0:
                continue
            mu = math.exp(LOG_FRICTION[g])
            total += weight
            if kind == TILTED:
                aim.tilted += weight
                level.add_moments(known.level, LOG_FRICTION[g], weight, aim.tilt, aim.variance)
            first, last = _shares(known, kind, g, u0, u1, share)
            for k in range(first, last):
                part = weight * share[k]
                weights[k] += part
                aim.friction[k] += part * mu
                aim.square[k] += part * mu * mu
    for k in range(GRID):
        if weights[k] > 1e-280:
            aim.log_weight[k] = math.log(weights[k]) + top
            aim.friction[k] /= weights[k]
            aim.square[k] /= weights[k]
        else:  # too unlikely for sums, but all that is left beyond a large ratio carried
            aim.log_weight[k] = known.log_weight[:, k].max()
            aim.friction[k] = math.exp(LOG_FRICTION[k])
            aim.square[k] = aim.friction[k] ** 2
    aim.tilted /= total
    for i in range(2):
        aim.tilt[i] /= total
    for i in range(2):
        for k in range(2):
            aim.variance[i, k] = aim.variance[i, k] / total - aim.tilt[i] * aim.tilt[k]


@njit(cache=True)
def renew_aim(friction):
    """Let `aim`, in the direction that it has, be of what is known now."""
    aim = friction.aim
    if not aim.true:
        _aim(aim, friction.known, aim.along[0], aim.along[1])


@njit(cache=True)
def look(friction, u0, u1, clear):
    """Let `aim` be of what is known now, in the direction u if that is clear."""
    aim = friction.aim
    if clear and math.hypot(u0 - aim.along[0], u1 - aim.along[1]) > TURN:
        _aim(aim, friction.known, u0, u1)
    else:
        renew_aim(friction)


@njit(cache=True)
def _turned(aim, log_ratio, v0, v1):
    """ln of the ratio r in the direction of `aim` that this ln r in the direction v stands for, and
    its standard deviation."""
    d0, d1 = aim.along[0] - v0, aim.along[1] - v1
    if d0 == 0.0 and d1 == 0.0:
        return log_ratio, 0.0
    ratio, c = math.exp(log_ratio), aim.variance
    gain = 1.0 + ratio * ratio
    variance = d0 * (c[0, 0] * d0 + c[0, 1] * d1) + d1 * (c[1, 0] * d0 + c[1, 1] * d1)
    turned = max(ratio + gain * (aim.tilt[0] * d0 + aim.tilt[1] * d1), level.LEAST * ratio)
    return math.log(turned), gain * math.sqrt(max(variance, 0.0)) / ratio


@njit(cache=True)
def _tell(known, u0, u1, likelihood, follows):
    """Learn the likelihood (GRID,) of each ratio at which it slips in the direction u, and what a
    sensor that is not level adds to it."""
    share = np.empty(GRID)
    for kind in KINDS:
        for g in range(GRID):
            first, last = _shares(known, kind, g, u0, u1, share)
            total = follows if kind == TILTED else 0.0
            for k in range(first, last):
                total += share[k] * likelihood[k]
            known.log_weight[kind, g] += math.log(total)


@njit(cache=True)
def _edge_width(friction, drift):
    """Softness of the edge, of ln μ: friction may have changed since the ratio was carried."""
    return math.hypot(EDGE, drift * math.sqrt(friction.age / DRIFT_TIME))


@njit(cache=True)
def carry(friction, ratio, drift):
    """A ratio that is carried now, in the direction of `aim`: it tells more than a larger one of
    long ago."""
    slack = 2.0 * (_edge_width(friction, drift) - EDGE)
    if ratio > friction.carried * math.exp(-slack):
        friction.carried, friction.age = ratio, 0.0
        friction.along[:] = friction.aim.along


@njit(cache=True)
def _if_tilted(known):
    """Mean and variance of ln μ where the sensor is not level."""
    weight = np.exp(known.log_weight[TILTED] - known.log_weight[TILTED].max())
    weight /= weight.sum()
    mean = np.sum(weight * LOG_FRICTION)
    return mean, np.sum(weight * (LOG_FRICTION - mean) ** 2)


@njit(cache=True)
def _loosen(known, change):
    """ln μ may have changed by a random step of this variance."""
    if known.level.sd > 0.0:
        mean, variance = _if_tilted(known)
        level.loosen(known.level, mean, variance, change)


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
        _loosen(known, drift * drift * step / DRIFT_TIME)
        top = known.log_weight.max()
        for kind in KINDS:
            weight = np.exp(known.log_weight[kind] - top)
            for g in range(GRID):
                below, above = weight[max(g - 1, 0)], weight[min(g + 1, GRID - 1)]
                widened = weight[g] + share * (below - 2.0 * weight[g] + above)
                known.log_weight[kind, g] = math.log(max(widened, 1e-300))
        friction.aim.true = False


@njit(cache=True)
def end_contact(friction, prior, drift):
    """Fold the edge into the weights; ln μ may differ in the next contact, by what is left of this
    drift."""
    known = friction.known
    if friction.carried > 0.0:
        known.told = True
        width = _edge_width(friction, drift)
        likelihood = np.empty(GRID)
        for g in range(GRID):
            edge = _normal((LOG_FRICTION[g] - math.log(friction.carried)) / width)
            likelihood[g] = edge + 1e-6
        _tell(known, friction.along[0], friction.along[1], likelihood, 0.0)
    friction.carried = 0.0
    friction.aim.true = False
    # Widen by a Gaussian of the drift.
    left = max(0.0, 1.0 - friction.drifted / DRIFT_TIME)
    friction.contact_time = friction.drifted = 0.0
    _loosen(known, left * drift * drift)
    width = math.sqrt(left) * drift / (LOG_FRICTION[1] - LOG_FRICTION[0])
    reach = int(3.0 * width) + 1
    another = _log_prior(prior, friction.moisture)
    another = np.exp(another - another.max())
    another /= another.sum()
    weights = np.exp(known.log_weight - known.log_weight.max())
    weights /= weights.sum()
    for kind in KINDS:
        weight = weights[kind]
        of_kind = weight.sum()
        for g in range(GRID):
            total, norm = 0.0, 0.0
            for k in range(max(g - reach, 0), min(g + reach + 1, GRID)):
                share = math.exp(-0.5 * ((k - g) / max(width, 1e-3)) ** 2)
                total += share * weight[k]
                norm += share
            found = (1.0 - NEW_SURFACE) * total / norm + NEW_SURFACE * of_kind * another[g]
            known.log_weight[kind, g] = math.log(max(found, 1e-300))


@njit(cache=True)
def keep_level(before, known):
    """Another surface on the same sensor: keep what was known of its tilt."""
    _loosen(before, math.inf)
    level.copy(before.level, known.level)
    share = np.exp(before.log_weight - before.log_weight.max())
    known.level.tilted = min(max(share[TILTED].sum() / share.sum(), SUREST), 1.0 - SUREST)


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
def learn(friction, plateau):
    """Keep what a plateau that ends has told; the probability that it was a slip that is news."""
    known, aim = friction.known, friction.aim
    known.told, aim.true = True, False
    share, log_ratio = slip_share(plateau), mean_log_ratio(plateau)
    news = _is_news(known, plateau)
    if plateau.odds < CLEAR_SLIP:
        known.unclear[_cell(log_ratio)] = 1
    if not news:
        return 0.0
    u0, u1 = direction(plateau)
    _aim(aim, known, u0, u1)
    aim.true = False
    ratio = math.exp(log_ratio)
    follows = share * level.follows(known.level, ratio, u0, u1)
    total, slip_total = 0.0, 0.0
    top = aim.log_weight.max()
    likelihood = np.empty(GRID)
    for g in range(GRID):
        likelihood[g], slip = _likelihood(share, log_ratio, plateau.spread, LOG_FRICTION[g])
        weight = math.exp(aim.log_weight[g] - top)
        total += weight * (likelihood[g] + aim.tilted * follows)
        slip_total += weight * slip
    _tell(known, u0, u1, likelihood, follows)
    probability = slip_total / total
    if probability > TILT_SLIP and known.level.sd > 0.0:
        mean, _ = _if_tilted(known)
        level.see_slip(known.level, mean, ratio, u0, u1, plateau.spread * ratio)
    return probability


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
def see_stick(friction, beyond, with_load, stick, sd):
    """Learn from a stick ratio ± sd seen in a first pull in the direction of `aim`, at these
    `elements.shares`."""
    spread = math.hypot(sd, 0.04)
    known, aim = friction.known, friction.aim
    known.told, aim.true = True, False
    likelihood = np.empty(GRID)
    for g in range(GRID):
        z = (_first_stick(beyond, with_load, math.exp(LOG_FRICTION[g])) - stick) / spread
        likelihood[g] = (math.exp(-0.5 * z * z) + 1e-3) ** FRAME_SHARE
    _tell(known, aim.along[0], aim.along[1], likelihood, 0.0)


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
    aim = friction.aim
    share, log_ratio, news, plateau_spread, follows = 0.0, 0.0, False, 1.0, 0.0
    if stands:
        share = slip_share(plateau)
        news = _is_news(friction.known, plateau)
        v0, v1 = direction(plateau)
        log_ratio = mean_log_ratio(plateau)
        follows = level.follows(friction.known.level, math.exp(log_ratio), v0, v1)
        follows *= share * aim.tilted
        log_ratio, error = _turned(aim, log_ratio, v0, v1)
        plateau_spread = math.hypot(plateau.spread, error)
    carried, error = math.log(max(friction.carried, 1e-3)), 0.0
    if friction.carried > 0.0:
        carried, error = _turned(aim, carried, friction.along[0], friction.along[1])
    # A ratio beyond all frictions that are thought of leaves the largest of them.
    edge_at = min(carried, LOG_FRICTION[-1])
    edge_width = math.hypot(_edge_width(friction, drift), error)
    log_weight = np.empty(GRID)
    for g in range(GRID):
        edge = _normal((LOG_FRICTION[g] - edge_at) / edge_width)
        log_weight[g] = aim.log_weight[g] + (math.log(edge) if edge > 0.0 else -math.inf)
    top = log_weight.max()
    total, mean, square, slip_total, probability = 0.0, 0.0, 0.0, 0.0, 0.0
    stick_mean, stick_square, margin_mean, margin_square, limit = 0.0, 0.0, 0.0, 0.0, 0.0
    log_ahead = math.log(max(ahead, 1e-6))
    for g in range(GRID):
        x = LOG_FRICTION[g]
        weight = math.exp(log_weight[g] - top)
        slip = 0.0
        if stands:
            likelihood, slip_part = _likelihood(share, log_ratio, plateau_spread, x)
            likelihood += follows
            slip = slip_part / likelihood
            if news:
                weight *= likelihood
        slips_at = math.exp(x)
        total += weight
        limit += weight * slips_at
        mean += weight * aim.friction[g]
        square += weight * aim.square[g]
        slip_total += weight * slip
        if judged:
            coming = _normal((log_ahead - x) / spread)
            probability += weight * max(slip, coming)
            s = (1.0 - slip) * _first_stick(beyond, with_load, slips_at)
            stick_mean += weight * s
            stick_square += weight * s * s
            margin = (1.0 - slip) * max(0.0, 1.0 - ratio / slips_at)
            margin_mean += weight * margin
            margin_square += weight * margin * margin
    friction.mean, friction.stddev = _moments(mean, square, total)
    friction.limit = limit / total
    if friction.carried > 0.95 * math.exp(LOG_FRICTION[-1]):
        friction.stddev = friction.mean
    out.friction, out.friction_stddev = friction.mean, friction.stddev
    out.slip_probability = min(probability / total, 1.0)
    out.slip_margin, out.slip_margin_stddev = _moments(margin_mean, margin_square, total)
    stick_mean, stick_spread = _moments(stick_mean, stick_square, total)
    return slip_total > 0.5 * total, stick_mean, stick_spread
