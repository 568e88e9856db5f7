# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Frames written into a folder as a camera's program would, for the `folder` camera.

Models: acquisition stamp and frame number in the file name, files that appear whole, a bounded
folder, lost and repeated frames (FAULTS). Does not model: exposure, transfer time, sensor noise
(the caller's image is written as it is), the camera's own clock.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from finger_common.errors import InputError
from finger_common.files import make_folder
from finger_common.settings import Settings, setting

from ..camera.folder import file_name, parse_name
from .faults import Faults
from .simulator import Simulator
from .values import moving_disc

FAULTS = {
    "silent": "no frame is written",
    "lost": "a frame is left out; its number is missing",
    "frozen": "the same image again under a new stamp",
    "damaged": "half of the file is missing",
}


class FrameFolderWriter:
    """Writes frames (H, W) uint8 as PGM; keeps the newest `keep` files.

    Frames that an earlier writer left in the folder are removed. Raises InputError when the folder
    cannot be written to.
    """

    def __init__(self, folder: str | Path, keep: int = 50) -> None:
        self.folder = Path(folder)
        self.faults = Faults(FAULTS)
        self.sequence = 0
        self._keep = keep
        self._written: deque[Path] = deque()
        self._last_image: np.ndarray | None = None
        try:
            make_folder(self.folder)
            for old in self.folder.iterdir():
                if parse_name(old.name) is not None:
                    old.unlink()
        except OSError as error:
            raise InputError(
                f"{folder}: cannot be written ({error.strerror}); choose a writable folder"
            ) from None

    def write(self, stamp_ns: int, image: np.ndarray) -> Path | None:
        """Write one frame; its path, or None when a fault kept it back."""
        sequence = self.sequence
        self.sequence += 1
        if self.faults.take("silent") or self.faults.take("lost"):
            return None
        if self.faults.take("frozen") and self._last_image is not None:
            image = self._last_image
        self._last_image = image
        image = np.ascontiguousarray(image, dtype=np.uint8)
        if image.ndim != 2:
            raise ValueError(f"image has shape {image.shape}, (H, W) is needed")
        data = b"P5\n%d %d\n255\n" % (image.shape[1], image.shape[0]) + image.tobytes()
        if self.faults.take("damaged"):
            data = data[:8]
        path = self.folder / file_name(stamp_ns, sequence)
        temporary = self.folder / f".{path.name}.part"
        temporary.write_bytes(data)
        os.replace(temporary, path)
        self._written.append(path)
        while len(self._written) > self._keep:
            self._written.popleft().unlink(missing_ok=True)
        return path


@dataclass(frozen=True)
class ImageOptions(Settings):
    """Options of the simulated camera."""

    folder: str = setting("", "Folder to write frames into.")
    size: str = setting("1280x1024", "WIDTHxHEIGHT in pixels.")
    rate: float = setting(10.0, "Frames per second.", unit="Hz", minimum=0.1, maximum=1000.0)
    keep: int = setting(50, "Newest files kept.", minimum=1)

    def shape(self) -> tuple[int, int]:
        """Height and width; raises InputError for what is none."""
        width, _, height = self.size.partition("x")
        if not (width.isdigit() and height.isdigit() and int(width) and int(height)):
            raise InputError(f"--size '{self.size}': write for example 1280x1024")
        return int(height), int(width)


class ImageSimulator(Simulator):
    """Camera whose program writes test images into a folder."""

    NAME = "images"
    SETTINGS = ImageOptions
    POSITIONAL = "folder"
    FAULTS = FAULTS

    def __init__(self, settings: ImageOptions) -> None:
        super().__init__()
        self._render = moving_disc(*settings.shape())
        self._writer = FrameFolderWriter(settings.folder, settings.keep)
        self.faults = self._writer.faults
        self.rate = settings.rate

    def describe(self) -> str:
        return f"in {self._writer.folder}"

    def commands(self) -> dict[str, Callable[..., None]]:
        return {"rate": self._set_rate}

    def _set_rate(self, rate: str) -> None:
        self.rate = float(rate)

    def run(self) -> None:
        for number in self.each(lambda: 1 / self.rate):
            self._writer.write(time.time_ns(), self._render(number))
