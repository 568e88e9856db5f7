# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The reduced model at run time: any parameters and any force history in microseconds a step."""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError, ModelError
from finger_common.files import atomic_write, parse_json, parse_npz, read_bytes, sha256_of

from ..geometry import Geometry
from ..history import ContactHistory, ContactPoint, check_force_history, check_trial, mean_pressure
from ..laws import ConstitutiveLaw, MaxwellLaw, ParameterSpace, StandardLinearSolid, law_of
from ..paper import SEARCH_BOX
from . import kernels as rk
from . import population
from .goals import missed
from .maps import GeometryMaps, Maps, PopulationMaps

FORMAT = 3
"""Version of the file's layout."""

SHIPPED = "reduced_default.npz"
"""Of the default geometry and friction: more exact there than the population's, for moduli of the
paper's search box."""

SHIPPED_POPULATION = "reduced_population.npz"
POPULATION = "population"
"""In place of a file: the shipped model of the population box, for any finger, to about 10 N."""

LAW = StandardLinearSolid
"""The law that models are trained on; their maps hold for any branches (see `training_runs`)."""


@dataclass
class ReducedState:
    """One finger: its parameters (n,), the kernels' records and the time (s) since rest."""

    parameters: np.ndarray
    constants: np.ndarray
    state: np.ndarray
    time: float = 0.0


class Arrays(dict[str, np.ndarray]):
    """The arrays of a file, contiguous and finite; models of several fingers share them.

    digests: of each array; tried: whether a model of them has made a step. Raises ValueError for
    numbers that are not finite.
    """

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        super().__init__(
            (key, np.ascontiguousarray(v, dtype=np.result_type(v.dtype, np.float32)))
            for key, v in arrays.items()
        )
        if not all(np.isfinite(values).all() for values in self.values()):
            raise ValueError("an array holds what is no finite number")
        self.digests = {key: sha256_of(v.tobytes()) for key, v in sorted(self.items())}
        self.tried = False


class ReducedModel:
    """Reduced model of one finger, for one material law.

    arrays, meta: what the file holds, made for one geometry or for the population box; for the
    latter, geometry (default: the default one) and fixed (fixed properties of the material; default
    those of the law) say which finger it is. law: StandardLinearSolid, on which models are trained,
    or another law of Maxwell branches (see `for_law`). geometry_hash: of the geometry; hash: of all
    that it consists of; range: dict of the parameters' (low, high) and of "force"; measured_error:
    what `finger-model verify --reduced` found when it was built; settings: of the build. Raises
    InputError for arrays that do not belong together and fingers outside the population box.
    """

    def __init__(
        self,
        arrays: dict[str, np.ndarray],
        meta: dict[str, Any],
        law: type[MaxwellLaw] | None = None,
        geometry: Geometry | None = None,
        fixed: dict[str, float] | None = None,
    ) -> None:
        try:
            self.arrays = arrays if isinstance(arrays, Arrays) else Arrays(arrays)
            self.meta = meta
            self.serves_population = bool(meta.get("population", False))
            if self.serves_population:
                self.geometry = geometry or Geometry()
                self.geometry_hash = self.geometry.hash()
                self._fixed = {**_fixed_of(LAW()), **(fixed or {})}
            else:
                self.geometry = Geometry.from_dict(meta["geometry"], "reduced model")
                self.geometry_hash = str(meta["geometry_hash"])
                self._fixed = {
                    **_fixed_of(LAW()),
                    **meta.get("fixed", {}),
                    "friction": float(meta["friction"]),
                }
            self._box = {k: (float(v[0]), float(v[1])) for k, v in meta["range"].items()}
            self.settings = dict(meta["settings"])
            trained_on = law_of(str(meta.get("law", "")))
            self.law = law or LAW
            self._prepare()
            if not self.arrays.tried:
                self._try_out()
                self.arrays.tried = True
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise InputError(
                f"reduced model: the file is not complete ({error}); build it again with "
                "'finger-model reduce'"
            ) from None
        if trained_on is not LAW:
            raise InputError(
                f"reduced model: trained on the law '{trained_on.name}'; only reduced models of "
                f"'{LAW.name}' can be run, use --solver full"
            )
        if self.geometry.hash() != self.geometry_hash:
            raise InputError(
                "reduced model: its geometry does not have the hash it claims; build it again with "
                "'finger-model reduce'"
            )
        if self.serves_population:
            population.check_geometry(self.geometry)
            population.check_fixed(self._fixed)

    @property
    def friction(self) -> float:
        """Friction coefficient between skin and plate."""
        return self._fixed["friction"]

    @property
    def measured_error(self) -> dict[str, Any]:
        """Errors measured when the file was built: for the population, those of the region in which
        the finger lies with the law's default parameters."""
        return self.error_of(self.material.vector())

    def error_of(
        self, parameters: np.ndarray | ConstitutiveLaw, force: float = 0.0
    ) -> dict[str, Any]:
        """The same of these parameters, in contacts up to a force (N)."""
        error = dict(self.meta["measured_error"])
        if not self.serves_population:
            return error
        return dict(error.get(self.region_of(parameters, force), {}))

    def region_of(self, parameters: np.ndarray | ConstitutiveLaw, force: float = 0.0) -> str:
        """Region of the population box whose stated error holds: "middle" or "whole"."""
        return population.region_of(self.geometry, self._material(parameters), force)

    def rms_error_of(self, parameters: np.ndarray | ConstitutiveLaw, force: float = 0.0) -> float:
        """RMS error of the area against the full order's, with these parameters, up to a force (N).

        A share of the largest area of a history, which 90 % of the histories of the population's
        model stay below, and 99 % of those of one geometry. Over the area of the moment it is more
        while the force falls.
        """
        # Over the population the largest errors are those of extreme fingers.
        figure = "rms_p90" if self.serves_population else "rms_p99"
        return float(self.error_of(parameters, force).get(figure, 0.01))

    @property
    def doubt(self) -> str:
        """What to say of a model of one geometry whose file states an error beyond the goals; empty
        for others."""
        return "" if self.serves_population else missed(self.measured_error)

    @property
    def space(self) -> ParameterSpace:
        """The parameters of the law it was built for; vectors (n,) have their order."""
        return self.law.PARAMETERS

    @property
    def fixed(self) -> dict[str, float]:
        """Fixed properties of the material that it is for, as in material.yaml."""
        properties = {**self.law().to_dict(), **self._fixed}
        return {name: properties[name] for name in self.law.keys() if name not in self.space}

    @property
    def range(self) -> dict[str, tuple[float, float]]:
        """(low, high) of each parameter of the law, and of "force" in N."""
        found = {}
        for spec in self.space:
            found[spec.name] = self._box.get(spec.name, spec.range)
        if "stiffening" in self.space:
            found["stiffening"] = self._box.get("stiffening", (0.0, 0.0))
        return {**found, "force": self._box["force"]}

    def for_law(self, law: type[ConstitutiveLaw]) -> ReducedModel:
        """The same model for another law of Maxwell branches; raises InputError for other laws."""
        if not issubclass(law, MaxwellLaw):
            raise InputError(f"material: law '{law.name}' has no reduced model; use --solver full")
        if law is self.law:
            return self
        return ReducedModel(self.arrays, self.meta, law, self.geometry, self._fixed)

    def for_material(self, material: ConstitutiveLaw) -> ReducedModel:
        """The same finger with the law and the fixed properties of a material.

        Raises InputError for a law without reduced model and for properties that it does not serve.
        The shipped model of the default geometry gives way to the population's where it must, and
        for moduli outside the paper's search box, where it is less exact.
        """
        model = self.for_law(type(material))
        assert isinstance(material, MaxwellLaw)
        wanted = {name: getattr(material, name) for name in model.fixed}
        if self.serves_population:
            if wanted == model.fixed:
                return model
            return ReducedModel(self.arrays, self.meta, model.law, self.geometry, wanted)
        served = wanted == model.fixed and material.stiffening == 0.0
        if self.gives_way and not (served and population.within(material, SEARCH_BOX)):
            return load_population(self.geometry).for_material(material)
        return model

    @property
    def gives_way(self) -> bool:
        """Whether this is the shipped model of the default finger: the population's model takes its
        place for materials and forces that it does not serve (see `for_material`)."""
        return self.hash == _shipped().hash

    @functools.cached_property
    def material(self) -> ConstitutiveLaw:
        """The law's default material with the fixed properties that the model was built for."""
        return replace(self.law(), **self.fixed)  # type: ignore[type-var]

    def _prepare(self) -> None:
        maps = PopulationMaps if self.serves_population else GeometryMaps
        self.maps: Maps = maps(self.arrays)
        self.latents = self.maps.latents
        self.networks, self.work = self.maps.networks, self.maps.work
        self.hash = _hash_of(self)

    # Files -----------------------------------------------------------------------------------

    @classmethod
    def load(cls, path: str | Path | None = None, geometry: Geometry | None = None) -> ReducedModel:
        """From a file of `finger-model reduce`; None for a shipped one.

        That is the one of the default geometry or, for another geometry, of the population box.
        With POPULATION in place of a file it is that of the population box for any geometry.

        Raises InputError for a file that is not one, of another version, or made for another
        geometry than `geometry` (when given), and for a finger outside the box.
        """
        if path == POPULATION:
            return load_population(geometry or Geometry())
        if path is None:
            if geometry is not None and geometry.hash() != Geometry().hash():
                return load_population(geometry)
            model = _shipped()
            where = "the shipped reduced model"
        else:
            where = str(path)
            model = cls._parse(read_bytes(path, "reduced model"), where)
            if model.serves_population and geometry is not None:
                return ReducedModel(model.arrays, model.meta, model.law, geometry)
        if geometry is not None and geometry.hash() != model.geometry_hash:
            raise InputError(
                f"{where} was made for another geometry ({model.geometry_hash[:8]}, needed is "
                f"{geometry.hash()[:8]}); build one with 'finger-model reduce --geometry …'"
            )
        return model

    @classmethod
    def _parse(cls, data: bytes, where: str) -> ReducedModel:
        try:
            arrays = parse_npz(data, where)
            meta = parse_json(str(arrays.pop("meta")), where)
        except (InputError, KeyError):
            raise InputError(
                f"{where}: not a reduced model file; make one with 'finger-model reduce'"
            ) from None
        if not isinstance(meta, dict) or meta.get("format") != FORMAT:
            raise InputError(
                f"{where}: reduced model of another version; build it again with "
                "'finger-model reduce'"
            )
        return cls(arrays, meta)

    def save(self, path: str | Path) -> None:
        """Write the file (npz, no pickle)."""
        with atomic_write(path, "wb") as file:
            meta = np.array(json.dumps({**self.meta, "format": FORMAT}))
            np.savez(file, **{"meta": meta, **self.arrays})  # type: ignore[arg-type]

    # Parameters ------------------------------------------------------------------------------

    def constants(self, *parameters: np.ndarray | ConstitutiveLaw) -> np.ndarray:
        """The kernels' records (n,) of n parameter sets; raises InputError for bad parameters."""
        materials = [self._material(own) for own in parameters]
        records = self.maps.parameters(self.geometry, materials)
        records["force_limit"] = [self._limit_of(material) for material in materials]
        return records

    def state_at_rest(self, constants: np.ndarray) -> np.ndarray:
        """The kernels' record (1,) of a finger at rest."""
        return self.maps.at_rest(constants)

    def _vector(self, parameters: np.ndarray | ConstitutiveLaw) -> np.ndarray:
        """Parameters (n,) as floats; raises InputError for what the model was not built for."""
        if isinstance(parameters, ConstitutiveLaw):
            self._check_material(parameters)
            parameters = parameters.vector()
        return self.space.checked(parameters)

    def _material(self, parameters: np.ndarray | ConstitutiveLaw) -> MaxwellLaw:
        found = self.material.with_vector(self._vector(parameters))
        assert isinstance(found, MaxwellLaw)
        if found.stiffening > 0 and not self.serves_population:
            raise InputError(
                f"material: 'stiffening' is {found.stiffening:g}, the reduced model is made for 0; "
                "use --solver full"
            )
        return found

    def _check_material(self, material: ConstitutiveLaw) -> None:
        """Refuse another law and other fixed properties than the model was built for."""
        if material.name != self.law.name:
            raise InputError(
                f"material: the law is '{material.name}', this reduced model is of "
                f"'{self.law.name}'; use `for_law` or --solver full"
            )
        for name, built in self.fixed.items():
            value = getattr(material, name)
            if value != built:
                raise InputError(
                    f"material: '{name}' is {value:g}, the reduced model was built for {built:g}; "
                    "use --solver full"
                )

    def out_of_range(self, parameters: np.ndarray | ConstitutiveLaw) -> list[str]:
        """Names of the parameters outside the range that the model was built for."""
        names = []
        vector = self._vector(parameters)
        for name, value in zip(self.space.names, vector):
            low, high = self.range[name]
            if not low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
                names.append(name)
        if not names and "E1" not in self.space:
            # The long-term modulus that a standard linear solid of the range may have.
            material = self._material(vector)
            E1 = material.instantaneous_modulus / (1.0 / material.long_term_fraction - 1.0)
            low, high = self._box["E1"]
            if not low * (1 - 1e-9) <= E1 <= high * (1 + 1e-9):
                names.append(self.space.names[1])
        return names

    def force_limit(self, parameters: np.ndarray | ConstitutiveLaw) -> float:
        """Largest force (N) that the model was built for with these parameters."""
        return self._limit_of(self._material(parameters))

    def _limit_of(self, material: MaxwellLaw) -> float:
        scale = material.instantaneous_modulus * self.geometry.pad_semi_axis_radial**2
        return min(self._box["force"][1], scale * self.maps.largest_load(material))

    # Use -------------------------------------------------------------------------------------

    def start(self, parameters: np.ndarray | ConstitutiveLaw) -> ReducedState:
        """A finger of these parameters at rest."""
        vector = self._vector(parameters)
        constants = self.constants(vector)
        return ReducedState(vector, constants, self.state_at_rest(constants))

    def step(self, state: ReducedState, dt: float, force: float) -> ContactPoint:
        """Advance by dt (s) to `force` (N), which is held between 0 and the force limit, or where
        the model cannot go on; the point's force is the held one, its time counts from rest.

        Raises InputError for numbers that are not finite and time that goes back.
        """
        dt, force = float(dt), float(force)
        if not (0.0 <= dt < math.inf and math.isfinite(force)):
            raise InputError(
                f"step of {dt:g} s to {force:g} N: a time of zero or more and a finite force are "
                "needed"
            )
        rk.step(self.networks, state.constants, state.state, self.work, dt, force)
        state.time += dt
        found = state.state[0]
        area, held = float(found["area"]), float(found["force"])
        return ContactPoint(
            state.time,
            held,
            area,
            math.sqrt(area / math.pi),
            float(found["indentation"]),
            float(found["peak_pressure"]),
            mean_pressure(held, area),
        )

    def _try_out(self) -> None:
        """One step at the default material; raises ValueError where it gives no contact."""
        constants = self.constants(self.space.default)
        state = self.state_at_rest(constants)
        time, force = np.array([0.0, 0.1]), np.array([0.0, 0.1])
        if not np.isfinite(self.run(constants, state, time, force, 0.0)).all():
            raise ValueError("its numbers give no contact")

    def run(
        self,
        constants: np.ndarray,
        state: np.ndarray,
        time: np.ndarray,
        force: np.ndarray,
        before: float,
    ) -> np.ndarray:
        """Area (m²), indentation (m) and peak pressure (Pa) as columns (n, 3); `state` goes along.

        constants, state: the kernels' records; time (n,) in s, the state's own being `before`;
        force (n,) in N. NaN from the first row on that cannot be followed: the learned map may have
        no solution where the tissue hardly carries the force. Raises InputError for a damaged
        model.
        """
        table = np.empty((len(time), 3))
        work = self.work.copy()  # other threads may run beside
        try:
            row = rk.run(self.networks, constants, state, work, before, time, force, table)
        except ZeroDivisionError:
            raise InputError(
                "reduced model: the file is damaged, its numbers give no contact; build it again "
                "with 'finger-model reduce'"
            ) from None
        table[row:] = np.nan
        return table

    def simulate(
        self, material: np.ndarray | ConstitutiveLaw, time: np.ndarray, force: np.ndarray
    ) -> ContactHistory:
        """Contact under forces (n,) in N at times (n,) in s.

        The finger is at rest before time[0], which may carry load.

        Raises InputError for time that does not increase, parameters out of range or a force beyond
        the limit, and ModelError for a force that cannot be followed.
        """
        time, force = check_force_history(time, force)
        vector = self._vector(material)
        outside = self.out_of_range(vector)
        if outside:
            name = outside[0]
            low, high = self.range[name]
            if low <= vector[self.space.index(name)] <= high:
                low, high = self._box["E1"]
                raise InputError(
                    "material: the long-term modulus of the branches is that of an E1 outside the "
                    f"reduced model's {low:g} … {high:g} Pa; use --solver full"
                )
            raise InputError(
                f"material: '{name}' is {vector[self.space.index(name)]:g}, outside the reduced "
                f"model's {low:g} … {high:g}; use --solver full"
            )
        constants = self.constants(vector)
        limit = float(constants["force_limit"][0])
        if force.max() > limit:
            row = int(np.argmax(force > limit))
            raise InputError(
                f"force {force[row]:.3g} N at t = {time[row]:.4g} s is beyond the reduced model's "
                f"limit of {limit:.3g} N for this material; lower the force or use --solver full"
            )
        state = self.state_at_rest(constants)
        table = self.run(constants, state, time, force, before=time[0])
        lost = np.isnan(table[:, 0])
        if lost.any():
            row = int(np.argmax(lost))
            raise ModelError(
                f"the reduced model cannot follow the force of {force[row]:.3g} N at t = "
                f"{time[row]:.4g} s, which this tissue hardly carries; lower the force or use "
                "--solver full"
            )
        return history_of(time, force, table)

    def visited(self, parameters: np.ndarray, time: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Amplitudes a and friction states q (n, k + m), see the kernels.

        They are those under forces (n,) in N at times (n,) in s.
        """
        state = self.start(parameters)
        out = []
        for dt, value in zip(np.diff(time, prepend=time[0]), force):
            self.step(state, dt, value)
            out.append([*state.state["amplitudes"][0], *state.state["friction"][0]])
        return np.array(out)

    def batch(
        self,
        parameters: np.ndarray,
        trials: Sequence[tuple[np.ndarray, ...]],
    ) -> list[np.ndarray]:
        """Areas (P, f) in m² of each trial; arguments as of `contacts`."""
        return [found[0] for found in self.contacts(parameters, trials)]

    def contacts(
        self,
        parameters: np.ndarray,
        trials: Sequence[tuple[np.ndarray, ...]],
    ) -> list[np.ndarray]:
        """Contacts of many parameter sets over many trials, on all cores that numba may use.

        parameters (P, n): vectors of `space`; trials: (time (n,), force (n,)) or (time, force, rows
        (f,)), increasing rows being the samples that are wanted (all of them without). Returns one
        (2, P, f) array per trial: areas (m²) and indentations (m). Forces beyond the limit are held
        at it, parameters out of range are not refused: see `out_of_range`. From the first sample on
        that cannot be followed (see `follow`) a trial is NaN.
        """
        parameters = np.atleast_2d(np.asarray(parameters, dtype=float))
        constants = self.constants(*parameters)
        checked = [check_trial(trial, f"trial {i}") for i, trial in enumerate(trials)]
        start = np.concatenate([[0], np.cumsum([len(time) for time, _, _ in checked])]).astype(
            np.int64
        )
        wanted = np.full(start[-1], -1, np.int64)
        frames = []
        count = 0
        for i, (_, _, rows) in enumerate(checked):
            wanted[start[i] + rows] = count + np.arange(len(rows))
            frames.append(slice(count, count + len(rows)))
            count += len(rows)
        out = np.empty((len(parameters), 2, count))
        if checked:
            rk.batch(
                self.networks,
                constants,
                np.zeros(1, self.maps.types.state),
                self.work,
                np.concatenate([time for time, _, _ in checked]),
                np.concatenate([force for _, force, _ in checked]),
                start,
                wanted,
                out,
            )
        return [out[:, :, part].swapaxes(0, 1) for part in frames]


def history_of(time: np.ndarray, force: np.ndarray, table: np.ndarray) -> ContactHistory:
    """History with the columns area, indentation and peak pressure of `table` (n, 3)."""
    area = table[:, 0]
    mean = np.divide(np.maximum(force, 0), area, out=np.zeros_like(area), where=area > 0)
    return ContactHistory(
        time, force, area, np.sqrt(area / math.pi), table[:, 1], table[:, 2], mean
    )


def _fixed_of(law: MaxwellLaw) -> dict[str, float]:
    """Properties of a material that no parameter of its law holds."""
    return {k: v for k, v in law.to_dict().items() if k not in law.PARAMETERS}


def _hash_of(model: ReducedModel) -> str:
    parts: dict[str, Any] = {
        "geometry": model.geometry_hash,
        "arrays": model.arrays.digests,
    }
    if model.serves_population:
        parts["fixed"] = {k: float(v) for k, v in model.fixed.items()}
    return sha256_of(parts)


def _read_shipped(name: str) -> ReducedModel:
    file = resources.files("finger_model") / "data" / name
    if not file.is_file():
        raise InputError(f"the shipped reduced model {name} is missing; run 'finger-model reduce'")
    return ReducedModel._parse(file.read_bytes(), name)


@functools.cache
def _shipped() -> ReducedModel:
    return _read_shipped(SHIPPED)


@functools.cache
def _population() -> ReducedModel:
    return _read_shipped(SHIPPED_POPULATION)


def load_population(geometry: Geometry) -> ReducedModel:
    """The shipped model of the population box for one finger; raises InputError outside the box."""
    shipped = _population()
    return ReducedModel(shipped.arrays, shipped.meta, shipped.law, geometry)
