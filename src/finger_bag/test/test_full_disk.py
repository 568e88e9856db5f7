# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A disk that is full while a bag is written: an error that names the bag, and nothing left.

A file that cannot grow beyond a limit stands for the disk.
"""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from session_bags import START, wrench

from finger_bag.reader import open_bag
from finger_bag.writer import BagWriter, MessageRefused
from finger_common.errors import InputError

LIMITED = """
import resource, signal, sys
from finger_bag.cli import command
from finger_common.cli import run
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
limit = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
sys.exit(run(command, sys.argv[2:]))
"""


@contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """Files of this process cannot grow beyond so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize("size", [1_000, 20_000])
@pytest.mark.parametrize("name", ["recover", "anonymise"])
def test_a_copy_that_does_not_fit_ends_with_its_name_and_leaves_nothing(
    session: Callable[..., Path], tmp_path: Path, name: str, size: int
) -> None:
    path, out = session(), tmp_path / "out"
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(size), name, str(path), "-o", str(out)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2 and done.stdout == ""
    assert f"{out}: cannot be written (File too large); make room" in done.stderr
    assert done.stderr.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_after_a_failed_write_nothing_more_is_written(tmp_path: Path) -> None:
    """There may be room again, and the file holds part of a chunk."""
    bag = BagWriter(tmp_path / "bag", chunk_size=1_000, compression="none")
    with files_up_to(5_000), pytest.raises(InputError, match=r"bag: cannot be written \(File"):
        for number in range(1_000):
            bag.write("wrench", wrench(START + number, 1.0))
    for further in (
        lambda: bag.write("wrench", wrench(START + 9_000, 1.0)),
        lambda: bag.attach("a", b"a"),
        bag.flush,
        bag.finish,
        bag.close,
    ):
        with pytest.raises(InputError, match=r"bag: cannot be written \(File"):
            further()
    assert not list(tmp_path.iterdir())


def test_a_bag_that_cannot_be_begun_leaves_nothing(tmp_path: Path) -> None:
    with files_up_to(0), pytest.raises(InputError, match="make room"):
        BagWriter(tmp_path / "bag").attach("a", bytes(20_000))
    assert not list(tmp_path.iterdir())


def test_a_message_that_no_bag_can_hold_is_refused_alone(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for cdr, time in ((b"xx", START), (b"\1" + bytes(20), START), (bytes(20), -1)):
            with pytest.raises(MessageRefused):
                bag.write_raw("wrench", cdr, time)
        bag.write("wrench", wrench(START, 1.0))
    with open_bag(tmp_path / "bag") as reader:
        assert len(list(reader.messages())) == 1
