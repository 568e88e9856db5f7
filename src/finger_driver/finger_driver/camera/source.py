# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What every camera's driver gives, and the settings that all of them have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from finger_common.diagnostics import Health
from finger_common.errors import InputError
from finger_common.mono8 import Mono8
from finger_common.settings import Settings, setting

from ..device import Device


@dataclass(frozen=True)
class CameraSettings(Settings):
    """Settings of every camera."""

    path: str = setting(
        "",
        "folder: the folder of frames. opencv: number of the camera, file, image sequence or "
        "pipeline.",
    )
    rate: float = setting(
        10.0, "Frames per second requested and expected.", unit="Hz", minimum=0.1, maximum=1000.0
    )
    width: int = setting(
        0, "Width requested; 0 leaves it as it is.", unit="px", minimum=0, maximum=20000
    )
    height: int = setting(
        0, "Height requested; 0 leaves it as it is.", unit="px", minimum=0, maximum=20000
    )
    exposure: float = setting(
        0.0, "Exposure time requested; 0 leaves it as it is.", unit="s", minimum=0.0, maximum=10.0
    )

    def address(self) -> str:
        """What tells this camera from others, in words; empty where nobody knows."""
        return f"path {self.path}" if self.path else ""


@dataclass(frozen=True)
class Frame:
    """One image.

    stamp_ns: acquisition, ns since the epoch, before the calibrated offset of the rig is added.
    image (H, W) uint8. sequence: the camera's own number of the frame; a gap means lost frames.
    """

    stamp_ns: int
    image: np.ndarray
    sequence: int


class CameraSource(Device[Frame]):
    """A monochrome camera."""

    SETTINGS: type[CameraSettings] = CameraSettings

    def __init__(self, settings: CameraSettings) -> None:
        rate = settings.rate
        self.stale_after = max(1.0, 5 / rate)
        """s without a frame after which the camera counts as silent."""
        health = Health("camera", expected_rate=rate, stale_after=self.stale_after)
        super().__init__(settings, health)
        self._next_number: int | None = None
        self._mono8 = Mono8()

    def frame(self, stamp_ns: int, image: np.ndarray, sequence: int, where: str) -> Frame | None:
        """A frame of an image as the camera gave it: grey or colour, 8 or 16 bits.

        None, and noted, for one that cannot be used. where: names the image.
        """
        try:
            grey = self._mono8(image, where)
        except InputError as error:
            self.note("malformed", str(error))
            return None
        self.cleared("malformed")
        return Frame(stamp_ns, np.ascontiguousarray(grey), sequence)

    def count_lost(self, number: int) -> None:
        """Count the frames that are missing before frame `number` of the camera's own counting."""
        expected = self._next_number
        if expected is not None and number > expected:
            self.health.count("lost", number - expected)
        self._next_number = number + 1
