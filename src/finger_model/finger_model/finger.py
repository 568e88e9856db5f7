# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which finger a node or command works with: geometry file, reduced model file, material law."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from finger_common.errors import InputError, ModelError

from .geometry import Geometry
from .history import ContactHistory
from .laws import ConstitutiveLaw, MaxwellLaw, law_of
from .parameter_sets import ParameterSets
from .reduced.model import ReducedModel, load_population

if TYPE_CHECKING:
    from .fem.area_model import FullOrderAreas


def load_reduced(
    model_file: str | Path = "", geometry_file: str | Path | Geometry = ""
) -> ReducedModel:
    """The reduced model of a finger; without files that of the default geometry.

    model_file: may be POPULATION. geometry_file: geometry.yaml or its content, of any finger of the
    population box or, with a file of a model, of the finger that it was made for. Raises InputError
    for files that are wrong or do not belong together, and for a finger outside the box.
    """
    return ReducedModel.load(model_file or None, _geometry(geometry_file))


def load_for(
    sets: ParameterSets, model_file: str | Path = "", geometry_file: str | Path = ""
) -> ReducedModel:
    """As `load_reduced`, for the finger whose lengths the sets hold.

    Raises InputError too where a file names another finger.
    """
    return model_for(sets, load_reduced(model_file, geometry_file), model_file, geometry_file)


def model_for(
    sets: ParameterSets,
    model: ReducedModel,
    model_file: str | Path = "",
    geometry_file: str | Path = "",
) -> ReducedModel:
    """As `load_for`; model: that of the files."""
    own = sets.geometry
    if own is None or sets.geometry_hash == model.geometry_hash:
        return model
    if geometry_file or (model_file and not model.serves_population):
        raise InputError(
            f"{sets.where}: holds the lengths of another finger ({sets.geometry_hash[:8]}) than "
            f"{geometry_file or model_file} ({model.geometry_hash[:8]}); leave one of the two out"
        )
    return load_reduced(model_file, own)


def _geometry(source: str | Path | Geometry) -> Geometry | None:
    """A geometry, or that of a file; None for an empty name."""
    if isinstance(source, Geometry):
        return source
    return Geometry.load(source) if source else None


def simulate_reduced(
    material: ConstitutiveLaw,
    time: np.ndarray,
    force: np.ndarray,
    geometry: Geometry,
    model_file: str | Path = "",
) -> ContactHistory:
    """Contact (see `ReducedModel.simulate`) by the most exact reduced model that serves a finger.

    Without a file that is the one of the default finger and, for materials and forces that it does
    not serve (see `ReducedModel.for_material`), the one of the population box. Raises the error of
    the last one.
    """
    model = ReducedModel.load(model_file or None, geometry)
    try:
        return model.for_material(material).simulate(material, time, force)
    except (InputError, ModelError):
        if not model.gives_way:
            raise
    return load_population(geometry).for_material(material).simulate(material, time, force)


def serving(model: Any, force: float, parameters: np.ndarray) -> Any:
    """What a fit uses of presses up to a force (N): the model, or that of the population box for
    the same finger where the force is beyond the model's limit for any of parameters (P, n).

    Only the shipped model of the default finger gives way, as in `simulate_reduced`.
    """
    if not isinstance(model, ReducedModel) or not model.gives_way:
        return model
    if force <= min(map(model.force_limit, parameters)):
        return model
    return load_population(model.geometry).for_material(model.material)


def load_areas(
    model_file: str | Path = "", geometry_file: str | Path | Geometry = "", law: str = ""
) -> ReducedModel | FullOrderAreas:
    """What a fit varies: the reduced model or, for a law that has none, the full-order model.

    Raises InputError as `load_reduced` does, and for an unknown law.
    """
    if not law or issubclass(law_of(law), MaxwellLaw):
        model = load_reduced(model_file, geometry_file)
        if not law:
            return model
        own = model.for_law(law_of(law))
        if own.gives_way and "stiffening" in own.space.names:
            # The shipped model of the default finger knows no stiffening, which a fit varies.
            return load_population(own.geometry).for_law(law_of(law))
        return own
    if model_file:
        raise InputError(
            f"law '{law}' has no reduced model: leave the model file out, or fit another law"
        )
    from .fem.area_model import FullOrderAreas  # finite elements take a second to import

    return FullOrderAreas(law_of(law)(), _geometry(geometry_file))
