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
from finger_common.image_files import decode_image
from finger_common.image_size import PixelBudget
from finger_common.mono8 import brightest_channel
from finger_vision.area_sensor import AreaSensor, ContactMeasurement, measured
from finger_vision.messages import contact_area_fields, image_of
from finger_vision.ridge_motion import DEFAULT_RIDGE_PERIOD, RidgeMotion, with_motion

from .image_settings import ImageSettings

LEAST_BRIGHTEST = 4096
"""Value that the brightest 16-bit pixel of a recording reaches where the camera fills 16 bits."""

IMAGES_AHEAD = 6
"""Images that may wait to be measured."""


def grey_image(message: Any) -> np.ndarray:
    """Image (H, W) of a sensor_msgs Image or CompressedImage, uint8, uint16 or float32.

    Raises InputError when it cannot be used.
    """
    if not hasattr(message, "format"):
        return image_of(message)
    where = f"compressed image ('{message.format[:40]}')"
    image = decode_image(bytes(message.data), where, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    return image if image.ndim == 2 else brightest_channel(image)


class RepeatedImage(InputError):
    """An image that a camera gave once more, which gives no area."""


NOISY, NOISY_PAIRS = 0.2, 3
"""Share of the pixels that differ from image to image of a camera, by its noise, so many times in a
row; a drawn image of a scene that moves differs in fewer."""


class Repeats:
    """Tells images that a camera, or its driver, gave once more, in place of a new one: its noise
    makes two equal ones all but impossible. `count` counts them."""

    def __init__(self) -> None:
        self.count = 0
        self._before: np.ndarray | None = None
        self._noisy = 0

    def add(self, image: np.ndarray) -> bool:
        """Whether the next image (H, W) is the one before once more."""
        before, self._before = self._before, image
        if before is None or before.shape != image.shape:
            return False
        changed = float(np.mean(image != before))
        if changed > 0:
            self._noisy = self._noisy + 1 if changed > NOISY else 0
            return False
        repeated = self._noisy >= NOISY_PAIRS
        self.count += repeated
        return repeated

    def problems(self) -> list[str]:
        """Sentences on them."""
        if not self.count:
            return []
        return [
            f"{self.count} images equal the one before, and give no area: the camera, or its "
            "driver, repeated its images"
        ]


class ImageAreas:
    """Collects the areas of images; `add` one image message after the other, in order.

    pixels: of all images together; those behind them are not measured, and counted in `left_out`.
    Images that a camera repeats give no area.
    motion: follows the ridges, None: nobody does.
    """

    def __init__(
        self,
        sensor: AreaSensor,
        pixels: PixelBudget,
        motion: RidgeMotion | None = None,
    ) -> None:
        self._sensor = sensor
        self._motion = motion
        self._pixels = pixels
        self.left_out = 0
        self._repeats = Repeats()
        self._brightest = 0
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

    def measure(self, message: Any) -> ContactMeasurement:
        """Measure one image; raises InputError when it is no usable image."""
        if self._pixels.spent:
            self.left_out += 1
            raise InputError("more pixels than a bag of this size can hold; not measured")
        image = grey_image(message)
        self._pixels.take(image.size)
        if self._repeats.add(image):
            raise RepeatedImage("equal to the image before; not measured")
        if image.dtype == np.uint16:
            self._brightest = max(self._brightest, int(image.max()))
        return with_motion(measured(self._sensor, image, learn=True), image, self._motion)

    def add(self, item: BagMessage, stamp: int) -> None:
        """Measure one image and keep its area; raises InputError when it is no usable image."""
        try:
            found = self.measure(item.message)
        except RepeatedImage:
            return
        areas = found.gross_area, found.real_area, found.area_sd
        self._rows.append((stamp, item.log_time_ns, *areas, int(found.flags)))

    def problems(self) -> list[str]:
        """Sentences on what the images as a whole lack."""
        found = self._repeats.problems()
        if 0 < self._brightest < LEAST_BRIGHTEST:
            found.append(
                f"the images have 16 bits, but no pixel is brighter than {self._brightest}: a "
                "camera of 10 or 12 bits that fills the lower ones? Scale them to full scale; as "
                "they are, contacts are hardly seen"
            )
        return found

    def table(self) -> np.ndarray:
        """The areas (k,), of `finger_bag.streams.AREA`."""
        return np.array(self._rows, AREA)


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
