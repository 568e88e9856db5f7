# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Static condensation onto the contact: nested dissection with dense blocks.

The mesh is divided in two again and again. Each part, from the smallest up, eliminates the
unknowns that no other part shares (Cholesky, by LAPACK) and hands the rest of its matrix to the
part above (multifrontal method: Duff and Reid 1983; nested dissection: George 1973). The unknowns
of the possible contact are never eliminated: what is left at the top is the dense stiffness of the
finger as the plate feels it. Contact and friction, with their changing sets and unsymmetric rows,
are then solved in that small matrix. No general sparse solver gives this matrix under a permissive
licence, see docs/dependencies.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dsyrk, dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf

from ..compiled import njit


class NotPositive(Exception):
    """The stiffness is not positive definite."""


@njit(cache=True)
def _add(source, where, eliminated, a11, a21, a22):
    """Add the lower triangle of a symmetric block at places `where` (k,) of a front."""
    k = where.shape[0]
    for j in range(k):
        pj = where[j]
        if pj < 0:
            continue
        for i in range(j, k):
            pi = where[i]
            if pi < 0:
                continue
            row, column = (pi, pj) if pi >= pj else (pj, pi)
            if row < eliminated:
                a11[row, column] += source[i, j]
            elif column < eliminated:
                a21[row - eliminated, column] += source[i, j]
            else:
                a22[row - eliminated, column - eliminated] += source[i, j]


@dataclass
class _Part:
    """A part of the mesh and its front, the dense matrix in which it is eliminated.

    children: its halves, or none; unknowns (n,): of the front, the eliminated ones first; sources:
    elements, or children, whose matrices are added; places: where their unknowns are in the front,
    −1 for those without displacement. l11, l21: columns of the Cholesky factor.
    """

    children: tuple[int, ...]
    unknowns: np.ndarray
    eliminated: int
    sources: Sequence[int]
    places: list[np.ndarray]
    l11: np.ndarray
    l21: np.ndarray


class Condensation:
    """Elimination of all unknowns of a mesh but those of `kept` nodes (m,).

    cells (E, n): nodes of the elements; place (E, 2): positions by which the mesh is divided; fixed
    (N, 3): unknowns without displacement.
    """

    def __init__(
        self, cells: np.ndarray, place: np.ndarray, fixed: np.ndarray, kept: np.ndarray
    ) -> None:
        self.kept = kept
        self._free = ~fixed
        self._cells = cells
        self._place = place
        self._dofs = _unknowns(cells)
        self._dofs[~self._free.ravel()[self._dofs]] = -1
        self._uses = np.bincount(cells.ravel(), minlength=len(fixed))
        self._uses[kept] += 1
        self._position = np.full(fixed.size, -1)
        self.parts: list[_Part] = []
        self._divide(np.arange(len(cells)))
        self.kept_dofs = _unknowns(kept)
        left = self.parts[-1].unknowns[self.parts[-1].eliminated :]
        self._position[left] = np.arange(len(left))
        self._root = self._position[self.kept_dofs]
        self._position[:] = -1

    def _divide(self, elements: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        """Make the part of these elements after its halves.

        Returns its number, its nodes that other parts share, and how often it used each.
        """
        points = self._place[elements]
        order = np.argsort(points[:, int(np.argmax(np.ptp(points, axis=0)))], kind="stable")
        along = points[order, int(np.argmax(np.ptp(points, axis=0)))]
        cuts = np.flatnonzero(np.diff(along) > 1e-9) + 1
        children: tuple[int, ...] = ()
        if len(cuts):
            # The cut nearest the middle that leaves columns of elements whole.
            cut = int(cuts[np.argmin(np.abs(cuts - len(order) / 2))])
            halves = [self._divide(elements[order[:cut]]), self._divide(elements[order[cut:]])]
            children = tuple(number for number, _, _ in halves)
            nodes, where = np.unique(
                np.concatenate([half[1] for half in halves]), return_inverse=True
            )
            uses = np.bincount(where, np.concatenate([half[2] for half in halves])).astype(int)
            sources: Sequence[int] = children
            blocks = [self.parts[c].unknowns[self.parts[c].eliminated :] for c in children]
        else:
            nodes, uses = np.unique(self._cells[elements], return_counts=True)
            sources = elements.tolist()
            blocks = list(self._dofs[elements])
        done = uses == self._uses[nodes]
        front = []
        for some in (nodes[done], nodes[~done]):
            dofs = _unknowns(some)
            front.append(dofs[self._free.ravel()[dofs]])
        unknowns = np.concatenate(front)
        eliminated, size = len(front[0]), len(unknowns)
        self._position[unknowns] = np.arange(size)
        places = [np.where(block >= 0, self._position[block], -1) for block in blocks]
        self._position[unknowns] = -1
        self.parts.append(
            _Part(
                children,
                unknowns,
                eliminated,
                sources,
                places,
                np.zeros((eliminated, eliminated), order="F"),
                np.zeros((size - eliminated, eliminated), order="F"),
            )
        )
        return len(self.parts) - 1, nodes[~done], uses[~done]

    def factorize(self, tangent: np.ndarray) -> np.ndarray:
        """Stiffness (3 m, 3 m) of the kept nodes from those of the elements (E, 3 n, 3 n).

        Rows and columns of unknowns without displacement are zero. Raises NotPositive.
        """
        rest: dict[int, np.ndarray] = {}
        for number, part in enumerate(self.parts):
            n, m = part.eliminated, len(part.unknowns) - part.eliminated
            part.l11[:] = 0.0
            part.l21[:] = 0.0
            a22 = np.zeros((m, m), order="F")
            for source, place in zip(part.sources, part.places):
                block = rest.pop(source) if part.children else tangent[source].T
                _add(block, place, n, part.l11, part.l21, a22)
            if n:
                part.l11, info = dpotrf(part.l11, lower=1, overwrite_a=1, clean=0)
                if info != 0:
                    raise NotPositive
            if n and m:
                part.l21 = dtrsm(1.0, part.l11, part.l21, side=1, lower=1, trans_a=1, overwrite_b=1)
                a22 = dsyrk(-1.0, part.l21, beta=1.0, c=a22, lower=1, overwrite_c=1)
            rest[number] = a22
        root = rest.popitem()[1]
        root = np.tril(root) + np.tril(root, -1).T
        out = np.zeros((len(self.kept_dofs), len(self.kept_dofs)))
        there = np.flatnonzero(self._root >= 0)
        out[np.ix_(there, there)] = root[np.ix_(self._root[there], self._root[there])]
        return out

    def reduce(self, load: np.ndarray) -> np.ndarray:
        """Load (3 m,) on the kept nodes that is equal to loads (3 N,) on all nodes.

        `expand` then uses the same loads.
        """
        work = load.copy()
        self._halfway = work
        for part in self.parts:
            n = part.eliminated
            if not n:
                continue
            own, shared = part.unknowns[:n], part.unknowns[n:]
            done = dtrsv(part.l11, work[own], lower=1)
            work[own] = done
            work[shared] -= part.l21 @ done
        return work[self.kept_dofs]

    def expand(self, displacement: np.ndarray) -> np.ndarray:
        """Displacement (3 N,) under the loads of the last `reduce`, given that (3 m,) of the kept
        nodes.

        Overwrites what `reduce` left.
        """
        out = self._halfway
        out[~self._free.ravel()] = 0.0
        there = self._root >= 0
        out[self.kept_dofs[there]] = displacement[there]
        for part in reversed(self.parts):
            n = part.eliminated
            if not n:
                continue
            own, shared = part.unknowns[:n], part.unknowns[n:]
            out[own] = dtrsv(part.l11, out[own] - part.l21.T @ out[shared], lower=1, trans=1)
        return out


def _unknowns(nodes: np.ndarray) -> np.ndarray:
    """Numbers (…, 3 n) of the displacement components of nodes (…, n)."""
    return (3 * nodes[..., None] + np.arange(3)).reshape(*nodes.shape[:-1], -1)
