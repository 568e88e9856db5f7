# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A material law on a mesh: bulk tissue by the law, epidermis and nail neo-Hookean."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from finger_common.errors import InputError

from ..laws import UNIT, ConstitutiveLaw, StepEnergy, Tissue, trace, unit
from . import elements
from .elasticity import FiniteStrain, LinearStrain
from .elements import Elements, Stiffness
from .mesh import BULK, EPIDERMIS, NAIL, Mesh

SMALLEST_VOLUME = 0.2
"""Fraction of its volume below which tissue is crushed: no law describes it there."""


class Crushed(Exception):
    """Tissue is squeezed below SMALLEST_VOLUME."""


def elastic_moduli(law: ConstitutiveLaw, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shear modulus (E,) of epidermis and nail, zero in the bulk tissue, and bulk modulus (E,) in
    Pa of elements whose part (E,) is BULK, EPIDERMIS or NAIL."""
    shear, bulk = np.zeros(len(part)), np.full(len(part), law.bulk_modulus)
    for number, modulus, ratio in (
        (EPIDERMIS, law.epidermis_modulus, law.poisson_ratio_epidermis),
        (NAIL, law.nail_modulus, law.poisson_ratio_nail),
    ):
        shear[part == number] = modulus / (2.0 * (1.0 + ratio))
        bulk[part == number] = modulus / (3.0 * (1.0 - 2.0 * ratio))
    return shear, bulk


class OnMesh(Protocol):
    """What a step needs of a law on a mesh, axisymmetric or not."""

    law: ConstitutiveLaw
    tissue_index: np.ndarray
    elastic_metric: np.ndarray
    bulk: np.ndarray

    def tissue_invariant(self, x: np.ndarray) -> np.ndarray:
        """Ī₁ of the bulk tissue at node positions x."""


class StepMaterial:
    """Material of all elements during one time step.

    metric (E, 4, 4): the tensor H in Pa without the law's stiffening; bulk (E,): K in Pa. Raises
    InputError for an energy of another shape or that is not finite.
    """

    def __init__(self, mesh_material: OnMesh, energy: StepEnergy) -> None:
        self.law = mesh_material.law
        index = mesh_material.tissue_index
        self.metric = mesh_material.elastic_metric.copy()
        try:
            self.metric[index] = energy.metric
        except ValueError:
            raise InputError(
                f"law '{self.law.name}': step_energy gave a metric of shape "
                f"{np.shape(energy.metric)}, {self.metric[index].shape} is needed"
            ) from None
        if not np.isfinite(self.metric).all():
            raise InputError(
                f"law '{self.law.name}': step_energy gave a metric that is not finite; correct it"
            )
        self.bulk = mesh_material.bulk
        self._stiffening = energy.stiffening
        self._material = mesh_material

    def stiffness(self, x: np.ndarray) -> Stiffness:
        """What the elements need at node positions x (N, 2); raises InputError for a stiffening of
        another shape."""
        if self._stiffening is None:
            return Stiffness(self.metric, elements.NO_SLOPE, self.bulk)
        index = self._material.tissue_index
        invariant = self._material.tissue_invariant(x)
        found = self._stiffening(invariant)
        try:
            h, slope_of_tissue = (np.broadcast_to(part, invariant.shape) for part in found)
        except (TypeError, ValueError):
            raise InputError(
                f"law '{self.law.name}': the stiffening of step_energy gave something else than h "
                f"and dh/dĪ₁ of shape {invariant.shape}"
            ) from None
        metric = self.metric.copy()
        metric[index] += h[:, :, None] * unit(metric.shape[-1])
        slope = np.zeros(metric.shape[:2])
        slope[index] = slope_of_tissue
        return Stiffness(metric, slope, self.bulk)

    @property
    def no_stress(self) -> str:
        """Why there is no equilibrium at positions where the stress is not finite."""
        return f"law '{self.law.name}' gives no finite stress at this strain"


def updated(
    law: ConstitutiveLaw,
    duration: float,
    before: Tissue,
    c_bar: np.ndarray,
    c_bar_inverse: np.ndarray,
) -> Tissue:
    """Tissue after a step of `duration` (s) to a strain; raises InputError for a law whose update
    gives tensors of another shape."""
    internal = law.update(duration, before, c_bar, c_bar_inverse)
    if np.shape(internal) != before.internal.shape:
        raise InputError(
            f"law '{law.name}': update gave shape {np.shape(internal)}, {before.internal.shape} is "
            "needed, each of the INTERNAL_TENSORS at each point"
        )
    return Tissue(c_bar, c_bar_inverse, internal)


class MeshMaterial:
    """A law on a mesh.

    law; groups: all elements by their strain measure; linear_tissue: whether the bulk tissue is
    linear; tissue_index (n,): elements of the bulk tissue; shear (E,): shear modulus in Pa of
    epidermis and nail, zero in the bulk tissue; bulk (E,): bulk modulus in Pa; elastic_metric (E,
    4, 4): H in Pa of epidermis and nail.
    """

    def __init__(
        self,
        law: ConstitutiveLaw,
        mesh: Mesh,
        reference: Elements,
        groups: Sequence[FiniteStrain | LinearStrain],
    ) -> None:
        self.law = law
        self.weight = reference.weight
        self.groups = groups
        self.tissue_index = np.flatnonzero(mesh.part == BULK)
        self.tissue_elements = reference.only(self.tissue_index)
        linear = np.zeros(len(mesh.cells), dtype=bool)
        for group in groups:
            linear[group.index] = isinstance(group, LinearStrain)
        self.linear_tissue = bool(linear[self.tissue_index].any())
        self.shear, self.bulk = elastic_moduli(law, mesh.part)
        self.elastic_metric = np.tile(self.shear[:, None, None] * UNIT, (1, 4, 1))

    def at_rest(self) -> Tissue:
        """The undeformed tissue."""
        unit = np.tile(UNIT, (len(self.tissue_index), 4, 1))
        return Tissue(unit, unit, np.tile(unit, (self.law.INTERNAL_TENSORS, 1, 1, 1)))

    def tissue_invariant(self, x: np.ndarray) -> np.ndarray:
        """Ī₁ (n, 4) of the bulk tissue at node positions x (N, 2); 3 where it is linear."""
        if self.linear_tissue:
            return np.full(self.tissue_elements.weight.shape, 3.0)
        return elements.first_invariant(x, self.tissue_elements)

    def step(self, duration: float, before: Tissue) -> StepMaterial:
        """Material of a step of `duration` (s) that starts from `before`."""
        return StepMaterial(self, self.law.step_energy(duration, before))

    def rate(self, duration: float, before: Tissue) -> Stiffness:
        """Change of H per step at the end of a step of `duration` (s), without volumetric part."""
        part = 1e-3
        later = self.law.step_energy((1 + part) * duration, before).metric
        now = self.law.step_energy((1 - part) * duration, before).metric
        metric = np.zeros_like(self.elastic_metric)
        metric[self.tissue_index] = (later - now) / (2 * part)
        return Stiffness(metric, elements.NO_SLOPE, np.zeros_like(self.bulk))

    def update(self, duration: float, before: Tissue, x: np.ndarray) -> tuple[Tissue, float, float]:
        """Tissue after a step to node positions x (N, 2), energy stored in the finger, and
        dissipated in the step.

        Energies in J/rad, NaN where the bulk tissue is linear. Raises Crushed.
        """
        c_bar = np.empty_like(self.elastic_metric)
        inverse = np.empty_like(self.elastic_metric)
        dilatation = np.empty(self.weight.shape)
        for group in self.groups:
            found = group.measures(x)
            if found.smallest < SMALLEST_VOLUME:
                raise Crushed(f"tissue is squeezed below {SMALLEST_VOLUME:g} of its volume")
            c_bar[group.index], inverse[group.index] = found.c_bar, found.c_bar_inverse
            dilatation[group.index] = found.dilatation
        index, weight = self.tissue_index, self.weight
        strain = c_bar[index], inverse[index]
        after = updated(self.law, duration, before, *strain)
        if self.linear_tissue:
            return after, math.nan, math.nan
        stored, dissipated = self.law.energies(self.tissue_elements.weight, before, after)
        volume = weight.sum(axis=1)
        mean = (weight * dilatation).sum(axis=1) / volume
        spring = (weight * (trace(c_bar) - 3.0)).sum(axis=1)
        elastic = 0.5 * self.shear @ spring + 0.5 * (self.bulk * volume) @ mean**2
        return after, stored + float(elastic), dissipated
