# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contact radius inside an element, and contact pressure, from the skin nodes.

An *event* is a node that touches the plate or leaves it. The loads of the events show where the
edge of the contact lies between two nodes. About an equilibrium the response to load is linear
until the next event; a small complementarity problem over the four nodes nearest the edge gives the
loads of the last two and the next two events. At its event a node lies a fixed fraction of an
element outside the true edge. Event loads and node radii are therefore points of the smooth curve
radius over load, and interpolation at the present load gives the radius. A fit of the gap, in
contrast, shows steps from element to element.

Where tissue creeps faster than one event follows another, the response of the last step gives the
two events beside the present load well, but the one before and the one after them only to about 8 %
of their distance. The curve would have a corner at every event, and a smaller one wherever a node
inside the contact begins to stick or slip, since that changes the response. In steps fine enough to
see each event in advance, the curve is therefore continued from step to step (`Edge`): load and
slope of the last event stay as they were when it happened, and the gap to the event after the next
is corrected by the error of the previous such prediction. Where a node inside begins to stick or
slip, the curve goes on from the last radius and slope.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .equilibrium import OPEN, SLIP, STICK, Contact, ContactSet, Equilibrium, NotConverged, Tangent

EDGE_FRACTION = 0.39
"""Distance of a node from the true edge, in node spacings, at the load at which it touches.

Found with Hertz's solution on a homogeneous sphere at small load (ν = 0.48): 0.39 ± 0.01 for 4 to
12 nodes in the contact and for skin layers of 0.5 to 0.9 node spacings; 0.395 for ν = 0.4999, 0.343
for ν = 0.3.
"""

MINIMUM_STEPS, MINIMUM_CREEP_TIMES = 2.7, 1.25
"""Steps, and creep times, between two events from which the curve is continued. With slower creep
the four predicted events have similar errors, and the curve through them is the smoother one."""

MAXIMUM_CHANGE, MAXIMUM_CHANGE_INSIDE = 0.02, 0.1
"""Largest change, from step to step, of the last event's predicted force over the distance of two
events; the second where a node inside began to stick or slip. Beyond it the load path has changed,
and the curve starts again."""

MAXIMUM_SLOPE_RATIO = 1.5
"""Largest ratio, either way, of the slope that is continued to that of the present step. While the
force hardly rises and the tissue creeps, radius over force is a hundred times as steep. A next step
that rises faster must not take this slope over: a force in stairs gave areas up to 149 % too large.
"""

FEW_NODES = 2
"""Nodes in contact up to which a pressure by nodes is too coarse. Above, it is within 20 % of that
on meshes three times as fine."""

CORRECTION_RANGE = (0.8, 1.25)
"""Smallest and largest correction of a predicted gap between events."""


@dataclass(frozen=True)
class Edge:
    """History of the contact's edge while the force rises; forces in N/rad, slopes in m per N/rad.

    last: outermost skin node in contact; touched: force at which it touched; predicted: the same
    as the present step alone predicts it. start: where the curve to the next event begins; present:
    where it is; both force, radius (m) beyond that of the last event, and dr/dF. sticking: number
    of sticking nodes. next_force, next_slope: predicted for the next node. next_gap: predicted
    force from the next event to the one after it. previous_gap: what was predicted for the present
    gap when it was the next one, NaN if unknown. gap_correction: true over predicted gap at the
    last event.
    """

    last: int
    touched: float
    predicted: float
    start: tuple[float, float, float]
    present: tuple[float, float, float]
    sticking: int
    next_force: float
    next_slope: float
    next_gap: float
    previous_gap: float = math.nan
    gap_correction: float = 1.0


def contact_edge(
    equilibrium: Equilibrium,
    x: np.ndarray,
    contact: Contact,
    friction: float,
    load_rate: np.ndarray,
    force_rate: float,
    creep: float = math.inf,
    before: Edge | None = None,
) -> tuple[float, float, Edge | None]:
    """Radius (m) of the contact's outer edge, rise of the force (N) until two more nodes touch, and
    the edge's history.

    For a state just solved for; x (N, 2) positions. load_rate (2N,) of the creeping tissue and
    force_rate of the plate (N/rad), per step, are those of the path on which the state lies; creep:
    creep time in steps; before: history after the step before. Uses, and overwrites, the stiffness
    that the last solve left in `equilibrium`. The radius is zero without contact; the rise is
    infinite where it cannot be predicted.
    """
    active = np.flatnonzero(contact.status != OPEN)
    if not len(active):
        return 0.0, math.inf, None
    skin = x[equilibrium.mesh.surface]
    last = int(active[-1])
    if last + 2 >= len(skin):
        return float(skin[last, 0]), math.inf, None
    # The nodes nearest the edge; all contact nodes but the first may open.
    near = np.arange(max(last - 1, int(active[0]) + 1), last + 3)
    loads = along = None
    if np.all(contact.status[near[near <= last]] != OPEN):
        loads, along = _event_loads(equilibrium, x, contact, friction, near, load_rate, force_rate)
    if loads is None:
        return gap_radius(skin, contact), math.inf, None
    reserve = 2.0 * math.pi * float(loads[-1])
    creeping = along is not None and bool(load_rate.any())
    if along is not None:
        loads = force_rate * along
    r = skin[:, 0]
    events = r[near] - EDGE_FRACTION * (r[near] - r[near - 1])
    force = float(contact.normal.sum())
    if last < 2:
        # So few nodes: Hertz's law, a ~ F^(1/3), from first touch to the next event.
        following = int(np.searchsorted(near, last + 1))
        ratio = force / (force + loads[following])
        return float(events[following] * np.cbrt(ratio)), reserve, None
    if len(near) < 4:
        return gap_radius(skin, contact), reserve, None
    steps = (loads[2] - loads[1]) / force_rate
    continued = creeping and steps > max(MINIMUM_STEPS, MINIMUM_CREEP_TIMES * creep)
    sticking = int(np.count_nonzero(contact.status == STICK)) if friction > 0.0 else 0
    edge = _continued(force + loads, events, last, sticking, before if continued else None)
    edge = _moved(edge, force, float(events[2] - events[1]))
    return float(events[1]) + edge.present[1], reserve, edge if creeping else None


def _continued(
    forces: np.ndarray, radii: np.ndarray, last: int, sticking: int, before: Edge | None
) -> Edge:
    """The edge between the inner two of four events (forces, radii), the second of which is of node
    `last`.

    It continues the edge of the step before, where there is one and the load path has not changed.
    """
    gaps = np.diff(forces)
    rates = np.diff(radii) / gaps
    touched = predicted = float(forces[1])
    slope = float((rates[0] * gaps[1] + rates[1] * gaps[0]) / (gaps[0] + gaps[1]))
    start = touched, 0.0, slope
    previous_gap, gap_correction = math.nan, 1.0
    if before is not None and before.last in (last - 1, last):
        touched_now = before.last == last - 1
        expected = before.next_force if touched_now else before.predicted
        changed = sticking != before.sticking
        limit = MAXIMUM_CHANGE_INSIDE if changed else MAXIMUM_CHANGE
        continued = before.next_slope if touched_now else before.start[2]
        alike = 1.0 / MAXIMUM_SLOPE_RATIO < continued / slope < MAXIMUM_SLOPE_RATIO
        if alike and abs(expected - predicted) < limit * gaps[1]:
            if touched_now:
                error = (before.next_force - before.touched) / before.previous_gap
                known = math.isfinite(error)
                gap_correction = float(np.clip(error, *CORRECTION_RANGE)) if known else 1.0
                touched, previous_gap = before.next_force, before.next_gap
                start = touched, 0.0, before.next_slope
            else:
                touched, start = before.touched, before.present if changed else before.start
                previous_gap, gap_correction = before.previous_gap, before.gap_correction
    gap, next_gap = float(forces[2]) - touched, gap_correction * float(gaps[2])
    rates = np.diff(radii[1:]) / [gap, next_gap]
    return Edge(
        last=last,
        touched=touched,
        predicted=predicted,
        start=start,
        present=start,
        sticking=sticking,
        next_force=float(forces[2]),
        next_slope=float((rates[0] * next_gap + rates[1] * gap) / (gap + next_gap)),
        next_gap=float(gaps[2]),
        previous_gap=previous_gap,
        gap_correction=gap_correction,
    )


def _moved(edge: Edge, force: float, rise: float) -> Edge:
    """The edge at a force (N/rad), on the cubic to the next event `rise` (m) beyond the last."""
    begin, radius, slope = edge.start
    width = edge.next_force - begin
    u, first, last = (force - begin) / width, width * slope, width * edge.next_slope
    square, cube = 3 * (rise - radius) - 2 * first - last, first + last - 2 * (rise - radius)
    radius += u * (first + u * (square + u * cube))
    slope = (first + u * (2 * square + 3 * u * cube)) / width
    return replace(edge, present=(force, radius, slope))


def _event_loads(
    equilibrium: Equilibrium,
    x: np.ndarray,
    contact: Contact,
    friction: float,
    near: np.ndarray,
    load_rate: np.ndarray,
    force_rate: float,
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Loads (k,), less the present one (N/rad), at which skin nodes `near` touch, and positions
    along the path.

    The present position on the path is zero, and the contact grows along it. None where nodes touch
    out of order.
    """
    status = contact.status
    nodes = equilibrium.contact_set(contact)
    edge = int(nodes.active[-1])
    # The nodes near the edge are loads here: they and the free radii beside them are not held.
    held = ContactSet(
        nodes.active[nodes.active < near[0]],
        nodes.sticking,
        nodes.slipping[nodes.slipping < near[0]],
    )
    slip_friction = friction * contact.direction
    # A node that touches slips as the one at the edge does.
    drag = np.where(status[near] == SLIP, slip_friction[near], 0.0)
    drag[near > edge] = slip_friction[edge] if status[edge] == SLIP else 0.0
    k = len(near)
    rows = np.arange(k)
    loads = np.zeros((k + 2, equilibrium.unknowns))
    loads[rows, equilibrium.axial[near]] = 1.0
    loads[rows, equilibrium.radial[near]] -= drag
    loads[k + 1] = load_rate
    try:
        tangent = Tangent(equilibrium, held, slip_friction, True)
        if not tangent.stable:
            return None, None
        moves, rises, _ = tangent.respond(loads, np.concatenate([-np.ones(k), [1.0, force_rate]]))
    except NotConverged:
        return None, None
    response = moves[:, equilibrium.axial[near]] - rises[:, None]
    compliance = response[:k].T
    closed = near <= edge
    normal = np.where(closed, contact.normal[near], 0.0)
    gap = np.where(closed, 0.0, x[equilibrium.mesh.surface[near], 1] - contact.height)
    found: list[np.ndarray | None] = []
    for rate in response[k:]:
        positions = np.empty(k)
        try:
            for j in range(k):
                # Nodes up to j touch, node j and those beyond carry nothing.
                matrix = np.column_stack([rate[: j + 1], compliance[: j + 1, :j]])
                right = compliance[: j + 1, j:] @ normal[j:] - gap[: j + 1]
                positions[j] = np.linalg.solve(matrix, right)[0]
        except np.linalg.LinAlgError:
            positions[:] = math.nan
        if positions[-1] < positions[0]:
            positions = -positions
        ordered = np.all(np.isfinite(positions)) and np.all(np.diff(positions) > 0)
        present = positions[closed].max(initial=-math.inf) <= 0.0 <= positions[~closed].min()
        found.append(positions if ordered and present else None)
    return found[0], found[1]


def gap_radius(skin: np.ndarray, contact: Contact) -> float:
    """Radius (m) of the outer edge from the gaps of the next open nodes alone; skin (S, 2)
    positions.

    Beside the edge the gap grows with distance to the power 3/2 (Hertz): gap^(2/3) of the open
    nodes, fitted by a parabola, has its root there. Serves where event loads cannot be predicted (a
    ring one node wide).
    """
    active = np.flatnonzero(contact.status != OPEN)
    last = int(active[-1])
    r = skin[last + 1 : last + 8, 0] - skin[last, 0]
    measure = np.maximum(skin[last + 1 : last + 8, 1] - contact.height, 0.0) ** (2.0 / 3.0)
    edge = 0.5 * r[0]
    if len(r) >= 4:
        weight = np.linspace(1.0, 0.1, len(r))
        roots: np.ndarray = np.polynomial.Polynomial.fit(r, measure, 2, w=weight).roots()
        roots = roots[np.isreal(roots)].real
        if len(roots):
            edge = float(np.clip(roots[np.argmin(np.abs(roots - edge))], -r[0], r[0]))
    return max(float(skin[last, 0]) + edge, 0.0)


def contact_pressure(skin: np.ndarray, contact: Contact) -> np.ndarray:
    """Pressure (S,) in Pa at skin nodes (S, 2): their force over their share of the area."""
    area = _node_areas(skin)
    return np.where(contact.normal > 0, contact.normal / area, 0.0)


def contact_shear(skin: np.ndarray, contact: Contact) -> np.ndarray:
    """Outward friction traction (S,) in Pa of the plate on the skin nodes (S, 2)."""
    return np.where(contact.normal > 0, contact.shear / _node_areas(skin), 0.0)


def _node_areas(skin: np.ndarray) -> np.ndarray:
    """∫ N_i r dr (S,) in m²/rad over the two skin edges of each node, as the plate sees them."""
    r = skin[:, 0]
    left = np.concatenate([[0.0], np.abs(np.diff(r))])
    right = np.concatenate([np.abs(np.diff(r)), [0.0]])
    area = left * (r / 2.0 - left / 6.0) + right * (r / 2.0 + right / 6.0)
    return np.maximum(area, 1e-6 * float(area.max()))


def peak_pressure(skin: np.ndarray, contact: Contact, mean: float) -> float:
    """Largest contact pressure (Pa), smoothed over neighbouring nodes with weights ¼, ½, ¼.

    Nodes share out more area than the first few of a contact touch: there at least Hertz's peak,
    1.5 times the mean pressure `mean` (Pa).
    """
    pressure = contact_pressure(skin, contact)
    mirrored = np.concatenate([pressure[1:2], pressure, [0.0]])
    peak = float(np.max(0.25 * mirrored[:-2] + 0.5 * mirrored[1:-1] + 0.25 * mirrored[2:]))
    return max(peak, 1.5 * mean) if np.count_nonzero(pressure) <= FEW_NODES else peak
