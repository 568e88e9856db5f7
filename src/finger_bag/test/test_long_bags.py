# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Long bags: every message is read, memory stays flat, `info` answers from the summary."""

from __future__ import annotations

import struct
import time
import tracemalloc
from pathlib import Path

import mutations
import pytest
from session_bags import START, wrench, write_session

from finger_bag import mcap_file
from finger_bag.cli import command
from finger_bag.definitions import encode
from finger_bag.mcap_writer import McapWriter
from finger_bag.reader import open_bag
from finger_bag.writer import BagWriter
from finger_common.cli import run

WRENCH = encode("geometry_msgs/msg/WrenchStamped", wrench(START, 1.0))


def test_every_message_of_a_long_bag_is_read_in_flat_memory(tmp_path: Path) -> None:
    """12 h scaled: as many chunks and message indexes as such a bag has, in small chunks."""
    topics = ["wrench", "wrench_raw", *(f"/extra_{i}" for i in range(9))]
    with BagWriter(tmp_path / "bag", chunk_size=1000) as bag:
        for topic in topics[2:]:
            bag.add_topic(topic, "geometry_msgs/msg/WrenchStamped")
        for i in range(60_000):
            bag.write_raw(topics[i % len(topics)], WRENCH, START + i * 2_000_000)
        written = bag.counts
    peaks = []
    with open_bag(tmp_path / "bag") as reader:
        assert len(reader._mcaps[0].regions) > 6_000
        found = dict.fromkeys(written, 0)
        tracemalloc.start()
        for number, message in enumerate(reader):
            found[message.topic] += 1
            if number in (20_000, 59_999):
                peaks.append(tracemalloc.get_traced_memory()[1])
                tracemalloc.reset_peak()
        tracemalloc.stop()
        assert found == written and reader.all_problems() == []
    assert peaks[1] < 1.2 * peaks[0] + 1e6
    assert run(command, ["recover", str(tmp_path / "bag"), "-o", str(tmp_path / "copy")]) == 0
    with open_bag(tmp_path / "copy") as reader:
        assert reader.info.message_count == 60_000


def test_a_million_records_without_messages_end_nothing(tmp_path: Path) -> None:
    path = write_session(tmp_path / "bag", trials=1, rate=100)
    data = (path / "bag_0.mcap").read_bytes()
    begin = mutations.records(data)[0][2]
    idle = (b"\x80" + bytes(8)) * 1_010_000
    (tmp_path / "idle.mcap").write_bytes(data[:begin] + idle + data[begin:])
    with open_bag(path) as reader, open_bag(tmp_path / "idle.mcap") as with_idle:
        assert len(list(with_idle)) == len(list(reader)) == reader.info.message_count
        assert with_idle.all_problems() == []


def test_info_of_10_gigabytes_comes_from_the_summary(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with open(path, "wb") as stream:
        writer = McapWriter(stream, 100, "none")
        writer.write_header("ros2", "test")
        schema = writer.register_schema("geometry_msgs/msg/WrenchStamped", "", b"")
        channel = writer.register_channel("/finger/wrench", schema, {})
        for i in range(10_000):
            writer.add_message(channel, START + i, WRENCH, START + i, i)
            # A hole, as a record that readers pass over: each chunk stands for a megabyte.
            stream.write(struct.pack("<BQ", 0x80, 1_000_000))
            stream.seek(1_000_000, 1)
            writer.size += 1_000_009
        writer.finish()
    assert path.stat().st_size > 10e9
    began = time.process_time()
    with open_bag(path) as reader:
        assert reader.info.message_count == 10_000 and reader.info.end_ns == START + 9_999
        assert reader.info.complete
    assert time.process_time() - began < 2.0


def test_a_summary_that_does_not_fit_is_not_believed(tmp_path: Path) -> None:
    path = write_session(tmp_path / "bag", trials=1, rate=100)
    data = bytearray((path / "bag_0.mcap").read_bytes())
    statistics = next(r for r in mutations.records(bytes(data)) if r[0] == 11)
    data[statistics[1] + 9] ^= 1  # the number of messages
    (tmp_path / "other.mcap").write_bytes(bytes(data))
    with open_bag(path) as reader, open_bag(tmp_path / "other.mcap") as other:
        assert len(list(other)) == reader.info.message_count
        assert other.info.start_ns == reader.info.start_ns


@pytest.mark.parametrize("limit", ["FREE_MESSAGES", "FREE_BYTES", "PLAIN_CHUNK"])
def test_a_reader_that_stops_early_never_exits_0(
    limit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(write_session(tmp_path / "bag", trials=1, rate=100))
    monkeypatch.setattr(mcap_file, limit, 100)
    for name in ("STORED_PER_MESSAGE", "_RATIO", "BYTES_PER_STORED"):
        monkeypatch.setattr(mcap_file, name, 10**9 if name[0] == "S" else 0)
    for arguments in (
        ["info", "--count", path],
        ["validate", path],
        ["recover", path, "-o", str(tmp_path / "recovered")],
        ["anonymise", path, "-o", str(tmp_path / "anonymous")],
        ["process", path, "-o", str(tmp_path / "processed")],
    ):
        assert run(command, arguments) != 0, arguments
    text = capsys.readouterr()
    assert "not all are read" in text.out or "not read" in text.out


def test_lost_chunks_end_with_1_and_a_cut_end_with_0(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_session(tmp_path / "bag", trials=1, rate=100, chunk_size=4000)
    data = (path / "bag_0.mcap").read_bytes()
    chunks = [(a, b) for opcode, a, b in mutations.records(data) if opcode == 6]
    middle = sum(chunks[3]) // 2
    (tmp_path / "hole.mcap").write_bytes(data[:middle] + b"\xff" + data[middle + 1 :])
    (tmp_path / "cut.mcap").write_bytes(data[: chunks[-1][0] + 20])
    for name, code in (("hole", 1), ("cut", 0)):
        out = str(tmp_path / f"{name}_recovered")
        assert run(command, ["recover", str(tmp_path / f"{name}.mcap"), "-o", out]) == code
        assert "problem: " in capsys.readouterr().out
        with open_bag(out) as reader:
            assert reader.info.complete and len(list(reader)) > 300
