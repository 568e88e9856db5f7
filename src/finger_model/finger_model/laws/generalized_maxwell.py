# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bulk tissue with one to four Maxwell branches: relaxation from milliseconds to seconds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from finger_common.errors import InputError
from finger_common.files import number

from .. import paper
from .law import IN_KPA, parameter
from .maxwell import Branch, MaxwellLaw, slowest_creep
from .space import DerivedQuantity
from .standard_linear_solid import MODULUS_RANGE

TIMES = {1: (0.5,), 2: (0.05, 1.0), 3: (0.004, 0.07, 1.4), 4: (0.004, 0.07, 1.4, 8.0)}
"""s, default relaxation times; three branches: Pawluk and Howe 1999."""
TIME_RANGE = (1e-3, 10.0)
"""s, relaxation times that the models are made for."""
E0_RANGE, E2_RANGE = (20e3, 400e3), (100e3, 5000e3)
"""Pa, moduli that the models are made for."""
STIFFENING_RANGE = (0.0, 10.0)
"""Stiffening that the models are made for."""
LOWEST_LONG_TERM_FRACTION = 1e-3
_SUBSCRIPTS = "₁₂₃₄"


def long_term_modulus(vectors: np.ndarray) -> np.ndarray:
    """E∞ = E0 (1 − Σ fractions) in Pa of vectors (…, n): E0, fractions and times in turn, …"""
    count = (vectors.shape[-1] - 3) // 2
    return vectors[..., 0] * (1.0 - vectors[..., 1 : 1 + 2 * count : 2].sum(axis=-1))


def with_long_term_modulus(vectors: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Vectors (…, n) with E0 such that E∞ has these values (…)."""
    out = np.array(vectors, dtype=float)
    out[..., 0] *= value / long_term_modulus(out)
    return out


def _long_term_modulus_of(count: int) -> DerivedQuantity:
    return DerivedQuantity(
        "long_term_E",
        **IN_KPA,
        meaning="Long-term modulus of the bulk tissue at small strain, E0 (1 − Σ fractions).",
        symbol="E∞",
        decimals=2,
        value=long_term_modulus,
        solve=with_long_term_modulus,
        solves_for="E0",
        of=("E0", *(f"fraction_{k}" for k in range(1, 1 + count))),
    )


@dataclass(frozen=True, kw_only=True)
class GeneralizedMaxwell(MaxwellLaw):
    """One to four Maxwell branches beside a spring that may stiffen.

    Its subclasses have the parameters E0, then fraction_k and tau_k of each branch, E2 and
    stiffening. fraction_k is over G0, tau_k the relaxation time. Raises InputError for fractions
    whose sum leaves less than 0.1 % to the spring.
    """

    STIFFNESS_ADVICE = "lower the fractions of the branches or 'poisson_ratio_bulk'"
    INTERNAL_TENSORS: ClassVar[int] = 0

    E0: float = parameter(
        80e3,
        "Modulus of the bulk tissue under a sudden small strain.",
        bounds=E0_RANGE,
        **IN_KPA,
        symbol="E₀",
        decimals=1,
        range=E0_RANGE,
        allowed=MODULUS_RANGE,
    )

    def _check_moduli(self) -> None:
        if self.long_term_fraction < LOWEST_LONG_TERM_FRACTION:
            raise InputError(
                f"material: the fractions of the branches add up to "
                f"{1 - self.long_term_fraction:g}; together they must stay below "
                f"{1 - LOWEST_LONG_TERM_FRACTION:g} of E0; lower them"
            )
        super()._check_moduli()

    @property
    def branches(self) -> tuple[Branch, ...]:
        """fraction_k and tau_k of each branch."""
        return tuple(
            Branch(getattr(self, f"fraction_{k}"), getattr(self, f"tau_{k}"))
            for k in range(1, 1 + self.INTERNAL_TENSORS)
        )

    def longest_creep_time(self, box: np.ndarray) -> float:
        """That of the largest fractions and relaxation times: it grows with each of them, and most
        with the fraction of the slowest branch."""
        last = 1 + 2 * self.INTERNAL_TENSORS
        fractions, times = box[1:last:2, 1].copy(), box[2:last:2, 1]
        left = 1.0 - LOWEST_LONG_TERM_FRACTION
        for k in np.argsort(-times):
            fractions[k] = min(fractions[k], left)
            left -= fractions[k]
        return slowest_creep(fractions, times)

    @property
    def epidermis_modulus(self) -> float:
        """E2 in Pa."""
        return self.E2  # type: ignore[attr-defined]

    @property
    def instantaneous_shear_modulus(self) -> float:
        """G0 = E0/(2(1+ν)) in Pa."""
        return self.E0 / (2.0 * (1.0 + self.poisson_ratio_bulk))


def _subclass(count: int) -> type[GeneralizedMaxwell]:
    """The law of so many branches."""
    made: dict[str, Any] = {}
    for k, default in enumerate(TIMES[count], start=1):
        made[f"fraction_{k}"] = parameter(
            0.6 / count,
            f"Modulus of branch {k} over E0.",
            bounds=(0.05, 0.9 / count),
            unit="",
            symbol=f"g{_SUBSCRIPTS[k - 1]}",
            display_unit="",
            display_factor=1.0,
            range=(1e-4, 0.98),
            allowed=(0.0, 1.0),
        )
        made[f"tau_{k}"] = parameter(
            default,
            f"Relaxation time of branch {k}.",
            bounds=(max(default / 5, TIME_RANGE[0]), min(default * 5, TIME_RANGE[1])),
            unit="s",
            symbol=f"τ{_SUBSCRIPTS[k - 1]}",
            display_unit="s",
            display_factor=1.0,
            range=TIME_RANGE,
        )
    made["E2"] = parameter(
        paper.NATURAL.parameters["E2"],
        "Modulus of the elastic epidermis.",
        bounds=E2_RANGE,
        **IN_KPA,
        symbol="E₂",
        decimals=0,
        range=E2_RANGE,
        allowed=MODULUS_RANGE,
    )
    made["stiffening"] = parameter(
        0.0,
        "Strain stiffening b of the long-term spring; 0 is none.",
        bounds=STIFFENING_RANGE,
        unit="",
        symbol="b",
        display_unit="",
        display_factor=1.0,
        decimals=2,
        range=STIFFENING_RANGE,
        log_offset=0.1,
    )
    names = {
        "name": f"generalized_maxwell_{count}",
        "INTERNAL_TENSORS": count,
        "DERIVED": (_long_term_modulus_of(count),),
        "__annotations__": {name: float for name in made},
        "__module__": __name__,
        "__doc__": f"Generalised Maxwell tissue of {count} branch{'es' if count > 1 else ''}.",
        **made,
    }
    cls = type(f"GeneralizedMaxwell{count}", (GeneralizedMaxwell,), names)
    return dataclass(frozen=True, kw_only=True)(cls)


LAWS_BY_BRANCHES = {count: _subclass(count) for count in TIMES}
GeneralizedMaxwell1 = LAWS_BY_BRANCHES[1]
GeneralizedMaxwell2 = LAWS_BY_BRANCHES[2]
GeneralizedMaxwell3 = LAWS_BY_BRANCHES[3]
GeneralizedMaxwell4 = LAWS_BY_BRANCHES[4]


def from_branches(data: Mapping[str, Any], where: str) -> GeneralizedMaxwell:
    """Material from a mapping whose key `branches` lists {fraction, tau}; raises InputError."""
    found = dict(data)
    branches = found.pop("branches")
    if not isinstance(branches, list) or not 1 <= len(branches) <= len(TIMES):
        raise InputError(
            f"{where}: 'branches' needs a list of 1 to {len(TIMES)} entries {{fraction: …, tau: …}}"
        )
    for key in ("E1", "tau1"):
        if key in found:
            raise InputError(
                f"{where}: '{key}' does not go with 'branches', which replace the Kelvin element; "
                f"remove '{key}'"
            )
    for k, branch in enumerate(branches, start=1):
        place = f"{where}: branch {k}"
        if not isinstance(branch, dict) or set(branch) != {"fraction", "tau"}:
            raise InputError(f"{place}: the keys 'fraction' and 'tau' are needed, and no others")
        for key, remedy in (
            ("fraction", "give its modulus over E0"),
            ("tau", f"give its relaxation time, {TIME_RANGE[0]:g} … {TIME_RANGE[1]:g} s"),
        ):
            value = found[f"{key}_{k}"] = number(branch, key, place)
            if value <= 0:
                raise InputError(f"{place}: '{key}' is {value:g}; {remedy}, or remove the branch")
    return LAWS_BY_BRANCHES[len(branches)].from_dict(found, where)
