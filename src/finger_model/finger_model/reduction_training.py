"""Training of the reduced model's network on full-order runs.

First the maps themselves, sample by sample (`fit_samples`); then the whole model along the histories
(`reduction_rollout.fit_histories`), where the error that counts is. Smooth sigmoid v/√(1 + v²), two hidden layers,
L-BFGS on all samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from . import reduced_kernels as rk
from .reduction_runs import Run

BETAS = (0.03, 0.15)
"""Memory of the friction states, in logarithm of indentation."""


@dataclass
class Samples:
    """Inputs (n, 2 + 2k + m + 1), targets (n, 3 + k) and weights (n, 3 + k) of the network."""

    inputs: np.ndarray
    targets: np.ndarray
    weights: np.ndarray


def friction_states(indentation: np.ndarray, force: np.ndarray, betas: np.ndarray) -> np.ndarray:
    """q (n, m) along δ/L (n,): see reduced_kernels."""
    q = np.ones((len(force), len(betas)))
    now = np.ones(len(betas))
    before = 0.01
    for i, (delta, f) in enumerate(zip(np.maximum(indentation, 0.01), force)):
        if f > 0:
            change = math.log(delta / before)
            sign = 1.0 if change > 0 else -1.0
            now = sign + (now - sign) * np.exp(-abs(change) / betas)
        else:
            now = np.ones(len(betas))
        q[i] = now
        before = delta
    return q


def features(x: np.ndarray, a: np.ndarray, q: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Inputs of the network (…, 2 + 2k + m + 1): x, ln(x + …), a, a/(x + …), q, ln E2/E0; see reduced_kernels."""
    return np.concatenate(
        [
            x[..., None],
            np.log(x + rk.SHIFT_LOG)[..., None],
            a,
            a / (x + rk.SHIFT_RATIO)[..., None],
            q,
            stiffness[..., None],
        ],
        axis=-1,
    )


def samples_of(run: Run, length: float, latents: int, betas: np.ndarray) -> Samples:
    """Samples of one run; the errors of area and indentation count relative to the run's largest."""
    E0, _, _, E2 = run.parameters
    force = np.maximum(run.force, 0.0)
    x = np.cbrt(force / (E0 * length**2))
    delta = run.indentation / length
    inputs = features(
        x,
        run.internal[:, :latents],
        friction_states(delta, force, betas),
        np.full(len(x), math.log(E2 / E0)),
    )
    touching = (force > 0.02) & (run.area > 0)
    safe = np.where(touching, x, 1.0)
    area = np.where(touching, run.area, length**2)
    peak = np.where(touching & (run.peak > 0), run.peak, 1.0)
    ratio = np.where(touching & (run.peak > 0), peak * area / np.where(touching, force, 1.0), 1.0)
    targets = np.column_stack(
        [
            np.where(touching, np.log(area / (length * safe) ** 2), 0.0),
            delta,
            np.log(ratio),
            (run.total - run.internal)[:, :latents],
        ]
    )
    share = np.where(touching, run.area / run.area.max(), 0.0)
    weights = np.column_stack(
        [
            share / 0.01,
            np.full(len(x), 0.01 / max(delta.max(), 0.06) / 1e-4),
            share / 0.1,
            np.ones((len(x), latents)),
        ]
    )
    return Samples(inputs, targets, weights)


def stack(parts: list[Samples]) -> Samples:
    """All samples in one."""
    return Samples(
        *(np.concatenate([getattr(p, f) for p in parts]) for f in ("inputs", "targets", "weights"))
    )


class Network:
    """Two hidden layers with sigmoid v/√(1 + v²); inputs and outputs scaled."""

    def __init__(self, samples: Samples, hidden: int, seed: int = 0) -> None:
        x, t, w = samples.inputs, samples.targets, samples.weights
        touching = w[:, 0] > 0
        self.input_mean = x.mean(0)
        self.input_scale = x.std(0) + 1e-12
        self.output_mean = np.zeros(t.shape[1])
        self.output_mean[0] = t[touching, 0].mean()
        self.output_mean[2] = t[touching, 2].mean()
        self.output_scale = t.std(0) + 1e-12
        self.output_scale[0] = t[touching, 0].std()
        self.output_scale[2] = max(t[touching, 2].std(), 0.05)
        n, outputs = x.shape[1], t.shape[1]
        self.shapes = [
            (n, hidden),
            (hidden,),
            (hidden, hidden),
            (hidden,),
            (hidden, outputs),
            (outputs,),
        ]
        rng = np.random.default_rng(seed)
        self.values = np.concatenate(
            [
                (rng.normal(size=s) * (1 / math.sqrt(s[0]) if len(s) > 1 else 0.3)).ravel()
                for s in self.shapes
            ]
        )

    def split(self, values: np.ndarray) -> list[np.ndarray]:
        """Layers as views of the flat vector."""
        parts, at = [], 0
        for shape in self.shapes:
            size = int(np.prod(shape))
            parts.append(values[at : at + size].reshape(shape))
            at += size
        return parts

    def arrays(self, betas: np.ndarray) -> dict[str, np.ndarray]:
        """As stored in the file of the reduced model."""
        names = ("weights_1", "bias_1", "weights_2", "bias_2", "weights_3", "bias_3")
        return {
            **dict(zip(names, (v.copy() for v in self.split(self.values)))),
            "input_mean": self.input_mean,
            "input_scale": self.input_scale,
            "output_mean": self.output_mean,
            "output_scale": self.output_scale,
            "betas": np.asarray(betas, float),
        }


def sigmoid(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """v/√(1 + v²) and its slope."""
    root = 1.0 / np.sqrt(1.0 + v * v)
    return v * root, root**3


def _adam(
    network: Network,
    x: np.ndarray,
    t: np.ndarray,
    w: np.ndarray,
    epochs: int,
    report=None,
    size: int = 256,
) -> None:
    """Adam (Kingma and Ba 2015) in batches, in single precision, the rate falling as a cosine."""
    rng = np.random.default_rng(0)
    x, t, w = (np.ascontiguousarray(v, np.float32) for v in (x, t, w))
    # Large weights would let few samples rule the batch.
    w = w / np.sqrt(np.mean(w**2, axis=0, keepdims=True)) + 1e-9
    values = network.values.astype(np.float32)
    first, second = np.zeros_like(values), np.zeros_like(values)
    gradient = np.zeros_like(values)
    parts, slopes = network.split(values), network.split(gradient)
    w1, b1, w2, b2, w3, b3 = parts
    number, step = len(x), 0
    for epoch in range(epochs):
        rate = 4e-3 * (0.5 + 0.5 * math.cos(math.pi * epoch / epochs)) + 1e-5
        order = rng.permutation(number)
        for begin in range(0, number - size + 1, size):
            rows = order[begin : begin + size]
            u = x[rows]
            z1, s1 = sigmoid(u @ w1 + b1)
            z2, s2 = sigmoid(z1 @ w2 + b2)
            g = (z2 @ w3 + b3 - t[rows]) * w[rows] ** 2 / size
            g2 = (g @ w3.T) * s2
            g1 = (g2 @ w2.T) * s1
            for part, value in zip(
                slopes, (u.T @ g1, g1.sum(0), z1.T @ g2, g2.sum(0), z2.T @ g, g.sum(0))
            ):
                part[...] = value
            step += 1
            first += 0.1 * (gradient - first)
            second += 0.001 * (gradient * gradient - second)
            scale = rate * math.sqrt(1 - 0.999**step) / (1 - 0.9**step)
            values -= scale * first / (np.sqrt(second) + 1e-10)
        if report is not None:
            report(0.6 * (epoch + 1) / epochs)
    network.values = values.astype(float)


def fit_samples(
    network: Network, samples: Samples, epochs: int, iterations: int, report=None
) -> float:
    """Least squares over all samples: Adam, then L-BFGS; returns the mean squared weighted error."""
    x = (samples.inputs - network.input_mean) / network.input_scale
    t = (samples.targets - network.output_mean) / network.output_scale
    w = samples.weights * network.output_scale
    w[:, rk.OUTPUTS :] = 50.0
    number = len(x)

    def loss(values: np.ndarray) -> tuple[float, np.ndarray]:
        w1, b1, w2, b2, w3, b3 = network.split(values)
        z1, s1 = sigmoid(x @ w1 + b1)
        z2, s2 = sigmoid(z1 @ w2 + b2)
        residual = (z2 @ w3 + b3 - t) * w
        g = residual * w / number
        g2 = (g @ w3.T) * s2
        g1 = (g2 @ w2.T) * s1
        gradient = np.concatenate(
            [
                (x.T @ g1).ravel(),
                g1.sum(0),
                (z1.T @ g2).ravel(),
                g2.sum(0),
                (z2.T @ g).ravel(),
                g.sum(0),
            ]
        )
        return 0.5 * float(np.sum(residual**2)) / number, gradient

    _adam(network, x, t, w, epochs, report)
    count = 0

    def each(_: np.ndarray) -> None:
        nonlocal count
        count += 1
        if report is not None:
            report(0.6 + 0.4 * count / iterations)

    result = minimize(
        loss,
        network.values,
        jac=True,
        method="L-BFGS-B",
        callback=each,
        options={"maxiter": iterations, "maxfun": 2 * iterations, "maxcor": 30},
    )
    network.values = result.x
    return float(result.fun)
