# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A trial of the simulated rig, planned ahead of time: press, contact, frames, moisture readings.

The full-order model and the renderer are slower than real time, so a worker process plans each
trial before it is played. A plan depends on the seed and the trial's name alone.
"""

from __future__ import annotations

import functools
import json
import math
import zlib
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from finger_common.files import atomic_write, make_folder
from finger_common.guided_presses import PRESS_BY_NAME
from finger_common.guided_pulls import is_pull
from finger_model.paper import READINGS_PER_TRIAL, TARGET_FORCE
from finger_model.pose.correction import PoseCorrection
from finger_model.pose.pose import Pose

from .conditions import condition
from .finger import SimulatedFinger, area_at
from .ftir import IMAGE_HEIGHT, IMAGE_WIDTH, Contact, FtirRenderer, Scene
from .press import Press, guided_style, plan_press
from .pull import Pull, finger_friction, pressed_and_pulled
from .skin_slip import SkinSlip

DIRECTION = 0.5 * math.pi
"""rad, of the fingertip in the plate: along its y, as the renderer's prints are."""

TO_PLATE = np.array([[0.0, -1.0], [1.0, 0.0]])
"""From axes of the finger, x towards its tip, to those of the plate."""

PLACEMENT_SD = 0.4e-3
"""m, scatter of the finger's place on the plate in either direction, an assumption."""


@dataclass(frozen=True)
class CameraView:
    """What the simulated camera sees: frames per s, size in pixels, tilt of its axis, noise.

    A pixel covers `ftir.AREA_PER_PIXEL` of the plate; a smaller frame is an area of interest of the
    same sensor.
    """

    frame_rate: float = 10.0
    width: int = IMAGE_WIDTH
    height: int = IMAGE_HEIGHT
    tilt: float = math.radians(6.0)
    """rad; the view through the prism is never square."""
    noise: float = Scene.noise
    """Standard deviation of a pixel's noise, greys of 255."""


@dataclass(frozen=True)
class TrialRequest:
    """Names one trial. Equal requests give equal trials."""

    condition: str
    index: int
    attempt: int = 0
    seed: int = 1

    def rng(self, stream: str) -> np.random.Generator:
        """Random numbers of this trial for one purpose, such as "press" or "moisture"."""
        words = [self.seed, self.index, self.attempt]
        words += [zlib.crc32(self.condition.encode()), zlib.crc32(stream.encode())]
        return np.random.default_rng(words)

    @property
    def name(self) -> str:
        """Name of the trial's files."""
        return f"{self.condition}_{self.index:03d}_{self.attempt}"


@dataclass(frozen=True)
class PlannedTrial:
    """A trial ready to be played.

    press: force over time, s from the instant of the first frame. frames: image file of each
    frame, one per frame period from 0 s. frame_time, frame_area (k,): s, and true area in m².
    pressure_center (k, 2): m, of the plate, point without torque of the pressure. moisture (6,) in
    a.u.; pull: sideways while the press is held.
    """

    request: TrialRequest
    press: Press
    frames: list[Path]
    frame_time: np.ndarray
    frame_area: np.ndarray
    pressure_center: np.ndarray
    moisture: np.ndarray
    pull: Pull | None = None
    truth: dict[str, Any] = field(repr=False, default_factory=dict)


def plan_trial(
    request: TrialRequest,
    folder: Path,
    view: CameraView,
    refinement: float = 1.0,
    pose: Pose | None = None,
) -> PlannedTrial:
    """Plan one trial and write its frames into `folder` as PNG. pose: of pad and plate, with the
    fingertip along y; None: a round pad on a level plate."""
    setting = condition(request.condition)
    press, pulled = _press_of(request)
    instants = np.arange(int(press.duration * view.frame_rate) + 1) / view.frame_rate
    finger = SimulatedFinger(setting.material, refinement=refinement)
    history = finger.plan(press.time, press.force, instants)
    round_areas = area_at(history, instants)
    skin_ratio = setting.material.skin_ratio
    correction = PoseCorrection(finger.geometry, pose or Pose(), skin_ratio)

    make_folder(folder)
    renderer = renderer_for(setting.name, view, request.seed)
    renderer.restart_noise(request.rng("noise"))
    centre = request.rng("placement").normal(0.0, PLACEMENT_SD, 2)
    origin = centre + TO_PLATE @ correction.touch.place
    frames, pressed = [], np.zeros((len(instants), 2))
    for number, area in enumerate(round_areas):
        path = folder / f"{request.name}_{number:04d}.png"
        found = correction.outline(float(area))
        pressed[number] = centre + TO_PLATE @ found.center_of_pressure
        contact = contact_of(
            math.sqrt(found.area / math.pi),
            centre + TO_PLATE @ found.center,
            found.semi_axes[0] / found.semi_axes[1] if area > 0 else 1.0,
            pulled,
            float(instants[number]),
            found.orientation + DIRECTION,
            origin,
        )
        image = renderer.render_frame([contact]).image
        # Fast rather than small.
        if not cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
            raise OSError(f"{path}: frame cannot be written")
        frames.append(path)

    areas = np.array([correction.outline(a).area for a in round_areas.tolist()])
    moisture = setting.draw_moisture(request.rng("moisture"), READINGS_PER_TRIAL)
    truth = {
        "request": asdict(request),
        "material": setting.material.to_dict(),
        "geometry": finger.geometry.to_dict(),
        "press": {k: getattr(press, k) for k in ("onset", "cue", "release", "lift_off")},
        "time_s": history.time.tolist(),
        "force_n": history.force.tolist(),
        "area_m2": [correction.outline(a).area for a in history.area.tolist()],
        "pose": asdict(correction.pose),
        "frame_time_s": instants.tolist(),
        "frame_area_m2": areas.tolist(),
        "pressure_center_m": pressed.tolist(),
        "centre_m": centre.tolist(),
        "moisture": moisture.tolist(),
    }
    if pulled is not None:
        truth["pull"] = {
            "friction": pulled.friction,
            "slip": pulled.slip,
            "direction_rad": pulled.direction,
            "time_s": pulled.time.tolist(),
            "tangential_n": pulled.tangential.tolist(),
        }
    return PlannedTrial(request, press, frames, instants, areas, pressed, moisture, pulled, truth)


def _press_of(request: TrialRequest) -> tuple[Press, Pull | None]:
    """The press of a trial, and its pull."""
    rng = request.rng("press")
    if is_pull(request.condition):
        # One finger for all trials of a seed.
        of_finger = TrialRequest(request.condition, 0, 0, request.seed).rng("friction")
        friction = finger_friction(of_finger, request.condition)
        return pressed_and_pulled(rng, request.rng("pull"), friction)
    guided = PRESS_BY_NAME.get(request.condition)
    style = None if guided is None else guided_style(guided)
    target = TARGET_FORCE if guided is None else guided.target_force
    return plan_press(rng, style=style, target_force=target), None


def contact_of(
    radius: float,
    place: np.ndarray,
    aspect: float,
    pull: Pull | None,
    time: float,
    angle: float = DIRECTION,
    origin: np.ndarray | None = None,
) -> Contact:
    """What the camera sees at a time in s of a contact at `place` (2,) (m).

    origin (2,): where the finger touched first, if the contact has moved since: as its pressure
    grows on a tilted plate, other skin touches, and none slides.
    """
    first = place if origin is None else origin
    touched = float(first[0]), float(first[1])
    if pull is not None:
        skin: SkinSlip | None = pull.skin(time, touched)
    else:
        skin = None if origin is None else SkinSlip(touched)
    return Contact(radius, (float(place[0]), float(place[1])), aspect, angle, skin)


@functools.cache
def renderer_for(skin: str, view: CameraView, seed: int) -> FtirRenderer:
    """The renderer of one condition: the same finger and plate for every trial of a seed."""
    scene = Scene(tilt=view.tilt, tilt_direction=math.radians(50.0), noise=view.noise)
    return FtirRenderer(skin, seed, scene, view.width, view.height)


def write_truth(path: Path, trial: PlannedTrial, start_ns: int) -> None:
    """Write the true contact of a played trial; `start_ns` is the stamp of time 0."""
    with atomic_write(path) as file:
        json.dump({**trial.truth, "start_ns": start_ns}, file)
