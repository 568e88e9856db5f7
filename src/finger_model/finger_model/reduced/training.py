# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Training of the reduced model's networks on full-order runs, by Levenberg and Marquardt's method.

Two hidden layers of the smooth sigmoid v/√(1 + v²), weighted least squares over all rows of the
runs. First the drive, on the full order's own states; then the contact network on the states that
the reduced model visits with that drive, so that it makes up for what the drive leaves
(`build.train`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from . import kernels as rk
from .maps import sigmoid
from .training_runs import Run

FIRST_FORCE = 0.04
"""N; below it the area is not trained on."""

ROWS = 2048
"""Rows of the Jacobian that are held at a time."""

RIDGE = 1e-6
"""Weight of the squares of a network's values."""


@dataclass
class Samples:
    """Inputs (n, i), targets (n, o) and weights (n, o) of a network."""

    inputs: np.ndarray
    targets: np.ndarray
    weights: np.ndarray


def features(
    x: np.ndarray, a: np.ndarray, q: np.ndarray | None, stiffness: np.ndarray
) -> np.ndarray:
    """Inputs of a network (n, 3 + k + m + 1), in the order of `kernels`."""
    scale = strain_scales(x, a)
    columns = [x, np.log(x + rk.SHIFT_LOG), np.log(scale + rk.SHIFT_STRAIN), a / scale[:, None]]
    columns += [q] if q is not None else []
    return np.column_stack([*columns, stiffness])


def strain_scales(x: np.ndarray, a: np.ndarray) -> np.ndarray:
    """S (n,) of load measures (n,) and amplitudes (n, k)."""
    return np.array([rk.strain_scale(*row) for row in zip(x, np.ascontiguousarray(a))])


def drive_targets(depth: np.ndarray, drive: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """What the drive network gives (n, 1 + k) for δ/L (n,) and c (n, k)."""
    return np.column_stack([depth / scale ** (2 / 3), drive / scale[:, None]])


def load_measure(run: Run, length: float) -> np.ndarray:
    """x (n,) along a run."""
    return np.cbrt(np.maximum(run.force, 0.0) / (run.parameters[0] * length**2))


def drive_samples(run: Run, length: float, latents: int, count: float = 1.0) -> Samples:
    """Samples of δ/L and c of one run that counts so much."""
    x = load_measure(run, length)
    stiffness = np.full(len(x), math.log(run.parameters[3] / run.parameters[0]))
    inputs = features(x, run.internal[:, :latents], None, stiffness)
    delta = run.indentation / length
    scale = strain_scales(x, run.internal[:, :latents])
    targets = drive_targets(delta, (run.total - run.internal)[:, :latents], scale)
    weights = np.repeat(scale[:, None], targets.shape[1], axis=1)
    # Indentation counts relative to the run's largest.
    weights[:, 0] = scale ** (2 / 3) * 0.2 / max(delta.max(), 0.06)
    return Samples(inputs, targets, count * weights)


def contact_samples(
    run: Run, length: float, latents: int, states: np.ndarray, count: float = 1.0
) -> Samples:
    """Samples of ln(A/(L² x²)) and ln(p_max/p_mean) of one run that counts so much.

    states (n, k + m): a and q that were visited. The error of the area counts relative to the run's
    largest area.
    """
    touching = (run.force >= FIRST_FORCE) & (run.area > 0) & (run.peak > 0)
    x = load_measure(run, length)[touching]
    area, peak, force = run.area[touching], run.peak[touching], run.force[touching]
    states = states[touching]
    stiffness = np.full(len(x), math.log(run.parameters[3] / run.parameters[0]))
    inputs = features(x, states[:, :latents], states[:, latents:], stiffness)
    targets = np.column_stack([np.log(area / (length * x) ** 2), np.log(peak * area / force)])
    share = count * area / run.area.max()
    return Samples(inputs, targets, np.column_stack([share, 0.1 * share]))


def stack(parts: list[Samples]) -> Samples:
    """All samples in one."""
    return Samples(
        *(np.concatenate([getattr(p, f) for p in parts]) for f in ("inputs", "targets", "weights"))
    )


class Network:
    """Two hidden layers with sigmoid v/√(1 + v²); inputs and outputs scaled."""

    def __init__(self, samples: Samples, hidden: int, seed: int = 0) -> None:
        x, t = samples.inputs, samples.targets
        self.input_mean = x.mean(0)
        self.input_scale = x.std(0) + 1e-12
        self.output_mean = t.mean(0)
        self.output_scale = t.std(0) + 1e-12
        n, outputs = x.shape[1], t.shape[1]
        self.shapes = [
            *((n, hidden), (hidden,)),
            *((hidden, hidden), (hidden,)),
            *((hidden, outputs), (outputs,)),
        ]
        self._ends = np.cumsum([math.prod(shape) for shape in self.shapes])[:-1]
        rng = np.random.default_rng(seed)
        self.values = np.concatenate(
            [
                (rng.normal(size=s) * (1 / math.sqrt(s[0]) if len(s) > 1 else 0.3)).ravel()
                for s in self.shapes
            ]
        )

    def split(self, values: np.ndarray) -> list[np.ndarray]:
        """Layers (…, *shape) of values (…, P), as views."""
        parts = np.split(values, self._ends, axis=-1)
        return [p.reshape(*p.shape[:-1], *shape) for p, shape in zip(parts, self.shapes)]

    def outputs(self, values: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Scaled outputs (n, o) of scaled inputs x (n, i)."""
        w1, b1, w2, b2, w3, b3 = self.split(values)
        return sigmoid(sigmoid(x @ w1 + b1)[0] @ w2 + b2)[0] @ w3 + b3

    def jacobians(self, values: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """Scaled outputs (n, o), and for each the derivatives (n, P) with respect to all values."""
        w1, b1, w2, b2, w3, b3 = self.split(values)
        z1, s1 = sigmoid(x @ w1 + b1)
        z2, s2 = sigmoid(z1 @ w2 + b2)
        n, outputs = len(x), w3.shape[1]
        found = []
        for j in range(outputs):
            matrix = np.zeros((n, len(values)), values.dtype)
            parts = self.split(matrix)
            g2 = s2 * w3[:, j]
            g1 = (g2 @ w2.T) * s1
            np.multiply(x[:, :, None], g1[:, None, :], out=parts[0])
            parts[1][...] = g1
            np.multiply(z1[:, :, None], g2[:, None, :], out=parts[2])
            parts[3][...] = g2
            parts[4][:, :, j] = z2
            parts[5][:, j] = 1.0
            found.append(matrix)
        return z2 @ w3 + b3, found

    def arrays(self, name: str) -> dict[str, np.ndarray]:
        """As stored in the file of the reduced model, with the network's name before each."""
        names = ("weights_1", "bias_1", "weights_2", "bias_2", "weights_3", "bias_3")
        found = {
            **dict(zip(names, (v.copy() for v in self.split(self.values)))),
            "input_mean": self.input_mean,
            "input_scale": self.input_scale,
            "output_mean": self.output_mean,
            "output_scale": self.output_scale,
        }
        return {f"{name}_{key}": value for key, value in found.items()}


def fit(
    network: Network,
    samples: Samples,
    iterations: int,
    report: Callable[[float], None] | None = None,
) -> float:
    """Weighted least squares by Levenberg and Marquardt's method; returns the root mean square
    weighted error.

    The Jacobian is formed in single precision, a block of rows at a time; RIDGE weighs the squares
    of the values. Steps are taken on a quarter of the rows for the first half of the iterations.
    """
    x = (samples.inputs - network.input_mean) / network.input_scale
    t = (samples.targets - network.output_mean) / network.output_scale
    scale = math.sqrt(np.mean(np.sum((samples.weights * network.output_scale) ** 2, axis=1)))
    w = samples.weights * network.output_scale / scale
    order = np.random.default_rng(0).permutation(len(x))
    few = order[: max(len(x) // 4, min(len(x), 4 * len(network.values)))]
    damping = 1e-2
    loss = math.inf
    for iteration in range(iterations):
        early = iteration < iterations // 2
        if iteration == 0 or iteration == iterations // 2:
            rows = few if early else order
            u, goal, weight = x[rows], t[rows], w[rows]
            loss = _loss(network, network.values, u, goal, weight)
        hessian, slope = _normal_equations(network, u, goal, weight)
        hessian[np.diag_indices_from(hessian)] += RIDGE
        slope += RIDGE * network.values
        mean = float(np.mean(np.diag(hessian)))
        for _ in range(10):
            shifted = hessian.copy()
            shifted[np.diag_indices_from(shifted)] += 1e-3 * damping * mean
            try:
                step = cho_solve(cho_factor(shifted, overwrite_a=True), -slope)
            except LinAlgError:
                damping *= 5.0
                continue
            found = _loss(network, network.values + step, u, goal, weight)
            if found < loss:
                network.values = network.values + step
                loss = found
                damping = max(damping / 3.0, 1e-9)
                break
            damping *= 4.0
        if report is not None:
            report((iteration + 1) / iterations)
    error = (network.outputs(network.values, x) - t) * w * scale
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def _loss(network, values, x, t, w) -> float:
    error = (network.outputs(values, x) - t) * w
    return 0.5 * float(np.sum(error**2)) / len(x) + 0.5 * RIDGE * float(values @ values)


def _normal_equations(network, x, t, w) -> tuple[np.ndarray, np.ndarray]:
    """JᵀJ (P, P) and Jᵀr (P,) of the weighted errors, over the number of rows."""
    values = network.values.astype(np.float32)
    hessian = np.zeros((len(values), len(values)), np.float32)
    slope = np.zeros(len(values))
    for begin in range(0, len(x), ROWS):
        rows = slice(begin, begin + ROWS)
        y, jacobians = network.jacobians(values, x[rows].astype(np.float32))
        error = (y - t[rows]) * w[rows]
        for j, matrix in enumerate(jacobians):
            matrix *= w[rows, j, None].astype(np.float32)
            hessian += matrix.T @ matrix
            slope += matrix.T @ error[:, j].astype(np.float32)
    return hessian.astype(float) / len(x), slope / len(x)
