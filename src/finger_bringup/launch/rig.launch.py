"""The whole rig: drivers, vision, model, recorder, protocol and operator's page.

ros2 launch finger_bringup rig.launch.py simulated:=true
ros2 launch finger_bringup rig.launch.py parameters:=my_rig.yaml page:=false
"""

import socket
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import OpaqueFunction

from finger_bringup import nodes
from finger_bringup.launch.actions import arguments, node_actions, truth, value
from finger_sim.rig import RigAddresses


def free_udp_port() -> int:
    """A UDP port nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


def rig(context: LaunchContext) -> list[Action]:
    """Actions by the arguments given."""
    simulated, record = truth(context, "simulated"), truth(context, "record")
    folder = Path(value(context, "folder")).expanduser().absolute()
    names = [name for name in nodes.RIG if record or name != "recorder"]
    parameters: dict[str, dict[str, object]] = {}
    if truth(context, "protocol"):
        names.append("protocol")
        parameters["protocol"] = {"output": str(folder / "sessions"), "need_recorder": record}
    if truth(context, "page"):
        names.append("page")
        if value(context, "page_port"):
            parameters["page"] = {"port": int(value(context, "page_port"))}
    if simulated:
        names.insert(0, "simulated_rig")
        addresses = RigAddresses(folder / "devices", can_port=free_udp_port())
        for name, values in nodes.simulated_devices(addresses).items():
            parameters[name] = {**parameters.get(name, {}), **values}
    chosen = {name: parameters[name] for name in names if name in parameters}
    return node_actions(context, nodes.select(names, chosen))


def generate_launch_description() -> LaunchDescription:
    """Entry point of ros2 launch."""
    further = {
        "simulated": ("false", "Simulated devices and participant in place of real ones."),
        "folder": ("out/rig", "Folder of sessions and of the simulated devices."),
        "record": ("true", "Run the recorder and record every trial."),
        "protocol": ("true", "Run the protocol node that guides the study."),
        "page": ("true", "Serve the operator's page."),
        "page_port": ("", "TCP port of the page; empty: the parameter's."),
    }
    declared = arguments("namespace", "parameters", "respawn", "log_level", **further)
    return LaunchDescription([*declared, OpaqueFunction(function=rig)])
