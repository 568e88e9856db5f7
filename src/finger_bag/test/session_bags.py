# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Small session bags with known content."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.writer import BagWriter

START = 1_700_000_000_000_000_000
AREA_PER_FORCE = 40e-6  # m^2 / N


def wrench(stamp_ns: int, normal: float, lateral: float = 0.0) -> dict[str, Any]:
    """WrenchStamped of a press along -z."""
    return {
        "header": {"stamp": stamp_ns, "frame_id": "force_sensor"},
        "wrench": {"force": {"x": lateral, "y": 0.0, "z": -normal}, "torque": {"x": 0.001}},
    }


def image(stamp_ns: int, area: float, size: int = 96, pixel: float = 0.2e-3) -> dict[str, Any]:
    """Mono8 image (size, size) of a disc of an area (m²); pixel: m."""
    y, x = np.mgrid[:size, :size] - size / 2
    pixels = np.where(np.hypot(x, y) * pixel < np.sqrt(area / np.pi), 60, 180).astype(np.uint8)
    return {
        "header": {"stamp": stamp_ns, "frame_id": "camera"},
        "height": size,
        "width": size,
        "step": size,
        "encoding": "mono8",
        "data": pixels,
    }


def press_force(time: np.ndarray, peak: float = 1.5) -> np.ndarray:
    """Rise, hold and fall within 3 s."""
    return peak * np.clip(np.minimum(time - 0.5, 3.0 - time), 0.0, 1.0)


def write_session(
    path: Path,
    trials: int = 2,
    messages: bool = True,
    condition: str = "natural",
    peak: float = 1.5,
    tremor: float = 0.0,
    images: bool = False,
    rate: int = 500,
    **options: Any,
) -> Path:
    """A session: per trial 3 readings, a press of 3.5 s with areas at 10 Hz, 3 readings."""
    with BagWriter(
        path, {"subject": "S01", "condition": condition, "session": "one"}, **options
    ) as bag:
        for index in range(trials):
            begin = START + index * 20_000_000_000

            def trial(phase: int, seconds: float, index: int = index, begin: int = begin) -> None:
                if messages:
                    bag.write(
                        "trial",
                        {
                            "header": {"stamp": begin + round(seconds * 1e9)},
                            "session": "one",
                            "subject": "S01",
                            "condition": condition,
                            "index": index,
                            "phase": phase,
                            "target_force": 1.35,
                        },
                    )

            trial(2, 0.0)
            for number in range(3):
                stamp = begin + round((0.5 + number) * 1e9)
                fields = {"header": {"stamp": stamp}, "value": 60.0 + number, "phase": 1}
                bag.write("moisture", fields)
            trial(3, 4.0)
            time = np.arange(0, 3.5, 1 / rate)
            forces = press_force(time, peak)
            forces += tremor * np.sin(2 * np.pi * 9.3 * time) * (forces > 0.2)
            for t, force in zip(time, forces):
                stamp = begin + round((4.0 + t) * 1e9)
                bag.write("wrench", wrench(stamp, force, 0.1 * force))
                if round(t * rate) % (rate // 10) == 0:
                    area = AREA_PER_FORCE * force
                    if images:
                        bag.write("image_raw", image(stamp, area), stamp + 20_000_000)
                    bag.write(
                        "contact_area",
                        {
                            "header": {"stamp": stamp, "frame_id": "plate"},
                            "gross_area": area,
                            "real_area": 0.4 * area,
                            "area_stddev": 1e-6,
                            "flags": 0 if force > 0 else 1,
                            "hull": [{"x": 0.001, "y": 0.002}, {"x": 0.003}],
                        },
                        log_time_ns=stamp + 30_000_000,
                    )
            trial(5, 8.0)
            for number in range(3):
                stamp = begin + round((8.5 + number) * 1e9)
                fields = {"header": {"stamp": stamp}, "value": 70.0 + number, "phase": 2}
                bag.write("moisture", fields)
            trial(6, 12.0)
    return path
