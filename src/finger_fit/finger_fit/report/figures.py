# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Figures of the report, drawn from a fit's results; none shows a fingerprint.

Nothing is computed here: areas, curves and the deformed finger are part of the results.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, fontManager, get_font
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, NullLocator

from finger_common.errors import InputError, known_names
from finger_model.laws import Quantity

from ..report_units import MM2, MM4, three_digits
from ..results import DeformedFinger, FitResult

PALETTE = ("#d55e00", "#009e73", "#0072b2", "#cc79a7", "#e69f00", "#56b4e9")
"""Warm to cool from dry to moist: colours of Okabe and Ito (2008), told apart with every kind of
colour vision; markers tell them apart without colour."""

MARKERS = ("o", "s", "^", "D", "v", "P")

SMALLEST = 8.0
"""pt, size of the smallest text of a figure that is printed at its own width."""

FALLBACKS = (
    "DejaVu Sans", "Noto Sans", "Arial Unicode MS", "Droid Sans Fallback", "WenQuanYi Zen Hei",
    "WenQuanYi Micro Hei", "IPAexGothic", "IPAGothic", "NanumGothic", "MS Gothic", "SimSun",
    "Malgun Gothic", "Noto Sans Arabic", "Noto Sans Hebrew", "Noto Sans Devanagari",
)  # fmt: skip
"""Fonts for letters that the serif ones do not have, where they are installed; of TrueType, as
journals want in PDF."""

STYLE: dict[Any, Any] = {
    "font.family": ["serif", *(f for f in FALLBACKS if f in fontManager.get_font_names())],
    "font.serif": ["STIX Two Text", "STIXGeneral", "DejaVu Serif"],
    "mathtext.fontset": "stix",
    "font.size": SMALLEST,
    "axes.titlesize": 9,
    "axes.labelsize": 8.5,
    "xtick.labelsize": SMALLEST,
    "ytick.labelsize": SMALLEST,
    "legend.fontsize": SMALLEST,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "lines.linewidth": 1.1,
    "axes.titlelocation": "left",
    "axes.titlepad": 5,
    "savefig.dpi": 220,
    "pdf.fonttype": 42,
    "svg.hashsalt": "finger_fit",
    "figure.constrained_layout.use": True,
}
COLUMN = 7.1
"""Width of a figure in inches: two columns of an IEEE page."""

ABREAST = 3
"""Panels of conditions beside each other; further ones go into further rows."""

PROFILES_IN_ROW = 6

LONGEST_LABEL, LONGEST_TITLE = 18, 40
"""Characters of the name of a condition, and of a trial, that a figure shows."""

LEGEND_HANDLE, LEGEND_LETTER = 0.45, 0.058
"""Inches that an entry of a legend takes, and further ones for each of its characters."""


def title_of(quantity: Quantity) -> str:
    """Symbol and unit of a quantity, as an axis title."""
    letter, index = quantity.letter_and_index
    symbol = f"${letter}_{{{index}}}$" if index else f"${letter}$"
    return f"{symbol} ({quantity.display_unit})" if quantity.display_unit else symbol


def colour_of(report: FitResult, condition: str) -> str:
    """The condition's colour, by its position from dry to moist."""
    return PALETTE[list(report.fits).index(condition) % len(PALETTE)]


def marker_of(report: FitResult, condition: str) -> str:
    """The condition's marker."""
    return MARKERS[list(report.fits).index(condition) % len(MARKERS)]


def labels_of(report: FitResult) -> dict[str, str]:
    """Names of the conditions as figures show them: a long one is cut behind its number, and one
    that no font has the letters of is its number alone."""
    with rc_context(STYLE):
        families = STYLE["font.family"]
        fonts = [get_font(fontManager.findfont(FontProperties(family=f))) for f in families]
    found = {}
    for number, name in enumerate(report.fits, 1):
        shown = all(any(font.get_char_index(ord(c)) for font in fonts) for c in name)
        found[name] = name
        if not shown:
            found[name] = f"condition {number}"
        elif len(name) > LONGEST_LABEL:
            found[name] = f"{number}: {name[: LONGEST_LABEL - 4].rstrip()}…"
    return found


def legend_below(figure: Figure, *panels: Axes, columns: int = 6) -> None:
    """One legend for the panels, below them: it covers no curve."""
    entries: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels()):
            entries.setdefault(label, handle)
    if entries:
        each = LEGEND_HANDLE + LEGEND_LETTER * max(map(len, entries))
        fitting = max(1, int(figure.get_figwidth() / each))
        figure.legend(
            list(entries.values()), list(entries), loc="outside lower center",
            ncols=min(columns, fitting, len(entries)), handlelength=1.8, columnspacing=1.4,
        )  # fmt: skip


def lettered(panel: Axes, number: int, text: str = "") -> None:
    """Title of a panel behind its letter: "(a) dry"."""
    panel.set_title(f"({chr(ord('a') + number)}) {text}".rstrip(), loc="left")


def condition_panels(report: FitResult, height: float) -> tuple[Figure, list[Axes]]:
    """A figure with one lettered panel per condition, all on the same axes."""
    number = len(report.fits)
    columns = min(number, ABREAST)
    rows = -(-number // columns)
    width = COLUMN if columns > 1 else 0.5 * COLUMN
    figure, grid = _subplots(
        rows, columns, figsize=(width, height * rows), sharex=True, sharey=True, squeeze=False
    )
    panels = list(grid.flat)
    for unused in panels[number:]:
        unused.set_visible(False)
    for index, label in enumerate(labels_of(report).values()):
        lettered(panels[index], index, label)
        if index + columns >= number:
            panels[index].tick_params(labelbottom=True)
    return figure, panels[:number]


def _subplots(
    rows: int = 1, columns: int = 1, *, figsize: tuple[float, float], **options: Any
) -> tuple[Figure, Any]:
    """As `pyplot.subplots`, which would choose a backend for the whole process."""
    figure = Figure(figsize=figsize)
    return figure, figure.subplots(rows, columns, **options)


def all_figures(report: FitResult) -> dict[str, Figure]:
    """Every figure that the fit has the data for, by file name in the order of the report."""
    with rc_context(STYLE):
        figures = {name: make(report) for name, make in FIGURES.items()}
    return {name: figure for name, figure in figures.items() if figure is not None}


def figure(report: FitResult, name: str) -> Figure:
    """One figure by name; raises InputError for a name that the fit has no figure of."""
    if name in FIGURES:
        with rc_context(STYLE):
            made = FIGURES[name](report)
        if made is not None:
            return made
    raise InputError(f"figure '{name}' does not exist here; {known_names(name, FIGURES)}")


def moisture_figure(report: FitResult) -> Figure | None:
    """Moisture of every trial by condition, with mean and standard deviation."""
    fits = {n: f for n, f in report.fits.items() if np.isfinite(f.moisture[0])}
    if not fits:
        return None
    figure, axes = _subplots(figsize=(0.6 * COLUMN, 1.0 + 0.42 * len(fits)))
    for row, (name, fit) in enumerate(fits.items()):
        colour = colour_of(report, name)
        values = np.array([t.moisture for t in fit.problem.trials])
        values = values[np.isfinite(values)]
        mean, deviation = fit.moisture
        spread = np.linspace(-0.16, 0.16, len(values)) if len(values) > 1 else np.zeros(1)
        # An even, repeatable spread of the points instead of a random one.
        spread = spread[np.argsort(np.argsort(np.sin(37.0 * np.arange(len(values)))))]
        axes.scatter(
            values, row + spread, s=16, color=colour, alpha=0.65, linewidths=0,
            marker=marker_of(report, name),
        )  # fmt: skip
        axes.errorbar(
            mean, row + 0.33, xerr=deviation, fmt="|", color="0.15", ms=7, mew=1.2, lw=1.0,
            capsize=2.5, capthick=1.0,
        )  # fmt: skip
        axes.text(
            mean,
            row + 0.40,
            f"{mean:.1f} ± {deviation:.1f}",
            ha="center",
            va="bottom",
            fontsize=SMALLEST,
        )
    labels = labels_of(report)
    axes.set_yticks(
        range(len(fits)), [f"{labels[n]}\n($n$ = {len(f.problem)})" for n, f in fits.items()]
    )
    axes.set_ylim(-0.4, len(fits) - 0.15)
    axes.set_xlim(0, 130)
    axes.set_xlabel("skin moisture (a.u.)")
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.grid(axis="x", color="0.9", lw=0.6)
    axes.set_axisbelow(True)
    return figure


def area_over_force_figure(report: FitResult) -> Figure:
    """Measured areas over force, one panel per condition, with model trials and power law."""
    figure, panels = condition_panels(report, 2.8)
    for panel, (name, fit) in zip(panels, report.fits.items()):
        colour = colour_of(report, name)
        problem = fit.problem
        model = fit.areas
        for index in range(len(problem)):
            part = slice(problem.starts[index], problem.starts[index + 1])
            order = np.argsort(problem.force[part])
            panel.plot(
                problem.force[part][order], model[part][order] * MM2, color=colour, lw=0.7,
                alpha=0.55, label="model, each trial" if index == 0 else None, zorder=2,
            )  # fmt: skip
        panel.scatter(
            problem.force, problem.measured * MM2, s=8, facecolors="white", edgecolors="0.25",
            linewidths=0.5, label="measured", zorder=3,
        )  # fmt: skip
        force = np.linspace(0, problem.force.max(), 200)
        law = fit.power_law
        panel.plot(
            force, law.area(force) * MM2, color="0.1", ls=(0, (4, 2)), lw=1.0,
            label="power law $kF^m$", zorder=4,
        )  # fmt: skip
        panel.set_xlabel("normal force (N)")
        panel.text(
            0.98, 0.03,
            f"model $J$ = {three_digits(fit.cost * MM4)} mm$^4$\n"
            f"power law $J$ = {three_digits(law.cost * MM4)} mm$^4$\n"
            f"$k$ = {law.k * MM2:.1f}, $m$ = {law.m:.2f}",
            transform=panel.transAxes, ha="right", va="bottom", fontsize=SMALLEST,
        )  # fmt: skip
    panels[0].set_xlim(0, None)
    panels[0].set_ylim(0, None)
    figure.supylabel("gross contact area (mm$^2$)", fontsize=8.5)
    legend_below(figure, *panels)
    return figure


def force_over_time_figure(report: FitResult) -> Figure:
    """Normal force of every trial as recorded, aligned at onset."""
    figure, panels = condition_panels(report, 1.9)
    target = report.options.target_force
    for panel, (name, fit) in zip(panels, report.fits.items()):
        for trial in fit.problem.trials:
            panel.plot(
                trial.drive.record_time,
                trial.drive.record_force,
                color=colour_of(report, name),
                lw=0.6,
                alpha=0.6,
            )
            # Where the loading ends: the last frame that counts.
            panel.plot(trial.time[-1], trial.force[-1], ".", color="0.15", ms=2.5, zorder=3)
        if target:
            panel.axhline(target, color="0.3", lw=0.6, ls=(0, (1, 2)))
        panel.set_xlabel("time from touch (s)")
    figure.supylabel("normal force (N)", fontsize=8.5)
    if target:
        panels[0].text(
            0.02, target, f"target {target:g} N", fontsize=SMALLEST, va="bottom", color="0.3",
            transform=panels[0].get_yaxis_transform(),
        )  # fmt: skip
    return figure


def example_figure(report: FitResult) -> Figure:
    """One trial: force and area over time, measured against model, and the deformed finger."""
    fit, index = report.example()
    name, trial = fit.condition, fit.problem.trials[index]
    colour = colour_of(report, name)
    figure = Figure(figsize=(COLUMN, 3.1))
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0), height_ratios=(1, 1.7))
    top = figure.add_subplot(grid[0, 0])
    bottom = figure.add_subplot(grid[1, 0], sharex=top)
    side = figure.add_subplot(grid[:, 1])
    top.plot(
        trial.drive.record_time, trial.drive.record_force, color="0.55", lw=0.6, label="recorded"
    )
    top.plot(trial.time, trial.force, color="0.1", lw=0.9, label="drives the model")
    top.set_ylabel("force (N)")
    top.tick_params(labelbottom=False)
    long = len(trial.label) > LONGEST_TITLE
    lettered(top, 0, f"…{trial.label[-LONGEST_TITLE:]}" if long else trial.label)
    bottom.plot(trial.time, fit.curves[index] * MM2, color=colour, label="model")
    bottom.errorbar(
        trial.frame_time, trial.area * MM2, yerr=np.nan_to_num(trial.area_sd) * MM2, fmt="o",
        ms=3.2, mfc="white", mec="0.15", ecolor="0.5", elinewidth=0.7, mew=0.7,
        label="measured (±1 SD)",
    )  # fmt: skip
    law = fit.power_law
    bottom.plot(
        trial.time,
        law.area(trial.force) * MM2,
        color="0.1",
        ls=(0, (4, 2)),
        lw=0.9,
        label="power law",
    )
    bottom.set_xlim(trial.time[0] - 0.03, trial.time[-1] + 0.12)
    bottom.set_ylim(0, None)
    bottom.set_xlabel("time from touch (s)")
    bottom.set_ylabel("gross contact area (mm$^2$)")
    legend_below(figure, top, bottom)
    if report.deformed is None:
        side.set_axis_off()
    else:
        _deformed(side, report.deformed, float(trial.force.max()))
    return figure


def _deformed(axes: Axes, finger: DeformedFinger, force: float) -> None:
    """The deformed finger, coloured by the shear strain, on the plate."""
    geometry = finger.geometry
    fields, contact = finger.fields, finger.contact
    rest, positions = fields.nodes * 1e3, fields.deformed * 1e3
    limit = float(np.quantile(finger.strain[fields.bulk], 0.995))
    image = None
    for sign in (-1.0, 1.0):
        mirror = np.array([sign, 1.0])
        for part in (fields.epidermis, fields.bulk):
            polygons = positions[fields.cells[part]] * mirror
            collection = PolyCollection(
                polygons, array=finger.strain[part], cmap="YlOrBr", clim=(0.0, limit),
                edgecolors="face", linewidths=0.1,
            )  # fmt: skip
            axes.add_collection(collection)
            image = collection
        axes.plot(*(positions[fields.surface] * mirror).T, color="0.15", lw=0.8)
        axes.plot(*(rest[fields.surface] * mirror).T, color="0.45", lw=0.6, ls=(0, (2, 2)))
        axes.plot(*(positions[fields.interface] * mirror).T, color="0.35", lw=0.5)
    nail = geometry.nail_reach * 1e3
    axes.fill_between([-nail, nail], 0, geometry.nail_thickness * 1e3, color="#d9d2c5", lw=0)
    r, z = geometry.bone_profile(np.linspace(0, 1, 60))
    bone_r = np.concatenate([-r[::-1], r]) * 1e3
    bone_z = np.concatenate([z[::-1], z]) * 1e3
    axes.fill(bone_r, np.minimum(bone_z, 0.0), facecolor="#f4f1ea", edgecolor="0.35", lw=0.6)
    axes.text(
        0,
        -0.45 * geometry.bone_semi_axis_axial * 1e3,
        "bone",
        ha="center",
        va="center",
        fontsize=SMALLEST,
    )
    plate = fields.plate_height * 1e3
    width = geometry.pad_semi_axis_radial * 1e3 * 1.12
    axes.fill_between([-width, width], plate - 0.55, plate, color="#c9dbe8", lw=0)
    axes.plot([-width, width], [plate, plate], color="#456", lw=0.8)
    axes.text(
        -width + 0.1, plate - 0.30, "glass plate", fontsize=SMALLEST, va="center", color="#345"
    )
    radius = contact.radius * 1e3
    axes.annotate(
        "", (radius, plate - 0.85), (-radius, plate - 0.85),
        arrowprops={"arrowstyle": "<->", "lw": 0.7, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    below = min(plate - 0.98, float(rest[:, 1].min()) - 0.15)
    axes.text(
        0, below,
        f"contact diameter {2 * radius:.1f} mm, area {contact.area * MM2:.1f} mm$^2$, "
        f"indentation {contact.indentation * 1e3:.2f} mm",
        ha="center", va="top", fontsize=SMALLEST,
    )  # fmt: skip
    axes.set_aspect("equal")
    axes.set_xlim(-width, width)
    axes.set_ylim(below - 0.72, geometry.nail_thickness * 1e3 + 0.2)
    axes.set_axis_off()
    lettered(axes, 1, f"full-order finger at {force:.2f} N")
    if image is not None:
        place = axes.inset_axes((0.22, -0.10, 0.56, 0.035))
        bar = axes.figure.colorbar(image, cax=place, orientation="horizontal")
        bar.set_label("largest shear strain", fontsize=SMALLEST)
        place.tick_params(labelsize=SMALLEST)
        bar.outline.set_linewidth(0.4)  # type: ignore[operator]


def candidates_figure(report: FitResult) -> Figure:
    """Top candidates of every quantity, and its 95 % range (as the paper's Fig. 5)."""
    space = report.space
    box = next(iter(report.fits.values())).problem.box
    figure, panels = _subplots(1, len(space.quantity_names), figsize=(COLUMN, 2.4))
    labels = list(labels_of(report).values())
    below = len(labels) > ABREAST or max(map(len, labels)) > LONGEST_LABEL // 2
    for number, (panel, name) in enumerate(zip(panels, space.quantity_names)):
        quantity = space.describe(name)
        factor = quantity.display_factor
        for row, (condition, fit) in enumerate(report.fits.items()):
            colour = colour_of(report, condition)
            profile = fit.profiles.get(name)
            if profile is not None:
                low, high = (value * factor for value in profile.interval)
                panel.add_patch(
                    Rectangle((row - 0.30, low), 0.60, high - low, color=colour, alpha=0.18, lw=0)
                )
                for value, is_open in ((low, profile.open_low), (high, profile.open_high)):
                    style = (0, (1, 1.5)) if is_open else "solid"
                    panel.plot(
                        [row - 0.30, row + 0.30], [value, value], color=colour, lw=0.8, ls=style
                    )
            values = space.quantity(name, fit.top) * factor
            offsets = np.linspace(-0.18, 0.18, len(values)) if len(values) > 1 else np.zeros(1)
            panel.scatter(
                row + offsets[1:], values[1:], s=14, facecolors="white", edgecolors=colour,
                linewidths=0.9, marker=marker_of(report, condition), zorder=3,
            )  # fmt: skip
            panel.scatter(
                row, fit.quantity(name) * factor, s=30, color=colour,
                marker=marker_of(report, condition), zorder=4, edgecolors="white", linewidths=0.5,
                label=labels[row],
            )  # fmt: skip
        if name in space:
            low, high = box[space.index(name)] * factor
            panel.axhspan(low, high, color="0.97", zorder=0)
            panel.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
            for bound in (low, high):
                panel.axhline(bound, color="0.6", lw=0.6)
        else:
            panel.set_ylim(0, None)
        panel.set_xlim(-0.6, len(labels) - 0.4)
        if below:
            panel.set_xticks([])
        else:
            panel.set_xticks(
                range(len(labels)), labels, rotation=35, ha="right", rotation_mode="anchor"
            )
        lettered(panel, number, title_of(quantity))
        panel.tick_params(axis="x", length=0)
    if below:
        legend_below(figure, panels[0])
    return figure


def matched_figure(report: FitResult) -> Figure | None:
    """One trial of each condition, of similar duration: force and area over time (as Fig. 6)."""
    if len(report.fits) < 2:
        return None
    durations = {
        n: np.array([t.time[-1] for t in f.problem.trials]) for n, f in report.fits.items()
    }
    middle = float(np.median(np.concatenate(list(durations.values()))))
    labels = labels_of(report)
    figure, (left, right) = _subplots(1, 2, figsize=(COLUMN, 2.4))
    for name, fit in report.fits.items():
        index = int(np.argmin(np.abs(durations[name] - middle)))
        trial = fit.problem.trials[index]
        colour, marker = colour_of(report, name), marker_of(report, name)
        left.plot(trial.time, trial.force, color=colour, label=labels[name])
        right.plot(trial.time, fit.curves[index] * MM2, color=colour)
        right.scatter(
            trial.frame_time, trial.area * MM2, s=14, facecolors="white", edgecolors=colour,
            linewidths=0.9, marker=marker, label=f"{labels[name]}, measured", zorder=3,
        )  # fmt: skip
    left.set_ylabel("normal force (N)")
    right.set_ylabel("gross contact area (mm$^2$)")
    for number, panel in enumerate((left, right)):
        lettered(panel, number)
        panel.set_xlabel("time from touch (s)")
        panel.set_ylim(0, None)
        panel.set_xlim(0, None)
    legend_below(figure, left, right)
    return figure


def profiles_figure(report: FitResult) -> Figure | None:
    """Profile likelihoods: rise of J over each quantity, scaled so that 1 is the 95 % limit."""
    if not any(fit.profiles for fit in report.fits.values()):
        return None
    space = report.space
    labels = labels_of(report)
    names = (*space.derived, *space.names)
    rows = -(-len(names) // PROFILES_IN_ROW)
    across = -(-len(names) // rows)
    size = (COLUMN, 0.5 + 1.85 * rows)
    figure, panels = _subplots(rows, across, figsize=size, sharey=True, squeeze=False)
    for panel in panels.ravel()[len(names) :]:
        panel.remove()
    for number, (panel, name) in enumerate(zip(panels.ravel(), names)):
        quantity = space.describe(name)
        factor = quantity.display_factor
        ticks: list[float] = []
        for condition, fit in report.fits.items():
            profile = fit.profiles.get(name)
            if profile is None:
                continue
            colour = colour_of(report, condition)
            rise = (profile.costs - fit.objective) / (profile.threshold - fit.objective)
            panel.plot(
                profile.values * factor, np.maximum(rise, 0.0), color=colour, lw=1.1,
                marker=marker_of(report, condition), ms=1.8, label=labels[condition],
            )  # fmt: skip
            panel.axvline(fit.quantity(name) * factor, color=colour, lw=0.5, ls=(0, (1, 2)))
            ticks += [value * factor for value in profile.box]
        panel.axhline(1.0, color="0.3", lw=0.7, ls=(0, (4, 2)))
        panel.set_ylim(0, 3.2)
        logarithmic = not space.log_offset(name)
        panel.set_xscale("log" if logarithmic else "linear")
        if ticks:
            panel.set_xlim(min(ticks), max(ticks))
            if logarithmic:
                _plain_log_ticks(panel, min(ticks), max(ticks))
        lettered(panel, number, title_of(quantity))
    for panel in panels[:, 0]:
        panel.set_ylabel(r"$(J - J_\mathrm{min})\,/\,(J_{95} - J_\mathrm{min})$")
    legend_below(figure, *panels[0])
    return figure


def _plain_log_ticks(panel: Axes, low: float, high: float) -> None:
    """Three round numbers on a logarithmic axis."""
    nice = [m * 10.0**e for e in range(-4, 6) for m in (1, 1.5, 2, 3, 5, 7)]
    inside = [v for v in nice if low <= v <= high]
    wanted = inside[:1]
    if len(inside) > 1:
        middle = math.sqrt(inside[0] * inside[-1])
        between = min(inside[1:-1], key=lambda v: abs(math.log(v / middle)), default=None)
        wanted += [*([] if between is None else [between]), inside[-1]]
    panel.xaxis.set_major_locator(FixedLocator(wanted))
    panel.xaxis.set_minor_locator(NullLocator())
    labels = panel.set_xticklabels([f"{v:g}" for v in wanted])
    if len(labels) > 1:  # the ends would run into the next panel's
        labels[0].set_horizontalalignment("left")
        labels[-1].set_horizontalalignment("right")


def residuals_figure(report: FitResult) -> Figure:
    """Residuals over force and their distribution, model beside power law."""
    figure, panels = _subplots(
        1, 3, figsize=(COLUMN, 2.45), gridspec_kw={"width_ratios": (1, 1, 0.7)}
    )
    limit = 0.0
    labels = labels_of(report)
    for name, fit in report.fits.items():
        problem, colour = fit.problem, colour_of(report, name)
        model = (fit.areas - problem.measured) * MM2
        law = (fit.power_law.area(problem.force) - problem.measured) * MM2
        limit = max(limit, np.abs(law).max(), np.abs(model).max())
        for panel, values in ((panels[0], model), (panels[1], law)):
            panel.scatter(
                problem.force, values, s=7, color=colour, alpha=0.6, linewidths=0,
                marker=marker_of(report, name), label=labels[name],
            )  # fmt: skip
        panels[2].hist(model, bins=13, histtype="step", color=colour, density=True, lw=1.0)
    for number, (panel, title) in enumerate(
        (
            (panels[0], "model − measured (mm$^2$)"),
            (panels[1], "power law − measured (mm$^2$)"),
        )
    ):
        panel.axhline(0, color="0.3", lw=0.6)
        panel.set_ylim(-1.1 * limit, 1.1 * limit)
        panel.set_xlabel("normal force (N)")
        lettered(panel, number, title)
    legend_below(figure, panels[0])
    panels[1].sharex(panels[0])
    lettered(panels[2], 2, "model: distribution")
    panels[2].set_xlabel("residual (mm$^2$)")
    panels[2].set_yticks([])
    return figure


def indentation_figure(report: FitResult) -> Figure | None:
    """Measured indentation over force beside the model's, and their difference."""
    fits = {n: f for n, f in report.fits.items() if f.indentation is not None}
    if not fits:
        return None
    labels = labels_of(report)
    figure, (left, right) = _subplots(1, 2, figsize=(COLUMN, 2.6))
    for name, fit in fits.items():
        found = fit.indentation
        assert found is not None
        colour, marker = colour_of(report, name), marker_of(report, name)
        for number, index in enumerate(dict.fromkeys(found.trial_of)):
            own = found.trial_of == index
            left.plot(
                found.force[own], found.predicted[own] * 1e3, color=colour, lw=0.7, alpha=0.55,
                label=None if number else f"{labels[name]}, model",
            )  # fmt: skip
        left.scatter(
            found.force, found.measured * 1e3, s=8, facecolors="white", edgecolors=colour,
            linewidths=0.6, marker=marker, label=f"{labels[name]}, measured", zorder=3,
        )  # fmt: skip
        right.scatter(
            found.force, (found.predicted - found.measured) * 1e6, s=7, color=colour, alpha=0.6,
            linewidths=0, marker=marker,
        )  # fmt: skip
    right.axhline(0, color="0.3", lw=0.6)
    lettered(left, 0, "indentation (mm)")
    lettered(right, 1, "model − measured (µm)")
    for panel in (left, right):
        panel.set_xlabel("normal force (N)")
        panel.set_xlim(0, None)
    legend_below(figure, left)
    return figure


def convergence_figure(report: FitResult) -> Figure:
    """Best J over the rounds of the search, relative to J after the polish, or without one to the
    best."""
    labels = labels_of(report)
    figure, axes = _subplots(figsize=(0.6 * COLUMN, 2.3))
    for name, fit in report.fits.items():
        colour = colour_of(report, name)
        reference = fit.polish.cost if fit.polish is not None else fit.pso.best[1]
        curve = fit.pso.convergence / reference
        rounds = np.arange(1, len(curve) + 1)
        axes.plot(rounds, curve, color=colour, drawstyle="steps-post")
        axes.plot(
            len(curve), curve[-1], marker=marker_of(report, name), color=colour, ms=4, ls="none",
            label=f"{labels[name]} {curve[-1]:.3f}", clip_on=False,
        )  # fmt: skip
    axes.axhline(1.0, color="0.3", lw=0.7, ls=(0, (4, 2)))
    axes.set_xlabel("PSO round")
    axes.set_ylabel(f"best $J$ over {'polished' if _polished(report) else 'last'} $J$")
    axes.set_xlim(0, None)
    legend_below(figure, axes)
    return figure


def _polished(report: FitResult) -> bool:
    return any(fit.polish is not None for fit in report.fits.values())


CAPTIONS = {
    "moisture": "Skin moisture of the trials (mean of the readings before and after each press), "
    "with mean ± SD per condition.",
    "area_over_force": "Gross contact area over normal force on the frames that count: measured, "
    "model driven by each trial's own force, and the power law A = kFᵐ fitted to the same frames "
    "with the same weights.",
    "force_over_time": "Normal force of all trials as recorded, aligned at first touch; the dot is "
    "the last frame that counts.",
    "example_trial": "The trial of median cost: (a) force and area over time, measured against "
    "model and power law.",
    "candidates": "Best parameters (filled) and the other top candidates (open). Grey lines: the "
    "search box.",
    "matched_trials": "One trial per condition, of about the same duration: force (left), and area "
    "with the fitted model (right).",
    "profiles": "Profile likelihoods: rise of J above its minimum along each quantity, in units of "
    "the 95 % limit (dashed). A flat curve means that the quantity is not identifiable from these "
    "data.",
    "residuals": "Residuals of the fitted model and of the power law over force, on one scale, "
    "and the distribution of the model's residuals.",
    "indentation": "Measured indentation, less the zero that was fitted in each trial, over normal "
    "force: (a) beside the model, (b) their difference.",
    "convergence": "Best J over the rounds of the particle swarm, relative to the dashed line. The "
    "legend gives the last value.",
}
"""Caption of each figure, without what only some fits have."""


def captions_of(report: FitResult) -> dict[str, str]:
    """Caption of each figure of a fit: it names what was computed."""
    found = dict(CAPTIONS)
    if report.deformed is not None:
        found["example_trial"] += (
            " (b) The full-order finger at the largest force, drawn from the deformed mesh; the "
            "dashed line is the pad at rest."
        )
    if any(fit.profiles for fit in report.fits.values()):
        found["candidates"] += (
            " Band: 95 % interval by profile likelihood; dotted ends extend to the bound."
        )
    found["convergence"] += (
        " Dashed: J after the bounded local polish, before any correction to full order."
        if _polished(report)
        else " Dashed: J of the best round."
    )
    cut = {label: name for name, label in labels_of(report).items() if label != name}
    if cut:
        read = any(np.isfinite(fit.moisture[0]) for fit in report.fits.values())
        whole = "; ".join(f"{label} = {name}" for label, name in cut.items())
        found["moisture" if read else "force_over_time"] += f" In all figures: {whole}."
    derived = report.space.derived.values()
    found["candidates"] += "".join(f" {q.symbol}: {q.meaning}" for q in derived)
    return found


FIGURES: dict[str, Callable[[FitResult], Figure | None]] = {
    "moisture": moisture_figure,
    "area_over_force": area_over_force_figure,
    "force_over_time": force_over_time_figure,
    "example_trial": example_figure,
    "candidates": candidates_figure,
    "matched_trials": matched_figure,
    "profiles": profiles_figure,
    "residuals": residuals_figure,
    "indentation": indentation_figure,
    "convergence": convergence_figure,
}
"""What draws each figure, in the order of the report."""
