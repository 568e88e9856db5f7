# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Parameter sets: interpolation over moisture, files, bad input."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_model.estimator import ContactEstimator
from finger_model.geometry import Geometry
from finger_model.laws import LAWS, StandardLinearSolid, parameter
from finger_model.parameter_sets import ParameterSet, ParameterSets
from finger_model.press_scatter import PressResiduals, PressScatter, press_scatter
from finger_model.reduced import ReducedModel

DRY = np.array([140e3, 38.56e3, 0.20, 1652e3])
NATURAL = np.array([80e3, 25.38e3, 0.50, 1795e3])


def test_at_a_fitted_moisture_the_set_itself_is_given() -> None:
    found = ParameterSets.default().interpolate(69.31)
    assert np.allclose(found.parameters, NATURAL, rtol=1e-12)
    assert not found.out_of_range


def test_half_way_the_geometric_mean_is_given() -> None:
    found = ParameterSets.default().interpolate((37.56 + 69.31) / 2)
    assert np.allclose(found.parameters, np.sqrt(DRY * NATURAL), rtol=1e-12)


@pytest.mark.parametrize(("moisture", "held"), [(5.0, DRY), (30.87, DRY)])
def test_outside_the_fitted_range_the_end_value_holds_with_a_flag(
    moisture: float, held: np.ndarray
) -> None:
    found = ParameterSets.default().interpolate(moisture)
    assert np.allclose(found.parameters, held, rtol=1e-12)
    assert found.out_of_range


@pytest.mark.parametrize("sd", [0.0, 5.0])
def test_a_reading_as_those_of_the_end_sets_trials_is_in_range(sd: float) -> None:
    """Half of them lie beyond the mean; a single reading errs by 3 a.u. itself."""
    reach = max(2.0 * sd, 3.0)
    one = ParameterSet("dry", 40.0, sd, tuple(DRY))
    two = ParameterSet("natural", 70.0, sd, tuple(NATURAL))
    for sets, low, high in (([one], 40.0, 40.0), ([one, two], 40.0, 70.0)):
        for moisture, held in ((low - reach, DRY), (high + reach, sets[-1].parameters)):
            found = ParameterSets(sets).interpolate(moisture)
            assert not found.out_of_range and np.allclose(found.parameters, held, rtol=1e-12)
            further = moisture + np.sign(moisture - low - 0.1) * 0.1
            assert ParameterSets(sets).interpolate(further).out_of_range


def test_sets_of_a_fit_that_is_not_final_are_doubted(tmp_path: Path) -> None:
    statuses = ("not final", "final", "not checked", "")
    sets = ParameterSets(
        [
            ParameterSet(f"c{i}", 10.0 * i, 1.0, tuple(DRY), (), status)
            for i, status in enumerate(statuses)
        ]
    )
    sets.save(tmp_path / "parameters.yaml")
    again = ParameterSets.load(tmp_path / "parameters.yaml")
    assert again.sets == sets.sets and again.hash == sets.hash
    assert again.doubt().startswith("the parameters of c0 are from a fit that is not final")
    assert not ParameterSets(sets.sets[1:]).doubt() and not ParameterSets.default().doubt()
    assert "status" not in ParameterSets.default().to_yaml()


@dataclass(frozen=True, kw_only=True)
class FiveParameters(StandardLinearSolid):
    """A law with one parameter more."""

    name = "five"
    CORRECTION = ()
    extra: float = parameter(
        0.0,
        "Stiffening; may be zero.",
        unit="",
        symbol="α",
        display_unit="",
        display_factor=1.0,
        log_offset=1.0,
    )


def test_sets_of_another_law_have_its_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LAWS, "_loaded", {"five": FiveParameters})
    first, second = (*DRY, 0.0), (*NATURAL, 3.0)
    sets = ParameterSets(
        [ParameterSet("a", 40.0, 1.0, first), ParameterSet("b", 60.0, 1.0, second)],
        law=FiveParameters,
    )
    sets.save(tmp_path / "parameters.yaml")
    again = ParameterSets.load(tmp_path / "parameters.yaml")
    assert again.law is FiveParameters
    assert again.hash == sets.hash
    found = again.interpolate(50.0)
    assert found.parameters[4] == pytest.approx(1.0)  # ln(1 + α) is half of ln 4
    assert np.allclose(found.parameters[:4], np.sqrt(DRY * NATURAL))
    assert found.covariance_log.shape == (5, 5)
    with pytest.raises(InputError, match=r"law 'five'.*'standard_linear_solid'"):
        ContactEstimator(ReducedModel.load(), again)


def test_the_default_law_is_not_named_in_the_file() -> None:
    assert "law" not in ParameterSets.default().to_yaml()


def test_a_saved_file_reads_back_bit_for_bit(tmp_path: Path) -> None:
    sets = ParameterSets.default()
    sets.save(tmp_path / "parameters.yaml")
    again = ParameterSets.load(tmp_path / "parameters.yaml")
    assert again.sets == sets.sets
    assert again.hash == sets.hash


def test_the_scatter_of_the_presses_is_kept_and_told(tmp_path: Path) -> None:
    """A file without it has the hash that it had."""
    default = ParameterSets.default()
    presses = PressScatter(9, 0.031, 0.006, 0.008)
    sets = ParameterSets(default.sets, presses=presses)
    sets.save(tmp_path / "parameters.yaml")
    again = ParameterSets.load(tmp_path / "parameters.yaml")
    assert again.presses == presses and again.hash == sets.hash
    plain = ParameterSets(default.sets)
    assert plain.hash != sets.hash and "presses" not in plain.to_yaml()
    assert again.of_finger(Geometry(pad_semi_axis_radial=9e-3)).presses == presses


@pytest.mark.parametrize(("sd", "drift"), [(0.0, 0.0), (0.03, 0.0), (0.08, 0.02)])
def test_residuals_tell_how_presses_differ(sd: float, drift: float) -> None:
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 3.0, 0.1)
    presses = []
    for _ in range(40):
        walk = drift * np.cumsum(rng.normal(size=len(time))) * 0.1**0.5
        left = sd * rng.normal() + walk + 0.025 * rng.normal(size=len(time))
        noise, log_force = np.full(len(time), 0.025), np.full(len(time), 0.1)
        presses.append(PressResiduals(time, left, noise, log_force))
    found = press_scatter(presses, 0.0)
    assert found is not None and found.number == 40
    assert found.sd == pytest.approx(max(sd, 0.01), rel=0.3)
    assert found.drift_sd == pytest.approx(drift, abs=0.004)
    assert press_scatter(presses[:3], 0.0) is None


_DEVIATIONS = "sd: 0.03, drift_sd: 0.006, slope_sd: 0.008"


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("E0: 140.0e+3", "E0: -1", "'E0'"),
        ("E0: 140.0e+3", "E0: 140.0", "set dry: 'E0' is 140 Pa"),
        ("tau1: 0.50,", "", "'tau1'"),
        ("moisture: 69.31,", "moisture: 37.56,", "same moisture"),
        ("moisture: 105.33,", "moisture: 131,", "130"),
        ("sets:", "groups:", "'sets'"),
        ("E2: 700.0e+3}", "E2: 700.0e+3, covariance_log: [1, 2]}", "covariance_log"),
        (
            "E2: 700.0e+3}",
            "E2: 700.0e+3, covariance_log: [[1, 2, 0, 0], [2, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, "
            "1]]}",
            "no covariance",
        ),
        ("E2: 700.0e+3}", "E2: 700.0e+3, friction: 0.9}", "unknown key 'friction'"),
        ("moisture_sd: 4.93", "moisture_sd: -3", "'moisture_sd' is -3"),
        ("\nsets:", "\nset_of: x\nsets:", "unknown key 'set_of'"),
        ("peak_sd: [0.147,", "peak_sd: [-0.1,", "deviation of 'prior' is negative"),
        ("peak_sd: [0.147,", "peak_sd: [", "'peak_sd' needs one number, or 5"),
        (
            "indentation_mean: [",
            "indentation_mean: [0, ",
            "'indentation_mean' needs one number, or",
        ),
        ("indentation_sd: [0.029,", "indentation_sd: [-0.1,", "deviation of 'prior' is negative"),
        ("walk_sd: 0.12", "walk_sd: -0.1", "deviation of 'prior' is negative"),
        ("\nsets:", "\npresses: 9\nsets:", "'presses' needs"),
        (
            "\nsets:",
            f"\npresses: {{number: 3, {_DEVIATIONS}}}\nsets:",
            "'number' of 'presses' is 3",
        ),
        ("\nsets:", f"\npresses: {{number: 9.5, {_DEVIATIONS}}}\nsets:", "is 9.5, a whole number"),
        ("\nsets:", f"\npresses: {{{_DEVIATIONS}}}\nsets:", "'number'"),
        (
            "\nsets:",
            "\npresses: {number: 9, sd: 0.03, drift_sd: -1, slope_sd: 0}\nsets:",
            "deviation of 'presses' is negative",
        ),
    ],
)
def test_a_bad_file_is_refused_with_the_place(
    tmp_path: Path, project_root: Path, old: str, new: str, named: str
) -> None:
    text = (project_root / "src/finger_model/finger_model/data/parameters.yaml").read_text()
    assert old in text
    path = tmp_path / "bad.yaml"
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=named) as caught:
        ParameterSets.load(path)
    assert "bad.yaml" in str(caught.value)
