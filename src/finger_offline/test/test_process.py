# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Processing gives what the core gives sample by sample, and what a live node published."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_recording import EventLog
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from session_bags import START, wrench

from finger_bag.cli import command
from finger_bag.definitions import decoder, definition_text, encode, own_definition
from finger_bag.mapping import TopicMapping
from finger_bag.read_settings import ReadSettings
from finger_bag.reader import open_bag
from finger_bag.streams import read_streams
from finger_bag.validate import NOTE, validate
from finger_bag.writer import BagWriter
from finger_common.cli import EXIT_BAD_INPUT, run
from finger_common.errors import InputError
from finger_common.image_size import PixelBudget
from finger_common.stamps import time_fields
from finger_model.estimator import (
    ContactEstimate,
    ContactEstimator,
    EstimateBlock,
    EstimatorSettings,
)
from finger_model.finger import load_for, load_reduced
from finger_model.geometry import Geometry
from finger_model.messages import (
    area_of,
    moisture_of,
    wrench_of,
)
from finger_model.parameter_sets import ParameterSets
from finger_offline.contact_states import serialize
from finger_offline.process import process
from finger_offline.process_options import ProcessOptions
from finger_offline.trials import load_trials

STATE = "finger_msgs/msg/ContactState"


def column(blocks: list[EstimateBlock], name: str) -> np.ndarray:
    """One field over all blocks."""
    return np.concatenate([b.column(name) for b in blocks])


def state_fields(estimate: ContactEstimate, frame_id: str) -> dict[str, Any]:
    """Fields of a ContactState as a dict, apart from the declaration of the estimate's fields."""
    fields = estimate._asdict()
    stamp = time_fields(fields.pop("stamp_ns"))
    onset = time_fields(fields.pop("onset_ns"))
    return {**fields, "header": {"stamp": stamp, "frame_id": frame_id}, "onset": onset}


def sample_by_sample(path: Path) -> list[ContactEstimate]:
    """Estimates as a live node makes them: inputs by log time, one wrench at a time."""
    estimator = ContactEstimator(load_reduced())
    found = []
    with open_bag(path) as reader:
        messages = list(reader.messages())
    for item in messages:
        if item.topic == "/finger/contact_area":
            estimator.add_area(*area_of(item.message))
        elif item.topic == "/finger/moisture":
            estimator.add_moisture(*moisture_of(item.message))
        elif item.topic == "/finger/wrench":
            found += estimator.add_wrench(*wrench_of(item.message))
    return found


def test_processing_equals_the_estimator_fed_sample_by_sample(
    session: Callable[..., Path], tmp_path: Path
) -> None:
    path = session(trials=2)
    blocks: list[EstimateBlock] = []
    result = process(path, tmp_path / "out", on_block=blocks.append)
    assert [repr(e) for b in blocks for e in b] == [repr(e) for e in sample_by_sample(path)]
    assert result.states == 3500 and result.problems == [] and not result.replayed
    # Areas were fused: the estimate differs from the model alone.
    area, model = column(blocks, "area"), column(blocks, "model_area")
    assert np.any(area != model)


def test_bag_written_holds_the_estimates_and_the_originals(
    session: Callable[..., Path], tmp_path: Path
) -> None:
    path = session(trials=1, images=True)
    before = (path / "session_0.mcap").read_bytes()
    blocks: list[EstimateBlock] = []
    process(path, tmp_path / "out", on_block=blocks.append)
    assert (path / "session_0.mcap").read_bytes() == before
    with open_bag(path) as source, open_bag(tmp_path / "out") as made:
        assert made.all_problems() == []
        theirs = {(m.topic, m.log_time_ns, m.raw) for m in source.messages()}
        copied = {(m.topic, m.log_time_ns, m.raw) for m in made.messages()}
        assert {t for t, _, _ in theirs - copied} == {"/finger/image_raw"}
        assert {t for t, _, _ in copied - theirs} == {
            "/finger/contact_state",
            "/finger/model_events",
        }
        states = [m.message for m in made.messages(["/finger/contact_state"])]
        logs = [m.log_time_ns for m in made.messages(["/finger/contact_state"])]
        wrenches = [m.log_time_ns for m in source.messages(["/finger/wrench"])]
        assert logs == wrenches
        assert made.info.metadata.extra["processed_from"] == "session"
        assert made.info.metadata.subject == "S01"
    assert [s.area for s in states] == column(blocks, "area").tolist()
    assert states[0].header.frame_id == "force_sensor"
    process(path, tmp_path / "with_images", ProcessOptions(keep_images=True))
    with open_bag(tmp_path / "with_images") as made:
        assert made.info.topics["/finger/image_raw"].count == 35


def test_serialized_states_equal_those_encoded_one_by_one() -> None:
    estimator = ContactEstimator(load_reduced())
    estimator.add_moisture(START - 10**9, 50.0)
    estimator.add_moisture(START + 10**8, 80.0)  # another parameter set midway
    stamps = START + np.arange(300) * 2_000_000
    forces = np.zeros((300, 3))
    forces[:, 2] = -np.linspace(0, 1, 300)
    forces[7, 2] = np.nan
    block = estimator.add_wrenches(stamps, forces)
    for frame_id in ("", "f", "force_sensor", "a frame"):
        for cdr, estimate in zip(serialize(block, frame_id), block):
            assert cdr == encode(STATE, state_fields(estimate, frame_id))


def live_recording(
    path: Path,
    behind_ns: int = 0,
    subject: ParameterSets | None = None,
    start_kept: bool = True,
) -> list[bytes]:
    """A bag as the recorder makes it beside a live model node: inputs, events, and what was
    published.

    With a late area, a change of settings and a reset on the way. behind_ns: what the node is
    behind, so that its events are logged as much later. subject: sets with a finger of its own, to
    which the node changed before the recording. start_kept: whether the start is among the events
    that are kept for late joiners. Gives the published states.
    """
    settings = EstimatorSettings(drift_sd=0.05)
    before = estimator = ContactEstimator(load_reduced(), None, settings)
    if subject is not None:
        estimator = ContactEstimator(load_for(subject), subject, settings)
    published = []
    with BagWriter(path) as bag:
        tell = partial(EventLog(bag).write, behind_ns=behind_ns)
        if subject is not None and start_kept:
            tell(before.start_event(START - 10**11), START - 1000)
            tell(before.change_settings(settings, "asked"), START - 1000)
        if start_kept:
            tell(estimator.start_event(START), START)
        else:
            for k in range(10):
                tell(estimator.change_settings(settings, f"asked {k}"), START)
        for i in range(6000):
            stamp = START + i * 2_000_000
            log = stamp + 300_000
            if i == 1200:
                settings = EstimatorSettings(drift_sd=0.1, onset_force=0.06)
                tell(estimator.change_settings(settings, "asked"), log)
            if i == 3100:
                tell(estimator.reset("asked"), log)
            force = max(0.0, 1.2 * float(np.sin(i / 400)))
            message = wrench(stamp, force)
            bag.write("wrench", message, log)
            vector = message["wrench"]["force"]
            values = (vector["x"], vector["y"], vector["z"])
            for estimate in estimator.add_wrench(stamp, values):
                published.append(encode(STATE, state_fields(estimate, "force_sensor")))
                bag.write_raw("contact_state", published[-1], log + 200_000)
            if i % 50 == 0:
                # Every seventh frame takes 150 ms: beyond the fusion delay of 100 ms.
                delay = 150_000_000 if i % 350 == 0 else 20_000_000
                image_stamp = stamp - delay
                area = (image_stamp, 38e-6 * force**0.7, 1e-6, 0 if force > 0.05 else 1)
                fields = {
                    "header": {"stamp": area[0]},
                    "gross_area": area[1],
                    "area_stddev": area[2],
                    "flags": area[3],
                }
                bag.write("contact_area", fields, log + 400_000)
                if not estimator.add_area(*area):
                    tell(estimator.note_late(areas=[area[0]]), log + 500_000)
    assert estimator.counters["late_areas"] > 10
    return published


def calibrated() -> ParameterSets:
    """Sets as the calibration of a subject whose finger was measured gives them."""
    sets = ParameterSets.default()
    assert sets.prior is not None
    return sets.with_prior(sets.prior, Geometry(pad_semi_axis_radial=8e-3))


@pytest.mark.parametrize(
    ("behind_ns", "subject", "start_kept"),
    [
        (0, None, True),
        (5_000_000_000, None, True),
        (0, calibrated(), True),
        (0, calibrated(), False),
    ],
)
def test_processing_a_recording_gives_what_the_live_node_published_bit_for_bit(
    tmp_path: Path, behind_ns: int, subject: ParameterSets | None, start_kept: bool
) -> None:
    published = live_recording(tmp_path / "live", behind_ns, subject, start_kept)
    result = process(tmp_path / "live", tmp_path / "out")
    assert result.replayed and result.problems == []
    with open_bag(tmp_path / "out") as reader:
        again = [m.raw for m in reader.messages(["/finger/contact_state"])]
    assert again == published
    # Other settings than recorded give something else.
    process(tmp_path / "live", tmp_path / "other", ProcessOptions(estimator={"fuse_area": False}))
    with open_bag(tmp_path / "other") as reader:
        assert [m.raw for m in reader.messages(["/finger/contact_state"])] != published


def test_processing_again_is_the_same_for_any_blocks(
    session: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = session(trials=1)
    process(path, tmp_path / "a")
    monkeypatch.setattr("finger_offline.input_order.BLOCK", 37)
    process(path, tmp_path / "b")

    def states(name: str) -> list[bytes]:
        with open_bag(tmp_path / name) as reader:
            return [m.raw for m in reader.messages(["/finger/contact_state"])]

    assert states("a") == states("b")


def test_areas_from_images_are_those_of_the_segmenter(
    session: Callable[..., Path], tmp_path: Path
) -> None:
    from finger_vision.calibration import PlateCalibration
    from finger_vision.ftir import FtirSegmenter
    from finger_vision.messages import image_of

    path = session(trials=1, images=True)
    with pytest.raises(InputError, match=r"plate_calibration.yaml.*--area-per-pixel"):
        process(path, tmp_path / "out", ProcessOptions(images="yes"))
    assert not (tmp_path / "out").exists()
    options = ProcessOptions(images="yes", area_per_pixel=0.04e-6)
    result = process(path, tmp_path / "out", options)
    assert result.areas == 35
    segmenter = FtirSegmenter(calibration=PlateCalibration.from_area_per_pixel(0.04e-6))
    with open_bag(path) as source, open_bag(tmp_path / "out") as made:
        expected = [
            segmenter.process(image_of(m.message)) for m in source.messages(["/finger/image_raw"])
        ]
        found = [m.message for m in made.messages(["/finger/contact_area"])]
    assert [a.gross_area for a in found] == [e.gross_area for e in expected]
    assert [a.flags for a in found] == [int(e.flags) for e in expected]
    for area, measurement in zip(found, expected):
        hull = np.array([[p.x, p.y] for p in area.hull]).reshape(-1, 2)
        assert np.allclose(hull, measurement.hull, atol=1e-9)


def test_images_left_out_by_the_limit_are_counted_as_lost(
    session: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from finger_bag.cli import command

    path = session(trials=1, images=True)
    arguments = ["process", str(path), "--images", "yes", "--area-per-pixel", "4e-8", "-o"]
    assert run(command, [*arguments, str(tmp_path / "all")]) == 0
    monkeypatch.setattr("finger_common.image_size.ALL_PIXELS", 100_000)
    monkeypatch.setattr("finger_offline.image_areas.PixelBudget", lambda size: PixelBudget(0))
    capsys.readouterr()
    assert run(command, [*arguments, str(tmp_path / "some")]) == 1
    assert "more pixels than a bag of this size can hold" in capsys.readouterr().err
    with open_bag(tmp_path / "some") as made:
        assert 0 < made.info.topics["/finger/contact_area"].count < 35


def test_what_a_run_has_no_use_for_is_told_or_refused(
    session: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = str(session())
    given = ["--area-per-pixel", "1e-9", "--set", "tilt_sd=0.2"]
    assert command(["process", bag, "-o", str(tmp_path / "out"), *given]) == 0
    said = capsys.readouterr().err
    assert "area_per_pixel 1e-09 is not used: give --images yes" in said
    assert "tilt_sd 0.2 is not used: give --shape" in said
    both = ["--calibration", "plate.yaml", "--area-per-pixel", "1e-9"]
    with pytest.raises(InputError, match="--calibration and --area-per-pixel: give one of the two"):
        command(["process", bag, "-o", str(tmp_path / "both"), *both])
    with pytest.raises(InputError, match="area sensor 'other' is not installed"):
        command(["process", bag, "-o", str(tmp_path / "other"), "--area-sensor", "other"])


def test_csv_holds_the_estimates(session: Callable[..., Path], tmp_path: Path) -> None:
    path = session(trials=1)
    blocks: list[EstimateBlock] = []
    process(path, None, ProcessOptions(tables=(str(tmp_path / "x.csv"),)), on_block=blocks.append)
    lines = (tmp_path / "x.csv").read_text().splitlines()
    header = "time_s,force_n,area_mm2,radius_mm,indentation_mm,peak_pressure_kpa,"
    assert lines[0].startswith(header)
    row = dict(zip(lines[0].split(","), lines[1001].split(",")))
    assert float(row["time_s"]) == pytest.approx(2.0)
    assert float(row["area_mm2"]) == pytest.approx(column(blocks, "area")[1000] * 1e6, rel=1e-9)
    assert len(lines) == 1751


def test_parquet_holds_what_the_csv_holds(session: Callable[..., Path], tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    csv, file = str(tmp_path / "x.csv"), str(tmp_path / "x.parquet")
    blocks: list[EstimateBlock] = []
    process(session(trials=1), None, ProcessOptions(tables=(csv, file)), on_block=blocks.append)
    table = parquet.read_table(file)
    assert table.column_names == Path(csv).read_text().split("\n")[0].split(",")
    assert np.array_equal(table["area_mm2"].to_numpy(), column(blocks, "area") * 1e6)
    assert table["stamp_ns"].to_pylist() == column(blocks, "stamp_ns").tolist()


def test_memory_does_not_grow_with_the_bag(tmp_path: Path) -> None:
    """Wrenches and inputs that wait span two seconds of log time, whatever the length."""
    from finger_offline import process as module

    raw = encode("geometry_msgs/msg/WrenchStamped", wrench(START, 1.0))
    with BagWriter(tmp_path / "bag") as bag:
        for i in range(20_000):
            stamp = START + i * 2_000_000
            patched = bytearray(raw)
            patched[4:8] = (stamp // 10**9).to_bytes(4, "little")
            patched[8:12] = (stamp % 10**9).to_bytes(4, "little")
            bag.write_raw("wrench", bytes(patched), stamp)
    waiting = []
    original = module._Run._estimate

    def watch(self: module._Run, items: list) -> None:
        waiting.append(len(self.queue._wrenches) + len(items))
        original(self, items)

    module._Run._estimate = watch  # type: ignore[method-assign]
    try:
        assert process(tmp_path / "bag", None).states == 20_000
    finally:
        module._Run._estimate = original  # type: ignore[method-assign]
    assert max(waiting) < 3 * 500


def test_a_wrench_of_another_definition_is_read_by_its_own(tmp_path: Path) -> None:
    """Torque before force: the same numbers as `read_streams` gives."""
    kind = "geometry_msgs/msg/WrenchStamped"
    known = definition_text(kind)
    force, torque = ("geometry_msgs/Vector3 force", "geometry_msgs/Vector3 torque")
    assert force in known and torque in known
    turned = known.replace(force, "?").replace(torque, force).replace("?", torque)
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("wrench", definition=turned)
        for i in range(500):
            fields = wrench(START + i * 2_000_000, 1.35)
            swapped = dict(zip(("force", "torque"), reversed(fields["wrench"].values())))
            raw = encode(kind, {**fields, "wrench": swapped})
            bag.write_raw("wrench", raw, START + i * 2_000_000)
    with open_bag(tmp_path / "bag") as reader:
        wrenches = read_streams(reader, ReadSettings()).wrenches
    assert np.all(wrenches.force[:, 2] == -1.35) and np.all(wrenches.torque[:, 0] == 0.001)
    blocks: list[EstimateBlock] = []
    assert process(tmp_path / "bag", tmp_path / "out", on_block=blocks.append).problems == []
    assert np.all(column(blocks, "normal_force") == 1.35)
    with open_bag(tmp_path / "out") as reader:
        states = [m.message for m in reader.messages(["/finger/contact_state"])]
    assert {state.header.frame_id for state in states} == {"force_sensor"}


AREA = "finger_msgs/msg/ContactArea"


def defined_otherwise(change: Callable[[list[str]], list[str]], path: Path) -> Path:
    """A bag of a press and of ten areas of 60 mm², with the fields of their type changed."""
    known = own_definition(AREA) or ""
    lines = [
        line for line in known.splitlines() if line[:1].islower() and "uint32 FLAG" not in line
    ]
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg("\n".join(change(lines)), AREA))
    with BagWriter(path) as bag:
        bag.add_topic("contact_area", definition=types.generate_msgdef(AREA, ros_version=2)[0])
        for i in range(500):
            stamp = START + i * 2_000_000
            bag.write("wrench", wrench(stamp, min(0.01 * i, 1.0)))
            if i % 50 == 25:
                fields = {"header": {"stamp": stamp}, "gross_area": 60e-6, "area_stddev": 2e-6}
                message = decoder(AREA)(encode(AREA, fields))
                names = [name for name, _ in types.fielddefs[AREA][1]]
                values = {"area": 60e-6, "warmth": 36.6, **vars(message)}
                other = types.types[AREA](**{name: values[name] for name in names})
                bag.write_raw("contact_area", bytes(types.serialize_cdr(other, AREA)), stamp)
    return path


def test_areas_whose_fields_have_another_order_and_new_ones_are_used(tmp_path: Path) -> None:
    found = []
    for number, change in enumerate((list, lambda lines: ["float32 warmth", *reversed(lines)])):
        blocks: list[EstimateBlock] = []
        bag = defined_otherwise(change, tmp_path / f"{number}")
        assert process(bag, None, on_block=blocks.append).problems == []
        found.append(column(blocks, "area"))
    np.testing.assert_array_equal(*found)


def test_areas_without_a_needed_field_are_told_and_the_remedy_helps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = defined_otherwise(
        lambda lines: [line.replace("gross_area", "area") for line in lines], tmp_path / "bag"
    )
    assert run(command, ["process", str(bag), "-o", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert "definition in the bag has no field 'gross_area'" in said and "mapping file" in said
    mapping = TopicMapping.from_mapping({"topics": {"contact_area": {"field": "area"}}})
    again = process(bag, None, ProcessOptions(mapping=mapping))
    assert again.areas == 10 and not again.lost


def test_torque_of_a_unit_that_is_not_told_is_left_out(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for i in range(10):
            bag.write("wrench", wrench(START + i * 2_000_000, 1350.0))
    mapping = TopicMapping.from_mapping({"topics": {"wrench": {"unit": "mN"}}})
    with open_bag(tmp_path / "bag") as reader:
        wrenches = read_streams(reader, ReadSettings(mapping=mapping)).wrenches
    assert wrenches.force[:, 2] == pytest.approx(-1.35) and not wrenches.torque.any()


def test_an_area_of_another_unit_is_as_certain_as_in_square_metres(tmp_path: Path) -> None:
    found = []
    for name, unit in (("m2", 1.0), ("mm2", 1e-6)):
        with BagWriter(tmp_path / name) as bag:
            for i in range(500):
                stamp = START + i * 2_000_000
                bag.write("wrench", wrench(stamp, min(0.01 * i, 1.0)))
                if i % 50 == 25:
                    area = {"gross_area": 60e-6 / unit, "area_stddev": 2e-6 / unit}
                    bag.write("contact_area", {"header": {"stamp": stamp}, **area})
        mapping = TopicMapping.from_mapping({"topics": {"contact_area": {"unit": name}}})
        blocks: list[EstimateBlock] = []
        process(tmp_path / name, None, ProcessOptions(mapping=mapping), on_block=blocks.append)
        found.append((column(blocks, "area")[-1], column(blocks, "area_stddev")[-1]))
    assert found[1] == pytest.approx(found[0], rel=1e-6)


def test_a_bag_of_a_failed_run_is_not_left_behind(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("contact_area", {"header": {"stamp": START}})
    with pytest.raises(InputError, match="'wrench'"):
        process(tmp_path / "bag", tmp_path / "out")
    assert {p.name for p in tmp_path.iterdir()} == {"bag"}


def test_bags_that_would_share_a_name_are_refused(
    session: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("S01/press", "S02/press", "dry_1.35N", "dry_1.50N"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        session(name, trials=1)
    target = ["-o", str(tmp_path / "out")]
    same = [str(tmp_path / name) for name in ("S01/press", "S02/press")]
    assert run(command, ["process", *same, *target]) == 2
    assert "process them one by one" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    apart = [str(tmp_path / name) for name in ("dry_1.35N", "dry_1.50N")]
    assert run(command, ["process", *apart, *target, "--jobs", "0"]) == 2
    assert "--jobs is 0" in capsys.readouterr().err
    assert run(command, ["process", *apart, *target]) == 0
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"dry_1.35N", "dry_1.50N"}


@pytest.mark.parametrize("names", [["cut"], ["empty", "cut", "whole"]])
def test_a_problem_names_the_bag_that_was_read(
    names: list[str],
    session: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in names:
        (file,) = session(name, trials=1).glob("*.mcap")
        kept = {"cut": 0.7, "empty": 0.0, "whole": 1.0}[name]
        os.truncate(file, int(kept * file.stat().st_size))
    bags = [str(tmp_path / name) for name in names]
    code = run(command, ["process", *bags, "-o", str(tmp_path / "out"), "--jobs", "1"])
    assert code == (EXIT_BAD_INPUT if "empty" in names else 0)
    said = capsys.readouterr().err
    assert f"finger-bag: {tmp_path / 'cut'}: file was not closed by its recorder" in said
    assert str(tmp_path / "out") not in said


def test_wrenches_without_stamps_are_not_left_out_silently(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for i in range(1000):
            bag.write("wrench", wrench(0, 0.5), START + 2_000_000 * i)
    found = process(tmp_path / "bag", tmp_path / "out")
    assert any("999 of 1000 wrenches repeat a stamp" in problem for problem in found.problems)
    by_log = TopicMapping.from_mapping({"topics": {"wrench": {"stamp": "log_time"}}})
    found = process(tmp_path / "bag", tmp_path / "out2", ProcessOptions(mapping=by_log))
    assert found.states == 1000 and not found.problems


def test_slip_of_former_settings_does_not_stay_beside_new_states(tmp_path: Path) -> None:
    live_recording(tmp_path / "bag")
    process(tmp_path / "bag", tmp_path / "slip", ProcessOptions(slip=True))
    assert "/finger/contact_slip" in open_bag(tmp_path / "slip").info.topics
    process(tmp_path / "slip", tmp_path / "same")
    assert "/finger/contact_slip" in open_bag(tmp_path / "same").info.topics
    process(tmp_path / "slip", tmp_path / "other", ProcessOptions(estimator={"fusion_delay": 0.05}))
    assert "/finger/contact_slip" not in open_bag(tmp_path / "other").info.topics


def robot_recording(path: Path, source: Path, events: float | None) -> None:
    """A recording of a finger of a hand whose force is published in another namespace.

    events: s after its start from which model_events were heard; None: not at all.
    """
    names = {
        "/finger/wrench": "/robot/thumb/ft",
        "/finger/contact_state": "/hand/thumb/contact_state",
        "/finger/contact_area": "/hand/thumb/contact_area",
        "/finger/model_events": "/hand/thumb/model_events",
    }
    with open_bag(source) as reader, BagWriter(path) as bag:
        for item in reader.messages():
            late = (item.log_time_ns - START) / 1e9
            if item.topic != "/finger/model_events" or (events is not None and late >= events):
                bag.add_topic(names[item.topic], item.type)
                bag.write_raw(names[item.topic], item.raw, item.log_time_ns)


@pytest.mark.parametrize("namespace", ["", "hand/thumb"])
def test_results_go_beside_the_former_ones_wherever_the_force_is(
    tmp_path: Path, namespace: str
) -> None:
    published = live_recording(tmp_path / "live")
    robot_recording(tmp_path / "robot", tmp_path / "live", 0.0)
    options = ProcessOptions(wrench_topic="/robot/thumb/ft", namespace=namespace)
    result = process(tmp_path / "robot", tmp_path / "out", options)
    with open_bag(tmp_path / "robot") as source, open_bag(tmp_path / "out") as made:
        assert set(made.info.topics) == set(source.info.topics)
        again = [m.raw for m in made.messages(["/hand/thumb/contact_state"])]
    assert again == published and not any("no event tells" in note for note in result.notes)


@pytest.mark.parametrize("given", [{}, {"namespace": "hand/thumb"}])
def test_areas_of_another_finger_than_the_force_are_told(
    session: Callable[..., Path], tmp_path: Path, given: dict[str, str]
) -> None:
    """A hand in which one finger has a camera and no force, the other a force and no camera."""
    fingers = {"contact_area": "index"}
    hand = tmp_path / "hand"
    with open_bag(session(trials=1)) as reader, BagWriter(hand) as bag:
        for item in reader.messages():
            name = item.topic.removeprefix("/finger/")
            topic = f"/hand/{fingers.get(name, 'thumb')}/{name}"
            bag.add_topic(topic, item.type)
            bag.write_raw(topic, item.raw, item.log_time_ns)
    result = process(hand, tmp_path / "out", ProcessOptions(**given))
    told = [p for p in result.problems if "/hand/index/contact_area, /hand/thumb/wrench" in p]
    assert bool(told) == (result.areas > 0) == (not given)
    assert all("--namespace" in problem for problem in told)
    if not given:
        assert any(told[0] in problem for problem in load_trials(hand).problems)
        notes = [c.detail for c in validate(hand).checks if c.status == NOTE]
        assert told[0] in notes


@pytest.mark.parametrize("events", [None, 2.0])
def test_states_older_than_every_event_are_told(tmp_path: Path, events: float | None) -> None:
    live_recording(tmp_path / "live")
    robot_recording(tmp_path / "robot", tmp_path / "live", events)

    def told(name: str, **given: Any) -> bool:
        where = {"wrench_topic": "/robot/thumb/ft", "namespace": "hand/thumb"}
        options = ProcessOptions(**where, **given)
        notes = process(tmp_path / "robot", tmp_path / name, options).notes
        return any("no event tells the settings" in note for note in notes)

    assert told("defaults")
    assert not told("given", estimator={"normal_axis": "-z"})
