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
from finger_bag.streams import AREA
from finger_common.errors import FingerError, InputError
from finger_common.image_size import PixelBudget
from finger_vision.area_sensor import AreaSensor, ContactMeasurement
from finger_vision.camera_stream import CameraStream, LeftOut
from finger_vision.messages import contact_area_fields, image_of
from finger_vision.ridge_motion import DEFAULT_RIDGE_PERIOD, RidgeMotion

from .image_settings import ImageSettings

IMAGES_AHEAD = 6
"""Images that may wait to be measured."""


class ImageAreas:
    """Collects the areas of images; `add` one image message after the other, in order.

    pixels: of all images together; those behind them are not measured, and counted in `left_out`.
    Images that a camera repeats, or stamps out of order, give no area.
    motion: follows the ridges, None: nobody does.
    """

    def __init__(
        self,
        sensor: AreaSensor,
        pixels: PixelBudget,
        motion: RidgeMotion | None = None,
    ) -> None:
        self._stream = CameraStream(sensor, motion)
        self._pixels = pixels
        self.left_out = 0
        self._rows: list[tuple[int, int, float, float, float, int]] = []

    @classmethod
    def for_bag(
        cls, reader: BagReader, settings: ImageSettings, ridge_motion: bool = False
    ) -> ImageAreas:
        """With the settings' area sensor; raises InputError without a plate calibration.

        ridge_motion: whether ridges are followed from image to image.
        """
        plate = settings.plate(reader)
        pixels = PixelBudget(reader.info.size)
        sensor = settings.opened(plate)
        period = settings.sensor.get("ridge_period", DEFAULT_RIDGE_PERIOD)
        motion = RidgeMotion(calibration=plate, ridge_period=period) if ridge_motion else None
        return cls(sensor, pixels, motion)

    def measure(self, message: Any, stamp: int | None = None) -> ContactMeasurement:
        """Measure one image; stamp: its own (ns), where their order matters. Raises InputError when
        it is no usable image, its subclass LeftOut for one that `problems` tells."""
        if self._pixels.spent:
            self.left_out += 1
            raise InputError("more pixels than a bag of this size can hold; not measured")
        if stamp is not None:
            self._stream.order.check(stamp)
        image = image_of(message)
        self._pixels.take(image.shape[0] * image.shape[1])
        return self._stream.measure(self._stream.signal(image))

    def add(self, item: BagMessage, stamp: int) -> None:
        """Measure one image and keep its area; raises InputError when it is no usable image."""
        try:
            found = self.measure(item.message, stamp)
        except LeftOut:
            return
        areas = found.gross_area, found.real_area, found.area_sd
        self._rows.append((stamp, item.log_time_ns, *areas, int(found.flags)))

    def problems(self) -> list[str]:
        """Sentences on what the images as a whole lack."""
        return self._stream.problems()

    def table(self) -> np.ndarray:
        """The areas (k,), of `finger_bag.streams.AREA`."""
        return np.array(self._rows, AREA)


class MeasuringThread:
    """Measures images in a thread of its own, in order; a context manager."""

    def __init__(self, areas: ImageAreas) -> None:
        self.areas = areas
        self._opencv_threads = cv2.getNumThreads()
        self._pool = ThreadPoolExecutor(1, "vision")
        self._pending: deque[tuple[BagMessage, int, Future[ContactMeasurement]]] = deque()

    def __enter__(self) -> MeasuringThread:
        # OpenCV's own threads take processor time from the estimator and save none.
        cv2.setNumThreads(1)
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)
        cv2.setNumThreads(self._opencv_threads)

    def add(self, item: BagMessage, stamp: int) -> None:
        """Measure an image of this stamp (ns), later."""
        future = self._pool.submit(lambda: self.areas.measure(item.message, stamp))
        self._pending.append((item, stamp, future))

    def results(
        self, until_ns: int
    ) -> Iterator[tuple[BagMessage, int, ContactMeasurement | FingerError]]:
        """Wait for and take the images logged until then, and all but the newest few, with their
        stamps.

        An unusable image gives its error.
        """
        pending = self._pending
        while pending and (len(pending) > IMAGES_AHEAD or pending[0][0].log_time_ns <= until_ns):
            item, stamp, future = pending.popleft()
            try:
                yield item, stamp, future.result()
            except FingerError as error:
                yield item, stamp, error


def area_fields(stamp: int, measurement: ContactMeasurement, frame_id: str) -> dict[str, Any]:
    """Fields of a ContactArea as `BagWriter.write` takes them."""
    fields = contact_area_fields(measurement)
    for name in ("centroid", "slip"):
        fields[name] = dict(zip("xyz", fields[name]))
    point = typestore().types["geometry_msgs/msg/Point32"]
    fields["hull"] = [point(u, v, 0.0) for u, v in fields["hull"].tolist()]
    return {"header": {"stamp": stamp, "frame_id": frame_id}, **fields}
