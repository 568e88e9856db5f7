# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The measured indentations of a fit beside the fitted model's: plain data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..problem import FitProblem


@dataclass(frozen=True)
class IndentationFit:
    """Indentations of one condition beside the model's, trial after trial (SI).

    measured, predicted (q,): m, the measured ones less the zero of their trial; time (q,), force
    (q,): s from first touch and N; trial_of (q,): index of the trial; zeros: m by label of the
    trial; sd: m, by which they were weighed (root mean square); gain: of the sensor.
    """

    measured: np.ndarray
    predicted: np.ndarray
    time: np.ndarray
    force: np.ndarray
    trial_of: np.ndarray
    zeros: dict[str, float]
    sd: float
    gain: float

    @property
    def rms(self) -> float:
        """Root mean square of the residuals (m); the zero of each trial counts as fitted."""
        residual = self.measured - self.predicted
        return float(np.sqrt((residual**2).sum() / (len(residual) - len(self.zeros))))

    @property
    def travel(self) -> float:
        """Median over the trials of the largest change of the measured indentation (m)."""
        return float(
            np.median([np.ptp(self.measured[self.trial_of == t]) for t in set(self.trial_of)])
        )

    def to_dict(self) -> dict[str, object]:
        """Make the entry of fit.json."""
        return {
            "trials": len(self.zeros),
            "frames": len(self.measured),
            "sd": self.sd,
            "rms": self.rms,
            "gain": self.gain,
            "zeros": self.zeros,
        }


def indentation_fit(problem: FitProblem, parameters: np.ndarray) -> IndentationFit | None:
    """Compare at fitted parameters (N,); None where no trial has an indentation."""
    rows = problem.indentations
    if rows is None:
        return None
    number = len(problem.measured)
    factor = 1.0 if problem.nuisances is None else problem.nuisances.factor[number]
    predicted = factor * problem.corrected(parameters)[0][number:]
    zeros = rows.means(rows.measured - predicted)
    trials = problem.trials
    used = rows.trials
    first = np.searchsorted(rows.trial_of, used)
    return IndentationFit(
        rows.measured - zeros,
        predicted,
        np.concatenate([trials[t].time[trials[t].drive.indentation_rows] for t in used]),
        np.concatenate([trials[t].force[trials[t].drive.indentation_rows] for t in used]),
        rows.trial_of,
        {trials[t].label: float(zeros[k]) for t, k in zip(used, first)},
        float(np.sqrt(np.mean(rows.sd**2))),
        float(factor),
    )
