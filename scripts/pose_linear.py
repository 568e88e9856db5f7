# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contacts of elliptical pads on tilted plates by linear elasticity: rough, but within a second.

    python scripts/pose_linear.py TABLE

writes a row for each finger, pose and depth of contact, of fingers all over the population box. A
pose costs some 0.4 s where the three-dimensional model (`scripts/pose_truth.py`) takes 20.
`scripts/pose_correction.py` learns from them how finger and pose act, and from the few of the truth
what large strain adds. A table that is there already is continued, so that a run may be broken off;
`--part 0 2` and `--part 1 2` are two halves for two processes with a table each.

The mesh is that of the truth, strains are small, there is no friction. The finger is condensed onto
the skin near the plate once; contacts of growing indentation are then found in that matrix by
exchanging nodes until none pulls and none penetrates.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import astuple, fields
from pathlib import Path

import numpy as np
from pose_truth import (
    Finger,
    box_fingers,
    center_of_pressure,
    exchanged,
    fill,
    material,
    mesh_of,
    parser_of,
    random_pose,
)
from scipy.linalg import cho_factor, cho_solve, inv

from finger_model.fem.equilibrium import OPEN, SLIP
from finger_model.geometry import Geometry
from finger_model.laws import ConstitutiveLaw
from finger_model.pose.pose import Pose
from finger_model.solid3d import elements
from finger_model.solid3d.condensation import Condensation
from finger_model.solid3d.contact import Contact
from finger_model.solid3d.contact_shape import node_areas, outline
from finger_model.solid3d.material import SolidMaterial
from finger_model.solid3d.mesh import SolidMesh

SEED = 811
DEPTHS = np.linspace(0.2, 0.6, 9)
"""Radius of the contact of the round pad on a level plate over half the pad's width."""
FIRST = 12
"""Nodes inside the first indentation."""
GROWTH = 1.16
"""Of the indentation, from contact to contact."""
REACH = 2.4
"""Area of the skin that may touch, over that of the round pad's deepest contact and aspect."""
EDGE = 0.7
"""Share of that skin up to which a contact is away from its edge."""
EXCHANGES = 80
FAR = 10.0
"""Where skin is held that cannot touch, over half the pad's width."""
FINGERS = 907
KINDS = ("pitch", "roll"), ("pitch", "level", "roll"), ("both", "roll"), ("pitch", "both")
"""Of the poses of fingers in turn."""

COLUMNS = (
    [f.name for f in fields(Finger)]
    + "aspect pitch_deg roll_deg depth log_ratio elongation_x elongation_y".split()
    + "center_x center_y pressure_x pressure_y".split()
)
"""log_ratio: ln of the area over that of the round pad on a level plate under the same force;
elongation: ln(a/b) of the semi-axes times cosine and sine of twice the direction; the two points
over half the pad's width."""


def flexibility(mesh: SolidMesh, kept: np.ndarray, law: ConstitutiveLaw) -> np.ndarray:
    """Displacements (k, k) along the plate's normal of the `kept` nodes (k,) of the unloaded
    finger's surface under unit forces on each of them (m/N)."""
    bricks = elements.reference_bricks(mesh.nodes, mesh.cells)
    solid = SolidMaterial(law, mesh, bricks)
    tangent = np.zeros((len(mesh.cells), elements.UNKNOWNS, elements.UNKNOWNS))
    stiffness = solid.step(1.0, solid.at_rest()).stiffness(mesh.nodes)
    elements.assemble(mesh.nodes, bricks, stiffness, True, np.zeros(mesh.nodes.shape), tangent)
    nodes = mesh.surface[kept]
    whole = Condensation(mesh.cells, mesh.place, mesh.fixed, nodes).factorize(tangent)
    along = np.tile([True, True, False], len(nodes)) & ~mesh.fixed[nodes].ravel()
    normal = np.arange(2, len(whole), 3)
    across = whole[np.ix_(along, normal)]
    factor = cho_factor(whole[np.ix_(along, along)], lower=True)
    return inv(whole[np.ix_(normal, normal)] - across.T @ cho_solve(factor, across))


def contacts(geometry: Geometry, pose: Pose, law: ConstitutiveLaw) -> np.ndarray:
    """Rows (n, 8) of growing contacts: ln of the force (N), ln of the area over the square of half
    the pad's width, then the last six of COLUMNS."""
    mesh, _ = mesh_of(geometry, pose)
    skin = mesh.nodes[mesh.surface]
    gap = skin[:, 2] - skin[:, 2].min()
    areas, width = node_areas(mesh, skin), geometry.pad_semi_axis_radial
    order = np.argsort(gap)
    reach = REACH * pose.aspect * math.pi * (DEPTHS[-1] * width) ** 2 / mesh.copies
    kept = np.sort(order[: np.searchsorted(np.cumsum(areas[order]), reach) + 1])
    flexible, height = flexibility(mesh, kept, law), gap[kept]
    largest = EDGE * float(areas[kept].sum()) * mesh.copies
    indentation, active = float(np.sort(height)[FIRST]), np.zeros(len(kept), dtype=bool)
    rows = []
    while True:
        active |= height < 0.4 * indentation
        for _ in range(EXCHANGES):
            pressed = np.flatnonzero(active)
            force = np.zeros(len(kept))
            own = flexible[np.ix_(pressed, pressed)]
            force[pressed] = np.linalg.solve(own, indentation - height[pressed])
            raised = height + flexible[:, pressed] @ force[pressed]
            now = np.where(active, force > 0.0, raised < indentation * (1.0 - 1e-12))
            if np.array_equal(now, active):
                break
            active = now
        moved = skin.copy()
        moved[:, 2] += FAR * width
        moved[kept, 2] = raised
        status, normal = np.full(len(skin), OPEN), np.zeros((len(skin), 3))
        status[kept[active]], normal[kept, 2] = SLIP, force
        plate = np.array([0.0, 0.0, indentation])
        contact = Contact(status, normal, skin[:, :2], np.zeros((len(skin), 2)), plate)
        found = outline(mesh, moved, contact, areas)
        if found.area > largest:
            return np.array(rows)
        places = found.center / width, center_of_pressure(mesh, contact, moved) / width
        turn = found.orientation
        if exchanged(pose):
            places, turn = tuple(place[::-1] for place in places), 0.5 * math.pi - turn
        ratio = math.log(found.semi_axes[0] / found.semi_axes[1])
        shape = ratio * math.cos(2.0 * turn), ratio * math.sin(2.0 * turn)
        load = math.log(force.sum() * mesh.copies)
        rows.append([load, math.log(found.area / width**2), *shape, *places[0], *places[1]])
        indentation *= GROWTH


def rows_of(finger: Finger, poses: list[Pose]) -> list[list[float]]:
    """Rows of one finger: in each pose, at the DEPTHS that it reaches."""
    geometry, law = finger.geometry, material(finger)
    level = contacts(geometry, Pose(), law)
    wanted = np.log(math.pi * DEPTHS**2)
    load = np.interp(wanted, level[:, 1], level[:, 0], left=math.nan, right=math.nan)
    rows = []
    for pose in poses:
        found = contacts(geometry, pose, law)
        tilt = math.degrees(pose.pitch), math.degrees(pose.roll)
        for depth, f, flat in zip(DEPTHS, load, wanted, strict=True):
            if found[0, 0] <= f <= found[-1, 0]:
                at = np.array([np.interp(f, found[:, 0], column) for column in found[:, 1:].T])
                at[0] -= flat
                rows.append([*astuple(finger), pose.aspect, *tilt, depth, *at])
    return rows


def cases() -> Iterator[tuple[Finger, list[Pose]]]:
    """Fingers with their poses, without end."""
    for finger in box_fingers(SEED, 0):
        rng = np.random.default_rng([SEED, finger.number])
        yield finger, [random_pose(rng, kind) for kind in KINDS[finger.number % len(KINDS)]]


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__.splitlines()[0], str(FINGERS))
    parser.add_argument("table", type=Path)
    arguments = parser.parse_args()
    number = arguments.fingers or FINGERS
    fill(arguments.table, COLUMNS, number, arguments.part, cases(), rows_of)


if __name__ == "__main__":
    main()
