# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Picture of a signal with the measured contact drawn in."""

from __future__ import annotations

import math

import cv2
import numpy as np

from finger_common.flags import AreaFlag, flag_names

from .area_sensor import ContactMeasurement
from .calibration import PlateCalibration
from .working_grid import to_fine

SMALLEST_WIDTH = 320
"""Pixels; pictures of signals with fewer columns are enlarged by a whole factor."""

GREEN, BLUE, WHITE, BLACK = (0, 200, 0), (255, 160, 0), (255, 255, 255), (0, 0, 0)
ORANGE = (0, 159, 230)
"""Colours in BGR."""


def draw_overlay(
    signal: np.ndarray, measurement: ContactMeasurement, calibration: PlateCalibration
) -> np.ndarray:
    """(H, W, 3) uint8 BGR: a signal (h, w) with outline, ellipse, areas and a scale bar drawn in.

    A contact that the border of the image cuts off gets an orange frame.

    8-bit signals keep their greys; others are scaled from their least to their largest value.
    """
    height, width = signal.shape
    if signal.dtype != np.uint8:
        low, high = float(signal.min()), float(signal.max())
        scale = 255 / (high - low) if high > low else 0.0
        signal = ((signal.astype(float) - low) * scale).astype(np.uint8)
    factor = max(1, math.ceil(SMALLEST_WIDTH / width))
    picture = cv2.cvtColor(np.ascontiguousarray(signal), cv2.COLOR_GRAY2BGR)
    picture = picture.repeat(factor, axis=0).repeat(factor, axis=1)
    if len(measurement.hull):
        for points, colour in ((_ellipse(measurement), BLUE), (measurement.hull, GREEN)):
            pixels = to_fine(calibration.to_pixels(points, width, height), factor)
            drawn = np.rint(np.clip(pixels, -1e4, 1e4)).astype(np.int32)
            cv2.polylines(picture, [drawn], True, colour, 2, cv2.LINE_AA)
    _draw_scale_bar(picture, calibration, width, height, factor)
    if measurement.flags & AreaFlag.CLIPPED:
        edge = max(picture.shape[1] // 80, 3)
        cv2.rectangle(picture, (0, 0), (width * factor - 1, height * factor - 1), ORANGE, edge)
    areas = (measurement.gross_area * 1e6, measurement.real_area * 1e6)
    flags = flag_names(AreaFlag(measurement.flags)).replace("_", " ").replace("|", ", ")
    _write_lines(picture, ["gross {:.1f} mm2, real {:.1f} mm2".format(*areas), flags])
    return picture


def _ellipse(measurement: ContactMeasurement) -> np.ndarray:
    """Points (72, 2) in m of the measurement's ellipse."""
    t = np.linspace(0, 2 * math.pi, 72)
    c, s = math.cos(measurement.ellipse_angle), math.sin(measurement.ellipse_angle)
    u = measurement.ellipse_major / 2 * np.cos(t)
    v = measurement.ellipse_minor / 2 * np.sin(t)
    x, y = measurement.centroid
    return np.column_stack([x + c * u - s * v, y + s * u + c * v])


def scale_bar(calibration: PlateCalibration, width: int, height: int) -> tuple[float, np.ndarray]:
    """Length in mm of a scale bar, and its ends (2, 2) in pixels through the middle of the image.

    The length is 1, 2 or 5 times a power of ten, and at most a quarter of the image's width.
    """
    middle = np.array([[0.375, 0.5], [0.625, 0.5]]) * (width, height)
    ends = calibration.to_plate(middle, width, height)
    longest = float(np.linalg.norm(ends[1] - ends[0])) * 1e3
    power = 10.0 ** math.floor(math.log10(longest))
    length = max(step for step in (power, 2 * power, 5 * power) if step <= longest)
    share = length / longest
    return length, middle.mean(axis=0) + (middle - middle.mean(axis=0)) * share


def _draw_scale_bar(
    picture: np.ndarray, calibration: PlateCalibration, width: int, height: int, factor: int
) -> None:
    """White bar on a dark ground at the lower right."""
    length, ends = scale_bar(calibration, width, height)
    pixels = round(float(ends[1, 0] - ends[0, 0]) * factor)
    scale = max(picture.shape[1] / 1100, 0.4)
    text = f"{length:g} mm"
    (text_width, text_height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
    pad = round(12 * scale)
    box = (max(pixels, text_width) + 2 * pad, text_height + round(10 * scale) + 2 * pad)
    left, top = picture.shape[1] - box[0], picture.shape[0] - box[1]
    cv2.rectangle(picture, (left, top), (picture.shape[1], picture.shape[0]), BLACK, cv2.FILLED)
    bar = top + box[1] - pad
    thick = max(round(5 * scale), 2)
    begin = left + (box[0] - pixels) // 2
    cv2.line(picture, (begin, bar), (begin + pixels, bar), WHITE, thick)
    where = (left + (box[0] - text_width) // 2, top + pad + text_height)
    cv2.putText(picture, text, where, cv2.FONT_HERSHEY_SIMPLEX, scale, WHITE, 1, cv2.LINE_AA)


def _write_lines(picture: np.ndarray, lines: list[str]) -> None:
    """White text on dark bars at the top left."""
    scale = max(picture.shape[1] / 1100, 0.4)
    line_height = round(38 * scale)
    for index, line in enumerate(filter(None, lines)):
        (text_width, _), _ = cv2.getTextSize(line, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
        top = index * line_height
        corner = (text_width + round(24 * scale), top + line_height)
        cv2.rectangle(picture, (0, top), corner, BLACK, cv2.FILLED)
        where = (round(12 * scale), top + round(27 * scale))
        cv2.putText(picture, line, where, cv2.FONT_HERSHEY_SIMPLEX, scale, WHITE, 1, cv2.LINE_AA)
