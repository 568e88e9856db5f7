# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Opening a CAN bus through python-can, with the pitfalls of its interfaces taken care of.

`udp_multicast` with a hop limit of 0 (the default here) is served by `HostMulticastBus`: the same
datagrams as python-can's bus of that name, but joined on the loopback interface, so that it works
on a machine without any network, stays on the host, keeps groups apart and, as a CAN controller
does, does not echo a bus its own frames.
"""

from __future__ import annotations

import contextlib
import ctypes
import ipaddress
import select
import socket
import struct
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import can
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

from finger_common.errors import DeviceError, InputError, put_once
from finger_common.settings import Settings, setting

from .clock import receive_stamped, request_kernel_stamps

DEFAULT_CHANNEL = {
    "socketcan": "can0",
    "pcan": "PCAN_USBBUS1",
    "udp_multicast": "239.74.163.2",
    "virtual": "finger",
}
"""Channel used where none is given, by interface."""

DEFAULT_PORT = 43113

BUS_ERRORS = (can.CanError, OSError)
"""What a bus raises when it fails; some of python-can's pass on errors of a socket or port."""


@dataclass(frozen=True)
class CanSettings(Settings):
    """The bus of a device on CAN."""

    can_interface: str = setting(
        "socketcan",
        "python-can interface that the sensor is connected to: socketcan, pcan, slcan, socketcand, "
        "udp_multicast, virtual, …",
    )
    can_channel: str = setting(
        "", "Channel of that interface; empty for its usual one (socketcan: can0)."
    )
    can_bitrate: int = setting(
        0,
        "Bit rate; 0 leaves it as set, as socketcan needs.",
        unit="bit/s",
        minimum=0,
        maximum=1_000_000,
    )
    can_options: str = setting("", "Further options of the interface, key=value,key=value.")
    response_timeout: float = setting(
        0.05,
        "Time for a reply after which a poll counts as lost (netcanoem, and dbc with a request).",
        unit="s",
        minimum=0.001,
        maximum=1.0,
        advice="Long enough for a busy computer's pauses; shorter loses less time per lost reply.",
    )

    def open_bus(self) -> can.BusABC:
        """The bus; raises InputError and DeviceError as `open_bus` does."""
        return open_bus(self.can_interface, self.can_channel, self.can_bitrate, self.can_options)

    def where(self) -> str:
        """Interface and channel, for error sentences."""
        channel = self.can_channel or DEFAULT_CHANNEL.get(self.can_interface, "")
        return f"{self.can_interface} {channel}".rstrip()

    def bus(self) -> str:
        """What tells this bus from others, in words."""
        return f"{self.where()} {self.can_options}".rstrip()


class HostMulticastBus(can.BusABC):
    """CAN frames between processes of this host over UDP multicast on the loopback interface.

    Compatible on the wire with python-can's `udp_multicast`. Not modelled: bit rate, arbitration,
    acknowledgement, error frames. Delivery is as reliable as the kernel's socket buffers.
    """

    def __init__(
        self,
        channel: str = DEFAULT_CHANNEL["udp_multicast"],
        port: int = DEFAULT_PORT,
        **kwargs: Any,
    ) -> None:
        super().__init__(channel, **kwargs)
        self.channel_info = f"udp_multicast {channel}:{port} on this host"
        self._address = (channel, port)
        self._receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        loopback = socket.inet_aton("127.0.0.1")
        try:
            self._receiver.setblocking(False)
            self._receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if hasattr(socket, "SO_REUSEPORT"):
                self._receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            request_kernel_stamps(self._receiver)
            # Bound to the group, Linux delivers its datagrams only; Windows cannot bind to it.
            self._receiver.bind(("" if sys.platform == "win32" else channel, port))
            self._receiver.setsockopt(
                socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(channel) + loopback
            )
            self._sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            self._sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            self._sender.bind(("127.0.0.1", 0))
            self._own = self._sender.getsockname()
            _leave_out_sender(self._receiver, *self._own)
        except OSError as error:
            self.shutdown()
            raise can.CanInitializationError(f"{channel}:{port}: {error.strerror}") from error

    def recv(self, timeout: float | None = None) -> can.Message | None:
        # python-can's own loop is for filters; it costs as much as receiving.
        return super().recv(timeout) if self.filters else self._recv_internal(timeout)[0]

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            try:
                # Mostly something waits; asking first would double the calls of the system.
                data, stamped, sender = receive_stamped(self._receiver, 4096)
            except BlockingIOError:
                if timeout == 0 or not self._wait(end):
                    return None, False
                continue
            except OSError as error:
                raise can.CanOperationError(f"receiving failed: {error}") from error
            stamp = time.time() if stamped is None else stamped * 1e-9
            if sender == self._own:
                continue
            try:
                return unpack_message(data, replace={"timestamp": stamp}, check=True), False
            except Exception:
                # Not from python-can; a real controller drops what is no frame, too.
                continue

    def _wait(self, end: float | None) -> bool:
        """Wait until something can be received, at most until `end` (monotonic s)."""
        left = None if end is None else max(0.0, end - time.monotonic())
        try:
            return bool(select.select([self._receiver], [], [], left)[0])
        except (OSError, ValueError) as error:
            raise can.CanOperationError(f"receiving failed: {error}") from error

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        try:
            self._sender.sendto(pack_message(msg), self._address)
        except OSError as error:
            raise can.CanOperationError(f"sending failed: {error}") from error

    def fileno(self) -> int:
        return self._receiver.fileno()

    def shutdown(self) -> None:
        super().shutdown()
        self._receiver.close()
        self._sender.close()


_SO_ATTACH_FILTER = 26
_IP_HEADER = -0x100000
"""Offset of the IP header in a filter, which else sees the UDP header first (linux/filter.h)."""


def _leave_out_sender(receiver: socket.socket, address: str, port: int) -> None:
    """Have the kernel drop datagrams of one sender, on Linux: each would wake the receiver up."""
    if not sys.platform.startswith("linux"):
        return
    ip = struct.unpack("!I", socket.inet_aton(address))[0]
    load_half, load_word, jump_if_equal, give_back = 0x28, 0x20, 0x15, 0x06
    steps = (
        (load_half, 0, 0, 0),  # source port
        (jump_if_equal, 0, 3, port),
        (load_word, 0, 0, _IP_HEADER + 12 & 0xFFFFFFFF),  # source address
        (jump_if_equal, 0, 1, ip),
        (give_back, 0, 0, 0),  # nothing of it
        (give_back, 0, 0, 0xFFFF),  # all of it
    )
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *step) for step in steps))
    program = struct.pack("HP", len(steps), ctypes.addressof(code))
    receiver.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, program)


def parse_options(text: str) -> dict[str, Any]:
    """Options "key=value,key=value" as keyword arguments; numbers and booleans are converted.

    Raises InputError naming the part that cannot be read.
    """
    options: dict[str, Any] = {}
    for part in filter(None, (p.strip() for p in text.split(","))):
        key, separator, value = part.partition("=")
        if not separator or not key.strip().isidentifier():
            raise InputError(
                f"can_options: '{part}' is not key=value; write for example port=43113"
            )
        value = value.strip()
        converted: Any = {"true": True, "false": False}.get(value.lower(), value)
        if converted is value:
            for kind in (lambda v: int(v, 0), float):
                with contextlib.suppress(ValueError):
                    converted = kind(value)
                    break
        put_once(options, key.strip(), converted, "can_options")
    return options


def open_bus(
    interface: str = "socketcan",
    channel: str = "",
    bitrate: int = 0,
    options: str | dict[str, Any] = "",
) -> can.BusABC:
    """Open a bus of any python-can interface.

    channel "" is the interface's usual one; bitrate 0 leaves it as it is set. `options` are further
    keyword arguments of the interface, as a dict or as "key=value,…". Raises InputError for
    arguments that cannot be used and DeviceError when the bus does not open.
    """
    arguments = dict(options) if isinstance(options, dict) else parse_options(options)
    channel = channel or DEFAULT_CHANNEL.get(interface, "")
    if interface not in can.VALID_INTERFACES:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise InputError(f"can_interface '{interface}' does not exist; known are {known}")
    if bitrate:
        arguments.setdefault("bitrate", bitrate)
    where = f"{interface} {channel}".strip()
    try:
        if interface == "udp_multicast":
            arguments.pop("bitrate", None)
            hops = int(arguments.pop("hop_limit", 0))
            if ipaddress.ip_address(channel).version == 4 and hops == 0:
                return HostMulticastBus(channel, **arguments)
            arguments["hop_limit"] = hops
        if interface == "socketcan":
            # Set with `ip link`; as an argument it would be ignored.
            arguments.pop("bitrate", None)
        bus = can.Bus(interface=interface, channel=channel or None, **arguments)
    except (TypeError, ValueError) as error:
        raise InputError(f"can bus {where}: {error}; correct can_channel or can_options") from None
    except (*BUS_ERRORS, ImportError, NotImplementedError) as error:
        look = f" and `ip link show {channel}`" if interface == "socketcan" else " and can_channel"
        raise DeviceError(
            f"can bus {where} does not open ({error}); check the cable, the driver{look}"
        ) from None
    # Of an adapter on a serial port. Another program there, such as the driver of a probe, would
    # take a part of the replies.
    port = getattr(bus, "serialPortOrig", None)
    if port is not None:
        try:
            port.exclusive = True
        except OSError:
            bus.shutdown()
            raise DeviceError(
                f"can bus {where}: the port is in use by another program or node; correct "
                "can_channel, or end the other"
            ) from None
    return bus


def discard_waiting(bus: can.BusABC) -> None:
    """Discard the frames that wait in the receive queue."""
    # Bounded: a bus that is flooded must not hold the driver here for ever.
    for _ in range(10_000):
        if bus.recv(0) is None:
            return


def frame(identifier: int, data: Iterable[int], extended: bool = False) -> can.Message:
    """Data frame; 11-bit identifier unless `extended`."""
    return can.Message(arbitration_id=identifier, data=bytes(data), is_extended_id=extended)


def stamp_of(message: can.Message) -> int | None:
    """Wall time (ns) that the interface gave a frame, None where it gave none."""
    return round(message.timestamp * 1e9) if message.timestamp else None


def may_be_own(bus: can.BusABC, message: can.Message) -> bool:
    """Whether a received frame may be an own one that came back.

    python-can's `udp_multicast` echoes without a mark. socketcan marks all frames of this computer.
    """
    return isinstance(bus, UdpMulticastBus) or not message.is_rx


def can_be_awaited(bus: can.BusABC) -> bool:
    """Whether `select` tells when a frame has come, with nothing kept back in this process."""
    return isinstance(bus, (HostMulticastBus, SocketcanBus)) and not sys.platform == "win32"


def describe(bus: can.BusABC) -> str:
    """Description of the bus."""
    return str(getattr(bus, "channel_info", "") or type(bus).__name__)
