# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled: forces that jump away and come back within LONGEST, as where a sensor or its line errs.

One such sample alone is left out. It may also be the first of a real jump. So from the second one
in a row the filters follow, but nothing is learned. Where the forces jump back, filters and
elements go on from before; where they do not, the jump was real. P and Q may jump each for itself:
the other one is real.
"""

from __future__ import annotations

import numpy as np

from ..compiled import njit
from . import elements, forces

LONGEST = 0.05
"""s after which a jump is real and a contact without force is over. Shorter contacts tell nothing,
and in the first LONGEST of a contact every jump is believed."""
FAR = 8.0
"""Least size of a jump over the noise of a sample; over P it is KNOCK times the time between
samples."""

NORMAL, LATERAL = (0, 1), (1, 3)
"""Components of P and of Q in a TRACK."""

SPIKE = np.dtype(
    [
        ("believed", "i8"),  # ns, newest sample that is no spike's
        ("jump", "f8", (3,)),  # N, its first sample less what was foretold; 0: there is none
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
        ("knocked", "i8"),  # ns
        ("elements", elements.ELEMENTS),
        ("ended", "?"),  # a spike was followed, and is over
    ],
    align=True,
)


@njit(cache=True)
def _believe(spike, stamp):
    spike.believed = stamp
    spike.jump[:] = 0.0
    spike.followed = False


@njit(cache=True)
def begin(spikes, stamp):
    """A contact begins at this stamp (ns)."""
    _believe(spikes.normal, stamp)
    _believe(spikes.lateral, stamp)
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
        spikes.turned, spikes.knocked = state.pull.turned, tracked.knocked
        elements.copy(state.elements, spikes.elements)


@njit(cache=True)
def _square(part, values):
    """Square of the part of a force (3,)."""
    total = 0.0
    for i in range(part[0], part[1]):
        total += values[i] ** 2
    return total


@njit(cache=True)
def _take_part(state, spike, part, stamp, step, values):
    """As `take`, P or Q alone; the time (s) since the filters took it before, 0 where it tells
    nothing."""
    tracked = state.forces
    since = max((stamp - spike.believed) * 1e-9, step)
    if spike.followed and since >= LONGEST:  # it was real
        _believe(spike, stamp - np.int64(round(1e9 * step)))
        since = step
    dt = step if spike.followed else since
    before = spike.fast if spike.followed else tracked.fast
    off = values - before.value - dt * before.rate
    reach = max(FAR * tracked.noise, forces.KNOCK * step * before.value[0])
    ended, first = spike.followed, not spike.jump.any()
    if _square(part, off) > reach * reach:
        left = values - tracked.fast.value - dt * tracked.fast.rate + spike.jump
        ended = spike.followed and _square(part, left) < 0.25 * _square(part, spike.jump)
        longest = LONGEST + step if first else LONGEST
        if not ended and since < longest and state.friction.contact_time >= LONGEST:
            if first:
                spike.jump[:] = off
            else:
                _follow(state, spike)
                forces.follow(tracked, part, dt, values)
                forces.see_knock(tracked, stamp)
            return 0.0
    if ended:
        state.spikes.ended = True
        for i in range(part[0], part[1]):
            tracked.fast.value[i] = tracked.slow.value[i] = values[i]
            tracked.fast.rate[i], tracked.slow.rate[i] = spike.fast.rate[i], spike.slow.rate[i]
    forces.follow(tracked, part, dt, values)
    _believe(spike, stamp)
    return dt


@njit(cache=True)
def take(state, noise, stamp, step, normal, q0, q1):
    """Let the filters take a sample (N) of a contact, step (s) after the one before; whether it
    tells something. noise (N): that of the settings."""
    spikes, values = state.spikes, np.array((normal, q0, q1))
    of_normal = _take_part(state, spikes.normal, NORMAL, stamp, step, values)
    of_lateral = _take_part(state, spikes.lateral, LATERAL, stamp, step, values)
    if of_lateral > 0.0:
        forces.see_noise(state.forces, noise, of_lateral, q0, q1)
    if of_normal == 0.0 or of_lateral == 0.0:
        return False
    if spikes.ended:
        state.pull.turned, state.forces.knocked = spikes.turned, spikes.knocked
        elements.copy(spikes.elements, state.elements)
    spikes.followed = spikes.ended = False
    return True
