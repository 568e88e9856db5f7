# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bags become trials: windows, normal force, areas, moisture, exclusions with reasons."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from session_bags import AREA_PER_FORCE, START, image, press_force, wrench, write_session

from finger_bag.cdr_layout import stamps_and_wrenches
from finger_bag.definitions import encode
from finger_bag.mapping import TopicMapping
from finger_bag.read_settings import ReadSettings
from finger_bag.reader import open_bag
from finger_bag.streams import read_streams
from finger_bag.validate import validate
from finger_bag.writer import BagWriter
from finger_common.axes import lateral_force, normal_force
from finger_common.errors import InputError
from finger_common.mono8 import as_mono8
from finger_common.trial_phases import TrialPhase
from finger_common.units import FORCE_UNITS
from finger_offline.lag import force_image_lag
from finger_offline.process import process
from finger_offline.process_options import ProcessOptions
from finger_offline.trial_split import TrialSettings
from finger_offline.trials import load_trials, streams_with_areas
from finger_offline.unloaded import moved_plate
from finger_vision.messages import image_of


@pytest.mark.parametrize("messages", [True, False], ids=["trial messages", "force alone"])
def test_trials_are_found_with_force_areas_and_moisture(
    session: Callable[..., Path], messages: bool
) -> None:
    found = load_trials(session(trials=3, messages=messages))
    assert [t.index for t in found] == [0, 1, 2]
    assert found.exclusions == [] and found.problems == []
    for index, trial in enumerate(found):
        assert (trial.subject, trial.condition, trial.session) == ("S01", "natural", "one")
        assert trial.target_force == 1.35
        time = (trial.stamp_ns - START) * 1e-9 - 20 * index - 4
        assert np.allclose(trial.force, press_force(time), atol=1e-12)
        assert np.allclose(trial.lateral_force, 0.1 * trial.force, atol=1e-12)
        # Onset at 0.05 N of a ramp of 1.5 N/s that starts at 0.5 s; half a second is kept before.
        assert (trial.onset_ns - START) * 1e-9 - 20 * index - 4.5 == pytest.approx(0.034, abs=1e-3)
        assert time[0] == pytest.approx(0.034, abs=2e-3)
        area_time = (trial.area_stamp_ns - START) * 1e-9 - 20 * index - 4
        assert np.allclose(trial.area, AREA_PER_FORCE * press_force(area_time), atol=1e-12)
        assert np.allclose(trial.real_area, 0.4 * trial.area)
        assert np.all(np.diff(trial.stamp_ns) == 2_000_000)
        assert trial.moisture_before == [60.0, 61.0, 62.0]
        assert trial.moisture_after == [70.0, 71.0, 72.0]
        assert trial.moisture == 66.0


def test_a_bag_of_which_something_could_not_be_read_is_named(
    session: Callable[..., Path], tmp_path: Path
) -> None:
    path = session(trials=3)
    assert load_trials(path).lost == []
    (file,) = path.glob("*.mcap")
    content = bytearray(file.read_bytes())
    middle = content.index(b"\x04\x00\x00\x00zstd", len(content) // 2) + 100
    content[middle : middle + 100] = bytes(100)
    (tmp_path / "damaged.mcap").write_bytes(content)
    found = load_trials(tmp_path / "damaged.mcap")
    assert found.lost == [str(tmp_path / "damaged.mcap")] and len(found) > 0
    # What a killed recorder left is whole up to its end.
    (tmp_path / "cut.mcap").write_bytes(file.read_bytes()[: len(content) // 2])
    assert load_trials(tmp_path / "cut.mcap").lost == []


def test_failed_redone_and_touching_presses_are_excluded_with_reasons(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path, {"condition": "dry"}) as bag:
        for attempt, (phase, note) in enumerate([(7, "slipped"), (6, ""), (6, "")]):
            begin = START + attempt * 10_000_000_000
            trial = {"session": "s", "condition": "dry", "index": 4, "attempt": attempt}
            bag.write("trial", {"header": {"stamp": begin}, "phase": 3, **trial})
            for t in np.arange(0, 3.5, 0.002):
                stamp = begin + round(t * 1e9)
                force = float(press_force(np.array(t)))
                bag.write("wrench", wrench(stamp, force))
                if round(t * 500) % 50 == 0:
                    fields = {"header": {"stamp": stamp}, "gross_area": AREA_PER_FORCE * force}
                    bag.write("contact_area", fields)
            end = {"header": {"stamp": begin + 4_000_000_000}, "phase": phase, "note": note}
            bag.write("trial", {**end, **trial})
    found = load_trials(path)
    assert [t.attempt for t in found] == [2]
    reasons = [e.reason for e in found.exclusions]
    assert reasons == ["marked as failed: slipped", "attempt 1, done again"]

    light = write_session(tmp_path / "light", trials=1, messages=False, peak=0.1)
    assert load_trials(light).exclusions[0].reason.startswith("a touch of 0.10 N")
    wrong_sign = load_trials(light, TrialSettings(normal_axis="+z"))
    assert not wrong_sign.trials and "along +z" in wrong_sign.exclusions[0].reason


@pytest.mark.parametrize("ahead", [-3600.0, -5.0, 8.0, 3600.0])
@pytest.mark.parametrize("cue", [True, False], ids=["with the cue to lift", "without"])
def test_announcements_of_another_clock_are_named_where_no_press_is_found(
    tmp_path: Path, ahead: float, cue: bool
) -> None:
    """ahead: s of the clock of the announcements; only the cue to lift has the force's stamp."""
    path = tmp_path / "bag"
    with BagWriter(path, {"condition": "dry"}) as bag:
        for t in np.arange(0, 14.0, 0.002):
            stamp = START + round(t * 1e9)
            bag.write("wrench", wrench(stamp, float(press_force(np.array(t - 6.0)))))
            if round(t * 500) % 50 == 0:
                bag.write("contact_area", {"header": {"stamp": stamp}, "gross_area": 0.0})
        time = np.arange(0, 3.5, 0.002)
        off = 6.0 + time[press_force(time) > 0.03][-1]
        phases = [(TrialPhase.PRESS, 5.0 + ahead), (TrialPhase.MOISTURE_AFTER, off + 0.5 + ahead)]
        phases += [(TrialPhase.DONE, off + 2.0 + ahead)]
        phases += [(TrialPhase.LIFT, 7.5)] if cue else []
        for phase, t in phases:
            stamp = START + round(t * 1e9)
            trial = {"session": "s", "condition": "dry", "index": 4, "attempt": 0}
            bag.write("trial", {"header": {"stamp": stamp}, "phase": int(phase), **trial})
    (left_out,) = load_trials(path).exclusions
    words = left_out.reason.partition(": announcements and forces are ")
    assert words[0] == "no press"
    if cue or abs(ahead) > 14.0:
        apart = float(words[2].removesuffix(" s apart"))
        assert apart == pytest.approx(abs(ahead), abs=0.1 if cue else 15.0)
    else:
        assert words[2] == "", "a trial without a press, for all that is known"


def write_press(bag: BagWriter, begin: int) -> None:
    """Forces and areas of a press of 3.5 s."""
    for t in np.arange(0, 3.5, 0.002):
        stamp, force = begin + round(t * 1e9), float(press_force(np.array(t)))
        bag.write("wrench", wrench(stamp, force))
        if round(t * 500) % 50 == 0:
            fields = {"header": {"stamp": stamp}, "gross_area": AREA_PER_FORCE * force}
            bag.write("contact_area", fields)


def write_attempt(folder: Path, attempt: int, completed: bool) -> None:
    with BagWriter(folder / f"004_dry_{attempt}", {"condition": "dry"}) as bag:
        begin = START + attempt * 10_000_000_000
        trial = {"session": "s", "condition": "dry", "index": 4, "attempt": attempt}
        bag.write("trial", {"header": {"stamp": begin}, "phase": 3, **trial})
        write_press(bag, begin)
        if completed:
            end = {"header": {"stamp": begin + 4_000_000_000}, "phase": 6}
            bag.write("trial", {**end, **trial})


def test_an_attempt_that_was_not_completed_does_not_replace_one_that_was(tmp_path: Path) -> None:
    """Such as that of a crash, in a bag that nobody could mark."""
    for attempt, completed in enumerate([False, True, False]):
        write_attempt(tmp_path, attempt, completed)
    found = load_trials(tmp_path)
    assert [t.attempt for t in found] == [1]
    assert [e.reason for e in found.exclusions] == [
        "attempt 0, done again",
        "attempt 2, not completed, unlike another",
    ]
    # Where none was completed, the last one is all there is.
    shutil.rmtree(tmp_path / "004_dry_1")
    assert [t.attempt for t in load_trials(tmp_path)] == [2]


def test_a_trial_done_again_counts_once_also_in_another_folder_or_by_its_file(
    tmp_path: Path,
) -> None:
    """A disk that was full has the failed attempt, and another one the trial."""
    write_attempt(tmp_path / "full", 0, completed=False)
    write_attempt(tmp_path / "next", 1, completed=True)
    write_attempt(tmp_path / "next", 2, completed=True)
    assert [t.attempt for t in load_trials([tmp_path / "full", tmp_path / "next"])] == [2]
    files = sorted(tmp_path.rglob("*.mcap"))
    assert len(files) == 3 and [t.attempt for t in load_trials(files)] == [2]


@pytest.mark.parametrize(
    "abouts",
    [
        [{"condition": "dry"}, {"condition": "moist"}],
        [{"subject": "S01"}, {"subject": "S02"}],
        [{"header": {"frame_id": "right_index"}}, {"header": {"frame_id": "left_thumb"}}],
        [{}, {}],
    ],
    ids=["conditions", "subjects", "fingers", "an announcement after the verdict"],
)
def test_numbers_that_begin_again_within_one_bag_are_trials_of_their_own(
    tmp_path: Path, abouts: list[dict[str, Any]]
) -> None:
    """Such as bags joined into one, or a protocol that numbers the trials of each condition."""
    path = tmp_path / "bag"
    begins = [START + k * 10_000_000_000 for k in range(2 * len(abouts))]
    with BagWriter(path, {"session": "s", "condition": "dry", "subject": "S09"}) as bag:
        for number, begin in enumerate(begins):
            about = abouts[number // 2]
            trial = {"session": "s", "condition": "dry", "index": number % 2, **about}
            finger = about.get("header", {})
            for phase, after in ((TrialPhase.PRESS, 0), (TrialPhase.DONE, 4_000_000_000)):
                header = {**finger, "stamp": begin + after}
                bag.write("trial", {**trial, "header": header, "phase": int(phase)})
            write_press(bag, begin)
    found = load_trials(path)
    assert [t.index for t in found] == [0, 1, 0, 1] and not found.exclusions
    assert all(b < t.onset_ns < b + 1_000_000_000 for b, t in zip(begins, found))
    names = [(t.condition, t.subject, t.finger) for t in found]
    expected = [
        (
            a.get("condition", "dry"),
            a.get("subject", "S09"),
            a.get("header", {}).get("frame_id", ""),
        )
        for a in abouts
    ]
    assert names == [expected[0]] * 2 + [expected[1]] * 2
    said = {c.name: c.detail for c in validate(path).checks}["trials"]
    assert said == ("2 dry, 2 moist" if "condition" in abouts[0] else "4 dry")


def test_a_force_that_is_recorded_during_the_presses_alone_is_no_slow_one(tmp_path: Path) -> None:
    """Areas that do not follow it are told all the same."""
    with BagWriter(tmp_path / "bag", {"condition": "dry", "subject": "S01"}) as bag:
        for begin in range(START, START + 360 * 10**9, 60 * 10**9):
            for at in np.arange(0.0, 3.5, 0.002):
                force = wrench(begin + round(at * 1e9), float(press_force(np.array(at))))
                bag.write("wrench", force)
            for at in np.arange(0.0, 3.5, 0.05):
                header = {"stamp": begin + round(at * 1e9)}
                bag.write("contact_area", {"header": header, "gross_area": 1e-4})
    found = {check.name: check for check in validate(tmp_path / "bag").checks}
    said = found["sync of force and image"]
    assert said.status == "fail" and "frames between the presses" in said.detail, said


def test_a_damaged_bag_without_areas_is_not_hidden_by_others(tmp_path: Path) -> None:
    whole, damaged = write_session(tmp_path / "whole", trials=1), tmp_path / "damaged"
    with BagWriter(damaged, {"condition": "natural", "session": "s"}) as bag:
        bag.write("wrench", wrench(START, 0.0))
    # A part with the areas, which its metadata does not list.
    shutil.copy(next(Path(whole).glob("*.mcap")), damaged / "part2.mcap")
    found = load_trials([whole, damaged])
    assert len(found) == 1 and found.lost == [str(damaged)]
    assert any("part2.mcap" in problem for problem in found.problems), found.problems


def test_another_finger_does_not_do_a_trial_again(tmp_path: Path) -> None:
    for attempt, finger in enumerate(["right_index", "left_thumb"]):
        with BagWriter(tmp_path / finger, {"condition": "dry"}) as bag:
            begin = START + attempt * 10_000_000_000
            for phase, after in ((TrialPhase.PRESS, 0), (TrialPhase.DONE, 4_000_000_000)):
                header = {"stamp": begin + after, "frame_id": finger}
                trial = {"header": header, "session": "s", "index": 4, "attempt": attempt}
                bag.write("trial", {**trial, "phase": int(phase)})
            write_press(bag, begin)
    found = load_trials(tmp_path)
    assert {t.finger for t in found} == {"right_index", "left_thumb"} and not found.exclusions


def write_announced(path: Path, *trials: list[tuple[float, TrialPhase, dict[str, Any]]]) -> Path:
    """A bag with a press 2 s after the begin of each trial, every 10 s; a trial has announcements
    with their times (s) after its begin."""
    with BagWriter(path, {"session": "s", "subject": "S01"}) as bag:
        for number, announcements in enumerate(trials):
            begin = START + number * 10_000_000_000
            for after, phase, about in announcements:
                header = {"stamp": begin + round(after * 1e9), "frame_id": about.get("finger", "")}
                fields = {k: v for k, v in about.items() if k != "finger"}
                bag.write("trial", {"session": "s", **fields, "header": header, "phase": phase})
            write_press(bag, begin + 2_000_000_000)
    return path


@pytest.mark.parametrize(
    ("names", "later"),
    [
        ([{"condition": "dry"}, {"condition": "moist"}], {}),
        ([{"condition": "dry", "finger": "right"}] * 2, {"finger": "right_index"}),
        ([{"condition": "dry", "subject": "S01"}] * 2, {"subject": "S1"}),
    ],
    ids=["names in the cue to press alone", "another finger", "another subject"],
)
def test_a_verdict_belongs_to_its_press_whatever_it_names(
    tmp_path: Path, names: list[dict[str, Any]], later: dict[str, Any]
) -> None:
    """Also the pull: a failed press and a pull are no trials for the area."""
    path = write_announced(
        tmp_path / "bag",
        *(
            [
                (2.0, TrialPhase.PRESS, {**about, "index": index}),
                *([(4.0, TrialPhase.PULL, {**later, "index": index})] if index == 2 else []),
                (6.0, verdict, {**later, "index": index, "note": "slipped"}),
            ]
            for about in names
            for index, verdict in enumerate([TrialPhase.DONE, TrialPhase.FAILED, TrialPhase.DONE])
        ),
    )
    found = load_trials(path)
    kept = [(t.index, t.condition, t.subject, t.finger, t.completed) for t in found]
    assert kept == [
        (0, about["condition"], "S01", about.get("finger", ""), True) for about in names
    ]
    assert [e.index for e in found.exclusions] == [1, 2] * 2
    assert found.exclusions[0].reason == "marked as failed: slipped"
    assert len(found.pulls) == 2


def test_what_is_announced_after_a_verdict_is_of_the_next_trial(tmp_path: Path) -> None:
    """With its target; without a press it is no trial."""
    path = write_announced(
        tmp_path / "bag",
        *(
            [
                (0.0, first, {"condition": "dry", "target_force": force}),
                (2.0, TrialPhase.PRESS, {"target_force": force}),
                (6.0, TrialPhase.DONE, {"target_force": force}),
                (7.0, TrialPhase.PREPARE, {"target_force": 9.0}),
            ]
            for first, force in ((TrialPhase.PREPARE, 1.0), (TrialPhase.MOISTURE_BEFORE, 2.0))
        ),
    )
    found = load_trials(path)
    assert [(t.target_force, t.condition) for t in found] == [(1.0, "dry"), (2.0, "dry")]
    assert not found.exclusions


@pytest.mark.parametrize("bags", [1, 2])
@pytest.mark.parametrize(
    ("fingers", "kept"),
    [
        (["", "right_index"], ["right_index"]),
        (["right_index", ""], [""]),
        (["right_index", "left_thumb"], ["right_index", "left_thumb"]),
    ],
)
def test_an_attempt_without_a_finger_is_one_at_the_same_trial(
    tmp_path: Path, bags: int, fingers: list[str], kept: list[str]
) -> None:
    trials = [
        [
            (after, phase, {"condition": "dry", "attempt": attempt, "finger": finger})
            for after, phase in ((2.0, TrialPhase.PRESS), (6.0, TrialPhase.DONE))
        ]
        for attempt, finger in enumerate(fingers)
    ]
    for number in range(bags):
        write_announced(tmp_path / f"bag_{number}", *(trials if bags == 1 else [trials[number]]))
    found = load_trials(tmp_path)
    assert [t.finger for t in found] == kept
    again = ["attempt 0, done again"] if len(kept) == 1 else []
    assert [e.reason for e in found.exclusions] == again


def test_presses_that_nothing_announces_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path, {"condition": "dry"}) as bag:
        for number in range(3):
            begin = START + number * 10_000_000_000
            if number == 1:
                for phase, after in ((TrialPhase.PRESS, 0), (TrialPhase.DONE, 4_000_000_000)):
                    trial = {"header": {"stamp": begin + after}, "session": "s"}
                    bag.write("trial", {**trial, "phase": int(phase)})
            write_press(bag, begin)
        bag.write("wrench", wrench(begin + 5_000_000_000, 0.1))  # a touch
        bag.write("wrench", wrench(begin + 6_000_000_000, 0.0))
    found = load_trials(path)
    assert len(found) == 1
    words = "2 presses of 0.2 N or more belong to no announced trial"
    assert found.problems == [f"{path}: {words}"]
    said = {c.name: (c.status, c.detail) for c in validate(path).checks}["trials"]
    assert said == ("note", f"1 dry; {words}")


def test_a_trial_names_its_finger(tmp_path: Path) -> None:
    """By its messages, or else by the bag; a frame that is no finger's is left out."""
    for name, frame, noted, finger in (
        ("a", "right_index", "", "right_index"),
        ("b", "left_thumb", "index", "left_thumb"),
        ("c", "", "index", "index"),
        ("d", "map", "", ""),
    ):
        with BagWriter(tmp_path / name, {"condition": "dry", "finger": noted}) as bag:
            header = {"stamp": START, "frame_id": frame}
            bag.write("trial", {"header": header, "phase": 3, "session": name})
            write_press(bag, START)
        assert [t.finger for t in load_trials(tmp_path / name)] == [finger]


def test_presses_in_quick_succession_keep_nothing_of_one_another(tmp_path: Path) -> None:
    """Half a second is kept around a press, unless another one lies there."""
    with BagWriter(tmp_path / "bag", {"condition": "dry"}) as bag:
        for t in np.arange(0, 4 * 2.8, 0.002):
            stamp, force = START + round(t * 1e9), float(press_force(np.array(t % 2.8)))
            bag.write("wrench", wrench(stamp, force))
            if round(t * 500) % 50 == 0:
                fields = {"header": {"stamp": stamp}, "gross_area": AREA_PER_FORCE * force}
                bag.write("contact_area", fields)
    found = load_trials(tmp_path / "bag").trials
    assert len(found) == 4
    for before, trial in pairwise(found):
        assert trial.force[0] < 0.05 and before.force[-1] < 0.05
        assert trial.stamp_ns[0] >= before.liftoff_ns
        assert trial.area_stamp_ns[0] >= trial.stamp_ns[0]


def test_a_trial_has_the_force_before_it_of_the_same_finger(tmp_path: Path) -> None:
    """Tissue does not forget at once; thinned, from the beginning of the recording or the last
    press of another finger on."""
    fingers = ["right_index", "right_index", "right_thumb", "right_thumb"]
    with BagWriter(tmp_path / "bag", {"condition": "dry"}) as bag:
        for t in np.arange(0, 4 * 2.8, 0.002):
            stamp, force = START + round(t * 1e9), float(press_force(np.array(t % 2.8)))
            if round(t * 500) % 1400 == 0:
                index = round(t / 2.8)
                header = {"stamp": stamp, "frame_id": fingers[index]}
                about = {"header": header, "session": "a", "index": index}
                bag.write("trial", {**about, "phase": int(TrialPhase.PRESS)})
            bag.write("wrench", wrench(stamp, force))
            if round(t * 500) % 50 == 0:
                fields = {"header": {"stamp": stamp}, "gross_area": AREA_PER_FORCE * force}
                bag.write("contact_area", fields)
    found = load_trials(tmp_path / "bag").trials
    assert [t.finger for t in found] == fingers
    for trial in found:
        time = (trial.history_ns - START) * 1e-9
        if not len(time):
            continue
        assert trial.history_ns[-1] < trial.stamp_ns[0]
        assert np.allclose(np.diff(time), 0.05, atol=0.03)
        # A mean over the end of a press, which is sudden here, lies between.
        assert np.mean(np.abs(trial.history - press_force(time % 2.8)) < 0.01) > 0.9
    begins = [(t.history_ns[0] - START) * 1e-9 for t in found if len(t.history)]
    assert begins[:2] == pytest.approx([0.0, 0.0], abs=0.03)
    ends = (found[1].liftoff_ns - START) * 1e-9
    assert begins[2:] == pytest.approx([ends] * 2, abs=0.03)


def test_images_of_another_clock_are_stamped_when_they_were_recorded(tmp_path: Path) -> None:
    bag = write_session(tmp_path / "bag", trials=1, images=True)
    topics = {"image_raw": {"topic": "/finger/image_raw", "stamp": "log_time"}}
    mapping = TopicMapping.from_mapping({"topics": topics})
    with open_bag(bag) as reader:
        own, logged = (
            read_streams(reader, ReadSettings(mapping=m)) for m in (TopicMapping(), mapping)
        )
        area = 1e-8
        settings = TrialSettings(mapping=mapping, image_areas="always", area_per_pixel=area)
        measured = streams_with_areas(reader, settings)
    assert np.array_equal(logged.images["stamp_ns"], own.images["log_ns"])
    assert np.array_equal(logged.images["stamp_ns"], own.images["stamp_ns"] + 20_000_000)
    assert np.array_equal(measured.areas["stamp_ns"], logged.images["stamp_ns"])


def test_a_camera_that_fills_the_lower_bits_is_named(tmp_path: Path) -> None:
    pixels = np.full((96, 96), 900, "<u2")
    with BagWriter(tmp_path / "bag", {"condition": "dry"}) as bag:
        for t in np.arange(0, 3.5, 0.002):
            stamp = START + round(t * 1e9)
            bag.write("wrench", wrench(stamp, float(press_force(np.array(t)))))
            if round(t * 500) % 50 == 0:
                fields = {**image(stamp, 0.0), "encoding": "mono16", "step": 192}
                bag.write("image_raw", {**fields, "data": pixels.view(np.uint8).ravel()})
    found = load_trials(tmp_path / "bag", TrialSettings(area_per_pixel=1e-8))
    assert any("no pixel is brighter than 900" in text for text in found.problems)


def test_raw_and_compressed_images_are_the_same_ones(tmp_path: Path) -> None:
    write_session(tmp_path / "one", trials=1, images=True)
    with open_bag(tmp_path / "one") as reader, BagWriter(tmp_path / "two") as bag:
        for item in reader.messages():
            bag.write_raw(item.topic, item.raw, item.log_time_ns)
            if item.topic == "/finger/image_raw":
                header = {"stamp": item.log_time_ns}
                bag.write("image_raw/compressed", {"header": header, "format": "png"})
        wanted = read_streams(reader, ReadSettings()).images
    with open_bag(tmp_path / "two") as reader:
        assert np.array_equal(read_streams(reader, ReadSettings()).images, wanted)


def test_each_trial_in_a_bag_of_its_own_reads_like_one_session(tmp_path: Path) -> None:
    for condition in ("dry", "moist"):
        write_session(tmp_path / "study" / condition, trials=1, condition=condition)
    found = load_trials(tmp_path / "study")
    assert found.conditions == ["dry", "moist"] and len(found.of("moist")) == 1


def test_presses_have_hysteresis_and_merge_what_chatters() -> None:
    force = np.array([0, 0.04, 0.06, 0.04, 0.031, 0.02, 0.06, 1, 0.0, 0, 0, 0, 0.2, 0.2])
    stamp = np.arange(len(force)) * 10_000_000
    assert TrialSettings(merge_gap=0.0).presses(stamp, force) == [(2, 5), (6, 8), (12, 14)]
    assert TrialSettings(merge_gap=0.025).presses(stamp, force) == [(2, 8), (12, 14)]
    assert TrialSettings().presses(stamp, np.zeros_like(force)) == []


@pytest.mark.parametrize("axis", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_normal_axis(axis: str) -> None:
    force = np.array([[1.0, 2.0, 3.0]])
    normal, lateral = normal_force(force, axis), lateral_force(force, axis)
    value = force[0, "xyz".index(axis[1])]
    assert normal[0] == (value if axis[0] == "+" else -value)
    assert lateral[0] ** 2 + value**2 == pytest.approx(14.0)


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("frame", ["", "a", "abcd", "force_sensor_with_a_long_name"])
def test_bulk_decoding_equals_one_by_one(frame: str, big_endian: bool) -> None:
    from finger_bag.definitions import decoder, typestore

    decode = decoder("geometry_msgs/msg/WrenchStamped")
    raws = []
    for i in range(50):
        fields = wrench(START + i, 0.1 * i, 0.2)
        fields["header"]["frame_id"] = frame
        raw = encode("geometry_msgs/msg/WrenchStamped", fields)
        if big_endian:
            raw = bytes(
                typestore().serialize_cdr(
                    decode(raw), "geometry_msgs/msg/WrenchStamped", little_endian=False
                )
            )
        raws.append(raw)
    raws[7] = raws[7][:30]
    stamps, force, torque = stamps_and_wrenches(raws, decode)
    assert stamps[7] == -1 and np.isnan(force[7]).all()
    keep = np.arange(50) != 7
    assert np.array_equal(stamps[keep], START + np.arange(50)[keep])
    assert np.array_equal(force[keep, 2], -0.1 * np.arange(50)[keep])
    assert np.all(torque[keep, 0] == 0.001)


def test_bag_of_another_system_is_read_through_a_mapping(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path, namespace="") as bag:
        for i in range(1750):
            stamp = START + i * 2_000_000
            force = 1000 * float(press_force(np.array(i * 0.002)))  # mN, along +x
            fields = wrench(stamp, 0.0)
            fields["wrench"]["force"] = {"x": force}
            bag.write("/ft/data", fields, message_type="geometry_msgs/msg/WrenchStamped")
            if i % 50 == 0:
                area = {"data": force * 0.04}  # mm^2
                bag.write("/area", area, stamp, message_type="std_msgs/msg/Float64")
        bag.write("/skin", {"data": 55.0}, START, message_type="std_msgs/msg/Float64")
    mapping = TopicMapping.from_mapping(
        {
            "topics": {
                "wrench": {"topic": "/ft/data", "unit": "mN"},
                "contact_area": {
                    "topic": "/area",
                    "field": "data",
                    "unit": "mm2",
                    "stamp": "log_time",
                },
                "moisture": {"topic": "/skin", "field": "data", "stamp": "log_time"},
            },
            "normal_axis": "+x",
            "trial": {"condition": "natural", "target_force": 1.2},
        }
    )
    (trial,) = load_trials(path, TrialSettings(mapping=mapping))
    assert trial.peak_force == pytest.approx(1.5)
    assert trial.area.max() == pytest.approx(60e-6)
    assert (trial.condition, trial.target_force, trial.moisture) == ("natural", 1.2, 55.0)


def test_a_mapping_replaces_what_announcements_say(tmp_path: Path) -> None:
    """As for a session that was begun with the wrong subject or condition."""
    write_attempt(tmp_path, 0, completed=True)
    given = {"subject": "S07", "condition": "moist", "target_force": 1.2}
    mapping = TopicMapping.from_mapping({"trial": given})
    found = load_trials(tmp_path, TrialSettings(mapping=mapping))
    (trial,) = found
    assert "replaces the condition dry by moist" in " ".join(found.problems)
    assert (trial.subject, trial.condition, trial.target_force) == ("S07", "moist", 1.2)
    assert (trial.session, trial.index) == ("s", 4), "what the mapping does not name"


def test_a_mapping_knows_every_force_unit_of_the_sensors() -> None:
    for unit, factor in FORCE_UNITS.items():
        data = {"topics": {"wrench": {"topic": "/x", "unit": unit}}}
        assert TopicMapping.from_mapping(data).topic("wrench").scale == factor


@pytest.mark.parametrize(
    ("data", "word"),
    [
        ({"topic": {}}, "'topic'"),
        ({"normal_axis": "z"}, "normal_axis"),
        ({"topics": {"forces": "/x"}}, "'forces'"),
        ({"topics": {"wrench": {"topic": "/x", "unit": "Pa"}}}, "unit"),
        ({"topics": {"wrench": {"topic": "/x", "scale": 2}}}, "'scale'"),
        ({"topics": {"moisture": {"topic": "/x", "stamp": "now"}}}, "stamp"),
        ({"topics": {"trial": {"topic": "/x", "stamp": "log_time"}}}, "needs its own stamps"),
        ({"topics": {"indentation": {"topic": "/x", "sign": ["negative"]}}}, "choose positive"),
        ({"topics": {"wrench": {"topic": "/x", "time_offset": 1}}}, "'time_offset', which is for"),
        ({"topics": {"image_raw": {"topic": "/x", "time_offset": "1 s"}}}, "seconds without a"),
        ({"topics": {"image_raw": {"topic": "/x", "time_offset": True}}}, "seconds without a"),
        ({"topics": [1]}, "'topics'"),
        ({"trial": {"subject": 8}}, r"trial\.subject is read as 8, no text; put it between"),
        ({"trial": {"condition": False}}, r"trial\.condition is read as False"),
    ],
)
def test_bad_mappings_are_refused(data: dict[str, Any], word: str) -> None:
    with pytest.raises(InputError, match=word):
        TopicMapping.from_mapping(data)


@pytest.mark.parametrize(("images", "late"), [(False, 0.4), (True, 0.4), (False, -0.3)])
def test_a_clock_that_differs_is_moved_by_a_mapping(
    tmp_path: Path, images: bool, late: float
) -> None:
    path = tmp_path / "bag"
    with BagWriter(path, {"condition": "dry", "subject": "S01"}) as bag:
        for t in np.arange(0, 4 * 4.0, 0.002):
            stamp = START + round(t * 1e9)
            bag.write("wrench", wrench(stamp, float(press_force(np.array(t % 4.0)))))
            if round(t * 500) % 50 == 0:
                area = 60e-6 * float(press_force(np.array((t - late) % 4.0))) ** 0.4
                if images:
                    bag.write("image_raw", image(stamp, area, 192, 0.1e-3))
                    continue
                fields = {"header": {"stamp": stamp}, "gross_area": area, "area_stddev": 1e-6}
                bag.write("contact_area", fields)
    name = "image_raw" if images else "contact_area"
    mapping = TopicMapping.from_mapping({"topics": {name: {"time_offset": -late}}})
    for read, lag in ((ReadSettings(), late), (ReadSettings(mapping), 0.0)):
        options = {"area_per_pixel": 1e-8} if images else {}
        trials = load_trials(path, TrialSettings(read.mapping, **options))
        assert force_image_lag(trials) == pytest.approx(lag, abs=0.04)
        checks = {c.name: c for c in validate(path, read).checks}
        assert checks[f"log time of {name}"].status == "ok"
        if not images:
            sync = checks["sync of force and image"]
            assert sync.status == ("fail" if lag else "ok")
            moved = re.search(r"move them by (\S+) s", sync.detail)
            assert float(moved[1] if moved else 0) == pytest.approx(-lag, abs=0.04)
        run = process(path, tmp_path / f"out{lag}", ProcessOptions(read.mapping, **options))
        assert ("MODEL_MISMATCH" in str(run.notes)) or not lag


def test_an_untared_force_of_another_lab_is_not_fit_for_use(tmp_path: Path) -> None:
    """From the first press on, or since one of them: the worst one counts."""
    for tare, since in ((0.0, 0.0), (0.5, 0.0), (-0.15, 16.0)):
        path = tmp_path / f"bag{tare}"
        with BagWriter(path, {"condition": "dry", "subject": "S01"}) as bag:
            for t in np.arange(0, 8 * 4.0, 0.002):
                stamp, force = START + round(t * 1e9), float(press_force(np.array(t % 4.0)))
                bag.write("wrench", wrench(stamp, force + (tare if t >= since else 0.0)))
                if round(t * 500) % 50 == 0:
                    area = 60e-6 * force**0.4
                    fields = {"header": {"stamp": stamp}, "gross_area": area}
                    bag.write("contact_area", fields)
        checks = {c.name: c for c in validate(path).checks}
        assert checks["tare"].status == ("fail" if tare else "ok")
        assert f"{tare:.2f} N while nothing touches the plate" in checks["tare"].detail


@pytest.mark.parametrize("value", [np.nan, -1e-5])
@pytest.mark.parametrize(("every", "flag", "status"), [(3, 0, "fail"), (8, 0, "note"), (3, 1, "")])
def test_areas_that_are_none_are_told(
    tmp_path: Path, value: float, every: int, flag: int, status: str
) -> None:
    """flag: 1, no contact, says why."""
    path = tmp_path / "bag"
    with BagWriter(path, {"condition": "dry", "subject": "S01"}) as bag:
        for row, t in enumerate(np.arange(0, 8.0, 0.002)):
            stamp, force = START + round(t * 1e9), float(press_force(np.array(t % 4.0)))
            bag.write("wrench", wrench(stamp, force))
            if row % 50 == 0:
                bad = row // 50 % every == 0
                fields = {"header": {"stamp": stamp}, "flags": flag * bad}
                area = value if bad else 60e-6 * force**0.4
                bag.write("contact_area", {**fields, "gross_area": area})
    result = validate(path)
    found = {c.name: c for c in result.checks}
    assert (found["areas"].status if "areas" in found else "") == status
    if status:
        counts = re.findall(r"trial \d: (\d+) of (\d+)", found["areas"].detail)
        assert len(counts) == 2
        assert all(int(a) / int(b) == pytest.approx(1 / every, abs=0.05) for a, b in counts)


@pytest.mark.parametrize("every", [50, 5])
def test_areas_that_are_published_again_are_told(tmp_path: Path, every: int) -> None:
    """every: rows of the force from message to message; the camera gives an area in 50."""
    path = tmp_path / "bag"
    rng = np.random.default_rng(0)
    with BagWriter(path, {"condition": "dry", "subject": "S01"}) as bag:
        for row, t in enumerate(np.arange(0, 8.0, 0.002)):
            stamp, force = START + round(t * 1e9), float(press_force(np.array(t % 4.0)))
            bag.write("wrench", wrench(stamp, force))
            if row % 50 == 0:
                area = 60e-6 * force**0.4 * rng.normal(1.0, 0.02)
            if row % every == 0:
                bag.write("contact_area", {"header": {"stamp": stamp}, "gross_area": area})
    areas = [c for c in validate(path).checks if c.name == "areas"]
    assert [c.status for c in areas] == (["note"] if every < 50 else [])
    assert every == 50 or "hold the one before" in areas[0].detail


MOVES: dict[str, tuple[Callable[[float], float], str, str]] = {
    "jump down between presses": (
        lambda t: -0.5 * (t >= 8.0),
        "from trial 2 on: the force jumps from 0.00 N to -0.50 N",
        "between 7.9 s and 8.1 s",
    ),
    "jump up in a press": (
        lambda t: 0.5 * (t >= 9.2),
        "from trial 2 on: the force jumps from 0.00 N to 0.50 N",
        "between 8.4 s and 11.1 s",
    ),
    "one press higher": (
        lambda t: 0.5 * (4.0 <= t < 8.0),
        "from trial 1 on: the force jumps from 0.00 N to 0.50 N",
        "between 3.9 s and 4.1 s",
    ),
    "the beginning lower": (
        lambda t: -0.5 * (t < 4.0),
        "from trial 1 on: the force jumps from -0.50 N to 0.00 N",
        "between 3.9 s and 4.1 s",
    ),
    "drift down": (lambda t: -0.03 * t, "the force drifts from -0.01 N to -0.47 N", "0.4 s and"),
    "drift up": (lambda t: 0.03 * t, "the force drifts from 0.01 N to 0.47 N", "0.4 s and"),
}


@pytest.mark.parametrize("move", MOVES)
def test_a_tare_that_moves_is_said_and_fails_nothing_else(tmp_path: Path, move: str) -> None:
    """A press whose zero has fallen by half a newton stays below its target on paper alone."""
    tare, words, times = MOVES[move]
    path = tmp_path / "bag"
    with BagWriter(path, {"condition": "dry", "subject": "S01"}) as bag:
        for t in np.arange(0, 16.0, 0.002):
            stamp, force = START + round(t * 1e9), float(press_force(np.array(t % 4.0)))
            bag.write("wrench", wrench(stamp, force + tare(t) + 0.002 * np.sin(60.0 * t)))
            if round(t * 500) % 50 == 0:
                fields = {"header": {"stamp": stamp}, "gross_area": 60e-6 * force**0.4}
                bag.write("contact_area", fields)
    checks = {c.name: c for c in validate(path).checks}
    assert words in checks["tare"].detail and times in checks["tare"].detail
    assert "tare, and record these presses again" in checks["tare"].detail
    failed = {n for n, c in checks.items() if c.status == "fail"}
    assert failed == {"tare"}
    assert any("while nothing touches the plate" in p for p in load_trials(path).problems)


def test_a_hold_that_the_camera_misses_is_no_tare() -> None:
    """A camera that sees nothing, or whose clock is wrong, makes no rest of a finger."""
    time = np.arange(0.0, 12.0, 0.002)
    force = press_force(time % 4.0) + 0.6 * np.exp(-(((time % 4.0) - 1.5) ** 2) / 0.01)
    frames = np.arange(0.0, 12.0, 0.1)
    touching = press_force(frames % 4.0) > 0.0
    for seen in (np.zeros_like(touching), np.roll(touching, 20)):
        assert moved_plate(time, force, frames[seen], frames[~seen]) is None
    assert moved_plate(time[:400], force[:400], frames[:8], frames[:0]) is None
    moved = moved_plate(time, force + 0.5 * (time > 5.5), frames[touching], frames[~touching])
    assert moved is not None and moved.force == pytest.approx(0.5, abs=0.01)


def guided_trial(path: Path, untared: float, pulled: bool = False) -> Path:
    """A bag whose force was tared (N before) 2 s before the cue to press."""
    about = {"session": "s", "subject": "S01", "condition": "dry", "target_force": 1.35}
    phases = [(TrialPhase.PRESS, 4.0), (TrialPhase.LIFT, 6.0), (TrialPhase.DONE, 7.4)]
    if pulled:
        phases.insert(1, (TrialPhase.PULL, 5.5))
    with BagWriter(path, {"condition": "dry", "subject": "S01"}) as bag:
        for phase, at in phases:
            header = {"header": {"stamp": START + round(at * 1e9)}}
            bag.write("trial", {**header, "phase": int(phase), **about})
        for t in np.arange(0, 7.5, 0.002):
            stamp, force = START + round(t * 1e9), float(press_force(np.array(t - 4.0)))
            force += 0.002 * np.sin(60.0 * t)
            bag.write("wrench", wrench(stamp, force + (untared if t < 2.0 else 0.0)))
            if round(t * 500) % 50 == 0:
                area = 60e-6 * max(force, 0.0) ** 0.4 if force > 0.01 else 0.0
                fields = {"header": {"stamp": stamp}, "gross_area": area}
                bag.write("contact_area", fields)
    return path


@pytest.mark.parametrize("pulled", [False, True])
@pytest.mark.parametrize("untared", [0.5, 0.12, -0.4])
def test_a_tare_within_a_bag_is_judged_beside_the_press(
    tmp_path: Path, untared: float, pulled: bool
) -> None:
    """As a fit takes it off; the plate was never loaded by the mean of before and after."""
    result = validate(guided_trial(tmp_path / "bag", untared, pulled))
    (tare,) = (c for c in result.checks if c.name == "tare")
    assert tare.status == "ok" and "0.00 N while nothing touches the plate" in tare.detail


def test_a_bag_of_pulls_is_fit_for_the_friction(tmp_path: Path) -> None:
    result = validate(guided_trial(tmp_path / "bag", 0.0, pulled=True))
    (trials,) = (c for c in result.checks if c.name == "trials")
    assert result.fit and trials.status == "note"
    assert "1 pull: fit for the friction (process --slip), not for the area" in trials.detail
    assert "left out" not in trials.detail


def test_what_is_missing_is_named_with_the_remedy(tmp_path: Path) -> None:
    def bag(name: str, *topics: str) -> Path:
        with BagWriter(tmp_path / name) as writer:
            for topic in topics:
                writer.write(topic, {"header": {"stamp": START}})
        return tmp_path / name

    with pytest.raises(InputError, match=r"nowhere.*no such bag"):
        load_trials(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"holds no message"):
        load_trials(bag("empty"))
    with pytest.raises(InputError, match=r"'wrench'.*missing.*/finger/wrench_raw.*mapping file"):
        load_trials(bag("raw", "wrench_raw", "contact_area"))
    with pytest.raises(InputError, match=r"'contact_area'.*missing"):
        load_trials(bag("force", "wrench"))
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"no bag in this folder"):
        load_trials(tmp_path / "folder")
    (tmp_path / "empty.mcap").write_bytes(b"")
    with pytest.raises(InputError, match=r"file is empty"):
        load_trials(tmp_path / "empty.mcap")


def test_another_type_under_a_known_name_is_named(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for i in range(10):
            stamp = START + i
            bag.write("contact_area", {"header": {"stamp": stamp}})
            bag.write("wrench", {"data": 1.0}, stamp, message_type="std_msgs/msg/Float64")
    with pytest.raises(InputError, match=r"std_msgs/msg/Float64.*WrenchStamped"):
        load_trials(tmp_path / "bag")


def test_two_rigs_in_one_bag_need_a_choice(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for name in ("/left/wrench", "/right/wrench"):
            bag.write(name, wrench(START, 1.0))
    with pytest.raises(InputError, match=r"/left/wrench, /right/wrench"):
        load_trials(tmp_path / "bag")


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_compressed_colour_is_the_grey_of_its_light(channel: int) -> None:
    """As the sensor makes of a raw picture: a plate lit in blue is not black."""
    ramp = np.add.outer(np.arange(40), np.arange(60)).astype(np.uint8)
    picture = np.zeros((40, 60, 3), np.uint8)
    picture[:, :, channel] = ramp
    data = cv2.imencode(".png", picture)[1].tobytes()
    message = SimpleNamespace(format="bgr8; png compressed", data=data)
    assert np.array_equal(as_mono8(image_of(message)), ramp)
