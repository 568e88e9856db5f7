# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Slip or hold? Two explanations of Q in a window of samples in which Q/P stands still.

In slip P explains it, Q = r P, in all samples or in those of the largest r. When it is held Q goes
its own smooth way, a polynomial in time, whatever P does.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit

LENGTH, LEAST = 32, 8
"""Samples in a window, and the least number of them."""
SCATTER, RATIO_DRIFT = 0.003, 0.02
"""Of Q from sample to sample, over Q, and of ln r over a window in slip: friction is not
constant."""
COURSES = np.array([0.0, 0.2, 0.1, 0.05])
"""Of Q over Q, by degree: how much of a polynomial in time a pull or load may have in a window; the
higher degrees less in a shorter one."""
COURSE_COST = 0.7
"""Log of the odds of a constant against a line, and so on."""
CLIPPED, LEAST_CLIPPED, CLIP_COST = 0.985, 3, 4.0
"""Share of the largest r from which samples may be those that slip, their least number, and the log
of the odds against slip that comes and goes."""


@njit(cache=True)
def _by_itself(pull, used, variance, coupled):
    """Log likelihood of the used ones of Q (n,) under the best polynomial in time of degree 0 to 3,
    its level free, its other coefficients of the sizes in COURSES; and how far below it the others
    lie on average."""
    n, count = len(pull), used.sum()
    basis = np.empty((4, n))
    rest = pull.copy()
    size = np.sum(pull * used) / count
    cost, best, below = 0.0, -math.inf, 0.0
    for k in range(4):
        for i in range(n):
            basis[k, i] = 1.0 if k == 0 else basis[k - 1, i] * (2.0 * i / (n - 1.0) - 1.0)
        for j in range(k):
            basis[k] -= np.sum(used * basis[k] * basis[j]) * basis[j]
        length = np.sum(used * basis[k] * basis[k])
        basis[k] /= math.sqrt(length)
        found = np.sum(used * rest * basis[k])
        rest -= found * basis[k]
        if k > 0 and not coupled:
            spread = (COURSES[k] * (n / LENGTH) ** (k - 1) * size) ** 2 * length
            unlike = 0.5 * found * found / (variance + spread)
            cost += 0.5 * math.log(1.0 + spread / variance) + unlike
        left = np.sum(used * rest * rest)
        likelihood = -0.5 * left / variance - cost - (0.0 if coupled else COURSE_COST * k)
        if likelihood > best:
            best = likelihood
            below = -np.sum((1.0 - used) * rest) / max(n - count, 1.0)
    return best, below


@njit(cache=True)
def _by_friction(normal, pull, variance, force_noise):
    """Log likelihood of Q = P (r + r' τ), r' drawn to zero by RATIO_DRIFT; ln r at the end."""
    n = len(normal)
    tau = np.linspace(-1.0, 1.0, n)
    a, b = np.sum(normal * normal), np.sum(normal * normal * tau)
    c = np.sum(normal * normal * tau * tau)
    d, e = np.sum(normal * pull), np.sum(normal * pull * tau)
    ratio = d / a
    of_force = variance + (force_noise * ratio) ** 2
    drawn = of_force / (0.5 * RATIO_DRIFT * ratio) ** 2
    det = a * (c + drawn) - b * b
    ratio, slope = ((c + drawn) * d - b * e) / det, (a * e - b * d) / det
    left = np.sum((pull - normal * (ratio + slope * tau)) ** 2) + drawn * slope * slope
    found = -0.5 * left / of_force - 0.5 * n * math.log(of_force / variance)
    return found - 0.5 * math.log(1.0 + c / drawn), math.log(max(ratio + slope, 1e-6))


@njit(cache=True)
def odds_of_slip(normal, pull, force_noise, coupled):
    """Log of the odds of slip, all the time or now and then, against holding, in samples of P and Q
    (n,) in N with this noise (N); and ln r of the slip. coupled: P may follow Q without slip."""
    n = len(normal)
    variance = force_noise * force_noise + SCATTER * SCATTER * np.mean(pull * pull)
    hold, _ = _by_itself(pull, np.ones(n), variance, coupled)
    slip, log_ratio = _by_friction(normal, pull, variance, force_noise)
    ratios = pull / np.maximum(normal, 1e-6)
    held = np.where(ratios < CLIPPED * ratios.max(), 1.0, 0.0)
    slips = n - int(held.sum())
    inside = held[0] + held[n - 1] == 2.0
    if inside and LEAST_CLIPPED <= slips <= n - LEAST:
        clipped, below = _by_itself(pull, held, variance, coupled)
        # Chance makes r large where Q is above its own way; slip keeps Q below it.
        if below > 3.0 * math.sqrt(variance / slips):
            slides = held == 0.0
            by_force, at = _by_friction(normal[slides], pull[slides], variance, force_noise)
            if clipped + by_force - CLIP_COST > slip:
                slip, log_ratio = clipped + by_force - CLIP_COST, at
    if min(-slip, -hold) > 0.5 * n:
        # More noise than is said: the better one shows how much.
        scale = 2.0 * min(-slip, -hold) / n
        return (slip - hold) / scale, log_ratio
    return slip - hold, log_ratio
