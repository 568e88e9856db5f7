# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Software, models and bags of a fit, as HTML."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from ..results import FitResult
from .markup import table

PAPER_TIME = "2 min a trial, 27,000 min (19 days) in COMSOL"
"""Time of the paper's search (Nam and Kuchenbecker 2021)."""


def provenance(result: FitResult) -> str:
    """Software, models, options, time and bags."""
    sources, options = result.sources, result.options
    default = type(options)().to_dict()
    changed = [f"{k} = {v}" for k, v in options.to_dict().items() if v != default[k]]
    seconds = ", ".join(f"{stage} {spent:.1f} s" for stage, spent in result.seconds.items())
    libraries = [f"{name} {v}" for name, v in sources.get("libraries", {}).items() if v]
    rows = [
        ["command", _code(sources.get("command") or "–")],
        ["software", escape(str(sources.get("software_version", "–")))],
        ["Python, libraries", escape(", ".join([str(sources.get("python", "–")), *libraries]))],
        ["machine", escape(str(sources.get("platform", "–")))],
        ["date (UTC)", escape(f"{sources.get('date', '–')} {sources.get('time_utc', '')}")],
        ["seed", str(options.seed)],
        ["material law", escape(str(sources.get("law", "–")))],
        ["geometry", _geometry(sources)],
        ["reduced model", _code(sources.get("reduced_model_hash", "–"))],
        [
            "measured error of the reduced model",
            model_error(dict(sources.get("reduced_model_error", {}))),
        ],
        ["search box", escape(", ".join(options.bounds)) or "default of the law"],
        ["time", escape(f"{seconds} (the paper: {PAPER_TIME})")],
        ["options other than default", escape(", ".join(changed) or "none")],
    ]
    text = table(["item", "value"], rows, (1,))
    bags = [
        [escape(b["bag"]), str(b["trials"]), escape(", ".join(b["areas"])), escape(b["force"]),
         _code(b["sha256"][:16])]
        for b in sources.get("bags", [])
    ]  # fmt: skip
    if bags:
        header = ["bag", "trials", "areas", "force", "SHA-256, first 16 digits"]
        text += table(header, bags, (2, 3, 4))
    return text


def _geometry(sources: Mapping[str, Any]) -> str:
    """Where the lengths of the finger come from, and the hash of its geometry."""
    stated = sources.get("geometry")
    words = "of each subject its own" if stated is None else stated["source"]
    return f"{escape(str(words))}; {_code(sources.get('geometry_hash') or '–')}"


def _code(text: object) -> str:
    return f"<code>{escape(str(text))}</code>"


def model_error(error: dict[str, float]) -> str:
    """The reduced model's error against full order, as its file records it."""
    if not {"pairs", "rms_p99", "worst_p99"} <= set(error):
        return "–"
    return (
        f"area {100 * error['rms_p99']:.2f} % RMS and {100 * error['worst_p99']:.2f} % at the "
        "worst instant, in % of a history's largest area, at the 99th percentile of "
        f"{error['pairs']:g} histories held out from its training"
    )
