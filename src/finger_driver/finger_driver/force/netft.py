# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""ATI Net F/T (and Ethernet Axia) over RDT, configured by its XML page.

- The page gives counts per unit and units; it is read at every connection and again every few
  seconds beside the stream, because units changed on the box's web page change the meaning of
  counts without a sign in the records.
- Records carry no time. Their number and the box's rate make a device clock, mapped to host time of
  receipt (kernel stamps); when the rate proves to differ from the page's, receipt itself is the
  stamp. A pause in which the box measured and numbered no record begins the mapping anew.
- What waits in the socket while this computer stands still for a moment is read afterwards; what
  waited longer than `_OLD` s is skipped, so that a slow reader never lags.
- A box that sends faster than `rate` is averaged over blocks of as many record numbers, of which
  some may be lost. Its own decimation has no filter.
- UDP has no protection against a forger who sends from the box's address. What can be checked is:
  the sender's address and port (by the kernel), whole records, the numbering (`RecordOrder`), the
  scale and the sensor's range.
- The box forgets the stream at a reboot and serves one client only; silence or a restarted
  numbering leads to a new connection. Its software bias is never changed.
"""

from __future__ import annotations

import contextlib
import http.client
import math
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from finger_common.diagnostics import ERROR
from finger_common.errors import DeviceError
from finger_common.settings import setting

from ..clock import LATE, ClockMapper, receive_stamped, request_kernel_stamps
from ..protocols import netft_xml, rdt
from ..protocols.rdt_order import REORDERED, Received, RecordOrder
from .source import (
    CRITICAL,
    GOOD,
    REPEATED,
    SATURATED,
    ForceSettings,
    ForceSource,
    WrenchSample,
)

_TIMEOUT = 1.0
"""Seconds for the web page to begin or go on, and for the first record to come."""
_PAGE_TIME = 3.0
"""Seconds for the whole page."""
_CHECK_PERIOD = 2.0
"""Seconds between readings of the page beside the stream."""
_UNREAD = 3
"""Readings of the page that fail one after the other before it is told."""
_SUDDEN = 10
"""Times the step before that a step is in which the box paused."""
_OLD = 0.5
_BUFFER = 1 << 20
"""Bytes asked for to hold what comes meanwhile; the kernel may grant less (net.core.rmem_max)."""
_OVERTAKEN = 0.25
"""s by which a datagram may come after later ones."""
_SHARE_OF, _LOST_SHARE = 1000, 0.01
"""Records of which the share that was lost is taken, and the share that is told."""
_CLOCK_BLOCK, _CLOCK_BLOCKS = 0.25, 120
"""s, and number, of the clock's blocks: many records, yet soon enough to find out another rate."""


def _shut(connection: socket.socket) -> None:
    """End whatever is done with a connection in another thread."""
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


class _PageWatcher(threading.Thread):
    """Reads the page periodically; `changed` once it gives another configuration.

    failed: readings without a result since the last one with, which was at `read` (monotonic s).
    """

    def __init__(
        self, page: Callable[[], netft_xml.Configuration], known: netft_xml.Configuration
    ) -> None:
        super().__init__(name="netft-page", daemon=True)
        self._page, self._known = page, known
        self.changed = False
        self.failed, self.read = 0, time.monotonic()
        self.ending = threading.Event()

    def run(self) -> None:
        while not self.ending.wait(_CHECK_PERIOD):
            try:
                now = self._page()
            except DeviceError:
                self.failed += 1
                continue  # the stream itself shows whether the box is there
            self.failed, self.read = 0, time.monotonic()
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

    def address(self) -> str:
        return f"netft_host {self.netft_host}"


class NetFtSource(ForceSource):
    """ATI Net F/T on Ethernet."""

    SETTINGS = NetFtSettings
    SIMULATOR = "finger_driver.simulators.netft:NetFtSimulator"

    settings: NetFtSettings

    def __init__(self, settings: NetFtSettings) -> None:
        super().__init__(settings)
        self._watcher: _PageWatcher | None = None
        self._socket: socket.socket | None = None
        self._scale: np.ndarray = np.ones(6)
        self._rates = settings.rate, rdt.INTERNAL_RATE
        """Records sent and internal samples per second."""
        self._due = self._lost = 0
        """Records since the share that was lost was taken, and those of them that were lost."""
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
        self._rates = sent_rate, internal_rate
        self._block = max(1, round(sent_rate / rate))
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
        self._begin_block()
        self._order = RecordOrder(max(REORDERED, round(_OVERTAKEN * self._rates[0])))
        self._newest: rdt.Record | None = None
        self._measured = 0
        """When the newest internal sample was received first."""
        self._usual_step = math.inf
        """s between the newest two records, by the box's internal samples."""
        self._mapper.restart()
        self._last_record = time.monotonic()

    def _begin_block(self) -> None:
        """The next records are averaged anew."""
        self._pending: list[tuple[int, np.ndarray]] = []
        self._pending_quality = GOOD
        self._pending_status = 0
        self._number = 0
        """Number of the block of the records that wait."""

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
        host, port = self.settings.netft_host, self.settings.netft_http_port
        url = f"http://{host}:{port}{path}"
        # Not through the proxy that the environment names: the box is in the laboratory.
        connection = http.client.HTTPConnection(host, port, timeout=_TIMEOUT)
        end = time.monotonic() + _PAGE_TIME
        reason: object
        try:
            connection.connect()
            ending = threading.Timer(_PAGE_TIME, _shut, [connection.sock])
            ending.start()
            try:
                connection.request("GET", path)
                answer = connection.getresponse()
                data = answer.read(netft_xml.MAX_BYTES + 1)
            finally:
                ending.cancel()
            reason = f"HTTP error {answer.status}" if answer.status >= 400 else ""
        except (OSError, ValueError) as error:
            reason = error
        except Exception as error:
            # http.client raises its own family for what is no HTTP.
            reason = f"no HTTP: {error}; is this a Net F/T?"
        finally:
            connection.close()
        if time.monotonic() >= end:
            reason = f"not complete within {_PAGE_TIME:g} s"
        if reason:
            raise DeviceError(f"{url} does not answer ({reason}); check address and power")
        return data

    # Reading ---------------------------------------------------------------------------------

    def read(self, timeout: float = 1.0) -> WrenchSample | None:
        """Next sample; raises DeviceError after `longest_silence` or a restart of the numbering."""
        if self._socket is None:
            raise DeviceError(f"{self._where()}: not connected")
        if self._watcher is not None:
            self._check_page(self._watcher)
        end = time.monotonic() + timeout
        while True:
            while self._records:
                sample = self._take(*self._records.popleft())
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

    def _check_page(self, watcher: _PageWatcher) -> None:
        if watcher.changed:
            raise DeviceError(
                f"{self._where()}: units or counts were changed on the box, or its rate, "
                "calibration, bias or tool transform; connecting again"
            )
        if watcher.failed < _UNREAD:
            self.cleared("page")
            return
        unread = time.monotonic() - watcher.read
        self.note(
            "page",
            f"the box's page could not be read for {unread:.0f} s; units changed there would not "
            "be noticed; check its web server and network",
        )

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
        self._count_lost(outcome.lost, len(usable))
        return usable

    def _count_lost(self, lost: int, came: int) -> None:
        if lost:
            self.health.count("lost", lost)
        self._lost += lost
        self._due += lost + came
        if self._due >= _SHARE_OF:
            share = self._lost / self._due
            self.note_if(
                share > _LOST_SHARE,
                "records_lost",
                f"{share:.0%} of the last {self._due} records were lost; check network and switch",
            )
            self._lost = self._due = 0

    def _take(self, record: rdt.Record, received: int) -> WrenchSample | None:
        """Take in a record, received at host time (ns); the sample of a block that ends."""
        newest, self._newest = self._newest, record
        if newest is not None and newest.ft_sequence == record.ft_sequence:
            self.health.count("repeated")
            if received - self._measured > REPEATED * 1e9:
                self.note("stalled", "the box repeats an internal sample; reboot it", ERROR)
            return None
        self._measured = received
        self.cleared("stalled")
        if newest is not None:
            self._find_pause(newest, record)
        stamp = self._mapper.update(record.rdt_sequence, received)
        self.note_if(
            self._mapper.another_rate,
            "clock",
            "the box does not send at the rate its page gives; stamps are times of receipt",
        )
        if self.clock.now() - received > _OLD * 1e9:
            self.health.count("skipped")
            self._begin_block()
            return None
        # Of a block whose last record was lost.
        number, last = divmod(record.rdt_sequence, self._block)
        sample = self._average() if self._pending and number != self._number else None
        self._number = number
        quality = self._quality(record.status)
        self._pending_quality = max(self._pending_quality, quality)
        self._pending_status |= record.status
        self._pending.append((stamp, np.array(record.counts, dtype=float) * self._scale))
        if sample is None and last == self._block - 1:
            sample = self._average()
        return sample

    def _find_pause(self, earlier: rdt.Record, later: rdt.Record) -> None:
        """Map the numbering anew after a time in which the box measured but numbered nothing."""
        sent_rate, internal_rate = self._rates
        sent = rdt.difference(earlier.rdt_sequence, later.rdt_sequence) / sent_rate
        measured = rdt.difference(earlier.ft_sequence, later.ft_sequence) / internal_rate
        paused = measured - sent
        # A box that sends more slowly than its page says does so all the time.
        sudden = measured > _SUDDEN * self._usual_step
        if not sudden or paused <= LATE + sent + 1 / internal_rate:
            self._usual_step = measured
            self.cleared("paused")
            return
        self.note("paused", f"the box sent nothing for {paused:.2f} s")
        self._mapper.restart()

    def _average(self) -> WrenchSample:
        """Sample of the records that wait, which are forgotten."""
        stamps, wrenches = zip(*self._pending, strict=True)
        sample = WrenchSample.of_wrench(
            sum(stamps) // len(stamps),
            np.mean(wrenches, axis=0),
            self._pending_status,
            self._pending_quality,
        )
        self.health.notes.update(self._mapper.notes())
        self._begin_block()
        return sample

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

    @property
    def serial(self) -> str:
        return "" if self.configuration is None else self.configuration.serial
