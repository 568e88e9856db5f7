# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-fit population`: calibration by simulation, recovery, and the command."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chisquare

from finger_common.cli import run
from finger_common.errors import InputError
from finger_fit.cli import command
from finger_fit.hierarchy import Estimates, HierarchyPriors, posterior
from finger_fit.hierarchy.command import _arrays, read_subjects
from finger_model.laws import StandardLinearSolid

PRIORS = HierarchyPriors(level=1.0, level_sd=1.0, slope_sd=0.5)


def study(rng: np.random.Generator, subjects: int, conditions: int = 3, covariate=False, **truth):
    """A study drawn from the model: estimates, and what is true."""
    beta = PRIORS.level + PRIORS.level_sd * rng.normal(size=conditions)
    sigma = [
        abs(rng.normal(0, PRIORS.subject_sd)),
        abs(rng.normal(0, PRIORS.condition_sd)),
    ]
    sigma = [truth.get("subject_sd", sigma[0]), truth.get("condition_sd", sigma[1])]
    if "beta" in truth:
        beta = np.asarray(truth["beta"])
    effect = sigma[0] * rng.normal(size=subjects)
    shape = (subjects, conditions)
    sd = rng.uniform(0.05, 0.3, shape)
    shared = 0.1 * rng.normal(1.0, 0.2, (*shape, 2))
    common = np.full(shape, 0.15)
    value = effect[:, None] + sigma[1] * rng.normal(size=shape)
    value = value + (shared * rng.normal(size=(subjects, 1, 2))).sum(axis=2)
    value = value + common * rng.normal() + sd * rng.normal(size=shape)
    if covariate:
        place = rng.normal(size=shape)
        slope = PRIORS.slope_sd * rng.normal()
        beta = np.array([beta[0], slope])
        value = value + beta[0] + slope * place
        data = Estimates.of_covariate(value, sd, shared, common, place)
    else:
        value = value + beta
        # Not every subject came in every condition.
        value[:, 1:][rng.random((subjects, conditions - 1)) < 0.1] = np.nan
        data = Estimates.of_conditions(value, sd, shared, common)
    return data, beta, sigma, effect


@pytest.mark.parametrize("covariate", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_ranks_of_the_truth_are_uniform(covariate: bool) -> None:
    """Simulation-based calibration (Talts and others 2018): 200 studies of five subjects."""
    rng = np.random.default_rng(3)
    draws, studies = 99, 200
    ranks: dict[str, list[int]] = {}
    for seed in range(studies):
        data, beta, sigma, effect = study(rng, 5, covariate=covariate)
        found = posterior(data, PRIORS, draws, seed)
        truth = {
            "level": (found.beta[:, 0], beta[0]),
            "contrast": (found.beta[:, 1] - (not covariate) * found.beta[:, 0],
                         beta[1] - (not covariate) * beta[0]),
            "subject_sd": (found.subject_sd, sigma[0]),
            "condition_sd": (found.condition_sd, sigma[1]),
            "effect": (found.effect[:, 1], effect[1]),
        }  # fmt: skip
        for name, (drawn, true) in truth.items():
            ranks.setdefault(name, []).append(int((drawn < true).sum()))
    for name, found in ranks.items():
        counts = np.histogram(found, bins=10, range=(0, draws + 1))[0]
        assert counts.sum() == studies
        assert chisquare(counts).pvalue > 0.001, (name, counts)


def test_thirty_subjects_give_means_spread_and_contrast() -> None:
    rng = np.random.default_rng(1)
    truth = {"beta": [3.4, 3.0, 2.6], "subject_sd": 0.25, "condition_sd": 0.1}
    data, *_ = study(rng, 30, **truth)
    found = posterior(data, HierarchyPriors(level=3.0), seed=2)
    assert not found.problems
    for j, mean in enumerate(truth["beta"]):
        assert abs(found.beta[:, j].mean() - mean) < 3 * found.beta[:, j].std()
    difference = found.beta[:, 0] - found.beta[:, 1]
    assert (difference > 0).mean() > 0.99
    # The gain of the one plate stays in the level, and leaves the contrast.
    assert found.beta[:, 0].std() > 0.14 > 2.0 * difference.std()
    assert abs(found.subject_sd.mean() - 0.25) < 3 * found.subject_sd.std() < 0.2


def test_arviz_finds_the_draws_independent() -> None:
    """Four parts of the draws as if they were chains: no part knows of another."""
    stats = pytest.importorskip("arviz_stats.base").array_stats
    data, *_ = study(np.random.default_rng(1), 10)
    found = posterior(data, PRIORS, draws=4000, seed=5)
    for draws in (*found.beta.T, found.subject_sd, found.condition_sd, *found.effect.T[:2]):
        chains = draws.reshape(4, 1000)
        assert stats.rhat(chains, chain_axis=0, draw_axis=1) < 1.01
        for method in ("bulk", "sd"):
            size = stats.ess(chains, chain_axis=0, draw_axis=1, method=method)
            assert size > 0.8 * draws.size, method


def test_a_subject_of_poor_data_is_drawn_to_the_others() -> None:
    value = np.array([[3.0], [3.1], [2.9], [3.0], [5.0]])
    none = np.zeros((5, 1, 0))
    sd = np.array([[0.05], [0.05], [0.05], [0.05], [1.0]])
    data = Estimates.of_conditions(value, sd, none, np.zeros((5, 1)))
    found = posterior(data, HierarchyPriors(level=3.0, subject_sd=0.2))
    assert abs(found.effect[:, 4].mean()) < 0.3
    with pytest.raises(InputError, match="at least three"):
        posterior(Estimates.of_conditions(value[:2], sd[:2], none[:2], np.zeros((2, 1))))


def test_an_error_that_a_subject_has_in_all_conditions_is_no_spread_between_people() -> None:
    """As that of a wrong length: it leaves the contrast as certain as it was."""
    rng = np.random.default_rng(0)
    value = 3.0 + 0.3 * rng.normal(size=(12, 1)) + [[0.0, 0.4]] + 0.03 * rng.normal(size=(12, 2))
    sd, none = np.full((12, 2), 0.03), np.zeros((12, 2))
    priors = HierarchyPriors(level=3.0)
    real, mere = (
        posterior(Estimates.of_conditions(value, sd, np.full((12, 2, 1), shared), none), priors)
        for shared in (0.0, 0.3)
    )
    assert mere.subject_sd.mean() < 0.15 < 0.2 < real.subject_sd.mean()
    contrast = [found.beta[:, 1] - found.beta[:, 0] for found in (real, mere)]
    assert contrast[1].std() == pytest.approx(contrast[0].std(), rel=0.2)


def fit_file(folder: Path, subjects: int = 8, trials: int = 15) -> Path:
    """A fit.json of subjects who are 1.5 times stiffer when dry."""
    rng = np.random.default_rng(4)
    space = StandardLinearSolid.PARAMETERS
    data: dict = {"subjects": {}}
    for i in range(subjects):
        level = 0.2 * rng.normal()
        conditions = {}
        for name, factor, moisture in (("dry", 1.5, 38.0), ("natural", 1.0, 70.0)):
            entry = {"moisture_mean": moisture + rng.normal(), "active_bounds": {}, "from_data": {}}
            entry["trials"] = trials
            for q in space.quantity_names:
                low, high = space.quantity_bounds(q)
                value = 0.6 * np.sqrt(low * high) * factor * np.exp(level + 0.05 * rng.normal())
                entry[q] = float(value)
                entry["from_data"][q] = {
                    "sd_log": 0.05, "sd_log_assumed": 0.25,
                    "assumed": {"area_gain": -0.15, "epidermis_thickness": -0.2},
                }  # fmt: skip
            conditions[name] = entry
        data["subjects"][f"S{i:02d}"] = {"conditions": conditions}
    folder.mkdir(exist_ok=True)
    (folder / "fit.json").write_text(json.dumps(data))
    return folder


def test_fits_of_few_presses_count_less(tmp_path: Path) -> None:
    """Of three presses, an interval is 4.30 deviations long to each side, not 1.96."""

    def spread(trials: int) -> float:
        subjects = read_subjects([str(fit_file(tmp_path / str(trials), trials=trials))])
        return float(_arrays(subjects, ["dry", "natural"], "composite_E")[1].mean())

    many, three = spread(100_000), spread(3)
    assert many == pytest.approx(0.05, rel=0.01) and three / many == pytest.approx(2.195, rel=0.01)


@pytest.mark.parametrize(
    ("key", "value"), [("trials", 0), ("trials", -3), ("composite_E", 0.0), ("sd_log", -0.05)]
)
def test_numbers_that_no_fit_gives_are_refused(tmp_path: Path, key: str, value: float) -> None:
    file = fit_file(tmp_path) / "fit.json"
    data = json.loads(file.read_text())
    entry = data["subjects"]["S03"]["conditions"]["dry"]
    (entry if key in entry else entry["from_data"]["composite_E"])[key] = value
    file.write_text(json.dumps(data))
    subjects = read_subjects([str(file)])
    with pytest.raises(InputError, match=r"S03 dry: fit.json: no value and deviations of"):
        _arrays(subjects, ["dry", "natural"], "composite_E")


def test_the_command_reads_fits_and_writes_the_population(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = fit_file(tmp_path / "fit")
    assert run(command, ["population", str(folder), "-o", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "told apart in the population" in shown
    data = json.loads((tmp_path / "population.json").read_text())
    entry = data["quantities"]["composite_E"]
    ratio = entry["ratios"]["dry / natural"]
    assert ratio["low"] < 1.5 < ratio["high"] and ratio["low"] > 1.3
    assert entry["moisture_slope_log_per_10"]["high"] < 0, "moister is softer"
    assert entry["sd_between_subjects_log"]["low"] > 0.0
    assert set(entry["subjects"]) == {f"S{i:02d}" for i in range(8)}
    header, *rows = csv.reader((tmp_path / "population_draws.csv").read_text().splitlines())
    draws = dict(zip(header, np.array(rows, dtype=float).T))
    found = draws["composite_E dry"] / draws["composite_E natural"]
    assert np.median(found) == pytest.approx(ratio["median"], rel=1e-4), "rows are paired"
    slope = draws["composite_E moisture_slope_log_per_10"]
    assert (slope < 0).mean() == entry["probability_slope_negative"]


def test_few_subjects_with_moisture_have_no_slope_and_the_rest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = fit_file(tmp_path / "fit", 5)
    data = json.loads((folder / "fit.json").read_text())
    for code in ("S02", "S03", "S04"):
        for entry in data["subjects"][code]["conditions"].values():
            entry["moisture_mean"] = None
    data["subjects"]["S01"]["conditions"]["dry"]["status"] = "interrupted"
    (folder / "fit.json").write_text(json.dumps(data))
    assert run(command, ["population", str(folder), "-o", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert shown.count("1 of the fits are not final: S01 dry (interrupted)") == 1
    assert "composite_E: dry / natural" in shown, "the words of a quantity name it"
    entry = json.loads((tmp_path / "population.json").read_text())["quantities"]["composite_E"]
    assert "moisture_slope_log_per_10" not in entry and entry["mean"]["dry"]["median"] > 0


def test_bad_input_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = fit_file(tmp_path / "fit")
    few = fit_file(tmp_path / "few", 2)
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "fit.json").write_text('{"conditions": {"dry": {"E2": 1e6}}}')
    (tmp_path / "other.json").write_text("[1]")
    for arguments, words in (
        ([str(tmp_path / "none")], "no fit.json there"),
        ([str(folder), "--quantity", "E9"], "known are E0"),
        ([str(few)], "at least three"),
        ([str(tmp_path / "old")], "fit again"),
        ([str(folder), str(folder)], "is there twice"),
        ([str(tmp_path / "other.json")], "not a fit.json"),
    ):
        assert run(command, ["population", *arguments, "-o", str(tmp_path / "out")]) == 2
        error = capsys.readouterr().err
        assert words in error and len(error.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
