# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Launch files, with the real ros2 command line where launch_ros is installed."""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
import re
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from waiting import wait_until

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip(
    "launch_ros", reason="launch_ros is not on PyPI; it comes with apt ROS or from its sources"
)

FILES = ("rig", "replay", "grasp", "hand", "fit")
ROS2 = [sys.executable, "-c", "import sys; from ros2cli.cli import main; sys.exit(main())"]


@pytest.fixture
def launch_folder(project_root: Path) -> Path:
    return project_root / "src" / "finger_bringup" / "launch"


@pytest.fixture
def environment(ros_domain: int) -> dict[str, str]:
    variables = dict(os.environ)
    prefix = variables.get("AMENT_PREFIX_PATH", "")
    variables["AMENT_PREFIX_PATH"] = f"{prefix}{os.pathsep}{sys.prefix}".lstrip(os.pathsep)
    variables["PYTHONUNBUFFERED"] = "1"
    return variables


def ros2(environment: dict[str, str], *arguments: str, seconds: float = 60.0) -> str:
    """Output of one ros2 command; what it printed until then where it runs until Ctrl-C."""
    child = subprocess.Popen(
        [*ROS2, *arguments],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        return child.communicate(timeout=seconds)[0]
    except subprocess.TimeoutExpired:
        os.killpg(child.pid, signal.SIGINT)
        return child.communicate(timeout=10)[0]


class Launch:
    """A running `ros2 launch`."""

    def __init__(self, environment: dict[str, str], folder: Path, *arguments: str) -> None:
        self.output = folder / "launch.log"
        with self.output.open("w") as log:
            self.child = subprocess.Popen(
                [*ROS2, "launch", "finger_bringup", *arguments],
                env={**environment, "ROS_LOG_DIR": str(folder / "ros")},
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=folder,
                start_new_session=True,
            )

    @property
    def text(self) -> str:
        return self.output.read_text()

    def until(self, condition: Callable[[], Any], seconds: float = 120.0) -> Any:
        spin = partial(time.sleep, 0.2)
        return wait_until(condition, lambda: self.text[-5000:], spin=spin, seconds=seconds)

    def logged(self, text: str, times: int = 1, seconds: float = 120.0) -> None:
        self.until(lambda: self.text.count(text) >= times, seconds)

    def pids(self, executable: str) -> list[int]:
        found = re.findall(rf"\[{executable}-\d+\]: process started with pid \[(\d+)\]", self.text)
        return [int(pid) for pid in found]

    def end(self) -> int:
        """Ctrl-C as a terminal gives it, then the exit code."""
        if self.child.poll() is None:
            self.child.send_signal(signal.SIGINT)
        return self.child.wait(40)


@pytest.fixture
def launch(environment: dict[str, str], tmp_path: Path) -> Iterator[Callable[..., Launch]]:
    running: list[Launch] = []

    def start(*arguments: str) -> Launch:
        running.append(Launch(environment, tmp_path, *arguments))
        return running[-1]

    yield start
    for one in running:
        try:
            one.end()
        except subprocess.TimeoutExpired:
            os.killpg(one.child.pid, signal.SIGKILL)


@pytest.mark.parametrize("name", FILES)
def test_arguments_have_defaults_and_meanings(launch_folder: Path, name: str) -> None:
    from launch.actions import DeclareLaunchArgument

    spec = importlib.util.spec_from_file_location(name, launch_folder / f"{name}.launch.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    declared = [
        e
        for e in module.generate_launch_description().entities
        if isinstance(e, DeclareLaunchArgument)
    ]
    names = {d.name for d in declared}
    assert {"namespace", "parameters", "respawn", "log_level"} <= names
    assert all(d.description and d.default_value is not None for d in declared)


def test_launch_files_and_finger_rig_run_the_same_nodes_with_the_same_parameters(
    tmp_path: Path,
) -> None:
    import yaml
    from launch import LaunchContext
    from launch_ros.actions import Node

    from finger_bringup import nodes
    from finger_bringup.launch.actions import COMMON, node_actions
    from finger_bringup.parameter_files import ParameterFile

    own = tmp_path / "rig.yaml"
    own.write_text("/**/force:\n  ros__parameters: {can_channel: can7}\n")
    context = LaunchContext()
    context.launch_configurations.update({name: default for name, (default, _) in COMMON.items()})
    context.launch_configurations["parameters"] = str(own)
    entries = nodes.rig(tmp_path, simulated=True)
    launched = [a for a in node_actions(context, entries) if isinstance(a, Node)]
    specs = nodes.process_specs(entries, tmp_path, parameter_file=ParameterFile(own))
    modules = [spec.command[3] for spec in specs]
    assert [f"{a.node_package}.{a.node_executable}" for a in launched] == modules
    written = yaml.safe_load((tmp_path / nodes.OWN_PARAMETERS).read_text())
    for action, entry in zip(launched, entries):
        action._perform_substitutions(context)
        assert action.node_name == f"/finger/{entry.name}"
        # The user's file first, so that what the suite sets overrides it, as in `finger-rig up`.
        files = [Path(argument) for argument, _ in action._Node__expanded_parameter_arguments]
        assert files[0] == own
        # launch_ros writes lists as tuples.
        text = files[1].read_text().replace("!!python/tuple", "")
        section = yaml.safe_load(text)[action.node_name]["ros__parameters"]
        assert section == written[action.node_name]["ros__parameters"]


def test_the_log_level_is_that_of_composed_nodes_too() -> None:
    from launch import LaunchContext
    from launch_ros.actions import Node

    from finger_bringup import nodes
    from finger_bringup.launch.actions import COMMON, COMPOSE, node_actions

    context = LaunchContext()
    for name, (default, _) in {**COMMON, **COMPOSE}.items():
        context.launch_configurations[name] = default
    context.launch_configurations.update({"namespace": "hand", "log_level": "warn"})
    actions = node_actions(context, nodes.hand(["thumb"]), compose=True)
    (node,) = [action for action in actions if isinstance(action, Node)]
    node._perform_substitutions(context)
    command = ["".join(part.perform(context) for part in word) for word in node.cmd]
    levels = [word for word, before in zip(command[1:], command) if before == "--log-level"]
    # Whoever waits for all nodes to be active reads it in the log.
    assert levels == ["warn", "hand.bring_up:=info"]


@pytest.mark.parametrize(
    ("code", "end", "words"),
    [
        (0, "true", ""),
        (0, "false", ""),
        (1, "true", "not all of the bag could be played"),
        (1, "false", ""),
        (2, "true", "the bag could not be played"),
        (2, "false", "the bag could not be played"),
    ],
)
def test_the_end_of_a_replay_says_how_much_was_played(
    launch_folder: Path, project_root: Path, code: int, end: str, words: str
) -> None:
    from launch import LaunchContext
    from launch.actions import DeclareLaunchArgument, ExecuteProcess, RegisterEventHandler
    from launch.events.process import ProcessExited, ProcessIO

    from finger_bringup.bring_up import ALL_ACTIVE

    module = runpy.run_path(str(launch_folder / "replay.launch.py"))
    context = LaunchContext()
    for argument in module["generate_launch_description"]().entities:
        if isinstance(argument, DeclareLaunchArgument):
            argument.visit(context)
    context.launch_configurations.update(bag=str(project_root / "bags" / "dry"), end=end)
    handlers = [
        action.event_handler
        for action in module["replay"](context)
        if isinstance(action, RegisterEventHandler)
    ]
    about: dict[str, Any] = dict(name="", cmd=[], cwd=None, env=None, pid=1)
    started = ProcessIO(action=None, text=ALL_ACTIVE.encode(), fd=1, **about)
    (player,) = handlers[0].handle(started, context)
    assert isinstance(player, ExecuteProcess)
    ended = ProcessExited(action=player, returncode=code, **about)
    assert handlers[1].matches(ended)
    if words:
        with pytest.raises(RuntimeError, match=words):
            handlers[1].handle(ended, context)
    else:
        assert bool(handlers[1].handle(ended, context)) == (end == "true")


@pytest.mark.slow
def test_restarts_are_delayed_as_in_finger_rig(
    environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from launch import LaunchContext, LaunchDescription, LaunchService
    from launch.actions import ExecuteProcess, OpaqueFunction, Shutdown, TimerAction

    from finger_bringup import nodes
    from finger_bringup.launch import actions
    from finger_bringup.restarts import RestartDelay

    started: list[float] = []

    def broken(entry: nodes.NodeEntry) -> ExecuteProcess:
        started.append(time.monotonic())
        return ExecuteProcess(cmd=[sys.executable, "-c", "raise SystemExit(1)"])

    def run(context: LaunchContext) -> list[Any]:
        entry = nodes.NODES["vision"]
        return actions._kept_running(entry, broken, RestartDelay(0.2, 0.8), True)

    service = LaunchService()
    end = TimerAction(period=4.0, actions=[Shutdown()])
    service.include_launch_description(LaunchDescription([OpaqueFunction(function=run), end]))
    assert service.run() == 0
    gaps = [later - earlier for earlier, later in itertools.pairwise(started)]
    assert len(gaps) >= 3
    for gap, delay in zip(gaps, (0.2, 0.4, 0.8)):
        assert gap >= delay


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("replay.launch.py",), "no bag is given"),
        (("replay.launch.py", "bag:=missing"), "no such bag"),
        (("replay.launch.py", "bag:=.", "rate:=fast"), "rate:=fast is no number"),
        (("replay.launch.py", "bag:=.", "rate:=0"), "'rate' is 0.0, outside"),
        (("fit.launch.py", "bags:=missing"), "no such bag"),
        (("grasp.launch.py", "parameters:=missing.yaml"), "missing.yaml"),
        (("rig.launch.py", "record:=perhaps"), "give true or false"),
        (("rig.launch.py", "realtime:=true"), "give both"),
        (("grasp.launch.py", "wrench:=/wrist/wrench"), "give force:=false as well"),
    ],
)
def test_wrong_arguments_are_named(
    launch: Callable[..., Launch], arguments: tuple[str, ...], words: str
) -> None:
    running = launch(*arguments)
    assert running.child.wait(60) != 0
    assert words in running.text


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_rig_comes_up_in_order_answers_ros2_and_survives_a_kill(
    launch: Callable[..., Launch],
    environment: dict[str, str],
    tmp_path: Path,
    project_root: Path,
    free_port: Callable[[], int],
) -> None:
    parameters = tmp_path / "rig.yaml"
    parameters.write_text(
        (project_root / "src/finger_bringup/config/rig.yaml")
        .read_text()
        .replace("target_force: 1.35", "target_force: 1.2")
    )
    running = launch(
        "rig.launch.py",
        "simulated:=true",
        "namespace:=lab",
        f"folder:={tmp_path / 'rig'}",
        f"page_port:={free_port()}",
        f"parameters:={parameters}",
    )
    running.logged("all nodes are active: simulated_rig, force, camera, moisture")
    options = ("--no-daemon", "--spin-time", "10")
    state = ros2(environment, "lifecycle", "get", "/lab/force", *options)
    assert "active [3]" in state, state
    value = ros2(environment, "param", "get", "/lab/protocol", "target_force", *options)
    assert "1.2" in value, value
    refused = ros2(environment, "param", "set", "/lab/protocol", "target_force", "99.0", *options)
    assert "0.06 … 50" in refused, refused
    rate = ros2(environment, "topic", "hz", "/lab/wrench", seconds=15.0)
    rates = [float(r) for r in re.findall(r"average rate: ([\d.]+)", rate)]
    assert rates and rates[-1] > 20, rate

    first = running.pids("vision_node")
    os.kill(first[0], signal.SIGKILL)
    running.until(lambda: len(running.pids("vision_node")) == 2)
    assert re.search(r"\[vision_node-\d+\]: process has died", running.text)
    running.logged("all nodes are active", times=2)
    state = ros2(environment, "lifecycle", "get", "/lab/vision", *options)
    assert "active [3]" in state, state

    pids = re.findall(r"process started with pid \[(\d+)\]", running.text)
    assert running.end() == 0
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()], "all processes have ended"
    assert "Traceback" not in running.text


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_grasp_listens_to_another_vendors_wrench(
    launch: Callable[..., Launch], environment: dict[str, str]
) -> None:
    running = launch("grasp.launch.py", "force:=false", "wrench:=/wrist/wrench")
    running.logged("all nodes are active: model")
    info = ros2(environment, "topic", "info", "/wrist/wrench", "--no-daemon", "--spin-time", "8")
    assert "Subscription count: 1" in info, info
    assert running.end() == 0


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_hand_of_named_fingers_comes_up_and_ends_at_an_impatient_ctrl_c(
    launch: Callable[..., Launch], environment: dict[str, str]
) -> None:
    running = launch("hand.launch.py", "fingers:=thumb index", "simulated:=true")
    running.logged("all nodes are active: thumb/force, index/force, thumb/model, index/model")
    options = ("--no-daemon", "--spin-time", "10")
    for finger in ("thumb", "index"):
        state = f"/hand/{finger}/contact_state"
        kind = "finger_msgs/msg/ContactState"
        said = ros2(environment, "topic", "echo", "--once", state, kind, seconds=30.0)
        assert f"frame_id: hand/{finger}/force_sensor" in said, said
    # What somebody takes down stays down, so that a parameter can be changed.
    for step in ("deactivate", "cleanup"):
        said = ros2(environment, "lifecycle", "set", "/hand/thumb/model", step, *options)
        assert "successful" in said, said
    said = ros2(environment, "param", "set", "/hand/thumb/model", "qos_depth", "50", *options)
    assert "successful" in said, said
    for step in ("configure", "activate"):
        said = ros2(environment, "lifecycle", "set", "/hand/thumb/model", step, *options)
        assert "successful" in said, said
    running.child.send_signal(signal.SIGINT)
    time.sleep(0.2)
    assert running.end() == 0
    assert "Traceback" not in running.text


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_replay_of_a_bag_gives_contact_states_and_ends(
    launch: Callable[..., Launch], environment: dict[str, str], project_root: Path, tmp_path: Path
) -> None:
    bags = sorted(p.parent for p in (project_root / "bags").glob("*/metadata.yaml"))
    if not bags:
        pytest.skip("no sample bag in bags/")
    running = launch("replay.launch.py", f"bag:={bags[0]}", "rate:=0.5")
    # The bag holds compressed images, which the vision node does not read: areas are replayed.
    running.logged("all nodes are active: model")
    running.logged("process started with pid", times=3)
    rate = ros2(environment, "topic", "hz", "/finger/contact_state", seconds=20.0)
    assert "average rate" in rate, rate + running.text[-2000:]
    assert running.child.wait(240) == 0, running.text[-3000:]
    sent = int(re.search(r"(\d+) messages; late by", running.text)[1])
    assert sent > 1000


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_fit_of_sample_bags_writes_parameters_and_ends(
    launch: Callable[..., Launch], project_root: Path, tmp_path: Path
) -> None:
    if not list((project_root / "bags").glob("*/metadata.yaml")):
        pytest.skip("no sample bag in bags/")
    running = launch(
        "fit.launch.py",
        f"bags:={project_root / 'bags'}",
        f"output:={tmp_path / 'fit'}",
        "conditions:=dry natural",
        'options:={"full_order": false, "profiles": false, "bootstrap": 0}',
    )
    assert running.child.wait(500) == 0, running.text[-3000:]
    fitted = json.loads((tmp_path / "fit" / "fit.json").read_text())["conditions"]
    assert set(fitted) == {"dry", "natural"}
    assert (tmp_path / "fit" / "parameters.yaml").exists()
    assert "Traceback" not in running.text


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_fit_that_fails_is_reported_and_ends_with_an_error(
    launch: Callable[..., Launch], project_root: Path, tmp_path: Path
) -> None:
    running = launch(
        "fit.launch.py",
        f"bags:={project_root / 'bags'}",
        f"output:={tmp_path / 'fit'}",
        "conditions:=oily",
    )
    assert running.child.wait(300) == 1, running.text[-3000:]
    assert "oily" in running.text
    assert not (tmp_path / "fit" / "parameters.yaml").exists()
