# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fitted material parameters per moisture condition, and their interpolation over moisture.

`parameters.yaml`, written by a fit and loaded by the model node::

    law: …                    # of the parameters; may be absent for the default law
    geometry_hash: …          # hash of the geometry the sets were fitted with; "" when unknown
    geometry: {…}             # its lengths, as in geometry.yaml; left out for the finger in use,
                              # where a recorded event has them unless it is the default one
    reduced_model_hash: …     # hash of the reduced model they were fitted with; "" when unknown
    sets:
      - condition: natural
        moisture: 69.31       # a.u., mean reading of the trials
        moisture_sd: 6.54     # a.u.
        status: final         # of the fit; may be absent
        E0: 80000.0           # the parameters of the law, in SI
        …
        covariance_log:       # (n, n), of the logarithms of the n parameters; may be absent
          - [0.09, 0.0, 0.0, 0.0]
          - …

A key `prior` says how fingers differ from the sets, see `finger_prior`; the shipped file has one.
A key `presses` says how much the presses of the fit differ, see `press_scatter`.

Between two sets the logarithms of the parameters and the covariance are interpolated linearly over
moisture. Beyond the driest and the wettest set the end set holds. The result is marked where the
reading is further out than twice the set's own `moisture_sd`, and than a reading errs.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from finger_common.errors import InputError, known_names, listed
from finger_common.files import atomic_write, number, parse_yaml, read_text, sha256_of
from finger_common.moisture import MOISTURE_TEXT, is_moisture

from .finger_prior import FingerPrior
from .geometry import Geometry
from .laws import ConstitutiveLaw, ParameterSpace, StandardLinearSolid, law_of
from .press_scatter import PressScatter


@dataclass(frozen=True)
class ParameterSet:
    """Parameters of one condition.

    moisture, moisture_sd: a.u.; parameters (n,): in the order of the law's space, SI;
    covariance_log (n, n): covariance of their logarithms, zero where it is not known; status: of
    the fit they are from, empty where it is not known.
    """

    condition: str
    moisture: float
    moisture_sd: float
    parameters: tuple[float, ...]
    covariance_log: tuple[tuple[float, ...], ...] = ()
    status: str = ""

    def __post_init__(self) -> None:
        n = len(self.parameters)
        rows = self.covariance_log if len(self.covariance_log) else ((0.0,) * n,) * n
        object.__setattr__(self, "parameters", tuple(map(float, self.parameters)))
        object.__setattr__(self, "covariance_log", tuple(tuple(map(float, r)) for r in rows))

    def to_dict(self, space: ParameterSpace) -> dict[str, Any]:
        """As one entry of `sets` in parameters.yaml."""
        return {
            "condition": self.condition,
            "moisture": self.moisture,
            "moisture_sd": self.moisture_sd,
            **({"status": self.status} if self.status else {}),
            **dict(zip(space.names, self.parameters)),
            "covariance_log": [list(row) for row in self.covariance_log],
        }


@dataclass(frozen=True)
class InterpolatedParameters:
    """Parameters at one moisture reading.

    parameters (n,): in the order of the law's space, SI; covariance_log (n, n);
    out_of_range: the reading lies outside those of the fitted sets and an end set is held;
    name: id of the parameters, "HASH@MOISTURE" with the first digits of the sets' hash.
    """

    parameters: np.ndarray
    covariance_log: np.ndarray
    out_of_range: bool
    name: str


class ParameterSets:
    """The sets of one parameters.yaml, in the order of their moisture.

    `law` is the law that the parameters belong to, `space` its parameters; `where` names their
    file in messages. Raises InputError for no sets, two sets at one moisture, or values that the
    space refuses.
    """

    def __init__(
        self,
        sets: Sequence[ParameterSet],
        geometry_hash: str = "",
        *,
        reduced_model_hash: str = "",
        where: str = "parameter sets",
        law: type[ConstitutiveLaw] = StandardLinearSolid,
        prior: FingerPrior | None = None,
        geometry: Geometry | None = None,
        presses: PressScatter | None = None,
    ) -> None:
        if not sets:
            raise InputError(f"{where}: 'sets' is empty; give at least one parameter set")
        self.where = where
        self.law = law
        self.space = law.PARAMETERS
        self.sets = tuple(sorted(sets, key=lambda s: s.moisture))
        self.prior = prior
        self.presses = presses
        if geometry is not None and geometry_hash not in ("", geometry.hash()):
            raise InputError(f"{where}: 'geometry' is not that of 'geometry_hash'; correct one")
        self.geometry = geometry
        self.geometry_hash = geometry_hash if geometry is None else geometry.hash()
        self.reduced_model_hash = reduced_model_hash
        self._moisture = np.array([s.moisture for s in self.sets])
        if np.any(np.diff(self._moisture) <= 0):
            raise InputError(f"{where}: two sets have the same moisture; merge them or correct one")
        vectors = [_checked(s, law, where) for s in self.sets]
        self._log = self.space.to_log(np.array(vectors))
        self._covariance = np.array([s.covariance_log for s in self.sets])
        self.hash = sha256_of(
            [
                *self._law_key().values(),
                *self._entries(),
                *self._prior_key().values(),
                *self._presses_key().values(),
                *self._geometry_key().values(),
            ]
        )

    def _law_key(self) -> dict[str, str]:
        """The key `law`, which files of the default law do not have."""
        return {} if self.law is StandardLinearSolid else {"law": self.law.name}

    def _prior_key(self) -> dict[str, Any]:
        """The key `prior`, which files without one do not have."""
        return {"prior": self.prior.to_dict()} if self.prior else {}

    def _presses_key(self) -> dict[str, Any]:
        """The key `presses`, which files without one do not have."""
        return {"presses": self.presses.to_dict()} if self.presses else {}

    def _geometry_key(self) -> dict[str, Any]:
        """The key `geometry`, which files without lengths do not have."""
        return {"geometry": self.geometry.to_dict()} if self.geometry else {}

    def _entries(self) -> list[dict[str, Any]]:
        return [s.to_dict(self.space) for s in self.sets]

    # Files -----------------------------------------------------------------------------------

    @classmethod
    def parse(cls, text: str, where: str = "parameter sets") -> ParameterSets:
        """From the text of parameters.yaml; raises InputError naming `where`, set and key."""
        data = parse_yaml(text, where)
        law = law_of(str(data.get("law") or ""))
        entries = data.get("sets")
        if not isinstance(entries, list):
            raise InputError(
                f"{where}: key 'sets' with a list of parameter sets is missing; add it"
            )
        _check_keys(data, _FILE_KEYS, where)
        return cls(
            [
                _parse_set(entry, law.PARAMETERS, f"{where}, set {i + 1}")
                for i, entry in enumerate(entries)
            ],
            str(data.get("geometry_hash") or ""),
            reduced_model_hash=str(data.get("reduced_model_hash") or ""),
            where=where,
            law=law,
            prior=FingerPrior.parse(data["prior"], where) if data.get("prior") else None,
            geometry=_parse_geometry(data.get("geometry"), where),
            presses=PressScatter.parse(data["presses"], where) if data.get("presses") else None,
        )

    @classmethod
    def load(cls, path: str | Path) -> ParameterSets:
        """From a parameters.yaml; raises InputError."""
        return cls.parse(read_text(path, "parameter file"), str(path))

    @classmethod
    @functools.cache
    def default(cls) -> ParameterSets:
        """The shipped sets: dry, natural and moist finger of the paper (sources in the file)."""
        file = resources.files(__package__) / "data" / "parameters.yaml"
        return cls.parse(file.read_text(encoding="utf-8"), "data/parameters.yaml")

    def to_yaml(self) -> str:
        """Text of a parameters.yaml; `parse` of it gives equal sets, bit for bit."""
        return self._text

    @functools.cached_property
    def _text(self) -> str:
        return yaml.safe_dump(
            {
                **self._law_key(),
                "geometry_hash": self.geometry_hash,
                **self._geometry_key(),
                "reduced_model_hash": self.reduced_model_hash,
                **self._prior_key(),
                **self._presses_key(),
                "sets": self._entries(),
            },
            sort_keys=False,
            allow_unicode=True,
        )

    def save(self, path: str | Path) -> None:
        """Write parameters.yaml."""
        with atomic_write(path) as file:
            file.write(self.to_yaml())

    # Use -------------------------------------------------------------------------------------

    def with_prior(
        self, prior: FingerPrior, geometry: Geometry, presses: PressScatter | None = None
    ) -> ParameterSets:
        """The same sets with another distribution of fingers, of this geometry, about them, and the
        scatter of the presses that it was found from."""
        same = geometry.hash() == self.geometry_hash
        return ParameterSets(
            self.sets,
            reduced_model_hash=self.reduced_model_hash if same else "",
            where="",
            law=self.law,
            prior=prior,
            geometry=geometry,
            presses=presses,
        )

    def of_finger(self, geometry: Geometry) -> ParameterSets:
        """The same sets with the lengths of the finger in use; without any for the default one."""
        if geometry.hash() == (self.geometry or Geometry()).hash():
            return self
        return ParameterSets(
            self.sets,
            reduced_model_hash=self.reduced_model_hash,
            where=self.where,
            law=self.law,
            prior=self.prior,
            geometry=geometry,
            presses=self.presses,
        )

    def of_condition(self, condition: str) -> ParameterSet:
        """Find the set of a condition; without a name the only one.

        Raises InputError for an unknown condition, and for none where there are several.
        """
        names = [s.condition for s in self.sets]
        if not condition:
            if len(self.sets) == 1:
                return self.sets[0]
            raise InputError(
                f"{self.where}: holds {len(self.sets)} sets; choose one by its condition "
                f"({', '.join(names)}) or by the moisture"
            )
        found = [s for s in self.sets if s.condition == condition]
        if len(found) != 1:
            if found:
                readings = listed(f"{s.moisture:g}" for s in found)
                raise InputError(
                    f"{self.where}: {len(found)} sets are of the condition '{condition}'; choose "
                    f"one by its moisture ({readings} a.u.), or rename one"
                )
            raise InputError(
                f"{self.where}: no set of the condition '{condition}'; "
                f"{known_names(condition, names)}"
            )
        return found[0]

    def interpolate(self, moisture: float) -> InterpolatedParameters:
        """Parameters at a reading (a.u.); raises InputError for one off the scale."""
        if not is_moisture(moisture):
            raise InputError(f"moisture is {moisture:g}, a number in {MOISTURE_TEXT} is needed")
        parameters, covariance, out_of_range = self.space.interpolate(
            self._moisture, self._log, self._covariance, moisture, self._margins
        )
        name = f"{self.hash[:8]}@{moisture:.2f}"
        return InterpolatedParameters(parameters, covariance, out_of_range, name)

    @functools.cached_property
    def _margins(self) -> np.ndarray:
        """a.u. (s,) beyond the mean of each set in which readings are still those of its trials."""
        prior = self.prior or ParameterSets.default().prior
        assert prior is not None
        return np.maximum([2.0 * s.moisture_sd for s in self.sets], prior.reading_sd)

    def doubt(self) -> str:
        """A sentence where sets are from fits that are not final; empty where none is."""
        doubtful = [
            s.condition or f"{s.moisture:g} a.u." for s in self.sets if s.status in _DOUBTFUL
        ]
        if not doubtful:
            return ""
        return (
            f"the parameters of {listed(doubtful)} are from a fit that is not final: its report "
            "says why"
        )


def _checked(found: ParameterSet, law: type[ConstitutiveLaw], where: str) -> np.ndarray:
    """Parameters (n,) of a set; raises InputError, naming it, for what its law refuses."""
    name = f"{where}, set {found.condition or f'at {found.moisture:g}'}"
    vector = law.PARAMETERS.checked(found.parameters, name)
    try:
        law().with_vector(vector)
    except InputError as error:
        raise InputError(str(error).replace("material", name, 1)) from None
    return vector


_DOUBTFUL = ("not final", "interrupted")
"""Statuses of a fit that are no result; one that was merely not checked is not among them."""

_SET_KEYS = ("condition", "moisture", "moisture_sd", "status", "covariance_log")
_FILE_KEYS = ("law", "geometry_hash", "geometry", "reduced_model_hash", "prior", "presses", "sets")


def _check_keys(data: dict[str, Any], known: Sequence[str], where: str) -> None:
    for key in data:
        if key not in known:
            raise InputError(f"{where}: unknown key '{key}'; {known_names(str(key), known)}")


def _parse_set(entry: Any, space: ParameterSpace, where: str) -> ParameterSet:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected 'key: value' lines, found {entry!r}")
    _check_keys(entry, (*_SET_KEYS, *space.names), where)
    parameters = space.checked([number(entry, name, where) for name in space.names], where)
    moisture = number(entry, "moisture", where)
    deviation = number(entry, "moisture_sd", where) if "moisture_sd" in entry else 0.0
    if deviation < 0.0:
        raise InputError(f"{where}: 'moisture_sd' is {deviation:g}, zero or more is needed")
    if not is_moisture(moisture):
        raise InputError(f"{where}: 'moisture' is {moisture}, outside {MOISTURE_TEXT}; correct it")
    return ParameterSet(
        str(entry.get("condition") or ""),
        moisture,
        deviation,
        tuple(parameters.tolist()),
        _parse_covariance(entry.get("covariance_log"), len(space), where),
        str(entry.get("status") or ""),
    )


def _parse_geometry(data: Any, where: str) -> Geometry | None:
    if data is None:
        return None
    if not isinstance(data, dict):
        raise InputError(f"{where}: 'geometry' needs 'key: value' lines as in geometry.yaml")
    return Geometry.from_dict(data, f"{where}, geometry")


def _parse_covariance(rows: Any, n: int, where: str) -> tuple[tuple[float, ...], ...]:
    """Covariance (n, n) of the logarithms; empty when it is absent."""
    if rows is None:
        return ()
    try:
        covariance = np.array(rows, dtype=float)
    except (TypeError, ValueError):
        covariance = np.array(math.nan)
    if covariance.shape != (n, n) or not np.all(np.isfinite(covariance)):
        raise InputError(
            f"{where}: 'covariance_log' is not a {n} × {n} matrix of numbers; correct it"
        )
    scale = float(np.abs(covariance).max())
    symmetric = np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-9 * scale)
    if not symmetric or np.linalg.eigvalsh(covariance)[0] < -1e-6 * scale:
        raise InputError(
            f"{where}: 'covariance_log' is no covariance (symmetric, no negative variance in any "
            "direction); correct it"
        )
    return tuple(map(tuple, covariance.tolist()))
