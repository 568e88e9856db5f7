# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Pulls of the simulated rig: the forces that the sensor gets and the ridges that the camera sees
are those of one pull, and of the simulated study's."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from finger_common.errors import InputError
from finger_common.guided_pulls import HOLD, LOAD
from finger_model.geometry import Geometry
from finger_model.pose.correction import PoseCorrection
from finger_model.pose.pose import Pose
from finger_sim import pull
from finger_sim.conditions import condition
from finger_sim.participant import FrameClock, Participant, _Press
from finger_sim.study import simulate_study
from finger_sim.study_trial import plan_study_trial
from finger_sim.trial_plan import (
    CameraView,
    PlannedTrial,
    TrialRequest,
    _press_of,
    plan_trial,
    renderer_for,
)
from finger_vision.ftir import FtirSegmenter
from finger_vision.ridge_motion import RidgeMotion

VIEW = CameraView(width=400, height=400)


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> PlannedTrial:
    folder = tmp_path_factory.mktemp("pull")
    return plan_trial(TrialRequest("natural_pull", 0, seed=5), folder, VIEW, refinement=0.3)


def test_a_pull_begins_after_its_cue_and_slips_at_its_friction(planned: PlannedTrial) -> None:
    press, pulled = planned.press, planned.pull
    assert pulled is not None
    held = (press.time > press.cue) & (press.time < press.release)
    assert press.force[held].mean() == pytest.approx(LOAD, rel=0.3)
    across = np.hypot(*pulled.force_on_plate(press.time))
    assert np.all(across[press.time < press.cue + HOLD] == 0.0)
    sliding = (press.time > pulled.slip) & held
    # Long enough to be seen: the plate stops half a second after the slip.
    sliding &= press.time < pulled.slip + 0.5
    assert sliding.sum() == pytest.approx(250, abs=2)
    ratio = across[sliding] / press.force[sliding]
    assert np.mean(ratio) == pytest.approx(pulled.friction, rel=0.01)
    assert ratio.min() > 0.9 * pulled.friction
    assert np.all(across <= pulled.friction * press.force * (1 + 1e-9))


def test_frames_show_the_slip_that_the_pull_has(planned: PlannedTrial) -> None:
    pulled = planned.pull
    assert pulled is not None
    calibration = renderer_for("natural", VIEW, 5).calibration()
    sensor, motion = FtirSegmenter(calibration=calibration), RidgeMotion(calibration=calibration)
    stuck, slid = [], []
    for number, path in enumerate(planned.frames):
        time = number / VIEW.frame_rate
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        seen = motion.track(image, sensor.process(image))
        if not math.isfinite(seen.stick_ratio):
            continue
        if planned.press.cue < time < planned.press.cue + pull.PAUSE - 0.1:
            stuck.append(seen.stick_ratio)
        elif pulled.slip + 0.15 < time < planned.press.release:
            slid.append(seen.stick_ratio)
    assert stuck and min(stuck) > 0.9
    assert slid and max(slid) < 0.1


def test_one_finger_has_one_friction_and_its_pulls_differ_by_little() -> None:
    found = [_press_of(TrialRequest("moist_pull", k, seed=2))[1] for k in range(6)]
    friction = np.array([p.friction for p in found if p is not None])
    assert len(friction) == 6 and len(set(friction)) == 6
    assert friction.std() / friction.mean() < 0.06
    assert _press_of(TrialRequest("moist", 0, seed=2))[1] is None


def test_the_participant_pulls_as_planned(planned: PlannedTrial) -> None:
    participant = Participant(None, FrameClock(0, 10**8), print, print)  # type: ignore[arg-type]
    assert participant.tangential_force(0) is None
    participant._press = _Press(planned, 0)
    assert planned.pull is not None
    at = planned.pull.slip
    force = participant.tangential_force(round(at * 1e9))
    assert force == pytest.approx(planned.pull.force_on_plate(at))
    assert planned.truth["pull"]["friction"] == planned.pull.friction


def test_the_study_pulls_by_the_same_code() -> None:
    trial = plan_study_trial(1, "dry", 0, refinement=0.3, slip=True)
    press, pulled = pull.pressed_and_pulled(np.random.default_rng(0), np.random.default_rng(1), 0.4)
    assert trial.pull is not None and type(trial.pull) is type(pulled)
    assert press.cue + pull.PAUSE + pull.RISE[0] < pulled.slip
    assert trial.target_force == LOAD


def test_a_study_of_a_negative_seed_is_refused_before_its_folder_is_claimed(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="seed is -1, zero or more is needed"):
        simulate_study(-1, tmp_path / "study", trials=1)
    assert not (tmp_path / "study").exists()


def test_an_interrupted_study_says_at_once_what_it_waits_for(tmp_path: Path) -> None:
    said: list[str] = []

    def report(line: str) -> None:
        said.append(line)
        if line.startswith("[1/40]"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate_study(
            1, tmp_path, False, trials=40, conditions=["dry"], refinement=0.3, report=report
        )
    assert said[-1].startswith("interrupted: ends after the trials that are being simulated")
    written = list(tmp_path.glob("dry_*"))
    assert 1 <= len(written) < 10 and all((bag / "metadata.yaml").exists() for bag in written)


def test_frames_of_a_tilted_finger_show_the_ellipse_where_it_is(tmp_path: Path) -> None:
    pose = Pose(1.3, 0.3, 0.1)
    request = TrialRequest("natural", 1, seed=5)
    view = CameraView(2.0, 480, 640)
    level = plan_trial(request, tmp_path, view, 0.3)
    tilted = plan_trial(request, tmp_path, view, 0.3, pose)
    calibration = renderer_for("natural", view, 5).calibration()
    sensor = FtirSegmenter(calibration=calibration)
    k = int(np.argmax(tilted.frame_area))
    images = [cv2.imread(str(tilted.frames[n]), cv2.IMREAD_GRAYSCALE) for n in (0, 1, k)]
    measured = [sensor.process(image) for image in images][-1]
    assert measured.gross_area == pytest.approx(tilted.frame_area[k], rel=0.06)
    correction = PoseCorrection(Geometry(), pose, condition("natural").material.skin_ratio)
    expected = correction.outline(level.frame_area[k])
    assert tilted.frame_area[k] == pytest.approx(expected.area)
    moved = tilted.pressure_center[k] - level.pressure_center[k]
    assert moved == pytest.approx([-expected.center_of_pressure[1], expected.center_of_pressure[0]])
    center = level.pressure_center[k] + [-expected.center[1], expected.center[0]]
    assert np.hypot(*(measured.centroid - center)) < 0.2e-3
