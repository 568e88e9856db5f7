# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Messages of rclpy from nested plain data."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any, TypeVar

M = TypeVar("M")


def message_of(message_class: type[M], fields: Mapping[str, Any]) -> M:
    """A message with these fields, messages in it as mappings; others keep their defaults.

    Raises AttributeError for a field that the type has not.
    """
    message = message_class()
    kinds = message.get_fields_and_field_types()  # type: ignore[attr-defined]
    for name, value in fields.items():
        kind = kinds.get(name)
        if kind is None:
            raise AttributeError(f"{message_class.__name__} has no field '{name}'")
        if isinstance(value, Mapping):
            value = message_of(type(getattr(message, name)), value)
        elif kind.startswith("sequence<") and "/" in kind:
            element = _class_of(kind.removeprefix("sequence<").partition(">")[0].split(",")[0])
            value = [message_of(element, item) for item in value]
        elif kind in ("double", "float"):
            value = float(value)
        setattr(message, name, value)
    return message


def _class_of(name: str) -> Any:
    """Class of "package/Name"."""
    package, _, kind = name.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)
