# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the page shows of a session survives the way through the message."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from test_protocol import Rig

from finger_bag.definitions import decoder, encode
from finger_operator.status import closed_status, session_status
from finger_operator.status_message import status_fields, status_of
from finger_operator.study_plan import PREPARATIONS, PlanSettings

KIND = "finger_msgs/msg/SessionStatus"


def through_the_message(status: dict[str, Any]) -> str:
    return json.dumps(status_of(decoder(KIND)(encode(KIND, status_fields(status)))), sort_keys=True)


def test_the_status_of_a_session_comes_back_at_every_step(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "session")
    rig.run(0.5)
    rig.protocol.start(rig.now)
    told = [session_status(rig.protocol)]

    def note(free: int | None = None) -> None:
        told.append(session_status(rig.protocol, free, ["S01_before"]))

    rig.trial()
    note(123_456_789_012)
    rig.protocol.note(rig.now, "cold hands", 0)
    rig.run(2.0)
    rig.to_press()
    note(0)
    rig.protocol.end(rig.now)
    rig.press()
    rig.readings(36.0, 37.0, 38.0)
    rig.run(2.0)
    note()
    assert len({status["step"] for status in told}) > 2
    assert any(row["peak_force"] for row in told[-1]["trials"])
    for status in told:
        assert through_the_message(status) == json.dumps(status, sort_keys=True)


@pytest.mark.parametrize("free", [None, 5_000_000_000])
def test_the_status_without_a_session_comes_back(free: int | None) -> None:
    plan = PlanSettings(subject="S02", conditions=["dry"], finger_width=0.016)
    used = {"S01": ["S01_a", "S01_b"]}
    status = closed_status(plan, dict(PREPARATIONS), used, ["dry", "greasy", "dry_pull"], free)
    texts = status["preparations"]
    assert texts["dry_pull"] == texts["dry"] == PREPARATIONS["dry"]
    assert texts["greasy"] == "Prepare the finger as in your protocol."
    assert through_the_message(status) == json.dumps(status, sort_keys=True)
