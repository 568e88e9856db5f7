# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The lengths of the finger that a fit assumes: who gave them, how well they are known, and whose
they are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from finger_common.cli import run
from finger_common.errors import InputError
from finger_fit import Fit, Trial, fit
from finger_fit.cli import command
from finger_fit.fingers import ALL, AssumedFinger, KnownLengths, by_subject, geometry_files
from finger_fit.nuisance_priors import CALIPERS
from finger_fit.report.nuisances import lengths
from finger_fit.report.page import render
from finger_model.anthropometry import estimate_geometry
from finger_model.finger import load_reduced
from finger_model.geometry import Geometry

TISSUE = np.array([95e3, 32e3, 0.3, 1300e3])
TRUE_E = 1.0 / (1.0 / 95e3 + 1.0 / 32e3)

QUICK: dict[str, Any] = {
    "full_order": False,
    "profiles": False,
    "bootstrap": 0,
    "bias_pairs": 0,
    "grid": 3,
    "rounds": 4,
    "particles": 4,
    "step": 0.04,
}


def presses_of(geometry: Geometry, number: int = 4, **about: Any) -> list[Trial]:
    """Presses of a finger of this size, to 1.4 N in 0.5 to 2 s, with 1 mm² of noise."""
    model, rng = load_reduced(geometry_file=geometry), np.random.default_rng(3)
    found = []
    for rise in np.linspace(0.5, 2.0, number):
        time = np.arange(0.0, rise + 1.6, 0.005)
        force = 1.4 * np.clip(np.minimum((time - 0.5) / rise, (rise + 1.1 - time) / 0.4), 0.0, 1.0)
        area = model.simulate(TISSUE, time, force).area[::20]
        area = np.where(area > 0, np.maximum(area + rng.normal(0, 1e-6, len(area)), 1e-7), 0.0)
        found.append(Trial(time, force, area, time[::20], "natural", target_force=1.33, **about))
    return found


def interval_of(found: Fit) -> tuple[float, float]:
    low, high = found.intervals["natural"]["composite_E"]
    return low, high


def check_of(found: Fit, name: str) -> tuple[str, str]:
    (quality,) = (f.quality for f in found.result.fits.values())
    assert quality is not None
    (check,) = (c for c in quality.checks if c.name == name)
    return check.status, check.detail


@pytest.fixture(scope="module", params=[(12.5e-3, 10e-3), (21e-3, 16.5e-3)])
def unmeasured(request: pytest.FixtureRequest) -> Fit:
    """A small and a large finger, fitted as if they were the default one."""
    width, depth = request.param
    return fit(presses_of(estimate_geometry(width=width, depth=depth).geometry), **QUICK)


def test_the_interval_of_a_finger_that_nobody_measured_holds_other_sizes(unmeasured: Fit) -> None:
    low, high = interval_of(unmeasured)
    assert low < TRUE_E < high
    assert abs(np.log(unmeasured.parameters["composite_E"] / TRUE_E)) > 0.25, "another finger"


def test_lengths_that_nobody_gave_are_noted_with_the_remedy(unmeasured: Fit) -> None:
    status, words = check_of(unmeasured, "lengths of the finger")
    assert status == "note" and "17 mm wide and 11 mm deep" in words and "--geometry" in words
    assert "default finger, not measured" in lengths(unmeasured.result)
    stated = unmeasured.result.sources["geometry"]
    assert stated["source"] == "default finger, not measured"
    assert stated["deviations"]["pad_semi_axis_radial"] == pytest.approx(0.86e-3, rel=0.01)


def test_estimates_on_bounds_are_said_to_limit_the_intervals(unmeasured: Fit) -> None:
    status, words = check_of(unmeasured, "search box")
    (fitted,) = unmeasured.result.fits.values()
    assert fitted.covariance is not None and fitted.covariance.active
    assert status == "note" and "on a bound" in words and "--geometry" in words
    assert "They end at the search box" in render(unmeasured.result, {})


def test_lengths_of_a_file_are_found_again_in_report_and_fit_json(tmp_path: Path) -> None:
    estimate = estimate_geometry(width=21e-3, depth=16.5e-3)
    file = tmp_path / "large.yaml"
    file.write_text(estimate.yaml_text())
    found = fit(presses_of(estimate.geometry), geometry=file, **QUICK)
    low, high = interval_of(found)
    assert low < TRUE_E < high
    assert found.parameters["composite_E"] == pytest.approx(TRUE_E, rel=0.25)
    assert check_of(found, "lengths of the finger")[0] == "ok"
    found.save(tmp_path)
    stated = json.loads((tmp_path / "fit.json").read_text())["provenance"]["geometry"]
    assert stated["source"] == f"given by {file}"
    assert stated["lengths"] == pytest.approx(estimate.geometry.to_dict())
    for name, deviation in estimate.deviations.items():
        if estimate.geometry.to_dict()[name]:
            assert stated["deviations"][name] == pytest.approx(deviation, rel=0.05)
    text = lengths(found.result)
    assert str(file) in text and "10.50" in text and "± 0.55 mm (5 %)" in text
    assert "–" in text, "the height of the bone's centre is 0, and has no relative deviation"


def test_what_a_geometry_states_is_what_the_fit_allows_for(tmp_path: Path) -> None:
    plain = tmp_path / "plain.yaml"
    plain.write_text("epidermis_thickness: 0.0004\n")
    assert AssumedFinger.load(plain).lengths == KnownLengths(CALIPERS, str(plain))
    some = tmp_path / "some.yaml"
    some.write_text("epidermis_thickness: 0.0004\ndeviations: {epidermis_thickness: 0.00002}\n")
    known = AssumedFinger.load(some).lengths.deviations
    assert known == pytest.approx({**CALIPERS, "epidermis_thickness": 0.05})
    typical, measured = (
        AssumedFinger.load(estimate_geometry(**how)).lengths.deviations
        for how in ({"finger": "index"}, {"width": 17e-3, "depth": 11e-3})
    )
    assert AssumedFinger.load().lengths == KnownLengths(typical), "nobody measured it"
    # Calipers without stated deviations are the rules', rounded.
    assert {n: measured[n] for n in CALIPERS} == pytest.approx(CALIPERS, rel=0.1)
    for name in ("pad_semi_axis_radial", "pad_semi_axis_axial"):
        assert typical[name] > 1.8 * measured[name]


@pytest.fixture(scope="module")
def two_subjects() -> tuple[list[Trial], dict[str, Geometry]]:
    sizes = {
        "S01": estimate_geometry(width=13e-3, depth=10.5e-3).geometry,
        "S02": estimate_geometry(width=21e-3, depth=16.5e-3).geometry,
    }
    return [p for s, g in sizes.items() for p in presses_of(g, 3, subject=s)], sizes


@pytest.mark.slow
def test_each_subject_has_its_own_finger(
    two_subjects: tuple[list[Trial], dict[str, Geometry]], tmp_path: Path
) -> None:
    trials, sizes = two_subjects
    found = fit(trials, geometry=sizes, **QUICK)
    for subject, geometry in sizes.items():
        own = found.subjects[subject]
        assert own.parameters["composite_E"] == pytest.approx(TRUE_E, rel=0.3)
        assert own.result.model.geometry == geometry
        assert own.result.sources["geometry"]["lengths"] == geometry.to_dict()
        assert own.result.sources["geometry_hash"] == geometry.hash()
    assert found.result.sources["geometry"] is None
    assert "of each subject its own" in render(found.result, {})


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["S01"], "no --geometry for S02: with lengths by subject each one needs its own"),
        (["S01", "S02", "S2"], "no press is of subject 'S2'; did you mean 'S02'?"),
    ],
)
def test_fingers_that_do_not_belong_to_the_subjects_are_refused(
    two_subjects: tuple[list[Trial], dict[str, Geometry]], given: list[str], words: str
) -> None:
    trials, _ = two_subjects
    with pytest.raises(InputError) as refused:
        fit(trials, geometry={subject: Geometry() for subject in given}, **QUICK)
    assert words in str(refused.value)
    with pytest.raises(InputError, match="--pool fits all presses as one finger's"):
        fit(trials, geometry={"S01": Geometry(), "S02": Geometry()}, pool=True, **QUICK)


def test_one_file_or_one_for_each_subject(tmp_path: Path) -> None:
    assert geometry_files([]) == {ALL: None}
    assert geometry_files(["g.yaml"]) == {ALL: "g.yaml"}
    assert geometry_files(["S01=a.yaml", "S 2=b.yaml"]) == {"S01": "a.yaml", "S 2": "b.yaml"}
    odd = tmp_path / "a=b.yaml"
    odd.write_text("")
    assert geometry_files([str(odd)]) == {ALL: str(odd)}
    assert by_subject({"nail_radius": 7e-3}) == {ALL: {"nail_radius": 7e-3}}
    assert by_subject({"S01": "a.yaml"}) == {"S01": "a.yaml"}


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (["a.yaml", "b.yaml"], "a file for all subjects is already given"),
        (["S01=a.yaml", "S01=b.yaml"], "a file for subject S01 is already given"),
        (["a.yaml", "S01=b.yaml"], "a file for all subjects beside those of some"),
        (["=a.yaml"], "give FILE, or SUBJECT=FILE"),
        (["S01="], "give FILE, or SUBJECT=FILE"),
    ],
)
def test_geometry_options_that_contradict_are_refused(
    texts: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    options = [part for text in texts for part in ("--geometry", text)]
    assert run(command, [str(bag), "-o", str(tmp_path / "out"), *options]) == 2
    error = capsys.readouterr().err.strip()
    assert words in error and "\n" not in error
