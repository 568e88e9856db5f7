# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Values for a simulated device when nothing else gives them: pressing forces, test images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from finger_common.axes import DEFAULT_NORMAL_AXIS, NORMAL_AXES, axis_of
from finger_common.errors import InputError
from finger_common.files import read_csv
from finger_common.settings import Settings, setting

Wrench = Callable[[int], np.ndarray]
"""Wrench (6,) in N and N m at a time in ns since the epoch."""


def no_load(stamp_ns: int) -> np.ndarray:
    """No wrench (6,) at any time."""
    return np.zeros(6)


def axis_vector(axis: str) -> np.ndarray:
    """Unit wrench (6,) along "+x" … "-z"."""
    index, sign = axis_of(axis)
    vector = np.zeros(6)
    vector[index] = sign
    return vector


def numbers(text: str, option: str) -> list[float]:
    """Numbers separated by commas; raises InputError naming the option."""
    try:
        return [float(v) for v in text.split(",") if v.strip()]
    except ValueError:
        raise InputError(f"{option} '{text}': numbers separated by commas are needed") from None


def constant_wrench(text: str) -> Wrench:
    """The same wrench always, from "FX,FY,FZ,TX,TY,TZ"; raises InputError unless six numbers."""
    wrench = np.array(numbers(text, "--wrench"))
    if wrench.shape != (6,) or not np.all(np.isfinite(wrench)):
        raise InputError(f"--wrench '{text}': six numbers separated by commas are needed")
    return lambda stamp_ns: wrench


def pressing_wrench(peak: float, axis: str = DEFAULT_NORMAL_AXIS, period: float = 4.0) -> Wrench:
    """A raised-cosine press to `peak` N in the first half of each `period` s, then no load."""
    direction = axis_vector(axis)

    def wrench(stamp_ns: int) -> np.ndarray:
        phase = (stamp_ns * 1e-9) % period / (period / 2)
        return direction * (peak * 0.5 * (1 - np.cos(2 * np.pi * phase)) if phase < 1 else 0.0)

    return wrench


def recorded_wrench(
    time_s: np.ndarray, force: np.ndarray, axis: str = DEFAULT_NORMAL_AXIS
) -> Wrench:
    """A recorded force (N) over time (s), repeated; raises InputError unless time increases."""
    if len(time_s) < 2 or np.any(np.diff(time_s) <= 0):
        raise InputError("--csv: time_s must increase from row to row, over at least two rows")
    direction = axis_vector(axis)
    length = time_s[-1] - time_s[0]

    def wrench(stamp_ns: int) -> np.ndarray:
        return direction * np.interp((stamp_ns * 1e-9) % length + time_s[0], time_s, force)

    return wrench


def moving_disc(height: int, width: int, seed: int = 1) -> Callable[[int], np.ndarray]:
    """Images (H, W) uint8 of a bright disc that moves from frame to frame, with noise."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    noise = np.random.default_rng(seed).normal(0, 2, (8, height, width)).astype(np.float32)

    def image(index: int) -> np.ndarray:
        centre = width / 2 + width / 4 * np.sin(index / 10)
        disc = (x - centre) ** 2 + (y - height / 2) ** 2 < (height / 5) ** 2
        return np.clip(40 + 120 * disc + noise[index % 8], 0, 255).astype(np.uint8)

    return image


@dataclass(frozen=True)
class LoadOptions(Settings):
    """The load on a simulated force sensor."""

    wrench: str = setting("0,0,0,0,0,0", "Constant FX,FY,FZ,TX,TY,TZ in N and N m.")
    press: float = setting(0.0, "Press to this force and release, repeatedly; 0 for not.", unit="N")
    csv: str = setting("", "File of force over time, columns time_s,force_n; repeated.")
    axis: str = setting(
        DEFAULT_NORMAL_AXIS,
        "Axis of the sensor along which --press and --csv push; the nodes' normal_axis.",
        choices=NORMAL_AXES,
    )

    def validate(self) -> None:
        if self.press and self.csv:
            raise InputError("--press and --csv exclude each other; give one")

    def load(self) -> Wrench:
        """The load over time; raises InputError for an option that cannot be used."""
        if self.csv:
            table = read_csv(self.csv, ["time_s", "force_n"])
            return recorded_wrench(table["time_s"], table["force_n"], self.axis)
        if self.press:
            return pressing_wrench(self.press, self.axis)
        return constant_wrench(self.wrench)
