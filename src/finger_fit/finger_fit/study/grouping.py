# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Trials by condition; trials without a condition are grouped by moisture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from finger_model.paper import CONDITIONS

from ..options import FitOptions
from ..problem import DataError, FitTrial
from ..problem.moisture import moisture_clusters

NEAR_LEVEL = 15.0
"""a.u. of a cluster's mean from the paper's condition of which it gets the name: half the distance
of the conditions, nearly."""


def group_trials(
    trials: Sequence[FitTrial], options: FitOptions, conditions: Sequence[str] = ()
) -> tuple[dict[str, list[FitTrial]], list[str]]:
    """Trials by condition in order of moisture, and notes on how missing conditions were filled in.

    Raises DataError when a condition asked for does not occur or nothing is left.
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
        moisture = np.array([t.moisture for t in usable])
        labels = moisture_clusters(moisture, options.clusters)
        means = [float(moisture[labels == k].mean()) for k in range(labels.max() + 1)]
        names = cluster_names(means)
        named += [replace(t, condition=names[k]) for t, k in zip(usable, labels)]
        parts = ", ".join(f"{name} at {mean:.0f} a.u." for name, mean in zip(names, means))
        notes.append(
            f"{len(usable)} trials carry no condition: {len(names)} moisture "
            f"cluster{'s' * (len(names) > 1)} ({parts})"
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
            raise DataError(f"condition '{name}' does not occur in the bags; they hold {known}")
    if conditions:
        groups = {name: group for name, group in groups.items() if name in conditions}
    if not groups:
        raise DataError("no trial is left to fit; see the exclusions in the report")

    def mean_moisture(item: tuple[str, list[FitTrial]]) -> float:
        values = [t.moisture for t in item[1] if np.isfinite(t.moisture)]
        return float(np.mean(values)) if values else np.inf

    return dict(sorted(groups.items(), key=mean_moisture)), notes


def cluster_names(means: Sequence[float]) -> list[str]:
    """Names of clusters of increasing mean moisture (a.u.): the paper's conditions where all of
    them lie near different ones, else numbers."""
    near = [min(CONDITIONS.values(), key=lambda c: abs(c.moisture - mean)) for mean in means]
    close = all(abs(c.moisture - mean) <= NEAR_LEVEL for c, mean in zip(near, means))
    names = [c.name for c in near]
    if close and len(set(names)) == len(names):
        return names
    return [f"moisture {k + 1}" for k in range(len(means))]
