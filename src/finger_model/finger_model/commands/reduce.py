"""`finger-model reduce`: build the reduced model of a geometry."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from finger_common.errors import InputError

from ..geometry import Geometry


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "reduce",
        help="build the reduced model of a geometry",
        description=(
            "Build the reduced model of a geometry from full-order runs, measure its error on held-out ones and write "
            "it. Takes some minutes; an interrupted build goes on where it stopped when the same command is given "
            "again (finished runs lie in OUTPUT.parts until then)."
        ),
        example="finger-model reduce --geometry geometry.yaml -o reduced.npz",
    )
    parser.add_argument("--geometry", metavar="YAML", help="lengths in m (default: built in)")
    parser.add_argument(
        "--friction",
        type=float,
        default=0.25,
        metavar="MU",
        help="friction coefficient (default: 0.25)",
    )
    parser.add_argument(
        "--histories",
        type=int,
        metavar="N",
        help="training histories; fewer is faster and less exact",
    )
    parser.add_argument(
        "--iterations", type=int, metavar="N", help="steps of each training; more is more exact"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the random histories (default: 1)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default: 2)")
    parser.add_argument("-o", "--output", required=True, metavar="NPZ", help="file to write")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the subcommand."""
    from ..reduced.build import BuildSettings, build

    geometry = Geometry.load(arguments.geometry) if arguments.geometry else Geometry()
    options = {"seed": arguments.seed, "friction": arguments.friction}
    if arguments.histories is not None:
        if arguments.histories < 12:
            raise InputError(f"--histories is {arguments.histories}, 12 or more are needed")
        options["histories"] = arguments.histories
    if arguments.iterations is not None:
        if arguments.iterations < 1:
            raise InputError(f"--iterations is {arguments.iterations}, 1 or more are needed")
        options["drive_iterations"] = options["contact_iterations"] = arguments.iterations
    if arguments.workers < 1:
        raise InputError(f"--workers is {arguments.workers}, 1 or more are needed")
    if not 0 <= arguments.friction <= 1:
        raise InputError(f"--friction is {arguments.friction:g}, outside 0 … 1")
    if Path(arguments.output).suffix != ".npz":
        raise InputError(f"{arguments.output}: the file is an npz archive; end its name in .npz")
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description:24s}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as progress:
        tasks: dict[str, int] = {}

        def tell(stage: str, share: float) -> None:
            if stage not in tasks:
                tasks[stage] = progress.add_task(stage, total=1.0)
            progress.update(tasks[stage], completed=share)  # type: ignore[arg-type]

        model, table = build(
            geometry, arguments.output, BuildSettings(**options), arguments.workers, tell
        )
    print(table.text())
    print(
        f"{arguments.output}: reduced model {model.hash[:8]} of geometry {model.geometry_hash[:8]}"
    )
    return 0
