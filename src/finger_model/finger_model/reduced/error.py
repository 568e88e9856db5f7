# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Error of a reduced model against full-order runs, over pairs of parameters and history."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from finger_common.errors import ModelError

from ..laws import law_of
from .goals import GOAL_RMS, GOAL_WORST, LIMIT_RMS, LIMIT_WORST
from .model import ReducedModel
from .training_runs import Run

COUNTED_FORCE = 0.1
"""N; rows below it do not count."""


class History(Protocol):
    """What of a full-order run the errors are taken against."""

    kind: str
    force: np.ndarray
    area: np.ndarray
    indentation: np.ndarray
    peak: np.ndarray


@dataclass
class PairError:
    """Errors of one pair, as shares of the history's largest value.

    kind of history; finger: material and, where there are several, geometry, in words; rms, worst,
    worst_force: RMS and worst instant of the area, and the force (N) at it; indentation,
    indentation_rms: worst instant and RMS; peak: RMS of the peak pressure.
    """

    kind: str
    finger: str
    rms: float
    worst: float
    worst_force: float
    indentation: float
    indentation_rms: float
    peak: float


@dataclass
class ErrorTable:
    """Errors of many pairs; `pairs` in the order of the runs."""

    pairs: list[PairError] = field(default_factory=list)

    def _column(self, name: str) -> np.ndarray:
        return np.array([getattr(p, name) for p in self.pairs])

    def share_within(self, rms: float = GOAL_RMS, worst: float = GOAL_WORST) -> float:
        """Share of the pairs whose area is within a share RMS and at the worst instant."""
        return float(np.mean((self._column("rms") <= rms) & (self._column("worst") <= worst)))

    def indentation_within(self, rms: float = GOAL_RMS, worst: float = GOAL_WORST) -> float:
        """The same of indentation."""
        within = self._column("indentation_rms") <= rms
        return float(np.mean(within & (self._column("indentation") <= worst)))

    def none_beyond(self) -> bool:
        """Whether no pair is beyond LIMIT_RMS or LIMIT_WORST."""
        return bool(
            np.all((self._column("rms") <= LIMIT_RMS) & (self._column("worst") <= LIMIT_WORST))
        )

    def worst(self) -> PairError:
        """The pair with the largest error at an instant."""
        return max(self.pairs, key=lambda pair: pair.worst)

    def summary(self) -> dict[str, Any]:
        """Figures kept in the model's file, as shares."""
        rms, worst = self._column("rms"), self._column("worst")
        found: dict[str, Any] = {"pairs": len(self.pairs)}
        for name, values in (
            ("rms", rms),
            ("worst", worst),
            ("indentation", self._column("indentation")),
            ("peak", self._column("peak")),
        ):
            for label, percent in (("median", 50), ("p90", 90), ("p99", 99), ("max", 100)):
                found[f"{name}_{label}"] = round(float(np.percentile(values, percent)), 6)
        found["share_within"] = round(self.share_within(), 4)
        return found

    def text(self, rms: float = GOAL_RMS, worst: float = GOAL_WORST) -> str:
        """The distribution, errors by kind of history, the worst pair and the share of the pairs
        within the goal, for the terminal."""
        lines = [
            f"{len(self.pairs)} pairs of parameter set and force history, F ≥ {COUNTED_FORCE} N, "
            "errors in % of the history's largest value",
            f"{'':24s}{'median':>8s}{'90 %':>8s}{'99 %':>8s}{'worst':>8s}",
        ]
        for label, name in (
            ("area, RMS", "rms"),
            ("area, worst instant", "worst"),
            ("indentation, worst", "indentation"),
            ("peak pressure, RMS", "peak"),
        ):
            row = np.percentile(100 * self._column(name), [50, 90, 99, 100])
            lines.append(f"{label:24s}" + "".join(f"{v:8.2f}" for v in row))
        kinds = sorted({p.kind for p in self.pairs})
        for kind in kinds:
            part = ErrorTable([p for p in self.pairs if p.kind == kind])
            row = np.percentile(100 * part._column("rms"), [50, 90, 99, 100])
            lines.append(f"  {kind + ', area RMS':22s}" + "".join(f"{v:8.2f}" for v in row))
        pair = self.worst()
        lines.append(
            f"worst pair: {pair.kind}, {pair.finger}: RMS {100 * pair.rms:.2f} %, "
            f"{100 * pair.worst:.2f} % at {pair.worst_force:.2f} N"
        )
        lines.append(
            f"within {100 * rms:g} % RMS and {100 * worst:g} % worst: "
            f"{100 * self.share_within(rms, worst):.1f} % of the pairs; "
            f"none beyond {100 * LIMIT_RMS:g} % / {100 * LIMIT_WORST:g} %: "
            + ("yes" if self.none_beyond() else "no")
        )
        return "\n".join(lines)


def pair_error(model: ReducedModel, run: Run) -> PairError | None:
    """Error along one run; None when fewer than three of its rows count, or the model refuses."""
    model = model.for_law(law_of(run.law))
    limit = model.force_limit(run.parameters)
    counted = (run.force >= COUNTED_FORCE) & (np.maximum.accumulate(run.force) <= limit)
    if np.sum(counted) < 3:
        return None
    try:
        found = model.simulate(run.parameters, run.time, np.minimum(run.force, limit))
    except ModelError:
        return None
    table = np.column_stack([found.area, found.indentation, found.peak_pressure])
    values = zip(model.space, run.parameters)
    named = ", ".join(f"{p.symbol} {p.text(value)} {p.display_unit}" for p, value in values)
    return error_along(run, table, counted, named)


def error_along(run: History, found: np.ndarray, counted: np.ndarray, finger: str) -> PairError:
    """Error of area, indentation and peak pressure `found` (n, 3) on the rows that count (n,)."""
    truth = np.column_stack([run.area, run.indentation, run.peak])[counted]
    errors = (found[counted] - truth) / np.maximum(truth.max(axis=0), 1e-9)
    rms = np.sqrt(np.mean(errors**2, axis=0))
    worst = np.abs(errors).max(axis=0)
    at = int(np.argmax(np.abs(errors[:, 0])))
    return PairError(
        run.kind,
        finger,
        rms=float(rms[0]),
        worst=float(worst[0]),
        worst_force=float(run.force[counted][at]),
        indentation=float(worst[1]),
        indentation_rms=float(rms[1]),
        peak=float(rms[2]),
    )


def error_table(model: ReducedModel, runs: list[Run]) -> ErrorTable:
    """Errors along all runs that count."""
    found = [pair_error(model, run) for run in runs]
    return ErrorTable([p for p in found if p is not None])
