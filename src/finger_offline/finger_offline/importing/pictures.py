# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Frames of videos and folders of images, one after the other, with their times."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from finger_common.errors import InputError
from finger_common.files import bounded_memory
from finger_common.image_size import VIDEO_PIXELS_PER_BYTE, PixelBudget, check_claim
from finger_common.mono8 import LEAST_BRIGHTEST, Mono8
from finger_common.stamps import NANOSECONDS, nanoseconds
from finger_vision.images import read_signal, silent_libraries

from .cells import stamp_of
from .series import AREA, time_unit_of
from .settings import ImportSettings
from .tables import Times, read_table

IMAGE_ENDINGS = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm")

MOST_DIGITS = 5
"""Digits before the number of an image that may be those of a camera or a trial."""

SURE_FRAMES = 0.98
"""Share of the frames that a container counts which must be there: some count roughly."""

_NAMED_TIMES: tuple[tuple[re.Pattern[str], Callable[..., int], bool], ...] = (
    (
        re.compile(r"(?:.*\D)?((?:19|20)\d{6}[_T-]?\d{6}[._-]?\d{3,9})"),
        lambda text: stamp_of(re.sub(r"^(\d{8})\D?(\d{6})\D?", r"\1_\2.", text)),
        True,
    ),
    (re.compile(r"(?:.*\D)?(1\d{9})[._](\d{3,9})"), lambda s, part: int(s + f"{part:0<9}"), True),
    (re.compile(r"(?:.*\D)?(1\d{12}|1\d{15}|1\d{18})"), lambda text: int(f"{text:0<19}"), True),
    (
        re.compile(r"(?:.*[^\d.])?(\d+(?:\.\d+)?) ?(ms|us|s)"),
        lambda text, unit: round(float(text) * {"s": 1e9, "ms": 1e6, "us": 1e3}[unit]),
        False,
    ),
)
"""Times in names of images: a date and time with a fraction, seconds or parts of them since 1970,
and a number with its unit; what gives their ns, and whether these count from 1970."""

Frame = tuple[int, np.ndarray]
"""Time in ns, image (H, W) uint8."""


def frames_of(settings: ImportSettings, problems: list[str]) -> tuple[Iterator[Frame], int, bool]:
    """Frames of the video or folder; how many are expected (0: unknown); whether their times are
    absolute.

    problems: gets what of the video could not be read, once all frames were taken. Raises
    InputError, from the iterator too, naming file and remedy.
    """
    times = _times_of(settings) if settings.image_times and settings.video else None
    if settings.video:
        count = len(times.ns) if times else 0
        return _video(settings, times, problems), count, bool(times and times.absolute)
    files = _image_files(settings.images)
    if settings.image_times:
        times, files = _by_name(settings, files)
    if times is None:
        if settings.frame_rate:
            _check_numbers(settings.images, files)
            period = NANOSECONDS / settings.frame_rate
            times = Times.of(np.round(np.arange(len(files)) * period).astype(np.int64), False)
        else:
            named = _times_in_names(files)
            if named is None:
                raise InputError(
                    f"{settings.images}: images have no times; give a table with --image-times, or "
                    "--frame-rate"
                )
            times, files = named
    if len(times.ns) != len(files):
        raise InputError(
            f"{settings.image_times}: {len(times.ns)} times for {len(files)} images in "
            f"{settings.images}; give one row per image"
        )
    return _images(times, files, settings.images, problems), len(files), times.absolute


def _images(times: Times, files: list[Path], where: str, problems: list[str]) -> Iterator[Frame]:
    pixels = PixelBudget(sum(file.stat().st_size for file in files))
    shape: tuple[int, ...] | None = None
    brightest, mono8 = 0, Mono8()
    for number, (stamp, file) in enumerate(zip(times.ns, files)):
        if pixels.spent:
            problems.append(_left_out(where, number, "images"))
            return
        signal = read_signal(file)
        if signal.dtype == np.uint16:
            brightest = max(brightest, int(signal.max(initial=0)))
        image = mono8(signal, str(file))
        if shape not in (None, image.shape):
            raise InputError(
                f"{file}: has {image.shape[1]} × {image.shape[0]} pixels, the images before have "
                f"{shape[1]} × {shape[0]}; give images of one camera and one size"
            )
        shape = image.shape
        pixels.take(image.size)
        yield int(stamp), image
    if 0 < brightest < LEAST_BRIGHTEST:
        bits = max(brightest.bit_length(), 8)
        raise InputError(
            f"{where}: the plate is dark: no value of the 16-bit images is above {brightest}, as "
            f"of pixels of {bits} bits; multiply them by {1 << 16 - bits}, or save 8 bits"
        )


def _left_out(where: str, number: int, what: str) -> str:
    return (
        f"{where}: more pixels than its bytes can hold; only the first {number} {what} are read, "
        "give less at once"
    )


def _times_of(settings: ImportSettings) -> Times:
    table = read_table(settings.image_times)
    heading = table.heading(settings.area_time, "--area-time")
    times = table.times(heading, time_unit_of(AREA, settings))
    if not times.known.all():
        row = int(np.argmin(times.known)) + table.first_row
        raise InputError(f"{table.where}, row {row}, column '{heading}': no time; give one a frame")
    return times


def _by_name(settings: ImportSettings, files: list[Path]) -> tuple[Times, list[Path]]:
    """Times of images, and the images in their order: by their names, where a column of the table
    names them, else row by row. Raises InputError."""
    times = _times_of(settings)
    table = read_table(settings.image_times)
    known = {name: file for file in files for name in (file.name, file.stem)}
    found = None
    for heading, cells in table.columns.items():
        names = [re.split(r"[/\\]", str(cell))[-1].strip() for cell in cells]
        # Plain numbers may count something else than the images.
        if any(re.search(r"\D", name) and name in known for name in names):
            found = heading, names
            break
    if found is None or len(found[1]) != len(times.ns):
        return times, files
    heading, names = found
    for row, name in enumerate(names):
        if name not in known or names.index(name) != row:
            fault = "is there twice" if name in known else f"does not exist in {settings.images}"
            raise InputError(
                f"{table.where}, row {row + table.first_row}, column '{heading}': image "
                f"'{name[:40]}' {fault}; give one row per image"
            )
    order = np.argsort(times.ns, kind="stable")
    return times.at(order), [known[names[row]] for row in order]


def _times_in_names(files: list[Path]) -> tuple[Times, list[Path]] | None:
    """Times that the names of images hold, and the images in their order; None where any name holds
    none, or two are equal."""
    for pattern, stamp, absolute in _NAMED_TIMES:
        found = [pattern.fullmatch(file.stem) for file in files]
        try:
            stamps = [stamp(*match.groups()) for match in found if match is not None]
        except ValueError:
            continue
        if len(set(stamps)) == len(files):
            order = np.argsort(stamps)
            return Times.of(np.array(stamps)[order], absolute), [files[i] for i in order]
    return None


def _check_numbers(folder: str, files: list[Path]) -> None:
    """Refuse numbered images of which some are missing: at an even rate all after a gap would be
    early. Refuse two series with numbers of their own, which would follow one another."""
    _check_series(folder, files)
    parts = [re.split(r"(\d+)", file.name) for file in files]
    counting = [{part[i] for part in parts} for i in range(min(map(len, parts)))]
    varying = [i for i, texts in enumerate(counting) if len(texts) > 1]
    if len(files) < 3 or len({len(part) for part in parts}) > 1 or len(varying) != 1:
        return
    texts = [part[varying[0]] for part in parts]
    if not all(map(str.isdigit, texts)):
        return
    steps = np.diff([int(text) for text in texts])
    if (steps != np.median(steps)).any():
        row = int(np.argmax(steps != np.median(steps)))
        raise InputError(
            f"{folder}: images are missing between {files[row].name} and {files[row + 1].name}; "
            "--frame-rate needs all of them, give their times with --image-times"
        )


def _check_series(folder: str, files: list[Path]) -> None:
    """Refuse images whose names begin in several ways, with numbers that overlap."""
    series: dict[str, list[int]] = {}
    for file in files:
        found = re.fullmatch(r"(.*?)(\d+)\D*", file.name)
        # A date and time before the number is no name of a camera.
        if found is None or len(re.sub(r"\D", "", found[1])) > MOST_DIGITS:
            return
        series.setdefault(found[1], []).append(int(found[2]))
    spans = sorted((min(n), max(n), name) for name, n in series.items() if len(n) > 1)
    for (_, last, name), (first, _, other) in pairwise(spans):
        if first <= last:
            name, other = sorted((name, other))
            raise InputError(
                f"{folder}: holds two series of images, '{name}' and '{other}', with numbers of "
                "their own; give each a folder, or the times by name with --image-times"
            )


def _image_files(folder: str) -> list[Path]:
    path = Path(folder)
    if not path.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder that holds the images")
    files = [p for p in path.iterdir() if p.suffix.lower() in IMAGE_ENDINGS]
    if not files:
        raise InputError(f"{folder}: holds no image ({', '.join(IMAGE_ENDINGS)})")

    def natural(file: Path) -> list[tuple[int, int | str]]:  # press2 before press10
        parts = re.split(r"(\d+)", file.name)
        return [(0, int(p)) if p.isdigit() else (1, p) for p in parts]

    return sorted(files, key=natural)


def _video(settings: ImportSettings, times: Times | None, problems: list[str]) -> Iterator[Frame]:
    name = settings.video
    if not Path(name).is_file():
        raise InputError(f"{name}: no such video; check the path")
    if Path(name).suffix.lower() in IMAGE_ENDINGS:
        raise InputError(
            f"{name}: is an image and no video; save its pages as images of one folder and give it "
            "with --images"
        )
    # What is wrong with a video is said in one sentence, not by FFmpeg for each frame.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    with silent_libraries(), bounded_memory(name):
        video = cv2.VideoCapture(name)
    if not video.isOpened():
        raise InputError(f"{name}: not a video that can be read; convert it to .mp4 or .avi")
    width, height = (
        int(video.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
    )
    size = Path(name).stat().st_size
    check_claim(width, height, size, name)
    pixels = PixelBudget(size, VIDEO_PIXELS_PER_BYTE)
    expected = video.get(cv2.CAP_PROP_FRAME_COUNT)
    rate = settings.frame_rate or video.get(cv2.CAP_PROP_FPS)
    number, last, mono8 = 0, -1, Mono8()
    try:
        while True:
            if pixels.spent:
                problems.append(_left_out(name, number, "frames"))
                return
            read, image = video.read()
            if not read:
                break
            pixels.take(image.size // image.shape[2] if image.ndim == 3 else image.size)
            if times is not None:
                if number >= len(times.ns):
                    raise InputError(
                        f"{settings.image_times}: {len(times.ns)} times, but {name} has more "
                        "frames; give one row per frame"
                    )
                stamp = int(times.ns[number])
            elif settings.frame_rate:
                stamp = nanoseconds(number / rate)
            else:
                stamp = nanoseconds(video.get(cv2.CAP_PROP_POS_MSEC) * 1e-3)
                if stamp <= last:  # a container without times of its frames
                    if not 0 < rate < 1e5:
                        raise InputError(
                            f"{name}: does not say its frame rate; give it with --frame-rate"
                        )
                    stamp = nanoseconds(number / rate)
            last = stamp
            yield stamp, mono8(image, name)
            number += 1
    finally:
        video.release()
    if not number:
        raise InputError(f"{name}: holds no frame that can be read; convert it to .mp4 or .avi")
    if times is not None and number < len(times.ns):
        raise InputError(
            f"{settings.image_times}: {len(times.ns)} times for {number} frames of {name}; give "
            "one row per frame"
        )
    if number < SURE_FRAMES * expected - 1:
        problems.append(f"{name}: {number} of {expected:.0f} frames could be read")
