# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled filters of the forces P and Q: present values and rates, noise, and knocks.

In the air Q is the sensor's zero: what the tare left, and what a gripper that moves brings. Its
mean over blocks of samples is taken off where it is clear; how the blocks scatter is its error.
"""

from __future__ import annotations

import math

import numpy as np

from .. import force_noise, sensor_air
from ..compiled import njit
from ..force_noise import NOISE_MEMORY
from ..sensor_air import BLOCK, BLOCKS, LEAST_BLOCKS

FAST, SLOW = 0.008, 0.03
"""s, time constants of the filters of the present forces and of their rates."""
LONGEST_STEP = 0.0125
"""s between samples up to which what is rough of Q is noise."""
KNOCK, KNOCKED = 40.0, 0.08
"""1/s, rate of Q over P of a knock, not a pull, and s after it in which ratios tell nothing."""
LETTING_GO = 3.0
"""1/s, fall of P over P from which a finger lets go: a Q that comes late makes a ratio too
large."""
LEAST_ROUGH = 10.0
"""Samples in the air that tell the noise."""
CLEAR_ZERO = 3.0
"""Mean over scatter of the blocks from which the mean is taken off."""

TARED = 0.05
"""N by which a block lies beside the mean of those before, at least, where the sensor was tared."""

_is_tared = njit(cache=True)(sensor_air.is_tared)

TRACK = np.dtype([("value", "f8", (3,)), ("rate", "f8", (3,))])
"""P, Qx, Qy."""
AIR = np.dtype(
    [
        ("begin", "i8"),  # ns, of this block
        ("sum", "f8", (2,)),  # N, Q of this block
        ("samples", "f8"),
        ("blocks", "f8"),  # so far
        ("mean", "f8", (2,)),  # N, of the blocks
        ("variance", "f8"),  # N², of a block
        ("jump", "f8"),  # N, to another zero that is not known yet
        ("rough_samples", "f8"),
        ("rough_variance", "f8"),  # N², of a sample
    ]
)
FORCES = np.dtype(
    [
        ("fast", TRACK),
        ("slow", TRACK),
        ("last", "f8", (2, 2)),  # N, Q of the two samples before
        ("last_normal", "f8", (2,)),  # N, P of the two samples before
        ("normal_variance", "f8"),  # N², of a sample of P, as the samples show it
        ("normal_time", "f8"),  # s, over which it was averaged
        ("normal_noise", "f8"),  # N, of a sample of P
        ("seen_variance", "f8"),  # N², of a sample of Q, as the samples show it
        ("seen_time", "f8"),  # s, over which it was averaged
        ("noise", "f8"),  # N, of a sample of Q
        ("filtered_noise", "f8"),  # N, of `fast`
        ("knocked", "i8"),  # ns, when Q last jumped
        ("air", AIR),
        ("zero", "f8", (2,)),  # N, of Q in this contact
        ("zero_error", "f8"),  # N
    ]
)


@njit(cache=True)
def begin(forces, noise, stamp, normal, q0, q1):
    """First sample of a contact, Q less its zero; the noise (N) is that of the settings."""
    for i in range(3):
        value = normal if i == 0 else (q0 if i == 1 else q1)
        forces.fast.value[i] = forces.slow.value[i] = value
        forces.fast.rate[i] = forces.slow.rate[i] = 0.0
    forces.last[:, 0], forces.last[:, 1] = q0, q1
    forces.last_normal[:] = normal
    forces.noise, forces.filtered_noise = noise, 0.6 * noise
    forces.knocked = stamp - np.int64(1e9)


@njit(cache=True)
def copy(track, to):
    """Copy one record to another."""
    to.value[:] = track.value
    to.rate[:] = track.rate


@njit(cache=True)
def _track(track, part, tau, dt, values):
    """Critically damped filter of value and rate (fading memory of degree 1)."""
    beta = math.exp(-dt / tau)
    for i in range(part[0], part[1]):
        ahead = track.value[i] + track.rate[i] * dt
        miss = values[i] - ahead
        track.value[i] = ahead + (1.0 - beta * beta) * miss
        track.rate[i] += (1.0 - beta) ** 2 / dt * miss


@njit(cache=True)
def _take_rough(forces, q0, q1):
    """Take a sample of Q into `last`; what it shows of its variance (N²)."""
    last = forces.last
    rough = force_noise.roughness(q0, last[0, 0], last[1, 0])
    rough = 0.5 * (rough + force_noise.roughness(q1, last[0, 1], last[1, 1]))
    last[1] = last[0]
    last[0, 0], last[0, 1] = q0, q1
    return rough


@njit(cache=True)
def see_normal_noise(forces, noise, dt, normal):
    """Noise of P, that of the settings or more where its samples show more: also of a grip that
    trembles."""
    last = forces.last_normal
    rough = force_noise.roughness(normal, last[0], last[1])
    last[1], last[0] = last[0], normal
    if dt <= LONGEST_STEP:
        forces.normal_variance, forces.normal_time = force_noise.averaged(
            forces.normal_variance, forces.normal_time, rough, noise * noise, dt
        )
    forces.normal_noise = max(noise, math.sqrt(forces.normal_variance))


@njit(cache=True)
def see_noise(forces, noise, dt, q0, q1):
    """Noise of Q, that of the settings or more where its samples show more, and that of `fast`."""
    rough = _take_rough(forces, q0, q1)
    if dt <= LONGEST_STEP:
        forces.seen_variance, forces.seen_time = force_noise.averaged(
            forces.seen_variance, forces.seen_time, rough, noise * noise, dt
        )
        forces.noise = max(noise, math.sqrt(forces.seen_variance))
    else:
        forces.noise = max(noise, math.sqrt(forces.air.rough_variance))
    beta = math.exp(-dt / FAST)
    forces.filtered_noise = forces.noise * math.sqrt(
        (1.0 - beta) * (1.0 + 4.0 * beta + 5.0 * beta * beta) / (1.0 + beta) ** 3
    )


@njit(cache=True)
def leave(forces, stamp):
    """The contact has ended at this stamp."""
    air = forces.air
    air.begin = stamp + np.int64(1e9 * BLOCK)
    air.sum[:] = 0.0
    air.samples = 0.0


@njit(cache=True)
def forget_air(forces):
    """The sensor may have another zero from now on."""
    air = forces.air
    air.blocks = air.rough_samples = air.rough_variance = air.variance = air.jump = 0.0
    air.mean[:] = 0.0


@njit(cache=True)
def _middle(a, b, c):
    """Median of three: one of them may be wrong."""
    return max(min(a, b), min(max(a, b), c))


@njit(cache=True)
def see_air(forces, noise, stamp, dt, q0, q1):
    """A sample in the air, dt (s) after the one before."""
    air = forces.air
    if not 0.0 < dt < 2.0 * BLOCK:
        leave(forces, stamp)
    s0 = _middle(q0, forces.last[0, 0], forces.last[1, 0])
    s1 = _middle(q1, forces.last[0, 1], forces.last[1, 1])
    rough = _take_rough(forces, q0, q1)
    if stamp < air.begin:
        return
    air.rough_samples += 1.0
    share = max(1.0 / air.rough_samples, min(dt / NOISE_MEMORY, 0.1))
    rough = force_noise.no_knock(rough, air.rough_variance, noise * noise)
    air.rough_variance += share * (rough - air.rough_variance)
    air.sum[0] += s0
    air.sum[1] += s1
    air.samples += 1.0
    if (stamp - air.begin) * 1e-9 < BLOCK:
        return
    d0, d1 = air.sum[0] / air.samples - air.mean[0], air.sum[1] / air.samples - air.mean[1]
    jump = math.hypot(d0, d1)
    if _is_tared(air.blocks, jump, air.variance, TARED):
        air.blocks, air.jump = 0.0, jump  # this block may be of both
    else:
        if air.blocks == 0.0 and air.jump > 0.0:
            air.jump = max(air.jump, jump)
        air.blocks = min(air.blocks + 1.0, BLOCKS)
        share = 1.0 / air.blocks
        air.mean[0] += share * d0
        air.mean[1] += share * d1
        air.variance = (1.0 - share) * (air.variance + share * jump * jump)
    air.begin = stamp
    air.sum[:] = 0.0
    air.samples = 0.0


@njit(cache=True)
def set_zero(forces):
    """Let the zero of the contact that begins be what the air told."""
    air = forces.air
    forces.zero[:] = 0.0
    forces.zero_error = air.jump
    if air.blocks >= LEAST_BLOCKS:
        scatter, mean = math.sqrt(air.variance), math.hypot(air.mean[0], air.mean[1])
        if mean > CLEAR_ZERO * scatter:
            forces.zero[:] = air.mean
            forces.zero_error = scatter
        else:
            forces.zero_error = math.hypot(scatter, mean)


@njit(cache=True)
def noise_known(forces):
    """Whether samples, in this contact or in the air, have shown their noise."""
    return forces.seen_time >= BLOCK or forces.air.rough_samples >= LEAST_ROUGH


@njit(cache=True)
def follow(forces, part, dt, values):
    """Take these of the values (3,) of P, Qx, Qy (N), dt (s) after those before."""
    _track(forces.fast, part, FAST, dt, values)
    _track(forces.slow, part, SLOW, dt, values)


@njit(cache=True)
def tangential(track):
    """|Q| (N)."""
    return math.hypot(track.value[1], track.value[2])


@njit(cache=True)
def direction(track):
    """Of Q, a unit vector."""
    size = max(tangential(track), 1e-9)
    return track.value[1] / size, track.value[2] / size


@njit(cache=True)
def ratio_of(track):
    """r = |Q|/P."""
    return tangential(track) / max(track.value[0], 1e-6)


@njit(cache=True)
def is_releasing(forces):
    """True when P falls faster than LETTING_GO · P."""
    return forces.fast.rate[0] < -LETTING_GO * forces.fast.value[0]


@njit(cache=True)
def see_knock(forces, stamp):
    """Notice a knock at this stamp."""
    if math.hypot(forces.fast.rate[1], forces.fast.rate[2]) > KNOCK * forces.fast.value[0]:
        forces.knocked = stamp


@njit(cache=True)
def calm(forces, stamp):
    """Whether the last knock is over."""
    return (stamp - forces.knocked) * 1e-9 > KNOCKED
