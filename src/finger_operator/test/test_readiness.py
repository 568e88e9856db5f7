# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the page says is wrong: within a second, with the remedy, and only what a trial needs."""

from __future__ import annotations

import pytest

from finger_common.diagnostics import ERROR, OK, STARTING, WARN, Health
from finger_operator.readiness import Readiness, refusal

NODES = ("force", "camera", "vision", "moisture", "model", "recorder", "protocol")


class Rig:
    """A rig on a clock that the test moves."""

    def __init__(self) -> None:
        self.board = Readiness()
        self.now = 0.0
        self.silent: set[str] = set()

    def run(self, seconds: float) -> None:
        """Let everything that is not silent send."""
        for _ in range(round(seconds / 0.05)):
            self.now += 0.05
            for stream in {"force", "area", "model"} - self.silent:
                self.board.sample(stream, self.now)
            for node in NODES:
                if node not in self.silent:
                    self.board.beat(node, self.now)

    def tare(self, tared: str = "yes") -> None:
        values = {"tared": tared}
        self.board.report("force", "finger/force: sensor", OK, "active", values, self.now)

    @property
    def texts(self) -> list[str]:
        return [problem.text for problem in self.board.problems(self.now)]


def ready() -> Rig:
    rig = Rig()
    rig.run(1.0)
    rig.tare()
    rig.run(0.1)
    assert rig.texts == []
    return rig


def test_nothing_is_ready_before_it_was_seen() -> None:
    assert Rig().texts == ["The protocol is not running.", "The force driver is not running."]


def test_a_node_that_comes_up_for_the_first_time_is_starting_and_not_dead() -> None:
    rig = Rig()
    rig.silent = {"model", "protocol"}
    rig.run(1.0)
    rig.tare()

    def bring_up(*starting: str) -> None:
        values = {STARTING: " ".join(starting)} if starting else {}
        rig.board.report("bring_up", "finger/bring_up", OK, "active", values, rig.now)

    bring_up("model", "protocol")
    rig.board.beat("model", rig.now - 2.0)
    assert rig.texts == ["The protocol is starting.", "The model is starting."]
    # Its heart beats, but no estimate comes before it is active; a fault is never hidden.
    rig.board.beat("model", rig.now)
    assert rig.texts == ["The protocol is starting.", "The model is starting."]
    rig.board.report("model", "finger/model", ERROR, "no such parameter file", {}, rig.now)
    assert rig.texts[1] == "No estimate: no such parameter file."
    rig.silent = set()
    rig.board.report("model", "finger/model", OK, "active", {}, rig.now)
    rig.run(0.2)
    assert rig.texts == []
    bring_up()
    rig.silent = {"model"}
    rig.run(1.0)
    assert rig.texts == ["The model is not running."]


def test_a_probe_that_the_session_needs_and_that_was_never_there_is_missed() -> None:
    rig = Rig()
    rig.silent = {"moisture"}
    rig.run(1.0)
    rig.tare()
    assert rig.texts == [], "without readings nothing is missing"

    def told() -> list[str]:
        return [problem.text for problem in rig.board.problems(rig.now, ["moisture"])]

    assert told() == ["No moisture probe runs."]
    assert refusal(rig.board.problems(rig.now, ["moisture"])) == (
        "Not ready: No moisture probe runs. Start the node moisture, or begin a session with "
        "Readings 0."
    )
    starts = {STARTING: "moisture"}
    rig.board.report("bring_up", "finger/bring_up", OK, "active", starts, rig.now)
    assert told() == ["The moisture driver is starting."]
    rig.board.report("bring_up", "finger/bring_up", OK, "active", {}, rig.now)
    rig.silent = set()
    rig.run(0.2)
    assert told() == []
    rig.silent = {"moisture"}
    rig.run(1.0)
    assert told() == rig.texts == ["The moisture driver is not running."]


def test_silent_streams_and_dead_nodes_show_within_a_second() -> None:
    for silent, text in (
        ({"force"}, "The force driver is not running."),
        ({"camera", "area"}, "The camera driver is not running."),
        ({"vision", "area"}, "The measurement of the area is not running."),
        ({"moisture"}, "The moisture driver is not running."),
        ({"recorder"}, "The recorder is not running."),
        ({"model"}, "The model is not running."),
        ({"protocol"}, "The protocol is not running."),
    ):
        rig = ready()
        rig.silent = silent
        rig.run(1.0)
        assert rig.texts == [text], silent
        assert text in refusal(rig.board.problems(rig.now))
        rig.silent = set()
        rig.run(0.2)
        if silent == {"force"}:
            rig.tare()
        assert rig.texts == [], silent


def test_an_unplugged_sensor_is_named_with_what_its_driver_says() -> None:
    rig = ready()
    rig.board.sample("force", rig.now)
    for _ in range(20):
        rig.now += 0.05
        for node in NODES:
            rig.board.beat(node, rig.now)
        rig.board.sample("area", rig.now)
    assert rig.texts[0] == "No force."
    rig.board.report("force", "force: sensor", ERROR, "no reply from the board", {}, rig.now)
    problem = rig.board.problems(rig.now)[0]
    assert problem.text == "No force: no reply from the board."
    assert problem.age is not None and 0.9 < problem.age < 1.2
    long = "NETCANOEM at base 0x20 on can0: no answer; check power, bit rate and termination"
    rig.board.report("force", "force: sensor", ERROR, long, {}, rig.now)
    problem = rig.board.problems(rig.now)[0]
    assert (problem.text, problem.detail) == ("No force.", long), "read from afar, and beside it"
    assert "cable" in problem.remedy
    assert len(rig.texts) == 1, "the model's silence follows from it"


@pytest.mark.parametrize(
    ("came", "warning"), [(False, ""), (True, ""), (True, "frame 0x200 with 7 bytes")]
)
def test_a_silent_source_is_named_once_with_the_cause_that_it_reports(
    came: bool, warning: str
) -> None:
    rig, now = ready(), 0.0
    health = Health("sensor", stale_after=0.5, clock=lambda: now)
    health.state = "active"
    if came:
        health.sample()
    now = 1.0
    if warning:
        health.fault("frame", warning, WARN)
    rig.silent = {"force"}
    rig.run(0.7)
    rig.board.beat("force", rig.now)
    report = health.report()
    assert report.level == ERROR and "no sample" in report.message
    rig.board.report("force", "force: sensor", report.level, report.message, {}, rig.now)
    assert rig.texts[0] == (f"No force: {warning}." if warning else "No force.")


def test_a_driver_that_started_again_has_no_zero() -> None:
    rig = ready()
    rig.tare("no")
    assert rig.texts == ["Tare needed."]
    rig.tare()
    rig.silent = {"force"}
    rig.run(2.0)
    rig.silent = set()
    rig.run(0.1)
    assert rig.texts == ["Looking for the force sensor's zero."], "it may have started again"
    rig.tare("no")
    assert rig.texts == ["Tare needed."]
    assert "press Tare" in refusal(rig.board.problems(rig.now))


def test_a_fault_of_the_force_sensor_stands_there_while_samples_come() -> None:
    rig = ready()
    rig.board.report("force", "force: sensor", ERROR, "overload", {}, rig.now)
    assert rig.texts == ["Force sensor: overload."]
    rig.tare("no")
    assert rig.texts == ["Tare needed."]


def test_warnings_do_not_stop_a_trial_and_devices_that_were_never_there_are_not_missed() -> None:
    rig = ready()
    rig.board.report("model", "model: inputs", WARN, "moisture outside", {}, rig.now)
    assert rig.texts == []
    rig.board.report("recorder", "recorder: recording", ERROR, "disk full", {}, rig.now)
    assert rig.texts == ["Recorder: disk full."]
    small = Rig()
    for _ in range(3):
        small.now += 0.1
        small.board.beat("protocol", small.now)
        small.board.sample("force", small.now)
    assert small.texts == [], "a driver of another make has no heartbeat and no tare"


def test_the_advice_is_that_of_the_device() -> None:
    rig = ready()
    for node, words in (
        ("recorder", "Make room on the disk"),
        ("protocol", "Read the rig's terminal"),
        ("model", "Read the rig's terminal"),
        ("camera", "Check power and cable of the camera"),
    ):
        rig.board.report(node, f"finger/{node}: part", ERROR, "has a fault", {}, rig.now)
        (problem,) = rig.board.problems(rig.now)
        assert problem.remedy.startswith(words), node
        rig.board.report(node, f"finger/{node}: part", OK, "active", {}, rig.now)


def test_a_part_that_its_node_no_longer_has_keeps_no_trial_from_beginning() -> None:
    rig = ready()
    rig.board.report("camera", "camera: A", ERROR, "unplugged", {}, rig.now)
    for _ in range(4):
        rig.run(1.0)
        assert rig.texts == ["Camera: unplugged."], "a node that is silent takes nothing back"
    rig.board.report("camera", "camera: B", OK, "active", {}, rig.now)
    assert rig.texts == []
    rig.board.report("camera", "camera: A", ERROR, "unplugged", {}, rig.now)
    rig.run(1.0)
    rig.board.report("camera", "camera: B", OK, "active", {}, rig.now)
    assert rig.texts == ["Camera: unplugged."]
