# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Any CAN force sensor that a DBC file and a mapping describe, streaming or polled."""

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
"""Share of the time between samples in which all frames of one must come; else those of two could
be joined when the ones between are lost."""


@dataclass(frozen=True)
class DbcSettings(can_bus.CanSettings, ForceSettings):
    """Settings of a sensor that a DBC file describes."""

    dbc_mapping: str = setting(
        "", "dbc: YAML file that maps a DBC file's signals; empty for the shipped Robotous RFT."
    )


class DbcSource(ForceSource):
    """Any CAN sensor that a DBC file describes.

    The stamp is the arrival of a sample's first frame, as the CAN interface gives it.
    """

    SETTINGS = DbcSettings
    SIMULATOR = "finger_driver.simulators.rft:RftSimulator"

    settings: DbcSettings

    def __init__(self, settings: DbcSettings) -> None:
        super().__init__(settings)
        mapping = SensorMapping.load(settings.dbc_mapping or SHIPPED)
        within = min(mapping.within, _WITHIN / settings.rate)
        self._mapping = replace(mapping, within=within)
        self._names = self._mapping.identifiers()
        self._period = 1.0 / settings.rate
        self._assembler = SampleAssembler(self._mapping)
        self._bus: can.BusABC | None = None
        self._count: tuple[int, int] | None = None
        """Number of the newest sample, and its stamp when it came first."""
        self._refused: str | None = None
        """Why the newest frame was refused while the first sample is waited for, None later."""

    def _where(self) -> str:
        return f"{self._mapping.name} on {self.settings.where()}"

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
                    f"{self._where()}: no sample within 1 s{refused}; check power, bit rate and "
                    "the mapping"
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
        self._count = None
        self._last_sample = self._next_poll = time.monotonic()

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
                f"{self._where()}: no sample for {silent:.2f} s; check power and cable"
            )
        return sample

    def _wait(self, end: float) -> WrenchSample | None:
        assert self._bus is not None
        request = self._mapping.request
        while (now := time.monotonic()) < end:
            until = end
            if request is not None:
                if now >= self._next_poll:
                    self._bus.send(request, timeout=0.1)
                    self._next_poll = max(self._next_poll + self._period, now)
                until = min(end, self._next_poll)
            frame = self._bus.recv(max(until - now, 0.0))
            if frame is not None:
                sample = self._sample_of(frame)
                if sample is not None:
                    return sample
        return None

    def _sample_of(self, frame: can.Message) -> WrenchSample | None:
        if frame.is_error_frame:
            self.note("bus_errors", "the bus carries error frames; check wiring and bit rate")
            return None
        name = self._names.get((frame.arbitration_id, frame.is_extended_id))
        if name is None or frame.is_remote_frame or frame.is_fd:
            self.health.count("foreign")
            return None
        incomplete = self._assembler.incomplete
        try:
            done = self._assembler.add(name, bytes(frame.data), self._arrival(frame))
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
        stamp, signals = done
        if self._repeated(signals, stamp):
            return None
        quality = self._quality(signals)
        return WrenchSample.of_wrench(stamp, self._mapping.wrench(signals), quality, quality)

    def _arrival(self, frame: can.Message) -> int:
        """Host time of a frame; an adapter's own clock shows by a stamp not of the last second."""
        last_second = self.clock.now() - NANOSECONDS
        return self.clock.of_stamp(can_bus.stamp_of(frame), earliest=last_second)

    def _repeated(self, signals: dict[str, Any], stamp: int) -> bool:
        """Whether the sensor's counter stands still; samples that it passed over are counted."""
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
            missing = (count - newest - 1) % modulus
            if missing:
                self.health.count("lost", missing)
        self._count = count, stamp
        self.cleared("stalled")
        return False

    def _quality(self, signals: dict[str, Any]) -> int:
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

    @property
    def scale_id(self) -> object:
        return self._mapping.name
