"""Images from files and from bags, one at a time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError

from .images import read_image
from .messages import image_of, stamp_ns_of

BAG_ENDINGS = (".mcap", ".db3", ".bag")


def is_bag(path: Path) -> bool:
    """Whether a path is an MCAP file or a rosbag2 folder rather than an image."""
    return path.suffix.lower() in BAG_ENDINGS or (path / "metadata.yaml").is_file()


def images_of(path: Path, topic: str, every: float) -> Iterator[tuple[str, np.ndarray]]:
    """Name and (H, W) uint8 of an image file, or of a bag's images at least `every` seconds apart by stamp.

    topic: of the images; a name that ends so counts too ("/finger/image_raw" for "image_raw"). Reads lazily.
    Raises InputError naming the file.
    """
    if not is_bag(path):
        yield str(path), read_image(path)
        return
    found = False
    last: int | None = None
    for message in _messages(path, topic):
        found = True
        stamp = stamp_ns_of(message)
        if last is not None and 0 <= stamp - last < every * 1e9:
            continue
        last = stamp
        yield f"{path} at {stamp / 1e9:.3f} s", image_of(message)
    if not found:
        raise InputError(f"{path}: holds no images on '{topic}'; name their topic with --topic")


def _fits(name: str, topic: str) -> bool:
    return name == topic or name.endswith("/" + topic.lstrip("/"))


def _messages(path: Path, topic: str) -> Iterator[Any]:
    if not path.exists():
        raise InputError(f"{path}: no such bag; check the path")
    reader = _mcap_messages if path.suffix.lower() == ".mcap" else _rosbag_messages
    try:
        yield from reader(path, topic)
    except InputError:
        raise
    except Exception as error:  # Readers raise many kinds for a damaged file.
        raise InputError(
            f"{path}: bag cannot be read ({type(error).__name__}: {error}); try finger-bag recover"
        ) from None


def _mcap_messages(path: Path, topic: str) -> Iterator[Any]:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        topics = None
        if summary is not None:
            topics = [c.topic for c in summary.channels.values() if _fits(c.topic, topic)]
            if not topics:
                return
        for _, channel, _, message in reader.iter_decoded_messages(topics=topics):
            if _fits(channel.topic, topic):
                yield message


def _rosbag_messages(path: Path, topic: str) -> Iterator[Any]:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if _fits(c.topic, topic)]
        if connections:
            for connection, _, raw in reader.messages(connections=connections):
                yield reader.deserialize(raw, connection.msgtype)
