# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A stream of numbers in a table: its column, its times, its unit, and the rows that count."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from finger_common.errors import InputError
from finger_common.stamps import NANOSECONDS
from finger_common.units import AREA_UNITS, FORCE_UNITS, LENGTH_UNITS

from .settings import PIXELS, ImportSettings
from .table import Table, Times

MOST_REPEATED = 0.9
"""Share of rows with the time of the row before from which the times are too coarse to use."""


@dataclass(frozen=True)
class Series:
    """The settings that say where a stream lies, by their names, and the units that it may have.

    time_unit: of its times, where it differs. rate: even rate of the rows, where the table has no
    times. offset: added to the times. units: SI value of each. example: of a unit, for a remedy.
    """

    file: str
    time: str
    column: str
    unit: str
    units: dict[str, float]
    example: str
    time_unit: str
    rate: str = ""
    offset: str = ""


FORCE = Series(
    "force",
    "force_time",
    "force_column",
    "force_unit",
    FORCE_UNITS,
    "N",
    "force_time_unit",
    rate="force_rate",
)
AREA = Series(
    "area",
    "area_time",
    "area_column",
    "area_unit",
    {**AREA_UNITS, PIXELS: math.nan},
    "mm2",
    "area_time_unit",
    rate="frame_rate",
    offset="time_offset",
)
INDENTATION = Series(
    "indentation",
    "indentation_time",
    "indentation_column",
    "indentation_unit",
    LENGTH_UNITS,
    "mm",
    "indentation_time_unit",
    offset="indentation_time_offset",
)


_COUNT = re.compile(r"frame|index|sample|count|number|bild|^(no|nr|n|i|#)\b", re.IGNORECASE)
"""Headings of columns that count rows."""


def option(name: str) -> str:
    """The option of a setting."""
    return "--" + name.replace("_", "-")


def times_of(
    spec: Series, settings: ImportSettings, table: Table, column: str
) -> tuple[str, Times]:
    """Heading and times (n,) of a stream; where its rows come at an even rate, of its `column`."""
    hertz = getattr(settings, spec.rate) if spec.rate else 0.0
    if not hertz:
        heading = table.heading(getattr(settings, spec.time), option(spec.time))
        unit = time_unit_of(spec, settings)
        times = table.times(heading, unit)
        if spec.rate and not unit and _COUNT.search(heading) and _counts(times):
            raise InputError(
                f"{table.where}: column '{heading}' counts rows; give {option(spec.rate)} in place "
                "of it, or its unit where these are times"
            )
        return heading, times
    _check_rate(spec, settings, table, hertz)
    rows = np.arange(len(table.columns[column]))
    return column, Times.of(np.round(rows * (NANOSECONDS / hertz)).astype(np.int64), False)


def _check_rate(spec: Series, settings: ImportSettings, table: Table, hertz: float) -> None:
    """Raise InputError for a rate that contradicts the column of times, if there is one."""
    name = getattr(settings, spec.time)
    if not table.alike(name):
        return
    heading = table.heading(name, option(spec.time))
    try:
        times = table.times(heading, time_unit_of(spec, settings))
    except InputError:
        return  # no times, so that a rate is needed
    steps = np.diff(times.ns[times.known]) / NANOSECONDS
    usual = float(np.median(steps)) if len(steps) else 0.0
    if usual > 0.0 and not _counts(times) and not 0.8 < usual * hertz < 1.25:
        raise InputError(
            f"{table.where}: the times in '{heading}' come at {1.0 / usual:.4g} Hz, and "
            f"{option(spec.rate)} says {hertz:g} Hz; leave it out, or rename the column"
        )


def _counts(times: Times) -> bool:
    """Whether times are whole numbers one after the other."""
    ns = times.ns[times.known]
    return len(ns) > 2 and not times.absolute and bool((np.diff(ns) == NANOSECONDS).all())


def time_unit_of(spec: Series, settings: ImportSettings) -> str:
    """Unit of the times of a stream, empty where its heading says it."""
    return str(getattr(settings, spec.time_unit) or settings.time_unit)


def factor_of(spec: Series, settings: ImportSettings, table: Table, column: str) -> float:
    """SI value of the unit of a column; raises InputError where nothing says its unit."""
    unit = getattr(settings, spec.unit) or table.unit(column, spec.units)
    if unit is None:
        raise InputError(
            f"{table.where}: column '{column}' does not say its unit; give {option(spec.unit)} "
            f"{spec.example} (one of {', '.join(spec.units)})"
        )
    if spec is AREA and (unit == PIXELS) != bool(settings.area_per_pixel):
        remedy = "is for areas in pixels; leave it out, or give --area-unit px"
        if unit == PIXELS:
            remedy = "is not given; give the area of a pixel, such as 9.86e-10"
        raise InputError(f"{table.where}: areas in {unit}; --area-per-pixel (m²) {remedy}")
    return settings.area_per_pixel if unit == PIXELS else spec.units[unit]


def check_length(table: Table, a: str, b: str, first: int, second: int) -> None:
    """Raise InputError for columns of different lengths."""
    if first != second:
        raise InputError(
            f"{table.where}: columns '{a}' and '{b}' have {first} and {second} values; they must "
            "belong together"
        )


def rows_in_order(
    table: Table, heading: str, times: Times, valued: np.ndarray, notes: list[str]
) -> np.ndarray:
    """Mask of the rows that count: those with a time and a value, and of such with one time, the
    first.

    valued (n,): rows that hold a value. Refuses a step back, and times that hardly ever step.
    """
    timeless = int((valued & ~times.known).sum())
    if timeless:
        notes.append(f"{table.where}: {timeless} rows without a time, left out")
    rows = np.flatnonzero(times.known)
    steps = np.diff(times.ns[rows])
    if (steps < 0).any():
        row = int(rows[np.flatnonzero(steps < 0)[0] + 1]) + table.first_row
        raise InputError(
            f"{table.where}, row {row}, column '{heading}': time runs back by "
            f"{-steps.min() / NANOSECONDS:.3g} s; export the rows in the order of time, or name "
            "the column that tells recordings apart with --trial-column"
        )
    repeats = int((steps == 0).sum())
    if repeats > MOST_REPEATED * len(rows):
        raise InputError(
            f"{table.where}: {repeats} of {len(rows)} rows of column '{heading}' repeat the "
            "time of the row before; export times with milliseconds, name the column that has "
            "them, or give the rate of the rows (--force-rate, --frame-rate)"
        )
    keep = times.known & valued
    rows = np.flatnonzero(keep)
    repeated = rows[1:][np.diff(times.ns[rows]) == 0]
    if len(repeated):
        keep[repeated] = False
        notes.append(
            f"{table.where}: {len(repeated)} rows repeat the time of the row before, left out"
        )
    return keep
