"""The fields of a dataclass as parameters of a node: what the example nodes share."""

from __future__ import annotations

import dataclasses
import sys
from typing import Any, TypeVar

from finger_common.cli import EXIT_BAD_INPUT
from finger_common.errors import known_names

T = TypeVar("T")


def from_parameters(node: Any, kind: type[T], **needed: Any) -> T:
    """An object of this dataclass, each field of which is a parameter of the node.

    needed: values for fields without a default, where no parameter is given. Ends the process with
    exit code 2 and one sentence for a parameter that does not exist, has the wrong type or that the
    class refuses.
    """
    from rclpy.exceptions import ParameterException

    settings = {
        field.name: needed.get(field.name, field.default)
        for field in dataclasses.fields(kind)  # type: ignore[arg-type]
        if field.init
    }
    try:
        values = {name: node.declare_parameter(name, settings[name]).value for name in settings}
        for name in node._parameter_overrides:
            if not (node.has_parameter(name) or name.startswith("qos_overrides.")):
                raise ValueError(
                    f"parameter '{name}' does not exist; {known_names(name, settings)}"
                )
        return kind(**values)
    except (ValueError, ParameterException) as error:
        print(f"{node.get_name()}: {error}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
