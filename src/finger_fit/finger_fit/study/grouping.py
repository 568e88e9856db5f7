# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Trials by condition; trials without a condition are grouped by moisture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from finger_common.errors import InputError
from finger_model.paper import CONDITIONS

from ..options import FitOptions
from ..problem import FitTrial


def group_trials(
    trials: Sequence[FitTrial], options: FitOptions, conditions: Sequence[str] = ()
) -> tuple[dict[str, list[FitTrial]], list[str]]:
    """Trials by condition in order of moisture, and notes on how missing conditions were filled in.

    Raises InputError when a condition asked for does not occur or nothing is left.
    """
    notes: list[str] = []
    nameless = [t for t in trials if not t.condition]
    named = [t for t in trials if t.condition]
    usable = [t for t in nameless if np.isfinite(t.moisture)]
    if nameless and not usable:
        named += [replace(t, condition="all") for t in nameless]
        notes.append(
            f"{len(nameless)} trials carry neither condition nor moisture: one group 'all'"
        )
    elif usable:
        labels = moisture_clusters(np.array([t.moisture for t in usable]), options.clusters)
        number = int(labels.max()) + 1
        names = list(CONDITIONS)
        if number != len(names):
            names = [f"moisture {k + 1}" for k in range(number)]
        named += [replace(t, condition=names[k]) for t, k in zip(usable, labels)]
        notes.append(
            f"{len(usable)} trials carry no condition: grouped into {number} moisture clusters "
            f"({', '.join(names)})"
        )
        if len(usable) < len(nameless):
            left = ", ".join(t.label for t in nameless if not np.isfinite(t.moisture))
            notes.append(f"left out, with neither condition nor moisture: {left}")
    groups: dict[str, list[FitTrial]] = {}
    for trial in named:
        groups.setdefault(trial.condition, []).append(trial)
    for name in conditions:
        if name not in groups:
            known = ", ".join(groups) or "none"
            raise InputError(f"condition '{name}' does not occur in the bags; they hold {known}")
    if conditions:
        groups = {name: group for name, group in groups.items() if name in conditions}
    if not groups:
        raise InputError("no trial is left to fit; see the exclusions in the report")

    def mean_moisture(item: tuple[str, list[FitTrial]]) -> float:
        values = [t.moisture for t in item[1] if np.isfinite(t.moisture)]
        return float(np.mean(values)) if values else np.inf

    return dict(sorted(groups.items(), key=mean_moisture)), notes


def moisture_clusters(moisture: np.ndarray, number: int) -> np.ndarray:
    """Cluster (n,) of each reading (n,) in a.u., 0 the driest.

    The division that minimises the squared distance to the clusters' means, found exactly over all
    cuts of the sorted readings (dynamic programme of Fisher 1958).
    """
    order = np.argsort(moisture, kind="stable")
    x = np.asarray(moisture, dtype=float)[order]
    n = len(x)
    number = min(number, n)
    total, square = np.cumsum(np.r_[0.0, x]), np.cumsum(np.r_[0.0, x * x])

    def spread(i: int, j: int) -> float:
        """Squared deviation of x[i:j] from its mean."""
        return square[j] - square[i] - (total[j] - total[i]) ** 2 / (j - i)

    best = np.full((number + 1, n + 1), np.inf)
    cut = np.zeros((number + 1, n + 1), dtype=int)
    best[0, 0] = 0.0
    for k in range(1, number + 1):
        for j in range(k, n + 1):
            costs = [best[k - 1, i] + spread(i, j) for i in range(k - 1, j)]
            cut[k, j] = k - 1 + int(np.argmin(costs))
            best[k, j] = min(costs)
    labels = np.empty(n, dtype=int)
    end = n
    for k in range(number, 0, -1):
        begin = cut[k, end]
        labels[order[begin:end]] = k - 1
        end = begin
    return labels
