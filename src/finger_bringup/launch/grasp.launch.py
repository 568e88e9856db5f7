# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""On a robot: force and contact state only, no camera, no moisture probe, no page.

ros2 launch finger_bringup grasp.launch.py parameters:=robot.yaml
ros2 launch finger_bringup grasp.launch.py force:=false wrench:=/wrist/wrench
"""

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import OpaqueFunction
from launch_ros.actions import SetRemap

from finger_bringup import nodes
from finger_bringup.launch.actions import COMPOSE, arguments, composed, node_actions, truth, value
from finger_common.errors import InputError


def grasp(context: LaunchContext) -> list[Action]:
    """Actions by the arguments given."""
    own = truth(context, "force")
    if own and value(context, "wrench"):
        raise InputError(
            f"wrench:={value(context, 'wrench')} is another vendor's topic, on which this suite's "
            "driver would publish too; give force:=false as well"
        )
    names = [name for name in nodes.GRASP if name != "force" or own]
    actions = node_actions(context, nodes.select(names), composed(context))
    if value(context, "wrench"):
        actions.insert(0, SetRemap("wrench", value(context, "wrench")))
    return actions


def generate_launch_description() -> LaunchDescription:
    """Entry point of ros2 launch."""
    declared = arguments(
        **COMPOSE,
        force=("true", "Run this suite's force driver; false where another vendor's runs."),
        wrench=("", "Topic of another vendor's wrench in place of this suite's."),
    )
    return LaunchDescription([*declared, OpaqueFunction(function=grasp)])
