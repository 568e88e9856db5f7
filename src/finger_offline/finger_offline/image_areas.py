# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contact areas from the images of a bag, through the same area sensor as the live vision node."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np

from finger_bag.definitions import typestore
from finger_bag.reader import BagMessage, BagReader
from finger_bag.schema import CALIBRATION_ATTACHMENT
from finger_common.errors import FingerError, InputError
from finger_common.image_size import PixelBudget, check_image
from finger_common.mono8 import brightest_channel
from finger_vision.area_sensor import (
    AREA_SENSORS,
    AreaSensor,
    ContactMeasurement,
)
from finger_vision.calibration import PlateCalibration
from finger_vision.messages import contact_area_fields, image_of
from finger_vision.ridge_motion import RidgeMotion, with_motion

DARKEST = 4096
"""Value of a 16-bit pixel that some pixel of a recording reaches where the camera fills 16 bits."""

IMAGES_AHEAD = 6
"""Images that may wait to be measured."""


def grey_image(message: Any) -> np.ndarray:
    """Image (H, W) of a sensor_msgs Image or CompressedImage, uint8, uint16 or float32.

    Raises InputError when it cannot be used.
    """
    if not hasattr(message, "format"):
        return image_of(message)
    data = np.frombuffer(bytes(message.data), np.uint8)
    check_image(data.data, f"compressed image ('{message.format[:40]}')")
    try:
        image = cv2.imdecode(data, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error:
        image = None
    if image is None:
        raise InputError(f"compressed image ('{message.format[:40]}') cannot be decoded")
    return image if image.ndim == 2 else brightest_channel(image)


def calibration_of(
    reader: BagReader, file: str = "", area_per_pixel: float = 0.0
) -> PlateCalibration:
    """Plate calibration from a file or an area (m²), else from the bag's attachment.

    Raises InputError when there is none.
    """
    if file:
        return PlateCalibration.load(file)
    if area_per_pixel:
        return PlateCalibration.from_area_per_pixel(area_per_pixel)
    data = reader.attachment(CALIBRATION_ATTACHMENT)
    if data is None:
        raise InputError(
            f"{reader.path}: no plate calibration attached ({CALIBRATION_ATTACHMENT}); "
            "give one with --calibration, or --area-per-pixel"
        )
    where = f"{reader.path}, {CALIBRATION_ATTACHMENT}"
    return PlateCalibration.from_yaml(data.decode(errors="replace"), where)


class ImageAreas:
    """Collects the areas of images; `add` one image message after the other, in order.

    pixels: of all images together, None: without limit; those behind them are not measured, and
    counted in `left_out`.
    motion: follows the ridges, None: nobody does.
    """

    def __init__(
        self,
        sensor: AreaSensor,
        pixels: PixelBudget | None = None,
        motion: RidgeMotion | None = None,
    ) -> None:
        self._sensor = sensor
        self._motion = motion
        self._pixels = pixels
        self.left_out = 0
        self._brightest = 0
        self._rows: list[tuple[int, int, float, float, float, int]] = []

    @classmethod
    def for_bag(
        cls,
        reader: BagReader,
        calibration: str = "",
        area_per_pixel: float = 0.0,
        area_sensor: str = AREA_SENSORS.default,
        ridge_motion: bool = False,
    ) -> ImageAreas:
        """With the area sensor's default settings and the bag's calibration.

        ridge_motion: whether ridges are followed from image to image.
        """
        found = calibration_of(reader, calibration, area_per_pixel)
        pixels = PixelBudget(reader.info.size)
        sensor = AREA_SENSORS.open({"area_sensor": area_sensor}, found)
        return cls(sensor, pixels, RidgeMotion(calibration=found) if ridge_motion else None)

    def measure(self, message: Any) -> ContactMeasurement:
        """Measure one image; raises InputError when it is no usable image."""
        if self._pixels is not None and self._pixels.spent:
            self.left_out += 1
            raise InputError("more pixels than a bag of this size can hold; not measured")
        image = grey_image(message)
        if self._pixels is not None:
            self._pixels.take(image.size)
        if image.dtype == np.uint16:
            self._brightest = max(self._brightest, int(image.max()))
        return with_motion(self._sensor.process(image), image, self._motion)

    def add(self, item: BagMessage, stamp: int) -> None:
        """Measure one image and keep its area; raises InputError when it is no usable image."""
        found = self.measure(item.message)
        self._rows.append(
            (
                stamp,
                item.log_time_ns,
                found.gross_area,
                found.real_area,
                found.area_sd,
                int(found.flags),
            )
        )

    def problems(self) -> list[str]:
        """Sentences on what the images as a whole lack."""
        if not 0 < self._brightest < DARKEST:
            return []
        return [
            f"the images have 16 bits, but no pixel is brighter than {self._brightest}: a camera "
            "of 10 or 12 bits that fills the lower ones? Scale them to full scale; as they are, "
            "contacts are hardly seen"
        ]

    def arrays(self) -> dict[str, np.ndarray]:
        """Columns for SessionStreams."""
        table = np.array([r[2:5] for r in self._rows], float).reshape(-1, 3)
        return {
            "area_stamp_ns": np.array([r[0] for r in self._rows], np.int64),
            "area_log_ns": np.array([r[1] for r in self._rows], np.int64),
            "area": table[:, 0],
            "real_area": table[:, 1],
            "area_sd": table[:, 2],
            "area_flags": np.array([r[5] for r in self._rows], np.int64),
        }


class MeasuringThread:
    """Measures images in a thread of its own, in order; a context manager."""

    def __init__(self, areas: ImageAreas) -> None:
        self.areas = areas
        self._opencv_threads = cv2.getNumThreads()
        self._pool = ThreadPoolExecutor(1, "vision")
        self._pending: deque[tuple[BagMessage, Future[ContactMeasurement]]] = deque()

    def __enter__(self) -> MeasuringThread:
        # OpenCV's own threads take processor time from the estimator and save none.
        cv2.setNumThreads(1)
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)
        cv2.setNumThreads(self._opencv_threads)

    def add(self, item: BagMessage) -> None:
        """Measure an image, later."""
        self._pending.append((item, self._pool.submit(lambda: self.areas.measure(item.message))))

    def results(
        self, until_ns: int
    ) -> Iterator[tuple[BagMessage, ContactMeasurement | FingerError]]:
        """Wait for and take the images logged until then, and all but the newest few.

        An unusable image gives its error.
        """
        pending = self._pending
        while pending and (len(pending) > IMAGES_AHEAD or pending[0][0].log_time_ns <= until_ns):
            item, future = pending.popleft()
            try:
                yield item, future.result()
            except FingerError as error:
                yield item, error


def area_fields(stamp: int, measurement: ContactMeasurement, frame_id: str) -> dict[str, Any]:
    """Fields of a ContactArea as `BagWriter.write` takes them."""
    fields = contact_area_fields(measurement)
    for name in ("centroid", "slip"):
        fields[name] = dict(zip("xyz", fields[name]))
    point = typestore().types["geometry_msgs/msg/Point32"]
    fields["hull"] = [point(u, v, 0.0) for u, v in fields["hull"].tolist()]
    return {"header": {"stamp": stamp, "frame_id": frame_id}, **fields}
