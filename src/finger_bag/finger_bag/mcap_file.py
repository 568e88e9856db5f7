# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Reading MCAP files that may be damaged, cut off or hostile, in bounded memory.

The `mcap` library believes a file: it allocates what a length field claims and stops at the first
bad record. Bags come from killed recorders and from other people, so this module walks the records
itself (MCAP specification, "Records") and never allocates more than the file can justify; what
cannot be read is left out and listed in `problems`. The library reads the contents of small
records.

What a file holds is known from its summary, where that is whole. Before messages are read, all
records are walked once. Limits grow with the file, so a long bag meets none of them. One that is
met is a problem, and `lost` is set.
"""

from __future__ import annotations

import io
import struct
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import (
    AttachmentIndex,
    Channel,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from finger_common.errors import InputError

from .mcap_writer import MAGIC

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 1, 2, 3, 4, 5, 6
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX = 9, 10, 11, 12, 13

MAXIMUM_SMALL_RECORD = 4 << 20
"""Bytes of a schema, channel or metadata record above which it is not read."""

MAXIMUM_TOPICS = 5000
"""Channels, and schemas, of a file that are read; a robot's recording has hundreds."""

MAXIMUM_ATTACHMENT = 256 << 20
"""Bytes of an attachment above which it is not read."""

MAXIMUM_CHUNK = 1 << 30
"""Bytes of an uncompressed chunk above which it is not read."""

PLAIN_CHUNK = 64 << 20
"""Bytes above which a chunk must not claim 200 times its compressed size (a zip bomb does)."""

FREE_BYTES, BYTES_PER_STORED = 1 << 30, 1000
"""All chunks of a file may claim 1 GiB, and 1000 bytes more for each byte of the file."""

FREE_MESSAGES, STORED_PER_MESSAGE = 200_000, 2
"""Messages that any file may hold, and bytes of it that justify a further one.

A message whose times differ from those of the last one takes 3 to 4 bytes at the least (zstd).
"""

_RATIO = 200
_RUN = 4 << 20  # bytes of unchunked messages that are read at once
_BLOCK = 1 << 20  # bytes of the summary that its checksum takes at once
_WINDOW = 1 << 27  # bytes: window of zstd that its own tools accept too

_RECORD = struct.Struct("<BQ")
RECORD_HEAD = _RECORD.size
"""Bytes of a record before its body: opcode and length."""
_MESSAGE = struct.Struct("<HIQQ")
WHOLE_MESSAGE = struct.Struct("<BQHIQQ")
"""opcode, length, channel id, sequence, log time (ns), publish time (ns); then the CDR bytes."""
_CHUNK = struct.Struct("<QQQI")
_FOOTER = struct.Struct("<BQQQI")
_TIMES = 16  # bytes of the two times an attachment begins with

_BROKEN = (McapError, struct.error, ValueError, EOFError, IndexError, MemoryError, OverflowError)


@dataclass(frozen=True)
class Region:
    """A piece of the file that holds messages: a chunk, or a run of messages outside chunks."""

    offset: int
    """Of the stored bytes."""
    stored: int
    size: int
    """Bytes once uncompressed."""
    compression: str
    crc: int
    start_ns: int
    end_ns: int


@dataclass(frozen=True)
class Block:
    """A region uncompressed: where its messages begin, in the order they were written.

    times (n,): log times in ns, uint64; channels (n,): their ids; offsets (n,): of the message
    records in `data`, to be read with `WHOLE_MESSAGE`.
    """

    data: bytes
    times: np.ndarray
    channels: np.ndarray
    offsets: np.ndarray


@dataclass(frozen=True)
class AttachmentEntry:
    """Where an attachment is; `McapFile.attachment` reads it."""

    name: str
    media_type: str
    offset: int
    size: int


class McapFile:
    """One MCAP file.

    `problems` lists what is wrong with it, completely once all messages were read; `lost`: whether
    something that is in the file was left out; `complete`: whether it was closed by its writer.
    start_ns, end_ns: first and last log time, None without messages. Raises InputError when it is
    no MCAP file at all or cannot be opened.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.problems: list[str] = []
        self.lost = False
        self.profile = ""
        self.library = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.attachments: list[AttachmentEntry] = []
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.statistics: Statistics | None = None
        self.complete = False
        self.start_ns: int | None = None
        self.end_ns: int | None = None
        self._regions: list[Region] | None = None
        self._claimed = 0
        self._allowed: dict[int, int] = {}
        self._chunk_starts: Iterator[int] | None = None
        try:
            self._stream: IO[bytes] = open(self.path, "rb")
            self._length = self.path.stat().st_size
        except FileNotFoundError:
            raise InputError(f"{path}: no such bag file; check the path") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from None
        except ValueError:
            raise InputError(f"{str(path)!r}: not a file name; check the path") from None
        self._messages_left = FREE_MESSAGES + self._length // STORED_PER_MESSAGE
        try:
            begin = self._stream.read(1024)
            if not begin:
                raise InputError(f"{path}: file is empty; record the bag again")
            if not begin.startswith(MAGIC):
                raise InputError(f"{path}: the file is {_kind_of(begin)}")
            if not self._read_summary():
                regions = self.regions
                self.start_ns = min((r.start_ns for r in regions), default=None)
                self.end_ns = max((r.end_ns for r in regions), default=None)
                if not self.complete or not self.channels:
                    # Schemas and channels are inside the chunks too.
                    for region in regions:
                        self.block(region)
        except OSError as error:
            self._stream.close()
            raise InputError(f"{path}: cannot be read ({error.strerror})") from None
        except BaseException:
            self._stream.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def __enter__(self) -> McapFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def regions(self) -> list[Region]:
        """Where messages are, in the order of the file; walks all records the first time."""
        if self._regions is None:
            self._regions = []
            self._walk(self._regions)
        return self._regions

    def note(self, text: str, lost: bool = True) -> None:
        """Add a problem; lost: whether something that is in the file is left out for it."""
        self.lost = self.lost or lost
        if len(self.problems) < 50 and text not in self.problems:
            self.problems.append(text)

    def _read(self, position: int, size: int) -> bytes:
        """Bytes at a place that was inside the file when it was opened; fewer, and a problem noted,
        where the file has become shorter."""
        self._stream.seek(position)
        data = self._stream.read(size)
        if len(data) < size:
            self.note("the file became shorter while it was read")
        return data

    # The summary -----------------------------------------------------------------------------

    def _read_summary(self) -> bool:
        """Take what the file holds from its summary; False where that is absent or not whole."""
        ending = _FOOTER.size + len(MAGIC)
        if self._length < len(MAGIC) + ending:
            return False
        tail = self._read(self._length - ending, ending)
        if len(tail) < ending:
            return False
        opcode, length, start, _, crc = _FOOTER.unpack_from(tail)
        end = self._length - ending
        whole = (opcode, length) == (FOOTER, _FOOTER.size - _RECORD.size) and tail.endswith(MAGIC)
        if not whole or not len(MAGIC) <= start < end:
            return False
        if crc and crc != self._checksum(start, end, tail[: _FOOTER.size - 4]):
            return False
        found: dict[int, list[int]] = {}
        for opcode, body, length in self._records(start, end):
            if opcode in (SCHEMA, CHANNEL, STATISTICS, ATTACHMENT_INDEX, METADATA_INDEX):
                self._take(opcode, body, length)
                found.setdefault(opcode, []).append(body)
        statistics = self.statistics
        counted = statistics is not None and (
            statistics.schema_count == len(self.schemas)
            and statistics.channel_count == len(self.channels)
            and statistics.attachment_count == len(self.attachments)
            and statistics.metadata_count == len(self.metadata)
            and statistics.message_count == sum(statistics.channel_message_counts.values())
        )
        if not counted or self.problems:
            self._forget()
            return False
        assert statistics is not None
        self._stream.seek(len(MAGIC))
        begin = self._stream.read(_RECORD.size)
        if len(begin) == _RECORD.size and begin[0] == HEADER:
            self._take(HEADER, len(MAGIC) + _RECORD.size, _RECORD.unpack(begin)[1])
        if statistics.message_count:
            self.start_ns = statistics.message_start_time
            self.end_ns = statistics.message_end_time
        self.complete = True
        return True

    def _forget(self) -> None:
        """Begin again: what the summary said is not believed."""
        self.problems, self.lost, self.statistics = [], False, None
        self.schemas, self.channels, self.attachments, self.metadata = {}, {}, [], []

    def _checksum(self, start: int, end: int, footer: bytes) -> int:
        self._stream.seek(start)
        crc = 0
        while start < end and (block := self._stream.read(min(_BLOCK, end - start))):
            crc, start = zlib.crc32(block, crc), start + len(block)
        return zlib.crc32(footer, crc)

    def _records(self, position: int, end: int) -> Iterator[tuple[int, int, int]]:
        """(opcode, place of the body, length) of records, up to the first that does not fit."""
        while position + _RECORD.size <= end:
            head = self._read(position, _RECORD.size)
            if len(head) < _RECORD.size:
                return
            opcode, length = _RECORD.unpack(head)
            body = position + _RECORD.size
            if body + length > end:
                return
            yield opcode, body, length
            position = body + length

    # The walk over the records ---------------------------------------------------------------

    def _walk(self, regions: list[Region]) -> None:
        self.attachments, self.metadata = [], []  # those of the summary come again
        position = len(MAGIC)
        run: list[int] = []  # offset, end, first and last log time of unchunked messages
        ended = False
        self._stream.seek(max(0, self._length - len(MAGIC)))
        closed = self._stream.read() == MAGIC
        while position + _RECORD.size <= self._length:
            head = self._read(position, _RECORD.size)
            if len(head) < _RECORD.size:
                break
            opcode, length = _RECORD.unpack(head)
            body = position + _RECORD.size
            end = body + length
            if opcode == 0 or end > self._length:
                if position + len(MAGIC) == self._length and closed:
                    break
                self._flush_run(run, regions)
                found = self._next_chunk(position + 1)
                # Nothing is left out where a killed recorder's last record is cut off.
                cut = found == self._length and not closed
                self.note(f"record at byte {position} is cut off or damaged", lost=not cut)
                position = found
                continue
            if opcode == MESSAGE:
                self._extend_run(run, position, end, regions)
            else:
                self._flush_run(run, regions)
                if opcode == CHUNK:
                    self._take_chunk(body, length, regions)
                elif opcode in (HEADER, SCHEMA, CHANNEL, ATTACHMENT, METADATA, STATISTICS):
                    self._take(opcode, body, length)
                ended = ended or opcode == FOOTER
            position = end
        self._flush_run(run, regions)
        self.complete = ended and closed
        if not self.complete:
            self.note("file was not closed by its recorder", lost=False)

    def _extend_run(self, run: list[int], position: int, end: int, regions: list[Region]) -> None:
        head = self._stream.read(_MESSAGE.size)
        if len(head) < _MESSAGE.size or end - position < _RECORD.size + _MESSAGE.size:
            self.note(f"message at byte {position} is too short")
            self._flush_run(run, regions)
            return
        log_time = _MESSAGE.unpack(head)[2]
        if run and end - run[0] > _RUN:
            self._flush_run(run, regions)
        if not run:
            run += [position, end, log_time, log_time]
        else:
            run[1:] = [end, min(run[2], log_time), max(run[3], log_time)]

    def _flush_run(self, run: list[int], regions: list[Region]) -> None:
        if run:
            offset, end, first, last = run
            size = end - offset
            regions.append(Region(offset, size, size, "", 0, first, last))
            run.clear()

    def _take(self, opcode: int, body: int, length: int) -> None:
        if opcode == ATTACHMENT:
            self._take_attachment(body, length)
        elif length > MAXIMUM_SMALL_RECORD:
            self.note(f"record at byte {body} claims {length} bytes and was not read")
        else:
            self._take_small(opcode, self._read(body, length), body)

    def _take_small(self, opcode: int, data: bytes, where: int) -> None:
        stream = ReadDataStream(io.BytesIO(data))
        try:
            if opcode == HEADER:
                header = Header.read(stream)
                self.profile, self.library = header.profile, header.library
            elif opcode == SCHEMA:
                schema = Schema.read(stream)
                self._keep(self.schemas, schema, "schemas")
            elif opcode == CHANNEL:
                channel = Channel.read(stream)
                self._keep(self.channels, channel, "channels")
            elif opcode == METADATA:
                record = Metadata.read(stream)
                if len(self.metadata) < 1000:
                    self.metadata.append((record.name, record.metadata))
            elif opcode == STATISTICS:
                self.statistics = Statistics.read(stream)
            elif opcode == ATTACHMENT_INDEX:
                self._take_at(ATTACHMENT, AttachmentIndex.read(stream).offset)
            elif opcode == METADATA_INDEX:
                self._take_at(METADATA, MetadataIndex.read(stream).offset)
        except _BROKEN:
            self.note(f"record at byte {where} cannot be parsed")

    def _keep(self, known: dict[int, Any], record: Any, what: str) -> None:
        if len(known) < MAXIMUM_TOPICS or record.id in known:
            known.setdefault(record.id, record)
        else:
            self.note(f"more than {MAXIMUM_TOPICS} {what}; not all are read")

    def _take_at(self, opcode: int, position: int) -> None:
        """Take the record that an index names; raises ValueError when it is not there."""
        if position > self._length - _RECORD.size:
            raise ValueError
        found, length = _RECORD.unpack(self._read(position, _RECORD.size))
        if found != opcode or position + _RECORD.size + length > self._length:
            raise ValueError
        self._take(opcode, position + _RECORD.size, length)

    def _take_chunk(self, body: int, length: int, regions: list[Region]) -> None:
        head = self._read(body, min(length, _CHUNK.size + 4))
        try:
            start, end, size, crc = _CHUNK.unpack_from(head)
            (name_length,) = struct.unpack_from("<I", head, _CHUNK.size)
            if name_length > 16:
                raise ValueError
            tail = self._stream.read(name_length + 8)
            compression = tail[:name_length].decode("ascii")
            (stored,) = struct.unpack("<Q", tail[name_length:])
        except (struct.error, ValueError):
            self.note(f"chunk at byte {body} cannot be parsed")
            return
        offset = body + len(head) + len(tail)
        if stored > body + length - offset:
            self.note(f"chunk at byte {body} claims more bytes than it has")
            return
        if compression not in ("", "zstd", "lz4"):
            self.note(f"chunk at byte {body} is compressed with '{compression}', unknown")
            return
        if size > MAXIMUM_CHUNK or (size > PLAIN_CHUNK and size > _RATIO * stored):
            self.note(f"chunk at byte {body} claims {size} bytes from {stored}; not read")
            return
        if self._claimed + size > FREE_BYTES + BYTES_PER_STORED * self._length:
            self.note("chunks claim more than a file of its size can hold; not all are read")
            return
        self._claimed += size
        regions.append(Region(offset, stored, size, compression, crc, start, end))

    def _take_attachment(self, body: int, length: int) -> None:
        head = ReadDataStream(io.BytesIO(self._read(body, min(length, 64 << 10))))
        try:
            head.read(_TIMES)
            name, media_type = head.read_prefixed_string(), head.read_prefixed_string()
            size, position = head.read8(), head.count
            if position + size > length:
                raise ValueError
        except _BROKEN:
            self.note(f"attachment at byte {body} cannot be parsed")
            return
        if len(self.attachments) < 1000:
            self.attachments.append(AttachmentEntry(name, media_type, body + position, size))

    def _next_chunk(self, position: int) -> int:
        """Where, after damage, the next plausible chunk begins; the file's length if none does."""
        if self._chunk_starts is None:
            self._chunk_starts = self._plausible_chunks(position)
        for found in self._chunk_starts:
            if found >= position:
                return found
        return self._length

    def _plausible_chunks(self, position: int) -> Iterator[int]:
        patterns = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")
        before = _RECORD.size + _CHUNK.size
        overlap = 64
        while position < self._length:
            size = min(_RUN, self._length - position)
            block = self._read(position, size)
            last = len(block) < size or position + size == self._length
            end = len(block) if last else len(block) - overlap
            found = sorted(
                index - before
                for pattern in patterns
                for index in _indices(block, pattern)
                if before <= index < end + before
            )
            for index in found:
                opcode, length = _RECORD.unpack_from(block, index)
                if opcode == CHUNK and position + index + _RECORD.size + length <= self._length:
                    yield position + index
            if last:
                return
            position += end

    # Content ---------------------------------------------------------------------------------

    def content(self, region: Region) -> bytes | None:
        """Uncompressed bytes of a region; None, and a problem noted, when they are damaged or
        gone."""
        where = f"chunk at byte {region.offset}"
        stored = self._read(region.offset, region.stored)
        if len(stored) < region.stored:
            return None
        try:
            if region.compression == "zstd":
                data = _zstd(stored, region.size)
            elif region.compression == "lz4":
                decompressor = lz4.frame.LZ4FrameDecompressor()
                data = decompressor.decompress(stored, max_length=region.size + 1)
            else:
                data = stored
        except (zstandard.ZstdError, RuntimeError, *_BROKEN):
            self.note(f"{where} cannot be uncompressed")
            return None
        if len(data) != region.size:
            self.note(f"{where} has {len(data)} bytes, {region.size} are claimed")
            return None
        if region.crc and zlib.crc32(data) != region.crc:
            self.note(f"{where} does not match its checksum")
            return None
        return data

    def block(self, region: Region) -> Block:
        """Content of a region and where its messages are; takes schemas and channels on the way.

        Damage gives the messages before it, and is noted.
        """
        times, channels, offsets = array("Q"), array("H"), array("L")
        data = self.content(region) or b""
        allowed = self._allowed.get(region.offset, self._messages_left)
        unpack, add_offset, head = WHOLE_MESSAGE.unpack_from, offsets.append, WHOLE_MESSAGE.size
        add_time, add_channel = times.append, channels.append
        position, size = 0, len(data)
        last = size - head
        while position + _RECORD.size <= size:
            if position <= last:
                opcode, length, channel, _, log_time, _ = unpack(data, position)
            else:
                opcode, length = _RECORD.unpack_from(data, position)
            end = position + _RECORD.size + length
            if end > size or opcode == 0 or (opcode == MESSAGE and length < _MESSAGE.size):
                break
            if opcode == MESSAGE:
                if len(offsets) == allowed:
                    self.note("more messages than a file of its size holds; not all are read")
                    position = size
                    break
                add_time(log_time)
                add_channel(channel)
                add_offset(position)
            elif opcode in (SCHEMA, CHANNEL) and length <= MAXIMUM_SMALL_RECORD:
                self._take_small(opcode, data[position + _RECORD.size : end], region.offset)
            position = end
        if position != size:
            self.note(f"chunk at byte {region.offset} holds a damaged record")
        if region.offset not in self._allowed:
            self._allowed[region.offset] = len(offsets)
            self._messages_left -= len(offsets)
        return Block(
            data,
            np.frombuffer(times, np.uint64),
            np.frombuffer(channels, np.uint16),
            np.frombuffer(offsets, f"u{offsets.itemsize}"),
        )

    def attachment(self, entry: AttachmentEntry) -> bytes | None:
        """Content of an attachment; None, and a problem noted, when it is too large or gone."""
        if entry.size > MAXIMUM_ATTACHMENT:
            self.note(f"attachment '{entry.name}' has {entry.size} bytes and was not read")
            return None
        data = self._read(entry.offset, entry.size)
        return data if len(data) == entry.size else None


_SIGNATURES = {
    b"#ROSBAG": "a ROS 1 bag, not MCAP: convert it with 'rosbags-convert --src FILE --dst NAME'",
    b"SQLite format 3": "a sqlite3 database, not MCAP: name it .db3",
    b"\x28\xb5\x2f\xfd": "zstd-compressed, not MCAP: unpack it, or name it .mcap.zstd",
    b"\x1f\x8b": "gzip-compressed, not MCAP: unpack it",
    b"PK\x03\x04": "a zip archive, not MCAP: unpack it",
    b"\x89PNG": "a PNG image, not MCAP: use 'finger-vision area'",
    b"\xff\xd8\xff": "a JPEG image, not MCAP: use 'finger-vision area'",
}


def _kind_of(begin: bytes) -> str:
    """What a file is that is no MCAP file, by its first bytes, with what to do with it."""
    for signature, text in _SIGNATURES.items():
        if begin.startswith(signature):
            return text
    if any(byte < 9 for byte in begin):
        return "not MCAP: give a recorded bag"
    if b"," in begin.partition(b"\n")[0]:
        return "a CSV, not MCAP: use 'finger-model simulate --force', or give a recorded bag"
    return "text, not MCAP: give a recorded bag"


def _indices(block: bytes, pattern: bytes) -> Iterator[int]:
    index = block.find(pattern)
    while index >= 0:
        yield index
        index = block.find(pattern, index + 1)


def _zstd(stored: bytes, size: int) -> bytes:
    """Uncompress exactly one chunk without ever holding more than it claims."""
    if zstandard.frame_content_size(stored) == size:  # In one go, which takes half the time.
        whole = zstandard.ZstdDecompressor(max_window_size=max(_WINDOW, size))
        return whole.decompress(stored, max_output_size=size, allow_extra_data=False)
    with zstandard.ZstdDecompressor(max_window_size=max(_WINDOW, size)).stream_reader(
        io.BytesIO(stored), read_across_frames=True
    ) as reader:
        data = reader.read(size)
        if reader.read(1):
            raise ValueError("more data than claimed")
        return data
