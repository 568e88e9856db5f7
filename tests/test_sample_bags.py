"""The bags in `bags/`: fit for use, and readable by programs of others."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml

from finger_bag.reader import open_bag
from finger_bag.validate import validate
from finger_model.paper import CONDITIONS, TARGET_FORCE
from finger_offline.trials import load_trials

TYPES = {
    "/finger/wrench": "geometry_msgs/msg/WrenchStamped",
    "/finger/wrench_raw": "geometry_msgs/msg/WrenchStamped",
    "/finger/contact_area": "finger_msgs/msg/ContactArea",
    "/finger/contact_state": "finger_msgs/msg/ContactState",
    "/finger/moisture": "finger_msgs/msg/Moisture",
    "/finger/trial": "finger_msgs/msg/Trial",
    "/finger/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
}
STAMPED = ("/finger/wrench", "/finger/contact_area", "/finger/contact_state", "/finger/moisture")


@pytest.fixture(scope="module", params=sorted(CONDITIONS))
def bag(request: pytest.FixtureRequest, project_root: Path) -> Path:
    return project_root / "bags" / request.param


@pytest.fixture(scope="module")
def our_counts(bag: Path) -> dict[str, int]:
    """Messages by topic, as our reader finds them."""
    with open_bag(bag) as reader:
        counts = Counter(item.topic for item in reader.messages())
        assert reader.info.complete and reader.all_problems() == []
        assert {name: topic.count for name, topic in reader.info.topics.items()} == counts
    return dict(counts)


def check_stamps(stamps: dict[str, list[int]]) -> None:
    for topic in STAMPED:
        assert np.all(np.diff(stamps[topic]) > 0), topic


def test_rosbags_reads_types_counts_and_stamps(bag: Path, our_counts: dict[str, int]) -> None:
    rosbags = pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    counts: Counter[str] = Counter()
    stamps: dict[str, list[int]] = {}
    with rosbags.Reader(bag) as reader:
        for connection in reader.connections:
            assert TYPES.get(connection.topic, connection.msgtype) == connection.msgtype
            definition = connection.msgdef.data
            store.register(
                {
                    k: v
                    for k, v in get_types_from_msg(definition, connection.msgtype).items()
                    if k not in store.types
                }
            )
        for connection, _, raw in reader.messages():
            counts[connection.topic] += 1
            message = store.deserialize_cdr(raw, connection.msgtype)
            if connection.topic in STAMPED:
                stamp = message.header.stamp
                stamps.setdefault(connection.topic, []).append(stamp.sec * 10**9 + stamp.nanosec)
    assert set(TYPES) <= set(counts)
    assert dict(counts) == our_counts
    check_stamps(stamps)


def test_mcap_ros2_support_reads_the_same_messages(bag: Path, our_counts: dict[str, int]) -> None:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    counts: Counter[str] = Counter()
    stamps: dict[str, list[int]] = {}
    with next(bag.glob("*.mcap")).open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        for schema, channel, _, message in reader.iter_decoded_messages():
            assert TYPES.get(channel.topic, schema.name) == schema.name
            counts[channel.topic] += 1
            if channel.topic in STAMPED:
                stamp = message.header.stamp
                stamps.setdefault(channel.topic, []).append(stamp.sec * 10**9 + stamp.nanosec)
        assert summary.statistics.message_count == sum(counts.values())
    assert dict(counts) == our_counts
    check_stamps(stamps)


def test_metadata_is_that_of_rosbag2(bag: Path, our_counts: dict[str, int]) -> None:
    information = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["storage_identifier"] == "mcap"
    assert information["message_count"] == sum(our_counts.values())
    for topic in information["topics_with_message_count"]:
        assert topic["message_count"] == our_counts[topic["topic_metadata"]["name"]]
    assert [bag / path for path in information["relative_file_paths"]] == sorted(bag.glob("*.mcap"))


def test_a_bag_is_small_and_holds_three_complete_trials_of_its_condition(bag: Path) -> None:
    assert sum(f.stat().st_size for f in bag.iterdir()) < 10e6
    found = load_trials([bag])
    assert not found.exclusions and len(found.trials) == 3
    for trial in found.trials:
        assert trial.condition == bag.name
        assert len(trial.moisture_before) == len(trial.moisture_after) == 3
        readings = trial.moisture_before + trial.moisture_after
        assert abs(np.mean(readings) - CONDITIONS[bag.name].moisture) < 20
        assert trial.force.max() >= TARGET_FORCE
        assert 30e-6 < trial.area.max() < 150e-6


def test_finger_bag_finds_it_fit_for_use(bag: Path) -> None:
    result = validate(bag)
    assert result.fit, [c for c in result.checks if c.status == "fail"]
    assert set(load_trials(bag).conditions) == {bag.name}


def test_no_person_is_named_in_it(bag: Path) -> None:
    with open_bag(bag) as reader:
        assert reader.info.metadata.subject == "SIM1"
        assert reader.info.metadata.source == "simulated rig"
