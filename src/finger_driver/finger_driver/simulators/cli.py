"""`finger-device-sim`: one simulated device in a process of its own."""

from __future__ import annotations

import argparse
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.cli import Parser, run
from finger_common.errors import InputError
from finger_common.files import read_csv

from .. import can_bus
from .faults import Faults
from .values import constant_wrench, pressing_wrench, recorded_wrench

EXAMPLE = """
finger-device-sim netcanoem --interface udp_multicast --options port=43210 --press 1.35
finger-device-sim serial --link run/moisture --values 42,43,41 --period 5
finger-device-sim images run/frames --size 1280x1024 --rate 10
While it runs, a line `silent -1` on standard input switches a fault on, `silent 0` off, `clear` all off,
`faults` lists them.
"""


def _commands(faults: Faults, extra: dict[str, Callable[[list[str]], None]]) -> None:
    """Serve commands from standard input until it ends; then wait to be told to stop."""
    stopped = threading.Event()
    # A parent that closes our input still wants the device; only a signal ends it.
    signal.signal(signal.SIGTERM, lambda *_: stopped.set())
    signal.signal(signal.SIGINT, lambda *_: stopped.set())
    buffer = b""
    listening = True
    while not stopped.is_set():
        if not listening:
            stopped.wait(0.2)
            continue
        ready, _, _ = select.select([0], [], [], 0.2)
        if not ready:
            continue
        data = os.read(0, 4096)
        if not data:
            listening = False
            continue
        *lines, buffer = (buffer + data).split(b"\n")
        for line in lines:
            _command(line.decode(errors="replace").split(), faults, extra)


def _command(
    words: list[str], faults: Faults, extra: dict[str, Callable[[list[str]], None]]
) -> None:
    if not words:
        return
    try:
        if words[0] in extra:
            extra[words[0]](words[1:])
        elif words[0] == "clear":
            faults.clear()
        elif words[0] == "faults":
            for name, meaning in faults.meanings.items():
                print(f"{name}: {meaning}")
        else:
            faults.set(words[0], int(words[1], 0) if len(words) > 1 else -1)
        print(f"ok {' '.join(words)}", flush=True)
    except (InputError, ValueError, IndexError) as error:
        print(f"refused: {error}", flush=True)


def _force_arguments(parser: argparse.ArgumentParser) -> None:
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--wrench", default="0,0,0,0,0,0", help="constant FX,FY,FZ,TX,TY,TZ in N and N m"
    )
    which.add_argument(
        "--press", type=float, metavar="N", help="press to this force and release, over and over"
    )
    which.add_argument(
        "--csv", metavar="FILE", help="force over time, columns time_s,force_n, over and over"
    )
    parser.add_argument(
        "--axis", default="+z", choices=("+x", "-x", "+y", "-y", "+z", "-z"),
        help="axis of the sensor along which --press and --csv push (default +z)",
    )  # fmt: skip


def _force(args: argparse.Namespace) -> Callable[[int], np.ndarray]:
    if args.csv:
        table = read_csv(args.csv, ["time_s", "force_n"])
        return recorded_wrench(table["time_s"], table["force_n"], args.axis)
    if args.press is not None:
        return pressing_wrench(args.press, args.axis)
    return constant_wrench(args.wrench)


def _say_limits(module: Any) -> None:
    text = " ".join((module.__doc__ or "").split())
    start = max(text.find("Does not model"), 0)
    print(text[start:], flush=True)


def _netcanoem(args: argparse.Namespace) -> None:
    from . import netcanoem

    force = _force(args)
    bus = can_bus.open_bus(args.interface, args.channel, args.bitrate, args.options)
    simulator = netcanoem.NetcanoemSimulator(
        bus, force, base=args.base, noise=args.noise, response_time=args.response_time
    )
    simulator.slots = {slot: netcanoem.default_calibration(slot) for slot in args.slots}
    _say_limits(netcanoem)
    simulator.start()
    print(f"ready on {can_bus.describe(bus)}, base 0x{args.base:02X}", flush=True)

    def units(words: list[str]) -> None:
        simulator.unit_codes = (int(words[0]), int(words[1]))

    try:
        _commands(
            simulator.faults, {"power": lambda words: simulator.power_cycle(), "units": units}
        )
    finally:
        simulator.stop()
        bus.shutdown()


def _serial(args: argparse.Namespace) -> None:
    from . import serial_moisture

    values = _numbers(args.values, "--values")
    with serial_moisture.SerialMoistureSimulator(args.link) as simulator:
        _say_limits(serial_moisture)
        print(f"ready on {simulator.port}", flush=True)

        def send(words: list[str]) -> None:
            simulator.send(float(words[0]), words[1] if len(words) > 1 else "before")

        def tick(index: int) -> None:
            if values:
                simulator.send(values[index % len(values)])

        with _Periodic(args.period if values else 0.0, tick):
            _commands(
                simulator.faults,
                {
                    "send": send,
                    "unplug": lambda words: simulator.unplug(),
                    "plug": lambda words: simulator.plug_in(),
                },
            )


def _rdt(args: argparse.Namespace) -> None:
    from . import netft

    simulator = netft.NetFtSimulator(
        _force(args), args.host, args.port, args.http_port, noise=args.noise
    )
    _say_limits(netft)
    simulator.start()
    print(
        f"ready on {args.host}: RDT port {simulator.port}, HTTP port {simulator.http_port}",
        flush=True,
    )

    def units(words: list[str]) -> None:
        simulator.set_units(words[0], words[1], float(words[2]), float(words[3]))

    try:
        _commands(simulator.faults, {"units": units})
    finally:
        simulator.stop()


def _rft(args: argparse.Namespace) -> None:
    from . import rft

    force = _force(args)
    bus = can_bus.open_bus(args.interface, args.channel, args.bitrate, args.options)
    simulator = rft.RftSimulator(bus, force, noise=args.noise)
    _say_limits(rft)
    simulator.start()
    print(f"ready on {can_bus.describe(bus)}", flush=True)
    try:
        _commands(simulator.faults, {})
    finally:
        simulator.stop()
        bus.shutdown()


def _export(args: argparse.Namespace) -> None:
    from . import export

    values = _numbers(args.values, "--values")
    simulator = export.ExportFileSimulator(args.path, args.encoding)
    _say_limits(export)
    print(f"ready in {args.path}", flush=True)

    def send(words: list[str]) -> None:
        simulator.send(float(words[0]), words[1] if len(words) > 1 else "before")

    def tick(index: int) -> None:
        simulator.send(values[index % len(values)])

    with _Periodic(args.period if values else 0.0, tick):
        _commands(simulator.faults, {"send": send})


def _images(args: argparse.Namespace) -> None:
    from . import images
    from .values import moving_disc

    width, height = _size(args.size)
    writer = images.FrameFolderWriter(args.folder, keep=args.keep)
    render = moving_disc(height, width)
    _say_limits(images)
    print(f"ready in {args.folder}", flush=True)

    rate = [args.rate]

    def set_rate(words: list[str]) -> None:
        rate[0] = float(words[0])
        ticker.period = 1 / rate[0]

    def tick(index: int) -> None:
        writer.write(time.time_ns(), render(index))

    with _Periodic(1 / args.rate, tick) as ticker:
        _commands(writer.faults, {"rate": set_rate})


def _numbers(text: str, what: str) -> list[float]:
    try:
        return [float(v) for v in text.split(",") if v.strip()]
    except ValueError:
        raise InputError(f"{what} '{text}': numbers separated by commas are needed") from None


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) and int(height)):
        raise InputError(f"--size '{text}': write for example 1280x1024")
    return int(width), int(height)


class _Periodic:
    """Calls `action(index)` every `period` seconds in a thread; never when the period is 0."""

    def __init__(self, period: float, action: Callable[[int], None]) -> None:
        self.period = period
        self._action = action
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> _Periodic:
        if self.period:
            self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(5)

    def _run(self) -> None:
        index, due = 0, time.monotonic()
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            self._action(index)
            index += 1
            due = max(due + self.period, time.monotonic() - self.period)


def build_parser() -> Parser:
    """The command's arguments."""
    parser = Parser(prog="finger-device-sim", description=__doc__, example=EXAMPLE)
    commands = parser.add_subparsers(dest="device", required=True, metavar="DEVICE")

    p = commands.add_parser("netcanoem", help="ATI NETCANOEM on a CAN bus")
    p.add_argument("--interface", default="udp_multicast", help="python-can interface")
    p.add_argument("--channel", default="", help="its channel")
    p.add_argument("--bitrate", type=int, default=0)
    p.add_argument("--options", default="", help="its options, key=value,…")
    p.add_argument("--base", type=lambda v: int(v, 0), default=0x20, help="base identifier")
    p.add_argument("--slots", type=lambda v: [int(s) for s in v.split(",")], default=[0],
                   help="slots that hold a calibration, e.g. 0,3")  # fmt: skip
    p.add_argument("--noise", type=float, default=1.0, help="standard deviation, counts")
    p.add_argument("--response-time", type=float, default=0.0, help="s")
    _force_arguments(p)
    p.set_defaults(run=_netcanoem)

    p = commands.add_parser("serial", help="serial moisture adapter on a pty")
    p.add_argument("--link", help="symbolic link to the pty")
    p.add_argument("--values", default="", help="readings to send over and over")
    p.add_argument("--period", type=float, default=5.0, help="s between readings")
    p.set_defaults(run=_serial)

    p = commands.add_parser("rdt", help="ATI Net F/T: RDT over UDP with its XML page")
    p.add_argument("--host", default="127.0.0.1")
    p.add_argument("--port", type=int, default=49152, help="UDP port (0: any free)")
    p.add_argument("--http-port", type=int, default=8080, help="port of the page (0: any free)")
    p.add_argument("--noise", type=float, default=0.002, help="standard deviation, N")
    _force_arguments(p)
    p.set_defaults(run=_rdt)

    p = commands.add_parser("rft", help="Robotous RFT on a CAN bus")
    p.add_argument("--interface", default="udp_multicast", help="python-can interface")
    p.add_argument("--channel", default="", help="its channel")
    p.add_argument("--bitrate", type=int, default=0)
    p.add_argument("--options", default="", help="its options, key=value,…")
    p.add_argument("--noise", type=float, default=0.01, help="standard deviation, N")
    _force_arguments(p)
    p.set_defaults(run=_rft)

    p = commands.add_parser("export", help="export file of a moisture program")
    p.add_argument("path", type=Path, help="file to write, .csv or .xlsx")
    p.add_argument("--encoding", default="utf-8")
    p.add_argument("--values", default="", help="readings to write over and over")
    p.add_argument("--period", type=float, default=5.0, help="s between readings")
    p.set_defaults(run=_export)

    p = commands.add_parser("images", help="camera that writes frames into a folder")
    p.add_argument("folder", type=Path)
    p.add_argument("--size", default="1280x1024", help="WIDTHxHEIGHT")
    p.add_argument("--rate", type=float, default=10.0, help="frames per second")
    p.add_argument("--keep", type=int, default=50, help="newest files kept")
    p.set_defaults(run=_images)
    return parser


def _main(argv: Sequence[str] | None = None) -> int:
    args = build_parser().parse_args(argv)
    if getattr(args, "base", 0) not in range(128):
        raise InputError(f"--base {args.base}: 0 … 0x7F is possible")
    args.run(args)
    return 0


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of `finger-device-sim`."""
    sys.exit(run(_main, argv))


if __name__ == "__main__":
    main()
