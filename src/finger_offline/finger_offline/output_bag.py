# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The bag that `finger-bag process` writes: the input's messages, new areas and estimates."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import TracebackType

from finger_bag.copying import announce, copy_attachments
from finger_bag.reader import BagMessage, BagReader
from finger_bag.schema import IMAGE_TOPICS, PARAMETERS_ATTACHMENT, TOPICS, spec_of
from finger_bag.writer import BagWriter, MessageRefused
from finger_common.errors import InputError
from finger_common.files import read_bytes
from finger_model.estimator import EstimatorEvent
from finger_model.messages import PLATE, event_fields
from finger_vision.area_sensor import ContactMeasurement

from .image_areas import area_fields
from .input_topics import InputTopics
from .process_options import ProcessOptions

IMAGE_TYPES = {TOPICS[name].type for name in ("image_raw", "image_raw/compressed")}


class OutputBag:
    """Writes the new bag; a context manager that leaves nothing behind after an error."""

    def __init__(
        self,
        path: str | Path,
        reader: BagReader,
        topics: InputTopics,
        options: ProcessOptions,
        model_hash: str,
    ) -> None:
        known = reader.info.metadata.to_mapping()
        known.pop("software_version", None)
        metadata = {
            **known,
            "processed_from": reader.path.name,
            "reduced_model_hash": model_hash,
            "areas_from": "contact_area" if topics.image is None else "images",
        }
        self._reader, self._options = reader, options
        self._topics = topics
        self._skipped = set(topics.replaced)
        self._announced: set[tuple[str, str]] = set()
        self.left_out: dict[tuple[str, str], str] = {}
        """Why topics of the input, by name and type, could not be copied."""
        self._writer = BagWriter(path, metadata)

    def __enter__(self) -> OutputBag:
        writer = self._writer.__enter__()
        copy_attachments(self._reader, writer)
        if self._options.parameter_file:
            data = read_bytes(self._options.parameter_file, "parameter file")
            writer.attach(PARAMETERS_ATTACHMENT, data)
        options = self._options
        made = {"contact_state": True, "contact_slip": options.slip, "contact_shape": options.shape}
        for name in (name for name, wanted in made.items() if wanted):
            writer.add_topic(self._topics.result(name))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._writer.__exit__(kind, error, traceback)

    def finish(self) -> None:
        """Write all but the bag's name, which it gets when the `with` ends without an error."""
        self._writer.finish()

    def copy(self, item: BagMessage) -> None:
        """Copy a message of the input, unless its topic is replaced or shows the print."""
        key = (item.topic, item.type)
        if item.topic in self._skipped or key in self.left_out:
            return
        if key not in self._announced:
            if not self._options.keep_images and _is_image(item):
                self._skipped.add(item.topic)
                return
            try:
                announce(self._writer, self._reader.topic_info(*key))
            except InputError as error:
                self.left_out[key] = str(error)
                return
            self._announced.add(key)
        try:
            self._writer.copy(item)
        except MessageRefused as error:
            self.left_out[key] = str(error)

    def write_area(self, measured: ContactMeasurement, stamp: int, log_ns: int) -> None:
        """Write an area measured in an image."""
        topic = self._topics.result("contact_area")
        self._writer.write(topic, area_fields(stamp, measured, PLATE), log_ns)

    def write_event(self, event: EstimatorEvent, log_ns: int, sequence: int = 0) -> None:
        """Write an event of the estimator."""
        topic = self._topics.result("model_events")
        self._writer.write(topic, event_fields(event, sequence), log_ns)

    def write(self, name: str, messages: Iterable[tuple[int, bytes]]) -> None:
        """Write estimates, serialized, to the results' topic of this name; each with its log time
        (ns)."""
        topic = self._topics.result(name)
        for log_ns, message in messages:
            self._writer.write_raw(topic, message, log_ns)


def _is_image(item: BagMessage) -> bool:
    spec = spec_of(item.topic)
    return item.type in IMAGE_TYPES or (spec is not None and spec.name in IMAGE_TOPICS)
