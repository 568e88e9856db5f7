# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Parameter files of subjects."""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

from finger_common.errors import InputError
from finger_common.subject_code import check_subject

from .parameter_sets import ParameterSets


def subject_file(folder: str | Path, subject: str) -> Path:
    """Where the parameters of a subject are; raises InputError for a code that is no file name."""
    return Path(folder).expanduser() / f"{check_subject(subject)}.yaml"


def check_folder(folder: str | Path) -> None:
    """Make the folder of the subjects' parameters if need be; raises InputError where nothing can
    be written into it.
    """
    path = Path(folder).expanduser()
    try:
        path.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()
    except OSError as error:
        raise InputError(
            f"{path}: no subject can be kept there ({error.strerror}); choose another "
            "'subjects_folder'"
        ) from None


def save_subject(folder: str | Path, subject: str, sets: ParameterSets) -> Path:
    """Write a subject's parameters; those of before are kept beside them with their date.

    Raises InputError when the folder cannot be written to.
    """
    path = subject_file(folder, subject)
    try:
        if path.exists():
            made = time.strftime("%Y%m%dT%H%M%S", time.localtime(path.stat().st_mtime))
            earlier = path.with_name(f"{subject}.{made}.yaml")
            shutil.copy2(path, earlier)
        sets.save(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
    return path
