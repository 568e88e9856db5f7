# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Parameter files of subjects: SUBJECT.FINGER.yaml, or SUBJECT.yaml where the finger was not
noted."""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

from finger_common.errors import InputError, listed
from finger_common.files import make_folder, user_path
from finger_common.subject_code import FINGER_NAMES, may_be_one, parameter_file_name

from .parameter_sets import ParameterSets


def subject_file(folder: str | Path, subject: str, finger: str = "") -> Path:
    """Where the parameters of a subject's finger are; raises InputError for a code that is no file
    name."""
    return user_path(folder) / parameter_file_name(subject, finger)


def find_subject(folder: str | Path, subject: str, finger: str = "") -> tuple[Path | None, str]:
    """The file that a session of this finger begins with, or none, and what is to be told of it.

    The finger's own; else one that may be of it, unless several fingers may. Raises InputError as
    `subject_file`.
    """
    own = subject_file(folder, subject, finger)
    files = {name: subject_file(folder, subject, name) for name in FINGER_NAMES}
    fingers = [name for name, path in files.items() if path.exists()]
    if own.exists():
        unused = [files[name].name for name in fingers if name and not finger]
        said = f"subject {subject}: finger not noted; {own.name} is used, not {listed(unused)}"
        return own, said if unused else ""
    fitting = [name for name in fingers if may_be_one(name, finger)]
    if not may_be_one(*fitting, finger):
        fitting = [name for name in fitting if not name]
    said = f"subject {subject}: no parameters of {finger or 'a finger that is not noted'}"
    if fitting:
        path = files[max(fitting, key=len)]
        return path, f"{said}; those of {path} are used"
    if fingers:
        others = ", ".join(files[name].name for name in fingers)
        return None, f"{said}, only {others}; calibrate this finger"
    return None, ""


def check_folder(folder: str | Path) -> None:
    """Make the folder of the subjects' parameters if need be; raises InputError where nothing can
    be written into it.
    """
    path = user_path(folder)
    try:
        make_folder(path)
        tempfile.TemporaryFile(dir=path).close()
    except OSError as error:
        raise InputError(
            f"{path}: no subject can be kept there ({error.strerror}); choose another "
            "'subjects_folder'"
        ) from None


def save_subject(folder: str | Path, subject: str, sets: ParameterSets, finger: str = "") -> Path:
    """Write the parameters of a subject's finger; those of before are kept beside them with their
    date.

    Raises InputError when the folder cannot be written to.
    """
    path = subject_file(folder, subject, finger)
    try:
        if path.exists():
            made = time.strftime("%Y%m%dT%H%M%S", time.localtime(path.stat().st_mtime))
            earlier = path.with_name(f"{path.stem}.{made}.yaml")
            shutil.copy2(path, earlier)
        sets.save(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
    return path
