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


class Sliding(Exception):
    """No node sticks, and the tangential force is given: the plate slides away."""


class Response(NamedTuple):
    """Displacement (m, 3) and force (m, 3) of the nodes, plate (3,), status (m,)."""

    displacement: np.ndarray
    force: np.ndarray
    plate: np.ndarray
    status: np.ndarray


def respond(
    stiffness: np.ndarray,
    internal: np.ndarray,
    positions: np.ndarray,
    movable: np.ndarray,
    anchor: np.ndarray,
    status: np.ndarray,
    force: np.ndarray,
    plate: np.ndarray,
    target: Plate,
    friction: float,
    spring: tuple[np.ndarray, np.ndarray] | None = None,
) -> Response:
    """Displacements of m nodes for which contact and friction hold, f = internal + stiffness · u.

    stiffness (3 m, 3 m); internal (3 m,): force (N) that holds the nodes at positions (m, 3);
    movable (m, 3): whether a component can move; anchor (m, 2), status (m,), force (m, 3), plate
    (3,): as in `Contact`, the last three as a first guess. spring: stiffness (m,) in N/m of
    sticking nodes, and `Contact.begun`; without it they do not move on the plate. Raises
    NotConverged or Sliding.
    """
    fixed = stiffness, internal, positions, movable, anchor
    try:
        return _settle(*fixed, status, force, plate, target, friction, spring)
    except NotConverged:
        if friction == 0.0 or target.slides:
            raise
        # After a turn of the load everything sticks at first.
        held = np.where(status == SLIP, STICK, status)
        return _settle(*fixed, held, force, plate, target, friction, spring)


def _settle(
    stiffness: np.ndarray,
    internal: np.ndarray,
    positions: np.ndarray,
    movable: np.ndarray,
    anchor: np.ndarray,
    status: np.ndarray,
    force: np.ndarray,
    plate: np.ndarray,
    target: Plate,
    friction: float,
    spring: tuple[np.ndarray, np.ndarray] | None,
) -> Response:
    """`respond` from one guess."""
    m = len(positions)
    status = status.copy()
    force = force.copy()
    plate = np.where(np.isnan(target.position), plate, target.position)
    loaded = target.loaded
    pulled = bool(np.any(loaded < 2))
    if pulled and friction == 0.0:
        raise Sliding
    loose = 0
    diagonal = np.diag(stiffness).reshape(m, 3)
    scale = np.where(diagonal[:, 0] > 0, diagonal[:, 0], diagonal[:, 2])
    begun = force[:, :2]
    if spring is not None:
        scale, begun = spring
    slip = positions[:, :2] - plate[:2] - anchor
    # Guess of the slip direction of nodes that already slip: that of their friction.
    trial = force[:, :2].copy()
    moved = np.zeros(3 * m)
    misfit = math.inf
    seen: list[bytes] = []
    one_at_a_time = False
    for _ in range(ITERATIONS):
        active = status != OPEN
        if len(loaded) and not active.any():
            raise NotConverged("no node touches")
        if pulled and not np.any(status == STICK):
            # The node nearest to sticking holds the plate until the others settle.
            loose += 1
            if loose > LOOSE:
                raise Sliding
            bound = friction * np.maximum(force[:, 2], 0.0)
            excess = np.where(active, np.hypot(trial[:, 0], trial[:, 1]) - bound, np.inf)
            status[np.argmin(excess)] = STICK
        held = np.zeros((m, 3), dtype=bool)
        held[active, 2] = True
        if friction > 0.0 and spring is None:
            held[status == STICK, :2] = True
        held |= ~movable
        known = np.zeros((m, 3))
        by_plate = np.zeros((m, 3, len(loaded)))
        on_plate = held & movable & active[:, None]
        goal = np.column_stack([anchor + plate[:2], np.full(m, plate[2])])
        known[on_plate] = (goal - positions)[on_plate]
        for column, axis in enumerate(loaded):
            by_plate[on_plate[:, axis], axis, column] = 1.0
        free = np.flatnonzero(~held.ravel())
        fixed = np.flatnonzero(held.ravel())
        by_plate_flat = by_plate.reshape(3 * m, -1)
        columns = np.concatenate(
            [
                stiffness[:, free],
                stiffness[:, fixed] @ by_plate_flat[fixed],
                (internal + stiffness[:, fixed] @ known.ravel()[fixed])[:, None],
            ],
            axis=1,
        )
        rows = columns[free]
        tangential = status == SLIP if spring is None else active
        slipping = np.flatnonzero(tangential) if friction > 0.0 else np.empty(0, dtype=int)
        if len(slipping):
            normal = np.maximum(force[slipping, 2], 0.0)
            size = np.hypot(trial[slipping, 0], trial[slipping, 1])
            size = np.where(size > 0, size, 1.0)
            e = trial[slipping] / size[:, None]
            beta = np.minimum(friction * normal / size, 1.0)
            where = np.full(3 * m, -1)
            where[free] = np.arange(len(free))
            elastic = status[slipping] == STICK
            e[elastic] = 0.0
            beta[elastic] = 1.0
            across = np.eye(2) - e[:, :, None] * e[:, None, :]
            fx, fy, fz = (columns[3 * slipping + k] for k in range(3))
            for k in range(2):
                own = (fx, fy)[k].copy()
                if spring is None:
                    own -= beta[:, None] * (across[:, k, :1] * fx + across[:, k, 1:] * fy)
                else:
                    own[:, -1] -= beta * np.sum(across[:, k] * begun[slipping], axis=1)
                own -= friction * e[:, k, None] * fz
                stiff = beta * scale[slipping]
                for n in range(2):
                    factor = stiff * across[:, k, n]
                    there = where[3 * slipping + n]
                    ok = there >= 0
                    own[np.flatnonzero(ok), there[ok]] += factor[ok]
                    for column, axis in enumerate(loaded):
                        if axis == n:
                            own[:, len(free) + column] -= factor
                    own[:, -1] += factor * (positions[slipping, n] - plate[n] - anchor[slipping, n])
                there = where[3 * slipping + k]
                ok = there >= 0
                rows[there[ok]] = own[ok]
        sums = np.zeros((len(loaded), columns.shape[1]))
        for row, axis in enumerate(loaded):
            sums[row] = columns[3 * np.flatnonzero(active) + axis].sum(axis=0)
            sums[row, -1] -= target.force[axis]
        system = np.concatenate([rows, sums])
        try:
            unknown = np.linalg.solve(system[:, :-1], -system[:, -1])
        except np.linalg.LinAlgError:
            raise NotConverged("the contact problem is singular") from None
        rise = unknown[len(free) :]
        moved[free] = unknown[: len(free)]
        moved[fixed] = known.ravel()[fixed] + by_plate_flat[fixed] @ rise
        plate_now = plate.copy()
        plate_now[loaded] += rise
        force = (internal + stiffness @ moved).reshape(m, 3)
        force[~active] = 0.0
        force[~movable] = 0.0
        # New sets.
        now = positions + moved.reshape(m, 3)
        gap = now[:, 2] - plate_now[2]
        slip = now[:, :2] - plate_now[:2] - anchor
        largest = float(force[:, 2].max(initial=0.0))
        before = status.copy()
        opens = active & (force[:, 2] < -1e-12 * largest)
        closes = ~active & (gap < -1e-13)
        if one_at_a_time:
            opens, closes = _worst(opens, force[:, 2]), _worst(closes, gap)
        if opens.sum() == active.sum() and not closes.any():
            opens[np.argmax(force[:, 2])] = False
        trial = (force[:, :2] if spring is None else begun) - scale[:, None] * slip
        trial[~movable[:, :2]] = 0.0
        misfit = 0.0
        if friction > 0.0:
            bound = friction * np.maximum(force[:, 2], 0.0)
            size = np.hypot(trial[:, 0], trial[:, 1])
            sticks = size <= bound
            inside = active & ~opens
            wanted = force[:, :2].copy()
            over = inside & ~sticks
            wanted[over] = trial[over] / size[over, None] * bound[over, None]
            off = np.abs(wanted - force[:, :2])[inside & ~sticks]
            misfit = float(off.max(initial=0.0)) / max(friction * largest, 1e-300)
            status[inside & sticks] = STICK
            status[inside & ~sticks] = SLIP
        status[opens] = OPEN
        status[closes] = SLIP if friction == 0.0 or target.slides else STICK
        if np.array_equal(status, before) and (misfit < TOLERANCE or friction == 0.0):
            return Response(moved.reshape(m, 3).copy(), force, plate_now, status)
        key = status.tobytes()
        one_at_a_time = one_at_a_time or seen.count(key) > 2
        seen.append(key)
    if misfit < 1e-3:
        return Response(moved.reshape(m, 3).copy(), force, plate_now, status)
    raise NotConverged(f"contact and friction did not settle (misfit {misfit:.1e})")


def _worst(mask: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Only the smallest of the values in a mask."""
    out = np.zeros_like(mask)
    if mask.any():
        candidates = np.flatnonzero(mask)
        out[candidates[np.argmin(value[candidates])]] = True
    return out
