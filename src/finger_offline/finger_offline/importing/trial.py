# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""One recording of a laboratory's own files → one session bag."""

from __future__ import annotations

import functools
import heapq
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import timezone
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from finger_bag.definitions import typestore
from finger_bag.schema import CALIBRATION_ATTACHMENT
from finger_bag.writer import BagWriter
from finger_common.errors import InputError
from finger_common.files import sha256_of_file
from finger_common.flags import AreaFlag
from finger_common.stamps import NANOSECONDS, check_stamp, nanoseconds, seconds, time_fields
from finger_common.trial_phases import TrialPhase
from finger_vision.area_sensor import AREA_SENSORS, measured
from finger_vision.calibration import PlateCalibration
from finger_vision.camera_stream import Repeats

from ..held_areas import held_rows, held_text
from ..image_areas import area_fields
from ..image_settings import told_settings
from ..indentation_checks import indentation_fault
from ..lag import MAXIMUM_LAG, indentation_lag, lag_text
from ..trial_checks import PLAUSIBLE_AREA, lone_areas
from ..trial_split import TrialSettings
from ..unloaded import pressed_force, reached_force
from .cells import from_iso
from .force import Force, check_tare, presses_in, read_force, unloaded
from .pictures import Frame, frames_of
from .series import (
    AREA,
    INDENTATION,
    Series,
    check_length,
    factor_of,
    option,
    rows_in_order,
    times_of,
)
from .settings import PATHS, ImportSettings
from .table import DAY_NS
from .tables import Table, read_table

FEWEST_AREAS = 3
"""Areas during a press without which a fit cannot use it."""

FEW_EMPTY = 0.02
"""Share of the areas in the middle of presses that may be zero."""

LEAST_AREA_SD = 5e-7
"""m²; no contact is measured better: an outline of 30 mm within 0.02 mm all around."""

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


def import_trial(
    settings: ImportSettings,
    target: str | Path,
    show: Progress | None = None,
    tables: Mapping[str, Table] | None = None,
    before: Table | None = None,
) -> Imported:
    """Write the bag `target` of one recording; may hold several presses.

    tables: in place of the files that the settings name, by their names. before: rows of the force
    before the recording, by the same clock, whose presses are of other bags.

    Raises InputError, and writes nothing, for files that cannot be read, or whose values cannot be
    those of a finger (unit, sign, clock).
    """
    recording = _Recording(settings, Path(target), show, tables or {}, before)
    streams = (
        recording.events(),
        recording.wrenches(),
        recording.indentations(),
        recording.areas(),
    )
    with BagWriter(target, _metadata(settings)) as bag:
        if settings.calibration or settings.area_per_pixel:
            plate = PlateCalibration.given(settings.calibration, settings.area_per_pixel)
            bag.attach(CALIBRATION_ATTACHMENT, plate.to_yaml().encode(), "text/yaml")
        for stamp, topic, fields in heapq.merge(*streams, key=lambda item: item[0]):
            check_stamp(stamp, topic)
            if isinstance(fields, dict):
                header = {**fields.pop("header", {}), "stamp": stamp}
                fields = {"header": header, **fields}
            bag.write(topic, fields, stamp)
        recording.check()
    return recording.result


class _Recording:
    """One recording on its way into a bag: what is read of it, and what becomes known of it.

    absolute: whether the times of the force, and so of all, count from 1970. start: ns, time 0
    where they do not.
    """

    def __init__(
        self,
        settings: ImportSettings,
        target: Path,
        show: Progress | None,
        tables: Mapping[str, Table],
        before: Table | None,
    ) -> None:
        self.settings = settings
        self.result = Imported(target)
        self._show = show
        self._tables = tables
        times, force = read_force(settings, self._table(settings.force), self.result.notes)
        self._start = _start(settings.start)
        self._absolute, self._daily = times.absolute, times.daily
        stamps = times.ns if times.absolute else times.ns + self._start
        for stamp in (int(stamps[0]), int(stamps[-1])):
            check_stamp(stamp, settings.force)
        self._force = Force(stamps, force, -force[:, 2])
        self._earlier = self._force_before(before)

    # Tables ----------------------------------------------------------------------------------

    def _table(self, name: str) -> Table:
        table = self._tables.get(name) or read_table(name)
        self.result.problems += table.problems
        self.result.notes += [note for note in table.notes if note not in self.result.notes]
        return table

    def _force_before(self, table: Table | None) -> Force | None:
        """The force before the recording; None without one, and where it ends in a press, of which
        the recording has the other part."""
        if table is None:
            return None
        untared = replace(self.settings, tare=0.0)
        times, force = read_force(untared, table, [])
        if self.settings.tare:
            own = read_force(untared, self._table(self.settings.force), [])[1]
            force = force - (own[0] - self._force.force[0])
        stamps = times.ns if times.absolute else times.ns + self._start
        first = self._force.stamp_ns[0]
        kept = stamps < first
        found = Force(stamps[kept], force[kept], -force[kept, 2])
        whole = np.concatenate([found.stamp_ns, self._force.stamp_ns])
        normal = np.concatenate([found.normal, self._force.normal])
        number = len(found.stamp_ns)
        over = any(a < number < b for a, b in TrialSettings().presses(whole, normal))
        return None if over or not number else found

    def _series(self, spec: Series) -> tuple[np.ndarray, np.ndarray]:
        """Stamps (n,) in ns and values (n,) in SI of a stream beside the force, without gaps."""
        settings = self.settings
        name = getattr(settings, spec.file)
        table = self._table(name)
        column = table.heading(getattr(settings, spec.column), option(spec.column))
        heading, times = times_of(spec, settings, table, column)
        factor = factor_of(spec, settings, table, column)
        values = table.numbers(column, gaps=True) * factor
        check_length(table, heading, column, len(times.ns), len(values))
        keep = rows_in_order(table, heading, times, np.isfinite(values), self.result.notes)
        stamps = times.ns[keep] + self._origin(name, times.absolute, spec.offset)
        if times.daily and self._daily and len(stamps):
            # One file may begin before midnight, the other behind it.
            days = round(int(self._force.stamp_ns[0] - stamps[0]) / DAY_NS)
            stamps = stamps + days * DAY_NS
        return stamps, values[keep]

    def _origin(self, name: str, absolute: bool, offset: str) -> int:
        """What is added to the times (ns) of a file beside the force; offset: its setting."""
        if absolute != self._absolute:
            raise InputError(
                f"{self.settings.force} and {name}: one counts its times from 1970 or midnight, "
                f"the other from its own start; give both the same origin, or {option(offset)}"
            )
        moved = nanoseconds(getattr(self.settings, offset))
        return moved if absolute else self._start + moved

    @functools.cached_property
    def _table_areas(self) -> tuple[np.ndarray, np.ndarray]:
        """Stamps (k,) in ns and areas (k,) in m² of the table, each once where a logger held them;
        none where images are measured."""
        if not self.settings.area:
            return np.empty(0, np.int64), np.empty(0)
        stamps, areas = self._series(AREA)
        held = held_rows(stamps, areas, self._force.stamp_ns, self._force.normal)
        if held.any():
            self.result.notes.append(f"{self.settings.area}: {held_text(int(held.sum()))}")
        return stamps[~held], areas[~held]

    # Streams ---------------------------------------------------------------------------------

    def events(self) -> list[_Item]:
        """Trial messages and moisture readings of the presses; raises InputError without one."""
        settings, found, result = self.settings, self._force, self.result
        stamps = found.stamp_ns
        area_stamps, areas = self._table_areas
        touching, empty = (area_stamps[mask] for mask in (areas > 0, areas <= 0))
        chosen = presses_in(found, settings.force, touching, empty)
        time = seconds(stamps - stamps[0])
        normal = pressed_force(time, found.normal)
        rest = unloaded(found, np.empty(0), np.empty(0))
        items: list[_Item] = []
        for number, (first, end) in enumerate(chosen):
            peak = float(normal[first:end].max())
            last = int(stamps[min(end, len(stamps)) - 1])
            result.presses.append((int(stamps[first]), last, peak))
            earlier = int(stamps[chosen[number - 1][1] - 1]) if number else int(stamps[0])
            begin = max(int(stamps[first]) - nanoseconds(BEFORE_PRESS), earlier)
            target = settings.target_force or reached_force(peak, rest)
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

    def wrenches(self) -> Iterator[_Item]:
        """The force, with what is known of it before the recording."""
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
        for part in filter(None, (self._earlier, self._force)):
            for stamp, (x, y, z) in zip(part.stamp_ns.tolist(), part.force.tolist()):
                header = head(time(**time_fields(stamp)), "force_sensor")
                yield stamp, "wrench", message(header, wrench(vector(x, y, z), nothing))

    def indentations(self) -> list[_Item]:
        """Measured indentations, after `events`; raises InputError for values that are not those
        of the presses."""
        settings, found, result = self.settings, self._force, self.result
        name = settings.indentation
        if not name:
            return []
        stamps, values = self._series(INDENTATION)
        values = values * (-1.0 if settings.indentation_sign == "negative" else 1.0)
        if not len(values):
            raise InputError(f"{name}: holds no indentation; check --indentation-column")
        faults = {}
        presses = []
        for number, (first, last, _) in enumerate(result.presses):
            press = (found.stamp_ns >= first) & (found.stamp_ns <= last)
            presses.append((found.stamp_ns[press], found.normal[press], stamps, values))
            fault = indentation_fault(*presses[-1])
            if fault is not None:
                faults[number] = fault
        for number, fault in faults.items():
            remedy = f"give the right {option(f'indentation_{fault.option}')}"
            text = f"press {number}: {fault.text}; {remedy}"
            # A recording of the indentation may end before the last press.
            everywhere = len(faults) == len(result.presses)
            if fault.certain and (fault.option != "time_offset" or everywhere):
                raise InputError(f"{name}: {text}")
            result.notes.append(text)
        lag = indentation_lag(presses)
        if lag is not None and abs(lag) > MAXIMUM_LAG:
            raise InputError(
                f"{name}: {lag_text('readings', lag)}; give {option(INDENTATION.offset)} "
                f"{getattr(settings, INDENTATION.offset) - lag:.2f}"
            )
        header = {"frame_id": "finger"}
        return [
            (stamp, "indentation", {"header": dict(header), "point": {"z": value}})
            for stamp, value in zip(stamps.tolist(), values.tolist())
        ]

    def areas(self) -> Iterator[_Item]:
        """Areas, and images where they are kept, in the order of time."""
        settings, result = self.settings, self.result
        if settings.area:
            stamps, areas = self._table_areas
            result.area_stamps, result.areas = stamps.tolist(), areas.tolist()
            return self._given_areas()
        frames, count, absolute = frames_of(settings, result.problems)
        begin = self._origin(settings.video or settings.images, absolute, AREA.offset)
        return self._measured_areas(frames, count, begin)

    def _given_areas(self) -> Iterator[_Item]:
        for stamp, area in zip(self.result.area_stamps, self.result.areas):
            touching = area > 0
            yield (
                stamp,
                "contact_area",
                {
                    "header": {"frame_id": "plate"},
                    "gross_area": max(area, 0.0),
                    "real_area": math.nan if touching else 0.0,
                    "area_stddev": max(self.settings.area_sd * area, LEAST_AREA_SD),
                    "flags": 0 if touching else int(AreaFlag.NO_CONTACT),
                },
            )

    def _measured_areas(self, frames: Iterator[Frame], count: int, begin: int) -> Iterator[_Item]:
        settings, result = self.settings, self.result
        plate = PlateCalibration.given(settings.calibration, settings.area_per_pixel)
        name, values = settings.area_sensor, settings.sensor
        if told := told_settings(name, values):
            result.notes.append(f"areas measured with {told} of the area sensor")
        sensor = AREA_SENSORS.open({**values, "area_sensor": name}, plate)
        stamps, areas = result.area_stamps, result.areas
        last, repeats = 0, Repeats()
        refused: list[InputError] = []
        for number, (time, image) in enumerate(frames, 1):
            stamp = begin + time
            if number > 1 and stamp <= last:
                raise InputError(
                    f"{settings.image_times or settings.video}: time of frame {number} is not "
                    "after the one before; correct the times"
                )
            # A codec makes equal frames of a scene that hardly moves.
            last = stamp
            if settings.video or not repeats.add(image):
                try:
                    found = measured(sensor, image, learn=True)
                except InputError as error:
                    refused.append(error)
                else:
                    stamps.append(stamp)
                    areas.append(found.gross_area)
                    yield stamp, "contact_area", area_fields(stamp, found, "plate")
            if settings.keep_images:
                data = cv2.imencode(".png", image)[1].tobytes()
                header = {"frame_id": "camera_optical"}
                yield (
                    stamp,
                    "image_raw/compressed",
                    {"header": header, "format": "mono8; png compressed", "data": data},
                )
            if self._show is not None:
                self._show("areas", number, max(count, number))
        if refused and not areas:
            raise refused[0]
        if refused:
            result.notes.append(f"{len(refused)} images give no area ({refused[0]})")
        result.notes += repeats.problems()

    # Checks ----------------------------------------------------------------------------------

    def check(self) -> None:
        """Check areas and tare, when all of the areas were taken; raises InputError."""
        self._check_areas()
        result = self.result
        result.problems += check_tare(
            self._force,
            result.presses[0][0],
            result.area_stamps,
            result.areas,
            self.settings.force,
            bool(self.settings.tare),
        )

    def _check_areas(self) -> None:
        """Refuse areas that no finger can have, and those of another time than the presses."""
        settings, result = self.settings, self.result
        name = settings.area or settings.video or settings.images
        high = max(result.areas, default=0.0)
        if not high > 0.0:
            raise InputError(f"{name}: no area above zero; check the column, or the image scale")
        lone = lone_areas(areas := np.array(result.areas))
        if len(lone) and np.delete(areas, lone).max() <= PLAUSIBLE_AREA[1] < high:
            row = int(np.argmax(areas))
            more = f", as are {len(lone) - 1} more" if len(lone) > 1 else ""
            raise InputError(
                f"{name}: area {row + 1} of {len(areas)} is {high * 1e6:.4g} mm², far above all "
                f"others{more}; where it marks a frame without an area, leave its cell empty, else "
                "correct it"
            )
        if not PLAUSIBLE_AREA[0] <= high <= PLAUSIBLE_AREA[1]:
            remedy = "--area-unit" if settings.area else "--area-per-pixel or --calibration"
            raise InputError(
                f"{name}: the largest area is {high * 1e6:.4g} mm², that of a fingertip lies "
                f"between {PLAUSIBLE_AREA[0] * 1e6:g} and {PLAUSIBLE_AREA[1] * 1e6:g} mm²; give "
                f"the right {remedy}"
            )
        stamps = np.array(result.area_stamps)
        inside = [int(((stamps >= a) & (stamps <= b)).sum()) for a, b, _ in result.presses]
        if not any(inside):
            origin = result.presses[0][0]
            first, last = (seconds(int(stamps[i]) - origin) for i in (0, -1))
            raise InputError(
                f"{name}: no area during a press; counted from the beginning of the first press, "
                f"the areas lie between {first:.6g} and {last:.6g} s; give --time-offset, or the "
                "--time-unit of both"
            )
        middle = np.zeros(len(stamps), bool)
        for begin, end, _ in result.presses:
            margin = (end - begin) // 4
            middle |= (stamps > begin + margin) & (stamps < end - margin)
        empty = int(np.count_nonzero(np.array(result.areas)[middle] <= 0.0))
        if settings.area and empty > FEW_EMPTY * middle.sum():
            result.notes.append(
                f"{name}: {empty} of {int(middle.sum())} areas in the middle of presses are zero "
                "or negative; leave the cells of rows without a frame empty"
            )
        for number, count in enumerate(inside):
            if count < FEWEST_AREAS:
                result.notes.append(
                    f"press {number}: {count} areas, {FEWEST_AREAS} are needed to fit"
                )


def _start(text: str) -> int:
    try:
        at = from_iso(text)
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
