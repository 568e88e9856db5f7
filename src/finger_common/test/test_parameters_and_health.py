# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Described parameters and the health of a source."""

from __future__ import annotations

from typing import Any

import pytest

from finger_common.diagnostics import (
    ERROR,
    HOLD,
    MIXED_INPUT,
    OK,
    WARN,
    Health,
    cause_of,
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
    Parameter("factors", [0.5], "Factors."),
    Parameter("topic", "wrench", "Topic.", ros_name=True),
    Parameter("on", True, "Switch."),
)


def test_defaults_are_filled_in_and_integers_count_as_numbers() -> None:
    values = TABLE.check({"rate": 100, "factors": [1, 0.2], "topic": "/a/b_2"})
    usual = {"axis": "+z", "names": ["a"], "on": True}
    assert values == {**usual, "rate": 100.0, "factors": [1.0, 0.2], "topic": "/a/b_2"}
    assert isinstance(values["rate"], float)
    assert [type(factor) for factor in values["factors"]] == [float, float]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"rate": 0.5}, ["'rate'", "0.5", "1 … 2000 Hz"]),
        ({"rate": "1,35"}, ["'rate'", "number", "decimal point"]),
        ({"axis": 0}, ["'axis'", "put it in quotes"]),
        ({"rate": float("nan")}, ["'rate'", "finite"]),
        ({"rate": True}, ["'rate'", "number"]),
        ({"axis": "up"}, ["'axis'", "+z, -z"]),
        ({"names": "a"}, ["'names'", "list"]),
        ({"names": ["a", 2]}, ["'names'", "2", "put it in quotes"]),
        ({"names": [True]}, ["'names'", "True", "put it in quotes"]),
        ({"factors": [0.1, "x"]}, ["'factors'", "'x'", "number"]),
        *(
            ({"topic": name}, ["'topic'", repr(name), "as in wrench"])
            for name in ("my wrench", "größe", "", "wrench/", "/finger//wrench", "1w", "a-b")
        ),
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


def run(health: Health, clock: Clock, rate: float, seconds: int, step: int = 1) -> list[Any]:
    """Reports of each second of samples; step: between the numbers of those that come."""
    reports = []
    number = int(clock.now * rate * step) + 1
    for _ in range(seconds):
        begin = clock.now
        for i in range(int(rate)):
            clock.now = begin + (i + 1) / rate
            number += step
            health.numbered(number)
            health.sample()
        reports.append(health.report())
    return reports


def test_a_low_rate_is_told_beside_other_warnings_and_logged_once_while_it_lasts() -> None:
    clock = Clock()
    health = source(clock, expected_rate=500.0, stale_after=0.5)
    health.fault("tare_needed", "tare needed", WARN)
    told = []
    for report in run(health, clock, 136.0, 40):
        assert report.level == WARN
        assert report.message.startswith("tare needed; rate 136.0 Hz, expected 500.0 Hz: ")
        told += [report.news] if report.news[1] else []
    assert [level for level, _ in told] == [WARN] and "force: rate 136" in told[0][1]
    good = run(health, clock, 500.0, 12)
    assert {report.message for report in good} == {"tare needed"}
    assert [r.news for r in good if r.news[1]] == [(OK, "force: rate 500.0 Hz, as expected again")]


def test_a_slow_moment_at_the_start_or_between_is_not_logged() -> None:
    clock = Clock()
    health = source(clock, expected_rate=500.0)
    reports = run(health, clock, 200.0, 20)
    for _ in range(5):
        reports += run(health, clock, 500.0, 3) + run(health, clock, 300.0, 2)
    assert {report.news[1] for report in reports} == {""}


def test_a_silence_is_no_low_rate_and_short_looks_judge_none() -> None:
    clock = Clock()
    health = source(clock, expected_rate=100.0, stale_after=0.5)
    assert run(health, clock, 100.0, 2)[-1].level == OK
    clock.now += 3.6
    assert health.report().message == "no sample for 3.6 s"
    clock.now += 0.3
    assert run(health, clock, 100.0, 1)[-1].message == "active"
    health.sample()
    clock.now += 0.015
    assert health.report().message == "active"
    # An error says why nothing comes.
    health.fault("saturated", "gauge 3 is saturated")
    assert run(health, clock, 20.0, 1)[-1].message == "gauge 3 is saturated"


def test_samples_that_are_lost_on_their_way_are_told_at_any_rate() -> None:
    clock = Clock()
    health = source(clock, rate_tolerance=0.1)
    for rate in (250.0, 500.0, 1000.0):  # also that of a bag that is played
        assert run(health, clock, rate, 2)[-1].level == OK
        health.numbered(None)
    reports = run(health, clock, 63.0, 25, step=2)
    assert {report.level for report in reports} == {WARN}
    assert reports[-1].message.startswith("63.0 of 126.0 samples per second come through")
    (told,) = [report.news for report in reports if report.news[1]]
    assert told[0] == WARN
    report = reports[-1]
    assert int(report.values["lost"]) == 63 * 25 - 1
    # It does not outlast the samples.
    health.stale_after = 0.1
    clock.now += 1.0
    assert health.report().message == "no sample for 1.0 s"
    # Two publishers that count apart are another fault.
    health.fault(MIXED_INPUT, "several publish it", WARN)
    for number in range(100):
        health.numbered(number + 1000 * (number % 2))
    assert health.report().values["lost"] == report.values["lost"]


@pytest.mark.parametrize("other", [400, -400], ids=["ahead", "behind"])
def test_a_second_publisher_makes_no_sample_count_as_lost(other: int) -> None:
    """It gives numbers of its own, and may be there before it is known to be."""
    clock = Clock()
    health = source(clock, rate_tolerance=0.1)
    number = 70_000
    for second in range(6):
        for _ in range(100):
            clock.now += 0.01
            number += 1
            for n in (number, number + 100 * other) if second in (2, 3) else (number,):
                health.numbered(n)
                health.sample()
        report = health.report()
        assert "lost" not in report.values and report.level == OK
    health.numbered(number + 51)
    assert health.report().values["lost"] == "50"


def test_the_end_of_a_slow_second_publisher_makes_no_sample_count_as_lost() -> None:
    """Between its last number and the next one of the first are reports without a number."""
    clock = Clock()
    health = source(clock, rate_tolerance=0.1)
    lost = set()
    for second in range(60):
        clock.now = float(second)
        if second % 2:
            number = 70_000 + second // 2
            for n in (number, number - 40_000) if 20 < second < 40 else (number,):
                health.numbered(n)
                health.sample()
        clock.now += 0.5
        report = health.report()
        assert report.level == OK
        lost.add(report.values.get("lost"))
    assert lost == {None}


def test_a_silent_source_says_what_to_check_which_is_no_cause() -> None:
    clock = Clock()
    health = source(clock, stale_after=0.5)
    health.advice = "nothing comes on /finger/wrench, 0 publishers: check wrench_topic"
    assert health.report().message == f"no sample yet ({health.advice})"
    health.sample()
    assert health.report().message == "active"
    clock.now = 0.7
    message = health.report().message
    assert message == f"no sample for 0.7 s ({health.advice})"
    assert cause_of(message) == ""
    health.fault("frames", "the wrench changes its frame", WARN)
    message = health.report().message
    assert message == f"no sample for 0.7 s ({health.advice}): the wrench changes its frame"
    assert cause_of(message) == "the wrench changes its frame"


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


def test_a_fault_that_comes_and_goes_is_new_once_and_stays_until_it_has_not_come_for_a_while() -> (
    None
):
    clock = Clock()
    health = source(clock)
    news = []
    for second in range(20):
        clock.now = 0.5 * second
        if second % 2:
            health.cleared("frame")
        else:
            news.append(health.fault("frame", "another size", WARN))
        assert health.report().level == WARN
    assert news == [True] + [False] * 9
    clock.now = 9.0 + HOLD
    assert health.report().level == WARN
    clock.now += 0.1
    assert health.report().level == OK and not health.faults
    assert health.fault("frame", "another size", WARN), "new again"
    # Not looked for since: it lasts.
    clock.now += 10 * HOLD
    assert not health.fault("frame", "another size", WARN) and health.report().level == WARN


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
