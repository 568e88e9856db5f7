# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The sample bags of the checkout: fit for use, small, and readable by independent readers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from finger_bag.bag_files import find_bags
from finger_bag.reader import open_bag
from finger_bag.validate import validate
from finger_offline.trials import load_trials

CONDITIONS = {"dry", "natural", "moist"}


@pytest.fixture(scope="module")
def bags(project_root: Path) -> list[Path]:
    folder = project_root / "bags"
    if not folder.is_dir():
        pytest.skip("no sample bags in this checkout; 'make bags' makes them")
    return find_bags([folder])


def test_each_condition_has_a_small_bag_that_is_fit_for_use(bags: list[Path]) -> None:
    conditions = set()
    for bag in bags:
        result = validate(bag)
        assert result.fit, [c for c in result.checks if c.status == "fail"]
        with open_bag(bag) as reader:
            assert reader.info.complete and reader.all_problems() == []
            assert reader.info.size < 20_000_000
            assert reader.info.metadata.subject and reader.info.metadata.source
        conditions |= set(load_trials(bag).conditions)
    assert conditions >= CONDITIONS
    assert (bags[0].parent / "README.md").is_file()


def test_independent_readers_see_the_same_types_counts_and_monotonic_stamps(
    bags: list[Path],
) -> None:
    for bag in bags:
        with open_bag(bag) as ours:
            counts = {n: (t.type, t.count) for n, t in ours.info.topics.items()}
        with AnyReader([bag]) as theirs:
            assert {n: (t.msgtype, t.msgcount) for n, t in theirs.topics.items()} == counts
            wrench = [c for c in theirs.connections if c.topic.endswith("/wrench")]
            stamps = [
                (m := theirs.deserialize(raw, c.msgtype)).header.stamp.sec * 10**9
                + m.header.stamp.nanosec
                for c, _, raw in theirs.messages(wrench)
            ]
        assert np.all(np.diff(stamps) > 0)
        seen = dict.fromkeys(counts, 0)
        for file in sorted(bag.glob("*.mcap")):
            with file.open("rb") as stream:
                reader = make_reader(
                    stream, validate_crcs=True, decoder_factories=[DecoderFactory()]
                )
                for _, channel, _, decoded in reader.iter_decoded_messages():
                    assert decoded is not None
                    seen[channel.topic] += 1
        assert seen == {name: count for name, (_, count) in counts.items()}
