# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""XDF files as LabRecorder writes them, made here to the description of the format."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from xdf_files import number_header, stream_chunks, write_xdf

from finger_common.errors import InputError
from finger_offline.importing.xdf import read_xdf

DRIFT, DELAY, JITTER = 2e-5, 3.0, 1e-4
"""Of the simulated second computer's clock: relative, in s, and of single measurements in s."""


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
    force = number_header("plate", "Force", {"fx": "N", "fz": "N"})
    marker = (
        "<?xml version='1.0'?><info><name>task</name><type>Markers</type>"
        "<channel_count>1</channel_count><nominal_srate>0</nominal_srate>"
        "<channel_format>string</channel_format><desc></desc></info>"
    )
    values = [struct.pack("<dd", 0.0, -t) for t in true]
    texts = [struct.pack("<BB", 1, len(text)) + text for text in (b"press", b"lift")]
    return write_xdf(
        tmp_path / "session.xdf",
        stream_chunks(1, force, remote, values, list(offsets)),
        stream_chunks(2, marker, np.array([101.0, 103.5]), texts, []),
    )


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


def test_what_is_damaged_or_cut_off_is_named(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert read_xdf(recording).problems == ()
    data = recording.read_bytes()
    short, torn, fewer = (tmp_path / f"{name}.xdf" for name in ("short", "torn", "fewer"))
    markers = data.index(b"task")
    short.write_bytes(data[: data.index(b"press") + 3])
    torn.write_bytes(data[:markers].replace(b"<info></info>", b"<info></inf"))
    count = b"<info><sample_count>2001</sample_count></info>"
    end = data.index(b"<info></info>")
    # The footer's chunk: 1 byte, length, tag and stream, then the text.
    begin = end - len("<?xml version='1.0'?>") - 11
    footer = data[begin + 5 : end] + count
    fewer.write_bytes(data[:begin] + struct.pack("<BI", 4, len(footer)) + footer + data[end + 13 :])
    said = " ".join(read_xdf(short).problems)
    assert "1 parts are damaged" in said and "'task' has no end" in said
    assert "2 parts are damaged" in read_xdf(torn).problems[0]
    (problem,) = read_xdf(fewer).problems
    assert "stream 'plate' holds 2000 of 2001 samples" in problem
    assert capsys.readouterr().err == ""
