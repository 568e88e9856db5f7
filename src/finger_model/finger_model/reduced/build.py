"""Building a reduced model: full-order runs, choice of coordinates, training, measured error, file.

The build can be interrupted and started again with the same settings: finished runs lie in a folder beside the
output (`OUTPUT.parts`) until the file is written.
"""

from __future__ import annotations

import math
import os
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError, ModelError
from finger_common.files import atomic_write, sha256_of

from ..fem.full_order import FullOrderModel
from ..geometry import Geometry
from ..material import Material
from .error import ErrorTable, error_table
from .force_histories import FULL_RANGE, PAPER_BOX
from .model import RANGE_NAMES, ReducedModel
from .training import BETAS, Network, Samples, contact_samples, drive_samples, fit, stack
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
"""Weight of errors far from the paper's box, where they are larger and would rule the training."""

SUPPORT = 4
"""Histories that must have reached the largest load, over E L², that the model is used for."""

CHUNK = 12
"""Runs per file of the folder of parts."""

Progress = Callable[[str, float], None]
"""Called with the stage in words and the share done of it."""


@dataclass(frozen=True)
class BuildSettings:
    """What a build depends on beside the geometry.

    histories: training histories; held_out: histories the error is measured on; pilots: histories that choose the
    coordinates; latents: coordinates of the internal strain; drive_width, contact_width: of the networks' layers;
    betas: memory of the friction states; drive_iterations, contact_iterations: of their trainings; seed; refinement
    of the full-order mesh; friction.
    """

    histories: int = 600
    held_out: int = 204
    pilots: int = 42
    latents: int = 4
    drive_width: int = 24
    contact_width: int = 32
    betas: tuple[float, ...] = BETAS
    drive_iterations: int = 20
    contact_iterations: int = 20
    seed: int = 1
    refinement: float = 1.0
    friction: float = 0.25


def build(
    geometry: Geometry,
    output: str | Path,
    settings: BuildSettings | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> tuple[ReducedModel, ErrorTable]:
    """Build the reduced model of a geometry and write it to `output`; returns it with its measured errors.

    Raises InputError when the output cannot be written and ModelError when too few runs succeed.
    """
    settings = settings or BuildSettings()
    workers = workers or min(2, os.cpu_count() or 1)
    tell = progress or (lambda stage, share: None)
    output = Path(output)
    parts = _parts_folder(output, geometry, settings)
    began = time.monotonic()

    modes = _modes(parts, geometry, settings, workers, tell)
    training = list(
        _runs(
            parts,
            "training",
            [training_case(settings.seed, i) for i in range(settings.histories)],
            (geometry, settings.refinement, settings.friction, modes),
            workers,
            lambda share: tell("full-order runs", share),
        )
    )
    usable = [r for r in training if len(r.time) > 5 and r.area.max() > 0]
    if len(usable) < 0.8 * len(training):
        raise ModelError(
            f"only {len(usable)} of {len(training)} full-order runs of this geometry succeeded; the finger "
            "carries too little, change the geometry"
        )
    arrays = train(usable, geometry, settings, tell)
    held_out = list(
        _runs(
            parts,
            "held_out",
            [held_out_case(settings.seed, i) for i in range(settings.held_out)],
            (geometry, settings.refinement, settings.friction, modes),
            workers,
            lambda share: tell("held-out runs", share),
        )
    )
    meta = _meta(geometry, settings)
    table = error_table(ReducedModel(arrays, meta), held_out)
    meta["measured_error"] = table.summary()
    meta["settings"]["build_seconds"] = round(time.monotonic() - began, 1)
    model = ReducedModel(arrays, meta)
    model.save(output)
    shutil.rmtree(parts)
    return model, table


def train(
    runs: list[Run], geometry: Geometry, settings: BuildSettings, tell: Progress
) -> dict[str, np.ndarray]:
    """Arrays of the reduced model from full-order runs."""
    length, k = geometry.pad_semi_axis_radial, settings.latents
    counts = [1.0 if _near_box(r) else FAR_WEIGHT for r in runs]
    others = {"betas": np.array(settings.betas), "force_limit": _force_limit(runs, length)}

    samples = stack([drive_samples(r, length, k, count) for r, count in zip(runs, counts)])
    drive = Network(samples, settings.drive_width, settings.seed)
    fit(drive, samples, settings.drive_iterations, lambda share: tell("training the drive", share))

    def contact_of(states: list[np.ndarray]) -> tuple[Network, Samples]:
        parts = [contact_samples(r, length, k, s, n) for r, s, n in zip(runs, states, counts)]
        samples = stack(parts)
        return Network(samples, settings.contact_width, settings.seed), samples

    def arrays_with(contact: Network) -> dict[str, np.ndarray]:
        return {**drive.arrays("drive"), **contact.arrays("contact"), **others}

    # States need a drive only: an untrained contact network stands in.
    idle, _ = contact_of([np.ones((len(r.time), k + len(settings.betas))) for r in runs])
    model = ReducedModel(arrays_with(idle), _meta(geometry, settings))
    contact, samples = contact_of([model.visited(r.parameters, r.time, r.force) for r in runs])
    fit(
        contact,
        samples,
        settings.contact_iterations,
        lambda share: tell("training the contact", share),
    )
    return arrays_with(contact)


def _near_box(run: Run) -> bool:
    """Whether a run is in or near the paper's box, where the accuracy is promised."""
    near = all(0.75 * low <= v <= 1.35 * high for v, (low, high) in zip(run.parameters, PAPER_BOX))
    return near and bool(run.force.max() <= 2.0)


def _force_limit(runs: list[Run], length: float) -> np.ndarray:
    """Coefficients of `ReducedModel.force_limit`: a load over E L² that several runs reached and none failed at.

    E is the composite modulus E0 E1/(E0 + E1).
    """
    visited, failed = [], [math.inf]
    for run in runs:
        E0, E1 = run.parameters[:2]
        scale = E0 * E1 / (E0 + E1) * length**2
        visited.append(run.force.max() / scale)
        if math.isfinite(run.failed):
            failed.append(0.95 * run.failed / scale)
    reached = sorted(visited)[-min(SUPPORT, len(visited))]
    return np.array([math.log(min(reached, min(failed))), 1.0, 0.0])


def _meta(geometry: Geometry, settings: BuildSettings) -> dict[str, Any]:
    return {
        "geometry": geometry.to_dict(),
        "geometry_hash": geometry.hash(),
        "range": {
            **{name: list(limits) for name, limits in zip(RANGE_NAMES, FULL_RANGE)},
            "force": [0.0, LARGEST_FORCE],
        },
        "friction": settings.friction,
        "poisson_ratios": [
            Material().poisson_ratio_bulk,
            Material().poisson_ratio_epidermis,
            Material().poisson_ratio_nail,
        ],
        "measured_error": {},
        "settings": {**asdict(settings), "betas": list(settings.betas)},
    }


# Resumable stages ----------------------------------------------------------------------------


def _parts_folder(output: Path, geometry: Geometry, settings: BuildSettings) -> Path:
    """Folder of finished runs; emptied when it belongs to other settings."""
    runs = {
        k: v
        for k, v in asdict(settings).items()
        if k in ("pilots", "seed", "refinement", "friction")
    }
    name = sha256_of({"geometry": geometry.hash(), "runs": runs})
    folder = output.with_name(output.name + ".parts")
    stamp = folder / "belongs_to"
    try:
        if folder.exists() and (not stamp.exists() or stamp.read_text() != name):
            shutil.rmtree(folder)
        folder.mkdir(parents=True, exist_ok=True)
        stamp.write_text(name)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written ({error.strerror}); choose another output"
        ) from None
    return folder


def _modes(
    parts: Path, geometry: Geometry, settings: BuildSettings, workers: int, tell: Progress
) -> np.ndarray:
    """Projections (8, n) on the principal components of the internal strain."""
    file = parts / "modes.npy"
    if file.exists():
        return np.load(file, allow_pickle=False)
    model = FullOrderModel(geometry, settings.refinement)
    cases = [training_case(settings.seed + 1_000_000, i) for i in range(settings.pilots)]
    fields = []
    with pool(workers, geometry, settings.refinement, settings.friction, None) as executor:
        for i, (_, found) in enumerate(run_all(executor, cases)):
            fields += [found] if len(found) else []
            tell("choosing coordinates", (i + 1) / len(cases))
    modes = principal_modes(np.concatenate(fields), weight_of(model), 8)
    with atomic_write(file, "wb") as handle:
        np.save(handle, modes)
    return modes


_FIELDS = ("parameters", "time", "force", "area", "indentation", "peak", "internal", "total")


def _runs(
    parts: Path,
    name: str,
    cases: list[Case],
    task: tuple[Geometry, float, float, np.ndarray],
    workers: int,
    tell: Callable[[float], None],
) -> Iterator[Run]:
    """Runs of all cases, from the folder where they are finished."""
    chunks = [cases[i : i + CHUNK] for i in range(0, len(cases), CHUNK)]
    files = [parts / f"{name}_{i:04d}_{len(chunk)}.npz" for i, chunk in enumerate(chunks)]
    missing = [i for i, file in enumerate(files) if not file.exists()]
    if missing:
        with pool(workers, *task) as executor:
            todo = [case for i in missing for case in chunks[i]]
            results = run_all(executor, todo)
            done = len(cases) - len(todo)
            for i in missing:
                found = []
                for _ in chunks[i]:
                    found.append(next(results)[0])
                    done += 1
                    tell(done / len(cases))
                with atomic_write(files[i], "wb") as handle:
                    np.savez(handle, **_packed(found))  # type: ignore[arg-type]
    for file in files:
        with np.load(file, allow_pickle=False) as archive:
            yield from _unpacked(archive)


def _packed(runs: list[Run]) -> dict[str, np.ndarray]:
    values: dict[str, Any] = {
        "kind": np.array([r.kind for r in runs]),
        "failed": np.array([r.failed for r in runs]),
        "rows": np.array([len(r.time) for r in runs]),
    }
    for field in _FIELDS:
        values[field] = (
            np.array([r.parameters for r in runs])
            if field == "parameters"
            else np.concatenate([getattr(r, field) for r in runs])
        )
    return values


def _unpacked(archive: Any) -> Iterator[Run]:
    data = {key: archive[key] for key in archive.files}
    ends = np.cumsum(data["rows"])
    for i, end in enumerate(ends):
        rows = slice(end - data["rows"][i], end)
        yield Run(  # type: ignore[call-arg]
            data["parameters"][i],
            str(data["kind"][i]),
            *(data[field][rows] for field in _FIELDS[1:]),
            float(data["failed"][i]),
        )
