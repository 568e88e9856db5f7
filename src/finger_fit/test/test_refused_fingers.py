# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fingers that the model cannot follow (NaN), beside the best one of a fit and among the others."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from finger_fit.full_order import check
from finger_fit.nuisance.estimate import NuisanceModel
from finger_fit.options import FitOptions
from finger_fit.problem.outputs import slope_between
from finger_fit.results import fit_dict
from finger_fit.search import all_free, carrying, refine, search
from finger_fit.study import fit_records
from finger_fit.uncertainty import covariance, in_interval, profile

SOFT = np.array([60e3, 18e3, 0.2, 900e3])
"""A finger that is not followed."""


@pytest.fixture
def problem(double):
    return double.make_problem(noise=1e-6, trials=6, model=double.YieldingModel())


def test_a_local_fit_from_a_finger_that_is_refused_comes_near_the_truth(problem, double) -> None:
    free = all_free(problem)
    assert np.isinf(problem.cost(SOFT)[0]) and np.isfinite(problem.cost(double.TRUTH)[0])
    near = carrying(problem, free, SOFT)
    assert near is not None and np.isfinite(problem.cost(near)[0])
    assert np.array_equal(carrying(problem, free, double.TRUTH), double.TRUTH)
    found = refine(problem, free, SOFT)
    assert found.cost < 0.1 * problem.cost(near)[0]
    assert double.composite(found.parameters) == pytest.approx(double.composite(double.TRUTH), 0.05)


def test_without_any_finger_that_is_followed_the_cost_stays_infinite(problem) -> None:
    problem.model.largest = 1e-6
    free = all_free(problem)
    assert carrying(problem, free, SOFT) is None
    found = refine(problem, free, SOFT)
    assert np.isinf(found.cost) and np.isfinite(found.parameters).all()


def test_slopes_are_taken_to_the_side_that_is_followed() -> None:
    ends = np.array([[3.0, np.nan, np.nan], [1.0, 1.0, np.nan]])
    found = slope_between(ends, np.array([2.0, 2.0, 2.0]), np.array([0.5, 0.5]))
    np.testing.assert_allclose(found, [2.0, 2.0, 0.0])
    assert slope_between(ends, np.full(3, np.nan), np.array([0.5, 0.5])) == pytest.approx(0.0)


def test_intervals_beside_refused_fingers_are_those_without(problem, double) -> None:
    """The best finger lies so near the others that its differences reach them."""
    best = refine(problem, all_free(problem), double.TRUTH)
    problem.model.largest = 1.0001 * float(problem.areas(best.parameters).max())
    whole = double.make_problem(noise=1e-6, trials=6)
    known, usual = (covariance(p, best.parameters) for p in (problem, whole))
    for name in problem.space.quantity_names:
        assert known.data_deviation(name) == pytest.approx(usual.data_deviation(name), rel=0.1)
    # What is refused is not excluded by the data.
    for p in (problem, whole):
        found = profile(p, "composite_E", best.parameters, best.cost, known, points=3)
        low, high = found.interval
        assert found.box[0] < low < double.composite(double.TRUTH) < high < found.box[1]
        assert np.isinf(found.costs).any() == (p is problem)
    value = float(double.composite(best.parameters))
    inside = (problem, "composite_E", low + 0.01 * value, best.parameters, best.cost, known)
    assert in_interval(*inside)


def test_nuisances_are_estimated_where_their_steps_are_refused(problem, double) -> None:
    best = refine(problem, all_free(problem), double.TRUTH)
    problem.model.largest = 1.0001 * float(problem.areas(best.parameters).max())
    found = NuisanceModel(problem, FitOptions(geometry_sd=[])).settle(best.parameters[None])
    assert np.isfinite(found.fit.cost) and np.isfinite(found.noise)
    assert np.isfinite(found.nuisances.state).all() and np.isfinite(found.nuisances.slope).all()
    assert np.log(double.composite(found.fit.parameters) / 20.6e3) == pytest.approx(0.0, abs=0.1)


def test_a_whole_fit_with_many_refused_fingers_holds_no_infinite_number(double) -> None:
    options = FitOptions(
        full_order=False, grid=3, rounds=6, particles=12, bootstrap=4, bias_pairs=1,
        optimizer=["pso", "de", "cmaes"],
    )  # fmt: skip
    # After the loading the force goes on, to where the model no longer follows.
    records = [double.make_record(i, 0.6 + 0.3 * i, 1e-6, peak=1.8) for i in range(4)]
    result = fit_records(records, double.YieldingModel(), options)
    (fit,) = result.fits.values()
    assert np.isinf(fit.grid.costs).any() and np.isfinite(fit.cost)
    assert fit.quality is not None and all(np.isfinite(t.lag) for t in fit.quality.trials)
    numbers = json.dumps(fit_dict(result)["conditions"]["natural"]["interval_95"])
    assert "null" not in numbers


class FailsFor:
    """A better model that does not carry one of the candidates."""

    def __init__(self, double, index: int) -> None:
        self._exact, self._index = double.Exact(), index

    def areas(self, problem, candidates, done=None):
        found = self._exact.areas(problem, candidates)
        found[self._index] = np.nan
        return found


def test_full_order_that_fails_for_a_lesser_candidate_judges_the_best(double) -> None:
    problem = double.make_problem(trials=4)
    candidates = np.array([double.TRUTH, 1.05 * double.TRUTH])
    found = check(problem, candidates, FailsFor(double, 1))
    assert found.best == 0 and not found.reasons
    worse = check(problem, candidates, FailsFor(double, 0))
    assert worse.reasons == [
        "the full-order model does not carry these presses with the fitted parameters"
    ]


def test_a_search_is_resumed_past_refused_fingers(problem, tmp_path: Path) -> None:
    free, start = all_free(problem), np.array([SOFT, 1.1 * SOFT, 1.8 * SOFT, 1.9 * SOFT])
    start = np.clip(start, problem.box[:, 0], problem.box[:, 1])
    file = tmp_path / "checkpoint.json"
    search("pso", problem.cost, free, start, 2, 0, checkpoint=file)
    whole = search("pso", problem.cost, free, start, 4, 0)
    resumed = search("pso", problem.cost, free, start, 4, 0, checkpoint=file, resume=True)
    assert np.isinf(whole.costs).any()
    np.testing.assert_array_equal(whole.costs, resumed.costs)
