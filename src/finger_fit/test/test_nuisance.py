# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Nuisance parameters: elimination, the unloaded plate, recovery of what the rig leaves unknown."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from finger_common.errors import InputError
from finger_fit.cli import unknowns
from finger_fit.full_order import FullOrder
from finger_fit.nuisance.estimate import NuisanceModel
from finger_fit.nuisance.geometry import (
    FullOrderGeometry,
    PopulationGeometry,
    Response,
    geometry_responses,
)
from finger_fit.nuisance_names import COLLAPSE, LAG, TARE, name_of
from finger_fit.nuisance_priors import CALIPERS
from finger_fit.options import FitOptions
from finger_fit.problem import FitProblem, Goal, Nuisance, Nuisances, prepare_all
from finger_fit.report.nuisances import nuisances
from finger_fit.report_units import MM4
from finger_fit.results import fit_dict
from finger_fit.search import all_free, refine
from finger_fit.study import fit_condition, fit_records
from finger_fit.uncertainty import bias_pair, covariance, in_interval
from finger_fit.uncertainty.profiles import student_95
from finger_model.geometry import LENGTHS, Geometry
from finger_model.laws import StandardLinearSolid
from finger_model.reduced import ReducedModel
from finger_offline.unloaded import unloaded_tare

NOISE = 1e-6
"""m², of the areas of these presses."""

SHARED_OUT = {"area_gain_sd": 0.0, "collapse_sd": 0.0, "geometry_sd": []}
"""Without the nuisances of the output, so that a test sees those of the drive alone."""


def presses(double, number=8, rest=True, tare=0.0, lag=0.0, gains=None, collapse=0.0, seed=0):
    """Records of the stand-in as a rig with these errors gives them; without rest, from the touch
    to the lift-off alone."""
    rng = np.random.default_rng(seed)
    records = []
    for index, ramp in enumerate(np.linspace(0.5, 2.0, number)):
        record = double.make_record(index, ramp, NOISE, rng)
        true = np.interp(record.area_stamp_ns, record.stamp_ns, record.force)
        area = record.area * (1.0 - collapse * np.clip(1.0 - true / 0.2, 0.0, 1.0))
        if gains is not None:
            area = area * gains[index]
        touched = np.flatnonzero(record.force > 0)
        kept = slice(None) if rest else slice(touched[0], touched[-1] + 1)
        stamps = record.stamp_ns[kept]
        seen = (record.area_stamp_ns >= stamps[0]) & (record.area_stamp_ns <= stamps[-1])
        records.append(
            replace(
                record,
                stamp_ns=stamps,
                force=record.force[kept] + tare + rng.normal(0, 0.004, len(stamps)),
                area_stamp_ns=record.area_stamp_ns[seen] + round(lag * 1e9),
                area=area[seen],
                area_sd=record.area_sd[seen],
                area_flags=record.area_flags[seen],
            )
        )
    return records


def problem_of(double, options, **rig) -> FitProblem:
    trials, excluded = prepare_all(presses(double, **rig), options)
    assert not excluded
    return FitProblem(trials, double.HereditaryModel(), options)


def error_of(double, parameters) -> float:
    """Error of the logarithm of composite E."""
    return float(np.log(double.composite(parameters) / double.composite(double.TRUTH)))


def settled(double, options, **rig):
    """Fit with nuisances of presses with these errors, from the truth."""
    problem = problem_of(double, options, **rig)
    found = NuisanceModel(problem, options).settle(double.TRUTH[None])
    return problem, found, covariance(problem, found.fit.parameters)


def some_nuisances(rng, frames=40, trials=4) -> Nuisances:
    trial_of = np.repeat(np.arange(trials), frames // trials)
    columns = [rng.normal(size=frames), rng.normal(size=frames)]
    columns += [np.where(trial_of == t, 3.0, 0.0) for t in range(trials)]
    names = ("lag", "collapse", *["press_gain"] * trials)
    states = rng.normal(size=2 + trials) * 0.1
    values = zip(names, [-1, -1, *range(trials)], states, [0.5, 1.0, *[0.3] * trials], columns)
    found = [Nuisance(name, t, at, sd, 1e-6 * column) for name, t, at, sd, column in values]
    return Nuisances(found, np.exp(0.1 * rng.normal(size=frames)), 1e-13)


@pytest.mark.parametrize("loss", ["squares", "huber"])
def test_elimination_is_the_minimum_over_the_nuisances(loss: str) -> None:
    rng = np.random.default_rng(0)
    nuisances, n = some_nuisances(rng), 40
    measured, weight = rng.uniform(2e-5, 5e-5, n), rng.uniform(0.5, 1.0, n)
    options = FitOptions(loss=loss, huber_scale=1e-3)  # so wide that both losses are squares
    goal = Goal(measured, weight, options, nuisances)
    areas = measured * np.exp(0.1 * rng.normal(size=n))

    def joint(x: np.ndarray) -> float:
        left = areas * nuisances.factor - measured + nuisances.slope @ (x - nuisances.state)
        prior = nuisances.variance * ((x / nuisances.sd) ** 2).sum()
        return float((weight * left**2).sum() + prior) * MM4

    best = minimize(joint, nuisances.state, method="BFGS", options={"gtol": 1e-9})
    assert goal.cost(areas) * MM4 == pytest.approx(best.fun, rel=1e-6)
    moved = nuisances.state + goal.moves(goal.residuals(areas))
    np.testing.assert_allclose(moved, best.x, atol=1e-4)


def test_rows_are_the_cost_and_its_change() -> None:
    rng = np.random.default_rng(1)
    measured = rng.uniform(2e-5, 5e-5, 40)
    goal = Goal(measured, np.ones(40), FitOptions(), some_nuisances(rng))
    areas = measured * np.exp(0.1 * rng.normal(size=40))
    rows, linear = goal.rows(areas)
    assert (rows**2).sum() == pytest.approx(float(goal.cost(areas)) * MM4, rel=1e-9)
    change = rng.normal(size=(3, 40)) * 1e-6
    moved = ((rows + linear(change)) ** 2).sum(axis=1)
    np.testing.assert_allclose(moved, goal.cost(areas + change) * MM4, rtol=1e-9)


def test_a_wide_prior_takes_a_nuisance_out_and_a_narrow_one_leaves_j(double) -> None:
    problem = double.make_problem(noise=NOISE, trials=3)
    plain = problem.cost(1.1 * double.TRUTH)[0]
    none = {"press_gain": False, "tare_sd": 0.0, **SHARED_OUT}
    narrow = NuisanceModel(problem, FitOptions(lag_sd=1e-7, **none))
    narrow.apply(double.TRUTH)
    assert problem.cost(1.1 * double.TRUTH)[0] == pytest.approx(plain, rel=1e-2)
    wide = NuisanceModel(problem, FitOptions(lag_sd=1.0, **none))
    wide.apply(double.TRUTH)
    assert problem.cost(1.1 * double.TRUTH)[0] < 0.9 * plain


# The unloaded plate ----------------------------------------------------------------------------


def rig_force(rest: float, tare: float, ramp: float = 0.5, noise: float = 0.004):
    time = np.arange(0.0, rest + 2.0, 0.002)
    press = np.clip((time - rest) / ramp, 0.0, 1.0) * np.clip((rest + 1.5 - time) / 0.2, 0.0, 1.0)
    smooth = 1.35 * press + tare
    return time, smooth + np.random.default_rng(3).normal(0, noise, len(time)), smooth


NONE = np.empty(0)


@pytest.mark.parametrize("tare", [-2.0, -0.3, -0.05, -0.02, 0.0, 0.02, 0.05])
def test_the_tare_is_measured_at_rest(tare: float) -> None:
    found = unloaded_tare(*rig_force(0.4, tare), NONE, NONE)
    assert found is not None
    assert found.force == pytest.approx(tare, abs=0.002)
    assert found.deviation < 0.003 and 0.4 < found.seconds < 1.0


def test_a_difference_of_the_ends_counts_as_drift() -> None:
    time, force, smooth = rig_force(0.4, 0.0)
    drift = 0.02 * (time > 1.5)
    found = unloaded_tare(time, force + drift, smooth + drift, NONE, NONE)
    assert found is not None and found.deviation > 0.009


def test_what_is_no_rest_gives_no_tare() -> None:
    time, force, smooth = rig_force(0.4, 0.0)
    pressed = (time > 0.5) & (time < 1.8)
    assert unloaded_tare(time[pressed], force[pressed], smooth[pressed], NONE, NONE) is None
    # A finger that rests on the plate is steady too: the camera sees it.
    resting = unloaded_tare(time, force + 0.05, smooth + 0.05, np.arange(0.0, 2.4, 0.1), NONE)
    assert resting is None
    heavy = unloaded_tare(time, force + 0.3, smooth + 0.3, NONE, NONE)
    assert heavy is None


def test_a_large_tare_is_believed_where_the_camera_saw_no_contact() -> None:
    time, force, smooth = rig_force(0.4, 0.3)
    frames = np.arange(0.01, 2.4, 0.1)
    contact = (frames > 0.4) & (frames < 1.9)
    found = unloaded_tare(time, force, smooth, frames[contact], frames[~contact])
    assert found is not None and found.force == pytest.approx(0.3, abs=0.002)


# Recovery of what the rig leaves unknown ---------------------------------------------------------


@pytest.mark.parametrize("tare", [-0.05, 0.02, 0.05])
def test_a_tare_seen_at_rest_does_not_move_e(double, tare: float) -> None:
    options = FitOptions(**SHARED_OUT)
    problem, found, known = settled(double, options, tare=tare)
    assert [t.drive.tare for t in problem.trials] == pytest.approx([tare] * 8, abs=0.004)
    error = error_of(double, found.fit.parameters)
    assert abs(error) < max(0.03, 0.5 * known.deviation("composite_E"))


def test_a_tare_without_rest_is_estimated_or_in_the_interval(double) -> None:
    options = FitOptions(**SHARED_OUT)
    problem, found, known = settled(double, options, tare=0.02, rest=False)
    assert not any(t.rest for t in problem.trials)
    tare = dict(zip(found.nuisances.names, found.nuisances.state))[TARE]
    assert tare == pytest.approx(0.02, abs=3 * known.nuisance_deviations()[TARE])
    assert abs(error_of(double, found.fit.parameters)) < 2 * known.deviation("composite_E")


@pytest.mark.parametrize("lag", [-0.03, 0.01, 0.08])
def test_the_lag_of_the_images_is_found(double, lag: float) -> None:
    options = FitOptions(**SHARED_OUT)
    problem, found, known = settled(double, options, lag=lag)
    assert problem.trials[0].drive.lag == pytest.approx(lag, abs=0.008)
    error = error_of(double, found.fit.parameters)
    assert abs(error) < max(0.03, 0.5 * known.deviation("composite_E"))


def test_without_nuisances_a_late_camera_is_read_as_another_finger(double) -> None:
    problem = problem_of(double, FitOptions(nuisances=False), lag=0.08)
    wrong = np.log(refine(problem, all_free(problem), double.TRUTH).parameters / double.TRUTH)
    right = np.log(settled(double, FitOptions(**SHARED_OUT), lag=0.08)[1].fit.parameters)
    right -= np.log(double.TRUTH)
    assert abs(wrong[2]) > 0.5 > 2 * abs(right[2]), "tau1"
    assert abs(wrong[3]) > 0.2 > 2 * abs(right[3]), "E2"


def test_the_collapse_of_the_hull_is_found(double) -> None:
    options = FitOptions(area_gain_sd=0.0, geometry_sd=[])
    _, found, known = settled(double, options, collapse=0.5)
    state = dict(zip(found.nuisances.names, found.nuisances.state))
    assert state[COLLAPSE] == pytest.approx(0.6, abs=0.2)  # 1 − exp(−0.6) ≈ 0.45
    error = error_of(double, found.fit.parameters)
    assert abs(error) < max(0.03, 0.5 * known.deviation("composite_E"))


def test_gains_of_presses_are_scatter_not_precision(double) -> None:
    """At 30 % from press to press the interval holds the truth; the frames alone promise more."""
    gains = np.exp(np.random.default_rng(5).normal(0.0, 0.3, 8))
    options = FitOptions(area_gain_sd=0.0, collapse_sd=0.0, geometry_sd=[])
    problem, found, known = settled(double, options, gains=gains)
    assert 0.5 * gains.std() < found.scatter < 2.0 * gains.std()
    estimated = np.exp(found.nuisances.state[np.array(found.nuisances.names) == "press_gain"])
    assert np.corrcoef(np.log(estimated), np.log(gains))[0, 1] > 0.98
    sd = known.deviation("composite_E")
    assert 1.5 * found.scatter / np.sqrt(8) < sd
    truth = float(double.composite(double.TRUTH))
    best = found.fit.parameters
    assert in_interval(problem, "composite_E", truth, best, found.fit.cost, known)
    # A pair of the bias flips the gains with the residuals, and leaves the finger where it was.
    pair = np.log(double.composite(bias_pair(problem, best, 0, 0)) / double.composite(best))
    assert abs(pair.mean()) < sd


@pytest.mark.parametrize("scatter", [0.0, 0.04])
def test_frames_of_a_press_are_no_independent_witnesses_of_its_gain(double, scatter) -> None:
    """Also where no gain is fitted: frames alone would claim 0.38 of the spread, and the larger
    variance of each parameter alone 0.53 of that of composite E. Without gains nothing widens."""
    options = FitOptions(nuisances=False)
    errors, claimed = [], []
    for seed in range(16):
        gains = np.exp(np.random.default_rng(seed).normal(0.0, scatter, 8))
        problem = problem_of(double, options, gains=gains, seed=seed)
        fit = refine(problem, all_free(problem), double.TRUTH)
        errors.append(error_of(double, fit.parameters))
        claimed.append(covariance(problem, fit.parameters).deviation("composite_E"))
    assert 0.8 < np.median(claimed) / np.std(errors) < 1.2


def test_a_factor_of_all_areas_is_not_estimated_and_widens_the_interval(double) -> None:
    alone = settled(double, FitOptions(collapse_sd=0.0, geometry_sd=[], area_gain_sd=0.0))[2]
    options = FitOptions(collapse_sd=0.0, geometry_sd=[], area_gain_sd=0.06)
    problem, found, known = settled(double, options, gains=np.full(8, 1.06))
    parts = known.budget("composite_E")
    total = np.sqrt(sum(part**2 for part in parts.values()))
    assert total == pytest.approx(known.deviation("composite_E"), rel=1e-6)
    assert known.deviation("composite_E") > alone.deviation("composite_E")
    truth = float(double.composite(double.TRUTH))
    best = found.fit.parameters
    assert in_interval(problem, "composite_E", truth, best, found.fit.cost, known)


class ScaledGeometry:
    """Areas that answer to the epidermis as a known power of the force."""

    geometry = Geometry()

    def __init__(self, double) -> None:
        self._model = double.HereditaryModel()

    def areas(self, parameters, geometry, trials):
        x = np.log(geometry.epidermis_thickness / self.geometry.epidermis_thickness)
        found = self._model.batch(parameters, [(t.time, t.force, t.frames) for t in trials])
        return [
            row[0]
            * np.exp(-x * (0.3 + 0.1 * np.log(np.maximum(t.frame_force, 0.05))) + 0.2 * x * x)
            for row, t in zip(found, trials)
        ]


def test_lengths_enter_by_the_answer_of_the_areas(double) -> None:
    options = FitOptions(area_gain_sd=0.0, collapse_sd=0.0)
    problem = problem_of(double, options)
    lengths = {"epidermis_thickness": 0.25, "nail_radius": 0.5}
    found = geometry_responses(problem, double.TRUTH, ScaledGeometry(double), lengths)
    slope = found["epidermis_thickness"].on(problem)
    expected = -0.3 - 0.1 * np.log(np.maximum(problem.force, 0.05))
    np.testing.assert_allclose(slope, expected, atol=1e-6)
    # One deviation more of the nail is wider than the pad: one side is enough.
    np.testing.assert_allclose(found["nail_radius"].on(problem), 0.0, atol=1e-9)

    # A finger whose epidermis is a quarter thicker, fitted as if it were not.
    x = np.log(1.25)
    problem.measured = problem.measured * np.exp(slope * x)
    model = NuisanceModel(problem, options, {"epidermis_thickness": found["epidermis_thickness"]})
    result = model.settle(double.TRUTH[None])
    known = covariance(problem, result.fit.parameters)
    truth = float(double.composite(double.TRUTH))
    best = result.fit.parameters
    assert in_interval(problem, "composite_E", truth, best, result.fit.cost, known)
    assert known.budget("composite_E")["epidermis_thickness"] > 0


def test_the_population_model_answers_as_the_full_order_does(double) -> None:
    """One deviation of each length, at every frame of three presses."""
    model = ReducedModel.load()
    options = FitOptions(geometry_sd=["calipers"])
    problem = FitProblem(double.make_problem(trials=3).trials, model, options)
    population = PopulationGeometry.like(model)
    assert population is not None
    found = population.responses(problem, model.space.default, problem.lengths)
    full = FullOrderGeometry(FullOrder.like(model))
    lengths = {n: sd for n, sd in problem.lengths.items() if n != "bone_semi_axis_axial"}
    exact = geometry_responses(problem, model.space.default, full, lengths)
    assert set(found) == set(problem.lengths) and len(found) == 4
    for name, deviation in lengths.items():
        error = deviation * (found[name] - exact[name].on(problem))
        assert np.sqrt(np.mean(error**2)) < 0.006, name
    # A thick pad on a small bone lies outside the box, and no model of the test has lengths.
    outside = replace(model.geometry, pad_semi_axis_radial=14e-3, nail_radius=7e-3)
    stub = SimpleNamespace(geometry=outside, space=model.space)
    assert PopulationGeometry.like(stub) is None
    assert PopulationGeometry.like(double.HereditaryModel()) is None


def test_lengths_widen_the_interval_but_not_that_from_the_data(double) -> None:
    """Conditions share their finger: a contrast is told apart that two fingers would not be."""
    records = []
    for name, E1 in (("dry", 40e3), ("natural", 22e3)):
        truth = np.array([120e3, E1, 0.2, 1500e3])
        for i in range(4):
            record = double.make_record(i, 0.7 + 0.3 * i, NOISE, condition=name, truth=truth)
            records.append(record)
    quick = {"grid": 3, "rounds": 5, "full_order": False, "bootstrap": 0, "bias_pairs": 0}
    wide = {}
    for gain in (0.02, 0.15):
        options = FitOptions(area_gain_sd=gain, **quick)
        wide[gain] = fit_records(records, double.HereditaryModel(), options)
    fits = {gain: found.fits["dry"] for gain, found in wide.items()}
    narrow, broad = (fits[g].found("composite_E").data_sd for g in (0.02, 0.15))
    assert broad == pytest.approx(narrow, rel=0.1)
    assert fits[0.15].found("composite_E").assumed_sd > 0.15
    low, high = fits[0.15].found("composite_E").data_interval
    profile = fits[0.15].profiles["composite_E"].interval
    assert profile[0] < low < fits[0.15].quantity("composite_E") < high < profile[1]
    entry = fit_dict(wide[0.15])["conditions"]["dry"]["from_data"]["composite_E"]
    assert entry["sd_log_assumed"] == pytest.approx(fits[0.15].found("composite_E").assumed_sd)
    (ratio,) = (c for c in wide[0.15].contrasts if c.quantity == "composite_E")
    found = [fit.found("composite_E") for fit in wide[0.15].fits.values()]
    student = student_95(4) / 1.96  # four presses of each
    alone = np.linalg.norm([(student * f.data_sd, f.assumed_sd) for f in found])
    shown = np.log(ratio.ratio_95[1] / ratio.ratio_95[0]) / 3.92
    assert shown < 0.75 * alone, "what both conditions share cancels"
    assert (
        ratio.ratio_95[0]
        < double.composite(np.array([120e3, 40e3, 0.2, 1500e3]))
        / (double.composite(np.array([120e3, 22e3, 0.2, 1500e3])))
        < ratio.ratio_95[1]
    )


def test_progress_names_each_stage_from_its_beginning_and_ends_at_the_j_of_the_result(
    double,
) -> None:
    options = FitOptions(grid=2, rounds=5, bootstrap=0, bias_pairs=2)
    records = presses(double, number=4, lag=0.03, gains=[0.9, 1.1, 0.95, 1.05])
    told: list[tuple[str, int, float]] = []

    def progress(condition: str, stage: str, number: int, rounds: int, cost: float, _: Any) -> None:
        told.append((stage, number, cost))

    problem = FitProblem(prepare_all(records, options)[0], double.HereditaryModel(), options)
    fit = fit_condition(problem, report=progress, better=double.Exact())
    stages = dict.fromkeys(stage for stage, *_ in told)
    assert list(stages)[:4] == ["grid", "pso", "polish", "nuisances"]
    begun = {stage for stage, number, _ in told if number == 0}
    assert begun >= {"polish", "nuisances", "sensitivities", "profiles", "bias"}
    assert fit.objective != pytest.approx(fit.cost, rel=0.01), "what is minimised is not J"
    assert {cost for stage, _, cost in told if stage in ("sensitivities", "bias")} == {fit.cost}


def test_a_fit_names_what_it_cannot_estimate(double, tmp_path) -> None:
    options = FitOptions(grid=2, rounds=5, full_order=False, bootstrap=0, bias_pairs=2)
    records = presses(double, number=4, lag=0.03)
    result = fit_records(records, double.HereditaryModel(), options)
    fit = result.fits["natural"]
    data = json.loads(json.dumps(fit_dict(result)))["conditions"]["natural"]
    block = data["nuisance"]
    assert block["values"][LAG]["estimated"]
    assert block["values"][LAG]["value"] == pytest.approx(0.03, abs=0.01)
    assert "area_gain" in block["not_estimated"]
    assert "epidermis_thickness" in block["left_out"], "without the full order"
    little, none = unknowns({"dry": fit, "natural": fit})
    assert little.startswith("dry, natural: the data say little about ")
    assert "gain of all areas" in little and "lag of the images" not in little
    unknown = fit.nuisance.not_estimated
    many = SimpleNamespace(not_estimated=("area_gain", *LENGTHS), left_out=())
    (short,) = unknowns({"dry": SimpleNamespace(nuisance=many)})
    assert f" and {len(LENGTHS) - 1} more. " in short and len(short) < 200
    assert ", ".join(map(name_of, unknown)) in nuisances(result), "the report names all of them"
    assert none.startswith("dry, natural: the interval does not allow for an error of ")
    assert "epidermis thickness" in none and "gain of all areas" not in none
    assert len(block["presses"]) == 4
    assert all(press["tare_measured"] for press in block["presses"].values())
    parts = block["sd_log_parts"]["composite_E"]
    assert data["sd_log"]["composite_E"] == pytest.approx(
        np.sqrt(sum(part**2 for part in parts.values())), rel=1e-6
    )
    assert block["without_nuisances"]["composite_E"] != data["composite_E"]
    truth = float(double.composite(double.TRUTH))
    assert data["interval_95"]["composite_E"]["low"] < truth
    assert truth < data["interval_95"]["composite_E"]["high"]
    assert fit.objective <= fit.cost * 1.5 + 1e-12


def test_a_length_that_is_named_keeps_the_others() -> None:
    known = {"epidermis_thickness": 0.27, "pad_semi_axis_radial": 0.1, "nail_radius": 0.1}
    assert FitOptions().lengths(known) == known
    better = FitOptions(geometry_sd=["epidermis_thickness=0.1"]).lengths(known)
    assert better == {**known, "epidermis_thickness": 0.1}
    without = FitOptions(geometry_sd=["epidermis_thickness=0"]).lengths(known)
    assert set(without) == set(known) - {"epidermis_thickness"}
    assert FitOptions(geometry_sd=[]).lengths(known) == {}
    measured = FitOptions(geometry_sd=["calipers", "epidermis_thickness=0.1"]).lengths(known)
    assert measured == {**CALIPERS, "epidermis_thickness": 0.1}


def test_a_relative_deviation_of_no_length_is_refused() -> None:
    options = FitOptions(geometry_sd=["bone_center_height=0.3"])
    raised = replace(Geometry(), bone_center_height=0.3e-3)
    options.check_names(StandardLinearSolid.PARAMETERS, [raised])
    with pytest.raises(InputError, match=r"'bone_center_height': this length .* is 0.*leave it"):
        options.check_names(StandardLinearSolid.PARAMETERS, [raised, Geometry()])


def test_outliers_do_not_widen_the_intervals_of_the_huber_loss(double) -> None:
    options = FitOptions(loss="huber", geometry_sd=[])
    deviations = []
    for rows in ([], [5, 40, 90]):
        problem = double.make_problem(noise=NOISE, options=options)
        problem.measured = problem.measured + np.bincount(
            rows, minlength=len(problem.measured)
        ) * 40e-6  # fmt: skip
        found = NuisanceModel(problem, options).settle(double.TRUTH[None])
        assert abs(error_of(double, found.fit.parameters)) < 0.02
        known = covariance(problem, found.fit.parameters)
        deviations.append([known.data_deviation(n) for n in problem.space.quantity_names])
    clean, spoilt = np.array(deviations)
    assert np.all(np.abs(np.log(spoilt / clean)) < np.log(1.5))


def test_a_length_that_is_fitted_besides_stays_assumed_in_the_main_fit(double) -> None:
    found = {}
    for extra in ("none", "epidermis_thickness"):
        options = FitOptions(extra=extra)
        problem = problem_of(double, options)
        skin = Response(np.array([1.0]), np.array([[0.0, -0.1, -0.3]]))
        responses = {"epidermis_thickness": skin}
        result = NuisanceModel(problem, options, responses).settle(double.TRUTH[None])
        found[extra] = covariance(problem, result.fit.parameters)
    for name in ("E2", "composite_E"):
        alone, fitted = (known.assumed_deviation(name) for known in found.values())
        assert fitted == pytest.approx(alone) and fitted > 0.05


def test_a_wrong_length_is_named() -> None:
    for text in ("thumb=0.1", "epidermis_thickness", "epidermis_thickness=2", "nail_radius=x"):
        with pytest.raises(InputError, match="NAME=DEVIATION"):
            FitOptions(geometry_sd=[text]).lengths({})


def test_a_response_lies_between_the_simulated_presses(double) -> None:
    problem = double.make_problem(trials=3)
    durations = np.array([0.1, 10.0])
    table = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0]])
    slope = Response(durations, table).on(problem)
    assert np.all((slope > 1.0) & (slope < 3.0))
