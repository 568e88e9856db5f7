"""The whole rig: drivers, vision, model, recorder, protocol and operator's page.

ros2 launch finger_bringup rig.launch.py simulated:=true
ros2 launch finger_bringup rig.launch.py parameters:=my_rig.yaml page:=false
"""

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import OpaqueFunction

from finger_bringup import nodes
from finger_bringup.launch.actions import arguments, node_actions, path, truth, value


def rig(context: LaunchContext) -> list[Action]:
    """Actions by the arguments given."""
    choices = {"record": "recorder", "protocol": "protocol", "page": "page"}
    without = [node for argument, node in choices.items() if not truth(context, argument)]
    port = value(context, "page_port")
    parameters = {"page": {"port": int(port)}} if port else {}
    simulated = truth(context, "simulated")
    return node_actions(context, nodes.rig(path(context, "folder"), simulated, without, parameters))


def generate_launch_description() -> LaunchDescription:
    """Entry point of ros2 launch."""
    declared = arguments(
        simulated=("false", "Simulated devices and participant in place of real ones."),
        folder=("out/rig", "Folder of sessions and of the simulated devices."),
        record=("true", "Run the recorder and record every trial."),
        protocol=("true", "Run the protocol node that guides the study."),
        page=("true", "Serve the operator's page."),
        page_port=("", "TCP port of the page; empty: as in the parameter file."),
    )
    return LaunchDescription([*declared, OpaqueFunction(function=rig)])
