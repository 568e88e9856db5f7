"""Measure trial simulations per second and core, and say what 1,000 subjects would take. Updates docs/scaling.md.

python scripts/throughput.py [--write]
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from pathlib import Path

os.environ["NUMBA_NUM_THREADS"] = "1"

import numpy as np

from finger_common.files import atomic_write
from finger_fit.full_order_check import REFINEMENT, STEP
from finger_model.full_order import FullOrderModel
from finger_model.reduced import ReducedModel
from finger_sim.conditions import STUDY
from finger_sim.press import plan_press

PAGE = Path(__file__).resolve().parent.parent / "docs" / "scaling.md"
SEARCH, BOOTSTRAP = 13_875, 66_000
"""Trial simulations of one condition: grid and PSO; 200 bootstrap samples (docs/scaling.md)."""

FULL_ORDER = 180
"""Full-order runs of one condition: correction (105, the slope and two renewals) and check (75)."""


def rate(seconds: float = 2.0) -> float:
    """Trial simulations per second of processor time of one core: presses of 0.5–2 s in steps of 20 ms."""
    model = ReducedModel.load()
    rng = np.random.default_rng(0)
    trials = []
    for _ in range(15):
        press = plan_press(rng)
        end = int(np.searchsorted(press.time, press.cue))
        trials.append((press.time[:end:10], press.force[:end:10]))
    parameters = np.array([[140e3, 22.35e3, 0.5, 1795e3]] * 5)
    model.batch(parameters, trials)
    count, start = 0, time.process_time()
    while time.process_time() - start < seconds:
        model.batch(parameters, trials)
        count += len(parameters) * len(trials)
    return count / (time.process_time() - start)


def full_order_seconds(runs: int = 6) -> float:
    """Processor time of one full-order run of a fit: a natural press to the target, the fit's mesh and steps."""
    model = FullOrderModel(refinement=REFINEMENT)
    rng = np.random.default_rng(0)
    spent = 0.0
    for _ in range(runs):
        press = plan_press(rng)
        times = np.arange(press.onset, press.cue, STEP)
        start = time.process_time()
        model.simulate(STUDY["natural"].material, times, np.interp(times, press.time, press.force))
        spent += time.process_time() - start
    return spent / runs


def page_text(per_second: float, full_order: float) -> str:
    """The measured paragraph."""
    subjects = 1000 * 3
    exact = subjects * FULL_ORDER * full_order
    search, bootstrap = subjects * SEARCH / per_second, subjects * BOOTSTRAP / per_second
    return (
        f"Measured ({platform.processor() or platform.machine()}, Python {platform.python_version()}): "
        f"{per_second:,.0f} trial simulations per second of one core's time, in steps of 20 ms. 1,000 subjects with three conditions then "
        f"take {search / 3600:.1f} core hours of search and {bootstrap / 3600:.1f} core hours for 200 bootstrap samples "
        f"each. A full-order run of a fit takes {full_order:.2f} s, correction and check of all conditions "
        f"{exact / 3600:.0f} core hours. On 64 cores the whole is {(search + bootstrap + exact) / 3600 / 64:.1f} hours. The "
        "paper's search for one subject took 450 hours."
    )


def replace_between(text: str, name: str, content: str) -> str:
    """Text with what stands between the markers `name` replaced."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, rest = text.split(begin, 1)
    after = rest.split(end, 1)[1]
    return f"{before}{begin}\n{content}\n{end}{after}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="put it into docs/scaling.md")
    args = parser.parse_args()
    text = page_text(rate(), full_order_seconds())
    print(text)
    if args.write:
        page = replace_between(PAGE.read_text(encoding="utf-8"), "throughput", text)
        with atomic_write(PAGE) as file:
            file.write(page)


if __name__ == "__main__":
    main()
