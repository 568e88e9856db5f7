# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Cattaneo–Mindlin and Mindlin–Deresiewicz: a sphere pressed on a rough plate and pulled."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from ..fem.equilibrium import SLIP
from ..geometry import Geometry
from ..material import Material
from ..solid3d.full_order import SolidModel
from ..solid3d.mesh import MeshSize, solid_mesh
from .cases import elastic
from .check import Check, Curve, Measure, Panel, largest, percent

RADIUS = 10e-3
MODULUS = 30e3
RATIO = 0.49
FRICTION = 0.5
CONTACT = 0.0025
"""Contact radius over that of the sphere: the half-ball is then nearly a half-space. At 0.01 the
ball as a whole adds some 2.6 % to the tangential displacement, in proportion to the contact."""
CORE = 0.05
"""Radius of the rigid core over that of the sphere."""
BLOCK = 1.3
"""Half the width of the mesh's central block over the contact radius."""


class Theory:
    """Sphere on a rigid plate in small strain, normal and tangential problem uncoupled (SI).

    Hertz; R. D. Mindlin, J. Appl. Mech. 16, 1949; R. D. Mindlin and H. Deresiewicz, J. Appl. Mech.
    20, 1953; K. L. Johnson, Contact Mechanics, 1985, §7.2 and 7.3, in the form of reduced loading:
    J. Jäger, Arch. Appl. Mech. 65, 1995. On a way back friction turns, so that a change of pull
    counts half and moves the plate twice as far.
    """

    normal = MODULUS / (1.0 - RATIO**2)
    tangential = 2.0 * MODULUS / (1.0 + RATIO) / (2.0 - RATIO)
    load = 4.0 / 3.0 * normal * CONTACT**3 * RADIUS**2

    @classmethod
    def radius(cls, force: float) -> float:
        """Contact radius (m) under a normal force (N)."""
        return float(np.cbrt(0.75 * force * RADIUS / cls.normal))

    @classmethod
    def added(cls, force: float, pull: float) -> float:
        """Tangential displacement (m) by a pull (N) added to a contact that sticks throughout."""
        before, after = cls.radius(force), cls.radius(force - pull / FRICTION)
        return FRICTION * cls.normal / cls.tangential * (before**2 - after**2) / RADIUS


def rubber() -> Material:
    """What the half-ball is made of."""
    return elastic(
        MODULUS,
        E2=MODULUS,
        friction=FRICTION,
        poisson_ratio_bulk=RATIO,
        poisson_ratio_epidermis=RATIO,
    )


def half_ball(across: int, half: bool = True) -> SolidModel:
    """Homogeneous half-ball held on its flat side, with a small rigid core.

    across: elements over half the width of the central block, as in `MeshSize`; half: by the
    symmetry of a pull.
    """
    spacing = BLOCK * CONTACT * RADIUS / across
    skin = 4
    growth = 1.8
    room = (1.0 - CORE) * RADIUS - skin * spacing
    layers = math.ceil(math.log1p(room * (growth - 1.0) / (growth * spacing)) / math.log(growth))
    geometry = Geometry(
        pad_semi_axis_radial=RADIUS,
        pad_semi_axis_axial=RADIUS,
        epidermis_thickness=skin * spacing,
        bone_semi_axis_radial=CORE * RADIUS,
        bone_semi_axis_axial=CORE * RADIUS,
        nail_thickness=0.0,
        nail_radius=0.0,
    )
    size = MeshSize(BLOCK * CONTACT / (0.5 * math.pi), across, 1.4, layers, growth, skin)
    mesh = solid_mesh(geometry, None, size, half)
    fixed = mesh.fixed.copy()
    fixed[mesh.nodes[:, 2] > -1e-12] = True
    return SolidModel(geometry, mesh=replace(mesh, fixed=fixed))


class Pull:
    """A half-ball pressed and pulled by given loads."""

    def __init__(self, model: SolidModel) -> None:
        self.stepper = model.start(rubber())
        self.turn()

    def turn(self) -> None:
        """Count slip from here on."""
        self._from = self._places()

    def _places(self) -> np.ndarray:
        """Places (S, 2) of the skin on the plate (m)."""
        state = self.stepper.state
        return state.positions[self.stepper.model.mesh.surface, :2] - state.contact.plate[:2]

    def step(self, force: float, pull: float) -> float:
        """Displacement (m) of the plate under a normal force over `Theory.load` and a tangential
        force over friction × `Theory.load`."""
        load = Theory.load
        time = self.stepper.state.time + 1.0
        return self.stepper.step(time, force * load, (pull * FRICTION * load, 0.0)).shift_x

    def stick_radius(self, share: float) -> float:
        """Radius (m) within which no skin slid since `turn`; NaN where few nodes slide.

        Slip is `share` times the gap beside a frictionless contact of that radius (reduced
        loading): the radius that fits slip^(2/3), nearly a line over distance, of all sliding nodes
        best.
        """
        state = self.stepper.state
        skin = state.positions[self.stepper.model.mesh.surface]
        distance = np.hypot(skin[:, 0] - state.contact.plate[0], skin[:, 1])
        edge = Theory.radius(Theory.load)
        used = (state.contact.status == SLIP) & (distance < 0.97 * edge)
        if used.sum() < 10:
            return math.nan
        slid = np.hypot(*(self._places() - self._from)[used].T) / share

        def misfit(part: float) -> float:
            fitted = gap(distance[used], part * edge)
            return float(np.sum((np.cbrt(slid**2) - np.cbrt(fitted**2)) ** 2))

        return edge * float(minimize_scalar(misfit, bounds=(0.1, 1.0), method="bounded").x)


def gap(distance: np.ndarray, radius: float) -> np.ndarray:
    """Gap (n,) in m between sphere and plate at distances (n,) in m from the middle of a
    frictionless contact of a radius (m), Johnson, eq. 3.42."""
    r = np.maximum(distance, radius)
    sunk = (2.0 * radius**2 - r**2) * np.arcsin(radius / r) + radius * np.sqrt(r**2 - radius**2)
    return (0.5 * r**2 - radius**2 + sunk / math.pi) / RADIUS


def cattaneo_mindlin() -> Check:
    """Pull, way back, way forth, and a changing normal force, against the theory."""
    model = half_ball(8)
    load, limit = Theory.load, FRICTION * Theory.load
    edge, ratio = Theory.radius(load), FRICTION * Theory.normal / Theory.tangential
    whole = Theory.added(load, limit)
    pull = Pull(model)
    pull.step(0.5, 0.0)
    pull.step(1.0, 0.0)
    top = 0.9
    ways = (
        ("pull", 1.0, 0.0, 0.0, (0.3, 0.5, 0.7, 0.9)),
        ("way back", -2.0, top, Theory.added(load, top * limit), (0.6, 0.3, 0.0, -0.3, -0.6, -top)),
        ("way forth", 2.0, -top, -Theory.added(load, top * limit), (-0.5, 0.0, 0.5, top)),
    )
    measures, loops, radii = [], [], []
    for index, (name, sense, begin, origin, pulls) in enumerate(ways):
        share = abs(sense)
        pull.turn()
        found = np.array([(pull.step(1.0, q), pull.stick_radius(share * ratio)) for q in pulls])
        parts = [abs(q - begin) / share for q in pulls]
        exact = np.array([origin + sense * Theory.added(load, part * limit) for part in parts])
        sticks = np.array([Theory.radius(load * (1.0 - part)) for part in parts])
        measures += [
            Measure(
                f"{name}: largest error of displacement over that of gross slip",
                largest(found[:, 0] - exact) / whole * 100.0,
                "%",
                high=2.0,
            ),
            Measure(
                f"{name}: largest error of stick radius over the contact's",
                float(np.nanmax(np.abs(found[:, 1] - sticks))) / edge * 100.0,
                "%",
                high=2.0,
            ),
        ]
        if index == 0:
            error = largest(percent(found[:, 0], exact))
            measures.append(Measure("pull: largest error of displacement", error, "%", high=2.0))
        dense = np.linspace(begin, pulls[-1], 100)
        line = [origin + sense * Theory.added(load, abs(q - begin) / share * limit) for q in dense]
        loops += [
            Curve(np.array(line) / whole, dense, f"C{index}-"),
            Curve(found[:, 0] / whole, pulls, f"C{index}o", name),
        ]
        known = np.isfinite(found[:, 1])
        radii += [
            Curve(np.array(parts), sticks / edge, f"C{index}-"),
            Curve(np.array(parts)[known], found[known, 1] / edge, f"C{index}o"),
        ]
    measures.append(_changing_normal_force(model, whole))
    return Check(
        "solid_mindlin",
        "Third dimension: pulled sphere",
        f"Homogeneous half-ball, R = 10 mm, E = 30 kPa, ν = {RATIO:g}, friction {FRICTION:g}, "
        f"contact radius a = {CONTACT:g} R, so that ball and half-space differ little; spacing of "
        "the nodes 0.16 a. Pulled to 0.9 μP, back to −0.9 μP and forth (Cattaneo 1938, Mindlin "
        "1949; loop: Mindlin and Deresiewicz 1953). Then, from 0.5 μP: the normal force rises by "
        "40 % under the same pull, the pull rises twice, the normal force falls. The stick radius "
        "is that of the Hertzian gap that fits the slip of the sliding nodes, where at least ten "
        "slide. The theory neglects that pressure moves skin sideways, which is exact for ν = 0.5.",
        measures,
        [
            Panel("displacement over that of gross slip", "Q / μP", loops, legend="lines: theory"),
            Panel("change of Q since the turn over its largest", "stick radius / a", radii),
        ],
    )


def _changing_normal_force(model: SolidModel, whole: float) -> Measure:
    """Error of the displacement where the normal force rises and falls under a pull."""
    load, limit = Theory.load, FRICTION * Theory.load
    pull = Pull(model)
    pull.step(1.0, 0.0)
    first = Theory.added(load, 0.5 * limit)
    path = (
        (1.0, 0.5, first),
        (1.4, 0.5, first),  # more pressure, all sticks
        (1.4, 0.7, first + Theory.added(1.4 * load, 0.2 * limit)),  # slips from the new edge
        (1.4, 1.1, Theory.added(1.4 * load, 1.1 * limit)),  # the rise is forgotten
        (1.2, 1.1, Theory.added(1.2 * load, 1.1 * limit)),
    )
    error = [pull.step(force, tangential) - exact for force, tangential, exact in path]
    return Measure(
        "changing normal force: largest error of displacement over that of gross slip",
        largest(np.array(error)) / whole * 100.0,
        "%",
        high=2.0,
    )
