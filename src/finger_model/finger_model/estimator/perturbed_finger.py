# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A finger of the reduced model and its perturbed copies (`sensitivities`) in known presses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..reduced.kernels import ModelRecords
from ..reduced.model import ReducedModel
from . import sensitivities as kernels
from .sensitivities import DIRECTIONS, SENSITIVITIES


class SensitivityHistory(NamedTuple):
    """Area (n,) in m², peak pressure (n,) in Pa, and sensitivities (n, 3) of the logarithm of the
    area along the directions of the tissue."""

    area: np.ndarray
    peak_pressure: np.ndarray
    sensitivities: np.ndarray


@dataclass(frozen=True)
class PerturbedFinger:
    """A finger and its perturbed copies, and `SENSITIVITIES` (1,) with the shift of the finger.
    `run` changes the states."""

    records: ModelRecords
    sensitivities: np.ndarray

    @classmethod
    def at(cls, model: ReducedModel, base: np.ndarray, shift: np.ndarray) -> PerturbedFinger:
        """At rest, the finger of the constants `base` (1,) shifted by (3,), within the limits."""
        sensitivities = np.zeros(1, SENSITIVITIES)
        kernels.set_shift_1(sensitivities, np.ascontiguousarray(shift))
        constants = np.repeat(base, 1 + DIRECTIONS)
        states = np.concatenate([model.state_at_rest(base)] * len(constants))
        # Apart from the model's own scratch, which a live estimator may be using.
        work = model.work.copy()
        records = ModelRecords(model.networks, base, constants, states, work)
        kernels.set_constants_1(records, sensitivities)
        return cls(records, sensitivities)

    @property
    def shift(self) -> np.ndarray:
        """Of the finger (3,) along the directions."""
        return self.sensitivities["shift"][0]

    def run(self, before: float, time: np.ndarray, force: np.ndarray) -> SensitivityHistory:
        """Go on from the instant `before` (s) under forces (n,) in N at times (n,) in s."""
        table = np.empty((len(time), 3 + 2 * DIRECTIONS))
        kernels.simulate(self.records, self.sensitivities.copy(), before, time, force, table)
        return SensitivityHistory(table[:, 0], table[:, 2], table[:, 3 : 3 + DIRECTIONS])
