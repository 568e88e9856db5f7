# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""J, the power law on the same frames, robust loss and weights."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from finger_fit.options import FitOptions
from finger_fit.problem import fit_power_law
from finger_fit.report_units import MM4
from finger_fit.search import all_free, refine


def test_cost_is_the_sum_over_trials_of_the_mean_squared_area_difference(double) -> None:
    problem = double.make_problem(noise=1.5e-6, trials=4)
    candidate = np.array([100e3, 30e3, 0.1, 1200e3])
    areas = problem.areas(candidate)[0]
    expected = sum(
        np.mean((areas[a:b] - problem.measured[a:b]) ** 2)
        for a, b in zip(problem.starts[:-1], problem.starts[1:])
    )
    assert problem.cost(candidate)[0] == pytest.approx(expected, rel=1e-12)


def test_a_batch_gives_what_its_candidates_give_alone(double) -> None:
    problem = double.make_problem(trials=3)
    candidates = np.exp(np.random.default_rng(0).uniform(*np.log(problem.box).T, (6, 4)))
    together = problem.cost(candidates)
    alone = [problem.cost(c)[0] for c in candidates]
    np.testing.assert_array_equal(together, alone)


def test_noise_free_truth_costs_nothing_and_noise_costs_its_variance(double) -> None:
    assert double.make_problem().cost(double.TRUTH)[0] * MM4 < 0.01
    noise = 1.5e-6
    problem = double.make_problem(noise=noise, trials=60)
    assert problem.cost(double.TRUTH)[0] == pytest.approx(60 * noise**2, rel=0.15)


@pytest.mark.parametrize("loss", ["squares", "huber"])
def test_power_law_minimises_the_same_cost(double, loss: str) -> None:
    problem = double.make_problem(noise=1.5e-6, trials=6, options=FitOptions(loss=loss))
    law = fit_power_law(problem)

    def cost(v: np.ndarray) -> float:
        return float(problem.trial_costs(v[0] * 1e-6 * problem.force ** v[1]).sum() * MM4)

    other = minimize(
        cost,
        [law.k * 1e6 * 1.1, law.m * 0.9],
        method="Nelder-Mead",
        options={"xatol": 1e-8, "fatol": 1e-10},
    )
    assert law.cost * MM4 == pytest.approx(other.fun, rel=1e-6)
    assert law.m == pytest.approx(other.x[1], rel=1e-3)


def test_power_law_data_give_back_k_and_m(double) -> None:
    problem = double.make_problem(trials=5)
    problem.measured = 40e-6 * problem.force**0.67
    law = fit_power_law(problem)
    assert law.k == pytest.approx(40e-6, rel=1e-6) and law.m == pytest.approx(0.67, rel=1e-6)
    assert law.log_m == pytest.approx(0.67, rel=1e-6)
    assert law.cost * MM4 < 1e-6


def test_low_force_frames_can_be_left_out_by_weight(double) -> None:
    full = double.make_problem(trials=3)
    none = double.make_problem(trials=3, options=FitOptions(low_force_weight=0.0))
    low = full.force < 0.2
    assert low.any()
    none.measured = np.where(low, none.measured + 20e-6, none.measured)
    full.measured = none.measured
    assert none.cost(double.TRUTH)[0] * MM4 < 0.01 < full.cost(double.TRUTH)[0] * MM4


def test_robust_loss_is_little_moved_by_outliers(double) -> None:
    moved = {}
    for loss in ("squares", "huber"):
        problem = double.make_problem(noise=0.5e-6, trials=8, options=FitOptions(loss=loss))
        clean = refine(problem, all_free(problem), double.TRUTH)
        problem.measured = problem.measured.copy()
        problem.measured[10:100:12] += 30e-6
        fit = refine(problem, all_free(problem), double.TRUTH)
        change = double.composite(fit.parameters) / double.composite(clean.parameters)
        moved[loss] = abs(np.log(change))
    assert moved["huber"] < 0.3 * moved["squares"], moved
