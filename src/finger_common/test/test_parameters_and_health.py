# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Described parameters and the health of a source."""

from __future__ import annotations

import pytest

from finger_common.diagnostics import (
    ERROR,
    OK,
    WARN,
    Health,
    full_node_name,
    node_within,
    status_node,
)
from finger_common.errors import InputError
from finger_common.parameters import Parameter, ParameterTable

TABLE = ParameterTable(
    Parameter("rate", 500.0, "Poll rate.", unit="Hz", minimum=1, maximum=2000, runtime=True),
    Parameter("axis", "+z", "Normal axis.", choices=("+z", "-z")),
    Parameter("names", ["a"], "Names."),
    Parameter("on", True, "Switch."),
)


def test_defaults_are_filled_in_and_integers_count_as_numbers() -> None:
    values = TABLE.check({"rate": 100})
    assert values == {"rate": 100.0, "axis": "+z", "names": ["a"], "on": True}
    assert isinstance(values["rate"], float)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"rate": 0.5}, ["'rate'", "0.5", "1 … 2000 Hz"]),
        ({"rate": "fast"}, ["'rate'", "number"]),
        ({"rate": float("nan")}, ["'rate'", "finite"]),
        ({"rate": True}, ["'rate'", "number"]),
        ({"axis": "up"}, ["'axis'", "+z, -z"]),
        ({"names": "a"}, ["'names'", "list"]),
        ({"rat": 1.0}, ["'rat'", "rate"]),
    ],
)
def test_bad_values_are_refused_with_key_and_remedy(
    values: dict[str, object], words: list[str]
) -> None:
    with pytest.raises(InputError) as error:
        TABLE.check(values)
    for word in words:
        assert word in str(error.value)


def test_reference_lists_every_parameter_with_its_range() -> None:
    text = TABLE.markdown()
    for parameter in TABLE:
        assert f"`{parameter.name}`" in text
    assert "1 … 2000 Hz" in text


def test_a_parameter_cannot_be_described_twice_or_with_a_bad_default() -> None:
    with pytest.raises(ValueError, match="twice"):
        ParameterTable(Parameter("a", 1, "x"), Parameter("a", 2, "y"))
    with pytest.raises(InputError):
        ParameterTable(Parameter("a", 1, "x", minimum=2))


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def source(clock: Clock, **options: float) -> Health:
    health = Health("force", "bus 0", clock=clock, **options)
    health.state = "active"
    return health


def test_rate_is_measured_between_reports_and_judged() -> None:
    clock = Clock()
    health = source(clock, expected_rate=100.0)
    for i in range(101):
        clock.now = i / 100
        health.sample()
    report = health.report()
    assert float(report.values["measured_rate_hz"]) == pytest.approx(100, rel=1e-6)
    assert report.level == OK
    for i in range(50):
        clock.now = 1 + (i + 1) / 50
        health.sample()
    report = health.report()
    assert report.level == WARN and "50.0 Hz" in report.message


def test_silence_is_an_error_with_its_age() -> None:
    clock = Clock()
    health = source(clock, stale_after=0.5)
    assert health.report().level == ERROR
    health.sample()
    assert health.report().level == OK
    clock.now = 2.0
    report = health.report()
    assert report.level == ERROR and "2.0 s" in report.message


def test_a_fault_is_new_once_then_counted_until_it_ends() -> None:
    health = source(Clock())
    assert health.fault("saturated", "gauge 3 saturated")
    assert not health.fault("saturated", "gauge 3 saturated")
    report = health.report()
    assert report.level == ERROR and report.message == "gauge 3 saturated"
    assert report.values["saturated"] == "2"
    assert health.recovered("saturated") and not health.recovered("saturated")
    report = health.report()
    assert report.level == OK and report.values["last_error"] == "gauge 3 saturated"
    assert health.fault("saturated", "again"), "after recovery the fault is new again"


def test_all_faults_are_shown_the_worst_first() -> None:
    health = source(Clock())
    health.fault("a", "a warning", WARN)
    health.fault("b", "an error", ERROR)
    assert health.report().message == "an error; a warning"


def test_a_warning_does_not_hide_that_nothing_comes() -> None:
    health = source(Clock(), stale_after=0.5)
    health.fault("malformed", "frames of a wrong length", WARN)
    report = health.report()
    assert report.level == ERROR
    assert report.message == "no sample yet: frames of a wrong length"


def test_an_active_source_without_fault_says_what_it_does() -> None:
    health = source(Clock())
    assert health.report().message == "active"
    health.activity = "idle"
    assert health.report().message == "idle"
    health.fault("disk", "disk is full")
    assert health.report().message == "disk is full"
    health.recovered()
    health.state = "inactive"
    assert health.report().message == "inactive"


def test_a_status_belongs_to_the_namespace_of_its_node() -> None:
    assert full_node_name("force", "/hand/left") == "hand/left/force"
    assert full_node_name("force", "/") == "force"
    assert full_node_name("/wrist/force", "/left") == "wrist/force"
    assert status_node("hand/left/force: ATI: FT1") == "hand/left/force"
    assert node_within("left/force: sensor", "/left") == "force"
    assert node_within("force: sensor", "/") == "force"
    for other in ("left_thumb/force: sensor", "right/force: sensor", "force: sensor"):
        assert node_within(other, "/left") is None
