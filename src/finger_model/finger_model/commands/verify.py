# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-model verify`: the full-order model against known solutions."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from finger_common.cli import plain
from finger_common.console import Console
from finger_common.errors import InputError, known_names
from finger_common.progress import Stages

from ..verification.check import Check
from . import verify_published, verify_reduced

EXIT_CHECK_FAILS = 1


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "verify",
        help="compare the model with known solutions",
        description=(
            "Run the verification of the full-order model: patch tests, orders of convergence, "
            "Hertz, Lee–Radok, limits, independent reference curves, energy, smoothness, "
            "monotonicity and friction. Every number is printed with its limit; -o also writes "
            "verification.md and its figures. Exit code 1 if a number misses its limit."
        ),
        example=(
            "finger-model verify -o docs\nfinger-model verify hertz calculix\n"
            "finger-model verify --reduced --error-plot errors.png\n"
            "finger-model verify --published -o table.json"
        ),
    )
    parser.add_argument("checks", nargs="*", metavar="CHECK", help="names of checks (default: all)")
    parser.add_argument("--list", action="store_true", help="list the names and stop")
    parser.add_argument(
        "-o",
        "--output",
        metavar="DIR",
        help="folder for page and figures; with --published: the table, JSON",
    )
    verify_reduced.add_arguments(parser)
    verify_published.add_arguments(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the subcommand."""
    if arguments.reduced and arguments.published:
        raise InputError("--reduced and --published: give one of the two")
    if arguments.reduced:
        for name, value in (("-o", arguments.output), ("named checks", arguments.checks)):
            if value:
                raise InputError(f"--reduced does not go with {name}: leave one of them out")
        return verify_reduced.run(arguments)
    for option in verify_reduced.given(arguments):
        raise InputError(f"{option} is for --reduced: give that too, or leave it out")
    if arguments.published:
        return verify_published.run(arguments)
    from ..verification.page import CHECKS, write_page

    console = Console()
    if arguments.list:
        console.print("\n".join(CHECKS))
        return 0
    unknown = [name for name in arguments.checks if name not in CHECKS]
    if unknown:
        raise InputError(f"check '{unknown[0]}' does not exist; {known_names(unknown[0], CHECKS)}")
    if arguments.output and arguments.checks:
        raise InputError("-o writes the page of all checks: leave out the names")
    done = []
    names = list(arguments.checks or CHECKS)
    with Stages(brief=True) as stages:
        for name in stages.track(names, "checks", len(names)):
            begin = time.perf_counter()
            check = CHECKS[name]()
            done.append(check)
            _show(check, time.perf_counter() - begin, console)
    if arguments.output:
        print(f"written: {plain(write_page(done, Path(arguments.output)))}")
    return 0 if all(check.passes for check in done) else EXIT_CHECK_FAILS


def _show(check: Check, duration: float, console: Console) -> None:
    """A check's numbers with their limits. duration: s."""
    mark = "[green]passes[/]" if check.passes else "[red]fails[/]"
    console.print(f"[bold]{check.title}[/] {mark} ({duration:.1f} s)")
    for measure in check.measures:
        colour = "" if measure.passes else "[red]"
        console.print(
            f"  {colour}{measure.what}: {measure.value:.3g} {measure.unit} ({measure.limit()})"
        )
