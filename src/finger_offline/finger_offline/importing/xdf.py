# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Streams of an XDF file, which LabRecorder writes from the Lab Streaming Layer.

`pyxdf` reads the file and puts all streams on the clock of the recording computer.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError, known_names
from finger_common.files import bounded_memory
from finger_common.stamps import NANOSECONDS

from .cells import from_iso
from .table import Table, numbered

NEEDS = "reading XDF files needs the package pyxdf: pip install pyxdf"


@dataclass(frozen=True)
class XdfStream:
    """One stream of a file.

    name, kind: as its program called it. labels, units: of the channels, "" where not given. rate:
    nominal, in Hz, 0 for an irregular one. time (n,): s on the clock of the recording computer.
    values (n, c): numbers, or texts of markers. clock_error: s, RMS deviation of the measured
    clock offsets from the line by which the times were corrected; 0 with fewer than three.
    """

    name: str
    kind: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    rate: float
    time: np.ndarray
    values: np.ndarray
    clock_error: float

    def channel(self, label: str) -> np.ndarray:
        """Values (n,) of a channel, by its label or by its number from 0; raises InputError."""
        if label in self.labels:
            return self.values[:, self.labels.index(label)]
        if label.isdecimal() and int(label) < self.values.shape[1]:
            return self.values[:, int(label)]
        named = [name or str(number) for number, name in enumerate(self.labels)]
        raise InputError(
            f"XDF stream '{self.name}' has no channel '{label}'; {known_names(label, named)}"
        )


@dataclass(frozen=True)
class XdfFile:
    """Streams of a file and when it was begun (ns since the epoch, None where it does not say).

    problems: what is damaged or was cut off; the streams hold the rest.
    """

    path: Path
    begun_ns: int | None
    streams: tuple[XdfStream, ...]
    problems: tuple[str, ...] = ()

    def stream(self, name: str) -> XdfStream:
        """The stream of that name, or else the only one of that type; raises InputError."""
        named = [s for s in self.streams if s.name == name]
        found = named or [s for s in self.streams if s.kind == name]
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(f"{self.path}: {len(found)} streams are called '{name}'; rename one")
        known = known_names(name, (s.name for s in self.streams))
        raise InputError(f"{self.path}: no stream is called '{name}'; {known}")


def read_xdf(path: Path) -> XdfFile:
    """Read a file; raises InputError without pyxdf and for a file of which nothing can be read."""
    try:
        import pyxdf
    except ImportError:
        raise InputError(NEEDS) from None
    if not path.is_file():
        raise InputError(f"{path}: no such XDF file")
    said = _Errors()
    logger = logging.getLogger("pyxdf")
    kept, logger.propagate = logger.propagate, False
    logger.addHandler(said)
    try:
        with bounded_memory(path):
            found, header = pyxdf.load_xdf(str(path), synchronize_clocks=True)
            streams = tuple(_stream(stream) for stream in found)
    except InputError:
        raise
    except Exception as error:  # pyxdf raises whatever its parsers do
        raise InputError(f"{path}: not a readable XDF file ({type(error).__name__})") from None
    finally:
        logger.removeHandler(said)
        logger.propagate = kept
    problems = [f"{path}: {said.count} parts are damaged and left out"] if said.count else []
    for data, stream in zip(found, streams):
        problems += [f"{path}: stream '{stream.name}' {cut}" for cut in _cut(data, stream)]
    return XdfFile(path, _begun(header), streams, tuple(problems))


def read_xdf_table(path: Path, part: str) -> Table:
    """A stream by its name or type: `time_s`, and its channels by label or number."""
    file = read_xdf(path)
    if not part:
        numbers = [s for s in file.streams if s.values.dtype.kind in "iuf"]
        if len(numbers) != 1:
            names = ", ".join(s.name for s in file.streams)
            raise InputError(
                f"{path}: holds {len(numbers)} streams of numbers; name one as {path}::STREAM "
                f"({names})"
            )
        part = numbers[0].name
    stream = file.stream(part)
    # All streams count from the same moment: which one that was is known to the second.
    first = min((s.time[0] for s in file.streams if len(s.time)), default=0.0)
    since = np.round((stream.time - first) * NANOSECONDS).astype(np.int64)
    times = since * 1e-9
    if file.begun_ns is not None:
        times = (since + file.begun_ns).astype("datetime64[ns]")
    headings = [label or str(i) for i, label in enumerate(stream.labels, 1)]
    headings = numbered(["time_s", *headings])[1:]
    named = dict(zip(headings, stream.values.T))
    units = dict(zip(headings, stream.units))
    where = f"{path}::{part}"
    return Table(where, {"time_s": times, **named}, units, problems=file.problems)


class _Errors(logging.Handler):
    """Counts what pyxdf skipped: it says so in its log alone."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.count += 1


def _cut(data: dict[str, Any], stream: XdfStream) -> Iterator[str]:
    """What is missing of a stream: the footer comes last, and may count the samples."""
    if "footer" not in data:
        yield "has no end: the file was cut off"
        return
    said = _text(data["footer"].get("info") or {}, "sample_count")
    if said.isdecimal() and len(said) < 20 and int(said) != len(stream.time):
        yield f"holds {len(stream.time)} of {said} samples"


def _stream(data: dict[str, Any]) -> XdfStream:
    info = data["info"]
    time = np.asarray(data["time_stamps"], float)
    values = np.asarray(data["time_series"])
    count = int(info["channel_count"][0])
    described = _channels(info, count)
    return XdfStream(
        name=_text(info, "name"),
        kind=_text(info, "type"),
        labels=tuple(_text(channel, "label") for channel in described),
        units=tuple(_text(channel, "unit") for channel in described),
        rate=float(info["nominal_srate"][0]),
        time=time,
        values=values.reshape(len(time), count),
        clock_error=_clock_error(data),
    )


def _channels(info: dict[str, Any], count: int) -> list[dict[str, Any]]:
    try:
        channels = info["desc"][0]["channels"][0]["channel"]
    except (KeyError, TypeError, IndexError):
        channels = []
    return [*channels, *({} for _ in range(count))][:count]


def _text(info: dict[str, Any], key: str) -> str:
    return str((info.get(key) or [""])[0] or "")


def _clock_error(data: dict[str, Any]) -> float:
    when = np.asarray(data.get("clock_times", ()), float)
    offset = np.asarray(data.get("clock_values", ()), float)
    if len(when) < 3:
        return 0.0
    line = np.polyfit(when - when[0], offset, 1)
    return float(np.std(offset - np.polyval(line, when - when[0])))


def _begun(header: dict[str, Any]) -> int | None:
    try:
        began = from_iso(header["info"]["datetime"][0])
    except (KeyError, TypeError, IndexError, ValueError):
        return None
    return round(began.timestamp() * NANOSECONDS)
