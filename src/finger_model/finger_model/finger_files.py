# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The files that a finger comes from: reduced model, geometry, parameter sets of a fit or of a
subject."""

from __future__ import annotations

from collections.abc import Callable

from .estimator import ContactEstimator
from .estimator.parameter_selection import check_sets
from .finger import load_reduced, model_for
from .geometry import StatedGeometry
from .parameter_sets import ParameterSets
from .reduced.model import ReducedModel
from .subjects import find_subject


class FingerFiles:
    """What `reduced_model_file` and `geometry_file` hold, and the parameter sets beside them.

    Raises InputError for files that are wrong or do not belong together. warn: takes a sentence
    on files that are used, but may not be meant.
    """

    def __init__(
        self,
        reduced_model_file: str,
        geometry_file: str,
        subjects_folder: str,
        warn: Callable[[str], object],
    ) -> None:
        self._files = reduced_model_file, geometry_file
        self._subjects_folder = subjects_folder
        self._warn = warn
        self._model = load_reduced(*self._files)
        self.stated = StatedGeometry.load(geometry_file) if geometry_file else None
        """What `geometry_file` states."""

    def named_sets(self, path: str) -> ParameterSets:
        """Those of a `parameter_file`, or the shipped ones; raises InputError too where another
        file names a finger of other lengths."""
        sets = self._load(path)
        model_for(sets, self._model, *self._files)
        return sets

    def of_subject(self, subject: str, finger: str) -> ParameterSets | None:
        """Those of a subject's finger, which may bring its own lengths; None without a file."""
        if not self._subjects_folder or not subject:
            return None
        path, told = find_subject(self._subjects_folder, subject, finger)
        if told:
            self._warn(told)
        return self._load(str(path)) if path else None

    def _load(self, path: str) -> ParameterSets:
        sets = ParameterSets.load(path) if path else ParameterSets.default()
        model = self.model_of(sets)
        check_sets(sets, model, path or "the shipped sets")
        # A fit takes the default finger's own model.
        known = "", model.hash, load_reduced(geometry_file=model.geometry).hash
        if sets.reduced_model_hash not in known:
            self._warn(
                f"{path or 'parameter sets'}: fitted with another reduced model of this geometry"
            )
        return sets

    def model_of(self, sets: ParameterSets) -> ReducedModel:
        """The model of the finger whose lengths the sets hold, or else of `geometry_file`."""
        model_file = self._files[0] if self._model.serves_population else ""
        return model_for(sets, self._model, model_file)

    def origin(self, estimator: ContactEstimator, subject: str) -> str:
        """The file that the lengths of the finger in use come from, or what is in its place."""
        if estimator.model.geometry_hash != self._model.geometry_hash:
            return estimator.parameter_sets.where or f"the calibration of {subject}"
        model_file = "" if self._model.serves_population else self._files[0]
        return self._files[1] or model_file or "the default finger"
