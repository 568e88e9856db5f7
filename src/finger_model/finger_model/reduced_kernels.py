"""Compiled kernels of the reduced model: one time step, and many histories at once.

Everything is dimensionless inside: force f = F / (E0 L²) with the pad's radial semi-axis L, x = f^(1/3), internal
strain amplitudes a (k,), friction states q (m,). A network y = N(x, a, q; ln E2/E0, ln E1/E0) says

    y[0]      ln(A / (L² x²))        area
    y[1]      δ / L                  indentation
    y[2]      ln(p_max / p_mean)     peak over mean pressure
    y[3 + i]  c_i                    drive of the internal strain

and the state follows

    τ1 da_i/dt = (E0/E1) c_i − a_i                         (the paper's eq. 2 in the coordinates a)
    dq_j = (sgn(dδ) − q_j) |d ln δ| / β_j,  q = 1 in the air   (stick after a reversal of the load)

with the exponential integrator for a drive that is linear within a step, implicit in a; a step of the caller is
divided where the force changes much. No `fastmath`: the order of the additions is that of the source, so that a value does not
depend on whether it came from a stream or a batch.

Flat arrays, for speed. `network` w: header (HEADER numbers), then the layers; `constants` p: one parameter set;
`state` s: see the offsets below. Both come from `finger_model.reduced`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

# Offsets of the header of w.
LATENTS, FRICTIONS, HIDDEN, BETAS = 0, 1, 2, 8
"""k, m, width of both hidden layers; β_j at BETAS + j (at most 4)."""
HEADER = 16

# Offsets of p.
LENGTH, FORCE_SCALE, TAU, RATIO, FORCE_LIMIT, FIRST_BIAS = 0, 1, 2, 3, 4, 8
"""L (m), E0 L² (N), τ1 (s), E0/E1, largest force (N); the first layer's bias with the parameters in it."""

# Offsets of s: force, then area, slope, indentation, peak pressure as `outputs` leaves them, then a, q, y, scratch.
FORCE, AREA, SLOPE, INDENTATION, PEAK, INTERNAL = 0, 1, 2, 3, 4, 8

OUTPUTS = 3
"""Number of outputs before the drives."""

SHIFT_LOG, SHIFT_RATIO = 0.03, 0.1
"""The network sees x, ln(x + SHIFT_LOG), a and a/(x + SHIFT_RATIO), q: what flattening by a does at small loads."""

_SUBSTEP = 0.15
_MOST_SUBSTEPS = 4
_DELTA_FLOOR = 0.01
"""Smallest δ/L that counts for the friction state."""


def constants_size(latents: int, hidden: int) -> int:
    """Length of p."""
    return FIRST_BIAS + hidden + OUTPUTS + latents


def state_size(latents: int, frictions: int, hidden: int) -> int:
    """Length of s."""
    layers = 3 * hidden + latents * latents
    return INTERNAL + 3 * latents + frictions + 2 * (OUTPUTS + latents) + layers


@njit(cache=True)
def _network(w, p, s, x, at, out):
    """Evaluate N at x and the state whose a starts at s[at]; y goes to s[out:]. q lies behind a in s[INTERNAL:]."""
    k, m, n = int(w[LATENTS]), int(w[FRICTIONS]), int(w[HIDDEN])
    outputs = OUTPUTS + k
    q = INTERNAL + k
    first = INTERNAL + 3 * k + m + 2 * outputs
    second = first + n
    layer = HEADER
    z = math.log(x + SHIFT_LOG)
    for o in range(n):
        s[first + o] = p[FIRST_BIAS + o] + x * w[layer + o] + z * w[layer + n + o]
    layer += 2 * n
    ratio = 1.0 / (x + SHIFT_RATIO)
    for j in range(k):
        v = s[at + j]
        r = v * ratio
        for o in range(n):
            s[first + o] += v * w[layer + o] + r * w[layer + k * n + o]
        layer += n
    layer += k * n
    for j in range(m):
        v = s[q + j]
        for o in range(n):
            s[first + o] += v * w[layer + o]
        layer += n
    for o in range(n):
        v = s[first + o]
        s[first + o] = v / math.sqrt(1.0 + v * v)
        s[second + o] = w[layer + o]
    layer += n
    for j in range(n):
        v = s[first + j]
        for o in range(n):
            s[second + o] += v * w[layer + o]
        layer += n
    for o in range(n):
        v = s[second + o]
        s[second + o] = v / math.sqrt(1.0 + v * v)
    # What p keeps is, for indentation and drives, the value at rest, so that a finger at rest stays there exactly.
    for o in range(outputs):
        s[out + o] = -p[FIRST_BIAS + n + o]
    for j in range(n):
        v = s[second + j]
        for o in range(outputs):
            s[out + o] += v * w[layer + o]
        layer += outputs


@njit(cache=True)
def _drive_jacobian(w, s, x, jacobian, k, m, n, h1, h2):
    """∂c_i/∂a_j (k, k) at the point evaluated last, into s[jacobian:]; overwrites that evaluation's layers."""
    outputs = OUTPUTS + k
    layer1 = HEADER + 2 * n
    layer2 = HEADER + (2 + 2 * k + m) * n + n
    ratio = 1.0 / (x + SHIFT_RATIO)
    layer3 = layer2 + n * n
    # Slopes of v / sqrt(1 + v²) from its values z: (1 − z²)^1.5.
    for o in range(n):
        z = 1.0 - s[h1 + o] * s[h1 + o]
        s[h1 + o] = z * math.sqrt(z)
        z = 1.0 - s[h2 + o] * s[h2 + o]
        s[h2 + o] = z * math.sqrt(z)
    work = h2 + n
    for j in range(k):
        for o in range(n):
            s[work + o] = 0.0
        for i in range(n):
            v = s[h1 + i] * (w[layer1 + j * n + i] + ratio * w[layer1 + (k + j) * n + i])
            at = layer2 + i * n
            for o in range(n):
                s[work + o] += v * w[at + o]
        for i in range(k):
            s[jacobian + i * k + j] = 0.0
        for o in range(n):
            v = s[work + o] * s[h2 + o]
            at = layer3 + o * outputs + OUTPUTS
            for i in range(k):
                s[jacobian + i * k + j] += v * w[at + i]


@njit(cache=True)
def _solve(s, matrix, right, k):
    """Solve the k × k system at s[matrix:], right side s[right:], in place, with row pivots."""
    for c in range(k):
        best = c
        for r in range(c + 1, k):
            if abs(s[matrix + r * k + c]) > abs(s[matrix + best * k + c]):
                best = r
        if best != c:
            for j in range(k):
                v = s[matrix + c * k + j]
                s[matrix + c * k + j] = s[matrix + best * k + j]
                s[matrix + best * k + j] = v
            v = s[right + c]
            s[right + c] = s[right + best]
            s[right + best] = v
        for r in range(c + 1, k):
            factor = s[matrix + r * k + c] / s[matrix + c * k + c]
            for j in range(c, k):
                s[matrix + r * k + j] -= factor * s[matrix + c * k + j]
            s[right + r] -= factor * s[right + c]
    for c in range(k - 1, -1, -1):
        for j in range(c + 1, k):
            s[right + c] -= s[matrix + c * k + j] * s[right + j]
        s[right + c] /= s[matrix + c * k + c]


@njit(cache=True)
def advance(w, p, s, dt, force):
    """Advance s by dt (s) to `force` (N), reached linearly from the force before; clipped to 0 … FORCE_LIMIT.

    The end of a step solves a₁ = e^(−h) a₀ + (E0/E1)(w₀ c₀ + w₁ c(a₁)) by Newton's method, which is stable for
    any ratio h of step and τ1.
    """
    k, m, n = int(w[LATENTS]), int(w[FRICTIONS]), int(w[HIDDEN])
    q = INTERNAL + k
    trial = q + m
    y = trial + 2 * k
    y_trial = y + OUTPUTS + k
    h1 = y_trial + OUTPUTS + k
    h2 = h1 + n
    jacobian = h2 + 2 * n
    right = trial + k
    end = min(max(force, 0.0), p[FORCE_LIMIT])
    start = s[FORCE]
    scale = 1.0 / p[FORCE_SCALE]
    jump = abs((end * scale) ** (1.0 / 3.0) - (start * scale) ** (1.0 / 3.0))
    steps = min(1 + int(jump / _SUBSTEP), _MOST_SUBSTEPS)
    h = dt / steps / p[TAU]
    decay = math.exp(-h)
    if h > 1e-4:
        new = 1.0 + math.expm1(-h) / h
    else:
        new = h / 2 - h * h / 6
    old = p[RATIO] * (-math.expm1(-h) - new)
    new *= p[RATIO]
    for step in range(1, steps + 1):
        f = start + (end - start) * step / steps
        x = (f * scale) ** (1.0 / 3.0)
        # s[y:] still holds the outputs at the start of this step, a first guess of those at its end.
        for i in range(k):
            s[trial + i] = s[INTERNAL + i]
        delta = s[y + 1]
        for _ in range(1 if new < 0.2 else 2):
            _network(w, p, s, x, trial, y_trial)
            _drive_jacobian(w, s, x, jacobian, k, m, n, h1, h2)
            for i in range(k):
                s[right + i] = (
                    s[INTERNAL + i] * decay
                    + old * s[y + OUTPUTS + i]
                    + new * s[y_trial + OUTPUTS + i]
                    - s[trial + i]
                )
                for j in range(k):
                    s[jacobian + i * k + j] *= -new
                s[jacobian + i * k + i] += 1.0
            _solve(s, jacobian, right, k)
            for i in range(k):
                s[trial + i] += s[right + i]
        if m > 0:
            if f > 0.0:
                _network(w, p, s, x, trial, y_trial)
                change = math.log(max(s[y_trial + 1], _DELTA_FLOOR) / max(delta, _DELTA_FLOOR))
                sign = 1.0 if change > 0.0 else -1.0
                for j in range(m):
                    fade = math.exp(-abs(change) / w[BETAS + j])
                    s[q + j] = sign + (s[q + j] - sign) * fade
            else:
                for j in range(m):
                    s[q + j] = 1.0
        for i in range(k):
            s[INTERNAL + i] = s[trial + i]
        _network(w, p, s, x, INTERNAL, y)
    s[FORCE] = end


@njit(cache=True)
def area_now(w, p, s):
    """Area (m²) of the state."""
    if s[FORCE] <= 0.0:
        return 0.0
    y = INTERNAL + 3 * int(w[LATENTS]) + int(w[FRICTIONS])
    return p[LENGTH] ** 2 * (s[FORCE] / p[FORCE_SCALE]) ** (2.0 / 3.0) * math.exp(s[y])


@njit(cache=True)
def outputs(w, p, s):
    """Fill AREA (m²), SLOPE (dA/dF, m²/N), INDENTATION (m) and PEAK (Pa) of s; SLOPE 0 without contact."""
    k = int(w[LATENTS])
    y = INTERNAL + 3 * k + int(w[FRICTIONS])
    y_trial = y + OUTPUTS + k
    force = s[FORCE]
    s[INDENTATION] = p[LENGTH] * s[y + 1]
    if force <= 0.0:
        s[AREA] = 0.0
        s[SLOPE] = 0.0
        s[PEAK] = 0.0
        return
    area = area_now(w, p, s)
    s[AREA] = area
    s[PEAK] = force / area * math.exp(s[y + 2])
    # ln A = const + (2/3) ln f + y[0]; a step of 0.1 % in force at frozen state.
    x = (force * 1.001 / p[FORCE_SCALE]) ** (1.0 / 3.0)
    _network(w, p, s, x, INTERNAL, y_trial)
    s[SLOPE] = area / force * (2.0 / 3.0 + (s[y_trial] - s[y]) / 9.995003330835331e-4)


@njit(cache=True)
def rest(w, p, s):
    """Put s at rest: no load, no internal strain."""
    s[:] = 0.0
    k = int(w[LATENTS])
    for j in range(int(w[FRICTIONS])):
        s[INTERNAL + k + j] = 1.0
    _network(w, p, s, 0.0, INTERNAL, INTERNAL + 3 * k + int(w[FRICTIONS]))


@njit(cache=True)
def refresh(w, p, s):
    """Evaluate the network anew after p was changed under a state."""
    k = int(w[LATENTS])
    x = (s[FORCE] / p[FORCE_SCALE]) ** (1.0 / 3.0)
    _network(w, p, s, x, INTERNAL, INTERNAL + 3 * k + int(w[FRICTIONS]))


@njit(cache=True)
def history(w, p, s, time, force, out):
    """Area, indentation and peak pressure (n, 3) along time and force (n,); at rest before time[0]."""
    rest(w, p, s)
    for i in range(len(time)):
        advance(w, p, s, time[i] - time[i - 1] if i else 0.0, force[i])
        outputs(w, p, s)
        out[i, 0] = s[AREA]
        out[i, 1] = s[INDENTATION]
        out[i, 2] = s[PEAK]


@njit(cache=True)
def _areas(w, p, s, time, force, first, last, wanted, out):
    """Areas of one trial, samples first … last − 1, written where `wanted` says (−1: nowhere)."""
    rest(w, p, s)
    for i in range(first, last):
        advance(w, p, s, time[i] - time[i - 1] if i > first else 0.0, force[i])
        if wanted[i] >= 0:
            out[wanted[i]] = area_now(w, p, s)


@njit(cache=True, parallel=True)
def batch(w, constants, size, time, force, start, wanted, out):
    """Areas out (P, frames) of P parameter sets (P, …) over all trials.

    The trials lie end to end in time and force (n,), trial t in start[t] … start[t + 1] − 1;
    wanted (n,): the frame of `out` that a sample gives, −1 for none.
    """
    trials = len(start) - 1
    for job in prange(len(constants) * trials):
        which = job // trials
        trial = job - which * trials
        s = np.empty(size)
        _areas(
            w,
            constants[which],
            s,
            time,
            force,
            start[trial],
            start[trial + 1],
            wanted,
            out[which],
        )
