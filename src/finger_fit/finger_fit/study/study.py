# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A whole fit: recorded trials, or bags, to results and files."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.condition_name import SPELLING_ALONE, check_condition_name, same_but_for_spelling
from finger_common.errors import FingerError, InputError, ModelError, listed
from finger_common.subject_code import may_be_one
from finger_model.fem.area_model import FullOrderAreas
from finger_model.reduced import ReducedModel
from finger_offline.force_history import LONGEST
from finger_offline.trial_split import TrialSettings

from .. import results
from ..engine import Engine, LocalEngine, engine_for
from ..fingers import Fingers
from ..full_order import FullOrder
from ..interruption import found_something, interruptible, kept, not_kept
from ..options import FitOptions
from ..problem import (
    DataError,
    Exclusion,
    FitProblem,
    FitTrial,
    by_reason,
    finger_of,
    material_of,
    prepare_all,
)
from ..quality import judge, quality_of, screen
from ..results import ConditionFit, Finger, FitResult, codes_of, contrasts
from ..search import Stopped
from .bags import load, noted, reading
from .condition import fit_condition
from .deformed import deformed_finger
from .further import force_modes, shared_fit, thickness_fit
from .grouping import group_trials
from .progress import Progress, Report
from .provenance import provenance

INTERRUPTIONS = (KeyboardInterrupt, Stopped)
"""What ends a fit; what was fitted before is kept."""

OF_THE_DATA = (DataError, ModelError)
"""Errors for which a condition has no fit; others may not come again."""

UNNAMED = "unnamed"
"""Subject of trials without a code, beside others that have one."""

SMALLEST_CONDITION = 3
"""Trials below which a condition is not fitted: too few to separate parameters from scatter."""


class NothingFitted(InputError):
    """Of the trials, no condition can be fitted."""


def fit_records(
    records: Sequence[Any],
    model: Any,
    options: FitOptions,
    conditions: Sequence[str] = (),
    folder: Path | None = None,
    report: Report | None = None,
) -> FitResult:
    """Fit recorded trials, subject by subject and condition by condition.

    model: of all subjects, or the `Fingers` of each. options.pool fits all subjects as one. Raises
    NothingFitted, and InputError for records that do not go together.
    """
    fingers = Fingers.of(model)
    _check_spelling(records)
    fingers.check((record.subject or UNNAMED for record in records), options.pool)
    if not options.pool:
        _check_fingers(records)
    screened = screen(records, options.indentation_sd > 0)
    memory = options.memory(fingers.space, material_of(fingers.any.model))
    trials, excluded = prepare_all(screened.records, options, memory)
    exclusions = [*screened.exclusions, *excluded]
    if not trials:
        raise nothing_to_fit(exclusions)
    fingers, on_models = _serving(fingers, trials, options)
    notes = [*screened.notes, *options.without_effect(), *_on_memory(trials, memory), *on_models]
    subjects: dict[str, list[FitTrial]] = {}
    for trial in trials:
        subjects.setdefault(trial.subject, []).append(trial)
    _check_codes(subjects)
    with engine_for(options.dask) as engine:
        work = _Work(fingers, options, conditions, engine, folder, report)
        if len(subjects) == 1 or options.pool:
            return _fit_as_one(work, trials, exclusions, notes)
        own = {subject or UNNAMED: found for subject, found in sorted(subjects.items())}
        return _fit_each(work, own, exclusions, notes)


def _serving(
    fingers: Fingers, trials: Sequence[FitTrial], options: FitOptions
) -> tuple[Fingers, list[str]]:
    """The fingers with models that reach the largest force of the trials, and what to say of these
    models."""
    highest = max(trial.drive.highest for trial in trials)
    corners = np.array(list(itertools.product(*options.box(fingers.space))))
    served = fingers.serving(highest, corners)
    models = [finger.model for finger in served.by_subject.values()]
    notes = []
    if any(m is not f.model for m, f in zip(models, fingers.by_subject.values())):
        notes.append(
            f"the force goes up to {highest:.2f} N, beyond the reduced model of the default "
            "finger: fitted with that of the population box"
        )
    notes += dict.fromkeys(filter(None, (getattr(model, "doubt", "") for model in models)))
    if material_of(models[0]) is None:
        notes.append(
            "the model has no 'material', the law of its parameters: without it there is no "
            "full-order model, for correction, check, the finger's lengths and the deformed "
            "finger, and no parameters.yaml"
        )
    return served, notes


def _on_memory(trials: Sequence[FitTrial], memory: float) -> list[str]:
    """Say how many trials may remember presses before the force that was kept; memory: s."""
    if memory <= LONGEST:
        return []
    cut = sum(t.recording.before_time.min(initial=0.0) < 1.0 - LONGEST for t in trials)
    if not cut:
        return []
    return [
        f"tissue of the search box may take up to {memory:.0f} s to recover from a press, and the "
        f"force before a press is known for {LONGEST:.0f} s: {cut} presses may begin with tissue "
        "that has not recovered from presses before; where it recovers faster, give lower upper "
        "bounds of the times or fractions with --bounds"
    ]


def _check_fingers(records: Sequence[Any]) -> None:
    """Raise InputError for trials of one subject that are of two fingers."""
    fingers: dict[str, dict[str, list[Path]]] = {}
    for record in records:
        fingers.setdefault(record.subject or "", {}).setdefault(finger_of(record), []).append(
            _bag_of(record)
        )
    for code, bags in fingers.items():
        if not may_be_one(*bags):
            found = listed(f"{finger} in {listed(of, 1)}" for finger, of in bags.items() if finger)
            raise InputError(
                f"subject {code or UNNAMED} has trials of several fingers ({found}): fit the bags "
                "of each finger alone, into folders of their own, or all as if they were of one "
                "finger with --pool"
            )


def _bag_of(record: Any) -> Path:
    """Bag of a trial, short enough for a message."""
    return Path(*Path(record.bag).parts[-2:])


def _check_spelling(records: Sequence[Any]) -> None:
    """Raise InputError for subjects or conditions whose names differ in case or spaces alone."""
    for kind in ("subject", "condition"):
        first_of: dict[str, Any] = {}
        for record in records:
            first_of.setdefault(getattr(record, kind) or "", record)
        if twins := same_but_for_spelling(first_of):
            one, other = (f"'{name}' in {_bag_of(first_of[name])}" for name in twins)
            raise InputError(
                f"{kind}s {one} and {other} {SPELLING_ALONE}, or fit each of them alone"
            )


def _check_codes(subjects: Iterable[str]) -> None:
    """Raise InputError for the code of a subject that cannot name a folder."""
    for code in subjects:
        check_condition_name(code, "subject")


_Outcome = FitResult | FingerError
"""Result of one subject, or why it cannot be fitted."""


@dataclasses.dataclass(frozen=True)
class _Work:
    """What the fits of all subjects share.

    conditions: names to fit, empty for all; folder: for checkpoints, none are kept without; report:
    learns of the progress.
    """

    fingers: Fingers
    options: FitOptions
    conditions: Sequence[str]
    engine: Engine
    folder: Path | None = None
    report: Report | None = None

    def one_by_one(
        self, subjects: Mapping[str, Sequence[FitTrial]]
    ) -> Iterator[tuple[str, _Outcome]]:
        """Fit each subject's trials on this machine, up to a fit that was interrupted."""
        fitted = False
        for name, trials in subjects.items():
            within = None if self.folder is None else self.folder / name
            own = dataclasses.replace(self, folder=within, report=_told(self.report, name))
            try:
                part = own.fit_subject(trials)
            except FingerError as error:
                yield name, error
                continue
            except INTERRUPTIONS:
                if not fitted:
                    raise
                return
            fitted = True
            yield name, part
            if part.stopped:
                return

    def on_cluster(
        self, subjects: Mapping[str, Sequence[FitTrial]]
    ) -> Iterator[tuple[str, _Outcome]]:
        """Fit each subject's trials as one piece of work of a cluster, without checkpoints."""
        done = Progress("", len(self.fingers.space), self.report).count("subjects")
        # A worker may have no processes of its own.
        shared = _Work(self.fingers, self.options, self.conditions, LocalEngine(1))
        with not_kept(), interruptible():
            found = self.engine.map(_fit_alone, shared, list(subjects.values()), done)
        found_something()
        return zip(subjects, found, strict=True)

    def fit_subject(self, trials: Sequence[FitTrial]) -> FitResult:
        """Fit the conditions of one subject; raises InputError when none can be fitted."""
        groups, notes = group_trials(trials, self.options, self.conditions)
        finger = self.fingers.of_subject(trials[0].subject or UNNAMED)
        fits: dict[str, ConditionFit] = {}
        stopped = lost = False
        left = list(groups)
        for name, group in groups.items():
            if len(group) < SMALLEST_CONDITION:
                left.remove(name)
                notes.append(
                    f"condition '{name}' has {len(group)} trial{'s' * (len(group) != 1)}, "
                    f"{SMALLEST_CONDITION} are needed: not fitted"
                )
                continue
            try:
                problem = FitProblem(group, finger.model, self.options, finger.lengths)
                fit = fit_condition(problem, name, self.engine, self.folder, self.report)
                if fit.status != "interrupted":
                    fit.quality = quality_of(fit)
                    judge(fit)
            except INTERRUPTIONS:
                if not fits:
                    raise
                stopped = True
                break
            except OF_THE_DATA as error:
                left.remove(name)
                wide = isinstance(error, ModelError) and self.options.bounds
                remedy = f"; narrow the bounds {', '.join(self.options.bounds)}" if wide else ""
                notes.append(f"condition '{name}' is not fitted: {error}{remedy}")
                continue
            except FingerError as error:
                lost = True
                notes.append(
                    f"condition '{name}' is lost: {error}; parameters.yaml and subjects/ are left "
                    "as they were: fit again"
                )
                continue
            if self.options.resume and not fit.pso.resumed:
                notes.append(
                    f"condition '{name}': no checkpoint to resume from; its search began anew"
                )
            if fit.unsaved:
                notes.append(
                    f"condition '{name}': a checkpoint, which only --resume needs, lacks the last "
                    f"rounds: {fit.unsaved}"
                )
            fits[name] = fit
            left.remove(name)
            if fit.status == "interrupted":
                stopped = True
                break
        if not fits:
            kind = InputError if lost else DataError
            raise kind(f"no condition can be fitted ({'; '.join(notes)})")
        result = FitResult(self.options, fits, [], notes, stopped=stopped, missing=left)
        self._complete(result, trials)
        return result

    def _complete(self, result: FitResult, trials: Sequence[FitTrial]) -> None:
        """Add the contrasts and the additional fits, and what to say of the files."""
        if not result.unfinished and material_of(result.model) is not None:
            result.problems += _on_parameter_files(result.fits)
        if not result.stopped:
            try:
                with interruptible():
                    result.contrasts = contrasts(result.fits, codes_of(trials))
                    _further(result, self.engine)
            except INTERRUPTIONS:
                result.stopped = True
            except FingerError as error:
                result.problems.append(f"the additional fits are not complete: {error}")
        if result.stopped:
            note = "interrupted: what the report does not show was not computed"
            if result.unfinished:
                note += (
                    f"; not fitted to the end: {', '.join(result.unfinished)}, so that "
                    "parameters.yaml and subjects/ are left as they were"
                )
            result.problems.append(note)


def _fit_as_one(
    work: _Work, trials: Sequence[FitTrial], exclusions: list[Exclusion], notes: list[str]
) -> FitResult:
    """Fit all trials as those of one subject, `notes` before its own; raises NothingFitted."""
    subjects = dict.fromkeys(trial.subject for trial in trials)
    if len(subjects) > 1:
        notes = [*notes, f"{len(subjects)} subjects are pooled: {', '.join(subjects)}"]
    elif not may_be_one(*(named := {t.finger for t in trials})):
        notes = [*notes, f"fingers are pooled: {', '.join(sorted(filter(None, named)))}"]
    try:
        part = work.fit_subject(trials)
    except InputError as error:
        raise NothingFitted(f"{error}{_left_out(exclusions)}") from None
    return dataclasses.replace(part, exclusions=exclusions, problems=[*notes, *part.problems])


def _fit_each(
    work: _Work,
    subjects: Mapping[str, Sequence[FitTrial]],
    exclusions: list[Exclusion],
    notes: list[str],
) -> FitResult:
    """Fit the trials of each subject by itself; `notes` gets what is to be said of one. Raises
    NothingFitted when no subject can be fitted."""
    parts: dict[str, FitResult] = {}
    missing: list[str] = []
    tried = 0
    outcomes = work.on_cluster(subjects) if work.options.dask else work.one_by_one(subjects)
    for name, found in outcomes:
        tried += 1
        if isinstance(found, FingerError):
            notes.append(f"subject {name}: {found}")
            missing += [] if isinstance(found, OF_THE_DATA) else [name]
            continue
        parts[name] = found
        missing += [f"{name} {condition}" for condition in found.missing]
        _exclude(found, exclusions, name)
        notes += [f"subject {name}: {note}" for note in found.problems]
    if tried < len(subjects):
        notes.append(f"interrupted: not fitted: subjects {', '.join(list(subjects)[tried:])}")
    if not parts:
        why = f"({'; '.join(notes)}){_left_out(exclusions)}"
        raise NothingFitted(f"no subject can be fitted {why}")
    return FitResult(
        work.options,
        {f"{name} {c}": fit for name, part in parts.items() for c, fit in part.fits.items()},
        exclusions,
        notes,
        subjects=parts,
        contrasts=[found for part in parts.values() for found in part.contrasts],
        stopped=tried < len(subjects) or any(part.stopped for part in parts.values()),
        missing=missing,
    )


def _on_parameter_files(fits: Mapping[str, ConditionFit]) -> list[str]:
    """Notes on the conditions of one subject that the model node cannot choose by moisture, or is
    not to use."""
    notes = []
    unread = [name for name, fit in fits.items() if not np.isfinite(fit.moisture[0])]
    if unread and len(fits) > 1:
        notes.append(
            f"no moisture readings, by which the model node chooses, of {', '.join(unread)}: "
            "each gets a parameter file of its own"
        )
    near = results.too_near(fits)
    if near:
        shown = {n: "{} ({:.1f} ± {:.1f} a.u.)".format(n, *fits[n].moisture) for n in sum(near, ())}
        notes.append(
            f"the moistures of {', '.join(shown.values())} lie closer than their readings scatter, "
            "so that no reading tells them apart: each condition gets a parameter file of its own"
        )
    failing = [name for name, fit in fits.items() if results.failing(fit)]
    if failing:
        notes.append(
            f"a data check fails: {', '.join(failing)} stays out of subjects/, and is marked 'not "
            "final' in the parameter file"
        )
    return notes


def _fit_alone(work: _Work, trials: Sequence[FitTrial]) -> _Outcome:
    """Fit one subject's trials in a worker of a cluster."""
    try:
        return work.fit_subject(trials)
    except FingerError as error:
        return error


def _told(report: Report | None, subject: str) -> Report | None:
    """A report of progress that names the subject before the condition."""
    if report is None:
        return None
    return lambda condition, *rest: report(f"{subject} {condition}".strip(), *rest)


def _exclude(part: FitResult, exclusions: Sequence[Exclusion], subject: str) -> None:
    """Give the result of one subject the exclusions that are its own."""
    own = [e for e in exclusions if (e.subject or UNNAMED) == subject]
    part.exclusions = [*own, *part.exclusions]


def nothing_to_fit(exclusions: Sequence[Exclusion]) -> NothingFitted:
    """The error of a fit without a usable trial."""
    return NothingFitted(f"no trial can be fitted ({_reasons(exclusions) or 'the bags hold none'})")


def _left_out(exclusions: Sequence[Exclusion]) -> str:
    return f"; left out: {_reasons(exclusions)}" if exclusions else ""


def _reasons(exclusions: Sequence[Exclusion]) -> str:
    grouped = by_reason(exclusions).items()
    return listed((f"{listed(labels, 3)}: {reason}" for (_, reason), labels in grouped), 3, "; ")


def _further(result: FitResult, engine: Engine) -> None:
    """The other force mode, and the additional fits that the options ask for."""
    options, fits = result.options, result.fits
    progress = Progress("", len(result.space), None)
    # A fit by the full-order model itself takes minutes, and is not repeated for a comparison.
    if not isinstance(next(iter(fits.values())).problem.model, FullOrderAreas):
        with progress.timed("other force mode"):
            result.force_modes = {name: force_modes(fit) for name, fit in fits.items()}
    if options.shared and len(fits) == 1:
        result.problems.append(
            f"{', '.join(options.shared)} can be shared by two or more conditions, one is fitted: "
            "no joint fit"
        )
    elif options.shared:
        result.shared = shared_fit(
            {name: fit.problem for name, fit in fits.items()},
            {name: fit.parameters for name, fit in fits.items()},
            options.shared,
        )
    full_order = FullOrder.like(result.model, engine)
    if options.extra == "epidermis_thickness" and full_order is not None:
        with progress.timed("thickness"):
            result.thickness = {
                name: thickness_fit(fit.problem, fit.parameters, full_order)
                for name, fit in fits.items()
            }
    result.seconds.update(progress.seconds)


def fit_bags(
    paths: Sequence[str | Path],
    options: FitOptions | None = None,
    output: str | Path | None = None,
    conditions: Sequence[str] = (),
    model: Any = None,
    report: Report | None = None,
    settings: TrialSettings | None = None,
    command: str = "",
) -> FitResult:
    """Fit bags and write fit.json, parameters.yaml, report.html and its figures into `output`.

    paths: bags and folders of bags; model: a ReducedModel, a FullOrderAreas of any law or the
    `Fingers` of the subjects, None for the shipped reduced model; conditions: names to fit, empty
    for all; settings: how the bags are read, by `reading`; command: how the fit was asked for, for
    its provenance. Of several subjects, each has its own folder in `output`. Nothing is written
    without `output`. KeyboardInterrupt during a stage or the report gives the result so far, with
    `stopped` set; anywhere else, and before anything was found, it is raised. Raises InputError for
    bags that cannot be fitted, and for an output folder that holds a fit of other subjects or that
    another fit writes into; NotWritten for files that cannot be written.
    """
    options = options or FitOptions()
    fingers = Fingers.of(model or ReducedModel.load())
    options.check_names(fingers.space, fingers.geometries)
    folder = None if output is None else Path(output)
    with contextlib.nullcontext() if folder is None else results.alone_in(folder):
        progress = Progress("", len(fingers.space), report)
        with progress.timed("load"):
            loaded = load(paths, settings or reading(options), progress.count("load"))
        found = noted(loaded.problems)
        if not loaded.records:
            raise InputError(f"{nothing_to_fit(loaded.exclusions)}{found}")
        if folder is not None:
            tried = {Finger(r.subject, finger_of(r)) for r in loaded.records}
            left_out = {Finger(e.subject, "") for e in loaded.exclusions}
            results.check_folder(folder, tried | left_out)
        with kept():
            try:
                result = fit_records(loaded.records, fingers, options, conditions, folder, report)
            except NothingFitted as error:
                raise InputError(f"{error}{_left_out(loaded.exclusions)}{found}") from None
            result.exclusions = [*loaded.exclusions, *result.exclusions]
            for name, part in result.subjects.items():
                _exclude(part, loaded.exclusions, name)
            result.problems = [*loaded.problems, *result.problems]
            result.lost = loaded.lost
            for part in (result, *result.subjects.values()):
                part.sources = provenance(part, options, loaded.sources, command)
            result.seconds.update(progress.seconds)
            for fit in result.fits.values():
                for stage, spent in fit.seconds.items():
                    result.seconds[stage] = result.seconds.get(stage, 0.0) + spent
            result.output = folder
            if folder is not None:
                _write(result, folder, progress)
    return result


class NotWritten(InputError):
    """Files of a fit cannot be written; result: the fit."""

    def __init__(self, message: str, result: FitResult) -> None:
        super().__init__(message)
        self.result = result


def _write(result: FitResult, folder: Path, progress: Progress) -> None:
    """Files first, then the report; a stopped fit writes what it found. An interruption after the
    files becomes a note. Raises NotWritten."""
    state = "not all files of the fit are written"
    written = "results" if result.interrupted else "results and parameters"
    try:
        results.write(result, folder)
        state = f"{written} are written, the report is not"
        results.remove_pages(result, folder)
        try:
            from ..report import remove_figures, write_report  # seconds: they import matplotlib

            remove_figures(result, folder)
            with interruptible():
                with contextlib.suppress(Stopped):
                    progress.count("report")(0, 1)
                with progress.timed("report"):
                    draw(result)
                    write_report(result, folder)
            state = f"{written} are written, and the report, but not the time that it took"
            result.seconds.update(progress.seconds)
            results.write(result, folder)
        except KeyboardInterrupt:
            result.stopped = True
            result.problems.append(f"interrupted: {state}")
            return
    except (FingerError, OSError) as error:
        reason = str(error)
        if isinstance(error, OSError):
            reason = f"{error.filename or folder}: {error.strerror}; check rights and disk"
        raise NotWritten(f"{reason}; {state}", result) from None
    with contextlib.suppress(Stopped):
        progress.count("report")(1, 1)


def draw(result: FitResult) -> None:
    """Compute the deformed finger that the report of each subject shows."""
    for part in result.parts.values():
        full_order = FullOrder.like(part.model)
        if full_order is None:
            return
        fit, trial = part.example()
        try:
            part.deformed = deformed_finger(fit, trial, full_order)
        except ModelError as error:
            part.problems.append(f"the deformed finger is not drawn: {error}")
