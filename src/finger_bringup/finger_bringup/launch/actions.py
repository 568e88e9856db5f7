"""The node table as launch actions, for the launch files of this package.

A launch file's nodes start with `autostart` false and are configured and activated in order by `bring_up_node`, which
also brings a restarted node up again. launch_ros restarts nodes that die and reports it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from launch import LaunchContext  # type: ignore[attr-defined]
from launch.action import Action
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from finger_bringup import nodes

CONFIG = Path(__file__).resolve().parents[2] / "config"

COMMON = {
    "namespace": ("finger", "Namespace of all nodes and topics."),
    "parameters": ("", "ROS parameter file (YAML), such as a copy of config/rig.yaml."),
    "respawn": ("true", "Start nodes that die again."),
    "log_level": ("info", "Least level of what nodes log."),
}
"""Arguments of every launch file: default and meaning."""


def arguments(*names: str, **further: tuple[str, str]) -> list[DeclareLaunchArgument]:
    """Declarations of the named common arguments and of further ones as (default, meaning)."""
    table = {**{name: COMMON[name] for name in names}, **further}
    return [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in table.items()
    ]


def value(context: LaunchContext, name: str) -> str:
    """Value of a launch argument."""
    return str(LaunchConfiguration(name).perform(context)).strip()


def truth(context: LaunchContext, name: str) -> bool:
    """Value of a yes-or-no argument; raises ValueError for anything else."""
    text = value(context, name).lower()
    if text not in ("true", "false"):
        raise ValueError(f"{name}:={text} is not understood; give true or false")
    return text == "true"


def parameter_file(context: LaunchContext) -> Path | None:
    """The checked parameter file, None where none is given; raises InputError naming file and key."""
    text = value(context, "parameters")
    return nodes.check_parameter_file(Path(text).expanduser()) if text else None


def node_actions(
    context: LaunchContext, entries: Iterable[nodes.NodeEntry], **for_all: Any
) -> list[Action]:
    """Launch actions of the entries, and of the node that brings the lifecycle nodes among them up in order.

    for_all: parameters of every node, such as use_sim_time.
    """
    entries = list(entries)
    namespace, level = value(context, "namespace"), value(context, "log_level")
    respawn, file = truth(context, "respawn"), parameter_file(context)
    options: dict[str, Any] = {
        "namespace": namespace,
        "output": "screen",
        "emulate_tty": False,
        "ros_arguments": ["--log-level", level],
        "respawn_delay": 1.0,
    }
    actions: list[Action] = []
    for entry in entries:
        own: dict[str, Any] = {"autostart": not entry.lifecycle, **for_all, **entry.parameters}
        parameters: Sequence[Any] = [own] if file is None else [str(file), own]
        actions.append(
            Node(
                package=entry.package,
                executable=entry.executable,
                name=entry.name,
                parameters=parameters,
                respawn=respawn and entry.respawn,
                **options,
            )
        )
    ranks = sorted({entry.rank for entry in entries if entry.lifecycle})
    order = [" ".join(e.name for e in entries if e.lifecycle and e.rank == rank) for rank in ranks]
    actions.append(
        Node(
            package="finger_bringup",
            executable="bring_up_node",
            name="bring_up",
            parameters=[{"order": order}],
            respawn=respawn,
            # Always told: a launch file may wait for its word that all nodes are active.
            **{**options, "ros_arguments": []},
        )
    )
    return actions
