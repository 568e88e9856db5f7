# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-fit design`: plans of presses side by side, before anybody is measured."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from finger_common.cli import Parser, add_settings, plain, settings_from
from finger_common.console import Console
from finger_common.errors import InputError, put_once
from finger_common.files import atomic_write
from finger_model.laws import ParameterSpace
from finger_model.paper import CONDITIONS

from ..fingers import AssumedFinger
from ..nuisance_names import name_of
from ..nuisance_priors import NuisancePriors
from ..options import FitOptions, value_of
from .expected import Expected, expected, presses_for
from .plan import Plan, plans_of
from .power import contrast_deviation, power, subjects_for

PLANS = {
    "paper": "15 natural presses, loading alone",
    "30 presses:presses=30": "twice as many",
    "release:window=contact": "the release counts too",
    "hold:hold=1,window=contact": "1 s at the peak, and the release",
    "rates:shortest=0.2,longest=6,window=contact": "fast and slow presses, and the release",
    "3 N:peak=3,window=contact": "harder presses, and the release",
}
"""Plans that are compared where none is given."""

SUBJECTS, BETWEEN = 10, 0.2
"""Of a contrast: subjects, and standard deviation of its logarithm between people."""

EXAMPLE = (
    "finger-fit design\n"
    "finger-fit design --plan long:presses=20,hold=2,window=contact --wanted composite_E=0.1\n"
    "finger-fit design --guess natural --against dry --subjects 20 --between 0.2"
)


def parser() -> Parser:
    """Arguments; the nuisances' priors are those of a fit."""
    p = Parser(
        prog="finger-fit design",
        description="Print the standard deviations that plans of presses are expected to give, "
        "without and with a measured indentation (--indentation-sd), and the power of a contrast "
        "of two conditions.",
        example=EXAMPLE,
    )
    p.add_argument(
        "--guess", default="natural", metavar="C|N=V,…",
        help="the finger: a condition of the simulated study (dry, natural, moist), or values "
        "as in E0=140kPa,E1=22kPa,tau1=0.5s,E2=1.8MPa, SI without units (default: natural)",
    )  # fmt: skip
    settings = ", ".join(f"{s.name} ({s.default}{' ' + s.unit if s.unit else ''})" for s in
                         Plan.parameters())  # fmt: skip
    p.add_argument(
        "--plan", action="append", default=[], metavar="NAME:S=V,…|YAML",
        help="a plan, or a YAML file with the settings of one plan, or of several plans by name; "
        f"repeatable (default: six plans). Settings: {settings}",
    )  # fmt: skip
    p.add_argument(
        "--wanted", default="", metavar="Q=D",
        help="relative standard deviation to reach, as in composite_E=0.1; prints the number of "
        "presses for it",
    )  # fmt: skip
    p.add_argument(
        "--against", default="", metavar="C|N=V,…", help="second condition of a contrast"
    )
    p.add_argument(
        "--subjects",
        type=int,
        metavar="N",
        help=f"with --against: number of subjects of the contrast (default: {SUBJECTS})",
    )
    p.add_argument(
        "--between", type=float, metavar="SD",
        help="with --against: standard deviation of the contrast's logarithm between people "
        f"(default: {BETWEEN:g}, an assumption)",
    )  # fmt: skip
    p.add_argument("--geometry", metavar="YAML", default="", help="geometry.yaml of the finger")
    p.add_argument("-o", "--output", metavar="FILE", default="", help="JSON file to write to")
    add_settings(p, NuisancePriors)
    return p


def with_indentation(plans: dict[str, Plan], sd: float) -> dict[str, Plan]:
    """Plans by name, each followed by the same with a displacement sensor of a deviation (m; 0:
    none); a plan that names a deviation itself is compared with the same without."""
    found = {}
    for name, plan in plans.items():
        found[name] = replace(plan, indentation_sd=0.0)
        own = plan.indentation_sd or sd
        if own:
            found[f"{name} + indentation"] = replace(plan, indentation_sd=own)
    return found


def finger_of(text: str, space: ParameterSpace) -> np.ndarray:
    """Parameters (N,) of a condition's name or of NAME=VALUE,…; raises InputError."""
    if text in CONDITIONS:
        values: dict[str, float] = CONDITIONS[text].parameters
    else:
        values = {}
        for part in text.split(","):
            name, _, number = part.partition("=")
            name = name.strip()
            value = value_of(number, space[name]) if name in space.names else math.nan
            put_once(values, name, value, f"finger '{text}'")
    if set(values) != set(space.names) or not np.isfinite(list(values.values())).all():
        raise InputError(
            f"finger '{text}': give one of {', '.join(CONDITIONS)}, or all of "
            f"{', '.join(space.names)}, as in E0=140kPa,E1=22kPa,tau1=0.5s,E2=1.8MPa (SI without "
            "units)"
        )
    for parameter in () if text in CONDITIONS else space.parameters:
        value, (low, high) = values[parameter.name], parameter.range
        if not low <= value <= high:
            factor, unit = parameter.display_factor, parameter.display_unit
            raise InputError(
                f"finger '{text}': {parameter.name} is {value:g} {parameter.unit}, outside "
                f"{low * factor:g} to {high * factor:g} {unit}, for which the model is made; give "
                "the unit, as in E0=140kPa"
            )
    return space.checked(np.array([values[name] for name in space.names]))


def command(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = parser().parse_args(argv)
    priors = settings_from(args, NuisancePriors)
    options = FitOptions(**priors.to_dict())
    for name in ("subjects", "between"):
        if getattr(args, name) is not None and not args.against:
            raise InputError(f"--{name} is for a contrast; give --against too, or leave it out")
    subjects = SUBJECTS if args.subjects is None else args.subjects
    between = BETWEEN if args.between is None else args.between
    if subjects < 2 or not 0.0 <= between <= 5.0:
        raise InputError(
            f"--subjects {subjects}, --between {between:g}: at least 2 subjects and a "
            "standard deviation from 0 to 5 are needed"
        )
    finger = AssumedFinger.load(args.geometry)
    model, known = finger.model, finger.lengths
    space = model.space
    wanted = _wanted(args.wanted, space)
    guess = finger_of(args.guess, space)
    other = finger_of(args.against, space) if args.against else None
    named = [plan for text in args.plan or PLANS for plan in plans_of(text)]
    plans = dict(named)
    if len(plans) < len(named):
        twice = next(name for name in plans if [n for n, _ in named].count(name) > 1)
        raise InputError(f"--plan {twice}: the name is there twice; give each plan its own")
    plans = with_indentation(plans, priors.indentation_sd)
    found = {name: expected(plan, model, guess, options, known) for name, plan in plans.items()}
    console = Console()
    console.print(_table(space, found, wanted))
    data: dict[str, Any] = {
        "guess": space.mapping(guess),
        "plans": {name: _entry(e, wanted) for name, e in found.items()},
    }
    if other is not None:
        second = {
            name: expected(plan, model, other, options, known) for name, plan in plans.items()
        }
        data["contrast"] = {
            "against": space.mapping(other), "subjects": subjects, "between": between,
            "plans": _contrasts(found, second, subjects, between),
        }  # fmt: skip
        console.print(_contrast_table(space, data["contrast"]))
    for line in gains(space, found):
        print(line)
    worst = next(iter(found.values())).parts[space.headline]
    names = [n for n in sorted(worst, key=lambda n: -worst[n]) if n != "data"][:3]
    if names:
        parts = ", ".join(f"{name_of(n)} {100 * worst[n]:.0f} %" for n in names)
        print(f"what no press tells of {space.describe(space.headline).symbol}: mostly {parts}")
    if args.output:
        with atomic_write(Path(args.output)) as file:
            json.dump(data, file, indent=1, ensure_ascii=False)
            file.write("\n")
        print(f"written: {plain(args.output)}")
    return 0


def _wanted(text: str, space: ParameterSpace) -> tuple[str, float] | None:
    if not text:
        return None
    name, _, number = text.partition("=")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if name not in space.quantity_names or not 0.0 < value < 5.0:
        raise InputError(
            f"--wanted '{text}': QUANTITY=DEVIATION is needed, QUANTITY one of "
            f"{', '.join(space.quantity_names)}, as in composite_E=0.1"
        )
    return name, value


def _table(
    space: ParameterSpace, found: dict[str, Expected], wanted: tuple[str, float] | None
) -> Table:
    """Deviations in percent: from the data, and in all."""
    symbols = [space.describe(n).symbol for n in space.quantity_names]
    title = "expected standard deviation in % of the value: from the data (in all)"
    extra = [f"presses for {wanted[0]} ± {100 * wanted[1]:g} %"] if wanted else []
    table = Table("plan", "presses", *symbols, *extra, title=title)
    for name, e in found.items():
        cells = [f"{100 * e.data[n]:.0f} ({100 * e.total[n]:.0f})" for n in space.quantity_names]
        if wanted:
            data, total = presses_for(e, *wanted), presses_for(e, *wanted, total=True)
            cells.append(f"{data or 'never'} ({total or 'never'})")
        table.add_row(name, str(e.plan.presses), *cells)
    return table


def gains(space: ParameterSpace, found: dict[str, Expected]) -> list[str]:
    """Say what a displacement sensor brings, in a sentence for each plan."""
    lines = []
    for name, e in found.items():
        other = found.get(f"{name} + indentation")
        if other is None:
            continue
        parts = [
            f"{space.describe(n).symbol} {100 * e.data[n]:.0f} → {100 * other.data[n]:.0f} % "
            f"({100 * e.total[n]:.0f} → {100 * other.total[n]:.0f} %)"
            for n in space.quantity_names
        ]
        sd = 1e6 * other.plan.indentation_sd
        lines.append(f"{name}, with an indentation to {sd:g} µm: {', '.join(parts)}")
    return lines


def _entry(found: Expected, wanted: tuple[str, float] | None) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "settings": found.plan.to_dict(),
        "sd_log": found.total,
        "sd_log_data": found.data,
        "sd_log_parts": found.parts,
    }
    if wanted:
        entry["presses_from_data"] = presses_for(found, *wanted)
        entry["presses_in_all"] = presses_for(found, *wanted, total=True)
    return entry


def _contrasts(
    first: dict[str, Expected], second: dict[str, Expected], subjects: int, between: float
) -> dict[str, Any]:
    """Compute, by plan and quantity, the difference of the logarithms, its deviation in a subject,
    and the power."""
    out: dict[str, Any] = {}
    for plan, one in first.items():
        other, space = second[plan], one.covariance.space
        out[plan] = {}
        for name in space.quantity_names:
            values = [float(space.quantity(name, e.covariance.parameters)) for e in (one, other)]
            difference = math.log(values[0] / values[1])
            within = contrast_deviation(one, other, name)
            out[plan][name] = {
                "difference_log": difference,
                "sd_log_within": within,
                "power": power(difference, within, between, subjects),
                "subjects_for_80": subjects_for(0.8, difference, within, between),
                "subjects_for_90": subjects_for(0.9, difference, within, between),
            }
    return out


def _contrast_table(space: ParameterSpace, contrast: dict[str, Any]) -> Table:
    title = (
        f"power of the contrast with {contrast['subjects']} subjects, SD between people "
        f"{contrast['between']:g} (subjects for 80 %, 90 %)"
    )
    table = Table("plan", *(space.describe(n).symbol for n in space.quantity_names), title=title)
    for plan, rows in contrast["plans"].items():
        cells = [
            f"{100 * r['power']:.0f} % ({r['subjects_for_80'] or '–'}, "
            f"{r['subjects_for_90'] or '–'})"
            for r in rows.values()
        ]
        table.add_row(plan, *cells)
    return table
