"""The check of a fit against a better model, with the stand-in as the better one and a biased copy as the reduced."""

from __future__ import annotations

import numpy as np
import pytest

from finger_fit.engine import LocalEngine
from finger_fit.full_order_check import (
    SHIFTS,
    check,
    correct,
    full_order_areas,
    shifted,
    thinned,
)
from finger_fit.local import refine, whole_box
from finger_fit.options import FitOptions
from finger_fit.problem import MM4, AreaCorrection, FitProblem, composite_modulus
from finger_model.geometry import Geometry
from finger_model.material import Material


@pytest.fixture
def biased(double):
    """A problem whose model is wrong by up to 3 %, and what the better model says."""
    exact = double.make_problem()

    class Biased(double.HereditaryModel):
        def batch(self, parameters, trials):
            areas = super().batch(parameters, trials)
            return [a * (1.0 + 0.03 * np.cos(6.0 * t[1][t[2]])) for a, t in zip(areas, trials)]

    def better(shared, item):
        trial = shared[3][item[1]]
        rows = [(trial.time, trial.force, trial.frames)]
        return double.HereditaryModel().batch(np.array([item[0]]), rows)[0][0]

    return FitProblem(exact.trials, Biased(), exact.options), better


class Inline(LocalEngine):
    spread = LocalEngine.map


def test_correction_undoes_the_bias_of_the_reduced_model(biased, double) -> None:
    problem, better = biased
    plain = refine(problem, whole_box(problem.box), np.log(double.TRUTH))
    before = abs(np.log(plain.parameters / double.TRUTH))
    fit, correction = correct(
        problem, plain.parameters, Geometry(), Inline(), rounds=4, simulate=better
    )
    after = abs(np.log(fit.parameters / double.TRUTH))
    assert after.max() < 0.02 < before.max()
    assert fit.cost * MM4 < 0.05 < plain.cost * MM4
    assert correction.cost_before == pytest.approx(plain.cost)
    assert 0.02 < correction.largest_factor < 0.05


def test_correction_undoes_a_bias_that_changes_along_the_valley(double) -> None:
    """An error that depends on E0 as strongly as the area does: with the ratio at one point alone, a fit stays near its
    start."""
    exact = double.make_problem(options=FitOptions(window="contact"))

    class Biased(double.HereditaryModel):
        def batch(self, parameters, trials):
            tilt = np.log(np.atleast_2d(parameters)[:, :1] / 120e3)
            areas = super().batch(parameters, trials)
            return [
                a * (1.0 + 0.2 * tilt * np.sin(3.0 * t[0][t[2]])) for a, t in zip(areas, trials)
            ]

    def better(shared, item):
        trial = shared[3][item[1]]
        rows = [(trial.time, trial.force, trial.frames)]
        return double.HereditaryModel().batch(np.array([item[0]]), rows)[0][0]

    problem = FitProblem(exact.trials, Biased(), exact.options)
    start = np.array([75e3, 30e3, 0.25, 1500e3])
    fit, _ = correct(problem, start, Geometry(), Inline(), rounds=4, simulate=better)
    np.testing.assert_allclose(fit.parameters, double.TRUTH, rtol=0.01)


@pytest.mark.parametrize(
    "parameters",
    [[160e3, 15e3, 0.01, 700e3], [50e3, 60e3, 0.8, 2200e3], [50e3, 15e3, 0.1, 1500e3]],
)
def test_shifted_sets_move_one_coordinate_each_and_stay_physical(parameters) -> None:
    points = shifted(np.array(parameters), FitOptions().box())
    assert (points > 0).all() and np.isfinite(points).all()
    moves = AreaCorrection.place(points[1:]) - AreaCorrection.place(points[0])
    np.testing.assert_allclose(np.abs(np.diag(moves)), SHIFTS)
    np.testing.assert_allclose(moves - np.diag(np.diag(moves)), 0.0, atol=1e-9)


def test_check_measures_the_raw_difference_and_says_what_is_not_final(biased, double) -> None:
    problem, better = biased
    fit = refine(problem, whole_box(problem.box), np.log(double.TRUTH))
    other = fit.parameters * np.array([1.0, 1.1, 1.0, 1.0])
    found = check(problem, np.array([fit.parameters, other]), Geometry(), Inline(), simulate=better)
    raw = problem.raw_areas(fit.parameters)[0]
    expected = np.sqrt(np.mean((found.areas[0] - raw) ** 2)) / found.areas[0].max()
    assert found.rms_difference == pytest.approx(expected)
    assert found.rms_difference > 0.01 and not found.final and "differ" in found.reasons[0]
    flat = np.zeros((4, len(raw)))
    problem.correction = AreaCorrection(fit.parameters, np.log(found.areas[0] / raw), flat)
    again = check(problem, found.parameters, Geometry(), Inline(), simulate=better)
    assert again.rms_difference == pytest.approx(found.rms_difference), "of the model itself"
    assert again.reduced_costs[0] == pytest.approx(again.full_costs[0])


def test_re_ranking_that_moves_the_modulus_is_not_final(double) -> None:
    problem = double.make_problem()
    first = double.TRUTH * np.array([1.0, 1.05, 1.0, 1.0])

    def better(shared, item):
        trial = shared[3][item[1]]
        return double.HereditaryModel().batch(
            np.array([item[0]]), [(trial.time, trial.force, trial.frames)]
        )[0][0]

    found = check(problem, np.array([first, double.TRUTH]), Geometry(), Inline(), simulate=better)
    expected = composite_modulus(double.TRUTH) / composite_modulus(first) - 1
    assert found.best == 1 and found.modulus_change == pytest.approx(abs(expected))
    assert any("re-ranking" in reason for reason in found.reasons)


def test_thinned_drive_keeps_frames_and_step(double) -> None:
    trial = double.make_problem(trials=1).trials[0]
    steps = thinned(trial, 0.04)
    assert set(trial.frames) <= set(steps)
    assert steps[0] == 0 and np.diff(trial.time[steps]).max() < 0.05
    assert len(steps) < 0.75 * len(trial.time)


def test_full_order_areas_follow_the_drive_and_a_failure_is_nan(double) -> None:
    problem = double.make_problem(trials=1, options=FitOptions())
    shared = (Geometry(), 0.5, Material(), problem.trials)
    stiff = full_order_areas(shared, ((140e3, 60e3, 0.5, 1795e3), 0))
    soft = full_order_areas(shared, ((140e3, 22e3, 0.5, 1795e3), 0))
    assert (soft > stiff).all() and (np.diff(soft) > 0).all()
    assert len(soft) == len(problem.trials[0].frames)
