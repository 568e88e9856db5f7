# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Training of the population's maps: elastic curves, then what the networks add to them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from finger_common.processes import Map

from . import kernels as rk
from .build import Progress
from .context_network import ContextNetwork, Rows, fit
from .elastic_contact import (
    ElasticContacts,
    LinearGuess,
    extended,
    network_context,
    press_contexts,
    strain_sizes,
)
from .error import COUNTED_FORCE, ErrorTable, error_along
from .kernels import NODES
from .maps import Finger, PopulationMaps, fill_curves
from .population import (
    CONTEXT,
    LARGEST_LOAD,
    MIDDLE_FORCE,
    MIDDLE_STIFFENING,
    largest_force,
)
from .population_runs import Run
from .training import features, strain_scales

LATENTS = 6
DRIVE, CONTACT = (48, 128), (128, 192)
"""Width of the hidden layers of each network, and of the network of its gains and biases."""
BATCH = 256
"""Pieces of histories of one step of training."""
BETAS = (0.03, 0.15)
FIRST_FORCE = 0.06
"""N; below it the area is not trained on."""
MIDDLE_COUNT = 2.0
"""How much a run of the middle box counts beside one of the rest: its goal is half as large."""
REFINING_COUNT = 1.5
"""How much a run on the default mesh counts in the contact network beside one on the coarse."""
DECAY = 0.1
RETURNS, RETURNING_RATE = 25, 3e-3
"""Epochs and first rate of the drive's training with the states that it visits itself."""
FARTHEST = 0.5
"""Of the strain: visited states farther off the full order's are not trained on."""
PIECE = 24
"""Rows of one piece of a history in training."""


def stiffening_of(run: Run) -> float:
    """Stiffening b of a run's law, from its context."""
    share = run.context[CONTEXT.index("stiffening")]
    return MIDDLE_STIFFENING * share / (1.0 - share)


def load_over_largest(run: Run) -> np.ndarray:
    """Forces (n,) over the largest that the model is used for."""
    return run.force / largest_force(run.scale * run.share, stiffening_of(run))


def counts(run: Run) -> np.ndarray:
    """How much each row (n,) counts: less towards the largest load, nothing beyond it."""
    load = load_over_largest(run)
    return np.where(load > 1.1, 0.0, (MIDDLE_COUNT if run.middle else 1.0) / (1.0 + 2.0 * load))


def friction_states(run: Run) -> np.ndarray:
    """q (n, m) along a run, as the kernels have it, from its own indentation."""
    found = np.ones((len(run.time), len(BETAS)))
    before = rk.DELTA_FLOOR
    for row in range(1, len(run.time)):
        depth = max(run.indentation[row] / run.length, rk.DELTA_FLOOR)
        if run.force[row] > 0.0:
            change = np.log(depth / before)
            sign = 1.0 if change > 0.0 else -1.0
            fade = np.exp(-abs(change) / np.array(BETAS))
            found[row] = sign + (found[row - 1] - sign) * fade
        before = depth
    return found


Columns = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Inputs (n, i), targets (n, o) and weights (n, o) of the rows of a run."""


def padded(runs: Iterable[tuple[np.ndarray, Columns]]) -> Rows:
    """Rows of all runs, in pieces of PIECE; of each run its context (c,) and its columns."""
    parts, owners = [], []
    for context, whole in runs:
        for begin in range(0, len(whole[0]), PIECE):
            parts.append([values[begin : begin + PIECE] for values in whole])
            owners.append(context)
    longest = max(len(part[0]) for part in parts)
    arrays = []
    for which in range(3):
        values = np.zeros((len(parts), longest, parts[0][which].shape[1]), np.float32)
        for index, part in enumerate(parts):
            values[index, : len(part[which])] = part[which]
        arrays.append(values)
    return Rows(np.array(owners, np.float32), *arrays)


def load_measure_of(run: Run) -> np.ndarray:
    """x (n,) along a run."""
    return np.cbrt(np.maximum(run.force, 0.0) / run.scale)


def _touching(run: Run) -> np.ndarray:
    return (run.force >= FIRST_FORCE) & (run.area > 0) & (run.peak > 0)


def _contact_targets(run: Run) -> np.ndarray:
    """ln(A/(L² x²)) and ln(p_max/p_mean) (n, 2), 0 where nothing touches."""
    on = _touching(run)
    found = np.zeros((len(run.time), 2))
    x = load_measure_of(run)[on]
    area, peak, force = run.area[on], run.peak[on], run.force[on]
    found[on] = np.column_stack([np.log(area / (run.length * x) ** 2), np.log(peak * area / force)])
    return found


@dataclass
class Seen:
    """What is seen along a run: amplitudes a and friction states q (n, k + m), rest R (n,), guess
    (n, 3 + k), mix (n, 2 + k), and which rows (n,) count."""

    states: np.ndarray
    rest: np.ndarray
    guess: np.ndarray
    mix: np.ndarray
    inside: np.ndarray

    @classmethod
    def at(
        cls,
        networks: np.ndarray,
        record: np.ndarray,
        work: np.ndarray,
        run: Run,
        states: np.ndarray,
        inside: np.ndarray,
    ) -> Seen:
        """What the guesses are at states (n, k + m), with the kernels' records of one finger."""
        end = 1 + 3 + LATENTS
        table = np.empty((len(states), end + rk.MIX_INPUTS + LATENTS))
        amplitudes = np.ascontiguousarray(states[:, :LATENTS])
        rk.guesses(networks, record, work, load_measure_of(run), amplitudes, table)
        return cls(states, table[:, 0], table[:, 1:end], table[:, end:], inside)


def _own_curves(run: Run) -> np.ndarray:
    """Elastic curves (2, nodes, 3 + k) of a run's own presses on the coarse mesh."""
    curves = run.presses.copy()
    curves[:, :, 3:] /= strain_sizes()[:, None]
    return extended(curves)


def exactly(
    types: rk.RecordTypes, run: Run, response: np.ndarray, curves: np.ndarray | None = None
) -> Seen:
    """What the full order itself visits along a run on the coarse mesh, with the response K (k, k)
    of the strain; curves (2, nodes, 3 + k): predicted ones where the run has no presses.

    Of a run with presses only the rows within them count.
    """
    networks = np.zeros(1, types.networks)
    networks["response"] = response
    record = np.zeros(1, types.parameters)
    record["share"] = run.share
    fill_curves(record, _own_curves(run) if curves is None else curves)
    x = load_measure_of(run)
    inside = np.ones(len(x), bool)
    if curves is None:
        reached = [NODES[np.isfinite(c[:, 0])].max() for c in run.presses]
        inside = (x <= reached[0] * 1.01) & (x <= reached[1] * run.share ** (1 / 3) * 1.01)
    states = np.column_stack([run.internal[:, :LATENTS], friction_states(run)])
    return Seen.at(networks, record, np.zeros(1, types.work), run, states, inside)


def response_of(types: rk.RecordTypes, runs: list[Run]) -> np.ndarray:
    """Response K (k, k) of the strain to internal strain e that is not in the pattern of a slow
    load: d is d₀ + ρ (d∞ − d₀) + Kᵀe, in least squares relative to |d₀| + |e|."""
    none = np.zeros((LATENTS, LATENTS))
    square, product = none.copy(), none.copy()
    for run in runs:
        own = exactly(types, run, none)
        internal = run.internal[:, :LATENTS]
        scale = strain_scales(load_measure_of(run), internal)
        used = own.inside & (run.force >= FIRST_FORCE)
        # 1/(|d₀| + |e|)², as the kernels have it.
        weights = (own.rest[used] ** -2 - scale[used] ** -2)[:, None]
        odd = own.mix[used, rk.MIX_INPUTS :] * scale[used, None]
        more = run.total[used, :LATENTS] - own.guess[used, 3:]
        square += (weights * odd).T @ odd
        product += (weights * odd).T @ more
    return np.linalg.solve(square + 1e-9 * np.eye(LATENTS), product)


def _press_inputs(runs: list[Run]) -> tuple[np.ndarray, LinearGuess]:
    """Contexts (2, n, 11) and guess of the runs' presses."""
    context = np.array([run.context for run in runs])
    contexts = press_contexts(context, np.array([run.share for run in runs]))
    return contexts, _linear_guess(runs)


def _linear_guess(runs: list[Run]) -> LinearGuess:
    return LinearGuess(*(np.stack(v, 1) for v in zip(*((r.guess, r.meshes) for r in runs))))


def fit_elastic(
    runs: list[Run], fine: list[Run], report: Progress, each: Map = map
) -> ElasticContacts:
    """Elastic contacts of the runs' presses; `fine`: on the default mesh, of the first fingers."""
    contexts, guess = _press_inputs(runs)
    coarse = np.stack([run.presses for run in runs], axis=1)
    finer = np.stack([run.presses[:, :, :3] for run in fine], axis=1)

    def fitted(stage: str, coarse: np.ndarray, finer: np.ndarray) -> ElasticContacts:
        return ElasticContacts.fit(contexts, guess, coarse, finer, partial(report, stage), each)

    first = fitted("fitting the elastic curves", coarse, finer)
    kept = first.without_outliers(contexts, guess, coarse, finer)
    return fitted("fitting them without outliers", *kept)


def drive_columns(run: Run, seen: Seen) -> Columns:
    """Columns of the drive along a run on the coarse mesh: of the full order's own states, or of
    others, from which the same strain and depth lead back to it."""
    x, amplitudes = load_measure_of(run), seen.states[:, :LATENTS]
    depth = run.indentation / run.length - x * x * np.exp(seen.guess[:, 2])
    scale = strain_scales(x, amplitudes)
    strain = (run.total[:, :LATENTS] - seen.guess[:, 3:]) / seen.rest[:, None]
    targets = np.column_stack([depth / scale ** (2 / 3), strain])
    # Errors count somewhat more than in proportion to the strain: early ones stay in the state.
    true = strain_scales(x, run.internal[:, :LATENTS])
    share = true / true.max()
    off = np.linalg.norm(amplitudes - run.internal[:, :LATENTS], axis=1)
    count = counts(run) * seen.inside * (off <= FARTHEST * true)
    weights = np.repeat((count * share**0.5)[:, None], 1 + LATENTS, axis=1)
    weights[:, 0] = 2.0 * count * share ** (2 / 3)
    weights[np.minimum(scale, true) < 1e-4] = 0.0
    return features(x, amplitudes, None, np.zeros((len(x), 0))), targets, weights


def contact_columns(run: Run, seen: Seen, count: float = 1.0) -> Columns:
    """Columns of the contact along a run that counts so much."""
    touching = _touching(run)
    share = count * counts(run) * run.area / run.area.max() * touching * seen.inside
    targets = _contact_targets(run) - np.where(touching[:, None], seen.guess[:, :2], 0.0)
    amplitudes, friction = seen.states[:, :LATENTS], seen.states[:, LATENTS:]
    inputs = features(load_measure_of(run), amplitudes, friction, np.zeros((len(share), 0)))
    return np.column_stack([inputs, seen.mix]), targets, np.column_stack([share, 0.1 * share])


class Sample(NamedTuple):
    """A run on the coarse mesh, what the maps know of its finger, and what it visits itself."""

    run: Run
    finger: Finger
    own: Seen


def train(
    runs: list[Run],
    fine: list[Run],
    further: list[Run],
    refining: list[Run],
    epochs: int,
    report: Progress,
    each: Map = map,
) -> dict[str, np.ndarray]:
    """Arrays of the population's maps; `each` does what can be done side by side.

    runs: with presses, on the coarse mesh; fine: presses of the first of these fingers on the
    default mesh; further, refining: runs of other fingers without presses, on the coarse and on
    the default mesh. Both networks learn what a run adds to its own elastic curves on the coarse
    mesh, and from the further runs what they add to predicted ones; they are used with the
    predicted curves of the default mesh, with which the contact network learns from the refining
    runs, too.
    """
    elastic = fit_elastic(runs, fine, report, each)
    types = rk.record_types(LATENTS, len(BETAS), DRIVE[0], CONTACT[0])
    response = response_of(types, runs)
    pressed = [
        Sample(run, finger._replace(curves=_own_curves(run)), exactly(types, run, response))
        for run, finger in zip(runs, _fingers(elastic, runs, coarse=True))
    ]
    predicted = [
        Sample(run, finger, exactly(types, run, response, finger.curves))
        for run, finger in zip(further, _fingers(elastic, further, coarse=True))
    ]
    coarse = [*pressed, *predicted]
    rows = [(finger.inputs, drive_columns(run, own)) for run, finger, own in coarse]
    learned = padded(rows)
    drive = ContextNetwork(learned, *DRIVE)
    _fit(drive, learned, epochs, "training the drive", report, each)

    # States need a drive only: an untrained contact network takes its place.
    columns = ((finger.inputs, contact_columns(run, own)) for run, finger, own in pressed)
    contact = ContextNetwork(padded(columns), *CONTACT)
    fixed = {"response": response, **elastic.arrays()}

    def visits() -> Iterator[tuple[Run, Finger, Seen]]:
        maps = PopulationMaps({**arrays_of(drive, contact), **fixed})
        for run, finger, own in coarse:
            yield run, finger, visited(maps, run, finger, own.inside)

    # With its own errors in the state the drive shall lead back to the full order.
    rows += [(finger.inputs, drive_columns(run, seen)) for run, finger, seen in visits()]
    _fit(drive, padded(rows), RETURNS, "training its way back", report, each, RETURNING_RATE)

    maps = PopulationMaps({**arrays_of(drive, contact), **fixed})
    rows = [(finger.inputs, contact_columns(run, seen)) for run, finger, seen in visits()]
    for run, finger in zip(refining, _fingers(elastic, refining, coarse=False)):
        seen = visited(maps, run, finger)
        rows.append((finger.inputs, contact_columns(run, seen, REFINING_COUNT)))
    learned = padded(rows)
    contact = ContextNetwork(learned, *CONTACT)
    _fit(contact, learned, epochs, "training the contact", report, each)
    return {**arrays_of(drive, contact), **fixed}


def _fit(
    network: ContextNetwork,
    rows: Rows,
    epochs: int,
    stage: str,
    report: Progress,
    each: Map,
    rate: float = 1e-2,
) -> None:
    def tell(share: float) -> None:
        report(stage, share)

    fit(network, rows, epochs, BATCH, rate, decay=DECAY, report=tell, each=each)


def _fingers(elastic: ElasticContacts, runs: list[Run], coarse: bool) -> list[Finger]:
    """What the maps know of the fingers of runs, with predicted curves on the coarse or the default
    mesh."""
    if not runs:
        return []
    presses, guess = _press_inputs(runs)
    seen = elastic.coarse_curves(presses, guess)
    curves = seen if coarse else elastic.default_curves(presses, guess, seen)
    return [
        Finger(network_context(run.context, run.share, seen[:, i]), curves[:, i])
        for i, run in enumerate(runs)
    ]


def arrays_of(drive: ContextNetwork, contact: ContextNetwork) -> dict[str, np.ndarray]:
    """As stored in the file of the reduced model."""
    found = {"betas": np.array(BETAS), "largest_load": np.array(LARGEST_LOAD)}
    for name, network in (("drive", drive), ("contact", contact)):
        for key, value in {**network.values, **network.scales}.items():
            found[f"{name}_{key}"] = np.asarray(value)
    return found


def visited(
    maps: PopulationMaps, run: Run, finger: Finger, inside: np.ndarray | None = None
) -> Seen:
    """What the maps visit along a run of a finger, of which rows `inside` (n,) count, or all."""
    record = maps.parameters_of(run.length, run.scale, run.fractions, run.times, finger)
    record["force_limit"] = np.inf
    state = maps.at_rest(record)
    states = np.zeros((len(run.time), maps.latents + len(BETAS)))
    before = run.time[0]
    for row, (time, force) in enumerate(zip(run.time, run.force)):
        rk.step(maps.networks, record, state, maps.work, time - before, force)
        states[row] = *state["amplitudes"][0], *state["friction"][0]
        before = time
    inside = np.ones(len(states), bool) if inside is None else inside
    return Seen.at(maps.networks, record, maps.work, run, states, inside)


def measured_error(arrays: dict[str, np.ndarray], runs: list[Run]) -> dict[str, ErrorTable]:
    """Errors over held-out runs on the default mesh, by region of the box."""
    maps = PopulationMaps(arrays)
    tables = {"middle": ErrorTable(), "whole": ErrorTable()}
    for run in runs:
        load = np.maximum.accumulate(load_over_largest(run))
        counted = (run.force >= COUNTED_FORCE) & (load <= 1.0) & (run.area > 0)
        if run.middle:
            counted &= np.maximum.accumulate(run.force) <= MIDDLE_FORCE
        if counted.sum() < 3:
            continue
        share = np.array([run.share])
        finger = maps.fingers_like(run.context[None], share, _linear_guess([run]))[0]
        record = maps.parameters_of(run.length, run.scale, run.fractions, run.times, finger)
        record["force_limit"] = run.scale * run.share * LARGEST_LOAD[0] * 10.0
        found = np.empty((len(run.time), 3))
        state = maps.at_rest(record)
        rk.run(maps.networks, record, state, maps.work, run.time[0], run.time, run.force, found)
        values = zip(CONTEXT, run.context)
        named = f"L {run.length * 1e3:.1f} mm, E∞/E0 {run.share:.3f}, " + ", ".join(
            f"{name} {value:.2f}" for name, value in values
        )
        pair = error_along(run, found, counted, named)
        tables["whole"].pairs.append(pair)
        if run.middle:
            tables["middle"].pairs.append(pair)
    return tables
