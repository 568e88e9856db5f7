# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled: noise of a force, by what is rough of its samples.

A sensor that is read more often than it measures repeats its samples, which show no noise.
"""

from __future__ import annotations

import numpy as np

from .compiled import njit

NOISE_MEMORY = 1.0
"""s for which noise is remembered."""
LONGEST_PERIOD, LATE = 0.07, 1.5
"""s between the measurements of a sensor, up to which it is looked for samples that it repeats, and
periods after which a sample that is still the same was measured anew."""

MEASURED = np.dtype(
    [
        ("sample", "f8", (3,)),  # N, the newest force
        ("since", "i8"),  # ns, stamp from which on it is this
        ("lasted", "f8", (2,)),  # s for which the two samples before were the same
        ("stamp", "i8"),  # ns, of the newest sample that was measured anew
    ]
)
"""State that detects repeated samples."""


@njit(cache=True)
def take_sample(measured, stamp, normal, q0, q1):
    """Take a sample (N) at a stamp (ns); whether it was measured anew, and is not repeated."""
    sample, lasted = measured.sample, measured.lasted
    same_for = (stamp - measured.since) * 1e-9
    if normal != sample[0] or q0 != sample[1] or q1 != sample[2]:
        sample[0], sample[1], sample[2] = normal, q0, q1
        lasted[1], lasted[0] = lasted[0], same_for
        measured.since = stamp
    else:
        period = min(lasted[0], lasted[1])
        if period < LONGEST_PERIOD and 0.0 <= same_for < LATE * period:
            return False
    measured.stamp = stamp
    return True


@njit(cache=True)
def roughness(force, last, before):
    """Variance (N²) of a sample, by the second difference of three."""
    return (force - 2.0 * last + before) ** 2 / 6.0


@njit(cache=True)
def no_knock(rough, variance, least):
    """Clip the squared second difference `rough` (N²), so that a knock does not count as noise.

    variance: noise found so far (N²); least: least noise of a sensor (N²).
    """
    return min(rough, 16.0 * max(variance, least))


@njit(cache=True)
def averaged(variance, time, rough, least, dt):
    """Mean variance (N²), and the time (s) it is of, with a sample dt (s) after the one before.

    least: as of `no_knock`.
    """
    time = min(time + dt, NOISE_MEMORY)
    return variance + (no_knock(rough, variance, least) - variance) * dt / time, time
