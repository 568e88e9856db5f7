"""The command finger-fit."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from finger_common.cli import EXIT_INTERRUPTED, Parser, run
from finger_common.errors import InputError

from .options import FIT_PARAMETERS, FitOptions

EXAMPLE = "finger-fit out/study/* -o out/fit\nfinger-fit session.mcap --condition natural --window contact -o out/fit"


def parser() -> argparse.ArgumentParser:
    """Arguments; every option of FIT_PARAMETERS becomes one."""
    p = Parser(
        prog="finger-fit",
        description="Fit the finger model's parameters to recorded bags; writes fit.json, parameters.yaml and "
        "report.html.",
        example=EXAMPLE,
    )
    p.add_argument(
        "bags", nargs="+", metavar="BAG", help="bags (MCAP, rosbag2 folders), or folders of bags"
    )
    p.add_argument(
        "-o", "--output", metavar="DIR", default="fit", help="folder to write to (default: fit)"
    )
    p.add_argument(
        "--condition",
        action="append",
        default=[],
        metavar="C",
        help="fit this condition only; repeatable",
    )
    p.add_argument(
        "--normal-axis",
        choices=("+x", "-x", "+y", "-y", "+z", "-z"),
        help="sensor axis of the normal force",
    )
    p.add_argument("--calibration", metavar="YAML", help="plate calibration for areas from images")
    p.add_argument("--mapping", metavar="FILE", help="YAML file with other topic names, units")
    p.add_argument("--model", metavar="NPZ", help="reduced model file (default: the shipped one)")
    p.add_argument("--quiet", action="store_true", help="no progress")
    for item in FIT_PARAMETERS:
        flag = "--" + item.name.replace("_", "-")
        unit = f" [{item.unit}]" if item.unit else ""
        meaning = f"{item.meaning}{unit}".replace("%", "%%")
        if isinstance(item.default, bool):
            p.add_argument(
                flag, action=argparse.BooleanOptionalAction, default=item.default, help=meaning
            )
        elif isinstance(item.default, list):
            p.add_argument(
                flag, nargs="*", default=item.default, choices=item.choices,
                metavar=None if item.choices else "NAME=LOW:HIGH", help=meaning,
            )  # fmt: skip
        else:
            p.add_argument(
                flag, type=type(item.default), default=item.default, choices=item.choices,
                help=f"{meaning} (default: {item.default if item.default != '' else 'none'})",
                metavar=None if item.choices else item.name.upper(),
            )  # fmt: skip
    return p


class Screen:
    """Progress on the terminal: one line per stage of each condition."""

    def __init__(self, quiet: bool) -> None:
        self.console = Console(stderr=True)
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed}/{task.total}"),
            TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
            console=self.console,
            disable=quiet,
        )
        self._tasks: dict[tuple[str, str], object] = {}

    def __enter__(self) -> Screen:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def __call__(
        self, condition: str, stage: str, number: int, rounds: int, cost: float, best: np.ndarray
    ) -> None:
        key = (condition, stage)
        note = f"J = {cost * 1e12:.1f} mm⁴" if np.isfinite(cost) else ""
        if key not in self._tasks:
            name = f"{condition} {stage}".strip()
            self._tasks[key] = self._progress.add_task(f"{name:<20}", total=rounds, note=note)
        self._progress.update(self._tasks[key], completed=number, note=note)  # type: ignore[arg-type]


def summary(result: object) -> Table:
    """Result as a table for the terminal."""
    from .fit import FitReport

    assert isinstance(result, FitReport)
    table = Table(
        "condition",
        "trials",
        "E0 kPa",
        "E1 kPa",
        "τ1 s",
        "E2 kPa",
        "E kPa",
        "J mm⁴",
        "J power law",
        "status",
    )
    for name, fit in result.fits.items():
        E0, E1, tau1, E2 = fit.parameters
        table.add_row(
            name, str(len(fit.problem)), f"{E0 / 1e3:.1f}", f"{E1 / 1e3:.2f}", f"{tau1:.3f}",
            f"{E2 / 1e3:.0f}", f"{fit.composite_E / 1e3:.2f}", f"{fit.cost * 1e12:.1f}",
            f"{fit.power_law.cost * 1e12:.1f}", fit.status,
        )  # fmt: skip
    return table


def command(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    args = parser().parse_args(argv)
    options = FitOptions.from_mapping({p.name: getattr(args, p.name) for p in FIT_PARAMETERS})
    for bag in args.bags:
        if not Path(bag).exists():
            raise InputError(f"{bag}: no such bag; check the path")
    from finger_model.reduced import ReducedModel

    from .fit import fit_bags

    model = ReducedModel.load(args.model) if args.model else ReducedModel.load()
    with Screen(args.quiet) as screen:
        result = fit_bags(
            args.bags, options, args.output, args.condition, model, screen,
            args.normal_axis, args.calibration, args.mapping,
        )  # fmt: skip
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(summary(result))
    for exclusion in result.exclusions:
        print(f"excluded: {exclusion.label}: {exclusion.reason}")
    for name, fit in result.fits.items():
        for reason in fit.reasons:
            print(f"{name}: {fit.status}: {reason}")
    print(f"report: {Path(args.output) / 'report.html'}")
    return EXIT_INTERRUPTED if result.interrupted else 0


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    sys.exit(run(command, argv))


if __name__ == "__main__":
    main()
