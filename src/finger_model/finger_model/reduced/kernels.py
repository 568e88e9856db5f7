"""Compiled kernels of the reduced model: one time step, and many histories at once.

Everything is dimensionless inside: force f = F / (E0 L²) with the pad's radial semi-axis L, x = f^(1/3), internal
strain amplitudes a (k,), friction states q (m,). Two small networks of the same form,

    drive    (δ/L, c)                       = N₁(x, a; ln E2/E0)
    contact  (ln(A / (L² x²)), ln(p_max/p_mean)) = N₂(x, a, q; ln E2/E0)

give indentation δ and drive c of the internal strain, area A and peak over mean pressure. The state follows

    τ1 da_i/dt = (E0/E1) c_i − a_i                         (the paper's eq. 2 in the coordinates a)
    dq_j = (sgn(dδ) − q_j) |d ln δ| / β_j,  q = 1 in the air   (stick after a reversal of the load)

with the exponential integrator for a drive that is linear within a step, implicit in a; a step of the caller is
divided where the force changes much. No `fastmath`: the order of the additions is that of the source, so that a value does not
depend on whether it came from a stream or a batch.

Flat arrays, for speed. `network` w: header (HEADER numbers), then the layers; `constants` p: one parameter set;
`state` s: see the offsets below. All come from `finger_model.reduced`. Widths of layers are multiples of four: four
rows of a layer are added at a time.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

# Offsets of the header of w.
LATENTS, FRICTIONS, DRIVE_WIDTH, CONTACT_WIDTH, BETAS = 0, 1, 2, 3, 8
"""k, m, widths of the hidden layers of both networks; β_j at BETAS + j (at most 4)."""
HEADER = 16

# Offsets of p.
LENGTH, FORCE_SCALE, TAU, RATIO, FORCE_LIMIT, FIRST_BIAS = 0, 1, 2, 3, 4, 8
"""L (m), E0 L² (N), τ1 (s), E0/E1, largest force (N); first layers' biases with the parameters in them."""

# Offsets of s: force, then area, slope, indentation, peak pressure as `outputs` leaves them, then a, q, y, scratch.
FORCE, AREA, SLOPE, INDENTATION, PEAK, INTERNAL = 0, 1, 2, 3, 4, 8

CONTACT_OUTPUTS = 2
"""Outputs of the contact network; the drive network has 1 + k."""

SHIFT_LOG, SHIFT_RATIO = 0.03, 0.1
"""The networks see x, ln(x + SHIFT_LOG), a and a/(x + SHIFT_RATIO): what flattening by a does at small loads."""

_SUBSTEP = 0.15
_MOST_SUBSTEPS = 4
_DELTA_FLOOR = 0.01
"""Smallest δ/L that counts for the friction state."""


def constants_size(latents: int, drive_width: int, contact_width: int) -> int:
    """Length of p."""
    return FIRST_BIAS + drive_width + (1 + latents) + contact_width


def state_size(latents: int, frictions: int, drive_width: int, contact_width: int) -> int:
    """Length of s."""
    k = latents
    layers = (2 + k) * drive_width + 2 * contact_width
    return INTERNAL + 3 * k + frictions + 2 * (1 + k) + k * k + layers + CONTACT_OUTPUTS


@njit(cache=True)
def _add_rows(w, layer, rows, n, s, values, out):
    """s[out : out + n] += Σ_j s[values + j] · w[layer + j n :] over all rows, four at a time."""
    j = 0
    while j + 4 <= rows:
        v0, v1 = s[values + j], s[values + j + 1]
        v2, v3 = s[values + j + 2], s[values + j + 3]
        at = layer + j * n
        for o in range(n):
            s[out + o] += (v0 * w[at + o] + v1 * w[at + n + o]) + (
                v2 * w[at + 2 * n + o] + v3 * w[at + 3 * n + o]
            )
        j += 4
    while j < rows:
        v0 = s[values + j]
        at = layer + j * n
        for o in range(n):
            s[out + o] += v0 * w[at + o]
        j += 1


@njit(cache=True)
def _hidden(w, layer, n, k, m, s, bias, x, at, first):
    """Both hidden layers of a network of width n, from s[bias:] and the features, into s[first : first + 2 n].

    The amplitudes lie at s[at:], the m friction states behind a. Returns where the last layer begins in w.
    """
    second = first + n
    z = math.log(x + SHIFT_LOG)
    for o in range(n):
        s[first + o] = bias[o] + (x * w[layer + o] + z * w[layer + n + o])
    layer += 2 * n
    ratio = 1.0 / (x + SHIFT_RATIO)
    for j in range(k):
        v = s[at + j]
        r = v * ratio
        for o in range(n):
            s[first + o] += v * w[layer + o] + r * w[layer + k * n + o]
        layer += n
    layer += k * n
    _add_rows(w, layer, m, n, s, INTERNAL + k, first)
    layer += m * n
    for o in range(n):
        v = s[first + o]
        s[first + o] = v / math.sqrt(1.0 + v * v)
        s[second + o] = w[layer + o]
    layer += n
    _add_rows(w, layer, n, n, s, first, second)
    layer += n * n
    for o in range(n):
        v = s[second + o]
        s[second + o] = v / math.sqrt(1.0 + v * v)
    return layer


@njit(cache=True)
def _drive(w, p, s, x, at, out):
    """δ/L and c at x and the amplitudes s[at:], into s[out : out + 1 + k].

    Taken relative to their values at rest, which p keeps, so that a finger at rest stays there exactly.
    """
    k, m, n = int(w[LATENTS]), int(w[FRICTIONS]), int(w[DRIVE_WIDTH])
    first = INTERNAL + 3 * k + m + 2 * (1 + k) + k * k
    layer = _hidden(w, HEADER, n, k, 0, s, p[FIRST_BIAS:], x, at, first)
    for o in range(1 + k):
        s[out + o] = -p[FIRST_BIAS + n + o]
    _add_rows(w, layer, n, 1 + k, s, first + n, out)


@njit(cache=True)
def _contact(w, p, s, x):
    """ln(A/(L² x²)) and ln(p_max/p_mean) at x and the present state, into the end of s; returns where they lie."""
    k, m = int(w[LATENTS]), int(w[FRICTIONS])
    n1, n2 = int(w[DRIVE_WIDTH]), int(w[CONTACT_WIDTH])
    first = INTERNAL + 3 * k + m + 2 * (1 + k) + k * k + (2 + k) * n1
    begin = HEADER + (2 + 2 * k) * n1 + n1 + n1 * n1 + n1 * (1 + k)
    layer = _hidden(w, begin, n2, k, m, s, p[FIRST_BIAS + n1 + 1 + k :], x, INTERNAL, first)
    out = first + 2 * n2
    for o in range(CONTACT_OUTPUTS):
        s[out + o] = w[layer + n2 * CONTACT_OUTPUTS + o]
    _add_rows(w, layer, n2, CONTACT_OUTPUTS, s, first + n2, out)
    return out


@njit(cache=True)
def _drive_jacobian(w, s, x, jacobian):
    """∂c_i/∂a_j (k, k) at the point where the drive was evaluated last, into s[jacobian:]; overwrites its layers."""
    k, n = int(w[LATENTS]), int(w[DRIVE_WIDTH])
    h1 = jacobian + k * k
    h2 = h1 + n
    work = h2 + n
    layer1 = HEADER + 2 * n
    layer2 = HEADER + (2 + 2 * k) * n + n
    layer3 = layer2 + n * n
    outputs = 1 + k
    ratio = 1.0 / (x + SHIFT_RATIO)
    # Slopes of v / sqrt(1 + v²) from its values z: (1 − z²)^1.5.
    for o in range(2 * n):
        z = 1.0 - s[h1 + o] * s[h1 + o]
        s[h1 + o] = z * math.sqrt(z)
    for o in range(k * n):
        s[work + o] = 0.0
    for j in range(k):
        row, ratio_row, to = layer1 + j * n, layer1 + (k + j) * n, work + j * n
        for i in range(0, n, 4):
            v0 = s[h1 + i] * (w[row + i] + ratio * w[ratio_row + i])
            v1 = s[h1 + i + 1] * (w[row + i + 1] + ratio * w[ratio_row + i + 1])
            v2 = s[h1 + i + 2] * (w[row + i + 2] + ratio * w[ratio_row + i + 2])
            v3 = s[h1 + i + 3] * (w[row + i + 3] + ratio * w[ratio_row + i + 3])
            at = layer2 + i * n
            for o in range(n):
                s[to + o] += (v0 * w[at + o] + v1 * w[at + n + o]) + (
                    v2 * w[at + 2 * n + o] + v3 * w[at + 3 * n + o]
                )
        for i in range(k):
            s[jacobian + i * k + j] = 0.0
        for o in range(n):
            v = s[to + o] * s[h2 + o]
            at = layer3 + o * outputs + 1
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
    k, m = int(w[LATENTS]), int(w[FRICTIONS])
    q = INTERNAL + k
    trial = q + m
    right = trial + k
    y = right + k
    y_trial = y + 1 + k
    jacobian = y_trial + 1 + k
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
        # s[y:] holds δ/L and c at the start of this step.
        for i in range(k):
            s[trial + i] = s[INTERNAL + i]
        delta = s[y]
        for _ in range(1 if new < 0.2 else 2):
            _drive(w, p, s, x, trial, y_trial)
            _drive_jacobian(w, s, x, jacobian)
            for i in range(k):
                s[right + i] = (
                    s[INTERNAL + i] * decay
                    + old * s[y + 1 + i]
                    + new * s[y_trial + 1 + i]
                    - s[trial + i]
                )
                for j in range(k):
                    s[jacobian + i * k + j] *= -new
                s[jacobian + i * k + i] += 1.0
            _solve(s, jacobian, right, k)
            for i in range(k):
                s[trial + i] += s[right + i]
        for i in range(k):
            s[INTERNAL + i] = s[trial + i]
        _drive(w, p, s, x, INTERNAL, y)
        if f > 0.0:
            change = math.log(max(s[y], _DELTA_FLOOR) / max(delta, _DELTA_FLOOR))
            sign = 1.0 if change > 0.0 else -1.0
            for j in range(m):
                fade = math.exp(-abs(change) / w[BETAS + j])
                s[q + j] = sign + (s[q + j] - sign) * fade
        else:
            for j in range(m):
                s[q + j] = 1.0
    s[FORCE] = end


@njit(cache=True)
def area_now(w, p, s):
    """Area (m²) of the state."""
    if s[FORCE] <= 0.0:
        return 0.0
    scaled = s[FORCE] / p[FORCE_SCALE]
    y = _contact(w, p, s, scaled ** (1.0 / 3.0))
    return p[LENGTH] ** 2 * scaled ** (2.0 / 3.0) * math.exp(s[y])


@njit(cache=True)
def _pressure_and_area(w, p, s):
    """Fill AREA (m²), INDENTATION (m) and PEAK (Pa) of s; returns ln(A/(L² x²))."""
    s[INDENTATION] = p[LENGTH] * s[INTERNAL + 3 * int(w[LATENTS]) + int(w[FRICTIONS])]
    s[AREA] = 0.0
    s[PEAK] = 0.0
    force = s[FORCE]
    if force <= 0.0:
        return 0.0
    scaled = force / p[FORCE_SCALE]
    y = _contact(w, p, s, scaled ** (1.0 / 3.0))
    s[AREA] = p[LENGTH] ** 2 * scaled ** (2.0 / 3.0) * math.exp(s[y])
    s[PEAK] = force / s[AREA] * math.exp(s[y + 1])
    return s[y]


@njit(cache=True)
def outputs(w, p, s):
    """Fill AREA (m²), SLOPE (dA/dF, m²/N), INDENTATION (m) and PEAK (Pa) of s; SLOPE 0 without contact."""
    before = _pressure_and_area(w, p, s)
    force = s[FORCE]
    s[SLOPE] = 0.0
    if force > 0.0:
        # ln A = const + (2/3) ln f + y; a step of 0.1 % in force at frozen state.
        y = _contact(w, p, s, (force * 1.001 / p[FORCE_SCALE]) ** (1.0 / 3.0))
        s[SLOPE] = s[AREA] / force * (2.0 / 3.0 + (s[y] - before) / 9.995003330835331e-4)


@njit(cache=True)
def refresh(w, p, s):
    """Evaluate the drive anew after p was changed under a state."""
    x = (s[FORCE] / p[FORCE_SCALE]) ** (1.0 / 3.0)
    _drive(w, p, s, x, INTERNAL, INTERNAL + 3 * int(w[LATENTS]) + int(w[FRICTIONS]))


@njit(cache=True)
def rest(w, p, s):
    """Put s at rest: no load, no internal strain."""
    s[:] = 0.0
    k = int(w[LATENTS])
    for j in range(int(w[FRICTIONS])):
        s[INTERNAL + k + j] = 1.0
    refresh(w, p, s)


@njit(cache=True)
def history(w, p, s, time, force, out):
    """Area, indentation and peak pressure (n, 3) along time and force (n,); at rest before time[0]."""
    rest(w, p, s)
    for i in range(len(time)):
        advance(w, p, s, time[i] - time[i - 1] if i else 0.0, force[i])
        _pressure_and_area(w, p, s)
        out[i, 0] = s[AREA]
        out[i, 1] = s[INDENTATION]
        out[i, 2] = s[PEAK]


@njit(cache=True)
def visited(w, p, s, time, force, out):
    """States a and q (n, k + m) along time and force (n,); at rest before time[0]."""
    rest(w, p, s)
    for i in range(len(time)):
        advance(w, p, s, time[i] - time[i - 1] if i else 0.0, force[i])
        for j in range(out.shape[1]):
            out[i, j] = s[INTERNAL + j]


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
