"""Arguments of a node, and the fields of a dataclass as its parameters: what the example nodes
share."""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from collections.abc import Sequence
from typing import Any, TypeVar

from finger_common.cli import EXIT_BAD_INPUT, one_line
from finger_common.errors import known_names

T = TypeVar("T")


def parse_arguments(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """The options of a node's command line. Ends the process with exit code 2 and a sentence for
    anything that is neither of them nor, after --ros-args, of ROS."""
    own = sys.argv
    if "--ros-args" in own:
        from rclpy.utilities import remove_ros_args

        try:
            own = remove_ros_args(own)
        except RuntimeError as error:
            parser.error(one_line(error))
    return parser.parse_args(own[1:])


def check_numbers(settings: Any, free: Sequence[str] = ()) -> None:
    """Raise ValueError for a field that is given and is no number from 0 on; free: may be any."""
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if field.init and field.name not in free and not 0.0 <= value < math.inf:
            raise ValueError(f"{field.name} is {value:g}, a number from 0 on is needed")


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
        whole = "; write 5.0 for a whole number" if "INTEGER" in str(error) else ""
        print(f"{node.get_name()}: {error}{whole}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
