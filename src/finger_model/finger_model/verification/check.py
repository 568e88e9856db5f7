"""Result of one verification."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from matplotlib.figure import Figure


@dataclass(frozen=True)
class Measure:
    """One number against its limit: value in [low, high], either may be None; both None for a figure reported."""

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
        """The limits in words."""
        if self.low is None and self.high is None:
            return "reported"
        if self.low is None:
            return f"≤ {self.high:g}"
        if self.high is None:
            return f"≥ {self.low:g}"
        return f"{self.low:g} … {self.high:g}"


@dataclass
class Check:
    """One point of the verification with its numbers and, perhaps, a figure."""

    name: str
    title: str
    text: str
    measures: list[Measure] = field(default_factory=list)
    draw: Callable[[Figure], None] | None = None

    @property
    def passes(self) -> bool:
        """True if every measure lies within its limits."""
        return all(measure.passes for measure in self.measures)

    def __getitem__(self, what: str) -> float:
        """Value of a measure."""
        return next(m.value for m in self.measures if m.what == what)
