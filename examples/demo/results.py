"""The demo's results as plain data for figures and report."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.reader import open_bag
from finger_fit.report_units import MM2, MM4
from finger_fit.results import ConditionFit
from finger_model.reduced import ReducedModel
from finger_offline.image_settings import ImageSettings
from finger_offline.trial_records import TrialRecord
from finger_offline.trials import load_trials
from finger_sim.conditions import STUDY
from finger_vision.messages import image_of

from .session import SessionRequest

PARAMETERS = (
    ("composite_E", "E = 1/(1/E0+1/E1)", 1e-3, "kPa"),
    ("E2", "E2", 1e-3, "kPa"),
    ("E1", "E1", 1e-3, "kPa"),
    ("E0", "E0", 1e-3, "kPa"),
    ("tau1", "τ1", 1.0, "s"),
)
"""Key, label, factor from SI, unit; the best identifiable first."""


PIXELATED = 12
"""Pixels of a block in pictures of prints, which are biometric data."""


@dataclass
class DemoResult:
    """What the demo made. seconds: by stage."""

    folder: Path
    bags: list[Path] = field(default_factory=list)
    processed: list[Path] = field(default_factory=list)
    fit: Any = None
    repeated: int = 0
    seconds: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class TrialCurve:
    """Measured frames (k,) and the model's curve (n,) of one press: s from onset, N, mm².

    counted: frames in J.
    """

    index: int
    frame_time: np.ndarray
    frame_force: np.ndarray
    frame_area: np.ndarray
    counted: np.ndarray
    time: np.ndarray
    force: np.ndarray
    area: np.ndarray
    true_time: np.ndarray
    true_area: np.ndarray


@dataclass(frozen=True)
class ConditionResult:
    """One condition's result: parameters by name in SI, intervals (low, high) or None, J in mm⁴."""

    name: str
    fitted: Mapping[str, float]
    true: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float] | None]
    cost: float
    power_law_cost: float
    true_cost: float
    k: float
    m: float
    moisture: Sequence[Sequence[float]]
    paper_moisture: tuple[float, float]
    curves: Sequence[TrialCurve]


@dataclass(frozen=True)
class LivePress:
    """What the suite published live during one press: s from the first sample, N, mm²."""

    condition: str
    time: np.ndarray
    force: np.ndarray
    area: np.ndarray
    area_sd: np.ndarray
    frame_time: np.ndarray
    frame_area: np.ndarray
    true_time: np.ndarray
    true_area: np.ndarray
    picture: np.ndarray
    picture_outline: np.ndarray


Truths = dict[tuple[str, int, int], dict[str, Any]]
"""What really happened, by condition, index and attempt."""


def true_trials(folder: Path) -> Truths:
    """The truth files of a simulated rig."""
    found: Truths = {}
    for path in sorted(folder.glob("*.json")):
        truth = json.loads(path.read_text())
        request = truth["request"]
        found[request["condition"], request["index"], request["attempt"]] = truth
    return found


def condition_result(
    fit: ConditionFit, records: Sequence[TrialRecord], model: ReducedModel, truth: Truths
) -> ConditionResult:
    """A condition's result as plain data. records: the fit's trials, of all conditions."""
    name = fit.condition
    material = STUDY[name].material
    true = fit.space.quantities(material.vector())
    fitted = fit.space.quantities(fit.parameters)
    intervals: dict[str, tuple[float, float] | None] = {}
    for key, profile in fit.profiles.items():
        low, high = profile.interval
        box_low, box_high = profile.values.min(), profile.values.max()
        intervals[key] = (
            float(low) if np.isfinite(low) else float(box_low),
            float(high) if np.isfinite(high) else float(box_high),
        )
    true_cost = float(fit.problem.cost(material.vector()[None])[0]) * MM4
    by_index = {r.index: r for r in records if r.condition == name}
    curves = [
        trial_curve(by_index[trial.index], trial.area, fit, model, truth)
        for trial in fit.problem.trials
    ]
    return ConditionResult(
        name,
        fitted,
        true,
        intervals,
        fit.cost * MM4,
        fit.power_law.cost * MM4,
        true_cost,
        fit.power_law.k,
        fit.power_law.m,
        [trial.readings.tolist() for trial in fit.problem.trials],
        (STUDY[name].moisture, STUDY[name].moisture_sd),
        curves,
    )


def trial_curve(
    record: TrialRecord,
    counted: np.ndarray,
    fit: ConditionFit,
    model: ReducedModel,
    truth: Truths,
) -> TrialCurve:
    """One press from onset to lift-off: frames, fitted model under the recorded force, truth.

    counted: the areas that count in J.
    """
    really = truth[record.condition, record.index, record.attempt]
    onset_ns = really["start_ns"] + round(really["press"]["onset"] * 1e9)
    end = really["press"]["lift_off"] - really["press"]["onset"] + 0.05
    time = (record.stamp_ns - onset_ns) * 1e-9
    # Means over 10 ms keep the sensor's noise from driving the model.
    bins = np.unique(np.round(time / 0.01).astype(int), return_inverse=True)[1]
    number = np.bincount(bins)
    time = np.bincount(bins, time) / number
    force = np.maximum(np.bincount(bins, record.force) / number, 0.0)
    history = model.simulate(fit.parameters, time, force)
    shown = (time > -0.02) & (time < end)
    frame_time = (record.area_stamp_ns - onset_ns) * 1e-9
    framed = (frame_time > -0.02) & (frame_time < end) & (record.area > 0)
    true_time = np.array(really["time_s"]) - really["press"]["onset"]
    inside = (true_time >= 0) & (true_time < end)
    return TrialCurve(
        record.index,
        frame_time[framed],
        np.interp(frame_time[framed], time, force),
        record.area[framed] * MM2,
        np.isin(record.area[framed], counted),
        time[shown],
        force[shown],
        history.area[shown] * MM2,
        true_time[inside],
        np.array(really["area_m2"])[inside] * MM2,
    )


def live_press(bag: Path, truth: dict[str, Any]) -> LivePress:
    """What the suite published live, from a bag as recorded."""
    stamp, force, area, deviation = [], [], [], []
    frames: list[tuple[int, float]] = []
    largest: tuple[float, int, np.ndarray] = (-1.0, 0, np.empty((0, 2)))
    with open_bag(bag) as reader:
        topics = {t.rsplit("/", 1)[-1]: t for t in reader.info.topics}
        wanted = [topics["contact_state"], topics["contact_area"]]
        for item in reader.messages(wanted):
            message = item.message
            at = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            if item.topic == topics["contact_state"]:
                stamp.append(at)
                force.append(message.normal_force)
                area.append(message.area * MM2)
                deviation.append(message.area_stddev * MM2)
            else:
                frames.append((at, message.gross_area * MM2))
                if message.gross_area > largest[0]:
                    hull = np.array([(p.x, p.y) for p in message.hull])
                    largest = (message.gross_area, at, hull)
        picture = next(
            image_of(item.message)
            for item in reader.messages([topics["image_raw"]])
            if item.message.header.stamp.sec * 1_000_000_000 + item.message.header.stamp.nanosec
            == largest[1]
        )
    outline = outline_in_pixels(bag, largest[2], picture.shape)
    start = truth["start_ns"]
    time = (np.array(stamp) - start) * 1e-9
    end = truth["press"]["lift_off"] + 0.2
    inside = (time > 0) & (time < end)
    frame_time = (np.array([at for at, _ in frames]) - start) * 1e-9
    frame_inside = (frame_time > 0) & (frame_time < end)
    true_time = np.array(truth["time_s"])
    return LivePress(
        truth["request"]["condition"],
        time[inside],
        np.array(force)[inside],
        np.array(area)[inside],
        np.array(deviation)[inside],
        frame_time[frame_inside],
        np.array([a for _, a in frames])[frame_inside],
        true_time[true_time < end],
        (np.array(truth["area_m2"]) * MM2)[true_time < end],
        pixelate(picture),
        outline,
    )


def outline_in_pixels(bag: Path, hull: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Outline (n, 2) in pixels by the calibration attached to the bag."""
    if not len(hull):
        return hull
    with open_bag(bag) as reader:
        calibration = ImageSettings().plate(reader)
    return calibration.to_pixels(hull, shape[1], shape[0])


def pixelate(image: np.ndarray, block: int = PIXELATED) -> np.ndarray:
    """Image (H, W) uint8 in blocks coarser than the ridges."""
    height, width = (n - n % block for n in image.shape)
    blocks = image[:height, :width].reshape(height // block, block, width // block, block)
    coarse = blocks.mean(axis=(1, 3)).astype(np.uint8)
    return np.kron(coarse, np.ones((block, block), np.uint8))


def gather(result: DemoResult, request: SessionRequest) -> list[ConditionResult]:
    """All conditions' results."""
    model = ReducedModel.load()
    truth = true_trials(request.truth)
    records = load_trials(result.processed).trials
    return [condition_result(fit, records, model, truth) for fit in result.fit.fits.values()]
