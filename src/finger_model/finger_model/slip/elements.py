# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled mechanics of the contact at a friction that is given: elements, creep and stiffness.

Elements (see `backbone`) remember the history of P and Q and give the stick ratio; the tissue
behind them gives way at once, by the stiffness of `shear`, and creeps. What of Q came with P came
while the contact was smaller: it has moved the plate further than the present stiffness says.

What P brings when it grows sticks at first: where Q grows with it by less than μ, nothing slips
(R. D. Mindlin and H. Deresiewicz, J. Appl. Mech. 20:327–344, 1953). That part of Q, c, goes to all
elements in proportion to their limits, and uses up as much of each limit. So a first pull beyond it
follows the backbone at |Q − c|/(μP − |c|). Where P falls, c falls in the same proportion, but not
below what Q still has of it: an oblique press that is put down again sticks, too.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from ..laws.maxwell import step_weights
from . import backbone
from .shear import DEPTHS, SOFTENING

COUNT = 40
LIMITS = backbone.limits(COUNT)
CURVE = np.interp(np.linspace(0.0, 1.0, 101), *backbone.STICK_CURVE.T)
"""Stick ratio of a first pull at r = 0, 0.01 … 1."""

LITTLE = 0.1
"""Share of μP below which c changes little: noise of the forces brings some, too."""
COMPLIANCE = backbone.SLIP_COMPLIANCE
FIRST, FURTHEST = 1.1, 1.5
"""Displacement by c over that at the present stiffness, where a contact has just come, and at
most."""
MOST_TAKEN = 1.0
"""Largest exponent of what the load takes of the stiffness: beyond, nothing was compared."""
BRANCHES = 4
"""Most branches of the tissue."""
FIRST_DEPTH, NODES = math.log(DEPTHS[0]), len(DEPTHS)
DEPTH_STEP = math.log(DEPTHS[1] / DEPTHS[0])

FINGER = np.dtype(
    [
        ("length", "f8"),  # m, the pad's radial semi-axis
        ("shear", "f8", (NODES,)),  # N/m, without load, see `shear`
        ("fractions", "f8", (BRANCHES,)),  # of the tissue's branches, 0 where there is none
        ("times", "f8", (BRANCHES,)),  # s
    ]
)
ELEMENTS = np.dtype(
    [
        ("force", "f8", (COUNT, 2)),  # of each, over the share of one
        ("moved", "f8", (2,)),  # their displacement, N
        ("pull", "f8", (2,)),  # N, Q of the sample before
        ("reached", "f8"),  # N, P up to which c has been given
        ("with_load", "f8", (2,)),  # N, c
        ("placed", "f8", (2,)),  # N, the part of c that has moved the plate
        ("placed_by", "f8", (2,)),  # m, sudden displacement by c
        ("placed_at", "f8"),  # N/m, stiffness then; 0: none was yet
        ("displaced", "f8", (2,)),  # m, of the plate
        ("crept", "f8", (BRANCHES, 2)),  # m, displacement that each branch has come to
    ]
)
"""The elements and the tissue behind them."""


@njit(cache=True)
def first_pull(ratio):
    """Stick ratio of a first pull at r = |Q|/(μP)."""
    if ratio >= 1.0:
        return 0.0
    at = 100.0 * max(ratio, 0.0)
    low = min(int(at), 99)
    return CURVE[low] + (at - low) * (CURVE[low + 1] - CURVE[low])


@njit(cache=True)
def release(elements):
    """Contact ends: nothing of it is remembered."""
    elements.force[:, :] = 0.0
    elements.moved[:] = elements.pull[:] = elements.with_load[:] = 0.0
    elements.reached = 0.0
    elements.placed[:] = elements.placed_by[:] = 0.0
    elements.placed_at = 0.0
    elements.displaced[:] = elements.crept[:] = 0.0


@njit(cache=True)
def copy(elements, to):
    """Copy one record to another."""
    to.force[:, :] = elements.force
    to.moved[:] = elements.moved
    to.pull[:] = elements.pull
    to.reached, to.with_load[:] = elements.reached, elements.with_load
    to.placed[:], to.placed_by[:] = elements.placed, elements.placed_by
    to.placed_at = elements.placed_at
    to.displaced[:], to.crept[:, :] = elements.displaced, elements.crept


@njit(cache=True)
def begin(elements, normal, q0, q1):
    """A contact that is first seen at these forces: how they came is not known."""
    release(elements)
    elements.reached = normal
    elements.pull[0], elements.pull[1] = q0, q1


@njit(cache=True)
def _bring(elements, d0, d1):
    """Add d (N) to c."""
    for i in range(COUNT):
        elements.force[i, 0] += d0 * LIMITS[i]
        elements.force[i, 1] += d1 * LIMITS[i]
    elements.with_load[0] += d0
    elements.with_load[1] += d1
    elements.moved[0] += d0
    elements.moved[1] += d1


@njit(cache=True)
def press(elements, friction, normal, margin, q0, q1):
    """Give the elements what comes of Q with a growth of P to `normal` (N), and take back what goes
    with a fall; `pull` gives the rest.

    margin (N): by which P must have fallen before it is said to grow again. Returns whether it has
    fallen so far under a c: then |Q − c|/(μP − |c|) tells nothing, the elements alone do.
    """
    d0, d1 = q0 - elements.pull[0], q1 - elements.pull[1]
    elements.pull[0], elements.pull[1] = q0, q1
    room = friction * (normal - elements.reached)
    size = math.hypot(d0, d1)
    if room > 0.0 and size > 0.0:
        part = min(1.0, room / size)
        _bring(elements, part * d0, part * d1)
    c0, c1 = elements.with_load[0], elements.with_load[1]
    carried = math.hypot(c0, c1)
    falls = carried > 0.0 and elements.reached > normal + margin
    fallen = falls and carried > LITTLE * friction * normal
    if falls:
        left = max((normal + margin) / elements.reached, (q0 * c0 + q1 * c1) / carried**2)
        gone = max(0.0, 1.0 - left)
        _bring(elements, -gone * c0, -gone * c1)
    elements.reached = min(max(elements.reached, normal), normal + margin)
    return fallen


@njit(cache=True)
def shares(elements, normal, q0, q1):
    """|Q − c| and |c| over P `normal` (N)."""
    c0, c1 = elements.with_load[0], elements.with_load[1]
    return math.hypot(q0 - c0, q1 - c1) / normal, math.hypot(c0, c1) / normal


@njit(cache=True)
def _summed(elements, load, d0, d1):
    """Elements moved by d: their mean force, its derivatives (xx, xy, yy), their mean potential,
    and the share of them that sticks."""
    f0, f1, a, b, c, potential, stuck = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(COUNT):
        t0, t1 = elements.force[i, 0] + d0, elements.force[i, 1] + d1
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
    n = 1.0 / COUNT
    return f0 * n, f1 * n, a * n, b * n, c * n, potential * n, stuck * n


@njit(cache=True)
def pull(elements, load, q0, q1):
    """Move the elements until their forces sum to Q at limits of `load` = μP; the stick ratio."""
    total = math.hypot(q0, q1)
    if total >= 0.999 * load:
        for i in range(COUNT):
            elements.force[i, 0] = q0 / max(total, 1e-12) * load * LIMITS[i]
            elements.force[i, 1] = q1 / max(total, 1e-12) * load * LIMITS[i]
        return 0.0
    # Newton's method for the least of a convex potential: far away, where all slip, it needs a
    # limit to its steps, and steps that raise the potential are halved.
    d0, d1 = 0.0, 0.0
    f0, f1, a, b, c, potential, stuck = _summed(elements, load, d0, d1)
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
            f0, f1, a, b, c, potential, stuck = _summed(elements, load, n0, n1)
            gain = before - (potential - q0 * n0 - q1 * n1)
            if gain >= 1e-4 * part * (e0 * s0 + e1 * s1) or part < 1e-6:
                break
            part *= 0.5
        d0, d1 = n0, n1
    for i in range(COUNT):
        t0, t1 = elements.force[i, 0] + d0, elements.force[i, 1] + d1
        k = min(1.0, load * LIMITS[i] / max(math.hypot(t0, t1), 1e-12))
        elements.force[i, 0] = k * t0
        elements.force[i, 1] = k * t1
    elements.moved[0] += d0
    elements.moved[1] += d1
    return stuck


@njit(cache=True)
def stiffness(finger, indentation, normal):
    """Tangential stiffness (N/m) under a sudden pull at P `normal` (N), and the factor of the
    finger's `fractions` there; NaN where the finger is not indented."""
    if not indentation > 0.0:
        return math.nan, math.nan
    at = (math.log(indentation / finger.length) - FIRST_DEPTH) / DEPTH_STEP
    at = min(max(at, 0.0), NODES - 1.001)
    k = int(at)
    unloaded = finger.shear[k] + (at - k) * (finger.shear[k + 1] - finger.shear[k])
    load = SOFTENING * max(normal, 0.0) / finger.length
    sudden = unloaded * math.exp(-min(load / unloaded, MOST_TAKEN))
    relaxing = finger.fractions.sum()
    if relaxing < 1e-6:
        return sudden, 1.0
    # The load takes more of a slow pull's stiffness.
    relaxed = (1.0 - relaxing) * unloaded
    slow = relaxed * math.exp(-min(load / relaxed, MOST_TAKEN))
    return sudden, (1.0 - slow / sudden) / relaxing


@njit(cache=True)
def _place(elements, stiffness):
    """Let `placed_by` follow c: each part of it moves the plate by the stiffness at its time."""
    c, along, square = elements.with_load, 0.0, 0.0
    compliance = FIRST / stiffness
    if elements.placed_at > 0.0:
        compliance = 0.5 / stiffness + 0.5 / elements.placed_at
    elements.placed_at = stiffness
    for i in range(2):
        elements.placed_by[i] += compliance * (c[i] - elements.placed[i])
        elements.placed[i] = c[i]
        along += elements.placed_by[i] * c[i]
        square += c[i] * c[i]
    further = min(max(stiffness * along / max(square, 1e-12), 1.0), FURTHEST)
    for i in range(2):
        elements.placed_by[i] = further * c[i] / stiffness


@njit(cache=True)
def displace(finger, elements, dt, stiffness, share, q):
    """Displace the plate under Q (2,), dt (s) after the sample before: the tissue creeps by its
    branches as in a linear Maxwell model, and what slips adds its share. stiffness and `share` are
    those of `stiffness`."""
    _place(elements, stiffness)
    before, driven = elements.displaced.copy(), np.empty(2)
    rest = 1.0
    for i in range(2):
        after = q[i] - elements.placed[i] + COMPLIANCE * (elements.moved[i] - q[i])
        driven[i] = elements.placed_by[i] + after / stiffness
    # Exact for a displacement that is linear within the step.
    for b in range(BRANCHES):
        weights = step_weights(dt, finger.times[b])
        fraction = share * finger.fractions[b]
        rest -= fraction * weights.new
        for i in range(2):
            elements.crept[b, i] = weights.decay * elements.crept[b, i] + weights.old * before[i]
            driven[i] += fraction * elements.crept[b, i]
    for i in range(2):
        elements.displaced[i] = driven[i] / rest
    for b in range(BRANCHES):
        new = step_weights(dt, finger.times[b]).new
        for i in range(2):
            elements.crept[b, i] += new * elements.displaced[i]
