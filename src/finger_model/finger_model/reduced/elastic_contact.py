# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Elastic contact of any finger, under loads so sudden or so slow, by Gaussian processes.

Inputs are the context of a finger and what linear contact theory says of it (`linear_contact`);
with these a few thousand presses are enough. Further processes add what the default mesh says more
than the coarse one, from what tells these meshes apart in linear theory.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..compiled import njit, prange
from ..laws import MaxwellLaw
from .kernels import NODES, sudden_strain
from .population import CONTEXT

if TYPE_CHECKING:
    from finger_common.processes import Map

    from ..fem.linear_contact import LinearContact

CONTACT = 3
"""Columns of a curve that are the contact's: ln(A/(L² x²)), ln(p_max/p_mean), ln(δ/(L x²))."""

POINTS = 2000
"""Points of a process: presses beyond them enter by projection (subset of regressors)."""
SAMPLE = 1200
"""Presses by which lengths and noise are chosen."""
ITERATIONS = 30
LEAST_PRESSES = 150
"""A node of the load that fewer presses (or a quarter of all) reached is continued linearly from
those before."""
OUTLIER = 15.0
"""Distance of a press from the processes, over the median one at that load, from which it does not
count there: at single loads a few of the full order's areas are far off."""
SEEN = [1, 2, 4]
"""Nodes of the load at which the networks see the elastic curves."""
LEAST_NOISE = 1e-7
SIDE_BY_SIDE = 16
"""Inputs from which on all cores work."""
_JITTER = 1e-8


def press_contexts(context: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Contexts (2, n, 11) of sudden and slow presses.

    context (n, 10); share (n,): long-term fraction. A slow press is one of a finger of modulus E∞
    whose bulk modulus is larger by 1/share; ln share is the last column.
    """
    less = np.log(share)
    sudden = np.column_stack([context, np.zeros(len(context))])
    slow = sudden.copy()
    for name in ("ln nail bending stiffness", "ln E2/E0"):
        slow[:, CONTEXT.index(name)] -= less
    slow[:, CONTEXT.index("stiffening share")] = slow[:, CONTEXT.index("stiffening")]
    slow[:, -1] = less
    return np.array([sudden, slow])


class LinearGuess(NamedTuple):
    """What linear theory says of sudden and slow presses of n fingers.

    curves (2, n, nodes, 2): ln(A/(L² x²)) and ln(δ/(L x²)) on the coarse mesh; meshes (2, n, 3):
    as of `LinearContact.meshes`.
    """

    curves: np.ndarray
    meshes: np.ndarray


def linear_guess(contact: LinearContact, materials: Sequence[MaxwellLaw]) -> LinearGuess:
    """What linear theory says of a finger of each material."""
    nodes = np.log(NODES)
    both = [m for m in materials for _ in range(2)]
    shares = [share for m in materials for share in (1.0, m.long_term_fraction)]
    found = np.empty((len(both), len(nodes), 2))
    for curve, own in zip(contact.curves(both, shares), found):
        x = curve[:, 0]
        low, high = nodes < x[0], nodes > x[-1]
        for column, y in enumerate(curve[:, 1:].T):
            values = np.interp(nodes, x, y)
            values[low] = y[0] + 2.0 * (nodes[low] - x[0])
            values[high] = y[-1] + (nodes[high] - x[-1])
            own[:, column] = values - 2.0 * nodes
    both_kinds = (v.reshape(-1, 2, *v.shape[1:]) for v in (found, contact.meshes(both, shares)))
    return LinearGuess(*(np.moveaxis(v, 1, 0) for v in both_kinds))


def network_context(context: np.ndarray, share: float, curves: np.ndarray) -> np.ndarray:
    """What the networks see of a finger (23,): its context (10,), ln of the long-term fraction, and
    area and indentation of its elastic curves (2, nodes, 3 + k) on the coarse mesh at three loads.
    """
    return np.concatenate([context, [math.log(share)], curves[:, SEEN][:, :, [0, 2]].ravel()])


def strain_sizes() -> np.ndarray:
    """What strains of a curve (nodes,) are divided by: G at each node."""
    return np.array([sudden_strain(x) for x in NODES])


class Process:
    """Gaussian process of several outputs: kernel 1/(1 + s²/2), s being the distance over a length
    for each input (rational quadratic, α = 1: Rasmussen and Williams 2006, equation 4.19).

    arrays: centre, lengths (d,), points (m, d) scaled, weights (m, o), mean (o,). Raises ValueError
    where they do not belong together: compiled code does not look.
    """

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        shapes = {
            key: arrays[key].shape for key in ("centre", "lengths", "points", "weights", "mean")
        }
        points, outputs = shapes["points"], shapes["mean"]
        wanted = points[-1:], points[-1:], points, points[:1] + outputs, outputs
        if tuple(shapes.values()) != wanted or (len(points), len(outputs)) != (2, 1):
            raise ValueError(f"a Gaussian process has arrays of {shapes}")
        # Column by column, so that several points are worked on at once.
        columns = {key: np.asfortranarray(arrays[key]) for key in ("points", "weights")}
        self.arrays = {**arrays, **columns}

    @classmethod
    def fit(cls, inputs: np.ndarray, outputs: np.ndarray, column: int) -> Process:
        """Fit inputs (n, d) to outputs (n, o); lengths and noise maximise the likelihood of one
        column of a sample (Rasmussen and Williams 2006, section 5.4.1)."""
        # Where a model is built only: half a second to import.
        from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular

        order = np.random.default_rng(0).permutation(len(inputs))
        centre, spread = inputs.mean(0), inputs.std(0) + 1e-9
        mean, size = outputs.mean(0), outputs.std(0)
        z = (inputs - centre) / spread
        residual = (outputs - mean) / size
        sample = order[:SAMPLE]
        lengths, gain, noise = _chosen(z[sample], residual[sample, column])
        z /= lengths
        # In single precision; the weights, large and of both signs, belong to these very points.
        kept = z[order[:POINTS]].astype(np.float32)
        points = kept.astype(float)
        own = gain * _kernel(points, points)
        if len(z) <= POINTS:
            own[np.diag_indices(len(own))] += noise
            weights = cho_solve(cho_factor(own, lower=True), residual[order])
        else:
            own[np.diag_indices(len(own))] += _JITTER * gain
            factor = cholesky(own, lower=True)
            across = solve_triangular(factor, gain * _kernel(points, z), lower=True)
            normal = across @ across.T
            normal[np.diag_indices(len(normal))] += noise
            weights = cho_solve(cho_factor(normal, lower=True), across @ residual)
            weights = solve_triangular(factor, weights, lower=True, trans=1)
        return cls(
            {
                "centre": centre,
                "lengths": spread * lengths,
                "points": kept,
                "weights": gain * weights * size,
                "mean": mean,
            }
        )

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """Outputs (n, o) at inputs (n, d); those of a row do not depend on the other rows."""
        a = self.arrays
        found = np.tile(a["mean"], (len(inputs), 1))
        add = _add_outputs if len(inputs) < SIDE_BY_SIDE else _add_outputs_side_by_side
        add((inputs - a["centre"]) / a["lengths"], a["points"].T, a["weights"].T, found)
        return found


@njit(cache=True, nogil=True)
def _add_row(z, points, weights, out):
    """out (o,) += kernel of z (d,) and points (d, m), times weights (o, m)."""
    near = np.ones(points.shape[1])
    if len(points) % 2:
        near += 0.5 * (z[0] - points[0]) ** 2
    # Two columns at once, which is faster.
    for k in range(len(points) % 2, len(points), 2):
        a, b = z[k], z[k + 1]
        near += 0.5 * ((a - points[k]) ** 2 + (b - points[k + 1]) ** 2)
    # Not by BLAS: its threads take longer to wake up than this takes.
    for column in range(len(weights)):
        out[column] += np.sum(weights[column] / near)


# Two functions: see `compiled`.
@njit(cache=True, nogil=True)
def _add_outputs(z, points, weights, out):
    for row in range(len(z)):
        _add_row(z[row], points, weights, out[row])


@njit(cache=True, nogil=True, parallel=True)
def _add_outputs_side_by_side(z, points, weights, out):
    for row in prange(len(z)):
        _add_row(z[row], points, weights, out[row])


def _kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    square = (a * a).sum(1)[:, None] + (b * b).sum(1) - 2.0 * a @ b.T
    return 1.0 / (1.0 + 0.5 * np.maximum(square, 0.0))


def _chosen(z: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Lengths (d,), gain and noise of the largest marginal likelihood of y (n,) at z (n, d)."""
    count = z.shape[1]
    found = np.concatenate([np.full(count, math.log(3.0)), [0.0, math.log(1e-3)]])
    # Half of the presses first: from far away the search among all may get stuck.
    for part in (len(y) // 2, len(y)):
        found = _likeliest(z[:part], y[:part], found)
    noise = max(math.exp(found[count + 1]), LEAST_NOISE)
    return np.exp(found[:count]), math.exp(found[count]), noise


def _likeliest(z: np.ndarray, y: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Logarithms of lengths, gain and noise (d + 2,) of the largest likelihood near a start."""
    from scipy.linalg import cho_factor, cho_solve
    from scipy.optimize import minimize

    count = z.shape[1]
    squares = np.array([(column[:, None] - column) ** 2 for column in z.T])

    def negative(p: np.ndarray) -> tuple[float, np.ndarray]:
        lengths, gain, noise = np.exp(p[:count]), math.exp(p[count]), math.exp(p[count + 1])
        near = 1.0 / (1.0 + 0.5 * np.tensordot(1.0 / lengths**2, squares, 1))
        kernel = gain * near
        whole = kernel + (noise + 1e-9) * np.eye(len(y))
        factor = cho_factor(whole, lower=True)
        weights = cho_solve(factor, y)
        slope = cho_solve(factor, np.eye(len(y))) - np.outer(weights, weights)
        value = 0.5 * y @ weights + np.log(np.diag(factor[0])).sum()
        weighted = slope * kernel * near
        rises = 0.5 * np.tensordot(squares, weighted, ([1, 2], [0, 1])) / lengths**2
        rest = [0.5 * (slope * kernel).sum(), 0.5 * noise * np.trace(slope)]
        return float(value), np.concatenate([rises, rest])

    bounds = [(-1.0, 5.0)] * count + [(-6.0, 8.0), (-18.0, 0.0)]
    result = minimize(
        negative,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": ITERATIONS},
    )
    return np.asarray(result.x)


def size_and_direction(strains: np.ndarray) -> np.ndarray:
    """ln |d| and d/|d| (n, 1 + k) of strains d (n, k): under stiffening |d| varies by decades."""
    size = np.linalg.norm(strains, axis=1)[:, None]
    return np.column_stack([np.log(size), strains / size])


class ElasticContacts:
    """Curves of sudden and slow presses of any finger of the population box.

    For each node of the load, or fewer nodes where too few presses reached, both have a process of
    area and pressure and one of the indentation; `coarse` also has one of the strain, which takes
    the contact as inputs too.
    """

    def __init__(self, coarse: list[list[Process]], finer: list[list[Process]]) -> None:
        self.coarse, self.finer = coarse, finer

    @classmethod
    def fit(
        cls,
        contexts: np.ndarray,
        guess: LinearGuess,
        coarse: np.ndarray,
        finer: np.ndarray,
        report: Callable[[float], None],
        each: Map = map,
    ) -> ElasticContacts:
        """Fit presses on the coarse mesh (2, n, nodes, 3 + k) and the first f of them on the
        default one (2, f, nodes, 3), NaN where there is none; contexts (2, n, 11) and guess of the
        n fingers; `each` does the work of the processes of a node."""
        sizes = strain_sizes()
        more = finer - coarse[:, : finer.shape[1], :, :CONTACT]
        found: tuple[list[list[Process]], list[list[Process]]] = ([], [])
        for node in range(len(NODES)):
            tasks: list[tuple[int, np.ndarray, np.ndarray]] = []
            for which, values in enumerate((coarse, more)):
                inputs = cls._inputs(contexts, guess, node, meshes=which == 1)
                inputs = inputs[:, : values.shape[1]].reshape(-1, inputs.shape[-1])
                outputs = values[:, :, node].reshape(len(inputs), -1).copy()
                reached = np.isfinite(outputs[:, 0])
                least = min(LEAST_PRESSES, len(inputs) // 4)
                if reached.sum() < least or len(found[which]) < node:
                    continue
                if which == 0:
                    outputs[:, [0, 2]] -= guess.curves[:, :, node].reshape(-1, 2)
                inputs, outputs = inputs[reached], outputs[reached]
                contact = outputs[:, :CONTACT]
                tasks += [(which, inputs, part) for part in (contact[:, :2], contact[:, 2:])]
                if which == 0:
                    strain = size_and_direction(outputs[:, CONTACT:] / sizes[node])
                    tasks.append((which, np.column_stack([inputs, contact]), strain))
                found[which].append([])
            for task, process in zip(
                tasks, each(lambda task: Process.fit(task[1], task[2], 0), tasks)
            ):
                found[task[0]][-1].append(process)
            report((node + 1) / len(NODES))
        return cls(*found)

    def without_outliers(
        self, contexts: np.ndarray, guess: LinearGuess, coarse: np.ndarray, finer: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The presses as of `fit`, to which self was fitted, NaN at the loads of outliers."""
        n = finer.shape[1]
        found = self.coarse_curves(contexts, guess)
        part = LinearGuess(guess.curves[:, :n], guess.meshes[:, :n])
        more = self.default_curves(contexts[:, :n], part, found[:, :n]) - found[:, :n]
        far = _far((coarse - found)[..., :CONTACT])
        finer_far = _far(finer - (coarse[:, :n] + more)[..., :CONTACT])
        return np.where(far, np.nan, coarse), np.where(finer_far, np.nan, finer)

    @staticmethod
    def _inputs(contexts: np.ndarray, guess: LinearGuess, node: int, meshes: bool) -> np.ndarray:
        parts = [contexts, guess.curves[:, :, node]]
        return np.concatenate([*parts, guess.meshes] if meshes else parts, axis=-1)

    def coarse_curves(self, contexts: np.ndarray, guess: LinearGuess) -> np.ndarray:
        """Curves (2, n, nodes, 3 + k) at NODES, strains over G, on the coarse mesh, of n fingers of
        contexts (2, n, 11)."""
        found = []
        for node, own in enumerate(self.coarse):
            inputs = self._inputs(contexts, guess, node, meshes=False)
            inputs = inputs.reshape(-1, inputs.shape[-1])
            contact = np.column_stack([process(inputs) for process in own[:2]])
            size = own[2](np.column_stack([inputs, contact]))
            contact[:, [0, 2]] += guess.curves[:, :, node].reshape(-1, 2)
            found.append(np.column_stack([contact, np.exp(size[:, :1]) * size[:, 1:]]))
        curves = extended(np.stack(found, axis=1))
        return curves.reshape(*contexts.shape[:2], *curves.shape[1:])

    def default_curves(
        self, contexts: np.ndarray, guess: LinearGuess, coarse: np.ndarray
    ) -> np.ndarray:
        """The same on the default mesh, from those on the coarse one."""
        found = coarse[:, :, : len(self.coarse)].reshape(-1, len(self.coarse), coarse.shape[-1])
        found = found.copy()
        for node in range(len(self.coarse)):
            last = min(node, len(self.finer) - 1)
            inputs = self._inputs(contexts, guess, node, meshes=True)
            inputs = inputs.reshape(-1, inputs.shape[-1])
            more = [process(inputs) for process in self.finer[last]]
            found[:, node, :CONTACT] += np.column_stack(more)
        return extended(found).reshape(coarse.shape)

    def arrays(self) -> dict[str, np.ndarray]:
        """As stored in the file of the reduced model."""
        return {
            f"elastic_{stage}_{node}_{which}_{key}": value
            for stage in ("coarse", "finer")
            for node, own in enumerate(getattr(self, stage))
            for which, process in enumerate(own)
            for key, value in process.arrays.items()
        }

    @classmethod
    def of_arrays(cls, arrays: dict[str, np.ndarray]) -> ElasticContacts:
        """From `arrays`. Raises KeyError for missing ones."""
        keys = ("centre", "lengths", "points", "weights", "mean")

        def stage(name: str, processes: int) -> list[list[Process]]:
            found: list[list[Process]] = []
            while f"elastic_{name}_{len(found)}_0_centre" in arrays:
                begin = f"elastic_{name}_{len(found)}"
                found.append(
                    [
                        Process({key: arrays[f"{begin}_{which}_{key}"] for key in keys})
                        for which in range(processes)
                    ]
                )
            return found

        return cls(stage("coarse", 3), stage("finer", 2))


def _far(residual: np.ndarray) -> np.ndarray:
    """Which presses (2, n, nodes, 1) are outliers in one of their residuals (2, n, nodes, o)."""
    sizes = np.ma.masked_invalid(np.abs(residual))
    median = np.ma.median(sizes, axis=1, keepdims=True)
    return (sizes > OUTLIER * median).filled(False).any(axis=-1, keepdims=True)


def extended(curves: np.ndarray) -> np.ndarray:
    """Curves (n, r, o) of the first r nodes, or of those before the first NaN, continued linearly
    in ln x to all nodes (n, nodes, o)."""
    u = np.log(NODES)
    found = np.empty((len(curves), len(NODES), curves.shape[-1]))
    for own, whole in zip(curves, found):
        r = int(np.isfinite(own[:, 0]).sum())
        whole[:r] = own[:r]
        rise = (own[r - 1] - own[r - 2]) / (u[r - 1] - u[r - 2])
        whole[r:] = own[r - 1] + rise * (u[r:] - u[r - 1])[:, None]
    return found
