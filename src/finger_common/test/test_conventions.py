# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Stamps, axes, contact thresholds, flags and phases: the facts that every package shares."""

from __future__ import annotations

import re
from enum import IntEnum, IntFlag
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from finger_common import axes, stamps
from finger_common.contact_threshold import check_thresholds, contacts, in_contact
from finger_common.errors import InputError
from finger_common.flags import AreaFlag, ShapeFlag, SlipFlag, StateFlag, flag_names
from finger_common.moisture import is_moisture
from finger_common.subject_code import alike, check_new_subject, is_subject
from finger_common.trial_phases import TrialPhase


@pytest.mark.parametrize(
    ("members", "file", "prefix"),
    [
        (StateFlag, "ContactState", "FLAG_"),
        (AreaFlag, "ContactArea", "FLAG_"),
        (SlipFlag, "ContactSlip", "FLAG_"),
        (ShapeFlag, "ContactShape", "FLAG_"),
        (TrialPhase, "Trial", "PHASE_"),
    ],
)
def test_constants_are_those_of_the_message(
    project_root: Path, members: type[IntFlag] | type[IntEnum], file: str, prefix: str
) -> None:
    text = (project_root / "src" / "finger_msgs" / "msg" / f"{file}.msg").read_text()
    defined = {n: int(v) for n, v in re.findall(rf"{prefix}(\w+) = (\d+)", text)}
    assert {m.name: m.value for m in members} == defined


@pytest.mark.parametrize("code", ["-1", "_S01", "-S01"])
def test_a_code_for_a_new_person_is_no_option_of_a_command(code: str) -> None:
    assert is_subject(code), "recordings of older versions are read"
    with pytest.raises(InputError, match="must begin with a letter or a digit"):
        check_new_subject(code)
    assert check_new_subject("1S") == "1S"
    with pytest.raises(InputError, match="never a name"):
        check_new_subject("Maria")


def test_codes_that_may_be_of_one_person_are_alike() -> None:
    assert alike("S01") == alike("s1") == alike("S001") != alike("S10")
    assert alike("2026_S007") == alike("2026_s7") != alike("2026_S07_2")
    assert alike("S100") != alike("S10") and alike("S0") == alike("S00") != alike("S")


def test_flag_names() -> None:
    assert flag_names(AreaFlag.CLIPPED | AreaFlag.SATURATED) == "clipped|saturated"
    assert flag_names(StateFlag(0)) == ""


@pytest.mark.parametrize("stamp_ns", [0, 1, 1_700_000_000_123_456_789, -1])
def test_stamps_round_trip_to_the_nanosecond(stamp_ns: int) -> None:
    time = SimpleNamespace(**stamps.time_fields(stamp_ns))
    assert 0 <= time.nanosec < stamps.NANOSECONDS
    assert stamps.stamp_of(time) == stamp_ns
    stamps.fill_time(time, stamp_ns + 5)
    assert stamps.header_stamp(SimpleNamespace(header=SimpleNamespace(stamp=time))) == stamp_ns + 5


def test_normal_and_lateral_force_by_axis() -> None:
    force = np.array([[3.0, 4.0, -2.0]])
    assert axes.normal_force(force, "-z") == [2.0]
    assert axes.lateral_force(force, "-z") == [5.0]
    assert axes.normal_force(force[0], "+y") == 4.0
    with pytest.raises(InputError, match=r"'z', choose one of \+x"):
        axes.axis_of("z")


def test_contacts_have_hysteresis() -> None:
    force = np.array([0.0, 0.04, 0.06, 0.04, 0.02, 0.04, 0.05, 0.031, np.nan, 0.06])
    assert list(contacts(force)) == [(2, 4), (6, 8), (9, 10)]
    touching, found = False, []
    for value in force:
        touching = in_contact(touching, value)
        found.append(touching)
    expected = [any(a <= i < b for a, b in contacts(force)) for i in range(len(force))]
    assert found == expected
    with pytest.raises(InputError, match="liftoff_force"):
        check_thresholds(0.05, 0.05)


def test_moisture_scale() -> None:
    assert is_moisture(0.0) and is_moisture(130.0)
    assert not is_moisture(130.1) and not is_moisture(float("nan"))
