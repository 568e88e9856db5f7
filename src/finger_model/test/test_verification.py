# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Every point of the verification page with its number (see docs/verification.md)."""

import pytest

from finger_model.verification import (
    fingers,
    frictions,
    homogeneous,
    numerics,
    page,
    pulled_spheres,
    solids,
    spheres,
    twisted_spheres,
)
from finger_model.verification.cases import reference
from finger_model.verification.check import Measure


def holds(check):
    """The check passes; otherwise say which numbers do not."""
    failing = [f"{m.what}: {m.value:g} ({m.limit()})" for m in check.measures if not m.passes]
    assert not failing, f"{check.title}: {failing}"
    return check


def test_patch_tests_to_rounding():
    holds(numerics.patch_tests())


def test_newton_converges_quadratically():
    holds(numerics.newton())


@pytest.mark.slow
def test_mesh_converges_and_default_mesh_is_within_1_percent():
    holds(numerics.space())


@pytest.mark.slow
def test_time_integration_is_of_second_order():
    holds(numerics.time_steps())


def test_hertz_within_2_percent_and_exponent_within_001():
    holds(spheres.hertz())


def test_lee_radok_within_2_percent():
    holds(spheres.lee_radok())


def test_lee_radok_of_three_branches_within_2_percent():
    holds(spheres.lee_radok_branches())


@pytest.mark.parametrize(
    ("mode", "law"),
    [
        ("uniaxial", "3 branches, stiffening 2"),
        ("simple shear", "4 branches, stiffening 5"),
        ("equibiaxial", "2 branches"),
    ],
)
def test_creep_and_relaxation_at_a_point_within_01_percent(mode, law):
    holds(homogeneous.points(400, (mode,), (law,)))


@pytest.mark.slow
def test_creep_and_relaxation_at_a_point_within_01_percent_in_every_mode():
    holds(homogeneous.points())


def test_creep_of_a_cylinder_within_01_percent():
    holds(homogeneous.cylinder(60, ("3 branches, stiffening 2",)))


@pytest.mark.slow
def test_creep_of_a_cylinder_within_01_percent_of_every_law():
    holds(homogeneous.cylinder())


def test_time_limits_within_01_percent_natural():
    check = holds(fingers.time_limits(("natural",)))
    # Both limits are neo-Hookean: no difference at the highest load either.
    assert check["natural: τ1 = 10⁻⁴ s against G∞, 1.35 N, difference of area"] < 0.1


@pytest.mark.slow
def test_time_limits_within_01_percent_of_all_sets():
    holds(fingers.time_limits())


def test_calculix_area_within_2_and_indentation_within_1_percent():
    check = holds(fingers.calculix())
    # Soft tissue under a thin, stiff skin: no limit on the page, but known.
    unlimited = [m for m in check.measures if "area difference" in m.what and m.high is None]
    assert all(abs(m.value) < 3 for m in unlimited)


def test_small_strain_is_that_of_calculix():
    holds(fingers.small_strain())


def test_energy_is_dissipated_and_balances_and_the_finger_returns_to_rest():
    holds(fingers.energy(steps=150))


def test_energy_of_three_branches_with_stiffening():
    holds(fingers.energy(steps=100, branches=True))


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.25])
def test_area_is_smooth_over_200_steps(friction):
    holds(fingers.smoothness(friction))


@pytest.mark.slow
def test_area_falls_and_force_rises_with_the_moduli():
    holds(fingers.monotonicity())


@pytest.mark.slow
def test_friction_makes_the_area_smaller_as_in_calculix():
    holds(frictions.effect_on_area())


def test_coulomb_law_holds_on_every_node():
    holds(frictions.coulomb())


def test_disc_on_a_rough_plane_within_2_percent():
    holds(frictions.disc())


def test_page_shows_every_number_and_marks_a_failure(tmp_path):
    check = frictions.disc()
    check.measures.append(Measure("impossible", 2.0, high=1.0))
    text = page.write_page([check], tmp_path).read_text()
    assert "**fails**" in text and "| impossible | 2 **fails** | ≤ 1 |" in text
    assert (tmp_path / "figures/verification_disc.png").stat().st_size > 10_000


@pytest.mark.slow
def test_three_dimensions_agree_with_two_within_1_percent():
    holds(solids.axisymmetric())


@pytest.mark.slow
def test_pulled_sphere_within_2_percent_of_cattaneo_mindlin():
    holds(pulled_spheres.cattaneo_mindlin())


@pytest.mark.slow
def test_twisted_sphere_within_2_percent_of_lubkin():
    holds(twisted_spheres.twisted())


def test_a_pull_begins_as_in_calculix():
    table = {name: column[1:4] for name, column in reference("shear_mu0.5").items()}
    points = solids.pulled(table["plate_shear_mm"] * 1e-3)
    for name, column, limit in (
        ("force", "normal_force_n", 0.02),
        ("tangential_x", "tangential_force_n", 0.02),
        ("area", "area_mm2", 0.03),
    ):
        found = [getattr(point, name) for point in points]
        expected = table[column] * (1e-6 if name == "area" else 1.0)
        assert found == pytest.approx(expected, rel=limit), name


@pytest.mark.slow
def test_pull_until_slip_within_2_percent_of_calculix():
    holds(solids.shear())


@pytest.mark.slow
@pytest.mark.parametrize("check", [solids.tilted, solids.elliptical])
def test_tilt_and_ellipse_within_3_percent_of_calculix(check):
    holds(check())
