# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Equilibrium of a mesh pressed by a rigid, flat, rough plate: Newton's method with an active set.

Contact is exact: a node in contact has the plate's height, its reaction is the contact force, and
no contact stiffness exists. Nodes that stick keep their radius; nodes that slip feel friction ×
reaction against their motion. The set of open, sticking and slipping nodes is updated with every
Newton iteration (semismooth Newton, or primal–dual active set: Hüeber, Stadler, Wohlmuth 2008). The
symmetric part of the tangent is factorised as a band matrix; the plate's height and the unsymmetric
rows of slipping nodes enter as a border.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dtbsv
from scipy.linalg.lapack import dpbtrf

from . import elements
from .elasticity import NEO_HOOKE, groups_of
from .elements import Stiffness
from .mesh import Mesh
from .mesh_material import StepMaterial

OPEN, STICK, SLIP = 0, 1, 2

TOLERANCE = 1e-8
"""Residual, relative to the plate's force, at which an iteration has converged."""
ITERATIONS = 40
HALVINGS = 6
"""Times that a step is halved before none is found."""
BUCKLES = "the tangent stiffness is not positive definite (the tissue buckles)"
INSIDE_OUT = "elements turn inside out"

STEP_LOCK = threading.Lock()
"""Held while a step is computed: a solver has work arrays, and threads may share a model."""


class NotConverged(Exception):
    """A load step found no equilibrium; the message is the cause."""


@dataclass
class Contact:
    """State of the skin nodes (S,) against the plate.

    status: OPEN, STICK or SLIP; direction: sign of the radial slip; reference: radius (m) a
    sticking node keeps; normal, shear: forces of the plate on the nodes (N/rad), up and outwards;
    height: z of the plate (m).
    """

    status: np.ndarray
    direction: np.ndarray
    reference: np.ndarray
    normal: np.ndarray
    shear: np.ndarray
    height: float

    def copy(self) -> Contact:
        """Independent copy."""
        arrays = ("status", "direction", "reference", "normal", "shear")
        return replace(self, **{name: getattr(self, name).copy() for name in arrays})


class ContactSet(NamedTuple):
    """Indices of skin nodes in contact, and of those that stick and slip off the axis."""

    active: np.ndarray
    sticking: np.ndarray
    slipping: np.ndarray


@dataclass
class _Move:
    """A step of Newton's method: of the nodes (N, 2) and of the plate, in m."""

    nodes: np.ndarray
    plate: float
    halvings: int = 0

    def undo_half(self, x: np.ndarray, contact: Contact) -> np.ndarray:
        """Take half of a step that was too long back; the positions (N, 2) then."""
        self.halvings += 1
        self.nodes = 0.5 * self.nodes
        self.plate *= 0.5
        contact.height -= self.plate
        return x - self.nodes


class Tangent:
    """Linear response about a state: factorised stiffness, with plate height and friction as a
    border.

    Takes the band of the last assembly and overwrites it. friction (S,): friction coefficient times
    direction of slip; loaded: the plate's force is given, not its height. `stable`: the stiffness
    is positive definite; only then may `respond` be called.
    """

    def __init__(
        self, equilibrium: Equilibrium, nodes: ContactSet, friction: np.ndarray, loaded: bool
    ) -> None:
        active, sticking, slipping = nodes
        band = equilibrium.band
        self.unknowns = equilibrium.unknowns
        self.loaded = loaded and len(active) > 0
        self.zdof = equilibrium.axial[active]
        self.dofs = np.concatenate([self.zdof, equilibrium.radial[sticking]])
        self.sdof = equilibrium.radial[slipping]
        self.slip_row = np.searchsorted(active, slipping)
        self.friction = friction[slipping]
        self.rows = np.empty((len(self.dofs), 2 * band.shape[1] - 1))
        elements.band_rows(band, self.dofs, self.rows)
        self.rise_column = self.force_of(np.repeat([1.0, 0.0], [len(active), len(sticking)]))
        self.held = np.concatenate([equilibrium.fixed, self.dofs])
        elements.hold(band, self.held)
        self.factor, info = dpbtrf(band.T, lower=1, overwrite_ab=1)
        self.stable = info == 0

    def force_of(self, displacements: np.ndarray) -> np.ndarray:
        """Force (n,) of given displacements (k,) of the held contact unknowns."""
        out = np.zeros(self.unknowns)
        elements.add_rows(self.rows, self.dofs, displacements, out)
        return out

    def respond(
        self, loads: np.ndarray, force: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Displacements (m, n), plate rises (m,) and reactions (m, k) at the held contact unknowns.

        loads (m, n): on all unknowns; force (m,): total force of the plate (N/rad), if it is given.
        """
        m, slips = len(loads), len(self.sdof)
        right = loads.copy()
        right[:, self.sdof] += self.friction * loads[:, self.zdof[self.slip_row]]
        right[:, self.held] = 0.0
        # With K = L Lᵀ, products of rows of K with K⁻¹ columns are those of their forward
        # substitutions. Contact unknowns are the last of the numbering: their vectors are
        # substituted over that end only.
        start = max(0, int(self.dofs.min(initial=self.unknowns)) - self.factor.shape[0])
        end = np.zeros((1 + 2 * slips, self.unknowns - start))
        end[0] = self.rise_column[start:]
        end[1 + np.arange(slips), self.sdof - start] = 1.0
        elements.copy_rows(self.rows, self.dofs, self.slip_row, start, end[1 + slips :])
        end[:, self.held[self.held >= start] - start] = 0.0
        width = self.factor.shape[0] - 1
        for vector in right:
            vector[:] = dtbsv(width, self.factor, vector, lower=1)
        tail = np.ascontiguousarray(end.T)
        elements.substitute_forward(self.factor.T, start, tail)
        near = right[:, start:].T
        by_load = tail[:, : 1 + slips]
        slip_rows = tail[:, 1 + slips :].T
        # Small system for the friction increments of slipping nodes and the rise of the plate.
        small = np.zeros((slips + 1, slips + 1))
        rhs = np.zeros((slips + 1, m))
        products = slip_rows @ by_load
        zslip = self.zdof[self.slip_row]
        small[:slips, :slips] = np.eye(slips) + self.friction[:, None] * products[:, 1:]
        small[:slips, slips] = self.friction * (products[:, 0] - self.rise_column[zslip])
        rhs[:slips] = self.friction[:, None] * (slip_rows @ near)
        if self.loaded:
            total = tail[:, 0] @ by_load
            small[slips, :slips] = -total[1:]
            small[slips, slips] = self.rise_column[self.zdof].sum() - total[0]
            rhs[slips] = force + loads[:, self.zdof].sum(axis=1) - tail[:, 0] @ near
        else:
            small[slips, slips] = 1.0
        try:
            unknown = np.linalg.solve(small, rhs)
        except np.linalg.LinAlgError:
            raise NotConverged("the linear system is singular") from None
        rise = unknown[slips]
        near -= by_load @ np.concatenate([rise[None, :], unknown[:slips]])
        displacements = right
        for vector in displacements:
            vector[:] = dtbsv(width, self.factor, vector, lower=1, trans=1)
        displacements[:, self.held] = 0.0
        products = np.empty((len(self.dofs), m))
        elements.rows_times(self.rows, self.dofs, displacements, products)
        reaction = -loads[:, self.dofs] + products.T + rise[:, None] * self.rise_column[self.dofs]
        displacements[:, self.zdof] += rise[:, None]
        return displacements, rise, reaction

    def newton(
        self, force: np.ndarray, closing: np.ndarray, target: float, longest: float
    ) -> tuple[_Move, np.ndarray]:
        """Step of at most `longest` (m) towards equilibrium, and the reactions (k,) after it.

        force (n,): not balanced yet; closing (k,): displacements (m) that are missing at the held
        contact unknowns; target: force of the plate (N/rad), if it is given. Raises NotConverged.
        """
        known = self.force_of(closing)
        displacements, rises, reactions = self.respond(
            -(force + known)[None, :], np.array([target])
        )
        step, rise = displacements[0], float(rises[0])
        step[self.dofs] += closing
        largest = float(np.abs(step).max())
        if not math.isfinite(largest):
            raise NotConverged("the linear system is singular")
        if largest > longest:
            limit = longest / largest
            step = limit * step
            rise *= limit
        return _Move(step.reshape(-1, 2), rise), reactions[0]


@dataclass
class Equilibrium:
    """Solver for one mesh; all that does not change between solves is kept here."""

    mesh: Mesh
    elasticity: str = NEO_HOOKE
    """One of ELASTICITIES."""
    residuals: list[float] = field(default_factory=list)
    """Relative residual of every iteration of the last solve."""

    def __post_init__(self) -> None:
        mesh = self.mesh
        self.elements = elements.reference_elements(mesh.nodes, mesh.cells)
        self.groups = groups_of(mesh, self.elements, self.elasticity)
        self.unknowns = 2 * len(mesh.nodes)
        self.force = np.zeros(self.unknowns)
        self.band = np.zeros((self.unknowns, mesh.half_bandwidth + 1))
        self.fixed = np.flatnonzero(mesh.fixed.ravel())
        self.radial = 2 * mesh.surface
        self.axial = 2 * mesh.surface + 1
        self.guided = mesh.fixed[mesh.surface, 0]
        """Skin nodes that cannot move radially (on the axis)."""

    def unloaded_contact(self) -> Contact:
        """No contact, the plate touching the undeformed tip."""
        n = len(self.mesh.surface)
        return Contact(
            np.zeros(n, dtype=np.int64),
            np.zeros(n),
            self.mesh.nodes[self.mesh.surface, 0].copy(),
            np.zeros(n),
            np.zeros(n),
            float(self.mesh.nodes[self.mesh.surface, 1].min()),
        )

    def assemble(self, x: np.ndarray, material: Stiffness, stiffness: bool = True) -> float:
        """Fill `force` (and `band`) at positions x (N, 2); returns the smallest J."""
        self.force[:] = 0.0
        if stiffness:
            self.band[:] = 0.0
        found = [
            group.assemble(x, material, stiffness, self.force, self.band) for group in self.groups
        ]
        return min(found)

    def solve(
        self,
        x: np.ndarray,
        contact: Contact,
        material: StepMaterial,
        friction: float,
        load: float | None,
        height: float | None = None,
    ) -> tuple[np.ndarray, Contact]:
        """Positions (N, 2) and contact at a plate force `load` (N) or else a plate `height` (m).

        x and contact are the starting guess; contact.reference holds the radii to stick to. Raises
        NotConverged with the cause.
        """
        x = x.copy()
        contact = contact.copy()
        if height is not None:
            contact.height = height
        target = 0.0 if load is None else max(load, 0.0) / (2.0 * math.pi)
        pressed = height is not None or target > 0.0
        if not pressed:
            contact.status[:] = OPEN
        length = -float(self.mesh.nodes[:, 1].min())
        smallest_scale = 1e-3 * float(material.metric[:, :, :3].mean()) * length**2
        self.residuals = []
        changed = True
        previous = math.inf
        move: _Move | None = None
        for iteration in range(ITERATIONS):
            smallest_volume = self.assemble(x, material.stiffness(x))
            nodes = self.contact_set(contact)
            gap = contact.height - x[self.mesh.surface[nodes.active], 1]
            drift = contact.reference[nodes.sticking] - x[self.mesh.surface[nodes.sticking], 0]
            closing = np.concatenate([gap, drift])
            total = float(self.force[self.axial[nodes.active]].sum())
            scale = max(target, abs(total), smallest_scale)
            norm, mismatch = math.inf, 0.0
            if smallest_volume > 0:
                missing = target - total if load is not None else 0.0
                unbalanced = float(np.linalg.norm(self._residual(contact, nodes, friction)))
                norm = math.hypot(unbalanced, missing) / scale
                mismatch = float(np.abs(closing).max(initial=0.0)) / length
            overshot = move is not None and norm > 4.0 * previous and norm > 1e-3 and not changed
            tangent = None
            if math.isfinite(norm) and not overshot:
                # Rounding of nearly incompressible tissue may end progress a little above the
                # tolerance.
                stalled = norm < 100.0 * TOLERANCE and norm > 0.3 * previous
                if (norm < TOLERANCE or stalled) and mismatch < 1e-10 and not changed:
                    self.residuals.append(norm)
                    self._keep_reactions(contact, nodes)
                    return x, contact
                tangent = Tangent(self, nodes, friction * contact.direction, load is not None)
            if tangent is None or not tangent.stable:
                if move is None or move.halvings >= HALVINGS:
                    if tangent is not None:
                        raise NotConverged(BUCKLES)
                    inside_out = smallest_volume <= 0 or math.isfinite(norm)
                    raise NotConverged(INSIDE_OUT if inside_out else material.no_stress)
                x = move.undo_half(x, contact)
                continue
            self.residuals.append(norm)
            previous = norm
            move, reactions = tangent.newton(self.force, closing, target, 0.1 * length)
            x = x + move.nodes
            contact.height += move.plate
            changed = pressed and self._update_set(
                x,
                contact,
                nodes,
                reactions,
                friction,
                force_tolerance=1e-10 * scale,
                keep_one=load is not None,
                one_at_a_time=iteration > 14,
            )
        raise NotConverged(f"no convergence in {ITERATIONS} iterations (residual {norm:.1e})")

    def contact_set(self, contact: Contact) -> ContactSet:
        """The nodes in contact."""
        active = np.flatnonzero(contact.status != OPEN)
        free = active[~self.guided[active]]
        slips = contact.status[free] == SLIP
        return ContactSet(active, free[~slips], free[slips])

    def follow(self, contact: Contact, nodes: np.ndarray) -> None:
        """Let new nodes of the contact slip as their neighbours towards the axis do."""
        for node in nodes:
            contact.status[node] = SLIP
            contact.direction[node] = 0.0 if self.guided[node] else contact.direction[node - 1]

    def _residual(self, contact: Contact, nodes: ContactSet, friction: float) -> np.ndarray:
        """Unbalanced force (2N,) of the unknowns that are not held, from `force`."""
        residual = -self.force
        slips = nodes.slipping
        drag = friction * contact.direction[slips] * self.force[self.axial[slips]]
        residual[self.radial[slips]] -= drag
        residual[self.fixed] = 0.0
        residual[self.axial[nodes.active]] = 0.0
        residual[self.radial[nodes.sticking]] = 0.0
        return residual

    def _keep_reactions(self, contact: Contact, nodes: ContactSet) -> None:
        """Forces of the plate on the nodes from the internal `force` of an equilibrium."""
        contact.normal[:] = 0.0
        contact.shear[:] = 0.0
        contact.normal[nodes.active] = self.force[self.axial[nodes.active]]
        contact.shear[nodes.active] = self.force[self.radial[nodes.active]]
        contact.shear[self.guided] = 0.0

    def _update_set(
        self,
        x: np.ndarray,
        contact: Contact,
        nodes: ContactSet,
        reaction: np.ndarray,
        friction: float,
        force_tolerance: float,
        keep_one: bool,
        one_at_a_time: bool,
    ) -> bool:
        """Move nodes between open, sticking and slipping; True if any moved.

        reaction (k,): of the plate on the active, then on the sticking nodes. keep_one: never open
        all nodes; one_at_a_time: against cycling.
        """
        active, sticking, slipping = nodes
        surface, status = self.mesh.surface, contact.status
        length = -float(self.mesh.nodes[:, 1].min())
        before = status.copy()
        normal = np.zeros(len(surface))
        normal[active] = reaction[: len(active)]
        released = active[normal[active] < -force_tolerance]
        gap = x[surface, 1] - contact.height
        touching = np.flatnonzero((status == OPEN) & (gap < -1e-12 * length))
        if one_at_a_time:
            released = released[np.argsort(normal[released])][:1]
            touching = (
                touching[np.argsort(gap[touching])][:1] if not len(released) else touching[:0]
            )
        if keep_one and len(active) and len(released) == len(active) and not len(touching):
            # The node with the largest reaction stays in contact.
            released = np.delete(released, np.argmax(normal[released]))
        if friction > 0.0:
            shear = np.zeros(len(surface))
            shear[sticking] = reaction[len(active) :]
            limit = friction * np.maximum(normal[sticking], 0.0) + force_tolerance
            sliding = sticking[np.abs(shear[sticking]) > limit]
            # A node open when the step began has no reference: it slips until the next step.
            known = slipping[np.isfinite(contact.reference[slipping])]
            travel = x[surface[known], 0] - contact.reference[known]
            stopped = known[travel * contact.direction[known] < -1e-13 * length]
            started = known[contact.direction[known] == 0.0]
            if one_at_a_time:
                started = started[:0]
                if len(released) or len(touching):
                    sliding, stopped = sliding[:0], stopped[:0]
                else:
                    sliding, stopped = sliding[:1], stopped[: 0 if len(sliding) else 1]
            status[sliding] = SLIP
            contact.direction[sliding] = -np.sign(shear[sliding])
            status[stopped] = STICK
            status[started] = STICK
            contact.direction[stopped] = 0.0
        status[released] = OPEN
        contact.direction[released] = 0.0
        self.follow(contact, touching)
        return bool(np.any(before != status))
