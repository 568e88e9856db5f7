"""Recording core: a queue, a thread that writes, and the accounts of what was lost. No ROS.

Messages are put in as they came from the middleware, serialized; the thread writes them and hands
the file to the operating system at least every `flush_interval`, so that a recorder killed at any
moment loses no more than what arrived since. When the disk is nearly full, the recording is closed
cleanly and the reason kept in `error`.
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
from .writer import BagWriter

IMAGE_TYPE = TOPICS["image_raw"].type
COMPRESSED_TYPE = TOPICS["image_raw/compressed"].type
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
        "Longest time a message stays in the recorder; what a kill can lose.",
        unit="s",
        minimum=0.05,
        maximum=1.0,
    )
    maximum_size: int = setting(
        0, "Size at which the next file of the bag is begun; 0 for never.", unit="B", minimum=0
    )
    maximum_duration: float = setting(
        0.0, "Time after which the next file of the bag is begun; 0 for never.", "s", minimum=0.0
    )
    minimum_free: int = setting(
        256 << 20, "Free disk space at which recording stops.", unit="B", minimum=0
    )
    queue_limit: int = setting(
        512 << 20,
        "What may wait for the disk before messages are dropped and counted.",
        unit="B",
        minimum=1 << 20,
    )


@dataclass
class RecordingResult:
    """The bag, messages recorded and lost by topic, and why it ended early ("" if not)."""

    path: Path
    counts: dict[str, int] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    error: str = ""

    @property
    def message_count(self) -> int:
        return sum(self.counts.values())

    @property
    def lost_count(self) -> int:
        return sum(self.lost.values())


class StampGaps:
    """Counts messages that are missing between the stamps of a stream of constant rate.

    The period is the median of the first 50 intervals; from then on an interval of n periods counts
    n − 1 missing.
    """

    def __init__(self) -> None:
        self._first: list[int] = []
        self._last: int | None = None
        self._period = 0
        self.missing = 0

    def add(self, stamp_ns: int) -> None:
        """Take the next stamp; repeated and older ones are ignored."""
        last, self._last = self._last, max(stamp_ns, self._last or stamp_ns)
        if last is None or stamp_ns <= last:
            return
        step = stamp_ns - last
        if not self._period:
            self._first.append(step)
            if len(self._first) == 50:
                self._period = sorted(self._first)[25]
                self.missing += sum(self._steps(s) for s in self._first)
            return
        self.missing += self._steps(step)

    def _steps(self, step: int) -> int:
        return max(0, round(step / self._period) - 1)


class Recorder:
    """Records one bag after the other; thread-safe.

    on_error is called, in the writing thread, with one sentence when a recording ends by itself.
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
        self._topics: dict[str, str] = {}
        self._error = ""
        self.last_flush = 0.0

    @property
    def recording(self) -> bool:
        """Whether messages are being taken."""
        return self._thread is not None and not self._error

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
    ) -> Path:
        """Begin a bag. topics: absolute name → type.

        Raises InputError when a recording runs already or `path` cannot be used.
        """
        if self._thread is not None:
            raise InputError(f"recording into {self.path} runs already; stop it first")
        path = Path(path)
        settings = self.settings
        parent = next(p for p in (path.absolute(), *path.absolute().parents) if p.exists())
        free = shutil.disk_usage(parent).free
        if free < settings.minimum_free:
            raise InputError(
                f"{path}: {free >> 20} MiB are free, recording needs "
                f"{settings.minimum_free >> 20}; make room or choose another disk"
            )
        writer = BagWriter(
            path,
            metadata,
            in_place=True,
            maximum_size=settings.maximum_size,
            maximum_duration=settings.maximum_duration,
            compression=settings.compression,
        )
        try:
            for name, data in (attachments or {}).items():
                writer.attach(name, data)
            for topic, message_type in (topics or {}).items():
                name, stored = self._stored(topic, message_type)
                writer.add_topic(name, stored)
            writer.flush()
        except FingerError:
            writer.abandon()
            shutil.rmtree(path, ignore_errors=True)
            raise
        self._lost, self._error = Counter(), ""
        self._writer = writer
        self._queue = queue.SimpleQueue()
        self._waiting = 0
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()
        return path

    def put(self, message: Serialized) -> bool:
        """Hand over a message; false when it is not recorded or lost, as the queue is full."""
        if self._thread is None:
            return False
        if self._error or self._waiting > self.settings.queue_limit:
            self.note_lost(message.topic, 1)
            return False
        with self._lock:
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
        return self._writer.counts if self._writer is not None else {}

    def stop(self) -> RecordingResult:
        """Write what waits, close the bag; raises InputError when nothing is being recorded."""
        thread, writer = self._thread, self._writer
        if thread is None or writer is None:
            raise InputError("nothing is being recorded; start a recording first")
        self._queue.put(None)
        thread.join()
        self._thread = None
        return RecordingResult(writer.path, writer.counts, self.lost, self._error)

    # The writing thread ----------------------------------------------------------------------

    def _stored(self, topic: str, message_type: str) -> tuple[str, str]:
        """Name and type under which a topic is stored."""
        if self.settings.png and message_type == IMAGE_TYPE:
            return topic + "/compressed", COMPRESSED_TYPE
        return topic, message_type

    def _run(self) -> None:
        writer = self._writer
        assert writer is not None
        good = (0, 0)  # file and length up to which everything is whole
        self.last_flush = checked = time.monotonic()
        try:
            while True:
                timeout = self.settings.flush_interval - (time.monotonic() - self.last_flush)
                message = None
                try:
                    message = self._queue.get(timeout=max(timeout, 0.001))
                    if message is None:
                        break
                    with self._lock:
                        self._waiting -= len(message.cdr)
                    self._write(writer, message)
                except queue.Empty:
                    pass
                now = time.monotonic()
                if now - self.last_flush >= self.settings.flush_interval:
                    writer.flush()
                    self.last_flush = now
                    good = (len(writer.files), writer.size)
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
                self._cut(writer, good)
        except (FingerError, OSError, struct.error, MemoryError) as error:
            detail = getattr(error, "strerror", None) or str(error)
            self._end(
                f"{writer.path}: recording ended ({detail}); 'finger-bag recover' completes the bag"
            )
            self._cut(writer, good)

    def _end(self, text: str) -> None:
        self._error = text
        self._on_error(text)

    @staticmethod
    def _cut(writer: BagWriter, good: tuple[int, int]) -> None:
        """Leave only complete records: the file as it was after the last flush."""
        files, length = good
        path = writer.path / writer.files[-1]
        with suppress(OSError):
            writer.abandon()
        with suppress(OSError):
            if files == len(writer.files) and path.stat().st_size > length:
                os.truncate(path, length)

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
        except InputError as error:
            if isinstance(error.__cause__ or error.__context__, OSError):
                raise
            self.note_lost(topic, 1)


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
