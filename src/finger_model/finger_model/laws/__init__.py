# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Material laws, and the parameters that each lets a fit vary.

A law is found by name among the entry points `finger_model.law`; nothing here is edited to add one
(docs/add_a_law.md).
"""

from __future__ import annotations

from pathlib import Path

from finger_common.errors import InputError
from finger_common.files import load_yaml
from finger_common.plugins import Plugins

from .generalized_maxwell import (
    GeneralizedMaxwell,
    GeneralizedMaxwell1,
    GeneralizedMaxwell2,
    GeneralizedMaxwell3,
    GeneralizedMaxwell4,
    from_branches,
)
from .law import UNIT, ConstitutiveLaw, StepEnergy, Tissue, parameter, trace, unit
from .maxwell import Branch, MaxwellLaw
from .space import DerivedQuantity, ParameterSpace, ParameterSpec, Quantity
from .standard_linear_solid import StandardLinearSolid

LAWS = Plugins("finger_model.law", "material law", ConstitutiveLaw)
"""The installed laws."""


def law_of(name: str) -> type[ConstitutiveLaw]:
    """The law class of a name; the empty name is the default law. Raises InputError, also for a
    class that is no complete law."""
    found: type[ConstitutiveLaw] = LAWS.load(name or StandardLinearSolid.name)
    found.check_class(name or StandardLinearSolid.name)
    return found


def load_material(path: str | Path) -> ConstitutiveLaw:
    """Material from material.yaml (SI), of the law named by its key `law`; raises InputError.

    A file with the key `branches` is one of generalised Maxwell tissue.
    """
    data = load_yaml(path, "material file")
    if "sets" in data:
        raise InputError(
            f"{path}: holds parameter sets, no material; give it with --parameters instead"
        )
    if "branches" in data:
        law = data.pop("law", None)
        material = from_branches(data, str(path))
        if law not in (None, "", "generalized_maxwell", material.name):
            raise InputError(
                f"{path}: 'law' is {law!r}, but the {material.INTERNAL_TENSORS} entries of "
                f"'branches' make it {material.name!r}; remove 'law' or 'branches'"
            )
        return material
    name = str(data.pop("law", "") or "")
    if name == "generalized_maxwell":
        raise InputError(f"{path}: 'law' is {name!r}, which needs the key 'branches'; add it")
    return law_of(name).from_dict(data, str(path))
