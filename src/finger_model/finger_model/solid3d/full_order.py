# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The three-dimensional finger: tangential load, elliptical pad, tilted plate.

`SolidModel` holds mesh and solver of a finger and a plate; `SolidStepper` takes it through a
history of loads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np

from finger_common.errors import InputError, ModelError, check_type

from ..fem.equilibrium import OPEN, SLIP, STEP_LOCK, STICK, NotConverged
from ..fem.mesh_material import Crushed, StepMaterial
from ..geometry import Geometry
from ..history import CSV_HEADER, check_force_history, csv_of, mean_pressure
from ..laws import ConstitutiveLaw, Tissue
from ..laws.creep_steps import CreepSteps
from ..pose.pose import Pose
from .contact import Contact, NotSettled, Plate, Sliding
from .contact_shape import node_areas, outline, pressure, stick_ratio, twist_torque
from .equilibrium import Equilibrium
from .material import SolidMaterial
from .mesh import MeshSize, SolidMesh, solid_mesh

SMALLEST_CUT = 2.0**-12
"""Smallest fraction of a step: a step that does not converge is cut to a quarter, down to this."""
FAR = 1e3
"""Shift of a sliding plate over the finger's height, at which every node slips along it."""
FULL_SLIP = 0.95
"""Share of the friction from which on the plate slides where no node sticks. Skin that spreads does
not slip along the pull alone, so that all of it slips before the pull is μP: from 0.97 μP on."""
SAME_WAY = 0.5
"""Cosine of the angle between two slides up to which the plate goes on the same way."""


SOLID_CSV_HEADER = (
    CSV_HEADER + ",semi_axis_a_mm,semi_axis_b_mm,stick_ratio,slip_margin,tangential_displacement_mm"
    ",orientation_deg,center_x_mm,center_y_mm"
)


@dataclass(frozen=True)
class SolidPoint:
    """Contact at one instant (SI); vectors are in axes of the plate, see `Pose`.

    time (s), force (N): along the plate's normal; area (m²), radius (m): √(area/π); indentation
    (m): the plate's travel along its normal from first touch of the unloaded shape; peak and mean
    pressure (Pa); semi_axis_a ≥ semi_axis_b (m), orientation (rad) of a from x, center_x, center_y
    (m): of the contact; tangential_x, tangential_y (N): force of the plate on the skin; shift_x,
    shift_y (m): of the plate; twist (rad): its turn about the normal; twist_torque (N m): of the
    plate on the skin about the normal through the centre of pressure; stick_ratio: share of the
    area that slid by less than 5 % of the plate's travel in the step, for a twist that of the edge,
    zero where the plate slides; slip_margin: 1 − |Q|/(μ P), at least zero, whatever the torque; Q
    is the pull that is given, if one is. Without contact, and without friction, these two are NaN.
    """

    time: float
    force: float
    area: float
    radius: float
    indentation: float
    peak_pressure: float
    mean_pressure: float
    semi_axis_a: float
    semi_axis_b: float
    orientation: float
    center_x: float
    center_y: float
    tangential_x: float
    tangential_y: float
    shift_x: float
    shift_y: float
    twist: float
    twist_torque: float
    stick_ratio: float
    slip_margin: float


@dataclass(frozen=True)
class SolidHistory:
    """Contact over time: arrays (n,) in SI of the fields of `SolidPoint`, by name."""

    columns: dict[str, np.ndarray] = field(default_factory=dict)

    def __getattr__(self, name: str) -> np.ndarray:
        columns = self.__dict__.get("columns", {})
        if name in columns:
            return columns[name]
        raise AttributeError(name)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    @classmethod
    def from_points(cls, points: Sequence[SolidPoint], load: np.ndarray) -> SolidHistory:
        """History of the given points in their order under normal forces `load` (n,) in N."""
        names = [f.name for f in fields(SolidPoint)]
        columns = {name: np.array([getattr(p, name) for p in points]) for name in names}
        return cls({**columns, "load": np.array(load, dtype=float)})

    def csv_text(self) -> str:
        """The header SOLID_CSV_HEADER and one line per instant."""
        columns = (
            self.area * 1e6,
            self.radius * 1e3,
            self.indentation * 1e3,
            self.peak_pressure * 1e-3,
            self.semi_axis_a * 1e3,
            self.semi_axis_b * 1e3,
            self.stick_ratio,
            self.slip_margin,
            self.shift_x * 1e3,
            np.degrees(self.orientation),
            self.center_x * 1e3,
            self.center_y * 1e3,
        )
        return csv_of(SOLID_CSV_HEADER, self.time, self.load, *columns)


class Slide(NamedTuple):
    """A plate that slides along `way` (2,), a unit vector, or zero without friction and pull.

    share: |Q|/(μ P) of the pull, at most 1; onset: that at which the slide began; load: largest
    normal force (N) on the mesh in it.
    """

    way: np.ndarray
    share: float
    onset: float
    load: float

    def same_way(self, way: np.ndarray) -> bool:
        """Whether a slide along `way` (2,), a unit vector or zero, goes on with this one."""
        return float(self.way @ way) > SAME_WAY


@dataclass
class SolidState:
    """State of a finger (SI). Arrays are never changed in place, but for those of `contact`.

    slid (S, 2): way (m) of the skin's nodes along the plate since the newest step of the caller
    began; crept: see `creep_steps`; slide: None where some node sticks, or where the plate's force
    along itself is not given; twist (rad): turn of the plate since the start.
    """

    time: float
    positions: np.ndarray
    contact: Contact
    tissue: Tissue
    slid: np.ndarray
    crept: np.ndarray
    slide: Slide | None = None
    twist: float = 0.0

    def copy(self) -> SolidState:
        """Independent copy."""
        return replace(self, contact=self.contact.copy())


class SolidModel:
    """Finite elements of one finger against one plate.

    refinement divides the node spacing; half: use the symmetry of the pose, if it has one, for
    loads along x; size and mesh replace the default ones; stick_stiffness: see `Equilibrium`.
    Several threads may use one model, whose steps are computed one at a time. Raises InputError.
    """

    def __init__(
        self,
        geometry: Geometry | None = None,
        pose: Pose | None = None,
        refinement: float = 1.0,
        half: bool = True,
        size: MeshSize | None = None,
        mesh: SolidMesh | None = None,
        stick_stiffness: float = math.inf,
    ) -> None:
        if not 0.25 <= refinement <= 4:
            raise InputError(f"refinement is {refinement:g}, outside 0.25 … 4; 1 is the default")
        self.geometry = geometry if geometry is not None else Geometry()
        self.pose = pose if pose is not None else Pose()
        check_type(self.geometry, Geometry, "geometry")
        check_type(self.pose, Pose, "pose")
        fineness = (size or MeshSize()).refined(refinement)
        self.mesh = (
            mesh if mesh is not None else solid_mesh(self.geometry, self.pose, fineness, half)
        )
        self.equilibrium = Equilibrium(self.mesh, stick_stiffness)
        self.tip_height = float(self.mesh.nodes[self.mesh.surface, 2].min())

    def start(self, material: ConstitutiveLaw, time: float = 0.0) -> SolidStepper:
        """A finger of this material at rest, without contact, at `time` (s)."""
        return SolidStepper(self, material, time)

    def simulate(
        self,
        material: ConstitutiveLaw,
        time: np.ndarray,
        force: np.ndarray,
        tangential_force: np.ndarray | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> SolidHistory:
        """Contact under forces (n,) in N along the plate's normal and tangential forces (n,) along
        x, or (n, 2), in N at times (n,) in s; at rest before time[0], which may carry load.

        `progress` is called with the fraction done. Raises InputError, also for tangential forces
        of another shape, and ModelError as the axisymmetric model does.
        """
        time, force = check_force_history(time, force)
        stepper = self.start(material, float(time[0]))
        pulls: list[tuple[float, float] | None] = [None] * len(time)
        if tangential_force is not None:
            pulls = [(float(x), float(y)) for x, y in _pulls(tangential_force, len(time))]
        points = []
        for index in range(len(time)):
            points.append(stepper.step(float(time[index]), float(force[index]), pulls[index]))
            if progress is not None:
                progress((index + 1) / len(time))
        return SolidHistory.from_points(points, force)


def _pulls(given: Any, rows: int) -> np.ndarray:
    """Tangential forces (rows, 2) in N of what is given, (rows,) along x or (rows, 2); raises
    InputError."""
    try:
        pull = np.asarray(given, float)
    except (TypeError, ValueError):
        raise InputError("tangential force: not an array of numbers; give forces in N") from None
    if pull.shape not in ((rows,), (rows, 2)):
        raise InputError(
            f"tangential force has the shape {pull.shape}; give ({rows},) along x, or ({rows}, 2), "
            "one row for each time"
        )
    return np.column_stack([pull, np.zeros(rows)]) if pull.ndim == 1 else pull


class SolidStepper:
    """One finger under a load history; `state` may be copied, kept and set again."""

    def __init__(self, model: SolidModel, material: ConstitutiveLaw, time: float = 0.0) -> None:
        self.model = model
        self.material = material
        self.solid = SolidMaterial(material, model.mesh, model.equilibrium.elements)
        self._creep = CreepSteps(material, model.geometry.pad_semi_axis_radial)
        self.state = SolidState(
            time,
            model.mesh.nodes.copy(),
            model.equilibrium.unloaded_contact(),
            self.solid.at_rest(),
            np.zeros((len(model.mesh.surface), 2)),
            self._creep.at_rest(),
        )
        self._begun = self.state
        """State when the newest step of the caller began."""
        self._before: SolidState | None = None
        with STEP_LOCK:
            model.equilibrium.forget()

    def step(
        self,
        time: float,
        force: float,
        tangential_force: tuple[float, float] | None = None,
        shift: tuple[float, float] | None = None,
        twist: float | None = None,
    ) -> SolidPoint:
        """Advance to `time` (s) with the plate's normal force (N) going there linearly.

        Along the plate either its force on the skin (N) or its shift (m) since the start is given;
        by default it does not move. A tangential force beyond friction makes the plate slide.
        twist (rad): turn of the plate since the start, about its normal through the place of first
        touch, which shifts with it; by default it does not turn. F ≤ 0 is no contact. Raises
        InputError for a twist where the tangential force is given, and ModelError when no
        equilibrium is found; the state is then unchanged.
        """
        with STEP_LOCK:
            return self._advance(time, max(force, 0.0), None, tangential_force, shift, twist)

    def step_to_position(
        self,
        time: float,
        indentation: float,
        shift: tuple[float, float] | None = None,
        twist: float | None = None,
    ) -> SolidPoint:
        """Advance to `time` (s) with the plate moving to `indentation` (m) from first touch, to a
        shift (m) along itself and a twist (rad); by default it does neither. Creep does not divide
        such a step, other than one of `step`."""
        with STEP_LOCK:
            return self._advance(time, None, indentation, None, shift, twist)

    @property
    def sliding(self) -> bool:
        """Whether the plate slides under the pull that is given."""
        return self.state.slide is not None

    @property
    def indentation(self) -> float:
        """Travel of the plate (m) from first touch of the unloaded shape."""
        return float(self.state.contact.plate[2]) - self.model.tip_height

    @property
    def plate_force(self) -> np.ndarray:
        """Force (3,) in N of the plate on the finger: tangential x, y and normal."""
        total = self.model.mesh.copies * self.state.contact.force.sum(axis=0)
        if self.model.mesh.half:
            total[1] = 0.0
        return total

    def _advance(
        self,
        time: float,
        force: float | None,
        indentation: float | None,
        pull: tuple[float, float] | None,
        shift: tuple[float, float] | None,
        twist: float | None,
    ) -> SolidPoint:
        """Advance to `time` in as many parts as creep and convergence need."""
        start, before = self.state, self._before
        values = (force, indentation, *(pull or ()), *(shift or ()), twist)
        given = [value for value in values if value is not None]
        if not all(math.isfinite(v) for v in (time, *given)):
            raise InputError(f"step to t = {time} s and {given}: finite numbers are needed")
        if time < start.time:
            raise InputError(
                f"time goes back from {start.time:g} s to {time:g} s; sort the history"
            )
        sideways = (pull or (0.0, 0.0))[1], (shift or (0.0, 0.0))[1]
        if self.model.mesh.half and any(sideways):
            raise InputError("a load along y needs the whole finger: use half=False")
        turn = 0.0 if twist is None else twist - start.twist
        if turn and self.model.mesh.half:
            raise InputError("a twist needs the whole finger: use half=False")
        if turn and pull is not None:
            raise InputError("a twist and a tangential force are given: give the shift instead")
        copies = self.model.mesh.copies
        old = start.contact
        begin = np.concatenate([old.plate, old.force.sum(axis=0)])
        end = np.concatenate([old.plate, np.full(3, np.nan)])
        if shift is not None:
            end[:2] = shift
        if pull is not None:
            end[3:5] = np.array(pull) / copies
            end[:2] = np.nan
            if self.model.mesh.half:
                end[1], end[4] = old.plate[1], np.nan
        if force is not None:
            end[5], end[2] = force / copies, np.nan
        else:
            end[2] = self.model.tip_height + (indentation or 0.0)
        self._begun = start
        self.state = replace(start, slid=np.zeros_like(start.slid))
        done, size = 0.0, 1.0
        while done < 1.0:
            goal = min(1.0, done + size)
            if force is not None:
                ahead = 1.0 - done
                allowed = self._creep.allowed(
                    self.state.crept,
                    ahead * (time - start.time),
                    float(self.plate_force[2]),
                    force,
                )
                goal = min(goal, done + allowed * ahead)
            if goal > 1.0 - 1e-9:
                goal = 1.0
            target = begin + goal * (end - begin)
            instant = start.time + goal * (time - start.time)
            try:
                self._try(instant, Plate(target[:3], target[3:]), start.twist + goal * turn)
            except (NotConverged, Crushed) as error:
                # What was factorised on the way is of no use to a smaller step.
                self.model.equilibrium.forget()
                size = 0.25 * (goal - done)
                if size < SMALLEST_CUT:
                    self.state, self._before = start, before
                    remedy = (
                        "lower the pull, or divide the mesh by another refinement"
                        if isinstance(error, NotSettled)
                        else "the load is beyond what this finger carries: lower it or use stiffer "
                        "moduli"
                    )
                    raise ModelError(
                        f"no equilibrium at t = {instant:.4g} s, {self._words(target)}: {error}; "
                        f"{remedy}"
                    ) from None
                continue
            done = goal
            size = 2.0 * size
        return self.point()

    def _words(self, target: np.ndarray) -> str:
        """The target of a step in words."""
        if not math.isnan(target[5]):
            return f"{target[5] * self.model.mesh.copies:.4g} N"
        return f"{(target[2] - self.model.tip_height) * 1e3:.4g} mm"

    def _try(self, time: float, plate: Plate, twist: float) -> None:
        """One step without cutting; leaves the state alone unless it converges."""
        state, friction = self.state, self.material.friction
        duration = time - state.time
        material = self.solid.step(duration, state.tissue)
        skin = state.positions[self.model.mesh.surface]
        slide: Slide | None = None
        if plate.force[2] <= 0.0:
            # No contact: the plate just touches.
            x, contact = state.positions.copy(), state.contact.copy()
            contact.status[:] = OPEN
            contact.force[:] = 0.0
            away = float(skin[:, 2].min()) - self.model.equilibrium.length
            x, contact = self.model.equilibrium.solve(
                x, contact, material, friction, Plate(np.array([0.0, 0.0, away]), plate.force)
            )
            contact.plate = state.contact.plate.copy()
            contact.plate[2] = float(x[self.model.mesh.surface, 2].min())
        else:
            x, contact, slide = self._solve(plate, twist, material)
        self._before = state
        before = float(self.plate_force[2])
        skin = x[self.model.mesh.surface, :2]
        slid = state.slid + skin - contact.plate[:2] - contact.anchor
        slid[contact.status == STICK] = state.slid[contact.status == STICK]
        slid[contact.status == OPEN] = 0.0
        tissue = self.solid.update(duration, state.tissue, x)
        self.state = SolidState(time, x, contact, tissue, slid, state.crept, slide, twist)
        after = float(self.plate_force[2])
        self.state.crept = self._creep.followed(state.crept, duration, before, after)

    def _solve(
        self, plate: Plate, twist: float, material: StepMaterial
    ) -> tuple[np.ndarray, Contact, Slide | None]:
        """Positions and contact; a plate that slides lies where no node sticks any more."""
        state, friction = self.state, self.material.friction
        x, contact = self._guess(plate, twist)
        contact.anchor = self._anchor(state, x, contact, twist)
        contact.begun = state.contact.force[:, :2].copy()
        pulled = np.isnan(plate.position[:2])
        if not pulled.any():
            return *self.model.equilibrium.solve(x, contact, material, friction, plate), None
        pull = np.where(pulled, plate.force[:2], 0.0)
        size, bound = float(np.hypot(*pull)), friction * float(plate.force[2])
        # What rounding leaves of no pull has no direction.
        way = pull / size if size > 1e-9 * plate.force[2] else np.zeros(2)
        share = min(size / bound, 1.0) if bound > 0.0 else 1.0
        old = state.slide
        if old is not None and not old.same_way(way):
            old = None
        onset = old.onset if old is not None else 1.0
        if share < onset - 1e-6:
            try:
                return *self._stuck(x, contact, material, plate), None
            except Sliding:
                if share < FULL_SLIP:
                    raise NotSettled("no skin sticks although friction is not used up") from None
                onset = share
        stays = old is not None and plate.force[2] <= old.load * (1.0 + 1e-6)
        x, contact = self._slide(x, contact, material, plate, way, stays)
        load = float(plate.force[2]) if old is None else max(float(plate.force[2]), old.load)
        return x, contact, Slide(way, share, onset, load)

    def _slide(
        self,
        x: np.ndarray,
        contact: Contact,
        material: StepMaterial,
        plate: Plate,
        way: np.ndarray,
        stays: bool,
    ) -> tuple[np.ndarray, Contact]:
        """The solution where every node slips along `way` (2,): that of a plate that is far away.
        Then the plate lies where the last node has just slipped, or stays where it was."""
        pulled = np.isnan(plate.position[:2])
        begun = self.state.contact.plate[:2]
        position = plate.position.copy()
        far = begun + FAR * self.model.equilibrium.length * way
        position[:2][pulled] = far[pulled]
        contact.status[contact.status == STICK] = SLIP
        solve, friction = self.model.equilibrium.solve, self.material.friction
        x, contact = solve(x, contact, material, friction, Plate(position, plate.force, True))
        active = contact.status != OPEN
        skin = x[self.model.mesh.surface][active, :2]
        travel = 0.0 if stays else float(((skin - begun - contact.anchor[active]) @ way).max())
        contact.plate[:2][pulled] = (begun + max(travel, 0.0) * way)[pulled]
        return x, contact

    def _stuck(
        self, x: np.ndarray, contact: Contact, material: StepMaterial, plate: Plate
    ) -> tuple[np.ndarray, Contact]:
        """The solution under a pull with which some skin sticks. Where no node stuck on the way to
        it, as when the skin has only just touched, the plate is held until some do, then pulled.
        Raises Sliding."""
        solve, friction = self.model.equilibrium.solve, self.material.friction
        try:
            return solve(x, contact, material, friction, plate)
        except Sliding:
            pass
        position, force = plate.position.copy(), plate.force.copy()
        pulled = np.isnan(position[:2])
        position[:2][pulled] = contact.plate[:2][pulled]
        force[:2][pulled] = np.nan
        x, contact = solve(x, contact, material, friction, Plate(position, force))
        return solve(x, contact, material, friction, plate)

    def _anchor(
        self, state: SolidState, x: np.ndarray, contact: Contact, twist: float
    ) -> np.ndarray:
        """Places (S, 2) on the plate where nodes stick: where they were when the step began or,
        for open nodes, where they touch on the way to the guess x of the step's end; then turned
        with the plate."""
        surface = self.model.mesh.surface
        before, after = state.positions[surface], x[surface]
        start = before[:, :2] - state.contact.plate[:2]
        gap = before[:, 2] - state.contact.plate[2]
        approach = gap - (after[:, 2] - contact.plate[2])
        part = np.zeros(len(gap))
        comes = (state.contact.status == OPEN) & (approach > 0.0)
        part[comes] = np.clip(gap[comes] / approach[comes], 0.0, 1.0)
        touched = start + part[:, None] * (after[:, :2] - contact.plate[:2] - start)
        turn = (1.0 - part) * (twist - state.twist)
        x, y = touched.T
        cosine, sine = np.cos(turn), np.sin(turn)
        return np.column_stack([cosine * x - sine * y, sine * x + cosine * y])

    def _guess(self, plate: Plate, twist: float) -> tuple[np.ndarray, Contact]:
        """Starting positions and contact of a step: extrapolation, or Hertz at first touch."""
        state, before = self.state, self._before
        surface = self.model.mesh.surface
        contact, x = state.contact.copy(), state.positions.copy()
        height = plate.position[2]
        if not contact.status.any():
            gap = x[surface, 2] - (height if not math.isnan(height) else math.inf)
            if math.isnan(height):
                shear = self.material.instantaneous_shear_modulus
                tip = self.model.geometry.tip_radius
                load = plate.force[2] * self.model.mesh.copies
                radius = min(
                    (3.0 * load * tip / (16.0 * shear)) ** (1 / 3),
                    0.4 * self.model.equilibrium.length,
                )
                contact.plate[2] = float(x[surface, 2].min()) + 0.6 * radius**2 / tip
                gap = x[surface, 2] - contact.plate[2]
            touching = STICK if self.material.friction > 0.0 else SLIP
            contact.status[gap < 0.0] = touching
            if not math.isnan(plate.force[2]):
                contact.status[np.argmin(x[surface, 2])] = touching
            return x, contact
        if before is not None and before.contact.status.any():
            length = self.model.equilibrium.length
            past = np.concatenate(
                [
                    [length * (state.twist - before.twist)],
                    state.contact.plate - before.contact.plate,
                    (state.contact.force - before.contact.force).sum(axis=0),
                ]
            )
            now = np.concatenate(
                [
                    [length * (twist - state.twist)],
                    plate.position - state.contact.plate,
                    plate.force - state.contact.force.sum(axis=0),
                ]
            )
            ratios = []
            for kind in (slice(0, 4), slice(4, 7)):
                known = ~np.isnan(now[kind])
                a, b = past[kind][known], now[kind][known]
                if float(b @ b) > 0.0:
                    scale = math.sqrt(float(a @ a) * float(b @ b))
                    if float(a @ b) < 0.9 * scale or scale == 0.0:
                        ratios.append(0.0)
                    else:
                        ratios.append(float(b @ b) / float(a @ b))
            ratio = ratios[0] if ratios and max(ratios) < 1.3 * min(ratios) + 1e-12 else 0.0
            if ratio == 0.0 and self.material.friction > 0.0:
                # The load turns: everything sticks at first.
                contact.status[contact.status == SLIP] = STICK
            if 0.0 < ratio <= 2.0:
                x = x + ratio * (state.positions - before.positions)
                contact.plate = contact.plate + ratio * (state.contact.plate - before.contact.plate)
        return x, contact

    def point(self) -> SolidPoint:
        """Contact at the present state."""
        state = self.state
        mesh = self.model.mesh
        skin = state.positions[mesh.surface]
        areas = node_areas(mesh, skin)
        shape = outline(mesh, skin, state.contact, areas)
        qx, qy, force = (float(v) for v in self.plate_force)
        radius = math.sqrt(shape.area / math.pi)
        bound = self.material.friction * force
        stick = margin = math.nan
        if bound > 0.0 and state.slide is not None:
            stick, margin = 0.0, 1.0 - state.slide.share
        elif bound > 0.0:
            turn = radius * (state.twist - self._begun.twist)
            moved = state.contact.plate - self._begun.contact.plate
            travel = float(np.linalg.norm([*moved, turn]))
            stick = stick_ratio(mesh, skin, state.contact, state.slid, travel)
            margin = max(1.0 - math.hypot(qx, qy) / bound, 0.0)
        return SolidPoint(
            time=state.time,
            force=force,
            area=shape.area,
            radius=radius,
            indentation=self.indentation,
            peak_pressure=float(pressure(mesh, state.contact, areas).max(initial=0.0)),
            mean_pressure=mean_pressure(force, shape.area),
            semi_axis_a=shape.semi_axes[0],
            semi_axis_b=shape.semi_axes[1],
            orientation=shape.orientation,
            center_x=float(shape.center[0]),
            center_y=float(shape.center[1]),
            tangential_x=qx,
            tangential_y=qy,
            shift_x=float(state.contact.plate[0]),
            shift_y=float(state.contact.plate[1]),
            twist=state.twist,
            twist_torque=0.0 if mesh.half else twist_torque(skin, state.contact.force),
            stick_ratio=stick,
            slip_margin=margin,
        )
