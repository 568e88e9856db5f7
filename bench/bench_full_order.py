"""One trial of the full-order finger: time, growth with the mesh, peak memory."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from typing import Any

import numpy as np

REFINEMENTS = (0.5, 0.75, 1.0, 1.5, 2.0)
STEPS = 20


def trial(refinement: float = 1.0, repeats: int = 1) -> tuple[int, list[float], float]:
    """Unknowns, wall time (s) of each repeat and final area (m²) of the natural trial.

    1.35 N in 1 s, with friction.
    """
    from finger_model.fem.full_order import FullOrderModel
    from finger_model.material import Material
    from finger_model.paper import TARGET_FORCE

    model = FullOrderModel(refinement=refinement)
    part = np.arange(STEPS + 1) / STEPS
    model.simulate(Material(), part[:3], TARGET_FORCE * part[:3])  # compile and warm up
    times, area = [], 0.0
    for _ in range(repeats):
        begin = time.perf_counter()
        area = float(model.simulate(Material(), part, TARGET_FORCE * part).area[-1])
        times.append(time.perf_counter() - begin)
    return 2 * len(model.mesh.nodes), times, area


def solid_trial() -> float:
    """Processor time (s) of a pull in three dimensions: 10 steps of pressing, 10 of pulling."""
    from finger_model.material import Material
    from finger_model.solid3d.full_order import SolidModel

    model = SolidModel()
    model.start(Material()).step(0.1, 0.1)  # compile and warm up
    stepper = model.start(Material())
    begin = time.process_time()
    for k in range(1, 11):
        stepper.step(0.1 * k, 0.1 * k)
    for k in range(1, 11):
        stepper.step(1.0 + 0.1 * k, 1.0, (0.024 * k, 0.0))
    return time.process_time() - begin


def peak_memory() -> float:
    """Peak memory (MB) of a process that does nothing but one trial."""
    done = subprocess.run(
        [sys.executable, __file__, "--memory"], capture_output=True, text=True, check=True
    )
    return float(done.stdout)


def run(report: Any) -> None:
    """Register the figures."""
    unknowns, times, area = trial(repeats=3 if report.quick else 9)
    report.add("full_order_trial", statistics.median(times), "s", 0.3)
    begin = time.process_time()
    trial()
    spent, begin = time.process_time() - begin, time.process_time()
    trial(repeats=2)
    report.add("full_order_trial_cpu", time.process_time() - begin - spent, "s of processor time")
    report.add("full_order_memory", peak_memory(), "MB", 300)
    report.add("full_order_3d_trial", solid_trial(), "s", 60)
    report.note(f"natural trial, {unknowns} unknowns, {STEPS} steps, area {area * 1e6:.2f} mm²")
    sizes, medians = [], []
    for refinement in REFINEMENTS:
        unknowns, times, area = trial(refinement, 1 if report.quick else 3)
        sizes.append(unknowns)
        medians.append(statistics.median(times))
        report.note(
            f"refinement {refinement:g}: {unknowns} unknowns, {medians[-1]:.3f} s, "
            f"area {area * 1e6:.2f} mm²"
        )
    exponent = float(np.polyfit(np.log(sizes), np.log(medians), 1)[0])
    report.add("full_order_growth", exponent, "exponent of time over unknowns")


if __name__ == "__main__" and "--memory" in sys.argv:
    trial()
    # Not getrusage: its maximum outlives exec and so holds the parent's.
    with open("/proc/self/status") as status:
        print(next(int(row.split()[1]) / 1024 for row in status if row.startswith("VmHWM")))
