# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Building the reduced model of the population box, once for all fingers in it.

Finished runs lie in a folder beside the output (`OUTPUT.parts`) until the file is written; the same
command continues an interrupted build.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import ModelError
from finger_common.files import atomic_write, sha256_of
from finger_common.processes import begin_worker, in_threads, worker_pool
from finger_common.settings import Settings, setting

from ..fem.full_order import FullOrderModel
from ..fem.mesh import similar_mesh
from ..geometry import Geometry
from ..laws.generalized_maxwell import STIFFENING_RANGE, TIME_RANGE
from .build import Progress, parts_folder
from .error import ErrorTable
from .model import LAW, ReducedModel
from .population_runs import (
    WHOLE,
    Case,
    Run,
    held_out_case,
    middle_case,
    refining_case,
    run,
    soft_case,
    training_case,
)
from .population_training import LATENTS, measured_error, train
from .training_runs import principal_modes, weight_of

LARGEST_FORCE = 10.0
"""N, end of the range the model is built for."""
CHUNK = 50
"""Runs of one file."""


@dataclass(frozen=True)
class Kind:
    """A kind of runs. name: with which its files begin; case: makes a case of a seed and an index;
    coarse: on `similar_mesh` and with the internal strain; history, pressed: as in `run`."""

    name: str
    case: Callable[[int, int], Case]
    coarse: bool = False
    history: bool = True
    pressed: bool = False


TRAINING = Kind("coarse", training_case, coarse=True, pressed=True)
SOFT = Kind("soft", soft_case, coarse=True, pressed=True)
FURTHER = Kind("middle", middle_case, coarse=True)
FINE = Kind("fine", training_case, history=False, pressed=True)
"""Presses on the default mesh of the fingers of TRAINING."""
REFINING = Kind("refine", refining_case)
HELD_OUT = Kind("held_out", held_out_case)


@dataclass(frozen=True)
class PopulationSettings(Settings):
    """What a build of the population's model depends on."""

    histories: int = setting(
        11_500, "Training histories, each of a finger of its own.", minimum=50, maximum=1_000_000
    )
    soft_histories: int = setting(
        4600,
        "Further histories of tissue that keeps little of its modulus.",
        minimum=0,
        maximum=1_000_000,
    )
    further_histories: int = setting(
        22_000,
        "Histories of further fingers of the middle of the box, for the contact network.",
        minimum=0,
        maximum=1_000_000,
    )
    corrections: int = setting(
        2500,
        "Fingers whose elastic presses are run on the default mesh too.",
        minimum=5,
        maximum=100_000,
    )
    refining: int = setting(
        3000,
        "Histories of further fingers on the default mesh, for the contact network.",
        minimum=0,
        maximum=1_000_000,
    )
    held_out: int = setting(
        340, "Histories on which the error is measured.", minimum=4, maximum=100_000
    )
    pilots: int = setting(160, "Histories that choose the coordinates.", minimum=5, maximum=10_000)
    epochs: int = setting(
        120, "Passes of each training over all histories.", minimum=1, maximum=100_000
    )
    seed: int = setting(1, "Seed of the random fingers and histories.", minimum=0, maximum=2**31)


def build(
    output: str | Path,
    settings: PopulationSettings | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> tuple[ReducedModel, dict[str, ErrorTable]]:
    """Build the model of the population box and write it to `output`; with its measured errors.

    Raises InputError when the output cannot be written or another build writes it, and ModelError
    when too few runs succeed.
    """
    settings = settings or PopulationSettings()
    workers = workers or min(2, os.cpu_count() or 1)
    report = progress or (lambda stage, share: None)
    output = Path(output)
    runs_only = {k: v for k, v in settings.to_dict().items() if k in ("seed", "pilots")}
    layout = [field.name for field in fields(Run)]
    name = sha256_of({"population": runs_only, "layout": layout})
    with parts_folder(output, name) as parts:
        return _build(output, settings, workers, report, parts)


def _build(
    output: Path, settings: PopulationSettings, workers: int, report: Progress, parts: Path
) -> tuple[ReducedModel, dict[str, ErrorTable]]:
    """As `build`, with the folder of finished runs."""
    began = time.monotonic()
    modes = _modes(parts, settings, report)

    def runs_of(stage: str, kind: Kind, number: int) -> list[Run]:
        task = _Task(kind, settings.seed, modes if kind.coarse else None)
        return list(_runs(parts, task, number, workers, stage, report))

    coarse = runs_of("runs on the coarse mesh", TRAINING, settings.histories)
    soft = runs_of("runs of soft tissue", SOFT, settings.soft_histories)
    further = runs_of("further runs", FURTHER, settings.further_histories)
    fine = runs_of("presses on the default mesh", FINE, settings.corrections)
    refining = runs_of("runs on the default mesh", REFINING, settings.refining)
    held_out = runs_of("held-out runs", HELD_OUT, settings.held_out)
    model, tables = assemble(
        coarse + soft,
        fine,
        further,
        refining,
        held_out,
        settings,
        workers,
        report,
        began,
    )
    model.save(output)
    return model, tables


def assemble(
    runs: list[Run],
    fine: list[Run],
    further: list[Run],
    refining: list[Run],
    held_out: list[Run],
    settings: PopulationSettings,
    workers: int,
    report: Progress,
    began: float,
) -> tuple[ReducedModel, dict[str, ErrorTable]]:
    """Train on the runs and measure the error. `fine` are presses of the same fingers as the first
    of the runs on the default mesh; `further` and `refining` are runs of other fingers on the
    coarse and on the default mesh.

    Raises ModelError when too few are usable.
    """
    usable = sum(map(_usable, runs))
    if usable < 0.8 * len(runs):
        raise ModelError(
            f"only {usable} of {len(runs)} full-order runs succeeded; check the population box"
        )
    own = [_usable(found) for found in runs]
    with in_threads(workers) as each:
        arrays = train(
            [found for found, good in zip(runs, own) if good],
            [found for found, good in zip(fine, own) if good],
            [found for found in further if _touched(found)],
            [found for found in refining if _touched(found)],
            settings.epochs,
            report,
            each,
        )
    return with_error(arrays, held_out, settings, time.monotonic() - began)


def with_error(
    arrays: dict[str, np.ndarray], held_out: list[Run], settings: PopulationSettings, seconds: float
) -> tuple[ReducedModel, dict[str, ErrorTable]]:
    """The model of trained arrays, and its error over held-out runs."""
    tables = measured_error(arrays, held_out)
    box = {name: list(limits) for name, limits in WHOLE.items()}
    meta: dict[str, Any] = {
        "population": True,
        "range": {
            **box,
            "tau1": list(TIME_RANGE),
            "stiffening": list(STIFFENING_RANGE),
            "force": [0.0, LARGEST_FORCE],
        },
        "law": LAW.name,
        "measured_error": {region: table.summary() for region, table in tables.items()},
        "settings": {
            **settings.to_dict(),
            "latents": LATENTS,
            "refinement": 1.0,
            "build_seconds": round(seconds, 1),
        },
    }
    return ReducedModel(arrays, meta), tables


def _usable(found: Run) -> bool:
    """Whether a run has rows and presses and never covers the whole pad, where the mesh is
    crushed."""
    pad = np.pi * found.length**2
    pressed = np.isfinite(found.presses[:, 3, 0]).all()
    return bool(pressed and _touched(found) and found.area.max() < 0.98 * pad)


def _touched(found: Run) -> bool:
    """Whether a run has rows and a contact."""
    return len(found.time) > 3 and found.area.max() > 0.0


@dataclass(frozen=True)
class _Task:
    """Runs to make, and the modes (k, n) on which the internal strain is projected."""

    kind: Kind
    seed: int
    modes: np.ndarray | None = None

    def runs(self, indices: range) -> list[Run]:
        kind = self.kind
        return [
            run(
                kind.case(self.seed, index),
                self.modes,
                kind.coarse,
                history=kind.history,
                pressed=kind.pressed,
            )
            for index in indices
        ]


_worker: dict[str, _Task] = {}


def _begin(task: _Task) -> None:
    begin_worker()
    _worker["task"] = task


def _work(indices: range) -> list[Run]:
    return _worker["task"].runs(indices)


def _modes(parts: Path, settings: PopulationSettings, report: Progress) -> np.ndarray:
    """Projections (k, n) on the principal components of the internal strain, on `similar_mesh`."""
    file = parts / "modes.npy"
    if file.exists():
        return np.load(file, allow_pickle=False)
    found: list[np.ndarray] = []
    for index in range(settings.pilots):
        run(training_case(settings.seed + 1_000_000, index), coarse=True, fields=found)
        report("choosing coordinates", (index + 1) / settings.pilots)
    geometry = Geometry()
    weight = weight_of(FullOrderModel(geometry, mesh=similar_mesh(geometry)))
    modes = principal_modes(np.array(found), weight, LATENTS)
    with atomic_write(file, "wb") as handle:
        np.save(handle, modes)
    return modes


def _runs(
    parts: Path,
    task: _Task,
    number: int,
    workers: int,
    stage: str,
    report: Progress,
) -> Iterator[Run]:
    """Runs of all cases, from their files where they are finished."""
    chunks = [range(first, min(first + CHUNK, number)) for first in range(0, number, CHUNK)]
    files = [parts / f"{task.kind.name}_{p.start:06d}_{p.stop:06d}.npz" for p in chunks]
    missing = {part: file for part, file in zip(chunks, files) if not file.exists()}
    done = number - sum(map(len, missing))
    if missing:
        with worker_pool(workers, _begin, (task,)) as executor:
            for (part, file), found in zip(missing.items(), executor.map(_work, missing)):
                save_runs(file, found)
                done += len(part)
                report(stage, done / number)
    for file in files:
        yield from load_runs(file)


def save_runs(path: Path, runs: list[Run]) -> None:
    """Write runs into an npz archive."""
    arrays = {
        f"{index}_{field.name}": np.asarray(getattr(found, field.name))
        for index, found in enumerate(runs)
        for field in fields(Run)
    }
    with atomic_write(path, "wb") as handle:
        np.savez(handle, **arrays)  # type: ignore[arg-type]


def load_runs(path: Path) -> Iterator[Run]:
    """Runs of `save_runs`."""
    with np.load(path, allow_pickle=False) as archive:
        values = {key: archive[key] for key in archive.files}
    for index in range(len(values) // len(fields(Run))):
        own = {field.name: values[f"{index}_{field.name}"] for field in fields(Run)}
        yield Run(**{k: v.item() if v.ndim == 0 else v for k, v in own.items()})


def held_out_runs(seed: int, number: int, workers: int) -> Iterator[Run]:
    """Held-out runs on the default mesh, as they come."""
    task = _Task(HELD_OUT, seed)
    parts = [range(i, i + 1) for i in range(number)]
    with worker_pool(workers, _begin, (task,)) as executor:
        for found in executor.map(_work, parts):
            yield from found
