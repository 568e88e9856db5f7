# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Global searches inside a box: brute-force grid, particle swarm, and the cross-checks.

All of them work on the logarithm of the parameters, evaluate every candidate of a round in one
batch and give the same bits for the same seed. A checkpoint keeps the candidates and costs of every
round, not the optimiser's state. To resume, the same seeded optimiser runs again with the recorded
costs, which restores its state exactly.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError
from finger_common.files import atomic_write, load_json

from ..interruption import found_something, interruptible
from .coordinates import Coordinates

Cost = Callable[[np.ndarray], np.ndarray]
Progress = Callable[[int, int, float, np.ndarray], None]
"""Called after each round with: round from 1, rounds in all, best cost, best parameters."""

LARGEST_GRID = 20_000
"""Candidates of a grid: laws of many parameters have fewer points along each."""
GRID_CHUNK = 125
"""Candidates of the grid per batch; between batches, progress is reported and Ctrl-C acts."""


class Stopped(Exception):
    """The search is to stop; raised by a progress callback (a cancelled action goal)."""


@dataclass
class Search:
    """What a search evaluated.

    candidates (R, C, N), costs (R, C) of R rounds with C candidates each; complete: all rounds were
    run; unsaved: why the checkpoint lacks the last rounds, empty where it holds all; resumed: how
    many rounds a checkpoint held already.
    """

    name: str
    candidates: np.ndarray
    costs: np.ndarray
    complete: bool = True
    unsaved: str = ""
    resumed: int = 0

    @property
    def best(self) -> tuple[np.ndarray, float]:
        """Parameters (N,) and cost of the best candidate."""
        flat = self.costs.reshape(-1)
        index = int(np.argmin(flat))
        return self.candidates.reshape(len(flat), -1)[index], float(flat[index])

    @property
    def convergence(self) -> np.ndarray:
        """Best cost (R,) up to each round."""
        return np.minimum.accumulate(self.costs.min(axis=1))


def grid_points(coordinates: Coordinates, number: int) -> np.ndarray:
    """Parameters (number^D, N), evenly spaced in the logarithm, both ends included; at least two
    along each of the D axes, and fewer than `number` where there would be more than
    LARGEST_GRID."""
    while number > 2 and number ** len(coordinates.box) > LARGEST_GRID:
        number -= 1
    axes = [np.linspace(low, high, number) for low, high in coordinates.box]
    return coordinates.parameters(np.array(list(itertools.product(*axes))))


def search_grid(
    cost: Cost, coordinates: Coordinates, number: int, progress: Progress | None = None
) -> Search:
    """Evaluate the whole grid; Ctrl-C or Stopped ends it with what was evaluated, if anything."""
    points = grid_points(coordinates, number)
    costs = np.full(len(points), np.inf)
    rounds = range(0, len(points), GRID_CHUNK)
    complete = False
    try:
        with interruptible():
            for count, start in enumerate(rounds, 1):
                part = slice(start, start + GRID_CHUNK)
                costs[part] = cost(points[part])
                if np.isfinite(costs[part]).any():
                    found_something()
                if progress is not None:
                    best = int(np.argmin(costs))
                    progress(count, len(rounds), float(costs[best]), points[best])
            complete = True
    except (KeyboardInterrupt, Stopped):
        if not np.isfinite(costs).any():
            raise
    return Search("grid", points[:, None], costs[:, None], complete)


def best_points(search: Search, number: int) -> np.ndarray:
    """The `number` best candidates (number, N) of a search, best first; ties in order of
    evaluation."""
    costs = search.costs.reshape(-1)
    order = np.argsort(costs, kind="stable")[:number]
    return search.candidates.reshape(len(costs), -1)[order]


class _Pymoo:
    """A pymoo algorithm on the coordinates."""

    def __init__(self, algorithm: Any, box: np.ndarray, seed: int) -> None:
        from pymoo.core.problem import Problem
        from pymoo.core.termination import NoTermination

        self._problem = Problem(n_var=len(box), n_obj=1, xl=box[:, 0], xu=box[:, 1])
        self._algorithm = algorithm
        algorithm.setup(self._problem, termination=NoTermination(), seed=seed, verbose=False)

    def ask(self) -> np.ndarray:
        self._infills = self._algorithm.ask()
        return self._infills.get("X")

    def tell(self, costs: np.ndarray) -> None:
        from pymoo.core.evaluator import Evaluator
        from pymoo.problems.static import StaticProblem

        Evaluator().eval(StaticProblem(self._problem, F=costs[:, None]), self._infills)
        self._algorithm.tell(infills=self._infills)


class _Cma:
    """CMA-ES (Hansen) on the coordinates, scaled to the unit box."""

    def __init__(self, start: np.ndarray, box: np.ndarray, size: int, seed: int) -> None:
        import cma  # a second, as it imports matplotlib

        self._low, self._span = box[:, 0], box[:, 1] - box[:, 0]
        settings = {
            "bounds": [0.0, 1.0],
            "popsize": size,
            "seed": seed + 1,  # 0 would seed from the clock
            "verbose": -9,
            "verb_log": 0,
            "tolfun": 0.0,
            "tolx": 0.0,
            "tolfunhist": 0.0,
        }
        first = np.clip((start[0] - self._low) / self._span, 0.0, 1.0)
        self._strategy = cma.CMAEvolutionStrategy(first, 0.2, settings)

    def ask(self) -> np.ndarray:
        self._asked = self._strategy.ask()
        return self._low + self._span * np.array(self._asked)

    def tell(self, costs: np.ndarray) -> None:
        self._strategy.tell(self._asked, costs.tolist())


def _optimizer(name: str, start: np.ndarray, box: np.ndarray, seed: int) -> Any:
    """The optimiser from start points (C, D) in box (D, 2), with C candidates per round."""
    from pymoo.algorithms.soo.nonconvex.de import DE
    from pymoo.algorithms.soo.nonconvex.pso import PSO
    from pymoo.core.population import Population

    size = len(start)
    sampling = Population.new("X", start)
    if name == "pso":
        # Textbook settings: inertia 0.9, c1 = c2 = 2 to begin with, adapted as in Zhan et al. 2009.
        return _Pymoo(PSO(pop_size=size, sampling=sampling), box, seed)
    if name == "de":
        return _Pymoo(
            DE(pop_size=size, sampling=sampling, variant="DE/rand/1/bin", CR=0.9, F=0.7), box, seed
        )
    if name == "cmaes":
        return _Cma(start, box, size, seed)
    raise InputError(f"optimizer '{name}' is not known; choose pso, cmaes or de")


def search(
    name: str,
    cost: Cost,
    coordinates: Coordinates,
    start: np.ndarray,
    rounds: int,
    seed: int,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    key: str = "",
) -> Search:
    """Run an optimiser from parameters `start` (C, N) for `rounds` rounds of C candidates.

    name: "pso", "de" or "cmaes"; checkpoint: file of what was evaluated, written after every round;
    resume: take its rounds as done; key: names the data and options that the cost depends on.
    Ctrl-C, and Stopped from the progress callback, end the search with what was evaluated; a
    checkpoint that cannot be written does not. Raises InputError for a checkpoint of another
    search.
    """
    optimizer = _optimizer(name, coordinates.of(start), coordinates.box, seed)
    identity = {
        "optimizer": name,
        "seed": seed,
        "key": key,
        "box": coordinates.box.tolist(),
        "start": np.asarray(start).tolist(),
    }
    done_points, done_costs = _load(checkpoint, identity) if checkpoint and resume else ([], [])
    points: list[np.ndarray] = []
    costs: list[np.ndarray] = []
    complete, unsaved = False, ""
    try:
        with interruptible():
            for index in range(rounds):
                asked = coordinates.parameters(optimizer.ask())
                if index < len(done_points):
                    if not np.array_equal(asked, done_points[index]):
                        raise InputError(
                            f"{checkpoint}: round {index + 1} was made by another version of the "
                            "optimiser; start again without resume"
                        )
                    found = np.array(done_costs[index])
                else:
                    found = np.asarray(cost(asked), dtype=float)
                optimizer.tell(found)
                points.append(asked)
                costs.append(found)
                if checkpoint is not None and index >= len(done_points):
                    try:
                        _save(checkpoint, identity, points, costs)
                        unsaved = ""  # it holds all rounds
                    except (InputError, OSError) as error:
                        unsaved = str(error)
                if progress is not None:
                    best = Search(name, np.array(points), np.array(costs)).best
                    progress(index + 1, rounds, best[1], best[0])
            complete = True
    except (KeyboardInterrupt, Stopped):
        if not points:
            raise
    resumed = min(len(done_points), len(points))
    return Search(name, np.array(points), np.array(costs), complete, unsaved, resumed)


def _save(
    path: Path, identity: dict[str, Any], points: list[np.ndarray], costs: list[np.ndarray]
) -> None:
    # JSON keeps every digit of a float.
    with atomic_write(path) as file:
        json.dump(
            {
                **identity,
                "candidates": [p.tolist() for p in points],
                "costs": [c.tolist() for c in costs],
            },
            file,
        )


def _load(path: Path, identity: dict[str, Any]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    if not path.exists():
        return [], []
    try:
        data = load_json(path, "checkpoint")
        points = [np.array(p, dtype=float) for p in data["candidates"]]
        costs = [np.array(c, dtype=float) for c in data["costs"]]
        found = {key: data[key] for key in identity}
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path}: not a checkpoint; delete it or start without resume") from None
    if found != identity:
        raise InputError(
            f"{path}: checkpoint of another search (other data, seed, box or options); "
            "start again without resume"
        )
    return points, costs
