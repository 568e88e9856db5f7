# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Linear elasticity as an option of the full-order model."""

import numpy as np
import pytest

from finger_common.cli import run
from finger_common.errors import InputError, ModelError
from finger_model.cli import _main
from finger_model.fem.elasticity import ELASTICITIES
from finger_model.fem.full_order import FullOrderModel
from finger_model.material import Material
from finger_model.verification.cases import block, elastic, ramp


def areas(elasticity, material=None, load=1.0):
    model = FullOrderModel(refinement=0.5, elasticity=elasticity)
    return model.simulate(material or elastic(30e3, E2=1652e3), *ramp(load, 1.0, 5)).area * 1e6


def bar(elasticity, squeeze):
    """Axial Cauchy stress (Pa) of a free bar, E = 30 kPa, ν = 0.3, squeezed by a fraction."""
    model = block(1e-2, 1e-2, 3, 3, distortion=0.2)
    model = FullOrderModel(model.geometry, 1.0, model.mesh, elasticity)
    stepper = model.start(elastic(30e3, friction=0.0, poisson_ratio_bulk=0.3))
    for k in range(1, 5):
        point = stepper.step_to_position(float(k), squeeze * 1e-2 * k / 4)
    return stepper.fields().stress, point.force / (np.pi * 1e-4)


def test_a_bar_follows_hooke_in_the_strain_of_its_elasticity():
    squeeze = 0.2
    stress, nominal = bar("small-strain", squeeze)
    assert nominal == pytest.approx(30e3 * squeeze, rel=1e-9)
    np.testing.assert_allclose(stress[:, 1], -30e3 * squeeze, rtol=1e-9)
    stress, nominal = bar("st-venant-kirchhoff", squeeze)
    stretch = 1.0 - squeeze
    green = 0.5 * (stretch**2 - 1.0)
    assert nominal == pytest.approx(-stretch * 30e3 * green, rel=1e-8)
    around = 1.0 - 2.0 * 0.3 * green
    np.testing.assert_allclose(stress[:, 1], stretch * 30e3 * green / around, rtol=1e-8)
    np.testing.assert_allclose(stress[:, [0, 2, 3]], 0.0, atol=1e-4)


def test_all_agree_at_small_load_and_part_at_larger():
    found = {name: areas(name, load=0.002)[-1] for name in ELASTICITIES}
    np.testing.assert_allclose(list(found.values()), found["neo-hooke"], rtol=0.03)
    large = {name: areas(name)[-1] for name in ("neo-hooke", "small-strain", "linear-epidermis")}
    assert large["small-strain"] != pytest.approx(large["neo-hooke"], rel=0.03)
    assert large["linear-epidermis"] != pytest.approx(large["neo-hooke"], rel=1e-3)


def test_st_venant_kirchhoff_breaks_down_in_compression_and_says_so():
    with pytest.raises(ModelError, match="no equilibrium at t"):
        areas("st-venant-kirchhoff")


def test_creep_of_linear_tissue_lies_between_its_elastic_limits():
    material = Material(E0=100e3, E1=43.33e3, tau1=0.3, E2=1652e3)
    soft, stiff = (
        areas("small-strain", Material(E0=100e3, E1=43.33e3, tau1=tau, E2=1652e3), 0.5)
        for tau in (1e-4, 1e4)
    )
    found = areas("small-strain", material, 0.5)
    assert np.all(stiff[1:] < found[1:]) and np.all(found[1:] < soft[1:])


def test_energy_of_a_finger_with_linear_epidermis_balances():
    model = FullOrderModel(refinement=0.5, elasticity="linear-epidermis")
    stepper = model.start(elastic(30e3, E2=1652e3, friction=0.0))
    for k in range(1, 31):
        stepper.step(k / 30, k / 30)
    assert stepper.state.stored == pytest.approx(stepper.state.work, rel=5e-3)


def test_an_unknown_elasticity_and_the_reduced_solver_end_with_one_sentence(tmp_path, capsys):
    with pytest.raises(InputError, match="the choices are neo-hooke, linear-epidermis"):
        FullOrderModel(elasticity="rubber")
    path = tmp_path / "f.csv"
    path.write_text("time_s,force_n\n0,0\n1,0.5\n")
    arguments = ["simulate", "--force", str(path), "--elasticity", "small-strain"]
    assert run(_main, [*arguments, "--solver", "reduced"]) == 2
    assert "--elasticity are of the full-order model: use" in capsys.readouterr().err
    assert run(_main, [*arguments, "--solver", "full"]) == 0
