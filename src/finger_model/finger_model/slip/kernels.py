# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled core of the slip estimator: many samples in one call.

Filtered `forces` tell a ratio r = |Q|/P, `forecasts` whether it stands still. Then it is a
`plateau`, and `windows` tell slip from holding. `friction` learns from plateaus, from the largest
ratio carried and from a camera; `elements` give the stick ratio at its mean.
"""

from __future__ import annotations

import math

import numpy as np

from finger_common.flags import SlipFlag

from .. import force_noise
from ..compiled import njit
from ..estimator.delayed import REMEMBERED
from ..sensor_air import SILENCE
from . import elements, forces, forecasts, friction, plateau

NO_CONTACT, SLIPPING, ASSUMED, INVALID = (int(flag) for flag in SlipFlag)

TURNED = 0.85
"""Share of the largest ratio of a pull below which it counts as reversed."""
DIP, DIP_NOISE = 0.1, 6.0
"""Of P, and of its noise: how far P must fall before it is said to grow again. Else every swing of
a load that is held would count."""
FRAMES, NEXT_RATIO = 20, 0.05
"""Frames of a pull that count until r has grown by NEXT_RATIO: more of them err as these do."""
SMALLEST_FORCE = 0.05
"""N; below it ratios are not judged."""
CLEAR_PULL = 20.0
"""|Q| over its noise from which its direction is clear."""
UNSURE = 0.1
"""Error of the zero of Q over μP from which friction counts as assumed."""
TEACHING_FORCE = 0.2
"""N; below it a ratio carried teaches no friction: what the tare left may be all of it."""

CONFIGURATION = np.dtype(
    [
        ("finger", elements.FINGER),
        ("prior", friction.PRIOR),
        ("drift", "f8"),  # of ln μ, from contact to contact
        ("horizon", "f8"),  # s
        ("noise", "f8"),  # N
        ("coupled", "?"),  # a controller lets P follow Q
    ]
)
PULL = np.dtype(
    [
        ("largest", "f8"),  # ratio
        ("turned", "?"),  # r has fallen since the pull began: s(r) does not hold
        ("counted", "?"),  # its slip
        ("frames", "i8"),  # stick ratios seen since r was `frames_ratio`
        ("frames_ratio", "f8"),
    ],
    align=True,
)
MEMORY = np.dtype(
    [
        ("next", "i8"),  # samples written so far
        ("stamp", "i8", (REMEMBERED,)),  # ns
        ("beyond", "f8", (REMEMBERED,)),  # |Q − c|/P, NaN where s(r) does not hold
        ("with_load", "f8", (REMEMBERED,)),  # |c|/P
    ]
)
"""Ring of past samples."""
STATE = np.dtype(
    [
        ("touching", "?"),
        ("doubted", "?"),  # the newest force of this contact is hardly a finger's
        ("stamp", "i8"),  # ns
        ("measured", force_noise.MEASURED),
        ("forces", forces.FORCES),
        ("forecasts", forecasts.FORECASTS),
        ("plateau", plateau.PLATEAU),
        ("pull", PULL),
        ("friction", friction.FRICTION),
        ("elements", elements.ELEMENTS),
        ("memory", MEMORY),
    ],
    align=True,
)


@njit(cache=True)
def _begin_contact(config, state, stamp, normal, q0, q1):
    state.touching = True
    friction.begin_contact(state.friction)
    forces.begin(state.forces, config.noise, stamp, normal, q0, q1)
    forecasts.begin(state.forecasts)
    elements.begin(state.elements, normal, q0, q1)
    state.plateau.least = math.inf
    pull = state.pull
    pull.largest = pull.frames_ratio = 0.0
    pull.turned = pull.counted = False
    pull.frames = 0


@njit(cache=True)
def _learn(state):
    """Keep what the plateau that ends has told."""
    known = state.friction.known
    probability = friction.learn(state.friction, state.plateau)
    if probability > 0.5 and not state.pull.counted:
        state.pull.counted = True
        friction.count_slip(known, plateau.mean_log_ratio(state.plateau), probability)


@njit(cache=True)
def _end_contact(config, state, stamp):
    """What was learned from a force that was hardly a finger's is forgotten."""
    if state.doubted:
        friction.forget_contact(state.friction)
    elif plateau.lasts(state.plateau, stamp):
        _learn(state)
    state.plateau.present = False
    friction.end_contact(state.friction, config.prior, config.drift)
    elements.release(state.elements)
    state.touching = False


@njit(cache=True)
def _judge_ratio(config, state, stamp):
    """What the present ratio r, which is returned, tells of friction and of the pull."""
    tracked, pull = state.forces, state.pull
    ratio, slow = forces.ratio_of(tracked.fast), forces.ratio_of(tracked.slow)
    load = tracked.fast.value[0]
    forces.see_knock(tracked, stamp)
    if forces.calm(tracked, stamp) and not forces.lets_go(tracked):
        # Noise of the force is no pull.
        carried = min(ratio, slow) - 2.0 * math.hypot(tracked.noise, tracked.zero_error) / load
        if load >= TEACHING_FORCE:
            friction.carry(state.friction, carried, config.drift)
        pull.largest = max(pull.largest, carried)
    if ratio < TURNED * pull.largest - 0.02:
        pull.turned = True
    if ratio < 0.5 * pull.largest and not state.plateau.present:
        pull.counted = False
        pull.frames, pull.frames_ratio = 0, 0.0
    if plateau.judge(state.plateau, state.forecasts, tracked, config.coupled, stamp):
        _learn(state)
    return ratio


@njit(cache=True)
def _remember(memory, stamp, beyond, with_load):
    at = memory.next % REMEMBERED
    memory.stamp[at] = stamp
    memory.beyond[at], memory.with_load[at] = beyond, with_load
    memory.next += 1


@njit(cache=True)
def _ahead(tracked, horizon, ratio, stands):
    """Largest r from now to the horizon (s), and the spread of its logarithm."""
    now = tracked.fast
    p = max(now.value[0] + horizon * now.rate[0], 1e-3)
    q0 = now.value[1] + horizon * now.rate[1]
    q1 = now.value[2] + horizon * now.rate[2]
    ahead = ratio if stands else max(math.hypot(q0, q1) / p, ratio)
    error = math.hypot(tracked.filtered_noise, tracked.zero_error)
    return ahead, math.hypot(friction.EDGE, error / max(ahead * p, 1e-3))


@njit(cache=True)
def _say_nothing(out, probability):
    """All NaN but what is known anyway and this probability of slip."""
    out.stick_ratio = out.stick_ratio_stddev = math.nan
    out.slip_margin = out.slip_margin_stddev = math.nan
    out.slip_probability = probability
    out.tangential_displacement[0] = out.tangential_displacement[1] = math.nan
    out.tangential_stiffness = math.nan


@njit(cache=True)
def follow(config, state, stamp, normal, q0, q1, touching, doubted, indentation, moisture, out):
    """One sample: stamp (ns), P and Q (N), whether in contact and whether that is doubted,
    indentation (m), moisture (a.u.)."""
    known = state.friction.known
    out.stamp_ns = stamp
    out.normal_force = normal
    out.tangential_force[0], out.tangential_force[1] = q0, q1
    if not math.isfinite(normal + q0 + q1):
        _say_nothing(out, math.nan)
        out.friction, out.friction_stddev = state.friction.mean, state.friction.stddev
        out.slips = known.slips
        out.flags = INVALID | (0 if known.shown else ASSUMED)
        return
    if not known.told and moisture != state.friction.moisture and math.isfinite(moisture):
        friction.set_prior(config.prior, state.friction, moisture)
    dt, step = (stamp - state.stamp) * 1e-9, (stamp - state.measured.stamp) * 1e-9
    anew = force_noise.measured_anew(state.measured, stamp, normal, q0, q1)
    if dt > SILENCE:
        if state.touching:
            _end_contact(config, state, state.stamp)
        forces.forget_air(state.forces)
    if touching:
        if not state.touching:
            forces.set_zero(state.forces)
        q0 -= state.forces.zero[0]
        q1 -= state.forces.zero[1]
    if touching and not state.touching:
        _begin_contact(config, state, stamp, normal, q0, q1)
        dt = 0.0
    elif state.touching and not touching:
        _end_contact(config, state, stamp)
        forces.leave(state.forces, stamp)
    elif not touching:
        if anew:
            forces.see_air(state.forces, config.noise, stamp, step, q0, q1)
    elif dt > 0.0:
        if anew and step > 0.0:
            forces.add(state.forces, config.noise, step, normal, q0, q1)
        friction.pass_time(state.friction, config.drift, dt)
    if touching:
        state.doubted = doubted
    state.stamp = stamp
    out.slips = known.slips
    out.flags = 0 if known.shown else ASSUMED
    now = state.forces.fast.value
    judged = touching and normal >= SMALLEST_FORCE and now[0] >= SMALLEST_FORCE
    ratio, beyond, with_load = 0.0, math.nan, 0.0
    if judged:
        u0, u1 = forces.direction(state.forces.fast)
        clear = forces.tangential(state.forces.fast) > CLEAR_PULL * state.forces.filtered_noise
        friction.look(state.friction, u0, u1, clear)
        ratio = _judge_ratio(config, state, stamp) if anew else forces.ratio_of(state.forces.fast)
        smooth = state.forces.slow.value
        margin = max(DIP * now[0], DIP_NOISE * state.forces.filtered_noise)
        mean = state.friction.limit  # of the sample before
        if elements.press(state.elements, mean, smooth[0], margin, smooth[1], smooth[2]):
            state.pull.turned = True
        beyond, with_load = elements.shares(state.elements, now[0], now[1], now[2])
    _remember(state.memory, stamp, math.nan if state.pull.turned else beyond, with_load)
    stands = plateau.lasts(state.plateau, stamp)
    ahead, spread = 0.0, 1.0
    if judged:
        ahead, spread = _ahead(state.forces, config.horizon, ratio, stands)
    friction.renew_aim(state.friction)
    slipping, first_stick, stick_spread = friction.weigh(
        state.friction,
        config.drift,
        state.plateau,
        stands,
        judged,
        ratio,
        beyond,
        with_load,
        ahead,
        spread,
        out,
    )
    mean = state.friction.limit
    if not judged:
        _say_nothing(out, 0.0)
        out.flags |= NO_CONTACT
        if touching:
            elements.begin(state.elements, normal, q0, q1)
        return
    if slipping:
        out.flags |= SLIPPING
    stick = elements.pull(state.elements, mean * now[0], now[1], now[2])
    if not state.pull.turned and not slipping:
        # A first pull: the mean over frictions, which the elements follow at the mean one only.
        stick = first_stick
    out.stick_ratio = 0.0 if slipping else stick
    out.stick_ratio_stddev = math.hypot(stick_spread, 0.03)
    if slipping:
        out.slip_margin = 0.0
    used = ratio / mean * friction.EDGE
    error = math.hypot(state.forces.filtered_noise, state.forces.zero_error) / (mean * now[0])
    out.slip_margin_stddev = math.hypot(out.slip_margin_stddev, math.hypot(used, error))
    unsure = state.forces.zero_error > UNSURE * mean * now[0]
    if doubted or unsure or not forces.noise_known(state.forces):
        out.flags |= ASSUMED
    if doubted:
        # The tare may be all of P and Q.
        out.stick_ratio_stddev = max(out.stick_ratio_stddev, 1.0)
        out.slip_margin_stddev = max(out.slip_margin_stddev, 1.0)
    stiffness = elements.sudden_stiffness(config.finger, indentation)
    out.tangential_stiffness = stiffness
    out.tangential_displacement[:] = math.nan
    if indentation > 0.0:
        elements.displace(config.finger, state.elements, max(dt, 0.0), stiffness, now[1:])
        out.tangential_displacement[:] = state.elements.displaced


@njit(cache=True)
def see_stick(state, stamp, stick, sd):
    """A stick ratio seen at a stamp; whether it told something."""
    memory, pull = state.memory, state.pull
    for back in range(min(memory.next, REMEMBERED)):
        at = (memory.next - 1 - back) % REMEMBERED
        if memory.stamp[at] <= stamp:
            beyond, with_load = memory.beyond[at], memory.with_load[at]
            if not beyond > 0.03:
                return False
            if beyond > pull.frames_ratio + NEXT_RATIO:
                pull.frames, pull.frames_ratio = 0, beyond
            pull.frames += 1
            if pull.frames > FRAMES:
                return False
            friction.see_stick(state.friction, beyond, with_load, stick, sd)
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
def pull_along(finger, state, time, normal, area, indentation, tangential, friction, table):
    """Stick ratio, slip margin and displacement (m), rows (n, 3) of `table`, at a known friction.

    finger, state: records of FINGER and, all zeros, of ELEMENTS; time (n,) in s, normal,
    tangential (n,) in N, area (n,) in m², indentation (n,) in m. Rows without contact stay.
    """
    slid = False
    pull = np.zeros(2)
    for i in range(len(normal)):
        load = friction * normal[i]
        if not (area[i] > 0.0 and load > 0.0):
            elements.release(state)
            slid = False
            continue
        pull[0] = tangential[i]
        elements.press(state, friction, normal[i], 0.0, pull[0], 0.0)
        table[i, 0] = elements.pull(state, load, pull[0], 0.0)
        table[i, 1] = max(0.0, 1.0 - abs(pull[0]) / load)
        slid = slid or abs(pull[0]) >= load
        if not slid and indentation[i] > 0.0:
            stiffness = elements.sudden_stiffness(finger, indentation[i])
            dt = time[i] - time[max(i - 1, 0)]
            elements.displace(finger, state, dt, stiffness, pull)
            table[i, 2] = state.displaced[0]
