"""A trial of the simulated rig, worked out ahead of time: press, contact, frames, moisture readings.

The full-order model and the renderer are slower than real time, so a worker process plans each trial before it is
played. What is planned depends on the seed and the trial's name alone.
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

from finger_common.files import atomic_write
from finger_model.geometry import Geometry

from .conditions import condition
from .finger import SimulatedFinger, area_at
from .ftir import IMAGE_HEIGHT, IMAGE_WIDTH, FtirRenderer, Scene
from .press import Press, PressStyle, plan_press

PLACEMENT_SD = 0.4e-3
"""m, scatter of the finger's place on the plate in either direction, an assumption."""

READINGS = 6
"""Moisture readings of a trial: three before and three after the press (paper)."""


@dataclass(frozen=True)
class CameraView:
    """What the simulated camera sees: frames per s, size in pixels, tilt of its axis, noise.

    A pixel covers `ftir.AREA_PER_PIXEL` of the plate; a smaller frame is an area of interest of the same sensor.
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
        """Generator of one stream ("press", "frames", "moisture") of this trial."""
        words = [self.seed, self.index, self.attempt]
        words += [zlib.crc32(self.condition.encode()), zlib.crc32(stream.encode())]
        return np.random.default_rng(words)

    @property
    def name(self) -> str:
        return f"{self.condition}_{self.index:03d}_{self.attempt}"


@dataclass(frozen=True)
class PlannedTrial:
    """A trial ready to be played.

    press: force over time, s from the instant of the first frame. frames: image file of each frame, one per
    frame period from 0 s. frame_area (k,): true area in m² at each frame. moisture (6,) in a.u.
    """

    request: TrialRequest
    press: Press
    frames: list[Path]
    frame_area: np.ndarray
    moisture: np.ndarray
    truth: dict[str, Any] = field(repr=False, default_factory=dict)


def plan_trial(
    request: TrialRequest,
    folder: Path,
    view: CameraView,
    style: PressStyle | None = None,
    refinement: float = 1.0,
    geometry: Geometry | None = None,
) -> PlannedTrial:
    """Work out one trial and write its frames into `folder` as PNG."""
    setting = condition(request.condition)
    press = plan_press(request.rng("press"), style=style)
    instants = np.arange(int(press.duration * view.frame_rate) + 1) / view.frame_rate
    finger = SimulatedFinger(setting.material, geometry, refinement)
    history = finger.plan(press.time, press.force, instants)
    areas = area_at(history, instants)

    folder.mkdir(parents=True, exist_ok=True)
    renderer = renderer_for(request.condition, view, request.seed)
    centre = request.rng("placement").normal(0.0, PLACEMENT_SD, 2)
    frames = []
    for number, area in enumerate(areas):
        path = folder / f"{request.name}_{number:04d}.png"
        radius = float(np.sqrt(area / np.pi))
        write_frame(path, renderer.render(radius, (float(centre[0]), float(centre[1]))))
        frames.append(path)

    moisture = setting.draw_moisture(request.rng("moisture"), READINGS)
    truth = {
        "request": asdict(request),
        "material": setting.material.to_dict(),
        "geometry": finger.geometry.to_dict(),
        "press": {k: getattr(press, k) for k in ("onset", "cue", "release", "lift_off")},
        "time_s": history.time.tolist(),
        "force_n": history.force.tolist(),
        "area_m2": history.area.tolist(),
        "frame_time_s": instants.tolist(),
        "frame_area_m2": areas.tolist(),
        "centre_m": centre.tolist(),
        "moisture": moisture.tolist(),
    }
    return PlannedTrial(request, press, frames, areas, moisture, truth)


@functools.cache
def renderer_for(look: str, view: CameraView, seed: int) -> FtirRenderer:
    """The renderer of one condition: the same finger and plate for every trial of a seed."""
    scene = Scene(tilt=view.tilt, tilt_direction=math.radians(50.0), noise=view.noise)
    return FtirRenderer(look, seed, scene, view.width, view.height)


def write_frame(path: Path, image: np.ndarray) -> None:
    """Write a grey image (H, W) uint8 as PNG, fast rather than small."""
    ok, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not ok:
        raise ValueError(f"image of shape {image.shape} and type {image.dtype} cannot be a PNG")
    path.write_bytes(data.tobytes())


def write_truth(path: Path, trial: PlannedTrial, start_ns: int) -> None:
    """Write what really happened in a played trial, for tests alone; `start_ns` is the stamp of time 0."""
    with atomic_write(path) as file:
        json.dump({**trial.truth, "start_ns": start_ns}, file)
