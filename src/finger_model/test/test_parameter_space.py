# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The parameter space: vectors, coordinates, derived quantities, moisture; the paper's facts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_model import paper
from finger_model.laws import StandardLinearSolid
from finger_model.laws.space import DerivedQuantity, ParameterSpace, ParameterSpec
from finger_model.laws.standard_linear_solid import PARAMETERS
from finger_model.parameter_sets import ParameterSets

NATURAL = PARAMETERS.vector(paper.NATURAL.parameters)
LOOK = {"unit": "", "meaning": "A number.", "display_unit": "", "display_factor": 1.0}


@pytest.mark.parametrize("condition", paper.CONDITIONS.values(), ids=lambda c: c.name)
def test_the_study_truth_has_the_printed_composite_modulus(condition) -> None:
    vector = PARAMETERS.vector(condition.parameters)
    assert PARAMETERS.quantity("composite_E", vector) == pytest.approx(
        condition.composite_E, rel=1e-3
    )
    low, high = PARAMETERS.box.T
    assert np.all((low <= vector) & (vector <= high))


def test_the_shipped_parameter_file_holds_the_study_truth() -> None:
    for found in ParameterSets.default().sets:
        condition = paper.CONDITIONS[found.condition]
        assert (found.moisture, found.moisture_sd) == (condition.moisture, condition.moisture_sd)
        assert PARAMETERS.mapping(found.parameters) == condition.parameters


def test_vector_and_mapping_are_inverse_and_bad_values_are_named() -> None:
    assert PARAMETERS.mapping(NATURAL) == paper.NATURAL.parameters
    with pytest.raises(InputError, match=r"file\.yaml: key 'E1' is missing"):
        PARAMETERS.vector({"E0": 1.0}, "file.yaml")
    with pytest.raises(InputError, match="'tau1' is -1 s, a positive value"):
        PARAMETERS.vector({**paper.NATURAL.parameters, "tau1": -1.0})
    with pytest.raises(InputError, match="4 numbers are needed: E0, E1, tau1, E2"):
        PARAMETERS.checked([1.0, 2.0])
    for length in (3, 5):
        with pytest.raises(InputError, match="4 numbers are needed: E0, E1, tau1, E2"):
            StandardLinearSolid().with_vector(np.ones(length))
    with pytest.raises(InputError, match="'E7' does not exist; known are E0"):
        PARAMETERS.index("E7")


def test_coordinates_and_correction_coordinates_come_back() -> None:
    rng = np.random.default_rng(1)
    low, high = PARAMETERS.to_log(PARAMETERS.box.T)
    vectors = PARAMETERS.from_log(low + rng.random((50, 4)) * (high - low))
    assert np.all((vectors >= low) & (vectors <= np.exp(high)))
    again = PARAMETERS.from_correction_coordinates(PARAMETERS.correction_coordinates(vectors))
    assert np.allclose(again, vectors, rtol=1e-12)
    composite, E0, tau1, E2 = PARAMETERS.correction_coordinates(NATURAL)
    assert np.exp(composite) == pytest.approx(19.27e3, rel=1e-3)
    assert np.allclose(np.exp([E0, tau1, E2]), NATURAL[[0, 2, 3]])


def test_a_derived_quantity_is_set_through_its_parameter() -> None:
    found = PARAMETERS.with_quantity("composite_E", NATURAL, 20e3)
    assert PARAMETERS.quantity("composite_E", found) == pytest.approx(20e3)
    assert np.all(found[[0, 2, 3]] == NATURAL[[0, 2, 3]])
    assert np.isnan(PARAMETERS.with_quantity("composite_E", NATURAL, 141e3)[1])
    E0, E1 = NATURAL[:2]
    gradient = PARAMETERS.log_gradient("composite_E", NATURAL)
    assert np.allclose(gradient, [E1 / (E0 + E1), E0 / (E0 + E1), 0, 0], atol=1e-8)
    low, high = PARAMETERS.quantity_bounds("composite_E")
    assert (low, high) == pytest.approx((1 / (1 / 50e3 + 1 / 15e3), 1 / (1 / 160e3 + 1 / 60e3)))


def test_a_parameter_that_may_be_zero_has_a_coordinate_there() -> None:
    space = ParameterSpace(
        [
            ParameterSpec("G", symbol="G∞", **LOOK),
            ParameterSpec("b", symbol="b", log_offset=0.1, **LOOK),
        ],
        derived=[DerivedQuantity("Gb", symbol="Gb", value=lambda v: v[..., 0] * v[..., 1], **LOOK)],
    )
    assert np.allclose(space.from_log(space.to_log([2.0, 0.0])), [2.0, 0.0])
    assert space.quantities(np.array([2.0, 3.0])) == {"G": 2.0, "b": 3.0, "Gb": 6.0}
    assert space["G"].html == "<i>G</i><sub>∞</sub>"
    with pytest.raises(InputError, match=r"'b' is -0\.2, zero or more is needed"):
        space.checked([1.0, -0.2])


@pytest.mark.parametrize(
    ("bounds", "sentence"),
    [
        ({}, "'k' are 0 … inf; give the lower one, then the higher one, both finite"),
        ({"bounds": (2.0, 0.5)}, "'k' are 2 … 0.5; give the lower one"),
        ({"bounds": (np.nan, 0.5)}, "'k' are nan … 0.5; give the lower one"),
        ({"bounds": (0.0, 2.0)}, "'k' are 0 … 2, but fits take logarithms; begin above zero"),
        ({"bounds": (0.5, 2.0), "range": (1.0, 3.0)}, "'k' are 0.5 … 2, beyond its range 1 … 3"),
    ],
)
def test_bounds_that_are_no_search_box_are_named(bounds: dict, sentence: str) -> None:
    space = ParameterSpace([ParameterSpec("k", symbol="k", **LOOK, **bounds)])
    with pytest.raises(InputError, match=f"parameters: the bounds of {sentence}"):
        _ = space.box


def test_between_two_moistures_coordinates_are_linear_and_the_ends_hold() -> None:
    moistures = np.array([30.0, 60.0])
    logs = PARAMETERS.to_log(np.array([NATURAL, 4 * NATURAL]))
    covariances = np.array([np.eye(4), 3 * np.eye(4)])
    vector, covariance, outside = PARAMETERS.interpolate(moistures, logs, covariances, 45.0)
    assert np.allclose(vector, 2 * NATURAL) and np.allclose(covariance, 2 * np.eye(4))
    assert not outside
    vector, _, outside = PARAMETERS.interpolate(moistures, logs, covariances, 70.0)
    assert np.allclose(vector, 4 * NATURAL) and outside


def test_the_theory_page_has_the_parameters_of_the_default_law() -> None:
    page = Path(__file__).resolve().parents[3] / "docs" / "theory.md"
    assert PARAMETERS.markdown() in page.read_text()
