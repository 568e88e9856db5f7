# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What fit.json holds: SI, J in mm⁴."""

from __future__ import annotations

import itertools
import math
from dataclasses import asdict
from typing import Any

import numpy as np

from ..report_units import MM4
from .fits import ConditionFit, FitResult, QuantityResult


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
        "subject": result.finger.subject,
        "finger": result.finger.name,
        "conditions": {name: condition_dict(fit) for name, fit in result.fits.items()},
        "force_modes": result.force_modes,
        "shared": result.shared,
        "epidermis_thickness": result.thickness,
    }


def condition_dict(fit: ConditionFit) -> dict[str, Any]:
    """One condition of fit.json: SI, J in mm⁴."""
    quantities = {name: fit.found(name) for name in fit.space.quantity_names}
    return (
        _result(fit)
        | _searches(fit)
        | {"seconds": fit.seconds}
        | _full_order(fit)
        | _covariance(fit, quantities)
        | _intervals(fit, quantities)
    )


def _result(fit: ConditionFit) -> dict[str, Any]:
    mean, deviation = fit.moisture
    law = fit.power_law
    return {
        **fit.space.quantities(fit.parameters),
        "J": fit.cost * MM4,
        "J_full_order": None if fit.full_order is None else fit.full_order_cost * MM4,
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
    }


def _searches(fit: ConditionFit) -> dict[str, Any]:
    space = fit.space
    top = [{**space.mapping(p), "J": float(c) * MM4} for p, c in zip(fit.top, fit.top_costs)]
    if fit.full_order is not None:
        for entry, cost in zip(top, fit.full_order.full_costs):
            entry["J_full_order"] = float(cost) * MM4
    return {
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
        "top": top,
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
    }


def _full_order(fit: ConditionFit) -> dict[str, Any]:
    out: dict[str, Any] = {}
    if fit.full_order is not None:
        found = fit.full_order
        out["full_order"] = {
            "rms_difference": found.rms_difference,
            f"{found.headline}_change": found.change,
            "gain_chi2": found.gain,
            "preferred_candidate": found.best,
        }
    if fit.correction is not None:
        made = fit.correction
        before = fit.space.mapping(made.parameters_before)
        out["correction"] = {
            "J_before": made.cost_before * MM4,
            **{f"{name}_before": value for name, value in before.items()},
            "rounds": made.rounds,
            "largest_relative_change_of_area": made.largest_factor,
        }
    return out


def _covariance(fit: ConditionFit, quantities: dict[str, QuantityResult]) -> dict[str, Any]:
    known, names = fit.covariance, fit.space.names
    if known is None:
        return {}
    return {
        "active_bounds": known.active,
        "frame_noise": known.noise,
        "covariance_log": {"parameters": list(names), "matrix": fit.covariance_log().tolist()},
        **{
            f"correlation_{first}_{second}": known.correlation(first, second)
            for first, second in itertools.combinations(names, 2)
        },
        "sd_log": {name: q.sd for name, q in quantities.items()},
        "from_data": {
            name: {
                **_ends(q.data_interval),
                "sd_log": q.data_sd,
                "sd_log_assumed": q.assumed_sd,
                "assumed": q.assumed,
            }
            for name, q in quantities.items()
        },
    }


def _intervals(fit: ConditionFit, quantities: dict[str, QuantityResult]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    if fit.profiles or fit.covariance is not None:
        out["interval_95"] = {
            name: {
                **_ends(q.interval),
                "low_is_bound": q.cut[0],
                "high_is_bound": q.cut[1],
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
            if q.bias is not None and q.identifiable is not False
        }
    if fit.samples is not None:
        out["bootstrap_95"] = {name: q.bootstrap for name, q in quantities.items()}
    return out


def _ends(interval: tuple[float, float]) -> dict[str, float]:
    return dict(zip(("low", "high"), interval))


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
