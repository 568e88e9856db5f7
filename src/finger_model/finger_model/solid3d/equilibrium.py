# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Equilibrium of a brick mesh on a rough rigid plate: Newton's method on the condensed stiffness.

Factorising costs thirty times as much as the internal force. So one factorisation serves several
iterations (chord method), until they converge slowly.
"""

from __future__ import annotations

import math

import numpy as np

from ..fem.equilibrium import OPEN, NotConverged
from ..fem.mesh_material import StepMaterial
from . import elements
from .condensation import Condensation, NotPositive
from .contact import Contact, Nodes, Plate, respond
from .contact_shape import node_areas
from .mesh import SolidMesh

TOLERANCE = 2e-5
"""Residual, relative to the plate's force, at which an iteration has converged."""
ITERATIONS = 40
MOST_HALVINGS = 6
"""Halvings of one step in a row."""
BELOW = 1e-6
"""Depth below the plate, over the finger's height, to which a node counts as on it."""
SLOW = 0.25
"""Ratio of two residuals above which the stiffness is factorised again."""


class Equilibrium:
    """Solver for one mesh; all that does not change between solves is kept here.

    stick_stiffness: of sticking skin against the plate, per area (N/m³); infinite by Coulomb's law.
    residuals: relative residual of every iteration of the last solve.
    """

    def __init__(self, mesh: SolidMesh, stick_stiffness: float = math.inf) -> None:
        self.mesh = mesh
        self._spring: np.ndarray | None = None
        if math.isfinite(stick_stiffness):
            areas = node_areas(mesh, mesh.nodes[mesh.surface])
            self._spring = stick_stiffness * areas
        self.elements = elements.reference_bricks(mesh.nodes, mesh.cells)
        self.tangent = np.zeros((len(mesh.cells), elements.UNKNOWNS, elements.UNKNOWNS))
        self.force = np.zeros(mesh.nodes.shape)
        self.length = float(np.ptp(mesh.nodes[:, 2]))
        self.residuals: list[float] = []
        self.possible = np.empty(0, dtype=int)
        """Indices into the mesh's surface of the nodes that are condensed onto."""
        self._condensation: Condensation | None = None
        self._stiffness: np.ndarray | None = None

    def unloaded_contact(self) -> Contact:
        """No contact, the plate touching the undeformed skin."""
        skin = self.mesh.nodes[self.mesh.surface]
        n = len(skin)
        return Contact(
            np.zeros(n, dtype=np.int64),
            np.zeros((n, 3)),
            skin[:, :2].copy(),
            np.zeros((n, 2)),
            np.array([0.0, 0.0, skin[:, 2].min()]),
        )

    def _choose(self, x: np.ndarray, contact: Contact) -> None:
        """Condense onto the nodes of all faces near contact, if that is not so already."""
        faces = self.mesh.faces
        gap = x[self.mesh.surface, 2] - contact.plate[2]
        near = (contact.status != OPEN) | (gap < 0.0)
        if not near.any():
            near[np.argmin(gap)] = True
        needed = np.unique(faces[near[faces].any(axis=1)])
        if len(self.possible) and np.isin(needed, self.possible).all():
            # Where far fewer are needed a small matrix is worth a new division.
            if len(self.possible) < 2.0 * len(needed) + 60:
                return
        # One ring of faces more, so that the next steps need no new division.
        near[needed] = True
        self.possible = np.unique(faces[near[faces].any(axis=1)])
        kept = self.mesh.surface[self.possible]
        self._condensation = Condensation(self.mesh.cells, self.mesh.place, self.mesh.fixed, kept)
        self._stiffness = None

    def _assemble(self, x: np.ndarray, material: StepMaterial, stiffness: bool) -> float:
        """Fill `force`, and the elements' tangents; returns the smallest J."""
        self.force[:] = 0.0
        return elements.assemble(
            x, self.elements, material.stiffness(x), stiffness, self.force, self.tangent
        )

    def forget(self) -> None:
        """Factorise anew at the next solve."""
        self._stiffness = None

    def solve(
        self,
        x: np.ndarray,
        contact: Contact,
        material: StepMaterial,
        friction: float,
        plate: Plate,
    ) -> tuple[np.ndarray, Contact]:
        """Positions (N, 3) and contact; x and contact are the starting guess.

        contact.anchor holds where nodes stick. Raises NotConverged with the cause, or Sliding.
        """
        x, contact = x.copy(), contact.copy()
        contact.plate = np.where(np.isnan(plate.position), contact.plate, plate.position)
        surface = self.mesh.surface
        fixed = self.mesh.fixed
        floor = 1e-3 * float(material.metric[..., :3].mean()) * self.length**2 * 1e-3
        self.residuals = []
        self._choose(x, contact)
        previous = math.inf
        step: np.ndarray | None = None
        halvings = 0
        for iteration in range(ITERATIONS):
            fresh = self._stiffness is None
            smallest = self._assemble(x, material, fresh)
            if smallest <= 0.0:
                step = _half(step, halvings, "elements turn inside out")
                halvings += 1
                x = x - step
                continue
            residual = self.force.copy()
            residual[surface] -= contact.force
            residual[fixed] = 0.0
            scale = max(float(contact.force[:, 2].sum()), floor)
            norm = float(np.linalg.norm(residual)) / scale
            if iteration:
                self.residuals.append(norm)
            if iteration and norm < TOLERANCE:
                gap = x[surface, 2] - contact.plate[2]
                if not np.any(gap < -BELOW * self.length):
                    return x, contact
                self._choose(x, contact)
                continue
            if not math.isfinite(norm):
                stressed = np.isfinite(self.force).all()
                raise NotConverged("the iterations diverge" if stressed else material.no_stress)
            if not fresh and norm > SLOW * previous:
                self._stiffness = None
                previous = math.inf
                continue
            if iteration:
                previous = norm
            assert self._condensation is not None
            if fresh:
                try:
                    self._stiffness = self._condensation.factorize(self.tangent)
                except NotPositive:
                    cause = "the tangent stiffness is not positive definite (the tissue buckles)"
                    step = _half(step, halvings, cause)
                    halvings += 1
                    x = x - step
                    continue
            halvings = 0
            assert self._stiffness is not None
            nodes = self.possible
            total = self.force.copy()
            total[fixed] = 0.0
            internal = -self._condensation.reduce(-total.ravel())
            found = respond(
                Nodes(
                    self._stiffness,
                    internal,
                    x[surface[nodes]],
                    ~fixed[surface[nodes]],
                    contact.anchor[nodes],
                    None if self._spring is None else (self._spring[nodes], contact.begun[nodes]),
                ),
                contact.status[nodes],
                contact.force[nodes],
                contact.plate,
                plate,
                friction,
            )
            step = self._condensation.expand(found.displacement.ravel()).reshape(-1, 3)
            largest = float(np.abs(step).max())
            if not math.isfinite(largest):
                raise NotConverged("the linear system is singular")
            contact.status[nodes] = found.status
            contact.force[:] = 0.0
            contact.force[nodes] = found.force
            part = min(1.0, 0.1 * self.length / largest) if largest > 0 else 1.0
            step = part * step
            x = x + step
            contact.plate = contact.plate + part * (found.plate - contact.plate)
        raise NotConverged(f"no convergence in {ITERATIONS} iterations (residual {norm:.1e})")


def _half(step: np.ndarray | None, halvings: int, cause: str) -> np.ndarray:
    """Half of the last step, which was too long. Raises NotConverged after too many halvings."""
    if step is None or halvings >= MOST_HALVINGS:
        raise NotConverged(cause)
    return 0.5 * step
