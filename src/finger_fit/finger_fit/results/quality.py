# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What was noted of a condition's data: checks with a status each, and its trials."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from finger_bag.validate import FAIL, Check


@dataclass(frozen=True)
class TrialQuality:
    """One trial.

    J: m⁴; lag: s of the areas behind the fitted model, NaN where it is unclear; tare: force (N) on
    the unloaded plate, NaN where the trial does not show it; gain: measured area over the model's,
    NaN where no frame has a weight; frames, saturated, doubtful, low: numbers of frames.
    """

    label: str
    J: float
    lag: float
    tare: float
    gain: float
    frames: int
    saturated: int
    doubtful: int
    low: int


@dataclass
class Quality:
    """Checks and trials of one condition."""

    checks: list[Check] = field(default_factory=list)
    trials: list[TrialQuality] = field(default_factory=list)

    @property
    def failures(self) -> list[str]:
        """Names and details of the checks that fail."""
        return [f"{c.name}: {c.detail}" for c in self.checks if c.status == FAIL]

    def add(self, name: str, status: str, detail: str) -> None:
        self.checks.append(Check(name, status, detail))

    def to_data(self) -> dict[str, Any]:
        """Make `checks` and `trials` (SI, J in mm⁴) for JSON."""
        trials = [{**asdict(t), "J": t.J * 1e12} for t in self.trials]
        return {"checks": [asdict(c) for c in self.checks], "trials": trials}
