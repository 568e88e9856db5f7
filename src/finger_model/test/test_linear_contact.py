# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Linear contact against the full order at small strain, and its laws of scale; linear shear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from finger_model.fem.full_order import FullOrderModel
from finger_model.fem.linear_contact import LinearContact
from finger_model.fem.linear_shear import LinearShear
from finger_model.fem.mesh import EPIDERMIS, finger_mesh, similar_mesh
from finger_model.geometry import Geometry
from finger_model.laws import StandardLinearSolid

GEOMETRY = Geometry()
MATERIAL = StandardLinearSolid(E0=60e3, E1=30e3, tau1=0.1, E2=1200e3, friction=0.0)


@pytest.mark.parametrize(("share", "step"), [(1.0, 1e-9), (1.0 / 3.0, 1e7)])
def test_it_is_the_full_order_at_small_strain(share: float, step: float) -> None:
    mesh = similar_mesh(GEOMETRY)
    full = FullOrderModel(GEOMETRY, mesh=mesh, elasticity="small-strain").start(MATERIAL)
    curve = LinearContact(GEOMETRY).curves([MATERIAL], [share])[0]
    length = GEOMETRY.pad_semi_axis_radial
    for count, force in enumerate((0.2, 0.6, 1.2), start=1):
        point = full.step(count * step, force)
        x = np.log(force / (MATERIAL.instantaneous_modulus * share * length**2)) / 3.0
        area, depth = (np.exp(np.interp(x, curve[:, 0], curve[:, i])) for i in (1, 2))
        assert length**2 * area == pytest.approx(point.area, rel=0.2)
        assert length * depth == pytest.approx(point.indentation, rel=0.02)


def test_moduli_and_lengths_scale_out() -> None:
    base = LinearContact(GEOMETRY).curves([MATERIAL], [0.5])[0]
    doubled = {name: 2.0 * value for name, value in GEOMETRY.to_dict().items()}
    stiff = replace(MATERIAL, E0=3 * 60e3, E1=3 * 30e3, E2=3 * 1200e3, nail_modulus=3 * 170e6)
    found = LinearContact(Geometry(**doubled)).curves([stiff], [0.5])[0]
    np.testing.assert_allclose(found, base, rtol=1e-6)


def test_compliances_tell_meshes_apart_as_the_full_order_does() -> None:
    depths, ratios = [], []
    for change in ({}, {"epidermis_thickness": 0.6e-3}, {"bone_semi_axis_axial": 4.5e-3}):
        geometry = replace(GEOMETRY, **change)
        for share, step in ((1.0, 1e-9), (1.0 / 3.0, 1e7)):
            for mesh in (None, similar_mesh(geometry)):
                full = FullOrderModel(geometry, mesh=mesh, elasticity="small-strain")
                depths.append(full.start(MATERIAL).step(step, 0.3 * share).indentation)
            ratios.append(LinearContact(geometry).meshes([MATERIAL], [share])[0, 0])
    differences = -np.diff(np.log(depths).reshape(-1, 2))[:, 0]
    assert np.ptp(differences) > 0.01
    assert np.corrcoef(differences, ratios)[0, 1] > 0.95


def test_spacings_are_those_of_the_default_mesh() -> None:
    along, through = LinearContact(GEOMETRY).meshes([MATERIAL], [1.0])[0, 1:]
    mesh = finger_mesh(GEOMETRY)
    skin = mesh.nodes[mesh.surface]
    length = GEOMETRY.pad_semi_axis_radial
    assert along == pytest.approx(skin[1, 0] / length)
    layers = GEOMETRY.epidermis_thickness / (through * length)
    assert layers == pytest.approx(round(layers))
    assert np.sum(mesh.part == EPIDERMIS) == round(layers) * (len(skin) - 1)


def test_shear_of_a_small_contact_is_that_of_a_disc_on_a_half_space() -> None:
    # 8 G a/(2 − ν): Mindlin 1949. The bone is behind, and lets the finger move a little more.
    geometry = Geometry(8e-3, 8e-3, 0.5e-3, 5e-3, 5e-3, 0.0, 7e-3)
    soft = replace(MATERIAL, E2=MATERIAL.E0)
    radius, stiffness = LinearShear(geometry).curve(soft)[:3].T
    shear, ratio = soft.instantaneous_shear_modulus, soft.poisson_ratio_bulk
    assert stiffness == pytest.approx(8.0 * shear * radius / (2.0 - ratio), rel=0.1)


def test_shear_scales_with_moduli_and_lengths() -> None:
    radius, stiffness = LinearShear(GEOMETRY).curve(MATERIAL).T
    doubled = {name: 2.0 * value for name, value in GEOMETRY.to_dict().items()}
    stiff = replace(MATERIAL, E0=3 * 60e3, E1=3 * 30e3, E2=3 * 1200e3, nail_modulus=3 * 170e6)
    found = LinearShear(Geometry(**doubled)).curve(stiff)
    np.testing.assert_allclose(found.T, [2.0 * radius, 6.0 * stiffness], rtol=1e-6)
    assert np.all(np.diff(stiffness) > 0.0)
