# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Images of a camera, a file, a bag or a message as arrays, or refused with the reason."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from finger_common.errors import InputError
from finger_common.files import exists
from finger_common.image_size import MAX_PIXELS, check_image
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

COLOUR = {
    "bgr8": cv2.COLOR_BGR2GRAY,
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bgra8": cv2.COLOR_BGRA2GRAY,
    "rgba8": cv2.COLOR_RGBA2GRAY,
    "8UC3": cv2.COLOR_BGR2GRAY,
    "8UC4": cv2.COLOR_BGRA2GRAY,
}
"""Encoding of several channels of 8 bit -> OpenCV's conversion to grey."""


LEAST_OF_16_BITS = 4096
"""Brightest value below which a 16-bit image is no picture: 16 of 256 greys, and what 12 bits in
the lower bits can hold."""


def as_mono8(image: np.ndarray, where: str = "image") -> np.ndarray:
    """(H, W) uint8 of a grey or colour image of uint8 or uint16.

    image: (H, W), (H, W, 1), (H, W, 3) BGR or (H, W, 4) BGRA. 16-bit images are scaled by 1/256,
    so that full scale stays full scale. Raises InputError for an empty image, another shape or
    another type.
    """
    image = np.asarray(image)
    shape = "×".join(map(str, image.shape))
    if image.size == 0:
        raise InputError(f"{where}: image is empty ({shape}); give pixels")
    if image.dtype == np.uint16:
        if 0 < (brightest := int(image.max())) < LEAST_OF_16_BITS:
            raise InputError(
                f"{where}: no value of the 16-bit pixels is above {brightest} of 65535: 10- or "
                "12-bit pixels in the lower bits, or no light; shift them to the upper bits, or "
                "set the camera to 8 bits"
            )
        image = (image >> 8).astype(np.uint8)
    elif image.dtype != np.uint8:
        raise InputError(
            f"{where}: pixels are {image.dtype}, 8-bit or 16-bit unsigned are needed; convert them"
        )
    if image.ndim == 3:
        channels = image.shape[2]
        if channels == 1:
            image = image[:, :, 0]
        elif channels == 3:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        elif channels == 4:
            image = cv2.cvtColor(image, cv2.COLOR_BGRA2GRAY)
    if image.ndim != 2:
        raise InputError(f"{where}: image has shape {shape}, (height, width) is needed")
    return image


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
        kind, channels = np.dtype("u1"), 4 if encoding.endswith(("a8", "C4")) else 3
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
    return cv2.cvtColor(pixels, COLOUR[encoding])


def read_signal(path: str | Path) -> np.ndarray:
    """Array of an image file as stored: (H, W) or (H, W, channels), any depth.

    Raises InputError naming the file.
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
    check_image(content.data, str(path))
    try:
        with silent_libraries():
            image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise InputError(f"{path}: not an image that can be decoded; give PNG, TIFF, JPEG or BMP")
    return image


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
