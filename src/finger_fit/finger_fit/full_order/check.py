# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Check of a fit's top candidates against a better model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.special import chdtri

from ..engine import Done
from ..problem import FitProblem
from .areas import BetterModel


@dataclass(frozen=True)
class FullOrderCheck:
    """Top candidates by both models.

    full_costs (C,): in m⁴, J with the nuisances eliminated, infinite where full order fails; areas
    (C, n): full-order areas (m²) at the frames; rms_difference: of the best candidate's areas by
    both models, uncorrected, over the largest area; best: index of the candidate that full order
    prefers; headline: name of the space's headline quantity; change: its relative change by
    re-ranking; gain: by how much full order finds that candidate better, as a χ² of one degree of
    freedom. A fit is final with rms_difference ≤ AREA_LIMIT and change ≤ CHANGE_LIMIT; a larger
    change is none where gain ≤ GAIN_LIMIT: noise then decides which of the two is the best, and the
    interval holds both.
    """

    AREA_LIMIT: ClassVar[float] = 0.01
    CHANGE_LIMIT: ClassVar[float] = 0.02
    GAIN_LIMIT: ClassVar[float] = float(chdtri(1, 1.0 - 0.95))

    full_costs: np.ndarray
    areas: np.ndarray
    rms_difference: float
    best: int
    headline: str
    change: float
    gain: float

    @property
    def reasons(self) -> list[str]:
        """Why the fit is not final; empty where it is."""
        if not np.isfinite(self.rms_difference):
            return ["the full-order model does not carry these presses with the fitted parameters"]
        out = []
        if not self.rms_difference <= self.AREA_LIMIT:
            out.append(
                f"full and reduced order differ by {100 * self.rms_difference:.2f} % of the "
                f"largest area (limit {100 * self.AREA_LIMIT:g} %)"
            )
        if not (self.change <= self.CHANGE_LIMIT or self.gain <= self.GAIN_LIMIT):
            out.append(
                f"re-ranking by full order changes {self.headline} by {100 * self.change:.1f} % "
                f"(limit {100 * self.CHANGE_LIMIT:g} %), and noise does not explain it"
            )
        return out


def check(
    problem: FitProblem, candidates: np.ndarray, better: BetterModel, done: Done | None = None
) -> FullOrderCheck:
    """Simulate candidates (C, N), best first, with a better model over all trials."""
    areas = better.areas(problem, candidates, done)
    reduced = problem.raw_areas(candidates)
    full_costs = problem.goal().cost(problem.compared(areas))
    areas = areas[:, : len(problem.measured)]
    best = int(np.nanargmin(full_costs)) if np.isfinite(full_costs).any() else 0
    headline = problem.space.headline
    values = problem.space.quantity(headline, candidates)
    finite = bool(np.isfinite(full_costs[0]))
    gain = (full_costs[0] / full_costs[best] - 1.0) * (areas.shape[1] - len(candidates[0]))
    difference = np.sqrt(np.mean((areas[0] - reduced[0]) ** 2)) / areas[0].max()
    return FullOrderCheck(
        full_costs,
        areas,
        float(difference),
        best,
        headline,
        float(abs(values[best] / values[0] - 1.0)) if finite else np.nan,
        float(gain) if finite else np.nan,
    )
