# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The check of a fit against a better model, with the stand-in as the better one and a biased copy
as the reduced.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from finger_fit.engine import LocalEngine
from finger_fit.full_order import FullOrder, check, correct
from finger_fit.full_order.correction import shifted
from finger_fit.options import FitOptions
from finger_fit.problem import AreaCorrection, FitProblem
from finger_fit.report_units import MM4
from finger_fit.search import all_free, refine
from finger_fit.study.deformed import deformed_finger
from finger_model.fem.area_model import FullOrderAreas, thinned_rows
from finger_model.geometry import Geometry
from finger_model.laws import StandardLinearSolid
from finger_model.reduced import ReducedModel

PARAMETERS = StandardLinearSolid.PARAMETERS


@pytest.fixture
def biased(double):
    """A problem whose model is wrong by up to 3 %."""
    exact = double.make_problem()

    class Biased(double.HereditaryModel):
        def batch(self, parameters, trials):
            areas = super().batch(parameters, trials)
            return [a * (1.0 + 0.03 * np.cos(6.0 * t[1][t[2]])) for a, t in zip(areas, trials)]

    return FitProblem(exact.trials, Biased(), exact.options)


def test_correction_undoes_the_bias_of_the_reduced_model(biased, double) -> None:
    problem = biased
    plain = refine(problem, all_free(problem), double.TRUTH)
    before = abs(np.log(plain.parameters / double.TRUTH))
    passes: list[int] = []
    fit, correction = correct(problem, plain.parameters, double.Exact(), 4, passes.append)
    assert passes == [*range(1, correction.rounds + 1)]
    after = abs(np.log(fit.parameters / double.TRUTH))
    assert after.max() < 0.02 < before.max()
    assert fit.cost * MM4 < 0.05 < plain.cost * MM4
    assert correction.cost_before == pytest.approx(plain.cost)
    assert 0.02 < correction.largest_factor < 0.05


def test_correction_undoes_a_bias_that_changes_along_the_valley(double) -> None:
    """An error that depends on E0 as strongly as the area does: with the ratio at one point alone,
    a fit stays near its start.
    """
    exact = double.make_problem(options=FitOptions(window="contact"))

    class Biased(double.HereditaryModel):
        def batch(self, parameters, trials):
            tilt = np.log(np.atleast_2d(parameters)[:, :1] / 120e3)
            areas = super().batch(parameters, trials)
            return [
                a * (1.0 + 0.2 * tilt * np.sin(3.0 * t[0][t[2]])) for a, t in zip(areas, trials)
            ]

    problem = FitProblem(exact.trials, Biased(), exact.options)
    start = np.array([75e3, 30e3, 0.25, 1500e3])
    fit, _ = correct(problem, start, double.Exact(), rounds=4)
    np.testing.assert_allclose(fit.parameters, double.TRUTH, rtol=0.01)


@pytest.mark.parametrize(
    "parameters",
    [[160e3, 15e3, 0.01, 700e3], [50e3, 60e3, 0.8, 2200e3], [50e3, 15e3, 0.1, 1500e3]],
)
def test_shifted_sets_move_one_coordinate_each_and_stay_physical(parameters) -> None:
    points = shifted(PARAMETERS, np.array(parameters), PARAMETERS.box)
    assert (points > 0).all() and np.isfinite(points).all()
    places = PARAMETERS.correction_coordinates(points)
    moves = places[1:] - places[0]
    np.testing.assert_allclose(np.abs(np.diag(moves)), PARAMETERS.correction_steps)
    np.testing.assert_allclose(moves - np.diag(np.diag(moves)), 0.0, atol=1e-9)


def test_check_measures_the_raw_difference_and_names_what_is_not_final(biased, double) -> None:
    problem = biased
    fit = refine(problem, all_free(problem), double.TRUTH)
    other = fit.parameters * np.array([1.0, 1.1, 1.0, 1.0])
    found = check(problem, np.array([fit.parameters, other]), double.Exact())
    raw = problem.raw_areas(fit.parameters)[0]
    expected = np.sqrt(np.mean((found.areas[0] - raw) ** 2)) / found.areas[0].max()
    assert found.rms_difference == pytest.approx(expected)
    assert found.rms_difference > 0.01 and "differ" in found.reasons[0]
    flat = np.zeros((4, len(raw)))
    problem.correction = AreaCorrection(
        PARAMETERS, fit.parameters, np.log(found.areas[0] / raw), flat
    )
    again = check(problem, np.array([fit.parameters, other]), double.Exact())
    assert again.rms_difference == pytest.approx(found.rms_difference), "of the model itself"
    assert problem.cost(fit.parameters)[0] == pytest.approx(again.full_costs[0])


def test_re_ranking_that_moves_the_modulus_is_not_final(double) -> None:
    problem = double.make_problem()
    first = double.TRUTH * np.array([1.0, 1.05, 1.0, 1.0])

    found = check(problem, np.array([first, double.TRUTH]), double.Exact())
    expected = double.composite(double.TRUTH) / double.composite(first) - 1
    assert found.best == 1 and found.change == pytest.approx(abs(expected))
    assert any("re-ranking" in reason for reason in found.reasons)


def test_re_ranking_by_less_than_noise_is_final(double) -> None:
    """Two candidates that the data do not tell apart: full order prefers the other by chance."""
    problem = double.make_problem()
    first = double.TRUTH * np.array([1.0, 1.05, 1.0, 1.0])
    rng = np.random.default_rng(3)
    problem.measured = problem.measured + rng.normal(0.0, 30e-6, len(problem.measured))
    found = check(problem, np.array([first, double.TRUTH]), double.Exact())
    costs = found.full_costs
    freedom = len(problem.measured) - 4
    assert found.gain == pytest.approx((costs[0] / costs.min() - 1) * freedom)
    assert found.gain < 3.84 and not any("re-ranking" in reason for reason in found.reasons)


def test_thinned_drive_keeps_frames_and_step(double) -> None:
    trial = double.make_problem(trials=1).trials[0]
    steps = thinned_rows(trial.time, trial.force, trial.frames, 0.04, 0.1)
    assert set(trial.frames) <= set(steps)
    assert steps[0] == 0 and np.diff(trial.time[steps]).max() < 0.05
    assert len(steps) < 0.75 * len(trial.time)


def test_full_order_areas_follow_the_drive_and_the_parameters(double) -> None:
    problem = double.make_problem(trials=1)
    candidates = np.array([[140e3, 60e3, 0.5, 1795e3], [140e3, 22e3, 0.5, 1795e3]])
    model = replace(FullOrder.like(problem.model), refinement=0.5, engine=LocalEngine(1))
    stiff, soft = model.areas(problem, candidates)
    assert (soft > stiff).all() and (np.diff(soft) > 0).all()
    assert len(soft) == len(problem.trials[0].frames)


def test_full_order_takes_the_constants_that_the_model_was_built_for() -> None:
    """A reduced model for another friction is corrected with that friction."""
    shipped = ReducedModel.load()
    other = ReducedModel(shipped.arrays, {**shipped.meta, "friction": 0.6})
    found = FullOrder.like(other)
    assert found.material.friction == 0.6 and found.geometry == other.geometry
    assert FullOrder.like(shipped).material.friction == shipped.friction


def test_every_fixed_property_and_length_reaches_the_full_order_areas(double) -> None:
    """Friction, nail, Poisson's ratios and geometry of the model are those of its correction."""
    problem = double.make_problem(trials=1)
    geometry = Geometry(pad_semi_axis_radial=7e-3, pad_semi_axis_axial=5e-3, nail_radius=5.5e-3)
    material = StandardLinearSolid(
        friction=0.6, nail_modulus=1e6, poisson_ratio_bulk=0.45, poisson_ratio_epidermis=0.46
    )
    model = SimpleNamespace(material=material, geometry=geometry)
    full = replace(FullOrder.like(model), refinement=0.4, engine=LocalEngine(1))
    assert (full.material, full.geometry) == (material, geometry)
    candidate = np.array([[140e3, 22e3, 0.5, 1795e3]])
    found = full.areas(problem, candidate)[0]
    trial = problem.trials[0]

    def direct(material, geometry):
        areas = FullOrderAreas(material, geometry, 0.4)
        return areas.areas(candidate[0], trial.time, trial.force, trial.frames)

    assert np.array_equal(found, direct(material, geometry))
    # Each of them is seen in the areas, so that one that got lost would be noticed.
    default = StandardLinearSolid()
    for name in ("friction", "nail_modulus", "poisson_ratio_bulk", "poisson_ratio_epidermis"):
        lost = replace(material, **{name: getattr(default, name)})
        assert abs(direct(lost, geometry)[-1] / found[-1] - 1) > 1e-4, name
    assert abs(direct(material, Geometry())[-1] / found[-1] - 1) > 0.01


def test_deformed_finger_is_that_of_the_model(double) -> None:
    problem = double.make_problem(trials=1)
    geometry = Geometry(pad_semi_axis_radial=7e-3, pad_semi_axis_axial=5e-3, nail_radius=5.5e-3)
    parameters = np.array([140e3, 22e3, 0.5, 1795e3])
    fit = SimpleNamespace(problem=problem, parameters=parameters)
    areas = []
    for friction in (0.0, 0.6):
        model = SimpleNamespace(material=StandardLinearSolid(friction=friction), geometry=geometry)
        finger = deformed_finger(fit, 0, FullOrder.like(model))
        assert finger.geometry == geometry
        areas.append(finger.contact.area)
    assert areas[1] < areas[0]
    # With the release: at the largest force, not at the last frame.
    whole = double.make_problem(trials=1, options=FitOptions(window="contact"))
    fit = SimpleNamespace(problem=whole, parameters=parameters)
    released = deformed_finger(fit, 0, FullOrder.like(model))
    assert released.contact.area > 0.95 * areas[1]
