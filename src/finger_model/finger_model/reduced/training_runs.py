# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Full-order runs for the reduced model: internal strain in a few coordinates along many histories.

The full-order bulk has the energy ½ J^(−2/3) H : C with H = G∞ 1 + (G0 − G∞) A. Over G0, and with r
= G∞/G0 = E1/(E0 + E1), H/G0 = 1 + B where B = (1 − r)(A − 1): the contact problem at an instant
depends on E1 only through the field B. B is projected on fields φ_i (principal components of
visited fields, volume-weighted):

    a_i = ⟨φ_i, B⟩,  b_i = ⟨φ_i, C̄⁻¹ − 1⟩,  c_i = b_i − a_i
    dA/dt = (C̄⁻¹ − A)/τ   ⇒   τ da_i/dt = (1 − r) b_i − a_i    (exact, for every φ)

so only the maps (force, a, E2/E0) → c and → area, indentation, pressure are to be learned. Several
branches (g_b, τ_b) have B = Σ g_b (A_b − 1), and each its own a_ib with τ_b da_ib/dt = g_b b_i −
a_ib: the maps, which see only the sum of the a_ib, are the same.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from finger_common.errors import ModelError
from finger_common.processes import begin_worker, worker_pool

from ..fem.full_order import FullOrderModel
from ..fem.mesh import BULK
from ..geometry import Geometry
from ..laws import UNIT, MaxwellLaw, Tissue, law_of
from ..laws.generalized_maxwell import LAWS_BY_BRANCHES, TIME_RANGE
from ..laws.standard_linear_solid import PARAMETERS, StandardLinearSolid
from .force_histories import KINDS, random_history, random_parameters, training_parameters

COMPONENT_WEIGHTS = np.array([1.0, 1.0, 1.0, 2.0])
"""Of rr, zz, θθ and rz in the double contraction of symmetric tensors."""


@dataclass(frozen=True)
class Case:
    """One history to run: parameters (p,) of a law, time (n,), force (n,), kind."""

    parameters: np.ndarray
    time: np.ndarray
    force: np.ndarray
    kind: str
    law: str = StandardLinearSolid.name


@dataclass
class Run:
    """What came out, up to the last row that converged.

    parameters (p,) of the law; time, force, area, indentation, peak (n,) in SI; internal, total
    (n, k): a and b; failed: the force (N) at which the finger carried no more, or NaN.
    """

    parameters: np.ndarray
    kind: str
    time: np.ndarray
    force: np.ndarray
    area: np.ndarray
    indentation: np.ndarray
    peak: np.ndarray
    internal: np.ndarray
    total: np.ndarray
    failed: float
    law: str = StandardLinearSolid.name


def training_case(seed: int, index: int) -> Case:
    """The index-th training history: two thirds around the paper's box, the rest over the range."""
    rng = np.random.default_rng([seed, index])
    wide = index % 3 == 2
    parameters = random_parameters(rng, PARAMETERS.range) if wide else training_parameters(rng)
    kind = (*KINDS[1:], "random", "random")[index % 7]
    if wide or rng.random() < 0.25:
        peak = np.exp(rng.uniform(np.log(0.15), np.log(3.0)))
    else:
        peak = rng.uniform(0.7, 1.5)
    time, force = random_history(rng, kind, peak)
    return Case(parameters, time, force, kind)


def held_out_case(seed: int, index: int) -> Case:
    """The index-th held-out history: paper's box, 1.35 N, kinds in turn."""
    rng = np.random.default_rng([seed, index, 1])
    kind = KINDS[index % len(KINDS)]
    parameters = random_parameters(rng, PARAMETERS.box)
    time, force = random_history(rng, kind)
    return Case(parameters, time, force, kind)


def wide_held_out_case(seed: int, index: int) -> Case:
    """The index-th held-out history over the whole range of parameters, to a peak of 0.15–3 N."""
    rng = np.random.default_rng([seed, index, 2])
    peak = float(np.exp(rng.uniform(np.log(0.15), np.log(3.0))))
    kind = KINDS[index % len(KINDS)]
    return Case(random_parameters(rng, PARAMETERS.range), *random_history(rng, kind, peak), kind)


def branch_case(seed: int, index: int) -> Case:
    """The index-th held-out history of a generalised Maxwell law: 2–4 branches of 1 ms … 10 s.

    Instantaneous and long-term modulus and E2 are those of the paper's box; no training has several
    branches.
    """
    rng = np.random.default_rng([seed, index, 3])
    E0, E1, _, E2 = random_parameters(rng, PARAMETERS.box)
    law = LAWS_BY_BRANCHES[2 + index % 3]
    count = law.INTERNAL_TENSORS
    shares = rng.dirichlet(np.ones(count)) * E0 / (E0 + E1)
    low, high = np.log(TIME_RANGE)
    times = np.exp(rng.uniform(low, high, count))
    values = {"E0": E0, "E2": E2, "stiffening": 0.0}
    values |= {f"fraction_{k + 1}": share for k, share in enumerate(shares)}
    values |= {f"tau_{k + 1}": time for k, time in enumerate(times)}
    kind = KINDS[index // 3 % len(KINDS)]
    vector = law.PARAMETERS.vector(values)
    return Case(vector, *random_history(rng, kind), kind, law.name)


def weight_of(model: FullOrderModel) -> np.ndarray:
    """Quadrature weights (E_bulk, 4, 1) of the bulk, over the pad's volume scale."""
    bulk = model.mesh.part == BULK
    length = model.geometry.pad_semi_axis_radial
    return (model.equilibrium.elements.weight[bulk] / length**3)[:, :, None] * COMPONENT_WEIGHTS


def internal_field(tissue: Tissue, material: MaxwellLaw) -> tuple[np.ndarray, np.ndarray]:
    """B and C̄⁻¹ − 1 (E_bulk, 4, 4) of the bulk tissue."""
    found = np.zeros_like(tissue.c_bar)
    for branch, internal in zip(material.branches, tissue.internal):
        found += branch.fraction * (internal - UNIT)
    return found, tissue.c_bar_inverse - UNIT


def run_case(
    model: FullOrderModel, case: Case, modes: np.ndarray | None, friction: float
) -> tuple[Run, np.ndarray]:
    """Run one case; also returns some fields B, for the choice of modes.

    modes (k, E_bulk·16): already weighted.
    """
    law = law_of(case.law)
    assert issubclass(law, MaxwellLaw)
    material = law(friction=friction).with_vector(case.parameters)
    stepper = model.start(material, float(case.time[0]))
    rows, internal, total, fields = [], [], [], []
    failed = np.nan
    for i in range(len(case.time)):
        try:
            point = stepper.step(float(case.time[i]), float(case.force[i]))
        except ModelError:
            failed = float(case.force[i])
            break
        rows.append((point.area, point.indentation, point.peak_pressure))
        b, c = internal_field(stepper.state.tissue, material)
        if modes is not None:
            internal.append(modes @ b.ravel())
            total.append(modes @ c.ravel())
        elif i % 6 == 5:
            fields.append(b.astype(np.float32).ravel())
    n = len(rows)
    table = np.array(rows).reshape(n, 3)
    k = 0 if modes is None else len(modes)
    return (
        Run(  # type: ignore[call-arg]
            case.parameters,
            case.kind,
            case.time[:n],
            case.force[:n],
            *table.T,
            np.array(internal).reshape(n, k),
            np.array(total).reshape(n, k),
            failed,
            case.law,
        ),
        np.array(fields),
    )


def principal_modes(fields: np.ndarray, weight: np.ndarray, number: int) -> np.ndarray:
    """Weighted projections (number, n) on the principal components of fields (m, n).

    The coordinates of a field are modes @ field.
    """
    root = np.sqrt(weight.ravel())
    scaled = fields * root
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    order = np.argsort(values)[::-1][:number]
    basis = (vectors[:, order] / np.sqrt(values[order])).T @ scaled
    return basis * root


_worker: dict[str, object] = {}


def _begin(
    geometry: Geometry, refinement: float, friction: float, modes: np.ndarray | None
) -> None:
    begin_worker()
    _worker.update(model=FullOrderModel(geometry, refinement), friction=friction, modes=modes)


def _work(case: Case) -> tuple[Run, np.ndarray]:
    return run_case(_worker["model"], case, _worker["modes"], _worker["friction"])  # type: ignore[arg-type]


def pool(
    workers: int, geometry: Geometry, refinement: float, friction: float, modes: np.ndarray | None
) -> ProcessPoolExecutor:
    """Processes that run cases."""
    return worker_pool(workers, _begin, (geometry, refinement, friction, modes))


def run_all(executor: ProcessPoolExecutor, cases: list[Case]):
    """Results of cases in their order, as they come."""
    return executor.map(_work, cases, chunksize=1)
