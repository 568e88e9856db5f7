# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-model verify --published`: printed results about people beside the model's."""

from __future__ import annotations

import argparse
import json

from finger_common.cli import plain
from finger_common.console import Console
from finger_common.errors import InputError
from finger_common.files import atomic_write


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of this mode."""
    parser.add_argument(
        "--published",
        action="store_true",
        help="compare with results printed about people (docs/published.md); a miss is a finding "
        "and does not change the exit code",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the table, and write it to -o."""
    from ..verification.published import published

    if arguments.checks:
        raise InputError("--published has no named checks: leave out the names")
    if arguments.output and not arguments.output.endswith(".json"):
        raise InputError(f"{arguments.output}: --published writes a table; name it NAME.json")
    console = Console(soft_wrap=True)
    rows = published()

    def text(value: float | None) -> str:
        return "–" if value is None else f"{value:.3g}"

    for row in rows:
        mark = "[green]pass[/]" if row.passed else "[red]miss[/]"
        console.print(
            f"{mark} {row.name}: {text(row.model)} (printed {text(row.printed)}, "
            f"{text(row.low)} … {text(row.high)})"
        )
        console.print(f"     {row.source}{f' ({row.note})' if row.note else ''}", style="dim")
    passed = sum(row.passed for row in rows)
    console.print(f"{passed} of {len(rows)} pass; docs/published.md explains the misses")
    if arguments.output:
        with atomic_write(arguments.output) as file:
            json.dump([row.to_dict() for row in rows], file, indent=1, ensure_ascii=False)
        print(f"written: {plain(arguments.output)}")
    return 0
