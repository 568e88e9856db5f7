"""What the errors of a rig do to a fit, with nuisance parameters and without.

    python scripts/nuisance_table.py [--seeds 20] [--cases "lag +80 ms;none"] [--processes 2]
        [--output DIR] [--write]
    python scripts/nuisance_table.py --misfit [--seeds 10] [--write]

Simulated presses with known truth: the reduced model makes the areas and fits them, so that the
bias is that of the error alone (the bias of the reduced model itself: scripts/recovery.py). What
another epidermis does to the true areas comes from the full-order model; the fit knows it from the
reduced model of all fingers. Every seed gives the same presses new noise. "scatter" cases: gains
of whole presses so large that the power law's J is the published one; "by images": their areas are
rendered as FTIR frames and measured by vision. "all" draws every error from its prior.

`--misfit` takes fingers that the fit's model does not hold instead: another tissue (by the reduced
model of all fingers), another pad or a tilted plate (areas times the ratio of two runs of the
three-dimensional model), and CalculiX's elastic curves as areas, which are fitted corrected to full
order.

Columns: mean error of E; mean standard deviation that the fits state; the larger goal, 3 % or half
of it; share of 95 % intervals that hold the truth. Writes nuisances.json, from which a stopped run
goes on, and with --write the table of docs/nuisance_parameters.md, or with --misfit that of
docs/study.md. One fit takes 3 s of a core, one by images 8 s more, one corrected to full order a
minute.
"""

from __future__ import annotations

import argparse
import json
import math
import pickle
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numba
import numpy as np
from doc_tables import replace_between
from scipy.optimize import brentq

from finger_common.files import atomic_write
from finger_common.processes import worker_pool
from finger_common.usable_press import TYPICAL_AREA_NOISE
from finger_fit.engine import LocalEngine
from finger_fit.full_order import FullOrder, correct
from finger_fit.nuisance.estimate import NuisanceModel
from finger_fit.nuisance.geometry import (
    FullOrderGeometry,
    PopulationGeometry,
    Response,
    geometry_responses,
)
from finger_fit.options import FitOptions
from finger_fit.problem import FitProblem, fit_power_law, prepare_all
from finger_fit.report_units import MM4
from finger_fit.search import all_free, refine
from finger_fit.uncertainty import covariance, in_interval
from finger_model.geometry import Geometry
from finger_model.laws import MaxwellLaw, StandardLinearSolid, from_branches
from finger_model.paper import CONDITIONS, FRICTION, TRIALS_PER_CONDITION
from finger_model.pose.pose import Pose
from finger_model.reduced import ReducedModel
from finger_model.reduced.model import load_population
from finger_model.solid3d.full_order import SolidModel
from finger_model.verification.cases import CALCULIX_FINGER, reference
from finger_sim.conditions import STUDY
from finger_sim.ftir import Contact
from finger_sim.press import Press, plan_press
from finger_sim.study_bag import START_NS, VIEW
from finger_sim.study_trial import (
    FORCE_NOISE,
    FORCE_RATE,
    FORCE_RESOLUTION,
    FRAME_RATE,
    stream,
)
from finger_sim.trial_plan import PLACEMENT_SD, renderer_for
from finger_vision.area_sensor import AREA_SENSORS

SPACE = StandardLinearSolid.PARAMETERS
QUANTITIES = ("composite_E", "E2", "tau1")
PRESS_SEED = 1
STEP = 0.04
PUBLISHED_J = {name: found.power_law_cost * MM4 for name, found in CONDITIONS.items()}
"""mm⁴, of the power law (the paper)."""

DOCS = Path(__file__).parents[1] / "docs"


@dataclass(frozen=True)
class Rig:
    """Errors of one study (SI; gains and lengths as logarithms).

    rest: whether the record holds the unloaded plate; scatter: of the presses' gains; images:
    whether areas are measured in rendered frames; collapse: share of the area that the hull loses
    at 0 N; trials: presses; tissue: another material law or
    constant than the fit assumes, a key of `TISSUES`; shape: another pad or plate, a key of
    `SHAPES`; curve: areas of another program, a key of `CURVES`.
    """

    tare: float = 0.0
    lag: float = 0.0
    gain: float = 0.0
    collapse: float = 0.0
    thickness: float = 0.0
    scatter: float = 0.0
    rest: bool = True
    trials: int = TRIALS_PER_CONDITION
    drawn: bool = False
    images: bool = False
    tissue: str = ""
    shape: str = ""
    curve: str = ""


def _tissue(
    material: MaxwellLaw, times: Sequence[float] = (), stiffening: float = 0.0
) -> MaxwellLaw:
    """The same E0, E2 and long-term modulus, relaxing in equal parts by other times (s)."""
    branches = [{"fraction": b.fraction, "tau": b.relaxation_time} for b in material.branches]
    if times:
        part = (1.0 - material.long_term_fraction) / len(times)
        branches = [{"fraction": part, "tau": tau} for tau in times]
    own = {"E0": material.instantaneous_modulus, "E2": dict(material.to_dict())["E2"]}
    return from_branches({**own, "stiffening": stiffening, "branches": branches}, "tissue")


TISSUES: dict[str, Callable[[Any], Any]] = {
    "tissue that stiffens (b = 5)": lambda material: _tissue(material, stiffening=5.0),
    "two relaxation times, 0.1 and 1.5 s": lambda material: _tissue(material, (0.1, 1.5)),
    "friction 0.5 for 0.25": lambda material: replace(material, friction=0.5),
}
"""Deviations of the true finger from the law that is fitted, by the reduced model of all
fingers."""


def _narrower(factor: float) -> Geometry:
    """The default finger with its lengths across the axis divided by a factor."""
    found = Geometry()
    names = ("pad_semi_axis_radial", "bone_semi_axis_radial", "nail_radius")
    return replace(found, **{name: getattr(found, name) / factor for name in names})


SHAPES: dict[str, tuple[Pose, Geometry]] = {
    "pad 1.3 times as long as wide, given width": (Pose(1.3), Geometry()),
    "pad 1.3 times as long as wide, given area": (Pose(1.3), _narrower(math.sqrt(1.3))),
    "plate tilted by 10°": (Pose(pitch=math.radians(10.0)), Geometry()),
    "plate tilted by 20°": (Pose(pitch=math.radians(20.0)), Geometry()),
}
"""True pads and plates by the three-dimensional model. The fit assumes the default round pad,
pressed straight: it has the width of the true one, or the same area seen from below. Both sides of
the ratio have the friction of the fit, but none under a tilted plate, where the model does not
always converge with friction."""

LEVELS = np.array([0.1, 0.15, 0.2, 0.3, 0.45, 0.65, 0.9, 1.15, 1.35])
"""N, at which the three-dimensional model is solved; below 0.1 N its mesh is too coarse."""


class Curve(NamedTuple):
    """An elastic curve of another program: file and columns of `verification.cases.reference`,
    composite E (Pa), friction, and the target force (N) that its rows allow."""

    file: str
    force: str
    area: str
    modulus: float
    friction: float
    target: float


CURVE_E2 = 1652e3
"""Pa, of all curves."""

CURVES = {
    "CalculiX": Curve("dry_friction", "force_N", "area_mm2", 30e3, FRICTION, 1.35),
    "CalculiX, no friction": Curve("dry_frictionless", "force_N", "area_mm2", 30e3, 0.0, 1.35),
    "CalculiX, pad 1.35 times as long": Curve(
        "ellipse_135", "normal_force_n", "area_mm2", 30.23e3, 0.0, 1.1
    ),
    "CalculiX, plate tilted by 20°": Curve(
        "tilt_20deg", "normal_force_n", "area_mm2", 30.23e3, 0.0, 1.0
    ),
}
"""Curves of CalculiX 2.20 on the finger `CALCULIX_FINGER`, which the fit assumes."""


CASES: dict[str, tuple[str, Rig]] = {
    "none": ("natural", Rig()),
    **{f"tare {v:+.2f} N": ("natural", Rig(tare=v)) for v in (-0.05, -0.02, 0.02, 0.05)},
    **{
        f"tare {v:+.2f} N, no rest recorded": ("natural", Rig(tare=v, rest=False))
        for v in (-0.05, -0.02, 0.02, 0.05)
    },
    **{f"lag {1e3 * v:+.0f} ms": ("natural", Rig(lag=v)) for v in (-0.03, -0.01, 0.01, 0.03, 0.08)},
    **{f"area {100 * v:+.0f} %": ("natural", Rig(gain=float(np.log1p(v)))) for v in (-0.06, 0.06)},
    "hull loses 30 % at 0 N": ("natural", Rig(collapse=0.3)),
    **{
        f"epidermis {100 * v:+.0f} %": ("natural", Rig(thickness=float(np.log1p(v))))
        for v in (-0.25, 0.25)
    },
    "all, drawn from the priors": ("natural", Rig(scatter=0.05, drawn=True)),
    "all, no rest recorded": ("natural", Rig(scatter=0.05, drawn=True, rest=False)),
    "three presses": ("natural", Rig(trials=3)),
    **{f"published J, {name}": (name, Rig(scatter=-1.0)) for name in PUBLISHED_J},
    **{
        f"published J, {name}, by images": (name, Rig(scatter=-1.0, images=True))
        for name in PUBLISHED_J
    },
    "published J, natural, three presses": ("natural", Rig(scatter=-1.0, trials=3)),
}


MISFITS: dict[str, tuple[str, Rig]] = {
    **{name: ("natural", Rig(tissue=name)) for name in TISSUES},
    **{name: ("natural", Rig(shape=name)) for name in SHAPES},
    **{name: ("natural", Rig(curve=name, trials=5)) for name in CURVES},
}
"""Fingers that the fit's model does not hold."""


@cache
def model() -> ReducedModel:
    return ReducedModel.load()


@cache
def press(name: str, index: int) -> tuple[Press, np.ndarray, np.ndarray]:
    """A press, its frame times (k,) in s and true areas (k,) in m²."""
    drawn = plan_press(stream(PRESS_SEED, name, index, "press"))
    phase = stream(PRESS_SEED, name, index, "camera").uniform(0.0, 1.0 / FRAME_RATE)
    frames = np.arange(phase, drawn.duration, 1.0 / FRAME_RATE)
    knots = np.union1d(drawn.time[::5], frames)
    force = np.interp(knots, drawn.time, drawn.force)
    rows = np.searchsorted(knots, frames)
    truth = STUDY[name].material.vector()
    area = model().batch(truth, [(knots, force, rows)])[0][0]
    return drawn, frames, np.where(force[rows] > 0, area, 0.0)


@cache
def tissue_factor(name: str, index: int, tissue: str) -> np.ndarray:
    """Area (k,) of a press by another tissue over that by the tissue of the fit's law."""
    drawn, frames, _ = press(name, index)
    knots = np.union1d(drawn.time[::5], frames)
    force = np.interp(knots, drawn.time, drawn.force)
    drive = (knots, force, np.searchsorted(knots, frames))
    areas = []
    for material in (TISSUES[tissue](STUDY[name].material), STUDY[name].material):
        found = load_population(model().geometry).for_material(material)
        areas.append(found.batch(material.vector()[None], [drive])[0][0])
    return np.where(areas[1] > 0, areas[0] / np.maximum(areas[1], 1e-12), 1.0)


def shape_answer(shape: str, folder: Path | None = None) -> Response:
    """How the logarithm of the area of natural presses answers to a shape of `SHAPES`; made once
    and kept in `folder`.

    The shortest and the longest press are solved, with the true pad and with the fit's.
    """
    path = None if folder is None else folder / f"shape_{list(SHAPES).index(shape)}.pickle"
    if path is not None and path.exists():
        return pickle.loads(path.read_bytes())
    drawn = [press("natural", i)[0] for i in range(TRIALS_PER_CONDITION)]
    drawn.sort(key=lambda p: p.cue - p.onset)
    ends = [drawn[0], drawn[-1]]
    slopes = []
    pose, geometry = SHAPES[shape]
    material = STUDY["natural"].material
    if pose.tilt > 0:
        material = replace(material, friction=0.0)
    for one in ends:
        true = _solid_areas(one, material, pose, geometry)
        fit = _solid_areas(one, material, Pose(), Geometry())
        slopes.append(np.polyfit(np.log(LEVELS), np.log(true / fit), 2))
    found = Response(np.array([p.cue - p.onset for p in ends]), np.array(slopes))
    if path is not None:
        with atomic_write(path, "wb") as file:
            pickle.dump(found, file)
    return found


_solid: dict[tuple[Any, ...], np.ndarray] = {}
"""Areas that were solved for in this process."""


def _solid_areas(
    one: Press, material: StandardLinearSolid, pose: Pose, geometry: Geometry
) -> np.ndarray:
    """Areas (k,) in m² at `LEVELS` of a press, in three dimensions."""
    key = (one.cue, material.friction, pose, geometry)
    if key not in _solid:
        reached = np.maximum.accumulate(one.force)
        rows = np.searchsorted(reached, LEVELS)
        time = np.concatenate([[one.onset], one.time[rows]])
        stepper = SolidModel(geometry, pose).start(material, float(time[0]))
        steps = zip(time[1:], LEVELS)
        _solid[key] = np.array([stepper.step(float(t), float(f)).area for t, f in steps])
    return _solid[key]


def curve_area(curve: Curve, force: np.ndarray) -> np.ndarray:
    """Areas (k,) in m² under forces (k,) in N: a cubic in both logarithms through the rows."""
    table = reference(curve.file)
    rows = np.log(table[curve.force]), np.log(table[curve.area] * 1e-6)
    area = np.exp(np.polyval(np.polyfit(*rows, 3), np.log(np.maximum(force, 0.02))))
    return np.where(force > 0, area, 0.0)


def finger_of(name: str, rig: Rig) -> tuple[ReducedModel, np.ndarray]:
    """The reduced model that the fit takes, and the true parameters (4,).

    An elastic curve has E0 and E1 of its composite E and no relaxation to speak of: τ1 is no part
    of the truth.
    """
    if not rig.curve:
        return model(), STUDY[name].material.vector()
    curve = CURVES[rig.curve]
    E0, tau1 = 100e3, SPACE["tau1"].bounds[0]
    truth = np.array([E0, 1.0 / (1.0 / curve.modulus - 1.0 / E0), tau1, CURVE_E2])
    material = StandardLinearSolid(friction=curve.friction)
    return load_population(CALCULIX_FINGER).for_material(material), truth


def published_scatter(name: str) -> float:
    """Scatter of the presses' gains at which the power law has the published J.

    A gain g = exp(z) adds mean(A²) (g − 1)² to a press's part of J.
    """
    squares = 0.0
    for index in range(TRIALS_PER_CONDITION):
        drawn, frames, area = press(name, index)
        squares += float((area[(area > 0) & (frames <= drawn.cue + 0.1)] ** 2).mean())

    def excess(s: float) -> float:
        gain = np.exp(2 * s * s) - 2 * np.exp(0.5 * s * s) + 1.0
        return squares * gain * MM4 - PUBLISHED_J[name]

    return float(brentq(excess, 1e-3, 1.0))


def record(
    name: str, index: int, rig: Rig, seed: int, answer: Response | None, options: FitOptions
) -> Any:
    """One press as a rig with these errors records it."""
    drawn, frames, area = press(name, index)
    rng = np.random.default_rng([seed, index, 17])
    time = np.arange(0.0, drawn.duration, 1.0 / FORCE_RATE)
    true = np.interp(time, drawn.time, drawn.force)
    force = true + rng.normal(0.0, FORCE_NOISE, len(time)) + rig.tare
    force = np.round(force / FORCE_RESOLUTION) * FORCE_RESOLUTION
    pressed = np.interp(frames, drawn.time, drawn.force)
    log = rig.gain + rig.scatter * rng.normal() + np.zeros(len(area))
    if answer is not None:
        duration, least = drawn.cue - drawn.onset, LEVELS[0] if rig.shape else 0.05
        place = np.log(np.maximum(pressed, least))
        own = [np.interp(duration, answer.durations, column) for column in answer.slope.T]
        log = log + np.polyval(own, place) * (1.0 if rig.shape else rig.thickness)
    if rig.tissue:
        area = area * tissue_factor(name, index, rig.tissue)
    if rig.curve:
        area = curve_area(CURVES[rig.curve], pressed)
    # A bow that the fit's straight line does not have.
    lost = 1.0 - rig.collapse * np.clip(1.0 - pressed / options.low_force, 0.0, 1.0) ** 0.7
    measured = area * np.exp(log) * lost
    if rig.images:
        areas, deviations, flags = by_images(name, index, seed, measured)
    else:
        noisy = np.maximum(measured + rng.normal(0.0, TYPICAL_AREA_NOISE, len(area)), 0.0)
        areas = np.where(area > 0, noisy, 0.0)
        deviations, flags = np.full(len(area), TYPICAL_AREA_NOISE), np.where(area > 0, 0, 1)
    inside, seen = np.ones(len(time), bool), np.ones(len(frames), bool)
    if not rig.rest:
        inside = (time > drawn.onset) & (time < drawn.lift_off)
        seen = (frames > drawn.onset) & (frames < drawn.lift_off)
    return SimpleNamespace(
        bag="rig",
        subject="SIM1",
        condition=name,
        index=index,
        stamp_ns=START_NS + np.round(time[inside] * 1e9).astype(np.int64),
        force=force[inside],
        area_stamp_ns=START_NS + np.round((frames[seen] + rig.lag) * 1e9).astype(np.int64),
        area=areas[seen],
        area_sd=deviations[seen],
        area_flags=flags[seen],
        moisture_before=[70.0],
        moisture_after=[70.0],
    )


def by_images(
    name: str, index: int, seed: int, area: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What vision measures of areas (k,) in m² that a camera sees: areas, deviations and flags."""
    renderer = renderer_for(name, VIEW, seed)
    chosen = {"area_sensor": AREA_SENSORS.default}
    sensor = AREA_SENSORS.open(chosen, renderer.calibration())
    place = stream(seed, name, index, "placement").normal(0.0, PLACEMENT_SD, 2)
    rows = []
    for radius in np.sqrt(area / math.pi):
        contact = Contact(float(radius), (float(place[0]), float(place[1])))
        found = sensor.process(renderer.render_frame([contact]).image)
        rows.append((found.gross_area, found.area_sd, found.flags))
    areas, deviations, flags = np.array(rows, dtype=float).T
    return areas, deviations, flags.astype(int)


def problem_of(name: str, rig: Rig, records: Sequence[Any], options: FitOptions) -> FitProblem:
    """Recorded presses, prepared."""
    if rig.curve:
        options = replace(options, target_force=CURVES[rig.curve].target)
    trials, _ = prepare_all(records, options)
    return FitProblem(trials, finger_of(name, rig)[0], options)


def responses_of(name: str, folder: Path | None) -> dict[str, Response]:
    """True answers of a condition's presses to the epidermis, computed once and kept."""
    path = None if folder is None else folder / f"epidermis_{name}.pickle"
    if path is not None and path.exists():
        return pickle.loads(path.read_bytes())
    options = FitOptions(step=STEP, geometry_sd=["calipers"])
    records = [record(name, i, Rig(), 0, None, options) for i in range(TRIALS_PER_CONDITION)]
    problem = problem_of(name, Rig(), records, options)
    better = FullOrderGeometry(FullOrder.like(model(), LocalEngine(1)))
    truth = STUDY[name].material.vector()
    found = geometry_responses(problem, truth, better, {"epidermis_thickness": 0.25})
    if path is not None:
        with atomic_write(path, "wb") as file:
            pickle.dump(found, file)
    return found


def drawn_rig(rig: Rig, options: FitOptions, rng: np.random.Generator) -> Rig:
    """A rig with its errors drawn from the priors."""
    lengths = options.lengths({})
    return replace(
        rig,
        tare=rng.normal(0.0, options.tare_sd),
        lag=rng.normal(0.0, options.lag_sd),
        gain=rng.normal(0.0, options.area_gain_sd),
        collapse=abs(rng.normal(0.0, options.collapse_sd)),
        thickness=rng.normal(0.0, lengths.get("epidermis_thickness", 0.0)),
    )


def fit_case(
    case: str, seed: int, responses: dict[str, Response], options: FitOptions | None = None
) -> dict[str, Any]:
    """One fit with nuisances and one without, of one case and seed, both from the truth.

    responses: true answers to the epidermis, or to "shape", needed where a case changes it.
    """
    name, rig = (CASES | MISFITS)[case]
    options = options or FitOptions(step=STEP, geometry_sd=["calipers"])
    if rig.scatter < 0:
        rig = replace(rig, scatter=published_scatter(name))
    if rig.drawn:
        rig = drawn_rig(rig, options, np.random.default_rng([seed, 29]))
    answer = responses.get("shape" if rig.shape else "epidermis_thickness")
    assumed, truth = finger_of(name, rig)
    out: dict[str, Any] = {"case": case, "seed": seed}
    records = [record(name, i, rig, seed, answer, options) for i in range(rig.trials)]
    plain = problem_of(name, rig, records, replace(options, nuisances=False))
    alone = refine(plain, all_free(plain), truth)
    problem = problem_of(name, rig, records, options)
    population = PopulationGeometry.like(assumed) if problem.lengths else None
    nuisances = NuisanceModel(problem, options, population=population)
    found = nuisances.settle(np.vstack([truth, alone.parameters]))
    if rig.curve:
        correct(problem, found.fit.parameters, FullOrder.like(assumed, LocalEngine(1)))
        found = nuisances.settle(found.fit.parameters[None])
    fit, known = found.fit, covariance(problem, found.fit.parameters)
    out |= {
        "J_power_law": fit_power_law(plain).cost * MM4,
        "scatter": found.scatter,
        "noise": found.noise,
        "active": known.active,
        "deviations": known.nuisance_deviations(),
        "budget": known.budget("composite_E"),
    }
    without = covariance(plain, alone.parameters)
    for q in QUANTITIES:
        true = float(SPACE.quantity(q, truth))
        out[q] = {
            "error": float(np.log(SPACE.quantity(q, fit.parameters) / true)),
            "deviation": known.deviation(q),
            "covered": in_interval(problem, q, true, fit.parameters, fit.cost, known),
            "error_without": float(np.log(SPACE.quantity(q, alone.parameters) / true)),
            "covered_without": in_interval(plain, q, true, alone.parameters, alone.cost, without),
        }
    return out


def answers_of(case: str, folder: Path | None) -> dict[str, Response]:
    """What `fit_case` needs for a case."""
    if case in CASES:
        return responses_of(CASES[case][0], folder)
    return {"shape": shape_answer(case, folder)} if case in SHAPES else {}


def _job(job: tuple[str, int, Path | None]) -> dict[str, Any]:
    case, seed, folder = job
    numba.set_num_threads(1)
    return fit_case(case, seed, answers_of(case, folder))


def run(folder: Path, seeds: int, wanted: Sequence[str], processes: int) -> list[dict[str, Any]]:
    """The cases `wanted`, seed after seed."""
    folder.mkdir(parents=True, exist_ok=True)
    cases = [c for c in CASES | MISFITS if c in wanted]
    for case in cases:
        answers_of(case, folder)
    path = folder / "nuisances.json"
    rows: list[dict[str, Any]] = json.loads(path.read_text()) if path.exists() else []
    known = {(row["case"], row["seed"]) for row in rows}
    jobs = [(c, s, folder) for s in range(seeds) for c in cases if (c, s) not in known]
    with ExitStack() as stack:
        each: Callable[..., Any] = map
        if processes > 1:
            each = stack.enter_context(worker_pool(processes, needs_main=True)).map
        for count, row in enumerate(each(_job, jobs), 1):
            rows.append(row)
            print(
                f"\r{row['case']}: {count}/{len(jobs)}      ", end="", file=sys.stderr, flush=True
            )
            with atomic_write(path) as file:
                json.dump(rows, file)
    print(file=sys.stderr)
    return [row for row in rows if row["case"] in cases and row["seed"] < seeds]


def summary(rows: Sequence[dict[str, Any]], q: str = "composite_E") -> dict[str, float]:
    """Bias, deviations and coverage of one quantity over the rows of a case."""
    found = {key: np.array([row[q][key] for row in rows], dtype=float) for key in rows[0][q]}
    number = len(rows)
    return {
        "bias": float(found["error"].mean()),
        "bias_error": float(found["error"].std(ddof=1) / np.sqrt(number)) if number > 1 else np.nan,
        "bias_without": float(found["error_without"].mean()),
        "deviation": float(found["deviation"].mean()),
        "spread": float(found["error"].std(ddof=1)) if number > 1 else np.nan,
        "coverage": float(found["covered"].mean()),
        "coverage_without": float(found["covered_without"].mean()),
    }


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The table of the page."""
    lines = [
        "| error | E without: bias | covered | E: bias (± its error) | spread | stated deviation | "
        "bias / deviation | E covered | E2 | τ1 | goal |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for case in CASES:
        part = [row for row in rows if row["case"] == case]
        if not part:
            continue
        found = summary(part)
        others = [f"{100 * summary(part, q)['coverage']:.0f} %" for q in ("E2", "tau1")]
        goal = abs(found["bias"]) <= max(0.03, 0.5 * found["deviation"])
        met = "met" if goal and found["coverage"] >= 0.9 else "missed"
        lines.append(
            f"| {case} | {100 * found['bias_without']:+.0f} % | "
            f"{100 * found['coverage_without']:.0f} % | "
            f"{100 * found['bias']:+.1f}{_or_none(found['bias_error'], ' ± {:.1f}')} % | "
            f"{_or_none(found['spread'], '{:.0f} %')} | {100 * found['deviation']:.0f} % | "
            f"{found['bias'] / found['deviation']:+.2f} | "
            f"{100 * found['coverage']:.0f} % | {others[0]} | {others[1]} | {met} |"
        )
    seeds = len({row["seed"] for row in rows})
    return "\n".join([*lines, "", f"{seeds} seeds, {len(rows)} fits."])


def misfit_table(rows: Sequence[dict[str, Any]]) -> str:
    """The table of fingers that the fit's model does not hold."""
    names = [SPACE.describe(q).symbol for q in QUANTITIES]
    header = ["true finger", "seeds", "residual (mm²)"]
    for name in names:
        header += [f"{name}: bias", "stated deviation", "covered"]
    lines = [f"| {' | '.join(header)} |", "|---" * len(header) + "|"]
    for case, (_, rig) in MISFITS.items():
        part = [row for row in rows if row["case"] == case]
        if not part:
            continue
        noise = float(np.mean([row["noise"] for row in part]))
        cells = [case, str(len(part)), f"{noise * 1e6:.2f}"]
        for q in QUANTITIES:
            found = summary(part, q)
            told = q != "tau1" or not rig.curve
            covered = "yes" if found["coverage"] else "no"
            cells += [
                f"{100 * math.expm1(found['bias']):+.0f} %",
                f"{100 * found['deviation']:.0f} %",
                f"{100 * found['coverage']:.0f} %" if len(part) > 1 else covered,
            ] if told else ["–"] * 3  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _or_none(value: float, form: str) -> str:
    """A share in percent; nothing where one seed gives none."""
    return form.format(100 * value) if np.isfinite(value) else ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--misfit", action="store_true", help="fingers that differ from the model")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--cases", default="", help="names, separated by semicolons")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--output", type=Path, default=Path("out/nuisances"))
    parser.add_argument("--write", action="store_true", help="put the table into its page")
    args = parser.parse_args()
    cases = MISFITS if args.misfit else CASES
    wanted = [word for word in args.cases.split(";") if word] or list(cases)
    for word in wanted:
        if word not in cases:
            parser.error(f"--cases: no case '{word}'; there are {', '.join(cases)}")
    rows = run(args.output, args.seeds, wanted, args.processes)
    text = misfit_table(rows) if args.misfit else table(rows)
    print(text)
    if args.write:
        name, marker = ("study", "truths") if args.misfit else ("nuisance_parameters", "nuisance")
        page = DOCS / f"{name}.md"
        found = replace_between(page.read_text(encoding="utf-8"), marker, text)
        with atomic_write(page) as file:
            file.write(found)


if __name__ == "__main__":
    main()
