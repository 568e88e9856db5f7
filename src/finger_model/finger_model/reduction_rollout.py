"""Training of the reduced model along whole histories, with the gradient by the adjoint of its time stepping.

A step solves G = a₁ − e a₀ − w₀ c₀ − w₁ c(u₁) = 0 (see reduced_kernels). With the loss's derivative λ with respect
to the outputs y₁, and μ₊ the multiplier of the next step,

    λ ← λ + [0, w₀₊ μ₊],   (1 − w₁ ∂c/∂a)ᵀ μ = e₊ μ₊ + (∂y/∂a)ᵀ λ,

and the gradient with respect to the weights is that of Σ (λ + [0, w₁ μ]) · y at all visited inputs. The friction
states are taken from the full-order indentation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from . import reduced_kernels as rk
from .reduction_runs import Run
from .reduction_training import Network, features, friction_states, sigmoid

FIRST_FORCE = 0.04
"""N; below it the area does not enter the loss."""


@dataclass
class Histories:
    """Histories padded to one length: time along the first axis, (T, N, …).

    x, stiffness (T, N); friction (T, N, m); decay, old, new (T, N); targets (T, N, 3 + k);
    weights (T, N, 3 + k) of residuals of area, indentation, pressure and a.
    """

    x: np.ndarray
    stiffness: np.ndarray
    friction: np.ndarray
    decay: np.ndarray
    old: np.ndarray
    new: np.ndarray
    targets: np.ndarray
    weights: np.ndarray
    scale: np.ndarray
    """(T, N): (L x)² over the history's largest area; the relative area is scale · exp(y[0])."""


def _grid(run: Run, length: float) -> list[tuple[int, float]]:
    """Steps as the kernel takes them: (row at or after it, share of the way from the row before)."""
    force = np.maximum(run.force, 0.0)
    x = np.cbrt(force / (run.parameters[0] * length**2))
    steps = []
    for i in range(len(x)):
        before = x[i - 1] if i else 0.0
        number = min(1 + int(abs(x[i] - before) / 0.15), 4)
        steps += [(i, j / number) for j in range(1, number + 1)]
    return steps


def prepare(runs: list[Run], length: float, latents: int, betas: np.ndarray) -> Histories:
    """Padded arrays of runs."""
    grids = [_grid(run, length) for run in runs]
    T, N = max(map(len, grids)), len(runs)
    k, m = latents, len(betas)
    xs, stiffness, friction = np.zeros((T, N)), np.zeros((T, N)), np.ones((T, N, m))
    decay, old, new = np.ones((T, N)), np.zeros((T, N)), np.zeros((T, N))
    targets, weights = np.zeros((T, N, rk.OUTPUTS + k)), np.zeros((T, N, rk.OUTPUTS + k))
    scale = np.zeros((T, N))
    for n, (run, grid) in enumerate(zip(runs, grids)):
        E0, E1, tau1, E2 = run.parameters
        stiffness[:, n] = math.log(E2 / E0)
        force = np.maximum(run.force, 0.0)
        delta = run.indentation / length
        q = friction_states(delta, force, betas)
        largest = run.area.max()
        deepest = max(delta.max(), 0.02)
        count = max(int(np.sum(force >= FIRST_FORCE)), 5)
        before_time = run.time[0]
        for t, (i, share) in enumerate(grid):
            j = max(i - 1, 0)
            start_force = force[j] if i else 0.0
            f = start_force + share * (force[i] - start_force)
            start_time = run.time[j]
            now = start_time + share * (run.time[i] - start_time)
            h = (now - before_time) / tau1
            before_time = now
            rise = 1.0 + math.expm1(-h) / h if h > 1e-4 else h / 2 - h * h / 6
            decay[t, n] = math.exp(-h)
            new[t, n] = E0 / E1 * rise
            old[t, n] = E0 / E1 * (-math.expm1(-h) - rise)
            x = (f / (E0 * length**2)) ** (1.0 / 3.0)
            xs[t, n] = x
            friction[t, n] = q[i]
            scale[t, n] = (length * x) ** 2 / largest
            if share < 1.0:
                continue
            targets[t, n, 1] = delta[i]
            targets[t, n, 3:] = run.internal[i, :k]
            weights[t, n, 1] = 0.5 / (0.01 * deepest) / math.sqrt(len(run.time))
            weights[t, n, 3:] = 1.0 / math.sqrt(len(run.time))
            if f >= FIRST_FORCE and run.area[i] > 0:
                targets[t, n, 0] = run.area[i] / largest
                weights[t, n, 0] = 1.0 / 0.01 / math.sqrt(count)
                if run.peak[i] > 0:
                    targets[t, n, 2] = math.log(run.peak[i] * run.area[i] / f)
                    weights[t, n, 2] = 0.1 / 0.01 * run.area[i] / largest / math.sqrt(count)
    return Histories(xs, stiffness, friction, decay, old, new, targets, weights, scale)


class Rollout:
    """Loss and gradient of a network along histories.

    robust: loss of a history from which it counts less than in full; anchor weighs the error of a, in shares of its
    spread.
    """

    def __init__(
        self, network: Network, histories: Histories, robust: float, anchor: float = 2.0
    ) -> None:
        self.network = network
        self.h = histories
        k = histories.targets.shape[-1] - rk.OUTPUTS
        self.latents = k
        self.weights = histories.weights.copy()
        spread = network.input_scale[2 : 2 + k]
        self.weights[:, :, rk.OUTPUTS :] *= anchor / (0.02 * spread) * 0.1
        self.robust = robust

    def _evaluate(self, layers, u):
        w1, b1, w2, b2, w3, b3 = layers
        z1, s1 = sigmoid(u @ w1 + b1)
        z2, s2 = sigmoid(z1 @ w2 + b2)
        y = (z2 @ w3 + b3) * self.network.output_scale + self.network.output_mean
        return y, z1, s1, z2, s2

    def forward(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """States and outputs along all histories."""
        net, h, k = self.network, self.h, self.latents
        layers = net.split(values)
        w1, _, w2, _, w3, _ = layers
        T, N = h.decay.shape
        out = h.targets.shape[-1]
        m = h.friction.shape[-1]
        offset_inputs = features(np.zeros(N), np.zeros((N, k)), np.ones((N, m)), h.stiffness[0])
        rest = self._evaluate(layers, (offset_inputs - net.input_mean) / net.input_scale)
        offset = rest[0].copy()
        offset[:, 0] = 0.0
        offset[:, 2] = 0.0
        a = np.zeros((N, k))
        c = np.zeros((N, k))
        hidden = w1.shape[1]
        keep = {
            "y": np.empty((T, N, out)),
            "u": np.empty((T, N, offset_inputs.shape[-1])),
            "z1": np.empty((T, N, hidden)),
            "s1": np.empty((T, N, hidden)),
            "z2": np.empty((T, N, hidden)),
            "s2": np.empty((T, N, hidden)),
            "jacobian": np.empty((T, N, k, k)),
            "a": np.empty((T, N, k)),
        }
        a_rows = w1[2 : 2 + k] / net.input_scale[2 : 2 + k, None]
        r_rows = w1[2 + k : 2 + 2 * k] / net.input_scale[2 + k : 2 + 2 * k, None]
        c_columns = w3[:, rk.OUTPUTS :] * net.output_scale[rk.OUTPUTS :]
        identity = np.eye(k)
        for t in range(T):
            trial = a
            known = h.decay[t][:, None] * a + h.old[t][:, None] * c
            ratio = 1.0 / (h.x[t] + rk.SHIFT_RATIO)[:, None]
            jacobian = np.empty((N, k, k))
            for iteration in range(13):
                u = features(h.x[t], trial, h.friction[t], h.stiffness[t])
                u = (u - net.input_mean) / net.input_scale
                y, z1, s1, z2, s2 = self._evaluate(layers, u)
                y -= offset
                for j in range(k):
                    row = a_rows[j] + ratio * r_rows[j]
                    jacobian[:, :, j] = (((s1 * row) @ w2) * s2) @ c_columns
                residual = known + h.new[t][:, None] * y[:, rk.OUTPUTS :] - trial
                if np.abs(residual).max() < 1e-8 or iteration == 12:
                    break
                matrix = identity - h.new[t][:, None, None] * jacobian
                trial = trial + np.linalg.solve(matrix, residual[:, :, None])[:, :, 0]
            a = trial
            c = y[:, rk.OUTPUTS :]
            for name, value in (
                ("y", y),
                ("u", u),
                ("z1", z1),
                ("s1", s1),
                ("z2", z2),
                ("s2", s2),
                ("jacobian", jacobian),
                ("a", a),
            ):
                keep[name][t] = value
        keep["rest_u"] = (offset_inputs - net.input_mean) / net.input_scale
        for name, value in zip(("rest_z1", "rest_s1", "rest_z2", "rest_s2"), rest[1:]):
            keep[name] = value
        return keep

    def __call__(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Loss and gradient."""
        net, h, k = self.network, self.h, self.latents
        N = h.decay.shape[1]
        with np.errstate(all="ignore"):
            keep = self.forward(values)
        y = keep["y"]
        if not np.all(np.isfinite(y)) or np.abs(y).max() > 50:
            return 1e12, np.zeros_like(values)
        w1, _, w2, _, w3, _ = net.split(values)
        area = h.scale * np.exp(y[:, :, 0])
        w = self.weights
        residual = np.empty_like(y)
        residual[:, :, 0] = area - h.targets[:, :, 0]
        residual[:, :, 1:3] = y[:, :, 1:3] - h.targets[:, :, 1:3]
        residual[:, :, 3:] = keep["a"] - h.targets[:, :, 3:]
        weighted = residual * w
        each = 0.5 * np.sum(weighted**2, axis=(0, 2))
        # κ log(1 + loss/κ): one history that runs away does not rule the others.
        loss = self.robust * float(np.sum(np.log1p(each / self.robust))) / N
        direct = weighted * w / N / (1.0 + each / self.robust)[:, None]
        outer = np.zeros_like(y)
        outer[:, :, 0] = direct[:, :, 0] * area
        outer[:, :, 1:3] = direct[:, :, 1:3]
        T = len(y)
        multiplier = np.zeros((N, k))
        a_rows = w1[2 : 2 + k] / net.input_scale[2 : 2 + k, None]
        r_rows = w1[2 + k : 2 + 2 * k] / net.input_scale[2 + k : 2 + 2 * k, None]
        identity = np.eye(k)
        for t in range(T - 1, -1, -1):
            g = direct[t, :, 3:].copy()
            if t + 1 < T:
                outer[t, :, 3:] += h.old[t + 1][:, None] * multiplier
                g += h.decay[t + 1][:, None] * multiplier
            back = ((outer[t] * net.output_scale) @ w3.T) * keep["s2"][t]
            back = (back @ w2.T) * keep["s1"][t]
            g += back @ a_rows.T + back @ r_rows.T / (h.x[t] + rk.SHIFT_RATIO)[:, None]
            matrix = identity - h.new[t][:, None, None] * keep["jacobian"][t]
            multiplier = np.linalg.solve(matrix.transpose(0, 2, 1), g[:, :, None])[:, :, 0]
            outer[t, :, 3:] += h.new[t][:, None] * multiplier
        rest = -outer.sum(0)
        rest[:, 0] = 0.0
        rest[:, 2] = 0.0
        gradient = np.zeros_like(values)
        parts = net.split(gradient)
        for o, u, z1, s1, z2, s2 in (
            (outer, keep["u"], keep["z1"], keep["s1"], keep["z2"], keep["s2"]),
            (
                rest,
                keep["rest_u"],
                keep["rest_z1"],
                keep["rest_s1"],
                keep["rest_z2"],
                keep["rest_s2"],
            ),
        ):
            flat = [v.reshape(-1, v.shape[-1]) for v in (o, u, z1, s1, z2, s2)]
            o, u, z1, s1, z2, s2 = flat
            o = o * net.output_scale
            g2 = (o @ w3.T) * s2
            g1 = (g2 @ w2.T) * s1
            for part, value in zip(
                parts, (u.T @ g1, g1.sum(0), z1.T @ g2, g2.sum(0), z2.T @ o, o.sum(0))
            ):
                part += value
        return loss, gradient


def fit_histories(
    network: Network, histories: Histories, iterations: int, report=None, robust: float = 5.0
) -> float:
    """Least squares along histories by L-BFGS; returns the loss."""
    rollout = Rollout(network, histories, robust)
    count = 0

    def each(_: np.ndarray) -> None:
        nonlocal count
        count += 1
        if report is not None:
            report(count / iterations)

    result = minimize(
        rollout,
        network.values,
        jac=True,
        method="L-BFGS-B",
        callback=each,
        options={"maxiter": iterations, "maxfun": 2 * iterations, "maxcor": 30},
    )
    network.values = result.x
    return float(result.fun)
