"""Makes the sample bags again: three presses of the simulated rig per condition, in one bag.

    python examples/sample_bags.py            # into bags/ of the checkout

The whole suite records them over DDS, as at a rig; then the presses of a condition are put into one
bag, message by message as they were recorded. The camera's frame is an area of interest of 560×480
pixels with little noise, stored as lossless PNG, so that a bag stays small.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from demo.session import SessionRequest, record_session
from finger_bag.copying import announce, copy_attachments
from finger_bag.reader import BagReader, open_bag
from finger_bag.schema import SessionMetadata
from finger_bag.writer import BagWriter
from finger_common.cli import Parser, run
from finger_common.errors import InputError

SEED = 2021
REQUEST_PARAMETERS: dict[str, dict[str, Any]] = {
    "recorder": {"png": True},
    "simulated_rig": {"noise": 0.5},
    # Short waits: most of a bag's size is pictures of an empty plate.
    "protocol": {"clear_time": 0.3, "release_time": 0.3},
}


PICTURES = ("image_raw/compressed", "camera_info")
MARGIN_NS = 220_000_000
"""Two frames of the empty plate before and after a press."""


def contact_times(reader: BagReader) -> np.ndarray:
    """Log times (n,) in ns of the areas that show a contact."""
    topic = next(t for t in reader.info.topics if t.endswith("/contact_area"))
    messages = reader.messages([topic])
    return np.array([i.log_time_ns for i in messages if i.message.gross_area > 0])


def trial_of(message: Any) -> tuple[str, int, int]:
    """Condition, index and attempt of a Trial message."""
    return message.condition, message.index, message.attempt


def own_trial(reader: BagReader) -> tuple[str, int, int]:
    """The trial a bag was recorded for, the last one announced in it."""
    topic = next(t for t in reader.info.topics if t.endswith("/trial"))
    return [trial_of(item.message) for item in reader.messages([topic])][-1]


def merge(bags: Sequence[Path], target: Path, condition: str) -> int:
    """Put bags, in order, into one of that condition; returns its size in bytes.

    Messages are copied as they are. Left out: pictures long before and after a press, and what
    latched topics repeat of earlier trials at the head of a bag.
    """
    readers = [open_bag(bag) for bag in bags]
    try:
        known = readers[0].info.metadata.to_mapping()
        known.pop("trial_index", None)
        metadata = SessionMetadata.from_mapping({**known, "condition": condition})
        with BagWriter(target, metadata) as writer:
            copy_attachments(readers[0], writer)
            announced: set[str] = set()
            events: set[bytes] = set()
            for reader in readers:
                contact, own = contact_times(reader), own_trial(reader)
                for topic in reader.info.topics.values():
                    if topic.name not in announced:
                        announce(writer, topic)
                        announced.add(topic.name)
                for message in reader.messages():
                    name = message.topic.split("/", 2)[-1]
                    if name in PICTURES:
                        distance = np.abs(contact - message.log_time_ns)
                        if distance.min() > MARGIN_NS:
                            continue
                    if name == "trial" and trial_of(message.message) != own:
                        continue
                    if name == "model_events":
                        if message.raw in events:
                            continue
                        events.add(message.raw)
                    writer.write_raw(
                        message.topic, message.raw, message.log_time_ns, message.publish_time_ns
                    )
    finally:
        for reader in readers:
            reader.close()
    return sum(file.stat().st_size for file in target.iterdir())


def make_bags(folder: Path, trials: int, seed: int, console: Console) -> list[Path]:
    """Record a session and write one bag per condition into `folder`, replacing those there."""
    # Kept after an error: its log names the cause.
    scratch = Path(tempfile.mkdtemp(prefix="finger_sample_bags_"))
    request = SessionRequest(
        scratch,
        trials=trials,
        seed=seed,
        width=560,
        height=480,
        reading_time=0.2,
        parameters=REQUEST_PARAMETERS,
    )
    recorded: dict[str, list[Path]] = {name: [] for name in request.conditions}
    with contextlib.closing(record_session(request)) as events:
        for event in events:
            if event["event"] == "trial" and event["verdict"] == "done":
                condition, index = event["condition"], event["index"]
                bag = request.bags / f"{index:03d}_{condition}_{event['attempts'] - 1}"
                recorded[condition].append(bag)
                console.print(f"press {index + 1} ({condition}): {event['peak_force']:.2f} N")
    made = []
    for condition, bags in recorded.items():
        target = folder / condition
        shutil.rmtree(target, ignore_errors=True)
        size = merge(bags, target, condition)
        console.print(f"{target}: {size / 1e6:.1f} MB")
        made.append(target)
    shutil.rmtree(scratch)
    return made


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point with the conventions of all commands."""
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> int:
    arguments = Parser(
        prog="python examples/sample_bags.py",
        description="Make the sample bags again with the simulated rig.",
        example="python examples/sample_bags.py -o bags",
    )
    arguments.add_argument("-o", "--output", type=Path, default=Path("bags"), metavar="DIR")
    arguments.add_argument("--trials", type=int, default=3, help="presses per bag (default: 3)")
    arguments.add_argument("--seed", type=int, default=SEED, help="(default: %(default)s)")
    given = arguments.parse_args(argv)
    if given.trials < 1:
        raise InputError(f"--trials is {given.trials}, at least 1 press is needed")
    make_bags(given.output.absolute(), given.trials, given.seed, Console(highlight=False))
    return 0


if __name__ == "__main__":
    sys.exit(main())
