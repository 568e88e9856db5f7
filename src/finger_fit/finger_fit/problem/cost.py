# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The cost J of a parameter set on the frames that count, as in the paper.

J = Σ over trials of the mean over the trial's frames of (model area − measured area)², in m⁴
(reports: mm⁴).
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from finger_common.files import sha256_of
from finger_model.laws import ConstitutiveLaw, ParameterSpace, StandardLinearSolid

from ..options import FitOptions
from .goal import Goal, Nuisances, losses
from .trials import FitTrial

_batch_lock = threading.Lock()
"""The compiled kernels of a batch share one pool of threads and do not nest."""


class AreaModel(Protocol):
    """What a fit needs of a model: the space of its parameters, and areas."""

    space: ParameterSpace

    def batch(
        self, parameters: np.ndarray, trials: Sequence[tuple[np.ndarray, ...]]
    ) -> list[np.ndarray]:
        """Areas (P, f) in m² per trial, of parameters (P, D) in SI units.

        A trial is time (n,) in s, force (n,) in N and rows (f,), the samples whose area is wanted.
        """
        ...


def batch_areas(
    model: Any, parameters: np.ndarray, drives: Sequence[tuple[np.ndarray, ...]]
) -> list[np.ndarray]:
    """`AreaModel.batch` of a model, one call at a time."""
    with _batch_lock:
        return model.batch(parameters, drives)


def material_of(model: Any) -> ConstitutiveLaw:
    """Law and fixed properties of a model; the default law where the model states none."""
    return getattr(model, "material", None) or StandardLinearSolid()


@dataclass(frozen=True)
class AreaCorrection:
    """Factor that turns a model's areas into those of a better model, near some parameters.

    The logarithm of the factor is linear in the space's correction coordinates (logarithms):
    log_ratio (n,) at `centre` (D,), a parameter set, and slope (D, n).
    """

    space: ParameterSpace
    centre: np.ndarray
    log_ratio: np.ndarray
    slope: np.ndarray

    def factor(self, parameters: np.ndarray) -> np.ndarray:
        """Factor (P, n) for parameters (P, D)."""
        place = self.space.correction_coordinates
        away = np.atleast_2d(place(parameters)) - place(self.centre)
        return np.exp(self.log_ratio + away @ self.slope)


class FitProblem:
    """Trials of one condition, the model and the options: everything J depends on.

    space: of the model's parameters; box (D, 2): the search box in SI units. Arrays over all
    frames, trial after trial: measured (n,) m², force (n,) N, trial_of (n,), weight (n,), which
    sums to one within a trial. correction: of the model's areas, None before the correction to
    full order. nuisances: eliminated from the cost, None before they were estimated. Calls are
    deterministic and safe from several threads.
    """

    def __init__(self, trials: Sequence[FitTrial], model: AreaModel, options: FitOptions) -> None:
        self.trials = tuple(trials)
        self.model = model
        self.options = options
        self.space: ParameterSpace = model.space
        self.box = options.box(self.space)
        self.measured = np.concatenate([t.area for t in self.trials])
        self.force = np.concatenate([t.frame_force for t in self.trials])
        lengths = [len(t.frames) for t in self.trials]
        self.trial_of = np.repeat(np.arange(len(lengths)), lengths)
        self.starts = np.concatenate([[0], np.cumsum(lengths)])
        raw = np.where(np.concatenate([t.low for t in self.trials]), options.low_force_weight, 1.0)
        sums = np.add.reduceat(raw, self.starts[:-1])
        # A trial whose frames all have weight zero does not count.
        self.weight = raw / np.where(sums > 0, sums, 1.0)[self.trial_of]
        self.correction: AreaCorrection | None = None
        self.nuisances: Nuisances | None = None
        self._drives = [(t.time, t.force, t.frames) for t in self.trials]

    def __len__(self) -> int:
        return len(self.trials)

    def areas(self, parameters: np.ndarray) -> np.ndarray:
        """Areas (P, n) in m² at the frames that count, for parameters (P, D): the model's,
        corrected."""
        raw = self.raw_areas(parameters)
        if self.correction is None:
            return raw
        return raw * self.correction.factor(parameters)

    def raw_areas(self, parameters: np.ndarray) -> np.ndarray:
        """As `areas`, without the correction."""
        parameters = np.atleast_2d(np.asarray(parameters, dtype=float))
        return np.concatenate(batch_areas(self.model, parameters, self._drives), axis=1)

    def uncorrected(self) -> FitProblem:
        """The same problem without correction and nuisances, which a fit sets."""
        found = copy.copy(self)
        found.correction = found.nuisances = None
        return found

    def redrive(self, trials: Sequence[FitTrial]) -> None:
        """Take the same trials under other drives (another tare, another lag)."""
        self.trials = tuple(trials)
        self.force = np.concatenate([t.frame_force for t in self.trials])
        self._drives = [(t.time, t.force, t.frames) for t in self.trials]

    def trial_costs(self, areas: np.ndarray) -> np.ndarray:
        """Part of J (…, T) in m⁴ of every trial for areas (…, n), whatever the nuisances: the
        weighted mean of its frames' losses."""
        lost = self.weight * losses(areas - self.measured, self.options)
        return np.add.reduceat(lost, self.starts[:-1], axis=-1)

    def goal(self, weight: np.ndarray | None = None) -> Goal:
        """What is minimised, under the problem's weights or others (n,), as the bootstrap has."""
        if weight is None:
            return Goal(self.measured, self.weight, self.options, self.nuisances)
        own = np.add.reduceat(self.weight, self.starts[:-1])
        given = np.add.reduceat(weight, self.starts[:-1])
        repeats = np.divide(given, own, out=np.zeros_like(own), where=own > 0)
        return Goal(self.measured, weight, self.options, self.nuisances, repeats)

    def cost(self, parameters: np.ndarray) -> np.ndarray:
        """J (P,) in m⁴ of parameters (P, D), with the nuisances eliminated where there are any."""
        areas = self.areas(parameters)
        if self.nuisances is None:
            return self.trial_costs(areas).sum(axis=-1)
        return self.goal().cost(areas)

    def key(self) -> str:
        """Hash of what a cost depends on: frames, drive, weights, loss and model."""
        parts: list[Any] = [self.measured.tobytes(), self.weight.tobytes()]
        for trial in self.trials:
            parts += [trial.time.tobytes(), trial.force.tobytes(), trial.frames.tobytes()]
        parts.append(str(getattr(self.model, "hash", "")).encode())
        return sha256_of([sha256_of(b"".join(parts)), self.options.loss, self.options.huber_scale])
