# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Block mesh of the finger from eight-node bricks: a graded surface mesh, swept from bone to skin.

The surface is meshed as a disc (radius: arc length from the tip over that to the rim) of one
central block and four outer ones, so that there is no pole. For a tilted plate the disc is shifted
so that its fine centre lies where the plate touches first. Columns of elements run from the bone to
the skin. All nodes are given in axes of the plate: z is its normal and points into the finger.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..fem.mesh import BULK, EPIDERMIS, NAIL
from ..geometry import Geometry
from ..pose.pose import Pose

NAIL_LAYERS = 2


@dataclass(frozen=True)
class MeshSize:
    """Fineness of the mesh; numbers of elements at refinement 1.

    center: half the width of the central block over the arc from tip to rim; across: elements over
    that half width; growth: of the rings of elements, outwards; bulk: layers of the bulk tissue;
    bulk_growth: of their thickness, from skin to bone; skin: layers of the epidermis.
    """

    center: float = 0.18
    across: int = 8
    growth: float = 1.09
    bulk: int = 7
    bulk_growth: float = 1.22
    skin: int = 3

    def refined(self, refinement: float) -> MeshSize:
        """With the node spacing divided by a factor; the skin keeps three layers, as two would bend
        too easily: an element has one pressure."""
        if refinement == 1.0:
            return self
        return MeshSize(
            self.center,
            max(2, round(self.across * refinement)),
            1.0 + (self.growth - 1.0) / refinement,
            max(2, round(self.bulk * refinement)),
            self.bulk_growth ** (1.0 / refinement),
            max(3, round(self.skin * refinement)),
        )


@dataclass(frozen=True)
class SolidMesh:
    """Mesh of eight-node bricks in axes of the plate.

    nodes (N, 3) in m; cells (E, 8); part (E,): BULK, EPIDERMIS or NAIL; place (E, 2): position of
    the element's column in the disc, by which the mesh is divided; fixed (N, 3): displacement
    components held at zero; surface (S,): skin nodes; disc (S, 2): their positions in the disc;
    faces (Q, 4): indices into `surface` of the skin's quadrilaterals; half: y = 0 is a plane of
    symmetry and forces of the mesh are half those of the finger.
    """

    nodes: np.ndarray
    cells: np.ndarray
    part: np.ndarray
    place: np.ndarray
    fixed: np.ndarray
    surface: np.ndarray
    disc: np.ndarray
    faces: np.ndarray
    half: bool

    @property
    def copies(self) -> int:
        """How many times the mesh stands for the whole finger."""
        return 2 if self.half else 1


def solid_mesh(
    geometry: Geometry,
    pose: Pose | None = None,
    size: MeshSize | None = None,
    half: bool = True,
) -> SolidMesh:
    """Mesh of a finger against a plate; `half` keeps y ≥ 0 where the pose is symmetric."""
    pose = pose or Pose()
    size = size or MeshSize()
    half = half and pose.symmetric
    dense = np.linspace(0.0, 0.5 * math.pi, 4001)
    a, c = geometry.pad_semi_axis_radial, geometry.pad_semi_axis_axial
    speed = np.hypot(a * np.cos(dense), c * np.sin(dense))
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(dense))])
    disc, faces = _disc(size, half)
    tip = _first_touch(geometry, pose)
    shift = np.interp(abs(tip), dense, arc / arc[-1]) * (tip / abs(tip) if tip else 1.0)
    z = disc[:, 0] + 1j * disc[:, 1]
    z = (z + shift) / (1.0 + np.conj(shift) * z)
    radius = np.minimum(np.abs(z), 1.0)
    rim = radius > 1.0 - 1e-9
    angle = np.where(rim, 0.5 * math.pi, np.interp(radius * arc[-1], arc, dense))
    azimuth = np.where(radius > 0, np.angle(z), 0.0)
    disc = np.column_stack([z.real, z.imag])

    bulk, nail_row = _bulk_fractions(geometry, size)
    r, height = _columns(geometry, angle, bulk, size.skin)
    rows = r.shape[1]
    nodes = np.stack([r * np.cos(azimuth)[:, None], r * np.sin(azimuth)[:, None], height], axis=-1)
    if half:
        nodes[disc[:, 1] < 1e-12, :, 1] = 0.0
    nodes = nodes.reshape(-1, 3)
    cells, part, place = [], [], []
    middle = disc[faces].mean(axis=1)
    for layer in range(rows - 1):
        cells.append(np.concatenate([faces * rows + layer, faces * rows + layer + 1], axis=1))
        part.append(np.full(len(faces), BULK if layer < len(bulk) - 1 else EPIDERMIS))
        place.append(middle)
    fixed = np.zeros(nodes.shape, dtype=bool)
    fixed[::rows] = True
    if geometry.nail_thickness > 0 and nail_row > 0:
        edges, owner = _rim_edges(faces, rim)
        nearest = middle[owner]
        outer = np.unique(edges)
        number = np.full(len(disc), -1)
        number[outer] = np.arange(len(outer))
        width = nail_row + 1
        top = nodes.reshape(-1, rows, 3)[outer, :width]
        added = np.repeat(top[:, :, None], NAIL_LAYERS, axis=2)
        added[..., 2] += geometry.nail_thickness * np.arange(1, NAIL_LAYERS + 1) / NAIL_LAYERS
        first = len(nodes)
        levels = np.empty((len(outer), width, 1 + NAIL_LAYERS), dtype=np.int64)
        levels[:, :, 0] = outer[:, None] * rows + np.arange(width)
        levels[:, :, 1:] = first + np.arange(added[..., 0].size).reshape(
            len(outer), width, NAIL_LAYERS
        )
        nodes = np.concatenate([nodes, added.reshape(-1, 3)])
        hold = np.zeros((len(outer), width, NAIL_LAYERS, 3), dtype=bool)
        hold[:, 0] = True  # over the bone
        fixed = np.concatenate([fixed, hold.reshape(-1, 3)])
        for k in range(nail_row):
            for up in range(NAIL_LAYERS):
                # Edge, along the rim, outwards, up; numbered with "up" last.
                block = levels[number[edges]][:, :, k : k + 2, up : up + 2]
                cells.append(block.transpose(0, 3, 1, 2).reshape(len(edges), 8))
                part.append(np.full(len(edges), NAIL))
                place.append(nearest)
    all_cells = np.concatenate(cells)
    surface = np.arange(len(disc)) * rows + rows - 1
    if half:
        fixed[nodes[:, 1] < 1e-12, 1] = True
    nodes[:, 0] *= pose.aspect
    return SolidMesh(
        nodes=nodes @ pose.axes.T,
        cells=_right_handed(nodes, all_cells),
        part=np.concatenate(part),
        place=np.concatenate(place),
        fixed=fixed,
        surface=surface,
        disc=disc,
        faces=faces,
        half=half,
    )


def _first_touch(geometry: Geometry, pose: Pose) -> complex:
    """Eccentric angle from the tip (modulus) and azimuth before stretching by the aspect (phase) of
    the point that the plate touches first."""
    n = -pose.axes[2]
    lateral = complex(
        geometry.pad_semi_axis_radial * pose.aspect * n[0], geometry.pad_semi_axis_radial * n[1]
    )
    if lateral == 0:
        return 0j
    angle = math.atan2(abs(lateral), -geometry.pad_semi_axis_axial * n[2])
    return angle * lateral / abs(lateral)


def _disc(size: MeshSize, half: bool) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 2) of the unit disc, or its half y ≥ 0, and quadrilaterals (q, 4) of nodes."""
    n = 2 * size.across
    even = np.linspace(-1.0, 1.0, n + 1)
    u, v = np.meshgrid(even, even, indexing="ij")
    bulge = 0.5
    center = size.center * np.stack(
        [u * np.sqrt(1 - 0.5 * bulge * v**2), v * np.sqrt(1 - 0.5 * bulge * u**2)], axis=-1
    )
    steps = [size.center / size.across]
    while sum(steps) < 1.0 - size.center:
        steps.append(steps[-1] * size.growth)
    along = np.concatenate([[0.0], np.cumsum(steps)]) / sum(steps)
    inner = center[-1]
    phi = 0.25 * math.pi * even
    outer = np.column_stack([np.cos(phi), np.sin(phi)])
    ring = inner[None] + along[:, None, None] * (outer - inner)[None]
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    blocks = [center]
    for _ in range(4):
        blocks.append(ring)
        ring = ring @ quarter.T
    points = np.concatenate([block.reshape(-1, 2) for block in blocks])
    quads = []
    first = 0
    for block in blocks:
        rows, columns = block.shape[:2]
        grid = first + np.arange(rows * columns).reshape(rows, columns)
        first += grid.size
        corner = grid[:-1, :-1].ravel()
        offsets = np.array([0, columns, 1, columns + 1])
        quads.append(corner[:, None] + offsets)
    faces = np.concatenate(quads)
    if half:
        faces = faces[points[faces, 1].min(axis=1) > -1e-9]
    _, index, inverse = np.unique(
        np.round(points, 9) + 0.0, axis=0, return_index=True, return_inverse=True
    )
    faces = inverse.ravel()[faces]
    used, faces = np.unique(faces, return_inverse=True)
    nodes = points[index][used]
    if half:
        nodes[np.abs(nodes[:, 1]) < 1e-9, 1] = 0.0
    return nodes, faces.reshape(-1, 4)


def _rim_edges(faces: np.ndarray, rim: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges (k, 2) of the faces on the rim, and the faces (k,) that they belong to."""
    edges, owner = [], []
    for edge in ((0, 1), (2, 3), (0, 2), (1, 3)):
        nodes = faces[:, edge]
        on_rim = np.flatnonzero(rim[nodes].all(axis=1))
        edges.append(nodes[on_rim])
        owner.append(on_rim)
    return np.concatenate(edges), np.concatenate(owner)


def _bulk_fractions(geometry: Geometry, size: MeshSize) -> tuple[np.ndarray, int]:
    """Fractions (b + 1,) of the nodes from bone (0) to epidermis (1), and the row of the nail's
    edge (0 without a nail)."""
    thickness = size.bulk_growth ** np.arange(size.bulk)[::-1]
    even = np.concatenate([[0.0], np.cumsum(thickness)]) / thickness.sum()
    return even, _nail_row(geometry, even)


def _columns(
    geometry: Geometry, angle: np.ndarray, bulk: np.ndarray, skin: int
) -> tuple[np.ndarray, np.ndarray]:
    """Radius and height (S, rows) of the nodes from bone to skin at eccentric angles (S,)."""
    top = angle > 0.5 * math.pi * (1 - 1e-12)
    sine, cosine = np.sin(angle), np.where(top, 0.0, np.cos(angle))
    inner_a, inner_c = geometry.bulk_semi_axes
    fraction = angle / (0.5 * math.pi)
    bone = np.column_stack(geometry.bone_profile(fraction))
    bone[top, 1] = 0.0
    inner = np.column_stack([inner_a * sine, -inner_c * cosine])
    outer = np.column_stack(
        [geometry.pad_semi_axis_radial * sine, -geometry.pad_semi_axis_axial * cosine]
    )
    # The nail's edge lies on a row of nodes: the rows shift towards the top.
    shifted = bulk
    row = _nail_row(geometry, bulk)
    if row:
        edge = float(geometry.bone_profile(np.array([1.0]))[0][0])
        target = (geometry.nail_reach - edge) / (inner_a - edge)
        shifted = np.interp(bulk, [0.0, bulk[row], 1.0], [0.0, target, 1.0])
    weight = np.maximum(0.0, 1.0 - (0.5 * math.pi - angle) / 0.6)
    rows = bulk + weight[:, None] * (shifted - bulk)
    points = bone[:, None] + rows[:, :, None] * (inner - bone)[:, None]
    if geometry.epidermis_thickness > 0:
        part = np.arange(1, skin + 1) / skin
        points = np.concatenate(
            [points, inner[:, None] + part[:, None] * (outer - inner)[:, None]], axis=1
        )
    return points[..., 0], points[..., 1]


def _nail_row(geometry: Geometry, bulk: np.ndarray) -> int:
    """Row of nodes at the nail's edge, 0 without a nail."""
    bone = float(geometry.bone_profile(np.array([1.0]))[0][0])
    if geometry.nail_thickness <= 0 or geometry.nail_reach <= bone * (1 + 1e-9):
        return 0
    edge = (geometry.nail_reach - bone) / (geometry.bulk_semi_axes[0] - bone)
    return int(np.argmin(np.abs(bulk[1:-1] - edge)) + 1)


def _right_handed(nodes: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Cells (E, 8) of positive volume: their first axis is turned round where it is not."""
    corner = nodes[cells]
    edges = [
        corner[:, far].mean(axis=1) - corner[:, near].mean(axis=1)
        for far, near in (
            ([1, 3, 5, 7], [0, 2, 4, 6]),
            ([2, 3, 6, 7], [0, 1, 4, 5]),
            ([4, 5, 6, 7], [0, 1, 2, 3]),
        )
    ]
    volume = np.einsum("ei,ei->e", np.cross(edges[0], edges[1]), edges[2])
    turned = np.array([1, 0, 3, 2, 5, 4, 7, 6])
    return np.where((volume < 0)[:, None], cells[:, turned], cells)
