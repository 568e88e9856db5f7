# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Described parameters as rclpy declares them: type, range and description."""

from __future__ import annotations

import sys
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.parameter import Parameter as RosParameter

from ..parameters import Parameter

_LARGEST_INTEGER = 2**63 - 1


def type_of(parameter: Parameter) -> RosParameter.Type:
    """ROS type of a parameter; an empty list is one of strings."""
    if parameter.default == []:
        return RosParameter.Type.STRING_ARRAY
    return RosParameter.Type.from_parameter_value(parameter.default)


def descriptor_of(parameter: Parameter) -> ParameterDescriptor:
    """Descriptor of a parameter; a missing end of its range is the largest number of the type."""
    allowed = parameter.range_text()
    descriptor = ParameterDescriptor(
        name=parameter.name,
        type=type_of(parameter).value,
        description=f"{parameter.meaning} {allowed}".strip(),
        additional_constraints=allowed,
    )
    low, high = parameter.minimum, parameter.maximum
    if low is None and high is None:
        return descriptor
    if isinstance(parameter.default, int):
        first = -_LARGEST_INTEGER - 1 if low is None else int(low)
        last = _LARGEST_INTEGER if high is None else int(high)
        descriptor.integer_range = [IntegerRange(from_value=first, to_value=last)]
    elif isinstance(parameter.default, float):
        largest = sys.float_info.max
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=-largest if low is None else float(low),
                to_value=largest if high is None else float(high),
            )
        ]
    return descriptor


def ros_value(parameter: Parameter, value: Any) -> RosParameter:
    """A value in the parameter's type, 3 for 3.0 too; raises InputError where it is refused."""
    return RosParameter(parameter.name, type_of(parameter), parameter.check(value))
