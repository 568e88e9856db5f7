# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A bag through vision and model, live, on the bag's own clock.

ros2 launch finger_bringup replay.launch.py bag:=bags/natural rate:=1.0
"""

import tempfile
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import (
    EmitEvent,
    ExecuteProcess,
    OpaqueFunction,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnProcessExit, OnProcessIO
from launch.events import Shutdown
from launch.events.process import ProcessExited, ProcessIO

from finger_bag.replay import ReplaySettings
from finger_bringup import nodes
from finger_bringup.bring_up import ALL_ACTIVE
from finger_bringup.launch.actions import (
    arguments,
    node_actions,
    number,
    parameter_file,
    truth,
    value,
)
from finger_bringup.replay import replay_of
from finger_common.cli import EXIT_LOST
from finger_common.entry import command_of
from finger_common.errors import InputError
from finger_common.files import user_path
from finger_common.namespaces import DEFAULT_NAMESPACE


def replay(context: LaunchContext) -> list[Action]:
    """Actions by the arguments given."""
    if not value(context, "bag"):
        raise InputError("no bag is given; name the folder or file of a recorded one: bag:=…")
    bag = user_path(value(context, "bag"))
    if not bag.exists():
        raise InputError(f"bag:={bag}: no such bag; give the folder or file of a recorded bag")
    rate = ReplaySettings(rate=number(context, "rate")).rate
    vision = truth(context, "vision") if value(context, "vision") else None
    namespace = value(context, "namespace")
    model = f"/{(namespace or DEFAULT_NAMESPACE).strip('/')}/model"
    wrench = parameter_file(context).values_of(model).get("wrench_topic", "wrench")
    chosen = replay_of(bag, vision, namespace, str(wrench))
    context.launch_configurations["namespace"] = chosen.namespace
    command = [*command_of("finger_bag.cli"), "play", str(bag), "--clock"]
    command += ["--rate", str(rate), "--topics", *chosen.topics, "--await", *chosen.heard]
    if truth(context, "loop"):
        command.append("--loop")
    player = ExecuteProcess(
        cmd=command, name="player", output="screen", additional_env={"PYTHONUNBUFFERED": "1"}
    )
    # The bag's time begins when all nodes are up: the one that brings them up does not need it.
    entries = [
        entry.with_parameters(use_sim_time=entry.lifecycle) for entry in nodes.select(chosen.nodes)
    ]
    seen = {"image_transport": chosen.image_transport}
    if chosen.calibration is not None:
        file = Path(tempfile.mkdtemp(prefix="finger_launch_")) / "plate_calibration.yaml"
        file.write_bytes(chosen.calibration)
        seen["calibration_file"] = str(file)
    entries = [e.with_defaults(**seen) if e.name == "vision" else e for e in entries]
    waiting: list[Action] = [player]
    ends = truth(context, "end")

    def output(event: ProcessIO) -> list[Action]:
        # The nodes must be active before the first message.
        return [waiting.pop()] if ALL_ACTIVE.encode() in event.text and waiting else []

    def played(event: ProcessExited, context: LaunchContext) -> list[Action]:
        if event.returncode and not context.is_shutdown:
            lost = event.returncode == EXIT_LOST
            said = "not all of the bag could be played" if lost else "the bag could not be played"
            if not lost or ends:
                raise RuntimeError(f"{said}; the lines above name the cause")
        done = [EmitEvent(event=Shutdown(reason="bag played"))]
        return [TimerAction(period=1.0, actions=done)] if ends else []

    start = RegisterEventHandler(OnProcessIO(on_stdout=output, on_stderr=output))
    end = RegisterEventHandler(OnProcessExit(target_action=player, on_exit=played))
    return [start, end, *node_actions(context, entries)]


def generate_launch_description() -> LaunchDescription:
    """Entry point of ros2 launch."""
    declared = arguments(
        bag=("", "Bag to replay: an MCAP file or a rosbag2 folder."),
        namespace=("", "Namespace of the nodes; empty: that of the bag's wrench."),
        rate=("1.0", "Speed; 1 is real time."),
        loop=("false", "Begin again at the end."),
        vision=(
            "",
            "Measure areas in the bag's images; false uses the recorded areas. Empty: true for "
            "a bag that holds raw images.",
        ),
        end=("true", "End everything when the bag is played."),
    )
    return LaunchDescription([*declared, OpaqueFunction(function=replay)])
