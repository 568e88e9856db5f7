# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How contact areas are measured in the images of a bag."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from finger_bag.reader import BagReader
from finger_bag.schema import CALIBRATION_ATTACHMENT
from finger_common.errors import InputError, put_once
from finger_common.settings import Settings, setting
from finger_vision.area_sensor import AREA_SENSORS, AreaSensor
from finger_vision.calibration import PlateCalibration


def named_values(pairs: Sequence[str], example: str) -> dict[str, Any]:
    """Values of NAME=VALUE pairs by name; raises InputError."""
    found: dict[str, Any] = {}
    for pair in pairs:
        name, sign, text = pair.partition("=")
        if not sign:
            raise InputError(f"--set {pair}: give NAME=VALUE, such as {example}")
        try:
            value = json.loads(text)
        except ValueError:
            value = text
        put_once(found, name, value, "--set")
    return found


def sensor_settings(area_sensor: str, values: dict[str, Any]) -> dict[str, Any]:
    """Take the settings of an area sensor out of values by name, checked; raises InputError, also
    for a sensor that is not installed."""
    if not values and area_sensor == AREA_SENSORS.default:
        return {}
    known = AREA_SENSORS.load(area_sensor).SETTINGS.parameters()
    found = {name: values.pop(name) for name in list(values) if name in known}
    known.check(found)
    return found


def told_settings(area_sensor: str, values: Mapping[str, Any]) -> str:
    """The settings of an area sensor that are not its defaults, in words; empty without any."""
    if not values:
        return ""
    known = AREA_SENSORS.load(area_sensor).SETTINGS.parameters()
    return ", ".join(f"{n} {v}" for n, v in values.items() if v != known[n].default)


@dataclass(frozen=True)
class ImageSettings(Settings):
    """The plate in the images of a bag, and the area sensor that measures them."""

    calibration: str = setting(
        "", "Plate calibration file for the images; empty: the one attached to the bag."
    )
    area_per_pixel: float = setting(
        0.0, "Area of a pixel in place of a calibration; 0: not given.", unit="m²", minimum=0.0
    )
    area_sensor: str = setting(
        AREA_SENSORS.default, "Area sensor that measures the contact in the images."
    )
    sensor: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the area sensor by name; defaults where absent."""

    def validate(self) -> None:
        """One scale of the images."""
        if self.calibration and self.area_per_pixel:
            raise InputError("--calibration and --area-per-pixel: give one of the two")

    def told(self) -> str:
        """What is given for images, in words; empty without any."""
        own = [p for p in ImageSettings.parameters() if getattr(self, p.name) != p.default]
        words = [f"{p.name} {getattr(self, p.name)}" for p in own]
        sensor = told_settings(self.area_sensor, self.sensor)
        return ", ".join(filter(None, (*words, sensor)))

    def opened(self, plate: PlateCalibration) -> AreaSensor:
        """The area sensor with its settings; raises InputError for those that it refuses."""
        return AREA_SENSORS.open({**self.sensor, "area_sensor": self.area_sensor}, plate)

    def plate(self, reader: BagReader) -> PlateCalibration:
        """Plate calibration of the file or the area, else of the bag's attachment.

        Raises InputError when there is none.
        """
        if self.calibration or self.area_per_pixel:
            return PlateCalibration.given(self.calibration, self.area_per_pixel)
        data = reader.attachment(CALIBRATION_ATTACHMENT)
        if data is None:
            raise InputError(
                f"{reader.path}: no plate calibration attached ({CALIBRATION_ATTACHMENT}); "
                "give one with --calibration, or --area-per-pixel"
            )
        where = f"{reader.path}, {CALIBRATION_ATTACHMENT}"
        return PlateCalibration.from_yaml(data.decode(errors="replace"), where)
