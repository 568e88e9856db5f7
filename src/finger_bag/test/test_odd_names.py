# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Names that mean something to a terminal, a shell or a file system are text and no more."""

from __future__ import annotations

import errno
import io
import os
import struct
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from mcap.writer import Writer
from session_bags import START, write_session

from finger_bag.bag_files import find_bags
from finger_bag.cli import command
from finger_bag.copying import recover
from finger_bag.definitions import definition_text, encode
from finger_bag.read_settings import ReadSettings
from finger_bag.reader import open_bag
from finger_bag.recorder import Recorder
from finger_bag.schema import TOPICS
from finger_bag.streams import find_used
from finger_bag.writer import LONGEST_NAME, BagWriter
from finger_common.cli import run
from finger_common.errors import InputError
from finger_offline.trials import load_trials

STRING = encode("std_msgs/msg/String", {"data": "hello"})


def foreign_bag(path: Path, topic: str) -> None:
    """A bag as another program may write it: any text as topic and as metadata."""
    out = io.BytesIO()
    writer = Writer(out)
    writer.start("ros2")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    writer.add_message(writer.register_channel(topic, "cdr", schema), START, STRING, START)
    good = writer.register_channel("/finger/chatter", "cdr", schema)
    writer.add_message(good, START, STRING, START)
    writer.add_metadata("finger_session", {topic: topic, "condition": topic})
    writer.add_attachment(START, START, topic + ".csv", "text/csv", b"1")
    writer.finish()
    path.write_bytes(out.getvalue())


@pytest.mark.parametrize(
    "name", ["[/red]", "[bold", "a" * 300, "\x1b[2J", "$x_{", "../../evil", "é\u202e", "\\"]
)
def test_odd_topics_are_shown_and_never_obeyed(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "inside"
    folder.mkdir()
    path = folder / "bag.mcap"
    foreign_bag(path, name)
    for arguments, codes in (
        (["info", str(path)], {0}),
        (["info", "--json", str(path)], {0}),
        (["validate", str(path)], {1}),
        (["recover", str(path), "-o", str(folder / "out")], {0, 1}),
        (["anonymise", str(path), "-o", str(folder / "other")], {2}),
        (["process", str(path), "-o", str(folder / "processed")], {2}),
        (["play", str(path), "--topics", name], {2}),
    ):
        assert run(command, arguments) in codes, arguments
        text = capsys.readouterr()
        assert "\x1b[2J" not in text.out + text.err and "Traceback" not in text.err
        assert text.err.count("\n") <= 1
    files = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()}
    assert files == {
        "inside/bag.mcap", "inside/out/metadata.yaml", "inside/out/out_0.mcap",
    }  # fmt: skip


@pytest.mark.parametrize("name", ["[red]", "[bold", "bad\udcffname", "$(rm)"])
def test_odd_file_names_are_shown(name: str, tmp_path: Path) -> None:
    """In a process of its own: standard output of a strict encoding."""
    folder = tmp_path / name
    folder.mkdir()
    path = write_session(folder / "bag", trials=1, rate=100)
    call = [sys.executable, "-m", "finger_bag.cli", "info", os.fsencode(path)]
    done = subprocess.run(call, capture_output=True, timeout=120)
    assert done.returncode == 0 and not done.stderr, done.stderr
    assert name.encode(errors="ignore")[:3] in done.stdout


@pytest.mark.parametrize("name", ["a" * 300, "a/" * 3000, "bad\udcffname", "null\x00byte"])
@pytest.mark.parametrize("act", ["info", "validate", "recover", "process", "anonymise"])
def test_impossible_names_are_refused_in_one_sentence(
    act: str, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = str(write_session(tmp_path / "bag", trials=1, rate=100))
    output = ["-o", str(tmp_path / "x")] if act in ("recover", "process", "anonymise") else []
    assert run(command, [act, str(tmp_path / name), *output]) == 2
    if output:
        assert run(command, [act, good, "-o", str(tmp_path / name)]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == (2 if output else 1) and "Traceback" not in text
    assert {p.name for p in tmp_path.iterdir()} == {"bag"}


@pytest.mark.parametrize("size", [241, 250, 255])
def test_a_name_too_long_for_the_files_of_a_bag_leaves_nothing_behind(
    size: int, tmp_path: Path
) -> None:
    """The names of the files in a bag are longer than its own."""
    for begin in (Recorder().start, BagWriter, lambda path: BagWriter(path, in_place=True)):
        with pytest.raises(InputError, match=f"the name has {size} bytes; give one of at most 2"):
            begin(tmp_path / "new" / ("é" * (size // 2) + "x" * (size % 2)))
    assert not list(tmp_path.iterdir())


def test_the_longest_name_is_recorded_in_parts(tmp_path: Path) -> None:
    path = tmp_path / ("a" * (LONGEST_NAME - len("_part999")))
    recorder = Recorder()
    recorder.start(path)
    recorder.stop()
    BagWriter(f"{path}_part999").close()
    assert sorted(names(list(tmp_path.iterdir()))) == [path.name, f"{path.name}_part999"]


@pytest.mark.parametrize("kind", ["loop", "link to a folder", "link to nothing", "pipe"])
def test_an_output_that_is_no_folder_is_refused(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = str(write_session(tmp_path / "bag", trials=1, rate=100))
    out = tmp_path / "out"
    (tmp_path / "empty").mkdir()
    if kind == "pipe":
        os.mkfifo(out)
    else:
        out.symlink_to({"loop": "out", "link to a folder": "empty"}.get(kind, "none"))
    for act in ("recover", "anonymise", "process"):
        assert run(command, [act, good, "-o", str(out)]) == 2
        assert capsys.readouterr().err.count("exists already") == 1
    assert {p.name for p in tmp_path.iterdir()} == {"bag", "empty", "out"}


def test_file_that_is_listed_twice_is_read_once(tmp_path: Path) -> None:
    path = write_session(tmp_path / "bag", trials=1, rate=100)
    with open_bag(path) as reader:
        number = len(list(reader))
    description = path / "metadata.yaml"
    data = yaml.safe_load(description.read_text())
    data["rosbag2_bagfile_information"]["relative_file_paths"] *= 2
    description.write_text(yaml.safe_dump(data))
    with open_bag(path) as reader:
        assert len(list(reader)) == reader.info.message_count == number
        assert any("listed twice" in p for p in reader.all_problems())


@pytest.mark.parametrize("condition", ["../../../evil", "/etc/evil", "..", "$x_{", "\x1b[2J"])
def test_trial_whose_condition_is_no_name_is_left_out(condition: str, tmp_path: Path) -> None:
    path = write_session(tmp_path / "bag", trials=1, rate=100, condition=condition)
    found = load_trials(path)
    assert not found.trials and "is not valid; use letters" in found.exclusions[0].reason

    assert "evil" not in {p.name for p in tmp_path.iterdir()}


def test_surrogates_are_not_written_into_a_bag(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not valid text"):
        BagWriter(tmp_path / "bag", {"subject": "S\udcff1"})
    assert not list(tmp_path.iterdir())


def test_two_programs_cannot_write_one_bag(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as first:
        first.write("moisture", {"header": {"stamp": 10**18}, "value": 1.0})
        with pytest.raises(InputError, match="is being written by another program"):
            BagWriter(tmp_path / "bag")
    with open_bag(tmp_path / "bag") as reader:
        assert reader.info.message_count == 1
    # What a killed program left behind is in nobody's way.
    (tmp_path / ".next.partial").mkdir()
    BagWriter(tmp_path / "next").close()


def test_a_topic_without_messages_is_read_as_such(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Other recorders leave it out of the file's statistics."""
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        for name in ("wrench", "contact_area"):
            kind = TOPICS[name].type
            text = definition_text(kind).encode()
            schema = writer.register_schema(kind, "ros2msg", text)
            channel = writer.register_channel(f"/finger/{name}", "cdr", schema)
            if name == "wrench":
                data = encode(kind, {"header": {"stamp": 10**18}})
                writer.add_message(channel, 10**18, data, 10**18)
        writer.finish()
    assert command(["info", str(tmp_path / "a.mcap")]) == 0
    with open_bag(tmp_path / "a.mcap") as reader:
        assert reader.info.topics["/finger/contact_area"].count == 0
        assert find_used(reader, "contact_area", ReadSettings()) is None


@pytest.mark.parametrize("at", ["finish", "write"])
def test_a_disk_that_is_full_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises((OSError, InputError), match="No space left"):
        with BagWriter(tmp_path / "bag") as bag:
            bag.write("moisture", {"header": {"stamp": 10**18}, "value": 1.0})
            if at == "finish":
                monkeypatch.setattr("finger_bag.writer.os.fsync", full)
            else:
                full()
    assert not list(tmp_path.iterdir())


def test_a_topic_without_a_leading_slash_is_recovered(tmp_path: Path) -> None:
    foreign_bag(tmp_path / "bag.mcap", "chatter")
    made = recover(tmp_path / "bag.mcap", tmp_path / "whole")
    assert made.counts == {"/chatter": 1, "/finger/chatter": 1}
    assert made.problems == [] and not made.lost


def skin(writer: Writer, definition: bytes) -> int:
    schema = writer.register_schema("lab/msg/Skin", "ros2msg", definition)
    return writer.register_channel("/lab/skin", "cdr", schema)


def test_each_message_is_decoded_by_the_definition_it_was_recorded_with(tmp_path: Path) -> None:
    out = io.BytesIO()
    writer = Writer(out)
    writer.start("ros2")
    channels = [
        skin(writer, b"float64 moisture\nfloat64 stretch\n"),
        skin(writer, b"# in percent\nfloat64 moisture\nfloat64 stretch\n"),
        skin(writer, b"float64 stretch\nfloat64 moisture\n"),
    ]
    values = [(42.0, 0.9), (42.0, 0.9), (0.9, 42.0)]
    for number, (channel, pair) in enumerate(zip(channels, values)):
        raw = b"\x00\x01\x00\x00" + struct.pack("<2d", *pair)
        writer.add_message(channel, START + number, raw, START)
    writer.finish()
    (tmp_path / "bag.mcap").write_bytes(out.getvalue())
    with open_bag(tmp_path / "bag.mcap") as reader:
        assert [m.message.moisture for m in reader] == [42.0, 42.0, 42.0]
        assert reader.info.topics["/lab/skin"].count == 3
        with pytest.raises(InputError, match="2 definitions of 'lab/msg/Skin'"):
            reader.decoder("/lab/skin", "lab/msg/Skin")
    made = recover(tmp_path / "bag.mcap", tmp_path / "whole")
    # Comments are no other definition; what one topic of a bag cannot hold is named.
    assert made.message_count == 2 and made.lost
    assert "'/lab/skin' holds 'lab/msg/Skin' with other fields" in made.problems[0]
    with open_bag(tmp_path / "whole") as reader:
        assert [m.message.moisture for m in reader] == [42.0, 42.0]


def names(paths: list[Path]) -> list[str]:
    return [path.name for path in paths]


def test_a_folder_of_sessions_stands_for_all_their_bags(tmp_path: Path) -> None:
    for name in ("S02_a/000_dry_0", "S01_a/001_dry_0", "S01_a/000_dry_0"):
        write_session(tmp_path / "sessions" / name, trials=1, rate=100)
        (tmp_path / "sessions" / name).with_name("session.json").write_text("{}")
    (tmp_path / "sessions" / "current_session").write_text("S02_a")
    found = find_bags([tmp_path / "sessions"])
    assert [str(bag.relative_to(tmp_path / "sessions")) for bag in found] == [
        "S01_a/000_dry_0", "S01_a/001_dry_0", "S02_a/000_dry_0",
    ]  # fmt: skip
    assert find_bags([tmp_path / "sessions" / "S01_a"]) == found[:2]
    with pytest.raises(InputError, match="no bag in this folder"):
        find_bags([tmp_path])
    # Also beside a bag of no session.
    loose = write_session(tmp_path / "sessions" / "take", trials=1, rate=100)
    assert find_bags([tmp_path / "sessions"]) == [*found, loose]


def test_files_are_one_bag_only_where_they_are_numbered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_session(tmp_path / "bag", trials=1, rate=100)
    data = (tmp_path / "bag" / "bag_0.mcap").read_bytes()

    def put(*files: str) -> None:
        for file in files:
            (tmp_path / file).parent.mkdir(exist_ok=True)
            (tmp_path / file).write_bytes(data)

    put("split/S01_0.mcap", "split/S01_1.mcap")
    assert names(find_bags([tmp_path / "split"])) == ["split"]
    put("loose/S01_dry.mcap", "loose/S02_moist.mcap", "dates/1.5N.mcap", "dates/1.7N.mcap")
    assert names(find_bags([tmp_path / "loose"])) == ["S01_dry.mcap", "S02_moist.mcap"]
    assert names(find_bags([tmp_path / "dates"])) == ["1.5N.mcap", "1.7N.mcap"]
    put("stray.mcap")
    everything = ["bag", "1.5N.mcap", "1.7N.mcap", "S01_dry.mcap", "S02_moist.mcap"]
    assert names(find_bags([tmp_path])) == [*everything, "split", "stray.mcap"]
    assert run(command, ["play", str(tmp_path / "loose")]) == 2
    error = capsys.readouterr().err
    assert "holds several bags (S01_dry.mcap, S02_moist.mcap); give one of them" in error
