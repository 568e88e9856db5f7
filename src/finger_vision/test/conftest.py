"""Bags of images."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from finger_bag.writer import BagWriter


@pytest.fixture
def write_image_bag() -> Callable[..., None]:
    """Function that writes mono8 pictures, `period` s apart, as /finger/image_raw of a bag."""

    def write(path: Path, pictures: Iterable[np.ndarray], period: float) -> None:
        with BagWriter(path, {"session": "images"}) as bag:
            for index, picture in enumerate(pictures):
                stamp = 100_000_000_000 + round(index * period * 1e9)
                bag.write(
                    "image_raw",
                    {
                        "header": {"stamp": stamp, "frame_id": "camera"},
                        "height": picture.shape[0],
                        "width": picture.shape[1],
                        "encoding": "mono8",
                        "step": picture.shape[1],
                        "data": picture.reshape(-1),
                    },
                )

    return write
