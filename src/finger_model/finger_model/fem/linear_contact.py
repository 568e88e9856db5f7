# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Frictionless contact of a linear elastic finger at small strain: rough, but within a millisecond.

The flat plate touches skin nodes 0 … k from the axis outwards; at the last of them the pressure is
zero. Each k gives one force, area and indentation, by the flexibility of the skin nodes.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs

from ..compiled import njit
from ..geometry import Geometry
from ..laws import UNIT, MaxwellLaw
from . import elements
from .equilibrium import Equilibrium
from .mesh import BULK, EPIDERMIS, NAIL, similar_mesh
from .mesh_material import elastic_moduli

FIRST = 3
"""Fewest nodes in contact."""


class LinearContact:
    """Linear contact of one geometry on `similar_mesh`."""

    def __init__(self, geometry: Geometry) -> None:
        self._mesh = mesh = similar_mesh(geometry)
        self.length = geometry.pad_semi_axis_radial
        solver = Equilibrium(mesh)
        self._parts = [np.flatnonzero(mesh.part == part) for part in (BULK, EPIDERMIS, NAIL)]
        # The stiffness is a sum over shear and bulk modulus of each part.
        self._bands = np.array(
            [self._band(solver, cells, shear) for cells in self._parts for shear in (True, False)]
        )
        self._fixed = solver.fixed
        self._axial = solver.axial
        self._loads = np.zeros((solver.unknowns, len(mesh.surface)), order="F")
        self._loads[solver.axial, np.arange(len(mesh.surface))] = 1.0
        skin = mesh.nodes[mesh.surface]
        self._radius, self._gap = skin[:, 0].copy(), skin[:, 1] - skin[:, 1].min()

    @staticmethod
    def _band(solver: Equilibrium, cells: np.ndarray, shear: bool) -> np.ndarray:
        """Lower band of the stiffness for a unit modulus of some cells."""
        number = len(solver.mesh.cells)
        moduli, bulk = np.zeros(number), np.zeros(number)
        (moduli if shear else bulk)[cells] = 1.0
        metric = np.tile(moduli[:, None, None] * UNIT, (1, 4, 1))
        solver.assemble(solver.mesh.nodes, elements.Stiffness(metric, elements.NO_SLOPE, bulk))
        return solver.band.copy()

    def curve(self, material: MaxwellLaw, share: float) -> np.ndarray:
        """Rows (n, 3) of rising load: ln x, ln(A/L²), ln(δ/L), x = (F/(E L²))^(1/3).

        The bulk tissue has the shear modulus G0 and the modulus E = E0, each times `share`, and its
        full bulk modulus.
        """
        shear, bulk = elastic_moduli(material, self._mesh.part)
        shear[self._parts[0]] = material.instantaneous_shear_modulus * share
        moduli = [
            m[cells[0]] if len(cells) else 0.0 for cells in self._parts for m in (shear, bulk)
        ]
        band = np.tensordot(np.array(moduli), self._bands, 1)
        elements.hold(band, self._fixed)
        factor, _ = dpbtrf(band.T, lower=1, overwrite_ab=1)
        flexibility = dpbtrs(factor, self._loads, lower=1)[0][self._axial]
        scale = material.instantaneous_modulus * share * self.length**2
        rows = _rows(np.ascontiguousarray(flexibility), self._gap)
        rows = rows[rows[:, 0] > 0.0]
        x = np.log(rows[:, 0] / scale) / 3.0
        area = np.log(math.pi * (self._radius[rows[:, 2].astype(int)] / self.length) ** 2)
        rising = np.concatenate([[True], x[1:] > np.maximum.accumulate(x)[:-1]])
        return np.column_stack([x, area, np.log(rows[:, 1] / self.length)])[rising]


@njit(cache=True)
def _rows(flexibility, gap):
    """Force (N), indentation (m) and last node (n, 3) of contacts that grow; 0 where none is."""
    number = len(gap)
    found = np.zeros((number - FIRST, 3))
    for k in range(FIRST, number):
        matrix = np.empty((k, k))
        matrix[:, : k - 1] = flexibility[:k, : k - 1]
        matrix[:, k - 1] = -1.0
        solution = np.linalg.solve(matrix, -gap[:k])
        force, depth = 2.0 * math.pi * solution[: k - 1].sum(), solution[k - 1]
        if force > 0.0 and depth > 0.0:
            found[k - FIRST, 0] = force
            found[k - FIRST, 1] = depth
            found[k - FIRST, 2] = k - 1
    return found
