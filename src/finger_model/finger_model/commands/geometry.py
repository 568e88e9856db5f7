# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-model geometry`: from caliper readings to geometry.yaml."""

from __future__ import annotations

import argparse
import sys

from finger_common.cli import plain
from finger_common.errors import InputError
from finger_common.files import atomic_write

from ..anthropometry import FINGERS, estimate_geometry, parse_length
from ..geometry import LENGTHS
from ..reduced.population import check_geometry

READINGS = {
    "width": "width of the fingertip across the pad, at the middle of the nail",
    "depth": "depth at the same place, from the pad to the nail",
    "length": "length from the last crease to the tip",
    "nail-width": "width of the nail",
}


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    keys = "\n".join(f"  {key:22}{meaning}" for key, meaning in LENGTHS.items())
    parser = subparsers.add_parser(
        "geometry",
        help="make geometry.yaml from a person's fingertip",
        description=(
            "Turn caliper readings of a fingertip into the lengths of the model, each with its\n"
            "standard deviation. Readings that are left out are taken from a typical finger.\n"
            "Give lengths with a unit: 14mm, 1.4cm, 0.014m. A plain 0.014 is in metres.\n\n"
            f"keys of geometry.yaml, all in m:\n{keys}"
        ),
        example=(
            "finger-model geometry --width 14mm --depth 11mm -o geometry.yaml\n"
            "finger-model geometry --finger thumb --age 70\n"
            "finger-model simulate --geometry geometry.yaml --force force.csv -o contact.csv"
        ),
    )
    for name, meaning in READINGS.items():
        parser.add_argument(f"--{name}", metavar="LENGTH", help=meaning)
    parser.add_argument("--finger", metavar="NAME", help=f"one of {', '.join(FINGERS)}")
    parser.add_argument("--age", type=float, metavar="YEARS", help="age of the person")
    parser.add_argument("-o", "--output", metavar="YAML", help="output file (default: terminal)")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the subcommand."""
    readings = {}
    for name in READINGS:
        key = name.replace("-", "_")
        text = getattr(arguments, key)
        readings[key] = None if text is None else parse_length(text, f"--{name}")
    estimate = estimate_geometry(**readings, finger=arguments.finger, age=arguments.age)
    try:
        check_geometry(estimate.geometry)
    except InputError as error:
        print(f"note: {error}", file=sys.stderr)
    if arguments.output is None:
        sys.stdout.write(estimate.yaml_text())
        return 0
    with atomic_write(arguments.output) as file:
        file.write(estimate.yaml_text())
    print(f"written: {plain(arguments.output)} (from {estimate.measured})")
    return 0
