# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Is a fit final? Only with bounds and forces for which the model is made, and data that pass their
checks."""

from __future__ import annotations

from ..problem import force_limit_of
from ..results import ConditionFit


def judge(fit: ConditionFit) -> None:
    """Add to a fit's reasons what keeps it from being final besides the full-order check."""
    problem = fit.problem
    for parameter, (low, high) in zip(problem.space, problem.box):
        first, last = parameter.range
        if low < first * (1 - 1e-9) or high > last * (1 + 1e-9):
            factor, unit = parameter.display_factor, parameter.display_unit
            fit.reasons.append(
                f"the bounds of {parameter.name}, {low * factor:g} to {high * factor:g} {unit}, "
                f"leave {first * factor:g} to {last * factor:g} {unit}, for which the model is made"
            )
    force = max(float(trial.force.max()) for trial in problem.trials)
    limit = force_limit_of(problem.model, fit.parameters)
    if force > limit:
        fit.reasons.append(
            f"the force goes up to {force:.3g} N, the model is made for {limit:.3g} N at most and "
            "is held there; fit the loading up to less, with target_force"
        )
    if fit.quality is not None:
        fit.reasons += [f"data: {failure}" for failure in fit.quality.failures]
    if fit.status == "not checked" and fit.reasons:
        fit.reasons.append("it was not checked against the full-order model")
    if fit.status in ("final", "not checked") and fit.reasons:
        fit.status = "not final"
