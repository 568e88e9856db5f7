"""Values to feed a simulated device with when nothing else does: pressing forces and test images."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from finger_common.errors import InputError

Wrench = Callable[[int], np.ndarray]
"""Wrench (6,) in N and N m at a time in ns since the epoch."""


def axis_vector(axis: str) -> np.ndarray:
    """Unit wrench (6,) along "+x" … "-z"."""
    vector = np.zeros(6)
    vector["xyz".index(axis[1])] = -1.0 if axis[0] == "-" else 1.0
    return vector


def constant_wrench(text: str) -> Wrench:
    """The same wrench always, from "FX,FY,FZ,TX,TY,TZ"; raises InputError when that is not six numbers."""
    try:
        wrench = np.array([float(v) for v in text.split(",")])
    except ValueError:
        wrench = np.zeros(0)
    if wrench.shape != (6,) or not np.all(np.isfinite(wrench)):
        raise InputError(f"--wrench '{text}': six numbers separated by commas are needed")
    return lambda stamp_ns: wrench


def pressing_wrench(peak: float, axis: str = "+z", period: float = 4.0) -> Wrench:
    """A press of raised-cosine shape to `peak` N in the first half of each `period` s, rest in the second."""
    direction = axis_vector(axis)

    def wrench(stamp_ns: int) -> np.ndarray:
        phase = (stamp_ns * 1e-9) % period / (period / 2)
        return direction * (peak * 0.5 * (1 - np.cos(2 * np.pi * phase)) if phase < 1 else 0.0)

    return wrench


def recorded_wrench(time_s: np.ndarray, force: np.ndarray, axis: str = "+z") -> Wrench:
    """A recorded force (N) over time (s), played over and over; raises InputError unless time increases."""
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
