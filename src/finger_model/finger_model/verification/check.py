# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Result of one verification: numbers with limits, and curves for a figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

FEW_PLACES = 8
"""A logarithmic axis with no more abscissae than this has its ticks there."""


@dataclass(frozen=True)
class Measure:
    """One number and its limits, each of which may be None; without limits it is reported only."""

    what: str
    value: float
    unit: str = ""
    low: float | None = None
    high: float | None = None

    @property
    def passes(self) -> bool:
        """True if the value lies within its limits."""
        above = self.low is None or self.value >= self.low
        return above and (self.high is None or self.value <= self.high)

    def limit(self) -> str:
        """The limits as text."""
        if self.low is None and self.high is None:
            return "reported"
        if self.low is None:
            return f"≤ {self.high:g}"
        if self.high is None:
            return f"≥ {self.low:g}"
        return f"{self.low:g} … {self.high:g}"


class Curve(NamedTuple):
    """Points x, y (n,), matplotlib's format of the line, and its label."""

    x: Sequence[float] | np.ndarray
    y: Sequence[float] | np.ndarray
    style: str = "-"
    label: str | None = None


@dataclass
class Panel:
    """One panel of a figure. scale: "linear", "semilogx", "semilogy" or "loglog"."""

    x_label: str
    y_label: str
    curves: list[Curve]
    scale: str = "linear"
    legend: str = ""

    def draw(self, axes) -> None:
        """Draw on matplotlib axes."""
        plot = axes.plot if self.scale == "linear" else getattr(axes, self.scale)
        for curve in self.curves:
            plot(curve.x, curve.y, curve.style, label=curve.label, markersize=4, linewidth=1.2)
        axes.set(xlabel=self.x_label, ylabel=self.y_label)
        places = sorted({float(x) for curve in self.curves for x in curve.x})
        if self.scale in ("semilogx", "loglog") and len(places) <= FEW_PLACES:
            axes.set_xticks(places, [f"{x:.3g}" for x in places])
            axes.set_xticks([], minor=True)
        if any(curve.label for curve in self.curves):
            axes.legend(title=self.legend or None, fontsize="small")


@dataclass
class Check:
    """One point of the verification: its numbers, and the panels of its figure if it has one."""

    name: str
    title: str
    text: str
    measures: list[Measure]
    panels: Sequence[Panel] = field(default_factory=list)

    @property
    def passes(self) -> bool:
        """True if every measure lies within its limits."""
        return all(measure.passes for measure in self.measures)

    def __getitem__(self, what: str) -> float:
        """Value of a measure."""
        return next(m.value for m in self.measures if m.what == what)


def percent(value: np.ndarray | float, exact: np.ndarray | float) -> np.ndarray:
    """Relative difference in %."""
    return 100.0 * (np.asarray(value) / exact - 1.0)


def largest(values: np.ndarray) -> float:
    """Largest absolute value."""
    return float(np.abs(values).max())
