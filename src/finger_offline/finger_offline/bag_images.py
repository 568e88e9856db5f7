# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Images of a bag one at a time, for `finger-vision calibrate`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from finger_bag.reader import open_bag
from finger_common.errors import InputError
from finger_common.image_size import PixelBudget
from finger_common.mono8 import as_mono8
from finger_common.stamps import header_stamp, seconds
from finger_vision.messages import image_of


def images_of_bag(path: Path, topic: str, every: float) -> Iterator[tuple[str, np.ndarray]]:
    """Name and (H, W) uint8 of a bag's images on a topic, at least `every` s apart by stamp.

    topic: relative names are those of the rig ("image_raw" for "/finger/image_raw"). Raises
    InputError naming the bag where it cannot be read or holds no such images.
    """
    last: int | None = None
    with open_bag(path) as reader:
        pixels = PixelBudget(reader.info.size)
        found = reader.topic(topic)
        for item in reader.messages([found] if found is not None else []):
            stamp = header_stamp(item.message)
            if last is not None and 0 <= seconds(stamp - last) < every:
                continue
            last = stamp
            if pixels.spent:
                raise InputError(f"{path}: more pixels than its bytes can hold; give --every")
            image = as_mono8(image_of(item.message))
            pixels.take(image.size)
            yield f"{path} at {seconds(stamp):.3f} s", image
        if reader.lost:
            raise InputError(
                f"{path}: not all of the bag could be read; give what 'finger-bag recover' writes"
            )
    if last is None:
        raise InputError(f"{path}: holds no images on '{topic}'; name their topic with --topic")
