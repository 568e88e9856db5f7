# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Progress of a fit: what a caller learns of its stages, and the time that they take."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

import numpy as np

Report = Callable[[str, str, int, int, float, np.ndarray], None]
"""Called with condition, stage, round (0 where a stage begins), rounds, J (m⁴) of the best and its
parameters (N,); raises Stopped to end the fit."""


class Progress:
    """Stages of one condition, "" for what all conditions share. seconds: time by stage."""

    def __init__(self, condition: str, parameters: int, report: Report | None) -> None:
        self.seconds: dict[str, float] = {}
        self.condition = condition
        self._report = report
        self._cost = float("nan") if not condition else np.inf
        self._best = np.full(parameters, np.nan)

    @contextlib.contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the time of the block to a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            self.seconds[stage] = self.seconds.get(stage, 0.0) + spent

    @contextlib.contextmanager
    def step(self, stage: str) -> Iterator[None]:
        """Time a stage that has no rounds, and show its beginning and its end."""
        done = self.count(stage)
        with self.timed(stage):
            done(0, 1)
            yield
        done(1, 1)

    def improved(self, cost: float, best: np.ndarray) -> None:
        """What the stages show from now on: J (m⁴) and parameters (N,) of the best."""
        self._cost, self._best = cost, best

    def rounds(self, stage: str) -> Callable[[int, int, float, np.ndarray], None]:
        """Callback of a stage that improves the best: round, rounds, best cost, best parameters."""

        def update(number: int, rounds: int, cost: float, best: np.ndarray) -> None:
            self.improved(cost, best)
            if self._report is not None:
                self._report(self.condition, stage, number, rounds, cost, best)

        return update

    def count(self, stage: str) -> Callable[[int, int], None]:
        """Callback of a stage of independent pieces: pieces done, pieces in all."""
        return lambda done, total: self.rounds(stage)(done, total, self._cost, self._best)
