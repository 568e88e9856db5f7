# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The report of a fit: one self-contained HTML file, with its figures as files beside it."""

from __future__ import annotations

import base64
import io
import itertools
from collections.abc import Container
from html import escape
from importlib import resources
from pathlib import Path

from matplotlib import rc_context

from finger_common.files import atomic_write

from ..results import FitResult
from . import candidates, data, goodness, identifiability, parameters, provenance
from .figures import FIGURES, STYLE, all_figures, captions_of
from .nuisances import lengths, nuisances

NARROW = ("moisture", "convergence")
"""Figures of less than the page's width."""


FORMATS = {
    # Fixed metadata: equal fits give equal files.
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
"""Formats of the figures beside the page, and the metadata that they do not get."""


def write_report(result: FitResult, folder: Path) -> Path:
    """Write report.html and figures/*.png, *.svg and *.pdf into the folder; returns the page.

    Of several subjects, each has a report in its own folder, and the page compares them.
    """
    page = folder / "report.html"
    if page.exists():  # of an earlier fit, and so is what was printed of it
        page.with_suffix(".pdf").unlink(missing_ok=True)
    if result.subjects:
        for name, part in result.subjects.items():
            write_report(part, folder / name)
        _remove_figures(folder / "figures", ())
        text = render_subjects(result)
    else:
        text = render(result, _write_figures(result, folder / "figures"))
    with atomic_write(page) as file:
        file.write(text)
    return page


def _write_figures(result: FitResult, folder: Path) -> dict[str, bytes]:
    """Write every figure in every format; gives the PNG of each."""
    pictures: dict[str, bytes] = {}
    with rc_context(STYLE):
        for name, figure in all_figures(result).items():
            for kind, metadata in FORMATS.items():
                buffer = io.BytesIO()
                figure.savefig(buffer, format=kind, metadata=metadata)
                # The first format's layout serves all; each other would be drawn twice for it.
                with rc_context({"figure.constrained_layout.use": False}):
                    figure.set_layout_engine(None)
                with atomic_write(folder / f"{name}.{kind}", "wb") as file:
                    file.write(buffer.getvalue())
                if kind == "png":
                    pictures[name] = buffer.getvalue()
    _remove_figures(folder, pictures)
    return pictures


def remove_figures(result: FitResult, folder: Path) -> None:
    """Remove the figures of an earlier fit of these subjects."""
    for name in ("", *result.subjects):
        _remove_figures(folder / name / "figures", ())


def _remove_figures(folder: Path, kept: Container[str]) -> None:
    """Remove the figures of an earlier fit in this folder that this one has not."""
    for name, kind in itertools.product(FIGURES, FORMATS):
        if name not in kept:
            (folder / f"{name}.{kind}").unlink(missing_ok=True)


def _head(title: str) -> list[str]:
    style = (resources.files(__package__) / "static" / "report.css").read_text(encoding="utf-8")
    return [
        "<!doctype html><html lang=en><meta charset=utf-8>",
        '<meta name=viewport content="width=device-width,initial-scale=1">',
        f"<title>{title}</title><style>{style}</style>",
    ]


def render_subjects(result: FitResult) -> str:
    """The page that compares several subjects."""
    parts = [
        *_head("Finger model fits"),
        "<main><h1>Viscoelastic finger model, fitted to contact area</h1>",
        f"<p class=lead>{_lead(result)}</p>",
        parameters.subjects(result),
        "<h2>Data quality</h2>",
        data.quality(result),
        data.exclusions(result),
        parameters.contrast_table(result),
        "<h2>Goodness of fit</h2>",
        goodness.costs(result),
        "<h2>Provenance</h2>",
        provenance.provenance(result),
    ]
    return "\n".join(part for part in parts if part) + "\n</main></html>\n"


def render(result: FitResult, pictures: dict[str, bytes]) -> str:
    """The page's HTML."""
    captions = captions_of(result)
    numbers = itertools.count(1)

    def figure(name: str) -> str:
        if name not in pictures:
            return ""
        image = base64.b64encode(pictures[name]).decode()
        kind = " class=narrow" if name in NARROW else ""
        text = escape(captions[name])
        return (
            f"<figure{kind}><div class=scroll tabindex=0>"
            f'<img alt="{text}" src="data:image/png;base64,{image}"></div>'
            f"<figcaption><b>Fig. {next(numbers)}.</b> {text}</figcaption></figure>"
        )

    parts = [
        *_head("Finger model fit"),
        "<main><h1>Viscoelastic finger model, fitted to contact area</h1>",
        f"<p class=lead>{_lead(result)}</p>",
        "<h2>Data quality</h2>",
        data.quality(result),
        "<h2>Parameters</h2>",
        parameters.parameters(result),
        parameters.verdict(result),
        parameters.contrast_table(result),
        "<h2>Data</h2>",
        figure("moisture"),
        figure("force_over_time"),
        data.exclusions(result),
        "<h2>Area over force</h2>",
        figure("area_over_force"),
        goodness.costs(result),
        goodness.force_modes(result),
        *(["<h2>Indentation</h2>", figure("indentation")] if "indentation" in pictures else []),
        goodness.indentations(result),
        "<h2>Trials</h2>",
        figure("example_trial"),
        figure("matched_trials"),
        figure("residuals"),
        data.trials(result),
        "<h2>Identifiability</h2>",
        figure("candidates"),
        figure("profiles"),
        identifiability.identifiability(result),
        lengths(result),
        nuisances(result),
        identifiability.covariances(result),
        identifiability.bootstrap(result),
        "<h2>Search</h2>",
        candidates.search(result),
        figure("convergence"),
        candidates.candidates(result),
        candidates.additional_fits(result),
        "<h2>Provenance</h2>",
        provenance.provenance(result),
    ]
    return "\n".join(part for part in parts if part) + "\n</main></html>\n"


def _lead(result: FitResult) -> str:
    """Presses, subjects, conditions, and the source of the areas."""
    problems = [fit.problem for fit in result.fits.values()]
    subjects = sorted({t.subject for p in problems for t in p.trials if t.subject})
    who = f" of {', '.join(subjects)}" if subjects else ""
    bags = result.sources.get("bags", [])
    names = {"topic": "recorded contact_area", "images": "images, measured again"}
    areas = [names.get(a, a) for a in sorted({a for bag in bags for a in bag["areas"]})]
    made = sorted({bag["made_by"] for bag in bags if bag["made_by"]})
    conditions = list(dict.fromkeys(t.condition for p in problems for t in p.trials))
    text = (
        f"{sum(map(len, problems))} presses{who} in {len(conditions)} "
        f"condition{'s' if len(conditions) != 1 else ''}: {', '.join(conditions)}. "
    )
    if areas:
        text += f"Areas from {', '.join(areas)}."
    if made:
        text += f" Recorded by: {'; '.join(made)}."
    text = escape(text)
    if "date" in result.sources:
        text += f' Fitted on <span class="date">{escape(str(result.sources["date"]))}</span>.'
    return text
