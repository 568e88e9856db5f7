"""Fingers drawn from the population, estimated by an estimator that knows none of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from finger_model.estimator import ContactEstimator
from finger_model.finger import load_reduced
from finger_model.finger_prior import PRIOR_FORCES, FingerPrior
from finger_model.parameter_sets import ParameterSets
from finger_model.people import People
from finger_model.reduced.model import POPULATION
from finger_model.reduced.population import check_geometry

FIGURES = {
    "presses": "camera: presses with RMS <= 1.05 x the camera's (%)",
    "median": "camera: median RMS over the camera's, from press 3",
    "camera": "camera: 95 % interval covers (%)",
    "first": "camera, press 1: 95 % interval covers (%)",
    "none": "none: 95 % interval covers (%)",
    "camera fingers": "camera: fingers with coverage >= 80 % (%)",
    "none fingers": "none: fingers with coverage >= 80 % (%)",
}


@pytest.fixture(scope="module")
def script(module_of: Callable[[str], Any]) -> Any:
    return module_of("scripts/population_fingers.py")


def figures(script: Any, number: int, seed: int) -> dict[str, float]:
    found = script.table([script.score(seed, False, index) for index in range(number)])
    return {name: found[label] for name, label in FIGURES.items()}


def test_drawn_fingers_lie_in_the_box_and_scatter_as_stated() -> None:
    people = People.default()
    rng = np.random.default_rng(0)
    drawn = [people.draw(rng) for _ in range(300)]
    for person in drawn:
        check_geometry(person.geometry)
    sizes = np.log([p.geometry.pad_semi_axis_radial for p in drawn])
    assert np.std(sizes) == pytest.approx(people.size, rel=0.15)
    assert np.std([p.moisture for p in drawn]) == pytest.approx(people.moisture_sd, rel=0.15)
    moist, dry = (
        [p.material.long_term_shear_modulus for p in drawn if low < p.moisture < high]
        for low, high in ((85, 130), (0, 55))
    )
    assert np.median(moist) < 0.75 * np.median(dry)


def test_the_estimate_is_honest_on_fingers_that_nobody_measured(script: Any) -> None:
    found = figures(script, 5, seed=3)
    assert found["presses"] >= 95.0
    assert found["median"] <= 0.5
    assert found["camera"] >= 85.0
    assert found["first"] >= 75.0
    assert found["camera fingers"] >= 80.0
    # Without a camera a finger is inside its interval or not: five say little.
    assert found["none fingers"] >= 60.0


@pytest.mark.parametrize("index", [1, 7, 11, 15, 19])
def test_the_release_without_a_moisture_reading_is_no_worse_than_the_camera(
    script: Any, index: int
) -> None:
    """Press by press, from the end of the hold on: moisture 81 to 130 a.u."""
    session = script.session_of(1, index)
    assert np.isnan(session.reading)
    for press in script.run_session(session, range(10)):
        pressing = np.flatnonzero(press["force"] > 0.95 * press["force"].max())
        for key in ("held", "at_once"):
            release = np.isfinite(press[key])
            release[: pressing[-1] + 1] = False
            if release.any():
                own = script.rms((press[key] - press["truth"])[release])
                fused = script.rms((press["area"] - press["truth"])[release])
                assert fused <= 1.05 * own, (press["force"].max(), key)


@pytest.mark.slow
def test_the_whole_table(script: Any) -> None:
    found = figures(script, 200, seed=1)
    assert found["presses"] >= 99.0
    assert found["median"] <= 0.6
    for name in ("camera", "first", "none"):
        assert 90.0 <= found[name] <= 99.0
    for name in ("camera fingers", "none fingers"):
        assert found[name] >= 90.0


def test_the_peak_pressure_is_as_uncertain_as_fingers_differ_in_it(script: Any) -> None:
    """At each force as much as the prior says there; one number is that of all forces."""
    prior = ParameterSets.default().prior
    assert prior is not None
    data = prior.to_dict()
    same = FingerPrior.parse({**data, "peak_mean": 0.149, "peak_sd": 0.186}, "an earlier file")
    assert same.peak_mean == len(PRIOR_FORCES) * (0.149,)
    assert FingerPrior.parse(data, "the shipped file") == prior
    for own in (prior, same):
        model = load_reduced(POPULATION)
        estimator = ContactEstimator(model, ParameterSets.default().with_prior(own, model.geometry))
        for k in range(350):
            estimate = estimator.add_wrench(k * 10**7, (0.0, 0.0, -0.01 * (k + 1)))[0]
            near = np.interp(math.log(max(0.01 * (k + 1), 0.15)), np.log(PRIOR_FORCES), own.peak_sd)
            if k > 10:
                stated = estimate.peak_pressure_stddev / estimate.peak_pressure
                assert stated**2 > near**2 + (estimate.area_stddev / estimate.area) ** 2


@pytest.mark.parametrize("cameras", [range(10), range(0)])
def test_the_indentation_is_neither_too_small_nor_too_certain(script: Any, cameras: range) -> None:
    """Of fingers that nobody measured; each counts once, by the median of its samples."""
    errors, scores = [], []
    for index in range(16):
        presses = list(script.run_session(script.session_of(5, index), cameras, None, script.KNOT))
        error, score = [], []
        for press in presses:
            firm = press["force"] > 0.3
            found, truth = press["indentation"][firm], press["indentation_truth"][firm]
            error.append(np.log(found / truth))
            score.append((found - truth) / press["indentation_stddev"][firm])
        errors.append(np.median(np.concatenate(error)))
        scores.append(np.median(np.concatenate(score)))
    assert abs(np.mean(errors)) < 0.08
    assert script.rms(np.array(scores)) < 1.2


def test_intervals_hold_over_a_wide_range_of_forces(script: Any) -> None:
    """Area after a firm grip that was loosened, and peak pressure and indentation at any force."""
    found = script.wide_table(3, range(10))
    covers = "95 % interval covers (%)"
    assert 90.0 <= found[f"camera: area, loosened: {covers}"]
    for label in ("camera", "none"):
        for low, high in script.RANGES:
            for name in ("peak_pressure", "indentation"):
                assert 85.0 <= found[f"{label}: {name}, {low:g} to {high:g} N: {covers}"]
        assert found[f"{label}: peak_pressure, 3 to 8 N: error, RMS (%)"] < 70.0
