"""Whatever a camera, a file or a message gives becomes an 8-bit grey image, or is refused with the reason."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from finger_common.errors import InputError

MAX_PIXELS = 200_000_000
MONO8 = ("mono8", "8UC1")
MONO16 = ("mono16", "16UC1")
COLOUR = {
    "bgr8": cv2.COLOR_BGR2GRAY,
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bgra8": cv2.COLOR_BGRA2GRAY,
    "rgba8": cv2.COLOR_RGBA2GRAY,
    "8UC3": cv2.COLOR_BGR2GRAY,
    "8UC4": cv2.COLOR_BGRA2GRAY,
}


def as_mono8(image: np.ndarray, where: str = "image") -> np.ndarray:
    """(H, W) uint8 from (H, W), (H, W, 1), (H, W, 3) BGR or (H, W, 4) BGRA of uint8 or uint16.

    16-bit frames are scaled by 1/256, so that full scale stays full scale. Raises InputError for an empty image,
    another shape or another type.
    """
    image = np.asarray(image)
    if image.size == 0:
        raise InputError(
            f"{where}: image is empty ({'×'.join(map(str, image.shape))}); give pixels"
        )
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    elif image.dtype == bool:
        image = image.astype(np.uint8) * 255
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
        raise InputError(
            f"{where}: image has shape {'×'.join(map(str, image.shape))}, (height, width) is needed"
        )
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
    """(H, W) uint8 from the fields of a sensor_msgs/Image; mono, RGB(A) and BGR(A) of 8 or 16 bit.

    No copy is made for mono8. Raises InputError for a zero size, an unknown encoding or too few bytes.
    """
    if height <= 0 or width <= 0:
        raise InputError(f"{where}: image is {width}×{height}, a size above zero is needed")
    if height * width > MAX_PIXELS:
        raise InputError(f"{where}: image of {width}×{height} is too large; bin or crop it")
    if encoding in MONO8:
        channels, wide = 1, False
    elif encoding in MONO16:
        channels, wide = 1, True
    elif encoding in COLOUR:
        channels, wide = (4 if encoding.endswith(("a8", "C4")) else 3), False
    else:
        known = ", ".join([*MONO8, *MONO16, *COLOUR])
        raise InputError(
            f"{where}: encoding '{encoding}' is not supported; set the camera to mono8 (known: {known})"
        )
    row = width * channels * (2 if wide else 1)
    step = step or row
    raw = np.frombuffer(data, np.uint8) if not isinstance(data, np.ndarray) else data.view(np.uint8)
    if step < row or raw.size < step * (height - 1) + row:
        raise InputError(
            f"{where}: {raw.size} bytes with step {step} are too few for {width}×{height} {encoding}; "
            "the sender fills the message wrongly"
        )
    rows = np.lib.stride_tricks.as_strided(
        raw.reshape(-1), (height, row), (step, 1), writeable=False
    )
    if wide:
        order = ">u2" if bigendian else "<u2"
        return (np.ascontiguousarray(rows).view(order) >> 8).astype(np.uint8)
    if channels == 1:
        return rows
    pixels = np.ascontiguousarray(rows).reshape(height, width, channels)
    return cv2.cvtColor(pixels, COLOUR[encoding])


def read_image(path: str | Path) -> np.ndarray:
    """(H, W) uint8 from an image file; raises InputError naming the file."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such image; check the path")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name the images in it")
    try:
        content = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"{path}: image cannot be read ({error.strerror})") from None
    if content.size == 0:
        raise InputError(f"{path}: file is empty; give an image")
    try:
        image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise InputError(f"{path}: not an image that can be decoded; give PNG, TIFF, JPEG or BMP")
    return as_mono8(image, str(path))
