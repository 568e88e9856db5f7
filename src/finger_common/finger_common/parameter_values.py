# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Settings as rcl_interfaces/Parameter: a name and a typed value, in messages, goals and bags.

Messages are read by attribute: those of rclpy and those of a bag reader alike.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from .errors import InputError

_FIELDS: dict[type, tuple[int, str, int, str]] = {
    bool: (1, "bool_value", 6, "bool_array_value"),
    int: (2, "integer_value", 7, "integer_array_value"),
    float: (3, "double_value", 8, "double_array_value"),
    str: (4, "string_value", 9, "string_array_value"),
}
"""Python type -> number and field in ParameterValue, alone and in a list."""

_FIELD_OF = {
    number: (field, kind)
    for kind, (one, field_one, many, field_many) in _FIELDS.items()
    for number, field in ((one, field_one), (many, field_many))
}


def parameter_fields(values: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Fields of a Parameter for each value; an empty list is one of texts.

    Raises InputError for a value that a parameter cannot hold.
    """
    return [{"name": name, "value": _value_fields(name, value)} for name, value in values.items()]


def parameter_values(parameters: Iterable[Any]) -> dict[str, Any]:
    """Plain values by name; raises InputError for a parameter without a value."""
    found = {}
    for parameter in parameters:
        if parameter.value.type not in _FIELD_OF:
            raise InputError(
                f"parameter '{parameter.name}' has no value of a known type; set its type"
            )
        field, kind = _FIELD_OF[parameter.value.type]
        value = getattr(parameter.value, field)
        several = field.endswith("array_value")
        found[str(parameter.name)] = [kind(v) for v in value] if several else kind(value)
    return found


def _value_fields(name: str, value: Any) -> dict[str, Any]:
    if isinstance(value, (list, tuple)):
        kinds = {type(v) for v in value} or {str}
        if kinds == {int, float}:
            kinds = {float}
        if len(kinds) == 1 and (kind := kinds.pop()) in _FIELDS:
            _, _, number, field = _FIELDS[kind]
            return {"type": number, field: [kind(v) for v in value]}
    elif type(value) in _FIELDS:
        number, field, _, _ = _FIELDS[type(value)]
        return {"type": number, field: value}
    raise InputError(f"'{name}' is {value!r}, which no parameter can hold")
