# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recording core: a queue, a thread that writes, and the accounts of what was lost. No ROS.

Messages are put in as they came from the middleware, serialized; the thread writes them and hands
the file to the operating system at least every `flush_interval`, so that a recorder killed at any
moment loses no more than what arrived since. When the disk is nearly full, the recording is closed
cleanly; it can be resumed when there is room again.
"""

from __future__ import annotations

import os
import queue
import shutil
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from finger_common.errors import FingerError, InputError
from finger_common.settings import Settings, setting
from finger_common.stamps import header_stamp

from .definitions import decoder, encode
from .schema import TOPICS, SessionMetadata
from .writer import BagWriter, check_name_length

IMAGE_TYPE = TOPICS["image_raw"].type
COMPRESSED_TYPE = TOPICS["image_raw/compressed"].type
SMALLEST_FILE = 1_000_000
"""Bytes; smaller files hold little beside the definitions of their messages."""
PNG_FORMAT = "mono8; png compressed "  # as image_transport writes it


class Serialized(NamedTuple):
    """One message as it came. sequence: of its publisher, 0 where unknown."""

    topic: str
    type: str
    cdr: bytes
    log_time_ns: int
    publish_time_ns: int
    sequence: int = 0


@dataclass(frozen=True)
class RecorderSettings(Settings):
    """How a bag is written."""

    png: bool = setting(
        False, "Store images as lossless PNG under 'image_raw/compressed' (smaller, slower)."
    )
    compression: str = setting("zstd", "Compression of chunks.", choices=("zstd", "lz4", "none"))
    flush_interval: float = setting(
        0.4,
        "Longest time that a message stays in the recorder. A recorder that is killed loses at "
        "most this time.",
        unit="s",
        minimum=0.05,
        maximum=1.0,
    )
    maximum_size: int = setting(
        0,
        "Size of messages after which the next file of the bag is begun, 1 MB at least; 0 for "
        "never.",
        unit="B",
        minimum=0,
    )
    maximum_duration: float = setting(
        0.0, "Time after which the next file of the bag is begun; 0 for never.", "s", minimum=0.0
    )
    minimum_free: int = setting(
        256 << 20, "Free disk space at which recording stops.", unit="B", minimum=0
    )
    queue_limit: int = setting(
        512 << 20,
        "Size of the messages that may wait for the disk. Beyond it, messages are dropped and "
        "counted.",
        unit="B",
        minimum=1 << 20,
    )

    def validate(self) -> None:
        if 0 < self.maximum_size < SMALLEST_FILE:
            raise InputError(
                f"parameter 'maximum_size' is {self.maximum_size} B; give {SMALLEST_FILE} B (1 MB) "
                "or more, or 0 for one file"
            )


@dataclass
class RecordingResult:
    """The first bag, messages recorded and lost by topic, why it was interrupted ("" if not)."""

    path: Path
    counts: dict[str, int] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    error: str = ""

    @property
    def message_count(self) -> int:
        """Messages recorded, of all topics."""
        return sum(self.counts.values())

    @property
    def lost_count(self) -> int:
        """Messages lost, of all topics."""
        return sum(self.lost.values())


@dataclass
class _Safe:
    """What is safe in a bag since its last flush: files, length, messages by topic.

    counts: by stored topic. taken: by topic as it came.
    """

    files: int = 0
    length: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    taken: Counter[str] = field(default_factory=Counter)


@dataclass
class _Content:
    """What a bag begins with, as `Recorder.start` takes it."""

    metadata: SessionMetadata | Mapping[str, Any] | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    definitions: Mapping[str, str] = field(default_factory=dict)


class Recorder:
    """Records one bag after the other; thread-safe.

    A recording that ends by itself, as the disk is full or its folder is gone, is *interrupted*:
    messages are counted as lost until `resume` continues it in a further bag, `NAME_part2`, or
    `stop` ends it. on_error is called, in the writing thread, with one sentence when that happens.
    """

    def __init__(
        self,
        settings: RecorderSettings | None = None,
        on_error: Callable[[str], None] | None = None,
    ) -> None:
        self.settings = settings or RecorderSettings()
        self._on_error = on_error or (lambda text: None)
        self._queue: queue.SimpleQueue[Serialized | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._waiting = 0
        self._writer: BagWriter | None = None
        self._thread: threading.Thread | None = None
        self._lost: Counter[str] = Counter()
        self._before: Counter[str] = Counter()
        self._safe_counts: dict[str, int] | None = None
        self._content = _Content()
        self._errors: list[str] = []
        self._interrupted = ""
        self._device = 0
        """Disk of the recording that runs, or ran last."""
        self.parts: list[Path] = []
        """Bags of the recording that runs, or ran last."""
        self.last_flush = 0.0

    @property
    def started(self) -> bool:
        """Whether a recording was started and not stopped, also an interrupted one."""
        return self._thread is not None

    @property
    def recording(self) -> bool:
        """Whether messages are being taken."""
        return self.started and not self._interrupted

    @property
    def interrupted(self) -> str:
        """Why the recording ended by itself; "" when it did not, or was resumed."""
        return self._interrupted if self.started else ""

    @property
    def path(self) -> Path | None:
        """Bag being written."""
        return self._writer.path if self._writer is not None else None

    @property
    def waiting(self) -> int:
        """Bytes that wait to be written."""
        return self._waiting

    def start(
        self,
        path: str | Path,
        metadata: SessionMetadata | Mapping[str, Any] | None = None,
        topics: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        definitions: Mapping[str, str] | None = None,
        further: bool = False,
    ) -> Path:
        """Begin a bag. topics: absolute name → type. definitions: type → text, of types that this
        package does not know. further: in a further file of the bag that is there (`BagWriter`).

        Raises InputError when a recording runs already or `path` cannot be used.
        """
        if self._thread is not None:
            raise InputError(f"recording into {self.path} runs already; stop it first")
        self._content = _Content(metadata, topics or {}, attachments or {}, definitions or {})
        if not further:
            check_name_length(Path(path), "_part999")
        writer = self._open(Path(path), self.settings.minimum_free, further)
        self._lost, self._before, self._errors, self.parts = Counter(), Counter(), [], []
        self._device = writer.path.parent.stat().st_dev
        self._begin(writer)
        return writer.path

    def resume(self) -> Path:
        """Continue an interrupted recording in a further bag beside the first.

        Raises InputError when that is not possible yet, as while its folder is not there, or
        nothing was interrupted.
        """
        if not self.interrupted:
            raise InputError("no recording was interrupted")
        first = self.parts[0]
        number = len(self.parts) + 1
        try:
            self._check_folder(first)
            while (path := first.with_name(f"{first.name}_part{number}")).exists():
                number += 1
            # A little more room than that at which it ends again.
            writer = self._open(path, self.settings.minimum_free * 5 // 4)
        except OSError as error:  # such as of a disk that was pulled out
            raise InputError(f"{first}: cannot be reached ({error.strerror})") from None
        assert self._thread is not None
        self._thread.join()
        self._before.update(self._part_counts())
        self._begin(writer)
        return path

    def _check_folder(self, first: Path) -> None:
        """Refuse to make the folder of a recording anew: where its disk is not connected, that
        would be on another one."""
        try:
            device: int | None = first.parent.stat().st_dev
        except (FileNotFoundError, NotADirectoryError):
            device = None
        # A disk that is connected again may have another number.
        if device != self._device and not first.exists():
            self._interrupted = f"{first.parent}: the folder is gone; is its disk connected?"
            raise InputError(self._interrupted)

    def _open(self, path: Path, needed: int, further: bool = False) -> BagWriter:
        settings, content = self.settings, self._content
        try:
            parent = next(p for p in (path.absolute(), *path.absolute().parents) if p.exists())
            free = shutil.disk_usage(parent).free
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"{path}: cannot be used ({reason}); choose another name") from None
        if free < needed:
            raise InputError(
                f"{path}: {free >> 20} MiB are free, recording needs {needed >> 20}; make room or "
                "choose another disk"
            )
        existed = path.exists()
        writer = BagWriter(
            path,
            content.metadata,
            in_place=True,
            further=further,
            maximum_size=settings.maximum_size,
            maximum_duration=settings.maximum_duration,
            compression=settings.compression,
        )
        try:
            for name, data in content.attachments.items():
                writer.attach(name, data)
            for topic, message_type in content.topics.items():
                name, stored = self._stored(topic, message_type)
                writer.add_topic(name, stored, definition=content.definitions.get(stored))
            writer.flush()
        except (FingerError, OSError) as error:
            with suppress(OSError):
                writer.abandon()
            if not existed:
                shutil.rmtree(path, ignore_errors=True)
            if isinstance(error, FingerError):
                raise
            raise InputError(f"{path}: cannot be written ({error.strerror}); make room") from None
        return writer

    def _begin(self, writer: BagWriter) -> None:
        self._writer = writer
        self._safe_counts = None
        self.parts.append(writer.path)
        with self._lock:
            self._interrupted = ""
            self._queue = queue.SimpleQueue()
            self._waiting = 0
        self._thread = threading.Thread(
            target=self._run, args=(writer,), name="bag writer", daemon=True
        )
        self._thread.start()

    def put(self, message: Serialized) -> bool:
        """Hand over a message; false when it is not recorded or lost, as the queue is full."""
        if self._thread is None:
            return False
        with self._lock:
            if self._interrupted or self._waiting > self.settings.queue_limit:
                self._lost[message.topic] += 1
                return False
            self._waiting += len(message.cdr)
            self._queue.put(message)
        return True

    def note_lost(self, topic: str, number: int) -> None:
        """Count messages of the running recording that are known to be lost."""
        with self._lock:
            self._lost[topic] += number

    @property
    def lost(self) -> dict[str, int]:
        """Messages lost so far by topic."""
        with self._lock:
            return {k: v for k, v in self._lost.items() if v}

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far by topic."""
        counts = Counter(self._before)
        counts.update(self._part_counts())
        return dict(counts)

    def _part_counts(self) -> dict[str, int]:
        if self._safe_counts is not None:
            return self._safe_counts
        return self._writer.counts if self._writer is not None else {}

    def stop(self) -> RecordingResult:
        """Write what waits, close the bag; raises InputError when nothing is being recorded."""
        thread, writer = self._thread, self._writer
        if thread is None or writer is None:
            raise InputError("nothing is being recorded; start a recording first")
        self._queue.put(None)
        thread.join()
        self._thread = None
        error = "; ".join(self._errors)
        if error and len(self.parts) > 1:
            error += f"; it continues in {', '.join(p.name for p in self.parts[1:])}"
        return RecordingResult(self.parts[0], self.counts, self.lost, error)

    # The writing thread ----------------------------------------------------------------------

    def _stored(self, topic: str, message_type: str) -> tuple[str, str]:
        """Name and type under which a topic is stored."""
        if self.settings.png and message_type == IMAGE_TYPE:
            return topic + "/compressed", COMPRESSED_TYPE
        return topic, message_type

    def _run(self, writer: BagWriter) -> None:
        safe, taken = _Safe(), Counter[str]()
        self.last_flush = checked = time.monotonic()
        try:
            while True:
                timeout = self.settings.flush_interval - (time.monotonic() - self.last_flush)
                try:
                    message = self._queue.get(timeout=max(timeout, 0.001))
                    if message is None:
                        break
                    with self._lock:
                        self._waiting -= len(message.cdr)
                    taken[message.topic] += 1
                    self._write(writer, message)
                except queue.Empty:
                    pass
                now = time.monotonic()
                if now - self.last_flush >= self.settings.flush_interval:
                    writer.flush()
                    if not writer.present:
                        safe = _Safe()
                        raise _Removed(
                            f"{writer.path}: the bag was removed or renamed while it was recorded"
                        )
                    self.last_flush = now
                    safe = _Safe(len(writer.files), writer.size, writer.counts, taken.copy())
                    if now - checked >= 1.0:
                        checked = now
                        free = shutil.disk_usage(writer.path).free
                        if free < self.settings.minimum_free:
                            raise _DiskFull(
                                f"{writer.path}: disk is nearly full ({free >> 20} MiB free), "
                                "recording was closed; make room"
                            )
            writer.close()
        except _DiskFull as full:
            self._end(str(full))
            try:
                writer.close()
            except (FingerError, OSError):
                self._cut(writer, safe, taken)
        except _Removed as removed:
            self._end(str(removed))
            self._cut(writer, safe, taken)
        except (FingerError, OSError, struct.error, MemoryError) as error:
            detail = getattr(error.__cause__ or error, "strerror", None) or str(error)
            self._end(
                f"{writer.path}: recording ended ({detail}); 'finger-bag recover' completes the bag"
            )
            self._cut(writer, safe, taken)

    def _end(self, text: str) -> None:
        """Interrupt the recording; what waits is lost."""
        with self._lock:
            self._interrupted = text
            self._errors.append(text)
            self._waiting = 0
            with suppress(queue.Empty):
                while True:
                    message = self._queue.get_nowait()
                    if message is not None:
                        self._lost[message.topic] += 1
        self._on_error(text)

    def _cut(self, writer: BagWriter, safe: _Safe, taken: Counter[str]) -> None:
        """Leave only complete records: the file as it was after the last flush."""
        path = writer.path / writer.files[-1]
        with suppress(OSError):
            writer.abandon()
        with suppress(OSError):
            if safe.files == len(writer.files) and path.stat().st_size > safe.length:
                os.truncate(path, safe.length)
        self._safe_counts = safe.counts
        with self._lock:
            self._lost.update(taken - safe.taken)

    def _write(self, writer: BagWriter, message: Serialized) -> None:
        topic, message_type, cdr, *times = message
        name, stored = self._stored(topic, message_type)
        if stored != message_type:
            packed = as_png(cdr)
            if packed is None:
                # Not mono8: kept as it came, on its own topic.
                name, stored = topic, message_type
            else:
                cdr = packed
        try:
            writer.add_topic(name, stored)
            writer.write_raw(name, cdr, *times)
        except InputError:
            if writer.closed:  # the disk refused it, not the bag
                raise
            self.note_lost(topic, 1)


class _Removed(Exception):
    pass


class _DiskFull(Exception):
    pass


def as_png(cdr: bytes) -> bytes | None:
    """A serialized mono8 Image as a serialized CompressedImage; None for other encodings."""
    import cv2
    import numpy as np

    try:
        image = decoder(IMAGE_TYPE)(cdr)
    except InputError:
        return None
    if image.encoding not in ("mono8", "8UC1") or image.height * image.step > len(image.data):
        return None
    if not 0 < image.width <= image.step or not image.height:
        return None
    pixels = image.data[: image.height * image.step].reshape(image.height, image.step)
    # Level 1: within 10 % of the size of the highest one for camera noise, several times as fast.
    done, packed = cv2.imencode(
        ".png", np.ascontiguousarray(pixels[:, : image.width]), [cv2.IMWRITE_PNG_COMPRESSION, 1]
    )
    if not done:
        return None
    header = {"stamp": header_stamp(image), "frame_id": image.header.frame_id}
    fields = {"header": header, "format": PNG_FORMAT, "data": packed.tobytes()}
    return encode(COMPRESSED_TYPE, fields)
