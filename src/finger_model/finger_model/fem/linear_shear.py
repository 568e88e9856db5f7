# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tangential stiffness of a linear elastic finger whose contact sticks to the plate.

The plate moves sideways; displacements are the first harmonic around the axis (cos θ radially and
axially, −sin θ around; Wilson, AIAA J. 3, 1965), so that the axisymmetric mesh is enough. Skin in
contact moves with the plate: u_r = cos θ, u_θ = −sin θ, u_z = 0.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from ..geometry import Geometry
from ..laws import MaxwellLaw
from . import elements
from .mesh import BULK, similar_mesh
from .mesh_material import elastic_moduli

FIRST = 3
"""Node of the smallest contact."""
PLATE = np.array([1.0, 0.0, -1.0])
"""Amplitudes (radial, axial, around) of a point that moves with the plate."""


class LinearShear:
    """Elements of one geometry's `similar_mesh`, their moduli being free."""

    def __init__(self, geometry: Geometry) -> None:
        mesh = self._mesh = similar_mesh(geometry)
        own = elements.reference_elements(mesh.nodes, mesh.cells)
        weight = np.pi * own.weight
        strain = _strains(own)
        dilation = strain[:, :, :3].sum(axis=2)
        # Dilation by its mean over the element: nearly incompressible tissue must not lock.
        mean = np.einsum("ep,epi->ei", weight, dilation) / weight.sum(axis=1)[:, None]
        strain[:, :, :3] -= dilation[:, :, None] / 3.0
        shear = np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
        self._shear = np.einsum("ep,epci,c,epcj->eij", weight, strain, shear, strain, optimize=True)
        self._bulk = np.einsum("e,ei,ej->eij", weight.sum(axis=1), mean, mean)
        # On the axis the finger moves as one point: around what it does radially, not axially.
        unknowns = np.arange(3 * len(mesh.nodes)).reshape(-1, 3)
        self._sign = np.ones(unknowns.shape)
        on_axis = np.flatnonzero(mesh.nodes[:, 0] < 1e-9 * mesh.nodes[:, 0].max())
        unknowns[on_axis, 2], self._sign[on_axis, 2] = unknowns[on_axis, 0], -1.0
        held = np.zeros(unknowns.size, bool)
        held[unknowns[on_axis, 1]] = True
        held[unknowns[mesh.fixed[:, 1]].ravel()] = True
        free = np.setdiff1d(unknowns, np.flatnonzero(held))
        self._number = np.full(unknowns.size, -1)
        self._number[free] = np.arange(len(free))
        self._unknowns = unknowns

    def curve(self, material: MaxwellLaw) -> np.ndarray:
        """Rows (n, 2) of growing contact: radius (m), tangential stiffness (N/m) under a sudden
        small load."""
        mesh, size = self._mesh, self._number.max() + 1
        shear, bulk = elastic_moduli(material, mesh.part)
        shear[mesh.part == BULK] = material.instantaneous_shear_modulus
        stiffness = shear[:, None, None] * self._shear + bulk[:, None, None] * self._bulk
        sign = self._sign[mesh.cells].reshape(len(mesh.cells), 12)
        number = self._number[self._unknowns[mesh.cells]].reshape(sign.shape)
        stiffness *= sign[:, :, None] * sign[:, None, :]
        rows, columns = np.broadcast_arrays(number[:, :, None], number[:, None, :])
        used = (rows >= 0) & (columns >= 0)
        matrix = csc_matrix((stiffness[used], (rows[used], columns[used])), shape=(size, size))
        # The skin's unknowns, from the axis outwards, and what they are on the plate.
        of_skin = self._number[self._unknowns[mesh.surface]]
        own, first = np.unique(of_skin, return_index=True)
        first = np.sort(first[own >= 0])
        at, node = of_skin.ravel()[first], first // 3
        plate = PLATE[first % 3]
        loads = np.zeros((size, len(at)))
        loads[at, np.arange(len(at))] = 1.0
        flexibility = splu(matrix).solve(loads)[at]
        found = []
        for last in range(FIRST, len(mesh.surface) - 1):
            n = int(np.searchsorted(node, last, side="right"))
            force = np.linalg.solve(flexibility[:n, :n], plate[:n])
            found.append((mesh.nodes[mesh.surface[last], 0], force @ plate[:n]))
        return np.array(found)


def _strains(own: elements.Elements) -> np.ndarray:
    """Strains (E, 4, 6, 12) rr, zz, θθ, 2 rz, 2 rθ, 2 zθ at the Gauss points per amplitude of the
    displacements, three a node."""
    found = np.zeros((*own.radius.shape, 6, 4, 3))
    over_r = elements.SHAPE[None, :, :] / own.radius[:, :, None]
    along_r, along_z = own.gradient[..., 0], own.gradient[..., 1]
    found[:, :, 0, :, 0] = along_r
    found[:, :, 1, :, 1] = along_z
    found[:, :, 2, :, 0] = found[:, :, 2, :, 2] = over_r
    found[:, :, 3, :, 0], found[:, :, 3, :, 1] = along_z, along_r
    found[:, :, 4, :, 0], found[:, :, 4, :, 2] = -over_r, along_r - over_r
    found[:, :, 5, :, 1], found[:, :, 5, :, 2] = -over_r, along_z
    return found.reshape(*own.radius.shape, 6, 12)
