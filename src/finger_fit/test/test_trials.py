# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which frames count, which trials do not, and how they are grouped."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from finger_bag.writer import BagWriter
from finger_common.errors import InputError
from finger_fit import Trial, fit
from finger_fit.options import FitOptions
from finger_fit.problem import TrialRejected, material_of, prepare, prepare_all, trial_outputs
from finger_fit.problem.moisture import best_division, moisture_clusters
from finger_fit.study import fit_bags, group_trials
from finger_fit.study.bags import load, reading
from finger_fit.study.grouping import cluster_names
from finger_model.finger import load_areas
from finger_model.laws import StandardLinearSolid, law_of
from finger_offline.trials import load_trials
from finger_operator.protocol import Protocol
from finger_operator.study_plan import StudyPlan


def test_frames_count_from_onset_to_the_first_at_or_after_the_target(double) -> None:
    record = double.make_record(ramp=1.0)
    trial = prepare(record, FitOptions())
    force = trial.frame_force
    assert force[0] >= 0.05
    assert (force[:-1] < 1.35).all() and force[-1] >= 1.35
    times = (record.area_stamp_ns - record.stamp_ns[0]) * 1e-9
    onset, target = 0.4 + 0.05 / 1.35, 0.4 + 1.0
    expected = times[(times >= onset) & (times < target)]
    assert len(force) == len(expected) + 1


def write_attempt(bag: BagWriter, attempt: int, phases: tuple[tuple[int, int], ...]) -> None:
    """A press of the trial 0 of a session; phases: (phase, s of the bag)."""
    about = {"session": "s", "condition": "dry", "attempt": attempt}
    begin = (1000 + 100 * attempt) * 10**9
    for phase, at in phases:
        bag.write("trial", {"header": {"stamp": begin + at * 10**9}, "phase": phase, **about})
    for k in range(1500):
        force = 1.5 * min(max(k / 500 - 0.5, 0.0), max(2.5 - k / 500, 0.0), 1.0)
        header = {"header": {"stamp": begin + k * 2_000_000}}
        bag.write("wrench", {**header, "wrench": {"force": {"z": -force}}})
        if k % 50 == 0:
            bag.write("contact_area", {**header, "gross_area": 4e-5 * force})


def test_a_bag_without_areas_is_left_out_beside_one_with_them(tmp_path) -> None:
    done = ((3, 0), (6, 4))
    for name, condition in (("t5", "dry"), ("t6", "dry")):
        with BagWriter(tmp_path / name, {"condition": condition, "subject": "S01"}) as bag:
            if name == "t5":
                write_attempt(bag, 0, done)
            else:
                bag.write("wrench", {"header": {"stamp": 10**12}})
    loaded = load([tmp_path], reading(FitOptions()))
    assert len(loaded.records) == 1
    (left_out,) = loaded.exclusions
    assert (left_out.label, left_out.condition, left_out.subject) == ("t6", "dry", "S01")
    assert left_out.reason.startswith("no contact areas or images were found; if a topic of ")
    read = load_trials(tmp_path)
    assert len(read) == 1 and [e.index for e in read.exclusions] == [None]
    for one in (load_trials, lambda path: load([path], reading(FitOptions()))):
        with pytest.raises(InputError, match=r"t6: topic 'contact_area' .*is missing"):
            one(tmp_path / "t6")


def test_a_trial_that_was_repeated_is_fitted_by_its_last_attempt(tmp_path) -> None:
    """Each attempt lies in a bag of its own, both done."""
    for attempt in (0, 1):
        with BagWriter(tmp_path / f"a{attempt}", {"condition": "dry"}) as bag:
            write_attempt(bag, attempt, phases=((3, 0), (6, 4)))
    found = load([tmp_path], reading(FitOptions(), area_per_pixel=1e-9))
    assert any("not used; measure the images again with --vision" in p for p in found.problems)
    assert [record.attempt for record in found.records] == [1]
    assert [e.reason for e in found.exclusions] == ["attempt 0, done again"]


def test_sessions_of_one_id_in_two_folders_are_both_fitted(tmp_path) -> None:
    """Two laboratories: what was done again in one of them says nothing of the other."""
    for folder, attempts in (("A", (0,)), ("B", (0, 1))):
        for attempt in attempts:
            with BagWriter(tmp_path / folder / f"a{attempt}", {"condition": "dry"}) as bag:
                write_attempt(bag, attempt, phases=((3, 0), (6, 4)))
    found = load([tmp_path], reading(FitOptions()))
    kept = [f"{Path(r.bag).parent.name} {r.attempt}" for r in found.records]
    assert kept == ["A 0", "B 1"] and len(found.exclusions) == 1
    (said,) = (p for p in found.problems if "session 's'" in p)
    assert "is in several folders" in said and str(tmp_path / "A") in said


def test_a_failed_attempt_on_another_disk_is_not_fitted(tmp_path) -> None:
    """The first disk was full; and one folder has two names."""
    (tmp_path / "B").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "B")
    for folder, attempt, end in (("A", 0, 7), ("B", 1, 6)):
        with BagWriter(tmp_path / folder / f"a{attempt}", {"condition": "dry"}) as bag:
            write_attempt(bag, attempt, phases=((3, 0), (end, 4)))
    with BagWriter(tmp_path / "B" / "a0", {"condition": "dry"}) as bag:
        write_attempt(bag, 0, phases=((3, 0), (6, 4)))
    parts = [tmp_path / "A", tmp_path / "B" / "a0", tmp_path / "link" / "a1"]
    found = load(parts, reading(FitOptions()))
    assert [record.attempt for record in found.records] == [1]
    assert not any("session" in problem for problem in found.problems)


def test_an_output_that_cannot_be_written_is_refused_before_bags_are_read(tmp_path) -> None:
    (tmp_path / "file").touch()
    for output in (tmp_path / "file" / "fit", tmp_path / "file"):
        with pytest.raises(InputError, match="nothing can be written there"):
            fit_bags([tmp_path / "no bag"], output=output)


def test_trials_that_the_end_of_a_bag_lacks_are_explained(tmp_path) -> None:
    """A computer that fails while it records leaves a bag that is cut off."""
    with BagWriter(tmp_path / "bag", {"condition": "dry"}) as bag:
        write_attempt(bag, 0, phases=((3, 0), (5, 4)))
    (file,) = (tmp_path / "bag").glob("*.mcap")
    whole = file.read_bytes()
    few = "condition 'dry' has 1 trial, 3 are needed"
    with pytest.raises(InputError) as found:
        fit_bags([tmp_path / "bag"])
    assert few in str(found.value) and "in the bags" not in str(found.value)
    for kept, why in ((0.95, few), (0.1, "holds neither 'wrench'")):
        file.write_bytes(whole[: int(kept * len(whole))])
        with pytest.raises(InputError) as found:
            fit_bags([tmp_path / "bag"])
        assert why in str(found.value)
        assert "cut off" in str(found.value) and "not closed by its recorder" in str(found.value)


def test_a_trial_that_a_crash_interrupted_is_not_fitted(tmp_path) -> None:
    """Its press is whole in its bag, and no later attempt is given."""
    plan = StudyPlan("S01", "s", conditions=("dry",), trials=1)
    protocol = Protocol(plan, tmp_path, lambda effect: None)
    protocol.start(1000 * 10**9)
    protocol.start(1000 * 10**9)
    with BagWriter(protocol.trials[0].attempts[0].bag, {"condition": "dry"}) as bag:
        write_attempt(bag, 0, phases=((3, 0), (5, 4)))
    settings = reading(FitOptions())
    assert len(load([tmp_path], settings).records) == 1
    again = Protocol.resume_from(tmp_path, lambda effect: None, 1100 * 10**9)
    again.recorder_stopped(True, "", 1101 * 10**9)
    found = load([tmp_path], settings)
    assert found.records == []
    (left_out,) = found.exclusions
    assert left_out.reason == "marked as failed: interrupted: the protocol ended during it"


def test_window_contact_continues_to_lift_off(double) -> None:
    record = double.make_record(ramp=1.0, release=0.5)
    loading = prepare(record, FitOptions())
    contact = prepare(record, FitOptions(window="contact"))
    assert len(contact.frames) > len(loading.frames)
    assert contact.frame_force[-1] < 1.0 < contact.frame_force.max()
    assert contact.frame_force[-1] >= 0.05


def test_drive_hits_every_frame_and_keeps_its_step(double) -> None:
    trial = prepare(double.make_record(), FitOptions(step=0.01))
    assert trial.force[0] == 0.0 and trial.time[0] == 0.0
    assert np.diff(trial.time).max() <= 0.01 + 1e-9
    assert np.diff(trial.time).min() > 0
    assert np.allclose(np.diff(trial.frame_time), 0.1, atol=1e-6)


def test_force_mode_paper_steps_at_frames_only(double) -> None:
    trial = prepare(double.make_record(), FitOptions(force="paper"))
    assert len(trial.time) <= len(trial.frames) + 2
    assert np.median(np.diff(trial.time)) == pytest.approx(0.1, abs=1e-6)


def test_tremor_passes_in_mode_full_and_not_in_mode_paper(double) -> None:
    record = double.make_record(ramp=2.0)
    time = (record.stamp_ns - record.stamp_ns[0]) * 1e-9
    pressing = record.force > 0.2
    tremor = 0.05 * np.sin(2 * np.pi * 9.0 * time) * pressing
    shaken = replace(record, force=record.force + tremor)

    def ripple(mode: str) -> float:
        plain = prepare(record, FitOptions(force=mode))
        rough = prepare(shaken, FitOptions(force=mode))
        inside = (plain.time > 0.5) & (plain.time < 1.5)
        instants = plain.time[inside]
        return float(np.ptp(np.interp(instants, rough.time, rough.force) - plain.force[inside]))

    assert ripple("full") > 0.08
    assert ripple("paper") < 0.02


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: replace(r, force=r.force * 0.8), "below the target"),
        (lambda r: replace(r, area_flags=r.area_flags | 4), "image border"),
        (
            lambda r: replace(
                r,
                area_stamp_ns=np.delete(r.area_stamp_ns, 8),
                area=np.delete(r.area, 8),
                area_sd=np.delete(r.area_sd, 8),
                area_flags=np.delete(r.area_flags, 8),
            ),
            "dropped",
        ),
        (
            lambda r: replace(
                r,
                stamp_ns=np.delete(r.stamp_ns, slice(400, 450)),
                force=np.delete(r.force, slice(400, 450)),
            ),
            "samples are missing",
        ),
        (
            lambda r: replace(r, area_stamp_ns=r.area_stamp_ns[:0], area=r.area[:0]),
            "no contact area",
        ),
        (
            lambda r: replace(r, force=np.where(np.arange(len(r.force)) == 300, np.nan, r.force)),
            "not finite",
        ),
    ],
)
def test_unfit_trials_are_excluded_with_the_reason(double, change, words: str) -> None:
    good, bad = double.make_record(0), change(double.make_record(1))
    trials, exclusions = prepare_all([good, bad], FitOptions())
    assert [t.index for t in trials] == [0]
    assert len(exclusions) == 1 and words in exclusions[0].reason
    assert exclusions[0].label == "natural_01 trial 1"


def test_a_hole_in_the_force_of_a_slow_sensor_is_one_too(double) -> None:
    """100 Hz, of which the contact misses 0.15 s."""
    record = double.make_record(0)
    slow = replace(record, stamp_ns=record.stamp_ns[::5], force=record.force[::5])
    assert len(prepare(slow, FitOptions()).frame_force) > 3
    hole = slice(80, 94)
    holed = replace(
        slow, stamp_ns=np.delete(slow.stamp_ns, hole), force=np.delete(slow.force, hole)
    )
    with pytest.raises(TrialRejected, match=r"force samples are missing for 0\.15 s"):
        prepare(holed, FitOptions())


def test_moisture_is_needed_only_when_asked_for(double) -> None:
    record = replace(double.make_record(0), moisture_before=[], moisture_after=[])
    assert len(prepare_all([record], FitOptions())[0]) == 1
    _, exclusions = prepare_all([record], FitOptions(moisture_required=True))
    assert exclusions[0].reason == "no moisture reading"


def test_a_trial_ends_at_its_own_target_force_unless_another_is_set(double) -> None:
    record = double.make_record(0, peak=1.1)
    assert not prepare_all([record], FitOptions())[0], "the paper's target where none is known"
    record.target_force = 0.9
    own = prepare(record, FitOptions())
    assert 0.9 <= own.frame_force[-1] < 1.1
    lower = prepare(record, FitOptions(target_force=0.5))
    assert len(lower.area) < len(own.area)


def test_a_target_that_is_not_reached_is_explained(double) -> None:
    """A trial's own target may come from a spike; one that was set does not."""
    record = double.make_record()
    force = record.force.copy()
    force[len(force) // 2] = 6.0
    spiky = SimpleNamespace(**vars(record) | {"force": force, "target_force": 5.7})
    with pytest.raises(
        TrialRejected, match=r"of the trial itself, though samples go up to 6\.00 N"
    ):
        prepare(spiky, FitOptions())
    with pytest.raises(TrialRejected) as error:
        prepare(record, FitOptions(target_force=4.0))
    assert "itself" not in str(error.value)
    assert str(error.value).endswith("4 N; set target_force to what the presses reach")


def test_frames_without_contact_in_the_window_are_dropped_and_counted(double) -> None:
    record = double.make_record()
    first = np.flatnonzero(record.area > 0)[0]
    flags = record.area_flags.copy()
    flags[first : first + 2] = 1
    plain = prepare(record, FitOptions())
    trial = prepare(replace(record, area_flags=flags), FitOptions())
    assert trial.dropped + len(trial.frames) == len(plain.frames)
    assert trial.dropped >= 1


def test_an_area_of_zero_is_none_whether_or_not_it_is_flagged(double) -> None:
    record = double.make_record()
    first = np.flatnonzero(record.area > 0)[0]
    area = record.area.copy()
    area[first + 2] = 0.0
    record = replace(record, area=area)
    flagged = prepare(replace(record, area_flags=(area <= 0).astype(int)), FitOptions())
    plain = prepare(replace(record, area_flags=np.zeros(len(area), int)), FitOptions())
    assert plain.dropped == flagged.dropped > 0 and plain.rest == flagged.rest
    for name in ("area", "time", "force", "frames"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(flagged, name))


@pytest.mark.parametrize("target", [0.02, 60.0])
def test_a_target_that_cannot_end_a_loading_excludes_its_own_press_alone(
    double, target: float
) -> None:
    records = [double.make_record(0), double.make_record(1)]
    records[1].target_force = target
    trials, (exclusion,) = prepare_all(records, FitOptions())
    assert [t.index for t in trials] == [0]
    assert f"target of {target:g} N" in exclusion.reason and exclusion.subject == "S01"


def test_too_short_a_press_is_named(double) -> None:
    with pytest.raises(TrialRejected, match="frames in the contact"):
        prepare(double.make_record(ramp=0.05), FitOptions())


def test_a_trial_with_neither_condition_nor_moisture_is_named(double) -> None:
    trials = [prepare(double.make_record(i), FitOptions()) for i in range(6)]
    trials = [
        replace(t, condition="", moisture=40.0 + i if i else np.nan) for i, t in enumerate(trials)
    ]
    groups, notes = group_trials(trials, FitOptions(clusters=1))
    assert sum(map(len, groups.values())) == 5
    assert f"left out, with neither condition nor moisture: {trials[0].label}" in notes


def test_moisture_clusters_find_the_study_groups() -> None:
    rng = np.random.default_rng(3)
    truth = np.repeat([0, 1, 2], 15)
    moisture = rng.normal(np.array([37.56, 69.31, 105.33])[truth], np.array([3.3, 6.5, 4.9])[truth])
    order = rng.permutation(45)
    labels = moisture_clusters(moisture[order], 3)
    np.testing.assert_array_equal(labels, truth[order])


def test_moisture_clusters_are_the_exact_optimum() -> None:
    x = np.random.default_rng(5).uniform(0, 100, 9)
    labels = best_division(x, 3)

    def spread(cut_low: int, cut_high: int) -> float:
        s = np.sort(x)
        parts = (s[:cut_low], s[cut_low:cut_high], s[cut_high:])
        return sum(((p - p.mean()) ** 2).sum() for p in parts)

    best = min(spread(i, j) for i in range(1, 8) for j in range(i + 1, 9))
    found = sum(((x[labels == k] - x[labels == k].mean()) ** 2).sum() for k in range(3))
    assert found == pytest.approx(best)


def test_readings_of_one_condition_are_one_cluster() -> None:
    rng = np.random.default_rng(1)
    for readings in (
        np.full(6, 69.0),
        *(rng.normal(69.0, sd, 15) for sd in (2.0, 6.5) for _ in range(20)),
    ):
        assert not moisture_clusters(readings, 3).any()
    two = moisture_clusters(np.array([40.0, 41.0, 69.0, 69.0, 70.0]), 3)
    np.testing.assert_array_equal(two, [0, 0, 1, 1, 1])


def test_clusters_are_named_after_the_conditions_that_they_lie_near() -> None:
    assert cluster_names([40.0, 69.0, 95.0]) == ["dry", "natural", "moist"]
    assert cluster_names([70.0]) == ["natural"]
    assert cluster_names([5.0, 20.0, 38.0]) == ["moisture 1", "moisture 2", "moisture 3"]
    assert cluster_names([60.0, 75.0]) == ["moisture 1", "moisture 2"]


def test_trials_without_condition_are_grouped_by_moisture(double) -> None:
    records = []
    for k, level in enumerate((37.0, 69.0, 105.0)):
        for i in range(3):
            record = double.make_record(3 * k + i)
            records.append(
                replace(record, condition="", moisture_before=[level + i], moisture_after=[])
            )
    trials, _ = prepare_all(records, FitOptions())
    groups, notes = group_trials(trials, FitOptions())
    assert list(groups) == ["dry", "natural", "moist"]
    assert [len(g) for g in groups.values()] == [3, 3, 3]
    assert "moisture clusters" in notes[0]


def test_unknown_condition_is_refused_with_the_known_ones(double) -> None:
    trials, _ = prepare_all([double.make_record(i) for i in range(3)], FitOptions())
    with pytest.raises(InputError, match=r"'wet'.*natural"):
        group_trials(trials, FitOptions(), ["wet"])


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"bounds": ["E0=5:1"]}, "E0=5:1"),
        ({"bounds": ["E9=1:2"]}, "E0, E1, tau1, E2"),
        ({"bounds": ["E2=1MPa:2MPa", "E2=1MPa:3MPa"]}, "bounds: 'E2' is there twice; keep one"),
        ({"window": "all"}, "loading, contact"),
        ({"onset_force": 2.0}, "onset_force"),
        ({"grid": 1}, "2 … 20"),
    ],
)
def test_bad_options_are_refused_with_key_and_remedy(values, words: str) -> None:
    with pytest.raises(InputError) as error:
        FitOptions(**values).check_names(StandardLinearSolid.PARAMETERS)
    assert words in str(error.value)


def test_options_from_json_name_the_unknown_key() -> None:
    assert FitOptions.from_json('{"rounds": 7}').rounds == 7
    with pytest.raises(InputError, match="'round'"):
        FitOptions.from_json('{"round": 7}')
    with pytest.raises(InputError, match="JSON"):
        FitOptions.from_json("[1")


def presses(double: SimpleNamespace, rest: float, noise: float = 0.0) -> Trial:
    """Five presses of one force signal, with rests (s) between, areas of the stand-in."""
    rng = np.random.default_rng(0)
    corners, levels = [0.0, 0.5], [0.0, 0.0]
    for _ in range(5):
        corners += list(corners[-1] + np.cumsum([rng.uniform(0.4, 1.2), 0.1, rest]))
        levels += [1.5, 0.0, 0.0]
    time = np.arange(0.0, corners[-1] + 0.5, 0.002)
    force = np.interp(time, corners, levels)
    frames = np.arange(25, len(time), 50)
    (area,) = double.HereditaryModel().batch(double.TRUTH, [(time, force, frames)])
    touched = force[frames] > 0
    area = np.where(touched, np.maximum(area[0] + noise * rng.normal(size=len(frames)), 1e-9), 0.0)
    return Trial(time, force, area, time[frames], condition="dry", target_force=1.4)


def test_a_press_after_a_short_rest_remembers_the_presses_before(double: SimpleNamespace) -> None:
    """Tissue that has not recovered has a larger area. What is compared stays the same."""
    options, model = FitOptions(), double.HereditaryModel()
    memory = options.memory(model.space, StandardLinearSolid())
    assert memory == pytest.approx(5 * 0.8)

    def worst(trials: list[Any]) -> float:
        found = trial_outputs(model, double.TRUTH[None], trials)
        return max(float(np.abs(a[0] / t.area - 1.0).max()) for a, t in zip(found, trials))

    records = presses(double, 0.3).records(0, 0)
    known, excluded = prepare_all(records, options, memory)
    alone, _ = prepare_all(records, options)
    assert not excluded and len(known) == 5
    assert worst(known) < 0.02 and worst(alone) > 0.2
    for trial, other in zip(known, alone):
        assert np.array_equal(trial.time, other.time) and np.array_equal(trial.force, other.force)
        assert np.array_equal(trial.frames, other.frames)
        assert (len(trial.drive.before_time) > 0) == (trial.index > 0)
        assert len(trial.drive.before_time) <= 3 + memory / 0.05, "thinned"
    # What is over for long has no effect, and costs nothing.
    rested, _ = prepare_all(presses(double, memory + 0.1).records(0, 0), options, memory)
    assert not any(len(t.drive.before_time) for t in rested)
    separate = [replace(r, history_ns=r.history_ns[:0], history=r.history[:0]) for r in records]
    assert not any(len(t.drive.before_time) for t in prepare_all(separate, options, memory)[0])


@pytest.mark.slow
def test_tissue_of_branches_remembers_for_its_creep_time() -> None:
    """Of tissue that relaxes by 85 % in 2 s at constant strain, strain creeps for 13 s: 13.5 s of
    rest do not end it. Its area at the largest force would be 9 % larger after a rest of a day."""
    law = "generalized_maxwell_1"
    model = load_areas("", "", law)
    truth = law_of(law)(E0=100e3, fraction_1=0.85, tau_1=2.0, E2=1300e3).vector()
    time = np.arange(0.0, 5 * 24.5, 0.02)
    own = time % 24.5
    force = np.interp(own, [0.0, 1.0, 2.0, 11.0, 11.2], [0.0, 0.0, 1.2, 1.2, 0.0])
    frames = np.arange(10, len(time), 10)
    (area,) = model.batch(truth[None], [(time, force, frames)])
    areas = np.where(force[frames] > 0.0, np.maximum(area[0], 1e-9), 0.0)
    trial = Trial(time, force, areas, time[frames], condition="dry")
    options = FitOptions(window="contact", bounds=["tau_1=0.4s:2.6s"])
    memory = options.memory(model.space, material_of(model))
    assert memory == pytest.approx(5 * 2.6 / (1.0 - 0.9))

    def worst(memory: float) -> float:
        trials, excluded = prepare_all(trial.records(0, 0), options, memory)
        assert not excluded
        found = trial_outputs(model, truth[None], trials)
        return max(float(np.abs(a[0] / t.area - 1.0)[5:-5].max()) for a, t in zip(found, trials))

    assert worst(memory) < 0.02 < 0.05 < worst(5 * 2.6)
    quick = {"full_order": False, "bootstrap": 0, "bias_pairs": 0, "grid": 2, "rounds": 1}
    quick |= {"particles": 2, "polish": False, "nuisances": False, "profiles": False, "step": 0.1}
    result = fit(trial, law=law, window="contact", bounds=options.bounds, **quick)
    (note,) = [n for n in result.notes if "to recover" in n]
    assert "up to 130 s" in note and "known for 60 s: 2 presses" in note
    short = fit(trial, law=law, window="contact", bounds=["tau_1=0.4s:1.1s"], **quick)
    assert not any("to recover" in n for n in short.notes)


def test_presses_with_short_rests_give_the_moduli_of_the_finger(double: SimpleNamespace) -> None:
    quick = {"full_order": False, "bootstrap": 0, "bias_pairs": 0, "grid": 3, "rounds": 5}
    result = fit(presses(double, 0.2, 0.2e-6), model=double.HereditaryModel(), **quick)
    true = double.composite(double.TRUTH)
    low, high = result.data_intervals["composite_E"]
    assert low < true < high and high < 1.3 * low
    assert result.parameters["composite_E"] == pytest.approx(true, rel=0.05)
    # Clocks agree, which the areas of a finger at rest would not show.
    lags = np.array([t.lag for t in result.result.fits["dry"].quality.trials])
    assert np.nanmax(np.abs(lags)) < 0.02 and np.isfinite(lags).sum() > 2
