# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The command `finger-model`: simulate, geometry, reduce, reduce-population, verify."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from finger_common.cli import Parser, run

COMMANDS = ("simulate", "geometry", "reduce", "reduce_population", "verify")


def parser() -> Parser:
    """Parser of the command with all its subcommands."""
    top = Parser(
        prog="finger-model",
        description="Finite-element finger pressing on glass, and its reduced model.",
        example="finger-model simulate --force force.csv --material material.yaml -o contact.csv",
    )
    subparsers = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name in COMMANDS:
        importlib.import_module(f"finger_model.commands.{name}").add_parser(subparsers)
    return top


def _main(argv: Sequence[str] | None) -> int:
    arguments = parser().parse_args(argv)
    return arguments.run(arguments)


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point: exit codes as in `finger_common.cli`."""
    sys.exit(run(_main, argv))


if __name__ == "__main__":
    main()
