# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The command `finger-rig`: the suite without ros2 launch, calibration, and a simulated study."""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from finger_bridge import lsl
from finger_bridge.foxglove_server import DEFAULT_PORT, require
from finger_common.cli import EXIT_INTERRUPTED, Parser, run
from finger_common.errors import InputError
from finger_common.files import user_path
from finger_common.folder_lock import lock_folder
from finger_common.guided_presses import CALIBRATION_PRESSES
from finger_common.namespaces import DEFAULT_NAMESPACE, default_folder
from finger_common.parameters import NOT_HERE
from finger_common.subject_code import FINGERS, check_subject, parameter_file_name
from finger_model.anthropometry import FINGERS as FINGER_NAMES
from finger_model.anthropometry import parse_length, session_geometry

from . import nodes
from .bring_up import ALL_ACTIVE
from .parameter_files import ParameterFile
from .supervisor import Supervisor

EXAMPLE = """\
finger-rig up --simulated             # on simulated devices; page at http://127.0.0.1:8080
finger-rig up --parameters rig.yaml   # real devices, as the file describes them
finger-rig up --fingers thumb index --compose --parameters hand.yaml   # fingers of a robot hand
finger-rig up --simulated --namespace thumb   # a second rig beside the first
finger-rig calibrate --subject S01    # nine guided presses on the running rig
finger-rig study --seed 1 --no-images -o out/study"""


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    top = Parser(
        prog="finger-rig",
        description="Run the finger contact suite, or simulate the paper's study.",
        example=EXAMPLE,
    )
    commands = top.add_subparsers(dest="command", required=True, parser_class=Parser)
    up = commands.add_parser(
        "up",
        help="start the suite and keep it running",
        description=(
            "Start the nodes of the rig in order and show their output. A node that ends "
            "unexpectedly is started again. Ctrl-C ends all. Each node is a process, unless "
            "--compose puts them into one."
        ),
        example=(
            "finger-rig up --simulated\n"
            "finger-rig up --parameters rig.yaml --without moisture\n"
            "finger-rig up --nodes force model --parameters robot.yaml\n"
            "finger-rig up --fingers thumb index --compose --parameters hand.yaml\n"
            "finger-rig up --simulated --foxglove"
        ),
    )
    up.add_argument("--simulated", action="store_true", help="simulated devices and participant")
    up.add_argument("--parameters", type=Path, metavar="FILE", help="ROS parameter file (YAML)")
    up.add_argument(
        "--namespace",
        help=f"namespace of all nodes (default: {DEFAULT_NAMESPACE}, with --fingers "
        f"{nodes.HAND_NAMESPACE})",
    )
    up.add_argument(
        "--fingers",
        nargs="*",
        metavar="NAME",
        help="run force and model once for each finger, in the namespace of its name; without "
        f"names: {' '.join(FINGERS)}",
    )
    up.add_argument(
        "--compose",
        action="store_true",
        help="run the nodes in one process: less processor time and delay for each sample",
    )
    up.add_argument(
        "--realtime",
        action="store_true",
        help="with --compose: that process has real-time priority, so that no other program delays "
        "samples (Linux; needs the right to real-time priority)",
    )
    up.add_argument("--nodes", nargs="+", metavar="NODE", help="run only these nodes")
    up.add_argument(
        "--without", nargs="+", default=[], metavar="NODE", help="leave out these nodes"
    )
    up.add_argument(
        "--folder",
        type=Path,
        help="folder of sessions and simulated devices (default: out/rig, and out/rig_NAMESPACE "
        "for other namespaces)",
    )
    up.add_argument(
        "--port", type=int, metavar="N", help="TCP port of the page (default: 8080, or a free one)"
    )
    up.add_argument(
        "--foxglove",
        nargs="?",
        const="",
        metavar="[HOST:]PORT",
        help=f"serve the live view in Foxglove (default: this machine only, port {DEFAULT_PORT})",
    )
    up.add_argument(
        "--lsl", action="store_true", help="exchange streams with the Lab Streaming Layer"
    )
    up.add_argument("--seed", type=int, help="seed of the simulated rig (default: 1)")
    _add_calibrate(commands)
    study = commands.add_parser(
        "study",
        help="simulate the paper's study into bags",
        description="Simulate the 45 trials of the paper (3 conditions × 15) into bags.",
        example="finger-rig study --seed 1 -o out/study\nfinger-rig study --no-images -o out/study",
    )
    study.add_argument("--seed", type=int, default=1, help="seed of the study (default: 1)")
    study.add_argument(
        "--no-images",
        action="store_true",
        help="write areas with measurement noise in place of images; the bags note it",
    )
    study.add_argument(
        "--misfit", action="store_true", help="simulate a finger that differs from the model"
    )
    study.add_argument(
        "--slip",
        action="store_true",
        help="hold each press at 1 N and pull it sideways until the finger slips, 30 frames/s",
    )
    study.add_argument(
        "--trials", type=int, default=15, help="trials per condition (default: 15, as in the paper)"
    )
    study.add_argument(
        "-o", "--output", type=Path, required=True, metavar="DIR", help="folder of the bags"
    )
    return top


def _add_calibrate(commands: Any) -> None:
    calibrate = commands.add_parser(
        "calibrate",
        help="calibrate a subject by nine guided presses",
        description=(
            "Guide nine presses on the running rig, fit them, and use the result in the model "
            "node at once. The result is kept in the model node's subjects_folder, as "
            "SUBJECT.yaml or with --finger as SUBJECT.FINGER.yaml. It is used whenever a session "
            "of this finger begins. With --width, the fit takes the lengths that 'finger-model "
            "geometry' makes of the readings, and the file holds them. Ctrl-C during the presses "
            "ends the session, and nothing is written. Ctrl-C after the last press does not stop "
            "the model node: it fits the presses and keeps the result."
        ),
        example=(
            "finger-rig calibrate --subject S01\n"
            "finger-rig calibrate --subject S01 --width 14mm --depth 11mm --again\n"
            "finger-rig calibrate --subject S01 --simulated"
        ),
    )
    calibrate.add_argument("--subject", required=True, metavar="CODE", help="such as S01")
    for name, example in (("width", "14mm"), ("depth", "11mm")):
        calibrate.add_argument(
            f"--{name}",
            metavar="LENGTH",
            help=f"{name} of the fingertip by calipers, such as {example}",
        )
    calibrate.add_argument("--age", type=int, metavar="YEARS", help="age of the subject")
    calibrate.add_argument("--finger", choices=FINGER_NAMES, help="finger that presses")
    calibrate.add_argument(
        "--again", action="store_true", help="replace an earlier calibration; its file is kept too"
    )
    calibrate.add_argument(
        "--simulated",
        action="store_true",
        help="start a simulated rig with a simulated participant",
    )
    calibrate.add_argument(
        "--namespace", help=f"namespace of the rig (default: {DEFAULT_NAMESPACE})"
    )
    calibrate.add_argument(
        "--folder", type=Path, help="folder of the simulated rig (default: that of 'finger-rig up')"
    )
    calibrate.add_argument(
        "--parameters",
        type=Path,
        metavar="FILE",
        help="parameter file of the simulated rig, as for 'finger-rig up'",
    )
    calibrate.add_argument("--seed", type=int, help="seed of the simulated rig (default: 1)")
    calibrate.set_defaults(fingers=None)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point with the conventions of all commands."""
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> int:
    arguments = parser().parse_args(argv)
    commands = {"up": _up, "calibrate": _calibrate, "study": _study}
    return commands[arguments.command](arguments)


# finger-rig up -------------------------------------------------------------------------------


def foxglove_address(text: str) -> dict[str, Any]:
    """Parameters of the node `foxglove` for "PORT", "HOST:PORT" or ""; raises InputError."""
    require()
    if not text:
        return {}
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > 65535:
        raise InputError(f"--foxglove {text}: give PORT or HOST:PORT, such as {DEFAULT_PORT}")
    return {"port": int(port), "host": host.strip("[]") or "127.0.0.1"}


def entries(
    arguments: argparse.Namespace, devices: nodes.Parameters | None = None
) -> list[nodes.NodeEntry]:
    """What `finger-rig up` runs; raises InputError for contradictory options.

    devices: parameters that connect the fingers of a hand to simulated sensors.
    """
    parameters: dict[str, dict[str, Any]] = {}
    needed: dict[str, str] = {}
    if arguments.seed is not None:
        parameters["simulated_rig"] = {"seed": arguments.seed}
        needed["--seed"] = "simulated_rig"
    if arguments.port is not None:
        if not 0 <= arguments.port <= 65535:
            raise InputError(f"--port {arguments.port}: give a TCP port, 1 to 65535")
        names = fingers(arguments)
        page = f"{names[0]}/page" if len(names) == 1 else "page"
        parameters[page] = {"port": arguments.port}
        needed["--port"] = page
    further = []
    if arguments.foxglove is not None:
        parameters["foxglove"] = foxglove_address(arguments.foxglove)
        further.append("foxglove")
    if arguments.lsl:
        if arguments.fingers is not None:
            raise InputError(
                "--lsl exchanges the streams of one finger; leave it out, or run a rig for that "
                "finger without --fingers"
            )
        lsl.require()
        further.append("lsl")
    if arguments.fingers is not None:
        chosen = nodes.hand(
            fingers(arguments),
            arguments.nodes or (),
            arguments.without,
            nodes.merged(devices or {}, parameters),
            further,
        )
    else:
        chosen = nodes.rig(
            folder_of(arguments),
            simulated=arguments.simulated,
            without=arguments.without,
            parameters=parameters,
            only=arguments.nodes or (),
            further=further,
        )
    if arguments.port is not None and sum(entry.name == "page" for entry in chosen) > 1:
        raise InputError(
            "--port: the pages of several fingers cannot share a port; leave it out, or set 'port' "
            "of each page in the parameter file"
        )
    for option, node in needed.items():
        if node not in {entry.path for entry in chosen}:
            raise InputError(
                f"{option} is for the node '{node}', which would not run; leave {option} out"
            )
    return chosen


def fingers(arguments: argparse.Namespace) -> Sequence[str]:
    """Names of the fingers of a hand; empty for a rig."""
    return () if arguments.fingers is None else arguments.fingers or FINGERS


def namespace_of(arguments: argparse.Namespace) -> str:
    """Namespace of all nodes."""
    usual = DEFAULT_NAMESPACE if arguments.fingers is None else nodes.HAND_NAMESPACE
    return usual if arguments.namespace is None else str(arguments.namespace)


def folder_of(arguments: argparse.Namespace) -> Path:
    """Absolute folder of the rig."""
    folder: Path = arguments.folder or default_folder(namespace_of(arguments))
    return user_path(folder).absolute()


def _warn(chosen: Sequence[nodes.NodeEntry], namespace: str, file: ParameterFile) -> None:
    """Name the sections of the parameter file that are of no node, and sensors of two fingers."""
    for doubt in (nodes.without_effect, nodes.shared_sensors):
        sentence = doubt(chosen, namespace, file)
        if sentence:
            print(f"finger-rig: {sentence}", file=sys.stderr)


def reach_line() -> str:
    """Who receives the topics: what to print where other computers do, else ""."""
    # rcl keeps to this computer with all other values, too.
    wide = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "") in ("", "SUBNET", "SYSTEM_DEFAULT")
    if not wide or os.environ.get("ROS_LOCALHOST_ONLY") == "1":
        return ""
    return (
        "topics, images of prints among them, reach the local network; "
        "with ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST other computers do not find them"
    )


_UNKNOWN = re.compile(rf"\[([\w.]+)\]: {NOT_HERE.format('([^ ]+)')}")


class ReadyLine:
    """Finds in the nodes' output that all are ready, where their pages are, and which parameters
    they do not have.

    pages: number of operator's pages among the nodes; fingers have one each.
    """

    def __init__(self, pages: int) -> None:
        self._pages = pages
        self._addresses: dict[str, str] = {}
        self._refused: dict[str, str] = {}
        """Why a page is not served."""
        self.unknown: dict[tuple[str, str], str] = {}
        """Sentences about (node, parameter) that a node does not have, by the node's full name."""
        self._active = False

    def take(self, text: str) -> str:
        """One line of output; returns what to print when it makes the rig ready, else ""."""
        found = re.search(r"(?:\[([\w.]*?)\.?page\]:? )?operator's page: (\S+)", text)
        refused = re.search(r"\[([\w.]*?)\.?page\]:? (?:configure|activate) failed: (.+)", text)
        unknown = _UNKNOWN.search(text)
        if unknown:
            self.unknown["/" + unknown[1].replace(".", "/"), unknown[2]] = text
        if found:
            self._addresses[found[1] or ""] = found[2]
            self._refused.pop(found[1] or "", None)
        elif refused:
            self._refused[refused[1]] = refused[2]
        elif ALL_ACTIVE in text:
            self._active = True
        else:
            return ""
        if not self._active or len(self._addresses) + len(self._refused) < self._pages:
            return ""
        if self._refused:
            return (
                f"ready but for the page, which is not served: {'; '.join(self._refused.values())}"
            )
        self._active = False
        if self._pages < 2:
            return ": page at ".join(("all ready", *self._addresses.values()))
        pages = (f"{name.rpartition('.')[2]} {url}" for name, url in self._addresses.items())
        return "all ready: pages at " + ", ".join(pages)


def _up(arguments: argparse.Namespace) -> int:
    if arguments.realtime and not arguments.compose:
        raise InputError("--realtime is for the process of --compose; give both")
    folder = folder_of(arguments)
    boards, devices = nodes.simulated_boards(fingers(arguments) if arguments.simulated else ())
    chosen = entries(arguments, devices)
    lock = lock_folder(folder, "a rig")
    namespace, file = namespace_of(arguments), ParameterFile(arguments.parameters)
    _warn(chosen, namespace, file)
    running = [entry.full_name(namespace) for entry in chosen]
    specs = boards + nodes.process_specs(
        chosen,
        folder,
        namespace,
        file,
        compose=arguments.compose,
        realtime=arguments.realtime,
    )
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    ready = ReadyLine(sum(entry.name == "page" for entry in chosen))
    reach = reach_line()
    if reach:
        print(f"finger-rig: {reach}", flush=True)

    def line(name: str, text: str) -> None:
        supervisor.show(name, text)
        news = ready.take(text)
        if news:
            print(f"finger-rig: {news}", flush=True)
            idle = file.unknown_parameters(running, ready.unknown)
            if idle:
                print(f"finger-rig: {file.path}: without effect: {', '.join(idle)}", flush=True)

    supervisor = Supervisor(specs, line)
    run_until_interrupted(supervisor)
    lock.close()
    return supervisor.exit_code


def run_until_interrupted(supervisor: Supervisor) -> bool:
    """Run its processes until an essential one ends, or Ctrl-C; whether it was Ctrl-C.

    The caller's handling of signals is restored, or its next processes would inherit that they are
    ignored.
    """
    interrupted = False
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    handlers = {number: signal.getsignal(number) for number in numbers}
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        supervisor.start()
        while not supervisor.wait(1.0):
            pass
    except KeyboardInterrupt:
        interrupted = True
        print("finger-rig: ending all nodes", flush=True)
    finally:
        # A second signal must not leave processes behind.
        for number in handlers:
            signal.signal(number, signal.SIG_IGN)
        supervisor.stop()
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return interrupted


# finger-rig calibrate ------------------------------------------------------------------------


def calibration_entries(arguments: argparse.Namespace) -> list[nodes.NodeEntry]:
    """What `finger-rig calibrate` runs; raises InputError for bad readings and codes."""
    check_subject(arguments.subject)
    own: dict[str, Any] = {"subject": arguments.subject, "again": arguments.again}
    for name in ("width", "depth"):
        text = getattr(arguments, name)
        if text is not None:
            own[f"finger_{name}"] = parse_length(text, f"--{name}")
    for name in ("finger", "age"):
        if getattr(arguments, name) is not None:
            own[name] = getattr(arguments, name)
    session_geometry(own)
    if not arguments.simulated:
        for name in ("seed", "folder"):
            if getattr(arguments, name) is not None:
                raise InputError(f"--{name} is for a simulated rig; give --simulated too")
        return nodes.select(["calibrate"], {"calibrate": own})
    name = parameter_file_name(arguments.subject, own.get("finger", ""))
    earlier = folder_of(arguments) / "subjects" / name
    if earlier.exists() and not arguments.again:
        raise InputError(
            f"subject {arguments.subject} is calibrated already ({earlier}); give --again to "
            "replace that"
        )
    # Planned while the nodes come up, with frames that are quick to draw.
    participant = {"upcoming": [f"{press.name}:1" for press in CALIBRATION_PRESSES]}
    quick = {"width": 640, "height": 512, "refinement": 0.5}
    seed = {} if arguments.seed is None else {"seed": arguments.seed}
    return nodes.rig(
        folder_of(arguments),
        simulated=True,
        without=("page",),
        parameters={
            "simulated_rig": {**participant, **quick, **seed},
            "calibrate": {**own, "patience": nodes.SIMULATED_PATIENCE},
        },
        further=("calibrate",),
    )


def _calibrate(arguments: argparse.Namespace) -> int:
    chosen = calibration_entries(arguments)
    folder = folder_of(arguments)
    lock = lock_folder(folder, "a rig") if arguments.simulated else None
    log = folder / "calibrate.log"
    names = namespace_of(arguments), ParameterFile(arguments.parameters)
    _warn(chosen, *names)
    with tempfile.TemporaryDirectory() as own:
        specs = nodes.process_specs(chosen, Path(own), *names)
        with open(log if lock else os.devnull, "w", encoding="utf-8") as lines:

            def line(name: str, text: str) -> None:
                if name == "calibrate" and not text.startswith("[supervisor]"):
                    print(text, flush=True)
                else:
                    lines.write(f"{name} | {text}\n")

            supervisor = Supervisor(specs, line)
            interrupted = run_until_interrupted(supervisor)
    if lock is not None:
        lock.close()
    return EXIT_INTERRUPTED if interrupted else supervisor.exit_code


# finger-rig study ----------------------------------------------------------------------------


def _study(arguments: argparse.Namespace) -> int:
    from finger_sim.study import simulate_study

    simulate_study(
        arguments.seed,
        arguments.output,
        images=not arguments.no_images,
        misfit=arguments.misfit,
        trials=arguments.trials,
        slip=arguments.slip,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
