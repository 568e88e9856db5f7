# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Figures as a journal wants them: formats, type size, letters, axes, colours for everybody."""

from __future__ import annotations

import itertools
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from finger_common.errors import InputError
from finger_fit.report import figure
from finger_fit.report.figures import (
    PALETTE,
    _plain_log_ticks,
    all_figures,
    captions_of,
    labels_of,
)

COLUMN = 7.2
"""inches; no figure is wider than two columns of a journal, so none is printed smaller."""

COLOUR_VISION = {
    "usual": np.eye(3),
    # Machado, Oliveira and Fernandes (2009), severity 1, for linear RGB.
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                   [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                     [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                   [0.004733, 0.691367, 0.303900]],
}  # fmt: skip


@pytest.fixture(scope="module")
def figures(study: Any) -> dict[str, Any]:
    return all_figures(study)


def lab(colour: str, sees: Any) -> np.ndarray:
    """CIE L*a*b* of a colour as it is seen."""
    values = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.asarray(sees) @ linear, 0.0, 1.0)
    to_xyz = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    x, y, z = np.cbrt(to_xyz @ linear / [0.9505, 1.0, 1.089])
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("vision", COLOUR_VISION)
def test_colours_are_told_apart_with_every_kind_of_colour_vision(vision: str) -> None:
    seen = [lab(colour, COLOUR_VISION[vision]) for colour in PALETTE]
    distances = {
        (i, j): float(np.linalg.norm(seen[i] - seen[j]))
        for i, j in itertools.combinations(range(len(seen)), 2)
    }
    # 2.3 is a just noticeable difference.
    assert min(distances.values()) > 15.0, distances


def test_no_text_is_smaller_than_8_pt_at_the_printed_width(figures: dict[str, Any]) -> None:
    for name, drawn in figures.items():
        assert drawn.get_figwidth() <= COLUMN, name
        sizes = [t.get_fontsize() for t in drawn.findobj(Text) if t.get_text().strip()]
        assert sizes and min(sizes) >= 8.0, (name, min(sizes))


def test_panels_have_letters_and_conditions_share_their_axes(figures: dict[str, Any]) -> None:
    for name, drawn in figures.items():
        panels = [p for p in drawn.axes if p.get_visible()]
        titles = [p.get_title(loc="left") for p in panels if p.get_title(loc="left")]
        if len(titles) > 1:
            letters = [t[:3] for t in titles]
            assert letters == [f"({chr(97 + i)})" for i in range(len(letters))], name
    for name in ("area_over_force", "force_over_time"):
        panels = figures[name].axes
        assert len({p.get_xlim() for p in panels}) == len({p.get_ylim() for p in panels}) == 1
    model, law, _ = figures["residuals"].axes
    assert (model.get_xlim(), model.get_ylim()) == (law.get_xlim(), law.get_ylim())


@pytest.mark.parametrize(
    ("low", "high", "wanted"),
    [(700.0, 2200.0, "700 1000 2000"), (0.01, 0.8, "0.01 0.1 0.7"), (12.0, 16.0, "15"),
     (6.0, 11.0, "7 10")],
)  # fmt: skip
def test_numbers_on_a_logarithmic_axis_stay_apart(low: float, high: float, wanted: str) -> None:
    panel = plt.figure().add_subplot()
    panel.set_xscale("log")
    _plain_log_ticks(panel, low, high)
    assert " ".join(label.get_text() for label in panel.get_xticklabels()) == wanted
    plt.close("all")


def test_reports_leave_the_backend_to_their_caller() -> None:
    """pyplot would choose one for the process: figures of a notebook then no longer show."""
    code = "import sys, finger_fit.report; sys.exit('matplotlib.pyplot' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def renamed(study: Any, names: list[str]) -> Any:
    fits = [replace(fit, condition=name) for fit, name in zip(study.fits.values(), names)]
    # The same conditions again: as many as names.
    more = [replace(fits[i % len(fits)], condition=name) for i, name in enumerate(names)]
    return replace(study, fits={fit.condition: fit for fit in more})


@pytest.mark.filterwarnings("error")
def test_long_and_foreign_names_of_conditions_stay_apart(study: Any) -> None:
    names = [
        "very dry skin after ten minutes of silica gel in a closed box p7",
        "\u4e7e\u71e5\u3057\u305f\u76ae\u819a",
        "moist (water of 30 degrees, 30 s), then wiped once with paper",
        "very dry skin after twenty minutes of silica gel in a closed box",
        "ξηρό δέρμα",
        "natural",
    ]
    report = renamed(study, names)
    labels = labels_of(report)
    assert len(set(labels.values())) == len(names) and max(map(len, labels.values())) <= 18
    assert labels["natural"] == "natural" and labels["ξηρό δέρμα"] == "ξηρό δέρμα"
    caption = captions_of(report)["moisture"]
    for name, label in labels.items():
        assert (f"{label} = {name}" in caption) == (label != name)
    for name, drawn in all_figures(report).items():
        canvas = FigureCanvasAgg(drawn)
        canvas.draw()
        renderer = canvas.get_renderer()
        whole = drawn.bbox
        titles = [p._left_title for p in drawn.axes if p.get_visible()]
        boxes = [t.get_window_extent(renderer) for t in titles if t.get_text()]
        assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2)), name
        boxes += [legend.get_window_extent(renderer) for legend in drawn.legends]
        assert all(whole.x0 <= b.x0 and b.x1 <= whole.x1 + 1 for b in boxes), name


def test_every_figure_comes_as_png_svg_and_pdf(written: Path) -> None:
    folder = written.parent / "figures"
    names = {p.stem for p in folder.iterdir()}
    starts = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
    for name in names:
        for kind, start in starts.items():
            content = (folder / f"{name}.{kind}").read_bytes()
            assert content.startswith(start) and len(content) > 2000
    page = written.read_text()
    order = [page.index(f"<h2>{words}") for words in ("Data quality", "Parameters", "Provenance")]
    assert order == sorted(order)
    for words in ("lag (ms)", "tare (N)", "gain", "RMS error", "Contrasts", "Covariance"):
        assert words in page


def test_a_figure_is_found_by_its_name(study: Any) -> None:
    assert figure(study, "residuals").axes
    with pytest.raises(InputError, match="did you mean 'residuals'"):
        figure(study, "residual")
