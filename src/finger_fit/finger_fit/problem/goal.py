# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a fit minimises: J, or J with nuisance parameters eliminated.

A nuisance parameter x (the gain of a press, the images' lag, …) changes the areas by S x near a
reference, and is known beforehand as x ~ N(0, sd²). Given the finger's parameters, the best
nuisances follow in closed form, and with Gaussian priors minimising over them is the same as
integrating over them (up to a constant). So a search keeps the finger's parameters alone:

    Q = min over x of  Σ w (A + S x − measured)² + s² Σ (x / sd)²,

with s² the variance of a frame of weight one. Without nuisances Q is J.

Assumed nuisances stay at their mean: they are not estimated, but widen the intervals
(`uncertainty.covariance`), as the "consider" parameters of orbit determination do (Tapley, Schutz
and Born 2004, section 6.2). A precise measurement that answers strongly to an assumed parameter, as
the indentation does to the lengths, would then do more harm than good: it would be believed beyond
what the assumption allows. So its rows get a copy of that parameter that is eliminated (absorbing).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..nuisance_names import PRESS_GAIN, is_assumed
from ..report_units import MM2


class Loss(Protocol):
    """The loss of the options."""

    @property
    def loss(self) -> str: ...

    @property
    def huber_scale(self) -> float: ...


def losses(residual: np.ndarray, loss: Loss) -> np.ndarray:
    """Loss in m⁴ of residuals in m²: the square, or the Huber loss."""
    if loss.loss == "huber":
        size = np.abs(residual)
        return np.where(
            size <= loss.huber_scale,
            residual**2,
            loss.huber_scale * (2.0 * size - loss.huber_scale),
        )
    return residual**2


def robust_factor(residual: np.ndarray, loss: Loss) -> np.ndarray:
    """Weights that turn squares into the loss near these residuals (m²)."""
    if loss.loss != "huber":
        return np.ones_like(residual)
    return huber_factor(residual, loss.huber_scale)


def huber_factor(residual: np.ndarray, scale: float) -> np.ndarray:
    """Weights that turn squares into the Huber loss near residuals in the unit of its scale."""
    return np.minimum(1.0, scale / np.maximum(np.abs(residual), 1e-30))


@dataclass(frozen=True)
class Nuisance:
    """One nuisance parameter near a reference.

    trial: the trial that it belongs to, −1 for one shared by all; state: value at the reference;
    sd: of its prior; column (n,): change of the rows (m²), areas and others, per unit; absorbing:
    it only keeps the rows of one kind from being trusted further than the assumed parameters
    allow, and is no error of its own.
    """

    name: str
    trial: int
    state: float
    sd: float
    column: np.ndarray
    absorbing: bool = False


class Nuisances:
    """Nuisance parameters linearised at a reference, and their values as arrays.

    parameters: k of them; factor (n,): of the model's rows at the reference, from gains and shape;
    variance: s² in m⁴; robust (n,): of the rows there, by `robust_factor`; 1 without. names,
    trials, state, sd, absorbing (k,): of the parameters; slope (n, k): their columns; assumed (k,):
    whether a parameter stays at its mean, its state.
    """

    def __init__(
        self,
        parameters: Iterable[Nuisance],
        factor: np.ndarray,
        variance: float,
        robust: np.ndarray | None = None,
    ) -> None:
        self.parameters = tuple(parameters)
        self.factor, self.variance, self.robust = factor, variance, robust
        self.names = tuple(p.name for p in self.parameters)
        self.trials = np.array([p.trial for p in self.parameters], dtype=int)
        self.state = np.array([p.state for p in self.parameters])
        self.sd = np.array([p.sd for p in self.parameters])
        self.slope = np.array([p.column for p in self.parameters]).reshape(-1, len(factor)).T
        self.assumed = np.array([is_assumed(name) for name in self.names], dtype=bool)
        self.absorbing = np.array([p.absorbing for p in self.parameters], dtype=bool)

    @property
    def shared(self) -> np.ndarray:
        """Mask (k,) of the parameters shared by all trials."""
        return self.trials < 0

    def without(self, *names: str) -> Nuisances:
        """Leave out the parameters of these names."""
        kept = [p for p in self.parameters if p.name not in names]
        return Nuisances(kept, self.factor, self.variance, self.robust)

    def with_gains(self, sign: np.ndarray, trial_of: np.ndarray) -> Nuisances:
        """Multiply the log gains of presses by a sign (T,): other presses of this scatter.

        trial_of (n,): the frames' trials; rows beyond them are no areas.
        """
        gains = np.zeros(len(sign))
        for p in self.parameters:
            if p.name == PRESS_GAIN:
                gains[p.trial] = p.state
        growth = np.ones(len(self.factor))
        growth[: len(trial_of)] = np.exp(sign * gains - gains)[trial_of]
        parameters = [
            replace(
                p,
                state=p.state * sign[p.trial] if p.name == PRESS_GAIN else p.state,
                column=p.column * growth,
            )
            for p in self.parameters
        ]
        return Nuisances(parameters, self.factor * growth, self.variance, self.robust)


class Goal:
    """J, or Q where there are nuisances, of n rows: areas and others, as `FitProblem.outputs`.

    observed (n,): measured, in m²; weight (n,).
    """

    def __init__(
        self,
        observed: np.ndarray,
        weight: np.ndarray,
        loss: Loss,
        nuisances: Nuisances | None = None,
        repeats: np.ndarray | None = None,
    ) -> None:
        """repeats (T,): how often a trial counts, for the priors of its own nuisances."""
        self.observed, self.weight, self.loss, self.nuisances = observed, weight, loss, nuisances
        if nuisances is not None:
            count = np.ones(len(nuisances.state))
            own = ~nuisances.shared
            if repeats is not None:
                count[own] = repeats[nuisances.trials[own]]
            self._precision = nuisances.variance * count / nuisances.sd**2
            self._free = ~nuisances.assumed
            # Outliers of the reference move no nuisance further than the loss lets them.
            self._robust = weight if nuisances.robust is None else weight * nuisances.robust
            self._best = self._elimination(self._robust)

    def spread(self) -> np.ndarray:
        """Standard deviation (k,) of the nuisances once the finger's parameters are known."""
        found = self.nuisances
        assert found is not None
        slope, spread = found.slope[:, self._free], found.sd.copy()
        matrix = slope.T @ (self._robust[:, None] * slope) + np.diag(self._precision[self._free])
        spread[self._free] = np.sqrt(found.variance * np.diag(np.linalg.inv(matrix)))
        return spread

    def _elimination(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """G (n, k) and g (k,): the best move of the nuisances is −(r @ G + g) at residuals r."""
        found = self.nuisances
        assert found is not None
        free, slope = self._free, found.slope[:, self._free]
        # A trial that does not count leaves its own nuisances at the prior; any value does.
        precision = self._precision[free] + 1e-12 * found.variance / found.sd[free] ** 2
        weighted = weight[:, None] * slope
        pulls = self._precision[free] * found.state[free]
        solved = np.linalg.solve(
            slope.T @ weighted + np.diag(precision), np.column_stack([weighted.T, pulls])
        )
        move, offset = np.zeros_like(found.slope), np.zeros(len(free))
        move[:, free], offset[free] = solved[:, :-1].T, solved[:, -1]
        return move, offset

    def residuals(self, outputs: np.ndarray) -> np.ndarray:
        """Model less measured (…, n) in m² at the reference of the nuisances."""
        if self.nuisances is None:
            return outputs - self.observed
        return outputs * self.nuisances.factor - self.observed

    def moves(self, residual: np.ndarray) -> np.ndarray:
        """Best moves (…, k) of the nuisances from their reference for residuals (…, n)."""
        matrix, offset = self._best
        return -(residual @ matrix + offset)

    def cost(self, outputs: np.ndarray) -> np.ndarray:
        """J or Q (…,) in m⁴ of the model's outputs (…, n); infinite where the model could not carry
        the load."""
        found = self._cost(outputs)
        return np.where(np.isfinite(found), found, np.inf)

    def _cost(self, outputs: np.ndarray) -> np.ndarray:
        residual = self.residuals(outputs)
        if self.nuisances is None:
            return (self.weight * losses(residual, self.loss)).sum(axis=-1)
        move = self.moves(residual)
        left = residual + move @ self.nuisances.slope.T
        prior = (self._precision * (move + self.nuisances.state) ** 2).sum(axis=-1)
        return (self.weight * losses(left, self.loss)).sum(axis=-1) + prior

    def rows(self, outputs: np.ndarray) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        """Q near the model's outputs (n,) as a sum of squares, in mm².

        The terms (m,) at these outputs, and the linear map from changes (…, n) of the outputs (m²)
        to changes (…, m) of the terms.
        """
        residual = self.residuals(outputs)
        found = self.nuisances
        if found is None:
            root = np.sqrt(self.weight * robust_factor(residual, self.loss)) * MM2
            return root * residual, lambda change: root * change
        move = self.moves(residual)
        robust = robust_factor(residual + found.slope @ move, self.loss)
        root = np.sqrt(self.weight * robust) * MM2
        matrix, offset = self._best
        if self.loss.loss == "huber":
            matrix, offset = self._elimination(self.weight * robust)
            move = -(residual @ matrix + offset)
        prior = np.sqrt(self._precision) * MM2

        def linear(change: np.ndarray) -> np.ndarray:
            scaled = change * found.factor
            follow = -(scaled @ matrix)
            return np.concatenate(
                [root * (scaled + follow @ found.slope.T), prior * follow], axis=-1
            )

        at = np.concatenate(
            [root * (residual + found.slope @ move), prior * (move + found.state)], axis=-1
        )
        return at, linear
