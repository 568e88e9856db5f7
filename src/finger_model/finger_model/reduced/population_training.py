# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Training of the population's maps: a correction to the default mesh, the drive, the contact."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from . import kernels as rk
from .context_network import ContextNetwork, Rows, fit
from .error import COUNTED_FORCE, ErrorTable, error_along
from .maps import PopulationMaps
from .population import CONTEXT, LARGEST_LOAD, MIDDLE_FORCE, MIDDLE_STIFFENING
from .population_runs import Run
from .training import drive_targets, features, strain_scales

Progress = Callable[[str, float], None]

LATENTS = 6
DRIVE, CONTACT, CORRECTION = (32, 80), (40, 96), (10, 24)
"""Width of the hidden layers of each network, and of the network of its gains and biases."""
BETAS = (0.03, 0.15)
FIRST_FORCE = 0.06
"""N; below it the area is not trained on."""
MIDDLE_COUNT = 1.5
"""How much a run of the middle box counts beside one of the rest."""
DECAY = 0.1


def stiffening_of(run: Run) -> float:
    """Stiffening b of a run's law, from its context."""
    share = run.context[CONTEXT.index("stiffening")]
    return MIDDLE_STIFFENING * share / (1.0 - share)


def load_over_largest(run: Run) -> np.ndarray:
    """Forces (n,) over the largest that the model is used for."""
    soft, stiffening = LARGEST_LOAD
    return run.force / (run.scale * run.share * soft * (1.0 + stiffening * stiffening_of(run)))


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


def padded(runs: list[Run], columns: Callable[[Run], tuple[np.ndarray, ...]]) -> Rows:
    """Rows of all runs; `columns` gives inputs (n, i), targets (n, o), weights (n, o) of one."""
    parts = [columns(run) for run in runs]
    longest = max(len(part[0]) for part in parts)
    arrays = []
    for which in range(3):
        values = np.zeros((len(runs), longest, parts[0][which].shape[1]), np.float32)
        for index, part in enumerate(parts):
            values[index, : len(part[which])] = part[which]
        arrays.append(values)
    return Rows(np.array([run.context for run in runs], np.float32), *arrays)


def _inputs(run: Run, states: np.ndarray | None = None) -> np.ndarray:
    x = load_measure_of(run)
    if states is None:
        return features(x, run.internal[:, :LATENTS], None, np.zeros((len(x), 0)))
    k = LATENTS
    return features(x, states[:, :k], states[:, k:], np.zeros((len(x), 0)))


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


def _exact_states(run: Run) -> np.ndarray:
    """a and q (n, k + m) of the full order itself."""
    return np.column_stack([run.internal[:, :LATENTS], friction_states(run)])


class Correction:
    """What the default mesh says more than the coarse one: ln area, ln peak ratio, δ/L."""

    def __init__(self, pairs: list[tuple[Run, Run]], epochs: int, report) -> None:
        fine = {id(coarse): other for coarse, other in pairs}

        def columns(run: Run) -> tuple[np.ndarray, ...]:
            other = fine[id(run)]
            rows = min(len(run.time), len(other.time))
            inputs = _inputs(run, _exact_states(run))
            ends = [r.indentation[:rows, None] / r.length for r in (run, other)]
            contact = _contact_targets(other)[:rows] - _contact_targets(run)[:rows]
            targets = np.column_stack([contact, ends[1] - ends[0]])
            on = (_touching(run)[:rows] & _touching(other)[:rows]).astype(float)
            on *= counts(run)[:rows]
            share = on * run.area[:rows] / run.area.max()
            depth = counts(run)[:rows] / max(run.indentation.max() / run.length, 0.03)
            return inputs[:rows], targets, np.column_stack([share, 0.3 * share, depth])

        rows = padded([coarse for coarse, _ in pairs], columns)
        self.network = ContextNetwork(rows, *CORRECTION)
        fit(self.network, rows, epochs, batch=32, decay=1.0, rate=2e-3, report=report)

    def __call__(self, runs: list[Run]) -> list[np.ndarray]:
        """Corrections (n, 3) of runs."""

        def columns(run: Run) -> tuple[np.ndarray, ...]:
            inputs = _inputs(run, _exact_states(run))
            empty = np.zeros((len(inputs), 3))
            return inputs, empty, empty

        found = self.network.outputs(padded(runs, columns))
        return [values[: len(run.time)] for values, run in zip(found, runs)]


def train(
    runs: list[Run], pairs: list[tuple[Run, Run]], epochs: int, report: Progress
) -> dict[str, np.ndarray]:
    """Arrays of the population's maps.

    runs: on the coarse mesh; pairs: of some of them, with the run on the default mesh.
    """
    correct = Correction(pairs, epochs, lambda share: report("training the correction", share))
    corrections = {id(run): values for run, values in zip(runs, correct(runs))}

    def drive_columns(run: Run) -> tuple[np.ndarray, ...]:
        depth = run.indentation / run.length + corrections[id(run)][:, 2]
        depth[run.force <= 0] = run.indentation[run.force <= 0] / run.length
        scale = strain_scales(load_measure_of(run), run.internal[:, :LATENTS])
        targets = drive_targets(depth, (run.total - run.internal)[:, :LATENTS], scale)
        # Errors count somewhat more than in proportion to the strain: early ones stay in the state.
        share = scale / scale.max()
        weights = np.repeat((counts(run) * share**0.5)[:, None], 1 + LATENTS, axis=1)
        weights[:, 0] = 2.0 * counts(run) * share ** (2 / 3)
        weights[scale < 1e-4] = 0.0
        return _inputs(run), targets, weights

    rows = padded(runs, drive_columns)
    drive = ContextNetwork(rows, *DRIVE)
    fit(drive, rows, epochs, 128, decay=DECAY, report=lambda s: report("training the drive", s))

    def contact_rows(states: dict[int, np.ndarray]) -> Rows:
        def columns(run: Run) -> tuple[np.ndarray, ...]:
            share = counts(run) * run.area / run.area.max() * _touching(run)
            targets = _contact_targets(run) + corrections[id(run)][:, :2]
            weights = np.column_stack([share, 0.1 * share])
            return _inputs(run, states[id(run)]), targets, weights

        return padded(runs, columns)

    # States need a drive only: an untrained contact network takes its place.
    guess = {id(run): _exact_states(run) for run in runs}
    contact = ContextNetwork(contact_rows(guess), *CONTACT)
    maps = PopulationMaps(arrays_of(drive, contact))
    rows = contact_rows({id(run): visited(maps, run) for run in runs})
    contact = ContextNetwork(rows, *CONTACT)
    fit(contact, rows, epochs, 128, decay=DECAY, report=lambda s: report("training the contact", s))
    return arrays_of(drive, contact)


def arrays_of(drive: ContextNetwork, contact: ContextNetwork) -> dict[str, np.ndarray]:
    """As stored in the file of the reduced model."""
    found = {"betas": np.array(BETAS), "largest_load": np.array(LARGEST_LOAD)}
    for name, network in (("drive", drive), ("contact", contact)):
        for key, value in {**network.values, **network.scales}.items():
            found[f"{name}_{key}"] = np.asarray(value, dtype=float)
    return found


def visited(maps: PopulationMaps, run: Run) -> np.ndarray:
    """Amplitudes a and friction states q (n, k + m) that the maps visit along a run."""
    record = maps.parameters_of(run.length, run.scale, run.fractions, run.times, run.context)
    record["force_limit"] = np.inf
    state = maps.at_rest(record)
    table = np.zeros((len(run.time), maps.latents + len(BETAS)))
    before = run.time[0]
    for row, (time, force) in enumerate(zip(run.time, run.force)):
        rk.step(maps.networks, record, state, maps.work, time - before, force)
        table[row] = *state["amplitudes"][0], *state["friction"][0]
        before = time
    return table


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
        record = maps.parameters_of(run.length, run.scale, run.fractions, run.times, run.context)
        record["force_limit"] = run.scale * run.share * LARGEST_LOAD[0] * 10.0
        found = np.empty((len(run.time), 3))
        state = maps.at_rest(record)
        rk.follow(maps.networks, record, state, maps.work, run.time[0], run.time, run.force, found)
        values = zip(CONTEXT, run.context)
        named = f"L {run.length * 1e3:.1f} mm, E∞/E0 {run.share:.3f}, " + ", ".join(
            f"{name} {value:.2f}" for name, value in values
        )
        pair = error_along(run, found, counted, named)
        tables["whole"].pairs.append(pair)
        if run.middle:
            tables["middle"].pairs.append(pair)
    return tables
