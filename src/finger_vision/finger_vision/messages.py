# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Plain data from and for messages, by attribute access alone, without a message package."""

from __future__ import annotations

from typing import Any

import numpy as np

from .area_sensor import ContactMeasurement
from .images import decode


def image_of(message: Any) -> np.ndarray:
    """(H, W) array from a sensor_msgs/Image, as `images.decode` gives it.

    Raises InputError with the reason when it cannot be used.
    """
    return decode(
        message.data,
        int(message.height),
        int(message.width),
        str(message.encoding),
        int(message.step),
        bool(message.is_bigendian),
        where="frame",
    )


def contact_area_fields(measurement: ContactMeasurement) -> dict[str, Any]:
    """Fields of a ContactArea but its header, as plain data.

    centroid: (x, y, z) tuple, m. hull: (n, 2) float32, m. flags: int. All others: float, SI.
    """
    x, y = measurement.centroid
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
    }
