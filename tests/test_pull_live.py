# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A guided pull on the whole simulated rig, in separate processes: slip and friction found live."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from demo.session import SESSION, SessionRequest, record_session
from finger_bag.reader import open_bag
from finger_common.trial_phases import TrialPhase

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(900)]

BUSY = {
    "gap_limit": 1.0,
    "frame_gap_limit": 2.0,
    "stale_after": 1.5,
    "record_timeout": 60.0,
    "lost_limit": 100000,
}
"""Limits that a loaded machine keeps."""


def test_the_rig_pulls_and_the_protocol_finds_slip_and_friction(
    tmp_path: Path, free_ros_domain: Callable[[], int]
) -> None:
    request = SessionRequest(
        tmp_path,
        ("natural_pull",),
        trials=1,
        parameters={
            "protocol": BUSY,
            "simulated_rig": {"refinement": 0.3},
            "vision": {"ridge_motion": True},
            "unattended": {"trial_timeout": 500.0, "max_failures": 20},
        },
        domain=free_ros_domain(),
    )
    for _ in record_session(request):
        pass
    state = json.loads((request.bags / "session.json").read_text())
    attempts = state["trials"][0]["attempts"]
    done = attempts[-1]
    assert done["verdict"] == "done"
    name = f"natural_pull_000_{len(attempts) - 1}.json"
    truth = json.loads((request.truth / name).read_text())["pull"]
    assert done["friction"] == pytest.approx(truth["friction"], rel=0.03)
    late = (done["slip_ns"] - done["pull_ns"]) * 1e-9
    assert 0.0 < late < 4.0
    with open_bag(request.bags / f"000_natural_pull_{len(attempts) - 1}") as reader:
        messages = [m.message for m in reader.messages(["/finger/trial"])]
        areas = [m.message for m in reader.messages(["/finger/contact_area"])]
    assert TrialPhase.PULL in [message.phase for message in messages]
    assert messages[-1].phase == TrialPhase.DONE
    assert messages[-1].note.startswith("slipped, friction")
    ratios = [area.stick_ratio for area in areas if area.stick_ratio == area.stick_ratio]
    assert max(ratios) > 0.9 and min(ratios) < 0.1
    assert SESSION in str(request.bags)
