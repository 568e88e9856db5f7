"""The report of a fit: one self-contained HTML file, with its figures as PNG files beside it."""

from __future__ import annotations

import base64
import io
import itertools
from html import escape
from importlib import resources
from pathlib import Path

import matplotlib.pyplot as plt

from finger_common.files import atomic_write

from ..results import FitResult
from . import tables
from .figures import CAPTIONS, STYLE, all_figures

NARROW = ("moisture", "convergence")
"""Figures of less than the page's width."""


def write_report(result: FitResult, folder: Path) -> Path:
    """Write report.html and figures/*.png into the folder; returns the path of the page."""
    pictures: dict[str, bytes] = {}
    with plt.rc_context(STYLE):
        for name, figure in all_figures(result).items():
            buffer = io.BytesIO()
            # Fixed metadata: equal fits give equal files.
            figure.savefig(buffer, format="png", metadata={"Software": None})
            plt.close(figure)
            pictures[name] = buffer.getvalue()
            with atomic_write(folder / "figures" / f"{name}.png", "wb") as file:
                file.write(pictures[name])
    page = folder / "report.html"
    with atomic_write(page) as file:
        file.write(render(result, pictures))
    return page


def render(result: FitResult, pictures: dict[str, bytes]) -> str:
    """The page's HTML."""
    captions = CAPTIONS | {"candidates": CAPTIONS["candidates"] + _meanings(result)}
    numbers = itertools.count(1)

    def figure(name: str) -> str:
        if name not in pictures:
            return ""
        data = base64.b64encode(pictures[name]).decode()
        kind = " class=narrow" if name in NARROW else ""
        text = escape(captions[name])
        return (
            f'<figure{kind}><img alt="{text}" src="data:image/png;base64,{data}">'
            f"<figcaption><b>Fig. {next(numbers)}.</b> {text}</figcaption></figure>"
        )

    style = (resources.files(__package__) / "static" / "report.css").read_text(encoding="utf-8")
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8>",
        '<meta name=viewport content="width=device-width,initial-scale=1">',
        f"<title>Finger model fit</title><style>{style}</style>",
        "<main><h1>Viscoelastic finger model, fitted to contact area</h1>",
        f"<p class=lead>{_lead(result)}</p>",
        tables.parameters(result),
        tables.verdict(result),
        "<h2>Data</h2>",
        figure("moisture"),
        figure("force_over_time"),
        tables.exclusions(result),
        "<h2>Area over force</h2>",
        figure("area_over_force"),
        tables.costs(result),
        tables.force_modes(result),
        "<h2>Trials</h2>",
        figure("example_trial"),
        figure("matched_trials"),
        figure("residuals"),
        tables.trials(result),
        "<h2>Identifiability</h2>",
        figure("candidates"),
        figure("profiles"),
        tables.identifiability(result),
        tables.bootstrap(result),
        "<h2>Search</h2>",
        tables.search(result),
        figure("convergence"),
        tables.candidates(result),
        tables.additional_fits(result),
        "<h2>Provenance</h2>",
        tables.provenance(result),
    ]
    return "\n".join(part for part in parts if part) + "\n</main></html>\n"


def _meanings(result: FitResult) -> str:
    """The derived quantities as text."""
    return "".join(f" {q.symbol}: {q.meaning}" for q in result.space.derived.values())


def _lead(result: FitResult) -> str:
    """Presses, subjects, conditions, and the source of the areas."""
    problems = [fit.problem for fit in result.fits.values()]
    subjects = sorted({t.subject for p in problems for t in p.trials if t.subject})
    who = f" of {', '.join(subjects)}" if subjects else ""
    bags = result.sources.get("bags", [])
    names = {"topic": "recorded contact_area", "images": "images, measured again"}
    areas = [names.get(a, a) for a in sorted({a for bag in bags for a in bag["areas"]})]
    made = sorted({bag["made_by"] for bag in bags if bag["made_by"]})
    text = (
        f"{sum(map(len, problems))} presses{who} in {len(problems)} "
        f"condition{'s' if len(problems) != 1 else ''}: {', '.join(result.fits)}. "
    )
    if areas:
        text += f"Areas from {', '.join(areas)}."
    if made:
        text += f" Recorded by: {'; '.join(made)}."
    if "date" in result.sources:
        text += f" Fitted on {result.sources['date']}."
    return escape(text)
