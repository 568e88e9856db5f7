# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Presses that do not count, and why."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from study_rig import Rig, expect_failure

from finger_operator.limits import Limits
from finger_operator.status import session_status
from finger_operator.steps import Step


def test_press_lifted_too_early_fails_and_is_redone(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 0.8, ramp=True)
    rig.run(0.1, 0.0)
    rig.run(0.7)
    expect_failure(rig, "lifted at 0.80 N")
    rig.run(2.0)
    assert rig.protocol.step is Step.PREPARE and rig.last.index == 0 and rig.last.attempt == 1
    rig.trial()
    assert [a.verdict for a in rig.protocol.trials[0].attempts] == ["failed", "done"]
    assert rig.attempt.bag.endswith("000_dry_1")


def test_no_press_at_all_fails(rig: Rig) -> None:
    rig.to_press()
    rig.run(30.2)
    expect_failure(rig, "no press within 30 s")


def test_target_never_reached_fails(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 1.0, ramp=True)
    rig.run(10.5)
    expect_failure(rig, "1.00 of 1.35 N")


def test_finger_not_lifted_fails(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 1.4, ramp=True)
    rig.run(10.5)
    expect_failure(rig, "not lifted")


def test_dropped_force_samples_fail_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 0.7, ramp=True)
    rig.force_on = False
    rig.run(0.12)
    rig.force_on = True
    rig.press()
    expect_failure(rig, "force samples missing for 0.12 s")


def test_samples_missing_at_the_first_touch_fail_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.force_on = False
    rig.run(0.12, 0.15, ramp=True)
    rig.force_on = True
    rig.press()
    expect_failure(rig, "force samples missing for 0.12 s")


def test_missing_frames_fail_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 0.7, ramp=True)
    rig.camera_on = False
    rig.run(0.6)
    rig.camera_on = True
    rig.press()
    expect_failure(rig, "6 frames in a row were dropped")
    assert rig.protocol.trials[0].attempts[0].longest_frame_gap == pytest.approx(0.7, abs=0.01)


def test_camera_that_stops_before_the_target_fails_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.run(1.0, 1.2, ramp=True)
    rig.camera_on = False
    rig.run(0.8)
    rig.press()
    expect_failure(rig, "no frame at the target force")


def test_camera_that_stops_before_lift_off_fails_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.run(1.2, 1.45, ramp=True)
    rig.camera_on = False
    rig.run(0.3)
    rig.run(0.2, 0.0, ramp=True)
    rig.run(0.7)
    expect_failure(rig, "camera frames missing for 0.")


def test_a_gap_between_frames_may_be_allowed_for_a_rehearsal(tmp_path: Path) -> None:
    rig = Rig(tmp_path, limits=Limits(frame_gap_limit=0.35))
    rig.protocol.start(rig.now)
    rig.to_press()
    rig.run(0.5, 0.7, ramp=True)
    rig.camera_on = False
    rig.run(0.1)
    rig.camera_on = True
    rig.press()
    assert rig.protocol.step is Step.MOISTURE_AFTER


def test_what_was_noticed_is_said_before_how_the_press_ended(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.3, 0.5, ramp=True)
    rig.protocol.health("force", 2, "gauge saturated", rig.now)
    rig.run(0.5, 0.0)
    rig.run(0.7)
    expect_failure(rig, "force: gauge saturated; lifted at 0.50 N")


def test_contact_not_seen_fails_the_trial(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.to_press()
    area = rig.protocol.area
    monkeypatch.setattr(rig.protocol, "area", lambda stamp, *_: area(stamp, 0.0, 1))
    rig.press()
    expect_failure(rig, "areas were measured in 0 frames")


def test_sensor_silent_during_the_press_fails_at_once_and_waits_until_it_is_back(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 0.7, ramp=True)
    rig.force_on = False
    rig.run(0.8)
    expect_failure(rig, "force sensor fell silent")
    rig.force = 0.0
    rig.run(2.0)
    rig.protocol.start(rig.now)
    rig.readings(1.0, 2.0, 3.0)
    rig.run(2.0)
    assert rig.protocol.step is Step.CLEAR
    rig.force_on = True
    rig.run(1.0)
    assert rig.protocol.step is Step.PRESS


def test_invalid_force_and_device_errors_fail_the_trial(rig: Rig) -> None:
    rig.to_press()
    rig.run(0.5, 0.7, ramp=True)
    rig.protocol.wrench(rig.now + 1_000_000, math.nan)
    rig.protocol.health("force", 2, "gauge saturated", rig.now)
    rig.press()
    expect_failure(rig, "invalid samples")
    expect_failure(rig, "force: gauge saturated")
    rig.protocol.health("force", 2, "gauge saturated", rig.now)
    assert "gauge saturated" in rig.protocol.waiting_for()
    rig.protocol.health("force", 0, "", rig.now)
    assert "gauge" not in rig.protocol.waiting_for()


def test_a_device_error_that_is_over_before_the_touch_spoils_no_press(rig: Rig) -> None:
    rig.to_press()
    rig.protocol.health("camera", 2, "no frames", rig.now)
    rig.run(0.2)
    rig.protocol.health("camera", 0, "", rig.now)
    rig.press()
    rig.readings(1.0, 2.0, 3.0)
    rig.run(0.2)
    assert rig.attempt.verdict == "done"


def test_trial_that_fails_again_and_again_holds_the_session(rig: Rig) -> None:
    for _ in range(5):
        rig.to_press()
        rig.run(0.3, 0.5, ramp=True)
        rig.run(0.7, 0.0)
        rig.run(2.0)
    assert rig.protocol.paused and "failed 5 times" in session_status(rig.protocol)["message"]
    rig.protocol.resume(rig.now)
    assert rig.protocol.step is Step.PREPARE
