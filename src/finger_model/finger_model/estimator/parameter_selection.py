# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Material parameters for a moisture reading, and what they mean for the estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from finger_common.errors import InputError
from finger_common.flags import StateFlag

from ..parameter_sets import InterpolatedParameters, ParameterSets
from ..reduced.model import ReducedModel
from .settings import EstimatorSettings

_RAMP = np.linspace(0.05, 1.0, 20)
"""s and N: 1 N reached in 1 s."""

_LOG_STEP = 0.05


@dataclass(frozen=True)
class SelectedParameters:
    """Parameters in use.

    parameters (n,): in the order of the sets' space; constants: the reduced model's record of them;
    name: of the parameter set; flags: of StateFlag; prior_variance: of ln A for a finger not seen
    before.
    """

    parameters: np.ndarray
    constants: np.ndarray
    name: str
    flags: StateFlag
    prior_variance: float


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
    return SelectedParameters(
        found.parameters,
        model.constants(found.parameters),
        found.name,
        flags,
        settings.prior_area_sd**2 + _area_variance(model, found),
    )


def check_sets(sets: ParameterSets, model: ReducedModel, where: str = "the parameter sets") -> None:
    """Raise InputError for sets of another law or geometry than the model's."""
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


def _area_variance(model: ReducedModel, found: InterpolatedParameters) -> float:
    """Variance of ln A that the covariance of the parameters brings, for 1 N reached in 1 s."""
    if not np.any(found.covariance_log):
        return 0.0
    space, n = model.space, len(found.parameters)
    shifts = _LOG_STEP * np.vstack([np.eye(n), -np.eye(n)])
    shifted = space.from_log(space.to_log(found.parameters) + shifts)
    areas = np.log(model.batch(shifted, [(_RAMP, _RAMP)])[0][:, -1])
    slope = (areas[:n] - areas[n:]) / (2 * _LOG_STEP)
    return float(max(slope @ found.covariance_log @ slope, 0.0))
