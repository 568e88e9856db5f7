# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How far a step under a given force may go, so that what creeps is followed.

All models take the strain for linear in time within a step. After a change of the load it is not:
it runs against its end with the creep time, and over a curved path, as Hertz's F^(2/3). What that
makes wrong is estimated in linear viscoelasticity: a body under the load s(t) = F^(2/3) has the
strain d = s + Σ a_b with τ_b da_b/dt = g_b d − a_b. Let D be the slope of the chord of d over a
step h and d' its slope at the end. If what lies between d and the chord were a parabola, a_b would
be wrong by g_b |d' − D| τ_b y²/(y² + 6), y = h/τ_b, for short and for long steps.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from .law import ConstitutiveLaw
from .maxwell import MaxwellLaw, step_weights

TOLERANCE = 0.003
"""Error of the strain in one step, over the strain."""
LEAST_LOAD = 0.02
"""F/(E0 L²), L the pad's radial semi-axis; the error is that over the strain of this load, where
there is less."""
SMALLEST = 0.02
"""Over the shortest relaxation time: steps as short as this are not divided."""
SHRINK = 0.6


@njit(cache=True)
def _load(force):
    """s of a force (N)."""
    return max(force, 0.0) ** (2.0 / 3.0)


@njit(cache=True)
def _strain(crept, fraction, tau, h, before, after):
    """d before and after a step, and 1 − Σ g_b β_b, with which it was solved for."""
    start = _load(before)
    for b in range(len(crept)):
        start += crept[b]
    base, left = _load(after), 1.0
    for b in range(len(crept)):
        weights = step_weights(h, tau[b])
        base += weights.decay * crept[b] + fraction[b] * weights.old * start
        left -= fraction[b] * weights.new
    return start, base / left, left


@njit(cache=True)
def creep(crept, fraction, tau, h, before, after):
    """Take a_b (n,) over a step of h (s) under forces from `before` to `after` (N).

    fraction (g_b), tau (n,) in s: of the branches.
    """
    start, end, _ = _strain(crept, fraction, tau, h, before, after)
    for b in range(len(crept)):
        weights = step_weights(h, tau[b])
        crept[b] *= weights.decay
        crept[b] += fraction[b] * (weights.old * start + weights.new * end)


@njit(cache=True)
def _error(crept, fraction, tau, least, h, before, after, slope):
    """Error of a step of h (s), over the strain, that of `least` (N) or more; slope: of the force
    at its end (N/s)."""
    start, end, left = _strain(crept, fraction, tau, h, before, after)
    rate = 2.0 / 3.0 * slope / max(after, least) ** (1.0 / 3.0)
    lag = 0.0
    for b in range(len(crept)):
        weights = step_weights(h, tau[b])
        own = weights.decay * crept[b] + fraction[b] * (weights.old * start + weights.new * end)
        rate += (fraction[b] * end - own) / tau[b]
        y = h / tau[b]
        lag += fraction[b] * tau[b] * y * y / (y * y + 6.0)
    return abs(rate - (end - start) / h) * lag / left / max(end, _load(least))


@njit(cache=True)
def allowed_step(crept, fraction, tau, scale, duration, before, after):
    """Largest step (s) up to `duration` (s), in which the force goes linearly from `before` to
    `after` (N), whose error is within TOLERANCE; scale: E0 L² (N); the others as of `creep`."""
    if duration <= 0.0 or len(crept) == 0:
        return duration
    slope = (max(after, 0.0) - max(before, 0.0)) / duration
    smallest, least = SMALLEST * tau.min(), LEAST_LOAD * scale
    h, goal = duration, after
    while h > smallest:
        if _error(crept, fraction, tau, least, h, before, goal, slope) <= TOLERANCE:
            break
        h *= SHRINK
        goal = max(before, 0.0) + slope * h
    if h == duration or duration - h > 0.5 * h:
        return h
    # What is left is not much smaller than the step.
    return 0.5 * duration


class CreepSteps:
    """`allowed_step` and `creep` of one material: of its Maxwell branches; of another law that
    creeps, of one branch with its creep time that holds half of the modulus.

    length: the pad's radial semi-axis (m).
    """

    def __init__(self, law: ConstitutiveLaw, length: float) -> None:
        shear = law.instantaneous_shear_modulus
        self._scale = 2.0 * (1.0 + law.poisson_ratio_bulk) * shear * length**2
        branches: list[tuple[float, float]] = []
        if isinstance(law, MaxwellLaw):
            branches = list(law.branches)
        elif 0.0 < law.creep_time < math.inf:
            branches = [(0.5, 0.5 * law.creep_time)]
        self._fraction = np.array([fraction for fraction, _ in branches])
        self._tau = np.array([tau for _, tau in branches])

    def at_rest(self) -> np.ndarray:
        """a_b (n,) of a finger at rest."""
        return np.zeros(len(self._tau))

    def allowed(self, crept: np.ndarray, duration: float, before: float, after: float) -> float:
        """Share of a step of `duration` (s) from a force to another (N) that may be made at
        once."""
        if duration <= 0.0:
            return 1.0
        law = self._fraction, self._tau, self._scale
        return float(allowed_step(crept, *law, duration, before, after)) / duration

    def followed(
        self, crept: np.ndarray, duration: float, before: float, after: float
    ) -> np.ndarray:
        """a_b (n,) after a step of `duration` (s) from a force to another (N)."""
        found = crept.copy()
        creep(found, self._fraction, self._tau, duration, before, after)
        return found
