# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-model verify --reduced`: error of a reduced model against full-order runs."""

from __future__ import annotations

import argparse

import numpy as np

from finger_common.errors import InputError
from finger_common.progress import Stages

PAIRS = 204
"""Pairs of parameter set and force history."""

SEED = 64075
"""Not that of any build: pairs that no training saw and no choice was made on."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `verify` that belong to `--reduced`."""
    parser.add_argument(
        "--reduced", action="store_true", help="measure the reduced model's error instead"
    )
    parser.add_argument(
        "--reduced-model", metavar="FILE", help="with --reduced: file to verify (default: shipped)"
    )
    parser.add_argument(
        "--pairs",
        type=int,
        default=PAIRS,
        help=f"with --reduced: number of pairs of parameter set and force history (default: "
        f"{PAIRS})",
    )
    parser.add_argument(
        "--wide",
        action="store_true",
        help="with --reduced: test the whole range of parameters and 0–3 N instead",
    )
    parser.add_argument(
        "--branches",
        action="store_true",
        help="with --reduced: test generalised Maxwell laws of 2 to 4 branches of 1 ms to 10 s "
        "instead",
    )
    parser.add_argument(
        "--population",
        action="store_true",
        help="with --reduced: test random fingers and laws of the population box instead",
    )
    parser.add_argument(
        "--workers", type=int, default=2, help="with --reduced: processes (default: 2)"
    )
    parser.add_argument(
        "--error-plot",
        metavar="PNG",
        help="with --reduced: draw the distribution of the errors and the worst pair",
    )


def given(arguments: argparse.Namespace) -> list[str]:
    """The options of this mode that are given without it, as on the command line."""
    chosen = {
        "--reduced-model": arguments.reduced_model,
        "--pairs": arguments.pairs != PAIRS,
        "--wide": arguments.wide,
        "--branches": arguments.branches,
        "--population": arguments.population,
        "--error-plot": arguments.error_plot,
    }
    return [option for option, value in chosen.items() if value]


def run(arguments: argparse.Namespace) -> int:
    """Print the distribution; exit code 1 when it misses the limits of `reduced.goals`."""
    if arguments.workers < 1:
        raise InputError(f"--workers is {arguments.workers}, 1 or more are needed")
    from .. import figures
    from ..laws import law_of
    from ..reduced.error import error_table, pair_error
    from ..reduced.goals import GOAL_SHARE
    from ..reduced.model import ReducedModel
    from ..reduced.training_runs import (
        branch_case,
        held_out_case,
        pool,
        run_all,
        wide_held_out_case,
    )

    if arguments.checks or arguments.output:
        raise InputError("--reduced runs no other check and writes no page: leave out CHECK and -o")
    if arguments.pairs < 6:
        raise InputError(f"--pairs is {arguments.pairs}, 6 or more are needed")
    if arguments.population:
        return _population(arguments)
    model = ReducedModel.load(arguments.reduced_model)
    if arguments.wide and arguments.branches:
        raise InputError("--wide and --branches are different sets of pairs: give one of them")
    make = held_out_case
    if arguments.wide:
        make = wide_held_out_case
    elif arguments.branches:
        make = branch_case
    cases = [make(SEED, i) for i in range(arguments.pairs)]
    refinement = float(model.settings.get("refinement", 1.0))
    runs = []
    with (
        pool(arguments.workers, model.geometry, refinement, model.friction, None) as executor,
        Stages() as stages,
    ):
        for found, _ in stages.track(run_all(executor, cases), "full-order runs", len(cases)):
            runs.append(found)
    table = error_table(model, runs)
    print(table.text())
    if arguments.error_plot:
        counted = [r for r in runs if pair_error(model, r) is not None]
        case = counted[table.pairs.index(table.worst())]
        limit = model.range["force"][1]
        model = model.for_law(law_of(case.law))
        found = model.simulate(case.parameters, case.time, np.minimum(case.force, limit))
        figures.error_distribution(table, case, found, arguments.error_plot)
    if arguments.wide or arguments.branches:
        return 0
    return 0 if table.share_within() >= GOAL_SHARE and table.none_beyond() else 1


def _population(arguments: argparse.Namespace) -> int:
    """The same over the population box; exit code 1 when it misses its goals."""
    from ..geometry import Geometry
    from ..reduced.model import ReducedModel, load_population
    from ..reduced.population_build import held_out_runs
    from ..reduced.population_training import measured_error
    from .reduce_population import GOALS, tables_text

    if arguments.wide or arguments.branches or arguments.error_plot:
        raise InputError("--population goes without --wide, --branches and --error-plot")
    if arguments.reduced_model:
        model = ReducedModel.load(arguments.reduced_model, Geometry())
        if not model.serves_population:
            raise InputError(f"{arguments.reduced_model}: made for one geometry, not for the box")
    else:
        model = load_population(Geometry())
    with Stages() as stages:
        found = held_out_runs(SEED, arguments.pairs, arguments.workers)
        runs = list(stages.track(found, "full-order runs", arguments.pairs))
    tables = measured_error(model.arrays, runs)
    print(tables_text(tables))
    shares = {"middle": 0.99, "whole": 0.95}
    met = [tables[r].share_within(*GOALS[r]) >= share for r, share in shares.items()]
    return 0 if all(met) else 1
