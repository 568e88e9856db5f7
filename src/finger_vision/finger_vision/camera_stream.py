# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Images of one camera, one after the other, through an area sensor: the same live and offline."""

from __future__ import annotations

import numpy as np

from finger_common.errors import InputError
from finger_common.mono8 import LEAST_BRIGHTEST, OneChannel
from finger_common.stamps import NANOSECONDS

from .area_sensor import AreaSensor, ContactMeasurement, measured
from .ridge_motion import RidgeMotion, with_motion

SET_BACK = NANOSECONDS
"""ns by which a stamp lies before the newest where the clock was set back, or a recording begins
again; a smaller step is an image out of order."""

NOISY, NOISY_PAIRS = 0.2, 3
"""Share of the pixels that differ from image to image of a camera, by its noise, so many times in a
row; a drawn image of a scene that moves differs in fewer."""


class LeftOut(InputError):
    """An image that gives no area, since it was given once more, or out of order; it is counted."""


class StampOrder:
    """Tells images whose stamps are not after those before. `dropped` counts them, `unstamped`
    those of stamp zero, which are taken."""

    def __init__(self) -> None:
        self.dropped = self.unstamped = 0
        self._newest: int | None = None

    def check(self, stamp_ns: int) -> None:
        """Take the stamp of the next image; raises LeftOut where it is the newest one once more, or
        before it by SET_BACK at most."""
        if stamp_ns == 0:
            self.unstamped += 1
            return
        if self._newest is not None and 0 <= self._newest - stamp_ns <= SET_BACK:
            self.dropped += 1
            raise LeftOut("its stamp is not after that of an image before; not measured")
        self._newest = stamp_ns

    def problems(self) -> list[str]:
        """Sentences on them."""
        found = []
        if self.dropped:
            found.append(
                f"{self.dropped} images have stamps that are not after those before, and give no "
                "area: does the camera's driver, or do two drivers, stamp them wrongly?"
            )
        if self.unstamped:
            found.append(
                f"{self.unstamped} images have no stamp (zero), and their areas fit no force; let "
                "the camera's driver stamp them"
            )
        return found


class Repeats:
    """Tells images that a camera, or its driver, gave once more, in place of a new one: its noise
    makes two equal ones all but impossible. `count` counts them, `in_a_row` the newest ones."""

    def __init__(self) -> None:
        self.count = self.in_a_row = 0
        self._before: np.ndarray | None = None
        self._noisy = 0

    def add(self, image: np.ndarray) -> bool:
        """Whether the next image (H, W) or (H, W, channels) is the one before once more."""
        before, self._before = self._before, image
        if before is not None and before.shape == image.shape:
            changed = np.count_nonzero(image != before) / image.size
            if changed == 0 and self._noisy >= NOISY_PAIRS:
                self.count += 1
                self.in_a_row += 1
                return True
            if changed > 0:
                self._noisy = self._noisy + 1 if changed > NOISY else 0
        self.in_a_row = 0
        return False

    def problems(self) -> list[str]:
        """Sentences on them."""
        if not self.count:
            return []
        return [
            f"{self.count} images equal the one before, and give no area: the camera, or its "
            "driver, repeated its images"
        ]


class CameraStream:
    """Measures the images of one camera with an area sensor.

    motion: follows the ridges, None: nobody does. dark_images: number of 16-bit images that used
    the lower bits alone, 0 once one has used the upper ones; `brightest` is their highest value.
    """

    def __init__(self, sensor: AreaSensor, motion: RidgeMotion | None = None) -> None:
        self.sensor = sensor
        self.order, self.repeats = StampOrder(), Repeats()
        self.dark_images = self.brightest = 0
        self._motion = motion
        self._colour = OneChannel()

    def signal(self, image: np.ndarray) -> np.ndarray:
        """Signal (H, W) for the sensor from the next image (H, W) or (H, W, channels).

        Raises LeftOut for one that is the one before once more. Where a colour camera has shown
        that another channel sees the contact, the background is forgotten.
        """
        if self.repeats.add(image):
            raise LeftOut("equal to the image before; not measured")
        self._see_bits(image)
        if image.ndim == 2:
            return image
        before = self._colour.channel
        signal = self._colour(image)
        if before not in (None, self._colour.channel):
            self._forget()
        return signal

    def measure(self, signal: np.ndarray, learn: bool = True) -> ContactMeasurement:
        """The contact in a signal, as `area_sensor.measured` gives it, and the skin's motion."""
        return with_motion(measured(self.sensor, signal, learn), signal, self._motion)

    def reset(self) -> None:
        """Forget the background, the skin that is followed and the channel of a colour camera."""
        self._colour = OneChannel()
        self._forget()

    def problems(self) -> list[str]:
        """Sentences on what the images as a whole lack."""
        found = self.order.problems() + self.repeats.problems()
        if self.dark_images:
            found.append(
                f"the images have 16 bits, but no pixel is brighter than {self.brightest}: a "
                "camera of 10 or 12 bits that fills the lower ones? Scale them to full scale; as "
                "they are, contacts are hardly seen"
            )
        return found

    def _forget(self) -> None:
        self.sensor.reset()
        if self._motion is not None:
            self._motion.reset()

    def _see_bits(self, image: np.ndarray) -> None:
        if image.dtype != np.uint16 or self.brightest >= LEAST_BRIGHTEST:
            return
        brightest = int(image.max())
        self.brightest = max(self.brightest, brightest)
        dark = self.brightest < LEAST_BRIGHTEST
        self.dark_images = self.dark_images + (brightest > 0) if dark else 0
