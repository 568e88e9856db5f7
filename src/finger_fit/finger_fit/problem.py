"""The cost of a parameter set: the paper's J on the frames that count, and the power law on the same frames.

J = Σ over trials of the mean over the trial's frames of (model area − measured area)², in m⁴ (reports: mm⁴).
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from .options import FitOptions
from .trials import FitTrial

MM2 = 1e6
"""mm² in a m²."""
MM4 = 1e12
"""mm⁴ in a m⁴."""

_batch_lock = threading.Lock()
"""The compiled kernels of a batch share one pool of threads and do not nest."""


class AreaModel(Protocol):
    """What a fit needs of a model."""

    def batch(
        self, parameters: np.ndarray, trials: Sequence[tuple[np.ndarray, ...]]
    ) -> list[np.ndarray]:
        """Areas (P, f) in m² per trial, of parameters (P, 4): E0, E1 (Pa), tau1 (s), E2 (Pa); a trial is time (n,)
        in s, force (n,) in N and rows (f,), the samples whose area is wanted."""
        ...


@dataclass(frozen=True)
class PowerLaw:
    """A = k F^m. k in m²/N^m, cost in m⁴ on the fit's frames; log_m: slope of a log–log regression."""

    k: float
    m: float
    cost: float
    log_m: float

    def area(self, force: np.ndarray) -> np.ndarray:
        """Area in m² at force in N."""
        return self.k * np.maximum(force, 0.0) ** self.m


@dataclass(frozen=True)
class AreaCorrection:
    """Factor that turns a model's areas into a better model's, around some parameters.

    The logarithm of the factor is linear in the logarithms of composite modulus, E0, tau1 and E2: log_ratio (n,) at
    `centre` (4,), a parameter set, and slope (4, n).
    """

    centre: np.ndarray
    log_ratio: np.ndarray
    slope: np.ndarray

    @staticmethod
    def place(parameters: np.ndarray) -> np.ndarray:
        """Coordinates (P, 4) of parameters (P, 4)."""
        logs = np.log(np.atleast_2d(parameters))
        logs[:, 1] = np.log(composite_modulus(np.atleast_2d(parameters)))
        return logs[:, [1, 0, 2, 3]]

    def factor(self, parameters: np.ndarray) -> np.ndarray:
        """Factor (P, n) for parameters (P, 4)."""
        away = self.place(parameters) - self.place(self.centre)
        return np.exp(self.log_ratio + away @ self.slope)


class FitProblem:
    """Trials of one condition, the model and the options: everything J depends on.

    Arrays over all frames, trial after trial: measured (n,) m², force (n,) N, trial_of (n,), weight (n,), which
    sums to one within a trial. correction: of the model's areas, None unless full order was consulted
    (`full_order_check.correct`). Calls are deterministic and safe from several threads.
    """

    def __init__(self, trials: Sequence[FitTrial], model: AreaModel, options: FitOptions) -> None:
        self.trials = tuple(trials)
        self.model = model
        self.options = options
        self.box = options.box()
        self.measured = np.concatenate([t.area for t in self.trials])
        self.force = np.concatenate([t.frame_force for t in self.trials])
        lengths = [len(t.frames) for t in self.trials]
        self.trial_of = np.repeat(np.arange(len(lengths)), lengths)
        self.starts = np.concatenate([[0], np.cumsum(lengths)])
        raw = np.where(np.concatenate([t.low for t in self.trials]), options.low_force_weight, 1.0)
        sums = np.add.reduceat(raw, self.starts[:-1])
        # A trial all of whose frames carry no weight takes no part.
        self.weight = raw / np.where(sums > 0, sums, 1.0)[self.trial_of]
        self.correction: AreaCorrection | None = None
        self._drives = [(t.time, t.force, t.frames) for t in self.trials]
        self.evaluations = 0

    def __len__(self) -> int:
        return len(self.trials)

    @property
    def largest_area(self) -> float:
        """Largest measured area in m²."""
        return float(self.measured.max())

    def areas(self, parameters: np.ndarray) -> np.ndarray:
        """Areas (P, n) in m² at the frames that count, for parameters (P, 4): the model's, corrected."""
        raw = self.raw_areas(parameters)
        if self.correction is None:
            return raw
        return raw * self.correction.factor(parameters)

    def raw_areas(self, parameters: np.ndarray) -> np.ndarray:
        """As `areas`, without the correction."""
        parameters = np.atleast_2d(np.asarray(parameters, dtype=float))
        with _batch_lock:
            parts = self.model.batch(parameters, self._drives)
        self.evaluations += len(parameters)
        return np.concatenate(parts, axis=1)

    def losses(self, areas: np.ndarray) -> np.ndarray:
        """Loss in m⁴ of every frame, the residual's square unless a robust loss is set; areas (…, n)."""
        residual = areas - self.measured
        if self.options.loss == "huber":
            scale = self.options.huber_scale
            size = np.abs(residual)
            return np.where(size <= scale, residual**2, scale * (2.0 * size - scale))
        return residual**2

    def trial_costs(self, areas: np.ndarray) -> np.ndarray:
        """Cost (…, T) in m⁴ of every trial for areas (…, n): the weighted mean of its frames' losses."""
        return np.add.reduceat(self.weight * self.losses(areas), self.starts[:-1], axis=-1)

    def cost(self, parameters: np.ndarray) -> np.ndarray:
        """J (P,) in m⁴ of parameters (P, 4)."""
        return self.trial_costs(self.areas(parameters)).sum(axis=-1)

    def power_law(self) -> PowerLaw:
        """The power law that minimises the same J (nonlinear least squares in area, pooled)."""
        force, measured, weight = self.force, self.measured, self.weight
        usable = (measured > 0) & (force > 0)
        log_m = float(np.polyfit(np.log(force[usable]), np.log(measured[usable]), 1)[0])

        def best_k(m: float) -> float:
            shape = force**m
            return float((weight * shape * measured).sum() / (weight * shape * shape).sum())

        def cost(m: float, k: float) -> float:
            return float((weight * self.losses(k * force**m)).sum())

        # k follows from m in closed form under squares, which leaves one dimension.
        found = minimize_scalar(
            lambda m: cost(m, best_k(m)) * MM4,
            bounds=(0.05, 2.0),
            method="bounded",
            options={"xatol": 1e-10},
        )
        m, k = float(found.x), best_k(float(found.x))
        if self.options.loss == "huber":
            scale = self.options.huber_scale * MM2
            refined = least_squares(
                lambda v: np.sqrt(weight) * (v[0] * force ** v[1] - measured * MM2),
                [k * MM2, m],
                loss="linear",
            ).x
            for _ in range(50):
                residual = refined[0] * force ** refined[1] - measured * MM2
                robust = np.minimum(1.0, scale / np.maximum(np.abs(residual), 1e-12))
                before = refined
                refined = least_squares(
                    lambda v, r=robust: (
                        np.sqrt(weight * r) * (v[0] * force ** v[1] - measured * MM2)
                    ),
                    refined,
                ).x
                if np.allclose(before, refined, rtol=1e-9):
                    break
            k, m = float(refined[0]) / MM2, float(refined[1])
        return PowerLaw(k, m, cost(m, k), log_m)


def composite_modulus(parameters: np.ndarray) -> np.ndarray:
    """E = 1/(1/E0 + 1/E1) in Pa of parameters (…, 4)."""
    parameters = np.asarray(parameters, dtype=float)
    return 1.0 / (1.0 / parameters[..., 0] + 1.0 / parameters[..., 1])
