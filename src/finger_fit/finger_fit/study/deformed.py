"""The full-order finger of the report's example trial, deformed at its last frame."""

from __future__ import annotations

import numpy as np

from finger_model.fem.full_order import FullOrderModel
from finger_model.fem.mesh import BULK, EPIDERMIS

from ..full_order import FullOrder
from ..results import ConditionFit, DeformedFinger

STEP = 0.04
"""s, time step of the run."""


def deformed_finger(fit: ConditionFit, trial: int, full_order: FullOrder) -> DeformedFinger:
    """Run the full-order model over one trial of a fit; raises ModelError where it cannot."""
    drive = fit.problem.trials[trial]
    model = FullOrderModel(full_order.geometry)
    stepper = model.start(full_order.material.with_vector(fit.parameters), float(drive.time[0]))
    number = max(int(np.ceil(drive.time[-1] / STEP)), 2)
    for instant in np.linspace(drive.time[0], drive.time[-1], number + 1)[1:]:
        force = float(np.interp(instant, drive.time, drive.force))
        point = stepper.step(float(instant), force)
    mesh, positions = model.mesh, stepper.state.positions
    return DeformedFinger(
        fit.condition,
        trial,
        full_order.geometry,
        mesh.nodes,
        positions,
        mesh.cells,
        mesh.part == EPIDERMIS,
        mesh.part == BULK,
        shear_strain(mesh.nodes, positions, mesh.cells),
        mesh.surface,
        interface(mesh.cells, mesh.part),
        float(stepper.state.contact.height),
        point.radius,
        point.area,
        point.indentation,
    )


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


def interface(cells: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Edges (K, 2) between epidermis and bulk."""
    owners: dict[tuple[int, ...], set[int]] = {}
    for cell, kind in zip(cells, part):
        for k in range(4):
            edge = tuple(sorted((int(cell[k]), int(cell[(k + 1) % 4]))))
            owners.setdefault(edge, set()).add(int(kind))
    return np.array([e for e, kinds in owners.items() if kinds == {EPIDERMIS, BULK}], dtype=int)
