"""Two fingers on one machine and one ROS domain: nothing of one reaches the other."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from builtin_interfaces.msg import Time  # noqa: E402
from geometry_msgs.msg import WrenchStamped  # noqa: E402
from rcl_interfaces.srv import GetParameters, SetParameters  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

from finger_bringup import nodes  # noqa: E402
from finger_common.flags import StateFlag  # noqa: E402
from finger_common.namespaces import default_folder  # noqa: E402
from finger_driver.force_node import ForceNode  # noqa: E402
from finger_model.model_node import ModelNode  # noqa: E402
from finger_msgs.action import FitParameters  # noqa: E402
from finger_msgs.msg import ContactArea, ContactState  # noqa: E402

if TYPE_CHECKING:
    from fingers_side_by_side import Hand

FINGERS = ("thumb", "hand/index")
SHARED_TOPICS = {"/diagnostics", "/rosout", "/parameter_events"}


@pytest.mark.timeout(600)
def test_two_fingers_meet_in_no_topic_service_file_port_frame_or_diagnostic(
    hand: Hand, tmp_path: Path
) -> None:
    for finger in FINGERS:
        hand.add_finger(finger)
        for name, node in hand.nodes[finger].items():
            if name != "bring_up":
                assert node.bring_up(), (finger, name)
    thumb, index = (hand.nodes[finger] for finger in FINGERS)

    # Frames: each stream bears its own finger's.
    for finger in FINGERS:
        for kind, topic in ((WrenchStamped, "wrench"), (Image, "image_raw")):
            assert hand.first(kind, f"/{finger}/{topic}").header.frame_id.startswith(f"{finger}/")
        area = hand.first(ContactArea, f"/{finger}/contact_area")
        assert area.header.frame_id == f"{finger}/plate"

    # Topics: whoever publishes or reads one lives in its namespace.
    own = {f"/{finger}" for finger in FINGERS}
    for topic, _ in hand.observer.get_topic_names_and_types():
        if topic in SHARED_TOPICS:
            continue
        home = next((space for space in own if topic.startswith(f"{space}/")), None)
        assert home is not None, topic
        ends = hand.observer.get_publishers_info_by_topic(topic)
        ends += hand.observer.get_subscriptions_info_by_topic(topic)
        assert {end.node_namespace for end in ends} <= {home}, topic

    # Services and actions.
    services = [name for name, _ in hand.observer.get_service_names_and_types()]
    lonely = [s for s in services if not any(s.startswith(f"{space}/") for space in own)]
    assert all(s.startswith("/observer/") for s in lonely), lonely
    for space in own:
        assert f"{space}/force/tare" in services and f"{space}/protocol/start" in services

    # Actions: a goal that one finger's fit refuses is no matter of the other's.
    assert all(f"{space}/fit/fit/_action/send_goal" in services for space in own)
    action = ActionClient(hand.observer, FitParameters, "/thumb/fit/fit")
    hand.until(action.server_is_ready)
    goal = action.send_goal_async(FitParameters.Goal(bags=[], output="x"))
    hand.until(goal.done)
    assert not goal.result().accepted
    action.destroy()
    assert "refused" in thumb["fit"].health.faults and not index["fit"].health.faults

    # Parameters: each node has its own, and a change is one finger's.
    value = Parameter("tare_duration", value=0.7).to_parameter_msg()
    request = SetParameters.Request(parameters=[value])
    answer = hand.call(SetParameters, "/thumb/force/set_parameters", request)
    assert answer.results[0].successful
    wanted = GetParameters.Request(names=["tare_duration", "can_channel", "frame_prefix"])
    got = [
        hand.call(GetParameters, f"{space}/force/get_parameters", wanted).values
        for space in ("/thumb", "/hand/index")
    ]
    assert [values[0].double_value for values in got] == [0.7, 0.5]
    for one, other in zip(*(values[1:] for values in got)):
        assert one.string_value != other.string_value

    # Files: everything written lies in the finger's folder, and both wrote something.
    folders = {default_folder(finger).absolute() for finger in FINGERS}
    written = {path for path in tmp_path.rglob("*") if path.is_file()}
    for folder in folders:
        assert {path for path in written if folder in path.parents}
    assert all(folders & set(path.parents) for path in written), written
    assert not any({*folders} <= set(path.parents) for path in written)

    # Ports.
    buses = {node["simulated_rig"].values["can_port"] for node in (thumb, index)}
    groups = {node["simulated_rig"].values["can_channel"] for node in (thumb, index)}
    assert len(buses) == len(groups) == 2
    pages = {node["page"].values["port"]: node["page"]._server.port for node in (thumb, index)}
    assert set(pages) == {0}
    assert thumb["page"]._server.port != index["page"]._server.port

    # Diagnostics: full names; the broken sensor of one finger is nothing to the other.
    def level(finger: str) -> int | None:
        return hand.levels.get(f"{finger}/force: force")

    hand.until(lambda: level("thumb") == 1 and level("hand/index") == 1)  # both want a tare
    for finger in FINGERS:
        assert {n.split("/force")[0] for n in hand.levels if f"{finger}/force" in n} == {finger}
    hand.nodes["thumb"]["protocol"]._start()
    hand.nodes["hand/index"]["protocol"]._start()
    # What falls silent has come before.
    hand.until(lambda: thumb["protocol"]._protocol._inputs._force is not None)
    faults = Parameter("faults", value=["force silent"])
    assert thumb["simulated_rig"].set_parameters_atomically([faults]).successful
    hand.until(lambda: level("thumb") == 2)

    def noted(node: dict[str, Any]) -> list[str]:
        events = node["protocol"]._protocol.log.events
        return [event.text for event in events if event.kind == "fault"]

    def of_force(node: dict[str, Any]) -> list[str]:
        return [t for t in noted(node) if t.startswith("force") and "Tare needed" not in t]

    hand.until(lambda: of_force(thumb))
    assert level("hand/index") == 1
    assert not of_force(index)
    shown = {item["name"].split(":")[0] for item in index["page"]._board.snapshot(time.monotonic())}
    assert shown and all(name.startswith("hand/index/") for name in shown)


def test_remapped_topics_reach_their_own_finger_only(
    hand: Hand, process: Callable[..., Any]
) -> None:
    """Force and model of both in one process, where samples pass without the middleware."""
    streams = {"thumb": ("/ft/a", "/state/a", 0.6), "index": ("/ft/b", "/state/b", 1.2)}
    _, devices = nodes.simulated_boards(streams)
    for finger, (wrench, state, press) in streams.items():
        options = devices[f"{finger}/force"]
        process(
            *("-m", "finger_driver.simulators.cli", "netcanoem", "--press", str(press)),
            *("--axis=-z", "--channel", options["can_channel"]),
            *("--options", options["can_options"]),
        )
        remaps = ["--ros-args", "-r", f"wrench:={wrench}", "-r", f"contact_state:={state}"]
        settings = {"rate": 50.0, "response_timeout": 0.5, "connect_timeout": 60.0, **options}
        hand.nodes[finger] = {}
        for kind, values in ((ForceNode, settings), (ModelNode, {})):
            overrides = [Parameter(name, value=value) for name, value in values.items()]
            node = kind(
                context=hand.context,
                namespace=finger,
                parameter_overrides=overrides,
                cli_args=remaps,
            )
            hand.nodes[finger][node.get_name()] = node
            hand.executor.add_node(node)
            assert node.bring_up(), finger
    forces: dict[str, list[float]] = {finger: [] for finger in streams}
    for finger, (_, state, _) in streams.items():
        hand.observer.create_subscription(
            ContactState, state, lambda m, of=forces[finger]: of.append(m.normal_force), 50
        )
    # Two presses of each, 1.35 s a press.
    hand.until(lambda: all(len(f) > 200 and max(f) > 0.5 for f in forces.values()))
    for finger, (wrench, _, press) in streams.items():
        assert max(forces[finger]) == pytest.approx(press, abs=0.03), finger
        # From force to model by a call: nobody reads the topic, and it has no second publisher.
        assert hand.observer.count_publishers(wrench) == 1
        assert hand.observer.count_subscribers(wrench) == 0
    names = {name for name, _ in hand.observer.get_topic_names_and_types()}
    assert not names & {f"/{f}/{t}" for f in streams for t in ("wrench", "contact_state")}
    assert {n for n, level in hand.levels.items() if level == 2} == set()
    # Whoever publishes one finger's force as well is a fault of that finger alone.
    hand.observer.create_publisher(WrenchStamped, "/ft/a", 10)
    hand.until(lambda: "second_publisher" in hand.nodes["thumb"]["force"].healths[0].faults)
    assert "second_publisher" not in hand.nodes["index"]["force"].healths[0].faults
    # The model takes the samples of its own process, and none of the topic.
    model = hand.nodes["thumb"]["model"].healths[0]
    hand.until(lambda: "mixed_input" in model.faults)
    assert "readers in other processes mix them" in model.faults["mixed_input"]


def test_simulated_time_that_jumps_back_resets_both_fingers_and_no_other(hand: Hand) -> None:
    """A bag that begins again, or a simulation that is reset, under two fingers."""
    clock = hand.observer.create_publisher(Clock, "/clock", 10)
    start = 1_700_000_000_000_000_000

    def at(seconds: float) -> Time:
        stamp = start + round(seconds * 1e9)
        return Time(sec=stamp // 10**9, nanosec=stamp % 10**9)

    states: dict[str, list[ContactState]] = {}
    wrenches: dict[str, Any] = {}
    for finger in ("thumb", "index", "live"):
        overrides = [Parameter("use_sim_time", value=finger != "live")]
        node = ModelNode(context=hand.context, namespace=finger, parameter_overrides=overrides)
        hand.nodes[finger] = {"model": node}
        hand.executor.add_node(node)
        assert node.bring_up()
        heard = states[finger] = []
        hand.observer.create_subscription(
            ContactState, f"/{finger}/contact_state", heard.append, 200
        )
        wrenches[finger] = hand.observer.create_publisher(WrenchStamped, f"/{finger}/wrench", 200)
    hand.until(lambda: all(w.get_subscription_count() for w in wrenches.values()))
    hand.until(lambda: all(hand.observer.count_publishers(f"/{f}/contact_state") for f in states))

    def press(finger: str, seconds: float) -> ContactState:
        """The answer to a force of 1 N."""
        message = WrenchStamped()
        message.header.stamp, message.wrench.force.z = at(seconds), -1.0
        before = len(states[finger])
        wrenches[finger].publish(message)
        hand.until(lambda: len(states[finger]) > before)
        return states[finger][-1]

    def tick(seconds: float) -> None:
        clock.publish(Clock(clock=at(seconds)))
        simulated = [group["model"] for f, group in hand.nodes.items() if f != "live"]
        now = start + round(seconds * 1e9)
        hand.until(lambda: all(n.get_clock().now().nanoseconds == now for n in simulated))

    tick(0.0)
    for step in range(40):
        tick(0.02 * step)
        for finger in states:
            grown = press(finger, 0.02 * step)
    # By less than time_reset_after: the samples alone would count as disorder.
    tick(0.3)
    for finger in ("thumb", "index"):
        first = press(finger, 0.3)
        assert first.flags & StateFlag.TIME_RESET, finger
        assert first.model_area < grown.model_area
        assert not press(finger, 0.32).flags & StateFlag.TIME_RESET
    # Who does not follow simulated time goes on as if nothing had been.
    assert not press("live", 0.8).flags & StateFlag.TIME_RESET
    # Diagnostics do not stand still while the clock does.
    hand.levels.clear()
    hand.until(lambda: {f"{f}/model: inputs" for f in states} <= hand.levels.keys())
