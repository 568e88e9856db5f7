# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Any CAN force sensor that a DBC file and a mapping describe, streaming or polled.

A polled sensor is asked again when its sample is complete: some abort what they send when another
request comes. After a lost reply nothing is asked for as long again, and what comes meanwhile is
left out, since it is not known when it was measured.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import can

from finger_common.diagnostics import ERROR
from finger_common.errors import DeviceError
from finger_common.settings import setting
from finger_common.stamps import NANOSECONDS

from .. import can_bus
from ..protocols.dbc import SampleAssembler, SensorMapping
from .source import (
    CRITICAL,
    GOOD,
    REPEATED,
    SATURATED,
    ForceSettings,
    ForceSource,
    WrenchSample,
)

SHIPPED = Path(__file__).resolve().parent.parent / "data" / "robotous_rft.yaml"

_WITHIN = 0.75
"""Share of the time between samples of a stream in which all frames of one must come; else those of
two could be joined when the ones between are lost."""

_OFTEN, _OFTEN_TIME, _OFTEN_SAMPLES = 1.5, 0.5, 5
"""Times the rate at which frames of a second sensor must be among them; s and samples over which it
is looked at. Two such times follow each other, since frames that waited in a queue come at once."""


@dataclass(frozen=True)
class DbcSettings(can_bus.CanSettings, ForceSettings):
    """Settings of a sensor that a DBC file describes."""

    dbc_mapping: str = setting(
        "", "dbc: YAML file that maps a DBC file's signals; empty for the shipped Robotous RFT."
    )

    def address(self) -> str:
        return f"{self.bus()}, dbc_mapping {self.dbc_mapping or 'of the Robotous RFT'}"


class DbcSource(ForceSource):
    """Any CAN sensor that a DBC file describes.

    The stamp of a stream's sample is the arrival of its first frame, as the CAN interface gives it;
    that of a polled one the middle between the request and that arrival.
    """

    SETTINGS = DbcSettings
    SIMULATOR = "finger_driver.simulators.rft:RftSimulator"

    settings: DbcSettings

    def __init__(self, settings: DbcSettings) -> None:
        super().__init__(settings)
        mapping = SensorMapping.load(settings.dbc_mapping or SHIPPED)
        if mapping.request is None:
            within = min(mapping.within, _WITHIN / settings.rate)
            mapping = replace(mapping, within=within)
        self._mapping = mapping
        self._names = self._mapping.identifiers()
        self._assembler = SampleAssembler(self._mapping)
        self._bus: can.BusABC | None = None
        self._begin()
        self._refused: str | None = None
        """Why the newest frame was refused while the first sample is waited for, None later."""

    def _where(self) -> str:
        return f"{self._mapping.name} on {self.settings.where()}"

    def _asked_for(self) -> str:
        """How often a polled sensor is asked, for error sentences."""
        return f" at {self.settings.rate:g} requests per second" if self._mapping.request else ""

    @property
    def longest_silence(self) -> float:
        silence = super().longest_silence
        # That of a polled one is not told before some replies were lost.
        return (
            max(silence, 4 * self.settings.response_timeout) if self._mapping.request else silence
        )

    def connect(self) -> None:
        self.close()
        self._bus = self.settings.open_bus()
        self._refused = ""
        try:
            for message in self._mapping.start:
                self._bus.send(message, timeout=0.1)
            self._begin()
            if self._wait(time.monotonic() + 1.0) is None:
                refused = f" ({self._refused})" if self._refused else ""
                raise DeviceError(
                    f"{self._where()}: no sample within 1 s{self._asked_for()}{refused}; check "
                    "power, bit rate and the mapping"
                )
        except can_bus.BUS_ERRORS as error:
            raise DeviceError(f"{self._where()}: the bus failed at start-up ({error})") from None
        self._begin()
        self.health.hardware_id = self._where()

    def flush(self) -> None:
        if self._bus is None:
            return
        with contextlib.suppress(*can_bus.BUS_ERRORS):
            can_bus.discard_waiting(self._bus)
        self._begin()

    def _begin(self) -> None:
        self._assembler.reset()
        self._count: tuple[int, int] | None = None
        """Number of the newest sample, and its stamp when it came first."""
        self._last_sample = self._due = self._quiet_until = time.monotonic()
        self._asked = False
        """Whether a polled sensor's reply is awaited, which counts as lost at `_deadline`."""
        self._deadline, self._sent = self._due, 0
        self._begin_rate(self.clock.now())
        self._often = 0
        """Times one after the other in which frames came too often."""

    def _begin_rate(self, stamp: int) -> None:
        """The rate of the frames is taken from a stamp (ns) on."""
        self._rate_since, self._first_frames = stamp, 0

    def close(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            # An adapter that was unplugged cannot be told.
            with contextlib.suppress(*can_bus.BUS_ERRORS):
                for message in self._mapping.stop:
                    bus.send(message)
            with contextlib.suppress(*can_bus.BUS_ERRORS):
                bus.shutdown()

    def read(self, timeout: float = 1.0) -> WrenchSample | None:
        """Next sample; raises DeviceError after `longest_silence` or when the bus fails."""
        if self._bus is None:
            raise DeviceError(f"{self._where()}: not connected")
        try:
            sample = self._wait(time.monotonic() + timeout)
        except can_bus.BUS_ERRORS as error:
            raise DeviceError(
                f"{self._where()}: bus error ({error}); check wiring and bit rate"
            ) from None
        silent = time.monotonic() - self._last_sample
        if sample is None and silent > self.longest_silence:
            raise DeviceError(
                f"{self._where()}: no sample for {silent:.2f} s{self._asked_for()}; check power "
                "and cable"
            )
        return sample

    def _wait(self, end: float) -> WrenchSample | None:
        assert self._bus is not None
        request = self._mapping.request
        while (now := time.monotonic()) < end:
            until = end
            if request is not None:
                ask = max(self._due, self._quiet_until)
                until = min(end, self._deadline if self._asked else ask)
            # First what waits: before a request it is old, and this process may have stood still.
            frame = self._bus.recv(max(until - now, 0.0))
            if frame is not None:
                sample = self._take(frame)
                if sample is not None:
                    return sample
            elif request is not None:
                self._poll(self._bus, request)
        return None

    def _poll(self, bus: can.BusABC, request: can.Message) -> None:
        """Ask when it is time for it; give up a reply that does not come."""
        now, timeout = time.monotonic(), self.settings.response_timeout
        if self._asked and now >= self._deadline:
            self._asked = False
            self._assembler.reset()
            self._quiet_until = now + timeout
            self.note("lost", f"no complete reply within {timeout * 1e3:.0f} ms")
        if not self._asked and now >= max(self._due, self._quiet_until):
            self._due = self.poll_after(self._due)
            self._sent = self.clock.now()
            bus.send(request, timeout=timeout)
            self._deadline = time.monotonic() + timeout
            self._asked = True

    def _take(self, frame: can.Message) -> WrenchSample | None:
        """Take in a frame; the sample that it completes, if it does."""
        if frame.is_error_frame:
            self.note("bus_errors", "the bus carries error frames; check wiring and bit rate")
            return None
        name = self._names.get((frame.arbitration_id, frame.is_extended_id))
        if name is None or frame.is_remote_frame or frame.is_fd:
            self.health.count("foreign")
            return None
        arrival = self._arrival(frame)
        if name == self._mapping.frames[0]:
            self._find_second_sensor(arrival)
        polled = self._mapping.request is not None
        if polled and not self._asked:
            self.health.count("late_replies")
            return None
        incomplete = self._assembler.incomplete
        try:
            done = self._assembler.add(name, bytes(frame.data), arrival)
        except DeviceError as error:
            # Before the first sample it may be the sensor's answer to the frames sent at the start.
            if self._refused is None:
                self.note("malformed", str(error))
            else:
                self._refused = str(error)
            done = None
        for _ in range(self._assembler.incomplete - incomplete):
            self.note("lost", "a frame of a sample is missing, swapped or late")
        if done is None:
            return None
        self.cleared("lost", "malformed", "bus_errors")
        self._refused = None
        self._last_sample = time.monotonic()
        self._asked = False
        stamp, signals = done
        if polled:
            stamp = (self._sent + stamp) // 2
        if self._follow_counter(signals, stamp):
            return None
        quality = self._quality(signals)
        return WrenchSample.of_wrench(stamp, self._mapping.wrench(signals), quality, quality)

    def _arrival(self, frame: can.Message) -> int:
        """Host time of a frame; an adapter's own clock shows by a stamp not of the last second."""
        last_second = self.clock.now() - NANOSECONDS
        return self.clock.of_stamp(can_bus.stamp_of(frame), earliest=last_second)

    def _follow_counter(self, signals: dict[str, Any], stamp: int) -> bool:
        """Follow the sensor's counter, and count the samples that it passed over; whether it stands
        still."""
        if self._mapping.counter is None:
            return False
        signal, modulus = self._mapping.counter
        count = int(signals[signal])
        if self._count is not None:
            newest, since = self._count
            if count == newest:
                self.health.count("repeated")
                if stamp - since > REPEATED * NANOSECONDS:
                    self.note("stalled", f"the sensor repeats a sample ({signal} {count})", ERROR)
                return True
            # A polled sensor counts what it measures, asked or not.
            missing = (count - newest - 1) % modulus
            if missing and self._mapping.request is None:
                self.health.count("lost", missing)
        self._count = count, stamp
        self.cleared("stalled")
        return False

    def _find_second_sensor(self, stamp: int) -> None:
        """Tell of samples that begin too often for one sensor. stamp: ns, of a first frame."""
        self._first_frames += 1
        passed = (stamp - self._rate_since) * 1e-9
        rate = self.settings.rate
        if 0 <= passed < max(_OFTEN_TIME, _OFTEN_SAMPLES / rate):
            return
        measured = self._first_frames / passed if passed > 0 else 0.0
        self._begin_rate(stamp)
        self._often = self._often + 1 if measured > _OFTEN * rate else 0
        if self._often > 1:
            self.note(
                "conflict",
                f"{measured:.0f} samples per second come, {rate:g} are expected: does another "
                "sensor use these identifiers? If not, set 'rate'",
                ERROR,
            )
        elif not self._often:
            self.cleared("conflict")

    def _quality(self, signals: dict[str, Any]) -> int:
        if self._often > 1:
            # Whose values these are is not known.
            return CRITICAL
        fault, saturation = self._mapping.fault, self._mapping.saturation
        if fault is not None and fault.set_in(signals):
            self.note("critical", f"sensor fault: {fault.signal} {signals[fault.signal]}", ERROR)
            return CRITICAL
        self.cleared("critical")
        if saturation is not None and saturation.set_in(signals):
            text = f"{saturation.signal} {signals[saturation.signal]}"
            self.note("saturated", f"sensor overloaded: {text}; check the load", ERROR)
            return SATURATED
        self.cleared("saturated")
        return GOOD
