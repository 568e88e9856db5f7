"""Figures of the demo's report, each from plain data."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from finger_fit.report_units import three_digits
from finger_model.paper import TARGET_FORCE

from .results import PARAMETERS, ConditionResult, LivePress

COLOURS = {"dry": "#D55E00", "natural": "#009E73", "moist": "#0072B2"}
"""Okabe and Ito's colour-blind-safe palette."""

TRUTH = "#222222"


def style() -> None:
    """Look of all figures."""
    plt.rcParams.update(
        {
            "figure.dpi": 130,
            "savefig.dpi": 160,
            "savefig.bbox": "tight",
            "font.size": 9,
            "axes.titlesize": 10,
            "axes.titleweight": "bold",
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.grid": True,
            "grid.color": "#e4e4e4",
            "grid.linewidth": 0.6,
            "axes.axisbelow": True,
            "legend.frameon": False,
            "legend.fontsize": 8,
        }
    )


def colour(name: str) -> str:
    """Colour of a condition."""
    return COLOURS.get(name, "#555555")


def legend_below(figure: Figure, *axes: Axes) -> None:
    """One legend for the axes, below them: it covers no curve; in grey, as the colours differ."""
    entries: dict[str, Any] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels()):
            entries.setdefault(label, handle)
    number = min(4, len(entries))
    figure.legend(entries.values(), entries, loc="upper center", ncol=number,
                  bbox_to_anchor=(0.5, 0.0))  # fmt: skip


def area_figure(results: Sequence[ConditionResult], path: Path) -> None:
    """Area over force and over time: measured frames, fitted model, truth, power law."""
    style()
    figure, axes = plt.subplots(
        len(results), 2, figsize=(9.2, 2.4 * len(results)), squeeze=False, sharex="col",
        sharey=True,
    )  # fmt: skip
    for (left, right), result in zip(axes, results):
        tint = colour(result.name)
        for number, curve in enumerate(result.curves):
            first = number == 0
            out = ~curve.counted
            for axis, x in ((left, curve.frame_force), (right, curve.frame_time)):
                axis.plot(
                    x[curve.counted],
                    curve.frame_area[curve.counted],
                    "o",
                    ms=4,
                    color=tint,
                    mec="white",
                    mew=0.4,
                    zorder=3,
                    label="measured, counts in J" if first else None,
                )
                axis.plot(
                    x[out],
                    curve.frame_area[out],
                    "o",
                    ms=3,
                    mfc="none",
                    mec=tint,
                    mew=0.6,
                    alpha=0.6,
                    label="measured, not in J" if first else None,
                )
            loading = slice(0, int(np.argmax(curve.force)) + 1)
            left.plot(curve.force[loading], curve.area[loading], color=tint, lw=1.1, alpha=0.85,
                      label="fitted model, loading" if first else None)  # fmt: skip
            right.plot(curve.time, curve.area, color=tint, lw=1.1, alpha=0.85,
                       label="fitted model" if first else None)  # fmt: skip
            right.plot(curve.true_time, curve.true_area, color=TRUTH, lw=0.8, ls=":",
                       label="truth" if first else None)  # fmt: skip
        force = np.linspace(0.02, max(c.force.max() for c in result.curves), 100)
        left.plot(force, result.k * 1e6 * force**result.m, color=TRUTH, lw=1.0, ls="--",
                  label="power law $kF^m$")  # fmt: skip
        left.set_title(f"{result.name}: $m$ = {result.m:.2f}", loc="left", color=tint)
        left.set_ylabel("contact area (mm²)")
    # After all rows, which share the axis.
    axes[0][0].set_ylim(bottom=0)
    curves = [curve for result in results for curve in result.curves]
    axes[0][0].set_xlim(0, 1.03 * max(c.force.max() for c in curves))
    axes[0][1].set_xlim(0, 1.03 * max(c.time[-1] for c in curves))
    axes[-1][0].set_xlabel("normal force (N)")
    axes[-1][1].set_xlabel("time since onset (s)")
    figure.tight_layout()
    legend_below(figure, axes[0][0], axes[0][1])
    figure.savefig(path)
    plt.close(figure)


def moisture_figure(results: Sequence[ConditionResult], path: Path) -> None:
    """Readings by condition, trial averages, and the paper's mean and standard deviation."""
    style()
    figure, axis = plt.subplots(figsize=(6.2, 3.0))
    for row, result in enumerate(results):
        tint = colour(result.name)
        mean, deviation = result.paper_moisture
        axis.add_patch(
            plt.Rectangle(
                (mean - deviation, row - 0.36), 2 * deviation, 0.72, color=tint, alpha=0.15, lw=0
            )
        )
        axis.plot([mean, mean], [row - 0.36, row + 0.36], color=tint, lw=1.0, alpha=0.6)
        for number, readings in enumerate(result.moisture):
            offset = (number - (len(result.moisture) - 1) / 2) * 0.6 / max(len(result.moisture), 3)
            axis.plot(readings, np.full(len(readings), row + offset), "|", color=tint, ms=7)
            axis.plot(np.mean(readings), row + offset, "o", color=tint, ms=5, mec="white")
    axis.set_yticks(range(len(results)), [r.name for r in results])
    axis.set_ylim(len(results) - 0.4, -0.6)
    axis.set_xlim(0, 130)
    axis.set_xlabel("moisture (a.u.): readings |, trial averages ●, band: mean ± SD of the paper")
    axis.grid(axis="y", visible=False)
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def parameter_figure(results: Sequence[ConditionResult], path: Path) -> None:
    """Fitted over true value of each parameter, with its 95 % interval."""
    style()
    figure, axes = plt.subplots(1, len(results), figsize=(9.2, 2.7), sharey=True, squeeze=False)
    for axis, result in zip(axes[0], results):
        tint = colour(result.name)
        axis.axvline(1.0, color=TRUTH, lw=0.8, ls=":")
        axis.axvspan(0.9, 1.1, color="#000000", alpha=0.04, lw=0)
        for row, (key, _, _, _) in enumerate(PARAMETERS):
            true = result.true[key]
            interval = result.intervals.get(key)
            if interval is not None:
                axis.plot(np.array(interval) / true, [row, row], color=tint, lw=2.2, alpha=0.45)
            axis.plot(result.fitted[key] / true, row, "o", color=tint, ms=6, mec="white")
        axis.set_xscale("log")
        axis.set_xlim(0.2, 5)
        ticks = (0.25, 0.5, 1, 2, 4)
        axis.set_xticks(ticks, [f"{t:g}" for t in ticks])
        axis.minorticks_off()
        axis.set_title(result.name, loc="left", color=tint)
        axis.set_xlabel("fitted / true")
        axis.grid(axis="y", visible=False)
    axes[0][0].set_yticks(range(len(PARAMETERS)), [label for _, label, _, _ in PARAMETERS])
    axes[0][0].set_ylim(len(PARAMETERS) - 0.5, -0.5)
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def cost_figure(results: Sequence[ConditionResult], path: Path) -> None:
    """J of the fitted model, of the true parameters and of the power law."""
    style()
    figure, axis = plt.subplots(figsize=(6.2, 3.0))
    groups = (
        ("fitted model", lambda r: r.cost, 1.0),
        ("true parameters", lambda r: r.true_cost, 0.45),
        ("power law", lambda r: r.power_law_cost, 0.2),
    )
    for column, result in enumerate(results):
        for number, (_, value, alpha) in enumerate(groups):
            cost = value(result)
            x = column + (number - 1) * 0.27
            axis.bar(x, cost, 0.24, color=colour(result.name), alpha=alpha)
            axis.annotate(
                three_digits(cost), (x, cost), ha="center", va="bottom", fontsize=8, xytext=(0, 1),
                textcoords="offset points",
            )  # fmt: skip
    axis.set_yscale("log")
    axis.set_xticks(range(len(results)), [r.name for r in results])
    axis.set_ylabel("J (mm⁴)")
    axis.grid(axis="x", visible=False)
    handles = [plt.Rectangle((0, 0), 1, 1, color="#555555", alpha=a) for _, _, a in groups]
    axis.legend(handles, [label for label, _, _ in groups], ncol=3, loc="upper center",
                bbox_to_anchor=(0.5, 1.18))  # fmt: skip
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def live_figure(press: LivePress, path: Path) -> None:
    """One press over time: the frame at the largest contact, the force and the estimate."""
    style()
    figure = plt.figure(figsize=(9.2, 3.3))
    grid = figure.add_gridspec(2, 2, width_ratios=(1, 1.55), height_ratios=(1, 1.7), hspace=0.12)
    tint = colour(press.condition)
    picture = figure.add_subplot(grid[:, 0])
    picture.imshow(press.picture, cmap="gray", vmin=0, vmax=255)
    if len(press.picture_outline):
        closed = np.vstack([press.picture_outline, press.picture_outline[:1]])
        picture.plot(closed[:, 0], closed[:, 1], color=tint, lw=1.6)
    picture.set_axis_off()
    picture.set_title(f"simulated camera, {press.condition} finger", loc="left")
    force = figure.add_subplot(grid[0, 1])
    force.plot(press.time, press.force, color=TRUTH, lw=0.9)
    force.axhline(TARGET_FORCE, color="#999999", lw=0.8, ls="--")
    force.set_ylabel("force (N)")
    force.tick_params(labelbottom=False)
    area = figure.add_subplot(grid[1, 1], sharex=force)
    area.fill_between(press.time, press.area - 2 * press.area_sd, press.area + 2 * press.area_sd,
                      color=tint, alpha=0.2, lw=0, label="± 2 SD")  # fmt: skip
    area.plot(press.time, press.area, color=tint, lw=1.2, label="contact_state, 500 Hz")
    area.plot(press.frame_time, press.frame_area, "o", ms=4, color=tint, mec="white", mew=0.5,
              label="contact_area, 10 Hz")  # fmt: skip
    area.plot(press.true_time, press.true_area, color=TRUTH, lw=0.9, ls=":", label="truth")
    area.set_xlabel("time (s)")
    area.set_ylabel("area (mm²)")
    area.set_ylim(bottom=0)
    area.legend(loc="upper center", ncol=4, bbox_to_anchor=(0.5, -0.25))
    figure.savefig(path)
    plt.close(figure)
