# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Requests to set parameters of another node."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter


def set_request(values: Mapping[str, Any]) -> SetParameters.Request:
    """Request that sets parameters of these names."""
    return SetParameters.Request(
        parameters=[Parameter(name, value=v).to_parameter_msg() for name, v in values.items()]
    )


def refusal_of(response: SetParameters.Response) -> str:
    """Why the first parameter that was refused was; empty when none was."""
    return next((str(r.reason) for r in response.results if not r.successful), "")
