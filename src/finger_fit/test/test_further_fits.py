# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Shared parameters and the fifth parameter."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from finger_fit.nuisance.estimate import NuisanceModel
from finger_fit.nuisance.geometry import Response
from finger_fit.options import FitOptions
from finger_fit.search import all_free, refine
from finger_fit.study.further import (
    EPIDERMIS,
    THICKNESS_FACTORS,
    ThicknessProblem,
    shared_fit,
    thickness_fit,
)
from finger_model.geometry import Geometry


@dataclass(frozen=True)
class Skin:
    """In place of full-order runs: a thicker skin flattens areas at low force more."""

    geometry: Geometry = field(default_factory=Geometry)
    refinement: float = 1.0

    def areas(self, problem, candidates, done=None):
        x = np.log(self.geometry.epidermis_thickness / Geometry().epidermis_thickness)
        return problem.areas(candidates) * np.exp(-0.3 * x * np.exp(-problem.force) - 0.1 * x * x)


def test_shared_parameter_is_found_and_equal_in_all_conditions(double) -> None:
    truths = {
        "dry": np.array([100e3, 43e3, 0.1, 1500e3]),
        "moist": np.array([150e3, 17e3, 0.05, 1500e3]),
    }
    problems = {n: double.make_problem(noise=0.5e-6, trials=6, truth=t) for n, t in truths.items()}
    best = {n: refine(p, all_free(p), truths[n]).parameters for n, p in problems.items()}
    joint = shared_fit(problems, best, ["E2"])
    values = {c["E2"] for c in joint["conditions"].values()}
    assert len(values) == 1 and values.pop() == pytest.approx(1500e3, rel=0.05)
    assert joint["J_separate"] <= joint["J"] * (1 + 1e-6)
    assert joint["J"] < 1.3 * joint["J_separate"]
    assert joint["J"] == pytest.approx(sum(c["J"] for c in joint["conditions"].values()), rel=1e-6)


def test_thickness_enters_as_a_ratio_of_areas_and_is_found(double) -> None:
    problem = double.make_problem(trials=6)
    # A thicker skin flattens area at low force more: a formula in place of full-order runs.
    x = np.log(np.array(THICKNESS_FACTORS))[:, None]
    log_ratio = -0.3 * x * np.exp(-problem.force) - 0.1 * x**2
    h0 = 0.6e-3
    extended = ThicknessProblem(problem, h0, log_ratio)
    outer = extended.outputs(np.array([[*double.TRUTH, h0 * f] for f in THICKNESS_FACTORS]))
    np.testing.assert_allclose(outer, problem.areas(double.TRUTH) * np.exp(log_ratio), rtol=1e-9)
    true = 0.7e-3
    extended.measured = extended.outputs(np.array([[*double.TRUTH, true]]))[0]
    start = np.array([*double.TRUTH, h0])
    fit = refine(extended, all_free(extended), start, tolerance=1e-12)
    assert fit.parameters[4] == pytest.approx(true, rel=0.02)


def test_gains_of_presses_do_not_widen_the_fitted_thickness(double) -> None:
    gains = np.exp(0.15 * np.random.default_rng(5).normal(size=15))
    deviations = []
    for gain in (np.ones(15), gains):
        options = FitOptions(area_gain_sd=0.0, collapse_sd=0.0)
        problem = double.make_problem(noise=0.5e-6, options=options)
        problem.measured = problem.measured * gain[problem.trial_of]
        response = Response(np.array([1.0]), np.array([[0.0, 0.0, -0.3]]))
        model = NuisanceModel(problem, options, {EPIDERMIS: response})
        best = model.settle(double.TRUTH[None]).fit.parameters
        found = thickness_fit(problem, best, Skin())
        deviations.append(found["sd_log"])
        true = Geometry().epidermis_thickness
        assert abs(np.log(found[EPIDERMIS] / true)) < 3 * found["sd_log"]
    # The gains tell less of the thickness than areas without them, and are no noise: 9 mm² of it
    # would make twenty times the deviation.
    assert 0.0 < deviations[1] < 2.5 * deviations[0]


def test_what_stands_for_the_thickness_is_left_out_where_it_is_fitted(double) -> None:
    options = FitOptions()
    problem = double.make_problem(trials=3, options=options)
    response = Response(np.array([1.0]), np.array([[0.0, 0.0, -0.3]]))
    NuisanceModel(problem, options, {EPIDERMIS: response}).apply(double.TRUTH)
    extended = ThicknessProblem(problem, 0.3e-3, np.zeros((3, len(problem.measured))))
    assert set(problem.nuisances.names) - set(extended.nuisances.names) == {EPIDERMIS}
    assert extended.nuisances.slope.shape[1] == len(extended.nuisances.names)
