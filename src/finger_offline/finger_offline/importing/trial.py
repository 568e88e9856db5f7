# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""One recording of a laboratory's own files → one session bag."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import uniform_filter1d

from finger_bag.definitions import typestore
from finger_bag.schema import CALIBRATION_ATTACHMENT
from finger_bag.writer import BagWriter
from finger_common.axes import axis_of
from finger_common.errors import InputError
from finger_common.files import sha256_of_file
from finger_common.flags import AreaFlag
from finger_common.stamps import NANOSECONDS, check_stamp, nanoseconds, seconds, time_fields
from finger_common.trial_phases import TrialPhase
from finger_common.units import AREA_UNITS, FORCE_UNITS, LENGTH_UNITS
from finger_vision.area_sensor import AREA_SENSORS, ContactMeasurement
from finger_vision.calibration import PlateCalibration

from ..image_areas import area_fields
from ..indentation_checks import indentation_fault
from ..trial_checks import LARGEST_FORCE, LONGEST_PRESS, PLAUSIBLE_AREA, SHORTEST_PRESS
from ..trial_split import TrialSettings, presses
from ..unloaded import LATE_START, Tare, reached_force, unloaded_tare
from .pictures import Frame, frames_of
from .settings import PATHS, PIXELS, ImportSettings
from .tables import Table, Times, read_table

FEWEST_AREAS = 3
"""Areas during a press without which a fit cannot use it."""

MAXIMUM_PRESSES = 1000
"""Presses of one recording; thousands are the noise of a force that was not tared."""

MOST_REPEATED = 0.9
"""Share of rows with the time of the row before from which the times are too coarse to use."""

LARGEST_TARE = 0.1
"""N of force without contact from which it is refused: a fit of such a force is not final."""

TARE_SMOOTHING = 0.04
"""s over which the force is averaged to see whether it rests."""

BEFORE_PRESS = 0.25
"""s before its onset at which a press is announced."""

Progress = Callable[[str, float, float], None]
"""Called with a stage, what is done and its total."""

_Item = tuple[int, str, Any]
"""Stamp in ns, topic, fields or a message of `typestore`."""


@dataclass
class Imported:
    """What a bag got.

    presses: onset, end (ns) and peak force (N) of each; area_stamps (ns), areas (m²) of all frames;
    notes: what a reader of the data should know. problems: what of the files could not be read.
    """

    path: Path
    presses: list[tuple[int, int, float]] = field(default_factory=list)
    area_stamps: list[int] = field(default_factory=list)
    areas: list[float] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _Force:
    """Force (n, 3) in the bag's axes, normal force (n,) and stamps (n,)."""

    stamp_ns: np.ndarray
    force: np.ndarray
    normal: np.ndarray


def import_trial(
    settings: ImportSettings,
    target: str | Path,
    show: Progress | None = None,
    tables: Mapping[str, Table] | None = None,
) -> Imported:
    """Write the bag `target` of one recording; may hold several presses.

    tables: in place of the files that the settings name, by their names.

    Raises InputError, and writes nothing, for files that cannot be read, or whose values cannot be
    those of a finger (unit, sign, clock).
    """
    result = Imported(Path(target))
    tables = tables or {}
    table = tables.get(settings.force) or read_table(settings.force)
    result.problems += table.problems
    times, force = _force(settings, table, result.notes)
    start = _start(settings.start)
    stamps = times.ns if times.absolute else times.ns + start
    for stamp in (int(stamps[0]), int(stamps[-1])):
        check_stamp(stamp, settings.force)
    found = _Force(stamps, force, -force[:, 2])
    events = _presses(settings, found, result)
    indentations = _indentations(settings, times.absolute, start, found, result, tables)
    areas = _areas(settings, times.absolute, start, result, show, tables)
    with BagWriter(target, _metadata(settings)) as bag:
        if settings.calibration or settings.area_per_pixel:
            bag.attach(
                CALIBRATION_ATTACHMENT, _calibration(settings).to_yaml().encode(), "text/yaml"
            )
        for stamp, topic, fields in heapq.merge(
            events, _wrenches(found), indentations, areas, key=lambda item: item[0]
        ):
            check_stamp(stamp, topic)
            if isinstance(fields, dict):
                header = {**fields.pop("header", {}), "stamp": stamp}
                fields = {"header": header, **fields}
            bag.write(topic, fields, stamp)
        _check_areas(settings, result)
        _check_tare(settings, found, result)
    return result


# Force ---------------------------------------------------------------------------------------


def _force(settings: ImportSettings, table: Table, notes: list[str]) -> tuple[Times, np.ndarray]:
    """Times, and forces (n, 3) in N in the bag's axes: negative in z under a press."""
    headings = [
        table.heading(name.strip(), "--force-column") for name in settings.force_column.split(",")
    ]
    if len(headings) not in (1, 3):
        raise InputError(
            f"--force-column {settings.force_column}: name the normal force, or x, y and z as "
            "Fx,Fy,Fz"
        )
    heading, times = _times(table, settings, "force_time", "force_rate", headings[0])
    unit = settings.force_unit or _unit(table, headings[-1], FORCE_UNITS, "--force-unit N")
    columns = [table.numbers(h, gaps=True) * FORCE_UNITS[unit] for h in headings]
    for name, column in zip(headings, columns):
        _check_length(table, heading, name, len(times.ns), len(column))
    known = np.all(np.isfinite(columns), axis=0)
    keep = _in_order(table, heading, times, known, notes)
    unknown = int((times.known & ~known).sum())
    if unknown:
        notes.append(f"{table.where}: {unknown} rows without a force, left out")
    if not keep.any():
        raise InputError(
            f"{table.where}: no row has both a time in '{heading}' and a force in "
            f"'{', '.join(headings)}'; name the columns that belong together"
        )
    times = times.at(keep)
    force = np.zeros((len(times.ns), 3))
    if len(columns) == 1:
        force[:, 2] = columns[0][keep] * (1.0 if settings.force_sign == "negative" else -1.0)
    else:
        index, sign = axis_of(settings.normal_axis)
        force[:, 2] = -sign * columns[index][keep]
        force[:, 0], force[:, 1] = (columns[(index + k) % 3][keep] for k in (1, 2))
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


def _unit(table: Table, heading: str, units: dict[str, float], remedy: str) -> str:
    unit = table.unit(heading, units)
    if unit is None:
        raise InputError(
            f"{table.where}: column '{heading}' does not say its unit; give {remedy} "
            f"(one of {', '.join(units)})"
        )
    return unit


def _check_length(table: Table, a: str, b: str, first: int, second: int) -> None:
    if first != second:
        raise InputError(
            f"{table.where}: columns '{a}' and '{b}' have {first} and {second} values; they must "
            "belong together"
        )


def _times(
    table: Table, settings: ImportSettings, column: str, rate: str, of: str
) -> tuple[str, Times]:
    """Heading and times (n,) of the column that a setting names, or of the rows of column `of` at
    an even rate (Hz) where the setting `rate` gives one."""
    hertz = getattr(settings, rate)
    if not hertz:
        heading = table.heading(getattr(settings, column), f"--{column.replace('_', '-')}")
        return heading, table.times(heading, settings.time_unit)
    rows = np.arange(len(table.columns[of]))
    return of, Times.of(np.round(rows * (NANOSECONDS / hertz)).astype(np.int64), False)


def _in_order(
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


def _presses(settings: ImportSettings, found: _Force, result: Imported) -> list[_Item]:
    """Trial messages and moisture readings of the presses; raises InputError without one."""
    normal, stamps = found.normal, found.stamp_ns
    split = TrialSettings()
    high, low = float(normal.max()), float(normal.min())
    where = settings.force
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
        for first, end in presses(stamps, normal)
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
    if min(lengths) > LONGEST_PRESS or max(lengths) < SHORTEST_PRESS:
        raise InputError(
            f"{where}: the first press lasts {lengths[0]:.3g} s; give the right --time-unit"
        )
    rest = _unloaded(found, np.empty(0), np.empty(0))
    items: list[_Item] = []
    for number, (first, end) in enumerate(chosen):
        peak = float(normal[first:end].max())
        last = int(stamps[min(end, len(stamps)) - 1])
        result.presses.append((int(stamps[first]), last, peak))
        earlier = int(stamps[chosen[number - 1][1] - 1]) if number else int(stamps[0])
        begin = max(int(stamps[first]) - nanoseconds(BEFORE_PRESS), earlier)
        target = settings.target_force or math.floor(reached_force(peak, rest) * 100) / 100
        about = {
            "session": settings.session,
            "subject": settings.subject,
            "condition": settings.condition,
            "index": settings.index + number,
            "target_force": target,
        }
        items.append((begin, "trial", {**about, "phase": int(TrialPhase.PRESS)}))
        for reading, value in enumerate(settings.readings):
            fields = {"value": value, "index": reading, "phase": 1, "source": "import"}
            items.append((begin, "moisture", fields))
        items.append((last + 1, "trial", {**about, "phase": int(TrialPhase.DONE)}))
    return items


def _wrenches(found: _Force) -> Iterator[_Item]:
    # Messages, not their fields: there are far more of them than of all others.
    types = typestore().types
    message, wrench, vector, head, time = (
        types[name]
        for name in (
            "geometry_msgs/msg/WrenchStamped",
            "geometry_msgs/msg/Wrench",
            "geometry_msgs/msg/Vector3",
            "std_msgs/msg/Header",
            "builtin_interfaces/msg/Time",
        )
    )
    nothing = vector(0.0, 0.0, 0.0)
    for stamp, (x, y, z) in zip(found.stamp_ns.tolist(), found.force.tolist()):
        header = head(time(**time_fields(stamp)), "force_sensor")
        yield stamp, "wrench", message(header, wrench(vector(x, y, z), nothing))


# Areas ---------------------------------------------------------------------------------------


def _areas(
    settings: ImportSettings,
    absolute: bool,
    start: int,
    result: Imported,
    show: Progress | None,
    tables: Mapping[str, Table],
) -> Iterator[_Item]:
    """Areas, and images where they are kept, in the order of time."""

    def based(name: str, theirs: bool) -> int:
        return _based(settings, name, theirs, absolute, start, "time_offset")

    if settings.area:
        units = {**AREA_UNITS, PIXELS: settings.area_per_pixel}
        stamps, areas, theirs = _column(settings, "area", units, "mm2", result, tables)
        result.area_stamps = (stamps + based(settings.area, theirs)).tolist()
        result.areas = areas.tolist()
        return _area_items(result)
    frames, count, theirs = frames_of(settings, result.problems)
    begin = based(settings.video or settings.images, theirs)
    return _image_items(settings, frames, count, begin, result, show)


def _column(
    settings: ImportSettings,
    what: str,
    units: dict[str, float],
    example: str,
    result: Imported,
    tables: Mapping[str, Table],
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Times (n,) in ns and values (n,) in SI of the table of "area" or "indentation", without its
    gaps, and whether its times count from 1970."""
    table = tables.get(getattr(settings, what)) or read_table(getattr(settings, what))
    result.problems += table.problems
    column = table.heading(getattr(settings, f"{what}_column"), f"--{what}-column")
    if what == "area":
        heading, times = _times(table, settings, "area_time", "frame_rate", column)
    else:
        heading = table.heading(getattr(settings, f"{what}_time"), f"--{what}-time")
        times = table.times(heading, settings.time_unit)
    unit = getattr(settings, f"{what}_unit")
    unit = unit or _unit(table, column, units, f"--{what}-unit {example}")
    if what == "area" and (unit == PIXELS) != bool(settings.area_per_pixel):
        raise InputError(
            f"{table.where}: areas in {unit}; --area-per-pixel (m²) belongs to areas in pixels, "
            "and to them alone"
        )
    values = table.numbers(column, gaps=True) * units[unit]
    _check_length(table, heading, column, len(times.ns), len(values))
    keep = _in_order(table, heading, times, np.isfinite(values), result.notes)
    return times.ns[keep], values[keep], times.absolute


def _based(
    settings: ImportSettings, name: str, theirs: bool, absolute: bool, start: int, offset: str
) -> int:
    """What is added to the times (ns) of a file beside the force; offset: its setting."""
    if theirs != absolute:
        raise InputError(
            f"{settings.force} and {name}: one counts its times from 1970 or midnight, the "
            f"other from its own start; give both the same origin, or --{offset.replace('_', '-')}"
        )
    moved = nanoseconds(getattr(settings, offset))
    return moved if theirs else start + moved


def _area_items(result: Imported) -> Iterator[_Item]:
    for stamp, area in zip(result.area_stamps, result.areas):
        touching = area > 0
        yield (
            stamp,
            "contact_area",
            {
                "header": {"frame_id": "plate"},
                "gross_area": max(area, 0.0),
                "real_area": math.nan if touching else 0.0,
                "area_stddev": math.nan,
                "flags": 0 if touching else int(AreaFlag.NO_CONTACT),
            },
        )


def _image_items(
    settings: ImportSettings,
    frames: Iterator[Frame],
    count: int,
    begin: int,
    result: Imported,
    show: Progress | None,
) -> Iterator[_Item]:
    sensor = AREA_SENSORS.open({"area_sensor": settings.area_sensor}, _calibration(settings))
    stamps, areas = result.area_stamps, result.areas
    for number, (time, image) in enumerate(frames, 1):
        stamp = begin + time
        if stamps and stamp <= stamps[-1]:
            raise InputError(
                f"{settings.image_times or settings.video}: time of frame {number} is not after "
                "the one before; correct the times"
            )
        found: ContactMeasurement = sensor.process(image)
        stamps.append(stamp)
        areas.append(found.gross_area)
        fields = area_fields(stamp, found, "plate")
        yield stamp, "contact_area", fields
        if settings.keep_images:
            data = cv2.imencode(".png", image)[1].tobytes()
            header = {"frame_id": "camera_optical"}
            yield (
                stamp,
                "image_raw/compressed",
                {"header": header, "format": "mono8; png compressed", "data": data},
            )
        if show is not None:
            show("areas", number, max(count, number))


def _calibration(settings: ImportSettings) -> PlateCalibration:
    if settings.calibration:
        return PlateCalibration.load(settings.calibration)
    return PlateCalibration.from_area_per_pixel(settings.area_per_pixel)


def _check_areas(settings: ImportSettings, result: Imported) -> None:
    """Refuse areas that no finger can have, and those of another time than the presses."""
    name = settings.area or settings.video or settings.images
    high = max(result.areas, default=0.0)
    if not high > 0.0:
        raise InputError(f"{name}: no area above zero; check the column, or the image scale")
    if not PLAUSIBLE_AREA[0] <= high <= PLAUSIBLE_AREA[1]:
        remedy = "--area-unit" if settings.area else "--area-per-pixel or --calibration"
        raise InputError(
            f"{name}: the largest area is {high * 1e6:.4g} mm², that of a fingertip lies between "
            f"{PLAUSIBLE_AREA[0] * 1e6:g} and {PLAUSIBLE_AREA[1] * 1e6:g} mm²; give the right "
            f"{remedy}"
        )
    stamps = np.array(result.area_stamps)
    inside = [int(((stamps >= a) & (stamps <= b)).sum()) for a, b, _ in result.presses]
    if not any(inside):
        origin = result.presses[0][0]
        first, last = (seconds(int(stamps[i]) - origin) for i in (0, -1))
        raise InputError(
            f"{name}: no area during a press; counted from the beginning of the first press, the "
            f"areas lie between {first:.6g} and {last:.6g} s; give --time-offset, or the "
            "--time-unit of both"
        )
    for number, count in enumerate(inside):
        if count < FEWEST_AREAS:
            result.notes.append(f"press {number}: {count} areas, {FEWEST_AREAS} are needed to fit")


def _check_tare(settings: ImportSettings, found: _Force, result: Imported) -> None:
    """Refuse a force that was not tared, as the plate shows while nothing touches it; say which
    presses begin before the recording."""
    stamps, areas = np.array(result.area_stamps, np.int64), np.array(result.areas)
    frames = seconds(stamps - found.stamp_ns[0])
    tare = _unloaded(found, frames[areas > 0], frames[areas <= 0])
    if tare is not None and abs(tare.force) > LARGEST_TARE:
        raise InputError(
            f"{settings.force}: the force is {tare.force:.2f} N while nothing touches the plate "
            f"({tare.seconds:.2g} s at the beginning or end); give a tared force, or the seconds "
            "without contact at its beginning with --tare"
        )
    begins = found.normal[0] - (tare.force if tare is not None else 0.0)
    if result.presses[0][0] == found.stamp_ns[0] and begins > LATE_START:
        result.problems.append(
            f"press 0: the force is {found.normal[0]:.2f} N at its first sample: the press began "
            "before the recording and cannot be fitted. If the finger did not touch yet, give "
            "--tare"
        )


def _unloaded(found: _Force, touched: np.ndarray, empty: np.ndarray) -> Tare | None:
    """As `unloaded_tare`, frames (m,), (k,) in s from the first sample of the force."""
    time = seconds(found.stamp_ns - found.stamp_ns[0])
    period = float(np.median(np.diff(time))) if len(time) > 1 else TARE_SMOOTHING
    smooth = uniform_filter1d(found.normal, max(round(TARE_SMOOTHING / period), 1), mode="nearest")
    return unloaded_tare(time, found.normal, smooth, touched, empty)


# Indentation ---------------------------------------------------------------------------------


def _indentations(
    settings: ImportSettings,
    absolute: bool,
    start: int,
    found: _Force,
    result: Imported,
    tables: Mapping[str, Table],
) -> list[_Item]:
    """Measured indentations; raises InputError for values that are not those of the presses."""
    name = settings.indentation
    if not name:
        return []
    times, values, theirs = _column(settings, "indentation", LENGTH_UNITS, "mm", result, tables)
    stamps = times + _based(settings, name, theirs, absolute, start, "indentation_time_offset")
    values = values * (-1.0 if settings.indentation_sign == "negative" else 1.0)
    if not len(values):
        raise InputError(f"{name}: holds no indentation; check --indentation-column")
    faults = {}
    for number, (first, last, _) in enumerate(result.presses):
        press = (found.stamp_ns >= first) & (found.stamp_ns <= last)
        fault = indentation_fault(found.stamp_ns[press], found.normal[press], stamps, values)
        if fault is not None:
            faults[number] = fault
    for number, fault in faults.items():
        option = f"--indentation-{fault.option.replace('_', '-')}"
        text = f"press {number}: {fault.text}; give the right {option}"
        # A recording of the indentation may end before the last press.
        if fault.certain and (fault.option != "time_offset" or len(faults) == len(result.presses)):
            raise InputError(f"{name}: {text}")
        result.notes.append(text)
    header = {"frame_id": "finger"}
    return [
        (stamp, "indentation", {"header": dict(header), "point": {"z": value}})
        for stamp, value in zip(stamps.tolist(), values.tolist())
    ]


# About ---------------------------------------------------------------------------------------


def _start(text: str) -> int:
    try:
        at = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(
            f"--start '{text[:40]}' is no date and time; give it as 2024-05-01T13:45:00"
        ) from None
    if at.tzinfo is None:
        at = at.replace(tzinfo=timezone.utc)
    start = round(at.timestamp()) * NANOSECONDS
    check_stamp(start, "--start")
    return start


def _metadata(settings: ImportSettings) -> dict[str, Any]:
    """Session metadata; `files` names what was imported, with hashes."""
    files = []
    for name in PATHS:
        path = Path(str(getattr(settings, name)).partition("::")[0])
        if getattr(settings, name) and path.is_file():
            files.append(f"{name}: {path.name} sha256:{sha256_of_file(path)}")
    return {
        "session": settings.session,
        "subject": settings.subject,
        "condition": settings.condition,
        "source": "finger-bag import",
        "files": "; ".join(files),
    }
