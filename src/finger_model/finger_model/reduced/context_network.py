# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Networks whose gains and biases a second network takes from the context of a finger.

    z₁ = s(g₁ ⊙ (u W₁) + b₁),  z₂ = s(g₂ ⊙ (z₁ W₂) + b₂),  y = z₂ W₃ + b₃
    (g₁, b₁, g₂, b₂, b₃) = s(s(C V₁ + d₁) V₂ + d₂) V₃ + d₃,   s(v) = v/√(1 + v²)

u are load and state, C is the context (`population`). The second network runs once for a finger;
a time step costs what it costs without context (feature-wise linear modulation: Perez et al. 2018).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from finger_common.processes import Map

from .maps import sigmoid

SLICE = 64
"""Histories whose derivatives are formed at a time, in each thread."""
BEND = 0.2
"""Errors beyond this share of their root mean square count by their size, not by its square: some
histories are far off whatever the network does, and would take the others' place."""


@dataclass
class Rows:
    """Padded rows of H histories of at most R rows, in single precision.

    context (H, c); inputs (H, R, i); targets (H, R, o); weights (H, R, o), 0 where there is no row.
    """

    context: np.ndarray
    inputs: np.ndarray
    targets: np.ndarray
    weights: np.ndarray

    def part(self, chosen: np.ndarray | slice) -> Rows:
        """Some of the histories."""
        return Rows(*(v[chosen] for v in (self.context, self.inputs, self.targets, self.weights)))


class ContextNetwork:
    """The two networks; inputs and outputs are scaled to mean 0 and deviation 1 of the data."""

    def __init__(self, rows: Rows, hidden: int, context_hidden: int, seed: int = 0) -> None:
        valid = rows.weights.sum(axis=2) > 0
        inputs, targets = rows.inputs[valid], rows.targets[valid]
        self.scales = {
            "context_mean": rows.context.mean(0),
            "context_scale": rows.context.std(0) + 1e-9,
            "input_mean": inputs.mean(0),
            "input_scale": inputs.std(0) + 1e-9,
            "output_mean": targets.mean(0),
            "output_scale": targets.std(0) + 1e-9,
        }
        self.hidden = hidden
        i, o, c = inputs.shape[1], targets.shape[1], rows.context.shape[1]
        outputs = 4 * hidden + o
        rng = np.random.default_rng(seed)

        def normal(n: int, m: int, gain: float = 1.0) -> np.ndarray:
            return (rng.normal(size=(n, m)) * gain / math.sqrt(n)).astype(np.float32)

        first = np.zeros(outputs, np.float32)
        first[:hidden] = first[2 * hidden : 3 * hidden] = 1.0
        first[hidden : 2 * hidden] = rng.normal(size=hidden) * 0.5
        first[3 * hidden : 4 * hidden] = rng.normal(size=hidden) * 0.5
        self.values = {
            "V1": normal(c, context_hidden),
            "d1": (rng.normal(size=context_hidden) * 0.3).astype(np.float32),
            "V2": normal(context_hidden, context_hidden),
            "d2": (rng.normal(size=context_hidden) * 0.3).astype(np.float32),
            "V3": normal(context_hidden, outputs, 0.3),
            "d3": first,
            "W1": normal(i, hidden),
            "W2": normal(hidden, hidden),
            "W3": normal(hidden, o),
        }

    def scaled(self, rows: Rows) -> Rows:
        """Rows in the network's own scales; a weighted error keeps its size."""
        s = self.scales
        return Rows(
            ((rows.context - s["context_mean"]) / s["context_scale"]).astype(np.float32),
            ((rows.inputs - s["input_mean"]) / s["input_scale"]).astype(np.float32),
            ((rows.targets - s["output_mean"]) / s["output_scale"]).astype(np.float32),
            (rows.weights * s["output_scale"]).astype(np.float32),
        )

    def modulation(self, context: np.ndarray) -> np.ndarray:
        """(…, 4 h + o): gains and biases of a scaled context (…, c)."""
        v = self.values
        first = sigmoid(context @ v["V1"] + v["d1"])[0]
        return sigmoid(first @ v["V2"] + v["d2"])[0] @ v["V3"] + v["d3"]

    def outputs(self, rows: Rows) -> np.ndarray:
        """Outputs (H, R, o) in their own units for rows in theirs."""
        scaled = self.scaled(rows)
        y = self._forward(scaled)[0]
        return y * self.scales["output_scale"] + self.scales["output_mean"]

    def _forward(self, rows: Rows) -> tuple:
        v, h = self.values, self.hidden
        c1, s1 = sigmoid(rows.context @ v["V1"] + v["d1"])
        c2, s2 = sigmoid(c1 @ v["V2"] + v["d2"])
        m = (c2 @ v["V3"] + v["d3"])[:, None, :]
        p1 = rows.inputs @ v["W1"]
        z1, t1 = sigmoid(m[..., :h] * p1 + m[..., h : 2 * h])
        p2 = z1 @ v["W2"]
        z2, t2 = sigmoid(m[..., 2 * h : 3 * h] * p2 + m[..., 3 * h : 4 * h])
        return z2 @ v["W3"] + m[..., 4 * h :], c1, s1, c2, s2, m, p1, z1, t1, p2, z2, t2

    def gradient(
        self, rows: Rows, bend: float = math.inf, each: Map = map
    ) -> tuple[float, dict[str, np.ndarray]]:
        """Mean square of the weighted errors of scaled rows, and the derivatives of a mean in which
        errors beyond `bend` count by their size (pseudo-Huber loss: Charbonnier et al. 1997);
        `each` does the work of all slices."""
        count = max(int(np.count_nonzero(rows.weights[..., 0])), 1)
        loss, found = 0.0, {key: np.zeros_like(value) for key, value in self.values.items()}
        # Few at a time: larger arrays leave the cache, and the allocator gives them back each time.
        begins = range(0, len(rows.context), SLICE)
        parts = [rows.part(slice(begin, begin + SLICE)) for begin in begins]
        for error, slope in each(lambda part: self._gradient_of_slice(part, count, bend), parts):
            loss += error
            for key, value in slope.items():
                found[key] += value
        return loss, found

    def _gradient_of_slice(
        self, rows: Rows, count: int, bend: float
    ) -> tuple[float, dict[str, np.ndarray]]:
        v, h = self.values, self.hidden
        y, c1, s1, c2, s2, m, p1, z1, t1, p2, z2, t2 = self._forward(rows)
        error = (y - rows.targets) * rows.weights
        loss = float(np.sum(error * error)) / count
        dy = error / np.sqrt(1.0 + (error / bend) ** 2) * rows.weights * (2.0 / count)

        def flat(a: np.ndarray) -> np.ndarray:
            return a.reshape(-1, a.shape[-1])

        found = {"W3": flat(z2).T @ flat(dy)}
        e2 = (dy @ v["W3"].T) * t2
        d2 = e2 * m[..., 2 * h : 3 * h]
        found["W2"] = flat(z1).T @ flat(d2)
        e1 = (d2 @ v["W2"].T) * t1
        d1 = e1 * m[..., :h]
        found["W1"] = flat(rows.inputs).T @ flat(d1)
        parts = ((e1 * p1), e1, (e2 * p2), e2, dy)
        dm = np.concatenate([part.sum(axis=1) for part in parts], axis=1)
        found["V3"], found["d3"] = c2.T @ dm, dm.sum(0)
        g2 = (dm @ v["V3"].T) * s2
        found["V2"], found["d2"] = c1.T @ g2, g2.sum(0)
        g1 = (g2 @ v["V2"].T) * s1
        found["V1"], found["d1"] = rows.context.T @ g1, g1.sum(0)
        return loss, found


class Soap:
    """Adam in the eigenbasis of the gradients' covariances (SOAP: Vyas et al. 2024), with
    decoupled weight decay (Loshchilov and Hutter 2019)."""

    EVERY = 10
    """Steps between two eigenbases."""
    KEEP, SQUARES = 0.95, 0.99

    def __init__(self, values: dict[str, np.ndarray], decay: float) -> None:
        self.values, self.decay, self.steps = values, decay, 0
        self.first = {k: np.zeros_like(v) for k, v in values.items()}
        self.second = {k: np.zeros_like(v) for k, v in values.items()}
        self.sides = {
            k: [np.zeros((n, n), np.float32) for n in v.shape]
            for k, v in values.items()
            if v.ndim == 2
        }
        self.bases = {k: [np.eye(n, dtype=np.float32) for n in v.shape] for k, v in values.items()}

    def step(self, slope: dict[str, np.ndarray], rate: float) -> None:
        """Change the values by one step against the slope."""
        self.steps += 1
        for key, value in self.values.items():
            g: np.ndarray = slope[key].astype(np.float32)
            if value.ndim == 2:
                self._renew(key, g)
                left, right = self.bases[key]
                g = left.T @ g @ right
            first = self.first[key] = self.KEEP * self.first[key] + (1 - self.KEEP) * g
            second = self.second[key] = self.SQUARES * self.second[key] + (1 - self.SQUARES) * g * g
            mean = first / (1 - self.KEEP**self.steps)
            change = mean / (np.sqrt(second / (1 - self.SQUARES**self.steps)) + 1e-8)
            if value.ndim == 2:
                change = left @ change @ right.T + self.decay * value
            self.values[key] = (value - rate * change).astype(np.float32)

    def _renew(self, key: str, g: np.ndarray) -> None:
        """Take a slope into the covariances, and renew the eigenbasis from time to time."""
        sides = self.sides[key]
        sides[0] = self.KEEP * sides[0] + (1 - self.KEEP) * (g @ g.T)
        sides[1] = self.KEEP * sides[1] + (1 - self.KEEP) * (g.T @ g)
        if self.steps == 1:
            self.bases[key] = [np.linalg.eigh(side)[1].astype(np.float32) for side in sides]
        elif self.steps % self.EVERY == 0:
            # One round of orthogonal iteration, in the order of the eigenvalues.
            left, right = self.bases[key]
            first = left @ self.first[key] @ right.T
            for which, side in enumerate(sides):
                basis = self.bases[key][which]
                image = side @ basis
                order = np.argsort(-np.sum(basis * image, axis=0))
                self.bases[key][which] = np.linalg.qr(image[:, order])[0].astype(np.float32)
                self.second[key] = np.take(self.second[key], order, axis=which)
            left, right = self.bases[key]
            self.first[key] = left.T @ first @ right


def fit(
    network: ContextNetwork,
    rows: Rows,
    epochs: int,
    batch: int = 256,
    rate: float = 1e-2,
    decay: float = 0.1,
    seed: int = 0,
    report: Callable[[float], None] | None = None,
    each: Map = map,
) -> float:
    """Minimise the weighted errors in batches, with a rate that falls to zero; `each` does the work
    of the slices of a batch.

    Returns the root mean square of the weighted errors over the last epoch.
    """
    scaled = network.scaled(rows)
    number = len(rows.context)
    batch = min(batch, number)
    rng = np.random.default_rng(seed)
    method = Soap(network.values, decay)
    steps, total = 0, epochs * (number // batch)
    mean = math.inf
    for epoch in range(epochs):
        order = rng.permutation(number)
        losses = []
        for begin in range(0, number - batch + 1, batch):
            loss, slope = network.gradient(
                scaled.part(order[begin : begin + batch]), BEND * mean, each
            )
            losses.append(loss)
            steps += 1
            share = steps / total
            now = rate * min(1.0, steps / 200) * 0.5 * (1.0 + math.cos(math.pi * share)) + 1e-6
            method.step(slope, now)
        mean = math.sqrt(float(np.mean(losses)))
        if report is not None:
            report((epoch + 1) / epochs)
    return mean
