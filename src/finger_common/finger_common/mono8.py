# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Pictures of any camera as 8-bit grey, or refused with the reason: one rule for all packages."""

from __future__ import annotations

import numpy as np

from .errors import InputError
from .image_size import white_level

_UPPER_BITS, _LOW_BITS = 0xF000, 0x000F
"""Bits of which a picture in the lower 10 or 12 bits has none, and one in the upper 12, 10 or 8."""


class Mono8:
    """Converts the pictures of one camera.

    dark: whether they may be dark throughout, as of a dark plate. A 16-bit picture that is dark and
    uses the lowest bits is else refused, until a brighter one has come: cameras of 10 or 12 bits
    that fill the lower bits give such pictures, which would become black.
    """

    def __init__(self, dark: bool = False) -> None:
        self._full_scale = dark

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
            image = brightest_channel(image)
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


def brightest_channel(pixels: np.ndarray) -> np.ndarray:
    """Grey (H, W) of pixels (H, W, 1), (H, W, 3) or (H, W, 4), the last of four being alpha.

    A plate is lit in one colour: luminance would keep a tenth of what blue light shows.
    """
    grey = pixels[:, :, 0]
    for channel in range(1, min(pixels.shape[2], 3)):
        grey = np.maximum(grey, pixels[:, :, channel])
    return grey


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
