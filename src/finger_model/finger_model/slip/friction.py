# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bayes filter for the friction coefficient on a grid of ln μ, for a level and for a tilted force
sensor.

A belief has a weight for each cell of the grid and each kind of sensor. It begins as a prior.
`predict` widens it a little within long contacts, `end_contact` at every contact. Of the directions
of Q: slip shows r = |Q|/P = μ where the sensor is level, another ratio where it is tilted.
`DIRECTIONAL` has the distribution of that ratio in one direction. `evaluate` gives the estimates.

There are three kinds of evidence:

- *A ratio that is held*: μ is not below the largest one (`raise_lower_bound`). This bound is soft,
  and softens with time. It enters the belief when the contact ends.
- *A plateau of r* (`update_from_plateau`): slip, so that r = μ, or a pull that is held, at any r
  below μ. The likelihood of a friction is a mixture of both.
- *A stick ratio seen by a camera* (`update_from_stick_ratio`), s ± σ in a first pull at known
  forces: s = s(ρ), ρ = r/μ or, where a part of Q came with P (`elements`), (r − c/P)/(μ − c/P).
  After a gap of the camera under load s is the most that sticks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiled import njit
from ..paper import NATURAL
from . import level
from .elements import first_pull
from .plateau import CLEAR_SLIP, SPREAD, direction, mean_log_ratio, slip_share

LEVEL_SENSOR, TILTED_SENSOR = 0, 1
"""Kinds of force sensors."""
KINDS = (LEVEL_SENSOR, TILTED_SENSOR)
GRID = 96
LOG_FRICTION = np.linspace(math.log(0.08), math.log(2.5), GRID)
NATURAL_MOISTURE = NATURAL.moisture
"""Moisture (a.u.) at which the prior's median friction holds."""
LARGEST_SHIFT = 1.0
"""Largest change of the prior's ln μ by moisture."""
EDGE = SPREAD
"""Of ln μ: softness of the lower bound: the largest ratio held scatters as one in slip does."""
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
BELIEF = np.dtype(
    [
        ("log_weight", "f8", (2, GRID)),  # of KINDS, without lower bound and present plateau
        ("level", level.LEVEL),  # of TILTED_SENSOR
        ("seen_ratios", "u1", (GRID,)),  # where a plateau was that did not show slip by itself
        ("slips", "i8"),
        ("slip_log_ratio", "f8"),  # ln r of the newest one
        ("slip_confirmed", "?"),  # beyond doubt
        ("has_evidence", "?"),  # more than the prior
    ],
    align=True,
)
DIRECTIONAL = np.dtype(
    [
        ("valid", "?"),  # of the present belief
        ("along", "f8", (2,)),  # a direction of Q
        ("log_weight", "f8", (GRID,)),  # of the ratio at which it slips in it, by LOG_FRICTION
        ("tilted", "f8"),  # probability of TILTED_SENSOR
        ("friction", "f8", (GRID,)),  # mean of μ, where this is the ratio
        ("square", "f8", (GRID,)),  # and of its square
        ("tilt", "f8", (2,)),  # rad, mean
        ("variance", "f8", (2, 2)),  # rad²
    ],
    align=True,
)
FRICTION = np.dtype(
    [
        ("belief", BELIEF),
        ("before", BELIEF),  # at the onset of this contact
        ("largest_held_ratio", "f8"),  # in this contact, of those that still tell most; 0: none
        ("held_direction", "f8", (2,)),
        ("age", "f8"),  # s since it was held
        ("contact_time", "f8"),  # s, of this contact
        ("drifted", "f8"),  # s of it for which the weights were widened
        ("moisture", "f8"),  # of the prior
        ("mean", "f8"),  # of μ, as last given
        ("stddev", "f8"),
        ("limit", "f8"),  # mean of the ratio at which it slips in the direction `directional.along`
        ("directional", DIRECTIONAL),
    ],
    align=True,
)


class PullNow(NamedTuple):
    """The pull at the newest sample. Without `judged` only `stands` means something.

    stands: the plateau lasts; judged: the forces are large enough; ratio: r = |Q|/P; beyond,
    with_load: see `elements.shares`; ahead: largest r within the horizon; spread: of its logarithm.
    """

    stands: bool
    judged: bool
    ratio: float
    beyond: float
    with_load: float
    ahead: float
    spread: float


@njit(cache=True)
def _normal_cdf(x):
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
    """The prior of a moisture (a.u., NaN where it is not known), where there is no evidence yet."""
    friction.moisture = moisture
    belief = friction.belief
    belief.log_weight[LEVEL_SENSOR] = belief.log_weight[TILTED_SENSOR] = _log_prior(prior, moisture)
    belief.log_weight[LEVEL_SENSOR] += math.log(1.0 - belief.level.tilted)
    belief.log_weight[TILTED_SENSOR] += math.log(belief.level.tilted)
    friction.directional.valid = False
    friction.largest_held_ratio = 0.0
    friction.mean = friction.stddev = friction.limit = math.nan


@njit(cache=True)
def _copy(source, target):
    target.log_weight[:] = source.log_weight
    target.seen_ratios[:] = source.seen_ratios
    target.slips, target.has_evidence = source.slips, source.has_evidence
    target.slip_log_ratio, target.slip_confirmed = source.slip_log_ratio, source.slip_confirmed
    level.copy(source.level, target.level)


@njit(cache=True)
def begin_contact(friction):
    """Save the belief. It is restored if this contact turns out not to be a finger."""
    _copy(friction.belief, friction.before)
    friction.contact_time = friction.drifted = 0.0


@njit(cache=True)
def forget_contact(friction):
    """Forget what was learned since the contact began."""
    _copy(friction.before, friction.belief)
    friction.directional.valid = False
    friction.largest_held_ratio = friction.drifted = 0.0


@njit(cache=True)
def _ratio_distribution(belief, kind, g, u0, u1, probability):
    """Distribution of the ratio at which it slips in the direction u at the friction of cell g.

    It stands in `probability` (GRID,), from the first cell to before the last one returned.
    """
    if kind == LEVEL_SENSOR or belief.level.sd == 0.0:
        probability[g] = 1.0
        return g, g + 1
    ratio, error = level.slip_ratio(belief.level, LOG_FRICTION[g], u0, u1)
    step = LOG_FRICTION[1] - LOG_FRICTION[0]
    at = (math.log(ratio) - LOG_FRICTION[0]) / step
    width = max(error / ratio / step, 0.5)
    first = min(max(int(at - 3.0 * width), 0), GRID - 1)
    last = min(max(int(at + 3.0 * width) + 2, first + 1), GRID)
    total = 0.0
    for k in range(first, last):
        probability[k] = math.exp(-0.5 * ((k - at) / width) ** 2) + 1e-30
        total += probability[k]
    for k in range(first, last):
        probability[k] /= total
    return first, last


@njit(cache=True)
def _compute_directional(directional, belief, u0, u1):
    """Distribution of the ratio at which it slips in the direction u."""
    directional.valid = True
    directional.along[0], directional.along[1] = u0, u1
    directional.friction[:] = directional.square[:] = directional.tilt[:] = 0.0
    directional.variance[:] = 0.0
    directional.tilted = 0.0
    weights, probability = np.zeros(GRID), np.empty(GRID)
    top, total = belief.log_weight.max(), 0.0
    for kind in KINDS:
        for g in range(GRID):
            weight = math.exp(belief.log_weight[kind, g] - top)
            if weight == 0.0:
                continue
            mu = math.exp(LOG_FRICTION[g])
            total += weight
            if kind == TILTED_SENSOR:
                directional.tilted += weight
                level.add_moments(
                    belief.level, LOG_FRICTION[g], weight, directional.tilt, directional.variance
                )
            first, last = _ratio_distribution(belief, kind, g, u0, u1, probability)
            for k in range(first, last):
                part = weight * probability[k]
                weights[k] += part
                directional.friction[k] += part * mu
                directional.square[k] += part * mu * mu
    for k in range(GRID):
        if weights[k] > 1e-280:
            directional.log_weight[k] = math.log(weights[k]) + top
            directional.friction[k] /= weights[k]
            directional.square[k] /= weights[k]
        else:  # too unlikely for sums, but all that is left beyond a large ratio held
            directional.log_weight[k] = belief.log_weight[:, k].max()
            directional.friction[k] = math.exp(LOG_FRICTION[k])
            directional.square[k] = directional.friction[k] ** 2
    directional.tilted /= total
    for i in range(2):
        directional.tilt[i] /= total
    for i in range(2):
        for k in range(2):
            directional.variance[i, k] = (
                directional.variance[i, k] / total - directional.tilt[i] * directional.tilt[k]
            )


@njit(cache=True)
def refresh_directional(friction):
    """Compute `directional`, in its direction, if the belief has changed."""
    directional = friction.directional
    if not directional.valid:
        _compute_directional(
            directional, friction.belief, directional.along[0], directional.along[1]
        )


@njit(cache=True)
def set_direction(friction, u0, u1, clear):
    """Compute `directional` for the direction u if that is clear and has changed."""
    directional = friction.directional
    if clear and math.hypot(u0 - directional.along[0], u1 - directional.along[1]) > TURN:
        _compute_directional(directional, friction.belief, u0, u1)
    else:
        refresh_directional(friction)


@njit(cache=True)
def _turned(directional, log_ratio, v0, v1):
    """ln of the ratio r in the direction of `directional` that this ln r in the direction v stands
    for, and its standard deviation."""
    d0, d1 = directional.along[0] - v0, directional.along[1] - v1
    if d0 == 0.0 and d1 == 0.0:
        return log_ratio, 0.0
    ratio, c = math.exp(log_ratio), directional.variance
    gain = 1.0 + ratio * ratio
    variance = d0 * (c[0, 0] * d0 + c[0, 1] * d1) + d1 * (c[1, 0] * d0 + c[1, 1] * d1)
    turned = max(
        ratio + gain * (directional.tilt[0] * d0 + directional.tilt[1] * d1), level.LEAST * ratio
    )
    return math.log(turned), gain * math.sqrt(max(variance, 0.0)) / ratio


@njit(cache=True)
def _update(belief, u0, u1, likelihood, tilt_likelihood):
    """Multiply the weights by a likelihood.

    likelihood (GRID,): of each ratio at which it slips in the direction u; tilt_likelihood: what a
    tilted sensor adds to it.
    """
    probability = np.empty(GRID)
    for kind in KINDS:
        for g in range(GRID):
            first, last = _ratio_distribution(belief, kind, g, u0, u1, probability)
            total = tilt_likelihood if kind == TILTED_SENSOR else 0.0
            for k in range(first, last):
                total += probability[k] * likelihood[k]
            belief.log_weight[kind, g] += math.log(total)


@njit(cache=True)
def _edge_width(friction, drift):
    """Softness of the lower bound of ln μ: friction may have changed since the ratio was held."""
    return math.hypot(EDGE, drift * math.sqrt(friction.age / DRIFT_TIME))


@njit(cache=True)
def raise_lower_bound(friction, ratio, drift):
    """A ratio that is held now, in the direction of `directional`; it replaces a larger one of long
    ago, which tells less."""
    slack = 2.0 * (_edge_width(friction, drift) - EDGE)
    if ratio > friction.largest_held_ratio * math.exp(-slack):
        friction.largest_held_ratio, friction.age = ratio, 0.0
        friction.held_direction[:] = friction.directional.along


@njit(cache=True)
def _tilted_moments(belief):
    """Mean and variance of ln μ where the sensor is not level."""
    weight = np.exp(belief.log_weight[TILTED_SENSOR] - belief.log_weight[TILTED_SENSOR].max())
    weight /= weight.sum()
    mean = np.sum(weight * LOG_FRICTION)
    return mean, np.sum(weight * (LOG_FRICTION - mean) ** 2)


@njit(cache=True)
def _predict_tilt(belief, change):
    """Predict the tilt after a random step of ln μ of this variance."""
    if belief.level.sd > 0.0:
        mean, variance = _tilted_moments(belief)
        level.predict(belief.level, mean, variance, change)


@njit(cache=True)
def predict(friction, drift, dt):
    """dt (s) of a contact, in which ln μ may change by this drift in DRIFT_TIME."""
    friction.contact_time += dt
    if friction.contact_time < friction.drifted + DRIFT_STEP:
        return
    step = friction.contact_time - friction.drifted
    friction.drifted += step
    friction.age += step
    belief = friction.belief
    if belief.has_evidence:
        cells = drift / (LOG_FRICTION[1] - LOG_FRICTION[0])
        share = min(0.5 * cells * cells * step / DRIFT_TIME, 0.3)
        _predict_tilt(belief, drift * drift * step / DRIFT_TIME)
        top = belief.log_weight.max()
        for kind in KINDS:
            weight = np.exp(belief.log_weight[kind] - top)
            for g in range(GRID):
                below, above = weight[max(g - 1, 0)], weight[min(g + 1, GRID - 1)]
                widened = weight[g] + share * (below - 2.0 * weight[g] + above)
                belief.log_weight[kind, g] = math.log(max(widened, 1e-300))
        friction.directional.valid = False


@njit(cache=True)
def end_contact(friction, prior, drift):
    """Fold the lower bound into the weights. In the next contact ln μ may differ by what is
    left of this drift."""
    belief = friction.belief
    if friction.largest_held_ratio > 0.0:
        belief.has_evidence = True
        width = _edge_width(friction, drift)
        likelihood = np.empty(GRID)
        for g in range(GRID):
            edge = _normal_cdf((LOG_FRICTION[g] - math.log(friction.largest_held_ratio)) / width)
            likelihood[g] = edge + 1e-6
        _update(belief, friction.held_direction[0], friction.held_direction[1], likelihood, 0.0)
    friction.largest_held_ratio = 0.0
    friction.directional.valid = False
    # Widen by a Gaussian of the drift.
    left = max(0.0, 1.0 - friction.drifted / DRIFT_TIME)
    _predict_tilt(belief, left * drift * drift)
    width = math.sqrt(left) * drift / (LOG_FRICTION[1] - LOG_FRICTION[0])
    reach = int(3.0 * width) + 1
    another = _log_prior(prior, friction.moisture)
    another = np.exp(another - another.max())
    another /= another.sum()
    weights = np.exp(belief.log_weight - belief.log_weight.max())
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
            belief.log_weight[kind, g] = math.log(max(found, 1e-300))


@njit(cache=True)
def keep_level(before, belief):
    """Another surface on the same sensor: keep what was known of its tilt."""
    _predict_tilt(before, math.inf)
    level.copy(before.level, belief.level)
    share = np.exp(before.log_weight - before.log_weight.max())
    belief.level.tilted = min(max(share[TILTED_SENSOR].sum() / share.sum(), SUREST), 1.0 - SUREST)


@njit(cache=True)
def _cell(log_friction):
    """Index of the nearest of LOG_FRICTION."""
    step = (LOG_FRICTION[-1] - LOG_FRICTION[0]) / (GRID - 1)
    return min(max(round((log_friction - LOG_FRICTION[0]) / step), 0), GRID - 1)


@njit(cache=True)
def _is_news(belief, plateau):
    """Whether the plateau tells of friction what none before it did. A thing that is held again, or
    whose load dips and returns, stands still at the same ratio."""
    at = _cell(mean_log_ratio(plateau))
    seen = belief.seen_ratios[max(at - NEAR, 0) : at + NEAR + 1].max() > 0
    return plateau.odds >= CLEAR_SLIP or not seen


@njit(cache=True)
def _likelihood(share, log_ratio, spread, log_friction):
    """Likelihood of a plateau under a friction, and the part of it that is slip; share: that of
    slip before friction is asked; spread: of ln r in slip."""
    z = (log_ratio - log_friction) / spread
    slip = share * math.exp(-0.5 * z * z) / (spread * 2.5066282746)
    hold = (1.0 - share) * HOLD_DENSITY * _normal_cdf(-z)
    return slip + hold + 1e-9, slip


@njit(cache=True)
def update_from_plateau(friction, plateau):
    """Update from a plateau that ends; the probability that it was a slip that is news."""
    belief, directional = friction.belief, friction.directional
    belief.has_evidence, directional.valid = True, False
    share, log_ratio = slip_share(plateau), mean_log_ratio(plateau)
    news = _is_news(belief, plateau)
    if plateau.odds < CLEAR_SLIP:
        belief.seen_ratios[_cell(log_ratio)] = 1
    if not news:
        return 0.0
    u0, u1 = direction(plateau)
    _compute_directional(directional, belief, u0, u1)
    directional.valid = False
    ratio = math.exp(log_ratio)
    tilt_likelihood = share * level.tilt_likelihood(belief.level, ratio, u0, u1)
    total, slip_total = 0.0, 0.0
    top = directional.log_weight.max()
    likelihood = np.empty(GRID)
    for g in range(GRID):
        likelihood[g], slip = _likelihood(share, log_ratio, plateau.spread, LOG_FRICTION[g])
        weight = math.exp(directional.log_weight[g] - top)
        total += weight * (likelihood[g] + directional.tilted * tilt_likelihood)
        slip_total += weight * slip
    _update(belief, u0, u1, likelihood, tilt_likelihood)
    probability = slip_total / total
    if probability > TILT_SLIP and belief.level.sd > 0.0:
        mean, _ = _tilted_moments(belief)
        level.update(belief.level, mean, ratio, u0, u1, plateau.spread * ratio)
    return probability


@njit(cache=True)
def count_slip(belief, log_ratio, probability):
    """A slip at this ln r, of this probability: one that is clear, or two that agree, leave no
    doubt."""
    agrees = belief.slips > 0 and abs(log_ratio - belief.slip_log_ratio) < AGREES
    belief.slip_confirmed = belief.slip_confirmed or probability > CLEAR or agrees
    belief.slip_log_ratio = log_ratio
    belief.slips += 1


@njit(cache=True)
def _first_stick(beyond, with_load, friction):
    """Stick ratio of a first pull; `beyond` and `with_load`: see `elements.shares`."""
    return first_pull(beyond / max(friction - with_load, 1e-6))


@njit(cache=True)
def update_from_stick_ratio(friction, beyond, with_load, stick, sd, at_most):
    """Update from a stick ratio ± sd that was seen in a first pull, in the direction of
    `directional`, at these `elements.shares`. at_most: less than that may stick."""
    spread = math.hypot(sd, 0.04)
    belief, directional = friction.belief, friction.directional
    belief.has_evidence, directional.valid = True, False
    likelihood = np.empty(GRID)
    for g in range(GRID):
        z = (_first_stick(beyond, with_load, math.exp(LOG_FRICTION[g])) - stick) / spread
        if at_most:
            z = max(z, 0.0)
        likelihood[g] = (math.exp(-0.5 * z * z) + 1e-3) ** FRAME_SHARE
    _update(belief, directional.along[0], directional.along[1], likelihood, 0.0)


@njit(cache=True)
def _moments(weighted, squared, total):
    """Mean and standard deviation, of weighted sums of a value and of its square."""
    mean = weighted / total
    return mean, math.sqrt(max(squared / total - mean * mean, 0.0))


@njit(cache=True)
def evaluate(friction, drift, plateau, now, out):
    """Write friction, probability of slip, margin and stick ratio of a first pull to `out`, with
    their deviations, by all weights; now: the PullNow. Returns whether the contact slips."""
    directional = friction.directional
    share, log_ratio, news, plateau_spread, tilt_likelihood = 0.0, 0.0, False, 1.0, 0.0
    if now.stands:
        share = slip_share(plateau)
        news = _is_news(friction.belief, plateau)
        v0, v1 = direction(plateau)
        log_ratio = mean_log_ratio(plateau)
        tilt_likelihood = level.tilt_likelihood(friction.belief.level, math.exp(log_ratio), v0, v1)
        tilt_likelihood *= share * directional.tilted
        log_ratio, error = _turned(directional, log_ratio, v0, v1)
        plateau_spread = math.hypot(plateau.spread, error)
    held, error = math.log(max(friction.largest_held_ratio, 1e-3)), 0.0
    if friction.largest_held_ratio > 0.0:
        v0, v1 = friction.held_direction[0], friction.held_direction[1]
        held, error = _turned(directional, held, v0, v1)
    # A ratio held beyond the grid leaves its largest friction.
    edge_at = min(held, LOG_FRICTION[-1])
    edge_width = math.hypot(_edge_width(friction, drift), error)
    log_weight = np.empty(GRID)
    for g in range(GRID):
        edge = _normal_cdf((LOG_FRICTION[g] - edge_at) / edge_width)
        log_weight[g] = directional.log_weight[g] + (math.log(edge) if edge > 0.0 else -math.inf)
    top = log_weight.max()
    total, mean, square, slip_total, probability = 0.0, 0.0, 0.0, 0.0, 0.0
    stick_mean, stick_square, margin_mean, margin_square, limit = 0.0, 0.0, 0.0, 0.0, 0.0
    log_ahead = math.log(max(now.ahead, 1e-6))
    for g in range(GRID):
        x = LOG_FRICTION[g]
        weight = math.exp(log_weight[g] - top)
        slip = 0.0
        if now.stands:
            likelihood, slip_part = _likelihood(share, log_ratio, plateau_spread, x)
            likelihood += tilt_likelihood
            slip = slip_part / likelihood
            if news:
                weight *= likelihood
        slips_at = math.exp(x)
        total += weight
        limit += weight * slips_at
        mean += weight * directional.friction[g]
        square += weight * directional.square[g]
        slip_total += weight * slip
        if now.judged:
            coming = _normal_cdf((log_ahead - x) / now.spread)
            probability += weight * max(slip, coming)
            s = (1.0 - slip) * _first_stick(now.beyond, now.with_load, slips_at)
            stick_mean += weight * s
            stick_square += weight * s * s
            margin = (1.0 - slip) * max(0.0, 1.0 - now.ratio / slips_at)
            margin_mean += weight * margin
            margin_square += weight * margin * margin
    friction.mean, friction.stddev = _moments(mean, square, total)
    friction.limit = limit / total
    if friction.largest_held_ratio > 0.95 * math.exp(LOG_FRICTION[-1]):
        friction.stddev = friction.mean
    out.friction, out.friction_stddev = friction.mean, friction.stddev
    out.slip_probability = min(probability / total, 1.0)
    out.slip_margin, out.slip_margin_stddev = _moments(margin_mean, margin_square, total)
    out.stick_ratio, out.stick_ratio_stddev = _moments(stick_mean, stick_square, total)
    return slip_total > 0.5 * total
