# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Frictionless contact of a linear elastic finger at small strain: rough, but within milliseconds.

The flat plate touches skin nodes 0 … k from the axis outwards; at the last of them the pressure is
zero. Each k gives one force, area and indentation, by the flexibility of the skin nodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..compiled import njit, prange
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
SIDE_BY_SIDE = 4
"""Factorisations from which on all cores work."""


class LinearContact:
    """Linear contact of one geometry on `similar_mesh`, and how the default mesh differs."""

    def __init__(self, geometry: Geometry) -> None:
        self.length = geometry.pad_semi_axis_radial
        self._coarse = _Linear(similar_mesh(geometry))
        self._default = _Linear(finger_mesh(geometry))

    def curves(self, materials: Sequence[MaxwellLaw], shares: Sequence[float]) -> list[np.ndarray]:
        """Curve for each of several materials and shares: the bulk tissue has the shear modulus G0
        and the modulus E = E0, each times its share, and its full bulk modulus.

        Rows (r, 3) of rising load: ln x, ln(A/L²), ln(δ/L), x = (F/(E L²))^(1/3).
        """
        moduli, young, which = _different(materials, shares)
        mesh = self._coarse
        flexibility = mesh.flexibility(moduli, np.eye(len(mesh.radius)))
        # The last node of the contact: not one of the first, nor the skin's last.
        ends = slice(FIRST - 1, -1)
        forces, depths = (v[:, ends] for v in _contacts(flexibility, mesh.gap))
        areas = math.pi * (mesh.radius[ends] / self.length) ** 2
        found = []
        for scale, force, depth in zip(young * self.length**2, forces, depths):
            reached = (force > 0.0) & (depth > 0.0)
            x = np.log(force[reached] / scale) / 3.0
            rising = np.concatenate([[True], x[1:] > np.maximum.accumulate(x)[:-1]])
            columns = x, np.log(areas[reached]), np.log(depth[reached] / self.length)
            found.append(np.column_stack(columns)[rising])
        return [found[k] for k in which]

    def meshes(self, materials: Sequence[MaxwellLaw], shares: Sequence[float]) -> np.ndarray:
        """What tells the default mesh from `similar_mesh` (n, 3), for materials and shares (n,) as
        of `curves`: logarithm of the ratio of their compliances to the pressure of Hertz over
        PRESSED; node spacing on the axis over L, along the skin and through it."""
        moduli, _, which = _different(materials, shares)
        coarse, default = (
            mesh.flexibility(moduli, mesh.hertzian_load(PRESSED * self.length)[:, None])
            for mesh in (self._coarse, self._default)
        )
        ratio = np.log(default / coarse)[which, 0, 0]
        spacing = np.tile(self._default.spacing / self.length, (len(ratio), 1))
        return np.column_stack([ratio, spacing])


def _different(
    materials: Sequence[MaxwellLaw], shares: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shear and then bulk moduli of PARTS (m, 6) and modulus E (m,) of the bulk tissue, in Pa, that
    differ, and which of them each material (n,) has, G0 and E being times its share.

    They do not depend on times, nor those of sudden loads on E∞: a fit that changes one parameter
    after the other asks for the same ones several times.
    """
    rows = []
    for material, share in zip(materials, shares):
        shear, bulk = elastic_moduli(material, np.array(PARTS))
        shear[PARTS.index(BULK)] = material.instantaneous_shear_modulus * share
        rows.append([*shear, *bulk, material.instantaneous_modulus * share])
    different, which = np.unique(rows, axis=0, return_inverse=True)
    return different[:, :-1], different[:, -1], which.ravel()


class _Linear:
    """Small elastic displacements of a mesh, its moduli in each part being free."""

    def __init__(self, mesh: Mesh) -> None:
        solver = Equilibrium(mesh)
        # The stiffness is a sum over shear and bulk modulus of each part, whose rows are few.
        bands = np.array(
            [self._band(solver, mesh.part == p, shear) for shear in (True, False) for p in PARTS]
        )
        self._rows = np.argwhere(bands.any(axis=2))
        self._values = bands[tuple(self._rows.T)]
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

    def flexibility(self, moduli: np.ndarray, loads: np.ndarray) -> np.ndarray:
        """Work (n, k, k) of axial forces (S, k) on the skin nodes (N/rad) on each other's
        displacements, for moduli (n, 6) of `_different`."""
        found = np.empty((len(moduli), loads.shape[1], loads.shape[1]))
        fill = _in_turn if len(moduli) < SIDE_BY_SIDE else _side_by_side
        fill(moduli, self._rows, self._values, self._fixed, self._axial, loads, found)
        return found

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


@njit(cache=True, nogil=True, fastmath=True)
def factorize(band):
    """L of K = L Lᵀ in place of K, both (u, w) by the diagonal and what is below it.

    What LAPACK's dpbtrf does, which kernels cannot call.
    """
    number, width = band.shape
    for column in range(number):
        own = band[column]
        own *= 1.0 / math.sqrt(own[0])
        for below in range(1, min(width, number - column)):
            row, under = band[column + below, : width - below], own[below:]
            factor = under[0]
            for k in range(len(under)):
                row[k] -= factor * under[k]


@njit(cache=True, nogil=True, fastmath=True)
def substitute(band, vectors):
    """Solve L y = x in place for vectors x (k, u), L (u, w) as of `factorize`."""
    number, width = band.shape
    for column in range(number):
        below = band[column, 1 : min(width, number - column)]
        inverse = 1.0 / band[column, 0]
        for vector in vectors:
            vector[column] *= inverse
            factor, rest = vector[column], vector[column + 1 :]
            for k in range(len(below)):
                rest[k] -= factor * below[k]


@njit(cache=True, nogil=True)
def _flexibility(moduli, rows, values, fixed, axial, loads):
    """Work (k, k) of loads (S, k) on each other's displacements, for moduli (6,); rows (r, 2):
    modulus and row of the band of each of values (r, w)."""
    band = np.zeros((rows[:, 1].max() + 1, values.shape[1]))
    for k in range(len(rows)):
        row, value, modulus = band[rows[k, 1]], values[k], moduli[rows[k, 0]]
        for m in range(len(value)):
            row[m] += modulus * value[m]
    elements.hold(band, fixed)
    factorize(band)
    # With K = L Lᵀ the work is that of L⁻¹ of the loads, which are at the numbering's end.
    start = axial.min()
    right = np.zeros((loads.shape[1], len(band) - start))
    for node in range(len(axial)):
        right[:, axial[node] - start] = loads[node]
    substitute(band[start:], right)
    return right @ right.T


# Two functions: see `compiled`.
@njit(cache=True, nogil=True)
def _in_turn(moduli, rows, values, fixed, axial, loads, found):
    for k in range(len(moduli)):
        found[k] = _flexibility(moduli[k], rows, values, fixed, axial, loads)


@njit(cache=True, nogil=True, parallel=True)
def _side_by_side(moduli, rows, values, fixed, axial, loads, found):
    for k in prange(len(moduli)):
        found[k] = _flexibility(moduli[k], rows, values, fixed, axial, loads)


def _contacts(flexibility: np.ndarray, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force (N) and indentation (m), each (n, S), of contacts that end at each node, where the
    pressure is zero; flexibility (n, S, S), gap (S,).

    F p = δ − gap on the nodes of a contact. With F = L Lᵀ and u, v the solutions of L u = 1 and
    L v = gap, the pressure at the k-th node is zero where δ = v_k/u_k, and the first k of u and v
    are those of the contact.
    """
    right = np.column_stack([np.ones(len(gap)), gap])
    u, v = np.moveaxis(np.linalg.solve(np.linalg.cholesky(flexibility), right), -1, 0)
    depth = v / u
    pressed = np.tril(depth[..., None] * u[:, None, :] - v[:, None, :])
    return 2.0 * math.pi * (pressed @ u[..., None])[..., 0], depth
