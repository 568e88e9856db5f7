# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The command finger-fit."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.table import Table
from rich.text import Text

from finger_common.axes import NORMAL_AXES
from finger_common.cli import (
    EXIT_INTERRUPTED,
    EXIT_LOST,
    Parser,
    add_settings,
    plain,
    print_to_nobody,
    run,
    settings_from,
)
from finger_common.console import Console
from finger_common.errors import InputError, listed
from finger_common.progress import Stages

from .fingers import Fingers, geometry_files
from .interruption import signals_taken
from .nuisance_names import name_of
from .options import FitOptions
from .problem import by_reason
from .report_units import CUT_NOTE, MM4, interval_text, three_digits
from .results import ConditionFit, FitResult
from .study import NotWritten, fit_bags, reading

EXAMPLE = (
    "finger-fit out/study/* -o out/fit\n"
    "finger-fit session.mcap --condition natural --window contact -o out/fit\n"
    "finger-fit bags/* --geometry S01=s01.yaml --geometry S02=s02.yaml -o out/fit"
)


def parser() -> argparse.ArgumentParser:
    """Arguments; every field of FitOptions becomes one."""
    p = Parser(
        prog="finger-fit",
        description="Fit the finger model's parameters to recorded bags; writes fit.json, "
        "parameters.yaml and report.html. 'finger-fit design' plans a study before it is made; "
        "'finger-fit population' joins the fits of many subjects.",
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
        "--pdf", action="store_true", help="also report.pdf; needs an installed Chromium or Chrome"
    )
    p.add_argument("--quiet", action="store_true", help="no progress")
    bags = p.add_argument_group("bags")
    bags.add_argument("--normal-axis", choices=NORMAL_AXES, help="sensor axis of the normal force")
    bags.add_argument(
        "--calibration", metavar="YAML", help="plate calibration for areas from images"
    )
    bags.add_argument(
        "--area-per-pixel",
        type=float,
        default=0.0,
        metavar="M2",
        help="area of a pixel in m², for images without a calibration",
    )
    bags.add_argument("--mapping", metavar="FILE", help="YAML file with other topic names, units")
    models = p.add_argument_group("model")
    models.add_argument(
        "--model", metavar="NPZ", help="reduced model file (default: the shipped one)"
    )
    models.add_argument(
        "--geometry",
        action="append",
        metavar="[SUBJECT=]YAML",
        default=[],
        help="geometry.yaml of the finger, from 'finger-model geometry'; with several subjects, "
        "SUBJECT=YAML for each (default: a typical finger, not measured)",
    )
    models.add_argument(
        "--law",
        metavar="NAME",
        default="",
        help="another installed material law; a law that is not a sum of Maxwell branches is "
        "fitted with the full-order model (slow)",
    )
    add_settings(p, FitOptions)
    return p


class Screen(Stages):
    """Progress of a fit: each stage of each condition."""

    def __call__(
        self, condition: str, stage: str, number: int, rounds: int, cost: float, best: np.ndarray
    ) -> None:
        note = f"J = {three_digits(cost * MM4)} mm⁴" if np.isfinite(cost) else ""
        self.update(f"{condition} {stage}".strip(), number, rounds, note)


def summary(result: FitResult) -> Table:
    """Result as a table for the terminal."""
    space = result.space
    columns = [space.describe(name) for name in space.quantity_names]
    headings = [f"{q.symbol} {q.display_unit}".strip() for q in columns]
    table = Table("condition", "trials", *headings, "J mm⁴", "J power law", "status")
    for name, fit in result.fits.items():
        table.add_row(
            Text(plain(name)),
            str(len(fit.problem)),
            *(q.text(fit.quantity(q.name)) for q in columns),
            three_digits(fit.cost * MM4),
            three_digits(fit.power_law.cost * MM4),
            fit.status,
        )
    return table


def headline_intervals(fit: ConditionFit) -> str:
    """Both intervals of the headline quantity as a line; empty without any."""
    headline = fit.space.describe(fit.space.headline)
    found = fit.found(headline.name)
    if np.isnan(found.data_interval[0]):
        return ""
    ends = ((found.interval, found.cut), (found.data_interval, found.data_cut))
    whole, part = (
        f"{interval_text(map(headline.text, e), cut, ' to ')} {headline.display_unit}"
        for e, cut in ends
    )
    return (
        f"{headline.symbol} {whole} (95 %); from the data alone, with lengths and gain as assumed, "
        f"{part}"
    )


def unknowns(fits: Mapping[str, ConditionFit]) -> Iterator[str]:
    """What the data do not tell of the nuisances, a sentence for conditions with the same."""
    for found, most, text in (
        (
            lambda nuisance: nuisance.not_estimated,
            2,
            "{names}: the data say little about {words}. Their assumed uncertainty is part of the "
            "interval; the report names them.",
        ),
        (
            lambda nuisance: nuisance.left_out,
            0,
            "{names}: the interval does not allow for an error of {words}.",
        ),
    ):
        conditions: dict[tuple[str, ...], list[str]] = {}
        for name, fit in fits.items():
            if fit.nuisance is not None and (unknown := found(fit.nuisance)):
                conditions.setdefault(tuple(map(name_of, unknown)), []).append(plain(name))
        for words, names in conditions.items():
            yield text.format(names=", ".join(names), words=listed(words, most or len(words)))


def show(result: FitResult) -> None:
    """Print a fit: table, notes, what was left out, intervals."""
    console = Console()
    console.print(summary(result))
    for note in result.problems:
        print(f"note: {plain(note)}")
    for (_, reason), labels in by_reason(result.exclusions).items():
        print(f"excluded: {plain(listed(labels, 3), 300)}: {plain(reason)}")
    for name, fit in result.fits.items():
        if intervals := headline_intervals(fit):
            print(f"{plain(name)}: {intervals}")
        if fit.indentation is not None:
            used = fit.indentation
            print(
                f"{plain(name)}: indentation of {len(used.zeros)} presses used, "
                f"{1e6 * used.rms:.0f} µm from the model (RMS)"
            )
        bounds = fit.covariance.active if fit.covariance is not None else {}
        if bounds:
            symbols = ", ".join(fit.space[parameter].symbol for parameter in bounds)
            print(f"{plain(name)}: on a bound of the search box: {symbols}")
        for reason in fit.reasons:
            print(f"{plain(name)}: {fit.status}: {plain(reason)}")
    headlines = [fit.found(fit.space.headline) for fit in result.fits.values()]
    if any(any(found.cut + found.data_cut) for found in headlines):
        print(CUT_NOTE)
    for sentence in unknowns(result.fits):
        print(sentence)


def command(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    given = list(sys.argv[1:] if argv is None else argv)
    if given[:1] == ["design"]:
        from .design.command import command as design_command

        return design_command(given[1:])
    if given[:1] == ["population"]:
        from .hierarchy.command import command as population_command

        return population_command(given[1:])
    args = parser().parse_args(given)
    options = settings_from(args, FitOptions)
    for bag in args.bags:
        if not Path(bag).exists():
            raise InputError(f"{bag}: no such bag; check the path")
    if args.calibration and args.area_per_pixel:
        raise InputError("--calibration and --area-per-pixel: give one of the two")
    settings = reading(
        options,
        args.mapping,
        normal_axis=args.normal_axis or "",
        calibration=args.calibration or "",
        area_per_pixel=args.area_per_pixel,
    )
    browser = ""
    if args.pdf:
        from .report import find_browser, write_pdf

        browser = find_browser()  # before the fit, which is long
    fingers = Fingers.load(geometry_files(args.geometry), args.model or "", args.law)
    try:
        with Screen(args.quiet) as screen, signals_taken(screen.say) as taken:
            result = fit_bags(
                args.bags, options, args.output, args.condition, fingers, screen, settings,
                shlex.join(["finger-fit", *given]),
            )  # fmt: skip
    except NotWritten as error:
        show(error.result)
        raise
    try:
        show(result)
        page = Path(args.output) / "report.html"
        written = page.is_file()
        if written:
            print(f"report: {plain(page)}")
        if written and browser:
            for name in ("", *result.subjects):
                write_pdf(page.parent / name / page.name, browser)
            print(f"report: {plain(page.with_suffix('.pdf'))}")
        for bag in result.lost:
            print(f"finger-fit: {plain(bag)}: not all of the bag could be read", file=sys.stderr)
    except BrokenPipeError:
        if not taken:
            raise
        print_to_nobody()
    if taken:
        return 128 + taken[0]
    if result.stopped:
        return EXIT_INTERRUPTED
    return EXIT_LOST if result.lost or result.missing else 0


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    sys.exit(run(command, argv))


if __name__ == "__main__":
    main()
