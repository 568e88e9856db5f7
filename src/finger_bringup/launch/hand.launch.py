# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Force and contact state of several fingers, each in a namespace of its own.

ros2 launch finger_bringup hand.launch.py parameters:=hand.yaml
ros2 launch finger_bringup hand.launch.py fingers:="thumb index" simulated:=true compose:=false
"""

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import ExecuteProcess, OpaqueFunction

from finger_bringup import nodes
from finger_bringup.launch.actions import COMPOSE, arguments, composed, node_actions, truth, value
from finger_common.subject_code import FINGERS


def hand(context: LaunchContext) -> list[Action]:
    """Actions by the arguments given."""
    fingers = value(context, "fingers").split()
    boards, devices = nodes.simulated_boards(fingers if truth(context, "simulated") else ())
    entries = nodes.hand(fingers, parameters=devices)
    return [
        *(ExecuteProcess(cmd=board.command, output="screen") for board in boards),
        *node_actions(context, entries, composed(context)),
    ]


def generate_launch_description() -> LaunchDescription:
    """Entry point of ros2 launch."""
    declared = arguments(
        namespace=(nodes.HAND_NAMESPACE, "Namespace of the hand, above those of its fingers."),
        fingers=(" ".join(FINGERS), "Namespaces of the fingers, separated by spaces."),
        simulated=("false", "A simulated force sensor for each finger."),
        **{**COMPOSE, "compose": ("true", "Run all fingers in one process.")},
    )
    return LaunchDescription([*declared, OpaqueFunction(function=hand)])
