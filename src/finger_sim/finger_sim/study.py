"""The paper's whole experiment on a simulated finger, written as bags: 45 presses, 15 in each of three conditions.

The finger is the full-order model on a finer mesh than any fit uses, with the study's known materials. A fit sees
bytes and pixels only; what really happened is in `truth.json` beside the bags, for those who judge a fit.

Areas either come from rendered FTIR frames (`images`), or are the true ones with measurement noise; the bag's
metadata says which. With `misfit`, trials also differ in ways a fit does not know of.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.schema import CALIBRATION_ATTACHMENT
from finger_bag.writer import BagWriter
from finger_common.errors import InputError
from finger_common.files import atomic_write
from finger_model.geometry import Geometry
from finger_vision.calibration import PlateCalibration

from . import ftir
from .conditions import STUDY, condition
from .finger import SimulatedFinger, area_at
from .press import TARGET_FORCE, Press, PressStyle, plan_press
from .trial_plan import PLACEMENT_SD, CameraView, renderer_for

TRIALS = 15
"""Presses per condition (paper)."""

REFINEMENT = 1.5
"""Of the finger's mesh; reduced model and full-order check of a fit use 1."""

FORCE_RESOLUTION = 1.0 / 171.0
"""N, resolution of the Nano17 Titanium SI-32-0.2 (paper)."""

FORCE_NOISE = 0.004
"""N, standard deviation of a force sample before rounding; an assumption below the resolution."""

AREA_NOISE = 1.5e-6
"""m², standard deviation of an area without images, independent from frame to frame; an assumption."""

FORCE_RATE = 500.0
FRAME_RATE = 10.0

VIEW = CameraView(FRAME_RATE, 640, 512)
"""Area of interest of the paper's camera, 20 × 16 mm of the plate."""

START_NS = 1_767_600_000_000_000_000
"""Stamp of the study's begin: bags of the same seed are alike."""

TRIAL_SECONDS = 60


@dataclass(frozen=True)
class Misfit:
    """How one trial differs from what a fit assumes.

    area_factor: contact angle and pad size change the area of a trial by 5 % (standard deviation). aspect: real
    contacts are ellipses. epidermis_factor: thickness of the finger's epidermis over the fit's.
    """

    area_factor: float = 1.0
    aspect: float = 1.0
    epidermis_factor: float = 1.0


AREA_SCATTER = 0.05
ELLIPSE_ASPECT = 1.3
EPIDERMIS_FACTORS = (0.75, 1.25)
"""The epidermis of a misfit study is this much thinner or thicker, all its trials alike: it is one finger."""


@dataclass(frozen=True)
class StudyTrial:
    """One press of the study with its truth (SI).

    press: from 0 s; frame_time (k,), area (k,): frames and true areas at them, misfit included; moisture (6,) a.u.
    """

    condition: str
    index: int
    press: Press
    frame_time: np.ndarray
    area: np.ndarray
    moisture: np.ndarray
    misfit: Misfit


def stream(seed: int, name: str, index: int, what: str) -> np.random.Generator:
    """Random numbers of one trial for one purpose; independent of every other trial."""
    words = [seed, index, zlib.crc32(name.encode()), zlib.crc32(what.encode())]
    return np.random.default_rng(words)


def misfit_of(seed: int, name: str, index: int) -> Misfit:
    """Drawn misfit of one trial; the epidermis is the same for a whole seed."""
    factor = float(np.exp(stream(seed, name, index, "misfit").normal(0.0, AREA_SCATTER)))
    return Misfit(factor, ELLIPSE_ASPECT, EPIDERMIS_FACTORS[seed % 2])


def plan_study_trial(
    seed: int,
    name: str,
    index: int,
    misfit: bool | Misfit = False,
    refinement: float = REFINEMENT,
    style: PressStyle | None = None,
) -> StudyTrial:
    """Press and contact of one trial; equal arguments give equal trials. misfit: drawn when True, or as given."""
    setting = condition(name)
    press = plan_press(stream(seed, name, index, "press"), style=style)
    phase = stream(seed, name, index, "camera").uniform(0.0, 1.0 / FRAME_RATE)
    frame_time = np.arange(phase, press.duration, 1.0 / FRAME_RATE)
    if isinstance(misfit, Misfit):
        off = misfit
    else:
        off = misfit_of(seed, name, index) if misfit else Misfit()
    geometry = Geometry()
    if off.epidermis_factor != 1.0:
        geometry = replace(
            geometry, epidermis_thickness=geometry.epidermis_thickness * off.epidermis_factor
        )
    finger = SimulatedFinger(setting.material, geometry, refinement)
    history = finger.plan(press.time, press.force, frame_time)
    area = area_at(history, frame_time) * off.area_factor
    area[np.interp(frame_time, press.time, press.force) <= 0] = 0.0
    moisture = setting.draw_moisture(stream(seed, name, index, "moisture"))
    return StudyTrial(name, index, press, frame_time, area, moisture, off)


def measured_force(trial: StudyTrial, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) in s and force (n, 3) in N as the sensor gives it: noise, then rounding to its resolution.

    The finger presses along −z of the sensor.
    """
    rng = stream(seed, trial.condition, trial.index, "force")
    time = np.arange(0.0, trial.press.duration, 1.0 / FORCE_RATE)
    force = rng.normal(0.0, FORCE_NOISE, (len(time), 3))
    force[:, 2] -= np.interp(time, trial.press.time, trial.press.force)
    return time, np.round(force / FORCE_RESOLUTION) * FORCE_RESOLUTION


def measured_area(trial: StudyTrial, seed: int, noise: float = AREA_NOISE) -> np.ndarray:
    """True areas (k,) in m² with measurement noise; exactly zero without contact."""
    rng = stream(seed, trial.condition, trial.index, "area")
    noisy = trial.area + rng.normal(0.0, noise, len(trial.area))
    return np.where(trial.area > 0, np.maximum(noisy, 0.0), 0.0)


def simulate_study(
    seed: int,
    output: str | Path,
    images: bool = True,
    misfit: bool = False,
    trials: int = TRIALS,
    conditions: Sequence[str] = tuple(STUDY),
    processes: int = 2,
    refinement: float = REFINEMENT,
    report: Callable[[str], None] | None = print,
) -> list[Path]:
    """Simulate the study and write one bag per trial into `output`; returns the bags in order.

    images: render FTIR frames (areas must then be measured in them); without, `contact_area` carries true areas with
    noise, and the metadata says so. A bag that exists already is kept, so that an interrupted study goes on. Raises
    InputError for an unknown condition or a folder with the bags of another study.
    """
    for name in conditions:
        condition(name)
    if trials < 1:
        raise InputError(f"study: {trials} trials per condition, at least 1 is needed")
    folder = Path(output)
    plan = {
        "seed": seed,
        "images": images,
        "misfit": misfit,
        "trials": trials,
        "conditions": list(conditions),
        "refinement": refinement,
    }
    _claim(folder, plan)
    jobs = [(number, name, index) for number, (name, index) in enumerate(
        (name, index) for name in conditions for index in range(trials)
    )]  # fmt: skip
    bags = [folder / f"{name}_{index:02d}" for _, name, index in jobs]
    write = partial(_write_trial, folder, seed, images, misfit, refinement)
    say = report or (lambda text: None)
    say(
        f"simulating {len(jobs)} trials, seed {seed}, "
        + ("with FTIR frames" if images else "areas with noise, no images")
        + (", with misfit" if misfit else "")
    )
    if processes > 1 and len(jobs) > 1:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(processes, context) as pool:
            for number, line in enumerate(pool.map(write, jobs), 1):
                say(f"[{number}/{len(jobs)}] {line}")
    else:
        for number, job in enumerate(jobs, 1):
            say(f"[{number}/{len(jobs)}] {write(job)}")
    truth = {
        **plan,
        "materials": {name: condition(name).material.to_dict() for name in conditions},
        "epidermis_factor": EPIDERMIS_FACTORS[seed % 2] if misfit else 1.0,
        "target_force": TARGET_FORCE,
    }
    with atomic_write(folder / "truth.json") as file:
        json.dump(truth, file, indent=1)
    say(f"{len(bags)} bags in {folder}")
    return bags


def _claim(folder: Path, plan: dict[str, Any]) -> None:
    """Refuse a folder with another study in it."""
    marker = folder / "study.json"
    text = json.dumps(plan, indent=1)
    if marker.exists():
        if marker.read_text(encoding="utf-8") != text:
            raise InputError(
                f"{folder}: holds another simulated study (see study.json); choose another folder"
            )
        return
    with atomic_write(marker) as file:
        file.write(text)


def _write_trial(
    folder: Path,
    seed: int,
    images: bool,
    misfit: bool,
    refinement: float,
    job: tuple[int, str, int],
) -> str:
    """Simulate one trial and write its bag; returns a line of progress."""
    number, name, index = job
    bag = folder / f"{name}_{index:02d}"
    if (bag / "metadata.yaml").exists():
        return f"{bag.name} exists already"
    trial = plan_study_trial(seed, name, index, misfit, refinement)
    write_bag(bag, trial, seed, images, START_NS + number * TRIAL_SECONDS * 1_000_000_000)
    peak = float(trial.press.force.max())
    return f"{bag.name}: {trial.press.cue - trial.press.onset:.2f} s to target, peak {peak:.2f} N, {trial.area.max() * 1e6:.1f} mm²"


def write_bag(
    path: Path, trial: StudyTrial, seed: int, images: bool, start_ns: int, noise: float = AREA_NOISE
) -> None:
    """Write one trial as a session bag; `start_ns` is the stamp of the press's time 0."""
    metadata = {
        "session": f"study_{seed}",
        "subject": "SIM1",
        "condition": trial.condition,
        "trial_index": trial.index,
        "target_force": TARGET_FORCE,
        "source": "simulated study",
        "area_source": "rendered FTIR frames"
        if images
        else f"true areas with noise of {noise * 1e6:g} mm² a frame, no images",
        "seed": seed,
        "misfit": json.dumps(asdict(trial.misfit)),
    }

    def stamp(seconds: float) -> int:
        return start_ns + round(seconds * 1e9)

    events: list[tuple[int, str, dict[str, Any]]] = []

    def add(at_ns: int, topic: str, frame: str = "", **fields: Any) -> None:
        events.append((at_ns, topic, {"header": {"stamp": at_ns, "frame_id": frame}, **fields}))

    press = trial.press
    for seconds, phase in (
        (-9.0, 2),
        (-0.05, 3),
        (press.cue, 4),
        (press.duration, 5),
        (press.duration + 9.0, 6),
    ):
        add(
            stamp(seconds), "trial", session=f"study_{seed}", subject="SIM1",
            condition=trial.condition, index=trial.index, phase=phase, target_force=TARGET_FORCE,
        )  # fmt: skip
    for k, value in enumerate(trial.moisture):
        before = k < len(trial.moisture) // 2
        seconds = -8.0 + 2.0 * k if before else press.duration + 2.0 + 2.0 * (k - 3)
        add(
            stamp(seconds), "moisture", value=float(value), index=k, phase=1 if before else 2,
            source="simulator",
        )  # fmt: skip
    time, force = measured_force(trial, seed)
    for seconds, (x, y, z) in zip(time, force.tolist()):
        add(stamp(seconds), "wrench", "force_sensor", wrench={"force": {"x": x, "y": y, "z": z}})
    attachments: list[tuple[str, bytes]] = []
    if images:
        attachments.append((CALIBRATION_ATTACHMENT, _frames(trial, seed, stamp, add)))
    else:
        for seconds, area, true in zip(
            trial.frame_time, measured_area(trial, seed, noise), trial.area
        ):
            add(
                stamp(seconds), "contact_area", "plate", gross_area=float(area),
                real_area=math.nan if true > 0 else 0.0, area_stddev=noise,
                flags=0 if true > 0 else 1,
            )  # fmt: skip
    with BagWriter(path, metadata) as bag:
        for name, data in attachments:
            bag.attach(name, data, "application/yaml")
        for at_ns, topic, fields in sorted(events, key=lambda event: event[0]):
            bag.write(topic, fields, at_ns)


def _frames(
    trial: StudyTrial,
    seed: int,
    stamp: Callable[[float], int],
    add: Callable[..., None],
) -> bytes:
    """Render the trial's frames and return the plate calibration's text."""
    renderer = renderer_for(trial.condition, VIEW, seed)
    rng = stream(seed, trial.condition, trial.index, "placement")
    x, y = rng.normal(0.0, PLACEMENT_SD, 2)
    for seconds, area in zip(trial.frame_time, trial.area):
        image = renderer.render(
            float(np.sqrt(area / np.pi)), (float(x), float(y)), trial.misfit.aspect
        )
        add(
            stamp(seconds), "image_raw", "camera_optical", height=image.shape[0], width=image.shape[1],
            encoding="mono8", is_bigendian=0, step=image.shape[1], data=image.reshape(-1),
        )  # fmt: skip
    import tempfile

    calibration = PlateCalibration(
        ftir.AREA_PER_PIXEL,
        np.linalg.inv(renderer.homography),
        renderer.camera_matrix,
        image_size=(VIEW.width, VIEW.height),
        camera_name="camera",
    )
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / CALIBRATION_ATTACHMENT
        calibration.save(path)
        return path.read_bytes()
