# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A stand-in for the reduced model, and trials made with it: the logic of a fit is tested alone.

The stand-in is the hereditary integral of Lee and Radok (1960) for a sphere, stiffened by the
epidermis: smooth, monotone in every parameter and exact to fit, but no finger.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numba import njit

from finger_fit.options import FitOptions
from finger_fit.problem import FitProblem, prepare_all
from finger_fit.report import write_report
from finger_fit.study import fit_records
from finger_model.fem.full_order import FullOrderModel
from finger_model.laws import StandardLinearSolid

PARAMETERS = StandardLinearSolid.PARAMETERS

TRUTH = np.array([120e3, 25e3, 0.2, 1500e3])
RATE = 500
FRAME_PERIOD = 0.1


@njit
def _contacts(parameters, time, force):
    out = np.empty((2, len(parameters), len(time)))
    for p in range(len(parameters)):
        E0, E1, tau, E2 = parameters[p]
        viscous = 0.0
        for i in range(len(time)):
            if i:
                h = (time[i] - time[i - 1]) / tau
                mean = -np.expm1(-h) / h
                viscous *= np.exp(-h)
                viscous += force[i - 1] * (mean - np.exp(-h)) + force[i] * (1 - mean)
            cube = 9 * 0.011 / 16 * (force[i] / E0 + viscous / E1)
            # A stiff skin flattens area over force, so that E2 is identifiable beside E0 and E1.
            square = max(cube, 0.0) ** (2 / 3)
            out[0, p, i] = np.pi * square / (1 + 0.2e-6 * E2 * force[i])
            # Of the size of a finger's.
            out[1, p, i] = 0.2 * square / 0.011
    return out


class HereditaryModel:
    """`batch` and `contacts` as the reduced model has them."""

    space = PARAMETERS
    geometry_hash = "stand-in geometry"
    hash = "stand-in"

    def batch(self, parameters, trials):
        return [found[0] for found in HereditaryModel.contacts(self, parameters, trials)]

    def contacts(self, parameters, trials):
        parameters = np.atleast_2d(parameters)
        return [_contacts(parameters, time, force)[:, :, rows] for time, force, rows in trials]


class YieldingModel(HereditaryModel):
    """The stand-in, which follows no press beyond an area just above the truth's largest."""

    largest = 1.02 * 114.8e-6

    def batch(self, parameters, trials):
        return [found[0] for found in self.contacts(parameters, trials)]

    def contacts(self, parameters, trials):
        found = []
        for time, force, rows in trials:
            whole = _contacts(np.atleast_2d(parameters), time, force)
            lost = np.maximum.accumulate(whole[0] > self.largest, axis=-1)
            found.append(np.where(lost, np.nan, whole)[:, :, rows])
        return found


@dataclass
class Record:
    """The fields of a recorded trial."""

    bag: str
    condition: str
    index: int
    stamp_ns: np.ndarray
    force: np.ndarray
    area_stamp_ns: np.ndarray
    area: np.ndarray
    area_sd: np.ndarray
    area_flags: np.ndarray
    moisture_before: list = field(default_factory=lambda: [69.0, 70.0, 71.0])
    moisture_after: list = field(default_factory=lambda: [70.0, 70.0, 70.0])
    subject: str = "S01"
    finger: str = ""


def make_record(
    index=0,
    ramp=1.0,
    noise=0.0,
    rng=None,
    condition="natural",
    truth=TRUTH,
    peak=1.5,
    release=0.3,
    frame_period=FRAME_PERIOD,
) -> Record:
    """A press to `peak` N at a steady rate, then a release; areas of the stand-in with noise
    (m²).
    """
    rng = rng or np.random.default_rng(index)
    length = 0.4 + ramp * peak / 1.35 + release + 0.3
    time = np.arange(int(length * RATE)) / RATE
    rising = np.clip((time - 0.4) / ramp * 1.35, 0.0, peak)
    top = 0.4 + ramp * peak / 1.35
    force = np.where(time <= top, rising, peak * np.clip(1 - (time - top) / release, 0.0, 1.0))
    frames = np.arange(int(length / frame_period)) * frame_period + 0.013
    grid = np.unique(np.concatenate([time, frames]))
    drive = np.interp(grid, time, force)
    whole = (grid, drive, np.searchsorted(grid, frames))
    area = HereditaryModel().batch(truth, [whole])[0][0]
    area = area + noise * rng.normal(size=len(area)) * (area > 0)
    offset = 1_700_000_000_000_000_000
    return Record(
        f"{condition}_{index:02d}",
        condition,
        index,
        offset + np.round(time * 1e9).astype(np.int64),
        force,
        offset + np.round(frames * 1e9).astype(np.int64),
        np.maximum(area, 0.0),
        np.full(len(area), 1.5e-6),
        np.where(area > 0, 0, 1),
    )


def make_problem(
    noise=0.0, trials=15, options=None, seed=0, truth=TRUTH, model=None, **record
) -> FitProblem:
    """Presses of 0.5–2 s, areas by the stand-in."""
    options = options or FitOptions()
    rng = np.random.default_rng(seed)
    ramps = rng.uniform(0.5, 2.0, trials)
    records = [
        make_record(i, ramp, noise, rng, truth=truth, **record) for i, ramp in enumerate(ramps)
    ]
    prepared, excluded = prepare_all(records, options)
    assert not excluded
    return FitProblem(prepared, model or HereditaryModel(), options)


class Exact:
    """The stand-in as the better model of a correction or a check."""

    def areas(self, problem, candidates, done=None):
        model = HereditaryModel()
        drives = [(t.time, t.force, t.frames) for t in problem.trials]
        return np.concatenate(model.batch(candidates, drives), axis=1)


def composite(parameters):
    """Composite modulus (Pa) of parameters (…, 4)."""
    return PARAMETERS.quantity("composite_E", parameters)


@pytest.fixture(scope="session")
def double() -> SimpleNamespace:
    """The stand-in and its makers; nothing in it is changed."""
    return SimpleNamespace(
        HereditaryModel=HereditaryModel,
        YieldingModel=YieldingModel,
        Exact=Exact,
        make_record=make_record,
        make_problem=make_problem,
        composite=composite,
        TRUTH=TRUTH,
    )


@pytest.fixture(scope="session")
def study():
    """Two conditions of six trials each, fitted, with one trial that must be excluded."""
    records = []
    for name, truth in (
        ("dry", [100e3, 43e3, 0.1, 1650e3]),
        ("natural", [140e3, 22e3, 0.5, 1795e3]),
    ):
        for i in range(6):
            records.append(
                make_record(i, 0.5 + 0.25 * i, 1e-6, condition=name, truth=np.array(truth))
            )
    records.append(make_record(6, peak=1.0, condition="dry"))
    options = FitOptions(
        full_order=False, bootstrap=12, bias_pairs=4, grid=3, rounds=20, optimizer=["pso", "de"]
    )
    result = fit_records(records, HereditaryModel(), options)
    result.sources = {"geometry_hash": "abc", "reduced_model_hash": "def"}
    return result


@pytest.fixture(scope="session")
def written(study, tmp_path_factory) -> Path:
    """report.html of the study, figures beside it, written while no model can run. A test that
    writes into the folder takes a copy.
    """

    def refuse(*_: object) -> None:
        raise AssertionError("the report runs a model")

    with pytest.MonkeyPatch.context() as patch:
        for fit in study.fits.values():
            patch.setattr(type(fit.problem.model), "batch", refuse)
        patch.setattr(FullOrderModel, "start", refuse)
        return write_report(study, tmp_path_factory.mktemp("report"))
