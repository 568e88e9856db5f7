# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Lab Streaming Layer: what is sent and received, and how its time maps to ROS time. No ROS here.

A sample's LSL time is the time of its header stamp, not of sending. Both are times of one host: LSL
counts seconds of a steady clock (`local_clock`), headers nanoseconds since the epoch. `ClockMap`
measures the difference and bounds its error. For a stream from another computer LSL estimates the
offset of that computer's clock by round trips, half of which bounds the error.
"""

from __future__ import annotations

import ctypes
import json
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from finger_common.cli import one_line
from finger_common.errors import InputError
from finger_common.files import parse_json
from finger_common.stamps import NANOSECONDS
from finger_common.trial_phases import TrialPhase

try:
    import pylsl
except (ImportError, RuntimeError):  # absent, or without its liblsl
    pylsl = None

NEEDS = "the Lab Streaming Layer needs the package pylsl with liblsl: pip install pylsl"

PAUSE = 0.002
"""s between looks for samples that have come in."""


@dataclass(frozen=True)
class Channel:
    """One number of a sample: its label, its unit and where it stands in the message."""

    label: str
    unit: str
    path: str


@dataclass(frozen=True)
class Stream:
    """A topic as an LSL stream; without channels it holds markers (text).

    kind: LSL's content type. needed: how many channels a stream that comes in must have; further
    fields keep what a new message has. With 0 it may only be sent.
    """

    topic: str
    kind: str
    channels: tuple[Channel, ...] = ()
    needed: int = 0


def _channels(text: str) -> tuple[Channel, ...]:
    return tuple(Channel(*entry.split(",")) for entry in text.split())


STREAMS: dict[str, Stream] = {
    stream.topic: stream
    for stream in (
        Stream(
            "wrench",
            "Force",
            _channels(
                "force_x,N,wrench.force.x force_y,N,wrench.force.y force_z,N,wrench.force.z "
                "torque_x,Nm,wrench.torque.x torque_y,Nm,wrench.torque.y "
                "torque_z,Nm,wrench.torque.z"
            ),
            needed=3,
        ),
        Stream(
            "contact_area",
            "ContactArea",
            _channels(
                "gross_area,m2,gross_area real_area,m2,real_area area_stddev,m2,area_stddev "
                "flags,bits,flags"
            ),
            needed=3,
        ),
        Stream("moisture", "Moisture", _channels("value,a.u.,value"), needed=1),
        Stream(
            "contact_state",
            "ContactState",
            _channels(
                "normal_force,N,normal_force in_contact,bool,in_contact area,m2,area "
                "area_stddev,m2,area_stddev indentation,m,indentation "
                "mean_pressure,Pa,mean_pressure peak_pressure,Pa,peak_pressure flags,bits,flags"
            ),
        ),
        Stream("trial", "Markers", needed=1),
    )
}
"""Topics that can be streams, by name."""

MARKER = ("session", "subject", "condition", "index", "attempt", "phase", "target_force", "note")
"""Fields of `trial` in the JSON object of a marker; the phase by its name in lower case."""


def sample_of(stream: Stream, message: Any) -> list[Any]:
    """Channels of a message, or its marker."""
    if stream.channels:
        return [float(attrgetter(channel.path)(message)) for channel in stream.channels]
    fields = {name: getattr(message, name) for name in MARKER}
    fields["phase"] = TrialPhase(message.phase).name.lower()
    return [json.dumps(fields)]


def fill_message(stream: Stream, message: Any, sample: Sequence[Any]) -> None:
    """Set the fields of a message, made with `check_fields=True`, from a sample; raises InputError
    for a value that does not fit.
    """
    try:
        if not stream.channels:
            _fill_trial(message, sample[0])
        for channel, value in zip(stream.channels, sample, strict=False):
            owner, _, field = channel.path.rpartition(".")
            target = attrgetter(owner)(message) if owner else message
            setattr(target, field, type(getattr(target, field))(value))
    except (
        InputError, ValueError, TypeError, LookupError, ArithmeticError, AttributeError,
        AssertionError,
    ):  # fmt: skip
        raise InputError(
            f"LSL sample {str(sample)[:60]} is no {stream.topic}; send channels or markers as the "
            "stream of that name has them"
        ) from None


def _fill_trial(message: Any, marker: str) -> None:
    fields = parse_json(marker, "marker")
    message.phase = int(TrialPhase[fields.pop("phase").upper()])
    for name in fields.keys() & set(MARKER):
        setattr(message, name, type(getattr(message, name))(fields[name]))


def require() -> None:
    """Raise InputError when pylsl is not installed."""
    if pylsl is None:
        raise InputError(NEEDS)


class ClockMap:
    """LSL's local clock (s) as ROS time (ns since the epoch).

    Both run steadily on one host, so their difference is a constant. It is measured by reading the
    one clock between two readings of the other: the true difference lies within half the time
    between these. `error` (s) is that bound for the narrowest of all readings.
    """

    def __init__(
        self, ros: Callable[[], int], lsl: Callable[[], float] | None = None, readings: int = 100
    ) -> None:
        self._ros = ros
        self._lsl = lsl or pylsl.local_clock
        self._offset = 0
        self.error = float("inf")
        for _ in range(readings):
            self._measure()

    def _measure(self) -> None:
        before = self._ros()
        local = self._lsl()
        after = self._ros()
        error = (after - before) / 2 / NANOSECONDS
        if error < self.error:
            self.error = error
            self._offset = (before + after) // 2 - round(local * NANOSECONDS)

    def to_lsl(self, stamp_ns: int) -> float:
        """LSL time in s of a stamp."""
        return (stamp_ns - self._offset) / NANOSECONDS

    def to_ros(self, lsl_time: float) -> int:
        """Stamp in ns of an LSL time in s."""
        return round(lsl_time * NANOSECONDS) + self._offset


class Sender:
    """An LSL stream of a topic, under a name that is unique in the laboratory."""

    def __init__(self, stream: Stream, name: str, clocks: ClockMap) -> None:
        require()
        self._stream = stream
        self._clocks = clocks
        # An irregular rate: each sample has a time of its own, and receivers make none up.
        info = pylsl.StreamInfo(
            name,
            stream.kind,
            len(stream.channels) or 1,
            pylsl.IRREGULAR_RATE,
            "double64" if stream.channels else "string",
            f"finger_contact:{name}",
        )
        described = info.desc().append_child("channels")
        for channel in stream.channels:
            entry = described.append_child("channel")
            entry.append_child_value("label", channel.label)
            entry.append_child_value("unit", channel.unit)
        self._outlet = pylsl.StreamOutlet(info)
        self._heard = False
        self._marker: tuple[list[Any], float] | None = None

    def send(self, stamp_ns: int, message: Any) -> None:
        """Send a message with the time of its header stamp."""
        sample = sample_of(self._stream, message), self._clocks.to_lsl(stamp_ns)
        if not self._stream.channels:
            self._marker = sample
        self._outlet.push_sample(*sample)

    def repeat_marker(self) -> None:
        """Send the newest marker again, with its time, when somebody begins to listen.

        LSL keeps nothing for those who come later; a recorder must know the trial that runs.
        """
        heard = bool(self._outlet.have_consumers())
        if heard and not self._heard and self._marker is not None:
            self._outlet.push_sample(*self._marker)
        self._heard = heard


class Receiver(threading.Thread):
    """Receives an LSL stream by its name, now or when it comes, until `stop`.

    `on_sample(stamp_ns, sample, error)` is called in this thread with the stamp mapped to ROS time
    and the bound (s) of the error of that mapping; `on_problem(sentence)` when the stream is not
    there, does not fit or breaks off, and with "" once it is received. A stream that broke off is
    looked for again.
    """

    def __init__(
        self,
        stream: Stream,
        name: str,
        clocks: ClockMap,
        on_sample: Callable[[int, Sequence[Any], float], None],
        on_problem: Callable[[str], None],
    ) -> None:
        require()
        super().__init__(name=f"lsl {name}", daemon=True)
        self._stream, self._stream_name, self._clocks = stream, name, clocks
        self._on_sample, self._on_problem = on_sample, on_problem
        self._told = ""
        self._ending = threading.Event()

    def stop(self) -> None:
        """End the thread."""
        self._ending.set()
        self.join(5.0)

    def run(self) -> None:
        """The thread."""
        while not self._ending.is_set():
            found = pylsl.resolve_byprop("name", self._stream_name, 1, 0.5)
            if not found:
                self._tell(
                    f"there is no LSL stream '{self._stream_name}'; start the program that sends "
                    "it, or correct the name"
                )
                continue
            problem = self._misfit(found[0])
            if problem:
                self._tell(problem)
                self._ending.wait(5.0)
                continue
            try:
                self._receive(pylsl.StreamInlet(found[0], recover=False))
            except Exception as error:  # of liblsl; whatever it is, the next stream may be well
                self._tell(
                    f"LSL stream '{self._stream_name}' broke off ({one_line(error)}); waiting for "
                    "it"
                )
                self._ending.wait(1.0)

    def _tell(self, problem: str) -> None:
        if problem != self._told:
            self._told = problem
            self._on_problem(problem)

    def _misfit(self, info: Any) -> str:
        text = info.channel_format() == pylsl.cf_string
        if text == bool(self._stream.channels):
            holds = "text" if text else "numbers"
            return f"LSL stream '{self._stream_name}' holds {holds}; name another one"
        if info.channel_count() < self._stream.needed:
            return (
                f"LSL stream '{self._stream_name}' has {info.channel_count()} channels, "
                f"'{self._stream.topic}' needs {self._stream.needed}; name another one"
            )
        return ""

    def _receive(self, inlet: Any) -> None:
        inlet.open_stream(5.0)
        self._tell("")
        while not self._ending.is_set():
            samples, times = inlet.pull_chunk(timeout=0.0, max_samples=256)
            if not times:
                time.sleep(PAUSE)
                continue
            offset, error = time_correction(inlet)
            for sample, local in zip(samples, times, strict=True):
                stamp = self._clocks.to_ros(local + offset)
                self._on_sample(stamp, sample, error + self._clocks.error)


def time_correction(inlet: Any) -> tuple[float, float]:
    """What to add to times of a stream to get times of this host (s), and the bound of its error.

    The bound is the round trip by which LSL measured the offset, which its estimate halves. Raises
    TimeoutError and LostError of pylsl.util.
    """
    remote, uncertainty, code = ctypes.c_double(), ctypes.c_double(), ctypes.c_int()
    library = pylsl.util.lib.lsl_time_correction_ex
    library.restype = ctypes.c_double
    library.argtypes = (
        [ctypes.c_void_p] + [ctypes.c_void_p] * 2 + [ctypes.c_double, ctypes.c_void_p]
    )
    offset = library(
        inlet.obj,
        ctypes.addressof(remote),
        ctypes.addressof(uncertainty),
        5.0,
        ctypes.addressof(code),
    )
    pylsl.util.handle_error(code)
    return float(offset), float(uncertainty.value)
