# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Outline, area, pressure and stick area of the contact from the skin nodes.

Beside the edge of a contact the gap grows with distance to the power 3/2 (Hertz), farther away than
the skin is thick rather with its square. So gap^(2/3) of the open nodes near the edge, and its
square, give their distance from it. The edge r(φ) about the contact's middle, and the slope of
gap^(2/3) round it, are fitted as Fourier series to all these nodes at once; a single node or a row
of them then has no weight of its own, and the area shows no staircase.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..fem.equilibrium import OPEN
from .contact import Contact
from .mesh import SolidMesh

EDGE_ORDER = 4
"""Highest cosine of the edge's Fourier series; its slope has those to 2."""
SLIP_SHARE = 0.05
"""Slip over the plate's travel below which skin is said to stick: the tissue's own small slips, as
those of the edge while a finger is pressed, are no sign of sliding."""
SAMPLES = 4
"""Across a face, of its slip."""
BAND = (0.2, 2.5)
"""Distance from the edge of the nodes in the fit, in node spacings."""
EDGE_SHIFT = 0.225
"""Distance of the true edge inside the fitted one, in node spacings, found with the axisymmetric
model on twelve fingers (`scripts/solid_areas.py`)."""
NEAR = 1.5
"""Distance from the edge of the nodes whose spacing that is, in node spacings."""


class Outline(NamedTuple):
    """Ellipse of the same second moments as the contact, and its area (m², m, rad).

    center (2,): in the plate's axes, from the foot of the normal through the pad's centre;
    semi_axes: the larger first; orientation: of the larger one from x.
    """

    area: float
    center: np.ndarray
    semi_axes: tuple[float, float]
    orientation: float


NO_CONTACT = Outline(0.0, np.zeros(2), (0.0, 0.0), 0.0)


def node_areas(mesh: SolidMesh, skin: np.ndarray) -> np.ndarray:
    """Share (S,) of each skin node of the plate's plane (m²); skin (S, 3) positions."""
    areas = np.zeros(len(skin))
    np.add.at(areas, mesh.faces, 0.25 * _face_areas(mesh, skin)[:, None])
    return areas


def _face_areas(mesh: SolidMesh, skin: np.ndarray) -> np.ndarray:
    """Areas (Q,) of the skin's quadrilaterals in the plate's plane (m²)."""
    p = skin[mesh.faces, :2]
    d, e = p[:, 3] - p[:, 0], p[:, 2] - p[:, 1]
    return 0.5 * np.abs(d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0])


def outline(mesh: SolidMesh, skin: np.ndarray, contact: Contact, areas: np.ndarray) -> Outline:
    """Outline of the contact; skin (S, 3) positions, areas (S,) of the nodes (m²)."""
    active = contact.status != OPEN
    if not active.any():
        return NO_CONTACT
    weight = areas[active]
    points = skin[active, :2]
    middle = weight @ points / weight.sum()
    if mesh.half:
        middle[1] = 0.0
    rel = skin[:, :2] - middle
    covariance = (weight[:, None, None] * rel[active][:, :, None] * rel[active][:, None, :]).sum(
        axis=0
    ) / weight.sum()
    if mesh.half:
        covariance[0, 1] = covariance[1, 0] = 0.0
    covariance += np.eye(2) * float(areas[active].mean()) / 12.0
    distance = np.hypot(rel[:, 0], rel[:, 1])
    angle = np.arctan2(rel[:, 1], rel[:, 0])
    inverse = np.linalg.inv(covariance)
    # Uniform ellipse: its half-axis is twice the standard deviation.
    reach = np.sqrt(np.einsum("ni,ij,nj->n", rel, inverse, rel)) / 2.0
    edge = distance / np.maximum(reach, 1e-12)
    root = np.maximum(skin[:, 2] - contact.plate[2], 0.0) ** (2.0 / 3.0)
    # The nodes of the symmetry plane have half their share here.
    on_plane = mesh.half & (np.abs(mesh.disc[:, 1]) < 1e-12)
    spacing = np.sqrt(np.where(on_plane, 2.0, 1.0) * areas)
    terms = _terms(angle, EDGE_ORDER, mesh.half)
    slopes = _terms(angle, 2, mesh.half)
    dense = np.linspace(-math.pi, math.pi, 721)[:-1]
    coefficients = None
    for _ in range(4):
        away = (distance - edge) / spacing
        low, high = BAND
        fade = np.clip((away - low) / 0.7, 0.0, 1.0) * np.clip((high - away) / 1.5, 0.0, 1.0)
        used = np.flatnonzero((fade > 0.0) & ~active)
        if len(used) < 2 * (terms.shape[1] + slopes.shape[1]):
            break
        scaled = root[used] / root[used].max()
        square = scaled[:, None] ** 2
        matrix = np.column_stack([terms[used], slopes[used] * scaled[:, None], square])
        w = np.sqrt(fade[used] * areas[used])
        found = np.linalg.lstsq(matrix * w[:, None], distance[used] * w, rcond=None)[0]
        coefficients = found[: terms.shape[1]]
        edge = terms @ coefficients
    if coefficients is None:
        total = float(weight.sum()) * mesh.copies
        a, b = 2.0 * np.sqrt(np.linalg.eigvalsh(covariance)[::-1])
        factor = math.sqrt(total / (math.pi * a * b))
        return Outline(total, middle, (a * factor, b * factor), 0.0)
    r = _terms(dense, EDGE_ORDER, mesh.half) @ coefficients
    around = _terms(dense, 2, mesh.half)
    near = np.abs(distance - edge) < NEAR * spacing
    local = np.linalg.lstsq(slopes[near], spacing[near], rcond=None)[0]
    r -= EDGE_SHIFT * (around @ local)
    step = 2.0 * math.pi / len(dense)
    area = 0.5 * step * float(np.sum(r**2))
    ray = np.column_stack([np.cos(dense), np.sin(dense)])
    center = step / 3.0 * (r**3 @ ray) / area
    second = step / 4.0 * np.einsum("n,ni,nj->ij", r**4, ray, ray) / area
    second -= np.outer(center, center)
    values, vectors = np.linalg.eigh(second)
    b, a = 2.0 * np.sqrt(values)
    orientation = math.atan2(vectors[1, 1], vectors[0, 1])
    orientation = (orientation + 0.5 * math.pi) % math.pi - 0.5 * math.pi
    return Outline(area, middle + center, (float(a), float(b)), orientation)


def _terms(angle: np.ndarray, order: int, even: bool) -> np.ndarray:
    """Columns 1, cos φ, …, and sines unless the shape is even in φ (n, k)."""
    k = np.arange(order + 1)
    columns = [np.cos(angle[:, None] * k)]
    if not even:
        columns.append(np.sin(angle[:, None] * k[1:]))
    return np.concatenate(columns, axis=1)


def stick_ratio(
    mesh: SolidMesh, skin: np.ndarray, contact: Contact, way: np.ndarray, travel: float
) -> float:
    """Share of the contact's area whose `way` (S, 2) along the plate in a step is less than
    SLIP_SHARE of the plate's `travel` (m) in it; skin (S, 3) positions. Slip is interpolated
    between the nodes, so that the edge of the stick zone need not pass through them."""
    slid = np.hypot(*way.T)
    touches = (contact.status != OPEN).astype(float)
    even = (np.arange(SAMPLES) + 0.5) / SAMPLES
    u, v = (grid.ravel() for grid in np.meshgrid(even, even))
    shape = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v])
    touching = touches[mesh.faces] @ shape
    mean = (touches * slid)[mesh.faces] @ shape / np.maximum(touching, 1e-12)
    weight = touching * _face_areas(mesh, skin)[:, None]
    return float(weight[mean <= SLIP_SHARE * travel].sum() / weight.sum())


def twist_torque(skin: np.ndarray, force: np.ndarray) -> float:
    """Torque (N m) about the normal through the centre of pressure of forces (S, 3) in N at
    positions (S, 3): that of the wrench along its own axis, over the cosine between the two (A.
    Bicchi, J. K. Salisbury and D. L. Brock, Int. J. Robotics Research 12, 1993)."""
    normal = float(force[:, 2].sum())
    if normal <= 0.0:
        return 0.0
    x, y = (skin[:, :2] - force[:, 2] @ skin[:, :2] / normal).T
    return float(x @ force[:, 1] - y @ force[:, 0])


def pressure(mesh: SolidMesh, contact: Contact, areas: np.ndarray) -> np.ndarray:
    """Pressure (S,) in Pa: forces of the nodes of each face over their areas, averaged over the
    faces of a node."""
    normal = contact.force[:, 2]
    f = mesh.faces
    uses = np.bincount(f.ravel(), minlength=len(normal))
    mean = (normal / uses)[f].sum(axis=1) / (areas / uses)[f].sum(axis=1)
    total = np.bincount(f.ravel(), np.repeat(mean, 4), minlength=len(normal))
    return np.where(contact.status != OPEN, total / uses, 0.0)
