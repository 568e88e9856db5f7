# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Between plain data and messages, by attribute access: no message package is imported here."""

from __future__ import annotations

import array
from typing import Any

import numpy as np

from finger_common.stamps import fill_time

from .camera.info import CameraCalibration
from .moisture.source import Reading


def fill_header(header: Any, stamp_ns: int, frame_id: str) -> None:
    """Fill a std_msgs/Header."""
    fill_time(header.stamp, stamp_ns)
    header.frame_id = frame_id


def fill_image(message: Any, stamp_ns: int, frame_id: str, image: np.ndarray) -> Any:
    """Fill a sensor_msgs/Image, mono8, with an image (H, W) uint8; returns it."""
    fill_header(message.header, stamp_ns, frame_id)
    message.height, message.width = (int(n) for n in image.shape)
    message.encoding = "mono8"
    message.is_bigendian = 0
    message.step = message.width
    # rclpy copies an array whole; it would check bytes or a list element by element.
    data = array.array("B")
    data.frombytes(np.ascontiguousarray(image).tobytes())
    message.data = data
    return message


def fill_camera_info(
    message: Any, stamp_ns: int, frame_id: str, calibration: CameraCalibration, shape: Any
) -> Any:
    """Fill a sensor_msgs/CameraInfo for images of `shape` (H, W); returns it."""
    fill_header(message.header, stamp_ns, frame_id)
    message.height, message.width = (int(n) for n in shape)
    message.distortion_model = calibration.distortion_model
    message.d, message.k = list(calibration.d), list(calibration.k)
    message.r, message.p = list(calibration.r), list(calibration.p)
    return message


def calibration_of(message: Any, name: str) -> CameraCalibration:
    """Calibration in a sensor_msgs/CameraInfo."""
    return CameraCalibration(
        width=int(message.width),
        height=int(message.height),
        name=name,
        distortion_model=str(message.distortion_model),
        d=[float(v) for v in message.d],
        k=[float(v) for v in message.k],
        r=[float(v) for v in message.r],
        p=[float(v) for v in message.p],
    )


def fill_moisture(message: Any, reading: Reading, index: int, frame_id: str) -> Any:
    """Fill a finger_msgs/Moisture with a reading and its number; returns it."""
    fill_header(message.header, reading.stamp_ns, frame_id)
    message.value = float(reading.value)
    message.index = index
    message.phase = int(reading.phase)
    message.source = reading.source
    message.flags = int(reading.flags)
    return message
