"""Compiled kernels of the four-node axisymmetric element with mean dilatation.

Symbols as in docs/theory.md: F deformation gradient, J its determinant, θ mean dilatation of an element, τ
Kirchhoff stress, H the tensor of the isochoric energy ½ J^(−2/3) H : C of the current step. Symmetric tensors are
stored as (rr, zz, θθ, rz). Forces and stiffness are per radian.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_POINT = 1.0 / math.sqrt(3.0)
_XI = np.array([[-_POINT, -_POINT], [_POINT, -_POINT], [_POINT, _POINT], [-_POINT, _POINT]])
_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
SHAPE = (
    0.25
    * (1 + _XI[:, None, 0] * _CORNERS[None, :, 0])
    * (1 + _XI[:, None, 1] * _CORNERS[None, :, 1])
)
"""Shape functions (4 points, 4 nodes) at the Gauss points."""


def reference_operators(
    nodes: np.ndarray, cells: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gradients (E, 4, 4, 2) of the shape functions in 1/m, radius (E, 4) in m and weight (E, 4) in m³/rad."""
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
    return np.ascontiguousarray(gradient), radius, weight


@njit(cache=True, fastmath=True)
def assemble(x, cells, gradient, shape, radius, weight, metric, bulk, stiffness, force, band):
    """Internal force and, where `stiffness` is set, the lower band of the tangent; returns the smallest J.

    x (N, 2) positions; metric (E, 4, 4) the tensor H (Pa); bulk (E,) bulk modulus (Pa); force (2N,) and
    band (2N, b+1) (band[j, i−j] = K[i, j]) are overwritten.
    """
    force[:] = 0.0
    if stiffness:
        band[:, :] = 0.0
    smallest = 1e300
    xr = np.empty(4)
    xz = np.empty(4)
    gr = np.empty((4, 4))
    gz = np.empty((4, 4))
    gt = np.empty((4, 4))
    jac = np.empty(4)
    tau = np.empty((4, 4))
    trace = np.empty(4)
    volume_gradient = np.empty(8)
    fe = np.empty(8)
    ke = np.empty((8, 8))
    d = np.empty((4, 4))
    for e in range(cells.shape[0]):
        for a in range(4):
            xr[a] = x[cells[e, a], 0]
            xz[a] = x[cells[e, a], 1]
        reference = 0.0
        volume = 0.0
        for p in range(4):
            frr = 0.0
            frz = 0.0
            fzr = 0.0
            fzz = 0.0
            r = 0.0
            for a in range(4):
                frr += xr[a] * gradient[e, p, a, 0]
                frz += xr[a] * gradient[e, p, a, 1]
                fzr += xz[a] * gradient[e, p, a, 0]
                fzz += xz[a] * gradient[e, p, a, 1]
                r += xr[a] * shape[p, a]
            ftt = r / radius[e, p]
            plane = frr * fzz - frz * fzr
            j = plane * ftt
            jac[p] = j
            if j < smallest:
                smallest = j
            if plane <= 0.0 or ftt <= 0.0:
                return min(plane, ftt)
            inverse = 1.0 / plane
            for a in range(4):
                g0 = gradient[e, p, a, 0]
                g1 = gradient[e, p, a, 1]
                gr[p, a] = (g0 * fzz - g1 * fzr) * inverse
                gz[p, a] = (g1 * frr - g0 * frz) * inverse
                gt[p, a] = shape[p, a] / r
            hrr = metric[e, p, 0]
            hzz = metric[e, p, 1]
            htt = metric[e, p, 2]
            hrz = metric[e, p, 3]
            q = j ** (-2.0 / 3.0)
            brr = q * (frr * frr * hrr + 2.0 * frr * frz * hrz + frz * frz * hzz)
            bzz = q * (fzr * fzr * hrr + 2.0 * fzr * fzz * hrz + fzz * fzz * hzz)
            btt = q * ftt * ftt * htt
            brz = q * (frr * fzr * hrr + (frr * fzz + frz * fzr) * hrz + frz * fzz * hzz)
            tr = brr + bzz + btt
            trace[p] = tr
            tau[p, 0] = brr - tr / 3.0
            tau[p, 1] = bzz - tr / 3.0
            tau[p, 2] = btt - tr / 3.0
            tau[p, 3] = brz
            reference += weight[e, p]
            volume += weight[e, p] * j
        pressure = bulk[e] * (volume / reference - 1.0)
        fe[:] = 0.0
        ke[:, :] = 0.0
        volume_gradient[:] = 0.0
        for p in range(4):
            w = weight[e, p]
            jp = jac[p] * pressure
            t0 = tau[p, 0]
            t1 = tau[p, 1]
            t2 = tau[p, 2]
            t3 = tau[p, 3]
            s0 = t0 + jp
            s1 = t1 + jp
            s2 = t2 + jp
            for a in range(4):
                fe[2 * a] += w * (gr[p, a] * s0 + gz[p, a] * t3 + gt[p, a] * s2)
                fe[2 * a + 1] += w * (gr[p, a] * t3 + gz[p, a] * s1)
                volume_gradient[2 * a] += w * jac[p] * (gr[p, a] + gt[p, a])
                volume_gradient[2 * a + 1] += w * jac[p] * gz[p, a]
            if not stiffness:
                continue
            c = 2.0 / 3.0 * trace[p] - 2.0 * jp
            m = jp - 2.0 / 9.0 * trace[p]
            k = 2.0 / 3.0
            d[0, 0] = w * (c + m - 2.0 * k * t0)
            d[1, 1] = w * (c + m - 2.0 * k * t1)
            d[2, 2] = w * (c + m - 2.0 * k * t2)
            d[0, 1] = w * (m - k * (t0 + t1))
            d[0, 2] = w * (m - k * (t0 + t2))
            d[1, 2] = w * (m - k * (t1 + t2))
            shear = -w * k * t3
            d[3, 3] = w * 0.5 * c
            w0 = w * s0
            w1 = w * s1
            w2 = w * s2
            w3 = w * t3
            for a in range(4):
                ra = gr[p, a]
                za = gz[p, a]
                ta = gt[p, a]
                # Rows of BᵀD for the radial and the axial displacement of node a.
                u0 = ra * d[0, 0] + ta * d[0, 2] + za * shear
                u1 = ra * d[0, 1] + ta * d[1, 2] + za * shear
                u2 = ra * d[0, 2] + ta * d[2, 2] + za * shear
                u3 = (ra + ta) * shear + za * d[3, 3]
                v0 = za * d[0, 1] + ra * shear
                v1 = za * d[1, 1] + ra * shear
                v2 = za * d[1, 2] + ra * shear
                v3 = za * shear + ra * d[3, 3]
                for b in range(a + 1):
                    rb = gr[p, b]
                    zb = gz[p, b]
                    tb = gt[p, b]
                    geometric = ra * (w0 * rb + w3 * zb) + za * (w3 * rb + w1 * zb)
                    ke[2 * a, 2 * b] += u0 * rb + u2 * tb + u3 * zb + geometric + ta * tb * w2
                    ke[2 * a, 2 * b + 1] += u1 * zb + u3 * rb
                    ke[2 * a + 1, 2 * b] += v0 * rb + v2 * tb + v3 * zb
                    ke[2 * a + 1, 2 * b + 1] += v1 * zb + v3 * rb + geometric
        for a in range(4):
            force[2 * cells[e, a]] += fe[2 * a]
            force[2 * cells[e, a] + 1] += fe[2 * a + 1]
        if not stiffness:
            continue
        factor = bulk[e] / reference
        for a in range(4):
            for i in range(2):
                row = 2 * cells[e, a] + i
                for b in range(a + 1):
                    for j2 in range(2):
                        if b == a and j2 > i:
                            continue
                        column = 2 * cells[e, b] + j2
                        value = (
                            ke[2 * a + i, 2 * b + j2]
                            + factor * volume_gradient[2 * a + i] * volume_gradient[2 * b + j2]
                        )
                        if row >= column:
                            band[column, row - column] += value
                        else:
                            band[row, column - row] += value
    return smallest


@njit(cache=True, fastmath=True)
def strain_measures(x, cells, gradient, shape, radius, c_bar, c_bar_inverse, jacobian):
    """Isochoric right Cauchy–Green tensor, its inverse (E, 4, 4) and J (E, 4) at the Gauss points."""
    for e in range(cells.shape[0]):
        for p in range(4):
            frr = 0.0
            frz = 0.0
            fzr = 0.0
            fzz = 0.0
            r = 0.0
            for a in range(4):
                xr = x[cells[e, a], 0]
                xz = x[cells[e, a], 1]
                frr += xr * gradient[e, p, a, 0]
                frz += xr * gradient[e, p, a, 1]
                fzr += xz * gradient[e, p, a, 0]
                fzz += xz * gradient[e, p, a, 1]
                r += xr * shape[p, a]
            ftt = r / radius[e, p]
            plane = frr * fzz - frz * fzr
            j = plane * ftt
            q = j ** (-2.0 / 3.0)
            crr = frr * frr + fzr * fzr
            czz = frz * frz + fzz * fzz
            crz = frr * frz + fzr * fzz
            inverse = 1.0 / (q * plane * plane)
            c_bar[e, p, 0] = q * crr
            c_bar[e, p, 1] = q * czz
            c_bar[e, p, 2] = q * ftt * ftt
            c_bar[e, p, 3] = q * crz
            c_bar_inverse[e, p, 0] = czz * inverse
            c_bar_inverse[e, p, 1] = crr * inverse
            c_bar_inverse[e, p, 2] = 1.0 / (q * ftt * ftt)
            c_bar_inverse[e, p, 3] = -crz * inverse
            jacobian[e, p] = j


@njit(cache=True)
def band_rows(band, dofs, rows):
    """Copy the full rows of the symmetric band matrix: rows[k, b + m] = K[dofs[k], dofs[k] + m], |m| ≤ b."""
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
    """Solve L y = x in place for x (n − start, m), with L[i, j] = band[j, i − j] from row `start` on."""
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
def energies(weight, elastic, maxwell, bulk, jacobian, viscous0, inverse0, viscous1, inverse1):
    """Stored energy at the end of a step and energy dissipated in the tissue during it, in J/rad.

    viscous (E, 4, 4) is A, inverse (E, 4, 4) is C̄⁻¹, before (0) and after (1); jacobian (E, 4) after. The
    dissipation −∫ ∂W/∂A : dA is taken by the trapezoidal rule, ∂W/∂A = ½ G (C̄ − A⁻¹).
    """
    stored = 0.0
    dissipated = 0.0
    c0 = np.empty(4)
    c1 = np.empty(4)
    a0 = np.empty(4)
    a1 = np.empty(4)
    for e in range(weight.shape[0]):
        reference = 0.0
        volume = 0.0
        for p in range(4):
            w = weight[e, p]
            reference += w
            volume += w * jacobian[e, p]
            _inverse(inverse1[e, p], c1)
            stored += 0.5 * w * elastic[e] * (c1[0] + c1[1] + c1[2] - 3.0)
            if maxwell[e] > 0.0:
                _inverse(inverse0[e, p], c0)
                _inverse(viscous0[e, p], a0)
                determinant = _inverse(viscous1[e, p], a1)
                product = 0.0
                rate = 0.0
                for k in range(4):
                    double = 2.0 if k == 3 else 1.0
                    product += double * viscous1[e, p, k] * c1[k]
                    rate += (
                        double
                        * (c0[k] - a0[k] + c1[k] - a1[k])
                        * (viscous1[e, p, k] - viscous0[e, p, k])
                    )
                stored += 0.5 * w * maxwell[e] * (product - math.log(determinant) - 3.0)
                dissipated -= 0.25 * w * maxwell[e] * rate
        stored += 0.5 * bulk[e] * reference * (volume / reference - 1.0) ** 2
    return stored, dissipated
