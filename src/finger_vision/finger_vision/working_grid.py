# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The coarser grid of pixels on which frames are measured."""

from __future__ import annotations

import math

import cv2
import numpy as np

from finger_common.errors import InputError

from .calibration import PlateCalibration

MAXIMUM_PIXELS = 6_000_000
"""Pixels of a working image: a plate of 150 × 140 mm at 60 µm. Larger frames are reduced more."""

Box = tuple[slice, slice]
"""Rows and columns of a part of the working image."""


def to_coarse(points: np.ndarray, step: int) -> np.ndarray:
    """Points (n, 2) of a frame in pixels of step × step of its own; centres are at integers."""
    return (points + 0.5) / step - 0.5


def to_fine(points: np.ndarray, step: int) -> np.ndarray:
    """Points (n, 2) in the frame's own pixels; the inverse of `to_coarse`."""
    return (points + 0.5) * step - 0.5


class WorkingGrid:
    """Pixels of about `working_pixel` (m), made of step × step pixels of the frame; larger ones
    for a frame of which these would be too many.

    size: (width, height) of the frame. shape: (rows, columns) of the working image. pitch: side of
    a working pixel, m. areas: (rows, columns) area of each on the plate, m². period: ridge period
    in working pixels.
    """

    def __init__(
        self,
        size: tuple[int, int],
        calibration: PlateCalibration,
        working_pixel: float,
        ridge_period: float,
    ) -> None:
        calibration.check_size(*size)
        width, height = size
        self.size = size
        self.calibration = calibration
        pitch = calibration.pitch(width, height)
        fewest = math.ceil(math.sqrt(width * height / MAXIMUM_PIXELS))
        self.step = max(1, round(working_pixel / pitch), fewest)
        self.pitch = pitch * self.step
        # Multiples of 4, so that coarser grids fit: up to three working pixels at the far borders
        # are left out.
        self.shape = (height // self.step // 4 * 4, width // self.step // 4 * 4)
        if min(self.shape) < 32:
            raise InputError(
                f"image of {width}×{height} pixels is too small at {pitch * 1e6:.0f} µm a pixel; "
                f"{32 * self.step} pixels a side are needed"
            )
        areas = calibration.pixel_areas(width, height, self.step)
        self.areas = areas[: self.shape[0], : self.shape[1]] * np.float32(self.step**2)
        self.period = ridge_period / self.pitch

    def reduce(self, image: np.ndarray) -> np.ndarray:
        """Working image (rows, columns) uint8 of a frame (H, W) uint8, by averaging."""
        rows, columns = self.shape
        cut = image[: rows * self.step, : columns * self.step]
        if self.step == 1:
            return cut
        return cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA)

    def to_plate(self, points: np.ndarray, box: Box) -> np.ndarray:
        """(n, 2) m from points in working pixels of a box; pixel centres are at integers."""
        corner = np.array([box[1].start, box[0].start])
        pixels = to_fine(points + corner, self.step)
        return self.calibration.to_plate(pixels, *self.size)
