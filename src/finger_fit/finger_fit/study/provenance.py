# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Where a fit comes from: command, date, versions, seed, models and hashes of the bags."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from finger_bag.schema import software_version

from ..options import FitOptions
from ..problem import material_of
from ..results import FitResult

LIBRARIES = ("numpy", "scipy", "numba", "pymoo", "opencv-python-headless", "matplotlib")
"""Libraries that the numbers of a fit depend on."""


def provenance(
    result: FitResult, options: FitOptions, bags: Sequence[dict[str, Any]] = (), command: str = ""
) -> dict[str, Any]:
    """What a fit is made of, for fit.json and the report."""
    model, now = result.model, datetime.now(timezone.utc)
    finger = result.assumed_finger
    return {
        "command": command,
        "date": now.date().isoformat(),
        "time_utc": now.time().isoformat("seconds"),
        "software_version": software_version(),
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "libraries": {name: _version(name) for name in LIBRARIES},
        "seed": options.seed,
        "law": getattr(material_of(model), "name", "none"),
        "geometry_hash": "" if finger is None else finger.geometry.hash(),
        "geometry": None if finger is None else finger.to_dict(),
        "reduced_model_hash": getattr(model, "hash", ""),
        "reduced_model_error": result.model_error,
        "bags": list(bags),
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
