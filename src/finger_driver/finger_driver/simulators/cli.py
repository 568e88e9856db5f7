# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-device-sim`: one simulated device in a process of its own.

Its subcommands are the simulators of the installed sources.
"""

from __future__ import annotations

import os
import pkgutil
import select
import signal
import sys
import threading
from collections.abc import Sequence
from typing import Any

from finger_common.cli import Parser, add_settings, one_line, run, settings_from
from finger_common.errors import InputError
from finger_common.plugins import PluginKind, title_of

from .. import camera, force, moisture
from .simulator import Simulator

EXAMPLE = """
finger-device-sim netcanoem --interface udp_multicast --options port=43210 --press 1.35
finger-device-sim serial --link run/moisture --values 42,43,41 --period 5
finger-device-sim images run/frames --size 1280x1024 --rate 10
While it runs, a line 'silent -1' on standard input switches a fault on, 'silent 0' off, 'clear' all
off, 'faults' lists them.
"""


def simulator_of(sources: PluginKind[Any], name: str) -> type[Simulator] | None:
    """Simulator that an installed source names, None where it names none.

    Raises InputError for a source or a simulator that cannot be used.
    """
    path = sources.load(name).SIMULATOR
    if not path:
        return None
    try:
        found = pkgutil.resolve_name(path)
    except Exception as error:
        raise InputError(f"simulator {path} of '{name}' cannot be imported: {error}") from error
    if not (isinstance(found, type) and issubclass(found, Simulator) and found.NAME):
        raise InputError(f"simulator {path} of '{name}' is not a Simulator with a NAME; correct it")
    return found


def installed() -> tuple[dict[str, type[Simulator]], list[str]]:
    """All simulators by the name of their subcommand, and why others cannot be used."""
    found: dict[str, type[Simulator]] = {}
    problems = []
    for sources in (force.SOURCES, camera.SOURCES, moisture.SOURCES):
        for name in sources.names():
            try:
                simulator = simulator_of(sources, name)
            except InputError as error:
                problems.append(one_line(error))
            else:
                if simulator is not None:
                    found[simulator.NAME] = simulator
    return found, problems


def _serve_commands(simulator: Simulator) -> None:
    """Serve commands from standard input until it ends; then wait for a signal."""
    stopped = threading.Event()
    # A parent that closes our input still wants the device; only a signal ends it.
    signal.signal(signal.SIGTERM, lambda *_: stopped.set())
    signal.signal(signal.SIGINT, lambda *_: stopped.set())
    buffer = b""
    listening = True
    while not stopped.is_set():
        if not listening:
            stopped.wait(0.2)
        elif select.select([0], [], [], 0.2)[0]:
            data = os.read(0, 4096)
            listening = bool(data)
            *lines, buffer = (buffer + data).split(b"\n")
            for line in lines:
                _command(line.decode(errors="replace").split(), simulator)


def _command(words: list[str], simulator: Simulator) -> None:
    if not words:
        return
    name, *arguments = words
    faults, commands = simulator.faults, simulator.commands()
    try:
        if name in commands:
            commands[name](*arguments)
        elif name == "clear":
            faults.clear()
        elif name == "faults":
            for fault, meaning in faults.meanings.items():
                print(f"{fault}: {meaning}")
        else:
            faults.set(name, int(arguments[0], 0) if arguments else -1)
        print(f"ok {' '.join(words)}", flush=True)
    except (InputError, ValueError, TypeError) as error:
        print(f"refused: {error}", flush=True)


def build_parser(simulators: dict[str, type[Simulator]]) -> Parser:
    """The command's arguments."""
    parser = Parser(
        prog="finger-device-sim",
        description="Run one simulated device. DEVICE is one of the installed simulators:",
        example=EXAMPLE,
    )
    commands = parser.add_subparsers(dest="device", required=True, metavar="DEVICE")
    for name, simulator in sorted(simulators.items()):
        title = title_of(simulator)
        command = commands.add_parser(name, help=title, description=title)
        if simulator.POSITIONAL:
            described = simulator.SETTINGS.parameters()[simulator.POSITIONAL]
            command.add_argument(simulator.POSITIONAL, help=described.meaning)
        add_settings(command, simulator.SETTINGS, without=simulator.POSITIONAL)
    return parser


def _main(argv: Sequence[str] | None = None) -> int:
    simulators, problems = installed()
    for problem in problems:
        print(f"finger-device-sim: left out: {problem}", file=sys.stderr)
    arguments = build_parser(simulators).parse_args(argv)
    cls = simulators[arguments.device]
    simulator = cls.from_settings(settings_from(arguments, cls.SETTINGS))
    print(cls.limits(), flush=True)
    with simulator:
        print(f"ready {simulator.describe()}", flush=True)
        _serve_commands(simulator)
    return 0


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of `finger-device-sim`."""
    sys.exit(run(_main, argv))


if __name__ == "__main__":
    main()
