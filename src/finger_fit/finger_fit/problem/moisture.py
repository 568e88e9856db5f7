# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Clusters of moisture readings: presses of one condition of the skin, or of several?"""

from __future__ import annotations

import itertools

import numpy as np

LEAST_DISTANCE = 20.0
"""a.u. between the means of two clusters. The paper's conditions lie 32 and 36 apart, and scatter
by 3 to 7 each."""

SEPARATED = 3.5
"""Distance of the means over the standard deviation within, of two clusters: a cut through the
middle of one even distribution gives as much, of a normal one 2.6."""


def moisture_clusters(moisture: np.ndarray, most: int) -> np.ndarray:
    """Cluster (n,) of each reading (n,) in a.u., 0 the driest: at most so many, all of them apart
    by `LEAST_DISTANCE` and `SEPARATED`."""
    moisture = np.asarray(moisture, dtype=float)
    for number in range(min(most, len(np.unique(moisture))), 1, -1):
        labels = best_division(moisture, number)
        groups = [moisture[labels == k] for k in range(number)]
        if all(_apart(low, high) for low, high in itertools.pairwise(groups)):
            return labels
    return np.zeros(len(moisture), dtype=int)


def _apart(low: np.ndarray, high: np.ndarray) -> bool:
    """Whether two neighbouring clusters (a.u.) are two."""
    degrees = max(len(low) + len(high) - 2, 1)
    squares = sum(((part - part.mean()) ** 2).sum() for part in (low, high))
    distance = float(high.mean() - low.mean())
    return distance >= max(LEAST_DISTANCE, SEPARATED * float(np.sqrt(squares / degrees)))


def best_division(moisture: np.ndarray, number: int) -> np.ndarray:
    """The division (n,) of readings (n,) into a number of clusters that minimises the squared
    distance to their means, found exactly over all cuts of the sorted readings (dynamic programme
    of Fisher 1958)."""
    order = np.argsort(moisture, kind="stable")
    x = moisture[order]
    n = len(x)
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
