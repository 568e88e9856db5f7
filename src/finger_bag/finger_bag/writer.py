# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Writing bags: a rosbag2 folder with MCAP files, zstd chunks, message index and metadata.yaml."""

from __future__ import annotations

import contextlib
import os
import shutil
import struct
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import yaml

from finger_common.errors import InputError
from finger_common.files import NO_ROOM, atomic_write, check_text, load_yaml, make_folder
from finger_common.folder_lock import refuse_existing, take_lock
from finger_common.stamps import NANOSECONDS, seconds

from .bag_files import METADATA, data_files, number_of
from .definitions import decoder, definition_text, encode, fields_of, type_hash
from .mcap_writer import McapWriter
from .reader import BagMessage
from .schema import NAMESPACE, SESSION_RECORD, SessionMetadata, full_name, offered_qos, spec_of
from .schema import software_version as _software_version

CHUNK_SIZE = 1 << 20
"""Bytes of a chunk before compression; a chunk is what is lost when one bit of it flips."""

LONGEST_NAME = 240
"""Bytes of a bag's name. Its files have up to 15 more, and file systems allow 255."""

# Version 8 keeps QoS as text, as every rosbag2 from Humble on reads it; version 9 changes that.
METADATA_VERSION = 8


class MessageRefused(InputError):
    """Bytes that are no message, or a time that no bag can hold; other messages can be written."""


@dataclass
class _Channel:
    name: str
    type: str
    definition: str
    form: str
    hash: str
    qos: str
    count: int = 0

    def is_defined_by(self, definition: str, form: str) -> bool:
        """Whether a definition has the fields of the topic's."""
        if definition == self.definition:
            return True
        own = fields_of(self.type, self.definition, self.form)
        return fields_of(self.type, definition, form) == own


@dataclass
class _File:
    name: str
    start_ns: int | None = None
    end_ns: int | None = None
    count: int = 0


@dataclass
class WrittenBag:
    """What a closed writer left behind."""

    path: Path
    files: list[str] = field(default_factory=list)
    message_count: int = 0
    counts: dict[str, int] = field(default_factory=dict)


def _same_fields(message_type: str, definition: str, form: str) -> bool:
    """Whether a definition has the fields of the known type: other comments change no hash."""
    try:
        known = bool(definition) and _known(message_type)
        return known and decoder(message_type, definition, form).standard
    except InputError:
        return False


def _known(message_type: str) -> bool:
    return bool(type_hash(message_type))


def add_message(
    bag: Path, topic: str, message_type: str, fields: Mapping[str, Any], log_time_ns: int
) -> None:
    """Add a message to a bag that nobody writes any longer, in a further file of it. topic:
    absolute.
    """
    description = bag / METADATA
    whole: dict[str, Any] = {"relative_file_paths": data_files(bag)}
    closed = description.is_file()
    if closed:
        whole = load_yaml(description, "bag metadata")["rosbag2_bagfile_information"]
    with tempfile.TemporaryDirectory(prefix=f".{bag.name}.", dir=bag.parent) as folder:
        with BagWriter(Path(folder) / "part") as writer:
            writer.write(topic, fields, log_time_ns, message_type)
        written = load_yaml(writer.path / METADATA, "bag metadata")
        part = written["rosbag2_bagfile_information"]
        number = len(whole["relative_file_paths"])
        while (bag / (name := f"{bag.name}_{number}.mcap")).exists():  # one that is not listed
            number += 1
        os.replace(writer.path / part["relative_file_paths"][0], bag / name)
    if not closed:  # as after a crash of the recorder: the files in the folder are the bag
        return
    # A bag without messages has no time of its own.
    spans = [_span(bag) for bag in (whole, part) if bag["message_count"]]
    start = min(first for first, _ in spans)
    whole["starting_time"]["nanoseconds_since_epoch"] = start
    whole["duration"]["nanoseconds"] = max(last for _, last in spans) - start
    whole["message_count"] += 1
    known = {t["topic_metadata"]["name"]: t for t in whole["topics_with_message_count"]}
    for added in part["topics_with_message_count"]:
        if added["topic_metadata"]["name"] in known:
            known[added["topic_metadata"]["name"]]["message_count"] += 1
        else:
            whole["topics_with_message_count"].append(added)
    whole["relative_file_paths"].append(name)
    whole["files"].append({**part["files"][0], "path": name})
    with atomic_write(description) as file:
        yaml.safe_dump({"rosbag2_bagfile_information": whole}, file, sort_keys=False)


def _span(metadata: Mapping[str, Any]) -> tuple[int, int]:
    """First and last log time (ns) by a bag's metadata."""
    start = int(metadata["starting_time"]["nanoseconds_since_epoch"])
    return start, start + int(metadata["duration"]["nanoseconds"])


def check_name_length(path: Path, more: str = "") -> None:
    """Raise InputError for a bag whose name, with what may be appended to it, is too long."""
    size, most = len(os.fsencode(path.name)), LONGEST_NAME - len(more)
    if size > most:
        raise InputError(f"{path}: the name has {size} bytes; give one of at most {most}")


class BagWriter:
    """Writes one bag; a context manager.

    path: folder of the bag; must not exist or be empty. The folder takes its name only when the
    writer closes without an error; with `in_place` it is written where it will stay from the
    beginning, as a recording must be (what was flushed survives a kill). metadata: SessionMetadata
    or a mapping with its keys. namespace: put before relative topic names. maximum_size,
    maximum_duration: bytes of messages and seconds after which the next file of the bag is begun; 0
    for never. further: go on with a bag that another writer left in place without closing it, in
    further files; metadata.yaml is left to `recover`, as nobody knows what those before hold.

    Raises InputError when the folder exists or cannot be written. After a write that failed, as on
    a full disk, nothing more is written and every further call raises InputError again.
    """

    def __init__(
        self,
        path: str | Path,
        metadata: SessionMetadata | Mapping[str, Any] | None = None,
        *,
        namespace: str = NAMESPACE,
        in_place: bool = False,
        further: bool = False,
        maximum_size: int = 0,
        maximum_duration: float = 0.0,
        chunk_size: int = CHUNK_SIZE,
        compression: str = "zstd",
    ) -> None:
        if not isinstance(metadata, SessionMetadata):
            metadata = SessionMetadata.from_mapping(metadata or {})
        self.metadata = {"software_version": _software_version(), **metadata.to_mapping()}
        self.path = Path(path)
        self.namespace = namespace
        self._maximum_size = maximum_size
        self._maximum_duration = maximum_duration
        self._chunk_size = chunk_size
        self._compression = compression
        self._splits = bool(maximum_size or maximum_duration)
        self._head_size = 0
        self._channels: dict[str, _Channel] = {}
        self._ids: dict[str, int] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._files: list[_File] = []
        self._attachments: list[tuple[str, bytes, str]] = []
        self._stream: IO[bytes] | None = None
        self._mcap: McapWriter | None = None
        self.closed = self._finished = False
        self._failure = ""
        name = self.path.name
        if not name or name in (".", "..") or "\0" in str(path):
            raise InputError(f"{path}: not a name for a bag; give the folder to write")
        for text in (name, *self.metadata, *self.metadata.values()):
            check_text(text, f"{str(path)!r}")
        check_name_length(self.path)
        if not further:
            refuse_existing(self.path)
        self._further = further
        in_place = in_place or further
        self._folder = self.path if in_place else self.path.with_name(f".{name}.partial")
        self._lock = -1
        try:
            if not in_place and self._folder.exists():
                self._lock_folder()  # else of a program that was killed
                self._unlock_folder()
                shutil.rmtree(self._folder)
            make_folder(self._folder)
            self._lock_folder()
            before = data_files(self._folder) if further else []
            self._first = 1 + max((number_of(file) for file in before), default=-1)
            self._open_file()
        except OSError as error:
            raise self._failed(error) from error

    def _lock_folder(self) -> None:
        """Keep other programs from writing a bag of this name; ends with the process."""
        self._lock = os.open(self._folder, os.O_RDONLY)
        if not take_lock(self._lock):
            self._unlock_folder()
            raise InputError(
                f"{self.path}: is being written by another program; choose another name"
            )

    def _unlock_folder(self) -> None:
        if self._lock >= 0:
            with contextlib.suppress(OSError):
                os.close(self._lock)
            self._lock = -1

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            if kind is None:
                self.close()
        finally:  # also of a disk that is full now
            self.abandon()

    # Files -----------------------------------------------------------------------------------

    def _open_file(self) -> None:
        name = f"{self.path.name}_{self._first + len(self._files)}.mcap"
        self._files.append(_File(name))
        self._stream = open(self._folder / name, "wb")
        self._mcap = McapWriter(self._stream, self._chunk_size, self._compression)
        self._mcap.write_header("ros2", f"finger_bag {_software_version()}")
        self._mcap.add_metadata(SESSION_RECORD, self.metadata)
        self._schemas.clear()
        self._head_size = self._mcap.size
        for attachment in self._attachments:
            self._add_attachment(*attachment)

    def _close_file(self) -> None:
        if self._mcap is None or self._stream is None:
            return
        self._mcap.finish()
        self._account(self._mcap)
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
        self._mcap = self._stream = None

    def _account(self, mcap: McapWriter) -> None:
        """Take over what a finished file holds."""
        file = self._files[-1]
        file.count = mcap.total
        file.start_ns, file.end_ns = (mcap.start, mcap.end) if mcap.total else (None, None)
        counts = mcap.counts
        for name, channel_id in self._ids.items():
            self._channels[name].count += counts.get(channel_id, 0)
        self._ids.clear()

    def _split_if_due(self, log_time_ns: int) -> None:
        file = self._files[-1]
        if file.start_ns is None:
            file.start_ns = log_time_ns
        if self._stream is None or self._mcap is None or not self._mcap.total:
            return
        full = self._maximum_size and self._mcap.size - self._head_size >= self._maximum_size
        long = (
            self._maximum_duration
            and seconds(log_time_ns - file.start_ns) >= self._maximum_duration
        )
        if full or long:
            self._close_file()
            self._open_file()

    # Content ---------------------------------------------------------------------------------

    def add_topic(
        self,
        topic: str,
        message_type: str | None = None,
        *,
        definition: str | None = None,
        form: str = "ros2msg",
        qos: str | None = None,
    ) -> str:
        """Announce a topic and return its absolute name.

        message_type: None for a topic of the schema. definition: text of the type where it is not a
        known one. qos: YAML as rosbag2 stores it; None for the schema's. Raises InputError for an
        unknown type, or when the topic was announced with another type or other fields of it.
        """
        name = full_name(topic, self.namespace)
        spec = spec_of(topic)
        if message_type is None:
            if spec is None:
                raise InputError(f"topic '{topic}' is not in the bag schema; give its message type")
            message_type = spec.type
        channel = self._channels.get(name)
        if channel is not None:
            if channel.type != message_type:
                raise InputError(
                    f"topic '{name}' holds '{channel.type}' already, "
                    f"'{message_type}' cannot be added"
                )
            if definition is not None and not channel.is_defined_by(definition, form):
                raise InputError(
                    f"topic '{name}' holds '{message_type}' with other fields already; its "
                    "messages of another definition cannot be added"
                )
            return name
        if qos is None:
            profile = offered_qos(spec.latched if spec is not None else 0)
            qos = yaml.safe_dump(profile, sort_keys=False).strip()
        known = definition_text(message_type) if definition is None or _known(message_type) else ""
        if definition is None:
            definition = known
        same = definition == known or _same_fields(message_type, definition, form)
        known_hash = type_hash(message_type) if same else ""
        self._channels[name] = _Channel(name, message_type, definition, form, known_hash, qos)
        return name

    def _channel_id(self, channel: _Channel) -> int:
        assert self._mcap is not None
        if channel.name not in self._ids:
            key = (channel.type, channel.definition)
            if key not in self._schemas:
                encoding = channel.form if channel.definition else ""
                self._schemas[key] = self._mcap.register_schema(
                    channel.type, encoding, channel.definition.encode()
                )
            details = {"offered_qos_profiles": channel.qos}
            if channel.hash:
                details["topic_type_hash"] = channel.hash
            self._ids[channel.name] = self._mcap.register_channel(
                channel.name, self._schemas[key], details
            )
        return self._ids[channel.name]

    def write_raw(
        self,
        topic: str,
        cdr: bytes,
        log_time_ns: int,
        publish_time_ns: int | None = None,
        sequence: int = 0,
    ) -> None:
        """Write one serialized message as it is.

        A topic that is not of the schema must have been announced by `add_topic`. Raises
        MessageRefused for bytes without a CDR encapsulation header and for a time that does not
        fit, InputError when the disk refuses.
        """
        try:
            channel_id = self._ids.get(topic)
            if channel_id is None or self._splits:
                channel_id = self._prepare(topic, log_time_ns)
            if len(cdr) < 4 or cdr[0] != 0:
                raise MessageRefused(f"topic '{topic}': bytes are not a CDR message")
            self._mcap.add_message(  # type: ignore[union-attr]
                channel_id,
                log_time_ns,
                cdr,
                log_time_ns if publish_time_ns is None else publish_time_ns,
                sequence & 0xFFFFFFFF,
            )
        except struct.error:
            raise MessageRefused(
                f"topic '{topic}': time {log_time_ns} ns is outside a bag's range; "
                "use ns since the epoch"
            ) from None
        except OSError as error:
            raise self._failed(error) from error

    def _prepare(self, topic: str, log_time_ns: int) -> int:
        """Id of a topic's channel in the file that a message of this time goes to."""
        name = topic if topic in self._channels else full_name(topic, self.namespace)
        if name not in self._channels:
            self.add_topic(topic)
        self._begun()
        if self._splits:
            self._split_if_due(log_time_ns)
        return self._channel_id(self._channels[name])

    def _begun(self) -> McapWriter:
        """File being written; raises InputError when the bag is closed or a write failed."""
        if self._mcap is None:
            raise InputError(self._failure or f"{self.path}: bag is closed already")
        return self._mcap

    def _failed(self, error: OSError) -> InputError:
        """The bag ends here, as nobody knows how much of a record is in its file; the sentence."""
        remedy = "make room, or choose" if error.errno in NO_ROOM else "choose"
        reason = error.strerror or error
        self._failure = f"{self.path}: cannot be written ({reason}); {remedy} another folder"
        self.abandon()
        return InputError(self._failure)

    def copy(self, message: BagMessage) -> None:
        """Write a message of another bag as it is; its topic must be known or announced."""
        self.write_raw(
            message.topic,
            message.raw,
            message.log_time_ns,
            message.publish_time_ns,
            message.sequence,
        )

    def write(
        self,
        topic: str,
        fields: Mapping[str, Any],
        log_time_ns: int | None = None,
        message_type: str | None = None,
    ) -> None:
        """Write one message given as plain data: nested mappings, sequences, arrays; left-out
        fields are zero.

        `{"header": {"stamp": 1_700_000_000_000_000_000}, "value": 69.3}` for a moisture reading: a
        stamp may be an int in ns. log_time_ns None takes the header stamp. Raises InputError for
        fields that do not fit the type.
        """
        name = self.add_topic(topic, message_type)
        if log_time_ns is None:
            stamp = fields.get("header", {}).get("stamp")
            if isinstance(stamp, Mapping):
                stamp = int(stamp.get("sec", 0)) * NANOSECONDS + int(stamp.get("nanosec", 0))
            log_time_ns = time.time_ns() if stamp is None else int(stamp)
        cdr = encode(self._channels[name].type, fields)
        self.write_raw(name, cdr, log_time_ns)

    def attach(self, name: str, data: bytes, media_type: str = "application/octet-stream") -> None:
        """Attach a file, such as the plate calibration, to every file of the bag."""
        self._add_attachment(name, data, media_type)
        self._attachments.append((name, data, media_type))

    def _add_attachment(self, name: str, data: bytes, media_type: str) -> None:
        mcap = self._begun()
        before = mcap.size
        try:
            mcap.add_attachment(time.time_ns(), name, media_type, data)
        except OSError as error:
            raise self._failed(error) from error
        self._head_size += mcap.size - before

    def flush(self) -> None:
        """End the chunk in progress and hand everything to the operating system: it survives a
        kill."""
        if self._mcap is None and not self._failure:
            return
        try:
            self._begun().flush()
        except OSError as error:
            raise self._failed(error) from error

    @property
    def present(self) -> bool:
        """Whether the file being written is where it was begun: not removed, not renamed."""
        if self._stream is None:
            return True
        try:
            there = os.stat(self._folder / self._files[-1].name)
        except OSError:
            return False
        here = os.fstat(self._stream.fileno())
        return (there.st_dev, there.st_ino) == (here.st_dev, here.st_ino)

    @property
    def files(self) -> list[str]:
        """Names of the files begun so far."""
        return [file.name for file in self._files]

    @property
    def size(self) -> int:
        """Bytes handed to the file now being written."""
        return self._mcap.size if self._mcap is not None else 0

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return sum(self.counts.values())

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far by topic."""
        running = self._mcap.counts if self._mcap is not None else {}
        return {
            c.name: c.count + running.get(self._ids.get(c.name, 0), 0)
            for c in list(self._channels.values())
        }

    # End -------------------------------------------------------------------------------------

    def finish(self) -> None:
        """Finish the files and write metadata.yaml; `close` needs no more room on the disk then."""
        if self._failure:
            raise InputError(self._failure)
        if self._finished or self.closed:
            return
        try:
            self._close_file()
            if not self._further:
                self._write_metadata()
        except OSError as error:
            raise self._failed(error) from error
        self._finished = True

    def close(self) -> WrittenBag:
        """Finish the files, write metadata.yaml, give the folder its name."""
        self.finish()
        if not self.closed:
            if self._folder != self.path:
                refuse_existing(self.path)
                if self.path.is_dir():
                    self.path.rmdir()
                os.replace(self._folder, self.path)
            self._unlock_folder()
            self.closed = True
        return WrittenBag(self.path, [f.name for f in self._files], self.message_count, self.counts)

    def abandon(self) -> None:
        """Stop without finishing; removes the folder unless it was written in place."""
        if self.closed:
            return
        self.closed = True
        if self._mcap is not None:
            self._account(self._mcap)
        if self._stream is not None:
            with contextlib.suppress(OSError):  # what is buffered may not fit on the disk
                self._stream.close()
        self._mcap = self._stream = None
        if self._lock >= 0 and self._folder != self.path:
            shutil.rmtree(self._folder, ignore_errors=True)
        self._unlock_folder()

    def _write_metadata(self) -> None:
        with atomic_write(self._folder / METADATA) as file:
            yaml.safe_dump(self._metadata(), file, sort_keys=False)

    def _metadata(self) -> dict[str, Any]:
        def span(files: list[_File]) -> tuple[int, int]:
            starts = [f.start_ns for f in files if f.start_ns is not None]
            ends = [f.end_ns for f in files if f.end_ns is not None]
            return (min(starts), max(ends) - min(starts)) if starts else (0, 0)

        start, duration = span(self._files)
        files = []
        for written in self._files:
            file_start, file_duration = span([written])
            files.append(
                {
                    "path": written.name,
                    "starting_time": {"nanoseconds_since_epoch": file_start},
                    "duration": {"nanoseconds": file_duration},
                    "message_count": written.count,
                }
            )
        topics = [
            {
                "topic_metadata": {
                    "name": c.name,
                    "type": c.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": c.qos,
                    "type_description_hash": c.hash,
                },
                "message_count": c.count,
            }
            for c in self._channels.values()
        ]
        return {
            "rosbag2_bagfile_information": {
                "version": METADATA_VERSION,
                "storage_identifier": "mcap",
                "duration": {"nanoseconds": duration},
                "starting_time": {"nanoseconds_since_epoch": start},
                "message_count": self.message_count,
                "topics_with_message_count": topics,
                # MCAP compresses its own chunks; rosbag2 must not look for compressed files.
                "compression_format": "",
                "compression_mode": "",
                "relative_file_paths": [f.name for f in self._files],
                "files": files,
                "custom_data": {f"{SESSION_RECORD}.{k}": v for k, v in self.metadata.items()},
                "ros_distro": "jazzy",
            }
        }
