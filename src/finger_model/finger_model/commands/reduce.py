# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-model reduce`: build the reduced model of a geometry."""

from __future__ import annotations

import argparse
from pathlib import Path

from finger_common.cli import add_settings, plain, settings_from
from finger_common.errors import InputError
from finger_common.progress import Stages

from ..geometry import Geometry
from ..reduced.build_settings import BuildSettings


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "reduce",
        help="build the reduced model of a geometry",
        description=(
            "Build the reduced model of a geometry from full-order runs, measure its error on "
            "held-out runs and write it. This takes some minutes. An interrupted build continues "
            "where it stopped when the same command is given again. Until then, finished runs are "
            "kept in OUTPUT.parts."
        ),
        example="finger-model reduce --geometry geometry.yaml -o reduced.npz",
    )
    parser.add_argument(
        "--geometry",
        metavar="YAML",
        help="geometry.yaml of the finger (default: the default finger)",
    )
    parser.add_argument("--workers", type=int, default=2, help="processes (default: 2)")
    parser.add_argument("-o", "--output", required=True, metavar="NPZ", help="file to write")
    add_settings(parser.add_argument_group("size and accuracy of the build"), BuildSettings)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the subcommand."""
    from ..reduced.build import build

    geometry = Geometry.load(arguments.geometry) if arguments.geometry else Geometry()
    settings = settings_from(arguments, BuildSettings)
    if arguments.workers < 1:
        raise InputError(f"--workers is {arguments.workers}, 1 or more are needed")
    if Path(arguments.output).suffix != ".npz":
        raise InputError(f"{arguments.output}: the file is an npz archive; end its name in .npz")
    with Stages() as stages:
        model, table = build(geometry, arguments.output, settings, arguments.workers, stages.update)
    print(table.text())
    print(
        f"{plain(arguments.output)}: reduced model {model.hash[:8]} of geometry "
        f"{model.geometry_hash[:8]}"
    )
    return 0
