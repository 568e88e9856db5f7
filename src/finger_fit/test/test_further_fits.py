# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Shared parameters and the fifth parameter."""

from __future__ import annotations

import numpy as np
import pytest

from finger_fit.search import all_free, refine
from finger_fit.study.further import THICKNESS_FACTORS, ThicknessProblem, shared_fit


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
    problem.measured = extended.measured
    start = np.array([*double.TRUTH, h0])
    fit = refine(extended, extended.coordinates(), start, tolerance=1e-12)
    assert fit.parameters[4] == pytest.approx(true, rel=0.02)
