# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How the areas of a fit answer to the finger's lengths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from finger_common.errors import InputError
from finger_model.geometry import Geometry

from ..engine import Done
from ..full_order import FullOrder
from ..full_order.areas import trial_areas
from ..problem import FitProblem, FitTrial

REFINEMENT = 0.5
"""Of the mesh of the full-order runs. It errs by 1 % of the area, nearly the same in both runs of a
difference."""

SAMPLED = 3
"""Trials that are simulated: the shortest, the median and the longest; the others lie between."""


@dataclass(frozen=True)
class Response:
    """Answer of the logarithm of the area to the logarithm x of a length's factor.

    ln A(x) − ln A(0) = slope x + bend x². durations (S,): of the simulated trials in s, increasing;
    slope, bend (S, 3): coefficients, highest power first, of parabolas of the force's logarithm.
    """

    durations: np.ndarray
    slope: np.ndarray
    bend: np.ndarray

    def on(self, problem: FitProblem) -> tuple[np.ndarray, np.ndarray]:
        """Slope and bend (n,) at all frames of a problem; trials lie between the simulated ones."""
        parts = []
        for trial in problem.trials:
            place = _place(trial)
            own = [
                [np.interp(trial.time[-1], self.durations, column) for column in table.T]
                for table in (self.slope, self.bend)
            ]
            parts.append([np.polyval(coefficients, place) for coefficients in own])
        slope, bend = np.concatenate(parts, axis=1)
        return slope, bend


class GeometryModel(Protocol):
    """Areas of trials for another geometry of the finger."""

    @property
    def geometry(self) -> Geometry:
        """The geometry that the fit assumes."""
        ...

    def areas(
        self, parameters: np.ndarray, geometry: Geometry, trials: Sequence[FitTrial]
    ) -> list[np.ndarray]:
        """Areas (k,) in m² at the frames of each trial for parameters (N,); NaN where there is
        none."""
        ...


@dataclass(frozen=True)
class FullOrderGeometry:
    """By full-order runs on a coarse mesh: about 0.1 s a trial and geometry."""

    full_order: FullOrder
    done: Done | None = None

    @property
    def geometry(self) -> Geometry:
        """The geometry that the fit assumes."""
        return self.full_order.geometry

    def areas(
        self, parameters: np.ndarray, geometry: Geometry, trials: Sequence[FitTrial]
    ) -> list[np.ndarray]:
        """Areas (k,) in m² at the frames of each trial for parameters (N,)."""
        shared = (self.full_order.material, geometry, REFINEMENT, trials)
        items = [(tuple(map(float, parameters)), index) for index in range(len(trials))]
        return self.full_order.engine.map(trial_areas, shared, items, self.done)


def geometry_responses(
    problem: FitProblem,
    parameters: np.ndarray,
    model: GeometryModel,
    lengths: Mapping[str, float],
) -> dict[str, Response]:
    """Answers at parameters (N,) to lengths with the given relative deviations.

    A length is left out where a change of one deviation is no finger or fails under the load.
    """
    durations = np.array([t.time[-1] for t in problem.trials])
    order = np.argsort(durations, kind="stable")
    picks = np.unique(order[np.linspace(0, len(order) - 1, SAMPLED).round().astype(int)])
    picks = picks[np.argsort(durations[picks], kind="stable")]
    sample = [problem.trials[i] for i in picks]
    base = model.areas(parameters, model.geometry, sample)

    def change(name: str, x: float) -> np.ndarray | None:
        """ln A(x) − ln A(0) of the sample, as parabolas (S, 3)."""
        value = getattr(model.geometry, name)
        try:
            changed = replace(model.geometry, **{name: value * float(np.exp(x))})
        except InputError:
            return None
        coefficients = []
        for trial, before, after in zip(sample, base, model.areas(parameters, changed, sample)):
            usable = (before > 0) & (after > 0)
            if usable.sum() < 0.8 * len(usable):
                return None
            ratio = np.log(after[usable] / before[usable])
            degree = min(2, len(ratio) - 1)
            found = np.polyfit(_place(trial)[usable], ratio, degree)
            coefficients.append(np.concatenate([np.zeros(2 - degree), found]))
        return np.array(coefficients)

    out = {}
    for name, deviation in lengths.items():
        high, low = change(name, deviation), change(name, -deviation)
        if high is not None and low is not None:
            slope, bend = (high - low) / (2 * deviation), (high + low) / (2 * deviation**2)
        elif high is not None:
            slope, bend = high / deviation, np.zeros_like(high)
        elif low is not None:
            slope, bend = -low / deviation, np.zeros_like(low)
        else:
            continue
        out[name] = Response(durations[picks], slope, bend)
    return out


def _place(trial: FitTrial) -> np.ndarray:
    """Logarithm of the force (k,) at the frames; below 0.05 N areas are too small to compare."""
    return np.log(np.maximum(trial.frame_force, 0.05))
