# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The parameters that a material law lets a fit vary.

Everything outside a law goes by its `ParameterSpace`: search box, tables, figures, parameter files,
interpolation over moisture. A vector of parameters has the order of `space.names`; functions take
vectors (…, n) in SI.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from finger_common.errors import InputError, known_names

CORRECTION_STEP = 0.2
"""Step of a correction coordinate, where a law does not state one."""

_SUBSCRIPTS = str.maketrans("₀₁₂₃₄₅₆₇₈₉∞", "0123456789∞")


@dataclass(frozen=True)
class Quantity:
    """A number that a material is described by, and how it is shown.

    name: as in files and code; unit: SI; meaning: one sentence; symbol: as in the theory page
    ("E₀"). display_unit, display_factor: unit in tables and figures, and the factor from SI to it;
    decimals: there.
    """

    name: str
    unit: str
    meaning: str
    symbol: str
    display_unit: str
    display_factor: float
    decimals: int = 3

    @property
    def letter_and_index(self) -> tuple[str, str]:
        """The symbol in two parts, the index in plain characters: "E" and "0"."""
        letter = self.symbol.rstrip("₀₁₂₃₄₅₆₇₈₉∞")
        return letter, self.symbol[len(letter) :].translate(_SUBSCRIPTS)

    @property
    def html(self) -> str:
        """The symbol as HTML: italic, its index a subscript."""
        letter, index = self.letter_and_index
        return f"<i>{letter}</i>" + (f"<sub>{index}</sub>" if index else "")

    @property
    def label(self) -> str:
        """Symbol and unit as an axis label: "E₀ (kPa)"."""
        return f"{self.symbol} ({self.display_unit})" if self.display_unit else self.symbol

    def text(self, value: float) -> str:
        """A value (SI) in the display unit, without the unit."""
        return f"{value * self.display_factor:.{self.decimals}f}"


@dataclass(frozen=True)
class ParameterSpec(Quantity):
    """A quantity that a fit may vary, with default, search box and range.

    default, bounds (search box of a fit), range (that the models are made for): SI. log_offset: the
    coordinate of fits and interpolation is ln(value + log_offset); positive only for parameters
    that may be zero.
    """

    default: float = 1.0
    bounds: tuple[float, float] = (0.0, math.inf)
    range: tuple[float, float] = (0.0, math.inf)
    log_offset: float = 0.0
    allowed: tuple[float, float] = (-math.inf, math.inf)

    def check(self, value: float, where: str = "parameters", allowed: bool = False) -> None:
        """Raises InputError for a value that is not finite, without logarithm or not allowed."""
        if not math.isfinite(value):
            raise InputError(f"{where}: '{self.name}' is {value}, a finite number is needed")
        if value + self.log_offset <= 0:
            lowest = "zero or more" if self.log_offset else "a positive value"
            shown = f"{value:g} {self.unit}".rstrip()
            raise InputError(f"{where}: '{self.name}' is {shown}, {lowest} is needed")
        low, high = self.allowed
        if allowed and not low <= value <= high:
            span = f"{low:g} … {high:g}" if math.isfinite(high) else f"{low:g} and more"
            what = "moduli" if self.unit == "Pa" else "it"
            raise InputError(
                f"{where}: '{self.name}' is {value:g} {self.unit}, outside {span} {self.unit}; "
                f"give {what} in {self.unit or 'plain numbers'}"
            )

    def check_bounds(self, where: str = "parameters") -> None:
        """Raises InputError for bounds that are no search box: left out, not increasing, beyond the
        range or without logarithm."""
        (low, high), (least, most) = self.bounds, self.range
        found = f"{where}: the bounds of '{self.name}' are {low:g} … {high:g}"
        if not low < high < math.inf:
            raise InputError(f"{found}; give the lower one, then the higher one, both finite")
        if not least <= low < high <= most:
            raise InputError(f"{found}, beyond its range {least:g} … {most:g}; correct either")
        if not low + self.log_offset > 0:
            raise InputError(
                f"{found}, but fits take logarithms; begin above zero or give a log_offset"
            )


@dataclass(frozen=True)
class DerivedQuantity(Quantity):
    """A quantity that follows from the parameters.

    value: (…, n) vectors → (…) values. solve: vectors (…, n) and values (…) → vectors with the
    parameter `solves_for` set so that the quantity has these values, and NaN there where no
    positive number does. of: the parameters that it depends on.
    """

    value: Callable[[np.ndarray], np.ndarray] = lambda vectors: vectors[..., 0]
    solve: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    solves_for: str = ""
    of: tuple[str, ...] = ()


class ParameterSpace:
    """Ordered parameters of a law, and the quantities derived from them.

    correction: names of n quantities whose logarithms are the coordinates in which a fit expands
    the ratio of two models; by default the parameters themselves. Raises ValueError for names that
    are not there or are used twice.
    """

    def __init__(
        self,
        parameters: Sequence[ParameterSpec],
        derived: Sequence[DerivedQuantity] = (),
        correction: Sequence[str] | Mapping[str, float] = (),
    ) -> None:
        self.parameters = tuple(parameters)
        self.names = tuple(p.name for p in self.parameters)
        self.derived = {q.name: q for q in derived}
        self.quantity_names = (*self.names, *self.derived)
        self.correction = tuple(correction) or self.names
        steps = correction if isinstance(correction, Mapping) else {}
        self.correction_steps = tuple(steps.get(name, CORRECTION_STEP) for name in self.correction)
        if len(set(self.quantity_names)) != len(self.quantity_names):
            raise ValueError(f"a name is used twice: {self.quantity_names}")
        if len(self.correction) != len(self) or set(self.correction) - set(self.quantity_names):
            raise ValueError(f"correction needs {len(self)} known names, not {self.correction}")
        self._offset = np.array([p.log_offset for p in self.parameters])

    def __len__(self) -> int:
        return len(self.parameters)

    def __iter__(self):
        return iter(self.parameters)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> ParameterSpec:
        return self.parameters[self.index(name)]

    def index(self, name: str) -> int:
        """Place of a parameter in a vector; raises InputError for an unknown name."""
        if name not in self.names:
            raise InputError(f"parameter '{name}' does not exist; {known_names(name, self.names)}")
        return self.names.index(name)

    @property
    def headline(self) -> str:
        """Name of the quantity that summarises a fit: the first derived one, else a parameter."""
        return next(iter(self.derived), self.names[0])

    def markdown(self) -> str:
        """Table of the parameters for a law's page."""
        lines = ["| parameter | symbol | search box | range | meaning |", "|---|---|---|---|---|"]
        for p in self.parameters:
            box, range_ = (
                f"{low * p.display_factor:g} … {high * p.display_factor:g} {p.display_unit}".strip()
                for low, high in (p.bounds, p.range)
            )
            lines.append(f"| `{p.name}` | {p.symbol} | {box} | {range_} | {p.meaning} |")
        return "\n".join(lines)

    # Vectors and mappings --------------------------------------------------------------------

    @property
    def default(self) -> np.ndarray:
        """Default values (n,)."""
        return np.array([p.default for p in self.parameters])

    @property
    def box(self) -> np.ndarray:
        """Search box (n, 2): lowest and highest value; raises InputError for bounds that are no
        search box."""
        for parameter in self.parameters:
            parameter.check_bounds()
        return np.array([p.bounds for p in self.parameters])

    @property
    def range(self) -> np.ndarray:
        """Range (n, 2) that the models of this law are made for: lowest and highest value."""
        return np.array([p.range for p in self.parameters])

    def vector(self, mapping: Mapping[str, float], where: str = "parameters") -> np.ndarray:
        """Vector (n,) from a mapping, which may hold other keys too; raises InputError."""
        for name in self.names:
            if name not in mapping:
                raise InputError(f"{where}: key '{name}' is missing; add it")
        return self.checked([mapping[name] for name in self.names], where)

    def mapping(self, vector: Sequence[float] | np.ndarray) -> dict[str, float]:
        """Plain mapping, name → value, of a vector (n,); raises InputError for a wrong length."""
        return dict(zip(self.names, self._shaped(vector, "parameters").tolist()))

    def checked(
        self, vector: Sequence[float] | np.ndarray, where: str = "parameters"
    ) -> np.ndarray:
        """A vector as a float array (n,); raises InputError for a wrong length or value."""
        found = self._shaped(vector, where)
        for parameter, value in zip(self.parameters, found):
            parameter.check(float(value), where)
        return found

    def _shaped(self, vector: Sequence[float] | np.ndarray, where: str) -> np.ndarray:
        found = np.asarray(vector, dtype=float)
        if found.shape != (len(self),):
            raise InputError(
                f"{where} have shape {found.shape}; {len(self)} numbers are needed: "
                f"{', '.join(self.names)}"
            )
        return found

    # Coordinates -----------------------------------------------------------------------------

    def to_log(self, vectors: np.ndarray) -> np.ndarray:
        """Coordinates (…, n) of fits and interpolation: ln(value + log_offset)."""
        return np.log(np.asarray(vectors, dtype=float) + self._offset)

    def from_log(self, coordinates: np.ndarray) -> np.ndarray:
        """Vectors (…, n) of coordinates (…, n)."""
        found = np.exp(coordinates) - self._offset
        # Zero stays zero: what is below the rounding of the offset is nothing.
        return np.where(np.abs(found) < 1e-12 * self._offset, 0.0, found)

    def quantity(self, name: str, vectors: np.ndarray) -> np.ndarray:
        """Values (…) of a parameter or derived quantity for vectors (…, n)."""
        vectors = np.asarray(vectors, dtype=float)
        if name in self.derived:
            return self.derived[name].value(vectors)
        return vectors[..., self.index(name)]

    def describe(self, name: str) -> Quantity:
        """Symbol, units and meaning of a parameter or derived quantity."""
        return self.derived[name] if name in self.derived else self[name]

    def quantities(self, vector: np.ndarray) -> dict[str, float]:
        """Parameters and derived quantities of a vector (n,) by name."""
        return {name: float(self.quantity(name, vector)) for name in self.quantity_names}

    def with_quantity(
        self, name: str, vectors: np.ndarray, value: np.ndarray | float
    ) -> np.ndarray:
        """Vectors (…, n) with a quantity set to a value, a derived one through `solves_for`."""
        out = np.array(vectors, dtype=float)
        if name in self.derived:
            solve = self.derived[name].solve
            if solve is None:
                raise ValueError(f"'{name}' cannot be solved for a parameter")
            return solve(out, np.asarray(value, dtype=float))
        out[..., self.index(name)] = value
        return out

    def quantity_bounds(self, name: str, box: np.ndarray | None = None) -> tuple[float, float]:
        """Smallest and largest value of a quantity at the corners of a box (n, 2).

        The default is the search box.
        """
        corners = np.array(list(itertools.product(*(self.box if box is None else box))))
        values = self.quantity(name, corners)
        return float(values.min()), float(values.max())

    def log_offset(self, name: str) -> float:
        """`ParameterSpec.log_offset` of a parameter; zero for a derived quantity."""
        return 0.0 if name in self.derived else self[name].log_offset

    def log_quantity(self, name: str, vectors: np.ndarray) -> np.ndarray:
        """ln(q + log_offset) (…) of a quantity q for vectors (…, n): its logarithm, for which all
        deviations are given."""
        return np.log(self.quantity(name, vectors) + self.log_offset(name))

    def can_hold(self, name: str) -> bool:
        """Whether `with_quantity` can set this quantity."""
        return name not in self.derived or self.derived[name].solve is not None

    def log_gradient(self, name: str, vector: np.ndarray) -> np.ndarray:
        """∂/∂x (n,) of `log_quantity` over the coordinates x, by central differences."""
        step = 1e-5
        shifts = step * np.eye(len(self))
        centre = self.to_log(vector)
        high = self.log_quantity(name, self.from_log(centre + shifts))
        low = self.log_quantity(name, self.from_log(centre - shifts))
        return (high - low) / (2.0 * step)

    # Correction of a model -------------------------------------------------------------------

    def correction_coordinates(self, vectors: np.ndarray) -> np.ndarray:
        """Coordinates (…, n): the logarithms of the quantities named in `correction`."""
        vectors = np.asarray(vectors, dtype=float)
        return np.stack([self.log_quantity(name, vectors) for name in self.correction], axis=-1)

    def from_correction_coordinates(self, coordinates: np.ndarray) -> np.ndarray:
        """Vectors (…, n) of correction coordinates (…, n)."""
        coordinates = np.asarray(coordinates, dtype=float)
        vectors = np.broadcast_to(self.default, coordinates.shape).copy()
        # Derived quantities last: they are solved for a parameter at the values of the others.
        for name in sorted(self.correction, key=lambda name: name in self.derived):
            value = np.exp(coordinates[..., self.correction.index(name)])
            vectors = self.with_quantity(name, vectors, value - self.log_offset(name))
        return vectors

    # Moisture --------------------------------------------------------------------------------

    def interpolate(
        self,
        moistures: np.ndarray,
        coordinates: np.ndarray,
        covariances: np.ndarray,
        moisture: float,
        margins: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        """Parameters (n,), covariance (n, n) of their coordinates, and "reading out of range".

        moistures (s,): increasing, a.u.; coordinates (s, n): of the parameters fitted there;
        covariances (s, n, n); margins (s,): a.u. beyond the first and the last in which a reading
        is not out of range, none by default. Coordinates and covariances are linear between two
        moistures; beyond the first and the last the end holds.
        """
        held = min(max(moisture, moistures[0]), moistures[-1])
        upper = int(np.searchsorted(moistures, held))
        if upper == 0 or moistures[upper] == held:
            found, covariance = coordinates[upper], covariances[upper].copy()
        else:
            weight = (held - moistures[upper - 1]) / (moistures[upper] - moistures[upper - 1])
            found = (1 - weight) * coordinates[upper - 1] + weight * coordinates[upper]
            covariance = (1 - weight) * covariances[upper - 1] + weight * covariances[upper]
        margin = 0.0 if margins is None else margins[upper]
        return self.from_log(found), covariance, bool(abs(moisture - held) > margin)
