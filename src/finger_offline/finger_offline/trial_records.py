# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Trials as read from bags: a press with its force, areas and moisture readings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from .unloaded import Unloaded


@dataclass(frozen=True)
class TrialRecord:
    """One trial (SI). Stamps are acquisition times in ns.

    stamp_ns (n,), force (n,): normal force, positive in compression, at full rate, from `margin`
    before onset to `margin` after lift-off; lateral_force (n,). area_stamp_ns, area, area_sd (m²,
    NaN where unknown), area_flags (k,): gross areas; real_area (k,). indentation_stamp_ns,
    indentation (j,): measured approach of plate and bone in m, positive into the finger, of unknown
    zero; empty where none was measured. history_ns, history (h,): normal force of the same
    recording before stamp_ns[0], thinned as of `force_history.force_before`; empty where it is not
    known. moisture_before, moisture_after: readings (a.u.). onset_ns, liftoff_ns: first sample at
    or above the onset force, first one below the lift-off force (None when the recording ends
    before). completed: false where messages announce the trial and not that it was done.
    area_source: "topic" or "images". doubts: what is wrong with the recording that it comes from.
    finger: such as right_index, empty where it was not noted.
    """

    bag: str
    session: str
    subject: str
    condition: str
    index: int
    attempt: int
    target_force: float
    stamp_ns: np.ndarray
    force: np.ndarray
    lateral_force: np.ndarray
    area_stamp_ns: np.ndarray
    area: np.ndarray
    area_sd: np.ndarray
    area_flags: np.ndarray
    real_area: np.ndarray
    moisture_before: list[float]
    moisture_after: list[float]
    onset_ns: int
    liftoff_ns: int | None
    completed: bool = True
    finger: str = ""
    area_source: str = "topic"
    doubts: tuple[str, ...] = ()
    indentation_stamp_ns: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    indentation: np.ndarray = field(default_factory=lambda: np.empty(0))
    history_ns: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    history: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def moisture(self) -> float:
        """Mean of all readings (a.u.), NaN without any."""
        readings = self.moisture_before + self.moisture_after
        return float(np.mean(readings)) if readings else float("nan")

    @property
    def peak_force(self) -> float:
        """Largest normal force (N)."""
        return float(np.nanmax(self.force)) if len(self.force) else float("nan")


@dataclass(frozen=True)
class Exclusion:
    """A press or trial that was left out, and the reason; index: None for all of a bag."""

    bag: str
    condition: str
    index: int | None
    reason: str
    subject: str = ""


@dataclass
class TrialSet:
    """Trials of one or more bags, what was left out, and what was wrong with the bags.

    pulls: trials for the friction, which are among the exclusions too. lost: bags of which
    something could not be read. moved: how the force of the unloaded plate moves in one bag, None
    where it does not. unannounced: what to say of presses in one bag that belong to no announced
    trial, empty where there are none.
    """

    trials: list[TrialRecord] = field(default_factory=list)
    pulls: list[TrialRecord] = field(default_factory=list)
    exclusions: list[Exclusion] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    moved: Unloaded | None = None
    unannounced: str = ""

    def __len__(self) -> int:
        return len(self.trials)

    def __iter__(self) -> Iterator[TrialRecord]:
        return iter(self.trials)

    @property
    def conditions(self) -> list[str]:
        """Conditions in the order they appear."""
        return list(dict.fromkeys(t.condition for t in self.trials))

    def of(self, condition: str) -> list[TrialRecord]:
        """Trials of one condition."""
        return [t for t in self.trials if t.condition == condition]
