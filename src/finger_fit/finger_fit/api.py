# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fit a finger from Python: arrays in, one result object out, without ROS and without bags.

    from finger_fit import Trial, fit

    presses = [Trial(time, force, area, condition="dry", subject="S01"), …]
    result = fit(presses)
    result.parameters["composite_E"]      # Pa
    result.intervals["composite_E"]       # 95 %
    result.report("out")                  # report.html, fit.json, tables and figures

Everything is in SI: s, N, m², Pa.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from finger_common.columns import column
from finger_common.condition_name import check_condition_name
from finger_common.errors import InputError, listed
from finger_common.flags import AreaFlag
from finger_common.stamps import NANOSECONDS
from finger_common.units import LARGEST_FORCE
from finger_offline.force_history import force_before
from finger_offline.held_areas import held_rows, held_text
from finger_offline.trial_checks import (
    PLAUSIBLE_AREA,
    fault_of,
    length_fault,
)
from finger_offline.trial_records import TrialRecord
from finger_offline.trial_split import TrialSettings
from finger_offline.unloaded import pressed_force, reached_force, unloaded_tare

from .fingers import Fingers, GeometrySource, by_subject
from .options import FitOptions
from .problem import force_limit_of
from .problem.trials import sample_period, smoothed
from .report_units import CUT_NOTE, interval_text
from .results import ConditionFit, Finger, FitResult, QuantityResult, check_folder, write
from .study import draw, fit_records, provenance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EPOCH = 946_684_800 * NANOSECONDS
"""Stamp (ns) of time 0 of a trial: 2000-01-01."""

NOISY_ZERO = 0.05
"""Part of the largest area up to which one below zero may be noise on an area of 0."""

_MISSING = ("nan", "NaT", "<NA>")
"""What NumPy and pandas have in columns where there is no value, as text."""

REMEDIES = {
    "unit": "give the indentation in m",
    "sign": "give the indentation positive into the finger",
    "time_offset": "give indentation_time on the clock of time",
}
"""What to do about a fault of an indentation."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One press, or several one after the other, of which each is fitted as a trial of its own, by
    tissue that those before it may have left deformed.

    time (n,): s, or dates as NumPy and pandas have them; force (n,): normal force in N, tared,
    positive when the finger presses, from no contact on; area: gross contact area in m², (n,) with
    NaN where there is no frame, or (k,) at area_time (k,) in s. moisture: readings (a.u.).
    target_force (N): ends the loading, 95 % of a press's peak above the tare by default. Lists,
    arrays and pandas columns are taken. Raises InputError for arrays that do not belong together,
    and for times, forces, areas and indentations that cannot be a finger's. None, NaN or NaT for
    subject or condition is none.

    indentation: measured approach of plate and bone in m, positive into the finger, from any zero:
    (n,) with NaN where there is none, or (j,) at indentation_time (j,) in s; None for none.
    """

    time: Any
    force: Any
    area: Any
    area_time: Any = None
    condition: str = ""
    subject: str = ""
    moisture: Any = ()
    target_force: float = 0.0
    index: int = -1
    label: str = ""
    indentation: Any = None
    indentation_time: Any = None

    def records(self, number: int, index: int) -> list[TrialRecord]:
        """Give the presses as trials of a bag have them.

        number: place in a list of trials, for messages; index: of the first press, where the trial
        has none. A single press keeps all samples; several are cut apart as those of a bag are.
        """
        return self.presses(_each_area_once([_Signals.of(self, number)], [])[0], index)

    def presses(self, signals: _Signals, index: int) -> list[TrialRecord]:
        """`records` of the trial's own signals."""
        name, force, area = signals.name, signals.force, signals.area
        stamps = _stamps(force.time, signals.origin)
        settings = TrialSettings()
        touches = settings.presses(stamps, force.values)
        peaks = [float(force.values[first:end].max()) for first, end in touches]
        least, peak = settings.minimum_peak, max(peaks, default=0.0)
        if peak < least:
            raise InputError(
                f"{name}: no press of {least:g} N or more, the largest force is "
                f"{force.values.max():.3g} N; give the normal force in N, positive when the finger "
                "presses"
            )
        first, end = touches[int(np.argmax(peaks))]
        span = (float(force.time[first]), float(force.time[min(end, len(stamps) - 1)]))
        _check_units(name, span, sample_period(force.time), peak, area)
        target = _scalar(self.target_force, f"{name}: target_force")
        if not 0.0 <= target <= peak:
            raise InputError(
                f"{name}: target_force is {target:g} N, the press goes up to {peak:.3g} N; give "
                "the force at which the loading ends, or 0"
            )
        given = _scalar(self.index, f"{name}: index")
        pressed = [n for n, highest in enumerate(peaks) if highest >= least]
        records = []
        for place, n in enumerate(pressed):
            alone = len(pressed) == 1
            part = slice(0, len(stamps)) if alone else _about(touches, n, force.time)
            own = signals if alone else signals.within(part)
            record = self._record(
                own,
                (given if given >= 0 else index) + place,
                (touches[n][0] - part.start, touches[n][1] - part.start),
            )
            history_ns, history = force_before(stamps, force.values, part.start)
            records.append(replace(record, history_ns=history_ns, history=history))
        return records

    def _record(self, own: _Signals, index: int, press: tuple[int, int]) -> TrialRecord:
        """Give one press, from its first sample to the first after it."""
        name, force, seen, indented = own.name, own.force, own.area, own.indentation
        readings = _column(
            [] if self.moisture is None else self.moisture, f"{name}: moisture", True
        )
        subject = _code(self.subject, f"{name}: subject")
        condition = _code(self.condition, f"{name}: condition")
        stamps = _stamps(force.time, own.origin)
        first, end = press
        peak = float(pressed_force(force.time, force.values)[first:end].max())
        touches = seen.values > 0
        smooth = smoothed(force.time, force.values, FitOptions.force_cutoff)
        rest = unloaded_tare(
            force.time, force.values, smooth, seen.time[touches], seen.time[~touches]
        )
        record = TrialRecord(
            bag=self.label or f"{subject} {condition}".strip() or "trials",
            session="python",
            subject=subject,
            condition=condition,
            index=index,
            attempt=0,
            target_force=self.target_force or reached_force(peak, rest),
            stamp_ns=stamps,
            force=force.values,
            lateral_force=np.zeros(len(stamps)),
            area_stamp_ns=_stamps(seen.time, own.origin),
            area=seen.values,
            area_sd=np.full(len(seen.values), np.nan),
            area_flags=np.where(touches, 0, int(AreaFlag.NO_CONTACT)),
            real_area=np.full(len(seen.values), np.nan),
            moisture_before=readings.tolist(),
            moisture_after=[],
            onset_ns=int(stamps[first]),
            liftoff_ns=int(stamps[end]) if end < len(stamps) else None,
            area_source="arrays",
            indentation_stamp_ns=_stamps(indented.time, own.origin),
            indentation=indented.values,
        )
        fault = fault_of(record) if len(indented.values) else None
        if fault is not None and fault.certain:
            raise InputError(f"{name}: {fault.text}; {REMEDIES[fault.option]}")
        return record


@dataclass(frozen=True)
class _Signal:
    """Values (n,) of a trial at increasing times (n,) in s, NaN where there is none."""

    time: np.ndarray
    values: np.ndarray

    @classmethod
    def of(cls, trial: Trial, name: str, what: str, time: np.ndarray | None = None) -> _Signal:
        """Check a field of a trial and its times; raises InputError that names the trial.

        time (n,): that of the force, for fields without a time of their own; None for the force.
        """
        clock = "time" if time is None else f"{what}_time"
        given = getattr(trial, clock)
        if given is not None or time is None:
            time = _column(given, f"{name}: {clock}")
        values = _column(getattr(trial, what), f"{name}: {what}", gaps=what != "force")
        if what == "indentation" and not np.isfinite(values).any():
            raise InputError(f"{name}: indentation holds no number; leave it out")
        if len(values) != len(time):
            raise InputError(
                f"{name}: {len(values)} values of {what} for {len(time)} times; give as many"
            )
        late = np.flatnonzero(~(np.diff(time) > 0))
        if len(time) < 2 or len(late):
            at = f" (values {late[0]} and {late[0] + 1} do not)" if len(late) else ""
            raise InputError(
                f"{name}: {clock} must increase{at}; sort the rows by time, and drop rows that "
                "repeat one"
            )
        return cls(time, values)

    @property
    def measured(self) -> _Signal:
        """The part with values."""
        known = np.isfinite(self.values)
        return _Signal(self.time[known], self.values[known])

    def within(self, start: float, end: float) -> _Signal:
        """The part from start to end (s)."""
        kept = (self.time >= start) & (self.time <= end)
        return _Signal(self.time[kept], self.values[kept])


@dataclass(frozen=True)
class _Signals:
    """What was measured in a trial, named for messages; origin: s, before which nothing was; area
    and indentation: the part with values."""

    name: str
    origin: float
    force: _Signal
    area: _Signal
    indentation: _Signal

    @classmethod
    def of(cls, trial: Trial, number: int) -> _Signals:
        """Check the signals of a trial, at a place in a list; raises InputError."""
        name = trial.label or f"trial {number}"
        force = _Signal.of(trial, name, "force")
        area = _Signal.of(trial, name, "area", force.time)
        indentation = _Signal(np.empty(0), np.empty(0))
        if trial.indentation is not None:
            indentation = _Signal.of(trial, name, "indentation", force.time)
        starts = [s.time[0] for s in (force, area, indentation) if len(s.time)]
        origin = min(float(min(starts)), 0.0)
        return cls(name, origin, force, area.measured, indentation.measured)

    def within(self, part: slice) -> _Signals:
        """The samples of the force in a part, and what was measured meanwhile."""
        force = _Signal(self.force.time[part], self.force.values[part])
        ends = force.time[0], force.time[-1]
        return replace(
            self,
            force=force,
            area=self.area.within(*ends),
            indentation=self.indentation.within(*ends),
        )


def _each_area_once(found: Sequence[_Signals], notes: list[str]) -> list[_Signals]:
    """The signals of one subject's trials with each area once, where a logger held them; notes gets
    the number of those left out.

    One press may be too short to tell by: the trials are looked at together.
    """
    begins = np.cumsum([0.0, *(s.force.time[-1] - s.force.time[0] + 1.0 for s in found)])
    moves = [begin - s.force.time[0] for begin, s in zip(begins, found)]
    held = held_rows(
        np.concatenate([_stamps(s.area.time + m, 0.0) for s, m in zip(found, moves)]),
        np.concatenate([s.area.values for s in found]),
        np.concatenate([_stamps(s.force.time + m, 0.0) for s, m in zip(found, moves)]),
        np.concatenate([s.force.values for s in found]),
    )
    if not held.any():
        return list(found)
    masks = np.split(~held, np.cumsum([len(s.area.time) for s in found])[:-1])
    names = [s.name for s, kept in zip(found, masks) if not kept.all()]
    notes.append(f"{listed(names, 3)}: {held_text(int(held.sum()))}")
    return [
        replace(s, area=_Signal(s.area.time[kept], s.area.values[kept]))
        for s, kept in zip(found, masks)
    ]


def _about(touches: Sequence[tuple[int, int]], n: int, time: np.ndarray) -> slice:
    """Samples at times (n,) in s of the n-th of the touches, with the margins that the trials of a
    bag have, which hold nothing of the touches before and after."""
    first, end = touches[n]
    margin = TrialSettings().margin
    low = int(np.searchsorted(time, time[first] - margin))
    high = int(np.searchsorted(time, time[min(end, len(time)) - 1] + margin, side="right"))
    before = touches[n - 1][1] if n else 0
    after = touches[n + 1][0] if n + 1 < len(touches) else len(time)
    return slice(max(low, before), min(high, after))


def _check_units(
    name: str, span: tuple[float, float], period: float, peak: float, seen: _Signal
) -> None:
    """Raise InputError for what no press can be: its span (s) with samples a period (s) apart, its
    peak (N), and its areas (m²)."""
    frames, area = seen.time, seen.values
    low, high = PLAUSIBLE_AREA
    frame_period = float(np.median(np.diff(frames))) if len(frames) > 1 else 0.0
    if fault := length_fault([span[1] - span[0]], period, "give the time in s", frame_period):
        raise InputError(f"{name}: the press {fault}")
    if peak > LARGEST_FORCE:
        raise InputError(
            f"{name}: force goes up to {peak:.4g} N, more than a finger can press; give it in N"
        )
    if not len(area):
        raise InputError(f"{name}: area holds no number; leave the trial out")
    if not area.max() > 0:
        raise InputError(f"{name}: area is nowhere above zero; give gross contact areas in m²")
    if area.max() > high or 0 < area.max() < low:
        raise InputError(
            f"{name}: the largest area is {area.max():.3g} m², that of a fingertip lies between "
            f"{low:g} and {high:g} m²; give the area in m²"
        )
    row = int(area.argmin())
    if area[row] < -NOISY_ZERO * area.max():
        raise InputError(
            f"{name}: area {area[row]:.3g} m² at t = {frames[row]:.4g} s is negative; correct it, "
            "or give NaN where it is not known"
        )
    if not ((frames >= span[0]) & (frames <= span[1])).any():
        raise InputError(
            f"{name}: no area during the press, which lasts from {span[0]:.6g} to {span[1]:.6g} s; "
            "give area_time on the clock of time"
        )


def _column(values: Any, name: str, gaps: bool = False) -> np.ndarray:
    """Numbers (n,) as `column` takes them. gaps: NaN may be among them."""
    found = column(values, name)
    bad = np.isinf(found) if gaps else ~np.isfinite(found)
    if bad.any():
        raise InputError(f"{name}: value {int(np.flatnonzero(bad)[0])} is not finite; leave it out")
    return found


def _code(value: Any, name: str) -> str:
    """Code of a subject or name of a condition, which name files too; empty for a missing one."""
    text = str(value).strip()
    if value is None or (not isinstance(value, str) and text in _MISSING):
        return ""
    return check_condition_name(text, name)


def _scalar(value: Any, name: str) -> Any:
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise InputError(f"{name} is {value!r}; give a number")
    return value


def _stamps(time: np.ndarray, origin: float) -> np.ndarray:
    """Stamps (n,) of times (n,) in s; origin: one for all of a trial, that none is before EPOCH."""
    return EPOCH + np.round((time - origin) * NANOSECONDS).astype(np.int64)


class ByCondition(dict[str, Any]):
    """Values by condition; of a single condition, its entries are found directly too.

    `result.parameters["dry"]["E0"]`, or `result.parameters["E0"]` where "dry" is all there is.
    """

    def __missing__(self, key: str) -> Any:
        if len(self) == 1:
            (only,) = self.values()
            if isinstance(only, Mapping) and key in only:
                return only[key]
        raise KeyError(f"{key!r}; there are {', '.join(map(repr, self))}")


@dataclass(eq=False)
class Fit:
    """What `fit` found. `result` has everything; the rest is the way there.

    Conditions of several subjects are named "SUBJECT CONDITION"; `subjects` has a Fit of each.
    """

    result: FitResult
    subjects: dict[str, Fit] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Fit({', '.join(self.result.fits)})\n{self.summary()}"

    @property
    def conditions(self) -> list[str]:
        """Names of what was fitted."""
        return list(self.result.fits)

    @property
    def parameters(self) -> ByCondition:
        """Condition → quantity → value (SI)."""
        return ByCondition(
            {n: f.space.quantities(f.parameters) for n, f in self.result.fits.items()}
        )

    @property
    def intervals(self) -> ByCondition:
        """Condition → quantity → 95 % interval (low, high) by profile likelihood, without
        profiles by the covariance.

        They hold all that is unknown, also the assumed lengths of the finger and the gain of all
        areas. An end at the bound of the search box means that the data do not limit it.
        """
        return self._intervals(lambda found: found.interval)

    @property
    def data_intervals(self) -> ByCondition:
        """Condition → quantity → 95 % interval (low, high) from the data alone: if the lengths of
        the finger and the gain of all areas were as assumed."""
        return self._intervals(lambda found: found.data_interval)

    def _intervals(self, kind: Callable[[QuantityResult], tuple[float, float]]) -> ByCondition:
        found = ByCondition()
        for name, condition in self.result.fits.items():
            ends = {q: kind(condition.found(q)) for q in condition.space.quantity_names}
            found[name] = {q: interval for q, interval in ends.items() if not np.isnan(interval[0])}
        return found

    @property
    def covariance(self) -> ByCondition:
        """Condition → covariance (N, N) of the logarithms of the parameters, in the order of
        `names`."""
        return ByCondition({n: f.covariance_log() for n, f in self.result.fits.items()})

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters in the order of the covariance."""
        return self.result.space.names

    @property
    def status(self) -> ByCondition:
        """Condition → "final", "not final", "not checked" or "interrupted"."""
        return ByCondition({n: f.status for n, f in self.result.fits.items()})

    @property
    def notes(self) -> list[str]:
        """What a reader should know: notes, failed checks, excluded trials."""
        found = list(self.result.problems)
        for name, condition in self.result.fits.items():
            found += [f"{name}: {reason}" for reason in condition.reasons]
        return found + [f"excluded: {e.label}: {e.reason}" for e in self.result.exclusions]

    def predict(
        self, time: Any = None, force: Any = None, condition: str | None = None
    ) -> np.ndarray:
        """Contact area (n,) in m² under a force (n,) in N at times (n,) in s, corrected to full
        order as the fit was, by the force.

        Without arguments: the fitted areas at all frames that count, in the order of `frames()`.
        condition: may be left out where there is one. Raises InputError, also for a force beyond
        the model's limit, or one that it cannot follow.
        """
        if time is None and force is None:
            chosen = [condition] if condition else self.conditions
            return np.concatenate([self._condition(c).areas for c in chosen])
        found = self._condition(condition)
        seconds, newtons = _column(time, "time"), _column(force, "force")
        if len(seconds) != len(newtons) or len(seconds) < 2 or np.any(np.diff(seconds) <= 0):
            raise InputError("predict: time and force need equal length, and time must increase")
        limit = force_limit_of(found.problem.model, found.parameters)
        if newtons.max() > limit:
            row = int(np.argmax(newtons > limit))
            raise InputError(
                f"predict: force {newtons[row]:.3g} N at t = {seconds[row]:.4g} s is beyond the "
                f"model's limit of {limit:.3g} N for these parameters; lower the force"
            )
        drive = (seconds - seconds[0], np.maximum(newtons, 0.0), np.arange(len(seconds)))
        areas = found.problem.model.batch(found.parameters[None], [drive])[0][0]
        if np.isnan(areas).any():
            row = int(np.argmax(np.isnan(areas)))
            raise InputError(
                f"predict: the model cannot follow the force of {newtons[row]:.3g} N at t = "
                f"{seconds[row]:.4g} s with these parameters; lower the force"
            )
        return areas * found.problem.correction_at(found.parameters, drive[1])

    def _condition(self, name: str | None) -> ConditionFit:
        fits = self.result.fits
        if name is None and len(fits) == 1:
            return next(iter(fits.values()))
        if name not in fits:
            named = "no condition is given" if name is None else f"condition {name!r}"
            raise InputError(f"{named}: choose one of {', '.join(fits)}")
        return fits[name]

    def frames(self) -> dict[str, np.ndarray]:
        """Columns of all frames that count: condition, trial, time_s, force_n, area_mm2,
        predicted_mm2, residual_mm2, …; `pandas.DataFrame(result.frames())` takes them."""
        from .results.tables import frame_rows

        rows = list(frame_rows(self.result))
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def summary(self) -> str:
        """A table of the parameters as text: 95 % intervals, and those from the data alone."""
        lines = ["95 % intervals; data: from the data alone, with lengths and gain as assumed"]
        any_cut = False
        for name, found in self.result.fits.items():
            lines.append(f"{name or 'all'} ({len(found.problem)} presses): {found.status}")
            for quantity in map(found.space.describe, found.space.quantity_names):
                known, span = found.found(quantity.name), ""
                for word, ends, cut in (
                    ("", known.interval, known.cut),
                    ("data ", known.data_interval, known.data_cut),
                ):
                    if not np.isnan(ends[0]):
                        any_cut |= any(cut)
                        span += f"  {word}[{interval_text(map(quantity.text, ends), cut, ', ')}]"
                text = quantity.text(known.value)
                lines.append(f"  {quantity.name:12} {text:>9}{span} {quantity.display_unit}")
        return "\n".join([*lines, CUT_NOTE] if any_cut else lines)

    def plot(self, name: str = "area_over_force") -> Figure:
        """A figure of the report: area_over_force, residuals, profiles, candidates, …

        Raises InputError for a name that this fit has no figure of.
        """
        from .report import figure

        return figure(self.result, name)

    def save(self, folder: str | Path) -> Path:
        """Write fit.json, parameters.yaml and tables/ into a folder; returns it.

        Raises InputError for a folder that holds a fit of other subjects or fingers.
        """
        trials = [t for fit in self.result.fits.values() for t in fit.problem.trials]
        fitted = {Finger(t.subject, t.finger) for t in trials}
        left_out = {Finger(e.subject, "") for e in self.result.exclusions}
        check_folder(Path(folder), fitted | left_out)
        write(self.result, Path(folder))
        return Path(folder)

    def report(self, folder: str | Path) -> Path:
        """`save`, and report.html with its figures, into a folder; returns the page's path."""
        from .report import write_report

        if Path(folder).suffix in (".html", ".htm"):
            raise InputError(f"report: {folder} names a page; give a folder, report.html is in it")
        if all(part.deformed is None for part in self.result.parts.values()):
            draw(self.result)
        self.save(folder)
        return write_report(self.result, Path(folder))


def fit(
    trials: Iterable[Trial],
    geometry: GeometrySource | Mapping[str, GeometrySource] = None,
    law: str = "",
    conditions: Sequence[str] = (),
    model: Any = None,
    **options: Any,
) -> Fit:
    """Fit the finger's parameters to presses, by subject and condition.

    geometry: of the finger: a geometry.yaml, its content as a mapping, a Geometry, or the estimate
    of caliper readings (`finger_model.anthropometry.estimate_geometry`); of several subjects, a
    mapping from each to its own. By default a typical finger that nobody measured.
    law: another installed material law; one without a reduced model is slow. model: any object
    with `space` and `batch` in place of both. It has its law in `material`, where its parameters
    are not those of the default law; without one, what needs the full-order model is left out, and
    so is parameters.yaml. options: fields of `FitOptions`, such as bootstrap=0, full_order=False,
    seed=1, bounds=["E2=500kPa:3MPa"] or {"E2": (500e3, 3e6)}.
    Raises InputError for data that cannot be fitted.
    """
    if "bounds" in options:
        options["bounds"] = _bounds(options["bounds"])
    chosen = FitOptions.from_mapping(options, "fit")
    fingers = Fingers.of(model) if model else Fingers.load(by_subject(geometry), law=law)
    chosen.check_names(fingers.space, fingers.geometries)
    trials = [trials] if isinstance(trials, Trial) else list(trials)
    for number, trial in enumerate(trials):
        if not isinstance(trial, Trial):
            raise InputError(
                f"fit: trial {number} is of type {type(trial).__name__}; give a list of "
                "Trial(time, force, area, …)"
            )
    if not trials:
        raise InputError("fit: no trial was given; give a list of Trial")
    notes: list[str] = []
    records: list[TrialRecord] = []
    several = []
    read = [_Signals.of(trial, number) for number, trial in enumerate(trials)]
    of_subject: dict[str, list[int]] = {}
    for number, trial in enumerate(trials):
        of_subject.setdefault(_code(trial.subject, f"{read[number].name}: subject"), []).append(
            number
        )
    for numbers in of_subject.values():
        for number, signals in zip(numbers, _each_area_once([read[n] for n in numbers], notes)):
            read[number] = signals
    for trial, signals in zip(trials, read):
        found = trial.presses(signals, len(records))
        records += found
        if len(found) > 1:
            several.append(f"{signals.name} ({len(found)})")
    conditions = (conditions,) if isinstance(conditions, str) else conditions
    result = fit_records(records, fingers, chosen, conditions)
    if several:
        notes.append(f"several presses in {listed(several)}: each press is a trial of its own")
    result.problems[:0] = notes
    changed = "".join(f", {name}={value!r}" for name, value in options.items())
    subjects = {}
    for name, part in result.subjects.items():
        part.sources = provenance(part, chosen, (), f"finger_fit.fit(…{changed})")
        subjects[name] = Fit(part)
    result.sources = provenance(result, chosen, (), f"finger_fit.fit(…{changed})")
    return Fit(result, subjects)


def _bounds(given: Any) -> Any:
    """Bounds as texts: of one text, or of a mapping of names to two ends in SI or with units."""
    if isinstance(given, str):
        return [given]
    if isinstance(given, Mapping):
        ends = {n: e if isinstance(e, (list, tuple)) else (e,) for n, e in given.items()}
        return [f"{name}={':'.join(map(str, span))}" for name, span in ends.items()]
    return given
