# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Sensitivities and the covariance of the estimate.

With the frames' weights w, residuals r and sensitivities s = ∂A/∂x in the coordinates x
(logarithms), J ≈ J_min + δᵀ H δ with H = Σ w s sᵀ. The estimate's covariance is V = H⁻¹ B H⁻¹, B
the covariance of Σ w r s. B is computed twice: for independent frames of equal noise, and from the
scatter of whole trials, which also holds when the frames of a trial share an error (Liang and Zeger
1986). The larger variance is used.

With nuisance parameters (`problem.Goal`), those of one trial are eliminated in H and in the first
B; those shared by all trials are further coordinates, with their priors in H and in both B. So the
covariance holds what a prior leaves open too.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from finger_model.laws import ParameterSpace

from ..problem import FitProblem

AT_BOUND = 1e-3
"""A parameter this close to a bound, in its coordinate, lies on it."""

_CENTRAL = 5e-3
"""Step of the central differences in the coordinates."""


@dataclass(frozen=True)
class Covariance:
    """Curvature and covariance of the coordinates at the best parameters (N,).

    curvature (N, N): H in m⁴; covariance (N, N), with zero rows where a bound is active; noise: m²,
    standard deviation of a frame's residual; active: parameters on a bound, with "low" or "high";
    scores (M, T): Σ w r s of every trial; frame_information (M, M): B of independent frames.
    nuisances: names of the K shared nuisances, M = N + K: they follow the parameters in curvature,
    scores and frame_information, and in prior (M,), their part of H.
    """

    space: ParameterSpace
    parameters: np.ndarray
    curvature: np.ndarray
    covariance: np.ndarray
    noise: float
    active: dict[str, str]
    scores: np.ndarray
    frame_information: np.ndarray
    prior: np.ndarray
    variance: float
    nuisances: tuple[str, ...] = ()

    def deviation(self, name: str) -> float:
        """Standard deviation of a quantity's logarithm."""
        gradient = self.space.log_gradient(name, self.parameters)
        return float(np.sqrt(gradient @ self.covariance @ gradient))

    def correlation(self, first: str, second: str) -> float:
        """Correlation of two parameters' logarithms as if no bound were active; NaN without
        variance."""
        inverse = inverse_of(self.curvature)
        i, j = self.space.index(first), self.space.index(second)
        scale = np.sqrt(inverse[i, i] * inverse[j, j])
        return float(inverse[i, j] / scale) if scale > 0 else float("nan")

    def interval_deviation(self, name: str) -> tuple[float, float]:
        """Standard deviation of a quantity's logarithm for its interval, and the rise of J (m⁴)
        there.

        A parameter on a bound is freed for its own interval only. Where a derived quantity depends
        on bounded parameters alone, the one that it is solved for is freed.
        """
        gradient = self.space.log_gradient(name, self.parameters)
        free = self._freed(name)
        index, part = self._with_nuisances(free, gradient)
        variance = float(part @ self._sandwich(index) @ part)
        inverse = inverse_of(self.curvature[np.ix_(index, index)])
        rise = variance / max(float(part @ inverse @ part), 1e-300)
        return float(np.sqrt(variance)), rise

    def _freed(self, name: str) -> list[int]:
        """Parameters that are free for the interval of a quantity."""
        space = self.space
        unbounded = set(space.names) - set(self.active)
        if name in space.derived:
            derived = space.derived[name]
            freed = set() if unbounded & set(derived.of) else {derived.solves_for}
        else:
            freed = {name}
        return [i for i, n in enumerate(space.names) if n in unbounded | freed]

    def _with_nuisances(
        self, free: Sequence[int], gradient: np.ndarray
    ) -> tuple[list[int], np.ndarray]:
        """Coordinates of the free parameters and all nuisances, and the gradient in them."""
        number = len(self.space)
        index = [*free, *range(number, number + len(self.nuisances))]
        return index, np.concatenate([gradient[list(free)], np.zeros(len(self.nuisances))])

    def responses(self, free: Sequence[int]) -> np.ndarray:
        """Change (K, N) of the coordinates by one prior deviation of each shared nuisance, with
        only the parameters `free` moving."""
        number, shared = len(self.space), len(self.nuisances)
        index = [*free, *range(number, number + shared)]
        inverse = inverse_of(self.curvature[np.ix_(index, index)])
        found = np.zeros((shared, number))
        own = np.sqrt(self.prior[number:] * self.variance)
        found[:, list(free)] = inverse[len(free) :, : len(free)] * own[:, None]
        return found

    def budget(self, name: str) -> dict[str, float]:
        """What the standard deviation of a quantity's logarithm is made of.

        By the prior of each shared nuisance, and the rest, "data"; their squares add up.
        """
        free = [i for i, n in enumerate(self.space.names) if n not in self.active]
        gradient = self.space.log_gradient(name, self.parameters)
        index, part = self._with_nuisances(free, gradient)
        parts = np.abs(self.responses(free) @ gradient)
        total = float(part @ self._sandwich(index) @ part)
        data = np.sqrt(max(total - float((parts**2).sum()), 0.0))
        return {"data": float(data), **dict(zip(self.nuisances, map(float, parts)))}

    def without(self, name: str, nuisances: Collection[str]) -> float:
        """Standard deviation of a quantity's logarithm for its interval, with some of the shared
        nuisances known exactly."""
        number = len(self.space)
        free = self._freed(name)
        kept = [number + k for k, n in enumerate(self.nuisances) if n not in nuisances]
        part = np.zeros(len(free) + len(kept))
        part[: len(free)] = self.space.log_gradient(name, self.parameters)[free]
        return float(np.sqrt(part @ self._sandwich([*free, *kept]) @ part))

    def with_presses(self, factor: float) -> Covariance:
        """As of `factor` times as many presses of the same kind; `covariance` stays as it is."""
        prior = np.diag(self.prior)
        return replace(
            self,
            curvature=(self.curvature - prior) * factor + prior,
            frame_information=self.frame_information * factor,
        )

    def nuisance_deviations(self) -> dict[str, float]:
        """Standard deviation of each shared nuisance after the fit."""
        free = [i for i, n in enumerate(self.space.names) if n not in self.active]
        index, _ = self._with_nuisances(free, np.zeros(len(self.space)))
        found = np.sqrt(np.diag(self._sandwich(index)))[len(free) :]
        return dict(zip(self.nuisances, map(float, found)))

    def _sandwich(self, free: Sequence[int]) -> np.ndarray:
        """Covariance of free coordinates: the larger of the two estimates of the module's text."""
        index = np.ix_(free, free)
        inverse = inverse_of(self.curvature[index])
        known = np.diag(self.prior[list(free)]) * self.variance
        by_frames = inverse @ (self.frame_information[index] + known) @ inverse
        part = self.scores[list(free)]
        trials = part.shape[1]
        part = part - part.mean(axis=1, keepdims=True)
        clustered = part @ part.T * (trials / max(trials - 1, 1))
        by_trials = inverse @ (clustered + known) @ inverse
        growth = np.sqrt(
            np.maximum(np.diag(by_trials) / np.maximum(np.diag(by_frames), 1e-300), 1.0)
        )
        return by_frames * np.outer(growth, growth)


def sensitivities(problem: FitProblem, parameters: np.ndarray) -> np.ndarray:
    """∂A/∂x (N, n) in m² at parameters (N,), by central differences in one batch."""
    space, number = problem.space, len(problem.space)
    centre = space.to_log(parameters)
    shifts = np.eye(number) * _CENTRAL
    areas = problem.areas(space.from_log(np.vstack([centre + shifts, centre - shifts])))
    return (areas[:number] - areas[number:]) / (2.0 * _CENTRAL)


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
    space, weight = problem.space, problem.weight
    number = len(space)
    goal = problem.goal()
    slope = sensitivities(problem, parameters)
    residual = goal.residuals(problem.areas(parameters)[0])
    planned = expected_noise is not None
    active = {} if planned else active_bounds(space, parameters, problem.box)
    free = [i for i, name in enumerate(space.names) if name not in active]
    degrees = float(len(weight) - len(free))
    shared = problem.nuisances
    names: tuple[str, ...] = ()
    prior = np.zeros(number)
    filtered = weight * slope
    own, own_sd, variance = np.zeros((len(weight), 0)), np.zeros(0), 0.0
    if shared is not None:
        common = shared.shared
        names = tuple(name for name, is_common in zip(shared.names, common) if is_common)
        residual = residual + shared.slope @ goal.moves(residual)
        slope = np.vstack([slope * shared.factor, shared.slope[:, common].T])
        variance = shared.variance
        prior = np.concatenate([prior, variance / shared.sd[common] ** 2])
        own, own_sd = shared.slope[:, ~common], shared.sd[~common]
        # Σ⁻¹ s for frames that share their trial's nuisances: what these explain is taken out.
        filtered = weight * slope
        inner = (own.T * weight) @ own + np.diag(variance / own_sd**2)
        filtered = filtered - (filtered @ own) @ np.linalg.solve(inner, (weight[:, None] * own).T)
        degrees -= float((1.0 - goal.spread() ** 2 / shared.sd**2).sum())
    curvature = filtered @ slope.T + np.diag(prior)
    # Equal noise in every frame; the residuals of the fit are smaller by the fitted parameters.
    noise = float(np.sqrt((residual**2).sum() / max(degrees, 0.2 * len(weight), 1.0)))
    if expected_noise is not None:
        noise, residual = expected_noise, np.zeros_like(residual)
    spread = np.hstack([filtered * noise, (filtered @ own) * own_sd])
    information = spread @ spread.T
    scores = np.add.reduceat(weight * residual * slope, problem.starts[:-1], axis=1)
    found = Covariance(
        space,
        np.array(parameters),
        curvature,
        np.zeros((number, number)),
        noise,
        active,
        scores,
        information,
        prior,
        variance,
        names,
    )
    if free:
        index, _ = found._with_nuisances(free, np.zeros(number))
        part = found._sandwich(index)[: len(free), : len(free)]
        found.covariance[np.ix_(free, free)] = part
    return found


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
