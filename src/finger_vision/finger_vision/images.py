# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Images of a camera, a file, a bag or a message as arrays, or refused with the reason."""

from __future__ import annotations

import os
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from finger_common.errors import InputError
from finger_common.files import exists
from finger_common.image_files import decode_image
from finger_common.image_size import MAX_PIXELS
from finger_common.mono8 import as_mono8, brightest_channel
from finger_common.plugins import Plugins

BAG_ENDINGS = (".mcap", ".db3", ".bag")

IMAGE_SOURCES = Plugins("finger_vision.image_source", "reader of images")
"""What reads files other than images; finger_offline brings the one named "bag"."""

PLAIN = {
    "mono8": "u1",
    "8UC1": "u1",
    "mono16": "u2",
    "16UC1": "u2",
    "32FC1": "f4",
}
"""Encoding of one channel -> type of a value."""

COLOUR = {"bgr8": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4, "8UC3": 3, "8UC4": 4}
"""Encoding of several channels of 8 bit -> their number."""


def decode(
    data: bytes | bytearray | memoryview | np.ndarray,
    height: int,
    width: int,
    encoding: str,
    step: int,
    bigendian: bool = False,
    where: str = "image",
) -> np.ndarray:
    """(H, W) uint8, uint16 or float32 from the fields of a sensor_msgs/Image.

    One channel of 8 bit, 16 bit or 32-bit float comes as sent; no copy is made for 8 bit. Colour
    of 8 bit becomes grey. Raises InputError for a zero size, an unknown encoding or too few bytes.
    """
    if height <= 0 or width <= 0:
        raise InputError(f"{where}: image is {width}×{height}, a size above zero is needed")
    if height * width > MAX_PIXELS:
        raise InputError(f"{where}: image of {width}×{height} is too large; bin or crop it")
    if encoding in PLAIN:
        kind, channels = np.dtype(PLAIN[encoding]), 1
    elif encoding in COLOUR:
        kind, channels = np.dtype("u1"), COLOUR[encoding]
    else:
        known = ", ".join([*PLAIN, *COLOUR])
        raise InputError(
            f"{where}: encoding '{encoding}' is not supported; set the camera to mono8 "
            f"(known: {known})"
        )
    row = width * channels * kind.itemsize
    step = step or row
    raw = np.frombuffer(data, np.uint8) if not isinstance(data, np.ndarray) else data.view(np.uint8)
    if step < row or raw.size < step * (height - 1) + row:
        raise InputError(
            f"{where}: {raw.size} bytes with step {step} are too few for {width}×{height} "
            f"{encoding}; the sender fills the message wrongly"
        )
    rows = np.lib.stride_tricks.as_strided(
        raw.reshape(-1), (height, row), (step, 1), writeable=False
    )
    if kind.itemsize > 1:
        sent = np.ascontiguousarray(rows).view(kind.newbyteorder(">" if bigendian else "<"))
        return sent.astype(kind)
    if channels == 1:
        return rows
    pixels = np.ascontiguousarray(rows).reshape(height, width, channels)
    return brightest_channel(pixels)


def read_signal(path: str | Path) -> np.ndarray:
    """Array of an image file as stored: (H, W) or (H, W, channels), any depth. Of PGM, white is the
    largest value that its type holds.

    Raises InputError naming the file, also for one of several pages.
    """
    path = Path(path)
    if not exists(path):
        raise InputError(f"{path}: no such image; check the path")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name the images in it")
    try:
        content = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"{path}: image cannot be read ({error.strerror})") from None
    if _has_pages(content.tobytes()):
        raise InputError(
            f"{path}: has several pages, of which one alone would be read; save each page as an "
            "image of its own"
        )
    with silent_libraries():
        return decode_image(content, str(path))


def _has_pages(content: bytes) -> bool:
    """Whether a TIFF file holds a second image."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(content[:4])
    if order is None:
        return False
    try:
        (first,) = struct.unpack_from(order + "I", content, 4)
        (entries,) = struct.unpack_from(order + "H", content, first)
        (following,) = struct.unpack_from(order + "I", content, first + 2 + 12 * entries)
    except struct.error:
        return False
    return 0 < following < len(content)


@contextmanager
def silent_libraries() -> Iterator[None]:
    """Keep what libpng and others print themselves from standard error: the reader says it."""
    sys.stderr.flush()
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)


def read_image(path: str | Path) -> np.ndarray:
    """(H, W) uint8 from an image file; raises InputError naming the file."""
    return as_mono8(read_signal(path), str(path))


def images_of(path: Path, topic: str, every: float) -> Iterator[tuple[str, np.ndarray]]:
    """Name and (H, W) uint8 of an image file, or of a bag's images on a topic.

    every: least time between two images of a bag by their stamps, s. Raises InputError naming the
    file.
    """
    if path.suffix.lower() in BAG_ENDINGS or (path / "metadata.yaml").is_file():
        yield from IMAGE_SOURCES.load("bag")(path, topic, every)
    else:
        yield str(path), read_image(path)
