"""Bags of images, written by the mcap library."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

IMAGE_SCHEMA = """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


@pytest.fixture
def write_image_bag() -> Callable[..., None]:
    """Function that writes mono8 pictures, `period` s apart, as /finger/image_raw into an MCAP file."""
    from mcap_ros2.writer import Writer

    def write(path: Path, pictures: Iterable[np.ndarray], period: float) -> None:
        with path.open("wb") as file, Writer(file) as writer:
            schema = writer.register_msgdef("sensor_msgs/msg/Image", IMAGE_SCHEMA)
            for i, picture in enumerate(pictures):
                since = round(i * period * 1e9)
                stamp = {"sec": 100 + since // 10**9, "nanosec": since % 10**9}
                writer.write_message(
                    topic="/finger/image_raw",
                    schema=schema,
                    message={
                        "header": {"stamp": stamp, "frame_id": "camera"},
                        "height": picture.shape[0],
                        "width": picture.shape[1],
                        "encoding": "mono8",
                        "is_bigendian": 0,
                        "step": picture.shape[1],
                        "data": picture.tobytes(),
                    },
                    log_time=since,
                    publish_time=since,
                )

    return write
