# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The general law in homogeneous deformations, against closed forms and ordinary differential
equations.

The references are written in full 3 × 3 tensors and solved by scipy; they share no code with the
law's update.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root

from ..laws import MaxwellLaw, StepEnergy, Tissue
from ..laws.generalized_maxwell import GeneralizedMaxwell, from_branches
from .cases import block
from .check import Check, Curve, Measure, Panel, largest

TAUS = (1e-3, 0.03, 0.5, 10.0)
"""s, relaxation times of the checks."""

LAWS = {
    "1 branch": ((0.7,), TAUS[2:3], 0.0),
    "2 branches": ((0.3, 0.4), TAUS[1:3], 0.0),
    "3 branches, stiffening 2": ((0.3, 0.2, 0.3), TAUS[:3], 2.0),
    "4 branches, stiffening 5": ((0.2, 0.2, 0.2, 0.2), TAUS, 5.0),
}
"""Fractions, times (s) and stiffening of the bulk tissue of the checks; E0 = 80 kPa."""


def tissue(
    fractions: Sequence[float], times: Sequence[float], stiffening: float, **others: float
) -> GeneralizedMaxwell:
    """Generalised Maxwell tissue, E0 = 80 kPa."""
    branches = [{"fraction": g, "tau": tau} for g, tau in zip(fractions, times)]
    data = {"E0": 80e3, "stiffening": stiffening, "branches": branches, **others}
    return from_branches(data, "verification")


# Modes --------------------------------------------------------------------------------------


class Mode(NamedTuple):
    """A homogeneous deformation without change of volume.

    gradient: amount → F (3, 3), axes r, θ, z; stress: tensor b (3, 3) → Kirchhoff stress of the
    mode (shear stress, or a difference of normal stresses). hardest: amount of the check.
    """

    gradient: Callable[[float], np.ndarray]
    stress: Callable[[np.ndarray], float]
    hardest: float


def _shear(amount: float) -> np.ndarray:
    gradient = np.eye(3)
    gradient[0, 2] = amount
    return gradient


MODES = {
    "uniaxial": Mode(
        lambda a: np.diag([(1 + a) ** -0.5, (1 + a) ** -0.5, 1 + a]),
        lambda b: b[2, 2] - b[0, 0],
        -0.4,
    ),
    "simple shear": Mode(_shear, lambda b: b[0, 2], 0.8),
    "equibiaxial": Mode(
        lambda a: np.diag([1 + a, 1 + a, (1 + a) ** -2.0]), lambda b: b[0, 0] - b[2, 2], 0.3
    ),
}

KNOTS = (0.0, 0.4, 1.2, 1.6, 2.4, 2.8, 3.2, 4.0)
PATH = (0.0, 1.0, 1.0, -0.5, -0.5, 0.6, 0.0, 0.0)
"""Ramp, hold, reversal, hold, reload, return, rest: times (s) and parts of the amplitude."""


def history(time: np.ndarray | float) -> np.ndarray:
    """Part of the amplitude at times (s)."""
    return np.asarray(np.interp(time, KNOTS, PATH))


def _root_of(stress: Callable[[float], float], wanted: float) -> float:
    """Amount at which a mode has a stress."""
    return float(brentq(lambda amount: stress(amount) - wanted, -0.7, 2.5, xtol=1e-11))


# Reference: ordinary differential equations -------------------------------------------------


def _stress(law: MaxwellLaw, mode: Mode, amount: float, metrics: np.ndarray) -> float:
    """Kirchhoff stress (Pa) of a mode for the branches' inverse metrics (k, 3, 3)."""
    gradient = mode.gradient(amount)
    invariant = np.sum(gradient**2)
    shear = law.instantaneous_shear_modulus
    total = law.long_term_fraction * shear * np.exp(law.stiffening * (invariant - 3.0)) * np.eye(
        3
    ) + sum(shear * branch.fraction * a for branch, a in zip(law.branches, metrics))
    return mode.stress(gradient @ total @ gradient.T)


def reference(
    law: MaxwellLaw, mode: Mode, time: np.ndarray, amplitude: float, creep: bool
) -> np.ndarray:
    """Stress (Pa) of a strain history or, in creep, amount of strain of a stress history.

    time (n,) in s; amplitude: of the amount, or of the stress in Pa.
    """
    count = len(law.branches)
    times = np.array([branch.relaxation_time for branch in law.branches])[:, None, None]

    def amount_of(t: float, metrics: np.ndarray) -> float:
        wanted = amplitude * float(history(t))
        if not creep:
            return wanted
        return _root_of(lambda amount: _stress(law, mode, amount, metrics), wanted)

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        metrics = state.reshape(count, 3, 3)
        gradient = mode.gradient(amount_of(t, metrics))
        inverse = np.linalg.inv(gradient.T @ gradient)
        return ((inverse - metrics) / times).ravel()

    found, state = np.empty(len(time)), np.tile(np.eye(3), (count, 1, 1)).ravel()
    # From knot to knot: the history has corners there.
    for begin, end in pairwise(KNOTS):
        rows = np.flatnonzero((time >= begin) & (time <= end))
        instants = np.unique(np.append(time[rows], end))
        solved = solve_ivp(rate, (begin, end), state, "LSODA", instants, rtol=1e-7, atol=1e-9)
        for row, values in zip(rows, solved.y.T):
            metrics = values.reshape(count, 3, 3)
            amount = amount_of(float(time[row]), metrics)
            found[row] = amount if creep else _stress(law, mode, amount, metrics)
        state = solved.y[:, -1]
    return found


# The law's own steps at one point -----------------------------------------------------------


def _tensor(energy: StepEnergy, invariant: float) -> np.ndarray:
    """H + h 1 (3, 3), axes r, θ, z, of a step of one element."""
    rr, zz, hoop, rz = energy.metric[0, 0]
    total = np.array([[rr, 0.0, rz], [0.0, hoop, 0.0], [rz, 0.0, zz]])
    if energy.stiffening is not None:
        total += energy.stiffening(np.full((1, 4), invariant))[0][0, 0] * np.eye(3)
    return total


def _stored(tensor: np.ndarray) -> np.ndarray:
    """A tensor (3, 3) with axes r, θ, z as the laws keep it, at the four points of one element."""
    return np.tile([tensor[0, 0], tensor[2, 2], tensor[1, 1], tensor[0, 2]], (1, 4, 1))


def _stress_of_step(mode: Mode, energy: StepEnergy, amount: float) -> float:
    """Kirchhoff stress (Pa) of a mode at the end of a step."""
    gradient = mode.gradient(amount)
    tensor = _tensor(energy, float(np.sum(gradient**2)))
    return mode.stress(gradient @ tensor @ gradient.T)


def stepped(
    law: MaxwellLaw, mode: Mode, time: np.ndarray, amplitude: float, creep: bool
) -> np.ndarray:
    """The same as `reference`, by the steps of the law between times (n,)."""
    unit = _stored(np.eye(3))
    state = Tissue(unit, unit, np.tile(unit, (len(law.branches), 1, 1, 1)))
    found = np.zeros(len(time))
    for row in range(1, len(time)):
        duration = float(time[row] - time[row - 1])
        energy = law.step_energy(duration, state)
        stress = partial(_stress_of_step, mode, energy)
        amount = wanted = amplitude * float(history(time[row]))
        if creep:
            amount = _root_of(stress, wanted)
        found[row] = amount if creep else stress(amount)
        gradient = mode.gradient(amount)
        metric = gradient.T @ gradient
        strain = _stored(metric), _stored(np.linalg.inv(metric))
        state = Tissue(*strain, law.update(duration, state, *strain))
    return found


def points(
    steps: int = 800, modes: Sequence[str] = tuple(MODES), laws: Sequence[str] = tuple(LAWS)
) -> Check:
    """Relaxation and creep at one material point."""
    time = np.linspace(0.0, KNOTS[-1], steps + 1)
    rows = np.arange(0, steps + 1, max(1, steps // 80))
    measures, panels = [], []
    for name in modes:
        mode, curves = MODES[name], []
        for index, what in enumerate(laws):
            law = tissue(*LAWS[what])
            stress = reference(law, mode, time[rows], mode.hardest, creep=False)
            found = stepped(law, mode, time, mode.hardest, creep=False)[rows]
            error = 100.0 * largest(found - stress) / largest(stress)
            measures.append(Measure(f"{name}, {what}: stress under strain", error, "%", high=0.1))
            load = 0.5 * float(stress[rows.searchsorted(steps * 1.2 / KNOTS[-1])])
            strain = reference(law, mode, time[rows], load, creep=True)
            found = stepped(law, mode, time, load, creep=True)[rows]
            error = 100.0 * largest(found - strain) / largest(strain)
            measures.append(Measure(f"{name}, {what}: strain under stress", error, "%", high=0.1))
            curves += [
                Curve(time[rows], strain, f"C{index}-"),
                Curve(time[rows][::4], found[::4], f"C{index}o"),
            ]
        panels.append(Panel("time (s)", f"{name}: strain", curves))
    measures += _closed_forms(steps)
    return Check(
        "homogeneous",
        "General law in homogeneous deformations",
        "Ramp, hold, reversal, hold, reload, return and rest in 4 s, of strain (40 % compression, "
        "shear 0.8, 30 % equibiaxial stretch) and of stress, for 1 to 4 branches of 1 ms to 10 s, "
        "against ordinary differential equations in full tensors (scipy, LSODA). Differences are "
        "over the largest value of a history. Closed forms: after a sudden strain every branch "
        "decays as exp(−t/τ) in any mode; in simple shear the shear stress of neo-Hookean branches "
        "is exactly that of linear viscoelasticity, so that creep follows the creep compliance. "
        "Figure, strain under stress: lines are the differential equations, circles the law; one "
        "to four branches in blue, orange, green and red.",
        measures,
        panels,
    )


def _closed_forms(steps: int) -> list[Measure]:
    """A sudden strain in each mode, and creep in simple shear."""
    law = tissue(*LAWS["4 branches, stiffening 5"])
    shear = law.instantaneous_shear_modulus
    elapsed = np.concatenate([[0.0], np.geomspace(1e-4, 20.0, 60)])
    decay = sum(b.fraction * np.exp(-elapsed / b.relaxation_time) for b in law.branches)
    measures = []
    for name, mode in MODES.items():
        gradient = mode.gradient(mode.hardest)
        metric = gradient.T @ gradient
        strain = _stored(metric), _stored(np.linalg.inv(metric))
        unit = _stored(np.eye(3))
        state = Tissue(unit, unit, np.tile(unit, (len(law.branches), 1, 1, 1)))
        state = Tissue(*strain, law.update(0.0, state, *strain))
        stresses = []
        for duration in np.diff(elapsed, prepend=0.0):
            tensor = _tensor(law.step_energy(float(duration), state), float(np.trace(metric)))
            stresses.append(mode.stress(gradient @ tensor @ gradient.T))
            state = Tissue(*strain, law.update(float(duration), state, *strain))
        spring = law.long_term_fraction * np.exp(law.stiffening * (np.trace(metric) - 3.0))
        exact = shear * (spring + decay) * mode.stress(gradient @ gradient.T)
        error = 100.0 * largest(np.array(stresses) / exact - 1.0)
        measures.append(Measure(f"{name}, sudden strain: stress, 0 to 20 s", error, "%", high=0.1))
    law = tissue(*LAWS["4 branches, stiffening 5"][:2], 0.0)
    time = np.linspace(0.0, KNOTS[-1], steps + 1)
    load = 0.3 * law.instantaneous_shear_modulus
    found = stepped(law, MODES["simple shear"], time, load, creep=True)
    exact = creep_response(law, time, load * history(time)) / law.instantaneous_shear_modulus
    error = 100.0 * largest(found - exact) / largest(exact)
    measures.append(Measure("simple shear, 4 branches: creep compliance", error, "%", high=0.1))
    return measures


# Creep compliance ---------------------------------------------------------------------------


class CreepCompliance(NamedTuple):
    """J(t)/J(0) = 1 + Σ amounts (1 − exp(−t/times)) over the instantaneous compliance."""

    amounts: np.ndarray
    times: np.ndarray


def creep_compliance(law: MaxwellLaw) -> CreepCompliance:
    """Exact creep compliance of a law's relaxation modulus at small strain.

    In the Laplace domain s Ĵ · s Ĝ = 1, with s Ĝ/G0 = g∞ + Σ g_k s/(s + 1/τ_k). The retardation
    times are the roots of s Ĝ, the amounts the residues there.
    """
    poles = np.array([-1.0 / branch.relaxation_time for branch in law.branches])
    denominator = np.poly(poles)
    numerator = law.long_term_fraction * denominator
    for k, branch in enumerate(law.branches):
        others = np.poly(np.delete(poles, k))
        numerator = np.polyadd(numerator, branch.fraction * np.append(others, 0.0))
    roots = np.roots(numerator).real
    residues = np.polyval(denominator, roots) / np.polyval(np.polyder(numerator), roots)
    return CreepCompliance(-residues / roots, -1.0 / roots)


def creep_response(law: MaxwellLaw, time: np.ndarray, load: np.ndarray) -> np.ndarray:
    """∫ J(t − s)/J(0) dF(s) of a load (n,) that is linear between times (n,) and starts at zero."""
    compliance = creep_compliance(law)
    found = load.astype(float)
    for amount, retardation in zip(*compliance):
        creeping = np.zeros(len(time))
        for row, (duration, rise) in enumerate(zip(np.diff(time), np.diff(load)), start=1):
            decay = np.exp(-duration / retardation)
            mean = (1.0 - decay) * retardation / duration
            # Exact for a load that is linear within the step.
            creeping[row] = (
                decay * creeping[row - 1] + (1.0 - decay) * load[row - 1] + (1.0 - mean) * rise
            )
        found = found + amount * creeping
    return found


# A cylinder of finite elements --------------------------------------------------------------


def _squeezed(law: MaxwellLaw, time: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """Axial stretch (n,) of a free cylinder under nominal pressures (n,) in Pa at times (n,).

    Compressible: both stretches follow from axial and radial equilibrium at each instant.
    """
    shear, bulk = law.instantaneous_shear_modulus, law.bulk_modulus
    count = len(law.branches)
    times = np.array([branch.relaxation_time for branch in law.branches])[:, None]

    def stretches(t: float, metrics: np.ndarray, start: np.ndarray) -> np.ndarray:
        pressure = np.interp(t, time, nominal)

        def unbalanced(stretch: np.ndarray) -> list[float]:
            radial, axial = stretch
            volume = radial**2 * axial
            squares = volume ** (-2 / 3) * np.array([radial**2, axial**2])
            spring = np.exp(law.stiffening * (2 * squares[0] + squares[1] - 3.0))
            modulus = shear * law.long_term_fraction * spring + sum(
                shear * b.fraction * a for b, a in zip(law.branches, metrics)
            )
            b = modulus * squares
            mean = (2 * b[0] + b[1]) / 3
            volumetric = volume * bulk * (volume - 1)
            return [
                (b[0] - mean + volumetric) / shear,
                ((b[1] - mean + volumetric) / axial + pressure) / shear,
            ]

        return np.asarray(root(unbalanced, start, tol=1e-12).x)

    guess = np.ones(2)

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        nonlocal guess
        metrics = state.reshape(count, 2)
        guess = stretches(t, metrics, guess)
        volume = guess[0] ** 2 * guess[1]
        return ((volume ** (2 / 3) / guess**2 - metrics) / times).ravel()

    solved = solve_ivp(
        rate,
        (time[0], time[-1]),
        np.ones(2 * count),
        "LSODA",
        time,
        rtol=1e-8,
        atol=1e-9,
        max_step=0.05,
    )
    found = []
    for t, state in zip(time, solved.y.T):
        guess = stretches(t, state.reshape(count, 2), guess)
        found.append(guess[1])
    return np.array(found)


def cylinder(steps: int = 100, laws: Sequence[str] = tuple(LAWS)) -> Check:
    """Creep of a cylinder between smooth plates, and equibiaxial stretch of its outline."""
    size = 1e-2
    time = np.linspace(0.0, 2.0, steps + 1)
    measures: list[Measure] = []
    curves: list[Curve] = []
    for index, name in enumerate(laws):
        law = tissue(*LAWS[name], friction=0.0)
        pressure = 0.35 * 80e3 * law.long_term_fraction
        force = np.interp(time, [0, 0.5, 1.0, 1.5, 2.0], [0, 1, 1, 0.3, 0.3]) * pressure
        stepper = block(size, size, 2, 2).start(law)
        area = np.pi * size**2
        found = [
            1.0 - stepper.step(float(t), float(p * area)).indentation / size
            for t, p in zip(time, force)
        ]
        exact = _squeezed(law, time, force)
        error = 100.0 * largest(np.array(found) - exact) / largest(1.0 - exact)
        measures.append(Measure(f"uniaxial, {name}: compression", error, "%", high=0.1))
        state = stepper.state
        spent = state.stored + state.dissipation
        measures.append(
            Measure(
                f"uniaxial, {name}: error of the energy balance",
                100.0 * abs(state.work - spent) / state.dissipation,
                "%",
                high=0.5,
            )
        )
        curves += [
            Curve(time, 1.0 - exact, f"C{index}-"),
            Curve(time[::10], 1.0 - np.array(found)[::10], f"C{index}o", name),
        ]
    for name in laws:
        law = tissue(*LAWS[name], friction=0.0)
        times, found_stress = _stretched(law, size, steps)
        exact = reference(law, MODES["equibiaxial"], times, 0.3, creep=False)
        error = 100.0 * largest(found_stress - exact) / largest(exact)
        measures.append(Measure(f"equibiaxial, {name}: stress", error, "%", high=0.1))
    return Check(
        "cylinder",
        "General law on a cylinder of finite elements",
        "A cylinder of bulk tissue, ν = 0.48, pressed between smooth plates to 0.35 E∞ in 0.5 s, "
        "held, released to 0.3 of it, held: the plate's travel against the differential equations "
        "of both stretches. The same cylinder with its outline stretched equibiaxially by 30 % in "
        "the history of the check before, without change of volume: difference of the principal "
        "stresses.",
        measures,
        [Panel("time (s)", "compression", curves, legend="lines: equations")],
    )


def _stretched(law: MaxwellLaw, size: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) and σ_rr − σ_zz (n,) in Pa of a cylinder whose outline follows MODES."""
    model = block(size, size, 2, 2, distortion=0.2)
    mesh, equilibrium = model.mesh, model.equilibrium
    r, z = mesh.nodes.T
    outline = (r <= 0) | (r >= size * (1 - 1e-9)) | (z >= 0) | (z <= -size * (1 - 1e-9))
    equilibrium.fixed = np.flatnonzero(np.repeat(outline, 2))
    stepper = model.start(law)
    times = np.linspace(0.0, KNOTS[-1], 2 * steps + 1)
    found = [0.0]
    for instant in times[1:]:
        state = stepper.state
        duration = float(instant) - state.time
        stretch = 1.0 + 0.3 * float(history(instant))
        start = mesh.nodes * [stretch, stretch**-2]
        material = stepper.mesh_material.step(duration, state.tissue)
        contact = equilibrium.unloaded_contact()
        positions, contact = equilibrium.solve(start, contact, material, 0.0, 0.0)
        tissue_now, _, _ = stepper.mesh_material.update(duration, state.tissue, positions)
        state.time, state.positions, state.tissue = float(instant), positions, tissue_now
        # A step of no duration gives the stress of the state.
        stress = stepper.fields().stress
        found.append(float(np.mean(stress[:, 0] - stress[:, 1])))
    return times, np.array(found)
