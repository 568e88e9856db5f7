"""Reading MCAP files that may be damaged, cut off or hostile, in bounded memory.

The `mcap` library believes a file: it allocates what a length field claims and stops at the first
bad record. Bags come from killed recorders and from other people, so this module walks the records
itself (MCAP specification, "Records") and never allocates more than the file can justify; what
cannot be read is left out and listed in `problems`. The library reads the contents of small
records.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, Header, Metadata, Schema, Statistics

from finger_common.errors import InputError

from .mcap_writer import MAGIC

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 1, 2, 3, 4, 5, 6
ATTACHMENT, STATISTICS, METADATA = 9, 11, 12

MAXIMUM_SMALL_RECORD = 4 << 20
"""Bytes of a schema, channel or metadata record above which it is not read."""

MAXIMUM_SMALL_RECORDS = 64 << 20
"""Bytes of all such records together."""

MAXIMUM_IDLE_RECORDS = 1_000_000
"""Records that hold nothing this reader needs, after which it stops."""

IDLE_RECORDS_PER_CHUNK = 100
"""Records that a chunk adds to that: its message indexes, one a channel, and its chunk index."""

MAXIMUM_CHUNK = 1 << 30
"""Bytes of an uncompressed chunk above which it is not read."""

PLAIN_CHUNK = 64 << 20
"""Bytes above which a chunk must not claim 200 times its compressed size (a zip bomb does)."""

_RATIO = 200
_RUN = 4 << 20  # bytes of unchunked messages that are read at once

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_WHOLE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<QQQI")
_TIMES = 16  # bytes of the two times an attachment begins with

_BROKEN = (McapError, struct.error, ValueError, EOFError, IndexError, MemoryError, OverflowError)


RawMessage = tuple[int, int, int, int, bytes]
"""log_time_ns, channel_id, sequence, publish_time_ns, CDR bytes."""


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
class AttachmentEntry:
    """Where an attachment is; `McapFile.attachment` reads it."""

    name: str
    media_type: str
    offset: int
    size: int


class McapFile:
    """One MCAP file, walked once when it is opened.

    `problems` lists what is wrong with it; `complete`: whether it was closed by its
    writer. Raises InputError when it is no MCAP file at all or cannot be opened.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.problems: list[str] = []
        self.profile = ""
        self.library = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.regions: list[Region] = []
        self.attachments: list[AttachmentEntry] = []
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.statistics: Statistics | None = None
        self.complete = False
        self._small_bytes = 0
        self._idle = 0
        try:
            self._stream: IO[bytes] = open(self.path, "rb")
            self._length = self.path.stat().st_size
        except FileNotFoundError:
            raise InputError(f"{path}: no such bag file; check the path") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from None
        try:
            begin = self._stream.read(1024)
            if not begin:
                raise InputError(f"{path}: file is empty; record the bag again")
            if not begin.startswith(MAGIC):
                raise InputError(f"{path}: the file is {_kind_of(begin)}")
            self._walk()
            if not self.complete or not self.channels:
                self._find_channels()
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

    def _problem(self, text: str) -> None:
        if len(self.problems) < 50 and text not in self.problems:
            self.problems.append(text)

    # The walk over the records ---------------------------------------------------------------

    def _walk(self) -> None:
        position = len(MAGIC)
        run: list[int] = []  # offset, end, first and last log time of unchunked messages
        ended = False
        while position + _RECORD.size <= self._length:
            self._stream.seek(position)
            opcode, length = _RECORD.unpack(self._stream.read(_RECORD.size))
            body = position + _RECORD.size
            end = body + length
            if opcode == 0 or end > self._length:
                self._stream.seek(position)
                if position + len(MAGIC) == self._length and self._stream.read() == MAGIC:
                    break
                self._problem(f"record at byte {position} is cut off or damaged")
                self._flush_run(run)
                position = self._next_chunk(position + 1)
                continue
            if opcode == MESSAGE:
                self._extend_run(run, position, end)
            else:
                self._flush_run(run)
                self._take(opcode, body, length)
                ended = ended or opcode == FOOTER
                self._idle += opcode != CHUNK
                allowed = MAXIMUM_IDLE_RECORDS + IDLE_RECORDS_PER_CHUNK * len(self.regions)
                if self._idle > allowed:
                    self._problem(f"more than {allowed} records without messages")
                    break
            position = end
        self._flush_run(run)
        self._stream.seek(max(0, self._length - len(MAGIC)))
        self.complete = ended and self._stream.read() == MAGIC
        if not self.complete:
            self._problem("file was not closed by its recorder")

    def _extend_run(self, run: list[int], position: int, end: int) -> None:
        head = self._stream.read(_MESSAGE.size)
        if len(head) < _MESSAGE.size or end - position < _RECORD.size + _MESSAGE.size:
            self._problem(f"message at byte {position} is too short")
            self._flush_run(run)
            return
        log_time = _MESSAGE.unpack(head)[2]
        if run and end - run[0] > _RUN:
            self._flush_run(run)
        if not run:
            run += [position, end, log_time, log_time]
        else:
            run[1:] = [end, min(run[2], log_time), max(run[3], log_time)]

    def _flush_run(self, run: list[int]) -> None:
        if run:
            offset, end, first, last = run
            size = end - offset
            self.regions.append(Region(offset, size, size, "", 0, first, last))
            run.clear()

    def _take(self, opcode: int, body: int, length: int) -> None:
        if opcode == CHUNK:
            self._take_chunk(body, length)
        elif opcode == ATTACHMENT:
            self._take_attachment(body, length)
        elif opcode in (HEADER, SCHEMA, CHANNEL, METADATA, STATISTICS):
            if length > MAXIMUM_SMALL_RECORD:
                self._problem(f"record at byte {body} claims {length} bytes and was not read")
                return
            if self._small_bytes + length > MAXIMUM_SMALL_RECORDS:
                self._problem(
                    "more schemas, channels and metadata than a bag has; not all were read"
                )
                return
            self._small_bytes += length
            self._stream.seek(body)
            self._take_small(opcode, self._stream.read(length), body)

    def _take_small(self, opcode: int, data: bytes, where: int) -> None:
        stream = ReadDataStream(io.BytesIO(data))
        try:
            if opcode == HEADER:
                header = Header.read(stream)
                self.profile, self.library = header.profile, header.library
            elif opcode == SCHEMA:
                schema = Schema.read(stream)
                self.schemas.setdefault(schema.id, schema)
            elif opcode == CHANNEL:
                channel = Channel.read(stream)
                self.channels.setdefault(channel.id, channel)
            elif opcode == METADATA:
                record = Metadata.read(stream)
                if len(self.metadata) < 1000:
                    self.metadata.append((record.name, record.metadata))
            elif opcode == STATISTICS:
                self.statistics = Statistics.read(stream)
        except _BROKEN:
            self._problem(f"record at byte {where} cannot be parsed")

    def _take_chunk(self, body: int, length: int) -> None:
        self._stream.seek(body)
        head = self._stream.read(min(length, _CHUNK.size + 4))
        try:
            start, end, size, crc = _CHUNK.unpack_from(head)
            (name_length,) = struct.unpack_from("<I", head, _CHUNK.size)
            if name_length > 16:
                raise ValueError
            tail = self._stream.read(name_length + 8)
            compression = tail[:name_length].decode("ascii")
            (stored,) = struct.unpack("<Q", tail[name_length:])
        except (struct.error, ValueError):
            self._problem(f"chunk at byte {body} cannot be parsed")
            return
        offset = body + len(head) + len(tail)
        if stored > body + length - offset:
            self._problem(f"chunk at byte {body} claims more bytes than it has")
            return
        if compression not in ("", "zstd", "lz4"):
            self._problem(f"chunk at byte {body} is compressed with '{compression}', unknown")
            return
        self.regions.append(Region(offset, stored, size, compression, crc, start, end))

    def _take_attachment(self, body: int, length: int) -> None:
        self._stream.seek(body)
        head = ReadDataStream(io.BytesIO(self._stream.read(min(length, 64 << 10))))
        try:
            head.read(_TIMES)
            name, media_type = head.read_prefixed_string(), head.read_prefixed_string()
            size, position = head.read8(), head.count
            if position + size > length:
                raise ValueError
        except _BROKEN:
            self._problem(f"attachment at byte {body} cannot be parsed")
            return
        if len(self.attachments) < 1000:
            self.attachments.append(AttachmentEntry(name, media_type, body + position, size))

    def _next_chunk(self, position: int) -> int:
        """Where, after damage, the next plausible chunk begins; the file's length if none does."""
        patterns = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")
        before = _RECORD.size + _CHUNK.size
        overlap = 64
        while position < self._length:
            self._stream.seek(position)
            block = self._stream.read(_RUN)
            found = sorted(
                index - before
                for pattern in patterns
                for index in _indices(block, pattern)
                if index >= before
            )
            for index in found:
                opcode, length = _RECORD.unpack_from(block, index)
                if opcode == CHUNK and position + index + _RECORD.size + length <= self._length:
                    return position + index
            if position + len(block) >= self._length:
                break
            position += max(1, len(block) - overlap)
        return self._length

    def _find_channels(self) -> None:
        """Schemas and channels from inside the chunks, for a file without a summary."""
        for region in self.regions:
            self.messages(region, skip=True)

    # Content ---------------------------------------------------------------------------------

    def content(self, region: Region) -> bytes | None:
        """Uncompressed bytes of a region; None, and a problem noted, when they are damaged."""
        where = f"chunk at byte {region.offset}"
        if region.size > MAXIMUM_CHUNK or (
            region.size > PLAIN_CHUNK and region.size > _RATIO * region.stored
        ):
            self._problem(f"{where} claims {region.size} bytes from {region.stored}; not read")
            return None
        self._stream.seek(region.offset)
        stored = self._stream.read(region.stored)
        try:
            if region.compression == "zstd":
                data = _zstd(stored, region.size)
            elif region.compression == "lz4":
                decompressor = lz4.frame.LZ4FrameDecompressor()
                data = decompressor.decompress(stored, max_length=region.size + 1)
            else:
                data = stored
        except (zstandard.ZstdError, RuntimeError, *_BROKEN):
            self._problem(f"{where} cannot be uncompressed")
            return None
        if len(data) != region.size:
            self._problem(f"{where} has {len(data)} bytes, {region.size} are claimed")
            return None
        if region.crc and zlib.crc32(data) != region.crc:
            self._problem(f"{where} does not match its checksum")
            return None
        return data

    def messages(self, region: Region, skip: bool = False) -> list[RawMessage]:
        """Messages of a region in the order they were written; takes schemas and channels on the
        way.

        skip: take only schemas and channels.
        """
        found: list[RawMessage] = []
        data = self.content(region)
        if data is None:
            return found
        add, unpack = found.append, _WHOLE.unpack_from
        position, size = 0, len(data)
        # Padded, so that one unpacking serves records shorter than a message at the very end too.
        padded = data + bytes(_WHOLE.size)
        while position + _RECORD.size <= size:
            opcode, length, channel, sequence, log_time, publish_time = unpack(padded, position)
            end = position + _RECORD.size + length
            if end > size or opcode == 0 or (opcode == MESSAGE and length < _MESSAGE.size):
                break
            if opcode == MESSAGE:
                if not skip:
                    content = data[position + _WHOLE.size : end]
                    add((log_time, channel, sequence, publish_time, content))
            elif opcode in (SCHEMA, CHANNEL) and length <= MAXIMUM_SMALL_RECORD:
                self._take_small(opcode, data[position + _RECORD.size : end], region.offset)
            position = end
        if position != size:
            self._problem(f"chunk at byte {region.offset} holds a damaged record")
        return found

    def attachment(self, entry: AttachmentEntry) -> bytes:
        """Content of an attachment."""
        self._stream.seek(entry.offset)
        return self._stream.read(entry.size)


_SIGNATURES = {
    b"#ROSBAG": "a ROS 1 bag, not MCAP: convert it with 'rosbags-convert'",
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
    with zstandard.ZstdDecompressor(max_window_size=1 << 31).stream_reader(
        io.BytesIO(stored), read_across_frames=True
    ) as reader:
        data = reader.read(size)
        if reader.read(1):
            raise ValueError("more data than claimed")
        return data
