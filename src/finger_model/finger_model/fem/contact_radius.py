"""Contact radius inside an element, and contact pressure, from the skin nodes.

Where the edge of the contact lies between two nodes is told by the loads at which nodes touch. About an
equilibrium the response to load is linear as long as no node touches or leaves; a small complementarity problem
over the four nodes nearest the edge gives the loads of the last two and the next two events. At its event a node
lies a fixed fraction of an element outside the true edge, so that event loads and node radii are points of the
smooth curve radius over load, and interpolating them at the present load gives the radius. Unlike a fit of the
gap it knows of no element edges.

Where tissue creeps faster than one event follows another, the response of the last step tells the two events
beside the present load well, the one before and the one after them to some 8 % of their distance: a corner at every
event. In steps fine enough to see every event coming, the curve is therefore continued: the last event and its slope
are kept as they were when it happened, and the event after the next is corrected by how such a prediction came out
before (`Edge`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .equilibrium import OPEN, SLIP, STICK, Contact, Equilibrium, NotConverged, Tangent

EDGE_FRACTION = 0.39
"""Distance of a node from the true edge, in node spacings, at the load at which it touches.

Found with Hertz's solution on a homogeneous sphere at small load (ν = 0.48): 0.39 ± 0.01 for 4 to 12 nodes in the
contact and for skin layers of 0.5 to 0.9 node spacings; 0.395 for ν = 0.4999, 0.343 for ν = 0.3.
"""

FEWEST_STEPS, CREEPS = 2.7, 1.25
"""Steps, and creep times τ1, from one event to the next above which events are remembered. With slower creep the
response of the last step errs alike on all four events, and the curve through them as told is the smoother one."""
LARGEST_JUMP = 0.02
"""Change, from step to step, of the load told of the last event, over the distance of two events, beyond which the
load path has changed and what is remembered is forgotten."""


@dataclass(frozen=True)
class Edge:
    """What is remembered of the edge while the force rises; forces in N/rad, slopes in m per N/rad.

    last: outermost skin node in contact; force, slope: at which it touched, and dr/dF there; told: that force as the
    present step alone tells it; next_force, next_slope: of the next node, predicted; ahead: predicted distance of the
    event after the next; said: what was predicted of the present distance when it was the one ahead (NaN if unknown);
    stretch: true over predicted distance of the last one that came to pass.
    """

    last: int
    told: float
    force: float
    slope: float
    next_force: float
    next_slope: float
    ahead: float
    said: float = math.nan
    stretch: float = 1.0


def contact_edge(
    equilibrium: Equilibrium,
    x: np.ndarray,
    contact: Contact,
    friction: float,
    push: np.ndarray,
    rise: float,
    creep: float = math.inf,
    before: Edge | None = None,
) -> tuple[float, float, Edge | None]:
    """Radius (m) of the contact's outer edge, zero without contact, force (N) until two more nodes touch, and memory.

    For a state just solved for; x (N, 2) positions. push (2N,) loads on the tissue and rise of the plate's force
    (N/rad) are the rates, per step, along the path on which the state lies; creep is τ1 in steps, `before` the memory
    of the step before. Uses, and overwrites, the stiffness that the last solve left in `equilibrium`. The force is
    infinite where it cannot be told.
    """
    active = np.flatnonzero(contact.status != OPEN)
    if not len(active):
        return 0.0, math.inf, None
    skin = x[equilibrium.mesh.surface]
    last = int(active[-1])
    if last + 2 >= len(skin):
        return float(skin[last, 0]), math.inf, None
    # The nodes nearest the edge; all contact nodes but the first may let go.
    near = np.arange(max(last - 1, int(active[0]) + 1), last + 3)
    closed = near[near <= last]
    loads = along = None
    if np.all(contact.status[closed] != OPEN):
        loads, along = _event_loads(equilibrium, x, contact, friction, near, push, rise)
    if loads is None:
        return gap_radius(skin, contact), math.inf, None
    reserve = 2.0 * math.pi * float(loads[-1])
    creeping = along is not None and bool(push.any())
    if along is not None:
        loads = rise * along
    r = skin[:, 0]
    events = r[near] - EDGE_FRACTION * (r[near] - r[near - 1])
    force = float(contact.normal.sum())
    edge = None
    if last < 2:
        # So few nodes: Hertz's law, a ~ F^(1/3), from first touch to the next event.
        following = int(np.searchsorted(near, last + 1))
        radius = float(events[following] * np.cbrt(force / (force + loads[following])))
    elif len(near) < 4:
        radius = gap_radius(skin, contact)
    else:
        steps = (loads[2] - loads[1]) / rise
        seen = creeping and steps > max(FEWEST_STEPS, CREEPS * creep)
        edge = _follow(force + loads, events, last, before if seen else None)
        radius = _hermite(force, edge, float(events[1]), float(events[2]))
    return radius, reserve, edge if creeping else None


def _follow(forces: np.ndarray, radii: np.ndarray, last: int, before: Edge | None) -> Edge:
    """The edge between the inner two of four events (forces, radii), the second of which is of node `last`."""
    width = np.diff(forces)
    rates = np.diff(radii) / width
    slope = float((rates[0] * width[1] + rates[1] * width[0]) / (width[0] + width[1]))
    force, said, stretch = float(forces[1]), math.nan, 1.0
    if before is not None and before.last in (last - 1, last):
        touching = before.last == last - 1
        told = before.next_force if touching else before.told
        if abs(told - force) < LARGEST_JUMP * width[1]:
            force, slope, said, stretch = before.force, before.slope, before.said, before.stretch
            if touching:
                true = (before.next_force - before.force) / before.said
                stretch = float(np.clip(true, 0.8, 1.25)) if math.isfinite(true) else 1.0
                force, slope, said = before.next_force, before.next_slope, before.ahead
    here, ahead = float(forces[2]) - force, stretch * float(width[2])
    rates = np.diff(radii[1:]) / [here, ahead]
    next_slope = float((rates[0] * ahead + rates[1] * here) / (here + ahead))
    return Edge(
        last,
        float(forces[1]),
        force,
        slope,
        float(forces[2]),
        next_slope,
        float(width[2]),
        said,
        stretch,
    )


def _hermite(force: float, edge: Edge, inner: float, outer: float) -> float:
    """Radius (m) at a force (N/rad) between the events of an edge at radii `inner` and `outer` (m)."""
    width = edge.next_force - edge.force
    u = (force - edge.force) / width
    return float(
        (1 + 2 * u) * (1 - u) ** 2 * inner
        + u * u * (3 - 2 * u) * outer
        + width * u * (1 - u) * ((1 - u) * edge.slope - u * edge.next_slope)
    )


def _event_loads(
    equilibrium: Equilibrium,
    x: np.ndarray,
    contact: Contact,
    friction: float,
    near: np.ndarray,
    path_push: np.ndarray,
    path_rise: float,
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Loads (k,), less the present one (N/rad), at which the given skin nodes touch, and places along the path.

    The present place on the path is zero, and the contact grows with place. None where nodes touch out of order.
    """
    status = contact.status
    active = np.flatnonzero(status != OPEN)
    base = active[active < near[0]]
    free = ~equilibrium.guided
    slipping = base[(status[base] == SLIP) & free[base]]
    sticking = active[(status[active] == STICK) & free[active]]
    pull = friction * contact.direction
    try:
        tangent = Tangent(equilibrium, base, sticking, slipping, pull, True)
        if not tangent.stable:
            return None, None
        k = len(near)
        push = np.zeros((k + 2, equilibrium.unknowns))
        push[k + 1] = path_push
        rows = np.arange(k)
        push[rows, equilibrium.axial[near]] = 1.0
        # A node that touches slips as the one at the edge does.
        drag = np.where(status[near] == SLIP, pull[near], 0.0)
        edge = int(active[-1])
        drag[near > edge] = pull[edge] if status[edge] == SLIP else 0.0
        push[rows, equilibrium.radial[near]] -= drag
        moves, rises, _ = tangent.respond(push, np.concatenate([-np.ones(k), [1.0, path_rise]]))
    except NotConverged:
        return None, None
    response = moves[:, equilibrium.axial[near]] - rises[:, None]
    compliance = response[:k].T
    closed = near <= edge
    normal = np.where(closed, contact.normal[near], 0.0)
    gap = np.where(closed, 0.0, x[equilibrium.mesh.surface[near], 1] - contact.height)
    found: list[np.ndarray | None] = []
    for rate in response[k:]:
        places = np.empty(k)
        try:
            for j in range(k):
                # Nodes up to j touch, node j and those beyond carry nothing.
                matrix = np.column_stack([rate[: j + 1], compliance[: j + 1, :j]])
                right = compliance[: j + 1, j:] @ normal[j:] - gap[: j + 1]
                places[j] = np.linalg.solve(matrix, right)[0]
        except np.linalg.LinAlgError:
            places[:] = math.nan
        if places[-1] < places[0]:
            places = -places
        ordered = np.all(np.isfinite(places)) and np.all(np.diff(places) > 0)
        present = places[closed].max(initial=-math.inf) <= 0.0 <= places[~closed].min()
        found.append(places if ordered and present else None)
    return found[0], found[1]


def gap_radius(skin: np.ndarray, contact: Contact) -> float:
    """Radius (m) of the outer edge from the gaps of the next open nodes alone; skin (S, 2) positions.

    Beside the edge the gap grows with distance to the power 3/2 (Hertz): gap^(2/3) of the open nodes, fitted by a
    parabola, has its root there. Serves where event loads cannot be told (a ring one node wide).
    """
    active = np.flatnonzero(contact.status != OPEN)
    last = int(active[-1])
    r = skin[last + 1 : last + 8, 0] - skin[last, 0]
    measure = np.maximum(skin[last + 1 : last + 8, 1] - contact.height, 0.0) ** (2.0 / 3.0)
    edge = 0.5 * r[0]
    if len(r) >= 4:
        weight = np.linspace(1.0, 0.1, len(r))
        roots = np.polynomial.Polynomial.fit(r, measure, 2, w=weight).roots()
        roots = roots[np.isreal(roots)].real
        if len(roots):
            edge = float(np.clip(roots[np.argmin(np.abs(roots - edge))], -r[0], r[0]))
    return max(float(skin[last, 0]) + edge, 0.0)


def contact_pressure(skin: np.ndarray, contact: Contact) -> np.ndarray:
    """Pressure (S,) in Pa at the skin nodes (S, 2): their force over the area of skin they stand for."""
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


def peak_pressure(skin: np.ndarray, contact: Contact) -> float:
    """Largest contact pressure (Pa), smoothed over neighbouring nodes with weights ¼, ½, ¼."""
    pressure = contact_pressure(skin, contact)
    mirrored = np.concatenate([pressure[1:2], pressure, [0.0]])
    return float(np.max(0.25 * mirrored[:-2] + 0.5 * mirrored[1:-1] + 0.25 * mirrored[2:]))
