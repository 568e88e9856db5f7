"""Small tables of nuisances and misfit: errors of a rig, and fingers that no model holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from finger_fit.options import FitOptions


@pytest.fixture(scope="module")
def script(module_of: Callable[[str], Any]) -> Any:
    return module_of("scripts/nuisance_table.py")


@pytest.fixture(scope="module")
def rows(script: Any) -> dict[str, dict]:
    """One seed of a few cases, with the finger's lengths known: their priors hide the rest."""
    cases = (
        "tare +0.05 N",
        "lag +80 ms",
        "published J, natural, three presses",
        "published J, natural, by images",
    )
    options = FitOptions(step=script.STEP, geometry_sd=[])
    return {case: script.fit_case(case, 0, {}, options) for case in cases}


def test_an_error_of_the_rig_does_not_move_e_out_of_its_interval(rows) -> None:
    for case, row in rows.items():
        found = row["composite_E"]
        assert found["covered"], case
        if not row["active"]:
            assert abs(found["error"]) < 2 * found["deviation"], case
    late = rows["lag +80 ms"]
    assert late["deviations"]["lag"] < 0.02, "the presses tell the lag"
    assert not late["tau1"]["covered_without"] or not late["composite_E"]["covered_without"]


def test_scatter_of_the_published_size_is_stated(rows, script) -> None:
    scatter = script.published_scatter("natural")
    assert 0.25 < scatter < 0.45, "gains of 30 to 40 %"
    few, many = rows["published J, natural, three presses"], rows["lag +80 ms"]
    assert few["scatter"] > 0.2 > 5 * many["scatter"]
    assert few["E2"]["deviation"] > 2 * many["E2"]["deviation"]
    seen = rows["published J, natural, by images"]
    assert seen["scatter"] > 0.2
    assert seen["noise"] < 0.5 * many["noise"], "frames tell areas better than the assumed noise"


def test_the_table_has_a_row_for_each_case(rows, script) -> None:
    text = script.table(list(rows.values()))
    for case in rows:
        assert f"| {case} |" in text
    assert "nan" not in text
    found = script.summary([rows["lag +80 ms"]])
    assert np.isfinite(found["bias"]) and found["coverage"] in (0.0, 1.0)


def test_curves_of_another_program_are_the_data(script) -> None:
    """The areas that are fitted go through the rows of CalculiX, within its scatter."""
    for name, curve in script.CURVES.items():
        table = script.reference(curve.file)
        force = table[curve.force]
        counted = force >= 0.1
        area = script.curve_area(curve, force)[counted] * 1e6
        np.testing.assert_allclose(area, table[curve.area][counted], rtol=0.015, err_msg=name)
        assert curve.target <= force.max(), "the curve holds the whole loading"
        model, truth = script.finger_of("natural", script.MISFITS[name][1])
        assert script.SPACE.quantity("composite_E", truth) == pytest.approx(curve.modulus)
        assert model.material.friction == curve.friction
    assert script.curve_area(curve, np.zeros(2)).tolist() == [0.0, 0.0]


def test_a_pad_of_larger_contact_is_read_as_a_softer_finger(script) -> None:
    """An area that another pad makes 10 % larger moves E, and the residuals do not tell."""
    case = "pad 1.3 times as long as wide, given width"
    answer = script.Response(np.array([0.5, 2.0]), np.array([[0.0, 0.0, 0.1]] * 2))
    options = FitOptions(step=script.STEP, geometry_sd=[])
    row = script.fit_case(case, 0, {"shape": answer}, options)
    assert row["composite_E"]["error"] < -0.1
    assert row["noise"] < 1.2 * script.TYPICAL_AREA_NOISE
    text = script.misfit_table([row])
    assert f"| {case} | 1 |" in text and "nan" not in text


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_another_pad_and_a_tilted_plate_change_the_area(script, monkeypatch) -> None:
    """By the three-dimensional model: a pad 1.3 times as long has more area, one that is narrower
    too has nearly the same, and a tilt of 20° moves the contact to where the pad is curved more."""
    monkeypatch.setattr(script, "LEVELS", np.array([0.3, 1.0]))
    script._solid.clear()
    material = replace(script.STUDY["natural"].material, friction=0.0)
    press = script.press("natural", 0)[0]
    base = script._solid_areas(press, material, script.Pose(), script.Geometry())
    longer, same, tilted = (
        script._solid_areas(press, material, *script.SHAPES[name]) / base
        for name in script.SHAPES if "10°" not in name
    )  # fmt: skip
    assert np.all((longer > 1.08) & (longer < 1.2))
    assert np.all(np.abs(same - 1.0) < 0.03)
    assert np.all(tilted != 1.0) and np.all(np.abs(tilted - 1.0) < 0.25)
    script._solid.clear()


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_fit_of_calculix_finds_its_moduli(script) -> None:
    """The finger of an independent program, corrected to full order."""
    row = script.fit_case("CalculiX", 0, {})
    for q in ("composite_E", "E2"):
        assert row[q]["covered"], q
    assert abs(row["composite_E"]["error"]) < 0.15
