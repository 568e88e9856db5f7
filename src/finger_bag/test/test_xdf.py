# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""XDF files as LabRecorder writes them, made here to the description of the format."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from finger_bag.xdf import read_xdf
from finger_common.errors import InputError

DRIFT, DELAY, JITTER = 2e-5, 3.0, 1e-4
"""Of the simulated second computer's clock: relative, in s, and of single measurements in s."""


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


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Force of a second computer, whose clock runs fast and late, and markers of this one."""
    pytest.importorskip("pyxdf", reason="pyxdf is not installed")
    true = 100.0 + np.arange(2000) / 200.0
    remote = true * (1 + DRIFT) - DELAY
    generator = np.random.default_rng(1)
    seconds = remote[0] + np.arange(10)
    # What is to be added to the remote clock; the first and last measurement as exact as the rest.
    offsets = (seconds + DELAY) / (1 + DRIFT) - seconds + generator.normal(0, JITTER, 10)
    channels = "".join(
        f"<channel><label>{label}</label><unit>N</unit></channel>" for label in ("fx", "fz")
    )
    force = (
        "<?xml version='1.0'?><info><name>plate</name><type>Force</type>"
        "<channel_count>2</channel_count><nominal_srate>0</nominal_srate>"
        "<channel_format>double64</channel_format>"
        f"<desc><channels>{channels}</channels></desc></info>"
    )
    marker = (
        "<?xml version='1.0'?><info><name>task</name><type>Markers</type>"
        "<channel_count>1</channel_count><nominal_srate>0</nominal_srate>"
        "<channel_format>string</channel_format><desc></desc></info>"
    )
    values = [struct.pack("<dd", 0.0, -t) for t in true]
    texts = [struct.pack("<BB", 1, len(text)) + text for text in (b"press", b"lift")]
    file = tmp_path / "session.xdf"
    header = b"<?xml version='1.0'?><info><datetime>2026-11-22T12:00:00+0000</datetime></info>"
    file.write_bytes(
        b"XDF:"
        + chunk(1, header)
        + stream_chunks(1, force, remote, values, list(offsets))
        + stream_chunks(2, marker, np.array([101.0, 103.5]), texts, [])
    )
    return file


def test_streams_of_two_computers_are_on_one_clock_with_the_error_of_that(
    recording: Path,
) -> None:
    file = read_xdf(recording)
    force, task = file.stream("plate"), file.stream("Markers")
    assert (force.labels, force.units, force.rate) == (("fx", "fz"), ("N", "N"), 0.0)
    # The value of each sample is minus its true time.
    error = force.time + force.channel("fz")
    assert np.abs(error).max() < 3 * JITTER, "delay and drift of the other clock are taken out"
    assert 0.3 * JITTER < force.clock_error < 2 * JITTER
    assert np.array_equal(force.channel("1"), force.channel("fz"))
    assert task.time.tolist() == [101.0, 103.5] and task.values[:, 0].tolist() == ["press", "lift"]
    assert file.begun_ns == 1795348800 * 10**9


def test_what_is_not_there_is_named(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = read_xdf(recording)
    with pytest.raises(InputError, match="no stream is called 'plat'; did you mean 'plate'"):
        file.stream("plat")
    with pytest.raises(InputError, match="has no channel 'fy'"):
        file.stream("plate").channel("fy")
    with pytest.raises(InputError, match=r"none\.xdf: no such XDF file"):
        read_xdf(tmp_path / "none.xdf")
    broken = tmp_path / "broken.xdf"
    broken.write_bytes(b"no XDF at all")
    with pytest.raises(InputError, match=r"broken\.xdf: not a readable XDF file"):
        read_xdf(broken)
    monkeypatch.setitem(sys.modules, "pyxdf", None)
    with pytest.raises(InputError, match="pip install pyxdf"):
        read_xdf(recording)
