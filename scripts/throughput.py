"""Measure trial simulations per second and core, and the time for 1,000 subjects.

With --write the result goes into docs/scaling.md.

    python scripts/throughput.py [--study out/study] [--write]

Bootstrap samples and bias pairs are counted on the study of seed 1, which is simulated into the
folder unless it is there.
"""

from __future__ import annotations

import argparse
import platform
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
from doc_tables import replace_between

from finger_common.files import atomic_write
from finger_fit.full_order.areas import REFINEMENT
from finger_fit.options import FitOptions
from finger_fit.problem import FitProblem, prepare_all
from finger_fit.search import all_free, refine
from finger_fit.study import group_trials, load
from finger_fit.uncertainty import bias_pair, bootstrap_sample
from finger_model.fem.full_order import FullOrderModel
from finger_model.reduced import ReducedModel
from finger_sim.conditions import STUDY
from finger_sim.press import plan_press
from finger_sim.study import simulate_study

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "scaling.md"
SEARCH = 13_875
"""Trial simulations of one condition: grid and PSO (docs/scaling.md)."""

PROFILES = 22_000
"""Trial simulations of one condition's five profiles (docs/scaling.md)."""

STEP = 0.04
"""s, time step of the full-order runs."""

TIMED = 6
"""Full-order runs of which the time is taken."""

FULL_ORDER = 180
"""Full-order runs of one condition: correction (105, the slope and two renewals) and check (75)."""


def rate(seconds: float = 2.0) -> float:
    """Trial simulations per second of processor time of one core: presses of 0.5–2 s in steps of 20
    ms.
    """
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


def full_order_seconds() -> float:
    """Processor time of one full-order run of a fit: a natural press to the target, the fit's mesh
    and steps.
    """
    model = FullOrderModel(refinement=REFINEMENT)
    rng = np.random.default_rng(0)
    spent = 0.0
    for _ in range(TIMED):
        press = plan_press(rng)
        times = np.arange(press.onset, press.cue, STEP)
        start = time.process_time()
        model.simulate(STUDY["natural"].material, times, np.interp(times, press.time, press.force))
        spent += time.process_time() - start
    return spent / TIMED


class Counting:
    """A reduced model that counts the trial simulations it is asked for."""

    def __init__(self, model: ReducedModel) -> None:
        self.model = model
        self.count = 0

    def batch(self, parameters: np.ndarray, trials: Any, **options: Any) -> Any:
        """As the model's own."""
        self.count += len(parameters) * len(trials)
        return self.model.batch(parameters, trials, **options)


@dataclass(frozen=True)
class Refits:
    """Trial simulations and processor seconds of one condition's bootstrap samples and bias pairs,
    default numbers.
    """

    bootstrap: int
    bias: int
    bootstrap_seconds: float
    bias_seconds: float


def refits(folder: Path) -> dict[str, Refits]:
    """Refits of every condition of the study of seed 1, press alone, at its fit; areas without the
    correction to full order.
    """
    simulate_study(1, folder, images=False, report=None)
    options, model = FitOptions(), Counting(ReducedModel.load())
    trials, _ = prepare_all(load([folder], options).records, options)
    out = {}
    for name, group in group_trials(trials, options)[0].items():
        problem = FitProblem(group, model, options)
        best = refine(problem, all_free(problem), STUDY[name].material.vector()).parameters
        spent = []
        for refit, number in (
            (bootstrap_sample, options.bootstrap),
            (bias_pair, options.bias_pairs),
        ):
            model.count, began = 0, time.process_time()
            for index in range(number):
                refit(problem, best, options.seed, index)
            spent.append((model.count, time.process_time() - began))
        (bootstrap, bootstrap_seconds), (bias, bias_seconds) = spent
        out[name] = Refits(bootstrap, bias, bootstrap_seconds, bias_seconds)
    return out


def page_text(per_second: float, full_order: float, found: dict[str, Refits]) -> str:
    """The measured table and paragraph."""
    options = FitOptions()
    subjects = 1000
    conditions = len(found)
    exact = subjects * conditions * FULL_ORDER * full_order
    counts = {
        "search": conditions * SEARCH,
        "profiles": conditions * PROFILES,
        "bias": sum(r.bias for r in found.values()),
        "bootstrap": sum(r.bootstrap for r in found.values()),
    }
    hours = {name: subjects * count / per_second / 3600 for name, count in counts.items()}
    whole = (sum(hours.values()) + exact / 3600) / 64
    rows = [
        f"| trial simulations of | {' | '.join(found)} |",
        "|---|" + "---|" * conditions,
        f"| {options.bootstrap} bootstrap samples | "
        + " | ".join(f"{r.bootstrap:,}" for r in found.values())
        + " |",
        f"| {options.bias_pairs} bias pairs | "
        + " | ".join(f"{r.bias:,}" for r in found.values())
        + " |",
        "| processor time of the pairs over that of the samples | "
        + " | ".join(f"{r.bias_seconds / r.bootstrap_seconds:.2f}" for r in found.values())
        + " |",
    ]
    return "\n".join(rows) + (
        "\n\n"
        f"Measured ({platform.processor() or platform.machine()}, "
        f"Python {platform.python_version()}): {per_second:,.0f} trial simulations per second of "
        "one core's time, in steps of 20 ms. 1,000 subjects with three conditions then take "
        f"{hours['search']:.1f} core hours of search, {hours['profiles']:.1f} of profiles, "
        f"{hours['bias']:.1f} of {options.bias_pairs} bias pairs each and "
        f"{hours['bootstrap']:.1f} of {options.bootstrap} bootstrap samples each. A full-order run "
        f"of a fit takes {full_order:.2f} s, correction and check of all conditions "
        f"{exact / 3600:.0f} core hours. On 64 cores the whole is {whole:.1f} hours. The "
        "paper's search for one subject took 450 hours."
    )


def main() -> None:
    numba.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--study", type=Path, default=ROOT / "out" / "study", metavar="FOLDER")
    parser.add_argument("--write", action="store_true", help="put the result into docs/scaling.md")
    args = parser.parse_args()
    text = page_text(rate(), full_order_seconds(), refits(args.study))
    print(text)
    if args.write:
        page = replace_between(PAGE.read_text(encoding="utf-8"), "throughput", text)
        with atomic_write(PAGE) as file:
            file.write(page)


if __name__ == "__main__":
    main()
