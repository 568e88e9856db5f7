# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The force of a recording that is imported: its axes, its presses, and whether it was tared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from finger_common.axes import DEFAULT_NORMAL_AXIS, NO_FORCE, axis_of, usable
from finger_common.errors import InputError, listed
from finger_common.stamps import seconds
from finger_common.units import LARGEST_FORCE

from ..trial_checks import length_fault
from ..trial_split import TrialSettings
from ..unloaded import (
    LARGEST_TARE,
    LATE_START,
    Tare,
    pressing_force,
    smooth_force,
    unloaded_plate,
    unloaded_tare,
    without_spikes,
)
from .series import FORCE, check_length, factor_of, rows_in_order, times_of
from .settings import ImportSettings
from .table import Table, Times

MAXIMUM_PRESSES = 1000
"""Presses of one recording; thousands are the noise of a force that was not tared."""


@dataclass(frozen=True)
class Force:
    """Force (n, 3) in the bag's axes, normal force (n,), both in N, and stamps (n,) in ns."""

    stamp_ns: np.ndarray
    force: np.ndarray
    normal: np.ndarray


def read_force(
    settings: ImportSettings, table: Table, notes: list[str]
) -> tuple[Times, np.ndarray]:
    """Times, and forces (n, 3) in N in the bag's axes: negative in z under a press.

    Raises InputError for a table without them.
    """
    named = settings.force_column
    # A heading may hold a comma itself: "Force, N", or three of them "Fx, N,Fy, N,Fz, N".
    parts = [named] if table.alike(named) else named.split(",")
    size = max(len(parts) // 3, 1)
    names = [",".join(parts[i : i + size]).strip() for i in range(0, len(parts), size)]
    headings = [table.heading(name, "--force-column") for name in names]
    if len(headings) not in (1, 3):
        raise InputError(
            f"--force-column {named}: name the normal force, or x, y and z as Fx,Fy,Fz"
        )
    if len(headings) == 1 and settings.normal_axis != DEFAULT_NORMAL_AXIS:
        raise InputError("--normal-axis is for three columns of the force; give --force-sign")
    if len(headings) == 3 and settings.force_sign != "positive":
        raise InputError("--force-sign is for one column of the force; give --normal-axis")
    heading, times = times_of(FORCE, settings, table, headings[0])
    factor = factor_of(FORCE, settings, table, headings[-1])
    columns = [table.numbers(h, gaps=True) * factor for h in headings]
    for name, column in zip(headings, columns):
        check_length(table, heading, name, len(times.ns), len(column))
    known = np.all(np.isfinite(columns), axis=0)
    keep = rows_in_order(table, heading, times, known, notes)
    unknown = int((times.known & ~known).sum())
    if unknown:
        notes.append(f"{table.where}: {unknown} rows without a force, left out")
    if not keep.any():
        raise InputError(
            f"{table.where}: no row has both a time in '{heading}' and a force in "
            f"'{', '.join(headings)}'; name the columns that belong together"
        )
    times = times.at(keep)
    if len(times.ns) < 2:
        raise InputError(f"{table.where}: holds one row with a force; export the whole recording")
    wild = np.flatnonzero(keep & ~np.all(usable(np.array(columns)), axis=0))
    if len(wild):
        row = table.first_row + wild[0]
        raise InputError(
            f"{table.where}, row {row}: a force beyond {NO_FORCE:g} N; correct it or leave it out"
        )
    force = np.zeros((len(times.ns), 3))
    if len(columns) == 1:
        force[:, 2] = columns[0][keep] * (1.0 if settings.force_sign == "negative" else -1.0)
    else:
        index, sign = axis_of(settings.normal_axis)
        force[:, 2] = -sign * columns[index][keep]
        force[:, 0], force[:, 1] = (columns[(index + k) % 3][keep] for k in (1, 2))
    cleaned, spikes = without_spikes(force[:, 2])
    if len(spikes):
        rows = np.flatnonzero(keep) + table.first_row
        shown = [f"row {rows[i]} ({-force[i, 2]:.2f} N beside {-cleaned[i]:.2f} N)" for i in spikes]
        notes.append(
            f"{table.where}: {len(spikes)} isolated spikes of the force make no press and no "
            f"target: {listed(shown, 3)}"
        )
    if settings.tare:
        first = seconds(times.ns - times.ns[0]) <= settings.tare
        force -= force[first].mean(axis=0)
        spread = float(force[first, 2].std())
        if spread > 0.05:
            raise InputError(
                f"{table.where}: the force varies by {spread:.2f} N in the first "
                f"{settings.tare:g} s; shorten --tare to the part without contact"
            )
    return times, force


def presses_in(
    found: Force, where: str, touched_ns: np.ndarray, empty_ns: np.ndarray
) -> list[tuple[int, int]]:
    """Presses as (first sample, first sample after); touched_ns (m,), empty_ns (k,): of the frames
    that show a contact, and none.

    Raises InputError, naming `where`, without a press and for a force that cannot be a finger's.
    """
    stamps = found.stamp_ns
    normal = pressing_force(stamps, found.normal, touched_ns, empty_ns)
    split = TrialSettings()
    high, low = float(normal.max()), float(normal.min())
    if high > LARGEST_FORCE:
        raise InputError(
            f"{where}: force goes up to {high:.4g} N, more than a finger can press; give the "
            "right --force-unit"
        )
    if -low > max(high, split.minimum_peak):
        raise InputError(
            f"{where}: force goes down to {low:.3g} N and up to {high:.3g} N; give "
            "--force-sign negative, or the --normal-axis along which a press is positive"
        )
    chosen = [
        (first, end)
        for first, end in split.presses(stamps, normal)
        if normal[first:end].max() >= split.minimum_peak
    ]
    if not chosen:
        raise InputError(
            f"{where}: no press of {split.minimum_peak:g} N or more, the largest force is "
            f"{high:.3g} N; check --force-column, --force-unit and --tare"
        )
    if len(chosen) > MAXIMUM_PRESSES:
        raise InputError(
            f"{where}: {len(chosen)} presses, {MAXIMUM_PRESSES} at most are read; check --tare and "
            "--force-unit, or give a part of the recording"
        )
    last_row = len(stamps) - 1
    lengths = [seconds(int(stamps[min(b, last_row)] - stamps[a])) for a, b in chosen]
    period = seconds(int(np.median(np.diff(stamps))))
    frames = np.sort(np.concatenate([touched_ns, empty_ns]))
    frame_period = seconds(int(np.median(np.diff(frames)))) if len(frames) > 1 else 0.0
    if fault := length_fault(lengths, period, "give the right --time-unit", frame_period):
        raise InputError(f"{where}: the first press {fault}")
    return chosen


def check_tare(
    found: Force,
    first_onset: int,
    area_stamps: list[int],
    areas: Sequence[float],
    where: str,
    tared: bool,
) -> list[str]:
    """Refuse a force that was not tared, as the plate shows while nothing touches it.

    first_onset: of the first press, ns. area_stamps (k,) in ns, areas (k,) in m². tared: the tare
    of the beginning was taken off. Gives what a press lacks that began before the recording. Raises
    InputError, naming `where`.
    """
    area = np.array(areas)
    frames = seconds(np.array(area_stamps, np.int64) - found.stamp_ns[0])
    time = seconds(found.stamp_ns - found.stamp_ns[0])
    touched, empty = frames[area > 0], frames[area <= 0]
    plate = unloaded_plate(time, found.normal, touched, empty)
    if plate is not None and abs(plate.force) > LARGEST_TARE:
        if plate.moves:
            remedy = "import parts of the recording with --tare each, or a force without drift"
        elif tared:
            remedy = "shorten --tare to the seconds without contact"
        else:
            remedy = (
                "give a tared force, or the seconds without contact at its beginning with --tare"
            )
        raise InputError(f"{where}: {plate.words}; {remedy}")
    tare = unloaded(found, touched, empty)
    begins = found.normal[0] - (tare.force if tare is not None else 0.0)
    if first_onset == found.stamp_ns[0] and begins > LATE_START:
        return [
            f"press 0: the force is {found.normal[0]:.2f} N at its first sample: the press began "
            "before the recording and cannot be fitted. If the finger did not touch yet, give "
            "--tare"
        ]
    return []


def unloaded(found: Force, touched: np.ndarray, empty: np.ndarray) -> Tare | None:
    """As `unloaded_tare`; frames with contact (m,) and without (k,), s from the first sample."""
    time = seconds(found.stamp_ns - found.stamp_ns[0])
    smooth = smooth_force(time, found.normal)
    return unloaded_tare(time, found.normal, smooth, touched, empty)
