# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-model reduce-population`: build the reduced model of all fingers of the box."""

from __future__ import annotations

import argparse
from pathlib import Path

from finger_common.cli import add_settings, plain, settings_from
from finger_common.errors import InputError
from finger_common.progress import Stages

from ..reduced.population_build import PopulationSettings

GOALS = {"middle": (0.01, 0.02), "whole": (0.02, 0.04)}
"""RMS and worst instant, as shares of the history's largest value, by region."""


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "reduce-population",
        help="build the reduced model of all fingers of the population box",
        description=(
            "Build the reduced model for every finger of the population box. It is trained on "
            "full-order runs of random fingers, and its error is measured on held-out runs. The "
            "package ships one such model. This takes more than an hour on two cores. An "
            "interrupted build continues where it stopped when the same command is given again. "
            "Until then, finished runs are kept in OUTPUT.parts."
        ),
        example="finger-model reduce-population -o reduced_population.npz",
    )
    parser.add_argument("--workers", type=int, default=2, help="processes (default: 2)")
    parser.add_argument("-o", "--output", required=True, metavar="NPZ", help="file to write")
    add_settings(parser, PopulationSettings)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the subcommand."""
    from ..reduced.population_build import build

    settings = settings_from(arguments, PopulationSettings)
    if arguments.workers < 1:
        raise InputError(f"--workers is {arguments.workers}, 1 or more are needed")
    if Path(arguments.output).suffix != ".npz":
        raise InputError(f"{arguments.output}: the file is an npz archive; end its name in .npz")
    with Stages() as stages:
        model, tables = build(arguments.output, settings, arguments.workers, stages.update)
    print(tables_text(tables))
    print(f"{plain(arguments.output)}: reduced model {model.hash[:8]} of the population box")
    return 0


def tables_text(tables: dict) -> str:
    """Distributions of the error by region, with the shares within the goals."""
    lines = []
    for region, (rms, worst) in GOALS.items():
        table = tables[region]
        lines += [f"{region} of the population box", table.text(rms, worst)]
        lines.append(
            f"indentation within {100 * rms:g} % RMS and {100 * worst:g} % worst: "
            f"{100 * table.indentation_within(rms, worst):.1f} % of the pairs"
        )
    return "\n".join(lines)
