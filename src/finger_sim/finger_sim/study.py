# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The paper's whole experiment on a simulated finger, written as bags: 45 presses, 15 a condition.

The finger is the full-order model on a finer mesh than any fit uses, with the study's known
materials. A fit reads bytes and pixels only; the truth is in `truth.json` beside the bags, for
those who judge a fit.

Areas either come from rendered FTIR frames (`images`), or are the true ones with measurement noise;
the bag's metadata names it. With `misfit`, trials also differ in ways unknown to a fit.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from finger_common.errors import InputError
from finger_common.files import atomic_write
from finger_common.guided_pulls import LOAD
from finger_common.processes import worker_pool
from finger_common.progress import duration_text
from finger_common.stamps import NANOSECONDS
from finger_model.paper import TARGET_FORCE, TRIALS_PER_CONDITION

from .conditions import STUDY, condition
from .study_bag import START_NS, TRIAL_SECONDS, write_bag
from .study_trial import EPIDERMIS_FACTORS, REFINEMENT, plan_study_trial, study_friction

Job = tuple[int, str, int]
"""Number of a trial in the study, its condition, its index in the condition."""


def simulate_study(
    seed: int,
    output: str | Path,
    images: bool = True,
    misfit: bool = False,
    trials: int = TRIALS_PER_CONDITION,
    conditions: Sequence[str] = tuple(STUDY),
    processes: int = 2,
    refinement: float = REFINEMENT,
    report: Callable[[str], None] | None = print,
    slip: bool = False,
) -> list[Path]:
    """Simulate the study and write one bag per trial into `output`; returns the bags in order.

    images: render FTIR frames (areas must then be measured in them); without, `contact_area`
    carries true areas with noise, as the metadata states. A bag that exists already is kept, so
    that an interrupted study can be continued. slip: each press is held and pulled sideways until
    the finger slips. Raises InputError for an unknown condition or a folder that holds the bags of
    another study.
    """
    materials = {name: condition(name).material.to_dict() for name in conditions}
    if trials < 1:
        raise InputError(f"study: {trials} trials per condition, at least 1 is needed")
    if seed < 0:
        raise InputError(f"study: seed is {seed}, zero or more is needed")
    folder = Path(output)
    plan = {
        "seed": seed,
        "images": images,
        "misfit": misfit,
        "trials": trials,
        "conditions": list(conditions),
        "refinement": refinement,
    }
    if slip:
        plan["slip"] = True
    _claim(folder, plan)
    names = [(name, index) for name in conditions for index in range(trials)]
    jobs = [(number, name, index) for number, (name, index) in enumerate(names)]
    progress = report or (lambda text: None)
    progress(
        f"simulating {len(jobs)} trials, seed {seed}, "
        + ("with FTIR frames" if images else "areas with noise, no images")
        + (", with misfit" if misfit else "")
        + (", pulled until they slip" if slip else "")
    )
    write = partial(_write_trial, folder, seed, images, misfit, refinement, slip)
    if processes > 1 and len(jobs) > 1:
        with worker_pool(processes) as pool:
            try:
                _tell(pool.map(write, jobs), len(jobs), progress)
            except KeyboardInterrupt:
                progress("interrupted: ends after the trials that are being simulated")
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    else:
        _tell(map(write, jobs), len(jobs), progress)
    truth = {
        **plan,
        "materials": materials,
        "epidermis_factor": EPIDERMIS_FACTORS[seed % 2] if misfit else 1.0,
        "target_force": LOAD if slip else TARGET_FORCE,
    }
    if slip:
        truth["friction"] = {name: study_friction(seed, name) for name in conditions}
    with atomic_write(folder / "truth.json") as file:
        json.dump(truth, file, indent=1)
    progress(f"{len(jobs)} bags in {folder}")
    return [_bag(folder, name, index) for name, index in names]


def _tell(lines: Iterable[str], total: int, progress: Callable[[str], None]) -> None:
    """A line per trial, with the time that the others take at the pace so far."""
    began = time.monotonic()
    for number, line in enumerate(lines, 1):
        left = (time.monotonic() - began) / number * (total - number)
        rest = f", {duration_text(left)} left" if number < total else ""
        progress(f"[{number}/{total}] {line}{rest}")


def _bag(folder: Path, name: str, index: int) -> Path:
    return folder / f"{name}_{index:02d}"


def _claim(folder: Path, plan: dict[str, Any]) -> None:
    """Refuse a folder with another study in it."""
    marker = folder / "study.json"
    text = json.dumps(plan, indent=1)
    if marker.exists():
        if marker.read_text(encoding="utf-8") != text:
            raise InputError(
                f"{folder}: holds another simulated study (see study.json); choose another folder"
            )
        return
    with atomic_write(marker) as file:
        file.write(text)


def _write_trial(
    folder: Path,
    seed: int,
    images: bool,
    misfit: bool,
    refinement: float,
    slip: bool,
    job: Job,
) -> str:
    """Simulate one trial and write its bag; returns a line of progress."""
    number, name, index = job
    bag = _bag(folder, name, index)
    if (bag / "metadata.yaml").exists():
        return f"{bag.name} exists already"
    trial = plan_study_trial(seed, name, index, misfit, refinement, slip)
    write_bag(bag, trial, seed, images, START_NS + number * TRIAL_SECONDS * NANOSECONDS)
    press = trial.press
    return (
        f"{bag.name}: {press.cue - press.onset:.2f} s to target, peak {press.force.max():.2f} N, "
        f"{trial.area.max() * 1e6:.1f} mm²"
        + (f", slips after {trial.pull.slip:.2f} s" if trial.pull else "")
    )
