# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Building a reduced model: full-order runs, coordinates, training, measured error, file.

An interrupted build continues when it is started again with the same settings: finished runs are in
a folder beside the output (`OUTPUT.parts`) until the file is written.
"""

from __future__ import annotations

import itertools
import math
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError, ModelError
from finger_common.files import atomic_write, make_folder, sha256_of
from finger_common.folder_lock import take_lock

from ..fem.full_order import FullOrderModel
from ..geometry import Geometry
from ..laws.standard_linear_solid import PARAMETERS, composite_modulus
from .build_settings import MODES, BuildSettings
from .error import ErrorTable, error_table
from .model import LAW, ReducedModel
from .training import Network, Samples, contact_samples, drive_samples, fit, stack
from .training_runs import (
    Case,
    Run,
    held_out_case,
    pool,
    principal_modes,
    run_all,
    training_case,
    weight_of,
)

LARGEST_FORCE = 3.0
"""N, end of the range the model is built for."""

FAR_WEIGHT = 0.35
"""Weight of errors far from the paper's box: they are larger and would dominate the training."""

FORCE_LIMIT_RUNS = 4
"""Histories that must have reached the largest load, over E L², that the model is used for."""

Progress = Callable[[str, float], None]
"""Called with the name of the stage and the share of it that is done."""


def build(
    geometry: Geometry,
    output: str | Path,
    settings: BuildSettings | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> tuple[ReducedModel, ErrorTable]:
    """Build the reduced model of a geometry and write it to `output`; with its measured errors.

    Raises InputError when the output cannot be written or another build writes it, and ModelError
    when too few runs succeed.
    """
    settings = settings or BuildSettings()
    workers = workers or min(2, os.cpu_count() or 1)
    report = progress or (lambda stage, share: None)
    output = Path(output)
    kept = ("pilots", "seed", "refinement", "friction")
    runs = {key: value for key, value in settings.to_dict().items() if key in kept}
    name = sha256_of({"geometry": geometry.hash(), "runs": runs})
    with parts_folder(output, name) as parts:
        return _build(geometry, output, settings, workers, report, parts)


def _build(
    geometry: Geometry,
    output: Path,
    settings: BuildSettings,
    workers: int,
    report: Progress,
    parts: Path,
) -> tuple[ReducedModel, ErrorTable]:
    """As `build`, with the folder of finished runs."""
    began = time.monotonic()
    modes = _modes(parts, geometry, settings, workers, report)

    def runs_of(name: str, stage: str, make_case: Callable, number: int) -> list[Run]:
        cases = [make_case(settings.seed, i) for i in range(number)]
        task = (geometry, settings.refinement, settings.friction, modes)
        return list(_runs(parts, name, cases, task, workers, lambda share: report(stage, share)))

    training = runs_of("training", "full-order runs", training_case, settings.histories)
    usable = [r for r in training if len(r.time) > 5 and r.area.max() > 0]
    if len(usable) < 0.8 * len(training):
        raise ModelError(
            f"only {len(usable)} of {len(training)} full-order runs of this geometry succeeded; "
            "the finger carries too little, change the geometry"
        )
    arrays = train(usable, geometry, settings, report)
    held_out = runs_of("held_out", "held-out runs", held_out_case, settings.held_out)
    meta = _meta(geometry, settings)
    table = error_table(ReducedModel(arrays, meta), held_out)
    meta["measured_error"] = table.summary()
    meta["settings"]["build_seconds"] = round(time.monotonic() - began, 1)
    model = ReducedModel(arrays, meta)
    model.save(output)
    return model, table


def train(
    runs: list[Run], geometry: Geometry, settings: BuildSettings, report: Progress
) -> dict[str, np.ndarray]:
    """Arrays of the reduced model from full-order runs."""
    length, k = geometry.pad_semi_axis_radial, settings.latents
    counts = [1.0 if _near_box(r) else FAR_WEIGHT for r in runs]
    others = {"betas": np.array(settings.betas), "force_limit": _force_limit(runs, length)}

    samples = stack([drive_samples(r, length, k, count) for r, count in zip(runs, counts)])
    drive = Network(samples, settings.drive_width, settings.seed)
    fit(drive, samples, settings.iterations, lambda share: report("training the drive", share))

    def contact_of(states: list[np.ndarray]) -> tuple[Network, Samples]:
        parts = [contact_samples(r, length, k, s, n) for r, s, n in zip(runs, states, counts)]
        samples = stack(parts)
        return Network(samples, settings.contact_width, settings.seed), samples

    def arrays_with(contact: Network) -> dict[str, np.ndarray]:
        return {**drive.arrays("drive"), **contact.arrays("contact"), **others}

    # States need a drive only: an untrained contact network takes its place.
    idle, _ = contact_of([np.ones((len(r.time), k + len(settings.betas))) for r in runs])
    model = ReducedModel(arrays_with(idle), _meta(geometry, settings))
    contact, samples = contact_of([model.visited(r.parameters, r.time, r.force) for r in runs])
    fit(contact, samples, settings.iterations, lambda share: report("training the contact", share))
    return arrays_with(contact)


def _near_box(run: Run) -> bool:
    """Whether a run is in or near the paper's box, where the accuracy is promised."""
    low, high = PARAMETERS.box.T
    near = np.all((0.75 * low <= run.parameters) & (run.parameters <= 1.35 * high))
    return bool(near and run.force.max() <= 2.0)


def _force_limit(runs: list[Run], length: float) -> np.ndarray:
    """Coefficients of `ReducedModel.force_limit`.

    They give a load over E L² that several runs reached and at which none failed; E is the
    composite modulus.
    """
    visited, failed = [], [math.inf]
    for run in runs:
        scale = float(composite_modulus(run.parameters)) * length**2
        visited.append(run.force.max() / scale)
        if math.isfinite(run.failed):
            failed.append(0.95 * run.failed / scale)
    reached = sorted(visited)[-min(FORCE_LIMIT_RUNS, len(visited))]
    return np.array([math.log(min(reached, min(failed))), 1.0, 0.0])


def _meta(geometry: Geometry, settings: BuildSettings) -> dict[str, Any]:
    return {
        "geometry": geometry.to_dict(),
        "geometry_hash": geometry.hash(),
        "range": {
            **{p.name: list(p.range) for p in PARAMETERS},
            "force": [0.0, LARGEST_FORCE],
        },
        "friction": settings.friction,
        "law": LAW.name,
        "fixed": {k: v for k, v in LAW().to_dict().items() if k not in LAW.PARAMETERS},
        "measured_error": {},
        "settings": settings.to_dict(),
    }


# Resumable stages ----------------------------------------------------------------------------


@contextmanager
def parts_folder(output: Path, name: str) -> Iterator[Path]:
    """Folder of finished runs, for this build alone; removed once the build is done, kept when it
    is interrupted.

    name: of the build; what another one left in the folder is removed. Raises InputError while
    another build writes there, and when the folder cannot be written. File systems without locks
    are not guarded.
    """
    folder = output.with_name(output.name + ".parts")
    stamp = folder / "belongs_to"
    try:
        make_folder(folder)
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise _no_folder(folder, error) from None
    try:
        # A build that ended in between has removed the folder that was opened.
        if not take_lock(handle) or not os.fstat(handle).st_nlink:
            raise InputError(
                f"{folder}: another build is writing there; wait until it has ended, or choose "
                "another output"
            )
        try:
            if not stamp.exists() or stamp.read_text() != name:
                for left in folder.iterdir():
                    left.unlink()
            stamp.write_text(name)
        except OSError as error:
            raise _no_folder(folder, error) from None
        yield folder
        shutil.rmtree(folder)
    finally:
        os.close(handle)


def _no_folder(folder: Path, error: OSError) -> InputError:
    return InputError(f"{folder}: cannot be written ({error.strerror}); choose another output")


def _modes(
    parts: Path, geometry: Geometry, settings: BuildSettings, workers: int, report: Progress
) -> np.ndarray:
    """Projections (MODES, n) on the principal components of the internal strain."""
    file = parts / "modes.npy"
    if file.exists():
        return np.load(file, allow_pickle=False)
    model = FullOrderModel(geometry, settings.refinement)
    cases = [training_case(settings.seed + 1_000_000, i) for i in range(settings.pilots)]
    fields = []
    with pool(workers, geometry, settings.refinement, settings.friction, None) as executor:
        for i, (_, found) in enumerate(run_all(executor, cases)):
            fields += [found] if len(found) else []
            report("choosing coordinates", (i + 1) / len(cases))
    modes = principal_modes(np.concatenate(fields), weight_of(model), MODES)
    with atomic_write(file, "wb") as handle:
        np.save(handle, modes)
    return modes


def _runs(
    parts: Path,
    name: str,
    cases: list[Case],
    task: tuple[Geometry, float, float, np.ndarray],
    workers: int,
    report: Callable[[float], None],
) -> Iterator[Run]:
    """Runs of all cases, from their files where they are finished."""
    files = [parts / f"{name}_{i:05d}.npz" for i in range(len(cases))]
    missing = [i for i, file in enumerate(files) if not file.exists()]
    if missing:
        with pool(workers, *task) as executor:
            results = run_all(executor, [cases[i] for i in missing])
            done = itertools.count(len(cases) - len(missing) + 1)
            for i, (run, _) in zip(missing, results):
                with atomic_write(files[i], "wb") as handle:
                    np.savez(handle, **asdict(run))
                report(next(done) / len(cases))
    for file in files:
        with np.load(file, allow_pickle=False) as archive:
            values = {key: archive[key] for key in archive.files}
        yield Run(
            **{
                **values,
                "kind": str(values["kind"]),
                "failed": float(values["failed"]),
                "law": str(values["law"]),
            }
        )
