# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Full-order runs over the population: random fingers, laws and short histories.

Most runs are on `similar_mesh`, coarse but smooth from finger to finger, and also give the internal
strain (see `training_runs`). Some are on the default mesh: they correct the coarse ones.
"""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass, replace

import numpy as np

from finger_common.errors import InputError, ModelError

from ..fem.full_order import FullOrderModel
from ..fem.linear_contact import LinearContact
from ..fem.mesh import similar_mesh
from ..geometry import Geometry
from ..laws import MaxwellLaw
from ..laws.generalized_maxwell import (
    E0_RANGE,
    E2_RANGE,
    LAWS_BY_BRANCHES,
    STIFFENING_RANGE,
    TIME_RANGE,
)
from ..paper import FRICTION
from .elastic_contact import linear_guess
from .force_histories import KINDS, random_history
from .kernels import NODES
from .population import (
    BOX,
    LARGEST_LOAD,
    MIDDLE,
    MIDDLE_FORCE,
    MIDDLE_FRICTION,
    MIDDLE_LENGTHS,
    MIDDLE_STIFFENING,
    NAIL_MODULUS,
    context_of,
    largest_force,
)
from .training_runs import internal_field

MOST_SECONDS = 6.0
"""A training run that takes more processor time is cut short."""

WHOLE = {"E0": E0_RANGE, "E1": (6e3, 150e3), "E2": E2_RANGE}
SOFT_SHARE = 0.15
"""E∞/E0 below which further histories are run."""

SOFT_SHARE_OF_MIDDLE = 0.2
"""The same of the further histories of the middle box."""

LONG_HOLD = "long hold"
_ROUGH = "tapping", "taps", "human", "random"
REFINING = ("ramp", "hold", "release", "release", "reload", "reload", *_ROUGH)
"""Kinds of the histories that refine the networks, beside LONG_HOLD."""

SUDDEN_STEP, SLOW_STEP = 1e-9, 1e7
"""s between two loads: far from all relaxation times."""
STEPS_BY_FRICTION = 12.0
"""Steps from node to node of an elastic press, beyond the first, over the friction. Skin that
sticks remembers where it touched: with friction 0.5, one step from node to node gives 1 % more area
than small ones."""


@dataclass(frozen=True)
class Case:
    """A finger, its law and a history: time (n,) in s, force (n,) in N."""

    geometry: Geometry
    material: MaxwellLaw
    time: np.ndarray
    force: np.ndarray
    kind: str
    middle: bool


def _between(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(limits))))


def random_geometry(rng: np.random.Generator, middle: bool) -> Geometry:
    """A finger of the population box; `middle`: 12 to 20 mm wide."""
    while True:
        whole = BOX["pad_semi_axis_radial"]
        length = rng.uniform(*(MIDDLE_LENGTHS if middle else (whole.low, whole.high)))
        aspect = rng.uniform(BOX["aspect"].low, BOX["aspect"].high)
        skin = rng.uniform(BOX["epidermis_thickness"].low, BOX["epidermis_thickness"].high)
        radial = rng.uniform(BOX["bone_radial"].low, BOX["bone_radial"].high)
        axial = rng.uniform(BOX["bone_axial"].low, BOX["bone_axial"].high)
        nail = rng.uniform(BOX["nail_radius"].low, BOX["nail_radius"].high)
        try:
            return Geometry(
                pad_semi_axis_radial=length,
                pad_semi_axis_axial=aspect * length,
                epidermis_thickness=skin,
                bone_semi_axis_radial=radial * length,
                bone_semi_axis_axial=axial * aspect * length,
                nail_radius=nail * length,
                nail_thickness=rng.uniform(0.2e-3, 0.8e-3),
            )
        except InputError:
            continue


def random_material(
    rng: np.random.Generator, middle: bool, branches: int, plain: bool = False
) -> MaxwellLaw:
    """A law of so many branches with moduli of the box; `plain`: friction 0.25, no stiffening."""
    box = MIDDLE if middle else WHOLE
    E0, E1, E2 = (_between(rng, box[name]) for name in ("E0", "E1", "E2"))
    shares = rng.dirichlet(np.ones(branches)) * E0 / (E0 + E1)
    values = {"E0": E0, "E2": E2}
    for k in range(branches):
        values |= {f"fraction_{k + 1}": shares[k], f"tau_{k + 1}": _between(rng, TIME_RANGE)}
    share = rng.uniform(0.0, 1.0 / (1.0 + MIDDLE_FRICTION))
    friction = MIDDLE_FRICTION * share / (1.0 - share)
    most = STIFFENING_RANGE[1]
    stiffening = rng.uniform(0.0, most / (most + MIDDLE_STIFFENING))
    stiffening = MIDDLE_STIFFENING * stiffening / (1.0 - stiffening)
    nail = 170e6 * math.exp(rng.normal(0.0, 1.0))
    if plain or rng.random() < 0.35:
        friction = FRICTION
    if plain or rng.random() < 0.45:
        stiffening = 0.0
    values["stiffening"] = stiffening
    law = LAWS_BY_BRANCHES[branches]
    nail = min(max(nail, NAIL_MODULUS[0]), NAIL_MODULUS[1])
    return law(friction=min(friction, 1.0), nail_modulus=nail, **values)  # type: ignore[arg-type]


def training_history(rng: np.random.Generator, tau: float, peak: float):
    """Time and force of a short history: loading, creep, unloading, reloading, in some 18 rows."""

    def span(low: float, high: float) -> float:
        return tau * 10.0 ** rng.uniform(low, high)

    times, forces = [0.0], [0.0]

    def go(force: float, duration: float, rows: int, power: float = 1.0) -> None:
        share = (np.arange(1, rows + 1) / rows) ** power
        start, before = times[-1], forces[-1]
        times.extend(start + share * duration)
        forces.extend(before + share * (force - before))

    go(peak, span(-2.5, 1.5), 6, 1.6)
    # Loading is nearly what the elastic curves say: most rows are about what comes after it.
    kind = rng.choice(4, p=(0.1, 0.1, 0.4, 0.4))
    if kind > 0:
        go(peak, span(-1.5, 1.5), 2, 1.5)
    if kind == 1:
        go(peak * rng.uniform(1.2, 2.5), span(-2.0, 1.0), 3)
    if kind == 2:
        low = peak * rng.uniform(0.05, 0.8)
        go(low, span(-2.0, 1.0), 3)
        go(low, span(-1.5, 1.5), 1)
        go(peak * rng.uniform(0.5, 1.2), span(-2.0, 1.0), 3)
    if kind == 3:
        go(0.0, span(-2.0, 1.0), 4)
        go(0.0, span(-1.5, 1.0), 1)
        go(peak * rng.uniform(0.3, 1.1), span(-2.0, 1.0), 4, 1.5)
    if kind > 1:
        go(forces[-1] * rng.uniform(0.05, 0.8), span(-2.0, 1.0), 3)
    return np.array(times), np.array(forces)


def training_case(seed: int, index: int) -> Case:
    """The index-th training history; half of them in the middle box."""
    rng = np.random.default_rng([seed, index])
    return _training_case(rng, bool(index % 2), 1.0)


def soft_case(seed: int, index: int) -> Case:
    """The same of tissue that keeps little of its modulus: with it the errors are largest."""
    rng = np.random.default_rng([seed, index, 2])
    return _training_case(rng, bool(index % 2), SOFT_SHARE)


def _training_case(rng: np.random.Generator, middle: bool, largest_share: float) -> Case:
    geometry = random_geometry(rng, middle)
    while True:
        material = random_material(rng, middle, int(rng.choice([1, 1, 1, 2, 3])))
        if material.long_term_fraction < largest_share:
            break
    length = geometry.pad_semi_axis_radial
    carried = material.instantaneous_modulus * material.long_term_fraction * length**2
    carried *= 12.0 * (1.0 + LARGEST_LOAD[1] * material.stiffening)
    peak = _between(rng, (0.3, 2.2) if middle else (0.2, 11.0))
    peak = min(peak, carried * rng.uniform(0.4, 1.0))
    time, force = training_history(rng, material.branches[0].relaxation_time, peak)
    return Case(geometry, material, time, force, "training", middle)


def held_out_case(seed: int, index: int) -> Case:
    """The index-th held-out history, half of them in the middle box: all kinds, holds of 60 s."""
    rng = np.random.default_rng([seed, index, 1])
    middle = bool(index % 2)
    geometry = random_geometry(rng, middle)
    material = random_material(rng, middle, int(rng.choice([1, 2, 3])), plain=index % 4 < 2)
    kind = (*KINDS, LONG_HOLD)[(index // 2) % (len(KINDS) + 1)]
    return _judged_case(rng, geometry, material, kind, middle)


def refining_case(seed: int, index: int) -> Case:
    """The index-th history that refines the networks: such as those on which the error is measured,
    more of them of tissue that keeps little of its modulus, with much unloading."""
    rng = np.random.default_rng([seed, index, 3])
    middle = bool(index % 2)
    geometry = random_geometry(rng, middle)
    largest_share = SOFT_SHARE if index % 4 < 2 else 1.0
    while True:
        material = random_material(rng, middle, int(rng.choice([1, 2, 3])), rng.random() < 0.3)
        if material.long_term_fraction < largest_share:
            break
    material = _of_any_friction(rng, material)
    kind = str(rng.choice((*REFINING, LONG_HOLD)))
    return _judged_case(rng, geometry, material, kind, middle)


def middle_case(seed: int, index: int) -> Case:
    """The index-th further history of the middle box, like those on which the error is measured;
    half of them of tissue that keeps little of its modulus."""
    rng = np.random.default_rng([seed, index, 4])
    geometry = random_geometry(rng, True)
    largest_share = SOFT_SHARE_OF_MIDDLE if index % 2 else 1.0
    while True:
        material = random_material(rng, True, int(rng.choice([1, 2, 3])), rng.random() < 0.4)
        if material.long_term_fraction < largest_share:
            break
    material = _of_any_friction(rng, material)
    kind = str(rng.choice((*REFINING, LONG_HOLD)))
    return _judged_case(rng, geometry, material, kind, True)


def _of_any_friction(rng: np.random.Generator, material: MaxwellLaw) -> MaxwellLaw:
    """The material, half of the time with a friction drawn evenly between 0 and 1: few others have
    much friction."""
    friction = rng.random()
    return replace(material, friction=friction) if rng.random() < 0.5 else material


def _judged_case(
    rng: np.random.Generator, geometry: Geometry, material: MaxwellLaw, kind: str, middle: bool
) -> Case:
    peak = _between(rng, (0.3, 2.0) if middle else (0.2, 10.0))
    if kind == LONG_HOLD:
        rise = rng.uniform(0.2, 2.0)
        share = np.arange(1, 17) / 16
        time = np.concatenate([[0.0], rise * share**1.4, rise + 60.0 * share**3])
        force = peak * np.concatenate([[0.0], share**1.4, np.ones(16)])
    else:
        time, force = random_history(rng, kind, peak)
    return Case(geometry, material, time, force, kind, middle)


@dataclass
class Run:
    """What came out, up to the last row that converged.

    context (10,), share: long-term fraction, length (m), scale: E0 L² (N); fractions, times (b,) of
    the branches; time, force, area, indentation, peak (n,) in SI; internal, total (n, k);
    presses (2, m, 3 + k): `elastic_press`, sudden and slow, where asked for (else (2, 0, 3));
    guess (2, m, 2), meshes (2, 3): curves and meshes of its `LinearGuess`.
    """

    context: np.ndarray
    length: float
    scale: float
    share: float
    fractions: np.ndarray
    times: np.ndarray
    time: np.ndarray
    force: np.ndarray
    area: np.ndarray
    indentation: np.ndarray
    peak: np.ndarray
    internal: np.ndarray
    total: np.ndarray
    presses: np.ndarray
    guess: np.ndarray
    meshes: np.ndarray
    failed: float
    kind: str
    middle: bool


def press_force(case: Case) -> float:
    """Force (N) to which a case's finger is pressed: that of its history; in the middle of the box
    at least the largest for which the stated error of the middle holds."""
    force = float(case.force.max())
    if not case.middle:
        return force
    material = case.material
    modulus = material.instantaneous_modulus * material.long_term_fraction
    scale = modulus * case.geometry.pad_semi_axis_radial**2
    return max(force, min(MIDDLE_FORCE, largest_force(scale, material.stiffening)))


def elastic_press(
    model: FullOrderModel,
    case: Case,
    slow: bool,
    to_force: float,
    modes: np.ndarray | None = None,
) -> np.ndarray:
    """Contact of a finger under loads so sudden or so slow that it is elastic.

    (m, 3 + k) at NODES: ln(A/(L² x²)), ln(p_max/p_mean), ln(δ/(L x²)) and the total strain on the
    modes (k, n); NaN beyond `to_force` (N) and where nothing converged. x is over E0, or over the
    long-term modulus E∞ of a slow press.
    """
    material, length = case.material, case.geometry.pad_semi_axis_radial
    share = material.long_term_fraction if slow else 1.0
    scale = material.instantaneous_modulus * share * length**2
    needed = np.cbrt(1.05 * to_force / scale)
    found = np.full((len(NODES), 3 + (0 if modes is None else len(modes))), np.nan)
    stepper = model.start(material, 0.0)
    steps = 1 + math.ceil(STEPS_BY_FRICTION * material.friction)
    begin = clock.process_time()
    before = 0.0
    for row, x in enumerate(NODES):
        if clock.process_time() - begin > 2.0 * MOST_SECONDS:
            break
        try:
            for part in range(1, steps + 1):
                force = scale * (before + (x - before) * part / steps) ** 3
                time = (row * steps + part) * (SLOW_STEP if slow else SUDDEN_STEP)
                point = stepper.step(time, force)
        except ModelError:
            break
        before = x
        if not 0.0 < point.area < 0.98 * math.pi * length**2:
            break
        found[row, 0] = math.log(point.area / (length * x) ** 2)
        found[row, 1] = math.log(point.peak_pressure * point.area / force)
        found[row, 2] = math.log(point.indentation / (length * x * x))
        if modes is not None:
            found[row, 3:] = modes @ internal_field(stepper.state.tissue, material)[1].ravel()
        if x > needed:
            break
    return found


def run(
    case: Case,
    modes: np.ndarray | None = None,
    coarse: bool = False,
    fields: list | None = None,
    history: bool = True,
    pressed: bool = False,
) -> Run:
    """Run a case; fields of the internal strain are added to `fields`.

    coarse: on `similar_mesh`, else on the default mesh; history: its force history; pressed: the
    elastic presses.
    """
    geometry, material = case.geometry, case.material
    model = FullOrderModel(geometry, mesh=similar_mesh(geometry) if coarse else None)
    stepper = model.start(material, float(case.time[0]))
    rows, internal, total = [], [], []
    failed = math.nan
    begin = clock.process_time()
    for i in range(len(case.time) if history else 0):
        if clock.process_time() - begin > (MOST_SECONDS if coarse else 10.0 * MOST_SECONDS):
            break
        try:
            point = stepper.step(float(case.time[i]), float(case.force[i]))
        except ModelError:
            failed = float(case.force[i])
            break
        rows.append((point.area, point.indentation, point.peak_pressure))
        if modes is not None or fields is not None:
            b, c = internal_field(stepper.state.tissue, material)
            if modes is not None:
                internal.append(modes @ b.ravel())
                total.append(modes @ c.ravel())
            elif fields is not None and i % 5 == 4:
                fields.append(b.astype(np.float32).ravel())
    n = len(rows)
    k = 0 if modes is None else len(modes)
    table = np.array(rows).reshape(n, 3)
    presses = np.zeros((2, 0, 3 + k))
    if pressed:
        to_force = press_force(case) if coarse else float(case.force.max())
        presses = np.array(
            [elastic_press(model, case, slow, to_force, modes) for slow in (False, True)]
        )
    return Run(  # type: ignore[call-arg]
        context_of(geometry, material),
        geometry.pad_semi_axis_radial,
        material.instantaneous_modulus * geometry.pad_semi_axis_radial**2,
        material.long_term_fraction,
        np.array([b.fraction for b in material.branches]),
        np.array([b.relaxation_time for b in material.branches]),
        case.time[:n],
        case.force[:n],
        *table.T,
        np.array(internal).reshape(n, k),
        np.array(total).reshape(n, k),
        presses,
        *(values[:, 0] for values in linear_guess(LinearContact(geometry), [material])),
        failed,
        case.kind,
        case.middle,
    )
