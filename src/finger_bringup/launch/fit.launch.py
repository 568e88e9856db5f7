"""The fit node, and a fit of a folder of bags where one is given.

ros2 launch finger_bringup fit.launch.py bags:=bags output:=out/fit
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.events.process import ProcessExited
from launch_ros.actions import Node

from finger_bringup import nodes
from finger_bringup.launch.actions import arguments, node_actions, value
from finger_common.errors import InputError


def fit(context: LaunchContext) -> list[Action]:
    """Actions by the arguments given."""
    actions = node_actions(context, nodes.select(["fit"]))
    bags = [str(Path(bag).expanduser().absolute()) for bag in value(context, "bags").split()]
    if not bags:
        return actions
    for bag in bags:
        if not Path(bag).exists():
            raise InputError(f"bags:={bag}: no such bag or folder; correct the path")
    request = Node(
        package="finger_bringup",
        executable="fit_request_node",
        name="fit_request",
        namespace=value(context, "namespace"),
        output="screen",
        parameters=[
            {
                "bags": bags,
                "output": str(Path(value(context, "output")).expanduser().absolute()),
                "conditions": value(context, "conditions").split() or [""],
                "options": value(context, "options"),
            }
        ],
    )

    def ended(event: ProcessExited, context: LaunchContext) -> list[Action]:
        if event.returncode:
            raise RuntimeError("the fit failed; the lines above say why")
        return [EmitEvent(event=Shutdown(reason="fit ended"))]

    return [
        *actions,
        request,
        RegisterEventHandler(OnProcessExit(target_action=request, on_exit=ended)),
    ]


def generate_launch_description() -> LaunchDescription:
    """Entry point of ros2 launch."""
    further = {
        "bags": ("", "Bags or folders of bags to fit, separated by spaces; empty: only the node."),
        "output": ("out/fit", "Folder for parameters.yaml, fit.json and report.html."),
        "conditions": ("", "Conditions to fit, separated by spaces; empty: all."),
        "options": ("", "JSON object of options of finger-fit."),
    }
    declared = arguments("namespace", "parameters", "respawn", "log_level", **further)
    return LaunchDescription([*declared, OpaqueFunction(function=fit)])
