# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The ridges alone of the images of a contact: without plate, light, contrast and outline."""

from __future__ import annotations

import cv2
import numpy as np

from .calibration import PlateCalibration
from .working_grid import to_coarse, to_fine

FLOW_PIXEL = 28e-6
"""m; finer images are reduced as far as pixels stay below twice this size."""

WINDOW = 1.1
"""Side of the compared patches, in ridge periods: an odd number of pixels."""

TAPER = 0.07e-3
"""m from the outline inwards over which the texture fades."""


class RidgeTexture:
    """Makes textures of the images of one size of one camera, and remembers the plate.

    A frame is an image whose pixels are as large as those of the texture. size: (width, height) of
    the images. pitch: side of a frame's pixel, m. window: side of a patch, pixels of a frame.
    """

    def __init__(
        self, size: tuple[int, int], calibration: PlateCalibration, ridge_period: float
    ) -> None:
        self.size = size
        self._calibration = calibration
        self._ridge_period = ridge_period
        pitch = calibration.pitch(*size)
        self._step = max(1, int(FLOW_PIXEL / pitch))
        self.pitch = pitch * self._step
        self.window = max(9, round(WINDOW * ridge_period / self.pitch) | 1)
        self._plate: np.ndarray | None = None

    def frame(self, image: np.ndarray) -> np.ndarray:
        """Frame (h, w) uint8 of an image (H, W) uint8, by averaging."""
        if self._step == 1:
            return image
        width, height = (side // self._step for side in self.size)
        cut = image[: height * self._step, : width * self._step]
        return cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA)

    def from_plate(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 2) in pixels of a frame from points in m on the plate."""
        return to_coarse(self._calibration.to_pixels(points, *self.size), self._step)

    def to_plate(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 2) in m on the plate from points in pixels of a frame."""
        return self._calibration.to_plate(to_fine(points, self._step), *self.size)

    def learn(self, frame: np.ndarray) -> None:
        """Learn what the plate carries, which does not move with the skin, from an empty frame."""
        if self._plate is None:
            self._plate = frame.astype(np.float32)
        else:
            cv2.accumulateWeighted(frame, self._plate, 0.1)

    def of(self, frame: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ridges alone about a contact, (h, w) uint8 about 128, and their strength (h, w) before.

        Without the plate's own texture, light that varies slowly, and contrast.
        """
        size = max(3, round(2.0 * self._ridge_period / self.pitch) | 1)
        box = box_about(mask, 2 * size)
        picture = frame[box].astype(np.float32)
        if self._plate is not None:
            light = cv2.max(self._plate[box], np.array([40.0]))
            cv2.divide(picture, light, picture, 128.0)
        # Of the skin alone: its outline stands still.
        taper = 2 * round(TAPER / self.pitch) + 1
        inside = cv2.erode(mask[box], np.ones((taper, taper), np.uint8)).astype(np.float32) / 255
        inside = np.asarray(cv2.blur(inside, (taper, taper)), np.float32)
        share = cv2.blur(inside, (size, size)) + 1e-3
        mean = cv2.divide(cv2.blur(cv2.multiply(picture, inside), (size, size)), share)
        picture = np.asarray(cv2.multiply(cv2.subtract(picture, mean), inside), np.float32)
        square = cv2.blur(cv2.multiply(picture, picture), (size, size))
        spread = np.sqrt(np.maximum(square, 0.0) / share)
        strength = np.zeros(frame.shape, np.float32)
        strength[box] = spread
        floor = max(0.25 * float(np.percentile(spread[::8, ::8], 98)), 2.0)
        scaled = cv2.divide(picture, cv2.max(spread, np.array([floor])), scale=42.0)
        texture = np.full(frame.shape, 128, np.uint8)
        texture[box] = cv2.add(scaled, np.array([128.0]), dtype=cv2.CV_8U)
        return texture, strength

    def gradients(self, texture: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Mean products gxx, gxy, gyy (n, 3) of a texture's gradient over patches at (n, 2)."""
        low = np.maximum(np.floor(places.min(axis=0)).astype(int) - self.window, 0)
        high = np.ceil(places.max(axis=0)).astype(int) + self.window
        gx, gy = cv2.spatialGradient(
            np.ascontiguousarray(texture[low[1] : high[1], low[0] : high[0]])
        )
        gx, gy = gx.astype(np.float32), gy.astype(np.float32)
        size = (self.window, self.window)
        columns, rows = (np.rint(places).astype(int) - low).T
        products: tuple[np.ndarray, ...] = (gx * gx, gx * gy, gy * gy)
        return np.column_stack([cv2.blur(a, size)[rows, columns] for a in products])


def box_about(mask: np.ndarray, margin: int) -> tuple[slice, slice]:
    """Rows and columns of a mask with a margin about it."""
    x, y, width, height = cv2.boundingRect(mask)
    return (
        slice(max(y - margin, 0), y + height + margin),
        slice(max(x - margin, 0), x + width + margin),
    )
