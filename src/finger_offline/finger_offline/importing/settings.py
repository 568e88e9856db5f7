# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What `finger-bag import` takes: files, their columns and units, and what they belong to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from finger_common.axes import DEFAULT_NORMAL_AXIS, NORMAL_AXES
from finger_common.condition_name import check_condition_name
from finger_common.errors import InputError, known_names
from finger_common.moisture import MOISTURE_TEXT, is_moisture
from finger_common.settings import Settings, setting
from finger_common.units import AREA_UNITS, FORCE_UNITS, LENGTH_UNITS, TIME_UNITS
from finger_vision.area_sensor import AREA_SENSORS

from ..image_settings import named_values, sensor_settings

PIXELS = "px"
"""Unit of an area in pixels, which `area_per_pixel` brings to m²."""

FILES = "files"
COLUMNS = "columns and units"
IMAGES = "areas from images"
ABOUT = "what the files hold"
"""Headings of the options in the help of the command."""

PATHS = ("force", "area", "indentation", "video", "images", "image_times", "calibration")
"""Settings that name a file; in a table of trials they are relative to the table."""


SLOWEST_RATE = 1e-3
"""Hz; an image in a quarter of an hour."""


def _time_unit(meaning: str) -> Any:
    """A setting that names a unit of times."""
    return setting("", meaning, choices=("", *TIME_UNITS), group=COLUMNS)


@dataclass(frozen=True)
class ImportSettings(Settings):
    """One recording: force, areas from a table, a video or images, and perhaps indentation.

    A table file is FILE or FILE::PART, where PART is the sheet of a workbook, the group or
    dataset of an HDF5 or MATLAB file, or the stream of an XDF file.
    """

    force: str = setting("", "Table with time and force.", group=FILES)
    area: str = setting("", "Table with time and contact area.", group=FILES)
    indentation: str = setting(
        "", "Table with time and measured indentation, beside the areas.", group=FILES
    )
    video: str = setting("", "Video of the contact, in place of areas.", group=FILES)
    images: str = setting(
        "", "Folder of images of the contact, in the order of their names.", group=FILES
    )
    image_times: str = setting(
        "", "Table with the time of each frame of a video or each image.", group=FILES
    )
    force_time: str = setting("time_s", "Column of the force's time.", group=COLUMNS)
    force_column: str = setting(
        "force_n",
        "Column of the normal force, or the three columns of the force as X,Y,Z.",
        group=COLUMNS,
    )
    force_unit: str = setting(
        "",
        "Unit of the force; empty: as the heading says (force_mn, Fz [N]).",
        choices=("", *FORCE_UNITS),
        group=COLUMNS,
    )
    force_sign: str = setting(
        "positive",
        "Sign of a single force column while the finger presses.",
        choices=("positive", "negative"),
        group=COLUMNS,
    )
    normal_axis: str = setting(
        DEFAULT_NORMAL_AXIS,
        "With three force columns, the axis along which a pressing finger gives a positive force.",
        choices=NORMAL_AXES,
        group=COLUMNS,
    )
    tare: float = setting(
        0.0,
        "Subtract the mean force of the first seconds, without contact; 0: the force is tared "
        "already.",
        "s",
        0.0,
        600.0,
        group=COLUMNS,
    )
    area_time: str = setting("time_s", "Column of the areas' or images' time.", group=COLUMNS)
    area_column: str = setting("area_mm2", "Column of the gross contact area.", group=COLUMNS)
    area_unit: str = setting(
        "",
        "Unit of the area; empty: as the heading says (area_mm2, Area [cm²]). px needs "
        "--area-per-pixel.",
        choices=("", *AREA_UNITS, PIXELS),
        group=COLUMNS,
    )
    area_sd: float = setting(
        0.03,
        "Standard deviation of the areas of a table, as a share of each; 0.5 mm² at least.",
        "",
        0.0,
        1.0,
        group=COLUMNS,
    )
    indentation_time: str = setting("time_s", "Column of the indentation's time.", group=COLUMNS)
    indentation_column: str = setting(
        "indentation_mm",
        "Column of the approach of plate and bone; its zero need not be known.",
        group=COLUMNS,
    )
    indentation_unit: str = setting(
        "",
        "Unit of the indentation; empty: as the heading says (indentation_mm, Weg [µm]).",
        choices=("", *LENGTH_UNITS),
        group=COLUMNS,
    )
    indentation_sign: str = setting(
        "positive",
        "Sign of its change while plate and bone come closer.",
        choices=("positive", "negative"),
        group=COLUMNS,
    )
    indentation_time_offset: float = setting(
        0.0,
        "Added to the times of the indentation, if its clock differs from that of the force.",
        "s",
        -1e9,
        1e9,
        group=COLUMNS,
    )
    time_unit: str = _time_unit("Unit of all times; empty: as the heading says, else seconds.")
    force_time_unit: str = _time_unit("Unit of the force's times; empty: as --time-unit says.")
    area_time_unit: str = _time_unit(
        "Unit of the areas' or images' times; empty: as --time-unit says."
    )
    indentation_time_unit: str = _time_unit(
        "Unit of the indentation's times; empty: as --time-unit says."
    )
    time_offset: float = setting(
        0.0,
        "Added to the times of areas or images, if their clock differs from that of the force.",
        "s",
        -1e9,
        1e9,
        group=COLUMNS,
    )
    force_rate: float = setting(
        0.0,
        "Samples a second, if the table of the force has no times; 0: the table has times.",
        "Hz",
        0.0,
        1e6,
        group=COLUMNS,
    )
    trial_column: str = setting(
        "",
        "Column that separates the recordings in tables with several: one bag for every value.",
        group=COLUMNS,
    )
    subject_column: str = setting(
        "", "Column with the subject of each row, in place of --subject.", group=COLUMNS
    )
    condition_column: str = setting(
        "", "Column with the condition of each row, in place of --condition.", group=COLUMNS
    )
    area_per_pixel: float = setting(
        0.0,
        "Area of a pixel on the plate, in place of a calibration; 0: not given.",
        "m²",
        0.0,
        1e-4,
        group=IMAGES,
    )
    calibration: str = setting("", "Plate calibration (finger-vision calibrate).", group=IMAGES)
    frame_rate: float = setting(
        0.0,
        "Frames or areas a second, if neither the video nor a table has their times; 0: not given.",
        "Hz",
        0.0,
        1e5,
        group=IMAGES,
    )
    area_sensor: str = setting(
        AREA_SENSORS.default, "Area sensor that measures the contact.", group=IMAGES
    )
    set: list[str] = setting(
        [], "Settings of the area sensor as NAME=VALUE, such as minimum_area=1e-6.", group=IMAGES
    )
    keep_images: bool = setting(
        False,
        "Write the images into the bag too, as lossless PNG. They show prints: biometric data.",
        group=IMAGES,
    )
    subject: str = setting("", "Code of the subject, never a name.", group=ABOUT)
    condition: str = setting("", "Condition of the skin, such as dry.", group=ABOUT)
    moisture: list[str] = setting(
        [], "Readings of the moisture probe (a.u.) that belong to each press.", group=ABOUT
    )
    session: str = setting("import", "Name of the session.", group=ABOUT)
    index: int = setting(0, "Number of the first press.", "", 0, 10**6, group=ABOUT)
    target_force: float = setting(
        0.0,
        "Force at which the loading ends; 0: 95 % of the peak of each press.",
        "N",
        0.0,
        100.0,
        group=ABOUT,
    )
    start: str = setting(
        "2000-01-01",
        "Date and time (UTC) of time 0, for times that are not dates.",
        group=ABOUT,
    )

    def validate(self) -> None:
        """One source of areas with its scale; subject and condition named."""
        given = [name for name in ("area", "video", "images") if getattr(self, name)]
        if not self.force:
            raise InputError("no file with the force; give it with --force")
        if len(given) != 1:
            what = " and ".join(f"--{name}" for name in given) or "none"
            raise InputError(f"areas: {what} given; give one of --area, --video and --images")
        for name in ("subject", "condition"):
            value, column = getattr(self, name), getattr(self, f"{name}_column")
            if value and column:
                raise InputError(f"--{name} and --{name}-column are given; give one of them")
            if column:
                continue
            if not value:
                raise InputError(
                    f"no {name}; give it with --{name}, with --{name}-column, or as a column of "
                    "--trials"
                )
            check_condition_name(value, name)
        if self.area:
            for name in ("calibration", "image_times"):
                if getattr(self, name):
                    option = name.replace("_", "-")
                    raise InputError(f"--{option} is for --video and --images, not for --area")
            if self.area_unit == PIXELS and not self.area_per_pixel:
                raise InputError(
                    "--area-unit px: give the area of a pixel in m² with --area-per-pixel, such as "
                    "9.86e-10"
                )
        elif self.grouping:
            raise InputError(
                f"--{next(iter(self.grouping)).replace('_', '-')} is for areas in a table; give "
                "videos and images of several recordings with --trials"
            )
        elif bool(self.area_per_pixel) == bool(self.calibration):
            raise InputError(
                f"areas from --{given[0]}: give either --calibration (finger-vision calibrate "
                "makes it) or --area-per-pixel in m², such as 9.86e-10"
            )
        if 0.0 < self.frame_rate < SLOWEST_RATE:
            raise InputError(
                f"--frame-rate {self.frame_rate:g}: below {SLOWEST_RATE:g} Hz; give images a second"
            )
        if self.set and self.area:
            raise InputError("--set is for --video and --images, not for --area")
        _ = self.readings, self.sensor

    def check_used(self) -> None:
        """Raise InputError for an option that one recording has no use for."""
        pictures = ("calibration", "image_times", "area_sensor", "set", "keep_images")
        table = ("area_column", "area_unit", "area_sd")
        unused = [(name, "--video and --images") for name in pictures if self.area]
        unused += [(name, "--area") for name in table if not self.area]
        if not self.indentation:
            names = [p.name for p in self.parameters() if p.name.startswith("indentation_")]
            unused += [(name, "--indentation") for name in names]
        for name, use in unused:
            if getattr(self, name) != self.parameters()[name].default:
                option = name.replace("_", "-")
                raise InputError(f"--{option} is for {use}; give that too, or leave it out")

    @property
    def grouping(self) -> dict[str, str]:
        """Option → column, of the columns that tell recordings apart."""
        names = ("subject_column", "condition_column", "trial_column")
        return {name: getattr(self, name) for name in names if getattr(self, name)}

    @property
    def sensor(self) -> dict[str, Any]:
        """Settings of the area sensor that are given; raises InputError for what is none."""
        values = named_values(self.set, "minimum_area=1e-6")
        found = sensor_settings(self.area_sensor, values)
        for name in values:
            table = AREA_SENSORS.load(self.area_sensor).SETTINGS.parameters()
            known = known_names(name, (p.name for p in table))
            raise InputError(f"--set: '{name}' is no setting of the area sensor; {known}")
        return found

    @property
    def readings(self) -> list[float]:
        """Moisture readings (a.u.); raises InputError for text that is none."""
        values = []
        for text in self.moisture:
            try:
                value = float(text)
            except ValueError:
                value = float("nan")
            if not is_moisture(value):
                raise InputError(f"moisture '{text[:20]}' is no reading; give {MOISTURE_TEXT}")
            values.append(value)
        return values
