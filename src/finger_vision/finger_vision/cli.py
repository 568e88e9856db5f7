# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-vision`: areas from images, plate calibration."""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np

from finger_common.cli import Parser, add_settings, plain, run
from finger_common.errors import InputError
from finger_common.files import atomic_write, check_outputs
from finger_common.flags import AreaFlag, flag_names

from .area_sensor import AREA_SENSORS, measured
from .board import DICTIONARY, Board, View, find_board
from .calibrate import calibrate_plate
from .calibration import PAPER_AREA_PER_PIXEL, PlateCalibration
from .images import images_of, read_signal

COLUMNS = ("image", "gross_area_mm2", "real_area_mm2", "flags")

Result = TypeVar("Result")


def _parser(area_sensor: str) -> Parser:
    parser = Parser(
        prog="finger-vision",
        description="Contact area of a finger from FTIR images.",
        example="finger-vision area press_01.png press_02.png --calibration plate.yaml",
    )
    commands = parser.add_subparsers(dest="command", required=True, parser_class=Parser)
    area = commands.add_parser(
        "area",
        help="images → gross and real contact area as CSV",
        description="Measure the contact in each image; one CSV row per image, areas in mm².",
        example="finger-vision area press_01.png press_02.png --area-per-pixel 9.86e-10 "
        "-o areas.csv",
    )
    area.add_argument("images", nargs="+", type=Path, metavar="IMAGE")
    scale = area.add_mutually_exclusive_group()
    scale.add_argument("--calibration", type=Path, metavar="YAML", help="plate calibration")
    scale.add_argument(
        "--area-per-pixel",
        type=float,
        default=PAPER_AREA_PER_PIXEL,
        metavar="M2",
        help="area of one pixel in m² (default %(default)g, the paper's; flagged as uncalibrated)",
    )
    area.add_argument(
        "--background",
        nargs="+",
        type=Path,
        default=[],
        metavar="IMAGE",
        help="contact-free images of the same plate",
    )
    area.add_argument("-o", "--output", type=Path, metavar="CSV", help="default: standard output")
    area.add_argument(
        "--area-sensor",
        default=AREA_SENSORS.default,
        metavar="NAME",
        help=f"area sensor that measures: {', '.join(AREA_SENSORS.names())} (default: %(default)s)",
    )
    settings = area.add_argument_group(f"settings of the area sensor '{area_sensor}'")
    try:
        add_settings(settings, AREA_SENSORS.load(area_sensor).SETTINGS)
    except argparse.ArgumentError as error:
        raise InputError(
            f"area sensor '{area_sensor}': {error}; rename this setting of the sensor"
        ) from None
    _add_calibrate(commands)
    return parser


def _chosen_area_sensor(argv: Sequence[str] | None) -> str:
    """Area sensor named on the command line: its settings are options of the command."""
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first.add_argument("--area-sensor", default=AREA_SENSORS.default)
    return str(first.parse_known_args(argv)[0].area_sensor)


def _add_calibrate(commands: Any) -> None:
    calibrate = commands.add_parser(
        "calibrate",
        help="views of a board → plate calibration",
        description="Calibrate camera and plate from images or bags that show a board through "
        "plate and prism. All views give the lens (Zhang's method); those of --on-plate, in which "
        "the board lies flat on the plate, give the plate's homography.",
        example="finger-vision calibrate view_*.png --on-plate flat.png --columns 12 --rows 9 "
        "--square 0.002 -o plate.yaml\n"
        "finger-vision calibrate board.mcap --on-plate flat.png --board charuco --columns 10 "
        "--rows 8 --square 0.003 --marker 0.0022 -o plate.yaml",
    )
    calibrate.add_argument(
        "views", nargs="*", type=Path, metavar="VIEW", help="images or bags, any tilt"
    )
    calibrate.add_argument(
        "--on-plate",
        nargs="+",
        type=Path,
        required=True,
        metavar="VIEW",
        help="images or bags with the board flat on the plate",
    )
    calibrate.add_argument(
        "--board",
        choices=("checkerboard", "charuco"),
        default="checkerboard",
        help="pattern of the board (default: %(default)s)",
    )
    calibrate.add_argument(
        "--columns", type=int, required=True, help="columns of squares, not inner corners"
    )
    calibrate.add_argument(
        "--rows", type=int, required=True, help="rows of squares, not inner corners"
    )
    calibrate.add_argument(
        "--square", type=float, required=True, metavar="M", help="side of a square, m"
    )
    calibrate.add_argument(
        "--marker", type=float, default=0.0, metavar="M", help="side of a marker, m (charuco only)"
    )
    calibrate.add_argument(
        "--dictionary",
        default=DICTIONARY,
        help=f"ArUco dictionary, charuco only (default: {DICTIONARY})",
    )
    calibrate.add_argument(
        "--no-lens",
        action="store_true",
        help="calibrate the homography only, without lens distortion",
    )
    calibrate.add_argument(
        "--mirrored",
        action="store_true",
        help="a mirror or prism mirrors the camera's picture; not needed with a ChArUco board, "
        "which shows it",
    )
    calibrate.add_argument("--topic", default="image_raw", help="topic of the images in a bag")
    calibrate.add_argument(
        "--every",
        type=float,
        default=1.0,
        metavar="S",
        help="time between the images used from a bag (default: %(default)g)",
    )
    calibrate.add_argument(
        "--camera-name",
        default="finger_camera",
        help="name of the camera in the file (default: %(default)s)",
    )
    calibrate.add_argument(
        "-o", "--output", type=Path, required=True, metavar="YAML", help="calibration file to write"
    )


def _views(paths: Sequence[Path], board: Board, arguments: Any) -> list[View]:
    views = []
    for path in paths:
        for name, image in images_of(path, arguments.topic, arguments.every):
            view = find_board(image, board, name)
            if view is None:
                print(f"{plain(name)}: board not found, left out", file=sys.stderr)
            else:
                views.append(view)
    return views


def _calibrate(arguments: Any) -> int:
    check_outputs([arguments.output], [*arguments.views, *arguments.on_plate])
    board = Board(
        arguments.board,
        arguments.columns,
        arguments.rows,
        arguments.square,
        arguments.marker,
        arguments.dictionary,
    )
    on_plate = _views(arguments.on_plate, board, arguments)
    views = [] if arguments.no_lens else _views(arguments.views, board, arguments) + on_plate
    report = calibrate_plate(
        views, on_plate, arguments.camera_name, not arguments.no_lens, arguments.mirrored
    )
    calibration = report.calibration
    calibration.save(arguments.output)
    for name, error in report.view_errors.items():
        print(f"{plain(name)}: {error:.3f} px")
    print(
        f"reprojection error {calibration.reprojection_error:.3f} px, on the plate "
        f"{calibration.plate_error * 1e6:.1f} µm; {calibration.area_per_pixel * 1e6:.6f} mm² per "
        "rectified pixel"
    )
    if calibration.mirrored:
        print("the picture is mirrored: y of the plate points up in it")
    elif board.kind == "checkerboard":
        print(
            "taken as not mirrored, which a checkerboard does not tell: give --mirrored if a "
            "mirror or prism mirrors the picture"
        )
    else:
        print("the picture is not mirrored: y of the plate points down in it")
    print(f"written to {plain(arguments.output)}")
    return 0


def _output(path: Path | None) -> AbstractContextManager[IO[Any]]:
    return nullcontext(sys.stdout) if path is None else atomic_write(path)


def _area(arguments: Any) -> int:
    inputs = [*arguments.images, *arguments.background, arguments.calibration]
    check_outputs([arguments.output], inputs)
    calibration = PlateCalibration.given(arguments.calibration, arguments.area_per_pixel)
    sensor = AREA_SENSORS.open(vars(arguments), calibration)
    plate: tuple[Path, tuple[int, ...]] | None = None
    empty = []
    for path in arguments.background:
        empty.append(_image(path, plate))
        plate = path, empty[-1].shape
        _apply(sensor.learn, empty[-1], path)
    with _output(arguments.output) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for path in arguments.images:
            # Images on a command line need not follow each other in time, or have one size: none
            # is followed by another, or becomes its background.
            sensor.reset()
            for image in empty:
                sensor.learn(image)
            measurement = _apply(partial(measured, sensor), _image(path, plate), path)
            writer.writerow(
                [
                    plain(path),
                    f"{measurement.gross_area * 1e6:.4f}",
                    f"{measurement.real_area * 1e6:.4f}",
                    flag_names(AreaFlag(measurement.flags)),
                ]
            )
    return 0


def _image(path: Path, plate: tuple[Path, tuple[int, ...]] | None) -> np.ndarray:
    """Array of an image file; raises InputError where it is not of the plate's size.

    plate: file and shape of an image without contact, None without any.
    """
    image = read_signal(path)
    if plate is not None and plate[1][:2] != image.shape[:2]:
        height, width = image.shape[:2]
        raise InputError(
            f"{path}: image of {width}×{height}, the background {plate[0]} has "
            f"{plate[1][1]}×{plate[1][0]}; give images of one camera and one size"
        )
    return image


def _apply(action: Callable[[np.ndarray], Result], image: np.ndarray, path: Path) -> Result:
    """Apply `action` to an image; errors name its file."""
    try:
        return action(image)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _main(argv: Sequence[str] | None = None) -> int:
    arguments = _parser(_chosen_area_sensor(argv)).parse_args(argv)
    return _area(arguments) if arguments.command == "area" else _calibrate(arguments)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `finger-vision`."""
    return run(_main, argv)


if __name__ == "__main__":
    sys.exit(main())
