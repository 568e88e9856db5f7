# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contact at one instant and over time, as models give it; the CSV files of force and contact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.columns import column
from finger_common.errors import InputError
from finger_common.files import read_csv

LATEST_TIME = 1e10
"""s, 300 years: beyond the seconds since 1970, and a float tells microseconds apart."""

SMALLEST_FORCE = 1e-12
"""N; smaller forces are no contact: their areas are rounding."""

CSV_HEADER = "time_s,force_n,area_mm2,radius_mm,indentation_mm,peak_pressure_kpa"


@dataclass(frozen=True)
class ContactPoint:
    """Contact at one instant (SI): s, N, m², m, m, Pa, Pa.

    `indentation` is the plate's travel from first touch of the unloaded shape; without contact it
    is where the plate would just touch. `peak_pressure` is the maximum of the smoothed contact
    pressure, `mean_pressure` force over area.
    """

    time: float
    force: float
    area: float
    radius: float
    indentation: float
    peak_pressure: float
    mean_pressure: float


@dataclass(frozen=True)
class ContactHistory:
    """Contact over time: arrays (n,) in SI, the fields of ContactPoint."""

    time: np.ndarray
    force: np.ndarray
    area: np.ndarray
    radius: np.ndarray
    indentation: np.ndarray
    peak_pressure: np.ndarray
    mean_pressure: np.ndarray

    def __len__(self) -> int:
        return len(self.time)

    @classmethod
    def from_points(cls, points: Sequence[ContactPoint]) -> ContactHistory:
        """History of the given points in their order."""
        return cls(**{f.name: np.array([getattr(p, f.name) for p in points]) for f in fields(cls)})

    def at(self, rows: np.ndarray) -> ContactHistory:
        """The history at some of its instants."""
        return ContactHistory(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def csv_text(self) -> str:
        """The header CSV_HEADER and one line per instant."""
        return csv_of(CSV_HEADER, self.time, self.force, *self.csv_columns())

    def csv_columns(self) -> tuple[np.ndarray, ...]:
        """The columns behind time and force, in the units of CSV_HEADER."""
        return (
            self.area * 1e6,
            self.radius * 1e3,
            self.indentation * 1e3,
            self.peak_pressure * 1e-3,
        )


def csv_of(header: str, time: np.ndarray, force: np.ndarray, *columns: np.ndarray) -> str:
    """CSV text of columns (n,); time and force, the input, come back digit by digit."""
    lines = [header]
    for instant, load, *rest in zip(time.tolist(), force.tolist(), *columns):
        lines.append(f"{instant!r},{load!r}," + ",".join(f"{value:.6g}" for value in rest))
    return "\n".join(lines) + "\n"


def mean_pressure(force: float, area: float) -> float:
    """Force over area in Pa; zero without contact."""
    return force / area if area > 0 else 0.0


def radius_to_area(radius: float) -> float:
    """πr² in m²."""
    return math.pi * radius * radius


def check_force_history(
    time: Any, force: Any, where: str = "force history"
) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) in s and force (n,) in N as float arrays, of what `column` takes; forces below
    SMALLEST_FORCE are zero.

    Raises InputError for empty, unequal or non-finite arrays, for time that does not increase, and
    for times beyond ±LATEST_TIME.
    """
    time, force = column(time, f"{where}: time"), column(force, f"{where}: force")
    if time.shape != force.shape or not len(time):
        raise InputError(
            f"{where}: time {time.shape} and force {force.shape} must be two arrays of equal "
            "length, not empty"
        )
    for name, values in (("time", time), ("force", force)):
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise InputError(f"{where}: {name} in row {bad[0] + 1} is not finite; remove the row")
    bad = np.flatnonzero(np.abs(time) > LATEST_TIME)
    if len(bad):
        raise InputError(
            f"{where}: time in row {bad[0] + 1} is {time[bad[0]]:g} s; give times in seconds, "
            f"within ±{LATEST_TIME:g} s"
        )
    bad = np.flatnonzero(np.diff(time) <= 0)
    if len(bad):
        row = int(bad[0]) + 1
        raise InputError(
            f"{where}: time does not increase from row {row} ({time[row - 1]:g} s) to row "
            f"{row + 1} ({time[row]:g} s); sort the rows and remove repeated times"
        )
    return time, np.where(np.abs(force) < SMALLEST_FORCE, 0.0, force)


def check_trial(trial: Sequence[Any], where: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (n,) in s, force (n,) in N and rows (f,) of a trial (time, force) or (time, force,
    rows): the samples that are wanted, all of them where left out.

    Raises InputError as `check_force_history`, and for rows that are no increasing whole numbers
    from 0 to n - 1.
    """
    time, force = check_force_history(trial[0], trial[1], where)
    if len(trial) < 3:
        return time, force, np.arange(len(time))
    rows = np.asarray(trial[2])
    if rows.ndim != 1 or (len(rows) and rows.dtype.kind not in "iu"):
        raise InputError(
            f"{where}: the wanted rows are {rows.dtype} {rows.shape}, whole numbers (f,) are "
            "needed; np.flatnonzero gives those of a mask"
        )
    rows = rows.astype(np.int64)
    if len(rows) and (rows[0] < 0 or rows[-1] >= len(time) or np.any(np.diff(rows) <= 0)):
        raise InputError(
            f"{where}: the wanted rows must increase from 0 to {len(time) - 1} at most; sort them "
            "and give each once"
        )
    return time, force, rows


def read_load_csv(path: str | Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Time (n,) in s, force (n,) in N and, where there is a column `tangential_force_n`, that force
    (n,) in N along x; raises InputError."""
    table = read_csv(path, ["time_s", "force_n"], ["tangential_force_n"])
    time, force = check_force_history(table["time_s"], table["force_n"], str(path))
    return time, force, table.get("tangential_force_n")
