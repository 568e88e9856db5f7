# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contact areas and indentations of many parameter sets by the full-order model, for fits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from finger_common.errors import ModelError

from ..geometry import Geometry
from ..history import check_trial
from ..laws import ConstitutiveLaw, ParameterSpace
from .full_order import FullOrderModel


def thinned_rows(
    time: np.ndarray, force: np.ndarray, wanted: np.ndarray, time_step: float, force_step: float
) -> np.ndarray:
    """Rows (k,) of a history that a simulation needs: those wanted, and enough between them.

    Steps between rows are no longer than `time_step` (s) and change the force by no more than
    `force_step` (N), where the history is fine enough. time, force (n,); wanted: increasing rows;
    nothing after the last one is kept.
    """
    keep = [0]
    last = int(wanted.max(initial=0))
    needed = set(map(int, wanted))
    for row in range(1, last + 1):
        following = min(row + 1, last)
        too_long = time[following] - time[keep[-1]] > time_step * 1.001
        too_much = abs(force[following] - force[keep[-1]]) > force_step
        if row in needed or too_long or too_much:
            keep.append(row)
    return np.array(keep)


class FullOrderAreas:
    """Areas by the full-order model, with the interface of `ReducedModel.batch`.

    material: law and fixed properties; its parameters are replaced by the given ones. A trial
    takes about 0.3 s per parameter set on the default mesh; `refinement` 0.5 takes a fifth of that
    and errs by about 1 % of the area. time_step (s), force_step (N): largest steps of the
    simulation where the drive is finer.
    """

    def __init__(
        self,
        material: ConstitutiveLaw,
        geometry: Geometry | None = None,
        refinement: float = 1.0,
        time_step: float = 0.04,
        force_step: float = 0.1,
    ) -> None:
        self.material = material
        self.geometry = geometry or Geometry()
        self.time_step = time_step
        self.force_step = force_step
        self._model = FullOrderModel(self.geometry, refinement)

    @property
    def space(self) -> ParameterSpace:
        """The space of the law's parameters."""
        return self.material.PARAMETERS

    def areas(
        self, parameters: np.ndarray, time: np.ndarray, force: np.ndarray, rows: np.ndarray
    ) -> np.ndarray:
        """Areas (f,) in m² at increasing rows (f,) of a history (n,) for parameters (p,).

        NaN and errors as in `contact`.
        """
        return self.contact(parameters, time, force, rows)[0]

    def contact(
        self, parameters: np.ndarray, time: np.ndarray, force: np.ndarray, rows: np.ndarray
    ) -> np.ndarray:
        """Areas in m² and indentations in m (2, f) at increasing rows (f,) of a history (n,).

        NaN throughout where the finger cannot carry the load. Raises InputError for other rows and
        where the law refuses the parameters.
        """
        time, force, rows = check_trial((time, force, rows), "trial")
        material = self.material.with_vector(np.asarray(parameters, dtype=float))
        steps = thinned_rows(time, force, rows, self.time_step, self.force_step)
        try:
            history = self._model.simulate(material, time[steps], force[steps])
        except ModelError:
            return np.full((2, len(rows)), np.nan)
        return np.array([history.area, history.indentation])[:, np.searchsorted(steps, rows)]

    def batch(
        self, parameters: np.ndarray, trials: Sequence[tuple[np.ndarray, ...]]
    ) -> list[np.ndarray]:
        """Areas (P, f) in m² of each trial; arguments as of `contacts`."""
        return [found[0] for found in self.contacts(parameters, trials)]

    def contacts(
        self, parameters: np.ndarray, trials: Sequence[tuple[np.ndarray, ...]]
    ) -> list[np.ndarray]:
        """Areas in m² and indentations in m (2, P, f) of each trial, for parameters (P, p).

        trials: (time (n,) in s, force (n,) in N, rows (f,)), rows increasing: the samples that
        are wanted, all of them where left out. NaN as in `contact`.
        """
        parameters = np.atleast_2d(np.asarray(parameters, dtype=float))
        found = []
        for i, trial in enumerate(trials):
            checked = check_trial(trial, f"trial {i}")
            each = [self.contact(row, *checked) for row in parameters]
            found.append(np.swapaxes(each, 0, 1))
        return found
