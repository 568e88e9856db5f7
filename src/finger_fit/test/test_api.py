# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`from finger_fit import Trial, fit`: arrays in, one result object out, without ROS."""

from __future__ import annotations

import copy
import csv
import html
import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_common.flags import AreaFlag
from finger_fit import Fit, Trial, fit
from finger_fit.cli import headline_intervals
from finger_fit.options import FitOptions
from finger_fit.problem import AreaCorrection, prepare
from finger_fit.report.figures import FIGURES
from finger_fit.report.identifiability import covariances
from finger_fit.report.page import render
from finger_fit.results import FitResult, contrasts, fit_dict
from finger_fit.search import all_free, refine
from finger_fit.study import fit_records
from finger_fit.uncertainty import covariance, profile
from finger_model.geometry import Geometry
from finger_model.laws import ParameterSpace, ParameterSpec, law_of
from finger_model.reduced.model import load_population
from finger_offline.importing.settings import ImportSettings
from finger_offline.importing.trial import import_trial
from finger_offline.trials import load_trials

QUICK: dict[str, Any] = {
    "full_order": False,
    "bootstrap": 50,
    "bias_pairs": 0,
    "grid": 3,
    "rounds": 10,
}


def trials_of(double: SimpleNamespace, number: int = 5, **about: Any) -> list[Trial]:
    """Presses as plain arrays, time from 0, force at 500 Hz, areas at 10 Hz."""
    found = []
    truth = about.pop("truth", double.TRUTH)
    for i in range(number):
        r = double.make_record(i, 0.6 + 0.3 * i, 0.3e-6, truth=truth)
        start = r.stamp_ns[0]
        time, frames = (r.stamp_ns - start) * 1e-9, (r.area_stamp_ns - start) * 1e-9
        found.append(Trial(time, r.force, r.area, frames, target_force=1.35, **about))
    return found


@pytest.fixture(scope="module")
def result(double: SimpleNamespace) -> Fit:
    trials = trials_of(double, condition="dry", subject="S01")
    return fit(trials, model=double.HereditaryModel(), **QUICK)


def test_the_truth_lies_in_the_intervals(double: SimpleNamespace, result: Fit) -> None:
    true = double.composite(double.TRUTH)
    assert result.parameters["composite_E"] == pytest.approx(true, rel=0.05)
    low, high = result.intervals["composite_E"]
    assert low < result.parameters["dry"]["composite_E"] < high
    assert low < true < high
    assert result.covariance["dry"].shape == (4, 4)
    assert np.all(np.linalg.eigvalsh(result.covariance["dry"]) > -1e-12)
    assert result.status == {"dry": "not checked"}
    assert "composite_E" in result.summary() and "kPa" in repr(result)


def test_it_predicts_areas_of_presses_that_it_has_not_seen(
    double: SimpleNamespace, result: Fit
) -> None:
    time = np.linspace(0.0, 1.5, 151)
    force = 1.2 * time / 1.5
    areas = result.predict(time, force)
    drive = (time, force, np.arange(151))
    (true,) = double.HereditaryModel().batch(double.TRUTH, [drive])
    assert areas.shape == (151,) and areas[0] == 0.0
    assert np.allclose(areas[force >= 0.4], true[0][force >= 0.4], rtol=0.02)
    # Near the onset, where the area grows fast, the lag that the fit cannot tell counts.
    nuisance = result.result.fits["dry"].nuisance
    assert nuisance is not None
    late = 2.0 * nuisance.values["lag"].sd
    assert np.all(true[0] >= 0.98 * np.interp(time - late, time, areas))
    assert np.all(true[0] <= 1.02 * np.interp(time + late, time, areas) + 1e-7)
    frames = result.frames()
    assert len(result.predict()) == len(frames["area_mm2"])
    assert np.allclose(frames["residual_mm2"], frames["area_mm2"] - frames["predicted_mm2"])
    with pytest.raises(InputError, match="time must increase"):
        result.predict(time[::-1], force)
    with pytest.raises(InputError, match="choose one of dry"):
        result.predict(time, force, "moist")


def test_it_predicts_no_areas_beyond_the_force_of_the_model(
    double: SimpleNamespace, result: Fit
) -> None:
    """`batch` would hold the force at the limit."""

    class Limited(double.HereditaryModel):
        def force_limit(self, parameters: np.ndarray) -> float:
            return 3.0

    condition = copy.copy(result.result.fits["dry"])
    condition.problem = copy.copy(condition.problem)
    condition.problem.model = Limited()
    limited = Fit(replace(result.result, fits={"dry": condition}))
    time = np.linspace(0.0, 1.0, 11)
    np.testing.assert_array_equal(limited.predict(time, 3 * time), result.predict(time, 3 * time))
    with pytest.raises(
        InputError, match=r"force 3.3 N at t = 0\.6 s is beyond the model's limit of 3 N"
    ):
        limited.predict(time, 5.5 * time)


def spec(name: str, default: float, low: float, high: float) -> ParameterSpec:
    return ParameterSpec(name, "", "Of a power law.", name, "", 1.0, 3, default, (low, high))


class PowerModel:
    """A = k F^m mm²: a model with parameters of its own and without a law."""

    space = ParameterSpace([spec("k", 40.0, 10.0, 200.0), spec("m", 0.5, 0.3, 0.9)])

    def batch(self, parameters: np.ndarray, trials: Any) -> list[np.ndarray]:
        k, m = np.atleast_2d(parameters).T[:, :, None]
        return [1e-6 * k * np.maximum(force[rows], 0.0) ** m for _, force, rows in trials]


def test_a_model_without_a_law_is_fitted_and_reported(
    double: SimpleNamespace, tmp_path: Path
) -> None:
    """What needs the full-order model of a law is left out, and a note says so."""
    trials = [
        replace(t, area=5e-5 * np.maximum(np.interp(t.area_time, t.time, t.force), 0.0) ** 0.6)
        for t in trials_of(double, 3, condition="dry")
    ]
    quick = {**QUICK, "bootstrap": 0, "profiles": False, "full_order": True}
    found = fit(trials, model=PowerModel(), **quick)
    assert found.parameters["k"] == pytest.approx(50.0, rel=0.01)
    assert found.parameters["m"] == pytest.approx(0.6, rel=0.01)
    assert found.status == {"dry": "not checked"}
    assert any("the model has no 'material'" in note for note in found.notes)
    found.report(tmp_path)
    with pytest.raises(InputError, match="give a folder"):
        found.report(tmp_path / "report.html")
    assert (tmp_path / "fit.json").is_file() and not (tmp_path / "parameters.yaml").exists()


def test_several_presses_in_one_trial_are_fitted_one_by_one(double: SimpleNamespace) -> None:
    """As the presses of one bag are, with a note that says so."""
    model = double.HereditaryModel()
    alone = trials_of(double, 4, condition="dry")
    starts = np.cumsum([0.0] + [t.time[-1] + 1.0 for t in alone[:-1]])
    session = Trial(
        np.concatenate([t.time + s for t, s in zip(alone, starts)]),
        np.concatenate([t.force for t in alone]),
        np.concatenate([t.area for t in alone]),
        np.concatenate([t.area_time + s for t, s in zip(alone, starts)]),
        condition="dry",
        target_force=1.35,
        label="session",
    )
    apart, whole = (fit(data, model=model, **QUICK) for data in (alone, session))
    assert not [note for note in apart.notes if "presses" in note]
    assert whole.notes[0] == "several presses in session (4): each press is a trial of its own"
    problem = whole.result.fits["dry"].problem
    assert [t.label for t in problem.trials] == [f"session trial {i}" for i in range(4)]
    assert whole.parameters["composite_E"] == pytest.approx(
        apart.parameters["composite_E"], rel=0.01
    )
    # A press that stays below the target is left out, with its reason.
    weak = replace(session, force=np.where(session.time < starts[1], 0.5, 1.0) * session.force)
    found = fit(weak, model=model, **QUICK)
    assert len(found.result.fits["dry"].problem) == 3
    assert any("session trial 0: force stays at" in note for note in found.notes)


def test_pandas_columns_and_one_common_time(double: SimpleNamespace) -> None:
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    presses = []
    for trial in trials_of(double, 3):
        frame = pandas.DataFrame({"time_s": trial.time, "force_n": trial.force})
        frame["area_m2"] = np.nan
        rows = np.searchsorted(trial.time, trial.area_time)
        rows = np.minimum(rows, len(frame) - 1)
        frame.loc[rows, "area_m2"] = trial.area
        presses.append(Trial(frame["time_s"], frame["force_n"], frame["area_m2"]))
    result = fit(presses, model=double.HereditaryModel(), **{**QUICK, "bootstrap": 0})
    assert result.conditions == ["all"]
    table = pandas.DataFrame(result.frames())
    assert set(table["trial"]) == {f"trials trial {i}" for i in range(3)}


def test_subjects_are_fitted_apart_and_conditions_compared(
    double: SimpleNamespace, tmp_path: Path
) -> None:
    soft = np.array([80e3, 15e3, 0.2, 1000e3])
    trials = [
        *trials_of(double, 4, condition="dry", subject="S01"),
        *trials_of(double, 4, condition="moist", subject="S01", truth=soft),
        *trials_of(double, 4, condition="dry", subject="S02"),
    ]
    # The areas of one truth must not repeat: S02 pressed a little otherwise.
    trials[8:] = [
        Trial(t.time, np.asarray(t.force) * 0.99, t.area, t.area_time, "dry", "S02",
              target_force=1.3)
        for t in trials[8:]
    ]  # fmt: skip
    result = fit(trials, model=double.HereditaryModel(), **QUICK)
    assert list(result.subjects) == ["S01", "S02"]
    assert result.subjects["S02"].conditions == ["dry"]
    found = {c.quantity: c for c in result.result.contrasts}
    assert {c.subject for c in found.values()} == {"S01"}
    contrast = found["composite_E"]
    assert (contrast.first, contrast.second) == ("dry", "moist")
    true = double.composite(double.TRUTH) / double.composite(soft)
    assert contrast.ratio_95[0] < contrast.ratio < contrast.ratio_95[1]
    assert contrast.ratio == pytest.approx(true, rel=0.1)
    assert contrast.separated and contrast.probability_greater > 0.99 and not contrast.on_bound

    result.save(tmp_path)
    data = json.loads((tmp_path / "fit.json").read_text())
    assert data["contrasts"][0]["subject"] == "S01" and "S02" in data["subjects"]
    assert data["provenance"]["command"].startswith("finger_fit.fit(")


def test_intervals_of_contrasts_cover_what_conditions_differ_by(study: FitResult) -> None:
    """Estimates drawn about two fingers whose common errors, of the gain of all areas, are large
    and cancel; the search box cuts single draws off."""
    rng = np.random.default_rng(0)
    truth, known, moves, spread = {}, {}, {}, {}
    for name, fitted in study.fits.items():
        found = fitted.covariance
        assert found is not None and found.assumed.any()
        # A tenth of the noise, where a fit is linear, and six times the error of the common gain.
        prior = found.prior.copy()
        prior[len(fitted.space) :][found.assumed] /= 6.0**2 * 10.0**2
        found = replace(
            found,
            prior=prior,
            active={},
            scores=found.scores / 10.0,
            frame_information=found.frame_information / 10.0**2,
            variance=found.variance / 10.0**2,
        )
        free = range(len(fitted.space))
        moves[name], data = found.responses(free)[found.assumed], found.data_covariance()
        truth[name] = fitted.space.to_log(fitted.parameters)
        known[name] = found
        spread[name] = np.linalg.cholesky(data + 1e-12 * np.eye(len(data)))
    covered: dict[str, list[bool]] = {}
    separated = []
    for _ in range(120):
        fits, common = {}, rng.normal(size=1)
        for name, fitted in study.fits.items():
            fits[name] = copy.copy(fitted)
            drawn = truth[name] + common @ moves[name] + spread[name] @ rng.normal(size=4)
            fits[name].parameters = fitted.space.from_log(drawn)
            fits[name].covariance = known[name]
        for c in contrasts(fits):
            one, other = (study.fits[n].quantity(c.quantity) for n in (c.first, c.second))
            hit = c.ratio_95[0] <= one / other <= c.ratio_95[1]
            covered.setdefault(c.quantity, []).append(hit)
            assert c.separated == (not c.ratio_95[0] <= 1.0 <= c.ratio_95[1])
            assert c.separated == (not c.difference_95[0] <= 0.0 <= c.difference_95[1])
            assert c.separated == (not 0.025 <= c.probability_greater <= 0.975)
            if c.quantity == "composite_E":
                separated.append(c.separated)
    shares = {name: float(np.mean(hits)) for name, hits in covered.items()}
    assert min(shares.values()) >= 0.9, shares
    assert np.mean(separated) > 0.9, "a common error of a third does not hide a ratio of 1.7"


@pytest.mark.parametrize("bootstrap", [0, 50])
def test_contrasts_of_few_presses_are_as_wide_as_their_intervals(
    double: SimpleNamespace, bootstrap: int
) -> None:
    """Each condition of three presses errs by Student's t with two degrees of freedom, which three
    presses that are resampled do not show."""
    trials = [
        *trials_of(double, 3, condition="dry", subject="S01"),
        *trials_of(double, 3, condition="moist", subject="S01", truth=1.1 * double.TRUTH),
    ]
    options = {**QUICK, "bootstrap": bootstrap, "nuisances": False}
    result = fit(trials, model=double.HereditaryModel(), **options).result
    (contrast,) = (c for c in result.contrasts if c.quantity == "composite_E")
    known = [fitted.covariance for fitted in result.fits.values()]
    scales = [k.released.data_deviation("composite_E") for k in known if k is not None]
    drawn = np.random.default_rng(1).standard_t(2, (2, 200_000)).T @ np.array(scales)
    width = np.log(contrast.ratio_95[1] / contrast.ratio_95[0])
    assert width == pytest.approx(2.0 * np.quantile(np.abs(drawn), 0.95), rel=0.15)


@pytest.mark.slow
def test_estimates_on_a_bound_are_not_compared(double: SimpleNamespace, tmp_path: Path) -> None:
    """Both held at the same bound, they would be equal for certain."""
    soft = np.array([80e3, 15e3, 0.2, 1000e3])
    trials = [
        *trials_of(double, 4, condition="dry", subject="S01"),
        *trials_of(double, 4, condition="moist", subject="S01", truth=soft),
    ]
    bounds = {"tau1": (0.3, 0.8)}
    result = fit(trials, model=double.HereditaryModel(), bounds=bounds, **QUICK)
    found = {c.quantity: c for c in result.result.contrasts}["tau1"]
    assert found.on_bound == ("dry", "moist") and not found.separated
    for fitted in result.result.fits.values():
        assert fitted.covariance is not None and fitted.covariance.deviation("tau1") > 0.0
    page = result.report(tmp_path).read_text()
    assert "<i>at a bound</i>" in page
    assert "8 presses of S01 in 2 conditions: dry, moist." in page
    assert "S01 dry trial 0" in page and "−0.000" not in page


def test_a_quantity_of_estimates_on_bounds_alone_is_not_compared(double: SimpleNamespace) -> None:
    """E0 and E1 on bounds hold composite E, of which no sample would have a spread."""
    soft = np.array([80e3, 15e3, 0.2, 1000e3])
    trials = [
        *trials_of(double, 4, condition="dry", subject="S01"),
        *trials_of(double, 4, condition="moist", subject="S01", truth=soft),
    ]
    # Both ends of the box lie between the two fingers.
    bounds = {"E0": (95e3, 105e3), "E1": (19e3, 21e3)}
    quick = {**QUICK, "profiles": False, "bootstrap": 0}
    result = fit(trials, model=double.HereditaryModel(), bounds=bounds, **quick).result
    for fitted in result.fits.values():
        assert fitted.covariance is not None and {"E0", "E1"} <= set(fitted.covariance.active)
        assert fitted.covariance.deviation("composite_E") > 0.0
    found = {c.quantity: c for c in result.contrasts}["composite_E"]
    assert found.on_bound == ("dry", "moist") and not found.separated


def test_presses_of_pooled_subjects_are_compared_under_the_codes_of_all(
    double: SimpleNamespace,
) -> None:
    soft = np.array([80e3, 15e3, 0.2, 1000e3])
    trials = [
        *trials_of(double, 3, condition="dry", subject="S02"),
        *trials_of(double, 3, condition="moist", subject="S01", truth=soft),
    ]
    quick = {**QUICK, "profiles": False, "bootstrap": 0}
    result = fit(trials, model=double.HereditaryModel(), pool=True, **quick)
    assert {c.subject for c in result.result.contrasts} == {"S01, S02"}


def test_a_tare_that_passes_leaves_the_press_its_target(double: SimpleNamespace) -> None:
    quick = {**QUICK, "profiles": False, "bootstrap": 0, "grid": 2}
    plain = [replace(t, target_force=0.0) for t in trials_of(double, 3)]
    tared = [replace(t, force=np.asarray(t.force) + 0.08) for t in plain]
    found = [fit(t, model=double.HereditaryModel(), **quick) for t in (plain, tared)]
    assert not found[1].result.exclusions
    first, second = (f.parameters["composite_E"] for f in found)
    assert second == pytest.approx(first, rel=0.02)


def test_predicted_areas_are_corrected_to_full_order(double: SimpleNamespace, result: Fit) -> None:
    """By a model whose areas are too small by a part that grows with the force."""
    condition = copy.copy(result.result.fits["dry"])
    problem = copy.copy(condition.problem)
    part = 0.02 + 0.01 * np.log(problem.force)
    problem.correction = AreaCorrection(
        problem.space, condition.parameters, part, np.zeros((4, len(part)))
    )
    condition.problem = problem
    corrected = Fit(replace(result.result, fits={"dry": condition}))
    time = np.linspace(0.0, 1.5, 16)
    force = 1.2 * time / 1.5
    ratio = corrected.predict(time, force)[4:] / result.predict(time, force)[4:]
    np.testing.assert_allclose(np.log(ratio), 0.02 + 0.01 * np.log(force[4:]), atol=1e-6)


@pytest.mark.slow
def test_a_cluster_fits_each_subject_as_this_machine_does(double: SimpleNamespace) -> None:
    distributed = pytest.importorskip("distributed")
    trials = [
        *trials_of(double, 3, condition="dry", subject="S01"),
        *trials_of(double, 3, condition="dry", subject="S02", truth=double.TRUTH * 0.9),
        *trials_of(double, 2, condition="dry", subject="S03", truth=double.TRUTH * 0.8),
    ]
    here = fit(trials, model=double.HereditaryModel(), **QUICK)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        there = fit(trials, model=double.HereditaryModel(), dask=address, **QUICK)
    assert list(there.subjects) == list(here.subjects) == ["S01", "S02"]
    for name in here.subjects:
        ours, theirs = here.subjects[name], there.subjects[name]
        assert theirs.parameters == ours.parameters and theirs.intervals == ours.intervals
    assert there.result.problems == here.result.problems
    assert any("S03" in note and "2 trials" in note for note in there.result.problems)


def test_saved_tables_hold_what_was_found(result: Fit, tmp_path: Path) -> None:
    folder = result.save(tmp_path / "out")
    with (folder / "tables" / "frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(result.predict())
    observed, predicted, residual = (
        np.array([float(r[k]) for r in rows]) for k in ("area_mm2", "predicted_mm2", "residual_mm2")
    )
    assert np.allclose(observed - predicted, residual, atol=1e-3)
    with (folder / "tables" / "parameters.csv").open() as file:
        found = {r["quantity"]: r for r in csv.DictReader(file)}
    value = result.parameters["E2"] * 1e-3
    assert float(found["E2"]["value"]) == pytest.approx(value, rel=1e-5)
    text = (folder / "tables" / "parameters.tex").read_text()
    rows_of_tex = text.split(r"\midrule")[1].split(r"\bottomrule")[0].strip().splitlines()
    assert len(rows_of_tex) == 5 and all(r.endswith(r"\\") for r in rows_of_tex)
    columns = text.splitlines()[1].split("}{")[1].rstrip("}")
    assert all(r.count(" & ") == len(columns) - 1 for r in rows_of_tex)
    for name in ("goodness", "trials"):
        assert (folder / "tables" / f"{name}.csv").stat().st_size > 0


@pytest.mark.parametrize("rate", [500.0, 2000.0, 10_000.0])
@pytest.mark.parametrize("duration", [0.5, 1.1])
def test_times_in_milliseconds_are_refused_at_every_rate(rate: float, duration: float) -> None:
    """Samples of the force may be as close as in a long press, frames are not."""
    time = np.arange(0.0, duration, 1.0 / rate)
    frames = np.arange(0.0, duration, 1.0 / 30.0)
    force, area = (np.sin(np.pi * t / duration) for t in (time, frames))
    with pytest.raises(InputError, match="give the time in s, or a press of up to 1200 s"):
        fit([Trial(1e3 * time, force, 9e-5 * area, 1e3 * frames)])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"force": [0.0, 1.0]}, "trial 0: 2 values of force"),
        ({"force": "much"}, "trial 0: force holds something else than numbers"),
        ({"time": [0.0] * 200}, "trial 0: time must increase"),
        ({"force": -np.ones(200)}, "positive when the finger presses"),
        ({"force": np.sin(np.linspace(0.0, 2.0, 200)) / 9.80665}, "no press of 0.2 N.*0.102 N"),
        ({"area": np.full(200, np.inf)}, "area: value 0 is not finite"),
        ({"area": np.full(200, np.nan)}, "trial 0: area holds no number"),
        ({"area": 50.0 * np.sin(np.linspace(0.0, 2.0, 200))}, "is 50 m².*give the area in m²"),
        ({"force": 1e3 * np.sin(np.linspace(0.0, 2.0, 200))}, "up to 1000 N.*give it in N"),
        ({"time": np.linspace(0.0, 2000.0, 200)}, "lasts 1.*give the time in s"),
        (
            {"time": np.linspace(0.0, 2000.0, 200)},
            "lasts 1.*or a press of up to 1200 s with two samples of the force or more in each",
        ),
        ({"time": np.linspace(0.0, 800.0, 200)}, "lasts .*give the time in s, or"),
        ({"area_time": 500.0 + np.linspace(0.0, 2.0, 200)}, "area_time on the clock of time"),
        ({"time": np.round(np.linspace(0.0, 2.0, 200), 1)}, r"increase \(values 0 and 1 do not"),
        ({"force": np.ones(200) * 1j}, "force holds something else than numbers"),
        ({"force": np.ma.masked_less(np.sin(np.linspace(0, 2, 200)), 0.1)}, "force: value 0"),
        ({"area": np.full(200, -5e-5)}, "area is nowhere above zero"),
        (
            {"area": np.where(np.arange(200) == 90, -4e-5, 5e-5)},
            r"trial 0: area -4e-05 m² at t = 0\.9045 s is negative; correct it, or give NaN",
        ),
        ({"moisture": "wet"}, "moisture holds something else than numbers"),
        ({"target_force": 30.0}, r"target_force is 30 N, the press goes up to 1 N"),
        ({"target_force": "1 N"}, "target_force is '1 N'; give a number"),
        ({"target_force": 1j}, "target_force is 1j; give a number"),
        ({"index": "first"}, "index is 'first'; give a number"),
        ({"condition": "dry/left"}, "condition 'dry/left' is not valid"),
        ({"subject": "../S01"}, r"subject '\.\./S01' is not valid"),
    ],
)
def test_bad_arrays_are_named(change: dict[str, Any], sentence: str) -> None:
    time = np.linspace(0.0, 2.0, 200)
    good = {"time": time, "force": np.sin(time), "area": 5e-5 * np.sin(time)}
    with pytest.raises(InputError, match=sentence):
        fit([Trial(**{**good, **change})])
    with pytest.raises(InputError, match="no trial was given"):
        fit([])
    with pytest.raises(InputError, match=r"trial 1 is of type dict; give a list of Trial\("):
        fit([Trial(**good), good])
    with pytest.raises(InputError, match=r"'dry' has 1 trial, 3 are needed.*left out.*same press"):
        fit([Trial(**good, condition="dry")] * 3)
    with pytest.raises(InputError, match="did you mean 'bootstrap'"):
        fit([Trial(**good)], bootstraps=3)


def test_presses_of_one_commanded_force_are_all_fitted(double: SimpleNamespace) -> None:
    """They were thrown away as one press, though each has areas of its own."""
    rng = np.random.default_rng(0)
    (press,) = trials_of(double, 1, condition="dry", subject="S01")
    noise = 0.3e-6 * rng.normal(size=(3, len(press.area))) * (press.area > 0)
    found = fit(
        [replace(press, area=press.area + own) for own in noise],
        model=double.HereditaryModel(),
        **{**QUICK, "bootstrap": 0, "profiles": False},
    )
    assert len(found.result.fits["dry"].problem) == 3
    assert any("same force" in note and "S01 dry trial 2; all" in note for note in found.notes)


def test_noise_on_an_area_of_zero_is_no_contact() -> None:
    time = np.linspace(0.0, 2.0, 200)
    area = 5e-5 * np.sin(time)
    area[0] = -1e-6
    record = Trial(time, np.sin(time), area).records(0, 0)[0]
    assert record.area[0] == -1e-6 and record.area_flags[0] == AreaFlag.NO_CONTACT


@pytest.mark.parametrize("missing", [None, math.nan, np.float32("nan"), np.datetime64("NaT", "ns")])
def test_a_missing_condition_is_none(missing: Any) -> None:
    """As columns of pandas have it; it became a condition named nan."""
    time = np.linspace(0.0, 2.0, 200)
    (record,) = Trial(
        time, np.sin(time), 5e-5 * np.sin(time), condition=missing, subject=missing
    ).records(0, 0)
    assert record.condition == "" and record.subject == ""


class Foreign:
    """A column of another library: only `__array__`."""

    def __init__(self, values: Any) -> None:
        self.values = np.asarray(values)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self.values if dtype is None else self.values.astype(dtype)


def test_columns_of_many_kinds_are_taken() -> None:
    pandas = pytest.importorskip("pandas")
    time = np.arange(0.0, 2.0, 0.01)
    force, area = np.sin(time), 5e-5 * np.sin(time)
    dates = pandas.to_datetime(1.7e9 + time, unit="s", utc=True)
    wanted = Trial(time, force, area).records(0, 0)[0]
    for kind in (
        Foreign, list, tuple, pandas.Series, np.ma.asarray, lambda a: np.asarray(a)[:, None],
    ):  # fmt: skip
        found = Trial(kind(time), kind(force), kind(area), condition=None, subject=None).records(
            0, 0
        )[0]
        assert np.array_equal(found.force, wanted.force) and found.subject == ""
        assert np.array_equal(found.stamp_ns, wanted.stamp_ns) and found.condition == ""
    for clock in (dates, list(dates.to_pydatetime()), dates.tz_convert("Asia/Tokyo")):
        found = Trial(clock, force, area).records(0, 0)[0]
        assert np.allclose(np.diff(found.stamp_ns), 1e7, atol=3e3)
    hidden = np.ma.masked_where(time < 1.0, area)
    assert len(Trial(time, force, hidden).records(0, 0)[0].area) == 100


@pytest.mark.parametrize(
    "bounds",
    [
        {"E2": (500e3, 3e6)},
        {"E2": ("500kPa", "3MPa")},
        {"E2": "500kPa:3MPa"},
        "E2=500kPa:3MPa",
        ["E2=500kPa:3MPa"],
    ],
)
def test_bounds_may_be_a_mapping(double: SimpleNamespace, bounds: Any) -> None:
    quick = {**QUICK, "bootstrap": 0, "grid": 3, "rounds": 2, "nuisances": False}
    found = fit(trials_of(double, 3), model=double.HereditaryModel(), bounds=bounds, **quick)
    (one,) = found.result.fits.values()
    assert one.problem.box[one.space.index("E2")].tolist() == [500e3, 3e6]


def test_without_profiles_the_covariance_gives_the_intervals(
    double: SimpleNamespace, result: Fit
) -> None:
    quick = {**QUICK, "bootstrap": 0, "profiles": False}
    plain = fit(trials_of(double), model=double.HereditaryModel(), **quick)
    low, high = plain.intervals["composite_E"]
    inner = plain.data_intervals["composite_E"]
    assert low < inner[0] < plain.parameters["composite_E"] < inner[1] < high
    # The gain of all areas is assumed in both: the whole interval is wider than that of the data.
    profiled = result.intervals["composite_E"]
    assert np.log(high / low) == pytest.approx(np.log(profiled[1] / profiled[0]), rel=0.3)


def test_a_report_names_the_method_of_its_intervals_and_marks_where_they_are_cut_off(
    double: SimpleNamespace,
) -> None:
    trials = trials_of(double, 4, condition="dry")
    bounds = {"E0": (115e3, 125e3), "E1": (24e3, 26e3), "tau1": (0.3, 0.8)}
    quick = {**QUICK, "bootstrap": 0, "bounds": bounds}
    pages, lines = {}, {}
    for profiles in (False, True):
        options = {**quick, "profiles": profiles, "polish": profiles}
        found = fit(trials, model=double.HereditaryModel(), **options)
        page = render(found.result, dict.fromkeys(FIGURES, b""))
        pages[profiles] = html.unescape(re.sub("<[^>]+>", " ", page))
        (fitted,) = found.result.fits.values()
        lines[profiles] = found.summary(), headline_intervals(fitted)
        known = fitted.found("E1")
        assert known.interval == (24e3, 26e3) and known.cut == (True, True)
        entry = fit_dict(found.result)["conditions"]["dry"]["interval_95"]["E1"]
        assert entry["low_is_bound"] and entry["high_is_bound"]
    plain, profiled = pages[False], pages[True]
    assert not re.search("profile likelihood|after the bounded local polish", plain)
    assert "95 % intervals from the covariance (no profiles were computed). * The search" in plain
    assert "95 % intervals by profile likelihood" in profiled and "covariance (no" not in profiled
    assert "Band: 95 % interval by profile likelihood" in profiled
    assert "24.00* – 26.00*" in plain
    for summary, line in lines.values():
        assert re.search(r"E1 .*\[24\.\d+\*, 26\.\d+\*\]", summary)
        assert summary.endswith(
            "\n* The search box ends here. The data do not limit the value on this side."
        )
        assert re.match(r"E 19\.86\* to 21\.52\* kPa \(95 %\); ", line)
    # A parameter that is held by a bound has no deviation.
    assert fitted.covariance is not None and "tau1" in fitted.covariance.active
    table = covariances(found.result)
    assert "<td>–</td>" in table and "0.0 %" not in table


def test_dates_are_times() -> None:
    time = np.linspace(0.0, 2.0, 201)
    dates = np.datetime64("2026-05-01T10:00:00") + np.round(time * 1e9).astype("timedelta64[ns]")
    plain, dated = (
        Trial(t, np.sin(time), 5e-5 * np.sin(time)).records(0, 0)[0] for t in (time, dates)
    )
    steps = np.diff(dated.stamp_ns) - np.diff(plain.stamp_ns)
    assert np.abs(steps).max() < 1000, "ns"
    np.testing.assert_array_equal(dated.stamp_ns, dated.area_stamp_ns)
    spans = np.round(time * 1e9).astype("timedelta64[ns]")
    spanned = Trial(spans, np.sin(time), 5e-5 * np.sin(time)).records(0, 0)[0]
    np.testing.assert_array_equal(spanned.stamp_ns, plain.stamp_ns)


@pytest.mark.parametrize("shift", [0.0, -0.5, 3.0])
def test_areas_keep_their_place_whatever_the_origin_of_time(
    double: SimpleNamespace, shift: float
) -> None:
    """Times may count from the onset: areas begin later than the force, and force below zero."""
    (trial,) = trials_of(double, 1)
    plain = trial.records(0, 0)[0]
    moved = replace(trial, time=trial.time + shift, area_time=trial.area_time + shift).records(
        0, 0
    )[0]
    lag = moved.area_stamp_ns - moved.stamp_ns[0] - (plain.area_stamp_ns - plain.stamp_ns[0])
    assert np.abs(lag).max() < 1000, "ns"


def test_importing_needs_no_ros() -> None:
    code = (
        "import sys; sys.modules['rclpy'] = None; sys.modules['finger_msgs'] = None\n"
        "from finger_fit import Trial, fit; print(Trial.__name__, fit.__name__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["Trial", "fit"]


def test_help_does_not_wait_for_imports_that_only_a_fit_needs() -> None:
    """Each of these takes a quarter of a second or more."""
    needless = ("cma", "pymoo", "matplotlib", "scipy.signal", "scipy.stats")
    code = (
        "import sys\nfrom finger_fit.cli import command\n"
        "try:\n    command(['--help'])\nexcept SystemExit:\n"
        f"    assert not [n for n in {needless} if n in sys.modules], sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


@pytest.mark.slow
def test_a_parameter_that_may_be_zero_is_fitted_with_intervals(tmp_path: Path) -> None:
    """Stiffening of 0, as of the tissue here, has no logarithm: its coordinate is ln(b + 0.1)."""
    tissue = law_of("generalized_maxwell_1")(
        E0=80e3, fraction_1=0.6, tau_1=0.3, E2=1.2e6, stiffening=0.0
    )
    model = load_population(Geometry()).for_material(tissue)
    random = np.random.default_rng(0)
    trials = []
    for condition in ("dry", "moist"):
        for rise in (0.3, 0.6, 1.0):
            time = np.arange(0.0, rise + 0.6, 0.01)
            force = 1.35 * np.clip(np.minimum((time - 0.4) / rise, 1.0), 0.0, None)
            area = model.simulate(tissue, time, force).area[::10]
            area = area + np.where(area > 0, 1e-6 * random.normal(size=len(area)), 0.0)
            trials.append(Trial(time, force, np.maximum(area, 0.0), time[::10], condition))
    found = fit(
        trials,
        **{**QUICK, "grid": 2, "bootstrap": 0, "bias_pairs": 1, "step": 0.05},
        law=tissue.name,
        bounds={"stiffening": (0, 3)},
        nuisances=False,
        profiles=False,
    )
    fitted = found.result.fits["dry"]
    known, space = fitted.covariance, fitted.space
    assert set(fitted.bias_corrected) == set(space.quantity_names)
    for name in space.quantity_names:
        assert np.isfinite(known.deviation(name)), name
    best = fitted.parameters, fitted.cost
    # Two of the eight, for their time.
    fitted.profiles = {
        name: profile(fitted.problem, name, *best, known) for name in ("stiffening", "long_term_E")
    }
    low, high = fitted.profiles["stiffening"].interval
    assert low == pytest.approx(0.0, abs=1e-9) and 0.0 < high <= 3.0
    low, high = fitted.profiles["long_term_E"].interval
    assert low < 32e3 < high
    stiffening = next(c for c in found.result.contrasts if c.quantity == "stiffening")
    assert np.isnan(stiffening.ratio) and np.isfinite(stiffening.difference)
    assert not re.search(r"\bnan\b", found.report(tmp_path).read_text())
    json.loads((tmp_path / "fit.json").read_text())


SCRIPT = """
import numpy as np
from finger_fit.engine import LocalEngine

{definition}
print(LocalEngine(2).spread({function}, np.zeros(100_000), [1, 2, 3]))
"""


@pytest.mark.parametrize("own", [False, True])
def test_a_script_without_main_guard_does_not_hang(tmp_path: Path, own: bool) -> None:
    """Worker processes do not run the script again; where they must, as it has the function, the
    user is told."""
    function = "size_of" if own else "np.take"
    script = tmp_path / "user.py"
    definition = "def size_of(a, b): return len(a) + b" if own else ""
    script.write_text(SCRIPT.format(definition=definition, function=function))
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, timeout=120, check=False
    )
    if own:
        assert done.returncode != 0
        assert "is not under 'if __name__ == \"__main__\":'" in done.stderr
    else:
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("0.0") == 3


def test_frames_that_do_not_count_leave_the_intervals_alone(double: SimpleNamespace) -> None:
    trials = trials_of(double, 4)
    collapsed = [
        replace(t, area=np.where(np.interp(t.area_time, t.time, t.force) < 0.5, 0.3, 1.0) * t.area)
        for t in trials
    ]
    options = {**QUICK, "low_force": 0.5, "low_force_weight": 0.0, "bootstrap": 0}
    one, other = (
        fit(given, model=double.HereditaryModel(), **options).result.fits["all"]
        for given in (trials, collapsed)
    )
    assert other.parameters == pytest.approx(one.parameters, rel=1e-3)
    assert other.covariance.noise == pytest.approx(one.covariance.noise, rel=0.02)
    with pytest.raises(InputError, match="every frame of these trials lies below low_force"):
        fit(trials, model=double.HereditaryModel(), **{**options, "low_force": 5.0})


def test_one_condition_may_be_named_by_a_text(double: SimpleNamespace) -> None:
    trials = trials_of(double, 3, condition="dry") + trials_of(double, 3, condition="moist")
    some = {**QUICK, "bootstrap": 0, "profiles": False}
    assert fit(trials, model=double.HereditaryModel(), conditions="dry", **some).conditions == [
        "dry"
    ]


def test_areas_that_a_logger_held_count_once(double: SimpleNamespace) -> None:
    """Each area again in all rows up to the next frame, as `finger-bag import` finds it too."""
    plain = trials_of(double, 4, condition="dry", subject="S01")
    quick = {**QUICK, "bootstrap": 0, "profiles": False}
    held = []
    for trial in plain:
        last = np.searchsorted(trial.area_time, trial.time, side="right") - 1
        rows = np.flatnonzero(last >= 0)[::5]
        area = np.asarray(trial.area)[last[rows]]
        held.append(replace(trial, area=area, area_time=trial.time[rows]))
    few = [len(t.area) for t in held]
    found = fit(held, model=double.HereditaryModel(), **quick)
    once = fit(plain, model=double.HereditaryModel(), **quick)
    (note,) = (n for n in found.notes if "hold the area of the row before" in n)
    assert "trial 0, trial 1" in note and int(note.split(": ")[1].split()[0]) > 0.7 * sum(few)
    assert len(found.frames()["time_s"]) == len(once.frames()["time_s"])
    assert found.parameters["composite_E"] == pytest.approx(
        once.parameters["composite_E"], rel=0.02
    )
    known, other = (r.result.fits["dry"].covariance for r in (found, once))
    assert known is not None and other is not None
    assert known.data_deviation("E1") == pytest.approx(other.data_deviation("E1"), rel=0.5)
    assert not any("hold the area" in n for n in once.notes)


@pytest.mark.parametrize("rise", [0.06, 0.08, 0.1])
def test_fast_presses_reach_their_own_target(double: SimpleNamespace, rise: float) -> None:
    """The target is of the force without its noise, as it is checked."""
    time = np.arange(0.0, 1.2, 0.002)
    force = 2.0 * np.clip(np.minimum((time - 0.4) / rise, (0.4 + rise + 0.1 - time) / 0.1), 0, 1)
    force += np.random.default_rng(0).normal(0.0, 0.003, len(force))
    frames = np.arange(0, len(time), 5)
    wanted = (time, np.maximum(force, 0.0), frames)
    area = double.HereditaryModel().batch(double.TRUTH, [wanted])[0][0]
    area[(time[frames] < 0.4) | (time[frames] > 0.5 + rise)] = 0.0
    (record,) = Trial(time, force, area, time[frames], "dry").records(0, 0)
    assert 0.6 * 2.0 < record.target_force < 0.95 * force.max()
    assert len(prepare(record, FitOptions()).area) >= 3


def test_a_press_has_the_same_target_from_python_and_from_a_file(tmp_path: Path) -> None:
    time = np.arange(0.0, 3.0, 0.004)
    force = 1.517 * np.clip(np.minimum(time - 0.5, 2.5 - time), 0.0, 1.0)
    frames = np.arange(0, len(time), 25)
    area = 60.0 * force[frames] ** 0.5
    files = {"force": force, "area": area}
    for name, at, unit in (("force", slice(None), "force_n"), ("area", frames, "area_mm2")):
        columns = np.column_stack([time[at], files[name]])
        np.savetxt(tmp_path / f"{name}.csv", columns, "%.6f", ",", header=f"time_s,{unit}",
                   comments="")  # fmt: skip
    settings = ImportSettings(
        force=str(tmp_path / "force.csv"), area=str(tmp_path / "area.csv"),
        subject="S01", condition="dry",
    )  # fmt: skip
    (imported,) = load_trials(import_trial(settings, tmp_path / "bag").path)
    (record,) = Trial(time, force, area * 1e-6, time[frames], "dry").records(0, 0)
    assert record.target_force == imported.target_force == 1.42


def test_labels_are_taken_without_blanks_and_in_one_case(double: SimpleNamespace) -> None:
    quick = {**QUICK, "bootstrap": 0, "profiles": False}
    model = double.HereditaryModel()
    trials = trials_of(double, 5, condition="dry", subject="S01")
    spelled = [*trials[:3], *(replace(t, condition=" dry ", subject="S01 ") for t in trials[3:])]
    found = fit(spelled, model=model, **quick)
    assert found.conditions == ["dry"] and not found.subjects
    assert len(found.result.fits["dry"].problem) == 5
    for change in ({"condition": "Dry"}, {"subject": "s01"}):
        other = [*trials[:4], replace(trials[4], **change)]
        with pytest.raises(
            InputError, match="differ in case or spaces alone; write one name in one way"
        ):
            fit(other, model=model, **quick)


@pytest.mark.slow
def test_contrasts_cover_what_differs_where_estimates_lie_on_bounds(
    double: SimpleNamespace,
) -> None:
    """Few noisy presses: a parameter on a bound is not known, and neither is what depends on it."""
    truth = {
        "dry": np.array([120e3, 38.56e3, 0.2, 1452e3]),
        "wet": np.array([110e3, 18e3, 0.05, 900e3]),
    }
    space = double.HereditaryModel.space
    options = FitOptions(
        full_order=False, bootstrap=0, bias_pairs=0, grid=3, rounds=3, profiles=False
    )
    covered: dict[str, list[bool]] = {}
    for seed in range(500, 530):
        rng = np.random.default_rng(seed)
        records = [
            double.make_record(i, rng.uniform(0.4, 2.0), 3e-6, rng, condition=name, truth=own)
            for name, own in truth.items()
            for i in range(4)
        ]
        result = fit_records(records, double.HereditaryModel(), options)
        bounds = [f.covariance.active for f in result.fits.values() if f.covariance is not None]
        for c in result.contrasts:
            one, other = (space.quantity(c.quantity, truth[n]) for n in ("dry", "wet"))
            hit = c.ratio_95[0] <= one / other <= c.ratio_95[1]
            if any(bounds):
                covered.setdefault(c.quantity, []).append(bool(hit))
    assert min(map(len, covered.values())) > 20
    shares = {name: float(np.mean(hits)) for name, hits in covered.items()}
    assert min(shares.values()) >= 0.9, shares


def test_the_deviation_of_e_is_that_of_its_errors_where_another_parameter_is_on_a_bound(
    double: SimpleNamespace,
) -> None:
    """E1 answers to E2: held at its bound, E2 would make E seem known three times too well."""
    truth = np.array([120e3, 25e3, 0.2, 2000e3])
    options = FitOptions(nuisances=False, press_gain=False)
    ratios = []
    for seed in range(100):
        problem = double.make_problem(2e-6, 4, options, seed, truth)
        best = refine(problem, all_free(problem), truth).parameters
        known = covariance(problem, best)
        if "E2" in known.active and not known.holds("composite_E"):
            error = np.log(double.composite(best) / double.composite(truth))
            gradient = known.space.log_gradient("composite_E", best)
            held = np.sqrt(gradient @ known.data_covariance() @ gradient)
            ratios.append([error / known.data_deviation("composite_E"), error / held])
    assert len(ratios) >= 15
    released, held = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert released < 1.2 < held


def test_a_covariance_without_active_bounds_is_released_unchanged(study: FitResult) -> None:
    for fitted in study.fits.values():
        found = fitted.covariance
        assert found is not None
        if not found.active:
            assert found.released is found
            continue
        free = found.released
        low, high = fitted.space.to_log(fitted.problem.box.T)
        for name in fitted.space.quantity_names:
            assert free.data_deviation(name) > 0.0
        for name in found.active:
            width = (high - low)[fitted.space.index(name)]
            assert free.data_deviation(name) <= width
