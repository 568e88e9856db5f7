# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Damaged and hostile bags give a clear error or partial result, in bounded time and memory."""

from __future__ import annotations

import json
import os
import sqlite3
import struct
import subprocess
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import mutations
import numpy as np
import pytest
import yaml
from recorded_messages import read_all
from session_bags import START, wrench, write_session

from finger_bag.bag_files import find_bags
from finger_bag.cli import command
from finger_bag.copying import anonymise, recover
from finger_bag.definitions import encode
from finger_bag.mapping import TopicMapping
from finger_bag.mcap_file import McapFile
from finger_bag.read_settings import ReadSettings
from finger_bag.reader import open_bag
from finger_bag.validate import validate
from finger_bag.writer import BagWriter
from finger_common.cli import run
from finger_common.errors import InputError
from finger_offline.trials import load_trials

SECONDS_PER_BAG = 10.0


def outcome(path: Path, folder: Path) -> str:
    """What each tool makes of a bag; anything but a result or an InputError fails the test."""
    began = time.process_time()  # of this process: other work on the machine does not count
    try:
        good, problems = read_all(path)
        result = "whole" if not problems else "part" if good else "nothing"
    except InputError as error:
        assert str(error) and "\n" not in str(error)
        result = "refused"
    for tool in (
        lambda: validate(path),
        lambda: load_trials(path),
        lambda: recover(path, folder / "recovered"),
        lambda: anonymise(path, folder / "anonymous"),
    ):
        try:
            tool()
        except InputError as error:
            assert str(error)
    assert time.process_time() - began < SECONDS_PER_BAG
    return result


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("original")
    path = write_session(folder / "bag", trials=1, chunk_size=4000, rate=100)
    return (path / "bag_0.mcap").read_bytes()


def fuzz(original: bytes, folder: Path, count: int, seed: int) -> Counter[tuple[str, str]]:
    import shutil

    rng = np.random.default_rng(seed)
    found: Counter[tuple[str, str]] = Counter()
    for number in range(count):
        mutate = mutations.MUTATIONS[number % len(mutations.MUTATIONS)]
        place = folder / "case"
        place.mkdir()
        path = place / "bag.mcap"
        path.write_bytes(mutate(original, rng))
        try:
            result = outcome(path, place)
        except Exception:
            # Every case runs before the test fails, so that one run shows every finding.
            traceback.print_exc(file=sys.stdout)
            result = "FAILED"
        found[(mutate.__name__, result)] += 1
        beside = {p.name for p in place.iterdir()}
        assert beside <= {"bag.mcap", "recovered", "anonymous"}, beside
        shutil.rmtree(place)
    return found


def test_a_few_hundred_mutated_bags(original: bytes, tmp_path: Path) -> None:
    found = fuzz(original, tmp_path, 18 * len(mutations.MUTATIONS), seed=1)
    results = Counter()
    for (_, result), count in found.items():
        results[result] += count
    # Most damage is local: most of the bag is still given.
    assert results["part"] > 0.4 * results.total()
    assert results["refused"] < 0.2 * results.total()
    assert not results["FAILED"]


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_thousands_of_mutated_bags(
    original: bytes, tmp_path: Path, record_property: Callable[[str, Any], None]
) -> None:
    count = int(os.environ.get("FINGER_FUZZ_BAGS", "5500"))
    found = fuzz(original, tmp_path, count, seed=int(os.environ.get("FINGER_FUZZ_SEED", "2")))
    record_property("bags", count)
    table = {f"{k[0]}: {k[1]}": v for k, v in sorted(found.items())}
    print(json.dumps(table, indent=1))
    assert found.total() == count
    assert not sum(n for (_, result), n in found.items() if result == "FAILED")


def test_flipped_bit_costs_one_chunk(original: bytes, tmp_path: Path) -> None:
    chunks = [(a, b) for opcode, a, b in mutations.records(original) if opcode == 6]
    begin, end = chunks[len(chunks) // 2]
    data = bytearray(original)
    data[(begin + end) // 2] ^= 1
    whole, damaged = tmp_path / "whole.mcap", tmp_path / "damaged.mcap"
    whole.write_bytes(original)
    damaged.write_bytes(bytes(data))
    total, _ = read_all(whole)
    rest, problems = read_all(damaged)
    assert total * (1 - 2 / len(chunks)) < rest < total
    assert len(problems) == 1 and "chunk at byte" in problems[0]


def test_cut_off_bag_gives_everything_before_the_cut(original: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    chunks = [(a, b) for opcode, a, b in mutations.records(original) if opcode == 6]
    path.write_bytes(original[: chunks[-1][0] + 20])
    rest, problems = read_all(path)
    last = tmp_path / "last.mcap"
    last.write_bytes(original)
    with McapFile(last) as file:
        expected = sum(len(file.block(r).times) for r in file.regions[:-1])
    assert rest == expected > 300
    assert any("not closed" in p for p in problems)


def test_a_file_of_which_nothing_can_be_read_is_refused_by_info(
    original: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cut.mcap"
    begin, _ = next((a, b) for opcode, a, b in mutations.records(original) if opcode == 6)
    path.write_bytes(original[: begin + 20])
    assert run(command, ["info", str(path)]) == 2
    assert "cut.mcap: nothing of it can be read" in capsys.readouterr().err


def test_damage_in_the_middle_does_not_hide_what_follows(original: bytes, tmp_path: Path) -> None:
    chunks = [(a, b) for opcode, a, b in mutations.records(original) if opcode == 6]
    begin = chunks[2][0]
    data = original[:begin] + b"\xff" * 300 + original[begin + 300 :]
    path = tmp_path / "hole.mcap"
    path.write_bytes(data)
    with McapFile(path) as file:
        assert len(file.regions) == len(chunks) - 1
        assert file.complete


@pytest.mark.parametrize("left", [0.0, 0.3, 0.7, 0.995])
@pytest.mark.parametrize("hole", [False, True])
def test_a_file_that_becomes_shorter_while_it_is_read_gives_what_is_left(
    left: float, hole: bool, original: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "short.mcap"
    path.write_bytes(original)
    kept = int(left * len(original))
    chunks = [(a, b) for opcode, a, b in mutations.records(original) if opcode == 6]
    whole = sum(end <= kept for _, end in chunks)
    with McapFile(path) as file, open(path, "r+b") as other:
        if hole:  # after which the next chunk is searched for
            other.seek(chunks[2][0])
            other.write(b"\xff" * 300)
            whole = max(0, whole - 1) if whole > 2 else whole
        other.truncate(kept)
        other.flush()
        found = [file.block(region) for region in file.regions]
        assert sum(len(block.times) > 0 for block in found) == whole
        assert file.lost and not file.complete
        assert "the file became shorter while it was read" in file.problems


def test_an_attachment_that_is_gone_is_no_attachment(tmp_path: Path) -> None:
    picture = bytes(100_000)
    with BagWriter(tmp_path / "bag") as writer:
        writer.attach("plate.png", picture)
    path = tmp_path / "bag" / "bag_0.mcap"
    with McapFile(path) as file:
        (entry,) = file.attachments
        assert file.attachment(entry) == picture
        os.truncate(path, entry.offset + 50_000)
        assert file.attachment(entry) is None
        assert file.lost and file.problems == ["the file became shorter while it was read"]


def test_a_file_that_becomes_shorter_before_its_summary_is_read(
    original: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "short.mcap"
    path.write_bytes(original)
    read_summary = McapFile._read_summary

    def later(file: McapFile) -> bool:
        os.truncate(path, len(original) // 2)
        return read_summary(file)

    monkeypatch.setattr(McapFile, "_read_summary", later)
    with McapFile(path) as file:
        assert file.regions and file.channels
        assert file.lost and "the file became shorter while it was read" in file.problems


HOSTILE = {
    "empty": b"",
    "only magic": mutations.MAGIC,
    "text": b"not a bag at all\n" * 100,
    "header alone": mutations.header(),
    "no messages": mutations.header() + mutations.ending(),
    "huge record": mutations.header() + b"\x05" + b"\xff" * 8 + b"xx",
    "endless empty records": mutations.header() + (b"\x80" + bytes(8)) * 50_000,
    "unknown compression": mutations.header()
    + mutations.chunk(b"", b"abc", 3, b"brotli")
    + mutations.ending(),
    "self-containing type": mutations.deep_schema(),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_end_with_one_sentence(name: str, tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    path.write_bytes(HOSTILE[name])
    outcome(path, tmp_path)
    with pytest.raises(InputError) as caught:
        load_trials(path)
    assert "bag.mcap" in str(caught.value) and "\n" not in str(caught.value)


MEASURED = """
import resource, sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from recorded_messages import read_all
from finger_common.errors import InputError
base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
began = time.process_time()
try:
    print(read_all(Path(sys.argv[1])))
except InputError as error:
    print(error)
grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base) / 1024
print(f"{grown:.0f} {time.process_time() - began:.1f}")
"""


@pytest.mark.parametrize(
    ("make", "megabytes"),
    [
        (mutations.truthful_bomb, 200),
        (mutations.lying_bomb, 200),
        (lambda: mutations.many_bombs(8), 300),
    ],
    ids=["8 GiB claimed", "more than claimed", "many at the limit"],
)
def test_zip_bombs_stay_small(make: Callable[[], bytes], megabytes: int, tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(make())
    assert path.stat().st_size < 2_000_000
    out = subprocess.run(
        [sys.executable, "-c", MEASURED, str(path), str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert out.returncode == 0, out.stderr
    grown, seconds = map(float, out.stdout.splitlines()[-1].split())
    assert grown < megabytes
    assert seconds < 60


def test_attachment_names_never_become_paths(tmp_path: Path) -> None:
    path = tmp_path / "inside" / "bag.mcap"
    path.parent.mkdir()
    path.write_bytes(mutations.attachment_tricks())
    made = recover(path, tmp_path / "inside" / "recovered")
    assert made.message_count == 1
    files = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()}
    assert files == {
        "inside/bag.mcap",
        "inside/recovered/metadata.yaml",
        "inside/recovered/recovered_0.mcap",
    }
    with open_bag(made.path) as reader:
        assert "../../escaped.yaml" in reader.info.attachments  # kept as text


@pytest.mark.parametrize(
    "entry", ["../outside.mcap", "/etc/passwd", "..", "", "nothing.mcap", "bag_0.mcap\x00"]
)
def test_file_names_in_metadata_never_lead_out(entry: str, tmp_path: Path) -> None:
    write_session(tmp_path / "bag", trials=1)
    (tmp_path / "outside.mcap").write_bytes((tmp_path / "bag" / "bag_0.mcap").read_bytes())
    description = tmp_path / "bag" / "metadata.yaml"
    data = yaml.safe_load(description.read_text())
    data["rosbag2_bagfile_information"]["relative_file_paths"] = [entry]
    description.write_text(yaml.safe_dump(data))
    with open_bag(tmp_path / "bag") as reader:
        assert all(f.parent == tmp_path / "bag" for f in reader.info.files)


@pytest.mark.parametrize(
    "text", ["", "[1, 2]", "{", "rosbag2_bagfile_information: 3", "a: &a [*a]\n", "\x00\x01"]
)
def test_broken_metadata_does_not_hide_the_files(text: str, tmp_path: Path) -> None:
    path = write_session(tmp_path / "bag", trials=1)
    (path / "metadata.yaml").write_text(text)
    good, problems = read_all(path)
    assert good > 1700 and any("metadata.yaml" in p for p in problems)


def test_broken_sqlite_is_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for number, data in enumerate(
        [b"", b"SQLite format 3\x00" + bytes(84), rng.bytes(5000), b"SQLite format 3\x00" * 100]
    ):
        path = tmp_path / f"bag{number}.db3"
        path.write_bytes(data)
        with pytest.raises(InputError, match=r"sqlite3 bag"):
            open_bag(path)


def test_a_database_that_computes_its_messages_is_refused(tmp_path: Path) -> None:
    """Of 300 MB each, from a file of 24 kB."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3):
        pass
    with closing(sqlite3.connect(tmp_path / "bag" / "bag.db3")) as database:
        database.execute("DROP TABLE messages")
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB AS (zeroblob(300000000)))"
        )
        database.execute("INSERT INTO messages(topic_id, timestamp) VALUES (1, 1)")
        database.commit()
    with pytest.raises(InputError, match="computes its column 'data'"):
        open_bag(tmp_path / "bag")


def test_mutated_sqlite_bags(tmp_path: Path) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / "good", version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        connection = bag.add_connection("/chatter", "std_msgs/msg/String", typestore=types)
        message = types.types["std_msgs/msg/String"]("hello")
        for i in range(300):
            bag.write(connection, i, types.serialize_cdr(message, "std_msgs/msg/String"))
    original = (tmp_path / "good" / "good.db3").read_bytes()
    rng = np.random.default_rng(4)
    simple = mutations.MUTATIONS[:8]
    results: Counter[str] = Counter()
    for number in range(80):
        path = tmp_path / f"bag{number}.db3"
        path.write_bytes(simple[number % len(simple)](original, rng))
        try:
            _, problems = read_all(path)
            results["part" if problems else "whole"] += 1
        except InputError as error:
            assert str(error)
            results["refused"] += 1
    assert results.total() == 80 and results["refused"] < 80


def test_messages_far_out_of_order_stay_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("finger_bag.reader.MAXIMUM_PENDING", 20_000)
    with BagWriter(tmp_path / "bag", chunk_size=4000) as bag:
        for i in range(1000):
            # Every chunk spans the whole time.
            bag.write("wrench", wrench(START + (i % 40) * 10**9 + i, 1.0))
    with open_bag(tmp_path / "bag") as reader:
        times = [m.log_time_ns for m in reader.messages()]
        assert len(times) == 1000
        assert any("out of order" in p for p in reader.all_problems())


def test_a_folder_of_ros_1_bags_is_refused_with_the_remedy(tmp_path: Path) -> None:
    (tmp_path / "press.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    for path in (tmp_path, tmp_path / "press.bag"):
        with pytest.raises(InputError, match=r"ROS 1 bag.*rosbags-convert --src"):
            for bag in find_bags([path]):
                open_bag(bag)


def test_malformed_messages_are_left_out_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as bag:
        for i in range(200):
            bag.write("wrench", wrench(START + i * 2_000_000, 1.0))
            if i % 50 == 0:
                bag.write_raw("wrench", b"\x00\x01\x00\x00short", START + i * 2_000_000)
                bag.write_raw("contact_area", b"\x00\x01\x00\x00" + b"\xff" * 40, START + i)
                bag.write("contact_area", {"header": {"stamp": START + i * 2_000_000}})
    found = load_trials(path)
    assert any("'/finger/wrench': 4 malformed" in p for p in found.problems)
    assert any("'/finger/contact_area': 4 malformed" in p for p in found.problems)
    checks = {c.name: c for c in validate(path).checks}
    assert checks["file"].status == "fail" and "malformed" in checks["file"].detail


def test_impossible_times_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as bag:
        for time_ns in (START, 1 << 63, (1 << 64) - 1, START + 1):
            bag.write("contact_area", {"header": {"stamp": START}}, time_ns)
            bag.write("wrench", wrench(START, 1.0), time_ns)
    with open_bag(path) as reader:
        assert len(list(reader.messages())) == 4
        assert any("2262" in p for p in reader.all_problems())
    validate(path)


def test_png_that_claims_gigapixels_is_not_decoded() -> None:
    from types import SimpleNamespace

    from finger_vision.messages import image_of

    size = (1 << 20).to_bytes(4, "big")
    data = b"\x89PNG\r\n\x1a\n" + b"\x00\x00\x00\rIHDR" + size * 2 + b"\x08\x00\x00\x00\x00" * 9
    with pytest.raises(InputError, match="1048576 x 1048576"):
        image_of(SimpleNamespace(format="mono8; png compressed ", data=data))
    with pytest.raises(InputError, match="can be decoded"):
        image_of(SimpleNamespace(format="jpeg", data=b"nothing"))


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"time_s,force_n\n0,1\n", "a CSV, not MCAP: use 'finger-model simulate --force'"),
        (b"some notes\n", "text, not MCAP"),
        (b"#ROSBAG V2.0\n", "a ROS 1 bag"),
        (b"SQLite format 3\x00", "a sqlite3 database"),
        (b"\x89PNG\r\n\x1a\n", "a PNG image"),
        (bytes(20), "not MCAP"),
    ],
)
def test_a_file_of_another_kind_is_named_with_the_remedy(
    content: bytes, kind: str, tmp_path: Path
) -> None:
    path = tmp_path / "bag.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match=kind):
        open_bag(path)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("bits", [0x7FF0000000000001, 0xFFF0000000000000, 0x7FEFFFFFFFFFFFFF])
def test_forces_that_are_no_numbers_give_no_warning(tmp_path: Path, bits: int) -> None:
    """A NaN that signals, as flipped bits make it; infinity; the largest number."""
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("wrench")
        for k in range(1000):
            cdr = encode("geometry_msgs/msg/WrenchStamped", wrench(START + 2_000_000 * k, 0.125))
            if k % 10 == 0:
                cdr = cdr.replace(struct.pack("<d", -0.125), struct.pack("<Q", bits))
            bag.write_raw("wrench", cdr, START + 2_000_000 * k)
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text("topics: {wrench: {topic: /finger/wrench, unit: kgf}}\n")
    for settings in (ReadSettings(), ReadSettings(mapping=TopicMapping.load(str(mapping)))):
        assert not validate(tmp_path / "bag", settings).fit
