"""What the data can tell: sensitivities, covariances, profile likelihoods and the bootstrap over trials.

With the frames' weights w, residuals r and sensitivities s = ∂A/∂ln θ, J ≈ J_min + δᵀ H δ with H = Σ w s sᵀ.
The estimate's covariance is V = H⁻¹ B H⁻¹, B the covariance of Σ w r s. B is computed twice: from independent
frames of equal noise, and from the scatter of whole trials (robust to errors that a trial's frames share; Liang
and Zeger 1986); the larger variance counts. A 95 % interval of a parameter is where its profile stays below
J_min + t² V_ii / (H⁻¹)_ii, with Student's t for as many degrees of freedom as trials less one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from finger_model.parameter_sets import PARAMETER_NAMES

from .local import Coordinates, LocalFit, refine, whole_box, with_composite, with_fixed
from .problem import FitProblem, composite_modulus

QUANTITIES = (*PARAMETER_NAMES, "composite_E")
"""What intervals are given for."""

AT_BOUND = 1e-3
"""A parameter this close to a bound, in logarithm, lies on it."""

TELLING = 0.9
"""An interval that covers this part of the box's logarithm, or more, tells nothing."""

_CENTRAL = 5e-3


@dataclass(frozen=True)
class Covariance:
    """Curvature and covariance of the logarithms of E0, E1, tau1, E2 at the best parameters.

    curvature (4, 4): H in m⁴; covariance (4, 4), with zero rows where a bound is active; noise: m², the standard
    deviation of a frame's residual; active: names of the parameters on a bound, with "low" or "high".
    """

    curvature: np.ndarray
    covariance: np.ndarray
    noise: float
    active: dict[str, str]
    composite_sd: float
    scores: np.ndarray
    frame_information: np.ndarray

    def correlation(self, first: str, second: str) -> float:
        """Correlation of two parameters' logarithms as if no bound were active; NaN if one has no variance."""
        inverse = inverse_of(self.curvature)
        i, j = PARAMETER_NAMES.index(first), PARAMETER_NAMES.index(second)
        scale = np.sqrt(inverse[i, i] * inverse[j, j])
        return float(inverse[i, j] / scale) if scale > 0 else float("nan")


@dataclass(frozen=True)
class Profile:
    """J along one quantity, everything else refitted.

    values (n,) SI; costs (n,) m⁴; threshold: J in m⁴ below which a value lies in the 95 % interval; interval: its
    ends, NaN where the interval runs to the bound; parameters (n, 4).
    """

    name: str
    values: np.ndarray
    costs: np.ndarray
    threshold: float
    interval: tuple[float, float]
    box: tuple[float, float]
    open_low: bool
    open_high: bool
    parameters: np.ndarray

    @property
    def told(self) -> bool:
        """Whether the data narrow the quantity down inside the box."""
        low, high = self.interval
        return bool(np.log(high / low) < TELLING * np.log(self.box[1] / self.box[0]))


def sensitivities(
    problem: FitProblem, parameters: np.ndarray, step: float = _CENTRAL
) -> np.ndarray:
    """∂A/∂ln θ (4, n) in m² at parameters (4,), by central differences in one batch."""
    log = np.log(parameters)
    shifts = np.eye(4) * step
    areas = problem.areas(np.exp(np.vstack([log + shifts, log - shifts])))
    return (areas[:4] - areas[4:]) / (2.0 * step)


def composite_gradient(parameters: np.ndarray) -> np.ndarray:
    """∂ln E/∂ln θ (4,) of the composite modulus."""
    modulus = composite_modulus(parameters)
    return np.array([modulus / parameters[0], modulus / parameters[1], 0.0, 0.0])


def active_bounds(parameters: np.ndarray, box: np.ndarray) -> dict[str, str]:
    """Names of the parameters on a bound, with "low" or "high"."""
    found = {}
    for name, value, (low, high) in zip(PARAMETER_NAMES, parameters, box):
        if np.log(value / low) < AT_BOUND:
            found[name] = "low"
        elif np.log(high / value) < AT_BOUND:
            found[name] = "high"
    return found


def covariance(problem: FitProblem, parameters: np.ndarray) -> Covariance:
    """Curvature and covariance at parameters (4,), the best ones."""
    slope = sensitivities(problem, parameters)
    residual = problem.areas(parameters)[0] - problem.measured
    weight = problem.weight
    curvature = (weight * slope) @ slope.T
    active = active_bounds(parameters, problem.box)
    free = [i for i, name in enumerate(PARAMETER_NAMES) if name not in active]
    frames, trials = len(weight), len(problem)
    degrees = max(frames - len(free), 1)
    # Equal noise in every frame; the residuals of the fit are smaller by the fitted parameters.
    noise = float(np.sqrt((residual**2).sum() / degrees))
    information = (weight * slope * noise) @ (weight * slope * noise).T
    scores = np.add.reduceat(weight * residual * slope, problem.starts[:-1], axis=1)
    out = np.zeros((4, 4))
    if free:
        out[np.ix_(free, free)] = _sandwich(curvature, information, scores, free, trials)
    gradient = composite_gradient(parameters)
    return Covariance(
        curvature,
        out,
        noise,
        active,
        float(np.sqrt(gradient @ out @ gradient)),
        scores,
        information,
    )


def inverse_of(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a positive semidefinite matrix; a direction without information gets a very large variance."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    values = np.maximum(values, 1e-9)
    return (vectors / values) @ vectors.T * np.outer(scale, scale)


def _sandwich(
    curvature: np.ndarray,
    information: np.ndarray,
    scores: np.ndarray,
    free: Sequence[int],
    trials: int,
) -> np.ndarray:
    """Covariance of the free logarithms: the larger of the two estimates, as said above."""
    index = np.ix_(free, free)
    inverse = inverse_of(curvature[index])
    by_frames = inverse @ information[index] @ inverse
    part = scores[list(free)]
    part = part - part.mean(axis=1, keepdims=True)
    clustered = part @ part.T * (trials / max(trials - 1, 1))
    by_trials = inverse @ clustered @ inverse
    growth = np.sqrt(np.maximum(np.diag(by_trials) / np.maximum(np.diag(by_frames), 1e-300), 1.0))
    return by_frames * np.outer(growth, growth)


def cramer_rao(
    problem: FitProblem, parameters: np.ndarray, noise: float, free: Sequence[str] = PARAMETER_NAMES
) -> dict[str, float]:
    """Smallest standard deviation of any unbiased estimate of ln θ, for independent frames of the given noise (m²).

    Computed from the model's sensitivities with every frame weighted alike, as maximum likelihood does; `free`
    names the parameters not held at a bound.
    """
    slope = sensitivities(problem, parameters)
    index = [PARAMETER_NAMES.index(name) for name in free]
    fisher = slope[index] @ slope[index].T / noise**2
    inverse = inverse_of(fisher)
    out = {name: float(np.sqrt(inverse[k, k])) for k, name in enumerate(free)}
    gradient = composite_gradient(parameters)[index]
    out["composite_E"] = float(np.sqrt(gradient @ inverse @ gradient))
    return out


# Profiles ------------------------------------------------------------------------------------


def quantity(name: str, parameters: np.ndarray) -> np.ndarray:
    """Values (…,) of a named quantity for parameters (…, 4)."""
    if name == "composite_E":
        return composite_modulus(parameters)
    return np.asarray(parameters)[..., PARAMETER_NAMES.index(name)]


def quantity_box(name: str, box: np.ndarray) -> tuple[float, float]:
    """Smallest and largest value of a quantity inside the box (4, 2)."""
    return float(quantity(name, box[:, 0])), float(quantity(name, box[:, 1]))


def held(name: str, box: np.ndarray, value: float) -> Coordinates | None:
    """Coordinates of all that is free while a quantity is held at a value (SI); None where box (4, 2) has no such."""
    if name == "composite_E":
        return with_composite(box, value)
    return with_fixed(box, PARAMETER_NAMES.index(name), value)


def _free_start(name: str, parameters: np.ndarray) -> np.ndarray:
    drop = 1 if name == "composite_E" else PARAMETER_NAMES.index(name)
    return np.log(np.delete(parameters, drop))


def quantity_deviation(
    problem: FitProblem, name: str, best: np.ndarray, found: Covariance
) -> tuple[float, float]:
    """Standard deviation of a quantity's logarithm, and the rise of J (m⁴) at one such deviation.

    A parameter on a bound is let free for its own interval only.
    """
    gradient = (
        composite_gradient(best)
        if name == "composite_E"
        else np.eye(4)[PARAMETER_NAMES.index(name)]
    )
    concerned = {"E0", "E1"} if name == "composite_E" else {name}
    free = [i for i, n in enumerate(PARAMETER_NAMES) if n not in found.active or n in concerned]
    if name == "composite_E" and {"E0", "E1"} & set(found.active):
        # On a bound of E0 or E1 only the other one moves the composite modulus.
        free = [i for i, n in enumerate(PARAMETER_NAMES) if n not in found.active]
        if not {0, 1} & set(free):
            free = [i for i, n in enumerate(PARAMETER_NAMES) if n not in found.active or n == "E1"]
    full = _sandwich(found.curvature, found.frame_information, found.scores, free, len(problem))
    inverse = inverse_of(found.curvature[np.ix_(free, free)])
    part = gradient[free]
    variance = float(part @ full @ part)
    rise = variance / max(float(part @ inverse @ part), 1e-300)
    return float(np.sqrt(variance)), rise


def profile(
    problem: FitProblem,
    name: str,
    best: np.ndarray,
    best_cost: float,
    found: Covariance,
    points: int = 9,
    confidence: float = 0.95,
) -> Profile:
    """Profile likelihood of one quantity around the best parameters (4,)."""
    box = problem.box
    low, high = quantity_box(name, box)
    centre = float(quantity(name, best))
    deviation, rise = quantity_deviation(problem, name, best, found)
    deviation = min(max(deviation, 1e-4), np.log(high / low))
    factor = student.ppf(0.5 + 0.5 * confidence, max(len(problem) - 1, 1))
    near = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
    logs = np.concatenate(
        [
            np.log(centre) + deviation * np.concatenate([-near, near]),
            np.linspace(np.log(low), np.log(high), points),
        ]
    )
    logs = np.unique(logs[(logs >= np.log(low) - 1e-12) & (logs <= np.log(high) + 1e-12)])
    values, costs, parameters = [centre], [best_cost], [best]
    # Outwards from the best, each refit from its neighbour.
    for side in (logs[logs < np.log(centre) - 1e-9][::-1], logs[logs > np.log(centre) + 1e-9]):
        start = best
        for log in side:
            value = float(np.clip(np.exp(log), low, high))
            coordinates = held(name, box, value)
            if coordinates is None:
                continue
            fit = refine(problem, coordinates, _free_start(name, start), tolerance=1e-5)
            start = fit.parameters
            values.append(value)
            costs.append(fit.cost)
            parameters.append(fit.parameters)
    order = np.argsort(values)
    value_array = np.array(values)[order]
    cost_array = np.array(costs)[order]
    threshold = best_cost + factor**2 * rise
    lower, open_low = _crossing(value_array, cost_array, centre, best_cost, threshold, -1)
    upper, open_high = _crossing(value_array, cost_array, centre, best_cost, threshold, +1)
    return Profile(
        name,
        value_array,
        cost_array,
        threshold,
        (lower, upper),
        (low, high),
        open_low,
        open_high,
        np.array(parameters)[order],
    )


def in_interval(
    problem: FitProblem,
    name: str,
    value: float,
    best: np.ndarray,
    best_cost: float,
    found: Covariance,
    confidence: float = 0.95,
) -> bool:
    """Whether a value (SI) lies in the interval that `profile` reports, by one refit there instead of a whole profile.

    A value on a bound of the box counts as inside it.
    """
    low, high = quantity_box(name, problem.box)
    if not low * (1 - AT_BOUND) <= value <= high * (1 + AT_BOUND):
        return False
    inside = float(np.clip(value, low * (1 + 1e-9), high * (1 - 1e-9)))
    coordinates = held(name, problem.box, inside)
    if coordinates is None:
        return False
    _, rise = quantity_deviation(problem, name, best, found)
    factor = student.ppf(0.5 + 0.5 * confidence, max(len(problem) - 1, 1))
    fit = refine(problem, coordinates, _free_start(name, best), tolerance=1e-5)
    return bool(fit.cost <= best_cost + factor**2 * rise)


def _crossing(
    values: np.ndarray, costs: np.ndarray, centre: float, base: float, threshold: float, side: int
) -> tuple[float, bool]:
    """Where the profile first exceeds the threshold going outwards, and whether it never does.

    The root of the rise is nearly linear in the logarithm: interpolated so.
    """
    beyond = values[values <= centre][::-1] if side < 0 else values[values >= centre]
    rises = costs[values <= centre][::-1] if side < 0 else costs[values >= centre]
    root = np.sqrt(np.maximum(rises - base, 0.0))
    limit = np.sqrt(max(threshold - base, 0.0))
    above = np.flatnonzero(root > limit)
    if not len(above):
        return float(beyond[-1]), True
    k = int(above[0])
    if k == 0:
        return float(centre), False
    share = (limit - root[k - 1]) / (root[k] - root[k - 1])
    log = np.log(beyond[k - 1]) + share * np.log(beyond[k] / beyond[k - 1])
    return float(np.exp(log)), False


# Bootstrap -----------------------------------------------------------------------------------


def bootstrap_sample(problem: FitProblem, best: np.ndarray, seed: int, index: int) -> np.ndarray:
    """Parameters (4,) refitted to the `index`-th resampling of the trials; the same for every machine."""
    rng = np.random.default_rng([seed, index])
    number = len(problem)
    weights = np.bincount(rng.integers(0, number, number), minlength=number)
    fit: LocalFit = refine(
        problem, whole_box(problem.box), np.log(best), weights, tolerance=1e-4, iterations=12
    )
    return fit.parameters


def bootstrap_interval(
    name: str, samples: np.ndarray, confidence: float = 0.95
) -> tuple[float, float]:
    """Percentile interval of a quantity over bootstrap samples (B, 4)."""
    values = quantity(name, samples)
    tail = 0.5 * (1.0 - confidence)
    low, high = np.quantile(values, [tail, 1.0 - tail])
    return float(low), float(high)
