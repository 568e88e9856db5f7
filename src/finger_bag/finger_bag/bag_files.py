# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which files and folders are bags, and which files belong to one."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from finger_common.errors import InputError
from finger_common.files import exists

METADATA = "metadata.yaml"
"""File in the folder of a bag that lists the bag's files."""

_SPLIT = re.compile(r"(.+)_(0|[1-9][0-9]{0,8})")  # as recorders number files, without zeros before


def find_bags(paths: Iterable[str | Path]) -> list[Path]:
    """Bags among files and folders; a folder that is no bag stands for the bags in it and in the
    folders directly in it, and a folder without bags there for those one deeper: of a session.

    Raises InputError for a path that is neither a file nor a folder, or a folder without bags.
    """
    found: list[Path] = []
    for path in map(Path, paths):
        check_place(path)
        if path.is_file() or (path / METADATA).is_file():
            found.append(path)
            continue
        bags = _bags_within(path) or sorted(
            path.glob("*.bag")
        )  # ROS 1: opening them says what to do
        if not bags:
            raise InputError(f"{path}: no bag in this folder; give a bag or a folder of bags")
        found += bags
    if not found:
        raise InputError("no bag was given; name bags or a folder of bags")
    return found


def check_place(path: Path) -> None:
    """Raise InputError for a path of a bag where there is neither a file nor a folder."""
    if not exists(path):
        raise InputError(f"{path}: no such bag; check the path")
    if not path.is_file() and not path.is_dir():
        raise InputError(f"{path}: is a pipe or a device, not a bag; save the bag as a file first")


def _visible(folder: Path) -> list[Path]:
    return [p for p in sorted(folder.iterdir()) if not p.name.startswith(".")]


def _folders(folder: Path) -> list[Path]:
    return [p for p in _visible(folder) if p.is_dir()]


def _bags_within(folder: Path) -> list[Path]:
    """Bags in a folder and in the folders directly in it."""
    bags = _bags_of(folder)
    inside = [bag for p in _folders(folder) for bag in _bags_of(p) or _bags_of_folders(p)]
    if inside and bags == [folder]:  # files beside bags are no bag with them
        bags = data_files(folder)
    return sorted(bags + inside)


def _bags_of_folders(folder: Path) -> list[Path]:
    return [bag for p in _folders(folder) for bag in _bags_of(p)]


def _bags_of(folder: Path) -> list[Path]:
    """The folder where it is one bag, else each file of a bag in it."""
    files = data_files(folder)
    one = (folder / METADATA).is_file() or (files and are_one_bag(files))
    return [folder] if one else files


def data_files(folder: Path) -> list[Path]:
    """MCAP and sqlite3 files in a folder, in the order of their names and numbers."""
    return sorted((p for p in _visible(folder) if storage_of(p) and p.is_file()), key=file_order)


def are_one_bag(files: Iterable[Path]) -> bool:
    """Whether files that no metadata.yaml lists are of one bag: NAME_0.mcap, NAME_1.mcap, …"""
    return len({file_order(file)[0] for file in files}) == 1


def storage_of(path: Path) -> str | None:
    """ "mcap" or "sqlite3" by the name of a file, None for another file."""
    name = path.name.removesuffix(".zstd")
    if name.endswith(".db3"):
        return "sqlite3"
    return "mcap" if name.endswith(".mcap") else None


def file_order(path: Path) -> tuple[Any, ...]:
    """Key to sort the files of a bag by: NAME_2.mcap before NAME_10.mcap."""
    stem = Path(path.name.removesuffix(".zstd")).stem
    split = _SPLIT.fullmatch(stem)
    return (split[1], int(split[2])) if split else (stem, -1)


def number_of(file: Path) -> int:
    """Number of a file of a bag, -1 where its name has none."""
    return int(file_order(file)[1])
