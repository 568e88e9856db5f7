"""Bags: speed of processing, and messages lost while recording the full load of a rig.

process_speed: a bag of 60 s with wrench, wrench_raw (500 Hz each), contact_area (10 Hz) and
moisture goes through the estimator into a new bag, in this process with everything loaded; median
of 5 runs. process_speed_images: 20 s with 1280 × 1024 frames of a ridged contact through vision
too. record_lost: see rig_load.py.
"""

from __future__ import annotations

import cProfile
import pstats
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.writer import BagWriter
from finger_offline.process import process
from finger_offline.process_options import ProcessOptions

sys.path.insert(0, str(Path(__file__).parent))
import rig_load

START = 1_700_000_000_000_000_000
PIXEL = 31.4e-6  # m, of the paper's 0.000986 mm²


def frame(area: float, rng: np.random.Generator) -> np.ndarray:
    """A ridged disc of an area (m²), ridges 0.5 mm apart, with noise: (1024, 1280) uint8."""
    y, x = np.mgrid[: rig_load.HEIGHT, : rig_load.WIDTH].astype(np.float32)
    x, y = (x - rig_load.WIDTH / 2) * PIXEL, (y - rig_load.HEIGHT / 2) * PIXEL
    inside = x * x + y * y < area / np.pi
    ridge = np.sin(2 * np.pi * y / 0.5e-3) > 0
    clean = np.where(inside & ridge, 60, 170)
    return np.clip(clean + rng.normal(0, 3, clean.shape), 0, 255).astype(np.uint8)


def make_bag(path: Path, seconds: float, images: bool) -> None:
    """Presses of 4 s to 1.4 N, with areas by a power law, or with frames of these areas."""
    rng = np.random.default_rng(0)
    sizes = np.linspace(0, 5e-5, 8)
    frames = [frame(s, rng) for s in sizes] if images else []
    with BagWriter(path, {"condition": "natural"}) as bag:
        bag.write("moisture", {"header": {"stamp": START}, "value": 69.0, "phase": 1})
        for i in range(round(seconds * 500)):
            stamp = START + i * 2_000_000
            force = 1.4 * max(0.0, float(np.sin(2 * np.pi * i / 4000)))
            noisy = force + 0.003 * float(rng.standard_normal())
            fields = {"header": {"stamp": stamp, "frame_id": "force_sensor"}}
            fields["wrench"] = {"force": {"x": 0.01, "z": -noisy}}
            bag.write("wrench_raw", fields, stamp + 100_000)
            bag.write("wrench", fields, stamp + 200_000)
            if i % 50:
                continue
            area = 4e-5 * force**0.7 if force > 0.05 else 0.0
            if images:
                number = int(np.argmin(abs(sizes - area)))
                bag.write(
                    "image_raw",
                    {
                        "header": {"stamp": stamp, "frame_id": "camera"},
                        "height": rig_load.HEIGHT,
                        "width": rig_load.WIDTH,
                        "step": rig_load.WIDTH,
                        "encoding": "mono8",
                        "data": frames[number],
                    },
                    stamp + 20_000_000,
                )
            else:
                hull = [{"x": 1e-4 * k, "y": 0.0} for k in range(60)]
                fields = {"header": {"stamp": stamp}, "gross_area": area, "area_stddev": 1e-6}
                fields |= {"flags": 0 if area else 1, "hull": hull}
                bag.write("contact_area", fields, stamp + 30_000_000)


def speed(bag: Path, folder: Path, seconds: float, options: ProcessOptions, runs: int) -> float:
    """Seconds of the bag per second of work, median of some runs."""
    took = []
    for _ in range(runs):
        shutil.rmtree(folder / "out", ignore_errors=True)
        began = time.perf_counter()
        process(bag, folder / "out", options)
        took.append(time.perf_counter() - began)
    return seconds / statistics.median(took)


def where_time_goes(bag: Path, folder: Path) -> list[str]:
    """The costliest functions of one run."""
    shutil.rmtree(folder / "out", ignore_errors=True)
    profile = cProfile.Profile()
    profile.runcall(process, bag, folder / "out")
    rows: Any = pstats.Stats(profile).stats.items()  # type: ignore[attr-defined]
    total = sum(row[1][2] for row in rows)
    rows = sorted(rows, key=lambda item: -item[1][2])[:6]
    return [f"{v[2] / total:.0%} {Path(k[0]).name}:{k[2]}" for k, v in rows]


def run(report: Any) -> None:
    folder = Path(tempfile.mkdtemp(prefix="bench_bag_"))
    try:
        seconds = 10.0 if report.quick else 60.0
        make_bag(folder / "bag", seconds, images=False)
        process(folder / "bag", folder / "first")  # loads the model, compiles
        found = speed(folder / "bag", folder, seconds, ProcessOptions(), 3 if report.quick else 5)
        report.add("process_speed", found, "× real time", 50, "higher")
        if found < 50:
            report.note("time goes to: " + ", ".join(where_time_goes(folder / "bag", folder)))
        seconds = 4.0 if report.quick else 20.0
        make_bag(folder / "images", seconds, images=True)
        options = ProcessOptions(images="yes", area_per_pixel=PIXEL**2)
        found = speed(folder / "images", folder, seconds, options, 3)
        report.add("process_speed_images", found, "× real time", 40, "higher")

        seconds = 5.0 if report.quick else 60.0
        report.note(f"recording for {seconds:.0f} s")
        load = rig_load.measure(seconds, folder)
        report.add("record_lost", load.lost, "messages", 0, "lower")
        report.note(
            f"of {sum(load.sent.values())} messages, "
            f"{load.bag_bytes / load.seconds / 1e6:.1f} MB/s; "
            f"recorder at {load.cpu:.0%} of a core; sender late by at most {load.late * 1e3:.0f} ms"
        )
        if load.lost:
            short = {t: load.sent[t] - n for t, n in load.recorded.items() if n < load.sent[t]}
            report.note(f"lost by topic: {short}")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
