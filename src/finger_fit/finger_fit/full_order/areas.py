# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contact areas and indentations of fit candidates by the full-order model."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from finger_model.fem.area_model import FullOrderAreas
from finger_model.geometry import Geometry
from finger_model.laws import ConstitutiveLaw

from ..engine import Done, Engine, LocalEngine
from ..problem import FitProblem, FitTrial, in_rows, material_of, trial_outputs

REFINEMENT = 1.25
"""Refinement of the mesh. The areas of the default mesh err by 0.05–0.15 %, which in the poorly
constrained direction of bulk against epidermis stiffness makes 1 %; those of this mesh by
0.02–0.07 %."""


class BetterModel(Protocol):
    """A model that a fit's own areas are compared with and corrected to."""

    def areas(
        self, problem: FitProblem, candidates: np.ndarray, done: Done | None = None
    ) -> np.ndarray:
        """Areas in m² at all frames, then indentations in m, as `FitProblem.raw`, (C, n + q) of
        candidates (C, N); NaN where a run fails."""
        ...


@dataclass(frozen=True)
class FullOrder:
    """The full-order model of one finger.

    geometry, material: of the finger; the material's parameters are replaced by each candidate's.
    """

    geometry: Geometry
    material: ConstitutiveLaw
    engine: Engine = field(default_factory=LocalEngine)
    refinement: float = REFINEMENT

    @classmethod
    def like(cls, model: Any, engine: Engine | None = None) -> FullOrder | None:
        """Take the law, geometry, friction and other constants that a model was built for; None
        for a model without a law."""
        geometry, material = getattr(model, "geometry", None) or Geometry(), material_of(model)
        return None if material is None else cls(geometry, material, engine or LocalEngine())

    def areas(
        self, problem: FitProblem, candidates: np.ndarray, done: Done | None = None
    ) -> np.ndarray:
        """Areas and indentations (C, n + q) of candidates (C, N); see `BetterModel`."""
        number = len(problem)
        items = [
            (tuple(map(float, parameters)), index)
            for parameters in candidates
            for index in range(number)
        ]
        # A worker needs no record, whose class may be one of the script itself.
        trials = [replace(trial, record=None) for trial in problem.trials]
        shared = (self.material, self.geometry, self.refinement, trials)
        parts = self.engine.spread(trial_areas, shared, items, done)
        rows = [parts[c * number : (c + 1) * number] for c in range(len(candidates))]
        return np.array([in_rows(row, problem.trials) for row in rows])


@functools.lru_cache(maxsize=4)
def _model(material: ConstitutiveLaw, geometry: Geometry, refinement: float) -> FullOrderAreas:
    return FullOrderAreas(material, geometry, refinement)


def trial_areas(
    shared: tuple[ConstitutiveLaw, Geometry, float, Sequence[FitTrial]],
    item: tuple[tuple[float, ...], int],
) -> np.ndarray:
    """Areas in m² of one trial at its frames, then its indentations in m, (k + q,); all NaN where
    the finger fails under the load.
    """
    material, geometry, refinement, trials = shared
    parameters, index = item
    trial = trials[index]
    model = _model(material, geometry, refinement)
    return trial_outputs(model, np.array([parameters]), [trial])[0][0]
