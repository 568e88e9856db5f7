"""Any CAN force sensor that a DBC file and a mapping describe, streaming or polled."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import Any

import can

from finger_common.diagnostics import ERROR, Health
from finger_common.errors import DeviceError

from .. import can_bus
from ..clock import HostClock
from ..protocols.dbc import CanFrame, SampleAssembler, SensorMapping
from .source import CRITICAL, GOOD, SATURATED, ForceSource, WrenchSample

SHIPPED = Path(__file__).resolve().parent.parent / "data" / "robotous_rft.yaml"
_SILENCE = 0.25


class DbcSource(ForceSource):
    """Driver made from a mapping. rate: samples per second expected, and polled when the mapping has a request.

    The stamp is the arrival of a sample's first frame, as the CAN interface gives it.
    """

    def __init__(
        self,
        bus_arguments: dict[str, object],
        mapping: SensorMapping,
        rate: float = 500.0,
        clock: HostClock | None = None,
        health: Health | None = None,
    ) -> None:
        super().__init__(health or Health("force", expected_rate=rate, stale_after=0.5))
        self._bus_arguments = bus_arguments
        self._mapping = mapping
        self._names = mapping.identifiers()
        self._period = 1.0 / rate
        self._clock = clock or HostClock()
        self._assembler = SampleAssembler(mapping)
        self._bus: can.BusABC | None = None
        self._count: int | None = None

    def _where(self) -> str:
        arguments = self._bus_arguments
        interface = str(arguments.get("interface", "socketcan"))
        channel = arguments.get("channel") or can_bus.DEFAULT_CHANNEL.get(interface, "")
        return f"{self._mapping.name} on {interface} {channel}".rstrip()

    def connect(self) -> None:
        self.close()
        self._bus = can_bus.open_bus(**self._bus_arguments)  # type: ignore[arg-type]
        try:
            for frame in self._mapping.start:
                self._send(frame)
            self._begin()
            if self._wait(time.monotonic() + 1.0) is None:
                raise DeviceError(
                    f"{self._where()}: no sample within 1 s; check power, bit rate and the mapping"
                )
        except can.CanError as error:
            self.close()
            raise DeviceError(f"{self._where()}: the bus failed at start-up ({error})") from None
        except DeviceError:
            self.close()
            raise
        self._begin()
        self.health.hardware_id = self._where()

    def flush(self) -> None:
        if self._bus is None:
            return
        with contextlib.suppress(can.CanError):
            for _ in range(10_000):
                if self._bus.recv(0) is None:
                    break
        self._begin()

    def _begin(self) -> None:
        self._assembler.reset()
        self._count = None
        self._last_sample = self._next_poll = time.monotonic()

    def close(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            with contextlib.suppress(can.CanError):
                for frame in self._mapping.stop:
                    bus.send(_message(frame))
            bus.shutdown()

    def _send(self, frame: CanFrame) -> None:
        assert self._bus is not None
        self._bus.send(_message(frame), timeout=0.1)

    def read(self, timeout: float = 1.0) -> WrenchSample | None:
        """Next sample; raises DeviceError after 0.25 s without one or when the bus fails."""
        if self._bus is None:
            raise DeviceError(f"{self._where()}: not connected")
        try:
            sample = self._wait(time.monotonic() + timeout)
        except can.CanError as error:
            raise DeviceError(
                f"{self._where()}: bus error ({error}); check wiring and bit rate"
            ) from None
        now = time.monotonic()
        if sample is not None:
            self._last_sample = now
        elif now - self._last_sample > _SILENCE:
            raise DeviceError(
                f"{self._where()}: no sample for {now - self._last_sample:.2f} s; check power and cable"
            )
        return sample

    def _wait(self, end: float) -> WrenchSample | None:
        assert self._bus is not None
        request = self._mapping.request
        while (now := time.monotonic()) < end:
            until = end
            if request is not None:
                if now >= self._next_poll:
                    self._send(request)
                    self._next_poll = max(self._next_poll + self._period, now)
                until = min(end, self._next_poll)
            frame = self._bus.recv(max(until - now, 0.0))
            if frame is not None:
                sample = self._take(frame)
                if sample is not None:
                    return sample
        return None

    def _take(self, frame: can.Message) -> WrenchSample | None:
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
            self.note("malformed", str(error))
            done = None
        for _ in range(self._assembler.incomplete - incomplete):
            self.note("lost", "a frame of a sample is missing, swapped or late")
        if done is None:
            return None
        for key in ("lost", "malformed", "bus_errors"):
            self.cleared(key)
        stamp, signals = done
        self._count_gap(signals)
        wrench = self._mapping.wrench(signals)
        quality = self._quality(signals)
        return WrenchSample(stamp, wrench[:3], wrench[3:], wrench, quality, quality)

    def _arrival(self, frame: can.Message) -> int:
        """Host time of a frame; an adapter's own clock shows by a stamp that is not of the last second."""
        now = self._clock.now()
        stamped = self._clock.from_wall(round(frame.timestamp * 1e9)) if frame.timestamp else now
        return stamped if 0 <= now - stamped < 1_000_000_000 else now

    def _count_gap(self, signals: dict[str, Any]) -> None:
        if self._mapping.counter is None:
            return
        signal, modulus = self._mapping.counter
        count = int(signals[signal])
        if self._count is not None:
            missing = (count - self._count - 1) % modulus
            if missing:
                self.health.count("lost", missing)
        self._count = count

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


def _message(frame: CanFrame) -> can.Message:
    return can.Message(
        arbitration_id=frame.identifier, data=frame.data, is_extended_id=frame.extended
    )
