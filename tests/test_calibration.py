"""A subject is calibrated from nine presses: the finger's own prior, and what it is worth."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_common.guided_presses import CALIBRATION_PRESSES
from finger_common.trial_phases import TrialPhase
from finger_common.usable_press import TYPICAL_AREA_NOISE
from finger_model.anthropometry import GeometryEstimate, estimate_geometry
from finger_model.calibration import (
    STRUCTURE_SD,
    Calibration,
    CalibrationPress,
    Quantity,
    calibrate,
    on_level_plate,
    subject_model,
)
from finger_model.estimator import ContactEstimator
from finger_model.finger import load_for, load_reduced
from finger_model.geometry import Geometry
from finger_model.parameter_sets import ParameterSets
from finger_model.people import People, Person
from finger_model.pose.correction import PoseCorrection
from finger_model.pose.pose import Pose
from finger_model.reduced import ReducedModel
from finger_model.reduced.model import load_population
from finger_model.subject_calibration import PressCollector, keep_subject
from finger_model.subjects import find_subject, save_subject, subject_file
from finger_sim.press import guided_style, plan_press

START = 10**18
FRAME = 0.1


@dataclass(frozen=True, eq=False)
class Finger:
    """A finger of the population, its presses and their true areas on the grid of the force."""

    person: Person
    presses: list[CalibrationPress]
    truth: list[np.ndarray]


def pressed(index: int, seed: int = 11) -> Finger:
    """The guided presses twice: the second time they are for the test."""
    rng = np.random.default_rng([seed, index])
    people = People.default()
    person = people.draw(rng)
    model = load_population(person.geometry).for_material(person.material)
    constants = model.constants(person.material)
    state, at, before = model.state_at_rest(constants), 1.0, 0.0
    presses, truth = [], []
    for guided in CALIBRATION_PRESSES * 2:
        plan = plan_press(rng, style=guided_style(guided), target_force=guided.target_force)
        time = at + plan.time
        table = model.run(constants, state, time[::5], plan.force[::5], before)
        before, at = time[::5][-1], time[-1] + 2.0
        area = np.interp(time, time[::5], table[:, 0])
        area *= np.exp(people.press_gain * rng.normal())
        frames = np.arange(time[0] + FRAME * rng.random(), time[-1], FRAME)
        seen = np.interp(frames, time, area)
        frames, seen = frames[seen > 0], seen[seen > 0]
        measured = np.maximum(seen + TYPICAL_AREA_NOISE * rng.normal(size=len(seen)), 1e-7)
        columns = frames, measured, np.full(len(frames), TYPICAL_AREA_NOISE)
        presses.append(CalibrationPress(time, plan.force, *columns))
        truth.append(area)
    return Finger(person, presses, truth)


@functools.cache
def calibrated(finger: Finger) -> Calibration:
    presses = finger.presses[: len(CALIBRATION_PRESSES)]
    sets = ParameterSets.default()
    return calibrate(load_reduced(), sets, presses, finger.person.reading)


def force_only(finger: Finger, sets: ParameterSets) -> tuple[float, float]:
    """RMS over RMS of the area, without camera, in the presses after; and the 95 % coverage."""
    estimator = ContactEstimator(load_reduced(), sets)
    estimator.add_moisture(START - 10**9, finger.person.reading)
    error, truth, deviation = [], [], []
    number = len(CALIBRATION_PRESSES)
    for press, area in zip(finger.presses[number:], finger.truth[number:]):
        stamps = START + np.round(press.time * 1e9).astype(np.int64)
        forces = np.column_stack([0 * press.force, 0 * press.force, -press.force])
        block = estimator.add_wrenches(stamps, forces)
        use = block.column("in_contact") & (area > 0)
        error.append((block.column("area") - area)[use])
        truth.append(area[use])
        deviation.append(block.column("area_stddev")[use])
    errors, truths = np.concatenate(error), np.concatenate(truth)
    covered = np.abs(errors) <= 1.96 * np.concatenate(deviation)
    return float(np.sqrt(np.mean(errors**2) / np.mean(truths**2))), float(np.mean(covered))


@pytest.fixture(scope="module")
def script(module_of: Callable[[str], Any]) -> Any:
    return module_of("scripts/calibration_fingers.py")


@pytest.mark.slow
def test_calipers_help_where_the_finger_is_of_another_size(script: Any) -> None:
    """Fingertips 11 mm wide: the error of later presses without camera, their scatter left out."""
    errors: dict[bool, list[float]] = {False: [], True: []}
    for index in range(4):
        drawn = People.default().draw(np.random.default_rng([11, index]))
        finger = script.pressed(11, index, person=script.scaled(drawn, 0.011))
        for calipers, found in errors.items():
            found.append(script.scores(finger, calipers)[1])
    assert script.rms(errors[True]) < 0.85 * script.rms(errors[False]), errors


def test_the_file_of_a_subject_holds_the_lengths(fingers: list[Finger], tmp_path: Path) -> None:
    model, lengths = subject_model(load_reduced(), estimate_geometry(0.014, 0.010, age=70))
    presses = fingers[0].presses[: len(CALIBRATION_PRESSES)]
    found = calibrate(model, ParameterSets.default(), presses, lengths=lengths)
    assert "lengths from width 14 mm, depth 10 mm, age 70" in found.sentence()
    found.sets.save(tmp_path / "S01.yaml")
    sets = ParameterSets.load(tmp_path / "S01.yaml")
    assert sets.geometry == model.geometry and sets.hash == found.sets.hash
    # The model comes with the file.
    assert load_for(sets).hash == model.hash
    ContactEstimator(load_for(sets), sets)
    # Thinner by age.
    assert sets.geometry is not None
    assert 0.85 < sets.geometry.epidermis_thickness / Geometry().epidermis_thickness < 0.95
    # Lengths that are not known exactly make the tissue less certain, not the area.
    known = replace(lengths, deviations=dict.fromkeys(lengths.deviations, 1e-9))
    exact = calibrate(model, ParameterSets.default(), presses, lengths=known)
    for name, wider in (("area_at_1N", False), ("stiffness", True)):
        a, b = (next(q for q in c.quantities if q.name == name) for c in (found, exact))
        # Beside what the model leaves out of a finger, however well its lengths are known.
        common = STRUCTURE_SD[True].get(name, 0.0)
        a_sd, b_sd = (math.sqrt((q.deviation / q.value) ** 2 - common**2) for q in (a, b))
        assert (a_sd > 1.2 * b_sd) == wider and a.value == b.value
    text = (tmp_path / "S01.yaml").read_text().replace("nail_radius: 0.0", "nail_radius: 0.001")
    with pytest.raises(InputError, match="geometry_hash"):
        ParameterSets.parse(text)


@pytest.mark.parametrize(
    ("calipers", "said"),
    [(None, "without calipers"), (estimate_geometry(0.028, 0.02), "outside the population box")],
)
def test_without_calipers_that_serve_the_finger_in_use_is_taken(
    calipers: GeometryEstimate | None, said: str
) -> None:
    in_use = load_reduced()
    model, lengths = subject_model(in_use, calipers)
    assert model is in_use and said in lengths.note and not lengths.deviations


def test_a_pose_that_the_node_knows_does_not_count_twice(fingers: list[Finger]) -> None:
    """Areas of a pad in a pose give the finger that areas of a round pad on a level plate give."""
    finger, model = fingers[0], ReducedModel.load()
    skin = model.material.skin_ratio
    pose = PoseCorrection(model.geometry, Pose(1.3, 0.2), skin)
    assert math.exp(pose.log_area(50e-6)) > 1.1
    posed = [
        replace(press, area=np.array([a * math.exp(pose.log_area(a)) for a in press.area]))
        for press in finger.presses
    ]
    level = on_level_plate(posed, model, pose)
    sets = ParameterSets.default()
    found = calibrate(model, sets, level, finger.person.moisture).quantities[0]
    round_pad = calibrate(model, sets, finger.presses, finger.person.moisture).quantities[0]
    assert found.value == pytest.approx(round_pad.value, rel=0.005)
    for one, other in zip(level, finger.presses, strict=True):
        assert np.allclose(one.area, other.area, rtol=1e-4)
        assert np.all(one.area_sd < other.area_sd)


def test_parameters_of_a_fit_keep_their_finger_whatever_calipers_say(
    fingers: list[Finger],
) -> None:
    """`parameters.yaml` of a fit names the geometry that it was made with."""
    default = ParameterSets.default()
    fitted = ParameterSets(default.sets, Geometry().hash(), law=default.law, prior=default.prior)
    calipers = estimate_geometry(0.014, 0.010)
    model, lengths = subject_model(load_reduced(), calipers, fitted)
    presses = fingers[0].presses[: len(CALIBRATION_PRESSES)]
    found = calibrate(model, fitted, presses, lengths=lengths)
    assert "not used, the parameters in use are of one finger's lengths" in found.sentence()


@pytest.fixture(scope="module")
def fingers() -> list[Finger]:
    return [pressed(index) for index in range(5)]


def test_force_alone_is_enough_after_nine_presses(fingers: list[Finger]) -> None:
    before = [force_only(finger, ParameterSets.default())[0] for finger in fingers]
    after = [force_only(finger, calibrated(finger).sets) for finger in fingers]
    errors = [error for error, _ in after]
    assert np.median(errors) < 0.055, errors
    assert max(errors) < 0.08, errors
    assert np.median(before) > 2 * np.median(errors)
    assert np.mean([coverage for _, coverage in after]) > 0.9


def test_force_alone_is_as_certain_as_the_guided_presses_were_alike(
    fingers: list[Finger],
) -> None:
    """The deviation that is stated after a calibration is not twice that of the errors."""
    stated = []
    for finger in fingers[:2]:
        sets = calibrated(finger).sets
        assert sets.presses is not None and sets.presses.number == 9
        assert 0.01 <= sets.presses.sd < 0.08
        estimator = ContactEstimator(load_reduced(), sets)
        estimator.add_moisture(START - 10**9, finger.person.reading)
        # As strong as the guided ones: of harder ones less is known.
        later = finger.presses[len(CALIBRATION_PRESSES) :]
        press = next(p for p in later if 1.0 < p.force.max() < 1.4)
        stamps = START + np.round(press.time * 1e9).astype(np.int64)
        forces = np.column_stack([0 * press.force, 0 * press.force, -press.force])
        block = estimator.add_wrenches(stamps, forces)
        use = block.column("normal_force") > 0.3
        stated.append(np.median(block.column("area_stddev")[use] / block.column("area")[use]))
        assert stated[-1] < 2.0 * sets.presses.sd + 0.015
    assert np.median(stated) < 0.06


def test_its_numbers_are_those_of_the_finger(fingers: list[Finger]) -> None:
    """The area under 1 N after a second lies within its interval, the presses' scatter aside."""
    for finger in fingers:
        model = load_population(finger.person.geometry).for_material(finger.person.material)
        time = np.linspace(0.0, 1.0, 101)
        force = np.minimum(time / 0.2, 1.0)
        true = 1e6 * model.simulate(finger.person.material, time, force).area[-1]
        found = calibrated(finger)
        area = found.quantities[0]
        assert area.name == "area_at_1N" and area.unit == "mm²"
        assert abs(area.value - true) < 3.5 * np.hypot(area.deviation, 0.02 * true)
        assert 0.0 < found.press_scatter < 0.1
        assert found.presses == 9 and found.areas > 60
        assert "area under 1 N" in found.sentence()


@pytest.mark.slow
def test_its_factors_are_as_uncertain_as_fingers_differ_from_the_model(script: Any) -> None:
    """Drawn fingers stiffen, and have several branches and lengths of their own."""
    rows = [script.tissue_errors(script.pressed(11, index), False) for index in range(24)]
    for name in STRUCTURE_SD[False]:
        error, stated, _ = np.array([row[name] for row in rows]).T
        assert 0.7 < script.rms(error / stated) < 1.5, name


def test_a_factor_has_its_interval_in_the_logarithm() -> None:
    factor = Quantity("creep", 2.0, 2.0 * math.log(4.0), "", "creep ×")
    assert factor.text() == "creep × 2 (0.5 to 8)"
    assert Quantity("area_at_1N", 50.0, 0.6, "mm²", "area").text() == "area 50 ± 0.6 mm²"


def test_a_calibration_is_a_parameter_file(fingers: list[Finger], tmp_path: Path) -> None:
    found = calibrated(fingers[0])
    path = tmp_path / "S01.yaml"
    found.sets.save(path)
    again = ParameterSets.load(path)
    assert again.hash == found.sets.hash
    assert again.prior == found.sets.prior
    assert again.sets == ParameterSets.default().sets
    assert force_only(fingers[0], again) == force_only(fingers[0], found.sets)


def test_a_finger_is_known_better_than_before(fingers: list[Finger]) -> None:
    before = ParameterSets.default().prior
    after = calibrated(fingers[1]).sets.prior
    assert before is not None and after is not None
    variances = np.diag(after.covariance) / np.diag(before.covariance)
    # Gain and stiffness go together: less is known of each than of the area.
    assert variances.max() < 1.0 and variances[3] < 0.1


def test_too_few_areas_are_refused(fingers: list[Finger]) -> None:
    blind = [
        CalibrationPress(p.time, p.force, p.area_time[:1], p.area[:1], p.area_sd[:1])
        for p in fingers[0].presses[:9]
    ]
    with pytest.raises(InputError, match="0 of 9 presses have 2 usable areas"):
        calibrate(load_reduced(), ParameterSets.default(), blind)


def test_presses_of_several_fingers_are_refused(fingers: list[Finger]) -> None:
    factors = [0.5, 1.0, 2.0, 0.6, 1.5, 0.8, 0.5, 1.0, 2.0]
    mixed = [
        CalibrationPress(p.time, p.force, p.area_time, f * p.area, p.area_sd)
        for p, f in zip(fingers[0].presses, factors)
    ]
    with pytest.raises(InputError, match="same finger"):
        calibrate(load_reduced(), ParameterSets.default(), mixed)


def test_presses_that_may_be_of_two_fingers_are_questioned(fingers: list[Finger]) -> None:
    """Two fingers whose areas differ by a quarter pass for one whose presses scatter more."""
    finger = fingers[0]
    presses = finger.presses[: len(CALIBRATION_PRESSES)]
    mixed = [replace(p, area=(1.25 if i % 2 else 1.0) * p.area) for i, p in enumerate(presses)]
    sets, reading = ParameterSets.default(), finger.person.reading
    found = calibrate(load_reduced(), sets, mixed, reading)
    assert found.press_scatter > 0.08
    assert "the same finger each time?" in found.sentence()
    assert "each time?" not in calibrated(finger).sentence()


def test_without_a_reading_the_moisture_is_found_with_the_finger() -> None:
    """A dry finger without probe: what its moisture does is taken for the finger's own."""
    finger = pressed(3)
    presses = finger.presses[: len(CALIBRATION_PRESSES)]
    found = calibrate(load_reduced(), ParameterSets.default(), presses)
    estimator = ContactEstimator(load_reduced(), found.sets)
    press, area = finger.presses[9], finger.truth[9]
    stamps = START + np.round(press.time * 1e9).astype(np.int64)
    block = estimator.add_wrenches(
        stamps, np.column_stack([0 * press.force, 0 * press.force, -press.force])
    )
    use = press.force > 0.3
    assert np.allclose(block.column("area")[use], area[use], rtol=0.15)


def test_the_area_is_that_which_was_seen_whether_or_not_the_moisture_is_known(
    fingers: list[Finger],
) -> None:
    presses = fingers[0].presses[: len(CALIBRATION_PRESSES)]
    blind = calibrate(load_reduced(), ParameterSets.default(), presses).quantities[0]
    assert blind.value == pytest.approx(calibrated(fingers[0]).quantities[0].value, rel=0.03)


def collected(finger: Finger, failing: int = -1) -> tuple[PressCollector, list[bool]]:
    """The presses as live streams, with one attempt that fails first."""
    collector = PressCollector()
    answers = []
    for index, (guided, press) in enumerate(zip(CALIBRATION_PRESSES, finger.presses)):
        for attempt in range(2 if index == failing else 1):
            trial = "S01_a", guided.name, index, attempt
            for phase in (TrialPhase.PREPARE, TrialPhase.PRESS):
                collector.announce(*trial, phase)
            # A failed attempt is half as large: it must not be fitted.
            factor = 0.5 if index == failing and attempt == 0 else 1.0
            for time, force in zip(press.time, press.force):
                collector.add_force(START + round(time * 1e9), force)
            for time, area, sd in zip(press.area_time, press.area, press.area_sd):
                collector.add_area(START + round(time * 1e9), factor * area, sd, 0)
            collector.add_area(START + round(press.time[-1] * 1e9), 0.0, 1e-7, 1)
            collector.add_moisture(finger.person.reading)
            failed = factor < 1.0
            collector.announce(*trial, TrialPhase.FAILED if failed else TrialPhase.DONE)
            assert not collector.collecting
        answers.append(collector.announce("S01_a", guided.name, index, 0, TrialPhase.IDLE))
    return collector, answers


@pytest.mark.parametrize("failing", [-1, 2])
def test_presses_out_of_the_streams_are_the_presses(fingers: list[Finger], failing: int) -> None:
    collector, answers = collected(fingers[0], failing)
    assert answers == [False] * 8 + [True]
    last = CALIBRATION_PRESSES[-1].name
    assert not collector.announce("S01_a", last, 8, 0, TrialPhase.IDLE)  # once is enough
    sets = ParameterSets.default()
    found = calibrate(load_reduced(), sets, collector.presses(), collector.moisture())
    known, wanted = found.sets.prior, calibrated(fingers[0]).sets.prior
    assert known is not None and wanted is not None
    assert np.allclose(known.mean, wanted.mean, atol=0.1)
    assert found.areas == calibrated(fingers[0]).areas


def test_an_earlier_calibration_is_kept(fingers: list[Finger], tmp_path: Path) -> None:
    sets = ParameterSets.default()
    path = save_subject(tmp_path / "subjects", "S01", sets)
    assert path == subject_file(tmp_path / "subjects", "S01")
    save_subject(tmp_path / "subjects", "S01", calibrated(fingers[0]).sets)
    files = sorted((tmp_path / "subjects").iterdir())
    assert len(files) == 2 and files[1] == path
    assert ParameterSets.load(files[0]).hash == sets.hash
    assert ParameterSets.load(path).hash == calibrated(fingers[0]).sets.hash


def test_a_calibration_is_of_one_finger_of_the_subject(
    fingers: list[Finger], tmp_path: Path
) -> None:
    """Another finger's replaces nothing, and no session begins with it."""
    found = calibrated(fingers[0])
    assert find_subject(tmp_path, "S01", "right_index") == (None, "")
    for finger in ("index", "left_thumb"):
        assert keep_subject(str(tmp_path), "S01", finger, found, 1.0).kept
    assert sorted(p.name for p in tmp_path.iterdir()) == ["S01.index.yaml", "S01.left_thumb.yaml"]
    for finger, name, words in (
        ("index", "S01.index.yaml", ""),
        ("right_index", "S01.index.yaml", "no parameters of right_index; those of"),
        ("right_thumb", "", "right_thumb, only S01.index.yaml, S01.left_thumb.yaml; calibrate"),
        ("", "", "a finger that is not noted, only S01"),
    ):
        path, said = find_subject(tmp_path, "S01", finger)
        assert (path.name if path else "") == name and words in said and bool(words) == bool(said)
    # One of which no finger was noted, as from before fingers were, serves all others.
    save_subject(tmp_path, "S01", found.sets)
    path, said = find_subject(tmp_path, "S01")
    assert path == tmp_path / "S01.yaml" and "not S01.index.yaml, S01.left_thumb.yaml" in said
    path, said = find_subject(tmp_path, "S01", "right_thumb")
    assert path == tmp_path / "S01.yaml" and "no parameters of right_thumb; those of" in said


@pytest.mark.parametrize("code", ["", "../S01", "a b", "x" * 65])
def test_a_subject_that_is_no_file_name_is_refused(tmp_path: Path, code: str) -> None:
    with pytest.raises(InputError, match="is no code"):
        subject_file(tmp_path, code)
