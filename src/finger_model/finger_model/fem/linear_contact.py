# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Frictionless contact of a linear elastic finger at small strain: rough, but within milliseconds.

The flat plate touches skin nodes 0 … k from the axis outwards; at the last of them the pressure is
zero. Each k gives one force, area and indentation, by the flexibility of the skin nodes.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from scipy.linalg.lapack import dpbtrf

from ..compiled import njit
from ..geometry import Geometry
from ..laws import UNIT, MaxwellLaw
from . import elements
from .equilibrium import Equilibrium
from .mesh import BULK, EPIDERMIS, NAIL, Mesh, finger_mesh, similar_mesh
from .mesh_material import elastic_moduli

PARTS = (BULK, EPIDERMIS, NAIL)
FIRST = 3
"""Fewest nodes in contact."""
PRESSED = 0.35
"""Radius of the pressure by which two meshes are compared, over the pad's radial semi-axis."""
HERTZIAN_RINGS = 1000
"""Rings into which that pressure is divided among the nodes."""
RECENT = 64
"""Curves that a geometry keeps."""


class LinearContact:
    """Linear contact of one geometry on `similar_mesh`, and how the default mesh differs."""

    def __init__(self, geometry: Geometry) -> None:
        self.length = geometry.pad_semi_axis_radial
        self._coarse = _Linear(similar_mesh(geometry))
        self._default = _Linear(finger_mesh(geometry))
        self._single = np.eye(len(self._coarse.radius))
        meshes = self._coarse, self._default
        self._hertzian = [mesh.hertzian_load(PRESSED * self.length) for mesh in meshes]
        # Sudden and slow curves do not depend on times, and sudden ones not on E∞: a fit that
        # changes one parameter after the other asks for the same ones again.
        self._curve = functools.lru_cache(maxsize=RECENT)(self._curve_of)

    def at(self, material: MaxwellLaw, share: float) -> tuple[np.ndarray, np.ndarray]:
        """Curve and meshes where the bulk tissue has the shear modulus G0 and the modulus E = E0,
        each times `share`, and its full bulk modulus.

        Curve: rows (n, 3) of rising load, ln x, ln(A/L²), ln(δ/L), x = (F/(E L²))^(1/3). Meshes
        (3,), what tells the default mesh from `similar_mesh`: logarithm of the ratio of their
        compliances to the pressure of Hertz over PRESSED; node spacing on the axis over L, along
        the skin and through it.
        """
        scale = material.instantaneous_modulus * share * self.length**2
        shear, bulk = elastic_moduli(material, np.array(PARTS))
        shear[PARTS.index(BULK)] = material.instantaneous_shear_modulus * share
        return self._curve((*shear.tolist(), *bulk.tolist()), scale)

    def _curve_of(self, moduli: tuple[float, ...], scale: float) -> tuple[np.ndarray, np.ndarray]:
        """What `at` gives, of shear and then bulk moduli (Pa) of PARTS, and of E L² (N)."""
        mesh = self._coarse
        flexibility = mesh.flexibility(moduli, self._single)
        rows = _rows(flexibility, mesh.gap)
        rows = rows[rows[:, 0] > 0.0]
        x = np.log(rows[:, 0] / scale) / 3.0
        area = np.log(math.pi * (mesh.radius[rows[:, 2].astype(int)] / self.length) ** 2)
        rising = np.concatenate([[True], x[1:] > np.maximum.accumulate(x)[:-1]])
        curve = np.column_stack([x, area, np.log(rows[:, 1] / self.length)])[rising]
        coarse, default = self._hertzian
        compliance = self._default.flexibility(moduli, default[:, None]).item()
        ratio = math.log(compliance / (coarse @ flexibility @ coarse))
        return curve, np.array([ratio, *(self._default.spacing / self.length)])


class _Linear:
    """Small elastic displacements of a mesh, its moduli in each part being free."""

    def __init__(self, mesh: Mesh) -> None:
        solver = Equilibrium(mesh)
        # The stiffness is a sum over shear and bulk modulus of each part.
        self._bands = np.array(
            [self._band(solver, mesh.part == p, shear) for shear in (True, False) for p in PARTS]
        )
        self._fixed = solver.fixed
        self._axial = solver.axial
        skin = mesh.nodes[mesh.surface]
        self.radius, self.gap = skin[:, 0].copy(), skin[:, 1] - skin[:, 1].min()
        on_axis = mesh.surface[0]
        self.spacing = np.array(
            [skin[1, 0] - skin[0, 0], mesh.nodes[on_axis - 1, 1] - mesh.nodes[on_axis, 1]]
        )

    @staticmethod
    def _band(solver: Equilibrium, cells: np.ndarray, shear: bool) -> np.ndarray:
        """Lower band of the stiffness for a unit modulus of some cells."""
        number = len(solver.mesh.cells)
        moduli, bulk = np.zeros(number), np.zeros(number)
        (moduli if shear else bulk)[cells] = 1.0
        metric = np.tile(moduli[:, None, None] * UNIT, (1, 4, 1))
        solver.assemble(solver.mesh.nodes, elements.Stiffness(metric, elements.NO_SLOPE, bulk))
        return solver.band.copy()

    def flexibility(self, moduli: tuple[float, ...], loads: np.ndarray) -> np.ndarray:
        """Work (n, n) of axial forces (S, n) on the skin nodes (N/rad) on each other's
        displacements; moduli (6,): shear and then bulk moduli (Pa) of PARTS."""
        band = np.tensordot(np.array(moduli), self._bands, 1)
        elements.hold(band, self._fixed)
        factor, _ = dpbtrf(band.T, lower=1, overwrite_ab=1)
        # With K = L Lᵀ the work is that of L⁻¹ of the loads, which are at the numbering's end.
        start = self._axial.min()
        right = np.zeros((len(band) - start, loads.shape[1]))
        right[self._axial - start] = loads
        elements.substitute_forward(factor.T, start, right)
        return right.T @ right

    def hertzian_load(self, radius: float) -> np.ndarray:
        """Forces (S,) on the skin nodes of a pressure √(1 − (r/radius)²), in all 1 N/rad."""
        r = radius * (np.arange(HERTZIAN_RINGS) + 0.5) / HERTZIAN_RINGS
        force = np.sqrt(1.0 - (r / radius) ** 2) * r
        node = np.searchsorted(self.radius, r) - 1
        outer = (r - self.radius[node]) / (self.radius[node + 1] - self.radius[node])
        number = len(self.radius)
        found = np.bincount(node, force * (1.0 - outer), number)
        found += np.bincount(node + 1, force * outer, number)
        return found / found.sum()


@njit(cache=True, nogil=True)
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
