# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The finger that a fit assumes: the model of its lengths, and how well these are known."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError, known_names, listed
from finger_model.anthropometry import GeometryEstimate, estimate_geometry
from finger_model.finger import load_areas, serving
from finger_model.geometry import DEVIATIONS, LENGTHS, Geometry, StatedGeometry
from finger_model.laws import ParameterSpace

from .nuisance_priors import CALIPERS

ALL = ""
"""Key of the finger of all subjects."""

GeometrySource = Geometry | GeometryEstimate | str | Path | Mapping[str, Any] | None
"""A geometry: as an object, as the estimate of caliper readings, by the path of a geometry.yaml, or
by the content of one; "" and None for the default finger, which nobody measured."""


@dataclass(frozen=True)
class KnownLengths:
    """What is known of the lengths of a finger before its fit.

    deviations: relative standard deviations by the keys of geometry.yaml; source: what gave the
    lengths, empty for the default finger, which nobody measured.
    """

    deviations: Mapping[str, float]
    source: str = ""

    @classmethod
    def stated(
        cls, geometry: Geometry, deviations: Mapping[str, float], source: str
    ) -> KnownLengths:
        """Lengths that somebody gave; deviations: in m, those left out are those of calipers."""
        return cls({**CALIPERS, **_relative(geometry, deviations)}, source)

    @classmethod
    def of_model(cls, model: Any) -> KnownLengths:
        """Lengths by a model alone: those of another finger than the default one were given with
        it."""
        geometry = getattr(model, "geometry", None) or Geometry()
        if geometry != Geometry():
            return cls.stated(geometry, {}, "the model")
        return _unmeasured()


@functools.lru_cache(maxsize=1)
def _unmeasured() -> KnownLengths:
    """The default finger of somebody whose finger nobody measured."""
    typical = estimate_geometry(finger="index")
    return KnownLengths(_relative(typical.geometry, typical.deviations))


def _relative(geometry: Geometry, deviations: Mapping[str, float]) -> dict[str, float]:
    """Deviations (m) over the lengths; a length of 0 has none."""
    lengths = geometry.to_dict()
    return {n: sd / abs(lengths[n]) for n, sd in deviations.items() if lengths[n]}


@dataclass(frozen=True)
class AssumedFinger:
    """The model of a finger, and what is known of its lengths."""

    model: Any
    lengths: KnownLengths

    @classmethod
    def load(
        cls, source: GeometrySource = None, model_file: str | Path = "", law: str = ""
    ) -> AssumedFinger:
        """The model that a fit varies, as `load_areas` makes it; raises InputError as that does,
        and for a geometry that is none."""
        if not source:
            model = load_areas(model_file, "", law)
            known = KnownLengths.of_model(model)
            return cls(model, replace(known, source=known.source and str(model_file)))
        if isinstance(source, Geometry):
            stated, name = StatedGeometry(source, {}), "the program"
        elif isinstance(source, GeometryEstimate):
            stated, name = StatedGeometry(source.geometry, source.deviations), source.measured
        elif isinstance(source, Mapping):
            stated, name = StatedGeometry.from_dict(dict(source)), "the program"
        else:
            stated, name = StatedGeometry.load(source), str(source)
        known = KnownLengths.stated(stated.geometry, stated.deviations, name)
        return cls(load_areas(model_file, stated.geometry, law), known)


@dataclass(frozen=True)
class Fingers:
    """The assumed finger of each subject, by code, or one of all subjects, as `ALL`."""

    by_subject: Mapping[str, AssumedFinger]

    @classmethod
    def of(cls, given: Any) -> Fingers:
        """These, or the finger of a model for all subjects."""
        if isinstance(given, Fingers):
            return given
        return cls({ALL: AssumedFinger(given, KnownLengths.of_model(given))})

    @classmethod
    def load(
        cls, sources: Mapping[str, GeometrySource], model_file: str | Path = "", law: str = ""
    ) -> Fingers:
        """Fingers of geometries by subject; raises InputError as `AssumedFinger.load` does."""
        return cls({s: AssumedFinger.load(g, model_file, law) for s, g in sources.items()})

    @property
    def space(self) -> ParameterSpace:
        """The space of the parameters, the same for all fingers."""
        space: ParameterSpace = self.any.model.space
        return space

    @property
    def any(self) -> AssumedFinger:
        """One of them: the law is the same for all."""
        return next(iter(self.by_subject.values()))

    @property
    def geometries(self) -> list[Geometry | None]:
        """Geometry of each finger; None of a model without one."""
        return [getattr(f.model, "geometry", None) for f in self.by_subject.values()]

    def of_subject(self, subject: str) -> AssumedFinger:
        """The finger of a subject that was checked."""
        return self.by_subject.get(subject) or self.by_subject[ALL]

    def check(self, subjects: Iterable[str], pooled: bool = False) -> None:
        """Raise InputError where fingers by subject do not belong to the subjects of a fit."""
        if ALL in self.by_subject:
            return
        present = sorted(set(subjects))
        if pooled:
            raise InputError(
                "--pool fits all presses as one finger's, and --geometry names the finger of each "
                "subject; leave one of the two out"
            )
        for subject in self.by_subject:
            if subject not in present:
                raise InputError(
                    f"--geometry {subject}=…: no press is of subject '{subject}'; "
                    f"{known_names(subject, present)}"
                )
        missing = [subject for subject in present if subject not in self.by_subject]
        if missing:
            raise InputError(
                f"no --geometry for {listed(missing)}: with lengths by subject each one needs its "
                f"own; add --geometry {missing[0]}=FILE"
            )

    def serving(self, force: float, corners: np.ndarray) -> Fingers:
        """The fingers with models that serve presses up to a force (N), for parameters (P, n) at
        the corners of the search box, as `finger_model.finger.serving`."""
        return Fingers(
            {
                subject: replace(finger, model=serving(finger.model, force, corners))
                for subject, finger in self.by_subject.items()
            }
        )


def geometry_files(texts: Sequence[str]) -> dict[str, GeometrySource]:
    """Files of the option --geometry by subject, given as FILE for all or as SUBJECT=FILE.

    Raises InputError for a subject that is named twice, and for two files for all.
    """
    found: dict[str, GeometrySource] = {}
    for text in texts:
        subject, equals, file = text.partition("=")
        if not equals or Path(text).exists():
            subject, file = ALL, text
        elif not (subject := subject.strip()) or not file:
            raise InputError(f"--geometry {text}: give FILE, or SUBJECT=FILE")
        if subject in found:
            whom = f"for subject {subject}" if subject else "for all subjects"
            raise InputError(f"--geometry {text}: a file {whom} is already given; leave one out")
        found[subject] = file
    if ALL in found and len(found) > 1:
        raise InputError(
            f"--geometry {found[ALL]}: a file for all subjects beside those of some; give each "
            "subject its own, as SUBJECT=FILE"
        )
    return found or {ALL: None}


def by_subject(given: Any) -> dict[str, GeometrySource]:
    """Geometries by subject, of the argument `geometry` of `finger_fit.fit`: of one geometry, or of
    a mapping from subjects to theirs."""
    lengths = {*LENGTHS, DEVIATIONS}
    if isinstance(given, Mapping) and given and not lengths & given.keys():
        if all(isinstance(value, (int, float)) for value in given.values()):
            return {ALL: given}  # lengths under wrong names, which are refused
        return {str(subject).strip(): source for subject, source in given.items()}
    return {ALL: given}
