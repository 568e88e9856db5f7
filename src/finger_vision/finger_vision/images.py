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

import cv2
import numpy as np

from finger_common.errors import InputError
from finger_common.files import exists
from finger_common.image_files import decode_image
from finger_common.image_size import MAX_PIXELS
from finger_common.mono8 import as_mono8
from finger_common.plugins import Plugins

BAG_ENDINGS = (".mcap", ".db3", ".bag")

IMAGE_SOURCES = Plugins("finger_vision.image_source", "reader of images")
"""What reads files other than images; finger_offline brings the one named "bag"."""

MOSAICS = {
    f"bayer_{pattern}{bits}": code
    for bits in (8, 16)
    for pattern, code in (
        ("rggb", cv2.COLOR_BayerBG2BGR),
        ("bggr", cv2.COLOR_BayerRG2BGR),
        ("gbrg", cv2.COLOR_BayerGR2BGR),
        ("grbg", cv2.COLOR_BayerGB2BGR),
    )
}
"""Encoding of a colour mosaic -> OpenCV's conversion."""

LUMA = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}
"""Encoding of luma and chroma by turns -> place of the luma."""

PICTURES = {
    **dict.fromkeys(("mono8", "8UC1"), ("u1", 1)),
    **dict.fromkeys(("mono16", "16UC1"), ("u2", 1)),
    **dict.fromkeys(("bgr8", "rgb8", "8UC3"), ("u1", 3)),
    **dict.fromkeys(("bgra8", "rgba8", "8UC4"), ("u1", 4)),
    **dict.fromkeys(("bgr16", "rgb16", "16UC3"), ("u2", 3)),
    **dict.fromkeys(("bgra16", "rgba16", "16UC4"), ("u2", 4)),
    **dict.fromkeys(LUMA, ("u1", 2)),
    **{name: ("u2" if name.endswith("16") else "u1", 1) for name in MOSAICS},
}
"""Encoding of a picture -> type of a value, and number of values of a pixel."""

ENCODINGS = {**PICTURES, "32FC1": ("f4", 1)}
"""The same with those of other signals than pictures."""


def decode(
    data: bytes | bytearray | memoryview | np.ndarray,
    height: int,
    width: int,
    encoding: str,
    step: int,
    bigendian: bool = False,
    where: str = "image",
) -> np.ndarray:
    """(H, W) uint8, uint16 or float32, or (H, W, channels), from the fields of a sensor_msgs/Image.

    Values come as sent; no copy is made for mono8. Of luma and chroma the luma is given, and a
    mosaic becomes three channels. Raises InputError for a zero size, an unknown encoding or too few
    bytes.
    """
    if height <= 0 or width <= 0:
        raise InputError(f"{where}: image is {width}×{height}, a size above zero is needed")
    if height * width > MAX_PIXELS:
        raise InputError(f"{where}: image of {width}×{height} is too large; bin or crop it")
    if encoding not in ENCODINGS:
        raise InputError(
            f"{where}: encoding '{encoding[:40]}' is not supported; set the camera to mono8 "
            f"(known: {', '.join(PICTURES)})"
        )
    kind, channels = np.dtype(ENCODINGS[encoding][0]), ENCODINGS[encoding][1]
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
    if encoding in LUMA:
        return np.ascontiguousarray(rows[:, LUMA[encoding] :: 2])
    if kind.itemsize > 1:
        sent = np.ascontiguousarray(rows).view(kind.newbyteorder(">" if bigendian else "<"))
        rows = sent.astype(kind)
    if encoding in MOSAICS:
        if min(height, width) < 3:
            raise InputError(f"{where}: a colour mosaic of {width}×{height} is too small")
        return cv2.cvtColor(np.ascontiguousarray(rows), MOSAICS[encoding])
    if channels == 1:
        return rows
    return np.ascontiguousarray(rows).reshape(height, width, channels)


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
