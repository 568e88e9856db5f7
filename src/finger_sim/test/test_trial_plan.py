# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Planned trials: true contacts of the full-order finger, their frames, and the planner."""

import functools
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from finger_common.errors import FingerError
from finger_model.history import ContactHistory
from finger_sim.conditions import STUDY
from finger_sim.finger import SimulatedFinger, area_at
from finger_sim.ftir import AREA_PER_PIXEL
from finger_sim.planner import Planner
from finger_sim.press import PressStyle, plan_press
from finger_sim.trial_plan import CameraView, TrialRequest, plan_trial, write_truth

VIEW = CameraView(width=480, height=400)
PRESS = plan_press(np.random.default_rng(1), PressStyle(ramp=(0.6, 0.6)))
FRAMES = np.arange(0, PRESS.duration, 0.1)


@pytest.fixture(scope="module")
def histories() -> dict[str, ContactHistory]:
    """Contact under PRESS by condition, at the default step."""
    return {
        name: SimulatedFinger(c.material).plan(PRESS.time, PRESS.force, FRAMES)
        for name, c in STUDY.items()
    }


def test_a_moister_finger_gives_a_larger_contact(histories) -> None:
    largest = {name: history.area.max() for name, history in histories.items()}
    assert 0 < largest["dry"] < largest["natural"] < largest["moist"] < 200e-6


def test_steps_of_20_ms_are_fine_enough_for_the_truth(histories) -> None:
    """Halving the step changes no frame's area by more than 1 % of the largest."""
    finger = SimulatedFinger(STUDY["natural"].material, step=0.01)
    finer = area_at(finger.plan(PRESS.time, PRESS.force, FRAMES), FRAMES)
    area = area_at(histories["natural"], FRAMES)
    assert np.abs(area - finer).max() < 0.01 * finer.max()


def test_frames_are_steps_of_the_plan_and_there_is_no_contact_without_force(histories) -> None:
    history = histories["dry"]
    assert np.all(np.min(np.abs(history.time[:, None] - FRAMES), axis=0) < 2e-5)
    areas = area_at(history, FRAMES)
    assert np.all(areas[FRAMES < PRESS.onset] == 0) and np.all(areas[FRAMES > PRESS.lift_off] == 0)
    inside = (FRAMES > PRESS.onset + 0.05) & (FRAMES < PRESS.release)
    assert np.all(areas[inside] > 0)


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory):
    return plan_trial(TrialRequest("natural", 3, seed=5), tmp_path_factory.mktemp("plan"), VIEW)


def test_frames_show_the_true_areas(planned) -> None:
    """The darkened part of a frame grows with the true area and fits inside its circle."""
    pictures = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in planned.frames]
    assert all(p.shape == (VIEW.height, VIEW.width) for p in pictures)
    empty = np.median([p for p, a in zip(pictures, planned.frame_area) if a == 0], axis=0)
    dark = np.array([np.sum(empty - p > 40) * AREA_PER_PIXEL for p in pictures])
    touching = planned.frame_area > 5e-6
    assert touching.sum() >= 4
    assert np.all(dark[planned.frame_area == 0] < 0.2e-6)
    fraction = dark[touching] / planned.frame_area[touching]
    assert np.all(fraction > 0.25) and np.all(fraction < 0.85)
    assert np.corrcoef(dark[touching], planned.frame_area[touching])[0, 1] > 0.98


def test_a_trial_depends_on_its_name_and_seed_alone(planned, tmp_path: Path) -> None:
    again = plan_trial(TrialRequest("natural", 3, seed=5), tmp_path, VIEW)
    assert np.array_equal(again.press.force, planned.press.force)
    assert np.array_equal(again.frame_area, planned.frame_area)
    assert np.array_equal(again.moisture, planned.moisture)
    # Whatever the same renderer drew before.
    for one, other in zip(again.frames, planned.frames, strict=True):
        assert one.read_bytes() == other.read_bytes()
    redone = TrialRequest("natural", 3, attempt=1, seed=5)
    assert redone.rng("press").random() != TrialRequest("natural", 3, seed=5).rng("press").random()


def test_the_truth_is_written_to_a_file(planned, tmp_path: Path) -> None:
    write_truth(tmp_path / "truth.json", planned, 17)
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["start_ns"] == 17 and truth["material"]["E1"] == 25380.0
    assert truth["frame_area_m2"] == planned.frame_area.tolist()


def test_the_planner_plans_in_another_process_and_names_what_it_cannot_plan(tmp_path: Path) -> None:
    planner = Planner(functools.partial(plan_trial, folder=tmp_path, view=VIEW))
    try:
        good = TrialRequest("dry", 0)
        planner.ask(good)
        with pytest.raises(FingerError, match=r"wet_001_0.*choose one of dry, natural, moist"):
            planner.get(TrialRequest("wet", 1))
        trial = planner.get(good)
        assert trial is not None and trial.request == good and trial.frames[0].exists()
        trial.frames[0].unlink()
        again = planner.get(good)
        assert again is not None and again.frames[0].exists()
    finally:
        planner.close()
    with pytest.raises(FingerError, match="planning process has ended"):
        planner.get(TrialRequest("dry", 9))
