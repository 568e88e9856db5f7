# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Pictures of any camera as 8-bit grey, or refused with the reason: one rule for all packages."""

from __future__ import annotations

import cv2
import numpy as np

from .errors import InputError
from .image_size import white_level

_UPPER_BITS, _LOW_BITS = 0xF000, 0x000F
"""Bits of which a picture in the lower 10 or 12 bits has none, and one in the upper 12, 10 or 8."""


LEAST_BRIGHTEST = 0x1000
"""Least value of a 16-bit picture that has used the upper bits."""

MORE_STRUCTURE, STRUCTURE_GREYS = 2.0, 0.5
"""Another channel of a colour camera sees the contact where it has seen so many times as much fine
structure, and so many greys more."""


class OneChannel:
    """Takes one channel of the pictures of a colour camera.

    A plate is lit in one colour: luminance would keep a tenth of what blue light shows, and the
    brightest value of each pixel would fill dark ridges with another light. It begins with the
    brightest channel. Where fine structure comes or goes, as ridges do, and another channel shows
    it better, that one is taken from then on; `channel` is its number.
    """

    def __init__(self) -> None:
        self.channel: int | None = None
        self._least = self._most = np.zeros(3)

    def __call__(self, pixels: np.ndarray) -> np.ndarray:
        """(H, W) of the next picture (H, W, 1), (H, W, 3) or (H, W, 4), alpha last."""
        if pixels.shape[2] == 1:
            return pixels[:, :, 0]
        structure = _structure(pixels)
        if self.channel is None:
            self.channel = int(np.argmax(cv2.mean(pixels)[:3]))
            self._least = self._most = seen = structure
        else:
            self._least = np.minimum(self._least, structure)
            self._most = np.maximum(self._most, structure)
            seen = self._most - self._least
        best = int(np.argmax(seen))
        if seen[best] > MORE_STRUCTURE * seen[self.channel] + STRUCTURE_GREYS:
            self.channel = best
        return np.ascontiguousarray(pixels[:, :, self.channel])


def _structure(pixels: np.ndarray) -> np.ndarray:
    """Fine structure (3,) of the channels of a picture: mean standard deviation within squares of
    16 pixels beyond that of the quietest ones, which is noise; in greys of 8 bits."""
    height, width = (max(1, side // 2) for side in pixels.shape[:2])
    half = cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)[:, :, :3]
    grey = half.astype(np.float32)
    if pixels.dtype == np.uint16:
        grey /= 256
    squares = max(1, width // 8), max(1, height // 8)
    mean = cv2.resize(grey, squares, interpolation=cv2.INTER_AREA)
    square = cv2.resize(grey * grey, squares, interpolation=cv2.INTER_AREA)
    deviation = np.sqrt(np.maximum(square - mean * mean, 0)).reshape(-1, 3)
    found: np.ndarray = deviation.mean(axis=0) - np.percentile(deviation, 10, axis=0)
    return found


class Mono8:
    """Converts the pictures of one camera.

    dark: whether they may be dark throughout, as of a dark plate. A 16-bit picture that is dark and
    uses the lowest bits is else refused, until a brighter one has come: cameras of 10 or 12 bits
    that fill the lower bits give such pictures, which would become black. `colour` takes the
    channel of a colour camera.
    """

    def __init__(self, dark: bool = False) -> None:
        self._full_scale = dark
        self.colour = OneChannel()

    def __call__(self, image: np.ndarray, where: str = "image") -> np.ndarray:
        """(H, W) uint8 of a grey or colour image of uint8 or uint16.

        image: (H, W), (H, W, 1), (H, W, 3) or (H, W, 4), alpha last. 16-bit images are scaled by
        1/256, so that full scale stays full scale. Raises InputError for an empty image, another
        shape or type, and for pixels in the lower bits.
        """
        image = np.asarray(image)
        if image.size == 0:
            shape = "×".join(map(str, image.shape))
            raise InputError(f"{where}: image is empty ({shape}); give pixels")
        if image.dtype not in (np.uint8, np.uint16):
            raise InputError(
                f"{where}: pixels are {image.dtype}, 8-bit or 16-bit unsigned are needed; convert "
                "them"
            )
        if image.ndim == 3 and image.shape[2] in (1, 3, 4):
            image = self.colour(image)
        if image.ndim != 2:
            shape = "×".join(map(str, image.shape))
            raise InputError(f"{where}: image has shape {shape}, (height, width) is needed")
        if image.dtype == np.uint8:
            return image
        if not self._full_scale:
            self._full_scale = self._fills_upper_bits(image, where)
        return (image >> 8).astype(np.uint8)

    def _fills_upper_bits(self, image: np.ndarray, where: str) -> bool:
        """Whether it is certain; raises InputError where it does not look so."""
        if in_low_bits(image):
            raise InputError(
                f"{where}: no value of the 16-bit pixels is above {int(image.max())} of 65535: 10- "
                "or 12-bit pixels in the lower bits, or no light; shift them to the upper bits, or "
                "set the camera to 8 bits"
            )
        return bool(image.any())


def in_low_bits(image: np.ndarray) -> bool:
    """Whether a 16-bit picture may be one of 10 or 12 bits that fill the lower ones: it is dark and
    uses the lowest bits."""
    used = int(np.bitwise_or.reduce(image, axis=None))
    return not used & _UPPER_BITS and bool(used & _LOW_BITS)


def as_mono8(image: np.ndarray, where: str = "image") -> np.ndarray:
    """(H, W) uint8 of one picture, as `Mono8` gives the first of a camera."""
    return Mono8()(image, where)


def in_full_range(image: np.ndarray, data: bytes | memoryview) -> np.ndarray:
    """A decoded image of unsigned integers, scaled to their range where its file (`data`) names the
    value of white, as PGM does.
    """
    white = white_level(data)
    if not white or image.dtype not in (np.uint8, np.uint16):
        return image
    full = int(np.iinfo(image.dtype).max)
    if white >= full:
        return image
    return (np.minimum(image, white).astype(np.uint32) * full // white).astype(image.dtype)
