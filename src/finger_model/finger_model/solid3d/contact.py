# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contact and Coulomb friction on a rigid plate, node by node, on the condensed stiffness.

A node is open, sticks or slips. A node in contact has the plate's height; its reaction is the
contact force, no contact stiffness exists. A sticking node keeps its place on the plate. A slipping
node feels friction × normal force against its slip since the step began. The laws are solved by a
semismooth Newton method (Alart and Curnier 1991; Hüeber, Stadler and Wohlmuth 2008) in the small
dense matrix that `Condensation` gives, to the end, between two evaluations of the finger.

To compare with codes that soften Coulomb's law, a sticking node may instead hang on a tangential
spring, up to the same limit (penalty with return mapping: Wriggers, Computational Contact
Mechanics, 2006, §5.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..fem.equilibrium import OPEN, SLIP, STICK, NotConverged

ITERATIONS = 40
LOOSE = 6
"""Times that no node sticks after which the plate is said to slide."""
TOLERANCE = 1e-9
"""Largest misfit of the friction law over the largest friction of a node."""


class Plate(NamedTuple):
    """What the plate does: per axis its position (m), or the force (N) it exerts on the mesh.

    position (3,): its shift and z; NaN where the force is given. force (3,). slides: every node
    slips, since the plate is far from where it was.
    """

    position: np.ndarray
    force: np.ndarray
    slides: bool = False

    @property
    def loaded(self) -> np.ndarray:
        """Axes (k,) along which the force is given."""
        return np.flatnonzero(np.isnan(self.position))


@dataclass
class Contact:
    """State of the skin nodes (S,) against the plate; axes x, y, z are those of the plate.

    status: OPEN, STICK or SLIP; force (S, 3): of the plate on the nodes (N); anchor (S, 2): place
    (m) on the plate of the node when the step began; begun (S, 2): friction (N) of the
    node then; plate (3,): shift of the plate in x and y, and its height (m).
    """

    status: np.ndarray
    force: np.ndarray
    anchor: np.ndarray
    begun: np.ndarray
    plate: np.ndarray

    def copy(self) -> Contact:
        """Independent copy."""
        names = ("status", "force", "anchor", "begun", "plate")
        return replace(self, **{name: getattr(self, name).copy() for name in names})


class NotSettled(NotConverged):
    """No set of nodes that stick and slip was found."""


class Sliding(Exception):
    """No node sticks, and the tangential force is given: the plate slides away."""


@dataclass(frozen=True)
class Nodes:
    """The m nodes that may touch, and the body under them: f = internal + stiffness · u.

    stiffness (3 m, 3 m); internal (3 m,): force (N) that holds the nodes at positions (m, 3);
    movable (m, 3): whether a component can move; anchor (m, 2): as in `Contact`. spring: stiffness
    (m,) in N/m on which sticking nodes hang, and `Contact.begun`; without it they do not move on
    the plate.
    """

    stiffness: np.ndarray
    internal: np.ndarray
    positions: np.ndarray
    movable: np.ndarray
    anchor: np.ndarray
    spring: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def slip_stiffness(self) -> np.ndarray:
        """Stiffness (m,) in N/m by which slip is weighed against friction."""
        if self.spring is not None:
            return self.spring[0]
        diagonal = np.diag(self.stiffness).reshape(-1, 3)
        return np.where(diagonal[:, 0] > 0, diagonal[:, 0], diagonal[:, 2])

    def slip(self, positions: np.ndarray, plate: np.ndarray) -> np.ndarray:
        """Way (m, 2) of nodes at positions (m, 3) on the plate (3,) since the step began."""
        return positions[:, :2] - plate[:2] - self.anchor


class Response(NamedTuple):
    """Displacement (m, 3) and force (m, 3) of the nodes, plate (3,), status (m,)."""

    displacement: np.ndarray
    force: np.ndarray
    plate: np.ndarray
    status: np.ndarray


def respond(
    nodes: Nodes,
    status: np.ndarray,
    force: np.ndarray,
    plate: np.ndarray,
    target: Plate,
    friction: float,
) -> Response:
    """Displacements of the m nodes for which contact and friction hold.

    status (m,), force (m, 3), plate (3,): as in `Contact`, a first guess. Raises NotConverged or
    Sliding.
    """
    try:
        return _settle(nodes, status, force, plate, target, friction)
    except NotConverged:
        if friction == 0.0 or target.slides:
            raise
        # After a turn of the load everything sticks at first.
        held = np.where(status == SLIP, STICK, status)
        return _settle(nodes, held, force, plate, target, friction)


def _settle(
    nodes: Nodes,
    status: np.ndarray,
    force: np.ndarray,
    plate: np.ndarray,
    target: Plate,
    friction: float,
) -> Response:
    """`respond` from one guess."""
    status = status.copy()
    plate = np.where(np.isnan(target.position), plate, target.position)
    pulled = bool(np.any(target.loaded < 2))
    if pulled and friction == 0.0:
        raise Sliding
    loose = 0
    slip_stiffness = nodes.slip_stiffness
    begun = nodes.spring[1] if nodes.spring is not None else None
    # Guess of the slip direction of nodes that already slip: that of their friction.
    trial = force[:, :2].copy()
    misfit = math.inf
    seen: list[bytes] = []
    one_at_a_time = False
    for _ in range(ITERATIONS):
        active = status != OPEN
        if len(target.loaded) and not active.any():
            raise NotConverged("no node touches")
        if pulled and not np.any(status == STICK):
            # The node nearest to sticking holds the plate until the others settle.
            loose += 1
            if loose > LOOSE:
                raise Sliding
            bound = friction * np.maximum(force[:, 2], 0.0)
            excess = np.where(active, np.hypot(trial[:, 0], trial[:, 1]) - bound, np.inf)
            status[np.argmin(excess)] = STICK
        system = _System(nodes, status, plate, target, friction)
        if friction > 0.0:
            system.set_friction(trial, np.maximum(force[:, 2], 0.0), slip_stiffness)
        moved, plate_now = system.solve()
        force = (nodes.internal + nodes.stiffness @ moved.ravel()).reshape(-1, 3)
        force[~active] = 0.0
        force[~nodes.movable] = 0.0
        # New sets.
        now = nodes.positions + moved
        gap = now[:, 2] - plate_now[2]
        largest = float(force[:, 2].max(initial=0.0))
        before = status.copy()
        opens = active & (force[:, 2] < -1e-12 * largest)
        closes = ~active & (gap < -1e-13)
        if one_at_a_time:
            opens, closes = _worst(opens, force[:, 2]), _worst(closes, gap)
        if opens.sum() == active.sum() and not closes.any():
            opens[np.argmax(force[:, 2])] = False
        held = force[:, :2] if begun is None else begun
        trial = held - slip_stiffness[:, None] * nodes.slip(now, plate_now)
        trial[~nodes.movable[:, :2]] = 0.0
        misfit = 0.0
        if friction > 0.0:
            bound = friction * np.maximum(force[:, 2], 0.0)
            size = np.hypot(trial[:, 0], trial[:, 1])
            inside = active & ~opens
            over = inside & (size > bound)
            wanted = trial[over] / size[over, None] * bound[over, None]
            off = np.abs(wanted - force[over, :2])
            misfit = float(off.max(initial=0.0)) / max(friction * largest, 1e-300)
            status[inside] = STICK
            status[over] = SLIP
        status[opens] = OPEN
        status[closes] = SLIP if friction == 0.0 or target.slides else STICK
        if np.array_equal(status, before) and (misfit < TOLERANCE or friction == 0.0):
            return Response(moved, force, plate_now, status)
        key = status.tobytes()
        one_at_a_time = one_at_a_time or seen.count(key) > 2
        seen.append(key)
    if misfit < 1e-3:
        return Response(moved, force, plate_now, status)
    raise NotSettled(f"contact and friction did not settle (misfit {misfit:.1e})")


class _System:
    """Linear equations of nodes that are open, stick or slip as `status` (m,) says.

    Unknown are the components of the nodes that nothing holds, then how far the plate (3,) goes
    along the axes whose force is given; the last column is the load.
    """

    def __init__(
        self, nodes: Nodes, status: np.ndarray, plate: np.ndarray, target: Plate, friction: float
    ) -> None:
        self.nodes, self.status, self.plate, self.target = nodes, status, plate, target
        self.friction, self.loaded = friction, target.loaded
        m, stiffness, active = len(status), nodes.stiffness, status != OPEN
        held = np.zeros((m, 3), dtype=bool)
        held[active, 2] = True
        if friction > 0.0 and nodes.spring is None:
            held[status == STICK, :2] = True
        held |= ~nodes.movable
        known = np.zeros((m, 3))
        by_plate = np.zeros((m, 3, len(self.loaded)))
        on_plate = held & nodes.movable & active[:, None]
        goal = np.column_stack([nodes.anchor + plate[:2], np.full(m, plate[2])])
        known[on_plate] = (goal - nodes.positions)[on_plate]
        for column, axis in enumerate(self.loaded):
            by_plate[on_plate[:, axis], axis, column] = 1.0
        self.free = np.flatnonzero(~held.ravel())
        self.fixed = fixed = np.flatnonzero(held.ravel())
        self.known, self.by_plate = known.ravel()[fixed], by_plate.reshape(3 * m, -1)[fixed]
        self.columns = np.concatenate(
            [
                stiffness[:, self.free],
                stiffness[:, fixed] @ self.by_plate,
                (nodes.internal + stiffness[:, fixed] @ self.known)[:, None],
            ],
            axis=1,
        )
        self.rows = self.columns[self.free]

    def set_friction(
        self, trial: np.ndarray, normal: np.ndarray, slip_stiffness: np.ndarray
    ) -> None:
        """Put the law of friction, linearised, in the rows of the nodes that may slip.

        trial (m, 2): friction (N) that would stop the slip; normal (m,): force (N); slip_stiffness
        (m,) as in `Nodes`.
        """
        nodes, columns, free = self.nodes, self.columns, self.free
        spring = nodes.spring
        slipping = np.flatnonzero(self.status == SLIP if spring is None else self.status != OPEN)
        if not len(slipping):
            return
        size = np.hypot(trial[slipping, 0], trial[slipping, 1])
        size = np.where(size > 0, size, 1.0)
        e = trial[slipping] / size[:, None]
        beta = np.minimum(self.friction * normal[slipping] / size, 1.0)
        where = np.full(columns.shape[0], -1)
        where[free] = np.arange(len(free))
        elastic = self.status[slipping] == STICK
        e[elastic] = 0.0
        beta[elastic] = 1.0
        across = np.eye(2) - e[:, :, None] * e[:, None, :]
        stiff = beta * slip_stiffness[slipping]
        slip = nodes.slip(nodes.positions, self.plate)[slipping]
        fx, fy, fz = (columns[3 * slipping + k] for k in range(3))
        for k in range(2):
            own = (fx, fy)[k].copy()
            if spring is None:
                own -= beta[:, None] * (across[:, k, :1] * fx + across[:, k, 1:] * fy)
            else:
                own[:, -1] -= beta * np.sum(across[:, k] * spring[1][slipping], axis=1)
            own -= self.friction * e[:, k, None] * fz
            for n in range(2):
                factor = stiff * across[:, k, n]
                there = where[3 * slipping + n]
                ok = there >= 0
                own[np.flatnonzero(ok), there[ok]] += factor[ok]
                own[:, len(free) + np.flatnonzero(self.loaded == n)] -= factor[:, None]
                own[:, -1] += factor * slip[:, n]
            there = where[3 * slipping + k]
            ok = there >= 0
            self.rows[there[ok]] = own[ok]

    def solve(self) -> tuple[np.ndarray, np.ndarray]:
        """Displacements (m, 3) of the nodes, and the plate (3,). Raises NotConverged."""
        columns, free, loaded = self.columns, self.free, self.loaded
        active = np.flatnonzero(self.status != OPEN)
        sums = np.zeros((len(loaded), columns.shape[1]))
        for row, axis in enumerate(loaded):
            sums[row] = columns[3 * active + axis].sum(axis=0)
            sums[row, -1] -= self.target.force[axis]
        system = np.concatenate([self.rows, sums])
        try:
            unknown = np.linalg.solve(system[:, :-1], -system[:, -1])
        except np.linalg.LinAlgError:
            raise NotConverged("the contact problem is singular") from None
        rise = unknown[len(free) :]
        moved = np.empty(columns.shape[0])
        moved[free] = unknown[: len(free)]
        moved[self.fixed] = self.known + self.by_plate @ rise
        plate = self.plate.copy()
        plate[loaded] += rise
        return moved.reshape(-1, 3), plate


def _worst(mask: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Only the smallest of the values in a mask."""
    out = np.zeros_like(mask)
    if mask.any():
        candidates = np.flatnonzero(mask)
        out[candidates[np.argmin(value[candidates])]] = True
    return out
