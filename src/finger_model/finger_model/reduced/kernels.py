# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compiled kernels of the reduced model: one time step, and many histories at once.

Everything is dimensionless inside: force f = F / (E0 L²) with the pad's radial semi-axis L, x =
f^(1/3), internal strain amplitudes a (k,), friction states q (m,). Strain grows over three decades
with the load; S = √(G(x)² + |a|²) measures it, G being what a sudden load brings to a finger at
rest. Two small networks of the same form,

    drive    (δ/(L S^(2/3)), c/S)                = N₁(x, S, a/S; finger)
    contact  (ln(A / (L² x²)), ln(p_max/p_mean)) = N₂(x, S, a/S, q; finger)

with y = W₃ᵀ s(g₂ ⊙ W₂ᵀ s(g₁ ⊙ W₁ᵀ u + b₁) + b₂) + b₃, s(v) = v/√(1 + v²), whose gains g and
biases b hold what the map needs to know of the finger (`maps`), give indentation δ and drive c = d
− a of the internal strain, area A and peak over mean pressure.

Where a finger has elastic curves (`elastic_contact`), the networks only add to what these say
(`_guess`). Sudden and slow loads give the strains d₀(x) and d∞(x); with ρ = a·d∞/((1 − E∞/E0)
|d∞|²), d is d₀ + ρ (d∞ − d₀) + Kᵀe, as in linear viscoelasticity: e = a − ρ (1 − E∞/E0) d∞ is what
is not in the pattern of a slow load, and K the response of the strain to it. The finger then looks
like an elastic one of modulus E0/(1 + ρ (E0/E∞ − 1)), and ln A, ln p_max/p_mean and ln δ are taken
between their curves by its logarithm: y₀ + w (y∞ − y₀), w = ln(1 + ρ (E0/E∞ − 1))/ln(E0/E∞). What
the drive network adds to the strain is in units of R, 1/R² = 1/S² + 1/(|d₀| + |e|)²: where E∞ is
small, only a force of the order of d₀ brings the strain back. The contact network also sees w, ρ
and e/S.

All Maxwell branches (g_b, τ_b) share the total strain d, and the state follows

    τ_b da_b/dt = g_b d − a_b,   a = Σ a_b                 (exact, see `training_runs`)
    dq_j = (sgn(dδ) − q_j) |d ln δ| / β_j,  q = 1 in the air   (stick after a reversal of the load)

with the exponential integrator for a drive that is linear within a step, implicit in a. A step of
the caller is divided where the drive is not (`creep_steps`) and where the force changes much, and
again where Newton's method fails. Under loads that the tissue hardly carries the learned drive may
have no solution, or one that takes back what the finger has given way (`_deepens`); the finger then
stays as it was, and its state says so (`failed`). No `fastmath`: the order of the additions is that
of the source, so that a value does not depend on whether it came from a stream or a batch.

The kernels work on four records, whose dtypes `record_types` gives for the sizes of a model: `net`
(both networks), `par` (one parameter set), `state` (one finger) and `work` (scratch;
holds nothing between calls). Functions without a leading underscore take each record as an array of
one element. Widths of layers are multiples of four: four rows of a layer are added at a time.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from ..compiled import njit, prange
from ..laws.creep_steps import allowed_step, creep
from ..laws.maxwell import step_weights

NODES = np.array([0.08, 0.14, 0.22, 0.32, 0.45, 0.60, 0.80, 1.05, 1.35, 1.70, 2.10, 2.60, 3.20])
"""Loads (F/(E L²))^(1/3) of elastic curves, E being E0 of a sudden and E∞ of a slow load."""
_LOG_NODES = np.log(NODES)
_LEAST_LOAD = 0.03
"""Below this load curves are taken there."""
MOST_SHARE = 1.0 - 1e-12
"""Of the long-term modulus: below 1, where nothing relaxes and sudden and slow load are one."""
_MOST_RELAXED = 10.0
"""Largest ρ that counts: after unloading it is above 1."""
_MOST_RELAXED_INPUT = 3.0
MIX_INPUTS = 2
"""Inputs of the contact network besides: w, ρ up to _MOST_RELAXED_INPUT, and for each amplitude how
far it is from the pattern of a slow load, over S."""

CONTACT_OUTPUTS = 2
"""Outputs of the contact network; the drive network has 1 + k."""

MOST_BRANCHES = 4

SHIFT_LOG, SHIFT_STRAIN = 0.03, 3e-4
"""The networks' inputs are x, ln(x + SHIFT_LOG), ln(S + SHIFT_STRAIN), a/S and, for contact, q."""
LOAD_INPUTS = 3

SUDDEN, SUDDEN_LIMIT = 0.9, 1.4
"""G(x) = SUDDEN x³/(1 + SUDDEN_LIMIT x): median of |c| at sudden loads on random fingers."""
_LEAST_STRAIN = 1e-6

_SUBSTEP = 0.15
_MOST_SUBSTEPS = 4
_MOST_GROWTH = 4.0
"""Largest growth of the strain by which Newton's method begins."""
_MOST_ITERATIONS = 12
_NEAR, _QUICK = 1e-2, 0.1
"""The Jacobian is kept after a change of less than _NEAR which is also less than _QUICK times the
one before."""
_CONVERGED = 1e-7
"""Of the amplitudes in Newton's method; they are of the order of 0.1."""
_ACCEPTED, _LEAST_SIZE = 1e-4, 0.1
"""Last change of the amplitudes over the strain S, or over the second where S is smaller, beyond
which a step has failed."""
_LIGHT = 0.1
"""x below which none fails: what little strain there is wrong is soon forgotten."""
_MOST_HALVINGS = 3
_RECOVERED = 0.005
"""Share of the internal strain that, when lost under a smaller force, has recovered."""
_TAKEN_BACK = 0.01
"""Share of indentation and internal strain that errors may take back under a new largest force."""
_HEAVY = 1.0
"""F/(E∞ L²) below which that is not looked at: where little carries, old strain is most of it."""
DELTA_FLOOR = 0.01
"""Smallest δ/L that counts for the friction state."""


class ModelRecords(NamedTuple):
    """Records of a model that runs, and of its perturbed copies.

    networks, work (1,); base (1,): constants of the parameters in use; constants, states (n,): of
    the finger itself and its copies, derived from `base`.
    """

    networks: np.ndarray
    base: np.ndarray
    constants: np.ndarray
    states: np.ndarray
    work: np.ndarray


class RecordTypes(NamedTuple):
    """Structured dtypes of the kernels' records."""

    networks: np.dtype
    parameters: np.dtype
    state: np.dtype
    work: np.dtype


@functools.cache
def record_types(latents: int, frictions: int, drive_width: int, contact_width: int) -> RecordTypes:
    """Records of a model with k latents, m friction states and hidden layers of these widths.

    Kept for ever: compiled code knows a record type by its address, and would take another one that
    came to lie there for it.
    """
    k, m = latents, frictions

    def layers(width: int, outputs: int) -> list[tuple]:
        return [
            ("load", "f8", (LOAD_INPUTS, width)),
            ("amplitude", "f8", (k, width)),  # rows of a/S
            ("weights_2", "f8", (width, width)),
            ("weights_3", "f8", (width, outputs)),
        ]

    def modulation(width: int, outputs: int) -> list[tuple]:
        vectors = [(name, "f8", (width,)) for name in ("gain_1", "bias_1", "gain_2", "bias_2")]
        return [*vectors, ("bias_3", "f8", (outputs,))]

    contact_only = [
        ("friction", "f8", (m, contact_width)),
        ("mix", "f8", (MIX_INPUTS + k, contact_width)),
    ]
    return RecordTypes(
        networks=np.dtype(
            [
                ("drive", layers(drive_width, 1 + k)),
                ("contact", [*layers(contact_width, CONTACT_OUTPUTS), *contact_only]),
                ("betas", "f8", (m,)),
                ("response", "f8", (k, k)),  # K
            ]
        ),
        parameters=np.dtype(
            [
                ("length", "f8"),  # L in m
                ("force_scale", "f8"),  # E0 L² in N
                ("branches", "i8"),  # how many
                ("fraction", "f8", (MOST_BRANCHES,)),  # g
                ("tau", "f8", (MOST_BRANCHES,)),  # in s
                ("force_limit", "f8"),  # N
                ("deepest", "f8"),  # δ/L at which the skin reaches the bone
                ("share", "f8"),  # E∞/E0
                ("curved", "i8"),  # whether `curves` count
                ("curves", "f8", (2, len(NODES), 2, 3 + k)),  # values, slopes over ln x
                ("drive", modulation(drive_width, 1 + k)),
                ("drive_at_rest", "f8", (1 + k,)),
                ("contact", modulation(contact_width, CONTACT_OUTPUTS)),
            ]
        ),
        state=np.dtype(
            [
                ("force", "f8"),  # N
                ("area", "f8"),  # m²
                ("area_force_slope", "f8"),  # dA/dF in m²/N
                ("indentation", "f8"),  # m
                ("peak_pressure", "f8"),  # Pa
                ("branches", "f8", (MOST_BRANCHES, k)),  # a_b
                ("amplitudes", "f8", (k,)),  # a, their sum
                ("friction", "f8", (m,)),  # q
                ("drive", "f8", (1 + k,)),  # δ/L and c at this state
                ("crept", "f8", (MOST_BRANCHES,)),  # by linear viscoelasticity, see `creep_steps`
                ("failed", "f8"),  # 1: the last step could not be followed to its end
                # The most so far, see `_deepens`.
                ("most_force", "f8"),  # N
                ("most_strain", "f8"),  # of |a|; 0 once some of it recovered
                ("most_depth", "f8"),  # of δ/L, the same
            ]
        ),
        work=np.dtype(
            [
                ("sudden", "f8", (3 + k,)),
                ("slow", "f8", (3 + k,)),
                ("guess", "f8", (3 + k,)),  # between the two
                ("mix", "f8", (MIX_INPUTS + k,)),
                ("branches", "f8", (MOST_BRANCHES, k)),  # of the state before a step, as the next
                ("friction", "f8", (m,)),
                ("start", "f8", (1 + k,)),  # its drive
                ("rest", "f8"),  # R
                ("rest_slope", "f8", (k,)),  # ∂R/∂a
                ("toward", "f8", (k,)),  # ∂ρ/∂a
                ("odd", "f8", (k,)),  # e
                ("pull", "f8", (k,)),  # ∂d/∂ρ at the same a
                ("trial", "f8", (k,)),
                ("base", "f8", (k,)),
                ("weights", "f8", (3, MOST_BRANCHES)),
                ("residual", "f8", (k,)),
                ("drive", "f8", (1 + k,)),
                ("jacobian", "f8", (k, k)),
                ("matrix", "f8", (k, k)),  # the same, overwritten by the solver
                ("sensitivity", "f8", (1 + k, drive_width)),  # to ln(S + …) and each a/S
                ("slope", "f8", (1 + k,)),
                ("drive_1", "f8", (drive_width,)),
                ("drive_2", "f8", (drive_width,)),
                ("contact_1", "f8", (contact_width,)),
                ("contact_2", "f8", (contact_width,)),
                ("contact", "f8", (CONTACT_OUTPUTS,)),
            ]
        ),
    )


@njit(cache=True)
def _add_rows(values, weights, out):
    """out (n,) += values (r,) @ weights (r, n), four rows at a time."""
    rows = len(values)
    j = 0
    while j + 4 <= rows:
        for o in range(len(out)):
            out[o] += (values[j] * weights[j, o] + values[j + 1] * weights[j + 1, o]) + (
                values[j + 2] * weights[j + 2, o] + values[j + 3] * weights[j + 3, o]
            )
        j += 4
    while j < rows:
        for o in range(len(out)):
            out[o] += values[j] * weights[j, o]
        j += 1


@njit(cache=True, error_model="numpy")
def _activate(gain, bias, layer):
    """v / sqrt(1 + v²) with v = gain · value + bias of each value, in place.

    No divisor can be 0: without looking at each, several values are computed at a time.
    """
    for o in range(len(layer)):
        v = gain[o] * layer[o] + bias[o]
        layer[o] = v / math.sqrt(1.0 + v * v)


@njit(cache=True)
def sudden_strain(x):
    """G of a load measure x."""
    return SUDDEN * x * x * x / (1.0 + SUDDEN_LIMIT * x)


@njit(cache=True)
def strain_scale(x, amplitudes):
    """S of a load measure x and amplitudes (k,)."""
    sudden = sudden_strain(x)
    square = sudden * sudden + _LEAST_STRAIN * _LEAST_STRAIN
    for j in range(len(amplitudes)):
        square += amplitudes[j] * amplitudes[j]
    return math.sqrt(square)


@njit(cache=True)
def _curve(curve, u, out):
    """Values (o,) at u = ln x of a curve (nodes, 2, o): cubic between nodes, straight beyond."""
    last = len(_LOG_NODES) - 1
    if u <= _LOG_NODES[0] or u >= _LOG_NODES[last]:
        node = 0 if u <= _LOG_NODES[0] else last
        for o in range(len(out)):
            out[o] = curve[node, 0, o] + (u - _LOG_NODES[node]) * curve[node, 1, o]
        return
    node = 0
    while u > _LOG_NODES[node + 1]:
        node += 1
    width = _LOG_NODES[node + 1] - _LOG_NODES[node]
    t = (u - _LOG_NODES[node]) / width
    r = 1.0 - t
    first, first_slope = (1.0 + 2.0 * t) * r * r, t * r * r * width
    second, second_slope = t * t * (3.0 - 2.0 * t), -t * t * r * width
    for o in range(len(out)):
        out[o] = (first * curve[node, 0, o] + first_slope * curve[node, 1, o]) + (
            second * curve[node + 1, 0, o] + second_slope * curve[node + 1, 1, o]
        )


@njit(cache=True)
def _guess(net, par, work, x, amplitudes):
    """What the elastic curves say of x and the amplitudes (k,), into work.guess, .mix and .toward.

    ln(A/(L² x²)), ln(p_max/p_mean), ln(δ/(L x²)) and the strain d (3 + k,).
    """
    sudden, slow, guess = work.sudden, work.slow, work.guess
    load = max(x, _LEAST_LOAD)
    log_share = math.log(par.share)
    own = load * par.share ** (-1.0 / 3.0)
    _curve(par.curves[0], math.log(load), sudden)
    _curve(par.curves[1], math.log(own), slow)
    # x of the slow curve is over E∞.
    slow[0] -= 2.0 / 3.0 * log_share
    slow[2] -= 2.0 / 3.0 * log_share
    small, large = sudden_strain(load), sudden_strain(own)
    product = 0.0
    square = 1e-30
    for j in range(len(amplitudes)):
        sudden[3 + j] *= small
        slow[3 + j] *= large
        product += amplitudes[j] * slow[3 + j]
        square += slow[3 + j] * slow[3 + j]
    square *= 1.0 - par.share
    relaxed = min(max(product / square, 0.0), _MOST_RELAXED)
    free = 0.0 < relaxed < _MOST_RELAXED
    mixed = math.log1p(relaxed * (1.0 - par.share) / par.share) / -log_share
    for o in range(3):
        guess[o] = sudden[o] + mixed * (slow[o] - sudden[o])
    own_size = 0.0
    odd = _LEAST_STRAIN * _LEAST_STRAIN
    for j in range(len(amplitudes)):
        work.toward[j] = slow[3 + j] / square if free else 0.0
        work.odd[j] = amplitudes[j] - relaxed * (1.0 - par.share) * slow[3 + j]
        odd += work.odd[j] * work.odd[j]
        own_size += sudden[3 + j] * sudden[3 + j]
    odd = math.sqrt(odd)
    for i in range(len(amplitudes)):
        apart = slow[3 + i] - sudden[3 + i]
        guess[3 + i] = sudden[3 + i] + relaxed * apart
        work.pull[i] = apart
        for j in range(len(amplitudes)):
            guess[3 + i] += net.response[j, i] * work.odd[j]
            work.pull[i] -= net.response[j, i] * (1.0 - par.share) * slow[3 + j]
    near = math.sqrt(own_size) + odd
    scale = strain_scale(x, amplitudes)
    work.rest = near * scale / math.hypot(near, scale)
    work.mix[0] = mixed
    work.mix[1] = min(relaxed, _MOST_RELAXED_INPUT)
    for j in range(len(amplitudes)):
        work.rest_slope[j] = work.odd[j] / odd * (work.rest / near) ** 3
        work.rest_slope[j] += amplitudes[j] / scale * (work.rest / scale) ** 3
        work.mix[MIX_INPUTS + j] = work.odd[j] / scale


@njit(cache=True)
def guesses(net, par, work, x, amplitudes, out):
    """Rows (n, 1 + 3 + k + 2 + k) of `_guess` at x (n,) and amplitudes (n, k): R, guess, mix."""
    for row in range(len(x)):
        _guess(net[0], par[0], work[0], x[row], amplitudes[row])
        end = 1 + len(work[0].guess)
        out[row, 0] = work[0].rest
        out[row, 1:end] = work[0].guess
        out[row, end:] = work[0].mix


@njit(cache=True)
def _first_layer(layers, x, scale, amplitudes, out):
    """First hidden layer of a network before gain, bias and activation, without friction states."""
    z = math.log(x + SHIFT_LOG)
    s = math.log(scale + SHIFT_STRAIN)
    for o in range(len(out)):
        out[o] = x * layers.load[0, o] + z * layers.load[1, o] + s * layers.load[2, o]
    for j in range(len(amplitudes)):
        v = amplitudes[j] / scale
        for o in range(len(out)):
            out[o] += v * layers.amplitude[j, o]


@njit(cache=True)
def _second_layer(layers, modulation, first, second):
    """Activate the first hidden layer in place and evaluate the second one."""
    _activate(modulation.gain_1, modulation.bias_1, first)
    for o in range(len(second)):
        second[o] = 0.0
    _add_rows(first, layers.weights_2, second)
    _activate(modulation.gain_2, modulation.bias_2, second)


@njit(cache=True)
def _drive(net, par, work, x, amplitudes, out):
    """δ/L and c (1 + k,) at x and the amplitudes (k,) into `out`.

    Relative to the values at rest, so that a finger at rest stays there exactly.
    """
    scale = strain_scale(x, amplitudes)
    _first_layer(net.drive, x, scale, amplitudes, work.drive_1)
    _second_layer(net.drive, par.drive, work.drive_1, work.drive_2)
    for o in range(len(out)):
        out[o] = par.drive.bias_3[o]
    _add_rows(work.drive_2, net.drive.weights_3, out)
    out[0] = scale ** (2.0 / 3.0) * out[0] - par.drive_at_rest[0]
    if par.curved:
        _guess(net, par, work, x, amplitudes)
        scale = work.rest
    for o in range(1, len(out)):
        out[o] = scale * out[o] - par.drive_at_rest[o]
    if par.curved:
        out[0] += x * x * math.exp(work.guess[2])
        for j in range(len(amplitudes)):
            out[1 + j] += work.guess[3 + j] - amplitudes[j]


@njit(cache=True)
def _contact(net, par, state, work, x):
    """ln(A/(L² x²)) and ln(p_max/p_mean) at x and the present state, into work.contact."""
    scale = strain_scale(x, state.amplitudes)
    _first_layer(net.contact, x, scale, state.amplitudes, work.contact_1)
    _add_rows(state.friction, net.contact.friction, work.contact_1)
    if par.curved:
        _guess(net, par, work, x, state.amplitudes)
        _add_rows(work.mix, net.contact.mix, work.contact_1)
    _second_layer(net.contact, par.contact, work.contact_1, work.contact_2)
    for o in range(CONTACT_OUTPUTS):
        work.contact[o] = par.contact.bias_3[o]
    _add_rows(work.contact_2, net.contact.weights_3, work.contact)
    if par.curved:
        for o in range(CONTACT_OUTPUTS):
            work.contact[o] += work.guess[o]


@njit(cache=True)
def _drive_jacobian(net, par, work, x, amplitudes):
    """∂c_i/∂a_j (k, k) where the drive was evaluated last, into work.jacobian.

    With c = S y(ln S, a/S), ∂S/∂a_j = a_j/S. Overwrites the layers of that evaluation.
    """
    layers, h1, h2 = net.drive, work.drive_1, work.drive_2
    sensitivity, jacobian, slope = work.sensitivity, work.jacobian, work.slope
    n = len(h1)
    k = len(amplitudes)
    scale = strain_scale(x, amplitudes)
    # Slopes of v / sqrt(1 + v²) from its values z: (1 − z²)^1.5.
    for o in range(n):
        z = 1.0 - h1[o] * h1[o]
        h1[o] = par.drive.gain_1[o] * z * math.sqrt(z)
        z = 1.0 - h2[o] * h2[o]
        h2[o] = par.drive.gain_2[o] * z * math.sqrt(z)
    for j in range(1 + k):
        row = layers.load[2] if j == 0 else layers.amplitude[j - 1]
        for o in range(n):
            sensitivity[j, o] = 0.0
        for i in range(0, n, 4):
            v0, v1 = h1[i] * row[i], h1[i + 1] * row[i + 1]
            v2, v3 = h1[i + 2] * row[i + 2], h1[i + 3] * row[i + 3]
            for o in range(n):
                sensitivity[j, o] += (
                    v0 * layers.weights_2[i, o] + v1 * layers.weights_2[i + 1, o]
                ) + (v2 * layers.weights_2[i + 2, o] + v3 * layers.weights_2[i + 3, o])
        for o in range(n):
            sensitivity[j, o] *= h2[o]
    share = work.rest / scale if par.curved else 1.0
    for i in range(k):
        # ∂y_i/∂ln S − Σ_m (a_m/S) ∂y_i/∂(a_m/S) is the factor of a_j/S², and y_i that of ∂S/∂a_j.
        output = work.drive[1 + i] + par.drive_at_rest[1 + i]
        for j in range(1 + k):
            slope[j] = 0.0
            for o in range(n):
                slope[j] += sensitivity[j, o] * layers.weights_3[o, 1 + i]
        radial = slope[0] * scale / (scale + SHIFT_STRAIN)
        for j in range(k):
            radial -= amplitudes[j] / scale * slope[1 + j]
        if not par.curved:
            radial += output / scale
        for j in range(k):
            jacobian[i, j] = share * (slope[1 + j] + radial * amplitudes[j] / scale)
        if par.curved:
            # c = R y + guess − a, where R and guess depend on ρ.
            output -= work.guess[3 + i] - amplitudes[i]
            output /= work.rest
            for j in range(k):
                rise = work.pull[i] * work.toward[j] + net.response[j, i]
                jacobian[i, j] += rise + output * work.rest_slope[j]
            jacobian[i, i] -= 1.0


@njit(cache=True)
def _solve(matrix, right):
    """Solve matrix (k, k) · y = right (k,) in place, with row pivots."""
    k = len(right)
    for c in range(k):
        best = c
        for r in range(c + 1, k):
            if abs(matrix[r, c]) > abs(matrix[best, c]):
                best = r
        if best != c:
            for j in range(k):
                matrix[c, j], matrix[best, j] = matrix[best, j], matrix[c, j]
            right[c], right[best] = right[best], right[c]
        for r in range(c + 1, k):
            factor = matrix[r, c] / matrix[c, c]
            for j in range(c, k):
                matrix[r, j] -= factor * matrix[c, j]
            right[r] -= factor * right[c]
    for c in range(k - 1, -1, -1):
        for j in range(c + 1, k):
            right[c] -= matrix[c, j] * right[j]
        right[c] /= matrix[c, c]


@njit(cache=True)
def _branch_weights(par, work, dt):
    """Weights e, g α and g β of each branch for a step of dt (s), into work.weights.

    a_b after the step is e a_b + g α d before + g β d after.
    """
    for b in range(par.branches):
        weights = step_weights(dt, par.tau[b])
        work.weights[0, b] = weights.decay
        work.weights[1, b] = par.fraction[b] * weights.old
        work.weights[2, b] = par.fraction[b] * weights.new


@njit(cache=True)
def _strain(net, par, state, work, x):
    """Internal strain at the end of a step to x, by Newton's method from the weights in `work`.

    Solves a = Σ e_b a_b + Σ g α d + Σ g β (c(a) + a); stable for any ratio of step and τ. It begins
    with a strain d that has grown as that of a sudden load does. False where it finds no solution;
    the state is then as before.
    """
    a, trial, residual, base = state.amplitudes, work.trial, work.residual, work.base
    k = len(a)
    weights = work.weights
    old = 0.0
    new = 0.0
    for b in range(par.branches):
        old += weights[1, b]
        new += weights[2, b]
    sudden = sudden_strain((state.force / par.force_scale) ** (1.0 / 3.0))
    growth = min(sudden_strain(x) / sudden, _MOST_GROWTH) if sudden > 0.0 else 1.0
    # state.drive is still that of the start of the step.
    for i in range(k):
        before = state.drive[1 + i] + a[i]
        base[i] = old * before
        for b in range(par.branches):
            base[i] += weights[0, b] * state.branches[b, i]
        trial[i] = base[i] + new * growth * before
    largest, kept = math.inf, False
    for _ in range(_MOST_ITERATIONS):
        _drive(net, par, work, x, trial, work.drive)
        for i in range(k):
            residual[i] = base[i] + new * (work.drive[1 + i] + trial[i]) - trial[i]
        if not kept:
            _drive_jacobian(net, par, work, x, trial)
            for i in range(k):
                for j in range(k):
                    work.jacobian[i, j] *= -new
                work.jacobian[i, i] += 1.0 - new
        work.matrix[:, :] = work.jacobian
        _solve(work.matrix, residual)
        before, largest = largest, 0.0
        for i in range(k):
            trial[i] += residual[i]
            largest = max(largest, abs(residual[i]))
        if largest < _CONVERGED:
            break
        kept = largest < _NEAR and largest < _QUICK * before
    accepted = _ACCEPTED * max(strain_scale(x, trial), _LEAST_SIZE)
    if not ((largest <= accepted or x < _LIGHT) and work.drive[0] <= par.deepest):
        return False
    for i in range(k):
        before = state.drive[1 + i] + a[i]
        after = (trial[i] - base[i]) / new if new > 0.0 else 0.0
        a[i] = 0.0
        for b in range(par.branches):
            state.branches[b, i] = (
                weights[0, b] * state.branches[b, i]
                + weights[1, b] * before
                + weights[2, b] * after
            )
            a[i] += state.branches[b, i]
    # At the very amplitudes of the state, so that `_refresh` finds the same bits.
    _drive(net, par, work, x, a, state.drive)
    return True


@njit(cache=True)
def _keep(state, work):
    """Keep what a step changes of a state, but for the force."""
    work.branches[:, :] = state.branches
    work.friction[:] = state.friction
    work.start[:] = state.drive


@njit(cache=True)
def _take_back(state, work):
    """The state as it was kept."""
    state.branches[:, :] = work.branches
    state.friction[:] = work.friction
    state.drive[:] = work.start
    for i in range(len(state.amplitudes)):
        state.amplitudes[i] = 0.0
        for b in range(MOST_BRANCHES):
            state.amplitudes[i] += state.branches[b, i]


@njit(cache=True)
def _deepens(par, state):
    """Whether a finger is as deep and as strained as it must be: the largest force so far takes
    back neither, unless strain recovered under a smaller force since the largest before."""
    square = 0.0
    for a in state.amplitudes:
        square += a * a
    strain = math.sqrt(square)
    if state.force < state.most_force:
        if strain < (1.0 - _RECOVERED) * state.most_strain:
            state.most_strain = 0.0
            state.most_depth = 0.0
        return True
    least = 1.0 - _TAKEN_BACK
    falls = state.drive[0] < least * state.most_depth or strain < least * state.most_strain
    if falls and state.force >= _HEAVY * par.share * par.force_scale:
        return False
    state.most_force = state.force
    state.most_strain = max(state.most_strain, strain)
    state.most_depth = max(state.most_depth, state.drive[0])
    return True


@njit(cache=True)
def _advance(net, par, state, work, dt, force):
    """Advance by dt (s) to `force` (N), reached linearly from the force before.

    The force is clipped to 0 … force_limit. A step that fails leaves the finger as it was, until
    the force is no larger than the one of that state.
    """
    goal = min(max(force, 0.0), par.force_limit)
    if state.failed and goal > state.force:
        return
    state.failed = 0
    before = state.force
    _keep(state, work)
    n = par.branches
    crept, fraction, tau = state.crept[:n], par.fraction[:n], par.tau[:n]
    while True:
        start = state.force
        h = allowed_step(crept, fraction, tau, par.force_scale, dt, start, goal)
        end = goal if h >= dt else start + (goal - start) * h / dt
        if not (_move(net, par, state, work, h, end) and _deepens(par, state)):
            _take_back(state, work)
            state.force = before
            state.failed = 1
            break
        creep(crept, fraction, tau, h, start, end)
        if h >= dt:
            break
        dt -= h


@njit(cache=True)
def _move(net, par, state, work, dt, end):
    """As `_advance`, in steps of equal length, which are halved where one fails; false where that
    does not help."""
    q = state.friction
    start = state.force
    jump = abs((end / par.force_scale) ** (1.0 / 3.0) - (start / par.force_scale) ** (1.0 / 3.0))
    steps = min(1 + int(jump / _SUBSTEP), _MOST_SUBSTEPS)
    _branch_weights(par, work, dt / steps)
    finest = steps << _MOST_HALVINGS
    step = 0
    while step < steps:
        step += 1
        f = start + (end - start) * step / steps if step < steps else end
        delta = state.drive[0]
        if not _strain(net, par, state, work, (f / par.force_scale) ** (1.0 / 3.0)):
            if steps == finest:
                return False
            step = 2 * (step - 1)
            steps *= 2
            _branch_weights(par, work, dt / steps)
            continue
        state.force = f
        if f > 0.0:
            change = math.log(max(state.drive[0], DELTA_FLOOR) / max(delta, DELTA_FLOOR))
            sign = 1.0 if change > 0.0 else -1.0
            for j in range(len(q)):
                fade = math.exp(-abs(change) / net.betas[j])
                q[j] = sign + (q[j] - sign) * fade
        else:
            for j in range(len(q)):
                q[j] = 1.0
    return True


@njit(cache=True)
def _area(net, par, state, work):
    """Area (m²) of the state; leaves the outputs of the contact network in `work`."""
    if state.force <= 0.0:
        return 0.0
    scaled = state.force / par.force_scale
    _contact(net, par, state, work, scaled ** (1.0 / 3.0))
    return par.length**2 * scaled ** (2.0 / 3.0) * math.exp(work.contact[0])


@njit(cache=True)
def _pressure_and_area(net, par, state, work):
    """Fill area (m²), indentation (m) and peak_pressure (Pa) of the state."""
    state.indentation = par.length * state.drive[0]
    state.area = _area(net, par, state, work)
    state.peak_pressure = 0.0
    if state.force > 0.0:
        state.peak_pressure = state.force / state.area * math.exp(work.contact[1])


@njit(cache=True)
def _outputs(net, par, state, work):
    """As `_pressure_and_area`, and area_force_slope (dA/dF, m²/N), which is 0 without contact."""
    _pressure_and_area(net, par, state, work)
    state.area_force_slope = 0.0
    force = state.force
    if force > 0.0:
        # ln A = const + (2/3) ln f + y; a step of 0.1 % in force at frozen state.
        before = work.contact[0]
        _contact(net, par, state, work, (force * 1.001 / par.force_scale) ** (1.0 / 3.0))
        state.area_force_slope = (
            state.area / force * (2.0 / 3.0 + (work.contact[0] - before) / 9.995003330835331e-4)
        )


@njit(cache=True)
def _refresh(net, par, state, work):
    """Evaluate the drive again after the parameters were changed under a state."""
    x = (state.force / par.force_scale) ** (1.0 / 3.0)
    _drive(net, par, work, x, state.amplitudes, state.drive)
    state.most_force = 0.0
    state.most_strain = 0.0
    state.most_depth = 0.0


@njit(cache=True)
def _rest(net, par, state, work):
    """Put the state at rest: no load, no internal strain."""
    state.failed = 0
    state.force = 0.0
    state.amplitudes[:] = 0.0
    state.branches[:, :] = 0.0
    state.crept[:] = 0.0
    for j in range(len(state.friction)):
        state.friction[j] = 1.0
    _refresh(net, par, state, work)
    _outputs(net, par, state, work)


@njit(cache=True)
def rest(net, par, state, work):
    """Put a finger at rest: no load, no internal strain."""
    _rest(net[0], par[0], state[0], work[0])


@njit(cache=True)
def refresh(net, par, state, work):
    """Adapt a state to changed parameters; the internal strain stays."""
    _refresh(net[0], par[0], state[0], work[0])


@njit(cache=True)
def scale_branches(par, state, before):
    """Keep the strain A_b of each branch, a_b = g_b ⟨φ, A_b − 1⟩, where its fraction g_b was
    `before` (branches,)."""
    own = state[0]
    own.amplitudes[:] = 0.0
    for b in range(par[0].branches):
        if before[b] > 0.0:
            own.branches[b, :] *= par[0].fraction[b] / before[b]
        own.amplitudes[:] += own.branches[b, :]


@njit(cache=True)
def step(net, par, state, work, dt, force):
    """Advance by dt (s) to `force` (N) and fill area, slope, indentation and peak pressure."""
    _advance(net[0], par[0], state[0], work[0], dt, force)
    _outputs(net[0], par[0], state[0], work[0])


@njit(cache=True)
def step_without_slope(net, par, state, work, dt, force):
    """As `step`, but the slope stays what it was."""
    _advance(net[0], par[0], state[0], work[0], dt, force)
    _pressure_and_area(net[0], par[0], state[0], work[0])


@njit(cache=True, nogil=True)
def run(net, par, state, work, before, time, force, table):
    """Area, indentation and peak pressure (n, 3) along time and force (n,).

    The state that they begin with is that of time `before`. Returns the first row that could not be
    followed, n without one.
    """
    first = len(time)
    for i in range(len(time)):
        _advance(net[0], par[0], state[0], work[0], time[i] - before, force[i])
        _pressure_and_area(net[0], par[0], state[0], work[0])
        if state[0].failed:
            first = min(first, i)
        before = time[i]
        table[i, 0] = state[0].area
        table[i, 1] = state[0].indentation
        table[i, 2] = state[0].peak_pressure
    return first


@njit(cache=True)
def _contacts(net, par, state, work, time, force, wanted, out):
    """Areas and indentations out (2, frames) of one trial, each at its index in `wanted` (−1: left
    out), NaN from the first sample on that could not be followed; records: arrays of one."""
    _rest(net[0], par[0], state[0], work[0])
    for i in range(len(time)):
        dt = time[i] - time[i - 1] if i else 0.0
        if not state[0].failed:
            _advance(net[0], par[0], state[0], work[0], dt, force[i])
        if wanted[i] >= 0 and state[0].failed:
            out[:, wanted[i]] = math.nan
        elif wanted[i] >= 0:
            out[0, wanted[i]] = _area(net[0], par[0], state[0], work[0])
            out[1, wanted[i]] = par[0].length * state[0].drive[0]


@njit(cache=True, parallel=True)
def batch(net, par, state, work, time, force, start, wanted, out):
    """Areas (m²) and indentations (m) out (P, 2, frames) of P parameter sets par (P,) over all
    trials.

    `state` and `work` are templates. The trials lie end to end in time and force (n,), trial t in
    start[t] … start[t + 1] − 1; wanted (n,): the frame of `out` that a sample gives, −1 for none.
    """
    trials = len(start) - 1
    for job in prange(len(par) * trials):
        which = job // trials
        trial = job - which * trials
        # Passed as arrays: a record alone does not keep its memory.
        own_state, own_work = np.empty_like(state), np.empty_like(work)
        rows = slice(start[trial], start[trial + 1])
        _contacts(
            net,
            par[which : which + 1],
            own_state,
            own_work,
            time[rows],
            force[rows],
            wanted[rows],
            out[which],
        )
