# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The subcommand `finger-bag process`. Vision and model are imported only when it runs."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from finger_bag.bag_files import find_bags
from finger_bag.cli import BAGS, AddCommand
from finger_bag.read_settings import add_read_options, read_settings_from
from finger_common.cli import EXIT_BAD_INPUT, EXIT_LOST, one_line, plain
from finger_common.errors import FingerError, InputError
from finger_common.files import check_outputs
from finger_common.processes import worker_pool
from finger_common.progress import Stages

from .image_settings import named_values, sensor_settings
from .process_options import ProcessOptions

if TYPE_CHECKING:
    from .process import ProcessResult


def add_command(add: AddCommand) -> None:
    """Add `process` to the command `finger-bag`."""
    parser = add(
        "process",
        run,
        "Run vision and model over bags; writes new bags with contact_area and contact_state.",
        "finger-bag process bags/dry -o out/dry --csv out/dry.csv\n"
        "finger-bag process session1 session2 -o out --images yes --calibration plate.yaml",
    )
    parser.add_argument("bags", nargs="+", metavar="BAG", help=BAGS)
    parser.add_argument(
        "-o", "--output", required=True, help="bag to write; with several bags, their folder"
    )
    model = parser.add_argument_group("model and estimator")
    model.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="setting of estimator, pose or area sensor",
    )
    model.add_argument("--parameters", default="", metavar="FILE", help="parameters.yaml to use")
    model.add_argument(
        "--model",
        default="",
        metavar="FILE",
        help="reduced model to use; 'population': the shipped one of all fingers",
    )
    model.add_argument("--geometry", default="", metavar="YAML", help="geometry.yaml of the finger")
    tables = parser.add_argument_group("tables")
    tables.add_argument("--csv", metavar="FILE", help="write the estimates to this CSV file")
    tables.add_argument(
        "--parquet", metavar="FILE", help="write them to this Parquet file (needs pyarrow)"
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
        help="bags in parallel (default: one per core)",
    )
    add_read_options(parser, ProcessOptions)


def run(args: argparse.Namespace) -> int:
    """Process the bags named; gives the exit code."""
    from .process import process

    bags = find_bags(args.bags)
    several = len(bags) > 1
    tables = tuple(table for table in (args.csv, args.parquet) if table)
    if several and tables:
        raise InputError("--csv and --parquet take one bag; process the bags one by one")
    values = named_values(args.set, "fusion_delay=0.05")
    sensor = sensor_settings(args.area_sensor, values)
    estimator, pose = estimator_settings(values)
    options = read_settings_from(
        args,
        ProcessOptions,
        estimator=estimator,
        pose=pose,
        sensor=sensor,
        parameter_file=args.parameters,
        model_file=args.model,
        geometry_file=args.geometry,
        tables=tables,
    )
    output = Path(args.output)
    inputs = [*bags, args.parameters, args.model, args.geometry, args.mapping, args.calibration]
    check_outputs([output, *tables], inputs)
    targets = [output / _name_of(bag) for bag in bags] if several else [output]
    for bag, target in zip(bags, targets):
        if targets.count(target) > 1:
            raise InputError(
                f"{bag}: several bags would be written to {target}; process them one by one"
            )
    if args.jobs < 1:
        raise InputError(f"--jobs is {args.jobs}; give 1 or more")
    for target in targets:
        if target.exists():
            raise InputError(f"{target}: exists already; choose another name or remove it")
    began = time.perf_counter()
    results: list[ProcessResult | FingerError] = []
    with Stages() as stages:
        if several:
            jobs = [(bag, target, options) for bag, target in zip(bags, targets)]
            with worker_pool(min(args.jobs, len(bags))) as pool:
                done = pool.map(_process_one, jobs)
                results += stages.track(done, f"{len(bags)} bags", len(bags))
        else:
            show = partial(stages.update, bags[0].name)
            results.append(process(bags[0], targets[0], options, show))
    return _report(bags, results, time.perf_counter() - began)


def _name_of(bag: Path) -> str:
    """Name of a bag: of its folder, or of its file without the ending."""
    return bag.name if bag.is_dir() else Path(bag.name.removesuffix(".zstd")).stem


def estimator_settings(found: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Values by name as checked settings of the estimator and of the pose; raises InputError."""
    from finger_model.estimator import EstimatorSettings
    from finger_model.shape.settings import PoseSettings

    pose = {name: found.pop(name) for name in list(found) if name in PoseSettings.parameters()}
    EstimatorSettings.parameters().check(found)
    PoseSettings.parameters().check(pose)
    return found, pose


def _process_one(job: tuple[Path, Path, ProcessOptions]) -> ProcessResult | FingerError:
    from .process import process

    source, target, options = job
    try:
        return process(source, target, options)
    except FingerError as error:
        # One bad bag does not stop the others.
        return error


def _report(
    bags: Sequence[Path], results: Sequence[ProcessResult | FingerError], took: float
) -> int:
    failed = [r for r in results if isinstance(r, FingerError)]
    good = [r for r in results if not isinstance(r, FingerError)]
    for bag, result in zip(bags, results, strict=True):
        if isinstance(result, FingerError):
            continue
        for problem in result.problems:
            print(f"finger-bag: {plain(bag)}: {plain(problem)}", file=sys.stderr)
        for note in result.notes:
            print(f"{plain(result.path)}: {plain(note)}")
    total = sum(r.duration for r in good)
    print(
        f"{sum(r.states for r in good)} contact states, {sum(r.areas for r in good)} areas from "
        f"{len(good)} bag(s) of {total:.1f} s in {took:.1f} s: {total / took:.0f} × real time"
    )
    for error in failed:
        print(f"finger-bag: {one_line(error)}", file=sys.stderr)
    if failed:
        return EXIT_BAD_INPUT
    return EXIT_LOST if any(r.lost for r in good) else 0
