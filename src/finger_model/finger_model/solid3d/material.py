# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A material law on a mesh of bricks: bulk tissue by the law, epidermis and nail neo-Hookean."""

from __future__ import annotations

import numpy as np

from ..fem.mesh import BULK
from ..fem.mesh_material import SMALLEST_VOLUME, Crushed, StepMaterial, elastic_moduli, updated
from ..laws import ConstitutiveLaw, Tissue, unit
from . import elements
from .elements import Bricks
from .mesh import SolidMesh

COMPONENTS = 6


class SolidMaterial:
    """A law on a mesh.

    law; tissue_index (n,): elements of the bulk tissue; bulk (E,): bulk modulus in Pa;
    elastic_metric (E, 8, 6): H in Pa of epidermis and nail.
    """

    def __init__(self, law: ConstitutiveLaw, mesh: SolidMesh, bricks: Bricks) -> None:
        self.law = law
        self.tissue_index = np.flatnonzero(mesh.part == BULK)
        self._tissue = bricks.only(self.tissue_index)
        shear, self.bulk = elastic_moduli(law, mesh.part)
        self.elastic_metric = np.tile(
            shear[:, None, None] * unit(COMPONENTS), (1, bricks.weight.shape[1], 1)
        )

    def at_rest(self) -> Tissue:
        """The undeformed tissue."""
        rest = np.tile(unit(COMPONENTS), (*self._tissue.weight.shape, 1))
        return Tissue(rest, rest, np.tile(rest, (self.law.INTERNAL_TENSORS, 1, 1, 1)))

    def tissue_invariant(self, x: np.ndarray) -> np.ndarray:
        """Ī₁ (n, 8) of the bulk tissue at node positions x (N, 3)."""
        return elements.first_invariant(x, self._tissue)

    def step(self, duration: float, before: Tissue) -> StepMaterial:
        """Material of a step of `duration` (s) that starts from `before`."""
        return StepMaterial(self, self.law.step_energy(duration, before))

    def update(self, duration: float, before: Tissue, x: np.ndarray) -> Tissue:
        """Tissue after a step to node positions x (N, 3); raises Crushed."""
        shape = (*self._tissue.weight.shape, COMPONENTS)
        c_bar, inverse, volume = np.empty(shape), np.empty(shape), np.empty(shape[:2])
        elements.strain_measures(x, self._tissue, c_bar, inverse, volume)
        if volume.min() < SMALLEST_VOLUME:
            raise Crushed(f"tissue is squeezed below {SMALLEST_VOLUME:g} of its volume")
        return updated(self.law, duration, before, c_bar, inverse)
