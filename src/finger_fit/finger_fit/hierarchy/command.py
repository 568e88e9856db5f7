# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-fit population`: what fits of many subjects say about people."""

from __future__ import annotations

import csv
import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from finger_common.cli import Parser, plain
from finger_common.console import Console
from finger_common.errors import InputError, known_names, listed
from finger_common.files import atomic_write, load_json, number
from finger_common.moisture import is_moisture
from finger_model.laws import ParameterSpace, StandardLinearSolid, law_of

from ..nuisance_names import AREA_GAIN
from ..uncertainty import NORMAL_95, student_95
from .model import Estimates, HierarchyPriors, Posterior, ends, posterior

MOISTURE_UNIT = 10.0
"""a.u. of moisture per unit of the slope."""

LARGEST = 1e12
"""Value in SI or deviation of a logarithm above which no fit was made."""

DRAWS_FILE = "population_draws.csv"

CLEAR = 0.975
"""Probability from which a difference of two conditions is called told apart."""


def parser() -> Parser:
    """Arguments."""
    p = Parser(
        prog="finger-fit population",
        description="Population means of the conditions, spread between subjects and slope over "
        "moisture, from the fit.json of finger-fit; writes population.json and "
        "population_draws.csv.",
        example="finger-fit out/bags/* -o out/fit\nfinger-fit population out/fit -o out/fit",
    )
    p.add_argument(
        "fits", nargs="+", metavar="FIT", help="fit.json, or the folder that holds it; one of "
        "several subjects, or one per subject"
    )  # fmt: skip
    p.add_argument(
        "-o", "--output", default=".", metavar="DIR", help="folder to write to (default: here)"
    )
    p.add_argument(
        "--quantity", action="append", default=[], metavar="Q",
        help="a fitted quantity; repeatable (default: those of composite_E, E2, tau1 that the law "
            "has)",
    )  # fmt: skip
    p.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of the draws (default: 0)"
    )
    return p


def command(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = parser().parse_args(argv)
    if args.seed < 0:
        raise InputError(f"--seed {args.seed}: zero or more is needed")
    space = law_of(_law(args.fits)).PARAMETERS
    usual = [n for n in ("composite_E", "E2", "tau1") if n in space.quantity_names]
    quantities = args.quantity or list(dict.fromkeys([space.headline, *usual]))
    for name in quantities:
        if name not in space.quantity_names:
            raise InputError(
                f"--quantity '{name}' does not exist; {known_names(name, space.quantity_names)}"
            )
        if space.log_offset(name):
            raise InputError(
                f"--quantity '{name}' may be zero, which has no logarithm; leave it out"
            )
    subjects = read_subjects(args.fits)
    data, draws = population(subjects, quantities, space, args.seed)
    console = Console()
    console.print(_table(space, data))
    said: dict[str, list[str]] = {}
    for name, found in data["quantities"].items():
        for words in found["words"]:
            said.setdefault(words, []).append(name)
    for words, names in said.items():
        of = "" if len(names) == len(data["quantities"]) else f"{plain(', '.join(names))}: "
        print(f"{of}{plain(words)}")
    path = Path(args.output) / "population.json"
    with atomic_write(path) as file:
        json.dump(data, file, indent=1, ensure_ascii=False)
        file.write("\n")
    write_draws(draws, path.with_name(DRAWS_FILE))
    print(f"written: {plain(path)}, {DRAWS_FILE}")
    return 0


def read_subjects(paths: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Subject → condition → entry of fit.json; raises InputError."""
    found: dict[str, dict[str, Any]] = {}
    for path, data in map(_read, paths):
        for name, part in _parts(data, path):
            if name in found:
                raise InputError(
                    f"{path}: subject '{name}' is there twice; give each once, by a fit of all "
                    "bags of one finger"
                )
            found[name] = part
    return found


def _law(paths: Sequence[str]) -> str:
    """Name of the law of all fits; raises InputError where they have several."""
    names = {}
    for path, data in map(_read, paths):
        known = data.get("provenance") if isinstance(data, dict) else None
        law = known.get("law") if isinstance(known, dict) else None
        names[str(law or StandardLinearSolid.name)] = path
    if len(names) > 1:
        raise InputError(
            f"these fits have different laws, {', '.join(names)}; give fits of one law"
        )
    return next(iter(names))


def _read(text: str) -> tuple[Path, Any]:
    """A fit.json, given by itself or by its folder."""
    path = Path(text)
    path = path / "fit.json" if path.is_dir() else path
    if not path.is_file():
        raise InputError(f"{text}: no fit.json there; run finger-fit first")
    return path, load_json(path, "fit.json")


def _parts(data: Any, path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Subjects with their conditions; raises InputError for what is no fit.json."""
    own = data.get("subject") if isinstance(data, dict) else None
    found: Any = {str(own or path.absolute().parent.name): data}
    if isinstance(data, dict) and "subjects" in data:
        found = data["subjects"]
    for name, part in found.items() if isinstance(found, dict) else [("", None)]:
        conditions = part.get("conditions") if isinstance(part, dict) else None
        if not isinstance(conditions, dict) or not all(
            isinstance(entry, dict) for entry in conditions.values()
        ):
            raise InputError(f"{path}: not a fit.json of finger-fit")
        yield name, conditions


def population(
    subjects: Mapping[str, Mapping[str, Any]],
    quantities: Sequence[str],
    space: ParameterSpace,
    seed: int = 0,
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Compute what population.json holds from the entries of fit.json, and draw from the posterior:
    (d,) by column of population_draws.csv."""
    conditions = list(dict.fromkeys(c for part in subjects.values() for c in part))
    draws: dict[str, np.ndarray] = {}
    out: dict[str, Any] = {"subjects": list(subjects), "conditions": conditions, "quantities": {}}
    moisture = np.array(
        [[_moisture(part.get(c)) for c in conditions] for part in subjects.values()]
    )
    for name in quantities:
        arrays = _arrays(subjects, conditions, name)
        low, high = space.quantity_bounds(name)
        priors = HierarchyPriors(level=0.5 * math.log(low * high))
        found = posterior(Estimates.of_conditions(*arrays), priors, seed=seed)
        entry = _entry(found, conditions, list(subjects))
        for j, condition in enumerate(conditions):
            draws[f"{name} {condition}"] = np.exp(found.beta[:, j])
        draws[f"{name} sd_between_subjects_log"] = found.subject_sd
        draws[f"{name} sd_subject_by_condition_log"] = found.condition_sd
        centre = np.nanmean(moisture) if np.isfinite(moisture).any() else math.nan
        read = np.isfinite(moisture)
        # The posterior needs three subjects that have a mean moisture.
        enough = (read & np.isfinite(arrays[0])).any(axis=1).sum() >= 3
        if enough and read.sum() > 3 and np.nanstd(moisture) > 1.0:
            scaled = (moisture - centre) / MOISTURE_UNIT
            slope = posterior(Estimates.of_covariate(*arrays, scaled), priors, seed=seed)
            entry["moisture_slope_log_per_10"] = ends(slope.beta[:, 1])
            draws[f"{name} moisture_slope_log_per_10"] = slope.beta[:, 1]
            entry["probability_slope_negative"] = float((slope.beta[:, 1] < 0).mean())
        unfinished = [
            f"{s} {c} ({part[c]['status']})" for s, part in subjects.items() for c in part
            if part[c].get("status", "final") != "final"
        ]  # fmt: skip
        bounded = [
            f"{s} {c}" for s, part in subjects.items() for c in part
            if part[c].get("active_bounds")
        ]  # fmt: skip
        entry["words"] = [*found.problems, *_words(entry)]
        if unfinished:
            entry["words"].append(
                f"{len(unfinished)} of the fits are not final: {listed(unfinished, 3)}"
            )
        if bounded:
            entry["words"].append(
                f"{len(bounded)} of the fits lie on a bound of the search box, which pulls them "
                f"inwards: {listed(bounded, 3)}"
            )
        out["quantities"][name] = entry
    out["priors"] = {k: v for k, v in vars(HierarchyPriors()).items() if k != "level"}
    return out, draws


def write_draws(draws: Mapping[str, np.ndarray], path: Path) -> None:
    """One row a draw (SI); columns are paired row by row within a quantity, but for the slope."""
    rows = np.column_stack(list(draws.values()))
    with atomic_write(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(draws)
        writer.writerows([f"{value:.6g}" for value in row] for row in rows)


def _moisture(entry: Any) -> float:
    value = entry.get("moisture_mean") if isinstance(entry, Mapping) else None
    return float(value) if isinstance(value, (int, float)) and is_moisture(value) else math.nan


def _arrays(
    subjects: Mapping[str, Mapping[str, Any]], conditions: Sequence[str], name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Value, deviation, moves by the lengths and by the gain, as of `Estimates`."""
    lengths: dict[str, int] = {}
    shape = (len(subjects), len(conditions))
    value, sd, common = np.full(shape, math.nan), np.zeros(shape), np.zeros(shape)
    moves: list[tuple[int, int, str, float]] = []
    for i, (subject, part) in enumerate(subjects.items()):
        for j, condition in enumerate(conditions):
            entry = part.get(condition)
            if entry is None:
                continue
            where = f"{subject} {condition}: fit.json"
            known, assumed = _deviations(entry, name, where)
            value[i, j] = math.log(known[name])
            total = known["sd_log"] ** 2 + known["sd_log_assumed"] ** 2
            common[i, j] = assumed.pop(AREA_GAIN, 0.0)
            left = total - common[i, j] ** 2 - sum(move**2 for move in assumed.values())
            # The Gaussian with the 95 % interval that Student's t gives few presses.
            wider = student_95(int(known["trials"])) / NORMAL_95
            sd[i, j] = wider * math.sqrt(max(left, known["sd_log"] ** 2, 1e-8))
            for length, move in assumed.items():
                lengths.setdefault(length, len(lengths))
                moves.append((i, j, length, move))
    shared = np.zeros((*shape, len(lengths)))
    for i, j, length, move in moves:
        shared[i, j, lengths[length]] = move
    return value, sd, shared, common


def _deviations(
    entry: Mapping[str, Any], name: str, where: str
) -> tuple[dict[str, float], dict[str, float]]:
    """Value and deviations of a quantity, and its moves by what was assumed; raises InputError."""
    given = entry.get("from_data")
    own = given.get(name) if isinstance(given, dict) else None
    if not isinstance(own, dict) or not isinstance(own.get("assumed"), dict):
        raise InputError(f"{where} holds no deviation of {name}; fit again with this version")
    known = {key: number(own, key, where) for key in ("sd_log", "sd_log_assumed")}
    known |= {key: number(dict(entry), key, where) for key in (name, "trials")}
    assumed = {key: number(own["assumed"], key, where) for key in own["assumed"]}
    usable = known[name] > 0.0 and known["trials"] >= 1.0 and known["sd_log"] >= 0.0
    if not usable or max(map(abs, (*known.values(), *assumed.values()))) > LARGEST:
        raise InputError(f"{where}: no value and deviations of {name} that a fit gives; correct it")
    return known, assumed


def _entry(found: Posterior, conditions: Sequence[str], subjects: Sequence[str]) -> dict[str, Any]:
    """Means (SI), spreads and contrasts of one quantity."""
    pairs = {}
    for (i, first), (j, second) in itertools.combinations(enumerate(conditions), 2):
        difference = found.beta[:, i] - found.beta[:, j]
        pairs[f"{first} / {second}"] = {
            **ends(np.exp(difference)),
            "probability_greater": float((difference > 0).mean()),
        }
    level = found.beta.mean(axis=1)
    return {
        "mean": {c: ends(np.exp(found.beta[:, j])) for j, c in enumerate(conditions)},
        "sd_between_subjects_log": ends(found.subject_sd),
        "sd_subject_by_condition_log": ends(found.condition_sd),
        "ratios": pairs,
        "subjects": {s: ends(np.exp(level + found.effect[:, i])) for i, s in enumerate(subjects)},
        "grid_cells": found.cells,
        "grid_edge": found.edge,
    }


def _words(entry: Mapping[str, Any]) -> list[str]:
    """Which conditions the data tell apart, in words."""
    words = []
    for pair, ratio in entry["ratios"].items():
        chance = ratio["probability_greater"]
        text = f"{pair} {ratio['median']:.2f} ({ratio['low']:.2f}–{ratio['high']:.2f})"
        if max(chance, 1.0 - chance) >= CLEAR:
            words.append(f"{text}: told apart in the population")
        else:
            words.append(
                f"{text}: not told apart in the population (probability that the first is greater "
                f"{chance:.2f})"
            )
    return words


def _table(space: ParameterSpace, data: Mapping[str, Any]) -> Table:
    table = Table(
        "quantity", *(escape(plain(c)) for c in data["conditions"]), "between subjects",
        "slope per 10 a.u.", title=f"population of {len(data['subjects'])} subjects, 95 %",
    )  # fmt: skip
    for name, entry in data["quantities"].items():
        quantity = space.describe(name)
        cells = [
            f"{quantity.text(m['median'])} ({quantity.text(m['low'])}–{quantity.text(m['high'])})"
            for m in entry["mean"].values()
        ]
        table.add_row(
            f"{quantity.symbol} {quantity.display_unit}",
            *cells,
            _percent(entry["sd_between_subjects_log"]),
            _percent(entry.get("moisture_slope_log_per_10")),
        )
    return table


def _percent(found: Mapping[str, float] | None) -> str:
    """A logarithm with its interval in percent; a dash for none."""
    if found is None:
        return "–"
    middle, low, high = (f"{100 * found[key]:.0f}" for key in ("median", "low", "high"))
    return f"{middle} % ({low} … {high})".replace("-", "−")
