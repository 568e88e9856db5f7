"""Picture of a signal with the measured contact drawn in."""

from __future__ import annotations

import math

import cv2
import numpy as np

from finger_common.flags import AreaFlag, flag_names

from .area_sensor import ContactMeasurement
from .calibration import PlateCalibration

SMALLEST_WIDTH = 320
"""Pixels; pictures of signals with fewer columns are enlarged by a whole factor."""

GREEN, BLUE, WHITE, BLACK = (0, 200, 0), (255, 160, 0), (255, 255, 255), (0, 0, 0)
"""Colours in BGR."""


def draw_overlay(
    signal: np.ndarray, measurement: ContactMeasurement, calibration: PlateCalibration
) -> np.ndarray:
    """(H, W, 3) uint8 BGR: a signal (h, w) with outline, ellipse and areas drawn in.

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
            pixels = calibration.to_pixels(points, width, height)
            pixels = (pixels + 0.5) * factor - 0.5
            drawn = np.rint(np.clip(pixels, -1e4, 1e4)).astype(np.int32)
            cv2.polylines(picture, [drawn], True, colour, 2, cv2.LINE_AA)
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
