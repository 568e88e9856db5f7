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
    # What the nodes compute anew, and old diagnostics, are left out of the replay.
    anew = {"contact_state", "model_events", "diagnostics", *(["contact_area"] if vision else [])}
    topics = [topic for topic in open_bag(bag).info.topics if topic.rsplit("/", 1)[-1] not in anew]
    command = [sys.executable, "-m", "finger_bag.cli", "play", str(bag), "--clock"]
    command += ["--rate", value(context, "rate"), "--topics", *topics]
    if truth(context, "loop"):
        command.append("--loop")
    player = ExecuteProcess(
        cmd=command, name="player", output="screen", additional_env={"PYTHONUNBUFFERED": "1"}
    )
    actions = node_actions(context, nodes.select(names), use_sim_time=True)
    waiting: list[Action] = [player]

    def said(event: ProcessIO) -> list[Action]:
        # The nodes must be active before the first message.
        return [waiting.pop()] if ALL_ACTIVE.encode() in event.text and waiting else []

    # The node that brings the others up is the last one.
    actions.append(
        RegisterEventHandler(OnProcessIO(target_action=actions[-1], on_stdout=said, on_stderr=said))
    )
    if truth(context, "end"):
        done = [TimerAction(period=1.0, actions=[EmitEvent(event=Shutdown(reason="bag played"))])]
        actions.append(RegisterEventHandler(OnProcessExit(target_action=player, on_exit=done)))
    return actions


def generate_launch_description() -> LaunchDescription:
    """Entry point of ros2 launch."""
    further = {
        "bag": ("", "Bag to replay: an MCAP file or a rosbag2 folder."),
        "rate": ("1.0", "Speed; 1 is real time."),
        "loop": ("false", "Begin again at the end."),
        "vision": (
            "true",
            "Measure areas anew from the bag's images; false takes the recorded areas.",
        ),
        "end": ("true", "End everything when the bag is played."),
    }
    declared = arguments("namespace", "parameters", "respawn", "log_level", **further)
    return LaunchDescription([*declared, OpaqueFunction(function=replay)])
