# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Sensitivities and the covariance of the estimate.

With the frames' weights w, residuals r and sensitivities s = ∂A/∂x in the coordinates x
(logarithms), J ≈ J_min + δᵀ H δ with H = Σ w s sᵀ. The estimate's covariance is V = H⁻¹ B H⁻¹, B
the covariance of Σ w r s. B is computed twice: for frames of equal noise, whose errors are alike as
far as their residuals show it (`frame_errors`), and from the scatter of whole trials, which also
holds when the frames of a trial share an error (Liang and Zeger 1986). What the second has more
than the first, in any direction of the coordinates, is added to the first: no quantity, of several
parameters either, then has less than the larger variance.

With nuisance parameters (`problem.Goal`), those of one trial are eliminated in H and in the first
B; those shared by all trials are further coordinates, with their priors in H and in both B. So the
covariance holds what a prior leaves open too. Assumed ones are not estimated: the estimate answers
to each by K = −H⁻¹ ∂²J/∂x∂c, and its covariance is V + K C Kᵀ, with C of their priors.

A parameter on a bound of the search box is not known either. A quantity has the larger deviation of
two: with the other parameters held at their bounds, and *released*, where they may move, with no
more known of them than that they lie in the box. Held, they would make it seem known to a third of
its error. `covariance`, which the live model samples, holds them: they cannot leave the box.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from finger_model.laws import ParameterSpace

from ..problem import FitProblem, robust_factor, slope_between
from .frame_errors import FrameErrors, frame_errors

AT_BOUND = 1e-3
"""A parameter this close to a bound, in its coordinate, lies on it."""

EXACT = 1e-9
"""Residuals over areas below which they are those of the arithmetic, not of errors."""

WITHIN_BOX = 3.0**-0.5
"""Distance of a bound from a place in the search box, root mean square, over the width of the box:
how far a parameter on a bound may be off."""

_CENTRAL = 5e-3
"""Step of the central differences in the coordinates."""


@dataclass(frozen=True)
class Covariance:
    """Curvature and covariance of the coordinates at the best parameters (N,).

    curvature (N, N): H in m⁴; noise: m², standard deviation of a frame's residual; active:
    parameters on a bound of the search box (N, 2), with "low" or "high"; scores (M, T): Σ w r s of
    every trial; frame_information (M, M): B of the frames. nuisances: names of the K shared
    nuisances, M = N + K: they follow the parameters in curvature, scores and frame_information, and
    in prior (M,), their part of H; assumed (K,): which are not estimated. frames: how the errors of
    neighbouring frames are alike; None of a plan.
    """

    space: ParameterSpace
    parameters: np.ndarray
    curvature: np.ndarray
    noise: float
    active: dict[str, str]
    box: np.ndarray
    scores: np.ndarray
    frame_information: np.ndarray
    prior: np.ndarray
    variance: float
    nuisances: tuple[str, ...] = ()
    assumed: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    frames: FrameErrors | None = None

    @functools.cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (N, N) with all that is unknown, with zero rows where a bound is active."""
        found, free = self.data_covariance(), self._free()
        if free:
            moves = self.responses(free)[self.assumed]
            found += moves.T @ moves
        return found

    @functools.cached_property
    def released(self) -> Covariance:
        """The same with the parameters on a bound free to move, of which no more is known than that
        they lie in the search box."""
        if not self.active:
            return self
        low, high = self.space.to_log(self.box.T)
        held = [self.space.index(name) for name in self.active]
        variance = self.variance or self.noise**2
        own = np.zeros(len(self.prior))
        own[held] = variance / (WITHIN_BOX * (high - low)[held]) ** 2
        return replace(
            self,
            curvature=self.curvature + np.diag(own),
            prior=self.prior + own,
            variance=variance,
            active={},
        )

    def holds(self, name: str) -> bool:
        """Whether a quantity follows from parameters on a bound alone, so that samples of
        `covariance` have no spread of it."""
        derived = self.space.derived.get(name)
        of = set(derived.of if derived else (name,))
        return bool(of) and of <= set(self.active)

    def correlation(self, first: str, second: str) -> float:
        """Correlation of two parameters' logarithms by the curvature alone: which of them the data
        trade against each other, as if no bound were active and the assumed nuisances were
        estimated too; NaN without variance. `covariance` tells how estimates err together."""
        inverse = inverse_of(self.curvature)
        i, j = self.space.index(first), self.space.index(second)
        scale = np.sqrt(inverse[i, i] * inverse[j, j])
        return float(inverse[i, j] / scale) if scale > 0 else float("nan")

    def data_deviation(self, name: str) -> float:
        """Standard deviation of a quantity's logarithm from the data alone, as if the assumed
        nuisances were known exactly."""
        return self._by_data(name)[0]

    def _by_data(self, name: str) -> tuple[float, Covariance, list[int]]:
        """`data_deviation`, with the covariance and the free parameters that give it."""
        found = []
        for known, free in self._views(name):
            index, part = known._estimated(free, name)
            found.append((float(np.sqrt(part @ known._sandwich(index) @ part)), known, free))
        return max(found, key=lambda one: one[0])

    def _views(self, name: str) -> list[tuple[Covariance, list[int]]]:
        """Covariances with the parameters that are free for a quantity: with the others held at
        their bounds, and released.

        Held, a parameter on a bound is free for its own deviation only. Where a derived quantity
        depends on such parameters alone, the one that it is solved for is free.
        """
        space = self.space
        derived = space.derived.get(name)
        own = {name} if derived is None else {derived.solves_for} if self.holds(name) else set()
        free = [i for i, n in enumerate(space.names) if n not in self.active or n in own]
        released = self.released
        return [(self, free), (released, released._free())]

    def data_covariance(self) -> np.ndarray:
        """`covariance` (N, N) from the data alone, as if the assumed nuisances were known."""
        free = self._free()
        found = np.zeros((len(self.space), len(self.space)))
        if free:
            index, _ = self._estimated(free)
            part = self._sandwich(index)[: len(free), : len(free)]
            found[np.ix_(free, free)] = part
        return found

    def assumed_deviation(self, name: str) -> float:
        """Standard deviation that the assumed nuisances add to `data_deviation`, as squares."""
        return float(np.linalg.norm(list(self.assumed_moves(name).values())))

    def assumed_moves(self, name: str) -> dict[str, float]:
        """Change of a quantity's logarithm by one prior deviation of each assumed nuisance."""
        gradient = self.space.log_gradient(name, self.parameters)
        found = [
            (known.responses(free) @ gradient)[self.assumed] for known, free in self._views(name)
        ]
        larger = max(found, key=lambda moves: float(np.linalg.norm(moves)))
        names = itertools.compress(self.nuisances, self.assumed)
        return {name: float(move) for name, move in zip(names, larger)}

    def deviation(self, name: str) -> float:
        """Standard deviation of a quantity's logarithm with all that is unknown."""
        return float(np.hypot(self.data_deviation(name), self.assumed_deviation(name)))

    def rise(self, name: str) -> float:
        """Rise of J (m⁴) along a quantity's profile at one `data_deviation`."""
        deviation, known, free = self._by_data(name)
        index, part = known._estimated(free, name)
        inverse = inverse_of(known.curvature[np.ix_(index, index)])
        return deviation**2 / max(float(part @ inverse @ part), 1e-300)

    def _free(self) -> list[int]:
        """Parameters that lie on no bound."""
        return [i for i, name in enumerate(self.space.names) if name not in self.active]

    def _estimated(self, free: Sequence[int], name: str = "") -> tuple[list[int], np.ndarray]:
        """Coordinates of the free parameters and the estimated nuisances, and the gradient of a
        quantity in them."""
        number = len(self.space)
        index = [*free, *(number + np.flatnonzero(~self.assumed))]
        part = np.zeros(len(index))
        if name:
            part[: len(free)] = self.space.log_gradient(name, self.parameters)[list(free)]
        return index, part

    def responses(self, free: Sequence[int]) -> np.ndarray:
        """Change (K, N) of the coordinates by one prior deviation of each shared nuisance, with
        only the parameters `free` moving."""
        number = len(self.space)
        index, _ = self._estimated(free)
        inverse = inverse_of(self.curvature[np.ix_(index, index)])[: len(free)]
        found = np.zeros((len(self.nuisances), number))
        prior = self.prior[number:]
        for k, fixed in enumerate(self.assumed):
            if fixed:
                answer = -inverse @ self.curvature[index, number + k]
                answer *= np.sqrt(self.variance / prior[k])
            else:
                answer = inverse[:, index.index(number + k)] * np.sqrt(prior[k] * self.variance)
            found[k, list(free)] = answer
        return found

    def budget(self, name: str) -> dict[str, float]:
        """What the standard deviation of a quantity's logarithm is made of.

        By the prior of each shared nuisance, and the rest, "data"; their squares add up.
        """
        deviation, known, free = self._by_data(name)
        parts = np.abs(known.responses(free) @ self.space.log_gradient(name, self.parameters))
        parts[self.assumed] = np.abs(list(self.assumed_moves(name).values()))
        alone = deviation**2
        data = np.sqrt(max(alone - float((parts[~self.assumed] ** 2).sum()), 0.0))
        return {"data": float(data), **dict(zip(self.nuisances, map(float, parts)))}

    def with_presses(self, factor: float) -> Covariance:
        """Predict `factor` times as many presses of the same kind."""
        prior = np.diag(self.prior)
        return replace(
            self,
            curvature=(self.curvature - prior) * factor + prior,
            frame_information=self.frame_information * factor,
        )

    def nuisance_deviations(self) -> dict[str, float]:
        """Standard deviation of each shared nuisance after the fit."""
        number, free = len(self.space), self._free()
        found = np.sqrt(self.variance / self.prior[number:])
        index, _ = self._estimated(free)
        found[~self.assumed] = np.sqrt(np.diag(self._sandwich(index)))[len(free) :]
        return dict(zip(self.nuisances, map(float, found)))

    def _sandwich(self, free: Sequence[int]) -> np.ndarray:
        """Covariance V of free coordinates, from the two estimates of the module's text."""
        index = np.ix_(free, free)
        inverse = inverse_of(self.curvature[index])
        known = np.diag(self.prior[list(free)]) * self.variance
        by_frames = inverse @ (self.frame_information[index] + known) @ inverse
        part = self.scores[list(free)]
        trials = part.shape[1]
        part = part - part.mean(axis=1, keepdims=True)
        clustered = part @ part.T * (trials / max(trials - 1, 1))
        by_trials = inverse @ (clustered + known) @ inverse
        return by_frames + _positive_part(by_trials - by_frames, np.diag(by_frames + by_trials))


def _positive_part(matrix: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Symmetric matrix (N, N) without its negative part, in coordinates whose units have these
    squares (N,)."""
    scale = np.sqrt(np.maximum(squares, 1e-300))
    units = np.outer(scale, scale)
    values, vectors = np.linalg.eigh(matrix / units)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T * units


def sensitivities(problem: FitProblem, parameters: np.ndarray) -> np.ndarray:
    """∂A/∂x (N, n) in m² of all rows at parameters (N,), by central differences in one batch; by
    differences to one side for a parameter that may be zero, and is."""
    space, number = problem.space, len(problem.space)
    centre = space.to_log(parameters)
    lowest = np.array([np.log(p.log_offset) if p.log_offset else -np.inf for p in space])
    below = np.maximum(centre - _CENTRAL, lowest)
    points = [centre + np.eye(number) * _CENTRAL, np.where(np.eye(number), below, centre), centre]
    rows = problem.outputs(space.from_log(np.vstack(points)))
    steps = np.stack([np.full(number, _CENTRAL), centre - below])
    return slope_between(rows[:-1].reshape(2, number, -1), rows[-1], steps)


def active_bounds(space: ParameterSpace, parameters: np.ndarray, box: np.ndarray) -> dict[str, str]:
    """Names of the parameters (N,) on a bound of box (N, 2), with "low" or "high"."""
    found = {}
    low, high = space.to_log(box.T)
    for name, value, below, above in zip(space.names, space.to_log(parameters), low, high):
        if value - below < AT_BOUND:
            found[name] = "low"
        elif above - value < AT_BOUND:
            found[name] = "high"
    return found


def covariance(
    problem: FitProblem, parameters: np.ndarray, expected_noise: float | None = None
) -> Covariance:
    """Curvature and covariance at parameters (N,), the best ones.

    expected_noise: m² of a frame, in place of the residuals of a fit: the covariance that data of
    this noise will have, without any bound.
    """
    space = problem.space
    number = len(space)
    goal = problem.goal()
    slope = sensitivities(problem, parameters)
    residual = goal.residuals(problem.outputs(parameters)[0])
    planned = expected_noise is not None
    active = {} if planned else active_bounds(space, parameters, problem.box)
    free = [i for i, name in enumerate(space.names) if name not in active]
    used = problem.row_weight > 0.0
    degrees = float(used.sum() - len(free))
    if problem.indentations is not None:
        degrees -= len(problem.indentations.trials)  # their zeros
    shared = problem.nuisances
    names: tuple[str, ...] = ()
    prior: np.ndarray = np.zeros(number)
    own: np.ndarray = np.zeros((len(used), 0))
    assumed, own_sd, variance = np.zeros(0, dtype=bool), np.zeros(0), 0.0
    if shared is not None:
        residual = residual + shared.slope @ goal.moves(residual)
    if planned:
        residual = np.zeros_like(residual)
    # With the Huber loss an outlier has the influence of the last residual that is none.
    robust = robust_factor(residual, problem.options)
    weight = problem.row_weight * robust
    filtered = weight * slope
    if shared is not None:
        common = shared.shared & ~shared.absorbing
        ordered = [*np.flatnonzero(common), *np.flatnonzero(shared.absorbing)]
        names = tuple(name for name, is_common in zip(shared.names, common) if is_common)
        slope = np.vstack([slope * shared.factor, shared.slope[:, ordered].T])
        variance, assumed = shared.variance, shared.assumed[common]
        prior = np.concatenate([prior, variance / shared.sd[ordered] ** 2])
        own, own_sd = shared.slope[:, ~shared.shared], shared.sd[~shared.shared]
        # Σ⁻¹ s for frames that share their trial's nuisances: what these explain is taken out.
        filtered = weight * slope
        inner = (own.T * weight) @ own + np.diag(variance / own_sd**2)
        filtered = filtered - (filtered @ own) @ np.linalg.solve(inner, (weight[:, None] * own).T)
        degrees -= float((1.0 - goal.spread() ** 2 / shared.sd**2).sum())
    curvature = filtered @ slope.T + np.diag(prior)
    # Equal noise in every frame; the residuals of the fit are smaller by the fitted parameters.
    # Indentations that fit worse than their stated deviation widen the intervals.
    areas = np.arange(len(weight)) < len(problem.measured)
    square = max(np.mean((robust * residual)[rows] ** 2) for rows in (used, used & areas))
    noise = float(np.sqrt(square * used.sum() / max(degrees, 0.2 * used.sum(), 1.0)))
    if expected_noise is not None:
        noise = expected_noise
    spread = np.hstack([filtered * noise, (filtered @ own) * own_sd])
    information = spread @ spread.T
    frames = None
    if not planned:
        frames = _frame_errors(problem, slope[free], weight, robust * residual, noise)
        rows, times = filtered[:, : len(problem.measured)], _times(problem)
        # Residuals show errors that are alike, not that some combination of them has less noise.
        alone = noise**2 * rows @ rows.T
        alike = frames.information(rows, times)
        information += _positive_part(alike - alone, np.diag(alike + alone))
    scores = problem.by_trial(weight * residual * slope)
    kept = number + len(names)
    if kept < len(curvature):
        # What only absorbs is eliminated, and is no error of its own.
        answer = np.linalg.solve(curvature[kept:, kept:], curvature[kept:, :kept]).T
        curvature = curvature[:kept, :kept] - answer @ curvature[kept:, :kept]
        pick = np.hstack([np.eye(kept), -answer])
        scores, information = pick @ scores, pick @ information @ pick.T
        prior = prior[:kept]
    return Covariance(
        space,
        np.array(parameters),
        curvature,
        noise,
        active,
        np.array(problem.box),
        scores,
        information,
        prior,
        variance,
        names,
        assumed,
        frames,
    )


def _frame_errors(
    problem: FitProblem, slope: np.ndarray, weight: np.ndarray, residual: np.ndarray, noise: float
) -> FrameErrors:
    """Errors of the frames, from residuals (n,) in m² of all rows with weights (n,).

    slope (N, n): of the free parameters; noise: m², of independent frames.
    """
    shared = problem.nuisances
    precision: np.ndarray = np.zeros(len(slope))
    if shared is not None:
        found = ~shared.assumed
        slope = np.vstack([slope, shared.slope[:, found].T])
        precision = np.append(precision, shared.variance / shared.sd[found] ** 2)
    gain = inverse_of((slope * weight) @ slope.T + np.diag(precision)) @ (slope * weight)
    areas = slice(len(problem.measured))
    if np.linalg.norm(residual[areas]) < EXACT * np.linalg.norm(problem.measured):
        return FrameErrors(noise**2)
    return frame_errors(
        residual[areas],
        problem.weight > 0.0,
        slope.T[areas],
        gain[:, areas],
        _times(problem),
        noise**2,
    )


def _times(problem: FitProblem) -> list[np.ndarray]:
    """Times (k,) in s of the frames of each trial."""
    return [trial.frame_time for trial in problem.trials]


def inverse_of(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a positive semidefinite matrix; without information the variance is very large."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    values = np.maximum(values, 1e-9)
    return (vectors / values) @ vectors.T * np.outer(scale, scale)


def cramer_rao(
    problem: FitProblem, parameters: np.ndarray, noise: float, free: Sequence[str] = ()
) -> dict[str, float]:
    """Smallest standard deviation of any unbiased estimate of a quantity's logarithm.

    For independent frames of the given noise (m²), every frame weighted alike, as in maximum
    likelihood. `free` names the parameters not held at a bound; empty for all.
    """
    space = problem.space
    free = free or space.names
    index = [space.index(name) for name in free]
    slope = sensitivities(problem, parameters)[index]
    inverse = inverse_of(slope @ slope.T / noise**2)
    gradients = {
        name: space.log_gradient(name, parameters)[index] for name in (*free, *space.derived)
    }
    return {name: float(np.sqrt(g @ inverse @ g)) for name, g in gradients.items()}
