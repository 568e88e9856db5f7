# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The simulated finger: a full-order model with known parameters, simulated ahead of time.

Its contact is the truth that images are rendered from; nothing else of it may reach an estimate.
"""

from __future__ import annotations

import numpy as np

from finger_common.errors import InputError
from finger_model.fem.full_order import FullOrderModel
from finger_model.geometry import Geometry
from finger_model.history import ContactHistory
from finger_model.material import Material


class SimulatedFinger:
    """A finger of known material and geometry.

    refinement: of the full-order mesh, 1 is its default. step: s, largest time step of the plan;
    20 ms resolves tremor of 8–12 Hz, and halving it changes the areas by less than the mesh does.
    """

    def __init__(
        self,
        material: Material,
        geometry: Geometry | None = None,
        refinement: float = 1.0,
        step: float = 0.02,
    ) -> None:
        if not step > 0:
            raise InputError(f"simulated finger: step is {step:g} s, a positive time is needed")
        self.material = material
        self.geometry = geometry or Geometry()
        self.step = step
        self._model = FullOrderModel(self.geometry, refinement)

    def plan(
        self, time: np.ndarray, force: np.ndarray, instants: np.ndarray | None = None
    ) -> ContactHistory:
        """Contact under a normal force, from rest at time[0].

        time (n,) in s, force (n,) in N. instants (k,) in s: times that must be steps of the model,
        such as those of the frames. Returns the history at the model's own steps, which `area_at`
        interpolates. Raises ModelError where the finger cannot carry the load.
        """
        time = np.asarray(time, dtype=float)
        force = np.asarray(force, dtype=float)
        knots = self._knots(time, force, instants)
        return self._model.simulate(self.material, knots, np.interp(knots, time, force))

    def _knots(
        self, time: np.ndarray, force: np.ndarray, instants: np.ndarray | None
    ) -> np.ndarray:
        """Steps: even over the loaded part, the instants, and the ends."""
        loaded = np.flatnonzero(force > 0)
        first, last = time[0], time[-1]
        knots = [np.array([first, last])]
        if len(loaded):
            begin = time[max(loaded[0] - 1, 0)]
            end = time[min(loaded[-1] + 1, len(time) - 1)]
            number = max(int(np.ceil((end - begin) / self.step)), 1)
            knots.append(np.linspace(begin, end, number + 1))
        if instants is not None:
            knots.append(np.asarray(instants, dtype=float))
        merged = np.unique(np.concatenate(knots))
        merged = merged[(merged >= first) & (merged <= last)]
        # Steps closer than a tenth of a sample of the force are one.
        keep = np.concatenate([[True], np.diff(merged) > 1e-5])
        return merged[keep]


def area_at(history: ContactHistory, time: np.ndarray) -> np.ndarray:
    """Contact area (k,) in m² at times (k,) in s.

    Linear between the history's steps, constant beyond its ends.
    """
    return np.interp(time, history.time, history.area)
