# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which files and folders are bags, and which files belong to one."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from finger_common.errors import InputError
from finger_common.files import exists


def find_bags(paths: Iterable[str | Path]) -> list[Path]:
    """Bags among files and folders; a folder that is no bag stands for the bags directly in it.

    Raises InputError for a path that does not exist or a folder without bags.
    """
    found: list[Path] = []
    for path in map(Path, paths):
        if not exists(path):
            raise InputError(f"{path}: no such bag; check the path")
        if path.is_file() or is_bag_folder(path):
            found.append(path)
            continue
        visible = (p for p in sorted(path.iterdir()) if not p.name.startswith("."))
        inside = [p for p in visible if p.is_dir() and is_bag_folder(p)]
        if not inside:
            raise InputError(f"{path}: no bag in this folder; give a bag or a folder of bags")
        found += inside
    if not found:
        raise InputError("no bag was given; name bags or a folder of bags")
    return found


def is_bag_folder(folder: Path) -> bool:
    """Whether a folder is a bag: it holds metadata.yaml or a file of a bag."""
    return (folder / "metadata.yaml").is_file() or any(storage_of(p) for p in folder.iterdir())


def storage_of(path: Path) -> str | None:
    """ "mcap" or "sqlite3" by the name of a file, None for another file."""
    name = path.name.removesuffix(".zstd")
    if name.endswith(".db3"):
        return "sqlite3"
    return "mcap" if name.endswith(".mcap") else None


def file_order(path: Path) -> tuple[Any, ...]:
    """Key to sort the files of a bag by: NAME_2.mcap before NAME_10.mcap."""
    stem = path.name.split(".")[0]
    head, _, number = stem.rpartition("_")
    return (head, int(number)) if number.isdigit() else (stem, -1)
