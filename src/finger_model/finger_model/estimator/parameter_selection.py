# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Material parameters for a moisture reading, and what they mean for the estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from finger_common.errors import InputError, check_type
from finger_common.flags import StateFlag
from finger_common.moisture import MOISTURE_RANGE

from ..finger_prior import AS_THE_MODEL
from ..laws import MaxwellLaw
from ..parameter_sets import InterpolatedParameters, ParameterSets
from ..reduced.model import ReducedModel
from . import area_filter
from .perturbed_finger import PerturbedFinger
from .sensitivities import DIRECTIONS
from .settings import EstimatorSettings

_TIME = np.concatenate([np.linspace(0.0, 1.0, 21), np.linspace(1.1, 3.0, 20), [3.05, 3.1, 3.15]])
_FORCE = np.interp(_TIME, [0.0, 1.0, 3.0, 3.2], [0.05, 1.0, 1.0, 0.1])
"""s and N: the press in which parameters are compared with the states of the filters."""

_LOG_STEP, _LEAST_CHANGE = 0.01, 1e-6
"""Change of the logarithms of parameters in that press, and the least that is told from none."""
_RIDGE = np.array([1e-4, 1e-3, 1e-3, 1e-3, 1e-3])
"""Inverse variances that settle what the press leaves open."""


@dataclass(frozen=True)
class SelectedPrior:
    """Distribution of the filters' states for a finger not seen before.

    mean (5,), covariance (5, 5) of the finger states; moisture_direction (5,): what one standard
    deviation of the population in moisture does to them; moisture_variance: of the reading in use,
    over the population's; moisture_wander: its growth in 1/s; misfit_sd: of ln A; contact_sd,
    slope_sd, drift_sd: of a contact, for scale 1 of the filters; walk_sd, peak (2, n), indentation
    (2, n): as `FingerPrior` has them.
    """

    mean: np.ndarray
    covariance: np.ndarray
    moisture_direction: np.ndarray
    moisture_variance: float
    moisture_wander: float
    misfit_sd: float
    contact_sd: float
    slope_sd: float
    drift_sd: float
    walk_sd: float = 0.0
    peak: tuple[tuple[float, ...], tuple[float, ...]] = AS_THE_MODEL, AS_THE_MODEL
    indentation: tuple[tuple[float, ...], tuple[float, ...]] = AS_THE_MODEL, AS_THE_MODEL


@dataclass(frozen=True)
class SelectedParameters:
    """Parameters in use.

    parameters (n,): in the order of the sets' space; constants: the reduced model's record of them;
    material: with them; name: of the parameter set; flags: of StateFlag; prior: of the finger.
    """

    parameters: np.ndarray
    constants: np.ndarray
    material: MaxwellLaw
    name: str
    flags: StateFlag
    prior: SelectedPrior


def select_parameters(
    model: ReducedModel,
    sets: ParameterSets,
    settings: EstimatorSettings,
    moisture: float | None,
) -> SelectedParameters:
    """Parameters at a moisture reading (a.u.), None for the default one."""
    found = sets.interpolate(settings.default_moisture if moisture is None else moisture)
    flags = StateFlag(0)
    if moisture is None:
        flags |= StateFlag.MOISTURE_MISSING
    elif found.out_of_range:
        flags |= StateFlag.MOISTURE_OUT_OF_RANGE
    if model.out_of_range(found.parameters):
        flags |= StateFlag.PARAMETERS_OUT_OF_RANGE
    material = model.material.with_vector(found.parameters)
    assert isinstance(material, MaxwellLaw)
    directions = _directions(sets, settings, moisture, found)
    constants, answers = _answers(model, found.parameters, directions)
    return SelectedParameters(
        found.parameters,
        constants,
        material,
        found.name,
        flags,
        _prior(sets, settings, moisture, answers),
    )


def check_sets(sets: ParameterSets, model: ReducedModel, where: str = "the parameter sets") -> None:
    """Raise InputError for sets of another law or geometry than the model's."""
    check_type(sets, ParameterSets, "parameter_sets")
    if sets.law is not model.law:
        raise InputError(
            f"{where} are parameters of the law '{sets.law.name}', the reduced model is for "
            f"'{model.law.name}'; give parameters of that law"
        )
    if sets.geometry_hash and sets.geometry_hash != model.geometry_hash:
        raise InputError(
            f"{where} were fitted with geometry {sets.geometry_hash[:8]}, the reduced model is for "
            f"{model.geometry_hash[:8]}; fit again or load the reduced model of that geometry"
        )


def _directions(
    sets: ParameterSets,
    settings: EstimatorSettings,
    moisture: float | None,
    found: InterpolatedParameters,
) -> np.ndarray:
    """Changes of the logarithms of the n parameters (d, n) that the prior asks for: what one
    standard deviation of the population in moisture does, or square roots of the covariance."""
    known = sets.prior
    if known is not None and known.moisture_sd > 0 and len(sets.sets) > 1:
        here = settings.default_moisture if moisture is None else moisture
        ends = [
            sets.interpolate(float(np.clip(here + d * known.moisture_sd, *MOISTURE_RANGE)))
            for d in (-1.0, 1.0)
        ]
        return np.diff([sets.space.to_log(end.parameters) for end in ends], axis=0) / 2
    if known is None and np.any(found.covariance_log):
        variances, axes = np.linalg.eigh(found.covariance_log)
        return (np.sqrt(np.maximum(variances, 0.0)) * axes).T
    return np.zeros((0, len(found.parameters)))


def _prior(
    sets: ParameterSets, settings: EstimatorSettings, moisture: float | None, answers: np.ndarray
) -> SelectedPrior:
    """What is known of the finger: by the sets' own prior, or by covariances and settings.

    answers (5, d): of the finger states to `_directions`."""
    none: np.ndarray = np.zeros(area_filter.FINGER_STATES)
    known, presses = sets.prior, sets.presses
    area_sd, contact = settings.prior_area_sd, _contact(sets, settings)
    if known is None:
        if presses is not None:
            area_sd = presses.sd * math.sqrt(presses.margin / presses.number)
        covariance = np.diag([area_sd**2, settings.slope_sd**2, 0.0, 0.0, 0.0])
        covariance = covariance + answers @ answers.T
        return SelectedPrior(none, covariance, none, 0.0, 0.0, 0.0, *contact)
    direction, variance, wander = none, 0.0, 0.0
    if answers.size:
        direction = answers[:, 0]
        variance = 1.0 if moisture is None else (known.reading_sd / known.moisture_sd) ** 2
        # At the age from which it is stale, a reading has lost half of what it told.
        wander = 0.5 / settings.moisture_stale_after
    return SelectedPrior(
        np.array(known.mean),
        np.array(known.covariance),
        direction,
        variance,
        wander,
        known.misfit_sd,
        *contact,
        known.walk_sd,
        (known.peak_mean, known.peak_sd),
        (known.indentation_mean, known.indentation_sd),
    )


def _contact(sets: ParameterSets, settings: EstimatorSettings) -> tuple[float, float, float]:
    """Deviations of area, slope and drift of a contact for scale 1 of the filters: by the settings,
    or by the presses of the fit, which all filters together then expect."""
    presses = sets.presses
    if presses is None:
        return settings.contact_area_sd, settings.slope_sd, settings.drift_sd
    contact, drift = (
        math.sqrt(np.mean(np.square(scales)))
        for scales in (area_filter.SCALES, area_filter.DRIFT_SCALES)
    )
    area_sd = presses.sd * math.sqrt(presses.margin)
    return area_sd / contact, presses.slope_sd / contact, presses.drift_sd / drift


def _answers(
    model: ReducedModel, parameters: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The model's record of the parameters (n,), and how the finger states (5, d) answer to changes
    (d, n) of their logarithms, in one press, as far as the model follows it."""
    space = model.space
    steps = _LOG_STEP / np.maximum(np.abs(directions).max(axis=1), _LEAST_CHANGE)
    shifted = space.from_log(space.to_log(parameters) + steps[:, None] * directions)
    # All at once: for a finger of the population box some of their cost is shared.
    constants = model.constants(parameters, *shifted)
    base = constants[:1]
    if not len(directions):
        return base, np.zeros((area_filter.FINGER_STATES, 0))
    areas = []
    for i in range(len(constants)):
        own = constants[i : i + 1]
        found = model.run(own, model.state_at_rest(own), _TIME, _FORCE, before=0.0)
        areas.append(np.log(found[:, 0]))
    perturbed = PerturbedFinger.at(model, base, np.zeros(DIRECTIONS))
    sensitivities = perturbed.run(0.0, _TIME, _FORCE).sensitivities
    h = np.column_stack([np.ones(len(_TIME)), np.log(_FORCE), sensitivities])
    changes = (np.array(areas[1:]) - areas[0]).T / steps
    followed = np.isfinite(changes).all(axis=1)
    h, changes = h[followed], changes[followed]
    return base, np.linalg.solve(h.T @ h + np.diag(_RIDGE), h.T @ changes)
