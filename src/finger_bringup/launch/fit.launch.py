# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The fit node, and a fit of a folder of bags where one is given.

ros2 launch finger_bringup fit.launch.py bags:=bags output:=out/fit
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import OpaqueFunction

from finger_bringup import nodes
from finger_bringup.launch.actions import arguments, node_actions, path, value
from finger_common.errors import InputError
from finger_common.files import user_path


def fit(context: LaunchContext) -> list[Action]:
    """Actions by the arguments given."""
    bags = [str(user_path(bag).absolute()) for bag in value(context, "bags").split()]
    for bag in bags:
        if not Path(bag).exists():
            raise InputError(f"bags:={bag}: no such bag or folder; correct the path")
    request = {
        "bags": bags,
        "output": str(path(context, "output")),
        "conditions": value(context, "conditions").split() or [""],
        "options": value(context, "options"),
    }
    names = ["fit", "fit_request"] if bags else ["fit"]
    return node_actions(context, nodes.select(names, {"fit_request": request}))


def generate_launch_description() -> LaunchDescription:
    """Entry point of ros2 launch."""
    declared = arguments(
        bags=("", "Bags or folders of bags to fit, separated by spaces; empty: only the node."),
        output=("out/fit", "Folder for parameters.yaml, fit.json and report.html."),
        conditions=("", "Conditions to fit, separated by spaces; empty: all."),
        options=("", "JSON object of options of finger-fit."),
    )
    return LaunchDescription([*declared, OpaqueFunction(function=fit)])
