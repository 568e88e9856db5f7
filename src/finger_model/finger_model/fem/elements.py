# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled kernels of the four-node axisymmetric element with mean dilatation.

Symbols as in docs/theory.md: F deformation gradient, J its determinant, θ mean dilatation of an
element, τ Kirchhoff stress, C̄ = J^(−2/3) FᵀF, H = 2 ∂W/∂C̄ for the isochoric energy W of the
current step. Symmetric tensors are stored as (rr, zz, θθ, rz). Forces and stiffness are per radian.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiled import njit

_POINT = 1.0 / math.sqrt(3.0)
_XI = np.array([[-_POINT, -_POINT], [_POINT, -_POINT], [_POINT, _POINT], [-_POINT, _POINT]])
_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
SHAPE = (
    0.25
    * (1 + _XI[:, None, 0] * _CORNERS[None, :, 0])
    * (1 + _XI[:, None, 1] * _CORNERS[None, :, 1])
)
"""Shape functions (4 points, 4 nodes) at the Gauss points."""


class Elements(NamedTuple):
    """Four-node elements of a mesh (E) with 2 × 2 Gauss points.

    cells (E, 4): node numbers; gradient (E, 4, 4, 2): of the shape functions at the points in 1/m;
    radius (E, 4): reference radius of the points in m; weight (E, 4): their volume in m³/rad.
    """

    cells: np.ndarray
    gradient: np.ndarray
    radius: np.ndarray
    weight: np.ndarray

    def only(self, index: slice | np.ndarray) -> Elements:
        """The elements of an index."""
        return Elements(*(np.ascontiguousarray(array[index]) for array in self))


class Stiffness(NamedTuple):
    """Material of one Newton iteration: W = w(C̄) + ½ K (θ − 1)², 2 ∂w/∂C̄ = H, ∂H = H' (1 : ∂C̄)
    1.

    metric (E, 4, 4): H in Pa; slope (E, 4), or (0, 0) where none is needed: H' in Pa; bulk (E,): K
    in Pa.
    """

    metric: np.ndarray
    slope: np.ndarray
    bulk: np.ndarray

    def only(self, index: slice | np.ndarray) -> Stiffness:
        """That of the elements of an index."""
        slope = self.slope[index] if self.slope.size else self.slope
        return Stiffness(self.metric[index], slope, self.bulk[index])


NO_SLOPE = np.zeros((0, 0))
"""H' of materials whose tensor H does not depend on the strain."""


def reference_elements(nodes: np.ndarray, cells: np.ndarray) -> Elements:
    """Operators of cells (E, 4) on nodes (N, 2) in m."""
    corner = 0.25 * np.stack(
        [
            _CORNERS[None, :, 0] * (1 + _XI[:, None, 1] * _CORNERS[None, :, 1]),
            _CORNERS[None, :, 1] * (1 + _XI[:, None, 0] * _CORNERS[None, :, 0]),
        ],
        axis=-1,
    )
    jacobian = np.einsum("eni,pnj->epij", nodes[cells], corner)
    gradient = np.einsum("pnj,epji->epni", corner, np.linalg.inv(jacobian))
    radius = np.einsum("en,pn->ep", nodes[cells, 0], SHAPE)
    weight = np.linalg.det(jacobian) * radius
    return Elements(np.ascontiguousarray(cells), np.ascontiguousarray(gradient), radius, weight)


class Deformation(NamedTuple):
    """Deformation gradient at a Gauss point, and the present radius r (m)."""

    rr: float
    rz: float
    zr: float
    zz: float
    hoop: float
    r: float


@njit(cache=True, fastmath=True, inline="always")
def take_places(x, nodes, xr, xz):
    """Radial and axial positions xr, xz (4,) of the nodes (4,) of an element, of x (N, 2)."""
    for a in range(4):
        xr[a] = x[nodes[a], 0]
        xz[a] = x[nodes[a], 1]


@njit(cache=True, fastmath=True, inline="always")
def deformation(xr, xz, gradient, radius, e, p):
    """F at Gauss point p of element e, whose nodes are at xr, xz (4,)."""
    rr = 0.0
    rz = 0.0
    zr = 0.0
    zz = 0.0
    r = 0.0
    for a in range(4):
        rr += xr[a] * gradient[e, p, a, 0]
        rz += xr[a] * gradient[e, p, a, 1]
        zr += xz[a] * gradient[e, p, a, 0]
        zz += xz[a] * gradient[e, p, a, 1]
        r += xr[a] * SHAPE[p, a]
    return Deformation(rr, rz, zr, zz, r / radius[e, p], r)


@njit(cache=True, fastmath=True, inline="always")
def _spatial_gradients(gradient, shape, f, plane, gr, gz, gt):
    """Radial, axial and hoop gradients gr, gz, gt (4,) of the shape functions in the deformed
    shape; gradient (4, 2) and values (4,) in the reference shape, plane: J without the hoop."""
    inverse = 1.0 / plane
    for a in range(4):
        g0 = gradient[a, 0]
        g1 = gradient[a, 1]
        gr[a] = (g0 * f.zz - g1 * f.zr) * inverse
        gz[a] = (g1 * f.rr - g0 * f.rz) * inverse
        gt[a] = shape[a] / f.r


@njit(cache=True, fastmath=True, inline="always")
def _deviatoric_stress(f, q, h, tau):
    """Kirchhoff stress τ (4,) without its volumetric part, dev b with b = q F H Fᵀ; returns tr b.

    q: J^(−2/3); h (4,): H.
    """
    brr = q * (f.rr * f.rr * h[0] + 2.0 * f.rr * f.rz * h[3] + f.rz * f.rz * h[1])
    bzz = q * (f.zr * f.zr * h[0] + 2.0 * f.zr * f.zz * h[3] + f.zz * f.zz * h[1])
    btt = q * f.hoop * f.hoop * h[2]
    trace = brr + bzz + btt
    tau[0] = brr - trace / 3.0
    tau[1] = bzz - trace / 3.0
    tau[2] = btt - trace / 3.0
    tau[3] = q * (f.rr * f.zr * h[0] + (f.rr * f.zz + f.rz * f.zr) * h[3] + f.rz * f.zz * h[1])
    return trace


@njit(cache=True, fastmath=True, inline="always")
def _deviatoric_strain(f, q, strain):
    """dev(q F Fᵀ) (4,), q being J^(−2/3): the change of tr C̄ with the strain is twice this."""
    srr = q * (f.rr * f.rr + f.rz * f.rz)
    szz = q * (f.zr * f.zr + f.zz * f.zz)
    stt = q * f.hoop * f.hoop
    third = (srr + szz + stt) / 3.0
    strain[0] = srr - third
    strain[1] = szz - third
    strain[2] = stt - third
    strain[3] = q * (f.rr * f.zr + f.rz * f.zz)


@njit(cache=True, fastmath=True, inline="always")
def _moduli(w, jp, trace, tau, d):
    """Upper half of the spatial moduli d (4, 4) times the volume w; jp: J times the pressure,
    trace: tr b."""
    k = 2.0 / 3.0
    c = k * trace - 2.0 * jp
    m = jp - 2.0 / 9.0 * trace
    d[0, 0] = w * (c + m - 2.0 * k * tau[0])
    d[1, 1] = w * (c + m - 2.0 * k * tau[1])
    d[2, 2] = w * (c + m - 2.0 * k * tau[2])
    d[0, 1] = w * (m - k * (tau[0] + tau[1]))
    d[0, 2] = w * (m - k * (tau[0] + tau[2]))
    d[1, 2] = w * (m - k * (tau[1] + tau[2]))
    d[0, 3] = d[1, 3] = d[2, 3] = -w * k * tau[3]
    d[3, 3] = w * 0.5 * c


@njit(cache=True, fastmath=True, inline="always")
def _add_force(w, j, jp, tau, gr, gz, gt, fe, volume_gradient):
    """Add a point's share of the element's force fe and of the gradient of its volume (8,)."""
    srr = tau[0] + jp
    szz = tau[1] + jp
    stt = tau[2] + jp
    srz = tau[3]
    for a in range(4):
        fe[2 * a] += w * (gr[a] * srr + gz[a] * srz + gt[a] * stt)
        fe[2 * a + 1] += w * (gr[a] * srz + gz[a] * szz)
        volume_gradient[2 * a] += w * j * (gr[a] + gt[a])
        volume_gradient[2 * a + 1] += w * j * gz[a]


@njit(cache=True, fastmath=True, inline="always")
def _add_stiffness(w, jp, tau, d, gr, gz, gt, ke):
    """Add a point's share of the lower half of the element's stiffness ke (8, 8): of the moduli d
    (4, 4), whose upper half is read, and of the stress."""
    wrr = w * (tau[0] + jp)
    wzz = w * (tau[1] + jp)
    wtt = w * (tau[2] + jp)
    wrz = w * tau[3]
    for a in range(4):
        ra = gr[a]
        za = gz[a]
        ta = gt[a]
        # Rows of BᵀD for the radial and the axial displacement of node a.
        u0 = ra * d[0, 0] + ta * d[0, 2] + za * d[0, 3]
        u1 = ra * d[0, 1] + ta * d[1, 2] + za * d[1, 3]
        u2 = ra * d[0, 2] + ta * d[2, 2] + za * d[2, 3]
        u3 = ra * d[0, 3] + ta * d[2, 3] + za * d[3, 3]
        v0 = za * d[0, 1] + ra * d[0, 3]
        v1 = za * d[1, 1] + ra * d[1, 3]
        v2 = za * d[1, 2] + ra * d[2, 3]
        v3 = za * d[1, 3] + ra * d[3, 3]
        for b in range(a + 1):
            rb = gr[b]
            zb = gz[b]
            tb = gt[b]
            geometric = ra * (wrr * rb + wrz * zb) + za * (wrz * rb + wzz * zb)
            ke[2 * a, 2 * b] += u0 * rb + u2 * tb + u3 * zb + geometric + ta * tb * wtt
            ke[2 * a, 2 * b + 1] += u1 * zb + u3 * rb
            ke[2 * a + 1, 2 * b] += v0 * rb + v2 * tb + v3 * zb
            ke[2 * a + 1, 2 * b + 1] += v1 * zb + v3 * rb + geometric


@njit(cache=True, fastmath=True, inline="always")
def add_to_band(nodes, ke, factor, volume_gradient, band):
    """Add an element's stiffness ke (8, 8), of which the lower half is read, and factor times the
    square of the gradient of its volume (8,) to the lower band of the tangent."""
    for i in range(8):
        row = 2 * nodes[i // 2] + i % 2
        for k in range(i + 1):
            column = 2 * nodes[k // 2] + k % 2
            value = ke[i, k] + factor * volume_gradient[i] * volume_gradient[k]
            band[min(row, column), abs(row - column)] += value


@njit(cache=True, fastmath=True)
def assemble(x, elements, material, stiffness, force, band):
    """Add the internal force and, where `stiffness` is set, the lower band of the tangent.

    Returns the smallest J. x (N, 2) are positions; elements and material as `Elements` and
    `Stiffness`; force (2N,) and band (2N, b+1) (band[j, i−j] = K[i, j]) are added to.
    """
    cells, gradient, radius, weight = elements
    metric, slope, bulk = material
    stiffening = slope.shape[0] > 0
    smallest = 1e300
    xr = np.empty(4)
    xz = np.empty(4)
    gr = np.empty((4, 4))
    gz = np.empty((4, 4))
    gt = np.empty((4, 4))
    jac = np.empty(4)
    tau = np.empty((4, 4))
    trace = np.empty(4)
    strain = np.empty((4, 4))
    volume_gradient = np.empty(8)
    fe = np.empty(8)
    ke = np.empty((8, 8))
    d = np.empty((4, 4))
    for e in range(cells.shape[0]):
        take_places(x, cells[e], xr, xz)
        reference = 0.0
        volume = 0.0
        for p in range(4):
            f = deformation(xr, xz, gradient, radius, e, p)
            plane = f.rr * f.zz - f.rz * f.zr
            if plane <= 0.0 or f.hoop <= 0.0:
                return min(plane, f.hoop)
            j = plane * f.hoop
            jac[p] = j
            smallest = min(smallest, j)
            _spatial_gradients(gradient[e, p], SHAPE[p], f, plane, gr[p], gz[p], gt[p])
            q = j ** (-2.0 / 3.0)
            trace[p] = _deviatoric_stress(f, q, metric[e, p], tau[p])
            if stiffening:
                _deviatoric_strain(f, q, strain[p])
            reference += weight[e, p]
            volume += weight[e, p] * j
        pressure = bulk[e] * (volume / reference - 1.0)
        fe[:] = 0.0
        ke[:, :] = 0.0
        volume_gradient[:] = 0.0
        for p in range(4):
            w = weight[e, p]
            jp = jac[p] * pressure
            _add_force(w, jac[p], jp, tau[p], gr[p], gz[p], gt[p], fe, volume_gradient)
            if not stiffness:
                continue
            _moduli(w, jp, trace[p], tau[p], d)
            if stiffening:
                factor = 2.0 * w * slope[e, p]
                for i in range(4):
                    for k in range(i, 4):
                        d[i, k] += factor * strain[p, i] * strain[p, k]
            _add_stiffness(w, jp, tau[p], d, gr[p], gz[p], gt[p], ke)
        for k in range(8):
            force[2 * cells[e, k // 2] + k % 2] += fe[k]
        if stiffness:
            add_to_band(cells[e], ke, bulk[e] / reference, volume_gradient, band)
    return smallest


@njit(cache=True, fastmath=True)
def strain_measures(x, elements, c_bar, c_bar_inverse, jacobian):
    """C̄, its inverse (E, 4, 4) and J (E, 4) at the Gauss points, for node positions x (N, 2)."""
    cells, gradient, radius, _ = elements
    xr = np.empty(4)
    xz = np.empty(4)
    for e in range(cells.shape[0]):
        take_places(x, cells[e], xr, xz)
        for p in range(4):
            f = deformation(xr, xz, gradient, radius, e, p)
            plane = f.rr * f.zz - f.rz * f.zr
            j = plane * f.hoop
            q = j ** (-2.0 / 3.0)
            crr = f.rr * f.rr + f.zr * f.zr
            czz = f.rz * f.rz + f.zz * f.zz
            crz = f.rr * f.rz + f.zr * f.zz
            inverse = 1.0 / (q * plane * plane)
            c_bar[e, p, 0] = q * crr
            c_bar[e, p, 1] = q * czz
            c_bar[e, p, 2] = q * f.hoop * f.hoop
            c_bar[e, p, 3] = q * crz
            c_bar_inverse[e, p, 0] = czz * inverse
            c_bar_inverse[e, p, 1] = crr * inverse
            c_bar_inverse[e, p, 2] = 1.0 / (q * f.hoop * f.hoop)
            c_bar_inverse[e, p, 3] = -crz * inverse
            jacobian[e, p] = j


@njit(cache=True, fastmath=True)
def first_invariant(x, elements):
    """tr C̄ (E, 4) at the Gauss points for node positions x (N, 2); 3 where J ≤ 0."""
    cells, gradient, radius, weight = elements
    found = np.full(weight.shape, 3.0)
    xr = np.empty(4)
    xz = np.empty(4)
    for e in range(cells.shape[0]):
        take_places(x, cells[e], xr, xz)
        for p in range(4):
            f = deformation(xr, xz, gradient, radius, e, p)
            j = (f.rr * f.zz - f.rz * f.zr) * f.hoop
            if j > 0.0:
                square = f.rr**2 + f.rz**2 + f.zr**2 + f.zz**2 + f.hoop**2
                found[e, p] = j ** (-2.0 / 3.0) * square
    return found


@njit(cache=True)
def band_rows(band, dofs, rows):
    """Copy full rows of the symmetric band matrix: rows[k, b + m] = K[dofs[k], dofs[k] + m]."""
    n, width = band.shape
    b = width - 1
    for k in range(dofs.shape[0]):
        i = dofs[k]
        for m in range(-b, b + 1):
            j = i + m
            if j < 0 or j >= n:
                rows[k, b + m] = 0.0
            elif j <= i:
                rows[k, b + m] = band[j, i - j]
            else:
                rows[k, b + m] = band[i, j - i]


@njit(cache=True)
def hold(band, dofs):
    """Replace rows and columns of the held unknowns by those of the unit matrix."""
    n, width = band.shape
    for k in range(dofs.shape[0]):
        i = dofs[k]
        for m in range(1, width):
            if i + m < n:
                band[i, m] = 0.0
            if i - m >= 0:
                band[i - m, m] = 0.0
        band[i, 0] = 1.0


@njit(cache=True)
def add_rows(rows, dofs, factors, out):
    """out (n,) += Σ factors[k] K[dofs[k], :]."""
    n = out.shape[0]
    b = rows.shape[1] // 2
    for k in range(dofs.shape[0]):
        if factors[k] != 0.0:
            for m in range(max(0, dofs[k] - b), min(n, dofs[k] + b + 1)):
                out[m] += factors[k] * rows[k, b + m - dofs[k]]


@njit(cache=True)
def rows_times(rows, dofs, vectors, out):
    """out[k, j] = K[dofs[k], :] · vectors[j] for vectors (m, n)."""
    n = vectors.shape[1]
    b = rows.shape[1] // 2
    for k in range(dofs.shape[0]):
        for j in range(vectors.shape[0]):
            total = 0.0
            for m in range(max(0, dofs[k] - b), min(n, dofs[k] + b + 1)):
                total += rows[k, b + m - dofs[k]] * vectors[j, m]
            out[k, j] = total


@njit(cache=True)
def copy_rows(rows, dofs, which, start, out):
    """out[k, :] = K[dofs[which[k]], start:]."""
    b = rows.shape[1] // 2
    for k in range(which.shape[0]):
        dof = dofs[which[k]]
        for m in range(max(start, dof - b), min(start + out.shape[1], dof + b + 1)):
            out[k, m - start] = rows[which[k], b + m - dof]


@njit(cache=True, fastmath=True)
def substitute_forward(band, start, x):
    """Solve L y = x in place for x (n − start, m); L[i, j] = band[j, i − j] from row `start`."""
    n, m = x.shape
    width = band.shape[1]
    for j in range(n):
        pivot = 1.0 / band[start + j, 0]
        for c in range(m):
            x[j, c] *= pivot
        for i in range(1, min(width, n - j)):
            factor = band[start + j, i]
            for c in range(m):
                x[j + i, c] -= factor * x[j, c]
