# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The whole rig: drivers, vision, model, recorder, protocol and operator's page.

ros2 launch finger_bringup rig.launch.py simulated:=true
ros2 launch finger_bringup rig.launch.py parameters:=my_rig.yaml page:=false
"""

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import OpaqueFunction

from finger_bringup import nodes
from finger_bringup.launch.actions import (
    COMPOSE,
    arguments,
    composed,
    node_actions,
    path,
    truth,
    value,
)
from finger_common.namespaces import default_folder


def rig(context: LaunchContext) -> list[Action]:
    """Actions by the arguments given."""
    choices = {"record": "recorder", "protocol": "protocol", "page": "page"}
    without = [node for argument, node in choices.items() if not truth(context, argument)]
    port = value(context, "page_port")
    parameters = {"page": {"port": int(port)}} if port else {}
    further = ["foxglove"] if truth(context, "foxglove") else []
    simulated = truth(context, "simulated")
    folder = default_folder(value(context, "namespace")).absolute()
    if value(context, "folder"):
        folder = path(context, "folder")
    entries = nodes.rig(folder, simulated, without, parameters, further=further)
    return node_actions(context, entries, composed(context))


def generate_launch_description() -> LaunchDescription:
    """Entry point of ros2 launch."""
    declared = arguments(
        **COMPOSE,
        simulated=("false", "Simulated devices and participant in place of real ones."),
        folder=("", "Folder of sessions and of simulated devices; empty: by namespace, out/rig."),
        record=("true", "Run the recorder and record every trial."),
        protocol=("true", "Run the protocol node that guides the study."),
        page=("true", "Serve the operator's page."),
        foxglove=("false", "Serve the live view in Foxglove (port 8765 of this machine)."),
        page_port=("", "TCP port of the page; empty: as in the parameter file."),
    )
    return LaunchDescription([*declared, OpaqueFunction(function=rig)])
