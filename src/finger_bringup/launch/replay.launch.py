# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A bag through vision and model, live, on the bag's own clock.

ros2 launch finger_bringup replay.launch.py bag:=bags/natural rate:=1.0
"""

import sys
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
from launch.events.process import ProcessIO

from finger_bag.reader import open_bag
from finger_bringup import nodes
from finger_bringup.bring_up import ALL_ACTIVE
from finger_bringup.launch.actions import arguments, node_actions, truth, value
from finger_common.errors import InputError


def replay(context: LaunchContext) -> list[Action]:
    """Actions by the arguments given."""
    bag = Path(value(context, "bag")).expanduser()
    if not value(context, "bag") or not bag.exists():
        raise InputError(f"bag:={bag}: no such bag; give the folder or file of a recorded bag")
    vision = truth(context, "vision")
    names = ["vision", "model"] if vision else ["model"]
    # Topics that the nodes publish again, and old diagnostics, are left out of the replay.
    again = {"contact_state", "contact_slip", "contact_shape", "model_events", "diagnostics"}
    again |= {"contact_area"} if vision else set()
    topics = [topic for topic in open_bag(bag).info.topics if topic.rsplit("/", 1)[-1] not in again]
    command = [sys.executable, "-m", "finger_bag.cli", "play", str(bag), "--clock"]
    command += ["--rate", value(context, "rate"), "--topics", *topics]
    if truth(context, "loop"):
        command.append("--loop")
    player = ExecuteProcess(
        cmd=command, name="player", output="screen", additional_env={"PYTHONUNBUFFERED": "1"}
    )
    entries = [entry.with_parameters(use_sim_time=True) for entry in nodes.select(names)]
    waiting: list[Action] = [player]

    def output(event: ProcessIO) -> list[Action]:
        # The nodes must be active before the first message.
        return [waiting.pop()] if ALL_ACTIVE.encode() in event.text and waiting else []

    start = RegisterEventHandler(OnProcessIO(on_stdout=output, on_stderr=output))
    actions = [start, *node_actions(context, entries)]
    if truth(context, "end"):
        done = [TimerAction(period=1.0, actions=[EmitEvent(event=Shutdown(reason="bag played"))])]
        actions.append(RegisterEventHandler(OnProcessExit(target_action=player, on_exit=done)))
    return actions


def generate_launch_description() -> LaunchDescription:
    """Entry point of ros2 launch."""
    declared = arguments(
        bag=("", "Bag to replay: an MCAP file or a rosbag2 folder."),
        rate=("1.0", "Speed; 1 is real time."),
        loop=("false", "Begin again at the end."),
        vision=("true", "Measure areas in the bag's images; false uses the recorded areas."),
        end=("true", "End everything when the bag is played."),
    )
    return LaunchDescription([*declared, OpaqueFunction(function=replay)])
