# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Files for the model node: the fitted parameters of conditions, and of subjects."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from finger_common.moisture import MOISTURE_RANGE
from finger_common.subject_code import is_subject
from finger_model.calibration import SMALLEST_AREA, SMALLEST_FORCE
from finger_model.geometry import Geometry
from finger_model.laws import ConstitutiveLaw
from finger_model.parameter_sets import ParameterSet, ParameterSets
from finger_model.people import People
from finger_model.press_scatter import (
    LEAST_PRESSES,
    PressResiduals,
    PressScatter,
    press_scatter,
)

from ..problem import material_of
from .fits import ConditionFit, Finger, FitResult

TOO_NEAR = 2.0
"""Distance of the mean moistures of two conditions over the deviation of their readings, below
which no reading can choose between them."""


def parameter_files(result: FitResult) -> dict[str, ParameterSets]:
    """Files for the model node, which interpolates over moisture: name → sets.

    parameters.yaml of the conditions with moisture readings, or of a single one. A condition
    without readings beside others gets a file of its own, parameters_CONDITION.yaml, since the
    model node cannot choose it; so does each one where the moistures of two are `too_near`. A set
    without readings is placed in the middle of the scale, where its moisture does not matter. None
    of a model without a law, and none of a fit that was interrupted before all conditions were
    fitted.
    """
    fits, material = result.fits, material_of(result.model)
    if material is None or result.unfinished:
        return {}
    chosen, names = _by_moisture(fits), own_files(fits)
    files = {"parameters.yaml": chosen} if chosen else {}
    files |= {names[n]: {n: f} for n, f in fits.items() if n not in chosen}
    return {file: _sets(result, held, type(material)) for file, held in files.items()}


def subject_sets(result: FitResult) -> dict[Finger, ParameterSets]:
    """Sets of each subject's finger, as `finger-rig calibrate` writes them: those of
    parameters.yaml but of conditions that fail a data check; not of trials that are pooled or have
    no code."""
    found = {}
    for part in result.parts.values():
        finger, material = part.finger, material_of(part.model)
        fits = {n: f for n, f in _by_moisture(part.fits).items() if not failing(f)}
        if fits and is_subject(finger.subject) and material is not None and not part.unfinished:
            found[finger] = _sets(part, fits, type(material))
    return found


def _by_moisture(fits: Mapping[str, ConditionFit]) -> dict[str, ConditionFit]:
    """The conditions between which the model node can choose by moisture."""
    if len(fits) == 1:
        return dict(fits)
    return {} if too_near(fits) else {n: f for n, f in fits.items() if _is_read(f)}


def _is_read(fit: ConditionFit) -> bool:
    return math.isfinite(fit.moisture[0])


def too_near(fits: Mapping[str, ConditionFit]) -> list[tuple[str, str]]:
    """Pairs of conditions whose mean moistures lie closer than their readings scatter."""
    known = [(name, *fit.moisture) for name, fit in fits.items() if _is_read(fit)]
    least = People.default().reading_sd
    return [
        (first, second)
        for (first, one, sd), (second, other, other_sd) in itertools.combinations(known, 2)
        if abs(one - other) < TOO_NEAR * max(math.sqrt(0.5 * (sd**2 + other_sd**2)), least)
    ]


def failing(fit: ConditionFit) -> bool:
    """Whether a condition fails a data check, which keeps it out of subjects/."""
    return fit.quality is not None and bool(fit.quality.failures)


def own_files(conditions: Iterable[str]) -> dict[str, str]:
    """Name of the file of each condition, if it gets one of its own."""
    names: dict[str, str] = {}
    for condition in conditions:
        stem = file = f"parameters_{condition.replace(' ', '_')}"
        for number in itertools.count(2):
            if f"{file}.yaml" not in names.values():
                break
            file = f"{stem}_{number}"
        names[condition] = f"{file}.yaml"
    return names


def _sets(
    result: FitResult, fits: dict[str, ConditionFit], law: type[ConstitutiveLaw]
) -> ParameterSets:
    """Sets of conditions, with the covariance that the data leave: the model runs with the lengths
    and on the plate that the fit assumed, so that their errors cancel in its areas."""
    middle = 0.5 * sum(MOISTURE_RANGE), 0.0
    sets = [
        ParameterSet(
            name,
            *(fit.moisture if _is_read(fit) else middle),
            tuple(map(float, fit.parameters)),
            tuple(tuple(map(float, row)) for row in fit.covariance_log(assumed=False)),
            fit.status,
        )
        for name, fit in fits.items()
    ]
    geometry = getattr(result.model, "geometry", None)
    return ParameterSets(
        sets,
        str(result.sources.get("geometry_hash", "")),
        reduced_model_hash=str(result.sources.get("reduced_model_hash", "")),
        where="fit",
        law=law,
        geometry=None if geometry == Geometry() else geometry,
        presses=_scatter(result.model, list(fits.values())),
    )


def _scatter(model: Any, fits: Sequence[ConditionFit]) -> PressScatter | None:
    """Scatter of the presses of all conditions, which the model node has one of; each condition is
    known from its own number of them, of which the smallest counts, and the model's error is the
    largest one."""
    conditions = [_residuals(fit) for fit in fits]
    fewest = min(map(len, conditions))
    misfit = 0.0
    if hasattr(model, "rms_error_of"):
        misfit = max(model.rms_error_of(fit.parameters, fit.largest_force) for fit in fits)
    found = press_scatter([press for presses in conditions for press in presses], misfit)
    return replace(found, number=fewest) if found and fewest >= LEAST_PRESSES else None


def _residuals(fit: ConditionFit) -> list[PressResiduals]:
    """The presses of a condition beside its model, at the frames that count."""
    problem, found = fit.problem, []
    for number, trial in enumerate(problem.trials):
        rows = slice(*problem.starts[number : number + 2])
        areas, weight = fit.areas[rows], problem.weight[rows]
        use = (weight > 0) & (np.minimum(areas, trial.area) > SMALLEST_AREA) & (trial.area_sd > 0)
        if np.count_nonzero(use) < 2:
            continue
        left = problem.measured[rows] / np.where(use, areas, np.inf) - 1.0
        log_force = np.log(np.maximum(trial.frame_force, SMALLEST_FORCE))
        columns = trial.frame_time, left, trial.area_sd / np.where(use, areas, 1.0), log_force
        found.append(PressResiduals(*(column[use] for column in columns)))
    return found
