# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Writing MCAP files, fast and with everything that is known of a message.

docs/dependencies.md has the figures of the libraries beside this: the `mcap` library takes six
times as long for a message, `foxglove-sdk` is as fast and keeps neither publish time nor sequence
number. The library's record classes write every record but messages, chunks and message indexes
(MCAP specification, version 0).
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import IO

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<QQQI")
_HEAD = _MESSAGE.size - _RECORD.size

ZSTD_LEVEL = 1
"""Noisy camera frames get smaller than with level 3, in a seventh of its time; they are read in a
third of it, and wrenches get as small (docs/dependencies.md, "Level of zstd")."""

COMPRESSORS: dict[str, Callable[[], Callable[[bytes], bytes]]] = {
    "zstd": lambda: zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress,
    "lz4": lambda: lz4.frame.compress,
    "none": lambda: bytes,
}
"""Functions that make a compressor; each writer has its own, as they are not thread-safe."""


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


class McapWriter:
    """Writes one MCAP file to a binary stream; `finish` completes it and leaves the stream open.

    compression: "zstd", "lz4" or "none". chunk_size: bytes of a chunk before compression.
    """

    def __init__(self, stream: IO[bytes], chunk_size: int, compression: str) -> None:
        self._stream = stream
        self._chunk_size = chunk_size
        self._compression = "" if compression == "none" else compression
        self._compress = COMPRESSORS[compression]()
        self.size = 0
        """Bytes written."""
        self.start = self.end = 0
        """First and last log time (ns); meaningful once there is a message."""
        self._counts: dict[int, int] = {}
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._begin_chunk()

    @property
    def counts(self) -> dict[int, int]:
        """Messages by channel, the chunk in progress included."""
        waiting = {channel: len(index) // 2 for channel, index in list(self._index.items())}
        return {channel: n + waiting.get(channel, 0) for channel, n in self._counts.items()}

    @property
    def total(self) -> int:
        """Messages added."""
        return sum(self._counts.values()) + len(self._times)

    def write_header(self, profile: str, library: str) -> None:
        """Begin the file."""
        self._write(MAGIC + _bytes_of(Header(profile, library)))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema; gives its id."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        self._add_to_chunk(_bytes_of(schema))
        return schema.id

    def register_channel(self, topic: str, schema_id: int, metadata: dict[str, str]) -> int:
        """Add a channel of CDR messages; gives its id."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="cdr",
            schema_id=schema_id,
            metadata=metadata,
        )
        self._channels.append(channel)
        self._counts[channel.id] = 0
        self._add_to_chunk(_bytes_of(channel))
        return channel.id

    def add_message(
        self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int
    ) -> None:
        """Add a message to the chunk in progress.

        Raises struct.error for a time that is no unsigned 64-bit number of ns.
        """
        length = len(data)
        head = _MESSAGE.pack(5, _HEAD + length, channel_id, sequence, log_time, publish_time)
        index = self._index[channel_id]
        index.append(log_time)
        index.append(self._chunk_bytes)
        self._parts.append(head)
        self._parts.append(data)
        self._times.append(log_time)
        self._chunk_bytes += _MESSAGE.size + length
        if self._chunk_bytes > self._chunk_size:
            self._end_chunk()

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Write a metadata record."""
        record = _bytes_of(Metadata(name=name, metadata=data))
        self._metadata.append(MetadataIndex(offset=self.size, length=len(record), name=name))
        self._write(record)

    def add_attachment(self, time: int, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment."""
        record = _bytes_of(Attachment(time, time, name, media_type, data))
        self._attachments.append(
            AttachmentIndex(
                offset=self.size,
                length=len(record),
                log_time=time,
                create_time=time,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )
        self._write(record)

    def flush(self) -> None:
        """End the chunk in progress and hand everything to the operating system."""
        self._end_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write what is left and the summary."""
        self._end_chunk()
        self._write(_bytes_of(DataEnd(0)))
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self.counts,
            chunk_count=len(self._chunks),
            message_count=self.total,
            metadata_count=len(self._metadata),
            message_start_time=self.start,
            message_end_time=self.end,
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        summary, offsets = io.BytesIO(), io.BytesIO()
        for opcode, records in groups:
            begin, data = self.size + summary.tell(), b"".join(map(_bytes_of, records))
            summary.write(data)
            if data:
                offsets.write(_bytes_of(SummaryOffset(opcode, begin, len(data))))
        start, offset_start = self.size, self.size + summary.tell()
        content = summary.getvalue() + offsets.getvalue()
        # The checksum covers the summary and the footer up to the checksum itself.
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        self._write(content + _bytes_of(Footer(start, offset_start, zlib.crc32(content + footer))))
        self._write(MAGIC)

    # Inside ----------------------------------------------------------------------------------

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self.size += len(data)

    def _begin_chunk(self) -> None:
        self._parts: list[bytes] = []
        self._chunk_bytes = 0
        self._times: list[int] = []
        self._index: dict[int, list[int]] = defaultdict(list)

    def _add_to_chunk(self, data: bytes) -> None:
        self._parts.append(data)
        self._chunk_bytes += len(data)

    def _end_chunk(self) -> None:
        """Write the chunk in progress with its message index; one without messages waits."""
        if not self._times:
            return
        data = b"".join(self._parts)
        stored = self._compress(data)
        first, last = min(self._times), max(self._times)
        name = self._compression
        head = _CHUNK.pack(first, last, len(data), zlib.crc32(data))
        head += struct.pack("<I", len(name)) + name.encode() + struct.pack("<Q", len(stored))
        start = self.size
        self._write(_RECORD.pack(Opcode.CHUNK, len(head) + len(stored)) + head)
        self._write(stored)
        length, offsets = self.size - start, {}
        for channel_id, entries in self._index.items():
            offsets[channel_id] = self.size
            body = struct.pack(f"<HI{len(entries)}Q", channel_id, 8 * len(entries), *entries)
            self._write(_RECORD.pack(Opcode.MESSAGE_INDEX, len(body)) + body)
            self._counts[channel_id] += len(entries) // 2
        self._chunks.append(
            ChunkIndex(
                message_start_time=first,
                message_end_time=last,
                chunk_start_offset=start,
                chunk_length=length,
                message_index_offsets=offsets,
                message_index_length=self.size - start - length,
                compression=name,
                compressed_size=len(stored),
                uncompressed_size=len(data),
            )
        )
        is_first = len(self._chunks) == 1
        self.start = first if is_first else min(self.start, first)
        self.end = last if is_first else max(self.end, last)
        self._begin_chunk()
