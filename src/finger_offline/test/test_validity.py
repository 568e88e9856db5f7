# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A run says how far its estimates can be trusted."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from session_bags import START, press_force, wrench, write_session

from finger_bag.cli import command
from finger_bag.definitions import encode
from finger_bag.mapping import TopicMapping
from finger_bag.read_settings import ReadSettings
from finger_bag.reader import open_bag
from finger_bag.validate import validate
from finger_bag.writer import BagWriter
from finger_common.errors import InputError
from finger_model.estimator import EstimateBlock
from finger_model.reduced import ReducedModel
from finger_offline.process import process
from finger_offline.process_options import ProcessOptions


def recorded(path: Path, lag: float = 0.0, tare: float = 0.0, sd: float = 1.5e-6) -> Path:
    """Four presses of the model's finger, with areas at 15 Hz that come late."""
    time, frames = np.arange(0.0, 14.0, 0.002), np.arange(0.0, 14.0, 1 / 15)
    force = press_force(time % 3.5)
    model = ReducedModel.load()
    (areas,) = model.batch(model.space.default[None], [(time, force, np.arange(len(time)))])
    seen = np.interp(frames - lag, time, areas[0])
    rows = [(t, "wrench", f) for t, f in zip(time, force)]
    rows += [(t, "contact_area", a) for t, a in zip(frames, seen)]
    with BagWriter(path, {"subject": "S01", "condition": "natural"}) as bag:
        for t, topic, value in sorted(rows):
            stamp = START + round(t * 1e9)
            area = {"header": {"stamp": stamp}, "gross_area": value, "area_stddev": sd}
            bag.write(topic, wrench(stamp, value + tare) if topic == "wrench" else area)
    return path


def notes(path: Path) -> str:
    return "; ".join(process(path, None).notes)


def test_a_good_recording_has_no_notes(tmp_path: Path) -> None:
    assert process(recorded(tmp_path / "bag"), None).notes == []


def test_areas_of_another_time_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = recorded(tmp_path / "bag", lag=0.3)
    assert command(["process", str(path), "-o", str(tmp_path / "out")]) == 0
    assert "MODEL_MISMATCH); check the clocks" in capsys.readouterr().out


def test_areas_without_a_deviation_are_told_with_the_remedy(tmp_path: Path) -> None:
    found = notes(recorded(tmp_path / "bag", sd=float("nan")))
    assert "areas have no standard deviation and were not used; import them again" in found
    mapping = "topics: {contact_area: {field: gross_area}}"
    (tmp_path / "map.yaml").write_text(mapping)
    output = ["-o", str(tmp_path / "out"), "--mapping", str(tmp_path / "map.yaml")]
    assert command(["process", str(tmp_path / "bag"), *output]) == 0


def test_a_force_beyond_the_default_finger_is_served_by_the_population(
    session: Callable[..., Path], tmp_path: Path
) -> None:
    strong = session("strong", trials=1, peak=5.0)
    result = process(strong, tmp_path / "out")
    assert "the model of the population was used" in result.notes[0]
    assert not any("FORCE_OUT_OF_RANGE" in note for note in result.notes)
    # A second run follows the events of the first, with its model.
    first: list[EstimateBlock] = []
    second: list[EstimateBlock] = []
    process(strong, None, on_block=first.append)
    assert process(tmp_path / "out", None, on_block=second.append).replayed
    again = np.concatenate([block.column("area") for block in second])
    assert np.array_equal(again, np.concatenate([b.column("area") for b in first])[-len(again) :])
    # Named, it serves at once, and says so no more.
    named: list[EstimateBlock] = []
    options = ProcessOptions(model_file="population")
    assert not any(
        "was used" in n for n in process(strong, None, options, None, named.append).notes
    )
    assert np.array_equal(np.concatenate([b.column("area") for b in named])[-len(again) :], again)
    own = ProcessOptions(estimator={"onset_force": 0.06})
    assert "population" in process(strong, None, own).notes[0]
    usual = process(session("usual", trials=1), None)
    assert not any("population" in note for note in usual.notes)


@pytest.mark.parametrize("axis", ["+z", "+x"])
def test_forces_along_another_axis_are_told_with_the_axis(tmp_path: Path, axis: str) -> None:
    found = process(recorded(tmp_path / "bag"), None, ProcessOptions(normal_axis=axis)).notes
    assert "areas show a contact, 0 of 7000 forces do" in found[0]
    assert f"along -z, not along normal_axis {axis}: give --normal-axis -z, or tare" in found[0]


def test_validate_names_the_axis_where_it_finds_no_press(tmp_path: Path) -> None:
    path = recorded(tmp_path / "bag")
    (trials,) = (
        check
        for check in validate(path, ReadSettings(normal_axis="+z")).checks
        if check.name == "trials"
    )
    assert trials.status == "fail" and "no press" in trials.detail
    assert trials.detail.endswith("give --normal-axis -z, or tare the force")


def test_validate_names_the_axis_of_a_long_hold_and_not_its_tare(tmp_path: Path) -> None:
    """A steady force that pulls looks as one that was not tared."""
    time = np.arange(0.0, 20.0, 0.01)
    with BagWriter(tmp_path / "bag") as bag:
        for t, force in zip(time, np.interp(time, [2.0, 3.0, 17.0, 18.0], [0.0, 1.3, 1.3, 0.0])):
            bag.write("wrench", wrench(START + int(1e9 * t), float(force)))
    found = validate(tmp_path / "bag", ReadSettings(normal_axis="+z"))
    checks = {check.name: check for check in found.checks}
    assert checks["trials"].detail.endswith("give --normal-axis -z, or tare the force")
    assert "tare" not in checks and not found.fit


def test_validate_names_no_axis_where_there_is_no_force(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(1000):
            bag.write("wrench", wrench(START + 2_000_000 * k, math.nan if k % 2 else 0.0))
    (trials,) = (c for c in validate(tmp_path / "bag").checks if c.name == "trials")
    assert trials.status == "fail" and "--normal-axis" not in trials.detail


@pytest.mark.filterwarnings("error")
def test_one_damaged_force_does_not_hide_a_press(tmp_path: Path) -> None:
    path = write_session(tmp_path / "whole", trials=1)
    with open_bag(path) as reader, BagWriter(tmp_path / "bag", {"condition": "dry"}) as bag:
        for number, item in enumerate(reader):
            raw = item.raw
            if item.topic.endswith("/wrench") and number == 1000:
                stamp = item.message.header.stamp
                time = stamp.sec * 10**9 + stamp.nanosec
                raw = encode(item.type, wrench(time, 1e308))
            bag.write_raw(bag.add_topic(item.topic, item.type), raw, item.log_time_ns)
    checks = {check.name: check for check in validate(tmp_path / "bag").checks}
    assert "1 natural" in checks["trials"].detail and checks["units"].status == "ok"


FULL_DISK = """
import resource, signal, sys
from finger_bag.cli import command
from finger_common.cli import run
from finger_bag.writer import BagWriter
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
begun = BagWriter.finish
def finish(self):  # kernels are compiled, and kept in files, before
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000, before[1]))
    try:
        begun(self)
    finally:  # the table would fit
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
BagWriter.finish = finish
sys.exit(run(command, sys.argv[1:]))
"""


def test_a_bag_that_does_not_fit_leaves_no_table_alone(tmp_path: Path) -> None:
    path = recorded(tmp_path / "bag")
    words = ["process", str(path), "-o", str(tmp_path / "out"), "--csv", str(tmp_path / "t.csv")]
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, *words], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 2, done.stderr
    assert f"{tmp_path / 'out'}: cannot be written (File too large); make room" in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["bag"]


def test_stamps_before_1970_are_named_as_the_cause(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for number in range(1000):
            bag.write("wrench", wrench(-5_000_000_000 + number * 2_000_000, 1.0), START + number)
    with pytest.raises(InputError, match="stamps lie before 1970; name 'stamp: log_time'"):
        process(tmp_path / "bag", None)
    mapping = tmp_path / "map.yaml"
    mapping.write_text("topics: {wrench: {stamp: log_time}}")
    by_log_time = ProcessOptions(mapping=TopicMapping.load(mapping))
    assert process(tmp_path / "bag", None, by_log_time).states == 1000


def test_readings_off_the_scale_are_noted(tmp_path: Path, session: Callable[..., Path]) -> None:
    path = session("sweaty", trials=1)
    with open_bag(path) as reader, BagWriter(tmp_path / "off", reader.info.metadata) as bag:
        for item in reader.messages():
            if item.topic.endswith("/moisture"):
                stamp = {"header": {"stamp": item.log_time_ns}}
                bag.write("moisture", {**stamp, "value": 1e9, "phase": item.message.phase})
            else:
                bag.copy(item)
    (moisture,) = (c for c in validate(tmp_path / "off").checks if c.name == "moisture")
    assert moisture.status == "note"
    assert "6 of 6 are off the scale (0 … 130 a.u.) and not used" in moisture.detail
