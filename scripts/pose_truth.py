# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contacts of elliptical pads on tilted plates, by the three-dimensional model.

    python scripts/pose_truth.py learn src/finger_model/finger_model/data/pose_truth.csv
    python scripts/pose_truth.py test src/finger_model/finger_model/data/pose_held_out.csv

writes a row for each finger, pose and force. `learn` gives the fingers that `finger_model.pose` is
fitted to: the default one in six poses, then such as lie all over the population box, the last ones
mostly in poses that touch far aside first; `test` those kept aside. Fingers that the file has
already are kept, so that a run may be broken off and taken up again; `--part 0 2` and `--part 1 2`
are two halves for two processes with a table each. A pose takes some 20 s of a core, one that is
tilted about both axes four times as long.

Areas are those of the three-dimensional model over a smooth curve through its areas of the round
pad on a level plate, times those of the axisymmetric model: what the mesh does to both cancels.

A pad that is tilted about its long axis alone is solved as half a finger too: with x and y
exchanged. One of a finger's poses is tilted in any direction and solved whole.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
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
from finger_model.pose.touch import first_touch
from finger_model.reduced.population import BOX
from finger_model.solid3d.contact import Contact
from finger_model.solid3d.full_order import SolidModel
from finger_model.solid3d.mesh import MeshSize, SolidMesh, solid_mesh
from finger_model.verification.cases import elastic

LOADS = np.geomspace(0.045, 1.6, 12)
"""Force over the modulus of the tissue and the square of half the pad's width."""
SIZE = MeshSize(center=0.18, across=6, growth=1.11, bulk=5, bulk_growth=1.3)
SEEDS = {"learn": 18, "test": 81}
KINDS = ("pitch", "roll", "level", "both")
"""Of the poses of a finger."""
ASIDE = 0.4
"""How far aside at least a steep pose touches first (see `finger_model.pose.touch`)."""
FIRST_STEEP = 156
"""Number of the finger from which on those to learn from have steep poses."""
FINGERS = {"learn": 188, "test": 24}
"""In whole tables; the shipped one to learn from has 175 of them."""
MODULUS = 30e3
"""Pa; only ratios count."""
FRICTION = (-0.3, 0.6)
"""Coefficients of friction: none where it is negative."""


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
    orientation of the larger one from x (rad), centre and centre of pressure (m)."""

    area: np.ndarray
    axes: np.ndarray
    orientation: np.ndarray
    center: np.ndarray
    pressure: np.ndarray


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
    first = 1 if which == "learn" else 2
    for finger in box_fingers(SEEDS[which], first):
        number = finger.number
        # Poses of their own random numbers: blocks of one sequence would give every finger alike
        # ones.
        rng = np.random.default_rng([SEEDS[which], number])
        if which == "test":
            kinds = KINDS[number % 4], KINDS[(number + 1) % 4]
        elif number < FIRST_STEEP:
            kinds = KINDS if number % 3 == 0 else KINDS[:3]
        else:
            yield finger, steep_poses(rng, finger)
            continue
        yield finger, [random_pose(rng, kind) for kind in kinds]


def steep_poses(rng: np.random.Generator, finger: Finger) -> list[Pose]:
    """Two poses that touch far aside first, every fourth finger's first one tilted in any
    direction, and one of any kind that is solved as half a finger."""
    poses = []
    for kind in ("pitch" if finger.number % 4 else "both", "pitch"):
        tries = (random_pose(rng, kind) for _ in itertools.count())
        aside = ((float(np.hypot(*first_touch(finger.geometry, p).aside)), p) for p in tries)
        poses.append(next(pose for far, pose in aside if far > ASIDE))
    return [*poses, random_pose(rng, KINDS[finger.number % 3])]


def box_fingers(seed: int, first: int) -> Iterator[Finger]:
    """Fingers of the population box without end, numbered from `first`."""
    names = "pad_semi_axis_radial aspect bone_radial bone_axial nail_radius epidermis_thickness"
    ranges = [(BOX[name].low, BOX[name].high) for name in names.split()]
    ranges[-1] = (math.log(ranges[-1][0]), math.log(ranges[-1][1]))
    ranges += [(math.log(SKIN_RATIOS[0]), math.log(SKIN_RATIOS[1])), FRICTION]
    low, high = np.transpose(ranges)
    of_finger = qmc.Sobol(len(ranges), seed=seed)
    for number in itertools.count(first):
        row = qmc.scale(of_finger.random(1), low, high)[0].tolist()
        width, height, bone_width, bone_height, nail, skin, skin_ratio, friction = row
        height *= width
        bone = bone_width * width, bone_height * height
        rest = nail * width, math.exp(skin_ratio), max(friction, 0.0)
        yield Finger(number, width, height, math.exp(skin), *bone, *rest)


def material(finger: Finger) -> StandardLinearSolid:
    """Elastic tissue under an elastic skin."""
    return elastic(MODULUS, E2=finger.skin_ratio * MODULUS, friction=finger.friction)


def forces(finger: Finger) -> np.ndarray:
    """N."""
    return LOADS * MODULUS * finger.width**2


def mesh_of(geometry: Geometry, pose: Pose) -> tuple[SolidMesh, Pose]:
    """Mesh of a pose, and the pose it was made for.

    A roll alone is a pitch of the finger with x and y exchanged, whose pad is long along y: half a
    finger is then enough. The pose returned tells so.
    """
    if not exchanged(pose):
        return solid_mesh(geometry, pose, SIZE), pose
    run = Pose(1.0, pose.roll)
    mesh = solid_mesh(geometry, run, SIZE)
    return replace(mesh, nodes=mesh.nodes * [1.0, pose.aspect, 1.0]), run


def exchanged(pose: Pose) -> bool:
    """Whether x and y are exchanged in the mesh of a pose."""
    return pose.pitch == 0.0 and pose.roll != 0.0


def press(finger: Finger, pose: Pose) -> Press:
    """One finger pressed onto one plate."""
    mesh, run = mesh_of(finger.geometry, pose)
    stepper = SolidModel(finger.geometry, run, mesh=mesh).start(material(finger))
    points, pressures = [], []
    for k, force in enumerate(forces(finger).tolist(), 1):
        try:
            points.append(stepper.step(float(k), force))
        except ModelError:
            break
        contact, skin = stepper.state.contact, stepper.state.positions[mesh.surface]
        pressures.append(center_of_pressure(mesh, contact, skin))
    area, a, b, angle, x, y = (
        np.array([getattr(point, name) for point in points])
        for name in "area semi_axis_a semi_axis_b orientation center_x center_y".split()
    )
    axes, center = np.column_stack([a, b]), np.column_stack([x, y])
    pressed = np.array(pressures).reshape(-1, 2)
    if exchanged(pose):
        angle, center, pressed = 0.5 * math.pi - angle, center[:, ::-1], pressed[:, ::-1]
    return Press(area, axes, angle, center, pressed)


def center_of_pressure(mesh: SolidMesh, contact: Contact, skin: np.ndarray) -> np.ndarray:
    """Point (2,) in m of the plate about which the normal forces on the skin (S, 3) have no
    torque."""
    force = np.where(contact.status != OPEN, contact.force[:, 2], 0.0)
    center = force @ skin[:, :2] / force.sum()
    if mesh.half:
        center[1] = 0.0
    return center


def rows_of(finger: Finger, poses: list[Pose]) -> list[list[float]]:
    """Rows of one finger."""
    stepper = FullOrderModel(finger.geometry).start(material(finger))
    areas: list[float] = []
    with suppress(ModelError):
        for k, force in enumerate(forces(finger).tolist(), 1):
            areas.append(stepper.step(float(k), force).area)
    level = press(finger, Pose()).area
    count = min(len(level), len(areas))
    if count < 3:
        return []
    flat = np.array(areas[:count])
    depth = np.sqrt(flat)
    larger = np.polyval(np.polyfit(depth, np.log(level[:count] / flat), 1, w=depth), depth)
    print(finger, flush=True)
    rows = []
    for pose in poses:
        found = press(finger, pose)
        turned = [math.degrees(pose.pitch), math.degrees(pose.roll)]
        for k in range(min(len(found.area), count)):
            scale = math.exp(-larger[k])
            outline = [flat[k], scale * found.area[k], *(math.sqrt(scale) * found.axes[k])]
            way = math.degrees(found.orientation[k]) % 180.0
            places = [way, *found.center[k], *found.pressure[k]]
            rows.append(
                [*astuple(finger), pose.aspect, *turned, forces(finger)[k], *outline, *places]
            )
    return rows


def parser_of(description: str, fingers: str) -> argparse.ArgumentParser:
    """Options of a script that fills a table; fingers: how many there are by default."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--fingers", type=int, help=f"(default: {fingers})")
    parser.add_argument(
        "--part",
        type=int,
        nargs=2,
        default=(0, 1),
        metavar=("K", "N"),
        help="only fingers whose number divided by N leaves K",
    )
    return parser


def fill(
    table: Path,
    columns: Sequence[str],
    number: int,
    part: tuple[int, int],
    cases: Iterable[tuple[Finger, list[Pose]]],
    rows: Callable[[Finger, list[Pose]], list[list[float]]],
) -> None:
    """Add the rows of the fingers below `number` of a part that the table has not yet."""
    done = set()
    if table.exists():
        with table.open() as file:
            done = {int(row["number"]) for row in csv.DictReader(file)}
    else:
        table.write_text(",".join(columns) + "\n")
    rest, parts = part
    for finger, poses in cases:
        if finger.number >= number:
            break
        if finger.number in done or finger.number % parts != rest:
            continue
        found = rows(finger, poses)
        with table.open("a", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerows([[f"{value:.5g}" for value in row] for row in found])


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__.splitlines()[0], "those of the shipped table")
    parser.add_argument("which", choices=sorted(SEEDS))
    parser.add_argument("table", type=Path)
    arguments = parser.parse_args()
    which = arguments.which
    number = arguments.fingers or FINGERS[which]
    fill(arguments.table, COLUMNS, number, arguments.part, fingers(which), rows_of)


if __name__ == "__main__":
    main()
