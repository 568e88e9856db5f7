"""Images one at a time, from image files or from a bag."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from finger_common.plugins import Plugins

from .images import read_image

BAG_ENDINGS = (".mcap", ".db3", ".bag")

IMAGE_SOURCES = Plugins("finger_vision.image_source", "reader of images")
"""What reads files other than images; finger_offline brings the one named "bag"."""


def is_bag(path: Path) -> bool:
    """Whether a path is a bag (file or rosbag2 folder) rather than an image."""
    return path.suffix.lower() in BAG_ENDINGS or (path / "metadata.yaml").is_file()


def images_of(path: Path, topic: str, every: float) -> Iterator[tuple[str, np.ndarray]]:
    """Name and (H, W) uint8 of an image file, or of a bag's images on a topic.

    every: least time between two images of a bag by their stamps, s. Raises InputError naming the
    file.
    """
    if is_bag(path):
        yield from IMAGE_SOURCES.load("bag")(path, topic, every)
    else:
        yield str(path), read_image(path)
