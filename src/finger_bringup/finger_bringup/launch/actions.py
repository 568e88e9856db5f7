# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The entries of `nodes` as launch actions, for the launch files of this package."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from launch import LaunchContext  # type: ignore[attr-defined]
from launch.action import Action
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from finger_bringup import nodes
from finger_bringup.parameter_files import ParameterFile, write_parameter_file
from finger_bringup.restarts import RestartDelay
from finger_common.errors import InputError
from finger_common.files import user_path
from finger_common.namespaces import DEFAULT_NAMESPACE

COMMON = {
    "namespace": (DEFAULT_NAMESPACE, "Namespace of all nodes and topics."),
    "parameters": ("", "ROS parameter file (YAML), such as a copy of config/rig.yaml."),
    "respawn": ("true", "Start nodes again that end by themselves."),
    "log_level": ("info", "Lowest level of the messages that nodes log."),
}
"""Arguments of every launch file: default and meaning."""

COMPOSE = {
    "compose": ("false", "Run the nodes in one process."),
    "realtime": ("false", "That process has real-time priority (needs the right to it)."),
}
"""Arguments of the launch files of many nodes."""


def arguments(**further: tuple[str, str]) -> list[DeclareLaunchArgument]:
    """Declarations of the common arguments and of further ones as (default, meaning)."""
    return [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in {**COMMON, **further}.items()
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


def number(context: LaunchContext, name: str) -> float:
    """Value of an argument that is a number; raises InputError for anything else."""
    try:
        return float(value(context, name))
    except ValueError:
        raise InputError(f"{name}:={value(context, name)} is no number; give one") from None


def composed(context: LaunchContext) -> bool:
    """Whether the nodes run in one process, by COMPOSE; raises InputError where its arguments
    contradict each other."""
    if truth(context, "realtime") and not truth(context, "compose"):
        raise InputError("realtime:=true is for the process of compose:=true; give both")
    return truth(context, "compose")


def path(context: LaunchContext, name: str) -> Path:
    """Absolute path that an argument names."""
    return user_path(value(context, name)).absolute()


def parameter_file(context: LaunchContext) -> ParameterFile:
    """The user's parameter file."""
    return ParameterFile(path(context, "parameters") if value(context, "parameters") else None)


def node_actions(
    context: LaunchContext, entries: Iterable[nodes.NodeEntry], compose: bool = False
) -> list[Action]:
    """Launch actions that run the entries with the common arguments.

    compose: run all that can share a process in one.
    """
    respawn, level = truth(context, "respawn"), value(context, "log_level")
    suite = value(context, "namespace")
    file = parameter_file(context)
    entries = nodes.settled(entries, suite, file)
    doubts = (nodes.without_effect, nodes.shared_sensors)
    files = [] if file.path is None else [str(file.path)]
    together = [entry for entry in entries if compose and entry.composable]

    def node(entry: nodes.NodeEntry) -> Node:
        # Launch files wait for a line of `bring_up` that has the level info.
        entry_level = "info" if entry.name == nodes.BRING_UP.name else level
        return Node(
            package=entry.package,
            executable=entry.executable,
            name=entry.name,
            namespace=entry.namespace(suite),
            parameters=[*files, dict(entry.parameters)],
            ros_arguments=["--log-level", entry_level],
            output="screen",
        )

    def composed(entry: nodes.NodeEntry) -> Node:
        own = Path(tempfile.mkdtemp(prefix="finger_launch_")) / "parameters.yaml"
        write_parameter_file({e.full_name(suite): e.parameters for e in together}, own)
        bring_up_loggers = [
            entry.full_name(suite).strip("/").replace("/", ".")
            for entry in together
            if entry.name == nodes.BRING_UP.name
        ]
        # Without a name and a namespace: they would be those of every node in the process.
        return Node(
            package=entry.package,
            executable=entry.executable,
            arguments=nodes.composed_arguments(together, suite, truth(context, "realtime")),
            ros_arguments=[
                *(p for file in (*files, own) for p in ("--params-file", str(file))),
                *("--log-level", level),
                *(p for logger in bring_up_loggers for p in ("--log-level", f"{logger}:=info")),
            ],
            output="screen",
        )

    alone = [(e, node) for e in entries if e not in together]
    shared = [(nodes.COMPOSED, composed)] if together else []
    sentences = [doubt(entries, suite, file) for doubt in doubts]
    warnings: list[Action] = [LogInfo(msg=sentence) for sentence in sentences if sentence]
    return warnings + [
        action
        for entry, make in (*alone, *shared)
        for action in _kept_running(entry, make, RestartDelay(), respawn)
    ]


def _kept_running(
    entry: nodes.NodeEntry,
    make: Callable[[nodes.NodeEntry], Node],
    delay: RestartDelay,
    respawn: bool,
) -> list[Action]:
    """The node and what follows its end: a restart after a delay, or the end of everything."""
    node, started = make(entry), time.monotonic()

    def ended(event: ProcessExited, context: LaunchContext) -> list[Action]:
        if context.is_shutdown:
            return []
        if entry.essential:
            if event.returncode:
                raise RuntimeError(f"'{entry.name}' failed; the lines above name the cause")
            return [EmitEvent(event=Shutdown(reason=f"'{entry.name}' has ended"))]
        duration = time.monotonic() - started
        if not (respawn and entry.restart) or delay.note_end(event.returncode, duration):
            return [LogInfo(msg=f"{entry.name} ended; it is not started again")]
        wait = delay.after_running(duration)
        again = OpaqueFunction(function=lambda _: _kept_running(entry, make, delay, respawn))
        message = LogInfo(msg=f"{entry.name} ended; starting it again in {wait:g} s")
        return [message, TimerAction(period=wait, actions=[again])]

    return [RegisterEventHandler(OnProcessExit(target_action=node, on_exit=ended)), node]
