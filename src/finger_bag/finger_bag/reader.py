# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Reading bags: rosbag2 folders (MCAP, sqlite3, compressed or not), bare MCAP and sqlite3 files.

Reading is streaming: messages come in the order of their log time, one chunk (or a few,
where chunks overlap in time) is in memory at once, and what cannot be read is left out and
listed in `BagReader.problems`.
"""

from __future__ import annotations

import heapq
import shutil
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePath, PureWindowsPath
from typing import Any

import numpy as np
import zstandard

from finger_common.errors import InputError, listed
from finger_common.files import load_yaml
from finger_common.stamps import seconds, whole_stamp

from .bag_files import METADATA, are_one_bag, check_place, data_files, storage_of
from .definitions import Decoder, TopicInfo, decoder, fields_of
from .log_order import Part, Pending
from .mcap_file import MAXIMUM_CHUNK, AttachmentEntry, McapFile
from .schema import SESSION_RECORD, SessionMetadata
from .sqlite_file import SqliteFile

MAXIMUM_PENDING = 64 << 20
"""Bytes of messages held back to give them in the order of log time."""

MAXIMUM_PROBLEMS = 100
"""Problems that are listed; more tell a reader nothing."""

LAST_TIME = 1 << 63
"""Log times (ns) from here on, the year 2262, are damage: they fit no signed integer."""

_UNPACKED_RATIO = 100
_UNPACKED_FREE = 1 << 30


@dataclass
class BagInfo:
    """What is known about a bag without reading its messages."""

    path: Path
    files: list[Path]
    storage: str
    topics: dict[str, TopicInfo]
    metadata: SessionMetadata
    start_ns: int | None
    end_ns: int | None
    message_count: int | None
    attachments: list[str]
    complete: bool
    """Whether every file was closed by its recorder."""
    size: int = 0
    """Bytes on disk."""
    problems: list[str] = field(default_factory=list)

    @property
    def duration(self) -> float:
        """Seconds from the first to the last log time."""
        if self.start_ns is None or self.end_ns is None:
            return 0.0
        return seconds(self.end_ns - self.start_ns)


@dataclass(slots=True)
class BagMessage:
    """One message of a bag; `raw` is its CDR bytes."""

    topic: str
    type: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    raw: bytes = field(repr=False)
    info: TopicInfo = field(repr=False)
    """The topic as it was described where this message was recorded."""
    _reader: BagReader = field(repr=False)
    _message: Any = field(default=None, repr=False)

    @property
    def message(self) -> Any:
        """Object with the type's fields; raises InputError for malformed bytes."""
        if self._message is None:
            try:
                self._message = self._reader.decoder_of(self.info)(self.raw)
            except InputError as error:
                raise InputError(f"{self._reader.path}, topic '{self.topic}': {error}") from None
        return self._message


class BagReader:
    """A bag opened for reading; a context manager. Use `open_bag`."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.problems: list[str] = []
        self._lost = False
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._mcaps: list[McapFile] = []
        self._sqlites: list[SqliteFile] = []
        # Of each topic and type, a description for each definition with fields of its own.
        self._types: dict[tuple[str, str], dict[Any, TopicInfo]] = {}
        self._known: dict[tuple[str, ...], TopicInfo] = {}
        self._decoders: dict[tuple[str, ...], Decoder | InputError] = {}
        files, storage, custom = self._find_files()
        try:
            self._open(files, storage)
            self.info = self._describe(files, storage, custom)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def lost(self) -> bool:
        """Whether something that the bag holds could not be read so far.

        A bag that was not closed by its recorder is complete up to its end, and not lost.
        """
        return self._lost or any(mcap.lost for mcap in self._mcaps)

    def _problem(self, text: str, lost: bool = True) -> None:
        self._lost = self._lost or lost
        if len(self.problems) < MAXIMUM_PROBLEMS and text not in self.problems:
            self.problems.append(text)

    # Opening ---------------------------------------------------------------------------------

    def _find_files(self) -> tuple[list[Path], str, dict[str, str]]:
        """Files of the bag, how they are stored, custom data of metadata.yaml."""
        check_place(self.path)
        if self.path.is_file():
            return [self.path], storage_of(self.path) or "mcap", {}
        custom: dict[str, str] = {}
        description = self.path / METADATA
        files: list[Path] = []
        if description.is_file():
            try:
                files, custom = self._read_metadata(description)
            except InputError as error:
                self._problem(f"{error}; the files in the folder are read instead", lost=False)
        else:
            self._problem("metadata.yaml is missing; 'finger-bag recover' writes it", lost=False)
        if not files:
            files = data_files(self.path)
            if not files:
                raise InputError(f"{self.path}: no .mcap or .db3 file in this folder; give a bag")
            if not are_one_bag(files):
                names = listed((file.name for file in files), 3)
                raise InputError(f"{self.path}: holds several bags ({names}); give one of them")
        kinds = {storage_of(file) or "mcap" for file in files}
        if len(kinds) > 1:
            raise InputError(f"{self.path}: MCAP and sqlite3 files mixed; keep one kind")
        return files, kinds.pop(), custom

    def _read_metadata(self, description: Path) -> tuple[list[Path], dict[str, str]]:
        data = load_yaml(description, "bag metadata").get("rosbag2_bagfile_information")
        if not isinstance(data, dict) or not isinstance(data.get("relative_file_paths"), list):
            raise InputError(f"{description}: key 'relative_file_paths' is missing")
        files = []
        for entry in data["relative_file_paths"]:
            # Only the name counts: a path that leads out of the folder is a mistake or a trick.
            name = PurePath(PureWindowsPath(str(entry)).name).name
            file = self.path / name
            if not name or not file.is_file():
                self._problem(f"file '{entry}' of metadata.yaml is missing")
                continue
            if file in files:
                text = f"file '{entry}' is listed twice in metadata.yaml; it is read once"
                self._problem(text, lost=False)
                continue
            if storage_of(file) is None:
                raise InputError(f"{description}: '{entry}' is neither .mcap nor .db3")
            files.append(file)
        listed_names = {_plain_name(file) for file in files}
        for file in data_files(self.path) if files else ():
            if _plain_name(file) not in listed_names:  # ROS unpacks a listed file beside it
                self._problem(f"{file.name} is in the folder and not in metadata.yaml; not read")
        custom = data.get("custom_data")
        texts = {str(k): str(v) for k, v in custom.items()} if isinstance(custom, dict) else {}
        return files, texts

    def _open(self, files: list[Path], storage: str) -> None:
        for file in files:
            try:
                opened = self._unpacked(file)
                if storage == "mcap":
                    self._open_mcap(opened, file)
                else:
                    self._open_sqlite(opened, file)
            except InputError as error:
                if len(files) == 1:
                    raise
                self._problem(str(error))
        if not self._mcaps and not self._sqlites:
            raise InputError(f"{self.path}: none of its files can be read ({self.problems[-1]})")

    def _unpacked(self, file: Path) -> Path:
        """The file itself, or a temporary copy when rosbag2 compressed the file."""
        if file.suffix != ".zstd":
            return file
        if self._temporary is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="finger_bag_")
        target = Path(self._temporary.name) / file.stem
        limit = _UNPACKED_RATIO * file.stat().st_size + _UNPACKED_FREE
        limit = min(limit, shutil.disk_usage(self._temporary.name).free // 2)
        written = 0
        try:
            with (
                open(file, "rb") as packed,
                zstandard.ZstdDecompressor().stream_reader(
                    packed, read_across_frames=True
                ) as stream,
                open(target, "wb") as out,
            ):
                while block := stream.read(1 << 20):
                    written += len(block)
                    if written > limit:
                        raise InputError(
                            f"{file}: uncompresses to more than {limit} bytes; not read"
                        )
                    out.write(block)
        except (zstandard.ZstdError, OSError) as error:
            self._problem(f"{file.name}: cannot be uncompressed to its end ({error})")
        return target

    def _open_mcap(self, opened: Path, file: Path) -> None:
        mcap = McapFile(opened)
        self._mcaps.append(mcap)
        for channel in mcap.channels.values():
            self._know(channel_info(mcap, channel.id))

    def _open_sqlite(self, opened: Path, file: Path) -> None:
        sqlite = SqliteFile(opened, file)
        self._sqlites.append(sqlite)
        for topic in sqlite.topics:
            self._know(topic)

    def _know(self, topic: TopicInfo) -> TopicInfo:
        """The description of a topic that holds for messages described so."""
        text = (topic.name, topic.type, topic.encoding, topic.form, topic.definition)
        if text not in self._known:
            described = self._types.setdefault((topic.name, topic.type), {})
            if described:  # parsed only where texts differ
                first = described.pop(None, None)
                if first is not None:
                    described[_fields(first)] = first
                self._known[text] = described.setdefault(_fields(topic), topic)
            else:
                self._known[text] = described[None] = topic
        return self._known[text]

    def _describe(self, files: list[Path], storage: str, custom: dict[str, str]) -> BagInfo:
        session = {
            k.removeprefix(SESSION_RECORD + "."): v
            for k, v in custom.items()
            if k.startswith(SESSION_RECORD + ".")
        }
        starts: list[int] = []
        ends: list[int] = []
        attachments: list[str] = []
        for mcap in self._mcaps:
            for name, values in mcap.metadata:
                if name == SESSION_RECORD:
                    session.update(values)
            starts += [t for t in (mcap.start_ns,) if t is not None and t < LAST_TIME]
            ends += [t for t in (mcap.end_ns,) if t is not None and t < LAST_TIME]
            attachments += [a.name for a in mcap.attachments if a.name not in attachments]
        for sqlite in self._sqlites:
            starts += [t for t in (sqlite.start_ns,) if t is not None]
            ends += [t for t in (sqlite.end_ns,) if t is not None]
        message_count = self._count()
        topics: dict[str, TopicInfo] = {}
        for (name, _), described in self._types.items():
            topic = next(iter(described.values()))
            if name not in topics or (topic.count or 0) > (topics[name].count or 0):
                topics[name] = topic
        return BagInfo(
            path=self.path,
            files=files,
            storage=storage,
            topics=topics,
            metadata=SessionMetadata.from_mapping(session),
            start_ns=min(starts, default=None),
            end_ns=max(ends, default=None),
            message_count=message_count,
            attachments=attachments,
            complete=all(m.complete for m in self._mcaps),
            size=sum(f.stat().st_size for f in files),
            problems=self.all_problems(),
        )

    def _count(self) -> int | None:
        """Count the messages of each topic and of all; None where a file does not tell its own."""
        counts: Counter[tuple[str, str]] = Counter()
        total = 0
        for mcap in self._mcaps:
            statistics = mcap.statistics
            if statistics is None or not mcap.complete:
                return None
            total += statistics.message_count
            for channel_id in mcap.channels:
                info = channel_info(mcap, channel_id)
                # A channel without messages need not be among the statistics.
                number = statistics.channel_message_counts.get(channel_id, 0)
                counts[(info.name, info.type)] += number
        for sqlite in self._sqlites:
            total += sqlite.count
            for topic, number in zip(sqlite.topics, sqlite.counts):
                counts[(topic.name, topic.type)] += number
        for key, described in self._types.items():
            next(iter(described.values())).count = counts[key]
        return total

    # Reading ---------------------------------------------------------------------------------

    def topic(self, name: str, namespace: str = "") -> str | None:
        """Absolute name in this bag of a topic of the schema, such as "wrench"; None when it is
        absent.

        namespace: of the topic, "/" for no namespace; empty: any. Raises InputError
        when the bag holds it under several namespaces.
        """
        if name.startswith("/") or namespace:
            absolute = name if name.startswith("/") else f"/{namespace.strip('/')}/{name}"
            absolute = absolute.replace("//", "/")
            return absolute if absolute in self.info.topics else None
        found = [t for t in self.info.topics if t == name or t.endswith("/" + name)]
        if len(found) > 1:
            # Empty topics are announced by a recorder and never published.
            found = [t for t in found if self.info.topics[t].count != 0] or found
        if len(found) > 1:
            raise InputError(
                f"{self.path}: topic '{name}' exists as {', '.join(sorted(found))}; "
                "choose with --namespace or in a mapping file"
            )
        return found[0] if found else None

    def topic_info(self, topic: str, message_type: str) -> TopicInfo:
        """What is known of a topic holding messages of a type.

        Raises InputError where its messages follow different definitions of the type; each message
        knows its own (`BagMessage.info`).
        """
        described = self._types.get((topic, message_type), {})
        if len(described) > 1:
            raise InputError(
                f"{self.path}, topic '{topic}': {len(described)} definitions of '{message_type}' "
                "with different fields; 'finger-bag recover' keeps the messages of the first"
            )
        return next(iter(described.values()), TopicInfo(topic, message_type))

    def decoder(self, topic: str, message_type: str) -> Decoder:
        """Decoder of all messages of a topic; raises InputError as `topic_info`, and when the type
        cannot be understood."""
        return self.decoder_of(self.topic_info(topic, message_type))

    def decoder_of(self, topic: TopicInfo) -> Decoder:
        """Decoder of messages described so; raises InputError when that cannot be understood."""
        key = (topic.type, topic.encoding, topic.form, topic.definition)
        if key not in self._decoders:
            try:
                self._decoders[key] = _new_decoder(topic)
            except InputError as error:
                # A broken definition is parsed once, not once a message.
                self._decoders[key] = error
        found = self._decoders[key]
        if isinstance(found, InputError):
            raise InputError(str(found))
        return found

    def messages(
        self,
        topics: str | Collection[str] | None = None,
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[BagMessage]:
        """Messages in the order of log time.

        topics: absolute names, or one; None for all. start (inclusive), stop (exclusive): log time
        in ns, None for no bound. Raises InputError for times with a point, and where the bag is
        closed before all were read.
        """
        wanted = None if topics is None else {topics} if isinstance(topics, str) else set(topics)
        start, stop = (None if t is None else whole_stamp(t) for t in (start, stop))
        if self._sqlites:
            return self._sqlite_messages(wanted, start, stop)
        return self._mcap_messages(wanted, start, stop)

    def _check_open(self) -> None:
        if not self._mcaps and not self._sqlites:
            raise InputError(f"{self.path}: the bag is closed; read its messages before")

    def __iter__(self) -> Iterator[BagMessage]:
        return self.messages()

    def _mcap_messages(
        self, wanted: set[str] | None, start: int | None, stop: int | None
    ) -> Iterator[BagMessage]:
        self._check_open()
        low = 0 if start is None else start
        high = LAST_TIME if stop is None else min(stop, LAST_TIME)
        regions = [
            (region.start_ns, number, index)
            for number, mcap in enumerate(self._mcaps)
            for index, region in enumerate(mcap.regions)
            if region.end_ns >= low and (stop is None or region.start_ns < high)
        ]
        regions.sort()
        known: dict[tuple[int, int], TopicInfo | None] = {}
        # What was uncompressed and may still be overtaken by the next region.
        pending = Pending()
        for place, (_, number, index) in enumerate(regions):
            self._check_open()
            mcap = self._mcaps[number]
            block = mcap.block(mcap.regions[index])
            if len(block.times) and int(block.times.max()) >= LAST_TIME:
                mcap.note("messages with a time beyond the year 2262 are left out")
            counts = np.bincount(block.channels)
            used = np.zeros(len(counts), bool)
            for channel_id in np.flatnonzero(counts).tolist():
                if (number, channel_id) not in known:
                    known[(number, channel_id)] = self._channel(mcap, channel_id, wanted)
                used[channel_id] = known[(number, channel_id)] is not None
            keep = (block.times >= low) & (block.times < high) & used[block.channels]
            if keep.any():
                pending.add(Part(number, block.data, block.times[keep], block.offsets[keep]))
            bound = regions[place + 1][0] if place + 1 < len(regions) else LAST_TIME
            if bound < LAST_TIME and pending.size > MAXIMUM_PENDING:
                if pending.reach(bound):
                    text = "messages lie too far out of order to be sorted by log time"
                    mcap.note(text, lost=False)
                bound = LAST_TIME
            for part, offset in pending.before(bound):
                _, length, channel_id, sequence, time_ns, publish_time_ns = part.head(offset)
                data = self._unpack_message(part.content(offset, length))
                if data is None:
                    continue
                info = known[(part.number, channel_id)]
                assert info is not None
                yield BagMessage(
                    info.name, info.type, time_ns, publish_time_ns, sequence, data, info, self
                )

    def _channel(
        self, mcap: McapFile, channel_id: int, wanted: set[str] | None
    ) -> TopicInfo | None:
        if channel_id not in mcap.channels:
            mcap.note(f"messages of channel {channel_id}, which nothing describes, are left out")
            return None
        info = self._know(channel_info(mcap, channel_id))
        return None if wanted is not None and info.name not in wanted else info

    def _unpack_message(self, data: bytes) -> bytes | None:
        """A message that rosbag2 compressed, uncompressed, and any other as it is, whatever the
        metadata say: CDR begins otherwise. None, and a problem noted, where it is damaged."""
        if not data.startswith(zstandard.FRAME_HEADER):
            return data
        try:
            parameters = zstandard.get_frame_parameters(data)
            if parameters.content_size > min(MAXIMUM_CHUNK, (64 << 20) + 200 * len(data)):
                raise zstandard.ZstdError("too large")
            return zstandard.ZstdDecompressor().decompress(data, max_output_size=64 << 20)
        except zstandard.ZstdError as error:
            self._problem(f"a compressed message cannot be read ({error})")
            return None

    def _sqlite_messages(
        self, wanted: set[str] | None, start: int | None, stop: int | None
    ) -> Iterator[BagMessage]:
        def of(sqlite: SqliteFile) -> Iterator[tuple[int, TopicInfo, bytes]]:
            known = [self._know(topic) for topic in sqlite.topics]
            try:
                for time_ns, place, raw in sqlite.messages(wanted, start, stop):
                    yield time_ns, known[place], raw
            except InputError as error:
                self._check_open()
                self._problem(str(error))

        self._check_open()
        merged = heapq.merge(*(of(sqlite) for sqlite in self._sqlites), key=lambda item: item[0])
        for time_ns, info, raw in merged:
            data = self._unpack_message(raw)
            if data is not None:
                yield BagMessage(info.name, info.type, time_ns, time_ns, 0, data, info, self)

    # Attachments -----------------------------------------------------------------------------

    def attachments(self) -> Iterator[tuple[AttachmentEntry, bytes]]:
        """Attachments with their content, each name once."""
        seen: set[str] = set()
        for mcap in self._mcaps:
            for entry in mcap.attachments:
                if entry.name not in seen:
                    seen.add(entry.name)
                    data = mcap.attachment(entry)
                    if data is not None:
                        yield entry, data

    def attachment(self, name: str) -> bytes | None:
        """Content of the attachment of a name, None when there is none that can be read."""
        for mcap in self._mcaps:
            for entry in mcap.attachments:
                if entry.name == name:
                    return mcap.attachment(entry)
        return None

    def all_problems(self) -> list[str]:
        """What could not be read so far; complete once all messages were read."""
        found = list(self.problems)
        for mcap in self._mcaps:
            prefix = f"{mcap.path.name}: " if len(self._mcaps) > 1 else ""
            found += [prefix + p for p in mcap.problems]
        return found

    def close(self) -> None:
        """Close all files."""
        for mcap in self._mcaps:
            mcap.close()
        for sqlite in self._sqlites:
            sqlite.close()
        self._mcaps, self._sqlites = [], []
        if self._temporary is not None:
            self._temporary.cleanup()
            self._temporary = None


def open_bag(path: str | Path) -> BagReader:
    """Open a bag: a rosbag2 folder, or a bare .mcap or .db3 file.

    Raises InputError when there is no bag or nothing of it can be read; damage in parts of it is
    listed in `problems` instead.
    """
    return BagReader(path)


def channel_info(mcap: McapFile, channel_id: int) -> TopicInfo:
    """Topic, type and definition of a channel."""
    channel = mcap.channels[channel_id]
    schema = mcap.schemas.get(channel.schema_id)
    name, definition, form = "", "", ""
    if schema is not None:
        name = schema.name
        definition = schema.data.decode(errors="replace")
        form = schema.encoding
    return TopicInfo(
        channel.topic,
        _normal_type(name),
        channel.message_encoding,
        definition,
        form,
        channel.metadata.get("offered_qos_profiles", ""),
    )


def _plain_name(file: Path) -> str:
    """Name of a file of a bag without the ending of a compressed one."""
    return file.name.removesuffix(".zstd")


def _fields(topic: TopicInfo) -> tuple[Any, ...]:
    """Equal for descriptions of a topic whose messages are decoded alike."""
    return topic.encoding, fields_of(topic.type, topic.definition, topic.form)


def _new_decoder(topic: TopicInfo) -> Decoder:
    if topic.encoding != "cdr":
        raise InputError(f"messages are encoded as '{topic.encoding}', only 'cdr' is read")
    if topic.form not in ("", "ros2msg", "ros2idl"):
        raise InputError(f"definition of '{topic.type}' is written in '{topic.form}'")
    return decoder(topic.type, topic.definition if topic.form else "", topic.form or "ros2msg")


def _normal_type(name: str) -> str:
    """ "pkg/Type" as "pkg/msg/Type"."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name
