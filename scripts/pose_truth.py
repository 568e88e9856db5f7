# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contacts of elliptical pads on tilted plates, by the three-dimensional model.

    python scripts/pose_truth.py learn src/finger_model/finger_model/data/pose_truth.csv
    python scripts/pose_truth.py test src/finger_model/finger_model/data/pose_held_out.csv

writes a row for each finger, pose and force. `learn` gives the fingers that `finger_model.pose` is
fitted to: the default one in six poses, then such as lie all over the population box; `test` those
kept aside, on a finer mesh. Fingers that the file has already are kept, so that a run may be broken
off and taken up again; `--part 0 2` and `--part 1 2` are two halves for two processes with a table
each. One pose takes 2 to 5 s of a core, one that is tilted about both axes three times as long.

The area is that inside the line where the skin touches just then: each skin node touches at some
force, known between two steps from how its gap closes, and between nodes that force is
interpolated. A node touches a part of the node spacing ahead of the true edge. How much it is, is
seen on the round pad on a level plate, whose area the axisymmetric model knows; the outlines of the
other poses are drawn in by as much.

A pad that is tilted about its long axis alone is solved as half a finger too: with x and y
exchanged. One of a finger's poses is tilted in any direction and solved whole.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import qmc

from finger_common.errors import ModelError
from finger_model.fem.equilibrium import OPEN
from finger_model.fem.full_order import FullOrderModel
from finger_model.geometry import Geometry
from finger_model.laws import StandardLinearSolid
from finger_model.pose.correction import SKIN_RATIOS
from finger_model.pose.pose import Pose
from finger_model.reduced.population import BOX
from finger_model.solid3d.contact_shape import node_areas
from finger_model.solid3d.full_order import SolidModel, SolidStepper
from finger_model.solid3d.mesh import MeshSize, SolidMesh, solid_mesh
from finger_model.verification.cases import elastic

LOADS = np.geomspace(0.03, 1.9, 14)
"""Force over the modulus of the tissue and the square of half the pad's width."""
WRITTEN = (3, 5, 7, 9, 11, 12)
"""Of LOADS."""
SIZES = {
    "learn": MeshSize(center=0.2, across=4, growth=1.12, bulk=3, bulk_growth=1.3, skin=3),
    "test": MeshSize(center=0.2, across=5, growth=1.09, bulk=4, bulk_growth=1.25, skin=3),
}
SEEDS = {"learn": 18, "test": 81}
KINDS = ("pitch", "roll", "level", "both")
"""Of the poses of a finger."""
FINGERS = {"learn": 156, "test": 24}
"""In the shipped tables."""
MODULUS = 30e3
"""Pa; only ratios count."""
FRICTION = (-0.3, 0.6)
"""Coefficients of friction: none where it is negative."""
SAMPLES = 12
"""Across a face, of the force at which the skin touches."""


@dataclass(frozen=True)
class Finger:
    """Proportions: lengths in m, ratio of the moduli, coefficient of friction."""

    number: int
    width: float
    height: float
    skin: float
    bone_width: float
    bone_height: float
    nail: float
    skin_ratio: float
    friction: float

    @property
    def geometry(self) -> Geometry:
        """Lengths of the model."""
        bone = self.bone_width, self.bone_height
        return Geometry(self.width, self.height, self.skin, *bone, 0.0, self.nail)


class Press(NamedTuple):
    """Contacts (n,) at LOADS that have an equilibrium: area (m²), larger and smaller semi-axis (m),
    orientation of the larger one from x (rad), centre and centre of pressure (m), node spacing at
    the edge (m)."""

    area: np.ndarray
    axes: np.ndarray
    orientation: np.ndarray
    center: np.ndarray
    pressure: np.ndarray
    spacing: np.ndarray


COLUMNS = (
    [f.name for f in fields(Finger)]
    + "aspect pitch_deg roll_deg force_n round_area_m2 area_m2 axis_a_m axis_b_m".split()
    + "orientation_deg center_x_m center_y_m pressure_x_m pressure_y_m".split()
)


def default_finger(number: int, skin_ratio: float) -> Finger:
    """The default finger without friction."""
    g = Geometry()
    pad = g.pad_semi_axis_radial, g.pad_semi_axis_axial, g.epidermis_thickness
    bone = g.bone_semi_axis_radial, g.bone_semi_axis_axial
    return Finger(number, *pad, *bone, g.nail_radius, skin_ratio, 0.0)


def pose_of(aspect: float, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> Pose:
    """Pose with tilts in degrees."""
    return Pose(aspect, math.radians(pitch_deg), math.radians(roll_deg))


def random_pose(rng: np.random.Generator, kind: str) -> Pose:
    """Aspect and tilt of this kind; steep tilts are as frequent as flat ones, by solid angle."""
    aspect, tilt = rng.uniform(1.0, 1.6), 30.0 * math.sqrt(rng.random())
    way = rng.uniform(0.0, 0.5 * math.pi)
    if kind == "level":
        return pose_of(aspect)
    if kind == "pitch":
        return pose_of(aspect, tilt)
    if kind == "roll":
        return pose_of(aspect, 0.0, tilt)
    return pose_of(aspect, tilt * math.cos(way), tilt * math.sin(way))


def fingers(which: str) -> Iterator[tuple[Finger, list[Pose]]]:
    """Fingers of the population box with their poses, without end."""
    if which == "learn":
        level = [pose_of(1.6), pose_of(1.25, 0.0, 15.0), pose_of(1.6, 0.0, 30.0)]
        yield default_finger(0, 60.0), [*level, *(pose_of(r, 30.0) for r in (1.0, 1.25, 1.6))]
    else:
        yield default_finger(0, 60.0), [pose_of(1.4, 22.0), pose_of(1.15, 0.0, 26.0)]
        yield default_finger(1, 22.0), [pose_of(1.3, 20.0)]
    names = "pad_semi_axis_radial aspect bone_radial bone_axial nail_radius epidermis_thickness"
    ranges = [(BOX[name].low, BOX[name].high) for name in names.split()]
    ranges[-1] = (math.log(ranges[-1][0]), math.log(ranges[-1][1]))
    ranges += [(math.log(SKIN_RATIOS[0]), math.log(SKIN_RATIOS[1])), FRICTION]
    low, high = np.transpose(ranges)
    of_finger = qmc.Sobol(len(ranges), seed=SEEDS[which])
    for number in range(1 if which == "learn" else 2, 10**6):
        row = qmc.scale(of_finger.random(1), low, high)[0].tolist()
        width, height, bone_width, bone_height, nail, skin, skin_ratio, friction = row
        height *= width
        bone = bone_width * width, bone_height * height
        rest = nail * width, math.exp(skin_ratio), max(friction, 0.0)
        finger = Finger(number, width, height, math.exp(skin), *bone, *rest)
        # Poses of their own random numbers: blocks of one sequence would give every finger alike
        # ones.
        rng = np.random.default_rng([SEEDS[which], number])
        kinds = KINDS if which == "learn" else (KINDS[number % 4], KINDS[(number + 1) % 4])
        poses = [random_pose(rng, kind) for kind in kinds]
        yield finger, poses


def material(finger: Finger) -> StandardLinearSolid:
    """Elastic tissue under an elastic skin."""
    return elastic(MODULUS, E2=finger.skin_ratio * MODULUS, friction=finger.friction)


def forces(finger: Finger) -> np.ndarray:
    """N."""
    return LOADS * MODULUS * finger.width**2


def press(finger: Finger, pose: Pose, size: MeshSize) -> Press:
    """One finger pressed onto one plate."""
    geometry = finger.geometry
    swapped = pose.pitch == 0.0 and pose.roll != 0.0
    if swapped:
        # x and y exchanged: the roll is a pitch, and the pad is long along y.
        run = Pose(1.0, pose.roll)
        mesh = solid_mesh(geometry, run, size)
        mesh = replace(mesh, nodes=mesh.nodes * [1.0, pose.aspect, 1.0])
        model = SolidModel(geometry, run, mesh=mesh)
    else:
        model = SolidModel(geometry, pose, size=size)
    stepper = model.start(material(finger))
    skins, gaps, pressures, spacings = [], [], [], []
    for k, force in enumerate(forces(finger).tolist(), 1):
        try:
            stepper.step(float(k), force)
        except ModelError:
            break
        contact, mesh = stepper.state.contact, model.mesh
        skin = stepper.state.positions[mesh.surface]
        open_ = contact.status == OPEN
        skins.append(skin[:, :2])
        gaps.append(np.where(open_, np.maximum(skin[:, 2] - contact.plate[2], 1e-12), 0.0))
        pressures.append(center_of_pressure(stepper))
        crossed = ~open_[mesh.faces].all(axis=1) & open_[mesh.faces].any(axis=1)
        edge = np.unique(mesh.faces[crossed])
        on_plane = mesh.half & (np.abs(mesh.disc[:, 1]) < 1e-12)
        share = node_areas(mesh, skin) * np.where(on_plane, 2.0, 1.0)
        spacings.append(float(np.sqrt(share[edge]).mean()))
    count = len(skins)
    if count < 3:
        none = np.zeros((0, 2))
        return Press(none[:, 0], none, none[:, 0], none, none, none[:, 0])
    root = np.cbrt(LOADS[:count])
    touch, place = touching(np.array(skins), np.array(gaps), root)
    shapes = [inside(model.mesh, place, touch, limit) for limit in root]
    area, axes, angle, center = (np.array(v) for v in zip(*shapes, strict=True))
    pressed = np.array(pressures)
    if swapped:
        angle, center, pressed = 0.5 * math.pi - angle, center[:, ::-1], pressed[:, ::-1]
    return Press(area, axes, angle, center, pressed, np.array(spacings))


def touching(
    skins: np.ndarray, gaps: np.ndarray, root: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cubic root of the load (S,) at which each node touches, and its place (S, 2) then.

    skins (n, S, 2) and gaps (n, S) at loads whose cubic roots are root (n,): the contact's radius
    grows nearly linearly with it, and beside the edge the gap with the distance to the power 3/2.
    """
    distance = gaps ** (2.0 / 3.0)
    touch, place = np.empty(skins.shape[1]), skins[-1].copy()
    for node, g in enumerate(distance.T):
        closed = np.flatnonzero(g == 0.0)
        k = int(closed[0]) if len(closed) else len(root)
        if k < 2:
            touch[node] = (0.6, 0.97)[k] * root[k]
            place[node] = skins[0, node]
            continue
        slope = (g[k - 1] - g[k - 2]) / (root[k - 1] - root[k - 2])
        found = root[k - 1] - g[k - 1] / slope if slope < 0.0 else math.inf
        latest = root[k] if k < len(root) else 3.0 * root[-1]
        touch[node] = min(max(found, root[k - 1]), latest)
        if k < len(root):
            part = (touch[node] - root[k - 1]) / (root[k] - root[k - 1])
            place[node] = (1.0 - part) * skins[k - 1, node] + part * skins[k, node]
    return touch, place


def inside(
    mesh: SolidMesh, place: np.ndarray, touch: np.ndarray, limit: float
) -> tuple[float, np.ndarray, float, np.ndarray]:
    """Area (m²) where the skin touches before `limit`, its semi-axes, the larger first, direction
    of that from x (rad), and centre."""
    even = (np.arange(SAMPLES) + 0.5) / SAMPLES
    u, v = (grid.ravel() for grid in np.meshgrid(even, even))
    shape = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
    along = np.stack([v - 1, 1 - v, -v, v])
    across = np.stack([u - 1, -u, 1 - u, u])
    corners = place[mesh.faces]
    points, du, dv = (np.einsum("nq,fnd->fqd", n, corners) for n in (shape, along, across))
    weight = np.abs(du[..., 0] * dv[..., 1] - du[..., 1] * dv[..., 0]) / len(u)
    weight = weight * (touch[mesh.faces] @ shape <= limit)
    area = weight.sum()
    center = np.einsum("fq,fqd->d", weight, points) / area
    if mesh.half:
        center[1] = 0.0
    away = points - center
    square = np.einsum("fq,fqc,fqd->cd", weight, away, away) / area
    if mesh.half:
        square[0, 1] = square[1, 0] = 0.0
    values, vectors = np.linalg.eigh(square)
    # Uniform ellipse: its semi-axis is twice the standard deviation.
    angle = math.atan2(vectors[1, 1], vectors[0, 1])
    return float(area) * mesh.copies, 2.0 * np.sqrt(values[::-1]), angle, center


def center_of_pressure(stepper: SolidStepper) -> np.ndarray:
    """Point (2,) in m of the plate about which the normal forces have no torque."""
    contact, mesh = stepper.state.contact, stepper.model.mesh
    skin = stepper.state.positions[mesh.surface]
    force = np.where(contact.status != OPEN, contact.force[:, 2], 0.0)
    center = force @ skin[:, :2] / force.sum()
    if mesh.half:
        center[1] = 0.0
    return center


def rows_of(finger: Finger, poses: list[Pose], size: MeshSize) -> list[list[float]]:
    """Rows of one finger."""
    stepper = FullOrderModel(finger.geometry).start(material(finger))
    areas: list[float] = []
    with suppress(ModelError):
        for k, force in enumerate(forces(finger).tolist(), 1):
            areas.append(stepper.step(float(k), force).area)
    flat = np.array(areas)
    level = press(finger, Pose(), size)
    count = min(len(flat), len(level.area))
    ahead = np.sqrt(level.area[:count] / math.pi) - np.sqrt(flat[:count] / math.pi)
    ahead /= level.spacing[:count]
    print(finger, "ahead", ahead.round(2), flush=True)
    rows = []
    for pose in poses:
        found = press(finger, pose, size)
        turned = [math.degrees(pose.pitch), math.degrees(pose.roll)]
        for k in WRITTEN:
            if k >= min(len(found.area), len(ahead)):
                break
            axes = found.axes[k] - ahead[k] * found.spacing[k]
            area = found.area[k] * axes.prod() / found.axes[k].prod()
            where = [*turned, forces(finger)[k], flat[k], area, *axes]
            way = math.degrees(found.orientation[k]) % 180.0
            places = [way, *found.center[k], *found.pressure[k]]
            rows.append([*astuple(finger), pose.aspect, *where, *places])
    return rows


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("which", choices=sorted(SIZES))
    parser.add_argument("table", type=Path)
    parser.add_argument("--fingers", type=int, help="(default: those of the shipped table)")
    parser.add_argument(
        "--part",
        type=int,
        nargs=2,
        default=(0, 1),
        metavar=("K", "N"),
        help="only fingers whose number divided by N leaves K",
    )
    arguments = parser.parse_args()
    done = set()
    if arguments.table.exists():
        with arguments.table.open() as file:
            done = {int(row["number"]) for row in csv.DictReader(file)}
    else:
        arguments.table.write_text(",".join(COLUMNS) + "\n")
    for finger, poses in fingers(arguments.which):
        if finger.number >= (arguments.fingers or FINGERS[arguments.which]):
            break
        part, parts = arguments.part
        if finger.number in done or finger.number % parts != part:
            continue
        rows = rows_of(finger, poses, SIZES[arguments.which])
        with arguments.table.open("a", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerows([[f"{value:.5g}" for value in row] for row in rows])


if __name__ == "__main__":
    main()
