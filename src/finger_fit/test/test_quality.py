# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Data that cannot be right are refused before a fit, or named on top of its results."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from finger_bag.writer import BagWriter
from finger_common.cli import run
from finger_common.errors import InputError
from finger_common.flags import AreaFlag
from finger_fit.cli import command
from finger_fit.options import FitOptions
from finger_fit.problem import FitProblem
from finger_fit.quality import screen
from finger_fit.results import Finger, check_folder, parameter_files, write
from finger_fit.results.tables import trial_rows
from finger_fit.study import fit_records
from finger_fit.study.bags import load, reading
from finger_model.anthropometry import estimate_geometry
from finger_model.estimator.parameter_selection import check_sets
from finger_model.finger import load_for
from finger_model.geometry import Geometry
from finger_model.laws import StandardLinearSolid
from finger_model.parameter_sets import ParameterSets
from finger_model.reduced import ReducedModel
from finger_model.reduced.model import load_population
from finger_model.subjects import subject_file
from finger_offline.process import process

QUICK = FitOptions(
    full_order=False, profiles=False, bootstrap=0, bias_pairs=0, grid=2, particles=2, rounds=1
)


@pytest.fixture(scope="module")
def presses(double: SimpleNamespace) -> list[Any]:
    """Four presses of one finger."""
    return [double.make_record(i, 0.6 + 0.4 * i, 0.3e-6) for i in range(4)]


def fitted(double: SimpleNamespace, records: list[Any], options: FitOptions = QUICK) -> Any:
    return fit_records(records, double.HereditaryModel(), options)


def status_of(result: Any, name: str) -> tuple[str, str]:
    (fit,) = result.fits.values()
    (check,) = [c for c in fit.quality.checks if c.name == name]
    return check.status, check.detail


def test_clean_presses_pass_every_check(double: SimpleNamespace, presses: list[Any]) -> None:
    result = fitted(double, presses)
    (fit,) = result.fits.values()
    assert {c.name: c.status for c in fit.quality.checks} == {
        "frames": "ok",
        "low force": "ok",
        "stamps": "ok",
        "saturation": "ok",
        "errors of the frames": "ok",
        "lag of the areas": "ok",
        "tare": "ok",
        "scatter between presses": "ok",
        "model against areas": "ok",
        "search box": "ok",
        "moisture": "ok",
    }
    assert all(t.gain == pytest.approx(1.0, abs=0.02) for t in fit.quality.trials)


def test_the_same_press_three_times_counts_once(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    again = [replace(p, bag="copy", stamp_ns=p.stamp_ns + 10**9,
                     area_stamp_ns=p.area_stamp_ns + 10**9) for p in presses]  # fmt: skip
    result = fitted(double, [*presses, *again, *presses])
    (fit,) = result.fits.values()
    assert len(fit.problem) == 4
    reasons = [e.reason for e in result.exclusions]
    assert len(reasons) == 8 and all("the same press as" in r for r in reasons)


def test_a_press_measured_again_counts_once(double: SimpleNamespace, presses: list[Any]) -> None:
    """Its images by another threshold; another finger under the same drive is no second time."""
    again = [replace(p, bag="copy", area=1.03 * p.area) for p in presses]
    other = [replace(p, subject="S02", area=1.2 * p.area) for p in presses]
    found = screen([*presses, *again, *other])
    assert len(found.records) == 8
    assert {e.subject for e in found.exclusions} == {"S01"} and len(found.exclusions) == 4


def without_date(record: Any) -> Any:
    """As an import makes it of a file whose times begin at 0."""
    shift = int(record.stamp_ns[0]) - 946_684_800 * 10**9
    return replace(
        record, stamp_ns=record.stamp_ns - shift, area_stamp_ns=record.area_stamp_ns - shift
    )


def test_presses_of_one_nominal_force_are_all_fitted(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    """They may be one press, of whose images the areas were measured twice: it is noted."""
    rng = np.random.default_rng(0)
    ramp = presses[1]
    noise = [0.3e-6 * rng.normal(size=len(ramp.area)) * (ramp.area > 0) for _ in range(3)]
    again = [replace(ramp, bag=f"ramp_{i}", area=ramp.area + noise[i]) for i in range(3)]
    result = fitted(double, [without_date(p) for p in again])
    (fit,) = result.fits.values()
    assert len(fit.problem) == 3 and not result.exclusions
    (note,) = [n for n in result.problems if "the same force" in n]
    assert "ramp_0 trial 1, ramp_1 trial 1, ramp_2 trial 1; all are kept" in note
    # At several dates they are several presses, at one date they are one.
    later = [
        replace(p, stamp_ns=p.stamp_ns + i * 10**10, area_stamp_ns=p.area_stamp_ns + i * 10**10)
        for i, p in enumerate(again)
    ]
    assert len(screen(later).records) == 3 and screen(later).notes
    assert len(screen(again).records) == 1 and not screen(again).notes


def test_simulated_presses_of_equal_areas_are_one(presses: list[Any]) -> None:
    found = screen([without_date(replace(presses[0], index=i)) for i in range(3)])
    assert len(found.records) == 1 and len(found.exclusions) == 2 and not found.notes


def test_a_press_counts_where_only_its_copy_is_in_another_unit(presses: list[Any]) -> None:
    wrong = replace(presses[0], area=presses[0].area * 1e6)
    found = screen([wrong, replace(presses[0], bag="mapped")])
    assert [record.bag for record in found.records] == ["mapped"]
    assert "name the unit" in found.exclusions[0].reason


def write_press(folder: Path, start: int, condition: str) -> None:
    """A bag of S01 with one press, from `start` on, in s."""
    with BagWriter(folder, {"subject": "S01", "condition": condition}) as bag:
        for k in range(1500):
            force = 1.5 * min(max(k / 500 - 0.5, 0.0), max(2.5 - k / 500, 0.0), 1.0)
            header = {"header": {"stamp": start * 10**9 + (k + 1) * 2_000_000}}
            bag.write("wrench", {**header, "wrench": {"force": {"z": -force}}})
            if k % 50 == 0:
                bag.write("contact_area", {**header, "gross_area": 4e-5 * force})


@pytest.mark.parametrize("start", [1_700_000_000, 0])
def test_copies_of_a_bag_count_once(tmp_path: Path, start: int) -> None:
    """Of a clock that was set, and of one that was not."""
    write_press(tmp_path / "a", start, "dry")
    shutil.copytree(tmp_path / "a", tmp_path / "copy")
    process(tmp_path / "a", tmp_path / "processed")
    bags = [tmp_path / name for name in ("a", "a", "copy", "processed")]
    records = [record for path in bags for record in load([path], reading(FitOptions())).records]
    found = screen(records)
    assert len(records) == 4 and len(found.records) == 1 and not found.notes
    # The images of the processed bag were measured by another threshold.
    again = replace(records[3], area=1.03 * records[3].area)
    found = screen([records[0], again])
    assert [len(found.records), len(found.notes)] == ([1, 0] if start else [2, 1])


def test_codes_of_subjects_are_written_in_one_way(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    other = [double.make_record(i, 0.7 + 0.4 * i, 0.3e-6) for i in range(4)]
    with pytest.raises(
        InputError, match=r"'S01' in .* and 's01' in .* differ in case or spaces alone"
    ):
        fitted(double, [*presses, *(replace(p, subject="s01") for p in other)])
    with pytest.raises(InputError, match=r"subject '\.\./S01' is not valid; use"):
        fitted(double, [replace(p, subject="../S01") for p in presses])


def test_bags_whose_conditions_differ_in_case_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, condition in enumerate(["dry", "Dry"]):
        write_press(tmp_path / f"b{number}", 1_700_000_000 + 10 * number, condition)
    bags = [str(tmp_path / name) for name in ("b0", "b1")]
    assert run(command, [*bags, "-o", str(tmp_path / "fit"), "--quiet"]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert "conditions 'dry' in " in said and "/b0 and 'Dry' in " in said
    assert (
        "differ in case or spaces alone; write one name in one way, or fit each of them alone"
        in said
    )


def test_a_press_that_began_before_the_recording_is_left_out(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    late = [
        replace(p, stamp_ns=p.stamp_ns[a:], force=p.force[a:])
        for p in presses
        for a in [int(np.argmax(p.force > 0.4))]
    ]
    result = fitted(double, [*presses, *late])
    (fit,) = result.fits.values()
    assert len(fit.problem) == 4
    reasons = [e.reason for e in result.exclusions]
    assert len(reasons) == 4 and all("began before the recording" in r for r in reasons)


@pytest.mark.parametrize("tare", [-0.3, 0.3])
def test_a_large_tare_is_taken_off_and_fails(
    double: SimpleNamespace, presses: list[Any], tare: float
) -> None:
    options = replace(QUICK, target_force=1.35)
    clean = fitted(double, presses, options).fits["natural"]
    result = fitted(double, [replace(p, force=p.force + tare) for p in presses], options)
    status, words = status_of(result, "tare")
    assert status == "fail" and f"{tare:+.3f} N (median)".replace("-", "−") in words
    assert result.fits["natural"].cost == pytest.approx(clean.cost, rel=0.02)


def test_areas_without_a_force_are_named(double: SimpleNamespace, presses: list[Any]) -> None:
    """The area sensor has an offset: no frame shows the plate without a contact."""
    moved = [
        replace(p, area=p.area + 4e-6, area_flags=np.zeros_like(p.area_flags)) for p in presses
    ]
    status, words = status_of(fitted(double, moved), "tare")
    assert status == "note"
    found = re.search(r"(\d+) of (\d+) frames where the force is zero show a contact, of 4", words)
    assert found and int(found[1]) == int(found[2]) > 10
    late = [replace(p, area_stamp_ns=p.area_stamp_ns + 100_000_000) for p in presses]
    for records in (presses, late):
        assert "where the force is zero" not in status_of(fitted(double, records), "tare")[1]


def test_the_tare_that_is_farthest_from_zero_counts(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    """A sensor that drifts below its zero, in the last press."""
    drifted = replace(presses[3], force=presses[3].force - 0.3)
    status, words = status_of(fitted(double, [*presses[:3], drifted]), "tare")
    assert status == "fail" and "at most −0.3" in words


def test_presses_beyond_the_default_fingers_model_are_fitted_with_the_populations(
    double: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, population = ReducedModel.load(), load_population(Geometry())
    truth = own.space.default
    options = replace(QUICK, polish=False, nuisances=False)
    monkeypatch.setattr("finger_fit.study.study._further", lambda *_: None)

    def found(peak: float) -> Any:
        records = []
        for i in range(3):
            record = double.make_record(i, 0.5 + 0.2 * i, peak=peak)
            time = (record.stamp_ns - record.stamp_ns[0]) * 1e-9
            frames = np.searchsorted(time, (record.area_stamp_ns - record.stamp_ns[0]) * 1e-9)
            (areas,) = population.batch(truth, [(time, record.force, frames)])
            record.area, record.target_force = areas[0], 0.97 * peak
            record.area_flags = (areas[0] <= 0).astype(int)
            records.append(record)
        return fit_records(records, own, options)

    result = found(5.0)
    (fit,) = result.fits.values()
    assert result.model.serves_population and not fit.reasons
    assert any("fitted with that of the population box" in note for note in result.problems)
    held = FitProblem(fit.problem.trials, own, options)
    assert fit.problem.area_cost(truth) < 0.1 * held.area_cost(truth), "areas above 3 N count"
    (beyond,) = found(12.0).fits.values()
    assert re.match(r"the force goes up to 1[12].* N, the model is made for", beyond.reasons[0])
    assert found(1.5).model is own


@pytest.mark.parametrize("every", [False, True])
def test_single_wrong_frames_are_named_and_are_no_wrong_unit(
    double: SimpleNamespace, every: bool
) -> None:
    records = []
    for index in range(8):
        record = double.make_record(index, 0.8 + 0.15 * index, 0.3e-6)
        wrong = np.zeros(len(record.area), dtype=bool)
        wrong[9] = every or index == 3
        area = record.area * np.where(wrong, 2.2 if every else 4.0, 1.0)
        records.append(replace(record, area=area))
    result = fitted(double, records)
    status, detail = status_of(result, "model against areas")
    assert status == "note" and "check the units" not in detail, detail
    frames = "8 frames: natural" if every else "1 frame: natural_03 trial 3 at 0.91 s ("
    assert f"most of it is of {frames}" in detail and "--loss huber" in detail
    huber = fitted(double, records, replace(QUICK, loss="huber"))
    assert "--loss huber" not in status_of(huber, "model against areas")[1]


def test_areas_and_forces_in_another_unit_are_excluded(presses: list[Any]) -> None:
    wrong = [
        replace(presses[0], area=presses[0].area * 1e6),
        replace(presses[1], area=presses[1].area * 1e-2),
        replace(presses[2], force=presses[2].force * 1e3),
    ]
    found = screen([*wrong, presses[3]])
    assert len(found.records) == 1
    areas, small, force = (e.reason for e in found.exclusions)
    assert "name the unit" in areas and "5 and 2000 mm²" in small and "more than a finger" in force


def test_two_subjects_are_fitted_apart_unless_pooled(
    double: SimpleNamespace, presses: list[Any], tmp_path: Path
) -> None:
    soft = np.array([80e3, 15e3, 0.2, 1000e3])
    other = [double.make_record(i, 0.6 + 0.4 * i, 0.3e-6, truth=soft) for i in range(4)]
    records = [*presses, *(replace(p, subject="S02") for p in other)]
    options = replace(QUICK, grid=4, rounds=5)
    result = fitted(double, records, options)
    assert list(result.subjects) == ["S01", "S02"]
    stiff, softer = (part.fits["natural"] for part in result.subjects.values())
    assert stiff.quantity("composite_E") > 1.3 * softer.quantity("composite_E")
    result.sources = {"geometry_hash": "a"}
    write(result, tmp_path)
    data = json.loads((tmp_path / "fit.json").read_text())
    assert set(data["subjects"]) == {"S01", "S02"} and "conditions" not in data
    assert data["subjects"]["S02"]["conditions"]["natural"]["trials"] == 4
    assert len(ParameterSets.load(tmp_path / "S02" / "parameters.yaml").sets) == 1
    assert not (tmp_path / "parameters.yaml").exists()
    # The folder that the model node chooses from by the protocol's subject.
    for code in result.subjects:
        own = ParameterSets.load(subject_file(tmp_path / "subjects", code)).sets
        assert own == ParameterSets.load(tmp_path / code / "parameters.yaml").sets

    pooled = fitted(double, records, replace(options, pool=True))
    assert not pooled.subjects and len(pooled.fits["natural"].problem) == 8
    assert "2 subjects are pooled: S01, S02" in pooled.problems
    # What an earlier fit wrote for the model node goes, what a calibration put there stays.
    calibrated = subject_file(tmp_path / "subjects", "S02")
    calibrated.write_text(calibrated.read_text() + "# calibrated\n")
    write(pooled, tmp_path)
    assert [p.name for p in (tmp_path / "subjects").iterdir()] == ["S02.yaml"]


def test_two_fingers_of_a_subject_are_not_fitted_as_one(
    double: SimpleNamespace, presses: list[Any], tmp_path: Path
) -> None:
    """What is not noted may be of either; each finger has a file of its own for the model node."""
    first, thumb = (
        [replace(p, bag=f"S01_{name}/{p.bag}", finger=finger) for p in presses]
        for name, finger in (("a", "right_index"), ("b", "thumb"))
    )
    both = [*first, *(replace(p, force=1.001 * p.force, area=1.45 * p.area) for p in thumb)]
    said = r"subject S01 has trials of several fingers \(right_index in S01_a/natural_00 and 3 more"
    with pytest.raises(InputError, match=said + ", thumb in S01_b/.*--pool"):
        fitted(double, both)
    assert len(fitted(double, both, replace(QUICK, pool=True)).fits["natural"].problem) == 8
    mixed = [*first[:2], *presses[2:]]
    for records, name in ((mixed, "S01.right_index.yaml"), (thumb, "S01.thumb.yaml")):
        write(fitted(double, records), tmp_path)
        assert [p.name for p in (tmp_path / "subjects").iterdir()] == [name]


def unnamed(codes: set[str]) -> set[Finger]:
    return {Finger(code, "") for code in codes}


def test_a_folder_with_a_fit_of_other_subjects_is_refused(
    double: SimpleNamespace, presses: list[Any], tmp_path: Path
) -> None:
    """Their parameters would stay there, where the model node chooses."""
    other = [replace(p, subject="S02", area=1.2 * p.area) for p in presses]
    write(fitted(double, [*presses, *other]), tmp_path)
    kept = sorted(p for p in tmp_path.rglob("*") if p.is_file())
    for found in ({"S01", "S02"}, {"S01", "S02", "S03"}):
        check_folder(tmp_path, unnamed(found))
    for found, named in (({"S01"}, "S02"), ({"S03", ""}, "S01, S02")):
        with pytest.raises(InputError, match=f"holds an earlier fit of {named}, who are not"):
            check_folder(tmp_path, unnamed(found))
    assert kept == sorted(p for p in tmp_path.rglob("*") if p.is_file())
    write(fitted(double, presses), tmp_path / "one")
    check_folder(tmp_path / "one", unnamed({"S01"}))
    with pytest.raises(InputError, match="holds an earlier fit of S01"):
        check_folder(tmp_path / "one", unnamed({"S02"}))
    check_folder(tmp_path / "new", unnamed({"S02"}))


def test_a_folder_with_a_fit_of_another_finger_is_refused_and_pooled_ones_have_no_file(
    double: SimpleNamespace, presses: list[Any], tmp_path: Path
) -> None:
    """Their parameters would be lost, or taken for those of one of the two."""
    names = "right_index", "right_thumb"
    index, thumb = ([replace(p, finger=name) for p in presses] for name in names)
    write(fitted(double, index), tmp_path)
    check_folder(tmp_path, {Finger("S01", "right_index")})
    check_folder(tmp_path, {Finger("S01", "")})
    with pytest.raises(InputError, match="holds an earlier fit of S01 right_index, who are not"):
        check_folder(tmp_path, {Finger("S01", "right_thumb")})
    both = [*index, *(replace(p, index=p.index + 9, force=1.01 * p.force) for p in thumb)]
    pooled = fit_records(both, double.HereditaryModel(), replace(QUICK, pool=True, nuisances=False))
    assert any("fingers are pooled: right_index, right_thumb" in note for note in pooled.problems)
    write(pooled, tmp_path / "pooled")
    assert not list((tmp_path / "pooled").glob("subjects/*"))


@pytest.mark.parametrize(
    ("change", "name", "words"),
    [
        (lambda r: {"area_flags": r.area_flags | int(AreaFlag.SATURATED)}, "frames", "saturated"),
        (
            lambda r: {"area_stamp_ns": r.area_stamp_ns + 120_000_000},
            "lag of the areas",
            "behind the fitted model",
        ),
        (lambda r: {"force": r.force + 0.12}, "tare", "without contact"),
        (lambda r: {"area": r.area * (0.6 + 0.35 * r.index)}, "scatter between presses", "differ"),
        (lambda r: {"area": 2.5 * r.area}, "model against areas", "check the units"),
    ],
    ids=["saturated", "late", "tare", "scatter", "unit"],
)
def test_a_failing_check_is_named_and_keeps_a_fit_from_being_final(
    double: SimpleNamespace, presses: list[Any], change: Any, name: str, words: str
) -> None:
    result = fitted(double, [replace(p, **change(p)) for p in presses])
    status, detail = status_of(result, name)
    assert status == "fail" and words in detail
    (fit,) = result.fits.values()
    assert any(reason.startswith(f"data: {name}") for reason in fit.reasons)


def test_flags_of_frames_after_the_loading_are_not_those_of_equal_areas_within(
    double: SimpleNamespace,
) -> None:
    """Areas rounded to 1 mm² come again while the finger is lifted, saturated there alone."""
    records = []
    for index in range(4):
        record = double.make_record(index, 0.8 + 0.4 * index, 0.3e-6, release=3.0)
        lifted = record.area_stamp_ns > record.stamp_ns[int(np.argmax(record.force))]
        flags = record.area_flags | np.where(lifted, int(AreaFlag.SATURATED), 0)
        records.append(replace(record, area=np.round(record.area, 6), area_flags=flags))
    result = fitted(double, records)
    assert status_of(result, "frames")[0] == "ok"
    assert [t.saturated for t in result.fits["natural"].quality.trials] == [0] * 4


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda force, ramp: force**0.1, r"depend on the force, by . ?\d"),
        (lambda force, ramp: ramp**0.1, r"slow presses have \+\d"),
    ],
    ids=["force", "duration"],
)
def test_areas_that_follow_another_law_are_noted(
    double: SimpleNamespace, change: Any, words: str
) -> None:
    """Presses of a finger whose areas depend on force or speed otherwise than the model's."""
    records = []
    for index, ramp in enumerate(np.tile([0.5, 0.7, 1.0, 1.4, 2.0], 2)):
        record = double.make_record(index, ramp, 0.5e-6)
        force = np.interp(record.area_stamp_ns, record.stamp_ns, record.force)
        factor = change(np.maximum(force, 0.05), ramp)
        records.append(replace(record, area=record.area * factor))
    box = ["E0=115kPa:125kPa", "E1=24kPa:26kPa", "E2=1400kPa:1600kPa", "tau1=0.19:0.21"]
    narrow = replace(QUICK, bounds=box, nuisances=False)
    status, detail = status_of(fitted(double, records, narrow), "model against areas")
    assert status == "note" and re.search(words, detail), detail
    assert "another law" in detail


def test_a_fit_on_bounds_that_stays_behind_the_power_law_is_not_final(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    """Areas too large, with parameters on bounds: another finger than the model's."""
    large = [replace(p, area=1.4 * p.area) for p in presses]
    box = ["E0=115kPa:150kPa", "E1=24kPa:30kPa", "E2=1400kPa:1600kPa"]
    narrow = replace(QUICK, bounds=box, nuisances=False)
    fit = fitted(double, large, narrow).fits["natural"]
    (check,) = [c for c in fit.quality.checks if c.name == "model against areas"]
    assert fit.cost > 1.5 * fit.power_law.cost and check.status == "fail", check
    assert re.search("J is .* of the power law, with E₀, E₁.* on bounds", check.detail)
    assert fit.status == "not final"
    assert fit.reasons[-1] == "it was not checked against the full-order model"
    right = fitted(double, presses, narrow).fits["natural"]
    assert right.status == "not checked" and not right.reasons


def test_a_fit_with_the_default_finger_is_told_to_give_lengths(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    model = double.HereditaryModel()
    model.geometry = Geometry()
    large = [replace(p, area=1.4 * p.area) for p in presses]
    box = ["E0=115kPa:150kPa", "E1=24kPa:30kPa", "E2=1400kPa:1600kPa"]
    options = replace(QUICK, bounds=box, nuisances=False)
    result = fit_records(large, model, options)
    assert (
        "give the finger's lengths with --geometry" in status_of(result, "model against areas")[1]
    )


def test_frames_without_an_area_are_counted_and_many_fail(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    """Zeros between the areas of a slower camera."""
    sparse = []
    for press in presses:
        stamps = np.arange(press.area_stamp_ns[0], press.area_stamp_ns[-1], 10**7)
        area = np.zeros(len(stamps))
        rows = np.searchsorted(stamps, press.area_stamp_ns[:-1])
        area[rows] = press.area[:-1]
        few = {"area_sd": np.full(len(area), np.nan), "area_flags": np.where(area > 0, 0, 1)}
        sparse.append(replace(press, area_stamp_ns=stamps, area=area, **few))
    result = fitted(double, sparse)
    trials = result.fits["natural"].problem.trials
    dropped, used = sum(t.dropped for t in trials), sum(len(t.area) for t in trials)
    status, detail = status_of(result, "frames")
    assert dropped > used and status == "fail"
    assert f"of {used + dropped} frames {dropped} without a measurable contact" in detail


def test_a_press_whose_frames_have_no_weight_hides_no_scatter(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    """All of it lies below the low force; the gains of the others are judged."""
    light = double.make_record(9, 3.0, 0.3e-6, peak=0.19)
    light.target_force = 0.17
    others = [replace(r, area=r.area * gain) for r, gain in zip(presses, (0.5, 1.0, 1.0, 2.0))]
    for record in others:
        record.target_force = 1.35
    options = replace(QUICK, low_force_weight=0.0, target_force=0.0, nuisances=False)
    result = fitted(double, [*others, light], options)
    status, detail = status_of(result, "scatter between presses")
    assert status == "fail" and "nan" not in detail
    assert "nan" not in status_of(result, "model against areas")[1]
    (fit,) = result.fits.values()
    assert [np.isnan(t.gain) for t in fit.quality.trials] == [False] * 4 + [True]


def test_lists_that_are_cut_say_how_many_more_there_are(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    for index, press in enumerate(presses):
        press.doubts = (f"bag {index}: stamps run back",)
    try:
        _, detail = status_of(fitted(double, presses), "stamps")
    finally:
        for press in presses:
            del press.doubts
    assert detail.endswith("bag 2: stamps run back; and 1 more")


def test_a_force_at_the_end_of_the_sensors_range_fails(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    rng = np.random.default_rng(0)
    noisy = [replace(r, force=r.force + rng.normal(0.0, 2e-3, len(r.force))) for r in presses]
    assert status_of(fitted(double, noisy), "saturation")[0] == "ok"
    cut = [replace(r, force=np.minimum(r.force, 1.38)) for r in noisy]
    status, text = status_of(fitted(double, cut), "saturation")
    assert status == "fail" and "stays at 1.38 N" in text and "3 of 4 presses" in text, (
        "the fastest is there for 0.09 s"
    )
    # Rounded to 0.02 N, equal ones are usual.
    coarse = [replace(r, force=np.round(r.force / 0.02) * 0.02) for r in cut]
    assert status_of(fitted(double, coarse), "saturation")[0] != "fail"
    # Force control without noise, and a quiet hold with a sensor of 1/171 N.
    held = [replace(r, force=np.minimum(r.force, 1.38)) for r in presses]
    assert status_of(fitted(double, held), "saturation")[0] == "note"
    steps = [
        replace(r, force=np.round((r.force + rng.normal(0.0, 3e-4, len(r.force))) * 171) / 171)
        for r in held
    ]
    assert status_of(fitted(double, steps), "saturation")[0] == "note"


def test_areas_that_are_cut_off_fail(double: SimpleNamespace) -> None:
    """At the border of the image; not areas in steps, which are often equal."""
    presses = [
        double.make_record(i, 0.6 + 0.4 * i, 0.3e-6, release=1.5, frame_period=1 / 30)
        for i in range(4)
    ]
    assert status_of(fitted(double, presses), "saturation")[0] == "ok"
    cut = [replace(r, area=np.minimum(r.area, 0.9 * r.area.max())) for r in presses]
    status, text = status_of(fitted(double, cut), "saturation")
    assert status == "fail" and "areas stay at exactly" in text and "4 of 4 presses" in text
    steps = [replace(r, area=np.round(r.area / 5e-6) * 5e-6) for r in presses]
    assert status_of(fitted(double, steps), "saturation")[0] == "ok"


def test_frames_that_err_alike_are_noted(double: SimpleNamespace) -> None:
    rng = np.random.default_rng(0)
    presses = []
    for index in range(4):
        record = double.make_record(index, 0.8 + 0.4 * index, release=1.5, frame_period=1 / 30)
        errors = np.convolve(rng.normal(size=len(record.area) + 9), np.ones(10), "valid")
        area = np.where(record.area > 0, np.maximum(record.area + 0.5e-6 * errors, 1e-9), 0.0)
        presses.append(replace(record, area=area))
    options = replace(QUICK, window="contact")
    status, text = status_of(fitted(double, presses, options), "errors of the frames")
    assert status == "note" and "alike from frame to frame" in text


def test_the_loading_ends_at_the_largest_force(double: SimpleNamespace, presses: list[Any]) -> None:
    """Whatever frames count."""
    for window in ("loading", "contact"):
        result = fitted(double, presses, replace(QUICK, window=window))
        found = [row["loading_s"] for row in trial_rows(result)]
        assert found == pytest.approx([0.6 + 0.4 * i for i in range(4)], rel=0.2)


def test_stamps_that_ran_back_fail(double: SimpleNamespace, presses: list[Any]) -> None:
    for press in presses:
        press.doubts = ("bag: 3 stamps of wrench run back; they were put in order",)
    try:
        assert status_of(fitted(double, presses), "stamps")[0] == "fail"
    finally:
        for press in presses:
            del press.doubts


def test_moisture_off_the_scale_is_noted_and_left_out(
    double: SimpleNamespace, presses: list[Any], tmp_path: Path
) -> None:
    records = [replace(p, moisture_before=[1e9, 70.0]) for p in presses]
    result = fitted(double, records)
    assert "4 moisture readings lie off the scale" in result.problems[0]
    (fit,) = result.fits.values()
    assert fit.moisture[0] == pytest.approx(70.0)
    write(result, tmp_path)
    assert ParameterSets.load(tmp_path / "parameters.yaml").sets[0].moisture < 130.0


def test_presses_of_two_moistures_in_one_condition_are_noted(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    records = [
        replace(p, moisture_before=[40.0 + 65.0 * (p.index % 2) + p.index], moisture_after=[])
        for p in presses
    ]
    status, detail = status_of(fitted(double, records), "moisture")
    assert status == "note"
    for words in (
        "41 a.u. (natural_00 trial 0, natural_02 trial 2)",
        "107 a.u. (natural_01 trial 1, natural_03 trial 3)",
    ):
        assert words in detail, detail


def test_a_fit_that_fails_a_check_is_marked_and_is_no_subjects(
    double: SimpleNamespace, presses: list[Any], tmp_path: Path
) -> None:
    good = fitted(double, presses)
    write(good, tmp_path)
    sets = ParameterSets.load(subject_file(tmp_path / "subjects", "S01"))
    assert [s.status for s in sets.sets] == ["not checked"] and not sets.doubt()
    bad = fitted(double, [replace(p, area=2.5 * p.area) for p in presses])
    assert any("stays out of subjects/" in note for note in bad.problems)
    write(bad, tmp_path)
    assert not subject_file(tmp_path / "subjects", "S01").exists()
    sets = ParameterSets.load(tmp_path / "parameters.yaml")
    assert [s.status for s in sets.sets] == ["not final"]
    assert "parameters of natural are from a fit that is not final" in sets.doubt()


def test_a_subject_of_another_finger_is_served_beside_others(
    double: SimpleNamespace, presses: list[Any], tmp_path: Path
) -> None:
    """The model node has the default finger's model; the file says which one the fit had."""
    own = estimate_geometry(width=0.0204, depth=0.0132).geometry
    for geometry, held in ((own, own), (Geometry(), None)):
        model = double.HereditaryModel()
        model.geometry = geometry
        result = fit_records(presses, model, replace(QUICK, nuisances=False))
        result.sources = {"geometry_hash": geometry.hash()}
        write(result, tmp_path)
        sets = ParameterSets.load(subject_file(tmp_path / "subjects", "S01"))
        assert sets.geometry == held
        served = load_for(sets)
        assert served.geometry_hash == geometry.hash()
        check_sets(sets, served)


def test_conditions_without_moisture_get_files_that_the_model_node_can_use(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    records = [
        replace(p, condition=name, moisture_before=[], moisture_after=[], bag=f"{name}{p.index}",
                area=p.area * (1.0 + 0.01 * k))
        for k, name in enumerate(("dry", "natural", "moist"))
        for p in presses
    ]  # fmt: skip
    result = fitted(double, records)
    files = parameter_files(result)
    assert set(files) == {f"parameters_{c}.yaml" for c in ("dry", "natural", "moist")}
    assert all(len(sets.sets) == 1 for sets in files.values())
    assert any("parameter file of its own" in note for note in result.problems)


SPACE = StandardLinearSolid.PARAMETERS


def test_bounds_take_units() -> None:
    box = FitOptions(bounds=["E2=500kPa:3MPa", "tau1=10 ms:0.5 s"]).box(SPACE)
    assert box[SPACE.index("E2")].tolist() == [500e3, 3e6]
    assert box[SPACE.index("tau1")] == pytest.approx([0.01, 0.5])
    assert FitOptions(bounds=["E0=5e4:160e3"]).box(SPACE)[0].tolist() == [5e4, 160e3]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("E2=500:3000", r"'E2=500:3000': 500 to 3000 Pa lies outside.*'E2=500kPa:3000kPa'"),
        ("E9=1:2", r"'E9=1:2'.*one of E0, E1, tau1, E2"),
        ("E2=3MPa:500kPa", r"0 < LOW < HIGH"),
        ("E2=500:3MPa", r"one end has a unit"),
        ("E2=500s:3s", r"with units Pa, kPa, MPa, GPa"),
        ("E2=500kPa", r"LOW:HIGH"),
        ("tau1=10kPa:20kPa", r"with units s, ms"),
    ],
)
def test_bad_bounds_are_quoted_with_the_remedy(text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        FitOptions(bounds=[text]).box(SPACE)


def test_bounds_beyond_the_models_range_are_not_final(
    double: SimpleNamespace, presses: list[Any]
) -> None:
    result = fitted(double, presses, replace(QUICK, bounds=["E2=100kPa:3MPa"]))
    (fit,) = result.fits.values()
    assert any("the bounds of E2" in reason for reason in fit.reasons)
