# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The full-order finger: finite strain, viscoelastic bulk, rough rigid plate.

`FullOrderModel` holds mesh and solver of a geometry; `Stepper` takes one finger through a load
history.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from finger_common.errors import InputError, ModelError, check_type

from ..geometry import Geometry
from ..history import (
    ContactHistory,
    ContactPoint,
    check_force_history,
    mean_pressure,
    radius_to_area,
)
from ..laws import ConstitutiveLaw, Tissue
from ..laws.creep_steps import CreepSteps
from .contact_radius import Edge, contact_edge, peak_pressure
from .elasticity import NEO_HOOKE
from .equilibrium import OPEN, SLIP, STEP_LOCK, STICK, Contact, Equilibrium, NotConverged
from .fields import Fields, fields_of
from .mesh import Mesh, finger_mesh
from .mesh_material import Crushed, MeshMaterial

SMALLEST_CUT = 2.0**-14
"""Smallest fraction of a step: a step that does not converge is cut to a quarter, down to this."""

SMALLEST_PART = 1.0 / 64.0
"""Smallest fraction into which a step is divided to follow its path."""
MAXIMUM_NEW_NODES = 2
"""Maximum number of new contact nodes in one part of a divided step."""


@dataclass
class State:
    """State of a finger (SI). Arrays are never changed in place, but for those of
    `contact`.

    time (s), force (N); positions (N, 2); contact; tissue: strain and internal variables of the
    bulk tissue; crept: see `creep_steps`. radius of the contact (m); edge: history of the contact's
    edge; reserve: rise of the force (N) until two more nodes touch. stored: elastic energy; work of
    the plate, dissipation in the tissue and friction_work since the start (J); stored and
    dissipation are NaN where the bulk tissue is linear (see `elasticity`). In steps that are long
    against the relaxation time dissipation may fall by about a hundredth of itself.
    """

    time: float
    force: float
    positions: np.ndarray
    contact: Contact
    tissue: Tissue
    crept: np.ndarray
    radius: float = 0.0
    reserve: float = math.inf
    edge: Edge | None = None
    stored: float = 0.0
    work: float = 0.0
    dissipation: float = 0.0
    friction_work: float = 0.0

    def copy(self) -> State:
        """Independent copy."""
        return replace(self, contact=self.contact.copy())


class FullOrderModel:
    """Axisymmetric finite elements of one geometry; `refinement` divides the node spacing (1 is the
    default).

    A mesh may be given instead of being made from the geometry. elasticity: one of ELASTICITIES;
    others than the default are for comparison. Several threads may use one model, whose steps are
    computed one at a time. Raises InputError for an impossible geometry or an unknown elasticity.
    """

    def __init__(
        self,
        geometry: Geometry | None = None,
        refinement: float = 1.0,
        mesh: Mesh | None = None,
        elasticity: str = NEO_HOOKE,
    ) -> None:
        self.geometry = geometry if geometry is not None else Geometry()
        check_type(self.geometry, Geometry, "geometry")
        self.refinement = refinement
        self.mesh = mesh if mesh is not None else finger_mesh(self.geometry, refinement)
        self.equilibrium = Equilibrium(self.mesh, elasticity)
        self.tip_height = float(self.mesh.nodes[self.mesh.surface, 1].min())

    def start(self, material: ConstitutiveLaw, time: float = 0.0) -> Stepper:
        """A finger of this material at rest, without contact, at `time` (s)."""
        return Stepper(self, material, time)

    def simulate(
        self,
        material: ConstitutiveLaw,
        time: np.ndarray,
        force: np.ndarray,
        progress: Callable[[float], None] | None = None,
    ) -> ContactHistory:
        """Contact under forces (n,) in N at times (n,) in s; at rest before time[0], which may
        carry load.

        `progress` is called with the fraction done. Raises InputError for time that does not
        increase and ModelError, naming time, force and cause, for a load the finger cannot carry.
        """
        time, force = check_force_history(time, force)
        stepper = self.start(material, float(time[0]))
        points = []
        for index in range(len(time)):
            points.append(stepper.step(float(time[index]), float(force[index])))
            if progress is not None:
                progress((index + 1) / len(time))
        return ContactHistory.from_points(points)


class _Target(NamedTuple):
    """Where the plate goes in a step: to a force (N) or to an indentation (m)."""

    is_force: bool
    value: float

    def __str__(self) -> str:
        return f"{self.value:.4g} N" if self.is_force else f"{self.value * 1e3:.4g} mm"


class Stepper:
    """One finger under a load history; `state` may be copied, kept and set again."""

    def __init__(self, model: FullOrderModel, material: ConstitutiveLaw, time: float = 0.0) -> None:
        self.model = model
        self.material = material
        self.mesh_material = MeshMaterial(
            material, model.mesh, model.equilibrium.elements, model.equilibrium.groups
        )
        self._creep = CreepSteps(material, model.geometry.pad_semi_axis_radial)
        self.state = State(
            time,
            0.0,
            model.mesh.nodes.copy(),
            model.equilibrium.unloaded_contact(),
            self.mesh_material.at_rest(),
            self._creep.at_rest(),
        )
        self._before: State | None = None

    def step(self, time: float, force: float) -> ContactPoint:
        """Advance to `time` (s) with the plate's force (N) going there linearly; F ≤ 0 is no
        contact.

        Raises ModelError naming time, force and cause when no equilibrium is found; the state is
        then unchanged.
        """
        with STEP_LOCK:
            return self._advance(time, _Target(True, force))

    def step_to_position(self, time: float, indentation: float) -> ContactPoint:
        """Advance to `time` (s) with the plate moving to `indentation` (m) from first touch.

        Creep does not divide such a step, other than one of `step`: give rows that are short
        against the creep time wherever the plate has just moved.
        """
        with STEP_LOCK:
            return self._advance(time, _Target(False, indentation))

    def _advance(self, time: float, target: _Target) -> ContactPoint:
        """Advance to `time` (s) in as many parts as path and convergence need."""
        start, before = self.state, self._before
        begin = max(start.force, 0.0) if target.is_force else self.indentation
        end = float(target.value)
        if not (math.isfinite(time) and math.isfinite(end)):
            raise InputError(f"step to t = {time} s and {end} N or m: finite numbers are needed")
        if time < start.time:
            raise InputError(
                f"time goes back from {start.time:g} s to {time:g} s; sort the history"
            )
        if target.is_force:
            end = max(end, 0.0)
        done, size = 0.0, 1.0
        while done < 1.0:
            goal = min(1.0, done + size)
            if end > begin and (self.material.friction > 0.0 or time > start.time):
                # Friction and creep depend on the path, which is curved (Hertz: F^(2/3)) while the
                # contact is small: only a few nodes may touch in one part of the step.
                rise = self._allowed_rise() if target.is_force else self._allowed_travel()
                goal = min(goal, done + max(rise / (end - begin), SMALLEST_PART))
            if target.is_force:
                ahead = 1.0 - done
                load = max(self.state.force, 0.0)
                allowed = self._creep.allowed(
                    self.state.crept, ahead * (time - start.time), load, end
                )
                goal = min(goal, done + allowed * ahead)
            if 1.0 - goal < 0.1 * (goal - done):
                goal = 1.0
            part = target._replace(value=begin + goal * (end - begin))
            instant = start.time + goal * (time - start.time)
            try:
                self._try(instant, part)
            except (NotConverged, Crushed) as error:
                size = 0.25 * (goal - done)
                if size < SMALLEST_CUT:
                    self.state, self._before = start, before
                    raise ModelError(
                        f"no equilibrium at t = {instant:.4g} s, {part}: {error}; the load is "
                        "beyond what this finger carries: lower it or use stiffer moduli"
                    ) from None
                continue
            done = goal
            size = 2.0 * size
        if target.is_force:
            self.state.force = target.value
        return self.point()

    @property
    def indentation(self) -> float:
        """Travel of the plate (m) from first touch of the unloaded shape."""
        return self.state.contact.height - self.model.tip_height

    def _path(
        self, duration: float, x: np.ndarray, force: float | None
    ) -> tuple[np.ndarray, float]:
        """Rates, per step, of the creeping tissue's load (2N,) and of the plate's force (N/rad) at
        a step's end.

        While the force falls, rests or is not given, the path is that of the force alone: the creep
        of tissue under a constant force does not show the order in which nodes touch.
        """
        equilibrium = self.model.equilibrium
        rise = (force if force is not None else 0.0) - max(self.state.force, 0.0)
        if duration <= 0.0 or force is None or rise <= 0.0:
            return np.zeros(equilibrium.unknowns), 1.0
        rate = self.mesh_material.rate(duration, self.state.tissue)
        equilibrium.assemble(x, rate, stiffness=False)
        return -equilibrium.force, rise / (2.0 * math.pi)

    def _try(self, time: float, target: _Target) -> None:
        """One step without cutting; leaves the state alone unless it converges."""
        state, friction = self.state, self.material.friction
        force = target.value if target.is_force else None
        height = None if target.is_force else self.model.tip_height + target.value
        equilibrium = self.model.equilibrium
        surface = self.model.mesh.surface
        duration = time - state.time
        x, contact = self._guess(time, force, height)
        contact.reference = np.where(
            state.contact.status != OPEN, state.positions[surface, 0], np.nan
        )
        material = self.mesh_material.step(duration, state.tissue)
        x, contact = equilibrium.solve(x, contact, material, friction, force, height)
        if force is not None and force <= 0.0:
            contact.height = float(x[surface, 1].min())
        load, rise = self._path(duration, x, force)
        creep = self.material.creep_time / duration if duration > 0 else math.inf
        radius, reserve, edge = contact_edge(
            equilibrium, x, contact, friction, load, rise, creep, state.edge
        )
        total = 2.0 * math.pi * float(contact.normal.sum())
        tissue, stored, dissipated = self.mesh_material.update(duration, state.tissue, x)
        slip = x[surface, 0] - state.positions[surface, 0]
        friction_work = -0.5 * float((contact.shear + state.contact.shear) @ slip)
        plate_work = 0.5 * (max(state.force, 0.0) + total) * (contact.height - state.contact.height)
        self._before = state
        self.state = State(
            time=time,
            force=force if force is not None else total,
            positions=x,
            contact=contact,
            tissue=tissue,
            crept=self._creep.followed(state.crept, duration, state.force, total),
            radius=radius,
            reserve=reserve,
            edge=edge,
            stored=2.0 * math.pi * stored,
            work=state.work + plate_work,
            dissipation=state.dissipation + 2.0 * math.pi * dissipated,
            friction_work=state.friction_work + 2.0 * math.pi * friction_work,
        )

    def _allowed_rise(self) -> float:
        """Rise of the force (N) in which at most a few more skin nodes touch."""
        state = self.state
        if state.contact.status.any():
            return MAXIMUM_NEW_NODES / 2.0 * state.reserve
        mesh = self.model.mesh
        touched = state.positions[mesh.surface[MAXIMUM_NEW_NODES], 0]
        return self._hertz_force(touched)

    def _allowed_travel(self) -> float:
        """Rise of the plate (m) in which at most a few more skin nodes touch."""
        state = self.state
        open_nodes = self.model.mesh.surface[state.contact.status == OPEN]
        gaps = state.positions[open_nodes, 1] - state.contact.height
        if len(gaps) <= MAXIMUM_NEW_NODES:
            return math.inf
        return float(np.partition(gaps, MAXIMUM_NEW_NODES)[MAXIMUM_NEW_NODES])

    def _hertz_force(self, radius: float) -> float:
        """Force (N) at which Hertz's solution for the resting tissue has a contact radius (m)."""
        shear = self.material.instantaneous_shear_modulus
        return 16.0 / 3.0 * shear * radius**3 / self.model.geometry.tip_radius

    def _guess(
        self, time: float, force: float | None, height: float | None
    ) -> tuple[np.ndarray, Contact]:
        """Starting positions and contact of a step: extrapolation, or Hertz at first touch."""
        state, before = self.state, self._before
        equilibrium, surface = self.model.equilibrium, self.model.mesh.surface
        contact = state.contact.copy()
        x = state.positions.copy()
        if self.material.friction > 0.0:
            # A node that touched beside sticking ones slipped without direction.
            undecided = (contact.status == SLIP) & (contact.direction == 0.0) & ~equilibrium.guided
            equilibrium.follow(contact, np.flatnonzero(undecided))
            contact.status[undecided & (contact.direction == 0.0)] = STICK
        if not contact.status.any():
            if force is not None and force > 0.0:
                tip = self.model.geometry.tip_radius
                radius = tip * np.cbrt(force / self._hertz_force(tip))
                radius = min(radius, 0.4 * self.model.geometry.pad_semi_axis_radial)
                contact.height = float(x[surface, 1].min()) + radius**2 / tip
                contact.status[x[surface, 0] <= 0.8 * radius] = SLIP
                contact.status[np.argmin(x[surface, 1])] = SLIP
            elif height is not None:
                contact.status[x[surface, 1] < height] = SLIP
            return x, contact
        if before is not None and before.contact.status.any():
            if force is not None:
                past, now = state.force - before.force, force - state.force
            else:
                past = state.contact.height - before.contact.height
                now = (height or 0.0) - state.contact.height
            if abs(now) < 1e-12 * abs(past) or past == 0.0:
                past, now = state.time - before.time, time - state.time
            ratio = now / past if past != 0.0 else 0.0
            if 0.0 < ratio <= 2.0:
                x = x + ratio * (state.positions - before.positions)
                contact.height += ratio * (state.contact.height - before.contact.height)
                if height is not None:
                    contact.height = height
                # A part brings few new nodes: of more, those too many would only be released again.
                touching = (contact.status == OPEN) & (x[surface, 1] < contact.height)
                equilibrium.follow(contact, np.flatnonzero(touching)[:MAXIMUM_NEW_NODES])
        return x, contact

    def point(self) -> ContactPoint:
        """Contact at the present state."""
        state = self.state
        mesh = self.model.mesh
        area = radius_to_area(state.radius)
        force = state.force
        mean = mean_pressure(max(force, 0.0), area)
        return ContactPoint(
            state.time,
            force,
            area,
            state.radius,
            self.indentation,
            peak_pressure(state.positions[mesh.surface], state.contact, mean),
            mean,
        )

    def fields(self) -> Fields:
        """Displacement, stress and contact tractions at the present state."""
        state = self.state
        material = self.mesh_material.step(0.0, state.tissue).stiffness(state.positions)
        return fields_of(self.model.equilibrium, state.positions, state.contact, material)
