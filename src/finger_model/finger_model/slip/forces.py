# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled filters of the forces P and Q: present values and rates, noise, and knocks."""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit

FAST, SLOW = 0.008, 0.03
"""s, time constants of the filters of the present forces and of their rates."""
LONGEST_STEP, NOISE_MEMORY = 0.005, 1.0
"""s between samples up to which what is rough of Q is noise, and how long it is remembered."""
KNOCK, KNOCKED = 40.0, 0.08
"""1/s, rate of Q over P of a knock, not a pull, and s after it in which ratios tell nothing."""

TRACK = np.dtype([("value", "f8", (3,)), ("rate", "f8", (3,))])
"""P, Qx, Qy."""
FORCES = np.dtype(
    [
        ("fast", TRACK),
        ("slow", TRACK),
        ("last", "f8", (2, 2)),  # N, Q of the two samples before
        ("seen_variance", "f8"),  # N², of a sample of Q, as the samples show it
        ("seen_time", "f8"),  # s, over which it was averaged
        ("noise", "f8"),  # N, of a sample of Q
        ("filtered_noise", "f8"),  # N, of `fast`
        ("knocked", "i8"),  # ns, when Q last jumped
    ]
)


@njit(cache=True)
def begin(forces, noise, stamp, normal, q0, q1):
    """First sample of a contact; the noise (N) is that of the settings."""
    for i in range(3):
        value = normal if i == 0 else (q0 if i == 1 else q1)
        forces.fast.value[i] = forces.slow.value[i] = value
        forces.fast.rate[i] = forces.slow.rate[i] = 0.0
    forces.last[:, 0], forces.last[:, 1] = q0, q1
    forces.noise, forces.filtered_noise = noise, 0.6 * noise
    forces.knocked = stamp - np.int64(1e9)


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
def _see_noise(forces, noise, dt, q0, q1):
    """Noise of Q, that of the settings or more where its samples show more, and that of `fast`."""
    last = forces.last
    rough = (q0 - 2.0 * last[0, 0] + last[1, 0]) ** 2
    rough = 0.5 * (rough + (q1 - 2.0 * last[0, 1] + last[1, 1]) ** 2) / 6.0
    last[1] = last[0]
    last[0, 0], last[0, 1] = q0, q1
    forces.noise = noise
    if dt <= LONGEST_STEP:
        # A knock is not noise.
        rough = min(rough, 16.0 * max(forces.seen_variance, noise * noise))
        forces.seen_time = min(forces.seen_time + dt, NOISE_MEMORY)
        forces.seen_variance += (rough - forces.seen_variance) * dt / forces.seen_time
        forces.noise = max(noise, math.sqrt(forces.seen_variance))
    beta = math.exp(-dt / FAST)
    forces.filtered_noise = forces.noise * math.sqrt(
        (1.0 - beta) * (1.0 + 4.0 * beta + 5.0 * beta * beta) / (1.0 + beta) ** 3
    )


@njit(cache=True)
def add(forces, noise, dt, normal, q0, q1):
    """A sample, dt (s) after the one before."""
    _see_noise(forces, noise, dt, q0, q1)
    values = (normal, q0, q1)
    _track(forces.fast, FAST, dt, values)
    _track(forces.slow, SLOW, dt, values)


@njit(cache=True)
def tangential(track):
    """|Q| (N)."""
    return math.hypot(track.value[1], track.value[2])


@njit(cache=True)
def ratio_of(track):
    """r = |Q|/P."""
    return tangential(track) / max(track.value[0], 1e-6)


@njit(cache=True)
def see_knock(forces, stamp):
    """Notice a knock at this stamp."""
    if math.hypot(forces.fast.rate[1], forces.fast.rate[2]) > KNOCK * forces.fast.value[0]:
        forces.knocked = stamp


@njit(cache=True)
def calm(forces, stamp):
    """Whether the last knock is over."""
    return (stamp - forces.knocked) * 1e-9 > KNOCKED
