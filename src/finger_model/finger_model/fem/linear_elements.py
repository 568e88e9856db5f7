# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled kernels of the same element for linear elasticity: Hooke's law in one strain measure E.

With `finite`, E is Green–Lagrange's strain and the stress that of Piola and Kirchhoff (St
Venant–Kirchhoff); without it, E is the small strain, and forces are taken on the undeformed shape.
H of a step is read as at small strain: the stress is K ē 1 + dev H + ⅔ tr H dev E, with ē the mean
of tr E over the element, so that nearly incompressible tissue does not lock.
"""

from __future__ import annotations

import numpy as np

from ..compiled import njit
from .elements import SHAPE, add_to_band, deformation, take_places


@njit(cache=True, inline="always")
def _strain(f, finite):
    """E (rr, zz, θθ, rz) of a deformation gradient."""
    if finite:
        return (
            0.5 * (f.rr * f.rr + f.zr * f.zr - 1.0),
            0.5 * (f.rz * f.rz + f.zz * f.zz - 1.0),
            0.5 * (f.hoop * f.hoop - 1.0),
            0.5 * (f.rr * f.rz + f.zr * f.zz),
        )
    return f.rr - 1.0, f.zz - 1.0, f.hoop - 1.0, 0.5 * (f.rz + f.zr)


@njit(cache=True)
def assemble(x, elements, material, finite, stiffness, force, band):
    """Add the internal force and, where `stiffness` is set, the lower band of the tangent.

    Arguments as those of `elements.assemble`. Returns the smallest J, 1 for small strain.
    """
    cells, gradient, radius, weight = elements
    metric, _, bulk = material
    smallest = 1e300 if finite else 1.0
    xr = np.empty(4)
    xz = np.empty(4)
    # ∂E/∂u (point, component, unknown); the fourth component is 2 E_rz.
    b = np.zeros((4, 4, 8))
    s = np.empty((4, 4))
    shear = np.empty(4)
    fe = np.empty(8)
    ke = np.empty((8, 8))
    d = np.empty((4, 8))
    volume_gradient = np.empty(8)
    for e in range(cells.shape[0]):
        take_places(x, cells[e], xr, xz)
        reference = 0.0
        volume_strain = 0.0
        for p in range(4):
            f = deformation(xr, xz, gradient, radius, e, p)
            frr, frz, fzr, fzz, hoop = 1.0, 0.0, 0.0, 1.0, 1.0
            if finite:
                plane = f.rr * f.zz - f.rz * f.zr
                smallest = min(smallest, plane * f.hoop)
                if plane <= 0.0 or f.hoop <= 0.0:
                    return min(plane, f.hoop)
                frr, frz, fzr, fzz, hoop = f.rr, f.rz, f.zr, f.zz, f.hoop
            for a in range(4):
                g0 = gradient[e, p, a, 0]
                g1 = gradient[e, p, a, 1]
                b[p, 0, 2 * a] = frr * g0
                b[p, 0, 2 * a + 1] = fzr * g0
                b[p, 1, 2 * a] = frz * g1
                b[p, 1, 2 * a + 1] = fzz * g1
                b[p, 2, 2 * a] = hoop * SHAPE[p, a] / radius[e, p]
                b[p, 3, 2 * a] = frr * g1 + frz * g0
                b[p, 3, 2 * a + 1] = fzr * g1 + fzz * g0
            err, ezz, ett, erz = _strain(f, finite)
            mean = (err + ezz + ett) / 3.0
            third = (metric[e, p, 0] + metric[e, p, 1] + metric[e, p, 2]) / 3.0
            shear[p] = third
            s[p, 0] = metric[e, p, 0] - third + 2.0 * third * (err - mean)
            s[p, 1] = metric[e, p, 1] - third + 2.0 * third * (ezz - mean)
            s[p, 2] = metric[e, p, 2] - third + 2.0 * third * (ett - mean)
            s[p, 3] = metric[e, p, 3] + 2.0 * third * erz
            reference += weight[e, p]
            volume_strain += weight[e, p] * 3.0 * mean
        pressure = bulk[e] * volume_strain / reference
        fe[:] = 0.0
        ke[:, :] = 0.0
        volume_gradient[:] = 0.0
        for p in range(4):
            w = weight[e, p]
            for i in range(3):
                s[p, i] += pressure
            for k in range(8):
                trace = b[p, 0, k] + b[p, 1, k] + b[p, 2, k]
                volume_gradient[k] += w * trace
                for i in range(4):
                    fe[k] += w * b[p, i, k] * s[p, i]
                for i in range(3):
                    d[i, k] = 2.0 * shear[p] * w * (b[p, i, k] - trace / 3.0)
                d[3, k] = shear[p] * w * b[p, 3, k]
            if not stiffness:
                continue
            for k in range(8):
                for m in range(k + 1):
                    for i in range(4):
                        ke[k, m] += b[p, i, k] * d[i, m]
            if not finite:
                continue
            for a in range(4):
                ra, za = gradient[e, p, a, 0], gradient[e, p, a, 1]
                for c in range(a + 1):
                    rc, zc = gradient[e, p, c, 0], gradient[e, p, c, 1]
                    value = w * (
                        ra * (s[p, 0] * rc + s[p, 3] * zc) + za * (s[p, 3] * rc + s[p, 1] * zc)
                    )
                    around = w * s[p, 2] * SHAPE[p, a] * SHAPE[p, c] / radius[e, p] ** 2
                    ke[2 * a, 2 * c] += value + around
                    ke[2 * a + 1, 2 * c + 1] += value
        for k in range(8):
            force[2 * cells[e, k // 2] + k % 2] += fe[k]
        if stiffness:
            add_to_band(cells[e], ke, bulk[e] / reference, volume_gradient, band)
    return smallest


@njit(cache=True)
def strain_measures(x, elements, finite, c_bar, c_bar_inverse, dilatation):
    """What a law sees as C̄ and its inverse (E, 4, 4), and tr E (E, 4); returns the smallest J.

    1 + 2e + ⅔ e:e 1, whose trace gives the energy G e:e, and 1 − 2e, with e = dev E.
    """
    cells, gradient, radius, _ = elements
    smallest = 1e300 if finite else 1.0
    xr = np.empty(4)
    xz = np.empty(4)
    for n in range(cells.shape[0]):
        take_places(x, cells[n], xr, xz)
        for p in range(4):
            f = deformation(xr, xz, gradient, radius, n, p)
            if finite:
                smallest = min(smallest, (f.rr * f.zz - f.rz * f.zr) * f.hoop)
            rr, zz, hoop, rz = _strain(f, finite)
            dilatation[n, p] = rr + zz + hoop
            mean = dilatation[n, p] / 3.0
            rr -= mean
            zz -= mean
            hoop -= mean
            energy = 2.0 / 3.0 * (rr * rr + zz * zz + hoop * hoop + 2.0 * rz * rz)
            c_bar[n, p, 0] = 1.0 + 2.0 * rr + energy
            c_bar[n, p, 1] = 1.0 + 2.0 * zz + energy
            c_bar[n, p, 2] = 1.0 + 2.0 * hoop + energy
            c_bar[n, p, 3] = 2.0 * rz
            c_bar_inverse[n, p, 0] = 1.0 - 2.0 * rr
            c_bar_inverse[n, p, 1] = 1.0 - 2.0 * zz
            c_bar_inverse[n, p, 2] = 1.0 - 2.0 * hoop
            c_bar_inverse[n, p, 3] = -2.0 * rz
    return smallest
