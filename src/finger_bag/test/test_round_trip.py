# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Independent readers read what this package writes, and the other way round."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as McapRos2Writer
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from session_bags import START, wrench

from finger_bag.copying import recover
from finger_bag.definitions import definition_text, type_hash
from finger_bag.reader import open_bag
from finger_bag.recorder import RecorderSettings
from finger_bag.writer import BagWriter, add_message
from finger_common.errors import InputError

DISTRIBUTIONS = [
    Stores.ROS2_HUMBLE,
    Stores.ROS2_IRON,
    Stores.ROS2_JAZZY,
    Stores.ROS2_KILTED,
    *([Stores.ROS2_LYRICAL] if hasattr(Stores, "ROS2_LYRICAL") else []),
]


def content(path: Path) -> list[tuple[Any, ...]]:
    with open_bag(path) as reader:
        found = [(m.topic, m.type, m.log_time_ns, m.raw) for m in reader.messages()]
        assert reader.all_problems() == []
    return found


def test_rosbags_reads_equal_bytes_types_and_times(session: Callable[..., Path]) -> None:
    path = session()
    with AnyReader([path]) as reader:
        theirs = [(c.topic, c.msgtype, t, bytes(raw)) for c, t, raw in reader.messages()]
        metadata = reader.topics
        assert reader.message_count == len(theirs)
        with open_bag(path) as ours:
            counts = {n: t.count for n, t in ours.info.topics.items()}
        assert {n: t.msgcount for n, t in metadata.items()} == counts
    assert sorted(theirs) == sorted(content(path))


def test_rosbags_decodes_equal_values(session: Callable[..., Path]) -> None:
    path = session(trials=1)
    with AnyReader([path]) as theirs, open_bag(path) as ours:
        connections = [c for c in theirs.connections if c.topic == "/finger/contact_area"]
        there = [theirs.deserialize(raw, c.msgtype) for c, _, raw in theirs.messages(connections)]
        here = [m.message for m in ours.messages(["/finger/contact_area"])]
    assert len(here) == len(there) == 35
    for a, b in zip(here, there):
        assert a.gross_area == b.gross_area and a.hull[0].y == b.hull[0].y
        assert a.header.stamp.nanosec == b.header.stamp.nanosec


def test_mcap_library_reads_equal_values_and_all_checksums(session: Callable[..., Path]) -> None:
    path = session(trials=1)
    with (path / "session_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        theirs = [
            (channel.topic, message.log_time, decoded)
            for _, channel, message, decoded in reader.iter_decoded_messages()
        ]
        assert next(iter(reader.iter_metadata())).metadata["subject"] == "S01"
    with open_bag(path) as ours:
        messages = list(ours.messages())
    assert [(m.topic, m.log_time_ns) for m in messages] == [t[:2] for t in theirs]
    forces = [m.message.wrench.force.z for m in messages if m.topic == "/finger/wrench"]
    assert forces == [d.wrench.force.z for t, _, d in theirs if t == "/finger/wrench"]
    assert len(forces) == 1750


def test_metadata_yaml_holds_what_rosbag2_needs(session: Callable[..., Path]) -> None:
    data = yaml.safe_load((session() / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert data["storage_identifier"] == "mcap"
    assert data["relative_file_paths"] == ["session_0.mcap"]
    assert data["message_count"] == sum(
        t["message_count"] for t in data["topics_with_message_count"]
    )
    by_name = {t["topic_metadata"]["name"]: t for t in data["topics_with_message_count"]}
    for name, durability in (("/finger/trial", 1), ("/finger/wrench", 2)):
        qos = yaml.safe_load(by_name[name]["topic_metadata"]["offered_qos_profiles"])
        # Latched or not on replay, and reliable, so that every reader hears it.
        assert (qos[0]["durability"], qos[0]["reliability"]) == (durability, 1)
    assert data["custom_data"]["finger_session.subject"] == "S01"


def write_with_rosbags(path: Path, store: Stores, **options: Any) -> list[bytes]:
    """A bag with wrench and moisture written by rosbags with a distribution's own definitions."""
    types = get_typestore(store)
    moisture = (Path(__file__).parents[1] / "finger_bag/data/finger_msgs/Moisture.msg").read_text()
    types.register(get_types_from_msg(moisture, "finger_msgs/msg/Moisture"))
    T = types.types
    raws = []
    with Writer(path, version=9, **options) as bag:
        connections = {
            name: bag.add_connection(name, kind, typestore=types)
            for name, kind in (
                ("/finger/wrench", "geometry_msgs/msg/WrenchStamped"),
                ("/finger/moisture", "finger_msgs/msg/Moisture"),
            )
        }
        for i in range(200):
            stamp = START + i * 2_000_000
            time = T["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
            header = T["std_msgs/msg/Header"](time, "ft")
            vector = T["geometry_msgs/msg/Vector3"]
            message = T["geometry_msgs/msg/WrenchStamped"](
                header,
                T["geometry_msgs/msg/Wrench"](vector(0.0, 0.0, -0.01 * i), vector(0.0, 0.0, 0.0)),
            )
            raws.append(bytes(types.serialize_cdr(message, message.__msgtype__)))
            bag.write(connections["/finger/wrench"], stamp, raws[-1])
        reading = T["finger_msgs/msg/Moisture"](header, 69.5, 4, 1, "serial", 0)
        raws.append(bytes(types.serialize_cdr(reading, reading.__msgtype__)))
        bag.write(connections["/finger/moisture"], stamp + 1, raws[-1])
    return raws


@pytest.mark.parametrize("store", DISTRIBUTIONS, ids=lambda s: s.name)
@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_bags_of_other_distributions_are_read(
    tmp_path: Path, store: Stores, plugin: StoragePlugin
) -> None:
    raws = write_with_rosbags(tmp_path / "bag", store, storage_plugin=plugin)
    with open_bag(tmp_path / "bag") as reader:
        messages = list(reader.messages())
        assert [m.raw for m in messages] == raws
        assert messages[-1].message.value == 69.5
        assert messages[150].message.wrench.force.z == -1.5
        assert reader.info.topics["/finger/wrench"].count == 200
        assert reader.all_problems() == []


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_compressed_bags_are_read(
    tmp_path: Path, mode: CompressionMode, plugin: StoragePlugin
) -> None:
    path = tmp_path / "bag"
    types = get_typestore(Stores.ROS2_JAZZY)
    bag = Writer(path, version=9, storage_plugin=plugin)
    bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        connection = bag.add_connection("/chatter", "std_msgs/msg/String", typestore=types)
        message = types.types["std_msgs/msg/String"]("hello")
        for i in range(20):
            raw = types.serialize_cdr(message, "std_msgs/msg/String")
            bag.write(connection, START + i, raw)
    with open_bag(path) as reader:
        assert [m.message.data for m in reader.messages()] == ["hello"] * 20
    # As a recorder of ROS leaves it that was killed.
    (path / "metadata.yaml").unlink()
    made = recover(path, tmp_path / "made")
    with open_bag(made.path) as reader:
        assert [m.message.data for m in reader.messages()] == ["hello"] * 20
        assert reader.all_problems() == []


def test_metadata_that_tell_of_compression_where_there_is_none_are_not_believed(
    tmp_path: Path,
) -> None:
    path = tmp_path / "bag"
    raws = write_with_rosbags(path, Stores.ROS2_JAZZY, storage_plugin=StoragePlugin.MCAP)
    text = (path / "metadata.yaml").read_text()
    text = re.sub("compression_mode: .*", "compression_mode: message", text)
    text = re.sub("compression_format: .*", "compression_format: zstd", text)
    (path / "metadata.yaml").write_text(text)
    with open_bag(path) as reader:
        assert [m.raw for m in reader.messages()] == raws and not reader.lost


@pytest.mark.parametrize("beside", ["bag_1.mcap", "bag_0.mcap.zstd"])
def test_a_file_that_the_metadata_do_not_list_is_named(tmp_path: Path, beside: str) -> None:
    """But for the other form of a file that is listed: ROS unpacks a file that it reads."""
    path = tmp_path / "bag"
    with BagWriter(path) as bag:
        bag.write("wrench", wrench(START, 1.0))
    (path / beside).write_bytes((path / "bag_0.mcap").read_bytes())
    lost = beside == "bag_1.mcap"
    with open_bag(path) as reader:
        assert len(list(reader.messages())) == 1
        assert any(beside in problem for problem in reader.all_problems()) == lost
        assert reader.lost == lost
    assert recover(path, tmp_path / "made").lost == lost
    # A message that is added later takes no file's place.
    size = (path / beside).stat().st_size
    add_message(path, "/finger/note", "std_msgs/msg/String", {"data": "later"}, START + 1)
    assert (path / beside).stat().st_size == size
    with open_bag(path) as reader:
        assert [m.topic for m in reader.messages()] == ["/finger/wrench", "/finger/note"]


def test_file_of_the_mcap_library_is_read(tmp_path: Path) -> None:
    path = tmp_path / "plain.mcap"
    with path.open("wb") as file, McapRos2Writer(file) as writer:
        schema = writer.register_msgdef(
            "finger_msgs/Moisture", definition_text("finger_msgs/msg/Moisture")
        )
        for i in range(10):
            reading = {"header": {"stamp": {"sec": i}}, "value": float(i), "source": "manual"}
            writer.write_message("/moisture", schema, reading, START + i, START)
    with open_bag(path) as reader:
        messages = list(reader.messages())
        assert [m.message.value for m in messages] == [float(i) for i in range(10)]
        assert messages[0].type == "finger_msgs/msg/Moisture"
        assert reader.topic("moisture") == "/moisture"


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_every_compression_gives_the_same_messages(tmp_path: Path, compression: str) -> None:
    with BagWriter(tmp_path / "bag", compression=compression, chunk_size=2000) as bag:
        for i in range(500):
            bag.write("wrench", wrench(START + i, 0.01 * i))
    found = content(tmp_path / "bag")
    assert [t[2] for t in found] == list(range(START, START + 500))


def test_messages_written_out_of_order_come_in_order_of_log_time(tmp_path: Path) -> None:
    times = np.random.default_rng(1).permutation(3000) * 1_000_000 + START
    with BagWriter(tmp_path / "bag", chunk_size=5000) as bag:
        for t in times:
            bag.write("wrench", wrench(int(t), 1.0))
    found = [t[2] for t in content(tmp_path / "bag")]
    assert found == sorted(times.tolist())
    with open_bag(tmp_path / "bag") as reader:
        cut = [m.log_time_ns for m in reader.messages(start=START + 10**9, stop=START + 2 * 10**9)]
    assert cut == [t for t in found if START + 10**9 <= t < START + 2 * 10**9]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_one_topic_may_be_named_and_what_would_give_nothing_is_refused(
    tmp_path: Path, storage: str
) -> None:
    if storage == "mcap":
        with BagWriter(tmp_path / "bag", chunk_size=1000) as bag:
            for i in range(200):
                bag.write("wrench", wrench(START + i, 0.01 * i))
    else:
        store = get_typestore(Stores.ROS2_JAZZY)
        with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as sqlite:
            name = "std_msgs/msg/String"
            topic = sqlite.add_connection("/finger/wrench", name, typestore=store)
            data = store.serialize_cdr(store.types[name]("a"), name)
            for i in range(200):
                sqlite.write(topic, START + i, data)
    with open_bag(tmp_path / "bag") as reader:
        assert len(list(reader.messages("/finger/wrench"))) == 200
        assert len(list(reader.messages("/finger/wrench", np.int64(START + 50)))) == 150
        for times in ({"start": START * 1e-9}, {"stop": float(START)}):
            with pytest.raises(InputError, match=r"whole nanoseconds are needed"):
                reader.messages(**times)
        begun = reader.messages("/finger/wrench")
        assert next(begun).log_time_ns == START
        later = reader.messages("/finger/wrench")
    for messages in (reader.messages(), later, begun):
        with pytest.raises(InputError, match="bag: the bag is closed; read its messages before"):
            list(messages)


def test_splits_by_size_and_time_read_as_one_bag(tmp_path: Path) -> None:
    def write(name: str, **limits: Any) -> list[str]:
        with BagWriter(tmp_path / name, chunk_size=4000, compression="none", **limits) as bag:
            bag.attach("plate_calibration.yaml", b"a: 1")
            for i in range(2000):
                bag.write("wrench", wrench(START + i * 2_000_000, 1.0))
        assert len(content(tmp_path / name)) == 2000
        with open_bag(tmp_path / name) as reader:
            assert reader.attachment("plate_calibration.yaml") == b"a: 1"
            assert reader.info.attachments == ["plate_calibration.yaml"]
            return [f.name for f in reader.info.files]

    assert write("time", maximum_duration=1.0) == [f"time_{i}.mcap" for i in range(4)]
    assert len(write("size", maximum_size=50_000)) > 3
    with AnyReader([tmp_path / "time"]) as reader:
        assert reader.message_count == len(list(reader.messages())) == 2000


def test_what_is_attached_is_no_reason_to_begin_the_next_file(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", maximum_size=20_000) as bag:
        bag.attach("plate_calibration.yaml", bytes(50_000))
        for i in range(20):
            bag.write("wrench", wrench(START + i * 2_000_000, 1.0))
            bag.flush()
    assert [f.name for f in (tmp_path / "bag").glob("*.mcap")] == ["bag_0.mcap"]
    with pytest.raises(InputError, match=r"'maximum_size' is 1000 B; give 1000000 B \(1 MB\)"):
        RecorderSettings(maximum_size=1000)


def test_latched_topics_of_sqlite_bags_stay_latched(tmp_path: Path) -> None:
    latched = Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
        QosTime(0, 0), QosTime(0, 0), QosLiveliness.AUTOMATIC, QosTime(0, 0), False,
    )  # fmt: skip
    types = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
        for topic, profiles in (("/note", [latched]), ("/finger/trial", [])):
            connection = bag.add_connection(
                topic, "std_msgs/msg/String", typestore=types, offered_qos_profiles=profiles
            )
            message = types.types["std_msgs/msg/String"]("hello")
            bag.write(connection, START, types.serialize_cdr(message, "std_msgs/msg/String"))
    made = recover(tmp_path / "bag", tmp_path / "whole")
    with open_bag(tmp_path / "bag") as reader, open_bag(made.path) as whole:
        found = [reader.info.topics["/note"], *whole.info.topics.values()]
    # Where the bag tells nothing, the schema does.
    assert [yaml.safe_load(topic.qos)[0]["durability"] for topic in found] == [1, 1, 1]


def test_counts_are_unknown_where_one_file_does_not_tell_its_own(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", maximum_duration=1.0) as bag:
        for i in range(1000):
            bag.write("wrench", wrench(START + i * 2_000_000, 1.0))
    first = tmp_path / "bag" / "bag_0.mcap"
    first.write_bytes(first.read_bytes()[:-200])
    with open_bag(tmp_path / "bag") as reader:
        assert reader.info.message_count is None
        assert reader.info.topics["/finger/wrench"].count is None


def test_a_bag_that_failed_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no field"), BagWriter(tmp_path / "bag") as bag:
        bag.write("wrench", {"wrong": 1})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("end", [BagWriter.close, BagWriter.abandon])
def test_a_closed_bag_takes_nothing_and_says_so(
    tmp_path: Path, end: Callable[[BagWriter], Any]
) -> None:
    bag = BagWriter(tmp_path / "bag")
    bag.write("wrench", wrench(START, 1.0))
    end(bag)
    with pytest.raises(InputError, match="bag: bag is closed already"):
        bag.write("wrench", wrench(START + 1, 1.0))
    with pytest.raises(InputError, match="bag: bag is closed already"):
        bag.attach("plate_calibration.yaml", b"a: 1")
    assert bag.counts == {"/finger/wrench": 1}


@pytest.mark.parametrize("held", [[], [0], [0, 3_000_000_000]])
@pytest.mark.parametrize("at", [-1_000_000_000, 1_000_000_000])
def test_a_bag_that_gets_a_further_message_tells_its_times(
    tmp_path: Path, held: list[int], at: int
) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("wrench")
        for time in held:
            bag.write("wrench", wrench(START + time, 1.0))
    kind = "geometry_msgs/msg/WrenchStamped"
    add_message(tmp_path / "bag", "/finger/wrench", kind, wrench(START + at, 1.0), START + at)
    first, last = START + min([*held, at]), START + max([*held, at])
    metadata = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
    told = metadata["rosbag2_bagfile_information"]
    assert told["starting_time"]["nanoseconds_since_epoch"] == first
    assert told["duration"]["nanoseconds"] == last - first
    with AnyReader([tmp_path / "bag"]) as reader:
        assert (reader.start_time, reader.end_time) == (first, last + 1)


def test_an_existing_bag_is_never_overwritten(session: Callable[..., Path]) -> None:
    path = session(trials=1)
    with pytest.raises(InputError, match="exists already"):
        BagWriter(path)


@pytest.mark.parametrize("topic", ["", "a b", "/x/", "../x", "1st"])
def test_what_is_no_topic_name_is_refused(tmp_path: Path, topic: str) -> None:
    bag = BagWriter(tmp_path / "bag")
    with pytest.raises(InputError, match="topic"):
        bag.write(topic, {}, START, message_type="finger_msgs/msg/Moisture")
    bag.abandon()


@pytest.mark.parametrize("change", ["# another comment\n", "float64 added\n"])
def test_a_definition_keeps_its_type_hash_for_any_comments(tmp_path: Path, change: str) -> None:
    kind = "finger_msgs/msg/Moisture"
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("moisture", kind, definition=change + definition_text(kind))
    metadata = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
    topics = metadata["rosbag2_bagfile_information"]["topics_with_message_count"]
    found = [topic["topic_metadata"]["type_description_hash"] for topic in topics]
    assert found == [type_hash(kind) if change.startswith("#") else ""]
