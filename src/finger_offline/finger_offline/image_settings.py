# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How contact areas are measured in the images of a bag."""

from __future__ import annotations

from dataclasses import dataclass

from finger_bag.reader import BagReader
from finger_bag.schema import CALIBRATION_ATTACHMENT
from finger_common.errors import InputError
from finger_common.settings import Settings, setting
from finger_vision.area_sensor import AREA_SENSORS
from finger_vision.calibration import PlateCalibration


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
