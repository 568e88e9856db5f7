# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A measured indentation beside the areas: recovery, zeros, gain, mixing, and what is refused."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_fit import Trial, fit
from finger_fit.design import Plan
from finger_fit.full_order import FullOrder
from finger_fit.full_order.areas import trial_areas
from finger_fit.nuisance.estimate import NuisanceModel
from finger_fit.nuisance.geometry import FullOrderGeometry, PopulationGeometry, geometry_responses
from finger_fit.options import FitOptions
from finger_fit.problem import FitProblem, in_rows, prepare_all
from finger_fit.report.figures import all_figures
from finger_fit.uncertainty import Covariance, covariance, in_interval
from finger_model.geometry import Geometry
from finger_model.reduced import ReducedModel
from finger_model.reduced.model import load_population

SENSOR = 20e-6
"""m, noise of a reading at a frame."""

NOISE = 1.0e-6
"""m², of an area."""

QUICK: dict[str, Any] = {
    "full_order": False, "bootstrap": 0, "bias_pairs": 0, "grid": 3, "rounds": 10,
}  # fmt: skip
ALONE: dict[str, Any] = {"area_gain_sd": 0.0, "collapse_sd": 0.0, "geometry_sd": []}
"""Without what is only assumed, so that the data alone speak."""


def presses(
    double: SimpleNamespace, number: int = 6, seed: int = 0, model: Any = None,
    truth: np.ndarray | None = None, rate: float = 0.0, gain: float = 1.0, peak: float = 1.5,
) -> list[Trial]:  # fmt: skip
    """Presses with areas and an indentation of unknown zero, at the frames or at a rate (Hz)."""
    rng = np.random.default_rng(seed)
    model = model or double.HereditaryModel()
    truth = double.TRUTH if truth is None else truth
    found = []
    for index, ramp in enumerate(np.linspace(0.5, 2.0, number)):
        record = double.make_record(index, ramp, peak=peak)
        start = record.stamp_ns[0]
        time, frames = (record.stamp_ns - start) * 1e-9, (record.area_stamp_ns - start) * 1e-9
        own = np.arange(0.0, time[-1], 1.0 / rate) if rate else frames
        knots = np.unique(np.concatenate([time, frames, own]))
        drive = (knots, np.interp(knots, time, record.force), np.arange(len(knots)))
        area, indentation = model.contacts(truth[None], [drive])[0][:, 0]
        area = np.interp(frames, knots, area)
        area = np.where(area > 0, np.maximum(area + NOISE * rng.normal(size=len(area)), 1e-9), 0.0)
        indentation = gain * np.interp(own, knots, indentation) + rng.uniform(-5e-3, 5e-3)
        indentation = indentation + SENSOR * rng.normal(size=len(own))
        found.append(
            Trial(
                time, record.force, area, frames, "dry", "S01", target_force=0.9 * peak,
                indentation=indentation, indentation_time=own,
            )
        )  # fmt: skip
    return found


def problem_of(double: SimpleNamespace, options: FitOptions, trials: list[Trial]) -> FitProblem:
    prepared, excluded = prepare_all([t.records(i, i)[0] for i, t in enumerate(trials)], options)
    assert not excluded
    return FitProblem(prepared, double.HereditaryModel(), options)


def test_the_finger_is_recovered_better_than_without(double: SimpleNamespace) -> None:
    """Of a sensor with noise and unknown zeros: narrower intervals that hold the truth."""
    trials = presses(double)
    wide = {"window": "contact", "bounds": ["E0=20kPa:900kPa", "tau1=0.05s:1s"]}
    model = double.HereditaryModel()
    both = fit(trials, model=model, **QUICK, **ALONE, **wide)
    alone = fit(trials, model=model, indentation_sd=0.0, **QUICK, **ALONE, **wide)
    space = both.result.space
    for name in (*space.names, "composite_E"):
        true = float(space.quantity(name, double.TRUTH))
        low, high = both.intervals[name]
        assert low < true < high, name
    for name in ("E2", "composite_E"):
        widths = [np.log(f.intervals[name][1] / f.intervals[name][0]) for f in (both, alone)]
        assert widths[0] < 0.9 * widths[1], name
    found = both.result.fits["dry"]
    assert found.indentation is not None and alone.result.fits["dry"].indentation is None
    zeros = np.array(list(found.indentation.zeros.values()))
    shifts = [float(np.median(t.indentation[t.indentation_time < 0.3])) for t in trials]
    assert np.abs(zeros - shifts).max() < 60e-6
    assert found.indentation.rms == pytest.approx(SENSOR, rel=0.35)
    # J stays that of the areas alone.
    assert found.cost == pytest.approx(
        found.problem.trial_costs(found.problem.areas(found.parameters)[0]).sum(), rel=1e-12
    )


NATURAL = np.array([140e3, 22e3, 0.5, 1795e3])


def settled(
    model: Any, truth: np.ndarray, sensor: float, seed: int, made_by: Any = None, **options: Any
) -> tuple[FitProblem, np.ndarray, float, Covariance]:
    """Six simulated presses, fitted with nuisances in a wide box; made_by: the true finger."""
    plan = Plan(presses=6, hold=0.5, window="contact", scatter=0.02, indentation_sd=sensor)
    given = FitOptions(**options)
    made = plan.problem(made_by or model, truth, given, np.random.default_rng(seed))
    problem = FitProblem(made.trials, model, made.options)
    problem.box = np.array([[20e3, 1e6], [5e3, 200e3], [0.05, 2.0], [300e3, 6e6]])
    found = NuisanceModel(problem, given, population=PopulationGeometry.like(model)).settle(truth)
    at = found.fit.parameters
    return problem, at, found.fit.cost, covariance(problem, at)


@pytest.mark.slow
def test_the_finger_of_the_paper_is_recovered_better_than_without() -> None:
    """By the reduced model, with all nuisances: E0 and E1, and intervals that hold the truth."""
    model = ReducedModel.load()
    for seed in range(2):
        with_it, without = (settled(model, NATURAL, sd, seed) for sd in (SENSOR, 0.0))
        for name, gain in (("E0", 0.5), ("E1", 0.85)):
            deviations = [f[3].data_deviation(name) for f in (with_it, without)]
            assert deviations[0] < gain * deviations[1], name
        problem, at, cost, known = with_it
        for name in (*problem.space.names, "composite_E"):
            true = float(problem.space.quantity(name, NATURAL))
            assert in_interval(problem, name, true, at, cost, known), name


@pytest.mark.slow
def test_a_finger_of_other_lengths_lies_in_the_intervals() -> None:
    """The indentation answers to the lengths by 10 to 15 %, and must not be believed beyond."""
    assumed = Geometry()
    for length, factor in (("pad_semi_axis_axial", 1.08), ("bone_semi_axis_axial", 0.85)):
        value = factor * getattr(assumed, length)
        true_finger = ReducedModel.load(geometry=replace(assumed, **{length: value}))
        model = load_population(assumed)
        problem, at, cost, known = settled(model, NATURAL, SENSOR, 0, true_finger)
        for name in ("E0", "E1", "E2", "composite_E"):
            true = float(problem.space.quantity(name, NATURAL))
            assert in_interval(problem, name, true, at, cost, known), (length, name)


def test_the_zero_of_a_trial_does_not_count(double: SimpleNamespace) -> None:
    options = FitOptions()
    trials = presses(double, 4)
    moved = [
        replace(t, indentation=np.asarray(t.indentation) + 1e-3 * (i - 2))
        for i, t in enumerate(trials)
    ]
    candidates = np.array([double.TRUTH, 1.2 * double.TRUTH])
    costs = [problem_of(double, options, t).cost(candidates) for t in (trials, moved)]
    np.testing.assert_allclose(*costs, rtol=1e-9)


def test_trials_with_and_without_indentation_are_fitted_together(double: SimpleNamespace) -> None:
    trials = presses(double, 6)
    mixed = [t if i % 2 else replace(t, indentation=None) for i, t in enumerate(trials)]
    result = fit(mixed, model=double.HereditaryModel(), **QUICK, **ALONE)
    found = result.result.fits["dry"]
    assert found.indentation is not None
    assert list(found.indentation.zeros) == [f"S01 dry trial {i}" for i in (1, 3, 5)]
    checks = {c.name: c for c in found.quality.checks}
    assert checks["indentation"].status == "note"
    assert "3 of 6 presses" in checks["indentation"].detail
    low, high = result.intervals["E1"]
    assert low < double.TRUTH[1] < high


def test_without_readings_nothing_changes(double: SimpleNamespace) -> None:
    plain = [replace(t, indentation=None) for t in presses(double, 4)]
    unused = presses(double, 4)
    one, other = (
        problem_of(double, FitOptions(indentation_sd=sd), t)
        for sd, t in ((20e-6, plain), (0.0, unused))
    )
    assert one.indentations is None and other.indentations is None
    np.testing.assert_array_equal(one.cost(double.TRUTH), other.cost(double.TRUTH))
    assert one.key() == other.key()


def test_a_fast_sensor_is_smoothed_and_meets_the_frames(double: SimpleNamespace) -> None:
    problem = problem_of(double, FitOptions(), presses(double, 3, rate=200.0))
    truth = problem.raw(double.TRUTH)[0][len(problem.measured) :]
    rows = problem.indentations
    assert rows is not None and len(rows.measured) == len(problem.measured)
    left = rows.measured - truth
    left = left - rows.means(left)
    assert np.sqrt(np.mean(left**2)) < 0.7 * SENSOR


def test_nothing_is_made_up_where_the_sensor_was_silent(double: SimpleNamespace) -> None:
    whole = presses(double, 2, rate=200.0)[1]
    options, time = FitOptions(), whole.indentation_time
    assert time is not None and whole.indentation is not None
    compared = problem_of(double, options, [whole]).trials[0].recording.indentation_time
    first, last = compared[len(compared) // 3], compared[2 * len(compared) // 3]
    told = (time < first - 0.01) | (time > last + 0.01)
    silent = replace(whole, indentation=whole.indentation[told], indentation_time=time[told])
    found = problem_of(double, options, [silent]).trials[0].recording.indentation_time
    assert last - first > 0.1
    np.testing.assert_array_equal(found, compared[(compared < first) | (compared > last)])


def test_images_that_are_late_do_not_move_the_indentation(double: SimpleNamespace) -> None:
    """The displacement sensor shares the clock of the force; the images' lag is not its own."""
    options = FitOptions(tare_sd=0.0, **ALONE)
    late = [replace(t, area_time=np.asarray(t.area_time) + 0.03) for t in presses(double, 6)]
    problem = problem_of(double, options, late)
    model = NuisanceModel(problem, options)
    settled = model.settle(double.TRUTH[None])
    assert model.state.lag == pytest.approx(0.03, abs=0.012)
    error = np.log(settled.fit.parameters / double.TRUTH)
    known = covariance(problem, settled.fit.parameters)
    for name, value in zip(problem.space.names, error):
        assert abs(value) < 3.0 * known.data_deviation(name), name


def test_a_gain_is_trusted_unless_stated(double: SimpleNamespace) -> None:
    """Of a sensor that reads 5 % too much; the fit that may doubt it is nearer to the truth."""
    trials = presses(double, 8, gain=1.05)
    error = {}
    for sd in (0.0, 0.1):
        options = FitOptions(indentation_gain_sd=sd, tare_sd=0.0, **ALONE)
        problem = problem_of(double, options, trials)
        model = NuisanceModel(problem, options)
        settled = model.settle(double.TRUTH[None])
        ratio = double.composite(settled.fit.parameters) / double.composite(double.TRUTH)
        error[sd] = abs(float(np.log(ratio)))
        if sd:
            assert model.state.indentation_gain == pytest.approx(np.log(1.05), abs=0.03)
        else:
            assert "indentation_gain" not in problem.nuisances.names
    assert error[0.1] < 0.6 * error[0.0]


def test_lengths_enter_by_the_answer_of_the_indentation(double: SimpleNamespace) -> None:
    """By the model of the population as by full-order runs, at areas and indentations."""
    model = ReducedModel.load()
    records = [t.records(i, i)[0] for i, t in enumerate(presses(double, 3))]
    prepared, _ = prepare_all(records, FitOptions())
    problem = FitProblem(prepared, model, FitOptions())
    population = PopulationGeometry.like(model)
    assert population is not None
    lengths = {"pad_semi_axis_axial": 0.08}
    found = population.responses(problem, model.space.default, lengths)["pad_semi_axis_axial"]
    full = FullOrderGeometry(FullOrder.like(model))
    exact = geometry_responses(problem, model.space.default, full, lengths)
    assert len(found) == len(problem.observed) == 2 * len(problem.measured)
    error = 0.08 * (found - exact["pad_semi_axis_axial"].on(problem))
    assert np.sqrt(np.mean(error**2)) < 0.01
    # One deviation of this length moves the indentation by 14 %, the area by less.
    assert 0.08 * found[-1] == pytest.approx(0.14, abs=0.03)
    assert np.abs(found[: len(problem.measured)]).max() < found[-1]


def test_the_full_order_gives_the_same_rows() -> None:
    """A fit is corrected to it, areas and indentations alike."""
    model = ReducedModel.load()
    plan = Plan(presses=3, shortest=0.5, longest=0.8, indentation_sd=SENSOR)
    problem = plan.problem(model, NATURAL, FitOptions())
    full = FullOrder.like(model)
    shared = (full.material, full.geometry, 0.5, problem.trials)
    parts = [trial_areas(shared, (tuple(NATURAL), index)) for index in range(3)]
    ratio = in_rows(parts, problem.trials) / problem.raw(NATURAL)[0]
    assert len(ratio) == 2 * len(problem.measured)
    np.testing.assert_allclose(ratio, 1.0, atol=0.03)


def test_files_report_and_figure_say_that_it_was_used(
    double: SimpleNamespace, tmp_path: Path
) -> None:
    result = fit(presses(double, 4), model=double.HereditaryModel(), **QUICK, **ALONE)
    result.save(tmp_path)
    data = json.loads((tmp_path / "fit.json").read_text())
    told = data["conditions"]["dry"]["indentation"]
    assert told["trials"] == 4 and told["rms"] == pytest.approx(SENSOR, rel=0.4)
    assert data["options"]["indentation_sd"] == 20e-6
    with (tmp_path / "tables" / "indentation.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == told["frames"]
    differences = [
        float(r["indentation_mm"]) - float(r["predicted_mm"]) - float(r["residual_mm"])
        for r in rows
    ]
    assert np.abs(differences).max() < 1e-5
    assert "indentation" in all_figures(result.result)
    page = result.report(tmp_path).read_text()
    assert "<h2>Indentation</h2>" in page and "RMS difference (µm)" in page

    plain = fit(presses(double, 4), model=double.HereditaryModel(), indentation_sd=0.0, **QUICK)
    assert "indentation" not in all_figures(plain.result)
    plain.save(tmp_path / "plain")
    assert not (tmp_path / "plain" / "tables" / "indentation.csv").exists()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda t: {"indentation": np.full(len(t.indentation), np.nan)}, r"holds no number"),
        (lambda t: {"indentation": 1e3 * t.indentation}, r"changes by .* during .* in m$"),
        (lambda t: {"indentation": 1e-3 * t.indentation}, r"changes by .* during .* in m$"),
        (lambda t: {"indentation": -t.indentation}, r"falls by .* positive into the finger"),
        (lambda t: {"indentation": t.indentation[1:]}, r"values of indentation for \d+ times"),
        (lambda t: {"indentation_time": t.indentation_time[::-1]}, r"indentation_time must incr"),
        (lambda t: {"indentation_time": t.indentation_time + 60.0}, r"0 readings .* clock of time"),
        (lambda t: {"indentation": ["much"] * len(t.indentation)}, r"else than numbers"),
        (lambda t: {"indentation": t.indentation / 0.0}, r"is not finite"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero")
def test_an_indentation_that_cannot_be_meant_is_refused(
    double: SimpleNamespace, change: Any, sentence: str
) -> None:
    trials = presses(double, 3)
    trials[1] = replace(trials[1], **change(trials[1]))
    with pytest.raises(InputError) as caught:
        fit(trials, model=double.HereditaryModel(), **QUICK)
    assert re.search(rf"^trial 1: .*{sentence}", str(caught.value)), caught.value


def test_a_model_without_indentation_is_told_apart(double: SimpleNamespace) -> None:
    plain = double.HereditaryModel()
    model = SimpleNamespace(space=plain.space, batch=plain.batch)
    with pytest.raises(InputError, match=r"the model gives none; .* indentation_sd=0"):
        fit(presses(double, 3), model=model, **QUICK)
    assert fit(presses(double, 3), model=model, indentation_sd=0.0, **QUICK).conditions == ["dry"]


def test_a_sensor_that_does_not_follow_the_force_is_noted(double: SimpleNamespace) -> None:
    """Of a sensor that slips back in one press: suspicious, but not refused."""
    trials = presses(double, 4)
    time = np.asarray(trials[2].indentation_time)
    slip = np.where(time > time[len(time) // 2], 0.0, 2e-3 * (time - 0.4).clip(0.0))
    trials[2] = replace(trials[2], indentation=slip)
    result = fit(trials, model=double.HereditaryModel(), **QUICK, **ALONE)
    checks = {c.name: c for c in result.result.fits["dry"].quality.checks}
    assert checks["indentation"].status != "ok"
    assert "from the model" in checks["indentation"].detail


@pytest.mark.parametrize(("gain", "late"), [(1.5, 0.0), (0.5, 0.0), (1.0, 0.3)])
def test_an_indentation_that_the_model_does_not_follow_fails(
    double: SimpleNamespace, gain: float, late: float
) -> None:
    trials = [
        replace(
            t,
            indentation=gain * np.asarray(t.indentation),
            indentation_time=np.asarray(t.indentation_time) + late,
        )
        for t in presses(double, 4)
    ]
    narrow = {
        "bounds": ["E0=115kPa:125kPa", "E1=24kPa:26kPa", "E2=1400kPa:1600kPa", "tau1=0.19:0.21"]
    }
    model = double.HereditaryModel()
    found = fit(trials, model=model, **QUICK, **ALONE, **narrow).result.fits["dry"]
    (check,) = [c for c in found.quality.checks if c.name == "indentation"]
    assert check.status == "fail" and "% of the travel" in check.detail, check
    assert found.status == "not final"


def test_a_condition_without_indentation_beside_one_with_it_has_a_report(
    double: SimpleNamespace, tmp_path: Path
) -> None:
    with_one, others = presses(double, 3), presses(double, 3, seed=1, peak=1.4)
    without = [replace(t, indentation=None, condition="moist") for t in others]
    found = fit([*with_one, *without], model=double.HereditaryModel(), **QUICK)
    assert found.conditions == ["dry", "moist"]
    assert "indentation" in found.report(tmp_path).read_text()


def test_a_second_fit_in_a_folder_leaves_no_parameters_of_the_first(
    double: SimpleNamespace, tmp_path: Path
) -> None:
    trials = presses(double, 3)
    others = presses(double, 3, seed=1, peak=1.4)
    two = [*trials, *(replace(t, condition="moist") for t in others)]
    fit(two, model=double.HereditaryModel(), **QUICK).save(tmp_path)
    (tmp_path / "parameters_mine.yaml").write_text("mine\n")
    assert (tmp_path / "parameters_moist.yaml").exists()
    fit(trials, model=double.HereditaryModel(), **QUICK).save(tmp_path)
    left = {p.name for p in tmp_path.glob("parameters*.yaml")}
    assert left == {"parameters.yaml", "parameters_mine.yaml"}
    assert not (tmp_path / "tables" / "contrasts.csv").exists()
