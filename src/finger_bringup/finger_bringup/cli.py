"""The command `finger-rig`: the suite without ros2 launch, and the paper's study in simulation."""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from finger_common.cli import Parser, run
from finger_common.folder_lock import lock_folder

from . import nodes
from .bring_up import ALL_ACTIVE
from .supervisor import Supervisor

EXAMPLE = """\
finger-rig up --simulated             # on simulated devices; page at http://127.0.0.1:8080
finger-rig up --parameters rig.yaml   # real devices, as the file describes them
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
        help="start the suite as separate processes and keep it running",
        description=(
            "Start the nodes of the rig in order and show their output. A node that ends "
            "unexpectedly is started again. Ctrl-C ends all."
        ),
        example=(
            "finger-rig up --simulated\n"
            "finger-rig up --parameters rig.yaml --without moisture\n"
            "finger-rig up --nodes force model --parameters robot.yaml"
        ),
    )
    up.add_argument("--simulated", action="store_true", help="simulated devices and participant")
    up.add_argument("--parameters", type=Path, metavar="FILE", help="ROS parameter file (YAML)")
    up.add_argument(
        "--namespace",
        default=nodes.DEFAULT_NAMESPACE,
        help="namespace of all nodes (default: %(default)s)",
    )
    up.add_argument("--nodes", nargs="+", metavar="NODE", help="run only these nodes")
    up.add_argument(
        "--without", nargs="+", default=[], metavar="NODE", help="leave out these nodes"
    )
    up.add_argument(
        "--folder",
        type=Path,
        default=Path("out/rig"),
        help="folder of sessions and simulated devices (default: %(default)s)",
    )
    up.add_argument("--seed", type=int, default=1, help="seed of the simulated rig (default: 1)")
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
        "--trials", type=int, default=15, help="trials per condition (default: 15, as in the paper)"
    )
    study.add_argument(
        "-o", "--output", type=Path, required=True, metavar="DIR", help="folder of the bags"
    )
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point with the conventions of all commands."""
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> int:
    arguments = parser().parse_args(argv)
    return _up(arguments) if arguments.command == "up" else _study(arguments)


# finger-rig up -------------------------------------------------------------------------------


def entries(arguments: argparse.Namespace) -> list[nodes.NodeEntry]:
    """What `finger-rig up` runs; raises InputError for contradictory options."""
    return nodes.rig(
        arguments.folder.absolute(),
        simulated=arguments.simulated,
        without=arguments.without,
        parameters={"simulated_rig": {"seed": arguments.seed}},
        only=arguments.nodes or (),
    )


class ReadyLine:
    """Finds in the nodes' output that all are ready, and where the page is.

    page: whether the operator's page is among the nodes.
    """

    def __init__(self, page: bool) -> None:
        self._page = page
        self._address = ""
        self._active = False

    def take(self, text: str) -> str:
        """One line of output; returns what to print when it makes the rig ready, else ""."""
        address = re.search(r"operator's page: (\S+)", text)
        if address:
            self._address = address[1]
        elif ALL_ACTIVE in text:
            self._active = True
        else:
            return ""
        if not self._active or (self._page and not self._address):
            return ""
        self._active = False
        return "all ready" + (f": page at {self._address}" if self._page else "")


def _up(arguments: argparse.Namespace) -> int:
    folder = arguments.folder.absolute()
    chosen = entries(arguments)
    lock = lock_folder(folder, "a rig")
    specs = nodes.process_specs(chosen, folder, arguments.namespace, arguments.parameters)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    ready = ReadyLine("page" in {entry.name for entry in chosen})

    def line(name: str, text: str) -> None:
        supervisor.show(name, text)
        news = ready.take(text)
        if news:
            print(f"finger-rig: {news}", flush=True)

    supervisor = Supervisor(specs, line)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        supervisor.start()
        while not supervisor.wait(1.0):
            pass
    except KeyboardInterrupt:
        print("finger-rig: ending all nodes", flush=True)
    finally:
        # A second Ctrl-C must not leave processes behind.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        supervisor.stop()
        lock.close()
    return supervisor.exit_code


# finger-rig study ----------------------------------------------------------------------------


def _study(arguments: argparse.Namespace) -> int:
    from finger_sim.study import simulate_study

    simulate_study(
        arguments.seed,
        arguments.output,
        images=not arguments.no_images,
        misfit=arguments.misfit,
        trials=arguments.trials,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
