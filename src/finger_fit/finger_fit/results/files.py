# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Files of a fit: fit.json, parameters.yaml and tables/, and those of an earlier fit in the same
folder."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from finger_common.errors import InputError, listed
from finger_common.files import atomic_write, load_json
from finger_common.subject_code import is_subject
from finger_model.subjects import subject_file

from .fit_json import fit_dict
from .fits import FitResult
from .parameter_files import own_files, parameter_files, subject_sets
from .tables import write_tables


def check_folder(folder: Path, subjects: Iterable[str]) -> None:
    """Raise InputError for a folder that holds an earlier fit of others than these subjects: what
    it wrote of them would stay, and be taken for a result of this fit."""
    others = sorted(_earlier_subjects(folder).keys() - set(subjects))
    if others:
        raise InputError(
            f"{folder}: holds an earlier fit of {listed(others)}, who are not among these trials; "
            "give another folder, or move the earlier fit away"
        )


def _earlier_subjects(folder: Path) -> dict[str, bytes]:
    """Codes of the subjects of the fit in a folder, each with the content of its parameters.yaml;
    none without a fit."""
    try:
        found = load_json(folder / "fit.json", "fit.json")
        parts = found.get("subjects") or {"": found}
        codes = {name: str(part["subject"]) for name, part in parts.items()}
    except (InputError, KeyError, TypeError, AttributeError):
        return {}
    files = {c: folder / name / "parameters.yaml" for name, c in codes.items() if is_subject(c)}
    return {code: file.read_bytes() if file.is_file() else b"" for code, file in files.items()}


def write(result: FitResult, folder: Path) -> None:
    """Write fit.json, the parameter files and the tables into the folder; of several subjects,
    those of each into a folder of its own too, and subjects/CODE.yaml of each for the model node.

    A fit that was interrupted leaves the parameter files of an earlier one.
    """
    earlier = _earlier_subjects(folder)
    for name, part in result.subjects.items():
        _write(part, folder / name)
    _write(result, folder)
    found = subject_sets(result)
    for part in result.parts.values():
        code = part.subject
        if not is_subject(code) or part.unfinished:
            continue
        file = subject_file(folder / "subjects", code)
        if code in found:
            found[code].save(file)
        else:
            file.unlink(missing_ok=True)  # of an earlier fit in this folder
    for code in set() if result.interrupted else earlier.keys() - found.keys():
        file = subject_file(folder / "subjects", code)
        # Not one that a calibration, or somebody, put there since.
        if file.is_file() and file.read_bytes() == earlier[code]:
            file.unlink()


def _write(result: FitResult, folder: Path) -> None:
    earlier = _parameter_files_of(folder)
    with atomic_write(folder / "fit.json") as file:
        json.dump(fit_dict(result), file, indent=1, ensure_ascii=False)
        file.write("\n")
    write_tables(result, folder)
    files = {} if result.subjects else parameter_files(result)
    for name, sets in files.items():
        sets.save(folder / name)
    # Those of an earlier fit in this folder would be taken for those of this one.
    for name in set() if result.interrupted else earlier - files.keys():
        (folder / name).unlink(missing_ok=True)


def _parameter_files_of(folder: Path) -> set[str]:
    """Names of the parameter files that the fit in a folder wrote; none without one."""
    try:
        found = load_json(folder / "fit.json", "fit.json")
        conditions = list(found["conditions"])
    except (InputError, KeyError, TypeError):
        return set()
    return {"parameters.yaml", *own_files(map(str, conditions)).values()}
