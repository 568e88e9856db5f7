# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a fit minimises: J, or J with nuisance parameters eliminated.

A nuisance parameter x (the gain of a press, the images' lag, …) changes the areas by S x near a
reference, and is known beforehand as x ~ N(mean, sd²). Given the finger's parameters, the best
nuisances follow in closed form, and with Gaussian priors minimising over them is the same as
integrating over them (up to a constant). So a search keeps the finger's parameters alone:

    Q = min over x of  Σ w (A + S x − measured)² + s² Σ ((x − mean) / sd)²,

with s² the variance of a frame of weight one. Without nuisances Q is J.

Assumed nuisances stay at their mean: they are not estimated, but widen the intervals
(`uncertainty.covariance`), as the "consider" parameters of orbit determination do (Tapley, Schutz
and Born 2004, section 6.2). A precise measurement that answers strongly to an assumed parameter, as
the indentation does to the lengths, would then do more harm than good: it would be believed beyond
what the assumption allows. So its rows get a copy of that parameter that is eliminated (absorbing).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from .report_units import MM2

PRESS_GAIN = "press_gain"
"""Name of the logarithm of each press's gain."""


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
    return np.minimum(1.0, loss.huber_scale / np.maximum(np.abs(residual), 1e-30))


@dataclass(frozen=True)
class Nuisances:
    """Nuisance parameters linearised at a reference state.

    names (k,), trials (k,): the trial that a parameter belongs to, −1 for one shared by all;
    state (k,): value at the reference; mean, sd (k,): prior; slope (n, k): change of the rows (m²),
    areas and others, per unit, at the reference; factor (n,): of the model's rows there, from gains
    and shape; variance: s² in m⁴; assumed (k,): whether a parameter stays at its mean, its state;
    absorbing (k,): whether it only keeps the rows of one kind from being trusted further than the
    assumed parameters allow, and is no error of its own; none without. robust (n,): of the rows at
    the reference, by `robust_factor`; 1 without.
    """

    names: tuple[str, ...]
    trials: np.ndarray
    state: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    slope: np.ndarray
    factor: np.ndarray
    variance: float
    assumed: np.ndarray
    absorbing: np.ndarray | None = None
    robust: np.ndarray | None = None

    @property
    def shared(self) -> np.ndarray:
        """Mask (k,) of the parameters shared by all trials."""
        return self.trials < 0

    @property
    def absorbers(self) -> np.ndarray:
        """`absorbing` as a mask (k,)."""
        none = np.zeros(len(self.names), dtype=bool)
        return none if self.absorbing is None else self.absorbing

    def without(self, *names: str) -> Nuisances:
        """Without the parameters of these names."""
        keep = ~np.isin(self.names, names)
        return replace(
            self,
            names=tuple(np.array(self.names)[keep].tolist()),
            slope=self.slope[:, keep],
            absorbing=self.absorbers[keep],
            **{n: getattr(self, n)[keep] for n in ("trials", "state", "mean", "sd", "assumed")},
        )

    def with_gains(self, sign: np.ndarray, trial_of: np.ndarray) -> Nuisances:
        """With the log gains of presses multiplied by a sign (T,): other presses of this scatter.

        trial_of (n,): the frames' trials; rows beyond them are no areas.
        """
        chosen = np.array([name == PRESS_GAIN for name in self.names], dtype=bool)
        state = self.state.copy()
        state[chosen] *= sign[self.trials[chosen]]
        change = np.zeros(len(sign))
        change[self.trials[chosen]] = state[chosen] - self.state[chosen]
        growth = np.ones(len(self.factor))
        growth[: len(trial_of)] = np.exp(change)[trial_of]
        return replace(
            self, state=state, factor=self.factor * growth, slope=self.slope * growth[:, None]
        )


class Goal:
    """J, or Q where there are nuisances, under given weights (n,) of the frames."""

    def __init__(
        self,
        measured: np.ndarray,
        weight: np.ndarray,
        loss: Loss,
        nuisances: Nuisances | None = None,
        repeats: np.ndarray | None = None,
    ) -> None:
        """repeats (T,): how often a trial counts, for the priors of its own nuisances."""
        self.measured, self.weight, self.loss, self.nuisances = measured, weight, loss, nuisances
        if nuisances is not None:
            count = np.ones(len(nuisances.state))
            own = ~nuisances.shared
            if repeats is not None:
                count[own] = repeats[nuisances.trials[own]]
            self._precision = nuisances.variance * count / nuisances.sd**2
            self._gap = nuisances.state - nuisances.mean
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
        pulls = self._precision[free] * self._gap[free]
        solved = np.linalg.solve(
            slope.T @ weighted + np.diag(precision), np.column_stack([weighted.T, pulls])
        )
        move, offset = np.zeros_like(found.slope), np.zeros(len(free))
        move[:, free], offset[free] = solved[:, :-1].T, solved[:, -1]
        return move, offset

    def residuals(self, areas: np.ndarray) -> np.ndarray:
        """Model less measured area (…, n) in m² at the reference of the nuisances."""
        if self.nuisances is None:
            return areas - self.measured
        return areas * self.nuisances.factor - self.measured

    def moves(self, residual: np.ndarray) -> np.ndarray:
        """Best moves (…, k) of the nuisances from their reference for residuals (…, n)."""
        matrix, offset = self._best
        return -(residual @ matrix + offset)

    def cost(self, areas: np.ndarray) -> np.ndarray:
        """J or Q (…,) in m⁴ of the model's areas (…, n) in m²; infinite where the model could not
        carry the load."""
        found = self._cost(areas)
        return np.where(np.isfinite(found), found, np.inf)

    def _cost(self, areas: np.ndarray) -> np.ndarray:
        residual = self.residuals(areas)
        if self.nuisances is None:
            return (self.weight * losses(residual, self.loss)).sum(axis=-1)
        move = self.moves(residual)
        left = residual + move @ self.nuisances.slope.T
        prior = (self._precision * (move + self._gap) ** 2).sum(axis=-1)
        return (self.weight * losses(left, self.loss)).sum(axis=-1) + prior

    def rows(self, areas: np.ndarray) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        """Q near the model's areas (n,) as a sum of squares, in mm².

        The rows (m,) at these areas, and the linear map from changes (…, n) of the areas (m²) to
        changes (…, m) of the rows.
        """
        residual = self.residuals(areas)
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
            [root * (residual + found.slope @ move), prior * (move + self._gap)], axis=-1
        )
        return at, linear
