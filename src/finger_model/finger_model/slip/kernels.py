# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled core of the slip estimator.

**Friction** is a distribution over a grid of ln μ: a prior, widened a little at every contact;
nothing below the largest ratio r = |Q|/P that was carried (a soft edge); and two kinds of evidence:

- *A plateau of r.* The ratio stands still: the skin slips, so r = μ, or a pull is held, at any r
  below μ. Forecasts over LAG are compared: in slip Q follows P, Q = r P; while the skin sticks Q
  goes on at its own rate, whatever P does. The likelihood is a mixture of slip and holding.
- *A stick ratio seen by a camera*, s ± σ at a known r of a first pull: μ = r/ρ with s = s(ρ).

**Elements** (see `backbone`) give the stick ratio of any history of P and Q at the mean friction.
"""

from __future__ import annotations

import math

import numpy as np

from finger_common.flags import SlipFlag

from ..compiled import njit
from ..laws.maxwell import step_weights
from . import backbone
from .shear import DEPTHS

NO_CONTACT, SLIPPING, ASSUMED, INVALID = (int(flag) for flag in SlipFlag)

ELEMENTS = 40
GRID = 96
LOG_FRICTION = np.linspace(math.log(0.08), math.log(2.5), GRID)
LIMITS = backbone.limits(ELEMENTS)
CURVE = np.interp(np.linspace(0.0, 1.0, 101), *backbone.STICK_CURVE.T)
"""Stick ratio of a first pull at r = 0, 0.01 … 1."""
REMEMBERED = 8192
"""Samples remembered, for stick ratios that come late: 1 s at up to 8 kHz."""

COMPLIANCE = backbone.SLIP_COMPLIANCE
BRANCHES = 4
"""Most branches of the tissue."""
FIRST_DEPTH, NODES = math.log(DEPTHS[0]), len(DEPTHS)
DEPTH_STEP = math.log(DEPTHS[1] / DEPTHS[0])

FAST, SLOW = 0.008, 0.03
"""s, time constants of the filters of the present forces and of their rates."""
LAG, EVERY, MEMORY = 0.04, 0.01, 0.1
"""s: over which forces are forecast, how often, and how long the comparison is remembered."""
LAGS = 4
OLD = LAG - 0.5 * EVERY
"""s, age from which a forecast is compared."""
STILL = -1.0
"""Log of the odds of slip and holding against pulling above which r stands still."""
NATURAL_MOISTURE = 69.0
"""Moisture (a.u.) at which the prior's median friction holds."""
LARGEST_SHIFT = 1.0
"""Largest change of the prior's ln μ by moisture."""
SLIP_ODDS = -1.5
"""Log of the odds of slip against holding of a plateau that shows neither: held things are more."""
CLEAR_SLIP = 2.0
"""Log of the odds of slip against holding from which a plateau tells of slip by itself."""
LETTING_GO = 3.0
"""1/s, fall of P over P from which a finger lets go: then Q falls with P, also where what it held
is put down, but at another ratio than before."""
NEAR = 2
"""Steps of LOG_FRICTION within which two plateaus have one ratio."""
FIRST_LOOKS = 5
"""Comparisons of a plateau before which its odds are those of the newest one."""
PLATEAU_AFTER = 0.02
"""s that r must stand still."""
TURNED = 0.85
"""Share of the largest ratio of a pull below which it counts as reversed."""
EDGE = 0.03
"""Of ln μ: softness of the edge at the largest ratio carried, and scatter of r in slip."""
FRAME_SHARE = 0.3
"""Share of a frame's evidence that counts: frames of one pull err alike where s(r) is not exact."""
FRAMES, NEXT_RATIO = 20, 0.05
"""Frames of a pull that count until r has grown by NEXT_RATIO: more of them err as these do."""
SMALLEST_FORCE = 0.05
"""N; below it ratios are not judged."""
TEACHING_FORCE = 0.2
"""N; below it a ratio carried teaches no friction: what the tare left may be all of it."""

CONFIGURATION = np.dtype(
    [
        ("prior_mean", "f8"),  # of ln μ, at natural moisture
        ("moisture_slope", "f8"),  # of ln μ
        ("prior_sd", "f8"),
        ("drift", "f8"),
        ("horizon", "f8"),  # s
        ("noise", "f8"),  # N
        ("length", "f8"),  # m, the pad's radial semi-axis
        ("shear", "f8", (NODES,)),  # N/m, see `shear`
        ("fractions", "f8", (BRANCHES,)),  # of the tissue's branches, 0 where there is none
        ("times", "f8", (BRANCHES,)),  # s
    ]
)
_TRACK = np.dtype([("value", "f8", (3,)), ("rate", "f8", (3,))])
LEARNED = np.dtype(
    [
        ("log_weight", "f8", (GRID,)),  # prior and evidence, without edge and present plateau
        ("unclear", "u1", (GRID,)),  # ln r of plateaus that did not show slip by themselves
        ("slips", "i8"),
        ("told", "?"),  # the weights hold more than the prior
    ],
    align=True,
)
"""What is known of the friction."""
STATE = np.dtype(
    [
        ("touching", "?"),
        ("doubted", "?"),  # the newest force of this contact is hardly a finger's
        ("stamp", "i8"),
        ("fast", _TRACK),  # P, Qx, Qy
        ("slow", _TRACK),
        ("known", LEARNED),
        ("before", LEARNED),  # at the onset of this contact
        ("largest", "f8"),  # ratio carried in this contact
        ("judged_at", "i8"),  # ns, last comparison of forecasts
        ("forecast", "f8", (LAGS, 4)),  # stamp (s), r, Q, its rate
        ("forecasts", "i8"),
        ("odds", "f8"),  # log, of standing still against pulling
        ("slip_odds", "f8"),  # log, of slip against holding
        ("turned", "?"),  # r has fallen since the pull began: s(r) does not hold
        ("pull_largest", "f8"),
        ("plateau", "?"),
        ("plateau_begin", "i8"),
        ("plateau_count", "f8"),
        ("plateau_sum", "f8"),  # of ln r
        ("plateau_odds", "f8"),  # largest log of the odds of slip in it
        ("plateau_looks", "i8"),
        ("friction", "f8", (2,)),  # mean and standard deviation, as last given
        ("counted", "?"),  # the slip of this pull
        ("moisture", "f8"),  # of the prior
        ("force", "f8", (ELEMENTS, 2)),  # of the elements, over the share of one
        ("moved", "f8", (2,)),  # displacement of the elements, N
        ("displaced", "f8", (2,)),  # m, of the plate
        ("crept", "f8", (BRANCHES, 2)),  # m, displacement that each branch has come to
        ("next", "i8"),
        ("frames", "i8"),  # stick ratios seen in this pull since r was `frames_ratio`
        ("frames_ratio", "f8"),
        ("past_stamp", "i8", (REMEMBERED,)),
        ("past_ratio", "f8", (REMEMBERED,)),  # NaN where s(r) does not hold
    ],
    align=True,
)


@njit(cache=True)
def _normal(x):
    """Distribution function of the normal distribution."""
    return 0.5 * math.erfc(-x * 0.7071067811865476)


@njit(cache=True)
def _curve(ratio):
    """Stick ratio of a first pull."""
    if ratio >= 1.0:
        return 0.0
    at = 100.0 * max(ratio, 0.0)
    low = min(int(at), 99)
    return CURVE[low] + (at - low) * (CURVE[low + 1] - CURVE[low])


@njit(cache=True)
def set_prior(config, state, moisture):
    """Forget all evidence: the prior of a moisture (a.u., NaN where it is not known) alone."""
    shift = 0.0
    if math.isfinite(moisture):
        shift = config.moisture_slope * (moisture - NATURAL_MOISTURE)
        shift = min(max(shift, -LARGEST_SHIFT), LARGEST_SHIFT)
    state.moisture = moisture
    for g in range(GRID):
        z = (LOG_FRICTION[g] - config.prior_mean - shift) / config.prior_sd
        state.known.log_weight[g] = -0.5 * z * z
    state.largest = 0.0
    state.known.slips = 0
    state.friction[:] = math.nan
    state.known.unclear[:] = 0


@njit(cache=True)
def _track(track, tau, dt, values):
    """Critically damped filter of value and rate (fading memory of degree 1)."""
    beta = math.exp(-dt / tau)
    for i in range(3):
        ahead = track.value[i] + track.rate[i] * dt
        miss = values[i] - ahead
        track.value[i] = ahead + (1.0 - beta * beta) * miss
        track.rate[i] += (1.0 - beta) ** 2 / dt * miss


@njit(cache=True)
def _ratio_rate(track):
    """r = |Q|/P of a track, and its rate (1/s)."""
    p = max(track.value[0], 1e-6)
    q = math.hypot(track.value[1], track.value[2])
    rise = 0.0
    if q > 1e-9:
        rise = (track.value[1] * track.rate[1] + track.value[2] * track.rate[2]) / q
    return q / p, (rise * p - q * track.rate[0]) / (p * p)


@njit(cache=True)
def _cell(log_friction):
    """Index of the nearest of LOG_FRICTION."""
    step = (LOG_FRICTION[-1] - LOG_FRICTION[0]) / (GRID - 1)
    return min(max(round((log_friction - LOG_FRICTION[0]) / step), 0), GRID - 1)


@njit(cache=True)
def _slip_share(state):
    """Probability, before friction is asked, that the plateau is slip."""
    return 1.0 / (1.0 + math.exp(-SLIP_ODDS - state.plateau_odds))


@njit(cache=True)
def _is_news(state, log_ratio):
    """Whether the plateau tells of friction what none before it did. A thing that is held again, or
    whose load dips and returns, stands still at the same ratio."""
    at = _cell(log_ratio)
    known = state.known.unclear[max(at - NEAR, 0) : at + NEAR + 1].max() > 0
    return state.plateau_odds >= CLEAR_SLIP or not known


@njit(cache=True)
def _plateau_likelihood(state, share, log_ratio, log_friction):
    """Likelihood of the plateau under a friction, and the part of it that is slip."""
    z = (log_ratio - log_friction) / EDGE
    slip = share * math.exp(-0.5 * z * z) / (EDGE * 2.5066282746)
    hold = (1.0 - share) * math.exp(log_ratio - log_friction) * _normal(-z)
    return slip + hold + 1e-9, slip


@njit(cache=True)
def _commit(state, share):
    """Keep what the plateau that ends has told."""
    state.known.told = True
    log_ratio = state.plateau_sum / state.plateau_count
    news = _is_news(state, log_ratio)
    if state.plateau_odds < CLEAR_SLIP:
        state.known.unclear[_cell(log_ratio)] = 1
    total, slip_total = 0.0, 0.0
    top = state.known.log_weight.max()
    for g in range(GRID):
        likelihood, slip = _plateau_likelihood(state, share, log_ratio, LOG_FRICTION[g])
        weight = math.exp(state.known.log_weight[g] - top)
        total += weight * likelihood
        slip_total += weight * slip
        if news:
            state.known.log_weight[g] += math.log(likelihood)
    if news and slip_total > 0.5 * total and not state.counted:
        state.counted = True
        state.known.slips += 1


@njit(cache=True)
def _end_contact(config, state, stamp):
    """Fold the edge into the weights; friction may differ in the next contact.

    What was learned from a force that was hardly a finger's is forgotten.
    """
    if state.doubted:
        _copy(state.before, state.known)
        state.plateau, state.largest = False, 0.0
    if state.plateau and (stamp - state.plateau_begin) * 1e-9 >= PLATEAU_AFTER:
        _commit(state, _slip_share(state))
    state.plateau = False
    if state.largest > 0.0:
        state.known.told = True
        for g in range(GRID):
            edge = _normal((LOG_FRICTION[g] - math.log(state.largest)) / EDGE)
            state.known.log_weight[g] += math.log(edge + 1e-6)
    top = state.known.log_weight.max()
    step = LOG_FRICTION[1] - LOG_FRICTION[0]
    # Widen by a Gaussian of the drift.
    width = config.drift / step
    reach = int(3.0 * width) + 1
    weight = np.exp(state.known.log_weight - top)
    for g in range(GRID):
        total, norm = 0.0, 0.0
        for k in range(max(g - reach, 0), min(g + reach + 1, GRID)):
            share = math.exp(-0.5 * ((k - g) / max(width, 1e-3)) ** 2)
            total += share * weight[k]
            norm += share
        state.known.log_weight[g] = math.log(total / norm + 1e-9)
    state.largest = 0.0
    state.force[:, :] = 0.0
    state.moved[:] = 0.0
    state.displaced[:] = state.crept[:] = 0.0
    state.touching = False


@njit(cache=True)
def _copy(learned, to):
    to.log_weight[:] = learned.log_weight
    to.unclear[:] = learned.unclear
    to.slips, to.told = learned.slips, learned.told


@njit(cache=True)
def _summed(state, load, d0, d1):
    """Elements moved by d: their mean force, its derivatives (xx, xy, yy), their mean potential,
    and the share of them that sticks."""
    f0, f1, a, b, c, potential, stuck = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(ELEMENTS):
        t0, t1 = state.force[i, 0] + d0, state.force[i, 1] + d1
        size, limit = math.hypot(t0, t1), load * LIMITS[i]
        if size > limit:
            k = limit / size
            n0, n1 = t0 / size, t1 / size
            f0 += k * t0
            f1 += k * t1
            a += k * (1.0 - n0 * n0)
            b -= k * n0 * n1
            c += k * (1.0 - n1 * n1)
            potential += limit * (size - 0.5 * limit)
        else:
            f0 += t0
            f1 += t1
            a += 1.0
            c += 1.0
            potential += 0.5 * size * size
            stuck += 1.0
    n = 1.0 / ELEMENTS
    return f0 * n, f1 * n, a * n, b * n, c * n, potential * n, stuck * n


@njit(cache=True)
def _pull(state, load, q0, q1):
    """Move the elements until their forces sum to Q at limits of `load` = μP; the stick ratio."""
    total = math.hypot(q0, q1)
    if total >= 0.999 * load:
        for i in range(ELEMENTS):
            state.force[i, 0] = q0 / max(total, 1e-12) * load * LIMITS[i]
            state.force[i, 1] = q1 / max(total, 1e-12) * load * LIMITS[i]
        return 0.0
    # Newton's method for the least of a convex potential: far away, where all slip, it needs a
    # limit to its steps, and steps that raise the potential are halved.
    d0, d1 = 0.0, 0.0
    f0, f1, a, b, c, potential, stuck = _summed(state, load, d0, d1)
    for _ in range(30):
        e0, e1 = q0 - f0, q1 - f1
        if math.hypot(e0, e1) < 1e-6 * load:
            break
        a, c = a + 1e-3, c + 1e-3
        det = a * c - b * b
        s0, s1 = (c * e0 - b * e1) / det, (a * e1 - b * e0) / det
        part = min(1.0, 4.0 * load / math.hypot(s0, s1))
        before = potential - q0 * d0 - q1 * d1
        while True:
            n0, n1 = d0 + part * s0, d1 + part * s1
            f0, f1, a, b, c, potential, stuck = _summed(state, load, n0, n1)
            gain = before - (potential - q0 * n0 - q1 * n1)
            if gain >= 1e-4 * part * (e0 * s0 + e1 * s1) or part < 1e-6:
                break
            part *= 0.5
        d0, d1 = n0, n1
    for i in range(ELEMENTS):
        t0, t1 = state.force[i, 0] + d0, state.force[i, 1] + d1
        k = min(1.0, load * LIMITS[i] / max(math.hypot(t0, t1), 1e-12))
        state.force[i, 0] = k * t0
        state.force[i, 1] = k * t1
    state.moved[0] += d0
    state.moved[1] += d1
    return stuck


@njit(cache=True)
def _compare(config, state, stamp):
    """Compare what was forecast LAG ago with what came."""
    p = state.fast.value[0]
    q = math.hypot(state.fast.value[1], state.fast.value[2])
    slow = math.hypot(state.slow.value[1], state.slow.value[2])
    rise = 0.0
    if slow > 1e-9:
        rise = state.slow.value[1] * state.slow.rate[1] + state.slow.value[2] * state.slow.rate[2]
        rise /= slow
    # The newest forecast that is old enough: fewer back where samples are rare.
    back = 1
    while back < LAGS and stamp * 1e-9 - state.forecast[(state.forecasts - back) % LAGS][0] < OLD:
        back += 1
    if state.forecasts >= back:
        past = state.forecast[(state.forecasts - back) % LAGS]
        lag = stamp * 1e-9 - past[0]
        if 0.5 * LAG < lag < 2.0 * LAG:
            # Noise of the filtered forces, and what a slip's friction and a pull's rate vary.
            noise = (0.6 * config.noise) ** 2
            ratio = past[1]
            slip = q - ratio * p
            hold = q - past[2]
            pull = q - past[2] - past[3] * lag
            slip_variance = 2.0 * noise * (1.0 + ratio * ratio) + (0.008 * q) ** 2
            hold_variance = 2.0 * noise + (0.008 * q) ** 2
            pull_variance = 4.0 * noise + (0.3 * past[3] * lag) ** 2 + (0.004 * q) ** 2
            log_slip = -0.5 * (slip * slip / slip_variance + math.log(slip_variance))
            log_hold = -0.5 * (hold * hold / hold_variance + math.log(hold_variance))
            log_pull = -0.5 * (pull * pull / pull_variance + math.log(pull_variance))
            keep = math.exp(-EVERY / MEMORY)
            gain = max(log_slip, log_hold) - log_pull
            state.odds = keep * state.odds + min(max(gain, -3.0), 3.0)
            gain = log_slip - log_hold
            if state.plateau and state.fast.rate[0] < -LETTING_GO * p:
                away = math.log(max(q, 1e-9) / p) - state.plateau_sum / state.plateau_count
                if abs(away) > EDGE:
                    gain = min(gain, 0.0)
            state.slip_odds = keep * state.slip_odds + min(max(gain, -2.0), 2.0)
    now = state.forecast[state.forecasts % LAGS]
    now[0], now[1], now[2], now[3] = stamp * 1e-9, q / max(p, 1e-6), q, rise
    state.forecasts += 1


@njit(cache=True)
def _judge_plateau(config, state, stamp, ratio):
    """Whether r stands still, and since when."""
    if (stamp - state.judged_at) * 1e-9 < EVERY:
        return
    state.judged_at = stamp
    _compare(config, state, stamp)
    q = math.hypot(state.fast.value[1], state.fast.value[2])
    still = state.odds > STILL and ratio > 0.05 and q > 6.0 * config.noise
    still = still and state.forecasts > 2 * LAGS
    if state.plateau and not still:
        if (stamp - state.plateau_begin) * 1e-9 >= PLATEAU_AFTER:
            _commit(state, _slip_share(state))
        state.plateau = False
    elif still and not state.plateau:
        state.plateau = True
        state.plateau_begin = stamp
        state.plateau_count = 0.0
        state.plateau_sum = 0.0
        state.plateau_odds = state.slip_odds = 0.0
        state.plateau_looks = 0
    if state.plateau:
        # The ratio of the time in which it looked most like slip.
        if state.slip_odds > state.plateau_odds + 0.5:
            keep = 0.5
            state.plateau_sum *= keep
            state.plateau_count *= keep
        if state.slip_odds > state.plateau_odds - 0.5 or state.plateau_count == 0.0:
            state.plateau_sum += math.log(max(ratio, 1e-6))
            state.plateau_count += 1.0
        state.plateau_looks += 1
        if state.plateau_looks <= FIRST_LOOKS:
            state.plateau_odds = state.slip_odds
        state.plateau_odds = max(state.plateau_odds, state.slip_odds)


@njit(cache=True)
def _say_nothing(out):
    """All NaN but what is known anyway."""
    out.stick_ratio = out.stick_ratio_stddev = math.nan
    out.slip_margin = out.slip_margin_stddev = math.nan
    out.slip_probability = 0.0
    out.tangential_displacement[0] = out.tangential_displacement[1] = math.nan
    out.tangential_stiffness = math.nan


@njit(cache=True)
def _stiffness(config, indentation):
    """Tangential stiffness (N/m) under a sudden load; NaN where the finger is not indented."""
    if not indentation > 0.0:
        return math.nan
    at = (math.log(indentation / config.length) - FIRST_DEPTH) / DEPTH_STEP
    at = min(max(at, 0.0), NODES - 1.001)
    k = int(at)
    return config.shear[k] + (at - k) * (config.shear[k + 1] - config.shear[k])


@njit(cache=True)
def _displace(config, state, dt, stiffness, q):
    """Displace the plate under Q (2,), dt (s) after the sample before: the tissue creeps by its
    branches as in a linear Maxwell model, and what slips adds its share."""
    before, driven = state.displaced.copy(), np.empty(2)
    rest = 1.0
    for i in range(2):
        driven[i] = (q[i] + COMPLIANCE * (state.moved[i] - q[i])) / stiffness
    # Exact for a displacement that is linear within the step.
    for b in range(BRANCHES):
        weights = step_weights(dt, config.times[b])
        rest -= config.fractions[b] * weights.new
        for i in range(2):
            state.crept[b, i] = weights.decay * state.crept[b, i] + weights.old * before[i]
            driven[i] += config.fractions[b] * state.crept[b, i]
    for i in range(2):
        state.displaced[i] = driven[i] / rest
    for b in range(BRANCHES):
        new = step_weights(dt, config.times[b]).new
        for i in range(2):
            state.crept[b, i] += new * state.displaced[i]


@njit(cache=True)
def follow(config, state, stamp, normal, q0, q1, touching, doubted, indentation, moisture, out):
    """One sample: stamp (ns), P and Q (N), whether in contact and whether that is doubted,
    indentation (m), moisture (a.u.)."""
    out.stamp_ns = stamp
    out.normal_force = normal
    out.tangential_force[0], out.tangential_force[1] = q0, q1
    if not math.isfinite(normal + q0 + q1):
        _say_nothing(out)
        out.friction, out.friction_stddev = state.friction[0], state.friction[1]
        out.slips = state.known.slips
        out.flags = INVALID | (ASSUMED if state.known.slips == 0 else 0)
        return
    if not state.known.told and moisture != state.moisture and math.isfinite(moisture):
        set_prior(config, state, moisture)
    dt = (stamp - state.stamp) * 1e-9
    if touching and not state.touching:
        state.touching = True
        _copy(state.known, state.before)
        for i in range(3):
            value = normal if i == 0 else (q0 if i == 1 else q1)
            state.fast.value[i] = state.slow.value[i] = value
            state.fast.rate[i] = state.slow.rate[i] = 0.0
        dt = 0.0
        state.pull_largest = 0.0
        state.turned = state.counted = False
        state.frames, state.frames_ratio = 0, 0.0
        state.forecasts = 0
        state.odds, state.slip_odds = -3.0, 0.0
    elif state.touching and not touching:
        _end_contact(config, state, stamp)
    elif touching and dt > 0.0:
        values = (normal, q0, q1)
        _track(state.fast, FAST, dt, values)
        _track(state.slow, SLOW, dt, values)
    if touching:
        state.doubted = doubted
    state.stamp = stamp
    out.slips = state.known.slips
    out.flags = ASSUMED if state.known.slips == 0 else 0
    judged = touching and normal >= SMALLEST_FORCE and state.fast.value[0] >= SMALLEST_FORCE
    ratio = 0.0
    if judged:
        ratio, _ = _ratio_rate(state.fast)
        slow, _ = _ratio_rate(state.slow)
        # Noise of the force is no pull.
        held = min(ratio, slow) - 2.0 * config.noise / state.fast.value[0]
        if state.fast.value[0] >= TEACHING_FORCE:
            state.largest = max(state.largest, held)
        state.pull_largest = max(state.pull_largest, held)
        if ratio < TURNED * state.pull_largest - 0.02:
            state.turned = True
        if ratio < 0.5 * state.pull_largest and not state.plateau:
            state.counted = False
            state.frames, state.frames_ratio = 0, 0.0
        _judge_plateau(config, state, stamp, slow)
    at = state.next % REMEMBERED
    state.past_stamp[at] = stamp
    state.past_ratio[at] = ratio if judged and not state.turned else math.nan
    state.next += 1

    # Friction.
    plateau = state.plateau and (stamp - state.plateau_begin) * 1e-9 >= PLATEAU_AFTER
    share, log_ratio, news = 0.0, 0.0, False
    if plateau:
        share = _slip_share(state)
        log_ratio = state.plateau_sum / state.plateau_count
        news = _is_news(state, log_ratio)
    # A ratio beyond all frictions that are thought of leaves the largest of them.
    edge_at = min(math.log(max(state.largest, 1e-3)), LOG_FRICTION[-1])
    log_weight = np.empty(GRID)
    for g in range(GRID):
        edge = _normal((LOG_FRICTION[g] - edge_at) / EDGE)
        log_weight[g] = state.known.log_weight[g] + (math.log(edge) if edge > 0.0 else -math.inf)
    top = log_weight.max()
    ahead, spread = 0.0, EDGE
    if judged:
        p = max(state.fast.value[0] + config.horizon * state.fast.rate[0], 1e-3)
        a0 = state.fast.value[1] + config.horizon * state.fast.rate[1]
        a1 = state.fast.value[2] + config.horizon * state.fast.rate[2]
        ahead = max(math.hypot(a0, a1) / p, ratio)
        if plateau:
            ahead = ratio
        spread = math.hypot(EDGE, 0.6 * config.noise / max(ahead * p, 1e-3))
    total, mean, square, slip_total, probability = 0.0, 0.0, 0.0, 0.0, 0.0
    stick_mean, stick_square = 0.0, 0.0
    log_ahead = math.log(max(ahead, 1e-6))
    for g in range(GRID):
        x = LOG_FRICTION[g]
        weight = math.exp(log_weight[g] - top)
        slip = 0.0
        if plateau:
            likelihood, slip_part = _plateau_likelihood(state, share, log_ratio, x)
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
            s = (1.0 - slip) * _curve(ratio / mu)
            stick_mean += weight * s
            stick_square += weight * s * s
    mean /= total
    out.friction = mean
    out.friction_stddev = math.sqrt(max(square / total - mean * mean, 0.0))
    if state.largest > 0.95 * math.exp(LOG_FRICTION[-1]):
        out.friction_stddev = mean
    state.friction[0], state.friction[1] = out.friction, out.friction_stddev
    if not judged:
        _say_nothing(out)
        out.flags |= NO_CONTACT
        if touching:
            _pull(state, mean * max(normal, 1e-6), 0.0, 0.0)
        return
    stick_mean /= total
    spread = math.sqrt(max(stick_square / total - stick_mean * stick_mean, 0.0))
    slipping = slip_total > 0.5 * total
    if slipping:
        out.flags |= SLIPPING
    out.slip_probability = min(probability / total, 1.0)
    stick = _pull(state, mean * state.fast.value[0], state.fast.value[1], state.fast.value[2])
    if not state.turned and not slipping:
        # A first pull: the mean over frictions, which the elements follow at the mean one only.
        stick = stick_mean
    out.stick_ratio = 0.0 if slipping else stick
    out.stick_ratio_stddev = math.hypot(spread, 0.03)
    out.slip_margin = 0.0 if slipping else max(0.0, 1.0 - ratio / mean)
    out.slip_margin_stddev = ratio / mean * math.hypot(out.friction_stddev / mean, EDGE)
    out.tangential_stiffness = _stiffness(config, indentation)
    out.tangential_displacement[:] = math.nan
    if indentation > 0.0:
        stiffness = out.tangential_stiffness
        _displace(config, state, max(dt, 0.0), stiffness, state.fast.value[1:])
        out.tangential_displacement[:] = state.displaced


@njit(cache=True)
def see_stick(state, stamp, stick, sd):
    """A stick ratio seen at a stamp; whether it told something."""
    count = min(state.next, REMEMBERED)
    for back in range(count):
        at = (state.next - 1 - back) % REMEMBERED
        if state.past_stamp[at] <= stamp:
            ratio = state.past_ratio[at]
            if not ratio > 0.03:
                return False
            if ratio > state.frames_ratio + NEXT_RATIO:
                state.frames, state.frames_ratio = 0, ratio
            state.frames += 1
            if state.frames > FRAMES:
                return False
            spread = math.hypot(sd, 0.04)
            state.known.told = True
            for g in range(GRID):
                z = (_curve(ratio / math.exp(LOG_FRICTION[g])) - stick) / spread
                state.known.log_weight[g] += FRAME_SHARE * math.log(math.exp(-0.5 * z * z) + 1e-3)
            return True
    return False


@njit(cache=True)
def follow_many(
    config, state, stamps, normal, lateral, touching, doubted, indentation, moisture, out
):
    """Many samples: arrays (n,) of what `follow` takes, lateral (n, 2)."""
    for i in range(len(stamps)):
        follow(
            config[0],
            state[0],
            stamps[i],
            normal[i],
            lateral[i, 0],
            lateral[i, 1],
            touching[i],
            doubted[i],
            indentation[i],
            moisture[i],
            out[i],
        )


@njit(cache=True)
def pull_along(config, time, normal, area, indentation, tangential, friction, table):
    """Stick ratio, slip margin and displacement (m), rows (n, 3) of `table`, at a known friction.

    config: finger of CONFIGURATION; time (n,) in s, normal, tangential (n,) in N, area (n,) in m²,
    indentation (n,) in m. Rows without contact stay.
    """
    state = np.zeros(1, STATE)[0]
    slid = False
    pull = np.zeros(2)
    for i in range(len(normal)):
        load = friction * normal[i]
        if not (area[i] > 0.0 and load > 0.0):
            state.force[:, :] = 0.0
            state.moved[:] = 0.0
            state.displaced[:] = state.crept[:] = 0.0
            slid = False
            continue
        pull[0] = tangential[i]
        table[i, 0] = _pull(state, load, pull[0], 0.0)
        table[i, 1] = max(0.0, 1.0 - abs(pull[0]) / load)
        slid = slid or abs(pull[0]) >= load
        if not slid and indentation[i] > 0.0:
            stiffness = _stiffness(config, indentation[i])
            _displace(config, state, time[i] - time[max(i - 1, 0)], stiffness, pull)
            table[i, 2] = state.displaced[0]
