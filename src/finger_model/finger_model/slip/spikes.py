# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled: forces that jump away and come back within LONGEST, as where a sensor or its line errs.

One such sample alone is left out. It may also be the first of a real jump. So from the second one
in a row the filters follow, but nothing is learned. Where the forces are on their old course again,
filters and elements go on from before; where they are not, the jump was real. P and Q may jump each
for itself: the other one is real. A contact whose force is gone for a moment goes on in the same
way, if it then has the forces that it had.
"""

from __future__ import annotations

import numpy as np

from ..compiled import njit
from . import elements, forces

LONGEST = 0.05
"""s after which a jump is real and a contact without force is over. Shorter contacts tell nothing,
and in the first LONGEST of a contact every jump is believed."""
FAR = 8.0
"""Least size of a jump over the noise of a sample of P or of Q; over P it is KNOCK times the time
between samples."""
ALIKE = 0.2
"""Over P, difference of P and of Q up to which a contact goes on whose force was gone."""

NORMAL, LATERAL = (0, 1), (1, 3)
"""Components of P and of Q in a TRACK."""

SPIKE = np.dtype(
    [
        ("believed", "i8"),  # ns, newest sample that is no spike's
        ("value", "f8", (3,)),  # N, that sample
        ("jumped", "?"),  # the sample after it
        ("followed", "?"),  # the filters follow what may be a spike; these are of before it:
        ("fast", forces.TRACK),
        ("slow", forces.TRACK),
    ],
    align=True,
)
"""Of P or of Q."""
SPIKES = np.dtype(
    [
        ("normal", SPIKE),
        ("lateral", SPIKE),
        ("followed", "?"),  # the filters follow what may be a spike; these are of before it:
        ("turned", "?"),  # the pull
        ("elements", elements.ELEMENTS),
        ("ended", "?"),  # a spike was followed, and is over
    ],
    align=True,
)


@njit(cache=True)
def _believe(spike, stamp):
    spike.believed = stamp
    spike.jumped = spike.followed = False


@njit(cache=True)
def begin(spikes, stamp, values):
    """A contact begins at this stamp (ns) with these P, Qx, Qy (3,) in N."""
    _believe(spikes.normal, stamp)
    _believe(spikes.lateral, stamp)
    spikes.normal.value[:] = spikes.lateral.value[:] = values
    spikes.followed = spikes.ended = False


@njit(cache=True)
def _follow(state, spike):
    """Keep what is now before the filters follow what may be a spike."""
    spikes, tracked = state.spikes, state.forces
    if not spike.followed:
        spike.followed = True
        forces.copy(tracked.fast, spike.fast)
        forces.copy(tracked.slow, spike.slow)
    if not spikes.followed:
        spikes.followed = True
        spikes.turned = state.pull.turned
        elements.copy(state.elements, spikes.elements)


@njit(cache=True)
def _square(part, values):
    """Square of the part of a force (3,)."""
    total = 0.0
    for i in range(part[0], part[1]):
        total += values[i] ** 2
    return total


@njit(cache=True)
def _take_part(state, spike, part, noise, stamp, step, values):
    """As `take`, P or Q alone, whose samples have this noise (N); the time (s) since the filters
    took it before, 0 where it tells nothing."""
    tracked = state.forces
    since = max((stamp - spike.believed) * 1e-9, step)
    if spike.followed and since >= LONGEST:  # it was real
        _believe(spike, stamp - np.int64(round(1e9 * step)))
        since = step
    dt = step if spike.followed else since
    before = spike.fast if spike.followed else tracked.fast
    off = values - before.value - dt * before.rate
    reach = max(FAR * noise, forces.KNOCK * step * before.value[0])
    # The filters lag behind a force that swings: it does not jump from sample to sample.
    sudden = spike.jumped or _square(part, values - spike.value) > reach * reach
    away = sudden and _square(part, off) > reach * reach
    longest = LONGEST if spike.jumped else LONGEST + step
    if away and since < longest and state.friction.contact_time >= LONGEST:
        if spike.jumped:
            _follow(state, spike)
            forces.follow(tracked, part, dt, values)
            forces.see_knock(tracked, stamp)
        spike.jumped = True
        return 0.0
    if spike.followed and not away:
        state.spikes.ended = True
        for i in range(part[0], part[1]):
            tracked.fast.value[i] = tracked.slow.value[i] = values[i]
            tracked.fast.rate[i], tracked.slow.rate[i] = spike.fast.rate[i], spike.slow.rate[i]
    forces.follow(tracked, part, dt, values)
    _believe(spike, stamp)
    spike.value[:] = values
    return dt


@njit(cache=True)
def take(state, noise, stamp, step, normal, q0, q1):
    """Let the filters take a sample (N) of a contact, step (s) after the one before; whether it
    tells something. noise (N): that of the settings."""
    spikes, tracked, values = state.spikes, state.forces, np.array((normal, q0, q1))
    forces.see_normal_noise(tracked, noise, step, normal)
    of_normal = _take_part(state, spikes.normal, NORMAL, tracked.normal_noise, stamp, step, values)
    of_lateral = _take_part(state, spikes.lateral, LATERAL, tracked.noise, stamp, step, values)
    if of_lateral > 0.0:
        forces.see_noise(tracked, noise, of_lateral, q0, q1)
    if of_normal == 0.0 or of_lateral == 0.0:
        return False
    if spikes.ended:
        state.pull.turned = spikes.turned
        elements.copy(spikes.elements, state.elements)
    spikes.followed = spikes.ended = False
    return True


@njit(cache=True)
def goes_on(state, stamp, normal, q0, q1):
    """Whether a contact whose force (N) is there again after a time without it is the same one."""
    gone = (stamp - state.touched) * 1e-9
    track = state.forces.fast
    off = np.array((normal, q0, q1)) - track.value - gone * track.rate
    most = max(FAR * state.forces.noise, ALIKE * track.value[0]) ** 2
    return gone < LONGEST and _square(NORMAL, off) < most and _square(LATERAL, off) < most
