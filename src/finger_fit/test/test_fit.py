# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A condition's fit as a whole: results, files, interruption, engines, report."""

from __future__ import annotations

import ast
import copy
import json
import math
import os
import re
import shutil
import signal
from dataclasses import asdict, replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_fit import report, results
from finger_fit.cli import command, show
from finger_fit.engine import DaskEngine
from finger_fit.options import FitOptions
from finger_fit.problem import Exclusion, fit_power_law
from finger_fit.report import data, find_browser, write_pdf, write_report
from finger_fit.report_units import MM4, three_digits
from finger_fit.results import FitResult
from finger_fit.results.tables import goodness_rows
from finger_fit.search import Stopped, all_free, refine
from finger_fit.study import fit_condition, fit_records, provenance
from finger_model.geometry import Geometry
from finger_model.parameter_sets import ParameterSets
from finger_model.reduced import ReducedModel
from finger_model.reduced.model import load_population

QUICK = {
    "full_order": False, "profiles": False, "bootstrap": 0, "bias_pairs": 0, "grid": 3,
    "nuisances": False,
}  # fmt: skip
"""The paper's fit, which minimises J."""


def test_fit_finds_the_truth_without_noise(double) -> None:
    fit = fit_condition(double.make_problem(options=FitOptions(**QUICK)))
    assert fit.quantity("composite_E") == pytest.approx(double.composite(double.TRUTH), rel=0.01)
    assert fit.parameters[3] == pytest.approx(double.TRUTH[3], rel=0.03)
    assert fit.cost * MM4 < 0.05
    assert fit.pso.best[1] >= fit.cost, "the swarm's own result is kept apart from the polish"
    assert fit.polish is not None and fit.polish.evaluations > 0


def test_fit_costs_no_more_than_the_truth_and_keeps_the_gap_to_the_power_law(double) -> None:
    problem = double.make_problem(noise=1.5e-6, options=FitOptions(**QUICK))
    fit = fit_condition(problem)
    at_truth = problem.cost(double.TRUTH)[0]
    assert fit.cost <= 1.05 * at_truth
    gap, true_gap = fit.power_law.cost - fit.cost, fit.power_law.cost - at_truth
    assert abs(gap - true_gap) <= max(0.1 * true_gap, 5 / MM4)


def test_fit_is_repeatable_to_the_bit(double) -> None:
    options = FitOptions(
        full_order=False, bootstrap=3, bias_pairs=2, profiles=False, grid=3, rounds=10
    )
    problem = double.make_problem(noise=1.5e-6, trials=5, options=options)
    first, second = (fit_condition(problem) for _ in range(2))
    np.testing.assert_array_equal(first.parameters, second.parameters)
    np.testing.assert_array_equal(first.samples, second.samples)
    assert first.bias_corrected == second.bias_corrected


def test_a_swarm_without_polish_has_no_bias_to_correct(double) -> None:
    options = FitOptions(**{**QUICK, "bias_pairs": 2}, rounds=5, polish=False)
    fit = fit_condition(double.make_problem(noise=1.5e-6, trials=4, options=options))
    assert fit.bias_corrected == {}
    assert "bias_corrected" not in results.condition_dict(fit)


def test_a_corrected_fit_without_polish_is_a_minimum_and_has_its_bias(double) -> None:
    class Better(double.Exact):
        def areas(self, problem, candidates, done=None):
            return 1.02 * super().areas(problem, candidates)

    options = FitOptions(
        polish=False, profiles=False, bootstrap=0, grid=3, rounds=5, top=1, bias_pairs=2,
        nuisances=False,
    )  # fmt: skip
    problem = double.make_problem(noise=1.5e-6, trials=4, options=options)
    fit = fit_condition(problem, better=Better())
    assert fit.polish is None and fit.correction is not None
    further = refine(fit.problem, all_free(problem), fit.parameters)
    assert further.cost == pytest.approx(fit.cost, rel=1e-4)
    assert fit.pso.best[1] > 1.001 * fit.cost, "the swarm alone ended elsewhere"
    corrected = results.condition_dict(fit)["bias_corrected"]
    assert set(corrected) == set(problem.space.quantity_names)


def test_the_cost_by_full_order_is_one_number_in_all_files(double, tmp_path: Path) -> None:
    """J of the areas, as that of the model beside it, not what the fit minimises."""
    options = FitOptions(profiles=False, bootstrap=0, grid=3, rounds=5, top=2, bias_pairs=0)
    fit = fit_condition(double.make_problem(noise=3e-6, trials=4, options=options), "dry",
                        better=double.Exact())  # fmt: skip
    assert fit.full_order is not None
    result = FitResult(options, {"dry": fit}, [])
    (row,) = goodness_rows(result)
    assert row["J_full_order_mm4"] == results.condition_dict(fit)["J_full_order"]
    assert row["J_full_order_mm4"] == pytest.approx(row["J_mm4"], rel=1e-3)
    assert fit.full_order.full_costs[0] != pytest.approx(fit.full_order_cost, rel=1e-3)


def test_top_candidates_are_distinct_and_sorted(study) -> None:
    for fit in study.fits.values():
        assert len(fit.top) == 5
        assert (np.diff(fit.top_costs) >= 0).all()
        assert fit.top_costs[0] == fit.objective
        for i in range(5):
            for j in range(i):
                assert np.abs(np.log(fit.top[i] / fit.top[j])).max() > 0.02


def test_cross_check_is_reported_with_its_verdict(study) -> None:
    for fit in study.fits.values():
        (check,) = fit.cross_checks
        assert check.name == "de"
        assert fit.polish is not None
        assert check.agrees == (abs(check.polished_cost / fit.polish.cost - 1) < 0.02)
        assert check.agrees


def test_other_force_mode_is_fitted_to_the_same_trials(double) -> None:
    """Two conditions in one bag, whose trials bear the same numbers."""
    records = []
    for name, E1 in (("dry", 43e3), ("natural", 22e3)):
        truth = np.array([120e3, E1, 0.2, 1500e3])
        for i in range(3):
            # No press is another one's copy, which would be left out.
            ramp = 0.7 + 0.1 * i
            records.append(double.make_record(i, ramp, condition=name, truth=truth))
    for record in records:
        record.bag = "session"
    result = fit_records(records, double.HereditaryModel(), FitOptions(**QUICK, rounds=5))
    for name, modes in result.force_modes.items():
        expected = result.fits[name].quantity("composite_E")
        assert modes["full"]["composite_E"] == pytest.approx(expected)
        assert modes["paper"]["composite_E"] == pytest.approx(expected, rel=0.1)


def test_conditions_come_apart_and_the_weak_trial_is_listed(study) -> None:
    assert list(study.fits) == ["dry", "natural"]
    assert [len(f.problem) for f in study.fits.values()] == [6, 6]
    (exclusion,) = study.exclusions
    assert exclusion.label == "dry_06 trial 6" and "below the target" in exclusion.reason


@pytest.mark.parametrize("signal", [KeyboardInterrupt, Stopped])
def test_what_was_fitted_before_an_interruption_is_kept(double, signal: type) -> None:
    """Of two subjects, the second is interrupted before its search has begun."""
    records = []
    for subject in ("S01", "S02"):
        for i in range(3):
            record = double.make_record(i, 0.7 + 0.1 * i + 0.05 * (subject == "S02"))
            record.subject, record.bag = subject, f"{subject}_{i}"
            records.append(record)

    begun = []

    class Interrupted(double.HereditaryModel):
        def batch(self, *arguments: object, **options: object) -> object:
            if begun:
                raise signal
            return super().batch(*arguments, **options)

    def progress(condition: str, *_: object) -> None:
        if condition.startswith("S02"):
            begun.append(condition)

    options = FitOptions(**QUICK, rounds=5)
    result = fit_records(records, Interrupted(), options, report=progress)
    assert list(result.subjects) == ["S01"] and result.interrupted
    assert not result.subjects["S01"].interrupted


def test_a_fault_of_one_condition_keeps_the_others(double) -> None:
    records = [double.make_record(i, 0.7 + 0.2 * i, condition="dry") for i in range(3)]
    weak = [double.make_record(i, 0.7 + 0.2 * i, condition="weak", peak=0.9) for i in range(3)]
    for record in weak:
        record.target_force = 0.8
    # All frames of the weak presses weigh nothing.
    options = FitOptions(**QUICK, rounds=3, low_force=1.0, low_force_weight=0.0, shared=["E2"])
    result = fit_records([*records, *weak], double.HereditaryModel(), options)
    assert list(result.fits) == ["dry"]
    assert any("'weak' is not fitted: every frame" in note for note in result.problems)
    assert any("E2 can be shared by two or more" in note for note in result.problems)
    with pytest.raises(InputError, match=r"no condition can be fitted .*every frame"):
        fit_records(weak, double.HereditaryModel(), options)


def test_a_poor_reduced_model_is_named_once(double) -> None:
    class Poor(double.HereditaryModel):
        doubt = "the reduced model is less exact"

    records = [double.make_record(i, 0.7 + 0.2 * i) for i in range(6)]
    records = [replace(r, subject=f"S0{i % 2}", bag=f"b{i}") for i, r in enumerate(records)]
    result = fit_records(records, Poor(), FitOptions(**QUICK, rounds=2))
    assert result.problems.count(Poor.doubt) == 1


def test_a_reason_of_many_exclusions_is_said_once(study, capsys) -> None:
    left_out = [Exclusion(f"b{i} trial {i}", "dry", "no contact", "S01") for i in range(5)]
    left_out.append(Exclusion("c1", "dry", "too short", "S01"))
    result = replace(study, exclusions=left_out)
    show(result)
    shown = [line for line in capsys.readouterr().out.splitlines() if line.startswith("excluded")]
    assert shown == [
        "excluded: b0 trial 0, b1 trial 1, b2 trial 2 and 2 more: no contact",
        "excluded: c1: too short",
    ]
    page = data.exclusions(result)
    assert page.count("no contact") == 1 and "6 trials excluded" in page
    assert all(one.label in page for one in left_out), "the report names all of them"


def test_a_subject_has_its_own_exclusions(double) -> None:
    records = []
    for subject in ("S01", "S02"):
        for i in range(4):
            ramp = 0.7 + 0.1 * i + 0.05 * (subject == "S02")
            peak = 1.0 if subject == "S02" and i == 3 else 1.5
            record = double.make_record(i, ramp, peak=peak)
            record.subject, record.bag = subject, f"{subject}_{i}"
            records.append(record)
    result = fit_records(records, double.HereditaryModel(), FitOptions(**QUICK, rounds=3))
    (exclusion,) = result.exclusions
    assert exclusion.subject == "S02"
    assert result.subjects["S02"].exclusions == [exclusion]
    assert not result.subjects["S01"].exclusions
    assert results.fit_dict(result)["exclusions"][0]["subject"] == "S02"


@pytest.mark.parametrize("done", [0, 1])
def test_an_interruption_of_the_full_order_leaves_one_state(double, done: int) -> None:
    """Before the first run of it, and in the second round of the correction."""
    options = FitOptions(profiles=False, bootstrap=0, bias_pairs=0, grid=3, rounds=5)
    problem = double.make_problem(noise=1e-6, trials=4, options=options)
    calls = []

    class Interrupted(double.Exact):
        def areas(self, problem, candidates, done=None):
            calls.append(len(candidates))
            if len(calls) > stop_after:
                raise KeyboardInterrupt
            return 1.1 * super().areas(problem, candidates, done)

    stop_after = done
    fit = fit_condition(problem, better=Interrupted())
    assert fit.status == "interrupted" and len(calls) == done + 1
    areas = fit.problem.areas(fit.parameters)[0]
    assert fit.problem.trial_costs(areas).sum() == pytest.approx(fit.cost)
    assert fit.problem.cost(fit.parameters)[0] == pytest.approx(fit.objective)
    assert fit.power_law.cost == pytest.approx(fit_power_law(fit.problem).cost)
    refined = refine(fit.problem, all_free(fit.problem), fit.parameters)
    assert refined.cost == pytest.approx(fit.objective, rel=1e-3), "still at its minimum"


@pytest.mark.parametrize("stop_at", ["grid", "pso", "bootstrap"])
@pytest.mark.parametrize("signal", [KeyboardInterrupt, Stopped])
def test_interruption_leaves_the_best_so_far(double, stop_at: str, signal: type) -> None:
    options = FitOptions(
        full_order=False, profiles=False, bootstrap=5, bias_pairs=2, grid=4, rounds=10
    )
    problem = double.make_problem(noise=1e-6, trials=4, options=options)

    def progress(condition: str, stage: str, number: int, *_: object) -> None:
        if stage == stop_at and number == 2:
            raise signal

    fit = fit_condition(problem, report=progress)
    assert fit.status == "interrupted" and fit.reasons
    areas = fit.problem.areas(fit.parameters)[0]
    assert fit.problem.trial_costs(areas).sum() == pytest.approx(fit.cost)
    assert len(fit.top) >= 1
    result = FitResult(options, {"natural": fit}, [])
    assert json.dumps(results.fit_dict(result), allow_nan=False)


def test_rounds_of_the_nuisances_are_reported(double) -> None:
    options = FitOptions(**{**QUICK, "nuisances": True}, rounds=3)
    problem = double.make_problem(noise=1e-6, trials=3, options=options)
    rounds = []

    def progress(condition: str, stage: str, number: int, most: int, *_: object) -> None:
        if stage == "nuisances":
            rounds.append((number, most))

    fit_condition(problem, report=progress)
    assert 2 < len(rounds) and rounds[-1][0] == rounds[-1][1]
    assert [number for number, _ in rounds[:-1]] == list(range(len(rounds) - 1))


@pytest.mark.parametrize("stop_at", [("dry", "pso"), ("natural", "grid")])
def test_an_interrupted_fit_leaves_the_parameters_of_a_whole_one(
    double, tmp_path: Path, stop_at: tuple[str, str]
) -> None:
    """The best of a search that did not end, without covariance, is no finger for the node."""
    moistures = {"dry": [40.0, 42.0], "natural": [70.0, 72.0]}
    records = [
        replace(double.make_record(i, 0.7 + 0.3 * i + 0.001 * found[0], 1e-6, condition=name),
                moisture_before=found, moisture_after=[])
        for name, found in moistures.items() for i in range(3)
    ]  # fmt: skip

    def stop(*stage: Any) -> None:
        if stage[:2] == stop_at:
            raise Stopped

    options = FitOptions(**QUICK, rounds=3)
    results.write(fit_records(records, double.HereditaryModel(), options), tmp_path)
    files = [tmp_path / "parameters.yaml", tmp_path / "subjects" / "S01.yaml"]
    whole = [path.read_bytes() for path in files]
    cut = fit_records(records, double.HereditaryModel(), options, report=stop)
    assert cut.stopped and cut.fits[stop_at[0]].status == "interrupted"
    missing = "dry, natural" if stop_at[0] == "dry" else "natural"
    assert any(f"not fitted to the end: {missing}, so" in note for note in cut.problems), (
        cut.problems
    )
    results.write(cut, tmp_path)
    assert [path.read_bytes() for path in files] == whole
    # The page says of which conditions it has checks.
    quality = data.quality(cut)
    for name in missing.split(", "):
        assert f"{name}: interrupted, not checked" in quality
    if stop_at[0] == "natural":
        checked = cut.fits["dry"].quality.checks
        assert all(f"dry: {escape(check.detail)}" in quality for check in checked)
    results.write(cut, tmp_path / "new")
    assert (tmp_path / "new" / "fit.json").is_file()
    assert not list((tmp_path / "new").rglob("*.yaml"))


def test_of_subjects_those_before_an_interruption_get_their_parameters(
    double, tmp_path: Path
) -> None:
    records = []
    for subject in ("S01", "S02", "S03"):
        for i in range(3):
            record = double.make_record(i, 0.7 + 0.2 * i + 0.01 * int(subject[1:]), 1e-6)
            records.append(replace(record, subject=subject, bag=f"{subject}_{i}"))

    def stop(condition: str, stage: str, *_: object) -> None:
        if (condition, stage) == ("S02 natural", "pso"):
            raise Stopped

    options = FitOptions(**QUICK, rounds=3)
    results.write(fit_records(records, double.HereditaryModel(), options), tmp_path)
    files = sorted(tmp_path.rglob("*.yaml"))
    (tmp_path / "subjects" / "S01.yaml").write_text("of before")
    cut = fit_records(records, double.HereditaryModel(), options, report=stop)
    assert "interrupted: not fitted: subjects S03" in cut.problems
    results.write(cut, tmp_path)
    assert sorted(tmp_path.rglob("*.yaml")) == files
    assert ParameterSets.load(tmp_path / "subjects" / "S01.yaml").sets


@pytest.mark.parametrize("several", [True, False], ids=["subjects", "one subject"])
def test_a_condition_lost_for_another_reason_than_its_data_leaves_parameters(
    double, tmp_path: Path, several: bool
) -> None:
    """Such as a checkpoint that --resume cannot use."""
    codes = ("S01", "S02") if several else ("S01",)
    moistures = {"dry": [40.0, 42.0], "natural": [70.0, 72.0]}
    records = [
        replace(
            double.make_record(i, 0.7 + 0.3 * i + 0.001 * found[0] + 0.01 * int(s[1:]), 1e-6),
            condition=c, subject=s, bag=f"{s}_{c}_{i}", moisture_before=found, moisture_after=[],
        )
        for s in codes for c, found in moistures.items() for i in range(3)
    ]  # fmt: skip
    options = FitOptions(**QUICK, rounds=3)
    results.write(fit_records(records, double.HereditaryModel(), options), tmp_path)
    files = {path: path.read_bytes() for path in tmp_path.rglob("*.yaml")}
    assert len(files) > 1
    kept = tmp_path / codes[0] if several else tmp_path
    kept.mkdir(exist_ok=True)
    (kept / "checkpoint_natural_pso.json").write_text("{}")
    options = replace(options, resume=True)
    cut = fit_records(records, double.HereditaryModel(), options, folder=tmp_path)
    lost = f"{codes[0]} natural" if several else "natural"
    assert cut.missing == [lost] and len(cut.fits) == 2 * len(codes) - 1 and not cut.stopped
    assert any("'natural' is lost" in p and "not a checkpoint" in p for p in cut.problems)
    results.write(cut, tmp_path)
    own = {p: text for p, text in files.items() if "S02" not in str(p)}
    assert own and all(path.read_bytes() == text for path, text in own.items())
    assert files.keys() <= set(tmp_path.rglob("*.yaml"))


def test_a_subject_without_the_condition_asked_for_is_not_lost(double) -> None:
    records = [
        replace(double.make_record(i, 0.7 + 0.3 * i + 0.1 * n, 1e-6, condition=c), subject=f"S0{n}")
        for n, c in ((1, "moist"), (2, "natural")) for i in range(3)
    ]  # fmt: skip
    found = fit_records(
        records, double.HereditaryModel(), FitOptions(**QUICK, rounds=3), conditions=["moist"]
    )
    assert list(found.fits) == ["S01 moist"] and found.missing == []
    assert any("S02: condition 'moist' does not occur" in note for note in found.problems)


def test_what_a_fit_has_no_use_for_is_told(double, tmp_path: Path) -> None:
    records = [double.make_record(i, 0.7 + 0.3 * i, 1e-6) for i in range(3)]
    options = FitOptions(**QUICK, rounds=3, huber_scale=1e-6, tare_sd=0.1, resume=True)
    model = double.HereditaryModel()
    found = fit_records(records, model, options, folder=tmp_path).problems
    assert "with loss 'squares', huber_scale has no effect" in found
    assert "with nuisances off, tare_sd has no effect" in found
    assert sum("no checkpoint to resume from" in note for note in found) == 1
    options = replace(options, tare_sd=FitOptions().tare_sd)
    again = fit_records(records, model, options, folder=tmp_path).problems
    assert not any("nuisances off" in note or "to resume from" in note for note in again)


def test_resumed_fit_equals_the_uninterrupted_one(double, tmp_path: Path) -> None:
    options = FitOptions(
        full_order=False, profiles=False, bootstrap=0, bias_pairs=0, grid=3, rounds=12
    )
    problem = double.make_problem(noise=1e-6, trials=4, options=options)
    whole = fit_condition(problem)

    def stop(condition: str, stage: str, number: int, *_: object) -> None:
        if stage == "pso" and number == 5:
            raise KeyboardInterrupt

    cut = fit_condition(problem, folder=tmp_path, report=stop)
    assert cut.status == "interrupted"
    resumed = replace(options, resume=True)
    again = double.make_problem(noise=1e-6, trials=4, options=resumed)
    rest = fit_condition(again, folder=tmp_path)
    np.testing.assert_array_equal(rest.pso.candidates, whole.pso.candidates)
    np.testing.assert_array_equal(rest.parameters, whole.parameters)
    other = double.make_problem(noise=1e-6, trials=5, options=resumed)
    with pytest.raises(InputError, match="another search"):
        fit_condition(other, folder=tmp_path)


def test_files_hold_every_documented_entry(study, tmp_path: Path) -> None:
    results.write(study, tmp_path)
    data = json.loads((tmp_path / "fit.json").read_text())
    for name, fit in study.fits.items():
        entry = data["conditions"][name]
        for key in ("E0", "E1", "E2", "tau1", "composite_E", "J", "J_full_order", "J_power_law",
                    "power_law", "moisture_mean", "moisture_sd", "trials"):  # fmt: skip
            assert key in entry
        assert entry["J"] == pytest.approx(fit.cost * 1e12)
        assert entry["composite_E"] == pytest.approx(1 / (1 / entry["E0"] + 1 / entry["E1"]))
        assert set(entry["power_law"]) >= {"k", "m"}
        assert entry["interval_95"]["composite_E"]["low"] < entry["composite_E"]
        for q, found in entry["bias_corrected"].items():
            assert np.log(entry[q] / found["value"]) == pytest.approx(found["bias_log"])
            assert 0 <= found["bias_log_error"] < 0.2
            assert found["low"] <= found["value"] <= found["high"]


def test_parameter_file_is_what_the_model_node_loads(study, tmp_path: Path) -> None:
    results.write(with_moisture(study, dry=[40.0]), tmp_path)
    sets = ParameterSets.load(tmp_path / "parameters.yaml")
    assert (sets.geometry_hash, sets.reduced_model_hash) == ("abc", "def")
    assert {s.condition for s in sets.sets} == {"dry", "natural"}
    for entry in sets.sets:
        np.testing.assert_allclose(entry.parameters, study.fits[entry.condition].parameters)
        mean = 40.0 if entry.condition == "dry" else 70.0
        assert entry.moisture == pytest.approx(mean, abs=0.01)
        eigenvalues = np.linalg.eigvalsh(np.array(entry.covariance_log))
        assert eigenvalues.min() > -1e-12 and eigenvalues.max() > 0
    # How the presses differ that were fitted, which the model node need not assume then.
    fewest = min(len(fit.problem) for fit in study.fits.values())
    assert sets.presses is not None and sets.presses.number == fewest
    assert 0.0 < sets.presses.sd < 0.1 and sets.presses.drift_sd < 0.02


def test_a_condition_without_moisture_beside_others_gets_a_file_of_its_own(
    study, tmp_path: Path
) -> None:
    fits = dict(study.fits)
    dry = fits["dry"] = copy.copy(fits["dry"])
    dry.problem = copy.copy(dry.problem)
    dry.problem.trials = tuple(replace(t, moisture=math.nan) for t in dry.problem.trials)
    mixed = replace(study, fits=fits)
    found = {n: [s.condition for s in sets.sets] for n, sets in
             results.parameter_files(mixed).items()}  # fmt: skip
    assert found == {"parameters.yaml": ["natural"], "parameters_dry.yaml": ["dry"]}
    results.write(mixed, tmp_path)
    results.write(with_moisture(study, dry=[40.0]), tmp_path)
    assert not (tmp_path / "parameters_dry.yaml").exists(), "the later fit has readings of it"


def with_moisture(study: FitResult, **moistures: list[float]) -> FitResult:
    """The study with these moistures (a.u.) of the presses of conditions, in turn."""
    fits = dict(study.fits)
    for name, readings in moistures.items():
        fit = fits[name] = copy.copy(fits[name])
        fit.problem = copy.copy(fit.problem)
        fit.problem.trials = tuple(
            replace(t, moisture=readings[i % len(readings)])
            for i, t in enumerate(fit.problem.trials)
        )
    return replace(study, fits=fits)


@pytest.mark.parametrize(
    ("dry", "natural", "told"),
    [
        ([68.0, 72.0], [68.8, 72.8], False),
        ([70.0], [70.0], False),
        ([70.0], [75.0], False),
        ([50.0, 66.0], [60.0, 76.0], False),
        ([70.0], [77.0], True),
        ([34.0, 41.0], [62.0, 77.0], True),
    ],
)
def test_conditions_that_no_reading_tells_apart_get_files_of_their_own(
    study, dry: list[float], natural: list[float], told: bool
) -> None:
    """Between thumb and index of one moisture, interpolation is of two fingers."""
    files = results.parameter_files(with_moisture(study, dry=dry, natural=natural))
    found = {name: [s.condition for s in sets.sets] for name, sets in files.items()}
    alone = {"parameters_dry.yaml": ["dry"], "parameters_natural.yaml": ["natural"]}
    assert found == ({"parameters.yaml": ["dry", "natural"]} if told else alone)
    for sets in files.values():
        for entry in sets.sets:
            assert entry.moisture == np.mean(dry if entry.condition == "dry" else natural)
    # The presses of the study itself have one moisture.
    assert any("dry (70.0 ± 0.0 a.u.), natural (70.0" in note for note in study.problems)


def test_the_parameter_file_has_what_the_data_leave_open_alone(study) -> None:
    """Lengths and gain as assumed are those that the model runs with: they cancel in its area."""
    for name, sets in results.parameter_files(with_moisture(study, dry=[40.0])).items():
        assert name == "parameters.yaml"
        for entry in sets.sets:
            fit = study.fits[entry.condition]
            known = fit.covariance
            assert known is not None and known.assumed_deviation("composite_E") > 0.05
            slope = fit.space.log_gradient("composite_E", fit.parameters)
            free = known.released  # the stated deviations hold no parameter at its bound
            stated = known.data_deviation("composite_E"), known.deviation("composite_E")
            for matrix, own, freed, deviation in (
                (np.array(entry.covariance_log), known.data_covariance(), free.data_covariance(),
                 stated[0]),
                (fit.covariance_log(), known.covariance, free.covariance, stated[1]),
            ):  # fmt: skip
                assert np.allclose(matrix, own, rtol=1e-6, atol=1e-15)
                assert np.sqrt(slope @ freed @ slope) <= deviation * (1.0 + 1e-9)
                exported = np.sqrt(slope @ matrix @ slope)
                if known.active:
                    assert exported < deviation
                else:
                    assert exported == pytest.approx(deviation)


def test_the_error_of_the_reduced_model_is_that_of_the_fitted_parameters(study) -> None:
    """In the report's provenance, and where it is taken off the scatter of the presses."""

    def told(model: ReducedModel, skin: float) -> tuple[Any, Any]:
        fits = {name: copy.copy(fit) for name, fit in study.fits.items()}
        for fit in fits.values():
            fit.problem = copy.copy(fit.problem)
            fit.problem.model = model
        fits["dry"].parameters = fits["dry"].parameters * [1.0, 1.0, 1.0, skin]
        found = replace(study, fits=fits)
        (sets,) = results.parameter_files(with_moisture(found, dry=[40.0])).values()
        return provenance(found, study.options)["reduced_model_error"], sets.presses

    model = load_population(Geometry())
    stated = model.meta["measured_error"]
    middle, whole = told(model, 1.0), told(model, 0.1)
    assert (middle[0], whole[0]) == (stated["middle"], stated["whole"])
    alike = {**model.meta, "measured_error": dict.fromkeys(stated, stated["whole"])}
    assert told(ReducedModel(model.arrays, alike), 1.0) == whole and whole[1] != middle[1]
    assert study.model_error == {}, "the stand-in states none"


def test_a_second_fit_leaves_nothing_of_the_first_but_foreign_files(
    study, written: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "fit"
    shutil.copytree(written.parent, folder)
    foreign = [folder / "figures" / "mine.png", folder / "subjects" / "S02.yaml"]
    stale = [folder / "report.pdf", folder / "subjects" / "S01.yaml"]
    stale += [folder / "figures" / f"indentation.{kind}" for kind in ("png", "svg", "pdf")]
    for path in (*foreign, *stale):
        path.parent.mkdir(exist_ok=True)
        path.write_text("of before")
    fits = {}
    for name, fit in study.fits.items():
        fits[name] = copy.copy(fit)
        fits[name].problem = copy.copy(fit.problem)
        fits[name].problem.trials = tuple(
            replace(t, moisture=math.nan) for t in fit.problem.trials
        )  # fmt: skip
    unread = replace(study, fits=fits)
    results.write(unread, folder)
    write_report(unread, folder)
    assert not [path.name for path in stale if path.exists()]
    assert all(path.exists() for path in foreign)


def test_report_is_one_self_contained_page_with_its_figures_beside_it(written: Path) -> None:
    page = written.read_text()
    pictures = sorted(p.name for p in (written.parent / "figures").glob("*.png"))
    assert page.count("data:image/png;base64,") == len(pictures) >= 8
    assert not re.search(r"(src|href)\s*=\s*[\"']?(?!data:)(https?:|/|\w+\.(png|css|js))", page)
    for words in (
        "dry_06 trial 6",
        "below the target",
        "power law",
        "Provenance",
        "not checked",
        "bias-corrected",
        "Δ<i>J</i>",
        "<i>R</i>² model",
        "on a bound",
    ):
        assert words in page
    assert not re.search(r"\bnan\b", re.sub(r"base64,[^\"]*", "", page))
    # "1,500" is one and a half to many readers.
    assert not re.search(r">\d,\d{3}<", page) and re.search(r">\d{4}(\.\d+)?<", page)


@pytest.fixture
def browser() -> Any:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = shutil.which("chromium") or shutil.which("google-chrome")
    if not found:
        pytest.skip("no Chromium is installed")
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield chromium
        chromium.close()


def test_report_fits_the_width_of_a_window_and_of_a_page_of_paper(
    written: Path, browser: Any
) -> None:
    page = browser.new_page()
    page.goto(written.as_uri())
    beyond = """() => [...document.querySelectorAll("th, td, .status, img, h2")]
        .filter((e) => e.getBoundingClientRect().right > document.documentElement.clientWidth)
        .map((e) => e.textContent || e.alt)"""
    cut = """() => [...document.querySelectorAll(".scroll")]
        .filter((e) => e.scrollWidth > e.clientWidth + 1).length"""
    # A4 less its margins is 182 mm wide, at 96 dots an inch.
    for media, width in (("screen", 1280), ("print", round(182 / 25.4 * 96))):
        page.emulate_media(media=media)
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate(beyond) == [] and page.evaluate(cut) == 0, media
    numbers = [int(n) for n in re.findall(r"Fig\. (\d+)", page.inner_text("body"))]
    assert numbers == sorted(numbers) and len(set(numbers)) == len(numbers) >= 8


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_in_the_report(written: Path, browser: Any, scheme: str) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page = browser.new_page(color_scheme=scheme, viewport={"width": 1280, "height": 900})
    page.goto(written.as_uri())
    for width in (1280, 390):
        page.set_viewport_size({"width": width, "height": 900})
        found = axe.run(page).response["violations"]
        assert [(v["id"], [n["target"] for n in v["nodes"]]) for v in found] == [], width


def test_the_report_is_printed_to_pdf(written: Path, tmp_path: Path) -> None:
    page = shutil.copy(written, tmp_path / "report.html")
    files = set(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"not written.*report\.html is complete"):
        write_pdf(page, shutil.which("false") or "false")
    with pytest.raises(InputError, match="No such file"):
        write_pdf(page, str(tmp_path / "no_browser"))
    assert set(tmp_path.iterdir()) == files, "nothing half-written"
    try:
        browser = find_browser()
    except InputError as error:
        pytest.skip(f"printing of the report not tested: {error}")
    content = write_pdf(page, browser).read_bytes()
    assert set(tmp_path.iterdir()) == files | {tmp_path / "report.pdf"}
    pages = re.search(rb"/Type /Pages\s*/Count (\d+)", content)
    assert pages and 3 <= int(pages[1]) <= 20
    (width, height) = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", content)[0]
    assert (round(float(width)), round(float(height))) == (595, 842), "A4"


def test_a_pdf_without_a_browser_is_refused_before_the_fit(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match="neither is installed; install one"):
        command([str(tmp_path / "bag"), "--pdf", "-o", str(tmp_path / "fit")])
    assert not (tmp_path / "fit").exists()


def test_goodness_has_intervals_over_the_trials(study) -> None:
    for fit in study.fits.values():
        found = fit.goodness
        assert found.k.value == fit.power_law.k and found.m.value == fit.power_law.m
        assert 0.5 < found.power_law.value < found.model.value < 1.0
        for interval in (found.k, found.m, found.model, found.power_law):
            assert interval.low < interval.value < interval.high
        total = fit.problem.measured - fit.problem.measured.mean()
        plain = 1 - ((fit.areas - fit.problem.measured) ** 2).sum() / (total**2).sum()
        assert found.model.value == pytest.approx(plain, abs=0.02), "weights change it little"
        told = results.condition_dict(fit)["goodness"]
        assert told["model"] == asdict(found.model)


def test_values_are_shown_with_three_digits() -> None:
    shown = [three_digits(v) for v in (1234.5, 41.0, 0.0012345, 0.29996, 0.0, float("nan"))]
    assert shown == ["1230", "41.0", "0.00123", "0.300", "0.00", "–"]


def test_report_draws_and_computes_nothing(written: Path) -> None:
    """No model runs for the report (see `written`), and its modules import no solver."""
    assert written.is_file()
    imported = set()
    for file in Path(report.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom):
                imported.add("." * node.level + (node.module or ""))
    others = {"search", "full_order", "study", "engine"}
    assert not {name for name in imported if name.lstrip(".").split(".")[0] in others}
    assert not [n for n in imported if re.search(r"finger_model\.(fem|reduced)|scipy|pymoo", n)]


def test_dask_gives_the_local_result_also_after_a_worker_was_killed(double) -> None:
    distributed = pytest.importorskip("distributed")
    options = FitOptions(
        full_order=False, profiles=False, bootstrap=12, bias_pairs=3, grid=3, rounds=5
    )
    problem = double.make_problem(noise=1e-6, trials=4, options=options)
    local = fit_condition(problem)
    killed = []
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        engine = DaskEngine(cluster.scheduler_address)

        def report(condition: str, stage: str, number: int, *_: object) -> None:
            if stage == "bootstrap" and number == 4 and not killed:
                worker = next(iter(cluster.workers.values()))
                killed.append(worker.process.pid)
                os.kill(worker.process.pid, signal.SIGKILL)

        remote = fit_condition(problem, engine=engine, report=report)
        engine.close()
    assert killed
    np.testing.assert_array_equal(remote.samples, local.samples)
    assert remote.bias_corrected == local.bias_corrected != {}
    np.testing.assert_array_equal(remote.parameters, local.parameters)


def test_no_scheduler_is_refused_with_the_address() -> None:
    with pytest.raises(InputError, match=r"tcp://127\.0\.0\.1:1"):
        DaskEngine("tcp://127.0.0.1:1", timeout=1)
