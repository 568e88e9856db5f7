# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Size of an image from the header of its file, so that none is decoded that is a bomb.

A JPEG of 380 bytes can claim 900 million pixels, and a decoder allocates what it claims.
"""

from __future__ import annotations

import re
import struct

from .errors import InputError

FREE_PIXELS, PIXELS_PER_BYTE = 10 << 20, 4
"""Pixels that any file may claim, and further ones for each of its bytes.

A dark photograph has about 2 pixels a byte as JPEG and 1 as PNG.
"""

MAX_PIXELS = 200_000_000
"""Pixels above which no image is decoded."""

ALL_PIXELS, ALL_PIXELS_PER_BYTE = 500_000_000, 100
"""The same for all images of a bag, a folder or a command line together; the camera's have one to
four pixels a byte."""

VIDEO_PIXELS_PER_BYTE = 400
"""In place of it, for the frames of a video: a still scene takes little."""

MAX_SCANS = 100
"""Scans of a JPEG above which it is not decoded: each goes over the whole image again, and takes
20 bytes. Encoders write ten."""

PIXEL_BYTES = 8
"""Bytes of a TIFF file's pixel above which it is not decoded: 16-bit colour, or a float64."""

_WIDTH, _HEIGHT, _BITS, _SAMPLES, _TILE_WIDTH, _TILE_HEIGHT = 256, 257, 258, 277, 322, 323
_TIFF_TAGS = {_WIDTH, _HEIGHT, _BITS, _SAMPLES, _TILE_WIDTH, _TILE_HEIGHT}

_SPACE = rb"(?:\s|#[^\n]*\n)+"
_PNM_SIZE = _SPACE + rb"(\d{1,9})" + _SPACE + rb"(\d{1,9})"

_KINDS = "PNG, TIFF, JPEG, BMP or PGM"


def check_image(data: bytes | memoryview, where: str) -> None:
    """Raise InputError, naming `where`, for what is no image file or claims too many pixels."""
    data = memoryview(data).cast("B")
    if not len(data):
        raise InputError(f"{where}: file is empty; give an image")
    size = image_size(data)
    if size is None or min(size) <= 0:
        raise InputError(f"{where}: not an image that can be decoded; give {_KINDS}")
    check_claim(*size, len(data), where)
    if data[:2] == b"\xff\xd8" and bytes(data).count(b"\xff\xda") > MAX_SCANS:
        raise InputError(f"{where}: JPEG of more than {MAX_SCANS} scans; not decoded, save it anew")


class PixelBudget:
    """What may be decoded from files of `size` bytes together: a small file can hold a thousand
    large images.
    """

    def __init__(self, size: int = 0, per_byte: int = ALL_PIXELS_PER_BYTE) -> None:
        self._per_byte = per_byte
        self._left = ALL_PIXELS + per_byte * size

    def add(self, size: int) -> None:
        """Allow for a further file of so many bytes."""
        self._left += self._per_byte * size

    @property
    def spent(self) -> bool:
        """Whether nothing more may be decoded."""
        return self._left <= 0

    def take(self, pixels: int) -> None:
        """Count an image that was decoded."""
        self._left -= pixels


def check_claim(width: int, height: int, size: int, where: str) -> None:
    """Raise InputError for an image or a video's frames of more pixels than `size` bytes
    justify.
    """
    if width * height > min(FREE_PIXELS + PIXELS_PER_BYTE * size, MAX_PIXELS):
        raise InputError(
            f"{where}: {size} bytes claim {width} x {height} pixels; not decoded, "
            "give a smaller image"
        )


def image_size(data: memoryview) -> tuple[int, int] | None:
    """Width and height (px) that a PNG, JPEG, TIFF, BMP or PNM file claims; None for others."""
    begin = bytes(data[:1024])
    try:
        if begin.startswith(b"\x89PNG\r\n\x1a\n"):
            return struct.unpack_from(">II", begin, 16)
        if begin.startswith(b"\xff\xd8"):
            return _jpeg(data)
        if begin.startswith(b"BM"):
            short = struct.unpack_from("<I", begin, 14)[0] == 12
            width, height = struct.unpack_from("<HH" if short else "<ii", begin, 18)
            return abs(width), abs(height)
        if begin.startswith((b"II*\x00", b"MM\x00*")):
            return _tiff(data, "<" if begin.startswith(b"I") else ">")
    except (struct.error, IndexError):
        return None
    found = re.match(rb"P[1-6]" + _PNM_SIZE + rb"\s", begin)
    return (int(found[1]), int(found[2])) if found else None


def white_level(data: bytes | memoryview) -> int | None:
    """Value of white that the header of a PGM or PPM file gives; None for others."""
    found = re.match(rb"P[2356]" + _PNM_SIZE + _SPACE + rb"(\d{1,5})\s", bytes(data[:1024]))
    return int(found[3]) if found else None


def _jpeg(data: memoryview) -> tuple[int, int] | None:
    """From the first frame header (ITU-T T.81, B.2.2), segment by segment."""
    position = 2
    while True:
        while data[position] != 0xFF:
            position += 1
        while data[position] == 0xFF:
            position += 1
        marker = data[position]
        position += 1
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, position + 3)
            return width, height
        if marker != 0x01 and not 0xD0 <= marker <= 0xD8:
            position += struct.unpack_from(">H", data, position)[0]


def _tiff(data: memoryview, order: str) -> tuple[int, int] | None:
    """From the first directory (TIFF 6.0, section 2): short or long tags of width and height.

    A decoder takes memory for a whole tile, however small the image. None for pixels of more bytes
    than `PIXEL_BYTES`.
    """
    (place,) = struct.unpack_from(order + "I", data, 4)
    (entries,) = struct.unpack_from(order + "H", data, place)
    found: dict[int, int] = {}
    for entry in range(place + 2, place + 2 + 12 * entries, 12):
        tag, kind, count = struct.unpack_from(order + "HHI", data, entry)
        if tag in _TIFF_TAGS and kind in (3, 4):
            # The bits of three and more samples are elsewhere.
            at = entry + 8
            if count > (2 if kind == 3 else 1):
                (at,) = struct.unpack_from(order + "I", data, at)
            value = struct.unpack_from(order + ("H" if kind == 3 else "I"), data, at)[0]
            found[tag] = max(found.get(tag, 0), value)
    if _WIDTH not in found or _HEIGHT not in found:
        return None
    if found.get(_BITS, 1) * found.get(_SAMPLES, 1) > 8 * PIXEL_BYTES:
        return None
    width, height = found[_WIDTH], found[_HEIGHT]
    return max(width, found.get(_TILE_WIDTH, 0)), max(height, found.get(_TILE_HEIGHT, 0))
