# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The command: exit codes, one sentence for bad input, tables and JSON."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from session_bags import START, image, press_force, wrench

from finger_bag.cli import command, parser
from finger_bag.read_settings import ReadSettings
from finger_bag.reader import open_bag
from finger_bag.recorder import RecorderSettings
from finger_bag.validate import validate
from finger_bag.writer import BagWriter
from finger_common.cli import run
from finger_offline.trial_checks import force_image_lag
from finger_offline.trials import load_trials

COMMANDS = ("info", "validate", "process", "play", "record", "recover", "anonymise")


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_an_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        parser().parse_args([name, "--help"])
    assert caught.value.code == 0
    assert f"example:\n  finger-bag {name}" in capsys.readouterr().out


def bad_calls(folder: Path) -> list[list[str]]:
    (folder / "text.mcap").write_text("no bag\n")
    (folder / "void").mkdir()
    (folder / "map.yaml").write_text("topics: {wrench: {topic: /x, unit: mm}}\n")
    for name, text in (("key", "subjct: S02"), ("unit", "target_force: 0.5 N")):
        (folder / f"{name}.yaml").write_text(f"trial: {{{text}}}\n")
    with BagWriter(folder / "good") as bag:
        bag.write("wrench", wrench(START, 0.0))
    good = str(folder / "good")
    return [
        ["info", str(folder / "nowhere")],
        ["validate", str(folder / "text.mcap")],
        ["validate", str(folder / "void")],
        ["validate", good, "--mapping", str(folder / "map.yaml")],
        ["validate", good, "--mapping", str(folder / "no.yaml")],
        ["validate", good, "--mapping", str(folder / "key.yaml")],
        ["validate", good, "--mapping", str(folder / "unit.yaml")],
        ["process", str(folder / "text.mcap"), "-o", str(folder / "out")],
        ["process", good, "-o", good],
        ["process", good, "-o", str(folder / "out"), "--set", "onset=1"],
        ["process", good, "-o", str(folder / "out"), "--set", "onset_force=lots"],
        ["process", good, "-o", str(folder / "out"), "--csv", str(folder / "x.xls")],
        ["process", good, "-o", str(folder / "out"), "--images", "yes"],
        ["process", good, "-o", str(folder / "out"), "--parameters", str(folder / "map.yaml")],
        ["play", good, "--topics", "moisture"],
        ["play", good, "--rate", "0"],
        ["recover", str(folder / "text.mcap")],
        ["recover", str(folder / "void")],
        ["anonymise", good, "-o", good],
        ["record", "-o", good],
        ["record", "-o", str(folder / "new"), "--flush-interval", "9"],
    ]


@pytest.mark.parametrize("number", range(21))
def test_bad_input_is_one_sentence_and_exit_code_2(
    number: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calls = bad_calls(tmp_path)
    assert len(calls) == 21
    before = {p.name for p in tmp_path.iterdir()}
    assert run(command, calls[number]) == 2
    # Where kernels are compiled for the first time, a line tells every 15 s that it works.
    lines = capsys.readouterr().err.splitlines()
    err = "\n".join(line for line in lines if "still running" not in line)
    assert err and err.count("\n") == 0 and "Traceback" not in err and len(err) < 500
    assert {p.name for p in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ([], RecorderSettings()),
        (
            [
                "--png",
                "--compression",
                "lz4",
                "--maximum-size",
                "1000000",
                "--queue-limit=0x100000",
            ],
            RecorderSettings(
                png=True, compression="lz4", maximum_size=1_000_000, queue_limit=1 << 20
            ),
        ),
        (["--no-png", "--maximum-duration", "60"], RecorderSettings(maximum_duration=60.0)),
    ],
)
def test_record_gives_the_node_its_settings(
    options: list[str],
    expected: RecorderSettings,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[list[str]] = []
    node = SimpleNamespace(record=calls.append)
    monkeypatch.setitem(sys.modules, "finger_bag.recorder_node", node)
    assert run(command, ["record", "-o", str(tmp_path / "new"), *options]) == 0
    (arguments,) = calls
    given = dict(item.split(":=") for item in arguments if ":=" in item and "__ns" not in item)
    parameters = {name: json.loads(text) for name, text in given.items()}
    assert parameters["bag_name"] == "new" and parameters["record_at_start"] is True
    assert {name: parameters[name] for name in expected.to_dict()} == expected.to_dict()


def checks(path: Path, **settings: object) -> dict[str, tuple[str, str]]:
    found = validate(path, ReadSettings(**settings))  # type: ignore[arg-type]
    return {c.name: (c.status, c.detail) for c in found.checks}


def test_good_bag_is_fit_for_use(
    session: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path = session(trials=2, tremor=0.01)
    assert run(command, ["validate", str(path)]) == 0
    out = capsys.readouterr().out
    assert "fit for use" in out and "2 natural" in out
    assert run(command, ["validate", str(path), "--json"]) == 0
    (data,) = json.loads(capsys.readouterr().out)
    assert data["fit_for_use"] and all(c["status"] in ("ok", "note") for c in data["checks"])


def test_of_all_files_of_a_session_the_bags_are_judged(
    session: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bags = [session(name, trials=1, tremor=0.01) for name in ("000_dry_0", "001_dry_0")]
    tables = [tmp_path / name for name in ("events.csv", "session.json", "trials.csv")]
    for table in tables:
        table.write_text("{}")
    everything = sorted(map(str, tmp_path.iterdir()))
    assert run(command, ["validate", *everything, "--json"]) == 0
    told = capsys.readouterr()
    assert [Path(data["bag"]) for data in json.loads(told.out)] == bags
    (line,) = told.err.splitlines()
    assert "no bags: events.csv, session.json, trials.csv" in line
    unfit = damaged(tmp_path / "002_dry_0", "short of target")
    assert run(command, ["validate", *everything, str(unfit)]) == 1
    for alone in (tables[:1], tables):
        assert run(command, ["validate", *map(str, alone)]) == 2


def test_the_force_of_a_wrist_is_no_finger(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "arm"
    with BagWriter(path) as bag:
        for i in range(500):
            stamp = START + i * 2_000_000
            for topic in ("/finger/wrench", "/arm/ft/wrench"):
                bag.write(topic, wrench(stamp, 0.1), stamp)
            if i % 50 == 0:
                bag.write("/finger/image_raw", image(stamp, 1e-4), stamp)
    assert run(command, ["validate", str(path)]) == 2
    assert "choose with --namespace" in capsys.readouterr().err
    run(command, ["validate", str(path), "--namespace", "finger", "--json"])
    assert len(json.loads(capsys.readouterr().out)) == 1


def test_each_finger_of_a_hand_is_judged_in_turn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "hand"
    with BagWriter(path) as bag:
        for i in range(1500):
            for finger in ("thumb", "index"):
                if finger == "thumb" or i < 3:
                    stamp = START + i * 2_000_000
                    message = wrench(stamp, press_force(i / 500) + 0.001 * (i % 7))
                    bag.write(f"/hand/{finger}/wrench", message, stamp)
    assert run(command, ["validate", str(path)]) == 1
    out = capsys.readouterr().out
    thumb = out.index(f"{path} /hand/thumb")
    assert out.index(f"{path} /hand/index") < thumb
    # Whole, but a grasp: no word of a bag that is damaged.
    assert "not fit for use" not in out[thumb:]
    assert "fit for 'finger-bag process' and 'play', not for a fit of parameters" in out[thumb:]
    assert run(command, ["validate", str(path), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert [data["namespace"] for data in found] == ["/hand/index", "/hand/thumb"]
    assert run(command, ["validate", str(path), "--namespace", "hand/thumb", "--json"]) == 1
    assert len(json.loads(capsys.readouterr().out)) == 1


def test_a_recording_of_trials_without_areas_is_not_called_fit_for_anything(
    session: Callable[..., Path],
) -> None:
    with open_bag(session(trials=1)) as reader, BagWriter(reader.path.with_name("blind")) as bag:
        for item in reader:
            if not item.topic.endswith(("contact_area", "image_raw")):
                bag.write(item.topic, item.message, item.log_time_ns)
    assert validate(bag.path).verdict == "not fit for use as it is"


def damaged(path: Path, kind: str) -> Path:
    """A session with one thing wrong."""
    rng = np.random.default_rng(0)
    with BagWriter(path, {} if kind == "neither" else {"condition": "dry"}) as bag:
        for number in range(6):
            if kind not in ("no moisture", "neither"):
                phase = 1 if number < 3 else 2
                stamp = START + (0 if number < 3 else 8) * 10**9 + number * 10**8
                late = -3600 * 10**9 if kind == "clock of the probe" else 500_000
                fields = {"header": {"stamp": stamp}, "value": 50.0, "phase": phase}
                bag.write("moisture", fields, stamp + late)
        for i in range(1750):
            t = i * 0.002
            stamp = START + 10**9 + round(t * 1e9)
            force = float(press_force(np.array(t))) + 0.002 * rng.standard_normal()
            log = stamp + 500_000
            shown = force
            if kind == "short of target":
                shown = force * 0.7
            elif kind == "saturated":
                shown = min(force, 1.4)
            elif kind == "coarse":
                shown = round(force / 0.05) * 0.05
            elif kind == "wrong sign":
                shown = -force
            elif kind == "gap" and 500 <= i < 550:
                continue
            elif kind == "slow" and i % 8:
                continue
            elif kind == "stamps back" and i == 900:
                stamp -= 50_000_000
            elif kind == "clock":
                log = stamp + 5_000_000_000
            if kind != "no wrench":
                bag.write("wrench", wrench(stamp, shown), log)
            if i % 50 == 0 and kind != "no area":
                late = 0.3 if kind == "late images" else 0.0
                area = 4e-5 * max(float(press_force(np.array(t - late))), 0.0) ** 0.7
                area = 0.0 if kind == "finger on the plate when it was learned" else area
                fields = {"header": {"stamp": stamp}, "gross_area": area, "flags": 0}
                if kind == "pictures without calibration":
                    bag.write("image_raw", image(stamp, area), log)
                else:
                    bag.write("contact_area", fields, log)
    return path


@pytest.mark.parametrize(
    ("kind", "check"),
    [
        ("no wrench", "topics"),
        ("no area", "topics"),
        ("neither", "moisture"),
        ("short of target", "target force"),
        ("saturated", "saturation"),
        ("wrong sign", "trials"),
        ("gap", "gaps in wrench"),
        ("slow", "rate of wrench"),
        ("stamps back", "stamp order of wrench"),
        ("clock", "log time of wrench"),
        ("clock of the probe", "log time of moisture"),
        ("late images", "sync of force and image"),
        ("pictures without calibration", "calibration"),
        ("finger on the plate when it was learned", "areas"),
    ],
)
def test_each_fault_fails_its_check(
    kind: str, check: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sound = checks(damaged(tmp_path / "sound", "nothing"))
    assert all(status != "fail" for status, _ in sound.values()), sound
    path = damaged(tmp_path / "bag", kind)
    assert checks(path)[check][0] == "fail"
    if kind == "clock of the probe":
        told = "; the earliest reading is stamped 3600.0 s ahead: clocks disagree"
        assert checks(path)[check][1].endswith(told)
    assert run(command, ["validate", str(path)]) == 1


def test_a_force_that_is_rounded_coarsely_is_no_saturated_one(tmp_path: Path) -> None:
    """The top of its presses stays at one value."""
    status, detail = checks(damaged(tmp_path / "bag", "coarse"))["saturation"]
    assert status == "note" and "stays at" in detail


def test_no_moisture_is_needed_where_the_condition_is_named(tmp_path: Path) -> None:
    path = damaged(tmp_path / "bag", "no moisture")
    status, detail = checks(path)["moisture"]
    assert status == "note" and "its condition is named" in detail
    assert run(command, ["validate", str(path)]) == 0


def test_lag_between_force_and_image_is_measured(session: Callable[..., Path]) -> None:
    (trial,) = load_trials(session(trials=1))
    for lag in (-0.2, 0.0, 0.1, 0.25):
        shifted = replace(trial, area_stamp_ns=trial.area_stamp_ns + round(lag * 1e9))
        assert force_image_lag([shifted]) == pytest.approx(lag, abs=0.02)


def test_info_tells_topics_times_and_metadata(
    session: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path = session(trials=1)
    assert run(command, ["info", str(path), "--json"]) == 0
    (data,) = json.loads(capsys.readouterr().out)
    assert data["topics"]["/finger/wrench"] == {
        "type": "geometry_msgs/msg/WrenchStamped",
        "count": 1750,
    }
    assert data["metadata"]["subject"] == "S01" and data["complete"]
    assert run(command, ["info", str(path)]) == 0
    assert "/finger/contact_area" in capsys.readouterr().out


def test_anonymise_drops_images_and_keeps_areas_hulls_and_metadata(
    session: Callable[..., Path], tmp_path: Path
) -> None:
    path = tmp_path / "bag"
    with BagWriter(path, {"subject": "S01"}) as bag:
        bag.attach("plate_calibration.yaml", b"a: 1")
        bag.attach("print.png", b"\x89PNG")
        bag.write("image_raw", {"data": b"PRINTPIXELS"}, START)
        bag.write("image_raw/compressed", {"data": b"PRINTPIXELS"}, START)
        image = {"data": b"PRINTPIXELS"}
        bag.write("contact_image", image, START, message_type="sensor_msgs/msg/Image")
        # Under the name of a known topic, and on one that nothing is known of.
        bag.write("/other/wrench", image, START, message_type="sensor_msgs/msg/Image")
        bag.write("/anything", {"data": "PRINTPIXELS"}, START, message_type="std_msgs/msg/String")
        bag.write("contact_area", {"gross_area": 1e-4, "hull": [{"x": 1.0}]}, START)
    assert run(command, ["anonymise", str(path), "-o", str(tmp_path / "out")]) == 0
    with open_bag(tmp_path / "out") as reader:
        (kept,) = reader.messages()
        assert kept.message.hull[0].x == 1.0
        assert reader.info.attachments == ["plate_calibration.yaml"]
        assert reader.info.metadata.subject == "S01"
    assert not any(b"PRINTPIXELS" in f.read_bytes() for f in (tmp_path / "out").iterdir())


def test_several_bags_are_processed_into_a_folder(
    session: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bags = [session(name, trials=1) for name in ("a", "b")]
    out = tmp_path / "out"
    assert run(command, ["process", *map(str, bags), "-o", str(out), "--jobs", "2"]) == 0
    assert "3500 contact states" in capsys.readouterr().out
    for name in ("a", "b"):
        with open_bag(out / name) as reader:
            assert reader.info.topics["/finger/contact_state"].count == 1750


def test_the_bag_in_this_folder_is_recovered_beside_it(
    session: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = session("S01.1", trials=1)
    monkeypatch.chdir(path)
    assert run(command, ["recover", "."]) == 0
    assert open_bag(path.with_name("S01.1_recovered")).info.topics


@pytest.mark.parametrize("name", ["info", "validate", "process", "recover", "anonymise"])
def test_a_device_or_pipe_is_no_bag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    output = [] if name in ("info", "validate") else ["-o", str(tmp_path / "out")]
    for path in ("/dev/null", str(tmp_path / "pipe.mcap")):
        assert run(command, [name, path, *output]) == 2
        assert f"{path}: is a pipe or a device, not a bag" in capsys.readouterr().err


def test_a_table_is_not_written_over_the_bag_or_another_table(
    session: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = session(trials=1), str(tmp_path / "out")
    table = str(tmp_path / "t.csv")
    for more in (["--csv", table, "--parquet", table], ["--csv", f"{out}/t.csv"]):
        assert run(command, ["process", str(path), "-o", out, *more]) == 2
    assert "lies in the output" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    "option",
    ["--rate=0", "--rate=1e300", "--start=-1", "--start=1e300", "--duration=1e300"]
    + [f"--wait={value}" for value in ("-1", "nan", "1e300")],
)
def test_impossible_times_of_a_replay_are_refused(
    session: Callable[..., Path], capsys: pytest.CaptureFixture[str], option: str
) -> None:
    pytest.importorskip("rclpy")
    assert run(command, ["play", str(session(trials=1)), option]) == 2
    said = capsys.readouterr().err
    assert option.split("=")[0].lstrip("-") in said and said.count("\n") == 1
