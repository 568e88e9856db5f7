"""ATI Net F/T (and Ethernet Axia) over RDT, configured by its XML page.

- The page gives counts per unit and units; it is read at every connection and again every few seconds beside the
  stream, because units changed on the box's web page change the meaning of counts without a sign in the records.
- Records carry no time. Their number and the box's rate make a device clock, mapped to host time of receipt
  (kernel stamps); when the rate proves not to be what the page says, receipt itself is the stamp.
- What waited in the socket longer than `_OLD` s is skipped, so that a slow reader never lags behind.
- A box that sends faster than `rate` is averaged over whole blocks, stamped in the block's middle. Its own
  decimation has no filter.
- The box forgets the stream at a reboot and serves one client only; silence or a restarted numbering leads to a new
  connection. Its software bias is never touched.
"""

from __future__ import annotations

import select
import socket
import struct
import sys
import threading
import time
import urllib.error
import urllib.request
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from finger_common.diagnostics import ERROR, WARN, Health
from finger_common.errors import DeviceError

from ..clock import ClockMapper, HostClock
from ..protocols import netft_xml, rdt
from .source import CRITICAL, GOOD, SATURATED, ForceSource, WrenchSample

_SO_TIMESTAMPNS = 35
_SILENCE = 0.25
_OLD = 0.1
_REORDERED = 64
"""A record number at most this far back is a late datagram, one further back a new numbering."""
_DRIFT_LIMIT = 2e-3
"""Deviation of the box's rate from its page beyond which its numbering is not used as a clock."""


class _PageWatcher(threading.Thread):
    """Looks at the page again and again; `changed` once it says other units, counts or rate."""

    def __init__(
        self,
        page: Callable[[], netft_xml.Configuration],
        known: netft_xml.Configuration,
        period: float,
    ) -> None:
        super().__init__(name="netft-page", daemon=True)
        self._page, self._known, self._period = page, known, period
        self.changed = False
        self.ending = threading.Event()

    def run(self) -> None:
        while not self.ending.wait(self._period):
            try:
                now = self._page()
            except DeviceError:
                continue  # the stream itself tells whether the box is there
            if replace(now, status=0) != replace(self._known, status=0):
                self.changed = True
                return


class NetFtSource(ForceSource):
    """Driver of one Net F/T box. rate: samples per second wanted. set_rate: write it into the box first."""

    def __init__(
        self,
        host: str,
        rate: float = 500.0,
        port: int = rdt.PORT,
        http_port: int = 80,
        set_rate: bool = False,
        check_period: float = 2.0,
        timeout: float = 1.0,
        clock: HostClock | None = None,
        health: Health | None = None,
    ) -> None:
        super().__init__(health or Health("force", expected_rate=rate, stale_after=0.5))
        self._host, self._port, self._http_port = host, port, http_port
        self._rate = rate
        self._set_rate = set_rate
        self._check_period = check_period
        self._watcher: _PageWatcher | None = None
        self._timeout = timeout
        self._clock = clock or HostClock()
        self._socket: socket.socket | None = None
        self._scale = np.ones(6)
        self.configuration: netft_xml.Configuration | None = None

    def _where(self) -> str:
        return f"Net F/T at {self._host}:{self._port}"

    # Connection ------------------------------------------------------------------------------

    def connect(self) -> None:
        self.close()
        if self._set_rate:
            self._get(f"/comm.cgi?comrdtrate={self._rate:.0f}")
        configuration = self._page()
        if not configuration.rdt_enabled:
            raise DeviceError(
                f"{self._where()}: RDT is disabled; enable it on the box's Communications page"
            )
        self.configuration = configuration
        scale = [configuration.force_scale] * 3 + [configuration.torque_scale] * 3
        self._scale = np.array(scale)
        sent_rate = rdt.real_rate(configuration.rdt_rate or self._rate)
        self._block = max(1, round(sent_rate / self._rate))
        self._mapper = ClockMapper(sent_rate)
        self.health.notes["box_rate_hz"] = f"{sent_rate:g}"
        self.health.hardware_id = f"{configuration.product or 'Net F/T'} ({self._where()})"
        try:
            self._open()
        except OSError as error:
            self.close()
            raise DeviceError(
                f"{self._where()}: {error.strerror or error}; check address and network"
            ) from None
        self._watcher = _PageWatcher(self._page, configuration, self._check_period)
        self._watcher.start()

    def _page(self) -> netft_xml.Configuration:
        return netft_xml.parse(self._get(netft_xml.PAGE))

    def _open(self) -> None:
        self._socket = connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        if sys.platform.startswith("linux"):
            connection.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        connection.connect((self._host, self._port))
        self._begin()
        self._send(rdt.START_REALTIME)
        ready, _, _ = select.select([connection], [], [], self._timeout)
        if not ready:
            self.close()
            raise DeviceError(
                f"{self._where()}: the web page answers but no record comes; check the firewall and "
                f"UDP port {self._port}"
            )

    def _begin(self) -> None:
        self._records: deque[tuple[rdt.Record, int]] = deque()
        self._pending: list[tuple[int, np.ndarray]] = []
        self._pending_quality = GOOD
        self._pending_status = 0
        self._last: rdt.Record | None = None
        self._mapper.restart()
        self._last_record = time.monotonic()

    def flush(self) -> None:
        while self._socket is not None and self._receive(0.0):
            self._records.clear()
        if self._socket is not None:
            self._begin()

    def close(self) -> None:
        watcher, self._watcher = self._watcher, None
        if watcher is not None:
            watcher.ending.set()
        connection, self._socket = self._socket, None
        if connection is not None:
            try:
                connection.send(rdt.encode_request(rdt.STOP))
            except OSError:
                pass  # the box is gone; there is nobody to stop
            connection.close()

    def _send(self, command: int) -> None:
        assert self._socket is not None
        self._socket.send(rdt.encode_request(command))

    def _get(self, path: str) -> bytes:
        url = f"http://{self._host}:{self._http_port}{path}"
        try:
            with urllib.request.urlopen(url, timeout=self._timeout) as answer:
                return bytes(answer.read(netft_xml.MAX_BYTES + 1))
        except (OSError, urllib.error.URLError, ValueError) as error:
            reason = getattr(error, "reason", None) or error
            raise DeviceError(
                f"{url} does not answer ({reason}); check address and power"
            ) from None
        except Exception as error:
            # http.client raises its own family for what is no HTTP.
            raise DeviceError(f"{url} does not speak HTTP ({error}); is this a Net F/T?") from None

    # Reading ---------------------------------------------------------------------------------

    def read(self, timeout: float = 1.0) -> WrenchSample | None:
        """Next sample; raises DeviceError after 0.25 s of silence or when the box restarted its numbering."""
        if self._socket is None:
            raise DeviceError(f"{self._where()}: not connected")
        if self._watcher is not None and self._watcher.changed:
            raise DeviceError(
                f"{self._where()}: units or counts were changed on the box; connecting again"
            )
        end = time.monotonic() + timeout
        while True:
            while self._records:
                sample = self._take(*self._records.popleft())
                if sample is not None:
                    return sample
            now = time.monotonic()
            if now - self._last_record > _SILENCE:
                raise DeviceError(
                    f"{self._where()}: no record for {now - self._last_record:.2f} s; check power, "
                    "cable and that no other client took the stream"
                )
            if now >= end:
                return None
            self._receive(min(end - now, 0.05))

    def _receive(self, timeout: float) -> bool:
        """Take in one datagram if one comes within `timeout`."""
        connection = self._socket
        assert connection is not None
        try:
            if not select.select([connection], [], [], timeout)[0]:
                return False
            data, ancillary, _, _ = connection.recvmsg(2048, socket.CMSG_SPACE(16))
        except OSError as error:
            raise DeviceError(f"{self._where()}: {error.strerror or error}") from None
        received = self._clock.now()
        for _level, kind, value in ancillary:
            if kind == _SO_TIMESTAMPNS and len(value) == 16:
                seconds, nanoseconds = struct.unpack("@ll", value)
                stamped = self._clock.from_wall(seconds * 1_000_000_000 + nanoseconds)
                received = min(received, stamped)
        try:
            records = rdt.decode_datagram(data)
        except DeviceError as error:
            self.note("malformed", f"{self._where()}: {error}")
            return True
        self._last_record = time.monotonic()
        self._records.extend((record, received) for record in records)
        return True

    def _take(self, record: rdt.Record, received: int) -> WrenchSample | None:
        last = self._last
        if last is not None:
            step = (record.rdt_sequence - last.rdt_sequence) & 0xFFFFFFFF
            back = (last.rdt_sequence - record.rdt_sequence) & 0xFFFFFFFF
            if step == 0 or (back <= _REORDERED and record.ft_sequence < last.ft_sequence):
                self.health.count("out_of_order")
                return None
            if step > 1 << 31:
                raise DeviceError(
                    f"{self._where()}: the numbering restarted; the box rebooted or another client "
                    "started it"
                )
            if step > 1:
                self.health.count("lost", step - 1)
                self._pending.clear()
            if record.ft_sequence == last.ft_sequence:
                self._last = record
                self.note("stalled", "the box repeats an internal sample; reboot it", ERROR)
                return None
            self.cleared("stalled")
        self._last = record
        self.cleared("malformed")
        stamp = self._mapper.update(record.rdt_sequence, received)
        if abs(self._mapper.drift) > _DRIFT_LIMIT:
            self.note(
                "clock", "the box does not send at the rate its page says; stamps are receipt"
            )
            stamp = received
        else:
            self.cleared("clock")
        self.health.notes["clock_drift_ppm"] = f"{self._mapper.drift * 1e6:.0f}"
        self.health.notes["clock_jitter_ms"] = f"{self._mapper.jitter * 1e3:.3f}"
        if self._clock.now() - received > _OLD * 1e9:
            self.health.count("skipped")
            self._pending.clear()
            return None
        quality = self._quality(record.status)
        self._pending_quality = max(self._pending_quality, quality)
        self._pending_status |= record.status
        self._pending.append((stamp, np.array(record.counts, dtype=float) * self._scale))
        if len(self._pending) < self._block:
            return None
        wrench = np.mean([w for _, w in self._pending], axis=0)
        first, final = self._pending[0][0], self._pending[-1][0]
        sample = WrenchSample(
            (first + final) // 2,
            wrench[:3],
            wrench[3:],
            wrench,
            self._pending_status,
            self._pending_quality,
        )
        self._pending, self._pending_quality, self._pending_status = [], GOOD, 0
        return sample

    def _quality(self, status: int) -> int:
        faults = status & ~(rdt.SUMMARY_BIT | rdt.LATCH_BIT)
        text = f"{rdt.status_text(status)} (status 0x{status:08X})"
        if faults & ~rdt.SATURATION_BIT or status == rdt.SUMMARY_BIT:
            self.note("critical", f"sensor fault: {text}", ERROR)
            return CRITICAL
        self.cleared("critical")
        if faults:
            self.note("saturated", f"sensor says: {text}; check load and cable", ERROR)
            return SATURATED
        self.cleared("saturated")
        if status & rdt.LATCH_BIT:
            self.note("latched", f"sensor says: {text}", WARN)
        else:
            self.cleared("latched")
        return GOOD

    @property
    def scale_id(self) -> object:
        configuration = self.configuration
        return None if configuration is None else self._host
