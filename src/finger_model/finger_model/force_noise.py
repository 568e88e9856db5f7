# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled: noise of a force, by what is rough of its samples."""

from __future__ import annotations

from .compiled import njit

LONGEST_STEP, NOISE_MEMORY = 0.005, 1.0
"""s between samples up to which what is rough of a force is noise, and how long it is remembered.
"""


@njit(cache=True)
def roughness(force, last, before):
    """Variance (N²) of a sample, by the second difference of three."""
    return (force - 2.0 * last + before) ** 2 / 6.0


@njit(cache=True)
def no_knock(rough, variance, least):
    """`rough` (N²) as far as it is noise: a sample far beyond the others, of which the variance was
    found so far, is a knock. least: N², below which no noise is."""
    return min(rough, 16.0 * max(variance, least))


@njit(cache=True)
def averaged(variance, time, rough, least, dt):
    """Mean variance (N²), and the time (s) it is of, with a sample dt (s) after the one before.

    least: as of `no_knock`.
    """
    time = min(time + dt, NOISE_MEMORY)
    return variance + (no_knock(rough, variance, least) - variance) * dt / time, time
