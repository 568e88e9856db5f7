# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Settings that describe themselves, and plugins."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from finger_common.cli import Parser, add_settings, settings_from
from finger_common.errors import InputError
from finger_common.plugins import PluginKind, Plugins
from finger_common.retry import Pauses
from finger_common.settings import Settings, parameters_of, setting


@dataclass(frozen=True)
class Poll(Settings):
    rate: float = setting(500.0, "Samples per second.", unit="Hz", minimum=1.0, maximum=7000.0)
    axes: list[str] = setting(["x"], "Axes to read.", choices=("x", "y"))
    low: float = setting(0.1, "Low end.", unit="N")
    high: float = setting(0.2, "High end.", unit="N", runtime=True)
    note: str = ""

    def validate(self) -> None:
        if self.low >= self.high:
            raise InputError(f"low is {self.low} N, not below high ({self.high} N); lower it")


@dataclass(frozen=True)
class SharedRate(Poll):
    more: int = setting(1, "One more.")


def test_the_fields_are_the_table() -> None:
    table = Poll.parameters()
    assert [p.name for p in table] == ["rate", "axes", "low", "high"]
    assert table["rate"].unit == "Hz" and table["high"].runtime
    assert "1 … 7000 Hz" in table.markdown()


def test_construction_checks_values_and_contradictions() -> None:
    assert Poll(rate=100).rate == 100.0 and isinstance(Poll(rate=100).rate, float)
    with pytest.raises(InputError, match=r"rate.*7000"):
        Poll(rate=1e9)
    with pytest.raises(InputError, match=r"low is 0\.3"):
        Poll(low=0.3)
    assert Poll().axes is not Poll().axes


def test_mappings_and_json_round_trip_and_name_what_is_wrong() -> None:
    settings = Poll(rate=10.0, axes=["y", "x"])
    assert Poll.from_json(settings.to_json()) == settings
    assert Poll.select({"rate": 10.0, "axes": ["y", "x"], "other": 3}) == settings
    assert Poll.from_json("") == Poll()
    for text, words in (("{", "goal: not valid JSON"), ("[1]", "goal: a JSON object")):
        with pytest.raises(InputError, match=words):
            Poll.from_json(text, "goal")
    with pytest.raises(InputError, match=r"rig.yaml: 'rat' does not exist; did you mean 'rate'\?"):
        Poll.from_mapping({"rat": 1.0}, "rig.yaml")
    with pytest.raises(InputError, match=r"^rig.yaml: parameter 'rate' is '5 Hz'"):
        Poll.from_mapping({"rate": "5 Hz"}, "rig.yaml")


def test_classes_share_a_field_but_not_a_name() -> None:
    assert [p.name for p in parameters_of(Poll, SharedRate)][-1] == "more"

    @dataclass(frozen=True)
    class Other(Settings):
        rate: float = setting(10.0, "Another rate.")

    with pytest.raises(ValueError, match="'rate' is declared twice"):
        parameters_of(Poll, Other)


def test_options_of_a_command_are_the_fields(capsys: pytest.CaptureFixture[str]) -> None:
    parser = Parser(prog="poll")
    add_settings(parser, Poll)
    found = settings_from(parser.parse_args(["--rate", "20", "--axes", "y"]), Poll)
    assert found == Poll(rate=20.0, axes=["y"])
    with pytest.raises(SystemExit):
        parser.parse_args(["--help"])
    assert "1 … 7000 Hz" in capsys.readouterr().out


@dataclass(frozen=True)
class Shown(Settings):
    loop: bool = setting(True, "Loop.")
    mirror: bool = setting(False, "Mirror.")
    searches: list[str] = setting(["pso", "de"], "Searches.")
    bounds: list[str] = setting([], "Bounds.")
    unit: str = setting("", "Unit.", choices=("", "N", "mN"))
    share: float = setting(0.5, "Share in %.", maximum=1.0)
    folder: str = setting("", "Folder.")


def test_help_tells_every_default_that_is_not_empty(capsys: pytest.CaptureFixture[str]) -> None:
    parser = Parser(prog="tool")
    add_settings(parser, Shown)
    with pytest.raises(SystemExit):
        parser.parse_args(["--help"])
    shown = " ".join(capsys.readouterr().out.split())
    for words in (
        "Loop. (default: yes) ",
        "Mirror. (default: no) ",
        "Searches. (default: pso de) ",
        "Bounds. --unit {N,mN} Unit. --share",
        "Share in %. [≤ 1] (default: 0.5) ",
    ):
        assert words in shown
    assert shown.endswith("Folder.")


def test_a_choice_may_be_empty_where_that_is_the_default(
    capsys: pytest.CaptureFixture[str],
) -> None:
    parser = Parser(prog="tool")
    add_settings(parser.add_argument_group("units"), Shown)
    for given in ([], ["--unit", ""], ["--unit="]):
        assert settings_from(parser.parse_args(given), Shown).unit == ""
    assert settings_from(parser.parse_args(["--unit", "mN"]), Shown).unit == "mN"
    with pytest.raises(SystemExit):
        parser.parse_args(["--unit", "n"])
    # Versions of Python differ in the quotes.
    assert "(choose from N, mN)" in capsys.readouterr().err.replace("'", "")


def test_an_unknown_plugin_is_named_with_those_installed() -> None:
    with pytest.raises(
        InputError, match=r"console script 'x' is not installed; known are .*pytest"
    ):
        Plugins("console_scripts", "console script").load("x")


def test_a_name_of_two_packages_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which one was meant, the order of the path cannot know."""
    for package, name in (("first", "json"), ("second", "json"), ("second", "csv")):
        metadata = tmp_path / f"{package}-1.0.dist-info"
        metadata.mkdir(exist_ok=True)
        (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1\n")
        with (metadata / "entry_points.txt").open("a") as file:
            file.write(f"[readers]\n{name} = {name}:{'load' if package == 'first' else 'reader'}\n")
    monkeypatch.syspath_prepend(tmp_path)
    readers = Plugins("readers", "reader")
    assert readers.names() == ("csv", "json")
    assert readers.load("csv") is csv.reader
    sentence = r"'json' is in several packages: first \(json:load\), second \(json:reader\); keep"
    with pytest.raises(InputError, match=sentence):
        readers.load("json")


class Gauge:
    """A gauge. Further sentences."""

    SETTINGS: type[Settings] = Settings

    def __init__(self, settings: Settings, place: str) -> None:
        self.settings, self.place = settings, place


class PollGauge(Gauge):
    """Polled gauge."""

    SETTINGS = Poll


def gauges(monkeypatch: pytest.MonkeyPatch, **members: object) -> PluginKind[Gauge]:
    """A kind whose installed members are these; the default is "poll"."""
    entries = {}
    for name, member in members.items():
        entries[name] = EntryPoint(name, f"{__name__}:{name}", "gauges")
        monkeypatch.setitem(globals(), name, member)
    kind = PluginKind("gauges", "gauge", Gauge, choice="gauge", default="poll")
    monkeypatch.setattr(kind, "_found", lambda: entries)
    return kind


def test_a_kind_has_the_settings_of_all_installed_and_opens_the_chosen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kind = gauges(monkeypatch, poll=PollGauge, plain=Gauge)
    table = parameters_of(*kind.settings())
    assert table["gauge"].choices == ("plain", "poll") and table["gauge"].default == "poll"
    assert table["gauge"].meaning == "Kind of gauge: plain (A gauge), poll (Polled gauge)."
    assert [p.name for p in table] == ["gauge", *(p.name for p in Poll.parameters())]
    opened = kind.open({"rate": 20.0, "other": 1}, "bench")
    assert opened.settings == Poll(rate=20.0) and opened.place == "bench"
    assert type(kind.open({"gauge": "plain"}, "")) is Gauge
    with pytest.raises(InputError, match="7000"):
        kind.open({"rate": 1e9}, "")


def test_a_member_that_cannot_be_made_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    class Licensed(Gauge):
        def __init__(self, settings: Settings, place: str) -> None:
            raise OSError("no licence file")

    kind = gauges(monkeypatch, poll=PollGauge, licensed=Licensed)
    sentence = r"gauge 'licensed' cannot be made \(OSError: no licence file\); correct it"
    with pytest.raises(InputError, match=sentence):
        kind.open({"gauge": "licensed"}, "bench")


def test_a_member_that_contradicts_is_left_out_and_never_displaces_the_default(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    @dataclass(frozen=True)
    class Other(Settings):
        rate: float = setting(10.0, "Another rate.")

    @dataclass(frozen=True)
    class NodesOwn(Settings):
        station: str = setting("", "Where the node is.")

    @dataclass(frozen=True)
    class Station(Settings):
        station: int = setting(1, "Number of the radio station.")

    kind = gauges(
        monkeypatch,
        a_contradiction=type("Contradiction", (Gauge,), {"SETTINGS": Other}),
        b_the_nodes=type("TheNodes", (Gauge,), {"SETTINGS": Station}),
        c_no_class=print,
        d_no_settings=type("NoSettings", (Gauge,), {"SETTINGS": None}),
        poll=PollGauge,
    )
    table = parameters_of(NodesOwn, *kind.settings(NodesOwn))
    assert table["rate"].default == 500.0 and table["station"].default == ""
    expected = {
        "a_contradiction": "'rate' is declared twice",
        "b_the_nodes": "'station' is declared twice",
        "c_no_class": "is not a subclass of Gauge",
        "d_no_settings": "SETTINGS is not a subclass of Settings",
    }
    assert set(kind.problems) == set(expected)
    for name, words in expected.items():
        with pytest.raises(InputError, match=rf"gauge '{name}'.*{words}"):
            kind.open({"gauge": name}, "")


def test_a_whole_number_may_be_hexadecimal_and_a_field_may_have_no_option() -> None:
    @dataclass(frozen=True)
    class Bus(Settings):
        base: int = setting(1, "Base identifier.")
        folder: str = setting("", "Where.")

    parser = Parser()
    parser.add_argument("folder")
    add_settings(parser, Bus, without="folder")
    arguments = parser.parse_args(["here", "--base", "0x21"])
    assert settings_from(arguments, Bus) == Bus(base=33, folder="here")


def test_pauses_double_up_to_the_longest_and_begin_again() -> None:
    pauses = Pauses(0.1, 0.35)
    assert [pauses.next() for _ in range(4)] == [0.1, 0.2, 0.35, 0.35]
    pauses.reset()
    assert pauses.next() == 0.1
