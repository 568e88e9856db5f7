# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Plain data from and for messages, by attribute access alone, without a message package."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from finger_common.errors import InputError
from finger_common.image_files import decode_image

from .area_sensor import ContactMeasurement
from .images import MOSAICS, decode


def image_of(message: Any) -> np.ndarray:
    """(H, W) or (H, W, channels) array from a sensor_msgs Image, as `images.decode` gives it, or
    from a CompressedImage, whatever maker's `format` it has.

    Raises InputError with the reason when it cannot be used.
    """
    if hasattr(message, "format"):
        return _uncompressed(str(message.format), bytes(message.data))
    return decode(
        message.data,
        int(message.height),
        int(message.width),
        str(message.encoding),
        int(message.step),
        bool(message.is_bigendian),
        where="frame",
    )


def _uncompressed(form: str, data: bytes) -> np.ndarray:
    where = f"compressed image ('{form[:40]}')"
    if "compressedDepth" in form:
        raise InputError(f"{where}: distances, no picture of the plate; name another topic")
    image = decode_image(data, where, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    sent, _, how = (part.strip() for part in form.partition(";"))
    if sent in MOSAICS and image.ndim == 2 and "bgr" not in how and "mono" not in how:
        return cv2.cvtColor(image, MOSAICS[sent])  # image_transport compresses a mosaic as it is
    return image


def contact_area_fields(measurement: ContactMeasurement) -> dict[str, Any]:
    """Fields of a ContactArea but its header, as plain data.

    centroid, slip: (x, y, z) tuples, m. hull: (n, 2) float32, m. flags: int. All others: float, SI.
    """
    x, y = measurement.centroid
    motion = measurement.motion
    return {
        "gross_area": float(measurement.gross_area),
        "real_area": float(measurement.real_area),
        "area_stddev": float(measurement.area_sd),
        "centroid": (float(x), float(y), 0.0),
        "ellipse_major": float(measurement.ellipse_major),
        "ellipse_minor": float(measurement.ellipse_minor),
        "ellipse_angle": float(measurement.ellipse_angle),
        "hull": np.asarray(measurement.hull, np.float32).reshape(-1, 2),
        "flags": int(measurement.flags),
        "centroid_stddev": float(measurement.centroid_sd),
        "ellipse_major_stddev": float(measurement.ellipse_major_sd),
        "ellipse_minor_stddev": float(measurement.ellipse_minor_sd),
        "ellipse_angle_stddev": float(measurement.ellipse_angle_sd),
        "stick_ratio": float(motion.stick_ratio),
        "stick_ratio_stddev": float(motion.stick_ratio_sd),
        "slip": (*map(float, motion.slip), 0.0),
        "rotation": float(motion.rotation),
    }
