# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Time that jumps back within a bag: the sample that waits for its successor is not lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from finger_bag.reader import open_bag
from finger_bag.writer import BagWriter
from finger_common.stamps import header_stamp
from finger_offline.process import process
from finger_offline.process_options import ProcessOptions


# The first five samples are a block: at 4, the sample that waits is the last one of its block.
@pytest.mark.parametrize("jump_at", [4, 250, 998, 999, 1000, 1001])
def test_every_sample_around_a_jump_has_its_estimate(tmp_path: Path, jump_at: int) -> None:
    stamps = [10**18 + n * 2_000_000 - (10**13 if n >= jump_at else 0) for n in range(1200)]
    with BagWriter(tmp_path / "bag", {"subject": "S01", "condition": "natural"}) as writer:
        for n, stamp in enumerate(stamps):
            sec, nanosec = divmod(stamp, 10**9)
            header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": "sensor"}
            force = {"x": 1e-4 * n, "y": 0.0, "z": -min(1.0, n / 500)}
            fields = {"header": header, "wrench": {"force": force, "torque": {}}}
            writer.write("/finger/wrench", fields, 10**18 + n * 2_000_000)
    result = process(tmp_path / "bag", tmp_path / "out", ProcessOptions(slip=True))
    assert result.states == len(stamps)
    for topic in ("/finger/contact_state", "/finger/contact_slip"):
        with open_bag(tmp_path / "out") as reader:
            found = {header_stamp(m.message): m for m in reader.messages([topic])}
        assert found.keys() == set(stamps)
        for n, stamp in enumerate(stamps):
            assert found[stamp].log_time_ns == 10**18 + n * 2_000_000, "that of its own sample"
            if topic == "/finger/contact_slip":
                assert found[stamp].message.tangential_force.x == pytest.approx(1e-4 * n)
