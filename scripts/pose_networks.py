# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Learn the networks of `finger_model.pose.networks` from contacts at small and large strain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize

HIDDEN = (48, 24)
"""Units of the hidden layers."""
DECAY, LARGE_DECAY = 3e-6, 3e-3
"""Of the weights' squares, and of those of what large strain differs, beside the mean square
error."""
ITERATIONS = 1500


@dataclass(frozen=True)
class Contacts:
    """Contacts to learn from.

    inputs (n, k); powers (n, p): of the depth; terms (n, t, c): those of the coefficients by the
    values they make; values (n, c); weight (n,); large: at large strain.
    """

    inputs: np.ndarray
    powers: np.ndarray
    terms: np.ndarray
    values: np.ndarray
    weight: np.ndarray
    large: bool

    def where(self, chosen: np.ndarray) -> Contacts:
        """Some of them."""
        arrays = self.inputs, self.powers, self.terms, self.values, self.weight
        return Contacts(*(array[chosen] for array in arrays), self.large)


class Network:
    """Hidden layers that are shared, then a layer for small strain and what is added to it at large
    strain, each giving coefficients (p, t)."""

    def __init__(self, inputs: int, coefficients: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        sizes = [inputs, *HIDDEN]
        self.layers = [
            np.vstack([rng.standard_normal((a, b)) / np.sqrt(a), 0.1 * rng.standard_normal((1, b))])
            for a, b in pairwise(sizes)
        ]
        last = HIDDEN[-1] + 1, coefficients
        self.layers += [0.05 * rng.standard_normal(last), np.zeros(last)]

    def learn(self, sets: Sequence[Contacts]) -> None:
        """Least squares over all sets, each counting alike."""
        shapes = [layer.shape for layer in self.layers]
        ends = np.cumsum([layer.size for layer in self.layers])[:-1]

        def parts(weights: np.ndarray) -> list[np.ndarray]:
            return [part.reshape(s) for part, s in zip(np.split(weights, ends), shapes)]

        def loss(weights: np.ndarray) -> tuple[float, np.ndarray]:
            self.layers = parts(weights)
            slopes = [2.0 * DECAY * layer for layer in self.layers]
            slopes[-1] = 2.0 * LARGE_DECAY * self.layers[-1]
            total = 0.5 * sum(float((s * w).sum()) for s, w in zip(slopes, self.layers))
            for contacts in sets:
                total += self._add(contacts, slopes)
            return total, np.concatenate([slope.ravel() for slope in slopes])

        start = np.concatenate([layer.ravel() for layer in self.layers])
        settings = {"maxiter": ITERATIONS, "maxfun": 2 * ITERATIONS, "maxcor": 30}
        found = minimize(loss, start, jac=True, method="L-BFGS-B", options=settings)
        self.layers = parts(found.x)

    def _add(self, contacts: Contacts, slopes: list[np.ndarray]) -> float:
        """Mean square error of contacts; its derivatives are added to `slopes`."""
        hidden, small, extra = self.layers[:-2], *self.layers[-2:]
        values = [contacts.inputs]
        for layer in hidden:
            values.append(np.tanh(values[-1] @ layer[:-1] + layer[-1]))
        last = small + extra if contacts.large else small
        coefficients = values[-1] @ last[:-1] + last[-1]
        powers, terms = contacts.powers, contacts.terms
        shape = len(powers), powers.shape[1], terms.shape[1]
        by_power = np.matmul(coefficients.reshape(shape), terms)
        error = np.einsum("np,npc->nc", powers, by_power) - contacts.values
        share = contacts.weight[:, None] / len(powers)
        pushed = 2.0 * share * error
        back = (powers[:, :, None] * np.matmul(terms, pushed[:, :, None])[:, None, :, 0]).reshape(
            len(powers), -1
        )
        slope = np.vstack([values[-1].T @ back, back.sum(axis=0)])
        slopes[-2] += slope
        if contacts.large:
            slopes[-1] += slope
        back = back @ last[:-1].T
        for k in range(len(hidden) - 1, -1, -1):
            back = back * (1.0 - values[k + 1] ** 2)
            slopes[k] += np.vstack([values[k].T @ back, back.sum(axis=0)])
            back = back @ hidden[k][:-1].T
        return float((share * error**2).sum())

    @property
    def at_large_strain(self) -> list[np.ndarray]:
        """Layers for use."""
        return [*self.layers[:-2], self.layers[-2] + self.layers[-1]]
