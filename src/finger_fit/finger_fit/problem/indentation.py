# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Measured indentation beside the areas: what of a model is compared with it, and how it weighs.

A displacement sensor knows the approach of plate and bone up to a constant. The constant that fits
best is the mean difference of a trial, so the mean of each trial is taken off measurement and model
alike: that is the least-squares solution with a free constant in every trial. What is left is
multiplied by (noise of a frame's area) / (deviation of an indentation), in m² per m: then it stands
beside the areas as further rows of the same noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .trials import FitTrial

MODEL_ERROR = 0.01
"""Error of a model's indentation over the largest of a press, where the model does not state it."""


@dataclass(frozen=True)
class IndentationRows:
    """Indentations of all trials that have them, trial after trial.

    measured (q,): m; trial_of (q,): index of the trial; sd (q,): m; weight (q,): that of an area of
    the same trial.
    """

    measured: np.ndarray
    trial_of: np.ndarray
    sd: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, trials: Sequence[FitTrial], model: Any, sd: float) -> IndentationRows | None:
        """Take the indentations of trials; None where none has any.

        sd: m, of a measured indentation; the model's own error is added as squares.
        """
        lengths = [len(t.indentation) for t in trials]
        if not sum(lengths):
            return None
        error = getattr(model, "measured_error", {}).get("indentation_p90", MODEL_ERROR)
        each = [np.hypot(sd, error * np.ptp(t.indentation)) if n else 0.0
                for t, n in zip(trials, lengths)]  # fmt: skip
        return cls(
            np.concatenate([t.indentation for t in trials]),
            np.repeat(np.arange(len(trials)), lengths),
            np.repeat(each, lengths),
            np.repeat([1.0 / len(t.frames) for t in trials], lengths),
        )

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sums (…, m) of values (…, q) over each of the m trials that have indentations."""
        return np.add.reduceat(values, self._starts, axis=-1)

    @property
    def trials(self) -> np.ndarray:
        """Indices (m,) of the trials that have indentations."""
        return self.trial_of[self._starts]

    @property
    def _starts(self) -> np.ndarray:
        return np.flatnonzero(np.diff(self.trial_of, prepend=-1))

    def means(self, values: np.ndarray) -> np.ndarray:
        """Mean (…, q) of values (…, q) over the trial of each row."""
        number = np.bincount(self.trial_of)[self.trials]
        return np.repeat(self.sums(values) / number, number, axis=-1)

    def compared(self, values: np.ndarray, noise: float) -> np.ndarray:
        """Turn indentations (…, q) in m into rows (…, q) in m² that stand beside areas of a noise
        (m²)."""
        return (values - self.means(values)) * (noise / self.sd)
