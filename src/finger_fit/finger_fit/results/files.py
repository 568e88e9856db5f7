# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Files of a fit: fit.json, parameters.yaml and tables/, and those of an earlier fit in the same
folder."""

from __future__ import annotations

import itertools
import json
import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from finger_common.errors import InputError, listed
from finger_common.files import atomic_write, load_json, make_folder
from finger_common.folder_lock import take_lock
from finger_common.subject_code import is_subject, may_be_one
from finger_model.subjects import subject_file

from .fit_json import fit_dict
from .fits import Finger, FitResult
from .parameter_files import own_files, parameter_files, subject_sets
from .tables import write_tables


def _check_writable(folder: Path) -> None:
    """Raise InputError for a folder that no result could be written into."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    try:
        tempfile.TemporaryFile(dir=existing).close()
    except OSError as error:
        raise _no_folder(folder, error) from None


def _no_folder(folder: Path, error: OSError) -> InputError:
    return InputError(
        f"{folder}: nothing can be written there ({error.strerror}); give another folder"
    )


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep other fits from writing into a folder, which is made if need be; ends with the process.

    Raises InputError while another fit writes there, and for a folder that nothing could be written
    into. File systems without locks are not guarded.
    """
    _check_writable(folder)
    made = list(itertools.takewhile(lambda path: not path.exists(), (folder, *folder.parents)))
    try:
        make_folder(folder)
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise _no_folder(folder, error) from None
    try:
        if not take_lock(handle):
            raise InputError(
                f"{folder}: another fit is writing there; wait until it has ended, or give another "
                "folder"
            )
        yield
    finally:
        os.close(handle)
        with suppress(OSError):  # the first one holds the fit
            for path in made:
                path.rmdir()


def check_folder(folder: Path, fingers: Iterable[Finger]) -> None:
    """Raise InputError for a folder that holds an earlier fit of others than these: what it wrote
    of them would stay, and be taken for a result of this fit, or be lost."""
    known = list(fingers)
    others = sorted(
        " ".join(filter(None, earlier))
        for earlier in _earlier_fingers(folder)
        if not any(f.subject == earlier.subject and may_be_one(f.name, earlier.name) for f in known)
    )
    if others:
        raise InputError(
            f"{folder}: holds an earlier fit of {listed(others)}, who are not among these trials; "
            "give another folder, or move the earlier fit away"
        )


def _earlier_fingers(folder: Path) -> dict[Finger, bytes]:
    """Fingers of the fit in a folder, each with the content of its parameters.yaml; none without a
    fit."""
    try:
        found = load_json(folder / "fit.json", "fit.json")
        parts = found.get("subjects") or {"": found}
        fingers = {n: Finger(str(p["subject"]), str(p.get("finger", ""))) for n, p in parts.items()}
    except (InputError, KeyError, TypeError, AttributeError):
        return {}
    files = {f: folder / n / "parameters.yaml" for n, f in fingers.items() if is_subject(f.subject)}
    return {finger: file.read_bytes() if file.is_file() else b"" for finger, file in files.items()}


def write(result: FitResult, folder: Path) -> None:
    """Write fit.json, the parameter files and the tables into the folder; of several subjects,
    those of each into a folder of its own too, and a file of each in subjects/ for the model node.

    A fit that was interrupted leaves the parameter files of an earlier one.
    """
    earlier = _earlier_fingers(folder)
    for name, part in result.subjects.items():
        _write(part, folder / name)
    _write(result, folder)
    found = subject_sets(result)
    for part in result.parts.values():
        finger = part.finger
        if not is_subject(finger.subject) or part.unfinished:
            continue
        file = subject_file(folder / "subjects", *finger)
        if finger in found:
            found[finger].save(file)
        else:
            file.unlink(missing_ok=True)  # of an earlier fit in this folder
    for finger in set() if result.interrupted else earlier.keys() - found.keys():
        file = subject_file(folder / "subjects", *finger)
        # Not one that a calibration, or somebody, put there since.
        if file.is_file() and file.read_bytes() == earlier[finger]:
            file.unlink()


def remove_pages(result: FitResult, folder: Path) -> None:
    """Remove the report.html of an earlier fit of these subjects, and what was printed of it."""
    for name in ("", *result.subjects):
        for page in ("report.html", "report.pdf"):
            path = folder / name / page
            if not path.is_dir():  # then drawing the report says so
                path.unlink(missing_ok=True)


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
