# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-fit design`: expected deviations against recovery, power against simulated studies."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from finger_common.cli import run
from finger_common.errors import InputError
from finger_fit.cli import command
from finger_fit.design import Plan, expected, plans_of, power, presses_for, subjects_for
from finger_fit.design.command import finger_of
from finger_fit.design.expected import expected_of
from finger_fit.design.power import contrast_deviation
from finger_fit.nuisance.estimate import NuisanceModel
from finger_fit.options import FitOptions
from finger_fit.search import all_free, refine
from finger_model.laws import StandardLinearSolid
from finger_model.paper import CONDITIONS
from finger_model.reduced import ReducedModel

SENSOR = 60e-6
"""m; of a finer sensor, the drift of the tare that a fit allows for would count, which planned
presses do not have."""


def with_box(problem) -> None:
    problem.box = np.array([[10e3, 2e6], [5e3, 200e3], [0.02, 2.0], [200e3, 6e6]])


@pytest.mark.parametrize(
    ("nuisances", "sensor"),
    [
        (False, SENSOR),
        (True, 0.0),
        pytest.param(False, 0.0, marks=pytest.mark.slow),
        pytest.param(True, SENSOR, marks=pytest.mark.slow),
    ],
)
def test_the_expected_deviation_is_that_of_repeated_fits(
    double, nuisances: bool, sensor: float
) -> None:
    """60 data sets give a deviation to 9 %, 120 to 6 %; both must agree within 20 %."""
    check_expected(double, nuisances, sensor, 120 if sensor else 60, 0.2)


@pytest.mark.slow
@pytest.mark.parametrize("nuisances", [False, True])
def test_the_expected_deviation_with_an_indentation_is_that_of_many_fits(
    double, nuisances: bool
) -> None:
    """300 data sets give a deviation to 4 %."""
    check_expected(double, nuisances, SENSOR, 300, 0.12)


def check_expected(double, nuisances: bool, sensor: float, number: int, tolerance: float) -> None:
    model, truth = double.HereditaryModel(), double.TRUTH
    # It makes the data itself, so it has no error.
    model.measured_error = {"indentation_p90": 0.0}
    plan = Plan(
        presses=8, hold=0.6, window="contact", area_noise=0.5e-6, scatter=0.02,
        indentation_sd=sensor,
    )  # fmt: skip
    if not nuisances:
        plan = replace(plan, scatter=0.0)
    options = FitOptions(
        nuisances=nuisances, area_gain_sd=0.0, collapse_sd=0.0, geometry_sd=[], tare_sd=0.0
    )
    predicted = expected(plan, model, truth, options)
    found = []
    for seed in range(number):
        problem = plan.problem(model, truth, options, np.random.default_rng(seed))
        with_box(problem)
        if nuisances:
            at = NuisanceModel(problem, options)
            at.noise, at.scatter = plan.area_noise, plan.scatter
            at.apply(truth)
        fit = refine(problem, all_free(problem), truth)
        found.append([problem.space.quantity(n, fit.parameters) for n in predicted.total])
    spread = dict(zip(predicted.total, np.log(found).std(axis=0, ddof=1)))
    names = ("composite_E", "E2", "tau1", "E1") + (("E0",) if sensor else ())
    for name in names:
        assert predicted.data[name] == pytest.approx(spread[name], rel=tolerance), name


def test_more_presses_narrow_what_they_can(double) -> None:
    model = double.HereditaryModel()
    options = FitOptions(area_gain_sd=0.05)
    few = expected(Plan(presses=10, hold=1.0, window="contact"), model, double.TRUTH, options)
    many = expected(Plan(presses=40, hold=1.0, window="contact"), model, double.TRUTH, options)
    name = "composite_E"
    assert few.data[name] / many.data[name] == pytest.approx(2.0, rel=0.2)
    assert many.total[name] > 0.9 * np.hypot(many.parts[name]["area_gain"], 0.0)
    assert many.total[name] > 2.0 * many.data[name], "the gain of all areas stays"
    # The number of presses for the deviation that 40 presses have.
    assert presses_for(few, name, many.data[name]) == pytest.approx(40, rel=0.15)
    assert presses_for(few, name, 0.2 * many.total[name], total=True) is None


def test_a_plan_without_gains_of_presses_has_none(double) -> None:
    model, parts = double.HereditaryModel(), []
    for scatter in (0.0, 0.1):
        plan = Plan(presses=5, scatter=scatter)
        options = FitOptions(press_gain=False, geometry_sd=[])
        parts.append(expected(plan, model, double.TRUTH, options).data["composite_E"])
    assert parts[1] == pytest.approx(parts[0], rel=1e-9)


def test_a_plan_whose_residuals_are_zero_has_the_noise_that_it_names(double) -> None:
    options = FitOptions(nuisances=False)
    plans = [Plan(presses=5, area_noise=noise) for noise in (1e-6, 3e-6)]
    one, three = (
        expected_of(p.problem(double.HereditaryModel(), double.TRUTH, options), p, double.TRUTH)
        for p in plans
    )
    for name in one.total:
        assert three.total[name] == pytest.approx(3.0 * one.total[name], rel=1e-6)


def test_power_is_the_share_of_simulated_studies_that_find_it() -> None:
    rng = np.random.default_rng(0)
    for difference, within, between, subjects in ((0.2, 0.15, 0.2, 8), (0.1, 0.3, 0.1, 20)):
        scatter = np.hypot(within, between)
        draws = difference + scatter * rng.normal(size=(4000, subjects))
        share = float((ttest_1samp(draws, 0.0, axis=1).pvalue < 0.05).mean())
        assert power(difference, within, between, subjects) == pytest.approx(share, abs=0.03)
    assert power(0.0, 0.1, 0.1, 10) == pytest.approx(0.05, abs=1e-6)
    number = subjects_for(0.8, 0.2, 0.15, 0.2)
    assert number is not None
    assert power(0.2, 0.15, 0.2, number) >= 0.8 > power(0.2, 0.15, 0.2, number - 1)
    assert subjects_for(0.9, 0.001, 1.0, 1.0) is None


def test_what_both_conditions_share_cancels(double) -> None:
    model = double.HereditaryModel()
    plan = Plan(presses=20, hold=1.0, window="contact", area_noise=0.3e-6, scatter=0.01)
    options = FitOptions(area_gain_sd=0.1)
    first = expected(plan, model, double.TRUTH, options)
    other = expected(plan, model, double.TRUTH * [1.0, 1.5, 1.0, 1.0], options)
    apart = np.hypot(first.total["composite_E"], other.total["composite_E"])
    assert contrast_deviation(first, other, "composite_E") < 0.5 * apart


def test_the_command_compares_plans(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "design.json"
    arguments = [
        "design", "--plan", "short:presses=4", "--plan", "hold:presses=4,hold=1,window=contact",
        "--wanted", "composite_E=0.3", "--against", "dry", "--subjects", "12", "-o", str(out),
    ]  # fmt: skip
    assert run(command, arguments) == 0
    text = capsys.readouterr().out
    assert "short" in text and "hold" in text and "power" in text
    data = json.loads(out.read_text())
    short, hold = data["plans"]["short"], data["plans"]["hold"]
    # A displacement sensor of 20 µm is supposed beside each plan.
    assert list(data["plans"]) == ["short", "short + indentation", "hold", "hold + indentation"]
    sensed = data["plans"]["hold + indentation"]
    assert sensed["settings"]["indentation_sd"] == 20e-6 and not hold["settings"]["indentation_sd"]
    for name, gain in (("E0", 0.6), ("E1", 0.95)):
        assert sensed["sd_log_data"][name] < gain * hold["sd_log_data"][name], name
    assert "hold, with an indentation to 20 µm: E₀" in text
    assert hold["sd_log"]["E0"] < short["sd_log"]["E0"], "a hold tells E0"
    assert short["sd_log_parts"]["composite_E"]["pad_semi_axis_radial"] > 0.05
    assert short["sd_log_data"]["composite_E"] < short["sd_log"]["composite_E"]
    found = data["contrast"]["plans"]["hold"]["composite_E"]
    assert found["difference_log"] == pytest.approx(np.log(19.27 / 30.23), abs=0.01)
    assert 0.0 < found["power"] <= 1.0 and found["subjects_for_80"] <= found["subjects_for_90"]


def test_a_plan_names_its_own_sensor_or_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "design.json"
    plans = ["--plan", "fine:presses=4,indentation_sd=5e-6", "--plan", "none:presses=4"]
    assert run(command, ["design", *plans, "--indentation-sd", "0", "-o", str(out)]) == 0
    assert "fine, with an indentation to 5 µm" in capsys.readouterr().out
    data = json.loads(out.read_text())
    assert list(data["plans"]) == ["fine", "fine + indentation", "none"]


def test_a_sensor_never_widens_what_a_fit_leaves_open() -> None:
    """It answers to the assumed lengths more than the areas do, and is not believed beyond."""
    model = ReducedModel.load()
    natural = np.array([140e3, 22e3, 0.5, 1795e3])
    measured = FitOptions(geometry_sd=["calipers"])
    for plan in (Plan(presses=5), Plan(presses=5, hold=1.0, window="contact")):
        without, sensed = (
            expected(replace(plan, indentation_sd=sd), model, natural, measured)
            for sd in (0.0, 20e-6)
        )
        for name in without.total:
            assert sensed.data[name] <= 1.02 * without.data[name], name
            assert sensed.total[name] <= 1.05 * without.total[name], name
        assert sensed.total["E0"] < 0.7 * without.total["E0"]
        # Exact lengths let it say more.
        exact = expected(
            replace(plan, indentation_sd=20e-6), model, natural, FitOptions(geometry_sd=[])
        )
        assert exact.data["E1"] < 0.8 * sensed.data["E1"]


def test_plans_are_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "long.yaml"
    path.write_text("presses: 20\nhold: 2\nwindow: contact\n")
    long = Plan(presses=20, hold=2.0, window="contact")
    assert plans_of(str(path)) == [("long", long)]
    path.write_text("short:\n  presses: 4\nlong: {presses: 20, hold: 2, window: contact}\n")
    assert plans_of(str(path)) == [("short", Plan(presses=4)), ("long", long)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("press: 3\n", "plan.yaml: 'press' does not exist"),
        ("a: {press: 3}\n", "plan.yaml: a: 'press' does not exist"),
        ("presses: many\n", "plan.yaml: parameter 'presses' is 'many'"),
        ("a: {presses: 4}\npresses: 4\n", "'presses' is no plan"),
        ("- 3\n", "plan.yaml"),
        ("", "the plan is empty"),
        (None, "plan.yaml"),
    ],
)
def test_a_bad_file_of_plans_is_one_sentence(
    text: str | None, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "plan.yaml"
    if text is not None:
        path.write_text(text)
    assert run(command, ["design", "--plan", str(path)]) == 2
    error = capsys.readouterr().err
    assert words in error and len(error.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--indentation-sd", "20"], "indentation_sd' is 20.0, outside 0 … 0.001 m"),
        (["--plan", "a:press=3"], "'press' is no setting"),
        (["--plan", "a:presses=many"], "'many'; give a whole number"),
        (["--plan", "a:peak=500mN"], "'500mN'; give a number in N, without the unit"),
        (
            ["--plan", "a:frame_rate=2"],
            "in 0.5 s at frame_rate 2 Hz; give longer presses",
        ),
        (["--against", "wet"], "'wet': give one of dry"),
        (["--plan", ":presses=5"], "a name is needed"),
        (["--plan", "a:shortest=3,longest=1"], "exchange them"),
        (["--guess", "wet"], "give one of dry"),
        (["--guess", "E0=1e5"], "all of E0"),
        (["--guess", "E0=80kPa,E1=25kPa,tau1=0.5s,E2=1.8GN"], "all of E0"),
        (["--guess", "E0=80kPa,E1=25kPa,tau1=0.5s,E2=1.8MPa,E3=1"], "all of E0"),
        (["--guess", "E0=80,E1=25,tau1=0.5,E2=1800"], "E0 is 80 Pa, outside"),
        (["--wanted", "E=0.1"], "QUANTITY=DEVIATION"),
        (["--against", "dry", "--subjects", "1"], "at least 2 subjects"),
        (["--subjects", "20"], "--subjects is for a contrast; give --against too, or leave it out"),
        (["--between", "0.3"], "--between is for a contrast; give --against too"),
        (["--geometry-sd", "nail_radius=0.1", "nail_radius=0.2"], "'nail_radius' is there twice"),
    ],
)
def test_bad_input_is_one_sentence(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(command, ["design", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error and len(error.strip().splitlines()) == 1


def test_a_finger_is_named_with_or_without_units() -> None:
    space = StandardLinearSolid.PARAMETERS
    plain = finger_of("E0=80e3,E1=25.38e3,tau1=0.5,E2=1.8e6", space)
    named = finger_of("E0=80kPa,E1=25.38 kPa,tau1=500ms,E2=1.8MPa", space)
    np.testing.assert_allclose(named, plain, rtol=1e-12)
    for name, condition in CONDITIONS.items():
        assert space.mapping(finger_of(name, space)) == condition.parameters


def test_a_press_that_shows_no_frame_is_refused(double) -> None:
    with pytest.raises(InputError, match="longer presses"):
        ((name, plan),) = plans_of("quick:shortest=0.1,longest=0.1,frame_rate=4")
        assert name == "quick"
        expected(plan, double.HereditaryModel(), double.TRUTH)


def test_a_setting_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'presses' is there twice; keep one"):
        plans_of("x:presses=5,presses=500")
    file = tmp_path / "plan.yaml"
    file.write_text("presses: 5\npresses: 500\n")
    with pytest.raises(InputError, match="line 2: 'presses' is there twice; keep one"):
        plans_of(str(file))


def test_a_number_with_an_exponent_is_a_number(tmp_path: Path) -> None:
    """YAML 1.1 reads 1e6 as text."""
    file = tmp_path / "plan.yaml"
    file.write_text("peak: 1e6\n")
    with pytest.raises(InputError, match=r"'peak' is 1000000\.0, outside 0\.2 … 10 N"):
        plans_of(str(file))
    file.write_text("peak: 2e0\n")
    assert plans_of(str(file))[0][1].peak == 2.0
