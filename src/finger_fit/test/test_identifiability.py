# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Local fits, covariances, profiles and bootstrap."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from finger_fit.options import FitOptions
from finger_fit.report_units import MM4
from finger_fit.search import all_free, held, refine
from finger_fit.uncertainty import (
    bootstrap_sample,
    covariance,
    cramer_rao,
    in_interval,
    profile,
)
from finger_model.laws import StandardLinearSolid

PARAMETERS = StandardLinearSolid.PARAMETERS

quantity = PARAMETERS.quantity


@pytest.fixture(scope="module")
def fitted(double):
    problem = double.make_problem(noise=1.5e-6)
    fit = refine(problem, all_free(problem), double.TRUTH)
    return SimpleNamespace(
        problem=problem, fit=fit, found=covariance(problem, fit.parameters), truth=double.TRUTH
    )


def test_local_fit_returns_the_truth_without_noise(double) -> None:
    problem = double.make_problem()
    for start in ([60e3, 50e3, 0.5, 800e3], [150e3, 20e3, 0.02, 2000e3]):
        fit = refine(problem, all_free(problem), np.array(start))
        np.testing.assert_allclose(fit.parameters, double.TRUTH, rtol=0.02)
        assert fit.cost * MM4 < 0.01


def test_local_fit_stays_in_the_box_and_lands_on_its_faces(double) -> None:
    outside = np.array([200e3, 25e3, 0.2, 1500e3])
    problem = double.make_problem(truth=outside)
    fit = refine(problem, all_free(problem), np.array([100e3, 40e3, 0.1, 1000e3]))
    assert fit.parameters[0] == pytest.approx(problem.box[0, 1], rel=1e-12)
    found = covariance(problem, fit.parameters)
    assert found.active == {"E0": "high"}
    assert found.covariance[0, 0] == 0.0 and found.covariance[1, 1] > 0.0


def test_composite_coordinates_hold_the_modulus_and_the_box(double) -> None:
    boxed = SimpleNamespace(space=PARAMETERS, box=PARAMETERS.box)
    box = boxed.box
    for modulus in (12e3, 20e3, 40e3):
        coordinates = held(boxed, "composite_E", modulus)
        u = np.random.default_rng(0).uniform(*coordinates.box.T, (50, 3))
        points = coordinates.parameters(u)
        np.testing.assert_allclose(double.composite(points), modulus, rtol=1e-9)
        assert (points >= box[:, 0] * (1 - 1e-9)).all() and (points <= box[:, 1] * (1 + 1e-9)).all()
    assert all(held(boxed, "composite_E", modulus) is None for modulus in (5e3, 60e3))


@pytest.mark.parametrize("window", ["loading", pytest.param("contact", marks=pytest.mark.slow)])
def test_bias_spread_and_coverage_over_many_seeds(double, window: str) -> None:
    """The targets of a recovery, where no bound is active; seeds are fixed, so the limits hold or
    fail for good.
    """
    wide = ["E0=10e3:900e3", "E1=3e3:300e3", "tau1=0.001:8", "E2=100e3:9000e3"]
    options = FitOptions(bounds=wide, window=window)
    names = ("composite_E", "E2", "tau1")
    errors: dict[str, list[float]] = {q: [] for q in names}
    covered: dict[str, list[bool]] = {q: [] for q in names}
    claimed: dict[str, list[float]] = {q: [] for q in names}
    bound = dict.fromkeys(names, 0.0)
    seeds = 150
    for seed in range(seeds):
        problem = double.make_problem(noise=1.5e-6, seed=seed, options=options)
        fit = refine(problem, all_free(problem), double.TRUTH, tolerance=1e-5)
        found = covariance(problem, fit.parameters)
        least = cramer_rao(problem, double.TRUTH, 1.5e-6)
        for q in names:
            true = float(quantity(q, double.TRUTH))
            errors[q].append(float(np.log(quantity(q, fit.parameters) / true)))
            covered[q].append(in_interval(problem, q, true, fit.parameters, fit.cost, found))
            claimed[q].append(found.deviation(q))
            bound[q] += least[q] / seeds
    for q in names:
        spread = np.std(errors[q], ddof=1)
        assert abs(np.mean(errors[q])) < 0.5 * spread, q
        assert spread < 1.2 * bound[q], q
        # 150 fits give a standard deviation to 6 %.
        assert 0.85 < np.mean(claimed[q]) / spread < 1.25, q
    assert 0.90 <= np.mean([covered[q] for q in names]) <= 0.99


def test_in_interval_agrees_with_the_profile(fitted) -> None:
    best = fitted.fit.parameters
    p = profile(fitted.problem, "E2", best, fitted.fit.cost, fitted.found, points=3)
    for value, expected in zip(
        (0.97 * p.interval[0], 1.03 * p.interval[0], 0.97 * p.interval[1], 1.03 * p.interval[1]),
        (False, True, True, False),
    ):
        inside = in_interval(fitted.problem, "E2", value, best, fitted.fit.cost, fitted.found)
        assert inside == expected
    beyond = 1.5 * fitted.problem.box[3, 1]
    assert not in_interval(fitted.problem, "E2", beyond, best, fitted.fit.cost, fitted.found)


def test_no_estimate_beats_the_cramer_rao_bound_by_claim(fitted) -> None:
    bound = cramer_rao(fitted.problem, fitted.fit.parameters, fitted.found.noise)
    claimed = np.sqrt(np.diag(fitted.found.covariance))
    for name, value in zip(("E0", "E1", "tau1", "E2"), claimed):
        assert value >= 0.99 * bound[name]
    held = cramer_rao(fitted.problem, fitted.fit.parameters, fitted.found.noise, ("E0", "E1"))
    assert held["E0"] < bound["E0"], "knowing the others can only help"


@pytest.mark.parametrize("name", ["E0", "tau1", "composite_E"])
def test_profile_is_least_at_the_best_and_brackets_the_truth(fitted, name: str) -> None:
    p = profile(
        fitted.problem, name, fitted.fit.parameters, fitted.fit.cost, fitted.found, points=3
    )
    assert p.costs.min() == pytest.approx(fitted.fit.cost, rel=1e-3)
    low, high = p.interval
    assert low < quantity(name, fitted.fit.parameters) < high
    assert low <= quantity(name, fitted.truth) <= high
    # Near the minimum the profile is the parabola of the covariance.
    assert np.log(high / low) == pytest.approx(2 * 2.14 * fitted.found.deviation(name), rel=0.5)


def test_a_parameter_that_the_data_do_not_determine_is_not_identifiable(double) -> None:
    problem = double.make_problem(
        noise=8e-6, trials=4, truth=np.array([100e3, 25e3, 0.012, 1500e3])
    )
    fit = refine(problem, all_free(problem), np.array([100e3, 25e3, 0.012, 1500e3]))
    found = covariance(problem, fit.parameters)
    known = profile(problem, "composite_E", fit.parameters, fit.cost, found, points=5)
    unknown = profile(problem, "E0", fit.parameters, fit.cost, found, points=5)
    assert known.identifiable and not unknown.identifiable
    assert unknown.open_low or unknown.open_high


def test_bootstrap_samples_are_repeatable_and_spread_like_the_covariance(fitted, double) -> None:
    best = fitted.fit.parameters
    samples = np.array([bootstrap_sample(fitted.problem, best, 3, i) for i in range(24)])
    np.testing.assert_array_equal(samples[5], bootstrap_sample(fitted.problem, best, 3, 5))
    spread = np.log(double.composite(samples)).std(ddof=1)
    assert 0.4 < spread / fitted.found.deviation("composite_E") < 1.7


def alike(rng: np.random.Generator, time: np.ndarray, decay: float) -> np.ndarray:
    """Errors (k,) of variance 1 at times (k,) in s, with a correlation of exp(−Δt/decay)."""
    found = rng.normal(size=len(time))
    for k in range(1, len(time) if decay else 0):
        kept = np.exp(-(time[k] - time[k - 1]) / decay)
        found[k] = kept * found[k - 1] + np.sqrt(1.0 - kept**2) * found[k]
    return found


@pytest.mark.parametrize("decay", [0.0, 0.3])
def test_deviations_are_those_of_the_errors_of_frames_that_err_alike(double, decay: float) -> None:
    """Repeated fits of presses at 30 frames/s: errors over stated deviations come out near one."""
    problem = double.make_problem(
        trials=6, options=FitOptions(window="contact"), frame_period=1 / 30, release=1.5
    )
    clean = problem.measured.copy()
    names = ("E0", "E1", "tau1", "E2", "composite_E")
    truth = np.array([quantity(name, double.TRUTH) for name in names])
    found, times = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        errors = [alike(rng, trial.frame_time, decay) for trial in problem.trials]
        problem.measured = clean + 1.0e-6 * np.concatenate(errors)
        fit = refine(problem, all_free(problem), double.TRUTH).parameters
        known = covariance(problem, fit)
        error = np.log([quantity(name, fit) for name in names] / truth)
        found.append(error / [known.data_deviation(name) for name in names])
        times.append(known.frames.time)
    size = np.sqrt(np.mean(np.square(found), axis=0))
    assert (size > 0.6).all() and (size < 1.5).all(), size
    assert np.median(times) == (0.0 if not decay else pytest.approx(decay, rel=0.5))
