# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the page shows of a session: instructions, time left, disk, warnings."""

from __future__ import annotations

from pathlib import Path

import pytest
from study_rig import SECOND, Rig, on_another_day

from finger_operator.limits import Limits
from finger_operator.protocol import Protocol
from finger_operator.session_store import (
    STATE_FILE,
    earlier_sessions,
    saved_plans,
    sessions_by_subject,
)
from finger_operator.status import session_status
from finger_operator.study_plan import StudyPlan


def test_summary_after_a_session_in_which_everything_was_skipped(rig: Rig) -> None:
    for _ in range(4):
        rig.protocol.skip(rig.now)
    told = session_status(rig.protocol)["summary"]
    assert (told["kept"], told["skipped"], told["planned"]) == (0, 4, 4)
    assert told["text"] == (
        "Finished: 0 of 4 trials kept, 4 skipped. Repeat the skipped trials from the list, or "
        "press Space to close the session."
    )


def test_time_left_and_disk_space_follow_from_the_trials_that_were_kept(rig: Rig) -> None:
    assert session_status(rig.protocol, 10**9)["disk"]["enough"] is None
    for _ in range(2):
        rig.trial()
        bag = Path(rig.attempt.bag)
        rig.run(2.0)
        bag.mkdir(parents=True)
    for trial in rig.protocol.trials[:2]:
        trial.attempts[-1].size = 200_000_000
    told = session_status(rig.protocol, 10**9)
    assert told["disk"] == {"free_gb": 1.0, "needed_gb": 0.4, "trials_left": 5, "enough": True}
    ends = [t.attempts[-1].ended_ns for t in rig.protocol.trials[:2]]
    assert told["time_left"] == pytest.approx(2 * (ends[1] - ends[0]) / SECOND, abs=0.1)
    told = session_status(rig.protocol, 300_000_000)
    assert told["disk"]["enough"] is False
    assert "room for only 1 more trial. Delete" in told["warnings"][0]
    # What the recorder leaves free is no room.
    told = session_status(rig.protocol, 10**9, reserve=700_000_000)
    assert (told["disk"]["free_gb"], told["disk"]["trials_left"]) == (1.0, 1)
    assert session_status(rig.protocol, 10**9, reserve=2 * 10**9)["disk"]["trials_left"] == 0


@pytest.mark.parametrize("later", [-7200.0, 12 * 3600.0])
@pytest.mark.parametrize("before", [1, 2])
def test_a_night_or_a_change_of_the_clock_is_not_in_the_time_left(
    tmp_path: Path, before: int, later: float
) -> None:
    rig = Rig(tmp_path, trials=4)
    rig.run(0.5)
    rig.protocol.start(rig.now)
    for trial in range(before + 1):
        if trial == before:
            on_another_day(rig, later)
        rig.trial()
        took = rig.attempt.ended_ns - rig.attempt.began_ns
        rig.run(2.0)
    left = session_status(rig.protocol)["time_left"]
    assert left == pytest.approx((7 - before) * took / SECOND, rel=0.5)


def test_a_disk_without_room_for_a_first_trial_is_warned_of(rig: Rig) -> None:
    told = session_status(rig.protocol, 300_000_000, reserve=268_435_456)
    assert "no room for another trial" in told["warnings"][0]
    assert session_status(rig.protocol, 10**9, reserve=268_435_456)["warnings"] == []
    rig.protocol.limits = Limits(need_recorder=False)
    assert session_status(rig.protocol, 300_000_000, reserve=268_435_456)["warnings"] == []


def test_one_huge_bag_does_not_hide_the_room_for_usual_ones(rig: Rig) -> None:
    for size in (50_000_000, 1_000_000_000, 50_000_000):
        rig.trial()
        rig.attempt.size = size
        rig.run(2.0)
    assert session_status(rig.protocol, 10**9)["disk"]["trials_left"] == 20


def test_size_of_a_bag_is_measured_when_the_trial_is_kept(rig: Rig) -> None:
    rig.to_press()
    bag = Path(rig.attempt.bag)
    bag.mkdir(parents=True)
    (bag / "a.mcap").write_bytes(bytes(1234))
    rig.press()
    rig.readings(36.0, 37.0, 38.0)
    rig.run(0.2)
    assert rig.attempt.size == 1234


def test_subject_codes_that_were_used_are_found_and_warned_of(rig: Rig, tmp_path: Path) -> None:
    rig.protocol.files.save()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / STATE_FILE).write_text("{")
    assert sessions_by_subject(saved_plans(tmp_path)) == {"S01": ["session"]}
    told = session_status(rig.protocol, None, ["S01_old"])
    assert "S01 was used before (S01_old)" in told["warnings"][0]


@pytest.mark.parametrize("code", ["S01", "s01", "S1", "S001"])
def test_codes_that_may_be_one_person_are_warned_of(rig: Rig, tmp_path: Path, code: str) -> None:
    rig.protocol.files.save()
    used = sessions_by_subject(saved_plans(tmp_path))
    plan = StudyPlan(code, "another")
    named = "session" if code == "S01" else "session as S01"
    assert earlier_sessions(used, plan) == [named]
    for other in ("S11", "S010", "S02", "S0_1"):
        assert earlier_sessions(used, StudyPlan(other, "another")) == []
    assert earlier_sessions(used, StudyPlan(code, "session")) == [], "itself"


def test_instructions_say_what_to_do(rig: Rig) -> None:
    def told() -> str:
        return str(session_status(rig.protocol)["instruction"])

    assert told() == "Prepare finger and plate, then press Space."
    rig.run(0.2)
    rig.protocol.start(rig.now)
    rig.readings(36.0)
    assert told() == "Hold the probe to the fingertip (2 of 3)."
    again = Protocol.resume_from(rig.folder, rig.take, rig.now, rig.limits)
    assert session_status(again)["instruction"] == (
        "Restarted. Trial 1 will begin again: press Space."
    )
