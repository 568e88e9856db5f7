# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bootstrap over trials: parameters refitted to resampled trials."""

from __future__ import annotations

import numpy as np

from ..problem import FitProblem
from ..search import all_free, refine


def bootstrap_sample(problem: FitProblem, best: np.ndarray, seed: int, index: int) -> np.ndarray:
    """Parameters (N,) refitted to the `index`-th resampling; the same on every machine."""
    rng = np.random.default_rng([seed, index])
    number = len(problem)
    multiplicity = np.bincount(rng.integers(0, number, number), minlength=number)
    return refine(
        problem,
        all_free(problem),
        best,
        problem.row_weight * multiplicity[problem.row_trial],
        tolerance=1e-4,
        iterations=12,
    ).parameters
