# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Damage to bag files: random bytes, cuts, swapped pieces, and the tricks of hostile files."""

from __future__ import annotations

import io
import struct
import zlib

import numpy as np
import zstandard
from mcap.writer import CompressionType, Writer

MAGIC = b"\x89MCAP0\r\n"


def flip_bits(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 20))):
        out[int(rng.integers(len(out)))] ^= 1 << int(rng.integers(8))
    return bytes(out)


def truncate(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(len(data)))]


def zero_stretch(data: bytes, rng: np.random.Generator) -> bytes:
    begin = int(rng.integers(len(data)))
    length = int(rng.integers(1, 5000))
    return data[:begin] + bytes(min(length, len(data) - begin)) + data[begin + length :]


def drop_stretch(data: bytes, rng: np.random.Generator) -> bytes:
    begin = int(rng.integers(len(data)))
    return data[:begin] + data[begin + int(rng.integers(1, 3000)) :]


def repeat_stretch(data: bytes, rng: np.random.Generator) -> bytes:
    begin, length = int(rng.integers(len(data))), int(rng.integers(1, 3000))
    return data[: begin + length] + data[begin : begin + length] + data[begin + length :]


def swap_stretches(data: bytes, rng: np.random.Generator) -> bytes:
    a, b, c = sorted(int(i) for i in rng.integers(0, len(data), 3))
    return data[:a] + data[b:c] + data[a:b] + data[c:]


def append_noise(data: bytes, rng: np.random.Generator) -> bytes:
    return data + rng.bytes(int(rng.integers(1, 2000)))


def huge_length(data: bytes, rng: np.random.Generator) -> bytes:
    """An 8- or 4-byte length field somewhere claims an enormous size."""
    out = bytearray(data)
    size = int(rng.choice([4, 8]))
    at = int(rng.integers(8, max(9, len(out) - size)))
    value = int(rng.choice([2**31, 2**32 - 1])) if size == 4 else int(rng.integers(2**40, 2**62))
    out[at : at + size] = value.to_bytes(size, "little")
    return bytes(out)


def records(data: bytes) -> list[tuple[int, int, int]]:
    """(opcode, start, end) of the records of a whole file."""
    position, found = len(MAGIC), []
    while position + 9 <= len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, position)
        found.append((opcode, position, position + 9 + length))
        position += 9 + length
    return found


def shuffle_records(data: bytes, rng: np.random.Generator) -> bytes:
    pieces = [data[a:b] for _, a, b in records(data)]
    order = rng.permutation(len(pieces))
    return MAGIC + b"".join(pieces[i] for i in order) + MAGIC


def change_record(data: bytes, rng: np.random.Generator) -> bytes:
    """Another opcode or length of one record."""
    _, begin, _ = records(data)[int(rng.integers(len(records(data))))]
    out = bytearray(data)
    if rng.integers(2):
        out[begin] = int(rng.integers(256))
    else:
        out[begin + 1 : begin + 9] = int(rng.integers(2**63)).to_bytes(8, "little")
    return bytes(out)


def change_inside_chunk(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage within a chunk's content, with a checksum that fits, so that it is parsed."""
    chunks = [(a, b) for opcode, a, b in records(data) if opcode == 6]
    begin, end = chunks[int(rng.integers(len(chunks)))]
    body = data[begin + 9 : end]
    start, stop, size, _ = struct.unpack_from("<QQQI", body)
    (name,) = struct.unpack_from("<I", body, 28)
    stored = body[32 + name + 8 :]
    content = bytearray(zstandard.ZstdDecompressor().decompress(stored, max_output_size=size))
    for _ in range(int(rng.integers(1, 10))):
        at = int(rng.integers(len(content)))
        content[at] = int(rng.integers(256))
    if rng.integers(4) == 0:
        content = content[: int(rng.integers(1, len(content)))]
    packed = zstandard.compress(bytes(content))
    new = (
        struct.pack("<QQQI", start, stop, len(content), zlib.crc32(bytes(content)))
        + body[28 : 32 + name]
        + struct.pack("<Q", len(packed))
        + packed
    )
    return data[:begin] + struct.pack("<BQ", 6, len(new)) + new + data[end:]


MUTATIONS = (
    flip_bits,
    truncate,
    zero_stretch,
    drop_stretch,
    repeat_stretch,
    swap_stretches,
    append_noise,
    huge_length,
    shuffle_records,
    change_record,
    change_inside_chunk,
)


def chunk(content: bytes, packed: bytes, claimed: int, compression: bytes = b"zstd") -> bytes:
    """A chunk record with claims of its own."""
    body = (
        struct.pack("<QQQI", 0, 1, claimed, zlib.crc32(content) if content else 0)
        + struct.pack("<I", len(compression))
        + compression
        + struct.pack("<Q", len(packed))
        + packed
    )
    return struct.pack("<BQ", 6, len(body)) + body


def header() -> bytes:
    body = struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)
    return MAGIC + struct.pack("<BQ", 1, len(body)) + body


def ending() -> bytes:
    return struct.pack("<BQI", 15, 4, 0) + struct.pack("<BQQQI", 2, 20, 0, 0, 0) + MAGIC


def truthful_bomb() -> bytes:
    """8 GiB of zeros in a chunk that states this size."""
    context = zstandard.ZstdCompressor(level=1)
    stream = context.compressobj()
    block = bytes(1 << 24)
    packed = b"".join(stream.compress(block) for _ in range(8)) * 1
    return header() + chunk(b"", packed + stream.flush(), 8 << 30) + ending()


def lying_bomb() -> bytes:
    """1 GiB of zeros in a chunk that claims 1000 bytes."""
    packed = zstandard.ZstdCompressor(level=1).compress(bytes(1 << 27))
    return header() + chunk(b"", packed, 1000) + ending()


def many_bombs(number: int = 200) -> bytes:
    """Chunks of 60 MiB of zeros each, the most that is uncompressed at all."""
    packed = zstandard.ZstdCompressor(level=1).compress(bytes(60 << 20))
    return header() + chunk(b"", packed, 60 << 20) * number + ending()


def deep_schema() -> bytes:
    """A type that contains itself."""
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start("ros2")
    text = b"Loop again\n" + b"=" * 80 + b"\nMSG: finger_msgs/Loop\nLoop again\n"
    schema = writer.register_schema("finger_msgs/msg/Loop", "ros2msg", text)
    channel = writer.register_channel("/loop", "cdr", schema)
    writer.add_message(channel, 1, b"\x00\x01\x00\x00" + bytes(64), 1)
    writer.finish()
    return out.getvalue()


def attachment_tricks() -> bytes:
    """Attachments whose names lead out of every folder."""
    out = io.BytesIO()
    writer = Writer(out)
    writer.start("ros2")
    for name in ("../../escaped.yaml", "/etc/escaped.yaml", "a\x00b", "C:\\escaped.yaml", ""):
        writer.add_attachment(1, 1, name, "text/plain", b"escaped")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    channel = writer.register_channel("/finger/chatter", "cdr", schema)
    writer.add_message(channel, 1, b"\x00\x01\x00\x00\x02\x00\x00\x00a\x00", 1)
    writer.finish()
    return out.getvalue()
