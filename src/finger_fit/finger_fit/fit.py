"""One condition's fit from grid to intervals, and a whole study from bags to files."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError
from finger_common.files import sha256_of
from finger_model.geometry import Geometry
from finger_model.parameter_sets import PARAMETER_NAMES

from . import identifiability
from .bias import Unbiased, bias_pair, unbiased
from .engine import DaskEngine, LocalEngine, engine_for
from .full_order_check import Correction, FullOrderCheck, check, correct
from .identifiability import QUANTITIES, Covariance, Profile
from .local import LocalFit, refine, whole_box
from .options import FitOptions
from .problem import MM4, FitProblem, PowerLaw, composite_modulus
from .search import Search, Stopped, best_points, search, search_grid
from .trials import SMALLEST_CONDITION, Exclusion, FitTrial, moisture_clusters, prepare_all

DISTINCT = 0.02
"""Candidates count as different when a parameter differs by this part."""

AGREEMENT = 0.02
"""A referee agrees when its polished J lies within this part of the fit's."""

Report = Callable[[str, str, int, int, float, np.ndarray], None]
"""Progress: condition, stage, round from 1, rounds, best J (m⁴), best parameters (4,); raises Stopped to end."""


@dataclass(frozen=True)
class Referee:
    """Another optimiser on the same problem: its own best, its J before and after the local polish."""

    name: str
    parameters: np.ndarray
    cost: float
    polished_cost: float
    agrees: bool


@dataclass
class ConditionFit:
    """Everything a fit of one condition found (SI, J in m⁴).

    parameters (4,): the result; cost: its J by the reduced model. pso: the search by itself; polish: what the local
    least squares added, None without. top (C, 4), top_costs (C,): best distinct candidates. status: "final", "not
    checked", "not final" or "interrupted", with reasons. unbiased: quantities without the bias of their estimates, empty without. samples
    (B, 4): bootstrap.
    """

    condition: str
    problem: FitProblem
    parameters: np.ndarray
    cost: float
    grid: Search
    pso: Search
    power_law: PowerLaw
    polish: LocalFit | None = None
    top: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))
    top_costs: np.ndarray = field(default_factory=lambda: np.empty(0))
    full_order: FullOrderCheck | None = None
    correction: Correction | None = None
    referees: list[Referee] = field(default_factory=list)
    covariance: Covariance | None = None
    profiles: dict[str, Profile] = field(default_factory=dict)
    unbiased: dict[str, Unbiased] = field(default_factory=dict)
    samples: np.ndarray | None = None
    status: str = "not checked"
    reasons: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def composite_E(self) -> float:
        """Composite modulus in Pa."""
        return float(composite_modulus(self.parameters))

    @property
    def moisture(self) -> tuple[float, float]:
        """Mean and standard deviation of the trials' moisture (a.u.)."""
        values = np.array([t.moisture for t in self.problem.trials])
        values = values[np.isfinite(values)]
        if not len(values):
            return float("nan"), float("nan")
        return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else 0.0

    def bootstrap_interval(self, name: str) -> tuple[float, float] | None:
        """Percentile interval, None without bootstrap."""
        if self.samples is None or not len(self.samples):
            return None
        return identifiability.bootstrap_interval(name, self.samples)

    def covariance_log(self) -> np.ndarray:
        """Covariance (4, 4) of the logarithms: of the bootstrap where there is one, else of the curvature."""
        if self.samples is not None and len(self.samples) > 10:
            return np.cov(np.log(self.samples).T)
        if self.covariance is not None:
            return self.covariance.covariance
        return np.zeros((4, 4))


def fit_condition(
    problem: FitProblem,
    options: FitOptions,
    condition: str = "",
    engine: LocalEngine | DaskEngine | None = None,
    geometry: Geometry | None = None,
    folder: Path | None = None,
    report: Report | None = None,
) -> ConditionFit:
    """Fit one condition: grid, PSO, polish, then what the options ask for.

    folder: for checkpoints, none are kept without. Ctrl-C (KeyboardInterrupt) and Stopped end the work; what was
    found so far comes back with status "interrupted".
    """
    engine = engine or LocalEngine()
    geometry = geometry or Geometry()
    seconds: dict[str, float] = {}
    best_so_far: list[Any] = [np.inf, np.full(4, np.nan)]

    def tell(stage: str, number: int, rounds: int, cost: float, best: np.ndarray) -> None:
        best_so_far[:] = [cost, best]
        if report is not None:
            report(condition, stage, number, rounds, cost, best)

    def progress_of(stage: str) -> Callable[[int, int, float, np.ndarray], None]:
        return lambda number, rounds, cost, best: tell(stage, number, rounds, cost, best)

    def count_of(stage: str) -> Callable[[int, int], None]:
        return lambda number, total: tell(stage, number, total, best_so_far[0], best_so_far[1])

    started = time.perf_counter()

    def lap(stage: str) -> None:
        nonlocal started
        now = time.perf_counter()
        seconds[stage] = seconds.get(stage, 0.0) + now - started
        started = now

    box = problem.box
    grid = search_grid(problem.cost, box, options.grid, progress_of("grid"))
    lap("grid")
    start = best_points(grid, options.particles)
    key = sha256_of([problem_key(problem), options.loss, options.huber_scale])
    checkpoint = None if folder is None else folder / f"checkpoint_{condition or 'all'}_pso.json"
    if grid.complete:
        pso = search(
            "pso", problem.cost, box, start, options.rounds, options.seed, checkpoint,
            options.resume, progress_of("pso"), key,
        )  # fmt: skip
    else:
        pso = Search("pso", grid.candidates[:1], grid.costs[:1], False)
    lap("pso")
    candidates = [grid, pso] if len(grid.candidates) else [pso]
    parameters, cost = min((s.best for s in candidates), key=lambda found: found[1])
    fit = ConditionFit(
        condition, problem, parameters, cost, grid, pso, problem.power_law(), seconds=seconds
    )
    lap("power law")
    if not (grid.complete and pso.complete):
        fit.status = "interrupted"
        fit.reasons = [
            f"interrupted in round {len(pso.costs)} of {options.rounds}" if grid.complete
            else "interrupted in the grid"
        ]  # fmt: skip
        fit.top, fit.top_costs = top_candidates(fit, options.top)
        return fit
    try:
        _after_search(
            fit, options, engine, geometry, start, key, folder, progress_of, count_of, lap
        )
    except (KeyboardInterrupt, Stopped):
        fit.status = "interrupted"
        fit.reasons = ["interrupted after the search; what follows it is incomplete"]
        if not len(fit.top):
            fit.top, fit.top_costs = top_candidates(fit, options.top)
    return fit


def _after_search(
    fit: ConditionFit,
    options: FitOptions,
    engine: LocalEngine | DaskEngine,
    geometry: Geometry,
    start: np.ndarray,
    key: str,
    folder: Path | None,
    progress_of: Callable[[str], Any],
    count_of: Callable[[str], Any],
    lap: Callable[[str], None],
) -> None:
    """Polish, referees, full order, covariance, profiles, bias, bootstrap; fills `fit`."""
    problem, box = fit.problem, fit.problem.box
    if options.polish:
        fit.polish = polish(problem, fit.parameters, fit.cost, start)
        if fit.polish.cost < fit.cost:
            fit.parameters, fit.cost = fit.polish.parameters, fit.polish.cost
        progress_of("polish")(1, 1, fit.cost, fit.parameters)
    lap("polish")
    for name in options.optimizer:
        if name == "pso":
            continue
        other = search(
            name, problem.cost, box, start, options.rounds, options.seed,
            None if folder is None else folder / f"checkpoint_{fit.condition or 'all'}_{name}.json",
            options.resume, progress_of(name), key,
        )  # fmt: skip
        found, cost = other.best
        polished = min(cost, refine(problem, whole_box(box), np.log(found)).cost)
        fit.referees.append(
            Referee(name, found, cost, polished, bool(abs(polished / fit.cost - 1) < AGREEMENT))
        )
        lap("referees")
    if options.full_order and options.correct:
        found_fit, fit.correction = correct(
            problem, fit.parameters, geometry, engine, done=count_of("full order")
        )
        fit.parameters, fit.cost = found_fit.parameters, found_fit.cost
        lap("full order")
    fit.top, fit.top_costs = top_candidates(fit, options.top)
    fit.covariance = identifiability.covariance(problem, fit.parameters)
    lap("sensitivities")
    if options.full_order:
        fit.full_order = check(problem, fit.top, geometry, engine, done=count_of("full order"))
        fit.reasons = fit.full_order.reasons
        fit.status = "not final" if fit.reasons else "final"
        lap("full order")
    if options.profiles:
        found_profiles = engine.map(
            _profile, (problem, fit.parameters, fit.cost, fit.covariance), QUANTITIES,
            count_of("profiles"),
        )  # fmt: skip
        fit.profiles = dict(zip(QUANTITIES, found_profiles))
        lap("profiles")
    if options.bias_pairs and (options.polish or fit.correction is not None):
        # What the swarm alone ends on is no minimum, and has no bias that refits could tell; polish and correction end on one.
        pairs = engine.map(
            _bias_pair, (problem, fit.parameters, options.seed), range(options.bias_pairs),
            count_of("bias"),
        )  # fmt: skip
        fit.unbiased = unbiased(fit.parameters, np.array(pairs))
        lap("bias")
    if options.bootstrap:
        samples = engine.map(
            _bootstrap, (problem, fit.parameters, options.seed), range(options.bootstrap),
            count_of("bootstrap"),
        )  # fmt: skip
        fit.samples = np.array(samples)
        lap("bootstrap")


def _profile(shared: Any, name: str) -> Profile:
    problem, best, cost, covariance = shared
    return identifiability.profile(problem, name, best, cost, covariance)


def _bias_pair(shared: Any, index: int) -> np.ndarray:
    problem, best, seed = shared
    return bias_pair(problem, best, seed, index)


def _bootstrap(shared: Any, index: int) -> np.ndarray:
    problem, best, seed = shared
    return identifiability.bootstrap_sample(problem, best, seed, index)


def polish(
    problem: FitProblem, parameters: np.ndarray, cost: float, starts: np.ndarray
) -> LocalFit:
    """Bounded least squares from the best candidate and from the best two grid points: the valley of J can have
    more than one low place, mostly at the bounds."""
    box = whole_box(problem.box)
    found = [refine(problem, box, np.log(parameters))]
    found += [refine(problem, box, np.log(point)) for point in starts[:2]]
    best = min(found, key=lambda fit: fit.cost)
    spent = sum(fit.evaluations for fit in found)
    return LocalFit(best.free, best.parameters, best.cost, spent)


def top_candidates(fit: ConditionFit, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Best distinct candidates (≤ number, 4) of polish, PSO and grid, and their J, best first."""
    points = [fit.parameters[None], fit.pso.candidates.reshape(-1, 4)]
    costs = [np.array([fit.cost]), fit.pso.costs.reshape(-1)]
    points.append(best_points(fit.grid, 50))
    costs.append(np.sort(fit.grid.costs.reshape(-1), kind="stable")[:50])
    all_points, all_costs = np.concatenate(points), np.concatenate(costs)
    if fit.correction is not None:
        # The search knew the uncorrected areas.
        keep = np.argsort(all_costs[1:], kind="stable")[:200] + 1
        all_points = np.concatenate([all_points[:1], all_points[keep]])
        all_costs = np.concatenate([all_costs[:1], fit.problem.cost(all_points[1:])])
    chosen: list[int] = []
    for index in np.argsort(all_costs, kind="stable"):
        if not np.isfinite(all_costs[index]):
            break
        apart = np.abs(np.log(all_points[chosen] / all_points[index])).max(axis=1)
        if np.all(apart > DISTINCT):
            chosen.append(int(index))
        if len(chosen) == number:
            break
    return all_points[chosen], all_costs[chosen]


def problem_key(problem: FitProblem) -> str:
    """Hash of what a cost depends on: frames, drive, weights, model."""
    parts = [problem.measured.tobytes(), problem.weight.tobytes()]
    for trial in problem.trials:
        parts += [trial.time.tobytes(), trial.force.tobytes(), trial.frames.tobytes()]
    parts.append(str(getattr(problem.model, "hash", "")).encode())
    return sha256_of(b"".join(parts))


# From bags to results ------------------------------------------------------------------------


@dataclass
class FitReport:
    """A whole fit: conditions in order of moisture, exclusions, where things came from, time spent."""

    options: FitOptions
    fits: dict[str, ConditionFit]
    exclusions: list[Exclusion]
    problems: list[str] = field(default_factory=list)
    sources: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    shared: Any = None
    thickness: Any = None
    force_modes: dict[str, dict[str, Any]] = field(default_factory=dict)
    output: Path | None = None

    @property
    def interrupted(self) -> bool:
        """Whether any condition was cut short."""
        return any(fit.status == "interrupted" for fit in self.fits.values())


def group_trials(
    trials: Sequence[FitTrial], options: FitOptions, conditions: Sequence[str] = ()
) -> tuple[dict[str, list[FitTrial]], list[str]]:
    """Trials by condition in order of moisture, and what was done about missing conditions, in words.

    Raises InputError when a condition asked for does not occur or nothing is left.
    """
    from dataclasses import replace

    notes: list[str] = []
    nameless = [t for t in trials if not t.condition]
    named = [t for t in trials if t.condition]
    usable = [t for t in nameless if np.isfinite(t.moisture)]
    if nameless and not usable:
        named += [replace(t, condition="all") for t in nameless]
        notes.append(
            f"{len(nameless)} trials carry neither condition nor moisture: one group 'all'"
        )
    elif usable:
        labels = moisture_clusters(np.array([t.moisture for t in usable]), options.clusters)
        number = int(labels.max()) + 1
        names = (
            ["dry", "natural", "moist"] if number == 3
            else [f"moisture {k + 1}" for k in range(number)]
        )  # fmt: skip
        named += [replace(t, condition=names[k]) for t, k in zip(usable, labels)]
        notes.append(
            f"{len(usable)} trials carry no condition: grouped into {number} moisture clusters "
            f"({', '.join(names)})"
        )
    groups: dict[str, list[FitTrial]] = {}
    for trial in named:
        groups.setdefault(trial.condition, []).append(trial)
    for name in conditions:
        if name not in groups:
            known = ", ".join(groups) or "none"
            raise InputError(f"condition '{name}' does not occur in the bags; they hold {known}")
    if conditions:
        groups = {name: group for name, group in groups.items() if name in conditions}
    if not groups:
        raise InputError("no trial is left to fit; see the exclusions in the report")

    def wetness(item: tuple[str, list[FitTrial]]) -> float:
        values = [t.moisture for t in item[1] if np.isfinite(t.moisture)]
        return float(np.mean(values)) if values else np.inf

    return dict(sorted(groups.items(), key=wetness)), notes


def fit_records(
    records: Sequence[Any],
    model: Any,
    options: FitOptions,
    conditions: Sequence[str] = (),
    folder: Path | None = None,
    report: Report | None = None,
    geometry: Geometry | None = None,
) -> FitReport:
    """Fit recorded trials, condition by condition. Raises InputError when nothing can be fitted."""
    trials, exclusions = prepare_all(records, options)
    if not trials:
        reasons = "; ".join(f"{e.label}: {e.reason}" for e in exclusions[:3])
        raise InputError(f"no trial can be fitted ({reasons or 'the bags hold none'})")
    groups, notes = group_trials(trials, options, conditions)
    fits: dict[str, ConditionFit] = {}
    with engine_for(options.dask) as engine:
        for name, group in groups.items():
            if len(group) < SMALLEST_CONDITION:
                notes.append(
                    f"condition '{name}' has {len(group)} trials, {SMALLEST_CONDITION} are needed: not fitted"
                )
                continue
            problem = FitProblem(group, model, options)
            fits[name] = fit_condition(problem, options, name, engine, geometry, folder, report)
            if fits[name].status == "interrupted":
                break
        if not fits:
            raise InputError(f"no condition can be fitted ({'; '.join(notes)})")
        result = FitReport(options, fits, exclusions, notes)
        if not result.interrupted:
            _further(result, records, model, geometry or Geometry(), engine)
    return result


def _further(
    result: FitReport,
    records: Sequence[Any],
    model: Any,
    geometry: Geometry,
    engine: LocalEngine | DaskEngine,
) -> None:
    """The other force mode, and the fits that were asked for beyond the four parameters."""
    from .further_fits import shared_fit, thickness_fit

    options = result.options
    started = time.perf_counter()
    for name, fit in result.fits.items():
        result.force_modes[name] = force_modes(fit, records, model, options)
    result.seconds["other force mode"] = time.perf_counter() - started
    if options.shared and len(result.fits) > 1:
        result.shared = shared_fit(
            {name: fit.problem for name, fit in result.fits.items()},
            {name: fit.parameters for name, fit in result.fits.items()},
            options.shared,
        )
    if options.extra == "epidermis_thickness":
        started = time.perf_counter()
        result.thickness = {
            name: thickness_fit(fit.problem, fit.parameters, geometry, engine)
            for name, fit in result.fits.items()
        }
        result.seconds["thickness"] = time.perf_counter() - started


def force_modes(
    fit: ConditionFit, records: Sequence[Any], model: Any, options: FitOptions
) -> dict[str, dict[str, float]]:
    """J (mm⁴) and composite E (Pa) with the force at its full rate and as in the paper, refitted locally."""
    from dataclasses import replace

    other = "paper" if options.force == "full" else "full"
    out = {options.force: {"J": fit.cost * MM4, "composite_E": fit.composite_E}}

    def identity(trial: FitTrial) -> tuple[str, bytes]:
        # Names of trials may recur from condition to condition; the measured areas do not.
        return trial.label, trial.area.tobytes()

    wanted = {identity(trial) for trial in fit.problem.trials}
    trials, _ = prepare_all(records, replace(options, force=other))
    problem = FitProblem([t for t in trials if identity(t) in wanted], model, options)
    if len(problem.measured) == len(fit.problem.measured):
        problem.correction = fit.problem.correction
    found = refine(problem, whole_box(problem.box), np.log(fit.parameters), tolerance=1e-5)
    out[other] = {
        "J": found.cost * MM4,
        "composite_E": float(composite_modulus(found.parameters)),
    }
    return out


def parameter_vector(fit: ConditionFit) -> dict[str, float]:
    """E0, E1, tau1, E2 by name (SI)."""
    return dict(zip(PARAMETER_NAMES, map(float, fit.parameters)))


def fit_bags(
    paths: Sequence[str | Path],
    options: FitOptions | None = None,
    output: str | Path | None = None,
    conditions: Sequence[str] = (),
    model: Any = None,
    report: Report | None = None,
    normal_axis: str | None = None,
    calibration: str | None = None,
    mapping: str | Path | None = None,
) -> FitReport:
    """Fit bags and write fit.json, parameters.yaml, report.html and its figures into `output`.

    paths: bags and folders of bags; model: a ReducedModel, None for the shipped one; conditions: names to fit,
    empty for all. Nothing is written without `output`. Raises InputError for bags that cannot be fitted.
    """
    from finger_bag.schema import software_version
    from finger_model.reduced import ReducedModel

    from . import output as files
    from .loading import load

    options = options or FitOptions()
    model = model or ReducedModel.load()
    folder = None if output is None else Path(output)
    began = time.perf_counter()

    def loading(number: int, total: int, bag: Path) -> None:
        if report is not None:
            report("", "load", number, total, float("nan"), np.full(4, np.nan))

    loaded = load(paths, options, normal_axis, calibration, loading, mapping)
    load_seconds = time.perf_counter() - began
    geometry = model.geometry
    if not loaded.records:
        reasons = "; ".join(f"{e.label}: {e.reason}" for e in loaded.exclusions[:3])
        raise InputError(f"no trial can be fitted ({reasons or 'the bags hold none'})")
    result = fit_records(loaded.records, model, options, conditions, folder, report, geometry)
    result.exclusions = [*loaded.exclusions, *result.exclusions]
    result.problems = [*loaded.problems, *result.problems]
    result.sources = {
        "bags": loaded.sources,
        "geometry_hash": model.geometry_hash,
        "reduced_model_hash": model.hash,
        "reduced_model_error": model.measured_error,
        "software_version": software_version(),
    }
    result.seconds["load"] = load_seconds
    for fit in result.fits.values():
        for stage, spent in fit.seconds.items():
            result.seconds[stage] = result.seconds.get(stage, 0.0) + spent
    result.output = folder
    if folder is not None:
        files.write(result, folder)
        before = time.perf_counter()
        _tell_writing(report, 0)
        from .report import write_report

        write_report(result, folder)
        result.seconds["report"] = time.perf_counter() - before
        files.write(result, folder)
        _tell_writing(report, 1)
    return result


def _tell_writing(report: Report | None, done: int) -> None:
    """Progress of the report; a fit told to stop still writes what it found."""
    if report is not None:
        with contextlib.suppress(Stopped):
            report("", "report", done, 1, float("nan"), np.full(4, np.nan))
