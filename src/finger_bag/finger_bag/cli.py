# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The command `finger-bag`."""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from finger_common.cli import (
    EXIT_LOST,
    Parser,
    add_settings,
    one_line,
    plain,
    run,
    settings_from,
)
from finger_common.console import Console
from finger_common.errors import InputError, listed
from finger_common.files import exists
from finger_common.namespaces import check_namespace
from finger_common.plugins import Plugins

from .bag_files import find_bags, storage_of
from .read_settings import ReadSettings, add_read_options, read_settings_from
from .recorder import RecorderSettings
from .replay import PlaySettings, lateness_text
from .schema import full_name

EXIT_CHECK_FAILS = 1

BAGS = "bags (MCAP, rosbag2 folders), or folders of bags"
"""Help of arguments that name several bags."""

COMMANDS = Plugins("finger_bag.commands", "subcommand")
"""Further subcommands of installed packages: functions that add theirs with an `AddCommand`."""

AddCommand = Callable[[str, Callable[[argparse.Namespace], int], str, str], argparse.ArgumentParser]
"""Adds a subcommand: name, what runs it, one sentence about it, example; gives its parser."""


# info ----------------------------------------------------------------------------------------


def _info(args: argparse.Namespace) -> int:
    from .reader import open_bag

    found = []
    lost = False
    for bag in find_bags(args.bags):
        with open_bag(bag) as reader:
            info = reader.info
            if not info.topics and not info.complete:
                raise InputError(f"{bag}: nothing of it can be read ({info.problems[0]})")
            if info.message_count is None or args.count:
                counts: dict[str, int] = dict.fromkeys(info.topics, 0)
                for item in reader.messages():
                    counts[item.topic] = counts.get(item.topic, 0) + 1
                for name, topic in info.topics.items():
                    topic.count = counts[name]
                info.message_count = sum(counts.values())
            data = {
                "bag": str(bag),
                "storage": info.storage,
                "files": [f.name for f in info.files],
                "size": info.size,
                "complete": info.complete,
                "start_ns": info.start_ns,
                "duration": info.duration,
                "messages": info.message_count,
                "metadata": info.metadata.to_mapping(),
                "attachments": info.attachments,
                "topics": {
                    t.name: {"type": t.type, "count": t.count} for t in info.topics.values()
                },
                "problems": reader.all_problems(),
            }
            lost = lost or reader.lost
        found.append(data)
    if args.json:
        print(json.dumps(found, indent=1))
    else:
        for data in found:
            _print_info(data)
    return EXIT_LOST if lost else 0


def _print_info(data: dict[str, Any]) -> None:
    console = Console()
    size = f"  ({data['storage']}, {data['size'] / 1e6:.1f} MB)"
    console.print(Text.assemble((plain(data["bag"]), "bold"), size))
    if data["start_ns"] is not None:
        began = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(data["start_ns"] * 1e-9))
        console.print(f"  from {began} UTC, {data['duration']:.2f} s, {data['messages']} messages")
    for key, value in data["metadata"].items():
        console.print(Text(f"  {plain(key)}: {plain(value)}"))
    if data["attachments"]:
        console.print(Text(f"  attached: {', '.join(map(plain, data['attachments']))}"))
    table = Table("topic", "type", "messages", "Hz", box=None, pad_edge=False)
    for name, topic in sorted(data["topics"].items()):
        rate = topic["count"] / data["duration"] if data["duration"] else 0.0
        type_name, count = Text(plain(topic["type"])), str(topic["count"])
        table.add_row(Text(plain(name)), type_name, count, f"{rate:.1f}")
    console.print(table)
    for problem in data["problems"]:
        console.print(Text.assemble(("  problem: ", "yellow"), plain(problem)))


# validate ------------------------------------------------------------------------------------


def _validate(args: argparse.Namespace) -> int:
    from .validate import fingers, validate

    settings = read_settings_from(args, ReadSettings)
    results = []
    unreadable = 0
    paths = list(map(Path, args.bags))
    # As SESSION/* names them: the tables of a session beside its bags.
    others = [p for p in paths if exists(p) and p.is_file() and not storage_of(p)]
    bags = [p for p in paths if p not in others] or paths
    if len(bags) < len(paths):
        names = listed(plain(p.name) for p in others)
        print(f"finger-bag: left out, as they are no bags: {names}", file=sys.stderr)
    for bag in find_bags(bags):
        try:
            for namespace in fingers(bag, settings):
                results.append(validate(bag, replace(settings, namespace=namespace)))
        except InputError as error:
            # One unreadable bag does not hide what is known of the others.
            if len(bags) == 1 and not results:
                raise
            unreadable += 1
            print(f"finger-bag: {one_line(error)}", file=sys.stderr)
    if args.json:
        print(json.dumps([r.to_data() for r in results], indent=1))
    else:
        console = Console()
        colours = {"ok": "green", "note": "yellow", "fail": "red"}
        for result in results:
            title = Text(plain(" ".join(filter(None, (result.bag, result.namespace)))))
            table = Table("check", "", "found", title=title, box=None, pad_edge=False)
            for check in result.checks:
                colour = colours[check.status]
                status = Text(check.status, colour)
                table.add_row(Text(plain(check.name)), status, Text(plain(check.detail)))
            console.print(table)
            console.print(Text(result.verdict, "" if result.fit else "red"))
    if unreadable:
        return 2
    return 0 if all(r.fit for r in results) else EXIT_CHECK_FAILS


# play ----------------------------------------------------------------------------------------


def _play(args: argparse.Namespace) -> int:
    from .reader import open_bag

    try:
        from .play_node import play
    except ImportError as error:
        raise InputError(
            f"playing needs ROS 2 ({error}); source it, or use finger_bag.replay without ROS"
        ) from None
    with open_bag(args.bag) as reader:
        topics = None
        if args.topics or args.exclude:
            named = [_topic(reader, t) for t in args.topics or reader.info.topics]
            without = {_topic(reader, t) for t in args.exclude or ()}
            topics = [t for t in named if t not in without]
        for topic in reader.info.topics if topics is None else topics:
            full_name(topic)
        awaited = [_topic(reader, t) for t in args.awaited or ()]
        lateness = play(reader, settings_from(args, PlaySettings), topics, awaited)
        problems, lost = reader.all_problems(), reader.lost
    print(lateness_text(lateness))
    return _report(problems, lost)


def _topic(reader: Any, name: str) -> str:
    found = reader.topic(name)
    if found is None:
        raise InputError(
            f"{reader.path}: topic '{name}' is not in the bag; it holds "
            f"{', '.join(sorted(reader.info.topics))}"
        )
    return str(found)


# record, recover, anonymise ------------------------------------------------------------------


def _record(args: argparse.Namespace) -> int:
    try:
        from .recorder_node import record
    except ImportError as error:
        raise InputError(f"recording needs ROS 2 ({error}); source it") from None
    from .writer import BagWriter

    # Refused here, before ROS starts, with the reason.
    check_namespace(args.namespace)
    settings = settings_from(args, RecorderSettings)
    BagWriter(args.output, in_place=False).abandon()
    path = Path(args.output).absolute()
    parameters = {
        "folder": str(path.parent),
        "record_at_start": True,
        "bag_name": path.name,
        **settings.to_dict(),
    }
    for key in ("session", "subject", "condition"):
        if getattr(args, key):
            parameters[key] = getattr(args, key)
    if args.calibration:
        parameters["calibration_file"] = str(Path(args.calibration).absolute())
    arguments = ["--ros-args", "-r", f"__ns:=/{args.namespace.strip('/')}"]
    for name, value in parameters.items():
        text = json.dumps(value)
        arguments += ["-p", f"{name}:={text}"]
    if args.topics:
        arguments += ["-p", f"topics:={json.dumps(args.topics)}"]
    record(["finger-bag", *arguments])
    return 0


def _recover(args: argparse.Namespace) -> int:
    from .copying import recover

    target = Path(args.output) if args.output else _beside(Path(args.bag), "_recovered")
    result = recover(args.bag, target)
    print(f"{plain(result.path)}: {result.message_count} messages recovered")
    for topic, count in sorted(result.counts.items()):
        print(f"  {plain(topic)}: {count}")
    return _report(result.problems, result.lost)


def _anonymise(args: argparse.Namespace) -> int:
    from .copying import anonymise

    result = anonymise(args.bag, args.output)
    print(f"{plain(result.path)}: {result.message_count} messages kept")
    for topic, count in sorted(result.dropped.items()):
        print(f"  dropped {plain(topic)}: {count}")
    for name in result.dropped_attachments:
        print(f"  dropped attachment {plain(name)}")
    return _report(result.problems, result.lost)


def _report(problems: Sequence[str], lost: bool) -> int:
    """Print what was wrong with a bag that was read; gives the exit code."""
    for problem in problems:
        print(f"  problem: {plain(problem)}")
    if lost:
        print("finger-bag: not all of the bag could be read", file=sys.stderr)
    return EXIT_LOST if lost else 0


def _beside(path: Path, suffix: str) -> Path:
    path = path.absolute() if path.name else path.resolve()
    name = (
        path.name if path.is_dir() else re.sub(r"(\.(mcap|active|zstd|db3|xdf))+$", "", path.name)
    )
    return path.with_name(name + suffix)


# The command ---------------------------------------------------------------------------------


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    top = Parser(
        prog="finger-bag",
        description="Inspect, check, play, record, repair and anonymise session bags.",
        example="finger-bag validate bags/natural\nfinger-bag process bags/natural -o out/natural",
    )
    commands = top.add_subparsers(dest="command", required=True, parser_class=Parser)

    def command(
        name: str, act: Callable[[argparse.Namespace], int], about: str, example: str
    ) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=about, description=about, example=example)
        added.set_defaults(act=act)
        return added

    info = command(
        "info", _info, "List topics, times and metadata of bags.", "finger-bag info bags/dry"
    )
    info.add_argument("bags", nargs="+", metavar="BAG", help=BAGS)
    info.add_argument("--count", action="store_true", help="count by reading every message")
    info.add_argument("--json", action="store_true", help="print JSON")

    check = command(
        "validate",
        _validate,
        "Check whether bags are fit for use. Exit code 0 fit, 1 a check fails, 2 unreadable.",
        "finger-bag validate bags/dry --json",
    )
    check.add_argument("bags", nargs="+", metavar="BAG", help=BAGS)
    add_read_options(check, ReadSettings)
    check.add_argument("--json", action="store_true", help="print JSON")

    show = command(
        "play",
        _play,
        "Publish a bag with its original spacing, until its end or Ctrl-C.",
        "finger-bag play bags/dry --rate 2 --clock --topics wrench contact_area",
    )
    show.add_argument("bag", metavar="BAG", help="bag to publish")
    add_settings(show.add_argument_group("how it is played"), PlaySettings)
    show.add_argument("--topics", nargs="+", metavar="TOPIC", help="play these topics only")
    show.add_argument("--exclude", nargs="+", metavar="TOPIC", help="leave out these topics")
    show.add_argument(
        "--await",
        dest="awaited",
        nargs="+",
        metavar="TOPIC",
        help="begin when somebody listens to these topics",
    )

    record = command(
        "record",
        _record,
        "Record the rig's topics until Ctrl-C.",
        "finger-bag record -o session1 --condition natural",
    )
    record.add_argument("-o", "--output", required=True, help="bag to write")
    record.add_argument(
        "--topics",
        nargs="+",
        metavar="TOPIC",
        help="topics of a session bag, relative to the namespace or absolute; others as NAME=TYPE "
        "(default: all of a session bag)",
    )
    record.add_argument("--namespace", default="finger", help="namespace of the rig")
    record.add_argument("--session", default="", help="id of the session")
    record.add_argument("--subject", default="", help="subject code, never a name")
    record.add_argument("--condition", default="", help="condition of the skin, such as dry")
    record.add_argument("--calibration", metavar="FILE", help="plate calibration to attach")
    add_settings(record.add_argument_group("how the bag is written"), RecorderSettings)

    recover = command(
        "recover",
        _recover,
        "Copy everything that can be read from a damaged bag into a complete bag.",
        "finger-bag recover session1 -o session1_recovered",
    )
    recover.add_argument("bag", metavar="BAG", help="damaged bag; it is not changed")
    recover.add_argument("-o", "--output", help="bag to write (default: BAG_recovered)")

    hide = command(
        "anonymise",
        _anonymise,
        "Copy a bag without images; areas, outlines and metadata stay.",
        "finger-bag anonymise session1 -o session1_anonymous",
    )
    hide.add_argument("bag", metavar="BAG", help="bag to copy; it is not changed")
    hide.add_argument("-o", "--output", required=True, help="bag to write")
    for name in COMMANDS.names():
        COMMANDS.load(name)(command)
    return top


def command(argv: Sequence[str] | None = None) -> int:
    """Run with arguments; raises FingerError."""
    args = parser().parse_args(argv)
    return int(args.act(args) or 0)


def main() -> None:
    """Entry point."""
    sys.exit(run(command))


if __name__ == "__main__":
    main()
