# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""ATI Net F/T (and Ethernet Axia) over RDT, configured by its XML page.

- The page gives counts per unit and units; it is read at every connection and again every few
  seconds beside the stream, because units changed on the box's web page change the meaning of
  counts without a sign in the records.
- Records carry no time. Their number and the box's rate make a device clock, mapped to host time of
  receipt (kernel stamps); when the rate proves to differ from the page's, receipt itself is the
  stamp.
- What waits in the socket while this computer stands still for a moment is read afterwards; what
  waited longer than `_OLD` s is skipped, so that a slow reader never lags.
- A box that sends faster than `rate` is averaged over whole blocks, stamped in the block's middle.
  Its own decimation has no filter.
- UDP has no protection against a forger who sends from the box's address. What can be checked is:
  the sender's address and port (by the kernel), whole records, the numbering (`RecordOrder`), the
  scale and the sensor's range.
- The box forgets the stream at a reboot and serves one client only; silence or a restarted
  numbering leads to a new connection. Its software bias is never changed.
"""

from __future__ import annotations

import select
import socket
import threading
import time
import urllib.error
import urllib.request
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from finger_common.diagnostics import ERROR
from finger_common.errors import DeviceError
from finger_common.settings import setting

from ..clock import ClockMapper, receive_stamped, request_kernel_stamps
from ..protocols import netft_xml, rdt
from ..protocols.rdt_order import Received, RecordOrder
from .source import CRITICAL, GOOD, SATURATED, ForceSettings, ForceSource, WrenchSample

_TIMEOUT = 1.0
"""Seconds for the web page and for the first record to come."""
_CHECK_PERIOD = 2.0
"""Seconds between readings of the page beside the stream."""
_OLD = 0.5
_BUFFER = 1 << 20
"""Bytes asked for to hold what comes meanwhile; the kernel may grant less (net.core.rmem_max)."""
_DRIFT_LIMIT = 2e-3
"""Deviation of the box's rate from its page beyond which its numbering is not used as a clock."""
_CLOCK_BLOCK, _CLOCK_BLOCKS = 0.25, 120
"""s, and number, of the clock's blocks: many records, yet soon enough to find out another rate."""
_REPEATED = 0.1
"""s without a new internal sample after which the box stands still; one that sends faster than it
measures repeats samples."""
_DIRECT = urllib.request.build_opener(urllib.request.ProxyHandler({}))
"""A box in the laboratory is not behind the proxy that the environment names."""


class _PageWatcher(threading.Thread):
    """Reads the page periodically; `changed` once it gives another configuration."""

    def __init__(
        self, page: Callable[[], netft_xml.Configuration], known: netft_xml.Configuration
    ) -> None:
        super().__init__(name="netft-page", daemon=True)
        self._page, self._known = page, known
        self.changed = False
        self.ending = threading.Event()

    def run(self) -> None:
        while not self.ending.wait(_CHECK_PERIOD):
            try:
                now = self._page()
            except DeviceError:
                continue  # the stream itself shows whether the box is there
            if now != self._known:
                self.changed = True
                return


@dataclass(frozen=True)
class NetFtSettings(ForceSettings):
    """Settings of a Net F/T box."""

    netft_host: str = setting("192.168.1.1", "Net F/T: address of the box (ATI's default).")
    netft_port: int = setting(rdt.PORT, "Net F/T: UDP port of RDT.", minimum=1, maximum=65535)
    netft_http_port: int = setting(80, "Net F/T: port of its web pages.", minimum=1, maximum=65535)
    netft_set_rate: bool = setting(
        False, "Net F/T: write `rate` into the box (comm.cgi) before the stream starts."
    )


class NetFtSource(ForceSource):
    """ATI Net F/T on Ethernet."""

    SETTINGS = NetFtSettings
    SIMULATOR = "finger_driver.simulators.netft:NetFtSimulator"

    settings: NetFtSettings

    def __init__(self, settings: NetFtSettings) -> None:
        super().__init__(settings)
        self._watcher: _PageWatcher | None = None
        self._socket: socket.socket | None = None
        self._scale = np.ones(6)
        self.configuration: netft_xml.Configuration | None = None

    def _where(self) -> str:
        return f"Net F/T at {self.settings.netft_host}:{self.settings.netft_port}"

    # Connection ------------------------------------------------------------------------------

    def connect(self) -> None:
        self.close()
        rate = self.settings.rate
        if self.settings.netft_set_rate:
            self._get(f"/comm.cgi?comrdtrate={rate:.0f}")
        configuration = self._page()
        if not configuration.rdt_enabled:
            raise DeviceError(
                f"{self._where()}: RDT is disabled; enable it on the box's Communications page"
            )
        scale = np.array([configuration.force_scale] * 3 + [configuration.torque_scale] * 3)
        with np.errstate(over="ignore"):
            self.check_scale(self._where(), scale, scale * rdt.MAX_COUNT)
        self.configuration = configuration
        self._scale = scale
        internal_rate = configuration.internal_rate or rdt.INTERNAL_RATE
        sent_rate = rdt.real_rate(configuration.rdt_rate or rate, internal_rate)
        self._block = max(1, round(min(sent_rate, internal_rate) / rate))
        self._mapper = ClockMapper(sent_rate, _CLOCK_BLOCK, _CLOCK_BLOCKS)
        self.health.notes["box_rate_hz"] = f"{sent_rate:g}"
        self.health.hardware_id = f"{configuration.product or 'Net F/T'} ({self._where()})"
        try:
            self._open()
        except OSError as error:
            raise DeviceError(
                f"{self._where()}: {error.strerror or error}; check address and network"
            ) from None
        self._watcher = _PageWatcher(self._page, configuration)
        self._watcher.start()

    def _page(self) -> netft_xml.Configuration:
        return netft_xml.parse(self._get(netft_xml.PAGE))

    def _open(self) -> None:
        self._socket = connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        request_kernel_stamps(connection)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        connection.connect((self.settings.netft_host, self.settings.netft_port))
        self._begin()
        self._send(rdt.START_REALTIME)
        failed = ""
        if not select.select([connection], [], [], _TIMEOUT)[0]:
            failed = "no record comes; check the firewall and"
        else:
            try:
                connection.recv(2048, socket.MSG_PEEK)
            except OSError as error:
                failed = f"no record can be received ({error.strerror or error}); check"
        if failed:
            raise DeviceError(
                f"{self._where()}: the web page answers but {failed} UDP port "
                f"{self.settings.netft_port}"
            )

    def _begin(self) -> None:
        self._records: deque[Received] = deque()
        """Records in order."""
        self._pending: list[tuple[int, np.ndarray]] = []
        self._pending_quality = GOOD
        self._pending_status = 0
        self._order = RecordOrder()
        self._internal: tuple[int, int] | None = None
        """Number of the newest internal sample, and when it was received first."""
        self._stamp = 0
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
                pass  # the box is gone; there is no stream to stop
            connection.close()

    def _send(self, command: int) -> None:
        assert self._socket is not None
        self._socket.send(rdt.encode_request(command))

    def _get(self, path: str) -> bytes:
        url = f"http://{self.settings.netft_host}:{self.settings.netft_http_port}{path}"
        try:
            with _DIRECT.open(url, timeout=_TIMEOUT) as answer:
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
        """Next sample; raises DeviceError after `longest_silence` or a restart of the numbering."""
        if self._socket is None:
            raise DeviceError(f"{self._where()}: not connected")
        if self._watcher is not None and self._watcher.changed:
            raise DeviceError(
                f"{self._where()}: units or counts were changed on the box, or its rate, "
                "calibration, bias or tool transform; connecting again"
            )
        end = time.monotonic() + timeout
        while True:
            while self._records:
                sample = self._sample_of(*self._records.popleft())
                if sample is not None:
                    return sample
            # First what waits in the socket: this process may have stood still, not the box.
            self._receive(min(max(end - time.monotonic(), 0.0), 0.05))
            now = time.monotonic()
            silent = now - self._last_record
            if not self._records and silent > self.longest_silence:
                raise DeviceError(
                    f"{self._where()}: no record for {silent:.2f} s; check power, cable and that "
                    "no other client took the stream"
                )
            if not self._records and now >= end:
                return None

    def _receive(self, timeout: float) -> bool:
        """Receive one datagram if one comes within `timeout`."""
        connection = self._socket
        assert connection is not None
        try:
            if not select.select([connection], [], [], timeout)[0]:
                return False
            data, stamped, _ = receive_stamped(connection, 2048)
        except OSError as error:
            raise DeviceError(f"{self._where()}: {error.strerror or error}") from None
        received = self.clock.of_stamp(stamped, earliest=0)
        try:
            records = rdt.decode_datagram(data)
        except DeviceError as error:
            self.note("malformed", f"{self._where()}: {error}")
            return True
        self._last_record = time.monotonic()
        for record in records:
            self._records.extend(self._in_order(record, received))
        return True

    def _in_order(self, record: rdt.Record, received: int) -> list[Received]:
        """Records that can be used now that this one has come; what was noticed goes to health."""
        usable, outcome = self._order.add(record, received)
        if outcome.follows:
            self.cleared("jump", "conflict", "malformed")
        if outcome.out_of_order:
            self.health.count("out_of_order")
        if outcome.conflict:
            self.note(
                "conflict",
                "two different records of one number; is another sender in the network?",
            )
        if outcome.left_out:
            self.note(
                "jump",
                "a record was left out: its number jumped and the next record did not follow it; "
                "was it damaged, or is another sender in the network?",
            )
        if outcome.restarted:
            raise DeviceError(
                f"{self._where()}: the numbering restarted; the box rebooted or another client "
                "started it"
            )
        if outcome.lost:
            self.health.count("lost", outcome.lost)
        if outcome.gap:
            self._begin_block()
        return usable

    def _sample_of(self, record: rdt.Record, received: int) -> WrenchSample | None:
        if self._internal is not None and self._internal[0] == record.ft_sequence:
            self.health.count("repeated")
            if received - self._internal[1] > _REPEATED * 1e9:
                self.note("stalled", "the box repeats an internal sample; reboot it", ERROR)
            return None
        self._internal = record.ft_sequence, received
        self.cleared("stalled")
        stamp = self._mapper.update(record.rdt_sequence, received)
        other_rate = abs(self._mapper.drift) > _DRIFT_LIMIT
        self.note_if(
            other_rate,
            "clock",
            "the box does not send at the rate its page gives; stamps are times of receipt",
        )
        if other_rate:
            stamp = received
        # Back from times of receipt, the mapped ones may begin a little earlier.
        self._stamp = stamp = max(stamp, self._stamp + 1)
        if self.clock.now() - received > _OLD * 1e9:
            self.health.count("skipped")
            self._begin_block()
            return None
        quality = self._quality(record.status)
        self._pending_quality = max(self._pending_quality, quality)
        self._pending_status |= record.status
        self._pending.append((stamp, np.array(record.counts, dtype=float) * self._scale))
        if len(self._pending) < self._block:
            return None
        wrench = np.mean([w for _, w in self._pending], axis=0)
        first, final = self._pending[0][0], self._pending[-1][0]
        sample = WrenchSample.of_wrench(
            (first + final) // 2, wrench, self._pending_status, self._pending_quality
        )
        self.health.notes.update(self._mapper.notes())
        self._begin_block()
        return sample

    def _begin_block(self) -> None:
        """The next records are averaged anew."""
        self._pending, self._pending_quality, self._pending_status = [], GOOD, 0

    def _quality(self, status: int) -> int:
        if not status:
            self.cleared("critical", "saturated", "latched")
            return GOOD
        faults = status & ~(rdt.SUMMARY_BIT | rdt.LATCH_BIT)
        text = f"{rdt.status_text(status)} (status 0x{status:08X})"
        if faults & ~rdt.SATURATION_BIT or status == rdt.SUMMARY_BIT:
            self.note("critical", f"sensor fault: {text}", ERROR)
            return CRITICAL
        self.cleared("critical")
        if faults:
            self.note("saturated", f"sensor reports: {text}; check load and cable", ERROR)
            return SATURATED
        self.cleared("saturated")
        self.note_if(bool(status & rdt.LATCH_BIT), "latched", f"sensor reports: {text}")
        return GOOD

    @property
    def scale_id(self) -> object:
        configuration = self.configuration
        return None if configuration is None else (self.settings.netft_host, configuration.zero)
