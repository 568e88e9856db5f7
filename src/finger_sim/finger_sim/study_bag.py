# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A trial of the simulated study as a session bag, such as a recording of the rig would give."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.schema import CALIBRATION_ATTACHMENT
from finger_bag.writer import BagWriter
from finger_common.flags import AreaFlag
from finger_common.guided_pulls import HOLD
from finger_common.stamps import nanoseconds
from finger_common.trial_phases import TrialPhase
from finger_common.usable_press import TYPICAL_AREA_NOISE

from .ftir import FtirRenderer
from .study_trial import FRAME_RATE, StudyTrial, measured_area, measured_force, stream
from .trial_plan import PLACEMENT_SD, CameraView, contact_of, renderer_for

VIEW = CameraView(FRAME_RATE, 640, 512)
"""Area of interest of the paper's camera, 20 × 16 mm of the plate."""

START_NS = 1_767_600_000_000_000_000
"""Stamp of the study's begin: bags of the same seed are alike."""

STICK_NOISE = 0.05
"""Standard deviation of a stick ratio without images; an assumption."""

TRIAL_SECONDS = 60
"""s from the start of a trial to that of the next."""

Record = tuple[float, str, str, dict[str, Any]]
"""Time in s from the press's time 0, topic, frame of the header, other fields."""


def write_bag(
    path: Path,
    trial: StudyTrial,
    seed: int,
    images: bool,
    start_ns: int,
    noise: float = TYPICAL_AREA_NOISE,
) -> None:
    """Write one trial as a session bag.

    images: render frames; without, `contact_area` carries true areas with noise (standard deviation
    in m²). start_ns: stamp of the press's time 0.
    """
    if images:
        areas = "rendered FTIR frames"
    else:
        areas = f"true areas with noise of {noise * 1e6:g} mm² a frame, no images"
    metadata = {
        "session": f"study_{seed}",
        "subject": "SIM1",
        "condition": trial.condition,
        "trial_index": trial.index,
        "target_force": trial.target_force,
        "source": "simulated study" if trial.pull is None else "simulated study of pulls",
        "area_source": areas,
        "seed": seed,
        "misfit": json.dumps(asdict(trial.misfit)),
    }
    records = [*_phases(trial, seed), *_readings(trial), *_wrenches(trial, seed)]
    with BagWriter(path, metadata) as bag:
        if images:
            renderer = renderer_for(trial.condition, VIEW, seed)
            renderer.restart_noise(stream(seed, trial.condition, trial.index, "noise"))
            calibration = renderer.calibration().to_yaml().encode()
            bag.attach(CALIBRATION_ATTACHMENT, calibration, "application/yaml")
            records += _frames(trial, seed, renderer)
        else:
            records += _areas(trial, seed, noise)
        for time, topic, frame, fields in sorted(
            records, key=lambda record: nanoseconds(record[0])
        ):
            stamp = start_ns + nanoseconds(time)
            header = {"stamp": stamp, "frame_id": frame}
            bag.write(topic, {"header": header, **fields}, stamp)


def _phases(trial: StudyTrial, seed: int) -> Iterator[Record]:
    press = trial.press
    for time, phase in (
        (-9.0, TrialPhase.MOISTURE_BEFORE),
        (-0.05, TrialPhase.PRESS),
        *_cues(trial),
        (press.duration, TrialPhase.MOISTURE_AFTER),
        (press.duration + 9.0, TrialPhase.DONE),
    ):
        fields = {
            "session": f"study_{seed}",
            "subject": "SIM1",
            "condition": trial.condition,
            "index": trial.index,
            "phase": int(phase),
            "target_force": trial.target_force,
        }
        yield time, "trial", "", fields


def _cues(trial: StudyTrial) -> list[tuple[float, TrialPhase]]:
    """Times (s) of the cues after that to press."""
    press, pull = trial.press, trial.pull
    if pull is None:
        return [(press.cue, TrialPhase.LIFT)]
    return [(press.cue + HOLD, TrialPhase.PULL), (pull.slip, TrialPhase.LIFT)]


def _readings(trial: StudyTrial) -> Iterator[Record]:
    half = len(trial.moisture) // 2
    for index, value in enumerate(trial.moisture):
        if index < half:
            time, phase = -8.0 + 2.0 * index, 1
        else:
            time, phase = trial.press.duration + 2.0 + 2.0 * (index - half), 2
        fields = {"value": float(value), "index": index, "phase": phase, "source": "simulator"}
        yield time, "moisture", "", fields


def _wrenches(trial: StudyTrial, seed: int) -> Iterator[Record]:
    time, force = measured_force(trial, seed)
    for at, (x, y, z) in zip(time, force.tolist()):
        yield float(at), "wrench", "force_sensor", {"wrench": {"force": {"x": x, "y": y, "z": z}}}


def _areas(trial: StudyTrial, seed: int, noise: float) -> Iterator[Record]:
    rng = stream(seed, trial.condition, trial.index, "stick ratio")
    for time, area, true in zip(trial.frame_time, measured_area(trial, seed, noise), trial.area):
        fields = {
            "gross_area": float(area),
            "real_area": math.nan if true > 0 else 0.0,
            "area_stddev": noise,
            "flags": 0 if true > 0 else int(AreaFlag.NO_CONTACT),
            "stick_ratio": math.nan,
        }
        if trial.pull is not None and true > 0:
            skin = trial.pull.skin(float(time), (0.0, 0.0))
            seen = skin.stick_ratio + rng.normal(0.0, STICK_NOISE)
            fields |= {"stick_ratio": min(max(seen, 0.0), 1.0), "stick_ratio_stddev": STICK_NOISE}
            fields["flags"] = int(AreaFlag.SLIDING) if skin.slid > 0 else 0
        yield float(time), "contact_area", "plate", fields


def _frames(trial: StudyTrial, seed: int, renderer: FtirRenderer) -> Iterator[Record]:
    place = stream(seed, trial.condition, trial.index, "placement").normal(0.0, PLACEMENT_SD, 2)
    for time, area in zip(trial.frame_time, trial.area):
        radius = float(np.sqrt(area / np.pi))
        contact = contact_of(radius, place, trial.misfit.aspect, trial.pull, float(time))
        image = renderer.render_frame([contact]).image
        fields = {
            "height": image.shape[0],
            "width": image.shape[1],
            "encoding": "mono8",
            "is_bigendian": 0,
            "step": image.shape[1],
            "data": image.reshape(-1),
        }
        yield float(time), "image_raw", "camera_optical", fields
