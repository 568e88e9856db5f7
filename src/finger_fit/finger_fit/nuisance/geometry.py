# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How the areas and indentations of a fit answer to the finger's lengths.

Inside the population box by the reduced model of all fingers, at every frame and wherever the fit
goes. Elsewhere by full-order runs of three presses at one set of parameters.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from finger_common.errors import InputError
from finger_model.geometry import Geometry
from finger_model.laws import ConstitutiveLaw, MaxwellLaw
from finger_model.reduced import ReducedModel
from finger_model.reduced.model import load_population

from ..engine import Done
from ..full_order import FullOrder
from ..full_order.areas import trial_areas
from ..problem import (
    SMALLEST_FORCE,
    FitProblem,
    FitTrial,
    in_rows,
    material_of,
    trial_outputs,
)

REFINEMENT = 0.5
"""Refinement of the mesh of the full-order runs, which errs by 1 % of the area, nearly the same in
both runs of a difference."""

SAMPLED = 3
"""Trials that are simulated: the shortest, the median and the longest; the others lie between."""


@dataclass(frozen=True)
class Response:
    """Answer of the logarithm of the area to the logarithm of a length's factor.

    durations (S,): of the simulated trials in s, increasing; slope (S, 3): coefficients, highest
    power first, of parabolas of the force's logarithm; (S, 6) with those of the indentation behind.
    """

    durations: np.ndarray
    slope: np.ndarray

    def on(self, problem: FitProblem) -> np.ndarray:
        """Slope (n + q,) at all rows of a problem; trials lie between the simulated ones."""
        parts = []
        for trial in problem.trials:
            own = [np.interp(trial.time[-1], self.durations, column) for column in self.slope.T]
            places = _place(trial, trial.frames), _place(trial, trial.drive.indentation_rows)
            areas, indentations = map(np.polyval, (own[:3], own[3:]), places)
            parts.append(np.concatenate([areas, indentations]))
        return in_rows(parts, problem.trials)


class GeometryModel(Protocol):
    """Areas and indentations of trials for another geometry of the finger."""

    @property
    def geometry(self) -> Geometry:
        """The geometry that the fit assumes."""
        ...

    def areas(
        self, parameters: np.ndarray, geometry: Geometry, trials: Sequence[FitTrial]
    ) -> list[np.ndarray]:
        """Areas in m² at the frames of each trial, then its indentations in m, (k + q,), for
        parameters (N,), as `problem.trial_outputs`; NaN where there is none."""
        ...


@dataclass(frozen=True)
class FullOrderGeometry:
    """Full-order runs on a coarse mesh: about 0.1 s a trial and geometry."""

    full_order: FullOrder
    done: Done | None = None

    @property
    def geometry(self) -> Geometry:
        """The geometry that the fit assumes."""
        return self.full_order.geometry

    def areas(
        self, parameters: np.ndarray, geometry: Geometry, trials: Sequence[FitTrial]
    ) -> list[np.ndarray]:
        """Areas and indentations (k + q,) of each trial for parameters (N,)."""
        shared = (self.full_order.material, geometry, REFINEMENT, trials)
        items = [(tuple(map(float, parameters)), index) for index in range(len(trials))]
        return self.full_order.engine.map(trial_areas, shared, items, self.done)


@functools.lru_cache(maxsize=64)
def _population(geometry: Geometry, material: ConstitutiveLaw) -> ReducedModel | None:
    """The population's model of a finger; None, which is kept too, for one outside the box."""
    try:
        return load_population(geometry).for_material(material)
    except InputError:
        return None


@dataclass(frozen=True)
class PopulationGeometry:
    """The reduced model of the population box: milliseconds for all presses.

    Both sides of a difference come from the same model: beside full-order runs on a coarse mesh
    the answers of the default finger agree to 0.3 % of the area for one deviation of each length.
    """

    geometry: Geometry
    material: ConstitutiveLaw

    @classmethod
    def like(cls, model: Any) -> PopulationGeometry | None:
        """Take the finger of a model; None where no reduced model serves it."""
        geometry, material = getattr(model, "geometry", None), material_of(model)
        if geometry is None or not isinstance(material, MaxwellLaw):
            return None
        return None if _population(geometry, material) is None else cls(geometry, material)

    def areas(
        self, parameters: np.ndarray, geometry: Geometry, trials: Sequence[FitTrial]
    ) -> list[np.ndarray]:
        """Areas and indentations (k + q,) of each trial for parameters (N,); raises InputError for
        a finger outside the box."""
        model = _population(geometry, self.material)
        if model is None:
            raise InputError("no reduced model of this finger")
        return [found[0] for found in trial_outputs(model, parameters[None], trials)]

    def responses(
        self, problem: FitProblem, parameters: np.ndarray, lengths: Mapping[str, float]
    ) -> dict[str, np.ndarray]:
        """Slopes (n + q,) at all rows, as of `Response.on`, at parameters (N,)."""
        trials = problem.trials
        base = in_rows(self.areas(parameters, self.geometry, trials), trials)

        def change(name: str, x: float) -> np.ndarray | None:
            try:
                changed = _with_length(self.geometry, name, x)
                areas = in_rows(self.areas(parameters, changed, trials), trials)
            except InputError:
                return None
            if np.isnan(areas[np.isfinite(base)]).any():
                return None  # this finger does not carry the load
            usable = (base > 0) & (areas > 0)
            return np.log(np.where(usable, areas, 1.0) / np.where(usable, base, 1.0))

        return _slopes(change, lengths)


def _with_length(geometry: Geometry, name: str, x: float) -> Geometry:
    """A geometry with one length multiplied by exp(x); raises InputError where it is no finger."""
    return replace(geometry, **{name: getattr(geometry, name) * float(np.exp(x))})


def _slopes(
    change: Callable[[str, float], np.ndarray | None], lengths: Mapping[str, float]
) -> dict[str, np.ndarray]:
    """Slope of a change ln A(x) − ln A(0), by differences of one deviation.

    change(name, x): None where there is no such finger. Where only one side is, a parabola through
    half a deviation and a whole one gives the slope.
    """
    found = {}
    for name, deviation in lengths.items():
        whole = {x: change(name, x) for x in (deviation, -deviation)}
        ends = {x: end for x, end in whole.items() if end is not None}
        if len(ends) == 2:
            found[name] = (ends[deviation] - ends[-deviation]) / (2 * deviation)
            continue
        for x, end in ends.items():
            half = change(name, 0.5 * x)
            found[name] = end / x if half is None else (4 * half - end) / x
    return found


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
    if problem.indentations is not None:
        # At all frames, whether or not these very trials have an indentation.
        sample = [
            replace(
                t,
                indentation=np.zeros(len(t.frames)),
                drive=replace(t.drive, indentation_rows=t.frames),
            )
            for t in sample
        ]
    base = model.areas(parameters, model.geometry, sample)

    def change(name: str, x: float) -> np.ndarray | None:
        """ln A(x) − ln A(0) of the sample, as parabolas (S, 3), or (S, 6) with indentation."""
        try:
            changed = _with_length(model.geometry, name, x)
        except InputError:
            return None
        coefficients = []
        for trial, before, after in zip(sample, base, model.areas(parameters, changed, sample)):
            place, row = _place(trial, trial.frames), []
            for one, other in zip(np.split(before, [len(place)]), np.split(after, [len(place)])):
                usable = (one > 0) & (other > 0)
                if usable.sum() < 0.8 * len(usable):
                    return None
                if len(usable):
                    row.append(_parabola(place[usable], np.log(other[usable] / one[usable])))
            coefficients.append(np.concatenate(row))
        return np.array(coefficients)

    found = _slopes(change, lengths)
    return {name: Response(durations[picks], slope) for name, slope in found.items()}


def _parabola(place: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Coefficients (3,), highest power first, through ratios (k,) at places (k,)."""
    degree = min(2, len(ratio) - 1)
    return np.concatenate([np.zeros(2 - degree), np.polyfit(place, ratio, degree)])


def _place(trial: FitTrial, rows: np.ndarray) -> np.ndarray:
    """Logarithm of the force (k,) at rows (k,)."""
    return np.log(np.maximum(trial.force[rows], SMALLEST_FORCE))
