# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""XDF files as LabRecorder writes them, made to the description of the format."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

HEADER = b"<?xml version='1.0'?><info><datetime>2026-11-22T14:00:00+0200</datetime></info>"


def chunk(tag: int, content: bytes) -> bytes:
    return struct.pack("<BIH", 4, len(content) + 2, tag) + content


def stream_chunks(
    number: int, header: str, times: np.ndarray, values: list[bytes], offsets: list[float]
) -> bytes:
    """Header, samples each with its time, clock offsets one a second, and the footer."""
    identity = struct.pack("<I", number)
    samples = b"".join(
        struct.pack("<Bd", 8, time) + value for time, value in zip(times, values, strict=True)
    )
    clock = b"".join(
        chunk(4, identity + struct.pack("<dd", times[0] + second, offset))
        for second, offset in enumerate(offsets)
    )
    body = identity + struct.pack("<BI", 4, len(times)) + samples
    footer = identity + b"<?xml version='1.0'?><info></info>"
    return chunk(2, identity + header.encode()) + chunk(3, body) + clock + chunk(6, footer)


def number_header(name: str, kind: str, channels: dict[str, str]) -> str:
    """Header of a stream of float64 channels: unit by label."""
    described = "".join(
        f"<channel><label>{label}</label><unit>{unit}</unit></channel>"
        for label, unit in channels.items()
    )
    return (
        f"<?xml version='1.0'?><info><name>{name}</name><type>{kind}</type>"
        f"<channel_count>{len(channels)}</channel_count><nominal_srate>0</nominal_srate>"
        "<channel_format>double64</channel_format>"
        f"<desc><channels>{described}</channels></desc></info>"
    )


def write_xdf(path: Path, *streams: bytes) -> Path:
    """A file of these streams."""
    path.write_bytes(b"XDF:" + chunk(1, HEADER) + b"".join(streams))
    return path
