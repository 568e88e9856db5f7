# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled core of the slip estimator.

**Friction** is a distribution over a grid of ln μ: a prior, widened a little at every contact;
nothing below the largest ratio r = |Q|/P that was carried (a soft edge); and two kinds of evidence:

- *A plateau of r.* The ratio stands still: the skin slips, so r = μ, or a pull is held, at any r
  below μ. Forecasts over LAG tell that r stands still. Windows of it tell slip, Q = r P all the
  time or where r is largest, from holding, where Q goes its own smooth way, whatever P does. The
  likelihood of a friction is a mixture of both.
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
CLOSE, ROUGH_MEMORY = 0.005, 1.0
"""s between samples up to which what is rough of Q is noise, and how long it is remembered."""
STILL, GONE = -1.0, -3.0
"""Log of the odds of slip and holding against pulling above which r stands still, and below which
it does so no more."""
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
WINDOW, LEAST = 32, 8
"""Newest samples of a plateau, EVERY apart, in which Q is explained by P or by itself, and the
least number of them."""
SCATTER, RATIO_DRIFT = 0.003, 0.02
"""Of Q from sample to sample, over Q, and of ln r over a window in slip: friction is not
constant."""
COURSES = np.array([0.0, 0.2, 0.1, 0.05])
"""Of Q over Q, by degree: how much of a polynomial in time a pull or load may have in a window; the
higher degrees less in a shorter one."""
CLIPPED, LEAST_CLIPPED, CLIP_COST = 0.985, 3, 4.0
"""Share of the largest r from which samples may be those that slip, their least number, and the log
of the odds against slip that comes and goes."""
COURSE_COST = 0.7
"""Log of the odds of a constant against a line, and so on."""
EARLIER = 0.5
"""Share of what the windows before tell that is kept."""
GROWN = 1.3
"""By which r must have grown in a contact before it can be slip: a force that is oblique from the
first touch on, or a sensor that is not level, has Q in proportion to P too."""
HOLD_DENSITY = 0.6
"""Of ln r of a held plateau, below μ: what is held is chosen by who holds it, not by friction."""
ANOTHER = 0.01
"""Probability that the next contact is with another surface, of which only the prior is known."""
KNOCK, KNOCKED = 40.0, 0.08
"""1/s, rate of Q over P of a knock, not a pull, and s after it in which ratios tell nothing."""
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
        ("coupled", "?"),  # a controller lets P follow Q
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
        ("slip_odds", "f8"),  # log, of slip against holding, in the newest window
        ("window", "f8", (WINDOW, 2)),  # P, Q of a plateau
        ("seen", "i8"),
        ("earlier_odds", "f8"),  # of slip, of windows before
        ("noise", "f8"),  # N, of a sample of Q
        ("filtered_noise", "f8"),  # N, of `fast`
        ("rough_time", "f8"),  # s, over which it was averaged
        ("roughness", "f8"),  # N², of Q as measured: the noise that its samples show
        ("last", "f8", (2, 2)),  # N, Q of the two samples before
        ("knocked", "i8"),  # ns, when Q last jumped
        ("least", "f8"),  # ratio in this contact
        ("turned", "?"),  # r has fallen since the pull began: s(r) does not hold
        ("pull_largest", "f8"),
        ("plateau", "?"),
        ("plateau_begin", "i8"),
        ("plateau_count", "f8"),
        ("plateau_sum", "f8"),  # of ln r
        ("plateau_odds", "f8"),  # largest log of the odds of slip in it
        ("past_odds", "f8", (LAGS,)),  # the same, LAGS × EVERY ago and since
        ("letting_go", "?"),
        ("kept_odds", "f8"),  # the same, before the finger began to let go
        ("kept_ratio", "f8"),  # ln r of the plateau then
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
def _prior(config, moisture):
    """Log weights (GRID,) of a moisture (a.u., NaN where it is not known)."""
    shift = 0.0
    if math.isfinite(moisture):
        shift = config.moisture_slope * (moisture - NATURAL_MOISTURE)
        shift = min(max(shift, -LARGEST_SHIFT), LARGEST_SHIFT)
    z = (LOG_FRICTION - config.prior_mean - shift) / config.prior_sd
    return -0.5 * z * z


@njit(cache=True)
def set_prior(config, state, moisture):
    """Forget all evidence: the prior of a moisture (a.u., NaN where it is not known) alone."""
    state.moisture = moisture
    state.known.log_weight[:] = _prior(config, moisture)
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
def _see_noise(config, state, dt, q0, q1):
    """Noise of Q, that of the settings or more where its samples show more, and that of `fast`."""
    rough = (q0 - 2.0 * state.last[0, 0] + state.last[1, 0]) ** 2
    rough = 0.5 * (rough + (q1 - 2.0 * state.last[0, 1] + state.last[1, 1]) ** 2) / 6.0
    state.last[1] = state.last[0]
    state.last[0, 0], state.last[0, 1] = q0, q1
    state.noise = config.noise
    if dt <= CLOSE:
        # A knock is not noise.
        rough = min(rough, 16.0 * max(state.roughness, config.noise * config.noise))
        state.rough_time = min(state.rough_time + dt, ROUGH_MEMORY)
        state.roughness += (rough - state.roughness) * dt / state.rough_time
        state.noise = max(config.noise, math.sqrt(state.roughness))
    beta = math.exp(-dt / FAST)
    state.filtered_noise = state.noise * math.sqrt(
        (1.0 - beta) * (1.0 + 4.0 * beta + 5.0 * beta * beta) / (1.0 + beta) ** 3
    )


@njit(cache=True)
def _ratio(track):
    """r = |Q|/P of a track."""
    return math.hypot(track.value[1], track.value[2]) / max(track.value[0], 1e-6)


@njit(cache=True)
def _cell(log_friction):
    """Index of the nearest of LOG_FRICTION."""
    step = (LOG_FRICTION[-1] - LOG_FRICTION[0]) / (GRID - 1)
    return min(max(round((log_friction - LOG_FRICTION[0]) / step), 0), GRID - 1)


@njit(cache=True)
def _slip_share(state):
    """Probability, before friction is asked, that the plateau is slip."""
    if state.plateau_sum / state.plateau_count < math.log(max(GROWN * state.least, 1e-6)):
        return 0.0
    return 1.0 / (1.0 + math.exp(-min(max(SLIP_ODDS + state.plateau_odds, -30.0), 30.0)))


@njit(cache=True)
def _is_news(state, log_ratio):
    """Whether the plateau tells of friction what none before it did. A thing that is held again, or
    whose load dips and returns, stands still at the same ratio."""
    at = _cell(log_ratio)
    known = state.known.unclear[max(at - NEAR, 0) : at + NEAR + 1].max() > 0
    return state.plateau_odds >= CLEAR_SLIP or not known


@njit(cache=True)
def _plateau_likelihood(share, log_ratio, log_friction):
    """Likelihood of the plateau under a friction, and the part of it that is slip."""
    z = (log_ratio - log_friction) / EDGE
    slip = share * math.exp(-0.5 * z * z) / (EDGE * 2.5066282746)
    hold = (1.0 - share) * HOLD_DENSITY * _normal(-z)
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
        likelihood, slip = _plateau_likelihood(share, log_ratio, LOG_FRICTION[g])
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
    weight /= weight.sum()
    prior = np.exp(_prior(config, state.moisture))
    prior /= prior.sum()
    for g in range(GRID):
        total, norm = 0.0, 0.0
        for k in range(max(g - reach, 0), min(g + reach + 1, GRID)):
            share = math.exp(-0.5 * ((k - g) / max(width, 1e-3)) ** 2)
            total += share * weight[k]
            norm += share
        state.known.log_weight[g] = math.log((1.0 - ANOTHER) * total / norm + ANOTHER * prior[g])
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
def _back(state, stamp):
    """How many comparisons back the newest forecast is that is old enough."""
    back = 1
    while back < LAGS and stamp * 1e-9 - state.forecast[(state.forecasts - back) % LAGS][0] < OLD:
        back += 1
    return back


@njit(cache=True)
def _compare(state, stamp):
    """Compare what was forecast LAG ago with what came."""
    p = state.fast.value[0]
    q = math.hypot(state.fast.value[1], state.fast.value[2])
    slow = math.hypot(state.slow.value[1], state.slow.value[2])
    rise = 0.0
    if slow > 1e-9:
        rise = state.slow.value[1] * state.slow.rate[1] + state.slow.value[2] * state.slow.rate[2]
        rise /= slow
    back = _back(state, stamp)
    if state.forecasts >= back:
        past = state.forecast[(state.forecasts - back) % LAGS]
        lag = stamp * 1e-9 - past[0]
        if 0.5 * LAG < lag < 2.0 * LAG:
            # Noise of the filtered forces, and what a slip's friction and a pull's rate vary.
            noise = state.filtered_noise * state.filtered_noise
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
    now = state.forecast[state.forecasts % LAGS]
    now[0], now[1], now[2], now[3] = stamp * 1e-9, q / max(p, 1e-6), q, rise
    state.forecasts += 1


@njit(cache=True)
def _own_way(values, used, noise, coupled):
    """Log likelihood of the used ones of values (n,) of this variance under the best polynomial in
    time of degree 0 to 3, its level free, its other coefficients of the sizes in COURSES; and how
    far below it the others lie on average."""
    n, count = len(values), used.sum()
    basis = np.empty((4, n))
    rest = values.copy()
    size = np.sum(values * used) / count
    cost, best, below = 0.0, -math.inf, 0.0
    for k in range(4):
        for i in range(n):
            basis[k, i] = 1.0 if k == 0 else basis[k - 1, i] * (2.0 * i / (n - 1.0) - 1.0)
        for j in range(k):
            basis[k] -= np.sum(used * basis[k] * basis[j]) * basis[j]
        length = np.sum(used * basis[k] * basis[k])
        basis[k] /= math.sqrt(length)
        found = np.sum(used * rest * basis[k])
        rest -= found * basis[k]
        if k > 0 and not coupled:
            spread = (COURSES[k] * (n / WINDOW) ** (k - 1) * size) ** 2 * length
            cost += 0.5 * math.log(1.0 + spread / noise) + 0.5 * found * found / (noise + spread)
        left = np.sum(used * rest * rest)
        likelihood = -0.5 * left / noise - cost - (0.0 if coupled else COURSE_COST * k)
        if likelihood > best:
            best = likelihood
            below = -np.sum((1.0 - used) * rest) / max(n - count, 1.0)
    return best, below


@njit(cache=True)
def _by_friction(normal, pull, noise, noise_of_ratio):
    """Log likelihood of Q = P (r + r' τ), r' drawn to zero by RATIO_DRIFT; ln r at the end."""
    n = len(normal)
    tau = np.linspace(-1.0, 1.0, n)
    a, b = np.sum(normal * normal), np.sum(normal * normal * tau)
    c = np.sum(normal * normal * tau * tau)
    d, e = np.sum(normal * pull), np.sum(normal * pull * tau)
    ratio = d / a
    of_force = noise + (noise_of_ratio * ratio) ** 2
    drawn = of_force / (0.5 * RATIO_DRIFT * ratio) ** 2
    det = a * (c + drawn) - b * b
    ratio, slope = ((c + drawn) * d - b * e) / det, (a * e - b * d) / det
    left = np.sum((pull - normal * (ratio + slope * tau)) ** 2) + drawn * slope * slope
    found = -0.5 * left / of_force - 0.5 * n * math.log(of_force / noise)
    return found - 0.5 * math.log(1.0 + c / drawn), math.log(max(ratio + slope, 1e-6))


@njit(cache=True)
def _window_odds(config, state, n):
    """Log of the odds that P explains Q in the newest n samples of the plateau, all of them (slip)
    or those of the largest r (slip now and then), against Q going its own smooth way, whatever P
    does; and ln r of the slip."""
    normal, pull = np.empty(n), np.empty(n)
    for i in range(n):
        normal[i], pull[i] = state.window[(state.seen - n + i) % WINDOW]
    noise = state.filtered_noise * state.filtered_noise + SCATTER * SCATTER * np.mean(pull * pull)
    own, _ = _own_way(pull, np.ones(n), noise, config.coupled)
    slip, log_ratio = _by_friction(normal, pull, noise, state.filtered_noise)
    ratios = pull / np.maximum(normal, 1e-6)
    held = np.where(ratios < CLIPPED * ratios.max(), 1.0, 0.0)
    slips = n - int(held.sum())
    inside = held[0] + held[n - 1] == 2.0
    if inside and LEAST_CLIPPED <= slips <= n - LEAST:
        clipped, below = _own_way(pull, held, noise, config.coupled)
        # Chance makes r large where Q is above its own way; slip keeps Q below it.
        if below > 3.0 * math.sqrt(noise / slips):
            slides = held == 0.0
            by_force, at = _by_friction(normal[slides], pull[slides], noise, state.filtered_noise)
            if clipped + by_force - CLIP_COST > slip:
                slip, log_ratio = clipped + by_force - CLIP_COST, at
    if min(-slip, -own) > 0.5 * n:
        # More noise than is said: the better one shows how much.
        scale = 2.0 * min(-slip, -own) / n
        return (slip - own) / scale, log_ratio
    return slip - own, log_ratio


@njit(cache=True)
def _look_for_slip(config, state, q, log_ratio, judged):
    """Keep the newest sample of a plateau and, where it may be judged, the odds of slip."""
    newest = state.window[state.seen % WINDOW]
    newest[0] = state.fast.value[0]
    newest[1] = q
    state.seen += 1
    if state.seen >= LEAST and judged:
        # What has just begun to slip was held in the longer window: each second one is short.
        n = WINDOW // 2 if state.seen % 2 else WINDOW
        odds, slipped = _window_odds(config, state, min(state.seen, n))
        if odds > 0.0:
            log_ratio = slipped
        state.slip_odds = state.earlier_odds + odds
        state.plateau_looks += 1
        if state.seen % WINDOW == 0:
            # What was held before may slip now.
            state.earlier_odds = max(EARLIER * state.slip_odds, 0.0)
    # Where it is looked for slip often enough, chance shows it: each window costs.
    odds = state.slip_odds - math.log(1.0 + state.plateau_looks / LEAST)
    # The ratio of the time in which it looked most like slip.
    if odds > state.plateau_odds + 0.5:
        keep = 0.5 if state.plateau_odds > 0.0 else 0.0
        state.plateau_sum *= keep
        state.plateau_count *= keep
    if odds > state.plateau_odds - 0.5 or state.plateau_count == 0.0:
        state.plateau_sum += log_ratio
        state.plateau_count += 1.0
    if state.plateau_looks <= 1:
        state.plateau_odds = odds
    state.plateau_odds = max(state.plateau_odds, odds)
    state.past_odds[state.forecasts % LAGS] = state.plateau_odds


@njit(cache=True)
def _judge_plateau(config, state, stamp, ratio):
    """Whether r stands still, and since when."""
    if (stamp - state.judged_at) * 1e-9 < EVERY:
        return
    state.judged_at = stamp
    _compare(state, stamp)
    q = math.hypot(state.fast.value[1], state.fast.value[2])
    log_ratio = math.log(max(ratio, 1e-6))
    if state.fast.value[0] > 20.0 * state.noise:
        noise = state.filtered_noise / state.fast.value[0]
        state.least = min(state.least, ratio + 2.0 * noise)
    still = (
        state.odds > (GONE if state.plateau else STILL) and ratio > 0.05 and q > 6.0 * state.noise
    )
    still = still and state.forecasts > 2 * LAGS
    still = still and (stamp - state.knocked) * 1e-9 > KNOCKED
    letting_go = state.fast.rate[0] < -LETTING_GO * state.fast.value[0]
    if letting_go and not state.letting_go:
        state.kept_odds = state.past_odds[(state.forecasts - _back(state, stamp)) % LAGS]
        state.kept_ratio = state.plateau_sum / max(state.plateau_count, 1.0)
    state.letting_go = letting_go
    begun = state.plateau_sum / max(state.plateau_count, 1.0)
    if letting_go:
        begun = state.kept_ratio
        still = still and state.plateau
    away = abs(log_ratio - begun) - state.filtered_noise / max(q, 1e-6)
    if state.plateau and (letting_go or _slip_share(state) > 0.5):
        # What slips leaves its ratio when it is caught, what is held when it is put down.
        still = still and away < 2.0 * EDGE
    if state.plateau and not still:
        if letting_go and away > EDGE:
            # Its beginning looked like slip: both forces began to fall.
            state.plateau_odds = min(state.plateau_odds, state.kept_odds)
        if (stamp - state.plateau_begin) * 1e-9 >= PLATEAU_AFTER:
            _commit(state, _slip_share(state))
        state.plateau = False
    elif still and not state.plateau:
        state.plateau = True
        state.plateau_begin = stamp
        state.plateau_count = 0.0
        state.plateau_sum = 0.0
        state.plateau_odds = state.slip_odds = state.earlier_odds = 0.0
        state.past_odds[:] = 0.0
        state.plateau_looks = state.seen = 0
    if state.plateau:
        _look_for_slip(config, state, q, log_ratio, not letting_go or away < EDGE)


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
def _begin_contact(config, state, stamp, normal, q0, q1):
    state.touching = True
    _copy(state.known, state.before)
    for i in range(3):
        value = normal if i == 0 else (q0 if i == 1 else q1)
        state.fast.value[i] = state.slow.value[i] = value
        state.fast.rate[i] = state.slow.rate[i] = 0.0
    state.last[:, 0], state.last[:, 1] = q0, q1
    state.noise, state.filtered_noise = config.noise, 0.6 * config.noise
    state.pull_largest, state.least = 0.0, math.inf
    state.turned = state.counted = False
    state.frames, state.frames_ratio = 0, 0.0
    state.forecasts = 0
    state.odds, state.slip_odds = -3.0, 0.0
    state.knocked = stamp - np.int64(1e9)


@njit(cache=True)
def _judge_ratio(config, state, stamp):
    """What the present ratio r, which is returned, tells of friction and of the pull."""
    ratio, slow = _ratio(state.fast), _ratio(state.slow)
    load = state.fast.value[0]
    if math.hypot(state.fast.rate[1], state.fast.rate[2]) > KNOCK * load:
        state.knocked = stamp
    if (stamp - state.knocked) * 1e-9 > KNOCKED:
        # Noise of the force is no pull.
        held = min(ratio, slow) - 2.0 * state.noise / load
        if load >= TEACHING_FORCE:
            state.largest = max(state.largest, held)
        state.pull_largest = max(state.pull_largest, held)
    if ratio < TURNED * state.pull_largest - 0.02:
        state.turned = True
    if ratio < 0.5 * state.pull_largest and not state.plateau:
        state.counted = False
        state.frames, state.frames_ratio = 0, 0.0
    _judge_plateau(config, state, stamp, slow)
    return ratio


@njit(cache=True)
def _weigh(config, state, stamp, judged, ratio, out):
    """Friction, and the probability of slip, by all weights; whether it slips, the mean stick ratio
    of a first pull, and its standard deviation."""
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
        ahead = ratio if plateau else max(math.hypot(a0, a1) / p, ratio)
        spread = math.hypot(EDGE, state.filtered_noise / max(ahead * p, 1e-3))
    total, mean, square, slip_total, probability = 0.0, 0.0, 0.0, 0.0, 0.0
    stick_mean, stick_square = 0.0, 0.0
    log_ahead = math.log(max(ahead, 1e-6))
    for g in range(GRID):
        x = LOG_FRICTION[g]
        weight = math.exp(log_weight[g] - top)
        slip = 0.0
        if plateau:
            likelihood, slip_part = _plateau_likelihood(share, log_ratio, x)
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
    out.slip_probability = min(probability / total, 1.0)
    stick_mean /= total
    spread = math.sqrt(max(stick_square / total - stick_mean * stick_mean, 0.0))
    return slip_total > 0.5 * total, stick_mean, spread


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
        _begin_contact(config, state, stamp, normal, q0, q1)
        dt = 0.0
    elif state.touching and not touching:
        _end_contact(config, state, stamp)
    elif touching and dt > 0.0:
        values = (normal, q0, q1)
        _see_noise(config, state, dt, q0, q1)
        _track(state.fast, FAST, dt, values)
        _track(state.slow, SLOW, dt, values)
    if touching:
        state.doubted = doubted
    state.stamp = stamp
    out.slips = state.known.slips
    out.flags = ASSUMED if state.known.slips == 0 else 0
    judged = touching and normal >= SMALLEST_FORCE and state.fast.value[0] >= SMALLEST_FORCE
    ratio = _judge_ratio(config, state, stamp) if judged else 0.0
    at = state.next % REMEMBERED
    state.past_stamp[at] = stamp
    state.past_ratio[at] = ratio if judged and not state.turned else math.nan
    state.next += 1
    slipping, first_stick, spread = _weigh(config, state, stamp, judged, ratio, out)
    mean = out.friction
    if not judged:
        _say_nothing(out)
        out.flags |= NO_CONTACT
        if touching:
            _pull(state, mean * max(normal, 1e-6), 0.0, 0.0)
        return
    if slipping:
        out.flags |= SLIPPING
    stick = _pull(state, mean * state.fast.value[0], state.fast.value[1], state.fast.value[2])
    if not state.turned and not slipping:
        # A first pull: the mean over frictions, which the elements follow at the mean one only.
        stick = first_stick
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
