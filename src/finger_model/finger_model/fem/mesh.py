# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Structured quadrilateral mesh of the finger's half-section, graded towards the contact.

Columns of nodes run from the bone to the skin; they are numbered from the top down to the axis, the
nail first, so that the stiffness matrix has a narrow band and the contact lies at its end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from finger_common.errors import InputError

from ..geometry import Geometry

BULK, EPIDERMIS, NAIL = 0, 1, 2

CONTACT_SPACING = 0.02
"""Node spacing in the contact over the pad's radial semi-axis at refinement 1 (0.17 mm)."""
SKIN_SPACING = 1.0 / 3.0
"""Largest node spacing in the contact over the epidermis thickness; not below CONTACT_SPACING/2."""
BULK_LAYERS = 13
SKIN_LAYER = 0.72
"""Thickness of a layer of skin elements over the node spacing in the contact."""
NAIL_LAYERS = 3

SIMILAR_CONTACT, SIMILAR_BEYOND, SIMILAR_BULK, SIMILAR_SKIN = 18, 8, 6, 3
"""Elements of `similar_mesh` along the skin, in the contact and beyond it, and across."""
SIMILAR_GROWTH = 1.05
"""Growth of its elements in the contact, from the axis outwards."""
SIMILAR_NAIL = 4
"""Its node at the nail's edge, counted from the bone."""


@dataclass(frozen=True)
class Mesh:
    """Axisymmetric mesh of four-node quadrilaterals.

    nodes (N, 2): r, z in m; cells (E, 4): node numbers, anticlockwise; part (E,): BULK, EPIDERMIS
    or NAIL; fixed (N, 2): displacement components held at zero; surface (S,): skin nodes from the
    axis outwards.
    """

    nodes: np.ndarray
    cells: np.ndarray
    part: np.ndarray
    fixed: np.ndarray
    surface: np.ndarray

    @property
    def half_bandwidth(self) -> int:
        """Largest distance from the diagonal of a coupled unknown."""
        spread = self.cells.max(axis=1) - self.cells.min(axis=1)
        return int(2 * spread.max() + 1)


def finger_mesh(geometry: Geometry, refinement: float = 1.0) -> Mesh:
    """Mesh of a geometry; `refinement` divides the node spacing everywhere (1 is the default mesh).

    Raises InputError for a refinement outside 0.25 … 8.
    """
    if not 0.25 <= refinement <= 8:
        raise InputError(f"refinement is {refinement:g}, outside 0.25 … 8; 1 is the default mesh")
    # A thin stiff skin bends: elements longer than a third of its thickness would be too stiff for
    # that.
    even = CONTACT_SPACING * geometry.pad_semi_axis_radial
    spacing = min(max(SKIN_SPACING * geometry.epidermis_thickness, 0.5 * even), even) / refinement
    angles = _surface_angles(geometry, spacing)
    layers = max(3, round(geometry.epidermis_thickness / (SKIN_LAYER * spacing)))
    bulk = _bulk_fractions(max(4, round(BULK_LAYERS * refinement)))
    columns = _columns(geometry, angles, bulk, layers)
    return _assemble(geometry, columns, len(bulk) - 1, max(1, round(NAIL_LAYERS * refinement)))


def similar_mesh(geometry: Geometry) -> Mesh:
    """Coarse mesh whose numbers of nodes are the same for every geometry (SIMILAR_…).

    Each node moves smoothly when a length changes, so that results are smooth functions of the
    lengths, and the values of a field at the same node of two fingers belong together. The default
    mesh rounds numbers of layers and nodes, which scatters the area by some tenths of a percent
    from finger to finger. The nail must end between bone and epidermis.
    """
    dense, arc = _arc(geometry)
    even = np.interp(0.62 * geometry.pad_semi_axis_radial, _radii(geometry, dense), arc)
    contact = SIMILAR_GROWTH ** np.arange(SIMILAR_CONTACT)
    contact *= even / contact.sum()

    def beyond(growth: float) -> np.ndarray:
        return contact[-1] * growth ** np.arange(1, SIMILAR_BEYOND + 1)

    from scipy.optimize import brentq  # a fifth of a second

    growth = brentq(lambda g: beyond(g).sum() - (arc[-1] - even), 0.5, 3.0)
    positions = np.concatenate([[0.0], np.cumsum(np.concatenate([contact, beyond(growth)]))])
    angles = np.interp(positions / positions[-1] * arc[-1], arc, dense)
    bulk = _bulk_fractions(SIMILAR_BULK)
    columns = _columns(geometry, angles, bulk, SIMILAR_SKIN, SIMILAR_NAIL)
    return _assemble(geometry, columns, SIMILAR_BULK, 1)


def _radii(geometry: Geometry, angles: np.ndarray) -> np.ndarray:
    return geometry.pad_semi_axis_radial * np.sin(angles)


def _arc(geometry: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Eccentric angles (n,) from the axis to the top and the skin's arc length (n,) to them."""
    dense = np.linspace(0.0, 0.5 * math.pi, 4001)
    a, b = geometry.pad_semi_axis_radial, geometry.pad_semi_axis_axial
    speed = np.hypot(a * np.cos(dense), b * np.sin(dense))
    return dense, np.concatenate(
        [[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(dense))]
    )


def _surface_angles(geometry: Geometry, spacing: float) -> np.ndarray:
    """Eccentric angles (n,) of the skin nodes from the axis to the top.

    The spacing is even where a contact can be expected and grows by 12 % a node beyond.
    """
    a = geometry.pad_semi_axis_radial
    dense, arc = _arc(geometry)
    even = np.interp(0.62 * a, _radii(geometry, dense), arc)
    steps = [spacing] * math.ceil(even / spacing)
    growth = 1.0 + 0.12 * spacing / (CONTACT_SPACING * a)
    while sum(steps) < arc[-1]:
        steps.append(steps[-1] * growth)
    positions = np.concatenate([[0.0], np.cumsum(steps)])
    positions *= arc[-1] / positions[-1]
    return np.interp(positions, arc, dense)


def _bulk_fractions(layers: int) -> np.ndarray:
    """Fractions (layers+1,) from 0 (bone) to 1 (epidermis), somewhat closer at both ends."""
    even = np.linspace(0.0, 1.0, layers + 1)
    return even - 0.3 * np.sin(2.0 * math.pi * even) / (2.0 * math.pi)


def _columns(
    geometry: Geometry, angles: np.ndarray, bulk: np.ndarray, layers: int, nail: int | None = None
) -> np.ndarray:
    """Nodes (n, m, 2) of columns from bone to skin at rising eccentric angles (n,) up to the top,
    the top's first; that one has the nail's edge, at its node number `nail` or else at the nearest.
    """
    angles = angles[::-1]
    sine, cosine = np.sin(angles), np.cos(angles)
    bone = np.column_stack(geometry.bone_profile(angles / (0.5 * math.pi)))
    cosine[0] = bone[0, 1] = 0.0
    inner_a, inner_b = geometry.bulk_semi_axes
    inner = np.column_stack([inner_a * sine, -inner_b * cosine])
    outer_a, outer_b = geometry.pad_semi_axis_radial, geometry.pad_semi_axis_axial
    outer = np.column_stack([outer_a * sine, -outer_b * cosine])
    skin = np.arange(1, layers + 1) / layers
    columns = np.concatenate(
        [
            bone[:, None] + bulk[:, None] * (inner - bone)[:, None],
            inner[:, None] + skin[:, None] * (outer - inner)[:, None],
        ],
        axis=1,
    )
    top = columns[0, :, 0]
    even = top[: len(bulk)].copy()
    _put_nail_edge(geometry, top, len(bulk), nail)
    # Columns near the top follow its shifted nodes so that elements keep their shape.
    shift = (top[: len(bulk)] - even) / (even[-1] - even[0])
    weight = np.maximum(0.0, 1.0 - (0.5 * math.pi - angles[1:]) / 0.6)
    columns[1:, : len(bulk)] += weight[:, None, None] * shift[:, None] * (inner - bone)[1:, None]
    return columns


def _put_nail_edge(geometry: Geometry, top: np.ndarray, bulk: int, nail: int | None) -> None:
    """Shift the radii (m,) of the top's nodes, `bulk` of them in the bulk tissue, so that one of
    them is the nail's edge."""
    edge = geometry.nail_reach
    if geometry.nail_thickness > 0 and edge > top[0]:
        r = top[:bulk].copy()
        nearest = nail or 1 + int(np.argmin(np.abs(r[1:-1] - edge)))
        top[:bulk] = np.interp(r, [r[0], r[nearest], r[-1]], [r[0], edge, r[-1]])


def _assemble(geometry: Geometry, columns: np.ndarray, bulk_layers: int, nail_layers: int) -> Mesh:
    """Number nodes and cells: nail rows, top line, then the columns down to the axis."""
    top = columns[0]
    rows = len(top)
    bone_edge = top[0, 0]
    nodes: list[np.ndarray] = []
    fixed: list[np.ndarray] = []
    cells: list[tuple[int, int, int, int]] = []
    part: list[int] = []
    inside = 0
    if geometry.nail_thickness > 0 and geometry.nail_reach > bone_edge * (1 + 1e-9):
        edge = int(np.argmin(np.abs(top[:, 0] - geometry.nail_reach)))
        # Over the bone the nail's lower face is held: two elements inwards its strain has died
        # away.
        reach = min(2.0 * geometry.nail_thickness, 0.9 * bone_edge)
        inner = bone_edge - reach * np.array([1.0, 1.0 / 3.0])
        radii = np.concatenate([inner, top[: edge + 1, 0]])
        inside = len(inner)
        for layer in range(nail_layers, 0, -1):
            height = geometry.nail_thickness * layer / nail_layers
            nodes.append(np.column_stack([radii, np.full(len(radii), height)]))
            hold = np.zeros((len(radii), 2), dtype=bool)
            hold[0] = True
            fixed.append(hold)
        nodes.append(np.column_stack([inner, np.zeros(inside)]))
        fixed.append(np.ones((inside, 2), dtype=bool))
        width = len(radii)
        for layer in range(nail_layers):
            upper, lower = layer * width, (layer + 1) * width
            for k in range(width - 1):
                cells.append((lower + k, lower + k + 1, upper + k + 1, upper + k))
                part.append(NAIL)
    first = sum(len(block) for block in nodes)
    for number, column in enumerate(columns):
        nodes.append(column)
        hold = np.zeros((rows, 2), dtype=bool)
        hold[0] = True
        if number == len(columns) - 1:
            hold[:, 0] = True
        fixed.append(hold)
        if number == len(columns) - 1:
            continue
        here, below = first + number * rows, first + (number + 1) * rows
        for j in range(rows - 1):
            cells.append((below + j, below + j + 1, here + j + 1, here + j))
            part.append(BULK if j < bulk_layers else EPIDERMIS)
    surface = first + rows * np.arange(len(columns))[::-1] + rows - 1
    mesh = Mesh(
        nodes=np.concatenate(nodes),
        cells=_anticlockwise(np.concatenate(nodes), np.array(cells, dtype=np.int64)),
        part=np.array(part, dtype=np.int64),
        fixed=np.concatenate(fixed),
        surface=surface.astype(np.int64),
    )
    mesh.nodes[surface[0] - rows + 1 : surface[0] + 1, 0] = 0.0
    return mesh


def _anticlockwise(nodes: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Cells (E, 4) with positive area."""
    r, z = nodes[cells, 0], nodes[cells, 1]
    area = np.sum(r * np.roll(z, -1, axis=1) - np.roll(r, -1, axis=1) * z, axis=1)
    cells = cells.copy()
    cells[area < 0] = cells[area < 0][:, ::-1]
    return cells
