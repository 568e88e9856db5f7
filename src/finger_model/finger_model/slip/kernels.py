# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled core of the slip estimator: many samples in one call.

Filtered `forces`, without `spikes`, tell a ratio r = |Q|/P, `forecasts` whether it stands still.
Then it is a `plateau`, and `windows` tell slip from holding. `friction` learns from plateaus, from
the largest ratio held and from a camera; `elements` give the stick ratio at its mean.
"""

from __future__ import annotations

import math

import numpy as np

from finger_common.flags import SlipFlag

from .. import force_noise
from ..compiled import njit
from ..delayed import REMEMBERED
from ..sensor_air import SILENCE
from . import elements, forces, forecasts, friction, plateau, spikes

NO_CONTACT = int(SlipFlag.NO_CONTACT)
SLIPPING = int(SlipFlag.SLIPPING)
ASSUMED = int(SlipFlag.FRICTION_ASSUMED)
INVALID = int(SlipFlag.FORCE_INVALID)

TURNED = 0.85
"""Share of the largest ratio of a pull below which it counts as reversed."""
DIP, DIP_NOISE = 0.1, 6.0
"""Of P, and of its noise: how far P must fall before it is said to grow again. Else every swing of
a load that is held would count."""
UNSEEN = 0.05
"""|Q − c|/P up to which no skin slips: a camera that follows it from there on misses nothing."""
FRAMES, NEXT_RATIO = 20, 0.05
"""Frames of a pull that count until r has grown by NEXT_RATIO: more of them err as these do."""
SMALLEST_FORCE = 0.05
"""N; below it ratios are not judged."""
CLEAR_PULL = 20.0
"""|Q| over its noise from which its direction is clear."""
UNSURE = 0.1
"""Error of the zero of Q over μP from which friction counts as assumed."""
TEACHING_FORCE = 0.2
"""N; below it a ratio held teaches no friction: what the tare left may be all of it."""

SAMPLE = np.dtype(
    [
        ("stamp", "i8"),  # ns
        ("normal", "f8"),  # N, P
        ("lateral", "f8", (2,)),  # N, Q
        ("touching", "?"),
        ("doubted", "?"),  # the force is hardly a finger's
        ("indentation", "f8"),  # m
        ("moisture", "f8"),  # a.u., NaN where it is not known
    ],
    align=True,
)
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
        ("unseen", "?"),  # under load the camera followed no skin: what slipped then is not known
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
        ("touched", "i8"),  # ns, newest sample in contact
        ("lifted", "?"),  # the sample before had no contact
        ("measured", force_noise.MEASURED),
        ("spikes", spikes.SPIKES),
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
    spikes.begin(state.spikes, stamp, np.array((normal, q0, q1)))
    forecasts.begin(state.forecasts)
    elements.begin(state.elements, normal, q0, q1)
    plateau.begin_contact(state.plateau)
    pull = state.pull
    pull.largest = pull.frames_ratio = 0.0
    pull.turned = pull.counted = pull.unseen = False
    pull.frames = 0


@njit(cache=True)
def _use_plateau(state):
    """Update friction and slips from the plateau that ends."""
    probability = friction.update_from_plateau(state.friction, state.plateau)
    if probability > 0.5 and not state.pull.counted:
        state.pull.counted = True
        log_ratio = plateau.mean_log_ratio(state.plateau)
        friction.count_slip(state.friction.belief, log_ratio, probability)


@njit(cache=True)
def _end_contact(config, state):
    """What was learned from a force that was hardly a finger's is forgotten."""
    brief = state.friction.contact_time < spikes.LONGEST
    if state.doubted or brief:
        friction.forget_contact(state.friction)
    elif plateau.lasts(state.plateau, state.touched):
        _use_plateau(state)
    state.plateau.present = False
    if not brief:
        friction.end_contact(state.friction, config.prior, config.drift)
    forces.leave(state.forces, state.touched)
    elements.release(state.elements)
    state.touching = False


@njit(cache=True)
def _judge_ratio(config, state, stamp):
    """What the present ratio r tells of friction and of the pull."""
    tracked, pull = state.forces, state.pull
    ratio, slow = forces.ratio_of(tracked.fast), forces.ratio_of(tracked.slow)
    load = tracked.fast.value[0]
    forces.see_knock(tracked, stamp)
    if forces.calm(tracked, stamp) and not forces.is_releasing(tracked):
        # Noise of the force is no pull.
        held = min(ratio, slow) - 2.0 * math.hypot(tracked.noise, tracked.zero_error) / load
        if load >= TEACHING_FORCE:
            friction.raise_lower_bound(state.friction, held, config.drift)
        pull.largest = max(pull.largest, held)
    if ratio < TURNED * pull.largest - 0.02:
        pull.turned = True
    if ratio < 0.5 * pull.largest and not state.plateau.present:
        pull.counted = False
        pull.frames, pull.frames_ratio = 0, 0.0
    if plateau.judge(state.plateau, state.forecasts, tracked, config.coupled, stamp):
        _use_plateau(state)


@njit(cache=True)
def _remember(memory, stamp, beyond, with_load):
    at = memory.next % REMEMBERED
    memory.stamp[at] = stamp
    memory.beyond[at], memory.with_load[at] = beyond, with_load
    memory.next += 1


@njit(cache=True)
def _ahead(tracked, horizon, ratio, stands):
    """Largest r from now to the horizon (s), and the spread of its logarithm. stands: r does."""
    now = tracked.fast
    # A pull that is held has little margin, perhaps: noise of the rates must not use it up.
    rate = tracked.slow.rate if stands else now.rate
    p = max(now.value[0] + horizon * rate[0], 1e-3)
    q = math.hypot(now.value[1] + horizon * rate[1], now.value[2] + horizon * rate[2])
    if stands:
        q = min(q, forces.tangential(now))
    ahead = max(q / p, ratio)
    error = math.hypot(tracked.filtered_noise, tracked.zero_error)
    return ahead, math.hypot(friction.EDGE, error / max(ahead * p, 1e-3))


@njit(cache=True)
def _write_nothing(out, probability):
    """All NaN but what is known anyway and this probability of slip."""
    out.stick_ratio = out.stick_ratio_stddev = math.nan
    out.slip_margin = out.slip_margin_stddev = math.nan
    out.slip_probability = probability
    out.tangential_displacement[0] = out.tangential_displacement[1] = math.nan
    out.tangential_stiffness = math.nan


@njit(cache=True)
def _write_slips(state, out):
    """What the belief tells of slips so far."""
    out.slips = state.friction.belief.slips
    out.flags = 0 if state.friction.belief.slip_confirmed else ASSUMED


@njit(cache=True)
def _write_invalid(state, out):
    """The row of a sample whose force is not finite."""
    _write_nothing(out, math.nan)
    _write_slips(state, out)
    out.friction, out.friction_stddev = state.friction.mean, state.friction.stddev
    out.flags |= INVALID


@njit(cache=True)
def _pull_of(state, sample):
    """Q (N) of a sample in contact, without the sensor's zero."""
    zero = state.forces.zero
    return sample.lateral[0] - zero[0], sample.lateral[1] - zero[1]


@njit(cache=True)
def _track_contact(config, state, sample, dt, step, anew):
    """Begin, continue or end the contact; the time (s) by which it has become older, and whether
    the sample tells something.

    dt, step: s since the newest sample, and since the newest one that was measured anew; anew:
    whether this one was.
    """
    tracked, older, tells = state.forces, 0.0, anew
    if dt > SILENCE:
        if state.touching:
            _end_contact(config, state)
        forces.forget_air(tracked)
    if sample.touching and state.lifted:
        state.lifted = False
        q0, q1 = _pull_of(state, sample)
        if state.touching and not spikes.goes_on(state, sample.stamp, sample.normal, q0, q1):
            _end_contact(config, state)
    if sample.touching:
        if not state.touching:
            forces.set_zero(tracked)
            q0, q1 = _pull_of(state, sample)
            _begin_contact(config, state, sample.stamp, sample.normal, q0, q1)
        elif dt > 0.0:
            if anew and step > 0.0:
                q0, q1 = _pull_of(state, sample)
                tells = spikes.take(state, config.noise, sample.stamp, step, sample.normal, q0, q1)
            friction.predict(state.friction, config.drift, dt)
            older = dt
        state.doubted = sample.doubted
        state.touched = sample.stamp
    else:
        state.lifted = True
        if state.touching and (sample.stamp - state.touched) * 1e-9 >= spikes.LONGEST:
            _end_contact(config, state)
    if not state.touching and anew:
        q0, q1 = sample.lateral[0], sample.lateral[1]
        forces.see_air(tracked, config.noise, sample.stamp, step, q0, q1)
    state.stamp = sample.stamp
    return older, tells


@njit(cache=True)
def _judge_pull(config, state, sample, tells):
    """Learn from the present ratio, where it tells something, and remember it; the PullNow."""
    tracked, now = state.forces, state.forces.fast.value
    judged = sample.touching and sample.normal >= SMALLEST_FORCE and now[0] >= SMALLEST_FORCE
    ratio, beyond, with_load = 0.0, math.nan, 0.0
    if judged:
        u0, u1 = forces.direction(tracked.fast)
        clear = forces.tangential(tracked.fast) > CLEAR_PULL * tracked.filtered_noise
        friction.set_direction(state.friction, u0, u1, clear)
        ratio = forces.ratio_of(tracked.fast)
        if tells:
            _judge_ratio(config, state, sample.stamp)
        smooth = tracked.slow.value
        margin = max(DIP * now[0], DIP_NOISE * tracked.filtered_noise)
        mean = state.friction.limit  # of the sample before
        if elements.press(state.elements, mean, smooth[0], margin, smooth[1], smooth[2]):
            state.pull.turned = True
        beyond, with_load = elements.shares(state.elements, now[0], now[1], now[2])
    unknown = state.pull.turned or state.spikes.followed
    _remember(state.memory, sample.stamp, math.nan if unknown else beyond, with_load)
    stands = plateau.lasts(state.plateau, sample.stamp)
    ahead, spread = 0.0, 1.0
    if judged:
        ahead, spread = _ahead(tracked, config.horizon, ratio, stands)
    return friction.PullNow(stands, judged, ratio, beyond, with_load, ahead, spread)


@njit(cache=True)
def _write_pull(config, state, sample, ratio, slipping, dt, out):
    """Complete the row of a sample whose ratio is judged: `friction.evaluate` has begun it.

    dt: s by which the contact has become older.
    """
    tracked, now = state.forces, state.forces.fast.value
    load = state.friction.limit * now[0]  # N, at which it slips
    stick = elements.pull(state.elements, load, now[1], now[2])
    if slipping:
        out.flags |= SLIPPING
        out.stick_ratio = out.slip_margin = 0.0
    elif state.pull.turned:
        # The mean over frictions is that of a first pull; the elements follow at the mean friction.
        out.stick_ratio = stick
    out.stick_ratio_stddev = math.hypot(out.stick_ratio_stddev, 0.03)
    used = ratio / state.friction.limit * friction.EDGE
    error = math.hypot(tracked.filtered_noise, tracked.zero_error) / load
    out.slip_margin_stddev = math.hypot(out.slip_margin_stddev, math.hypot(used, error))
    unsure = tracked.zero_error > UNSURE * state.friction.limit * now[0]
    if sample.doubted or unsure or not forces.noise_known(tracked):
        out.flags |= ASSUMED
    if sample.doubted:
        # The tare may be all of P and Q.
        out.stick_ratio_stddev = max(out.stick_ratio_stddev, 1.0)
        out.slip_margin_stddev = max(out.slip_margin_stddev, 1.0)
    stiffness, share = elements.stiffness(config.finger, sample.indentation, now[0])
    out.tangential_stiffness = stiffness
    out.tangential_displacement[:] = math.nan
    if sample.indentation > 0.0:
        elements.displace(config.finger, state.elements, dt, stiffness, share, now[1:])
        out.tangential_displacement[:] = state.elements.displaced


@njit(cache=True)
def process_sample(config, state, sample, out):
    """One record of SAMPLE to one of OUTPUT."""
    stamp, normal, moisture = sample.stamp, sample.normal, sample.moisture
    q0, q1 = sample.lateral[0], sample.lateral[1]
    out.stamp_ns, out.normal_force = stamp, normal
    out.tangential_force[0], out.tangential_force[1] = q0, q1
    if not math.isfinite(normal + q0 + q1):
        _write_invalid(state, out)
        return
    changed = moisture != state.friction.moisture and math.isfinite(moisture)
    if changed and not state.friction.belief.has_evidence:
        friction.set_prior(config.prior, state.friction, moisture)
    dt, step = (stamp - state.stamp) * 1e-9, (stamp - state.measured.stamp) * 1e-9
    anew = force_noise.take_sample(state.measured, stamp, normal, q0, q1)
    dt, tells = _track_contact(config, state, sample, dt, step, anew)
    _write_slips(state, out)
    now = _judge_pull(config, state, sample, tells)
    friction.refresh_directional(state.friction)
    slipping = friction.evaluate(state.friction, config.drift, state.plateau, now, out)
    if now.judged:
        _write_pull(config, state, sample, now.ratio, slipping, dt, out)
        return
    _write_nothing(out, 0.0)
    out.flags |= NO_CONTACT
    if sample.doubted:
        out.flags |= ASSUMED
    if sample.touching and tells:
        q0, q1 = _pull_of(state, sample)
        elements.begin(state.elements, normal, q0, q1)


@njit(cache=True)
def _remembered(memory, stamp):
    """Place of the newest sample up to a stamp (ns), -1 where none is remembered."""
    for back in range(min(memory.next, REMEMBERED)):
        at = (memory.next - 1 - back) % REMEMBERED
        if memory.stamp[at] <= stamp:
            return at
    return -1


@njit(cache=True)
def update_from_stick_ratio(state, stamp, stick, sd):
    """Update from a stick ratio ± sd that was seen at a stamp (ns); whether it told something."""
    memory, pull = state.memory, state.pull
    at = _remembered(memory, stamp)
    if at < 0 or not memory.beyond[at] > 0.03:
        return False
    beyond, with_load = memory.beyond[at], memory.with_load[at]
    if beyond > pull.frames_ratio + NEXT_RATIO:
        pull.frames, pull.frames_ratio = 0, beyond
    pull.frames += 1
    if pull.frames > FRAMES:
        return False
    friction.update_from_stick_ratio(state.friction, beyond, with_load, stick, sd, pull.unseen)
    return True


@njit(cache=True)
def lose_sight(state, stamp):
    """A picture of this stamp (ns) in which no skin was followed: from then on a stick ratio counts
    only what slips later."""
    at = _remembered(state.memory, stamp)
    if at >= 0 and state.memory.beyond[at] > UNSEEN:
        state.pull.unseen = True


@njit(cache=True)
def process_samples(config, state, samples, out):
    """Records (n,) of SAMPLE to records (n,) of OUTPUT; config, state (1,)."""
    for i in range(len(samples)):
        process_sample(config[0], state[0], samples[i], out[i])


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
            stiffness, share = elements.stiffness(finger, indentation[i], normal[i])
            dt = time[i] - time[max(i - 1, 0)]
            elements.displace(finger, state, dt, stiffness, share, pull)
            table[i, 2] = state.displaced[0]
