"""A whole fit: recorded trials, or bags, to results and files."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

from finger_bag.schema import software_version
from finger_common.errors import InputError, ModelError
from finger_model.fem.area_model import FullOrderAreas
from finger_model.reduced import ReducedModel

from .. import results
from ..engine import Engine, engine_for
from ..full_order import FullOrder
from ..options import FitOptions
from ..problem import Exclusion, FitProblem, material_of, prepare_all
from ..report import write_report
from ..results import ConditionFit, FitResult
from ..search import Stopped
from .bags import load
from .condition import fit_condition
from .deformed import deformed_finger
from .further import force_modes, shared_fit, thickness_fit
from .grouping import group_trials
from .progress import Progress, Report

SMALLEST_CONDITION = 3
"""Trials below which a condition is not fitted: too few to separate parameters from scatter."""


def fit_records(
    records: Sequence[Any],
    model: Any,
    options: FitOptions,
    conditions: Sequence[str] = (),
    folder: Path | None = None,
    report: Report | None = None,
) -> FitResult:
    """Fit recorded trials, condition by condition. Raises InputError when nothing can be fitted."""
    trials, exclusions = prepare_all(records, options)
    if not trials:
        raise nothing_to_fit(exclusions)
    groups, notes = group_trials(trials, options, conditions)
    fits: dict[str, ConditionFit] = {}
    with engine_for(options.dask) as engine:
        for name, group in groups.items():
            if len(group) < SMALLEST_CONDITION:
                notes.append(
                    f"condition '{name}' has {len(group)} trials, {SMALLEST_CONDITION} are needed: "
                    "not fitted"
                )
                continue
            problem = FitProblem(group, model, options)
            fits[name] = fit_condition(problem, options, name, engine, folder, report)
            if fits[name].status == "interrupted":
                break
        if not fits:
            raise InputError(f"no condition can be fitted ({'; '.join(notes)})")
        result = FitResult(options, fits, exclusions, notes)
        if not result.interrupted:
            _further(result, records, engine)
    return result


def nothing_to_fit(exclusions: Sequence[Exclusion]) -> InputError:
    """The error of a fit without a usable trial."""
    reasons = "; ".join(f"{e.label}: {e.reason}" for e in exclusions[:3])
    return InputError(f"no trial can be fitted ({reasons or 'the bags hold none'})")


def _further(result: FitResult, records: Sequence[Any], engine: Engine) -> None:
    """The other force mode, and the additional fits that the options ask for."""
    options, fits = result.options, result.fits
    progress = Progress("", len(result.space), None)
    # A fit by the full-order model itself takes minutes, and is not repeated for a comparison.
    if not isinstance(next(iter(fits.values())).problem.model, FullOrderAreas):
        with progress.timed("other force mode"):
            result.force_modes = {name: force_modes(fit, records) for name, fit in fits.items()}
    if options.shared and len(fits) > 1:
        result.shared = shared_fit(
            {name: fit.problem for name, fit in fits.items()},
            {name: fit.parameters for name, fit in fits.items()},
            options.shared,
        )
    if options.extra == "epidermis_thickness":
        with progress.timed("thickness"):
            result.thickness = {
                name: thickness_fit(
                    fit.problem, fit.parameters, FullOrder.like(fit.problem.model, engine)
                )
                for name, fit in fits.items()
            }
    result.seconds.update(progress.seconds)


def fit_bags(
    paths: Sequence[str | Path],
    options: FitOptions | None = None,
    output: str | Path | None = None,
    conditions: Sequence[str] = (),
    model: Any = None,
    report: Report | None = None,
    normal_axis: str | None = None,
    calibration: str | None = None,
    mapping: str | Path | None = None,
) -> FitResult:
    """Fit bags and write fit.json, parameters.yaml, report.html and its figures into `output`.

    paths: bags and folders of bags; model: a ReducedModel, or a FullOrderAreas of any law, None for
    the shipped reduced model; conditions: names to fit, empty for all. Nothing is written without
    `output`. Raises InputError for bags that cannot be fitted.
    """
    options = options or FitOptions()
    model = model or ReducedModel.load()
    options.check_names(model.space)
    folder = None if output is None else Path(output)
    progress = Progress("", len(model.space), report)
    with progress.timed("load"):
        loaded = load(paths, options, normal_axis, calibration, progress.count("load"), mapping)
    if not loaded.records:
        raise nothing_to_fit(loaded.exclusions)
    result = fit_records(loaded.records, model, options, conditions, folder, report)
    result.exclusions = [*loaded.exclusions, *result.exclusions]
    result.problems = [*loaded.problems, *result.problems]
    result.sources = {
        "bags": loaded.sources,
        "law": material_of(model).name,
        "geometry_hash": model.geometry.hash(),
        "reduced_model_hash": getattr(model, "hash", ""),
        "reduced_model_error": getattr(model, "measured_error", {}),
        "software_version": software_version(),
        "date": date.today().isoformat(),
    }
    result.seconds.update(progress.seconds)
    for fit in result.fits.values():
        for stage, spent in fit.seconds.items():
            result.seconds[stage] = result.seconds.get(stage, 0.0) + spent
    result.output = folder
    if folder is not None:
        _write(result, folder, progress)
    return result


def _write(result: FitResult, folder: Path, progress: Progress) -> None:
    """fit.json and parameters.yaml first, then the report; a stopped fit writes what it found."""
    results.write(result, folder)
    with contextlib.suppress(Stopped):
        progress.count("report")(0, 1)
    with progress.timed("report"):
        fit, trial = result.example()
        try:
            result.deformed = deformed_finger(fit, trial, FullOrder.like(fit.problem.model))
        except ModelError as error:
            result.problems.append(f"the deformed finger is not drawn: {error}")
        write_report(result, folder)
    result.seconds.update(progress.seconds)
    results.write(result, folder)
    with contextlib.suppress(Stopped):
        progress.count("report")(1, 1)
