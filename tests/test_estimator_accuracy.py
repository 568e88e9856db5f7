"""The estimator over sessions of simulated trials: gain by fusion, and its standard deviation.

Truth is the full-order finger of the study (finger_sim). Force and area carry the study's
measurement noise; areas come at 10 Hz. Fast variant: the truth is the reduced model with other
parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from finger_common.usable_press import TYPICAL_AREA_NOISE
from finger_model.estimator import ContactEstimator
from finger_model.finger import load_reduced
from finger_model.geometry import Geometry
from finger_model.parameter_sets import ParameterSet, ParameterSets
from finger_model.reduced import ReducedModel
from finger_sim.conditions import condition
from finger_sim.finger import SimulatedFinger, area_at
from finger_sim.press import plan_press
from finger_sim.study_trial import FORCE_NOISE, Misfit, misfit_of, stream

NATURAL = condition("natural").material.vector()
PARAMETERS = {
    "right": NATURAL,
    "20 % soft": NATURAL * np.array([0.8, 0.8, 1.0, 0.8]),
    "20 % stiff": NATURAL * np.array([1.2, 1.2, 1.0, 1.2]),
}
OPPOSITE = NATURAL * np.array([1.2, 0.8, 1.2, 0.8])
"""Wrong in opposite directions: the error changes its shape within a press."""


@dataclass
class Trial:
    """Truth of one press: time, force, area (n,), frame times (k,)."""

    time: np.ndarray
    force: np.ndarray
    area: np.ndarray
    frames: np.ndarray


@dataclass
class Score:
    """Of all samples in contact: errors of fused, model and measured area; SD given (m²)."""

    fused: np.ndarray
    model: np.ndarray
    measured: np.ndarray
    sd: np.ndarray

    @property
    def normalised(self) -> np.ndarray:
        return self.fused / self.sd

    @property
    def coverage(self) -> float:
        return float(np.mean(np.abs(self.normalised) < 1.96))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def trial_of(seed: int, index: int, misfit: bool, model: ReducedModel | None) -> Trial:
    """Truth by the full order, or by the reduced model when one is given."""
    press = plan_press(stream(seed, "natural", index, "press"))
    phase = stream(seed, "natural", index, "camera").uniform(0.0, 0.1)
    frames = np.arange(phase, press.duration, 0.1)
    time = np.arange(0.0, press.duration, 0.002)
    force = np.interp(time, press.time, press.force)
    off = misfit_of(seed, "natural", index) if misfit else Misfit()
    if model is not None:
        area = model.simulate(NATURAL, time, np.maximum(force, 0.0)).area
    else:
        geometry = Geometry()
        if misfit:
            thickness = geometry.epidermis_thickness * off.epidermis_factor
            geometry = replace(geometry, epidermis_thickness=thickness)
        finger = SimulatedFinger(condition("natural").material, geometry, 1.0)
        area = area_at(finger.plan(press.time, press.force, frames), time)
    return Trial(time, force, np.where(force > 0, area * off.area_factor, 0.0), frames)


def session(trials: list[Trial], parameters: np.ndarray, seed: int) -> Score:
    """One estimator over all trials of a session, 20 s apart."""
    rng = np.random.default_rng(seed)
    sets = ParameterSets([ParameterSet("natural", 69.31, 6.54, tuple(parameters))])
    estimator = ContactEstimator(load_reduced(), sets)
    found: list[list[np.ndarray]] = [[], [], [], []]
    for number, trial in enumerate(trials):
        start = 10**18 + number * 20 * 10**9
        truth = np.interp(trial.frames, trial.time, trial.area)
        measured = np.maximum(truth + rng.normal(0.0, TYPICAL_AREA_NOISE, len(truth)), 0.0)
        for instant, true, area in zip(trial.frames, truth, measured):
            if true > 0:
                estimator.add_area(start + round(instant * 1e9), area, TYPICAL_AREA_NOISE)
        stamps = start + np.round(trial.time * 1e9).astype(np.int64)
        force = trial.force + rng.normal(0.0, FORCE_NOISE, len(trial.force))
        block = estimator.add_wrenches(stamps, np.column_stack([0 * force, 0 * force, -force]))
        counted = block.column("in_contact") & (trial.area > 0)
        found[0].append((block.column("area") - trial.area)[counted])
        found[1].append((block.column("model_area") - trial.area)[counted])
        found[2].append((measured - truth)[truth > 0])
        found[3].append(block.column("area_stddev")[counted])
    return Score(*(np.concatenate(part) for part in found))


def check(score: Score, off: bool) -> None:
    assert rms(score.fused) <= rms(score.measured)
    if off:
        assert rms(score.fused) <= 1.1 * min(rms(score.model), rms(score.measured))
        assert rms(score.fused) <= 0.5 * rms(score.model)
    assert 0.7 <= score.normalised.std() <= 1.3
    assert 0.90 <= score.coverage <= 0.99
    assert score.sd.mean() < TYPICAL_AREA_NOISE


@pytest.mark.parametrize("which", ["20 % soft", "20 % stiff"])
def test_fusion_halves_the_error_of_wrong_parameters(which: str) -> None:
    model = ReducedModel.load()
    trials = [trial_of(1, i, False, model) for i in range(10)]
    score = session(trials, PARAMETERS[which], 1)
    assert rms(score.fused) <= 0.5 * rms(score.model)
    assert rms(score.fused) <= 1.1 * rms(score.measured)
    assert score.coverage >= 0.9
    assert score.sd.mean() < TYPICAL_AREA_NOISE


def pooled_score(name: str, parameters: np.ndarray, misfit: bool) -> Score:
    """Three sessions of ten full-order presses each; prints a row of docs/estimator.md."""
    scores = []
    for seed in (1, 2, 3):
        trials = [trial_of(seed, i, misfit, None) for i in range(10)]
        scores.append(session(trials, parameters, seed))
    pooled = Score(
        *(
            np.concatenate([getattr(s, n) for s in scores])
            for n in ("fused", "model", "measured", "sd")
        )
    )
    print(
        f"{name}, misfit {misfit}: normalised error SD {pooled.normalised.std():.2f}, coverage "
        f"{100 * pooled.coverage:.1f} %, RMS fused {1e6 * rms(pooled.fused):.2f}, model "
        f"{1e6 * rms(pooled.model):.2f}, measured {1e6 * rms(pooled.measured):.2f} mm², mean SD "
        f"{1e6 * pooled.sd.mean():.2f} mm²"
    )
    return pooled


@pytest.mark.slow
@pytest.mark.parametrize("misfit", [False, True])
@pytest.mark.parametrize("which", list(PARAMETERS))
def test_the_standard_deviation_is_calibrated_and_small(which: str, misfit: bool) -> None:
    check(pooled_score(which, PARAMETERS[which], misfit), which != "right")


@pytest.mark.slow
@pytest.mark.parametrize("misfit", [False, True])
def test_errors_that_change_shape_within_a_press_are_halved_too(misfit: bool) -> None:
    score = pooled_score("opposite", OPPOSITE, misfit)
    assert rms(score.fused) <= 0.5 * rms(score.model)
    assert rms(score.fused) <= 1.1 * rms(score.measured)
    assert score.sd.mean() < TYPICAL_AREA_NOISE
