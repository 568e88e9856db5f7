# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""An ATI Net F/T box: RDT over UDP with its XML page over HTTP.

Models: start, stop and bias requests, one client at a time, endless and counted streams, real-time
and buffered mode, both sequence numbers, the status word, counts and units as on the page, output
rates as integer fractions of the internal rate and, as an Axia, beyond it (samples repeat),
`comm.cgi` for the rate, reboot (silent, then waiting for a new start, without the bias); see
FAULTS.

Does not model: the box's filter, another buffer size than ten records, monitor conditions, tool
transforms, the slow TCP interface, EtherNet/IP, CAN, further pages, the transducer's noise beyond
white noise, network loss (but see FAULTS).
"""

from __future__ import annotations

import dataclasses
import http.server
import math
import select
import socket
import threading
import time
import urllib.parse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from finger_common.errors import DeviceError, InputError
from finger_common.settings import setting

from ..protocols import netft_xml, rdt
from .simulator import Simulator
from .values import LoadOptions

FAULTS = {
    "silent": "sends no record and answers no page",
    "gap": "leaves out a record; its number is missing",
    "duplicate": "sends a record twice",
    "reordered": "sends a record after the next one",
    "restart": "the numbering of the records restarts",
    "stalled": "the internal sample number stands still",
    "short": "sends a datagram of 20 bytes",
    "status": "status word of the records",
    "reboot": "restarts: silent for half a second, then waits for a new start",
    "bad_page": "the page is cut off in the middle",
    "jump": "sends a wild record numbered 1000 ahead before a record",
}

DEFAULT_CONFIGURATION = netft_xml.Configuration(
    1_000_000, 1_000_000, "N", "N-mm", "Simulated Net F/T", True, 500.0, rdt.INTERNAL_RATE
)


@dataclass(frozen=True)
class NetFtOptions(LoadOptions):
    """Options of the simulated box."""

    host: str = setting("127.0.0.1", "Address to serve on.")
    port: int = setting(rdt.PORT, "UDP port; 0 for any free one.", minimum=0, maximum=65535)
    http_port: int = setting(
        8080, "Port of the page; 0 for any free one.", minimum=0, maximum=65535
    )
    noise: float = setting(0.002, "Standard deviation.", unit="N", minimum=0)


class NetFtSimulator(Simulator):
    """ATI Net F/T: RDT over UDP with its XML page.

    Ports 0 are chosen free; `port` and `http_port` give them. The noise of the torque is 1e-3 times
    that of the force.
    """

    NAME = "rdt"
    SETTINGS = NetFtOptions
    FAULTS = FAULTS

    def __init__(self, settings: NetFtOptions) -> None:
        super().__init__()
        self.configuration = DEFAULT_CONFIGURATION
        self._host = settings.host
        self._force = settings.load()
        self._noise = settings.noise * np.array([1.0] * 3 + [1e-3] * 3)
        self._random = np.random.default_rng(1)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((self._host, settings.port))
            page_address = (self._host, settings.http_port)
            self._server = http.server.ThreadingHTTPServer(page_address, self._handler())
        except OSError as error:
            raise InputError(
                f"{self._host}, ports {settings.port} and {settings.http_port}: {error.strerror}; "
                "choose others"
            ) from None
        self.port = int(self._socket.getsockname()[1])
        self._server.daemon_threads = True
        self.http_port = int(self._server.server_address[1])
        self._client: tuple[str, int] | None = None
        self._left = 0.0
        """Records to send yet."""
        self._rdt = 0
        self._ft = 0.0
        self._per_datagram = 1
        self._bias: np.ndarray = np.zeros(6)
        self._held: bytes | None = None
        self._down_until = 0.0
        self._pages = threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True)

    def describe(self) -> str:
        return f"on {self._host}: RDT port {self.port}, HTTP port {self.http_port}"

    def commands(self) -> dict[str, Callable[..., None]]:
        return {"units": self.set_units}

    def start(self) -> NetFtSimulator:
        self._pages.start()
        return super().start()

    def close(self) -> None:
        if self._pages.is_alive():
            self._server.shutdown()
        self._server.server_close()
        self._socket.close()

    def set_units(
        self, force: str, torque: str, counts: float | str, torque_counts: float | str
    ) -> None:
        """Change units and counts, on the page and in the stream, as its web page does.

        Raises InputError for what the box could not have.
        """
        changed = dataclasses.replace(
            self.configuration,
            force_unit=force,
            torque_unit=torque,
            counts_per_force=float(counts),
            counts_per_torque=float(torque_counts),
        )
        try:
            netft_xml.parse(netft_xml.render(changed))
        except DeviceError as error:
            raise InputError(f"units: {error}") from None
        self.configuration = changed

    @property
    def _rate(self) -> float:
        """Records per second."""
        return rdt.real_rate(self.configuration.rdt_rate, self.configuration.internal_rate)

    @property
    def _down(self) -> bool:
        return bool(self.faults.value("silent")) or time.monotonic() < self._down_until

    def _handler(self) -> type[http.server.BaseHTTPRequestHandler]:
        box = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                url = urllib.parse.urlparse(self.path)
                if box._down:
                    # A box without power does not even close the connection.
                    time.sleep(0.5)
                    self.close_connection = True
                    return
                if url.path == "/comm.cgi":
                    box._configure(urllib.parse.parse_qs(url.query))
                    page = b"ok"
                elif url.path == netft_xml.PAGE:
                    page = netft_xml.render(box.configuration)
                    if box.faults.take("bad_page"):
                        page = page[: len(page) // 2]
                else:
                    self.send_error(404)
                    return
                self.send_response(200)
                self.send_header("Content-Length", str(len(page)))
                self.end_headers()
                self.wfile.write(page)

            def log_message(self, *arguments: object) -> None:
                pass

        return Handler

    def _configure(self, query: dict[str, list[str]]) -> None:
        try:
            rate = float(query.get("comrdtrate", ["0"])[0])
        except ValueError:
            return
        if 1 <= rate <= self.configuration.internal_rate:
            self.configuration = dataclasses.replace(self.configuration, rdt_rate=rate)

    def run(self) -> None:
        due = time.monotonic()
        while not self.ending:
            wait = 0.05 if self._client is None else max(0.0, min(due - time.monotonic(), 0.05))
            if select.select([self._socket], [], [], wait)[0]:
                self._request()
            now = time.monotonic()
            if self.faults.take("reboot"):
                self._down_until, self._client = now + 0.5, None
                self._rdt, self._ft, self._bias = 0, 0.0, np.zeros(6)
            if self._client is None or self._down:
                due = now
                continue
            if now < due:
                continue
            period = self._per_datagram / self._rate
            due = max(due + period, now - 0.1)
            self._send(self._client)

    def _request(self) -> None:
        try:
            data, sender = self._socket.recvfrom(64)
            command, count = rdt.decode_request(data)
        except (DeviceError, OSError):
            return
        if self._down:
            return
        if command in (rdt.START_REALTIME, rdt.START_BUFFERED):
            self._client, self._left, self._rdt = sender, count or math.inf, 0
            self._held = None
            self._per_datagram = 1 if command == rdt.START_REALTIME else 10
        elif command == rdt.STOP:
            self._client = None
        elif command == rdt.SET_BIAS:
            self._bias = np.array(self._force(time.time_ns()), dtype=float)

    def _send(self, client: tuple[str, int]) -> None:
        number = int(min(self._per_datagram, self._left))
        self._left -= number
        if self._left == 0:
            self._client = None
        data = b"".join(self._record() for _ in range(number))
        if self.faults.take("gap"):
            return
        if self.faults.take("short"):
            data = data[:20]
        datagrams = [data]
        if self.faults.take("jump"):
            ahead = rdt.Record(self._rdt + 1000, int(self._ft) + 14_000, 0, (50_000_000,) * 6)
            datagrams.insert(0, rdt.encode_record(ahead))
        if self.faults.take("reordered"):
            self._held = data
            return
        if self._held is not None:
            datagrams.append(self._held)
            self._held = None
        if self.faults.take("duplicate"):
            datagrams.append(data)
        for datagram in datagrams:
            try:
                self._socket.sendto(datagram, client)
            except OSError:
                self._client = None
                return

    def _record(self) -> bytes:
        if self.faults.take("restart"):
            self._rdt = 0
        self._rdt += 1
        if not self.faults.value("stalled"):
            self._ft += self.configuration.internal_rate / self._rate
        wrench = np.asarray(self._force(time.time_ns())) - self._bias
        wrench = wrench + self._noise * self._random.standard_normal(6)
        configuration = self.configuration
        scale = [configuration.force_scale] * 3 + [configuration.torque_scale] * 3
        counts = np.clip(np.rint(wrench / np.array(scale)), -(2**31), 2**31 - 1)
        status = self.faults.value("status") & 0xFFFFFFFF
        values = tuple(int(c) for c in counts)
        # Sums of fractions that should be whole may lie a little below.
        internal = int(self._ft + 1e-3)
        return rdt.encode_record(rdt.Record(self._rdt, internal, status, values))  # type: ignore[arg-type]
