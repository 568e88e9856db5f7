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
def _take_places(x, nodes, xe):
    """Positions xe (8, 3) of the nodes (8,) of an element, of x (N, 3)."""
    for a in range(NODES):
        for i in range(3):
            xe[a, i] = x[nodes[a], i]


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


@njit(cache=True, fastmath=True, inline="always")
def _spatial_gradients(gradient, c, j, g):
    """Gradients g (8, 3) of the shape functions in the deformed shape; gradient (8, 3) in the
    reference shape, c (3, 3): cofactors of F, j: J."""
    inverse = 1.0 / j
    for a in range(NODES):
        g0 = gradient[a, 0]
        g1 = gradient[a, 1]
        g2 = gradient[a, 2]
        for i in range(3):
            g[a, i] = (c[i, 0] * g0 + c[i, 1] * g1 + c[i, 2] * g2) * inverse


@njit(cache=True, fastmath=True, inline="always")
def _deviatoric(left, right, q, out):
    """dev(q left rightᵀ) (6,) of matrices (3, 3) whose product is symmetric; returns the trace of
    q left rightᵀ."""
    xx = q * (left[0, 0] * right[0, 0] + left[0, 1] * right[0, 1] + left[0, 2] * right[0, 2])
    yy = q * (left[1, 0] * right[1, 0] + left[1, 1] * right[1, 1] + left[1, 2] * right[1, 2])
    zz = q * (left[2, 0] * right[2, 0] + left[2, 1] * right[2, 1] + left[2, 2] * right[2, 2])
    trace = xx + yy + zz
    out[0] = xx - trace / 3.0
    out[1] = yy - trace / 3.0
    out[2] = zz - trace / 3.0
    out[3] = q * (left[0, 0] * right[1, 0] + left[0, 1] * right[1, 1] + left[0, 2] * right[1, 2])
    out[4] = q * (left[1, 0] * right[2, 0] + left[1, 1] * right[2, 1] + left[1, 2] * right[2, 2])
    out[5] = q * (left[0, 0] * right[2, 0] + left[0, 1] * right[2, 1] + left[0, 2] * right[2, 2])
    return trace


@njit(cache=True, fastmath=True, inline="always")
def _times_metric(f, h, fh):
    """F H (3, 3) of F (3, 3) and H (6,)."""
    for i in range(3):
        fh[i, 0] = f[i, 0] * h[0] + f[i, 1] * h[3] + f[i, 2] * h[5]
        fh[i, 1] = f[i, 0] * h[3] + f[i, 1] * h[1] + f[i, 2] * h[4]
        fh[i, 2] = f[i, 0] * h[5] + f[i, 1] * h[4] + f[i, 2] * h[2]


@njit(cache=True, fastmath=True, inline="always")
def _stressed_gradients(w, jp, tau, g, stressed):
    """Stress times the gradients g (8, 3) times the volume w: stressed (8, 3); jp: J times the
    pressure, tau (6,): Kirchhoff stress without its volumetric part."""
    sxx = w * (tau[0] + jp)
    syy = w * (tau[1] + jp)
    szz = w * (tau[2] + jp)
    sxy = w * tau[3]
    syz = w * tau[4]
    sxz = w * tau[5]
    for a in range(NODES):
        gx = g[a, 0]
        gy = g[a, 1]
        gz = g[a, 2]
        stressed[a, 0] = sxx * gx + sxy * gy + sxz * gz
        stressed[a, 1] = sxy * gx + syy * gy + syz * gz
        stressed[a, 2] = sxz * gx + syz * gy + szz * gz


@njit(cache=True, fastmath=True, inline="always")
def _moduli(w, jp, trace, tau, d):
    """Spatial moduli d (6, 6) times the volume w; jp, tau (6,): as in `_stressed_gradients`, trace:
    tr b with b = J^(−2/3) F H Fᵀ."""
    k = 2.0 / 3.0
    c = k * trace - 2.0 * jp
    m = jp - 2.0 / 9.0 * trace
    for i in range(3):
        for n in range(3):
            d[i, n] = w * (m - k * (tau[i] + tau[n]))
            d[i, 3 + n] = d[3 + n, i] = -w * k * tau[3 + n]
            d[3 + i, 3 + n] = 0.0
        d[i, i] += w * c
        d[3 + i, 3 + i] = 0.5 * w * c


@njit(cache=True, fastmath=True, inline="always")
def _strain_rows(g, d, b, db):
    """Rows b (6, 24) of B, strain over the displacements of the nodes, and db (6, 24) of D B; of b
    only what is not zero is written."""
    for a in range(NODES):
        gx = g[a, 0]
        gy = g[a, 1]
        gz = g[a, 2]
        u = 3 * a
        b[0, u] = gx
        b[1, u + 1] = gy
        b[2, u + 2] = gz
        b[3, u] = gy
        b[3, u + 1] = gx
        b[4, u + 1] = gz
        b[4, u + 2] = gy
        b[5, u] = gz
        b[5, u + 2] = gx
        for i in range(6):
            db[i, u] = d[i, 0] * gx + d[i, 3] * gy + d[i, 5] * gz
            db[i, u + 1] = d[i, 1] * gy + d[i, 3] * gx + d[i, 4] * gz
            db[i, u + 2] = d[i, 2] * gz + d[i, 4] * gy + d[i, 5] * gx


@njit(cache=True, fastmath=True, inline="always")
def _add_to_tangent(g, stressed, factor, volume_gradient, tangent):
    """Add to the tangent (24, 24) of an element what the stress gives, and factor times the square
    of the gradient of its volume (8, 3).

    g, stressed (points, 8, 3): gradients and what `_stressed_gradients` gives, of all points.
    """
    for a in range(NODES):
        for n in range(NODES):
            geometric = 0.0
            for p in range(POINTS):
                for i in range(3):
                    geometric += g[p, a, i] * stressed[p, n, i]
            for i in range(3):
                tangent[3 * a + i, 3 * n + i] += geometric
                for k in range(3):
                    product = volume_gradient[a, i] * volume_gradient[n, k]
                    tangent[3 * a + i, 3 * n + k] += factor * product


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
    d = np.zeros((6, 6))
    stressed = np.empty((POINTS, NODES, 3))
    b = np.zeros((6 * POINTS, UNKNOWNS))
    db = np.empty((6 * POINTS, UNKNOWNS))
    volume_gradient = np.empty((NODES, 3))
    for e in range(cells.shape[0]):
        _take_places(x, cells[e], xe)
        reference = 0.0
        volume = 0.0
        for p in range(POINTS):
            _deformation(xe, gradient[e, p], f)
            j = _cofactor(f, c)
            if j <= 0.0:
                return j
            jac[p] = j
            smallest = min(smallest, j)
            _spatial_gradients(gradient[e, p], c, j, g[p])
            _times_metric(f, metric[e, p], fh)
            q = j ** (-2.0 / 3.0)
            trace[p] = _deviatoric(fh, f, q, tau[p])
            if stiffening:
                # The change of tr C̄ with the strain is twice this.
                _deviatoric(f, f, q, strain[p])
            reference += weight[e, p]
            volume += weight[e, p] * j
        pressure = bulk[e] * (volume / reference - 1.0)
        for p in range(POINTS):
            _stressed_gradients(weight[e, p], jac[p] * pressure, tau[p], g[p], stressed[p])
            for a in range(NODES):
                for i in range(3):
                    force[cells[e, a], i] += stressed[p, a, i]
        if not stiffness:
            continue
        volume_gradient[:, :] = 0.0
        for p in range(POINTS):
            w = weight[e, p]
            _moduli(w, jac[p] * pressure, trace[p], tau[p], d)
            if stiffening:
                factor = 2.0 * w * slope[e, p]
                for i in range(6):
                    for n in range(6):
                        d[i, n] += factor * strain[p, i] * strain[p, n]
            _strain_rows(g[p], d, b[6 * p : 6 * p + 6], db[6 * p : 6 * p + 6])
            for a in range(NODES):
                for i in range(3):
                    volume_gradient[a, i] += w * jac[p] * g[p, a, i]
        np.dot(b.T, db, tangent[e])
        _add_to_tangent(g, stressed, bulk[e] / reference, volume_gradient, tangent[e])
    return smallest


@njit(cache=True, fastmath=True)
def strain_measures(x, bricks, c_bar, c_bar_inverse, jacobian):
    """C̄, its inverse (E, 8, 6) and J (E, 8) at the Gauss points, for node positions x (N, 3)."""
    cells, gradient, _ = bricks
    xe = np.empty((NODES, 3))
    f = np.empty((3, 3))
    c = np.empty((3, 3))
    for e in range(cells.shape[0]):
        _take_places(x, cells[e], xe)
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
        _take_places(x, cells[e], xe)
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
