"""The live estimate on fingers that nobody measured: drawn from the population, pressed ten times.

    python scripts/population_fingers.py [--fingers 200] [--seed 1] [--full-order 8] [-o t.json]

Truth: the reduced model of the population box with the finger's own lengths, branches, stiffening
and friction, and a factor on the area of each press. The estimator has none of these: it runs the
default finger. With --full-order the truth of so many fingers is the full-order model, as control.
Areas have noise of 1.5 mm² at 10 Hz, forces that of the simulated study. Every second finger has no
moisture reading. Presses are taps, holds and slow presses.

With --wide the presses, grips among them, go to 9 N, and the table is one of coverages by force.

Three runs of each finger: with camera; without; with camera for five presses and then without.
The camera's own error is that of its newest area that the estimator may use (stamp + fusion delay),
held to the instants of the estimate. "At once": as if the area were there at the frame's stamp.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numba
import numpy as np
import yaml
from scipy.optimize import minimize

from finger_common.files import atomic_write
from finger_common.flags import StateFlag
from finger_common.processes import worker_pool
from finger_common.usable_press import TYPICAL_AREA_NOISE
from finger_model.estimator import ContactEstimator
from finger_model.estimator.area_filter import TISSUE
from finger_model.estimator.perturbed_finger import PerturbedFinger
from finger_model.estimator.sensitivities import SHIFT_LIMITS
from finger_model.fem.full_order import FullOrderModel
from finger_model.finger import load_reduced
from finger_model.finger_prior import AS_THE_MODEL, PRIOR_FORCES, FingerPrior
from finger_model.parameter_sets import ParameterSets
from finger_model.people import People, Person
from finger_model.reduced import ReducedModel
from finger_model.reduced.model import POPULATION, load_population
from finger_sim.study_trial import FORCE_NOISE

WIDE_KINDS = ("hold", "grip", "slow", "tap", "grip", "hold")
WIDE_FORCES, LOOSE_FORCES = (0.5, 9.0), (0.1, 1.0)
"""N, of presses over a wide range of forces, and of a grip that was loosened."""
RANGES = ((0.1, 0.5), (0.5, 1.5), (1.5, 3.0), (3.0, 8.0))
"""N, in which their coverages are counted."""
FIRM_FORCE = 4.0
"""N, after which a force of LOOSE_FORCES is that of a loosened grip."""
WALKS = np.arange(0.04, 0.2, 0.02)
LEAST_COVERED = 0.92
"""Of `walk_sd`, among which the prior takes the least one whose 95 % intervals cover so many of the
loosened grips. All of 95 % would make the others far too wide."""
KINDS = ("hold", "tap", "slow", "tap", "hold", "slow", "tap", "hold", "slow", "tap")
FRAME, SAMPLE, KNOT = 0.1, 0.002, 0.01
"""s between camera frames, force samples, and the samples of the truth."""
START = 10**18
ESTIMATED = (
    "area",
    "area_stddev",
    "model_area",
    "peak_pressure",
    "peak_pressure_stddev",
    "indentation",
    "indentation_stddev",
    "flags",
)
"""Columns of the estimate that `run_session` gives."""
EVERY = range(10)
"""Presses of a session."""
TRUTHS = {"area": "truth", "peak_pressure": "peak_truth", "indentation": "indentation_truth"}
"""Columns of the truth, by those of the estimate."""
COUNTED_FORCE = 0.1
"""N; below it relative errors of the area are not counted."""


@dataclass(frozen=True)
class Press:
    """Truth of one press: time since the session's start (n,) in s, force (n,) in N, area (n,) in
    m² and the press's own factor in it, peak pressure (n,) in Pa, indentation (n,) in m."""

    kind: str
    time: np.ndarray
    force: np.ndarray
    area: np.ndarray
    gain: float
    peak: np.ndarray
    indentation: np.ndarray


@dataclass(frozen=True)
class Session:
    """Presses of one finger, and the reading of its moisture (NaN for none); wide: beyond 3 N."""

    person: Person
    presses: tuple[Press, ...]
    reading: float
    seed: int
    wide: bool


def force_of(
    rng: np.random.Generator, kind: str, wide: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) in s and force (n,) in N of a press: linear rise, hold, smooth release."""
    if kind == "grip":
        return grip_of(rng)
    peak = between(rng, WIDE_FORCES) if wide else rng.uniform(0.5, 1.35)
    spans = {
        "tap": ((0.05, 0.15), (0.0, 0.05), (0.05, 0.15)),
        "hold": ((0.3, 1.0), (1.5, 4.0), (0.15, 0.4)),
        "slow": ((1.5, 3.0), (0.0, 0.5), (0.5, 1.5)),
    }[kind]
    rise, hold, fall = (rng.uniform(*span) for span in spans)
    time = np.arange(0.0, rise + hold + fall + 2 * KNOT, KNOT)
    falling = np.clip((time - rise - hold) / fall, 0.0, 1.0)
    return time, peak * np.minimum(time / rise, 1.0) * 0.5 * (1.0 + np.cos(np.pi * falling))


def between(rng: np.random.Generator, forces: tuple[float, float]) -> float:
    """A force (N), even in its logarithm."""
    return float(np.exp(rng.uniform(*np.log(forces))))


def grip_of(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) in s and force (n,) in N of a grip that is loosened three times in one contact."""
    at, knots = 0.0, [(0.0, 0.0)]
    for _ in range(3):
        firm, loose = between(rng, WIDE_FORCES), between(rng, LOOSE_FORCES)
        for force, change, hold in (
            (firm, (0.1, 1.0), (0.5, 3.0)),
            (min(loose, firm), (0.1, 0.5), (0.3, 1.5)),
        ):
            for span in (change, hold):
                at += rng.uniform(*span)
                knots.append((at, force))
    at += 0.2
    time = np.arange(0.0, at + 2 * KNOT, KNOT)
    return time, np.interp(time, *np.transpose([*knots, (at, 0.0)]))


def session_of(seed: int, index: int, full_order: bool = False, wide: bool = False) -> Session:
    """The index-th finger of a seed and its presses; the same for equal arguments."""
    kinds = WIDE_KINDS if wide else KINDS
    rng = np.random.default_rng([seed, index])
    people = People.default()
    person = people.draw(rng)
    gains = np.exp(people.press_gain * rng.normal(size=len(kinds)))
    times, forces, at = [], [], 0.0
    for kind in kinds:
        time, force = force_of(rng, kind, wide)
        at += rng.uniform(0.8, 3.0)
        times.append(at + time)
        forces.append(force)
        at = times[-1][-1]
    if full_order:
        tables = _full_order(person, times, forces)
    else:
        model = load_population(person.geometry).for_material(person.material)
        constants = model.constants(person.material)
        state, tables, before = model.state_at_rest(constants), [], 0.0
        for time, force in zip(times, forces):
            tables.append(model.run(constants, state, time, force, before))
            before = time[-1]
    presses = [
        Press(k, t, f, g * a[:, 0], float(g), a[:, 2] / g, a[:, 1])
        for k, t, f, a, g in zip(kinds, times, forces, tables, gains)
    ]
    reading = np.nan if index % 2 else person.reading
    return Session(person, tuple(presses), reading, 7919 * seed + index, wide)


def _full_order(
    person: Person, times: list[np.ndarray], forces: list[np.ndarray]
) -> list[np.ndarray]:
    """Areas, indentations and peak pressures (n, 3) of the presses by the full-order model, every
    20 ms."""
    stepper = FullOrderModel(person.geometry).start(person.material, 0.0)
    tables = []
    for time, force in zip(times, forces):
        knots = np.unique(np.append(np.arange(0, len(time), 2), len(time) - 1))
        found = [stepper.step(float(time[i]), float(force[i])) for i in knots]
        columns = np.transpose([(p.area, p.indentation, p.peak_pressure) for p in found])
        tables.append(np.column_stack([np.interp(time, time[knots], c) for c in columns]))
    return tables


def run_session(
    session: Session,
    cameras: range,
    prior: FingerPrior | None = None,
    sample: float = SAMPLE,
) -> Iterator[dict[str, np.ndarray]]:
    """Estimates of each press whose area a camera sees for the presses in `cameras`.

    prior: None for the shipped one; sample: s. Columns (n,) of the samples in contact: truth, area,
    area_stddev, model_area, peak_truth, peak_pressure, peak_pressure_stddev, indentation_truth,
    indentation, indentation_stddev, force, held (the camera's newest usable area, NaN before the
    first), flags.
    """
    rng = np.random.default_rng(session.seed)
    model = load_reduced(POPULATION if session.wide else "")
    sets = ParameterSets.default()
    if prior is not None:
        sets = sets.with_prior(prior, model.geometry)
    estimator = ContactEstimator(model, sets)
    if np.isfinite(session.reading):
        estimator.add_moisture(START - 10**9, session.reading)
    delay = estimator.settings.fusion_delay
    for number, press in enumerate(session.presses):
        noise = rng.normal(size=2 * len(press.time))
        frames = np.arange(press.time[0] + FRAME * rng.random(), press.time[-1], FRAME)
        truth = np.interp(frames, press.time, press.area)
        measured = np.maximum(truth + TYPICAL_AREA_NOISE * noise[: len(frames)], 0.1e-6)
        frames, measured = frames[truth > 0], measured[truth > 0]
        if number in cameras:
            for instant, area in zip(frames, measured):
                estimator.add_area(START + round(instant * 1e9), area, TYPICAL_AREA_NOISE)
        time = np.arange(press.time[0] - 0.3, press.time[-1] + 0.3, sample)
        force = np.interp(time, press.time, press.force, 0.0, 0.0)
        noisy = force + FORCE_NOISE * rng.normal(size=len(time))
        stamps = START + np.round(time * 1e9).astype(np.int64)
        block = estimator.add_wrenches(stamps, np.column_stack([0 * noisy, 0 * noisy, -noisy]))
        newest = np.searchsorted(frames, time - delay, side="right") - 1
        held = np.where(newest >= 0, np.append(measured, np.nan)[newest], np.nan)
        newest = np.searchsorted(frames, time, side="right") - 1
        at_once = np.where(newest >= 0, np.append(measured, np.nan)[newest], np.nan)
        area = np.interp(time, press.time, press.area, 0.0, 0.0)
        use = block.column("in_contact") & (area > 0)
        yield {
            **{name: block.column(name)[use] for name in ESTIMATED},
            "truth": area[use],
            "peak_truth": np.interp(time, press.time, press.peak)[use],
            "indentation_truth": np.interp(time, press.time, press.indentation)[use],
            "force": force[use],
            "held": held[use],
            "at_once": at_once[use],
        }


def states_of(
    session: Session, covariance: np.ndarray, mean: np.ndarray
) -> tuple[np.ndarray, float]:
    """The finger states (5,) that describe the areas of a session best, and what they leave.

    By Gauss and Newton from a prior; the model is that of the true moisture. What they leave is the
    deviation of the logarithm of the area about each press's own mean.
    """
    model = ReducedModel.load()
    sets = ParameterSets.default()
    base = model.constants(sets.interpolate(session.person.moisture).parameters)
    x = mean.copy()
    left = 0.0
    for _ in range(4):
        perturbed = PerturbedFinger.at(model, base, x[TISSUE])
        rows, values, weights, residuals, before = [], [], [], [], 0.0
        for press in session.presses:
            found = perturbed.run(before, press.time, press.force)
            before = press.time[-1]
            use = (press.force > COUNTED_FORCE) & (press.area > 5e-6)
            log_force = np.log(np.maximum(press.force, 0.05))
            h = np.column_stack([np.ones(len(log_force)), log_force, found.sensitivities])[use]
            y = np.log(press.area[use] / found.area[use]) + h[:, TISSUE] @ perturbed.shift
            rows.append(h)
            values.append(y)
            # As accurate as some ten frames a second with the misfit of a few per cent.
            weights.append(np.full(len(y), 1.0 / (0.1 / KNOT * 0.03**2)))
            residuals.append(y - h @ x)
        h, y, w = np.vstack(rows), np.concatenate(values), np.concatenate(weights)
        left = rms(np.concatenate([r - r.mean() for r in residuals]))
        inverse = np.linalg.inv(covariance)
        x = np.linalg.solve(h.T @ (w[:, None] * h) + inverse, h.T @ (w * y) + inverse @ mean)
        limits = 1.5 * np.array(SHIFT_LIMITS)
        x[TISSUE] = np.clip(x[TISSUE], -limits, limits)
    return x, left


def derive_prior(seed: int, number: int) -> FingerPrior:
    """Distribution of the finger states over so many fingers, by two rounds of `states_of`."""
    mean, covariance = np.zeros(5), np.diag([0.25, 0.06, 0.3, 0.7, 0.4]) ** 2
    sessions = [session_of(seed, index) for index in range(number)]
    left: list[float] = []
    for _ in range(2):
        found = [states_of(session, covariance, mean) for session in sessions]
        states, left = zip(*found)
        x = np.array(states)
        mean, covariance = x.mean(axis=0), np.cov(x.T)
        print("mean", mean.round(3), "deviations", np.sqrt(np.diag(covariance)).round(3))
        print("left", np.percentile(left, [10, 50, 90]).round(4))
    people = People.default()
    narrow = FingerPrior(
        tuple(mean.round(4).tolist()),
        tuple(map(tuple, covariance.round(5).tolist())),
        round(float(np.median(left)), 4),
        people.moisture_sd,
        people.reading_sd,
    )
    return derive_range(narrow, seed, number)


def derive_range(prior: FingerPrior, seed: int, number: int) -> FingerPrior:
    """A prior with what its five numbers leave over a wide range of forces: the walk of the area,
    the peak over the mean pressure and the indentation, as live estimates of so many fingers need
    them."""
    sessions = wide_sessions(seed, range(number))
    names = ("peak_mean", "peak_sd", "indentation_mean", "indentation_sd")
    bare = replace(prior, **dict.fromkeys(names, AS_THE_MODEL))
    for walk in WALKS:
        prior = replace(bare, walk_sd=round(float(walk), 3))
        found = [p for s in sessions for p in run_session(s, EVERY, prior, KNOT)]
        share = np.mean(np.concatenate([covered(press)[loosened(press)] for press in found]))
        print(f"walk_sd {walk:.2f}: 95 % interval covers {share:.3f} of the loosened grips")
        if share >= LEAST_COVERED:
            break
    unseen = [p for s in sessions for p in run_session(s, range(0), prior, KNOT)]
    values = [
        values
        for errors in (_peak_errors, _indentation_errors)
        for values in by_force(errors, found, unseen)
    ]
    return replace(prior, **dict(zip(names, values)))


def wide_sessions(seed: int, indices: range) -> list[Session]:
    """Sessions over a wide range of forces, without fingers that the model cannot press so hard."""
    found = [session_of(seed, index, wide=True) for index in indices]
    return [s for s in found if all(np.isfinite(p.area).all() for p in s.presses)]


def loosened(press: dict[str, np.ndarray]) -> np.ndarray:
    """Whether each sample (n,) is of a grip that was firm and is loose now."""
    was_firm = np.maximum.accumulate(press["force"]) > FIRM_FORCE
    return was_firm & (press["force"] > LOOSE_FORCES[0]) & (press["force"] < LOOSE_FORCES[1])


def by_force(
    errors: Callable[[dict[str, np.ndarray]], tuple[np.ndarray, np.ndarray, np.ndarray]],
    *runs: list[dict[str, np.ndarray]],
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Mean and deviation (n,) at PRIOR_FORCES of ln (truth over the estimate), in presses of a
    prior without them: the mean by least squares, the deviation by the likelihood beside that which
    is stated without it, as large as each of the runs needs it. errors: `_peak_errors` or
    `_indentation_errors`."""
    columns = [[np.concatenate(c) for c in zip(*map(errors, run))] for run in runs]
    force, off, _ = (np.concatenate(column) for column in zip(*columns))
    mean = np.linalg.lstsq(_hats(force), off, rcond=None)[0]
    deviation = np.zeros(len(mean))
    for force, off, variance in columns:
        hats = _hats(force)
        least = partial(_unlikely, hats, (off - hats @ mean) ** 2, variance)
        own = minimize(least, np.full(len(mean), 0.15), bounds=len(mean) * [(0.0, 1.0)]).x
        deviation = np.maximum(deviation, own)
    return tuple(mean.round(3).tolist()), tuple(deviation.round(3).tolist())


def _unlikely(
    hats: np.ndarray, square: np.ndarray, variance: np.ndarray, deviation: np.ndarray
) -> float:
    """Logarithm of the likelihood, times −2/n, of squared errors (n,) that have a variance (n,) and
    beside it the deviation (5,) at PRIOR_FORCES."""
    total = variance + (hats @ deviation) ** 2
    return float(np.mean(np.log(total) + square / total))


def _hats(force: np.ndarray) -> np.ndarray:
    """Weights (n, 5) of the values at PRIOR_FORCES in that at each force (n,)."""
    knots = np.log(PRIOR_FORCES)
    return np.column_stack([np.interp(np.log(force), knots, own) for own in np.eye(len(knots))])


def _peak_errors(press: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Force (n,) of the counted samples, ln (true peak over the estimate), stated variance of the
    area."""
    use = press["force"] > COUNTED_FORCE
    relative = press["area_stddev"][use] / press["area"][use]
    off = np.log(press["peak_truth"][use] / press["peak_pressure"][use])
    return press["force"][use], off, np.log1p(relative**2)


def _indentation_errors(press: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `_peak_errors`, of the indentation and with its own stated variance."""
    use = press["force"] > COUNTED_FORCE
    relative = press["indentation_stddev"][use] / press["indentation"][use]
    off = np.log(press["indentation_truth"][use] / press["indentation"][use])
    return press["force"][use], off, np.log1p(relative**2)


def rms(values: np.ndarray) -> float:
    """Root mean square of the values (n,); NaN for none."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def covered(press: dict[str, np.ndarray], name: str = "area") -> np.ndarray:
    """Whether the 95 % interval of each sample (n,) holds the truth; name: of TRUTHS."""
    return np.abs(press[name] - press[TRUTHS[name]]) <= 1.96 * press[name + "_stddev"]


def wide_table(seed: int, indices: range) -> dict[str, float]:
    """Coverages (%) of area, peak pressure and indentation by force, with camera and without, over
    fingers whose presses go to WIDE_FORCES; their relative errors (RMS)."""
    figures = {}
    sessions = wide_sessions(seed, indices)
    for label, cameras in (("camera", EVERY), ("none", range(0))):
        presses = [press for s in sessions for press in run_session(s, cameras, sample=KNOT)]
        parts = [
            (f"{low:g} to {high:g} N", [(p["force"] > low) & (p["force"] < high) for p in presses])
            for low, high in RANGES
        ]
        parts.append(("loosened", [loosened(press) for press in presses]))
        for name, truth in TRUTHS.items():
            for part, uses in parts:
                inside = [covered(press, name)[use] for press, use in zip(presses, uses)]
                off = [(p[name] / p[truth] - 1.0)[use] for p, use in zip(presses, uses)]
                where = f"{label}: {name}, {part}"
                figures[f"{where}: 95 % interval covers (%)"] = float(
                    100.0 * np.mean(np.concatenate(inside))
                )
                figures[f"{where}: error, RMS (%)"] = 100.0 * rms(np.concatenate(off))
    return figures


def least_error(presses: tuple[Press, ...], seen: int) -> float:
    """Relative RMS error of the areas after `seen` presses, for one who knows the finger exactly.

    Only the factors of the presses are not known; their mean is taken from those seen.
    """
    expected = float(np.exp(np.mean(np.log([press.gain for press in presses[:seen]]))))
    later = presses[seen:]
    error = np.concatenate([press.area * (1.0 - expected / press.gain) for press in later])
    return rms(error) / rms(np.concatenate([press.area for press in later]))


def score(seed: int, full_order: bool, index: int) -> dict[str, list]:
    """Figures of one finger."""
    numba.set_num_threads(1)
    session = session_of(seed, index, full_order)
    found: dict[str, list] = {"index": [index]}
    for name, cameras in (("camera", range(10)), ("none", range(0)), ("five", range(5))):
        presses = list(run_session(session, cameras))
        inside = [covered(p) for p in presses]
        if name == "camera":
            # Relative to the camera: from its first usable area of the press on.
            for key in ("held", "at_once"):
                found[key] = []
                for press in presses:
                    seen = np.isfinite(press[key])
                    own = rms((press[key] - press["truth"])[seen])
                    fused = rms((press["area"] - press["truth"])[seen])
                    found[key].append(fused / own if seen.any() else np.nan)
            found["rms_mm2"] = [1e6 * rms(p["area"] - p["truth"]) for p in presses]
            found["first_covered"] = [float(inside[0].sum()), len(inside[0])]
            found["flagged"] = [
                float(np.mean(p["flags"] & getattr(StateFlag, "MODEL_MISMATCH", 0) > 0))
                for p in presses
            ]
        if name == "five":
            presses, inside = presses[5:], inside[5:]
            error = np.concatenate([p["area"] - p["truth"] for p in presses])
            truth = np.concatenate([p["truth"] for p in presses])
            found["five_relative_rms"] = [rms(error) / rms(truth)]
            found["five_least"] = [least_error(session.presses, 5)]
        found[name + "_rms_mm2"] = [
            1e6 * rms(np.concatenate([p["area"] - p["truth"] for p in presses]))
        ]
        found[name + "_covered"] = [float(sum(i.sum() for i in inside)), sum(map(len, inside))]
    return found


def table(scores: list[dict[str, list]]) -> dict[str, float]:
    """The figures of all fingers, by name; shares and coverages in %."""
    ratio = np.array([s["held"] for s in scores])
    at_once = np.array([s["at_once"] for s in scores])
    later = ratio[:, 2:]

    def share(condition: np.ndarray) -> float:
        return float(100.0 * np.mean(condition))

    def coverage(name: str) -> np.ndarray:
        return np.array([s[name] for s in scores])

    figures = {
        "camera: presses with RMS <= 1.05 x the camera's (%)": share(
            ratio[np.isfinite(ratio)] <= 1.05
        ),
        "camera: median RMS over the camera's, from press 3": float(np.nanmedian(later)),
        "camera: worst press, RMS over the camera's": float(np.nanmax(ratio)),
        "camera at once: presses with RMS <= 1.05 x the camera's (%)": share(
            at_once[np.isfinite(at_once)] <= 1.05
        ),
        "camera at once: median RMS over the camera's, from press 3": float(
            np.nanmedian(at_once[:, 2:])
        ),
    }
    for name in ("camera", "first", "none", "five"):
        counts = coverage(name + "_covered")
        own = counts[:, 0] / counts[:, 1]
        label = {"first": "camera, press 1", "five": "five, then force alone"}.get(name, name)
        figures[f"{label}: 95 % interval covers (%)"] = float(
            100.0 * counts[:, 0].sum() / counts[:, 1].sum()
        )
        figures[f"{label}: fingers with coverage >= 80 % (%)"] = share(own >= 0.8)
    relative = np.array([s["five_relative_rms"][0] for s in scores])
    figures["five, then force alone: fingers with RMS <= 5 % (%)"] = share(relative <= 0.05)
    figures["five, then force alone: RMS, 90 % of fingers (%)"] = float(
        100.0 * np.percentile(relative, 90)
    )
    least = np.array([s["five_least"][0] for s in scores])
    figures["five, then force alone: the same at best, finger known (%)"] = share(least <= 0.05)
    for name in ("camera", "none", "five"):
        values = [s[name + "_rms_mm2"][0] for s in scores]
        figures[f"{name}: RMS, median of fingers (mm²)"] = float(np.median(values))
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fingers", type=int, default=200)
    parser.add_argument("--full-order", type=int, default=0, help="fingers of the control")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--prior", action="store_true", help="print the prior of the estimator")
    parser.add_argument("-o", "--output", default="")
    parser.add_argument(
        "--range", action="store_true", help="print walk_sd, peak and indentation of the prior"
    )
    parser.add_argument("--wide", action="store_true", help="presses to 9 N: coverages by force")
    args = parser.parse_args()
    if args.range:
        prior = ParameterSets.default().prior
        assert prior is not None
        print(yaml.safe_dump({"prior": derive_range(prior, args.seed, args.fingers).to_dict()}))
        return 0
    if args.wide:
        for label, value in wide_table(args.seed, range(args.fingers)).items():
            print(f"  {label:62s} {value:8.3g}")
        return 0
    if args.prior:
        print(yaml.safe_dump({"prior": derive_prior(args.seed, args.fingers).to_dict()}))
        return 0
    results = {}
    for name, number, full in (
        ("population", args.fingers, False),
        ("full order", args.full_order, True),
    ):
        if not number:
            continue
        if args.workers > 1:
            with worker_pool(args.workers, needs_main=True) as pool:
                scores = list(pool.map(partial(score, args.seed, full), range(number)))
        else:
            scores = [score(args.seed, full, index) for index in range(number)]
        results[name] = {"figures": table(scores), "fingers": scores}
        print(f"{number} fingers, truth: {name}")
        for label, value in results[name]["figures"].items():
            print(f"  {label:62s} {value:8.3g}")
    if args.output:
        with atomic_write(args.output) as file:
            json.dump(results, file)
    return 0


if __name__ == "__main__":
    sys.exit(main())
