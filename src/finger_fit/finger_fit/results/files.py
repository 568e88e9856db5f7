# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Files of a fit: fit.json, parameters.yaml and tables/."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError, listed
from finger_common.files import atomic_write, load_json
from finger_common.moisture import MOISTURE_RANGE
from finger_common.subject_code import is_subject
from finger_model.calibration import SMALLEST_AREA, SMALLEST_FORCE
from finger_model.geometry import Geometry
from finger_model.laws import ConstitutiveLaw
from finger_model.parameter_sets import ParameterSet, ParameterSets
from finger_model.people import People
from finger_model.press_scatter import (
    LEAST_PRESSES,
    PressResiduals,
    PressScatter,
    press_scatter,
)
from finger_model.subjects import subject_file

from ..problem import MM4, material_of
from .fits import ConditionFit, FitResult
from .tables import write_tables

TOO_NEAR = 2.0
"""Distance of the mean moistures of two conditions over the deviation of their readings, below
which no reading can choose between them."""


def condition_dict(fit: ConditionFit) -> dict[str, Any]:
    """One condition of fit.json: SI, J in mm⁴."""
    space = fit.space
    mean, deviation = fit.moisture
    law = fit.power_law
    quantities = {name: fit.found(name) for name in space.quantity_names}
    out: dict[str, Any] = {
        **space.quantities(fit.parameters),
        "J": fit.cost * MM4,
        "J_full_order": None,
        "J_power_law": law.cost * MM4,
        "power_law": {"k": law.k, "m": law.m, "log_log_m": law.log_m},
        "goodness": None if fit.goodness is None else asdict(fit.goodness),
        "moisture_mean": mean,
        "moisture_sd": deviation,
        "trials": len(fit.problem),
        "frames": len(fit.problem.measured),
        "status": fit.status,
        "reasons": fit.reasons,
        "indentation": None if fit.indentation is None else fit.indentation.to_dict(),
        "nuisance": None if fit.nuisance is None else fit.nuisance.to_dict(),
        "quality": None if fit.quality is None else fit.quality.to_data(),
        "pso": {
            **space.mapping(fit.pso.best[0]),
            "J": fit.pso.best[1] * MM4,
            "rounds": len(fit.pso.costs),
            "particles": fit.pso.costs.shape[1],
        },
        "grid": {
            "points_per_parameter": round(len(fit.grid.costs) ** (1 / len(space))),
            "J": fit.grid.best[1] * MM4,
        },
        "polish": None
        if fit.polish is None
        else {"J": fit.polish.cost * MM4, "evaluations": fit.polish.evaluations},
        "top": [{**space.mapping(p), "J": float(c) * MM4} for p, c in zip(fit.top, fit.top_costs)],
        "cross_checks": [
            {
                "name": other.name,
                **space.mapping(other.parameters),
                "J": other.cost * MM4,
                "J_polished": other.polished_cost * MM4,
                "agrees": other.agrees,
            }
            for other in fit.cross_checks
        ],
        "seconds": fit.seconds,
    }
    if fit.full_order is not None:
        found = fit.full_order
        out["J_full_order"] = fit.full_order_cost * MM4
        for entry, cost in zip(out["top"], found.full_costs):
            entry["J_full_order"] = float(cost) * MM4
        out["full_order"] = {
            "rms_difference": found.rms_difference,
            f"{found.headline}_change": found.change,
            "gain_chi2": found.gain,
            "preferred_candidate": found.best,
        }
    if fit.correction is not None:
        made = fit.correction
        before = space.mapping(made.parameters_before)
        out["correction"] = {
            "J_before": made.cost_before * MM4,
            **{f"{name}_before": value for name, value in before.items()},
            "rounds": made.rounds,
            "largest_relative_change_of_area": made.largest_factor,
        }
    if fit.covariance is not None:
        c = fit.covariance
        out["active_bounds"] = c.active
        out["frame_noise"] = c.noise
        out["covariance_log"] = {
            "parameters": list(space.names),
            "matrix": fit.covariance_log().tolist(),
        }
        for first, second in itertools.combinations(space.names, 2):
            out[f"correlation_{first}_{second}"] = c.correlation(first, second)
        out["sd_log"] = {name: q.sd for name, q in quantities.items()}
        out["from_data"] = {
            name: {
                **_ends(q.data_interval),
                "sd_log": q.data_sd,
                "sd_log_assumed": q.assumed_sd,
                "assumed": q.assumed,
            }
            for name, q in quantities.items()
        }
    if fit.profiles or fit.covariance is not None:
        out["interval_95"] = {
            name: {
                **_ends(q.interval),
                "low_is_bound": q.low_is_bound,
                "high_is_bound": q.high_is_bound,
                "identifiable": q.identifiable,
            }
            for name, q in quantities.items()
        }
    if fit.bias_corrected:
        out["bias_corrected"] = {
            name: {
                "value": q.bias.value,
                "bias_log": q.bias.bias,
                "bias_log_error": q.bias.bias_error,
                **({} if q.identifiable is None else _ends(q.corrected_interval)),
            }
            for name, q in quantities.items()
            if q.bias is not None
        }
    if fit.samples is not None:
        out["bootstrap_95"] = {name: q.bootstrap for name, q in quantities.items()}
    return out


def _ends(interval: tuple[float, float]) -> dict[str, float]:
    return dict(zip(("low", "high"), interval))


def fit_dict(result: FitResult) -> dict[str, Any]:
    """The whole of fit.json, as plain data that JSON can hold."""
    data = {
        "provenance": result.sources,
        **_found(result),
        "contrasts": [asdict(c) for c in result.contrasts],
        "exclusions": [
            {
                "trial": e.label,
                "subject": e.subject,
                "condition": e.condition,
                "reason": e.reason,
            }
            for e in result.exclusions
        ],
        "notes": result.problems,
        "options": result.options.to_dict(),
        "seconds": result.seconds,
    }
    return _plain(data)


def _found(result: FitResult) -> dict[str, Any]:
    """What was fitted: `conditions`, or of several subjects `subjects` with theirs."""
    if result.subjects:
        return {"subjects": {name: _found(part) for name, part in result.subjects.items()}}
    return {
        "subject": _subject_of(result),
        "conditions": {name: condition_dict(fit) for name, fit in result.fits.items()},
        "force_modes": result.force_modes,
        "shared": result.shared,
        "epidermis_thickness": result.thickness,
    }


def parameter_files(result: FitResult) -> dict[str, ParameterSets]:
    """Files for the model node, which interpolates over moisture: name → sets.

    parameters.yaml of the conditions with moisture readings, or of a single one. A condition
    without readings beside others gets a file of its own, parameters_CONDITION.yaml, since the
    model node cannot choose it; so does each one where the moistures of two are `too_near`. A set
    without readings is placed in the middle of the scale, where its moisture does not matter. None
    of a model without a law, and none of a fit that was interrupted before all conditions were
    fitted.
    """
    fits, material = result.fits, material_of(result.model)
    if material is None or result.unfinished:
        return {}
    chosen, names = _by_moisture(fits), _own_files(fits)
    files = {"parameters.yaml": chosen} if chosen else {}
    files |= {names[n]: {n: f} for n, f in fits.items() if n not in chosen}
    return {file: _sets(result, held, type(material)) for file, held in files.items()}


def _by_moisture(fits: Mapping[str, ConditionFit]) -> dict[str, ConditionFit]:
    """The conditions between which the model node can choose by moisture."""
    if len(fits) == 1:
        return dict(fits)
    return {} if too_near(fits) else {n: f for n, f in fits.items() if _is_read(f)}


def _is_read(fit: ConditionFit) -> bool:
    return math.isfinite(fit.moisture[0])


def too_near(fits: Mapping[str, ConditionFit]) -> list[tuple[str, str]]:
    """Pairs of conditions whose mean moistures lie closer than their readings scatter."""
    known = [(name, *fit.moisture) for name, fit in fits.items() if _is_read(fit)]
    least = People.default().reading_sd
    return [
        (first, second)
        for (first, one, sd), (second, other, other_sd) in itertools.combinations(known, 2)
        if abs(one - other) < TOO_NEAR * max(math.sqrt(0.5 * (sd**2 + other_sd**2)), least)
    ]


def _own_files(conditions: Iterable[str]) -> dict[str, str]:
    """Name of the file of each condition, if it gets one of its own."""
    names: dict[str, str] = {}
    for condition in conditions:
        stem = file = f"parameters_{condition.replace(' ', '_')}"
        for number in itertools.count(2):
            if f"{file}.yaml" not in names.values():
                break
            file = f"{stem}_{number}"
        names[condition] = f"{file}.yaml"
    return names


def _sets(
    result: FitResult, fits: dict[str, ConditionFit], law: type[ConstitutiveLaw]
) -> ParameterSets:
    """Sets of conditions, with the covariance that the data leave: the model runs with the lengths
    and on the plate that the fit assumed, so that their errors cancel in its areas."""
    middle = 0.5 * sum(MOISTURE_RANGE), 0.0
    sets = [
        ParameterSet(
            name,
            *(fit.moisture if _is_read(fit) else middle),
            tuple(map(float, fit.parameters)),
            tuple(tuple(map(float, row)) for row in fit.covariance_log(assumed=False)),
            fit.status,
        )
        for name, fit in fits.items()
    ]
    geometry = getattr(result.model, "geometry", None)
    return ParameterSets(
        sets,
        str(result.sources.get("geometry_hash", "")),
        reduced_model_hash=str(result.sources.get("reduced_model_hash", "")),
        where="fit",
        law=law,
        geometry=None if geometry == Geometry() else geometry,
        presses=_scatter(result, [_residuals(fit) for fit in fits.values()]),
    )


def _scatter(
    result: FitResult, conditions: Sequence[Sequence[PressResiduals]]
) -> PressScatter | None:
    """Scatter of the presses of all conditions, which the model node has one of; each condition is
    known from its own number of them, of which the smallest counts."""
    fewest = min(map(len, conditions))
    misfit = float(getattr(result.model, "rms_error", 0.0))
    found = press_scatter([press for presses in conditions for press in presses], misfit)
    return replace(found, number=fewest) if found and fewest >= LEAST_PRESSES else None


def _residuals(fit: ConditionFit) -> list[PressResiduals]:
    """The presses of a condition beside its model, at the frames that count."""
    problem, found = fit.problem, []
    for number, trial in enumerate(problem.trials):
        rows = slice(*problem.starts[number : number + 2])
        areas, weight = fit.areas[rows], problem.weight[rows]
        use = (weight > 0) & (np.minimum(areas, trial.area) > SMALLEST_AREA) & (trial.area_sd > 0)
        if np.count_nonzero(use) < 2:
            continue
        left = problem.measured[rows] / np.where(use, areas, np.inf) - 1.0
        log_force = np.log(np.maximum(trial.frame_force, SMALLEST_FORCE))
        columns = trial.frame_time, left, trial.area_sd / np.where(use, areas, 1.0), log_force
        found.append(PressResiduals(*(column[use] for column in columns)))
    return found


def check_folder(folder: Path, subjects: Iterable[str]) -> None:
    """Raise InputError for a folder that holds an earlier fit of others than these subjects: what
    it wrote of them would stay, and be taken for a result of this fit."""
    others = sorted(_earlier_subjects(folder).keys() - set(subjects))
    if others:
        raise InputError(
            f"{folder}: holds an earlier fit of {listed(others)}, who are not among these trials; "
            "give another folder, or move the earlier fit away"
        )


def _earlier_subjects(folder: Path) -> dict[str, bytes]:
    """Codes of the subjects of the fit in a folder, each with the content of its parameters.yaml;
    none without a fit."""
    try:
        found = load_json(folder / "fit.json", "fit.json")
        parts = found.get("subjects") or {"": found}
        codes = {name: str(part["subject"]) for name, part in parts.items()}
    except (InputError, KeyError, TypeError, AttributeError):
        return {}
    files = {c: folder / name / "parameters.yaml" for name, c in codes.items() if is_subject(c)}
    return {code: file.read_bytes() if file.is_file() else b"" for code, file in files.items()}


def write(result: FitResult, folder: Path) -> None:
    """Write fit.json, the parameter files and the tables into the folder; of several subjects,
    those of each into a folder of its own too, and subjects/CODE.yaml of each for the model node.

    A fit that was interrupted leaves the parameter files of an earlier one.
    """
    earlier = _earlier_subjects(folder)
    for name, part in result.subjects.items():
        _write(part, folder / name)
    _write(result, folder)
    found = subject_sets(result)
    for part in result.parts.values():
        code = _subject_of(part)
        if not is_subject(code) or part.unfinished:
            continue
        file = subject_file(folder / "subjects", code)
        if code in found:
            found[code].save(file)
        else:
            file.unlink(missing_ok=True)  # of an earlier fit in this folder
    for code in set() if result.interrupted else earlier.keys() - found.keys():
        file = subject_file(folder / "subjects", code)
        # Not one that a calibration, or somebody, put there since.
        if file.is_file() and file.read_bytes() == earlier[code]:
            file.unlink()


def _write(result: FitResult, folder: Path) -> None:
    earlier = _parameter_files_of(folder)
    with atomic_write(folder / "fit.json") as file:
        json.dump(fit_dict(result), file, indent=1, ensure_ascii=False)
        file.write("\n")
    write_tables(result, folder)
    files = {} if result.subjects else parameter_files(result)
    for name, sets in files.items():
        sets.save(folder / name)
    # Those of an earlier fit in this folder would be taken for those of this one.
    for name in set() if result.interrupted else earlier - files.keys():
        (folder / name).unlink(missing_ok=True)


def _parameter_files_of(folder: Path) -> set[str]:
    """Names of the parameter files that the fit in a folder wrote; none without one."""
    try:
        found = load_json(folder / "fit.json", "fit.json")
        conditions = list(found["conditions"])
    except (InputError, KeyError, TypeError):
        return set()
    return {"parameters.yaml", *_own_files(map(str, conditions)).values()}


def subject_sets(result: FitResult) -> dict[str, ParameterSets]:
    """Sets of each subject by code, as `finger-rig calibrate` writes them: those of
    parameters.yaml but of conditions that fail a data check; not of trials that are pooled or have
    no code."""
    found = {}
    for part in result.parts.values():
        code, material = _subject_of(part), material_of(part.model)
        fits = {n: f for n, f in _by_moisture(part.fits).items() if not failing(f)}
        if fits and is_subject(code) and material is not None and not part.unfinished:
            found[code] = _sets(part, fits, type(material))
    return found


def failing(fit: ConditionFit) -> bool:
    """Whether a condition fails a data check, which keeps it out of subjects/."""
    return fit.quality is not None and bool(fit.quality.failures)


def _subject_of(result: FitResult) -> str:
    """Code of the subject of all trials, empty where there are several."""
    codes = {trial.subject for fit in result.fits.values() for trial in fit.problem.trials}
    return codes.pop() if len(codes) == 1 else ""


def _plain(value: Any) -> Any:
    """The value with NaN replaced by null, for JSON."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, (np.integer, np.bool_)):
        return value.item()
    return value
