# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled: sensitivities of the reduced model to its finger, by finite differences.

Beside the model of the finger that the estimator believes in runs one perturbed copy for each
direction

    stiffness   all moduli
    time        all relaxation times
    creep       what relaxes over what does not, (G0 − G∞)/G∞, at the same long-term modulus,
                creep times and E2/E0

of the tissue, in logarithms. A copy is a set of constants of the same kernels: the networks see
E2/E0 alone, so that none of the directions needs them to be prepared again. Copies take turns, one
per sample at 500 Hz: a sensitivity changes slowly, and each of its terms is as old for the copy as
for the finger.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from ..reduced import kernels as rk

DIRECTION_NAMES = ("stiffness", "time", "creep")
DIRECTIONS = len(DIRECTION_NAMES)
PERTURBATIONS = (0.25, 0.5, -0.3)
"""Of the copies along their directions. Creep steps down: soft skin lies at the range's end."""
SHIFT_LIMITS = (1.2, 2.0, 1.2)
"""Largest shift along each direction."""
MOST_CREEP = 11.0
"""Largest (G0 − G∞)/G∞ that models are made for."""

MAX_LAG_NS = 5_000_000
"""ns by which a copy may be behind before it is advanced beside another one."""

SENSITIVITIES = np.dtype(
    [
        ("stamp", "i8", (DIRECTIONS,)),  # ns, of each copy
        ("shift", "f8", (DIRECTIONS,)),  # w₀ of the finger itself
        ("area", "f8", (DIRECTIONS,)),  # ∂ln A/∂w
        ("indentation", "f8", (DIRECTIONS,)),  # ∂ln δ/∂w
    ],
    align=True,
)


@njit(cache=True)
def _deform(base, par, shift):
    """Constants `par` of the finger `base` shifted by (3,) along the directions."""
    total = 0.0
    for b in range(base.branches):
        total += base.fraction[b]
    rest = max(1.0 - total, 1e-6)
    before = total / rest
    creep = min(before * math.exp(shift[2]), max(before, MOST_CREEP))
    share = min(1.0 / (1.0 + creep), rk.MOST_SHARE)
    for b in range(base.branches):
        par.fraction[b] = base.fraction[b] * (1.0 - share) / total if total > 0.0 else 0.0
        par.tau[b] = base.tau[b] * math.exp(shift[1]) * share / rest
    par.share = share
    par.force_scale = base.force_scale * math.exp(shift[0]) * rest / share


@njit(cache=True)
def set_constants(model, sensitivities):
    """Constants (4,) of the finger and its copies at sensitivities.shift, from those of `base`.

    They hold copies of `base`, or what was set before, whose fractions the states (4,) are of: the
    strain of each branch stays.
    """
    shift = np.empty(DIRECTIONS)
    for j in range(1 + DIRECTIONS):
        for i in range(DIRECTIONS):
            shift[i] = sensitivities.shift[i] + (PERTURBATIONS[i] if j == 1 + i else 0.0)
        one = slice(j, j + 1)
        before = model.constants[j].fraction.copy()
        _deform(model.base[0], model.constants[j], shift)
        rk.scale_branches(model.constants[one], model.states[one], before)
        rk.refresh(model.networks, model.constants[one], model.states[one], model.work)


@njit(cache=True)
def set_constants_1(model, sensitivities):
    """As `set_constants`, with sensitivities an array of one record."""
    set_constants(model, sensitivities[0])


@njit(cache=True)
def set_shift_1(sensitivities, mean):
    """As `set_shift`, with sensitivities an array of one record."""
    set_shift(sensitivities[0], mean)


@njit(cache=True)
def set_shift(sensitivities, mean):
    """Set the shift to w (3,), within its limits."""
    for i in range(DIRECTIONS):
        sensitivities.shift[i] = min(max(mean[i], -SHIFT_LIMITS[i]), SHIFT_LIMITS[i])


@njit(cache=True)
def update_sensitivity(states, sensitivities, j):
    """Sensitivities of direction j from the present states, if both could be followed to here."""
    here, there = states[0], states[1 + j]
    if here.failed or there.failed:
        return
    if here.area > 0.0 and there.area > 0.0:
        sensitivities.area[j] = math.log(there.area / here.area) / PERTURBATIONS[j]
    if here.indentation > 0.0 and there.indentation > 0.0:
        sensitivities.indentation[j] = (
            math.log(there.indentation / here.indentation) / PERTURBATIONS[j]
        )


@njit(cache=True)
def _step(model, j, dt, force):
    """Advance one by dt (s) to `force` (N): 0 the finger, 1 + i its copy of direction i."""
    one = slice(j, j + 1)
    constants, states = model.constants[one], model.states[one]
    rk.step_without_slope(model.networks, constants, states, model.work, dt, force)


@njit(cache=True)
def advance_perturbed(model, sensitivities, stamp, force, every):
    """Bring the copy most behind to `stamp`, and others behind by MAX_LAG_NS, or `every` one."""
    for turn in range(DIRECTIONS):
        oldest = 0
        for j in range(1, DIRECTIONS):
            if sensitivities.stamp[j] < sensitivities.stamp[oldest]:
                oldest = j
        behind = stamp - sensitivities.stamp[oldest]
        if behind <= 0 or (turn > 0 and behind <= MAX_LAG_NS and not every):
            break
        j = oldest
        _step(model, j + 1, behind * 1e-9, force)
        sensitivities.stamp[j] = stamp
        update_sensitivity(model.states, sensitivities, j)


@njit(cache=True)
def evaluate(model, sensitivities, force):
    """Outputs and sensitivities at `force` (N) after `set_constants`; no time passes."""
    for j in range(1 + DIRECTIONS):
        one = slice(j, j + 1)
        rk.step(model.networks, model.constants[one], model.states[one], model.work, 0.0, force)
    for j in range(DIRECTIONS):
        update_sensitivity(model.states, sensitivities, j)


@njit(cache=True)
def reset(model):
    """Put the finger and its copies at rest."""
    for j in range(1 + DIRECTIONS):
        one = slice(j, j + 1)
        rk.rest(model.networks, model.constants[one], model.states[one], model.work)


@njit(cache=True, nogil=True)
def simulate(model, sensitivities, before, time, force, table):
    """Area (m²), indentation (m), peak pressure (Pa) and both sensitivities (n, 9) along a future.

    All copies go along with the finger from `before` (s); time (n,) in s, force (n,) in N;
    sensitivities (1,): scratch. Returns the first row that the finger could not follow, n without
    one.
    """
    first = len(time)
    for i in range(len(time)):
        for j in range(1 + DIRECTIONS):
            _step(model, j, time[i] - before, force[i])
        if model.states[0].failed:
            first = min(first, i)
        before = time[i]
        table[i, 0] = model.states[0].area
        table[i, 1] = model.states[0].indentation
        table[i, 2] = model.states[0].peak_pressure
        for j in range(DIRECTIONS):
            update_sensitivity(model.states, sensitivities[0], j)
            table[i, 3 + j] = sensitivities[0].area[j]
            table[i, 3 + DIRECTIONS + j] = sensitivities[0].indentation[j]
    return first
