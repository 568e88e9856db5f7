# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The measured bias is that of the estimate, and corrected values have almost none."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from finger_fit.options import FitOptions
from finger_fit.problem import FitProblem
from finger_fit.search import all_free, refine
from finger_fit.uncertainty import Profile, bias_corrected, bias_pair, shifted_interval
from finger_model.laws import StandardLinearSolid

PARAMETERS = StandardLinearSolid.PARAMETERS

quantity = PARAMETERS.quantity

NOISE = 1.5e-6
"""m², standard deviation of a frame's area."""


class Cubic:
    """Areas that go as the cube of E0 and depend on nothing else: the bias of ln E0 is known."""

    hash = "cubic"
    space = PARAMETERS

    def batch(self, parameters, trials):
        cube = 50e-6 * (np.atleast_2d(parameters)[:, :1] / 100e3) ** 3
        return [np.repeat(cube, len(rows), axis=1) for _, _, rows in trials]


def corrected(problem: FitProblem, best: np.ndarray, pairs: int) -> dict:
    return bias_corrected(
        problem.space, best, np.array([bias_pair(problem, best, 1, i) for i in range(pairs)])
    )


def antithetic(problem: FitProblem, noise: np.ndarray, truth: np.ndarray) -> list[FitProblem]:
    """The problem with this noise on its true areas, and with the sign of the noise flipped.

    A mean over few draws then shows a bias far below the spread.
    """
    out = []
    for sign in (1.0, -1.0):
        one = copy.copy(problem)
        one.measured = problem.areas(truth)[0] + sign * noise
        out.append(one)
    return out


def test_a_bias_known_in_closed_form_is_found_and_removed(double) -> None:
    truth = np.array([100e3, 30e3, 0.1, 1000e3])
    exact = double.make_problem(
        model=Cubic(), truth=truth, options=FitOptions(bounds=["E0=1e3:900e3"])
    )
    rng = np.random.default_rng(0)
    size = 25e-6
    shares = [1.0 / len(t.frames) for t in exact.trials]
    mean_variance = size**2 * np.mean(shares) / len(exact)
    # ln of a mean of areas over its truth, by a third: Taylor's second term.
    known = -mean_variance / (50e-6) ** 2 / 6.0
    errors, after, measured = [], [], []
    for _ in range(40):
        for problem in antithetic(exact, size * rng.normal(size=len(exact.measured)), truth):
            fit = refine(problem, all_free(problem), truth)
            found = corrected(problem, fit.parameters, 10)["E0"]
            errors.append(np.log(fit.parameters[0] / truth[0]))
            after.append(np.log(found.value / truth[0]))
            measured.append(found.bias)
    assert np.mean(errors) == pytest.approx(known, rel=0.15)
    assert np.mean(measured) == pytest.approx(known, rel=0.15)
    assert abs(np.mean(after)) < 0.15 * abs(known)


def test_the_bias_that_a_bound_of_the_box_makes_is_more_than_halved(double) -> None:
    """The natural finger's case: E0 a good half of a deviation below its bound."""
    truth = np.array([155e3, 22.35e3, 0.5, 1795e3])
    exact = double.make_problem(truth=truth)
    rng = np.random.default_rng(1)
    before: dict[str, list[float]] = {q: [] for q in ("E0", "composite_E", "tau1")}
    after: dict[str, list[float]] = {q: [] for q in before}
    on_bound = 0
    for _ in range(40):
        noise = NOISE * rng.normal(size=len(exact.measured))
        for problem in antithetic(exact, noise, truth):
            fit = refine(problem, all_free(problem), truth, tolerance=1e-5)
            on_bound += fit.parameters[0] > 0.999 * problem.box[0, 1]
            found = corrected(problem, fit.parameters, 6)
            for q in before:
                true = float(quantity(q, truth))
                before[q].append(float(np.log(quantity(q, fit.parameters) / true)))
                after[q].append(float(np.log(found[q].value / true)))
    assert on_bound > 16, "the bound must matter here"
    for q in before:
        spread = np.std(before[q], ddof=1)
        assert abs(np.mean(before[q])) > 0.1 * spread, q
        assert abs(np.mean(after[q])) < 0.5 * abs(np.mean(before[q])), q
        assert np.std(after[q], ddof=1) < 1.4 * spread, q


def test_without_noise_there_is_nothing_to_correct(double) -> None:
    problem = double.make_problem(trials=4)
    found = corrected(problem, double.TRUTH, 2)
    for q in PARAMETERS.quantity_names:
        assert found[q].value == pytest.approx(float(quantity(q, double.TRUTH)), rel=1e-3)


def test_pairs_are_repeatable_and_leave_the_problem_alone(double) -> None:
    problem = double.make_problem(noise=NOISE, trials=5)
    before = problem.measured.copy()
    best = refine(problem, all_free(problem), double.TRUTH).parameters
    late = bias_pair(problem, best, 3, 4)
    for index in range(4):
        assert not np.array_equal(bias_pair(problem, best, 3, index), late)
    np.testing.assert_array_equal(bias_pair(problem, best, 3, 4), late)
    np.testing.assert_array_equal(problem.measured, before)
    assert not np.array_equal(bias_pair(problem, best, 4, 4), late), "another seed, other signs"


def test_corrected_value_may_leave_the_box(double) -> None:
    """A truth in a corner: estimates err to one side, and only values beyond the bound can make up
    for it.
    """
    truth = np.array([160e3, 25e3, 0.2, 1500e3])
    problem = double.make_problem(noise=NOISE, truth=truth, seed=4)
    best = refine(problem, all_free(problem), truth).parameters
    assert best[0] == pytest.approx(problem.box[0, 1]), "this seed's fit lies on the bound"
    found = corrected(problem, best, 10)["E0"]
    assert found.bias < 0 and found.value > problem.box[0, 1]


def test_corrected_estimate_on_a_bound_stays_in_its_interval() -> None:
    best = np.array([160e3, 25e3, 0.2, 1500e3])
    empty = np.empty(0)
    ends, box = (90e3, 160e3), (50e3, 160e3)
    profile = Profile("E0", empty, empty, 0.0, ends, ends, box, False, True, np.empty((0, 4)))
    rng = np.random.default_rng(0)
    for _ in range(200):
        pairs = best * np.exp(-np.abs(0.2 * rng.normal(size=(3, 2, 4))))
        found = bias_corrected(PARAMETERS, best, pairs)["E0"]
        low, high = shifted_interval(profile, found.bias)
        assert low < found.value <= high


@pytest.mark.parametrize(
    ("bias", "open_low", "expected"),
    [
        (-0.1, False, (np.exp(0.1) * 20.0, np.exp(0.1) * 30.0)),
        (-0.1, True, (20.0, np.exp(0.1) * 30.0)),
        (0.1, True, (np.exp(-0.1) * 20.0, np.exp(-0.1) * 30.0)),
    ],
)
def test_interval_moves_with_the_value(bias: float, open_low: bool, expected: tuple) -> None:
    empty = np.empty(0)
    ends, box = (20.0, 30.0), (20.0, 60.0)
    profile = Profile("E1", empty, empty, 0.0, ends, ends, box, open_low, False, np.empty((0, 4)))
    assert shifted_interval(profile, bias) == pytest.approx(expected)
