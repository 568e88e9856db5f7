# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Described parameters: one table per node that declares, checks and documents them.

A `Parameter` has name, default, unit, range or choices, meaning and whether it may change while
the node is active. A `ParameterTable` checks values against it and renders the node reference. No
ROS here; `finger_common.node` declares a table on an rclpy node.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .errors import InputError, known_names

_TYPES = {
    bool: "boolean is needed; write true or false",
    int: "integer is needed; write it with digits alone, without quotes and unit",
    float: "number is needed; write it with a decimal point, without quotes and unit",
    str: "text is needed; put it in quotes",
    list: "list is needed; put it in [ ]",
}

NOT_HERE = "parameter '{}' does not exist here"
"""Begins a node's sentence about a parameter of a file that it does not have."""

_EXPONENT = re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+")
"""Numbers such as 1e6, which YAML 1.1 reads as text."""


_ROS_NAME = re.compile(r"(~?/)?[A-Za-z_{][A-Za-z0-9_{}]*(/[A-Za-z_{][A-Za-z0-9_{}]*)*")
"""Names of topics and services, with {node} and the like."""


def _in_type(value: Any, kind: type) -> Any:
    """A whole number, or one as YAML 1.1 reads it, as the number that is needed."""
    if kind is float and (
        type(value) is int or (isinstance(value, str) and _EXPONENT.fullmatch(value))
    ):
        return float(value)
    return value


@dataclass(frozen=True)
class Parameter:
    """One parameter. The type is that of `default` (bool, int, float, str, or a list of one of
    these).
    """

    name: str
    default: Any
    meaning: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[Any, ...] | None = None
    runtime: bool = False
    """May be changed while the node is active."""
    advice: str = ""
    """What to try with it when in trouble."""
    group: str = ""
    """Heading under which the help of a command lists it."""
    ros_name: bool = False
    """Whether it is the name of a topic or of a service."""

    def check(self, value: Any) -> Any:
        """The value in the parameter's type; raises InputError with key, value and what is
        allowed.
        """
        kind = type(self.default)
        if kind is list and isinstance(value, Sequence) and not isinstance(value, str):
            # An empty list is one of texts.
            of = type([*self.default, ""][0])
            value = items = [_in_type(item, of) for item in value]
        else:
            of = kind
            value = _in_type(value, kind)
            items = [value]
        if type(value) is not kind:
            raise InputError(f"parameter '{self.name}' is {value!r}, {_TYPES[kind]}")
        for item in items:
            if type(item) is not of:
                raise InputError(f"parameter '{self.name}' holds {item!r}, {_TYPES[of]}")
            if isinstance(item, float) and not math.isfinite(item):
                raise InputError(f"parameter '{self.name}' is {item}, a finite number is needed")
            if self.choices is not None and item not in self.choices:
                allowed = ", ".join(map(str, self.choices))
                raise InputError(f"parameter '{self.name}' is {item!r}, choose one of {allowed}")
            if self.ros_name and not _ROS_NAME.fullmatch(item):
                raise InputError(
                    f"parameter '{self.name}' is {item!r}, which is no name of ROS; use letters of "
                    f"English, digits, '_' and '/', as in {self.default}"
                )
            low = self.minimum is not None and item < self.minimum
            high = self.maximum is not None and item > self.maximum
            if low or high:
                raise InputError(
                    f"parameter '{self.name}' is {item}, outside {self.range_text()}; correct it"
                )
        return value

    def range_text(self) -> str:
        """Allowed values as text, e.g. "0 … 130 a.u."."""
        if self.choices is not None:
            return ", ".join(map(str, self.choices))
        if self.minimum is None and self.maximum is None:
            return ""
        low = "" if self.minimum is None else f"{self.minimum:g}"
        high = "" if self.maximum is None else f"{self.maximum:g}"
        unit = f" {self.unit}" if self.unit else ""
        if not low:
            return f"≤ {high}{unit}"
        if not high:
            return f"≥ {low}{unit}"
        return f"{low} … {high}{unit}"


class ParameterTable:
    """Ordered set of parameters, looked up by name."""

    def __init__(self, *parameters: Parameter) -> None:
        self._parameters = {p.name: p for p in parameters}
        if len(self._parameters) != len(parameters):
            raise ValueError("a parameter is described twice")
        for parameter in parameters:
            parameter.check(parameter.default)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self._parameters.values())

    def __contains__(self, name: str) -> bool:
        return name in self._parameters

    def __getitem__(self, name: str) -> Parameter:
        return self._parameters[name]

    def check(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """All values, defaults filled in; raises InputError for an unknown name or a bad value."""
        for name in values:
            if name not in self._parameters:
                known = known_names(name, self._parameters)
                raise InputError(f"parameter '{name}' does not exist; {known}")
        return {p.name: p.check(values.get(p.name, p.default)) for p in self}

    def markdown(self) -> str:
        """Table for the node reference."""
        lines = ["| parameter | default | range | meaning |", "|---|---|---|---|"]
        for p in self:
            unit = f" {p.unit}" if p.unit else ""
            default = "`[]`" if p.default == [] else f"`{p.default!r}`{unit}"
            note = " Changeable while active." if p.runtime else ""
            advice = f" {p.advice}" if p.advice else ""
            lines.append(
                f"| `{p.name}` | {default} | {p.range_text()} | {p.meaning}{note}{advice} |"
            )
        return "\n".join(lines)
