# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled kernels of the eight-node brick with mean dilatation.

Symbols as in `fem/elements.py`: F deformation gradient, J its determinant, θ mean dilatation of an
element, τ Kirchhoff stress, C̄ = J^(−2/3) FᵀF, H = 2 ∂W/∂C̄. Symmetric tensors are stored as (xx, yy,
zz, xy, yz, xz).

Where a layer bends or shears, the derivative along its thickness grows along the element, and the
shear that follows from it makes the element too stiff (parasitic shear). So the derivatives of the
shape functions by ζ, along the thickness, are averaged over ξ and η. Those by ξ and η are not, so
that only a rigid motion is free of stress; a uniform strain stays exact.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from ..compiled import njit
from ..fem.elements import NO_SLOPE, Stiffness

__all__ = ["NO_SLOPE", "Bricks", "Stiffness", "assemble", "reference_bricks", "strain_measures"]

NODES = 8
"""Nodes of an element, and Gauss points: (i, j, k) → i + 2 j + 4 k, k along the thickness."""
POINTS = 8
UNKNOWNS = 3 * NODES


_SIGN = np.array([[i, j, k] for k, j, i in itertools.product((-1.0, 1.0), repeat=3)])
_AT = _SIGN / math.sqrt(3.0)


def _local_gradients() -> np.ndarray:
    """Derivatives (8 points, 8 nodes, 3) of the shape functions by ξ, η, ζ."""
    factor = 1.0 + _AT[:, None, :] * _SIGN[None, :, :]
    out = np.empty((POINTS, NODES, 3))
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        out[..., axis] = 0.125 * _SIGN[None, :, axis] * factor[..., others].prod(axis=-1)
    return out


class Bricks(NamedTuple):
    """Elements (E) of a mesh with 2 × 2 × 2 Gauss points.

    cells (E, 8): node numbers; gradient (E, 8 points, 8 nodes, 3): of the shape functions in 1/m;
    weight (E, 8): volume of the points in m³.
    """

    cells: np.ndarray
    gradient: np.ndarray
    weight: np.ndarray

    def only(self, index: np.ndarray) -> Bricks:
        """The elements of an index."""
        return Bricks(*(np.ascontiguousarray(array[index]) for array in self))


def reference_bricks(nodes: np.ndarray, cells: np.ndarray) -> Bricks:
    """Operators of cells (E, 8) on nodes (N, 3) in m. Raises ValueError for elements inside out."""
    local = _local_gradients()
    jacobian = np.einsum("eni,pnj->epij", nodes[cells], local, optimize=True)
    volume = np.linalg.det(jacobian)
    if volume.min() <= 0.0:
        raise ValueError(f"{int((volume.min(axis=1) <= 0).sum())} elements are inside out")
    local[..., 2] = 0.125 * _SIGN[:, 2]
    jacobian = np.einsum("eni,pnj->epij", nodes[cells], local, optimize=True)
    gradient = np.einsum("pnj,epji->epni", local, np.linalg.inv(jacobian), optimize=True)
    return Bricks(np.ascontiguousarray(cells), np.ascontiguousarray(gradient), volume)


@njit(cache=True, fastmath=True, inline="always")
def _deformation(xe, gradient, f):
    """F (3, 3) of an element with nodes at xe (8, 3); gradient (8, 3)."""
    for i in range(3):
        for j in range(3):
            f[i, j] = 0.0
    for a in range(NODES):
        for i in range(3):
            for j in range(3):
                f[i, j] += xe[a, i] * gradient[a, j]


@njit(cache=True, fastmath=True, inline="always")
def _cofactor(f, c):
    """Cofactors (3, 3), J F^(−T), of F; returns J."""
    c[0, 0] = f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1]
    c[0, 1] = f[1, 2] * f[2, 0] - f[1, 0] * f[2, 2]
    c[0, 2] = f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0]
    c[1, 0] = f[0, 2] * f[2, 1] - f[0, 1] * f[2, 2]
    c[1, 1] = f[0, 0] * f[2, 2] - f[0, 2] * f[2, 0]
    c[1, 2] = f[0, 1] * f[2, 0] - f[0, 0] * f[2, 1]
    c[2, 0] = f[0, 1] * f[1, 2] - f[0, 2] * f[1, 1]
    c[2, 1] = f[0, 2] * f[1, 0] - f[0, 0] * f[1, 2]
    c[2, 2] = f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    return f[0, 0] * c[0, 0] + f[0, 1] * c[0, 1] + f[0, 2] * c[0, 2]


@njit(cache=True, fastmath=True)
def assemble(x, bricks, material, stiffness, force, tangent):
    """Add the internal force and, where `stiffness` is set, fill the tangent of each element.

    Returns the smallest J. x (N, 3) are positions; bricks and material as `Bricks` and `Stiffness`
    (with 6 components); force (N, 3) is added to; tangent (E, 24, 24).
    """
    cells, gradient, weight = bricks
    metric, slope, bulk = material
    stiffening = slope.shape[0] > 0
    smallest = 1e300
    xe = np.empty((NODES, 3))
    f = np.empty((3, 3))
    c = np.empty((3, 3))
    fh = np.empty((3, 3))
    g = np.empty((POINTS, NODES, 3))
    jac = np.empty(POINTS)
    tau = np.empty((POINTS, 6))
    trace = np.empty(POINTS)
    strain = np.empty((POINTS, 6))
    volume_gradient = np.empty(UNKNOWNS)
    fe = np.empty((NODES, 3))
    b_rows = np.zeros((6 * POINTS, UNKNOWNS))
    db_rows = np.empty((6 * POINTS, UNKNOWNS))
    d = np.zeros((6, 6))
    plain = np.empty((3 * POINTS, NODES))
    stressed = np.empty((3 * POINTS, NODES))
    for e in range(cells.shape[0]):
        for a in range(NODES):
            for i in range(3):
                xe[a, i] = x[cells[e, a], i]
        reference = 0.0
        volume = 0.0
        for p in range(POINTS):
            _deformation(xe, gradient[e, p], f)
            j = _cofactor(f, c)
            jac[p] = j
            if j < smallest:
                smallest = j
            if j <= 0.0:
                return j
            inverse = 1.0 / j
            for a in range(NODES):
                g0 = gradient[e, p, a, 0]
                g1 = gradient[e, p, a, 1]
                g2 = gradient[e, p, a, 2]
                for i in range(3):
                    g[p, a, i] = (c[i, 0] * g0 + c[i, 1] * g1 + c[i, 2] * g2) * inverse
            h = metric[e, p]
            for i in range(3):
                fh[i, 0] = f[i, 0] * h[0] + f[i, 1] * h[3] + f[i, 2] * h[5]
                fh[i, 1] = f[i, 0] * h[3] + f[i, 1] * h[1] + f[i, 2] * h[4]
                fh[i, 2] = f[i, 0] * h[5] + f[i, 1] * h[4] + f[i, 2] * h[2]
            q = j ** (-2.0 / 3.0)
            b0 = q * (fh[0, 0] * f[0, 0] + fh[0, 1] * f[0, 1] + fh[0, 2] * f[0, 2])
            b1 = q * (fh[1, 0] * f[1, 0] + fh[1, 1] * f[1, 1] + fh[1, 2] * f[1, 2])
            b2 = q * (fh[2, 0] * f[2, 0] + fh[2, 1] * f[2, 1] + fh[2, 2] * f[2, 2])
            tr = b0 + b1 + b2
            trace[p] = tr
            tau[p, 0] = b0 - tr / 3.0
            tau[p, 1] = b1 - tr / 3.0
            tau[p, 2] = b2 - tr / 3.0
            tau[p, 3] = q * (fh[0, 0] * f[1, 0] + fh[0, 1] * f[1, 1] + fh[0, 2] * f[1, 2])
            tau[p, 4] = q * (fh[1, 0] * f[2, 0] + fh[1, 1] * f[2, 1] + fh[1, 2] * f[2, 2])
            tau[p, 5] = q * (fh[0, 0] * f[2, 0] + fh[0, 1] * f[2, 1] + fh[0, 2] * f[2, 2])
            if stiffening:
                # dev(J^(−2/3) F Fᵀ): the change of tr C̄ with the strain is twice this.
                s0 = q * (f[0, 0] ** 2 + f[0, 1] ** 2 + f[0, 2] ** 2)
                s1 = q * (f[1, 0] ** 2 + f[1, 1] ** 2 + f[1, 2] ** 2)
                s2 = q * (f[2, 0] ** 2 + f[2, 1] ** 2 + f[2, 2] ** 2)
                third = (s0 + s1 + s2) / 3.0
                strain[p, 0] = s0 - third
                strain[p, 1] = s1 - third
                strain[p, 2] = s2 - third
                strain[p, 3] = q * (f[0, 0] * f[1, 0] + f[0, 1] * f[1, 1] + f[0, 2] * f[1, 2])
                strain[p, 4] = q * (f[1, 0] * f[2, 0] + f[1, 1] * f[2, 1] + f[1, 2] * f[2, 2])
                strain[p, 5] = q * (f[0, 0] * f[2, 0] + f[0, 1] * f[2, 1] + f[0, 2] * f[2, 2])
            reference += weight[e, p]
            volume += weight[e, p] * j
        pressure = bulk[e] * (volume / reference - 1.0)
        fe[:, :] = 0.0
        if stiffness:
            volume_gradient[:] = 0.0
        for p in range(POINTS):
            w = weight[e, p]
            jp = jac[p] * pressure
            t = tau[p]
            s0 = w * (t[0] + jp)
            s1 = w * (t[1] + jp)
            s2 = w * (t[2] + jp)
            s3 = w * t[3]
            s4 = w * t[4]
            s5 = w * t[5]
            for a in range(NODES):
                x0 = g[p, a, 0]
                x1 = g[p, a, 1]
                x2 = g[p, a, 2]
                y0 = s0 * x0 + s3 * x1 + s5 * x2
                y1 = s3 * x0 + s1 * x1 + s4 * x2
                y2 = s5 * x0 + s4 * x1 + s2 * x2
                fe[a, 0] += y0
                fe[a, 1] += y1
                fe[a, 2] += y2
                if stiffness:
                    plain[3 * p, a] = x0
                    plain[3 * p + 1, a] = x1
                    plain[3 * p + 2, a] = x2
                    stressed[3 * p, a] = y0
                    stressed[3 * p + 1, a] = y1
                    stressed[3 * p + 2, a] = y2
            if not stiffness:
                continue
            k = 2.0 / 3.0
            cc = k * trace[p] - 2.0 * jp
            mm = jp - 2.0 / 9.0 * trace[p]
            for i in range(3):
                for n in range(3):
                    d[i, n] = w * (mm - k * (t[i] + t[n]))
                    d[i, 3 + n] = d[3 + n, i] = -w * k * t[3 + n]
                    d[3 + i, 3 + n] = 0.0
                d[i, i] += w * cc
                d[3 + i, 3 + i] = 0.5 * w * cc
            if stiffening:
                factor = 2.0 * w * slope[e, p]
                for i in range(6):
                    for n in range(6):
                        d[i, n] += factor * strain[p, i] * strain[p, n]
            wj = w * jac[p]
            row = 6 * p
            for a in range(NODES):
                x0 = g[p, a, 0]
                x1 = g[p, a, 1]
                x2 = g[p, a, 2]
                u = 3 * a
                b_rows[row, u] = x0
                b_rows[row + 1, u + 1] = x1
                b_rows[row + 2, u + 2] = x2
                b_rows[row + 3, u] = x1
                b_rows[row + 3, u + 1] = x0
                b_rows[row + 4, u + 1] = x2
                b_rows[row + 4, u + 2] = x1
                b_rows[row + 5, u] = x2
                b_rows[row + 5, u + 2] = x0
                for i in range(6):
                    db_rows[row + i, u] = d[i, 0] * x0 + d[i, 3] * x1 + d[i, 5] * x2
                    db_rows[row + i, u + 1] = d[i, 1] * x1 + d[i, 3] * x0 + d[i, 4] * x2
                    db_rows[row + i, u + 2] = d[i, 2] * x2 + d[i, 4] * x1 + d[i, 5] * x0
                volume_gradient[u] += wj * x0
                volume_gradient[u + 1] += wj * x1
                volume_gradient[u + 2] += wj * x2
        for a in range(NODES):
            for i in range(3):
                force[cells[e, a], i] += fe[a, i]
        if not stiffness:
            continue
        ke = np.dot(b_rows.T, db_rows)
        geometric = np.dot(plain.T, stressed)
        factor = bulk[e] / reference
        for i in range(UNKNOWNS):
            for n in range(UNKNOWNS):
                ke[i, n] += factor * volume_gradient[i] * volume_gradient[n]
        for a in range(NODES):
            for n in range(NODES):
                value = geometric[a, n]
                for i in range(3):
                    ke[3 * a + i, 3 * n + i] += value
        tangent[e] = ke
    return smallest


@njit(cache=True, fastmath=True)
def strain_measures(x, bricks, c_bar, c_bar_inverse, jacobian):
    """C̄, its inverse (E, 8, 6) and J (E, 8) at the Gauss points, for node positions x (N, 3)."""
    cells, gradient, _ = bricks
    xe = np.empty((NODES, 3))
    f = np.empty((3, 3))
    c = np.empty((3, 3))
    for e in range(cells.shape[0]):
        for a in range(NODES):
            for i in range(3):
                xe[a, i] = x[cells[e, a], i]
        for p in range(POINTS):
            _deformation(xe, gradient[e, p], f)
            j = _cofactor(f, c)
            jacobian[e, p] = j
            q = max(j, 1e-3) ** (-2.0 / 3.0)
            # The inverse of FᵀF is cofᵀ cof/J²; cof is J F^(−T).
            r = 1.0 / (q * j * j)
            for n in range(6):
                i = n if n < 3 else (n - 3) % 3
                k = n if n < 3 else (1 if n == 3 else 2)
                if n == 5:
                    i = 0
                total = 0.0
                other = 0.0
                for m in range(3):
                    total += f[m, i] * f[m, k]
                    other += c[m, i] * c[m, k]
                c_bar[e, p, n] = q * total
                c_bar_inverse[e, p, n] = r * other


@njit(cache=True, fastmath=True)
def first_invariant(x, bricks):
    """tr C̄ (E, 8) at the Gauss points for node positions x (N, 3); 3 where J ≤ 0."""
    cells, gradient, weight = bricks
    found = np.full(weight.shape, 3.0)
    xe = np.empty((NODES, 3))
    f = np.empty((3, 3))
    c = np.empty((3, 3))
    for e in range(cells.shape[0]):
        for a in range(NODES):
            for i in range(3):
                xe[a, i] = x[cells[e, a], i]
        for p in range(POINTS):
            _deformation(xe, gradient[e, p], f)
            j = _cofactor(f, c)
            if j > 0.0:
                total = 0.0
                for i in range(3):
                    for k in range(3):
                        total += f[i, k] * f[i, k]
                found[e, p] = j ** (-2.0 / 3.0) * total
    return found
