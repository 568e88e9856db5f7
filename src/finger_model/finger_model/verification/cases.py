# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bodies and materials of the verification."""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files

import numpy as np

from ..fem.full_order import FullOrderModel
from ..fem.mesh import BULK, Mesh, finger_mesh
from ..geometry import Geometry
from ..material import Material
from ..paper import CONDITIONS, TARGET_FORCE

ELASTIC = 1e9
"""E1 over E0 of a bulk written as elastic."""

STUDY = {name: Material(**condition.parameters) for name, condition in CONDITIONS.items()}
"""Materials of the study's conditions: dry, natural, moist."""

CALCULIX_FINGER = Geometry(
    pad_semi_axis_radial=8.5e-3,
    pad_semi_axis_axial=6.5e-3,
    epidermis_thickness=0.6e-3,
    bone_semi_axis_radial=3.5e-3,
    bone_semi_axis_axial=2.5e-3,
    bone_center_height=0.0,
    nail_radius=7.0e-3,
    nail_thickness=0.5e-3,
)
"""The finger of the CalculiX curves `dry_*.csv`; it need not be the default one."""

LOAD = TARGET_FORCE
"""N, at which presses of the verification end."""


def elastic(modulus: float, **others: float) -> Material:
    """Material with an elastic bulk of a modulus (Pa)."""
    return Material(E0=modulus, E1=ELASTIC * modulus, tau1=1.0, **others)


def long_term(material: Material) -> Material:
    """Elastic material with long-term shear modulus and bulk modulus of a viscoelastic one."""
    shear, bulk = material.long_term_shear_modulus, material.bulk_modulus
    modulus = 9.0 * bulk * shear / (3.0 * bulk + shear)
    ratio = (3.0 * bulk - 2.0 * shear) / (2.0 * (3.0 * bulk + shear))
    return replace(material, E0=modulus, E1=ELASTIC * modulus, poisson_ratio_bulk=ratio)


def sphere(radius: float = 10e-3, refinement: float = 1.0) -> FullOrderModel:
    """Half-ball held on its flat side, with a small rigid core.

    It is homogeneous where skin and bulk tissue have one modulus.
    """
    geometry = Geometry(
        pad_semi_axis_radial=radius,
        pad_semi_axis_axial=radius,
        epidermis_thickness=0.06 * radius,
        bone_semi_axis_radial=0.1 * radius,
        bone_semi_axis_axial=0.1 * radius,
        nail_thickness=0.0,
        nail_radius=0.0,
    )
    mesh = finger_mesh(geometry, refinement)
    fixed = mesh.fixed.copy()
    fixed[mesh.nodes[:, 1] > -1e-12] = True
    return FullOrderModel(geometry, refinement, replace(mesh, fixed=fixed))


def block(
    radius: float, height: float, across: int, along: int, distortion: float = 0.0
) -> FullOrderModel:
    """Cylinder z = −height … 0 of bulk tissue, its top held axially, free to spread, its lower face
    the skin.

    across, along: elements over height and radius; distortion: random shift of inner nodes in
    element sizes.
    """
    rows = np.linspace(0.0, -height, across + 1)
    columns = np.linspace(radius, 0.0, along + 1)
    nodes = np.array([(r, z) for r in columns for z in rows])
    inner = (
        (nodes[:, 0] > 0)
        & (nodes[:, 0] < radius)
        & (nodes[:, 1] < 0)
        & (nodes[:, 1] > -height * (1 - 1e-9))
    )
    shift = np.random.default_rng(1).uniform(-distortion, distortion, nodes.shape)
    nodes[inner] += (shift * [radius / along, height / across])[inner]
    width = across + 1
    cells = np.array(
        [
            (i * width + j, i * width + j + 1, (i + 1) * width + j + 1, (i + 1) * width + j)
            for i in range(along)
            for j in range(across)
        ]
    )
    corners = nodes[cells]
    r, z = corners[..., 0], corners[..., 1]
    area = np.sum(r * np.roll(z, -1, axis=1) - np.roll(r, -1, axis=1) * z, axis=1)
    cells[area < 0] = cells[area < 0][:, ::-1]
    fixed = np.zeros(nodes.shape, dtype=bool)
    fixed[nodes[:, 0] == 0.0, 0] = True
    fixed[nodes[:, 1] == 0.0, 1] = True
    surface = np.arange(along, -1, -1) * width + across
    mesh = Mesh(nodes, cells, np.full(len(cells), BULK), fixed, surface)
    return FullOrderModel(Geometry(), 1.0, mesh)


def reference(name: str) -> dict[str, np.ndarray]:
    """Columns of a reference curve in the package's data."""
    with files("finger_model").joinpath(f"data/verification/{name}.csv").open() as file:
        table = np.genfromtxt(file, delimiter=",", names=True)
    return {column: table[column] for column in table.dtype.names or ()}


def smooth_area(name: str, load: np.ndarray) -> np.ndarray:
    """Area (mm²) at loads (n,) in N of a reference curve: a cubic in log force and log area."""
    table = reference(name)
    fit = np.polyfit(np.log(table["force_N"]), np.log(table["area_mm2"]), 3)
    return np.exp(np.polyval(fit, np.log(load)))


def ramp(force: float, duration: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Times (steps + 1,) in s and forces (steps + 1,) in N of an even ramp from zero."""
    part = np.arange(steps + 1) / steps
    return duration * part, force * part
