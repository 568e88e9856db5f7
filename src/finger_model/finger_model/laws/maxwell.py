"""A Maxwell branch at finite strain: a spring G in series with a damper of relaxation time τ.

    W = ½ G (A : C̄ − ln det A − 3),   dA/dt = (C̄⁻¹ − A)/τ,   A = 1 at rest

A is the inverse metric of the damper (Linder, Tkachuk and Miehe, J. Mech. Phys. Solids 59,
2134–2156, 2011). For C̄⁻¹ linear in time over a step Δt the evolution is integrated exactly:

    A₊ = e A + α C̄⁻¹ + β C̄₊⁻¹,   e = exp(−Δt/τ),   β = 1 − (1 − e) τ/Δt,   α = (1 − e) τ/Δt − e

The last term does not enter the stress, since the deviator of C̄⁻¹ with respect to C̄ is zero. A
step is therefore that of a hyperelastic body with ½ G (e A + α C̄⁻¹) : C̄.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit


class StepWeights(NamedTuple):
    """Weights of A, C̄⁻¹ before and C̄⁻¹ after a step in the new A."""

    decay: float
    old: float
    new: float


def step_weights(duration: float, relaxation_time: float) -> StepWeights:
    """The weights e, α and β of a step of `duration` (s)."""
    ratio = duration / relaxation_time
    decay = math.exp(-ratio)
    if ratio < 1e-5:
        return StepWeights(decay, 0.5 * ratio, 0.5 * ratio)
    mean = -math.expm1(-ratio) / ratio
    return StepWeights(decay, mean - decay, 1.0 - mean)


@njit(cache=True)
def _inverse(a, out):
    """Inverse of a symmetric tensor stored as (rr, zz, θθ, rz); returns the determinant."""
    plane = a[0] * a[1] - a[3] * a[3]
    out[0] = a[1] / plane
    out[1] = a[0] / plane
    out[2] = 1.0 / a[2]
    out[3] = -a[3] / plane
    return plane * a[2]


@njit(cache=True)
def branch_energies(weight, shear_modulus, c_bar_before, c_bar, internal_before, internal):
    """Energy stored in a branch after a step and dissipated in it, in J/rad.

    weight (n, 4) in m³/rad; tensors (n, 4, 4). The dissipation −∫ ∂W/∂A : dA, with
    ∂W/∂A = ½ G (C̄ − A⁻¹), is taken by the trapezoidal rule.
    """
    stored = 0.0
    dissipated = 0.0
    inverse_before = np.empty(4)
    inverse = np.empty(4)
    for e in range(weight.shape[0]):
        for p in range(4):
            _inverse(internal_before[e, p], inverse_before)
            determinant = _inverse(internal[e, p], inverse)
            product = 0.0
            change = 0.0
            for k in range(4):
                double = 2.0 if k == 3 else 1.0
                product += double * internal[e, p, k] * c_bar[e, p, k]
                force = c_bar_before[e, p, k] - inverse_before[k] + c_bar[e, p, k] - inverse[k]
                change += double * force * (internal[e, p, k] - internal_before[e, p, k])
            stored += 0.5 * weight[e, p] * (product - math.log(determinant) - 3.0)
            dissipated -= 0.25 * weight[e, p] * change
    return shear_modulus * stored, shear_modulus * dissipated
