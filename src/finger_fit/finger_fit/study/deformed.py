# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The full-order finger of the report's example trial, deformed at the largest force."""

from __future__ import annotations

import numpy as np

from finger_model.fem.full_order import FullOrderModel

from ..full_order import FullOrder
from ..results import ConditionFit, DeformedFinger

STEP = 0.04
"""s, time step of the run."""


def deformed_finger(fit: ConditionFit, trial: int, full_order: FullOrder) -> DeformedFinger:
    """Run the full-order model over one trial of a fit; raises ModelError where it cannot."""
    drive = fit.problem.trials[trial].drive
    time, forces, _ = drive.to_model(drive.frames)
    model = FullOrderModel(full_order.geometry)
    stepper = model.start(full_order.material.with_vector(fit.parameters), float(time[0]))
    end = fit.problem.trials[trial].loading
    number = max(int(np.ceil((end - time[0]) / STEP)), 2)
    for instant in np.linspace(time[0], end, number + 1)[1:]:
        force = float(np.interp(instant, time, forces))
        point = stepper.step(float(instant), force)
    fields = stepper.fields()
    strain = shear_strain(fields.nodes, fields.deformed, fields.cells)
    return DeformedFinger(full_order.geometry, fields, strain, point)


def shear_strain(rest: np.ndarray, moved: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Half the difference of the principal in-plane stretches (E,) at each quadrilateral's
    centre."""
    a, b = rest[cells], moved[cells]

    def slopes(x: np.ndarray) -> np.ndarray:
        # Derivatives of the bilinear map along the two natural coordinates.
        along = x[:, 1] + x[:, 2] - x[:, 0] - x[:, 3]
        across = x[:, 2] + x[:, 3] - x[:, 0] - x[:, 1]
        return np.stack([along, across], -1)

    stretches = np.linalg.svd(slopes(b) @ np.linalg.inv(slopes(a)), compute_uv=False)
    return 0.5 * (stretches[:, 0] - stretches[:, 1])
