"""Files of a fit: fit.json and parameters.yaml, as the design's "Files" has them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.files import atomic_write
from finger_model.parameter_sets import (
    MOISTURE_MAXIMUM,
    PARAMETER_NAMES,
    ParameterSet,
    ParameterSets,
)

from .bias import shifted_interval
from .fit import ConditionFit, FitReport, parameter_vector
from .problem import MM4


def condition_dict(fit: ConditionFit) -> dict[str, Any]:
    """One condition of fit.json: SI, J in mm⁴."""
    mean, deviation = fit.moisture
    law = fit.power_law
    out: dict[str, Any] = {
        **parameter_vector(fit),
        "composite_E": fit.composite_E,
        "J": fit.cost * MM4,
        "J_full_order": None,
        "J_power_law": law.cost * MM4,
        "power_law": {"k": law.k, "m": law.m, "log_log_m": law.log_m},
        "moisture_mean": mean,
        "moisture_sd": deviation,
        "trials": len(fit.problem),
        "frames": len(fit.problem.measured),
        "status": fit.status,
        "reasons": fit.reasons,
        "pso": {
            **dict(zip(PARAMETER_NAMES, map(float, fit.pso.best[0]))),
            "J": fit.pso.best[1] * MM4,
            "rounds": len(fit.pso.costs),
            "particles": fit.pso.costs.shape[1],
        },
        "grid": {
            "points_per_parameter": round(len(fit.grid.costs) ** 0.25),
            "J": fit.grid.best[1] * MM4,
        },
        "polish": None
        if fit.polish is None
        else {"J": fit.polish.cost * MM4, "evaluations": fit.polish.evaluations},
        "top": [
            {**dict(zip(PARAMETER_NAMES, map(float, p))), "J": float(c) * MM4}
            for p, c in zip(fit.top, fit.top_costs)
        ],
        "referees": [
            {
                "name": r.name,
                **dict(zip(PARAMETER_NAMES, map(float, r.parameters))),
                "J": r.cost * MM4,
                "J_polished": r.polished_cost * MM4,
                "agrees": r.agrees,
            }
            for r in fit.referees
        ],
        "seconds": fit.seconds,
    }
    if fit.full_order is not None:
        found = fit.full_order
        out["J_full_order"] = float(found.full_costs[0]) * MM4
        for entry, cost in zip(out["top"], found.full_costs):
            entry["J_full_order"] = float(cost) * MM4
        out["full_order"] = {
            "rms_difference": found.rms_difference,
            "composite_E_change": found.modulus_change,
            "preferred_candidate": found.best,
        }
    if fit.correction is not None:
        done = fit.correction
        out["correction"] = {
            "J_before": done.cost_before * MM4,
            **{
                f"{name}_before": float(v)
                for name, v in zip(PARAMETER_NAMES, done.parameters_before)
            },
            "rounds": done.rounds,
            "largest_relative_change_of_area": done.largest_factor,
        }
    if fit.covariance is not None:
        c = fit.covariance
        out["active_bounds"] = c.active
        out["frame_noise"] = c.noise
        out["correlation_E0_E1"] = c.correlation("E0", "E1")
        out["correlation_E1_E2"] = c.correlation("E1", "E2")
        out["sd_log"] = dict(zip(PARAMETER_NAMES, np.sqrt(np.diag(c.covariance)).tolist()))
        out["sd_log"]["composite_E"] = c.composite_sd
    if fit.profiles:
        out["interval_95"] = {
            name: {
                "low": p.interval[0],
                "high": p.interval[1],
                "low_is_bound": p.open_low,
                "high_is_bound": p.open_high,
                "told": p.told,
            }
            for name, p in fit.profiles.items()
        }
    if fit.unbiased:
        out["bias_corrected"] = {
            name: {
                "value": found.value,
                "bias_log": found.bias,
                "bias_log_error": found.bias_error,
                **_moved_interval(fit, name, found.bias),
            }
            for name, found in fit.unbiased.items()
        }
    if fit.samples is not None:
        out["bootstrap_95"] = {
            name: fit.bootstrap_interval(name) for name in (*PARAMETER_NAMES, "composite_E")
        }
    return out


def _moved_interval(fit: ConditionFit, name: str, bias: float) -> dict[str, float]:
    """The 95 % interval of a bias-corrected value, where there is a profile."""
    if name not in fit.profiles:
        return {}
    low, high = shifted_interval(fit.profiles[name], bias)
    return {"low": low, "high": high}


def fit_dict(report: FitReport) -> dict[str, Any]:
    """The whole of fit.json."""
    return {
        "conditions": {name: condition_dict(fit) for name, fit in report.fits.items()},
        "force_modes": report.force_modes,
        "shared": report.shared,
        "epidermis_thickness": report.thickness,
        "exclusions": [
            {"trial": e.label, "condition": e.condition, "reason": e.reason}
            for e in report.exclusions
        ],
        "notes": report.problems,
        "options": report.options.to_dict(),
        "sources": report.sources,
        "seconds": report.seconds,
    }


def parameter_sets(report: FitReport) -> ParameterSets:
    """Sets for the model node, which interpolates over moisture: equal means are set apart by a hair, and a condition
    without readings takes the middle of the instrument's scale."""
    sets: list[ParameterSet] = []
    for name, fit in report.fits.items():
        mean, deviation = fit.moisture
        values = parameter_vector(fit)
        mean = mean if math.isfinite(mean) else 0.5 * MOISTURE_MAXIMUM
        while any(abs(mean - other.moisture) < 1e-6 for other in sets):
            mean += 1e-3 if mean < MOISTURE_MAXIMUM - 1 else -1e-3
        sets.append(
            ParameterSet(
                name,
                mean,
                deviation if math.isfinite(deviation) else 0.0,
                (values["E0"], values["E1"], values["tau1"], values["E2"]),
                tuple(tuple(map(float, row)) for row in fit.covariance_log()),
            )
        )
    return ParameterSets(
        sets,
        str(report.sources.get("geometry_hash", "")),
        str(report.sources.get("reduced_model_hash", "")),
        "fit",
    )


def write(report: FitReport, folder: Path) -> None:
    """Write fit.json and parameters.yaml into the folder."""
    with atomic_write(folder / "fit.json") as file:
        json.dump(_plain(fit_dict(report)), file, indent=1, ensure_ascii=False)
        file.write("\n")
    parameter_sets(report).save(folder / "parameters.yaml")


def _plain(value: Any) -> Any:
    """JSON has no NaN: null in its place."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, (np.integer, np.bool_)):
        return value.item()
    return value
