# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Laws of bulk tissue as a spring beside Maxwell branches, at finite strain.

A branch is a spring G in series with a damper of relaxation time τ:

    W = ½ G (A : C̄ − ln det A − 3),   dA/dt = (C̄⁻¹ − A)/τ,   A = 1 at rest

A is the inverse metric of the damper (Linder, Tkachuk and Miehe, J. Mech. Phys. Solids 59,
2134–2156, 2011). For C̄⁻¹ linear in time over a step Δt the evolution is integrated exactly:

    A₊ = e A + α C̄⁻¹ + β C̄₊⁻¹,   e = exp(−Δt/τ),   β = 1 − (1 − e) τ/Δt,   α = (1 − e) τ/Δt − e

The last term does not enter the stress, since the deviator of C̄⁻¹ with respect to C̄ is zero. A
step is therefore that of a hyperelastic body with ½ G (e A + α C̄⁻¹) : C̄.

The spring may stiffen with strain: W∞ = G∞/(2b) (exp(b (Ī₁ − 3)) − 1), neo-Hooke for b = 0
(Demiray, J. Biomech. 5, 309–311, 1972).
"""

from __future__ import annotations

import contextlib
import itertools
import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from finger_common.errors import InputError

from ..compiled import njit
from .law import ConstitutiveLaw, StepEnergy, Tissue, trace

LARGEST_STIFFENING = 50.0
_LARGEST_EXPONENT = 40.0
"""Of exp(b (Ī₁ − 3)): no equilibrium comes near, a wild iterate of Newton's method may."""


class StepWeights(NamedTuple):
    """Weights of A, C̄⁻¹ before and C̄⁻¹ after a step in the new A."""

    decay: float
    old: float
    new: float


@njit(cache=True)
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


class Branch(NamedTuple):
    """A Maxwell branch: spring G_k over the instantaneous shear modulus, relaxation time in s."""

    fraction: float
    relaxation_time: float


def slowest_creep(fractions: np.ndarray, times: np.ndarray) -> float:
    """Time (s) of the slowest creep of branches: fractions (n,) of G0, relaxation times (n,) in s.

    At constant stress the strain is Σ g_k γ_k, and the dampers follow it by τ_k dγ_k/dt =
    Σ g_j γ_j − γ_k.
    """
    rates = (fractions - np.eye(len(times))) / times[:, None]
    return float(-1.0 / np.linalg.eigvals(rates).real.max())


@dataclass(frozen=True, kw_only=True)
class MaxwellLaw(ConstitutiveLaw):
    """Spring G∞, which may stiffen, beside Maxwell branches (G_k, τ_k); G0 = G∞ + Σ G_k.

        W = G∞/(2b) (exp(b (Ī₁ − 3)) − 1) + Σ ½ G_k (A_k : C̄ − ln det A_k − 3) + ½ K (J − 1)²

    A subclass gives `branches`, the instantaneous shear modulus and the epidermis. Raises
    InputError for a stiffening outside 0 … 50.
    """

    stiffening: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.stiffening <= LARGEST_STIFFENING:
            raise InputError(
                f"material: 'stiffening' is {self.stiffening:g}, outside 0 … "
                f"{LARGEST_STIFFENING:g}; 0 is tissue that does not stiffen"
            )

    @property
    @abstractmethod
    def branches(self) -> tuple[Branch, ...]:
        """The Maxwell branches, as many as INTERNAL_TENSORS."""

    @property
    def instantaneous_modulus(self) -> float:
        """E0 = 2 (1 + ν) G0 in Pa: Young's modulus under a sudden small strain."""
        return 2.0 * (1.0 + self.poisson_ratio_bulk) * self.instantaneous_shear_modulus

    @property
    def long_term_fraction(self) -> float:
        """G∞/G0 = 1 − Σ G_k/G0."""
        return 1.0 - sum(branch.fraction for branch in self.branches)

    @property
    def long_term_shear_modulus(self) -> float:
        """G∞ in Pa."""
        return self.long_term_fraction * self.instantaneous_shear_modulus

    @property
    def creep_time(self) -> float:
        """Shortest time (s) in which strain creeps at constant stress."""
        rest = self.long_term_fraction
        return min(b.relaxation_time * (1.0 + b.fraction / rest) for b in self.branches)

    def longest_creep_time(self, box: np.ndarray) -> float:
        """That of the corners of the box which the law allows."""
        found = [0.0]
        for corner in itertools.product(*box):
            with contextlib.suppress(InputError):
                branches = self.with_vector(np.array(corner)).branches
                found.append(slowest_creep(*np.transpose(branches)))
        return max(found)

    def _spring(self, invariant: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """2 ∂W∞/∂Ī₁ and its slope (n, 4) in Pa at Ī₁ (n, 4)."""
        exponent = np.minimum(self.stiffening * (invariant - 3.0), _LARGEST_EXPONENT)
        modulus = self.long_term_shear_modulus * np.exp(exponent)
        return modulus, self.stiffening * modulus

    def step_energy(self, duration: float, before: Tissue) -> StepEnergy:
        """H = Σ G_k (e_k A_k + α_k C̄⁻¹), and G∞ 1 or the stiffening spring."""
        metric = np.zeros_like(before.c_bar)
        for branch, internal in zip(self.branches, before.internal):
            weights = step_weights(duration, branch.relaxation_time)
            relaxed = weights.decay * internal + weights.old * before.c_bar_inverse
            metric += branch.fraction * self.instantaneous_shear_modulus * relaxed
        if self.stiffening > 0.0:
            return StepEnergy(metric, self._spring)
        return StepEnergy(metric + self.long_term_shear_modulus * before.unit)

    def update(
        self, duration: float, before: Tissue, c_bar: np.ndarray, c_bar_inverse: np.ndarray
    ) -> np.ndarray:
        """A₊ = e A + α C̄⁻¹ + β C̄₊⁻¹ of each branch."""
        found = np.empty_like(before.internal)
        for k, branch in enumerate(self.branches):
            weights = step_weights(duration, branch.relaxation_time)
            found[k] = weights.decay * before.internal[k] + weights.old * before.c_bar_inverse
            found[k] += weights.new * c_bar_inverse
        return found

    def energies(self, weight: np.ndarray, before: Tissue, after: Tissue) -> tuple[float, float]:
        """Energy of the spring and of the Maxwell branches; the branches dissipate."""
        strain = trace(after.c_bar) - 3.0
        if self.stiffening > 0.0:
            strain = np.expm1(self.stiffening * strain) / self.stiffening
        stored = 0.5 * self.long_term_shear_modulus * float(np.sum(weight * strain))
        dissipated = 0.0
        for k, branch in enumerate(self.branches):
            energy, loss = branch_energies(
                weight,
                branch.fraction * self.instantaneous_shear_modulus,
                before.c_bar,
                after.c_bar,
                before.internal[k],
                after.internal[k],
            )
            stored += energy
            dissipated += loss
        return stored, dissipated
