"""The demo's report: figures, one HTML page that needs nothing else, a summary for the terminal."""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from finger_bag.reader import open_bag
from finger_common.files import atomic_write
from finger_fit.fit import ConditionFit
from finger_fit.problem import MM2, MM4
from finger_model.reduced import ReducedModel
from finger_offline.image_areas import calibration_of
from finger_offline.trials import TrialRecord, load_trials
from finger_sim.conditions import STUDY
from finger_vision.messages import image_of

from . import demo_figures as figures
from .demo_figures import PARAMETERS, ConditionResult, LivePress, TrialCurve
from .demo_session import SessionRequest

if TYPE_CHECKING:
    from .demo import DemoResult

PIXELATED = 12
"""Pixels of a block in pictures of prints: prints are biometric data, simulated ones are shown alike."""


# Gathering -----------------------------------------------------------------------------------


Truths = dict[tuple[str, int, int], dict[str, Any]]
"""What really happened, by condition, index and attempt."""


def true_trials(folder: Path) -> Truths:
    """The truth files of a simulated rig."""
    found: Truths = {}
    for path in sorted(folder.glob("*.json")):
        truth = json.loads(path.read_text())
        request = truth["request"]
        found[request["condition"], request["index"], request["attempt"]] = truth
    return found


def condition_result(
    fit: ConditionFit, records: Sequence[TrialRecord], model: ReducedModel, truth: Truths
) -> ConditionResult:
    """A condition's result as plain data for the figures; records (of all conditions) are the fit's trials."""
    name = fit.condition
    material = STUDY[name].material
    true = dict(zip(("E0", "E1", "tau1", "E2"), material.vector()))
    true["composite_E"] = material.composite_modulus
    fitted = dict(zip(("E0", "E1", "tau1", "E2"), map(float, fit.parameters)))
    fitted["composite_E"] = fit.composite_E
    intervals: dict[str, tuple[float, float] | None] = {}
    for key, profile in fit.profiles.items():
        low, high = profile.interval
        box_low, box_high = profile.values.min(), profile.values.max()
        intervals[key] = (
            float(low) if np.isfinite(low) else float(box_low),
            float(high) if np.isfinite(high) else float(box_high),
        )
    true_cost = float(fit.problem.cost(material.vector()[None])[0]) * MM4
    by_index = {r.index: r for r in records if r.condition == name}
    curves = [
        trial_curve(by_index[trial.index], trial.area, fit, model, truth)
        for trial in fit.problem.trials
    ]
    return ConditionResult(
        name,
        fitted,
        true,
        intervals,
        fit.cost * MM4,
        fit.power_law.cost * MM4,
        true_cost,
        fit.power_law.k,
        fit.power_law.m,
        [trial.readings.tolist() for trial in fit.problem.trials],
        (STUDY[name].moisture, STUDY[name].moisture_sd),
        curves,
    )


def trial_curve(
    record: TrialRecord,
    counted: np.ndarray,
    fit: ConditionFit,
    model: ReducedModel,
    truth: Truths,
) -> TrialCurve:
    """One press from onset to lift-off: frames, the fitted model driven by the recorded force, the truth.

    counted: the areas that count in J.
    """
    really = truth[record.condition, record.index, record.attempt]
    onset_ns = really["start_ns"] + round(really["press"]["onset"] * 1e9)
    end = really["press"]["lift_off"] - really["press"]["onset"] + 0.05
    time = (record.stamp_ns - onset_ns) * 1e-9
    # Means over 10 ms keep the sensor's noise from driving the model.
    bins = np.unique(np.round(time / 0.01).astype(int), return_inverse=True)[1]
    number = np.bincount(bins)
    time = np.bincount(bins, time) / number
    force = np.maximum(np.bincount(bins, record.force) / number, 0.0)
    history = model.simulate(fit.parameters, time, force)
    shown = (time > -0.02) & (time < end)
    frame_time = (record.area_stamp_ns - onset_ns) * 1e-9
    framed = (frame_time > -0.02) & (frame_time < end) & (record.area > 0)
    true_time = np.array(really["time_s"]) - really["press"]["onset"]
    inside = (true_time >= 0) & (true_time < end)
    return TrialCurve(
        record.index,
        frame_time[framed],
        np.interp(frame_time[framed], time, force),
        record.area[framed] * MM2,
        np.isin(record.area[framed], counted),
        time[shown],
        force[shown],
        history.area[shown] * MM2,
        true_time[inside],
        np.array(really["area_m2"])[inside] * MM2,
    )


def live_press(bag: Path, truth: dict[str, Any]) -> LivePress:
    """What the suite published live, from a bag as recorded."""
    stamp, force, area, deviation = [], [], [], []
    frames: list[tuple[int, float]] = []
    largest: tuple[float, int, np.ndarray] = (-1.0, 0, np.empty((0, 2)))
    with open_bag(bag) as reader:
        topics = {t.rsplit("/", 1)[-1]: t for t in reader.info.topics}
        wanted = [topics["contact_state"], topics["contact_area"]]
        for item in reader.messages(wanted):
            message = item.message
            at = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            if item.topic == topics["contact_state"]:
                stamp.append(at)
                force.append(message.normal_force)
                area.append(message.area * MM2)
                deviation.append(message.area_stddev * MM2)
            else:
                frames.append((at, message.gross_area * MM2))
                if message.gross_area > largest[0]:
                    hull = np.array([(p.x, p.y) for p in message.hull])
                    largest = (message.gross_area, at, hull)
        picture = next(
            image_of(item.message)
            for item in reader.messages([topics["image_raw"]])
            if item.message.header.stamp.sec * 1_000_000_000 + item.message.header.stamp.nanosec
            == largest[1]
        )
    outline = outline_in_pixels(bag, largest[2], picture.shape)
    start = truth["start_ns"]
    time = (np.array(stamp) - start) * 1e-9
    end = truth["press"]["lift_off"] + 0.2
    inside = (time > 0) & (time < end)
    frame_time = (np.array([at for at, _ in frames]) - start) * 1e-9
    frame_inside = (frame_time > 0) & (frame_time < end)
    true_time = np.array(truth["time_s"])
    return LivePress(
        truth["request"]["condition"],
        time[inside],
        np.array(force)[inside],
        np.array(area)[inside],
        np.array(deviation)[inside],
        frame_time[frame_inside],
        np.array([a for _, a in frames])[frame_inside],
        true_time[true_time < end],
        (np.array(truth["area_m2"]) * MM2)[true_time < end],
        pixelate(picture),
        outline,
    )


def outline_in_pixels(bag: Path, hull: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Outline (n, 2) in pixels by the calibration attached to the bag."""
    if not len(hull):
        return hull
    with open_bag(bag) as reader:
        calibration = calibration_of(reader)
    return calibration.to_pixels(hull, shape[1], shape[0])


def pixelate(image: np.ndarray, block: int = PIXELATED) -> np.ndarray:
    """Image (H, W) uint8 in blocks coarser than the ridges."""
    height, width = (n - n % block for n in image.shape)
    blocks = image[:height, :width].reshape(height // block, block, width // block, block)
    coarse = blocks.mean(axis=(1, 3)).astype(np.uint8)
    return np.kron(coarse, np.ones((block, block), np.uint8))


# Writing -------------------------------------------------------------------------------------


def gather(result: DemoResult, request: SessionRequest) -> list[ConditionResult]:
    """All conditions' results."""
    model = ReducedModel.load()
    truth = true_trials(request.truth)
    records = load_trials(result.processed).trials
    return [condition_result(fit, records, model, truth) for fit in result.fit.fits.values()]


def write_report(result: DemoResult, request: SessionRequest) -> Path:
    """Write figures, summary.json and report.html; returns the report's path."""
    results = gather(result, request)
    folder = result.folder / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    figures.area_figure(results, folder / "area.png")
    figures.moisture_figure(results, folder / "moisture.png")
    figures.parameter_figure(results, folder / "parameters.png")
    figures.cost_figure(results, folder / "cost.png")
    truth = true_trials(request.truth)
    shown = next((b for b in result.bags if "natural" in b.name), result.bags[-1])
    index, condition, attempt = shown.name.split("_")
    really = truth[condition, int(index), int(attempt)]
    figures.live_figure(live_press(shown, really), folder / "live.png")
    summary = summary_of(results, result)
    with atomic_write(result.folder / "summary.json") as file:
        json.dump(summary, file, indent=1)
    page = result.folder / "report.html"
    with atomic_write(page) as file:
        file.write(page_of(results, result, folder))
    return page


def summary_of(results: list[ConditionResult], result: DemoResult) -> dict[str, Any]:
    """The main figures as plain data: SI, J in mm⁴."""
    return {
        "conditions": {
            r.name: {
                "fitted": dict(r.fitted),
                "true": dict(r.true),
                "intervals_95": dict(r.intervals),
                "J": r.cost,
                "J_true_parameters": r.true_cost,
                "J_power_law": r.power_law_cost,
                "power_law_m": r.m,
                "trials": len(r.curves),
            }
            for r in results
        },
        "repeated_presses": result.repeated,
        "seconds": result.seconds,
    }


CSS = """
body{font:15px/1.55 system-ui,sans-serif;color:#222;max-width:960px;margin:2.2em auto;padding:0 1.2em}
h1{font-size:1.7em;margin:0 0 .2em} h2{font-size:1.15em;margin:2em 0 .4em}
p.lead{color:#555;margin:.2em 0 1.4em} img{max-width:100%;height:auto}
table{border-collapse:collapse;margin:.6em 0;font-variant-numeric:tabular-nums}
th,td{padding:.28em .8em;text-align:right;border-bottom:1px solid #e2e2e2}
th:first-child,td:first-child{text-align:left} thead th{border-bottom:2px solid #999;font-weight:600}
td.c{font-weight:600} .note{color:#555;font-size:.92em} figure{margin:.8em 0}
"""


def page_of(results: list[ConditionResult], result: DemoResult, folder: Path) -> str:
    """The HTML page with its pictures inside."""

    def picture(name: str, text: str) -> str:
        data = base64.b64encode((folder / f"{name}.png").read_bytes()).decode()
        return (
            f'<figure><img alt="{html.escape(text)}" src="data:image/png;base64,{data}"></figure>'
        )

    trials = sum(len(r.curves) for r in results)
    seconds = result.seconds
    excluded = "".join(
        f"<li>{html.escape(e.label)}: {html.escape(e.reason)}</li>" for e in result.fit.exclusions
    )
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>A finger on glass: demo report</title>
<style>{CSS}</style></head><body>
<h1>A finger on glass</h1>
<p class="lead">{trials} presses of a simulated finger in {len(results)} moisture conditions, recorded over DDS by
the whole suite, replayed from their bags and fitted. The estimates know the finger only through CAN frames, camera
pictures and lines of a moisture probe.</p>
{picture("live", "One press as it was published live")}
<p class="note">One press as it was published live: the frame at the largest contact with its measured outline (print
pixelated), the force with the cue at 1.35 N, and the contact area: measured in pictures, estimated at the force rate
with the shipped parameters, and true.</p>
<h2>Area over force and over time</h2>
{picture("area", "Measured area against the fitted model")}
<h2>Fitted parameters beside the true ones</h2>
{parameter_table(results)}
{picture("parameters", "Fitted over true value of each parameter")}
<p class="note">Bars are 95 % intervals by profile likelihood; where the data cannot tell a parameter, the bar runs to
the ends of the search box. At presses of 0.5–2 s only the composite modulus E and E2 are well told: E0 and E1 trade
off, and a small τ1 cannot be seen.</p>
<h2>J of the model and of the power law</h2>
{picture("cost", "J of model, truth and power law")}
<p class="note">J is the sum over presses of the mean squared difference of area, on the same frames for all three (Nam
and Kuchenbecker 2021). The power law A = kF<sup>m</sup> has one k and m per condition.</p>
<h2>Moisture</h2>
{picture("moisture", "Moisture readings by condition")}
<h2>How it was made</h2>
<ul>
<li>recording {seconds.get("record", 0):.0f} s, fit {seconds.get("fit", 0):.0f} s; presses redone on the spot:
{result.repeated}</li>
<li>reduced model: {html.escape(error_text(result))}</li>
{f"<li>presses left out of the fit:<ul>{excluded}</ul></li>" if excluded else ""}
<li>the fit's own report with grid, swarm, profiles and residuals: <a href="fit/report.html">fit/report.html</a></li>
</ul>
<p class="note">The geometry is the default one, an assumption; the truth is the study truth of the documentation, not
measured fingers. What the rig does not model is said in <a href="suite.log">suite.log</a>.</p>
</body></html>
"""


def error_text(result: DemoResult) -> str:
    """The reduced model's own statement of its error."""
    error = result.fit.sources.get("reduced_model_error")
    if isinstance(error, dict):
        return ", ".join(f"{k} {v:.3g}" for k, v in error.items() if isinstance(v, (int, float)))
    return str(error)


def parameter_table(results: list[ConditionResult]) -> str:
    """HTML table of fitted and true parameters."""
    head = "".join(
        f"<th>{html.escape(label)} ({unit})<br>fitted / true</th>"
        for _, label, _, unit in PARAMETERS
    )
    rows = ""
    for r in results:
        cells = "".join(
            f"<td>{r.fitted[key] * scale:.4g} / {r.true[key] * scale:.4g}</td>"
            for key, _, scale, _ in PARAMETERS
        )
        tint = figures.colour(r.name)
        rows += f'<tr><td class="c" style="color:{tint}">{html.escape(r.name)}</td>{cells}</tr>'
    return f"<table><thead><tr><th></th>{head}</tr></thead><tbody>{rows}</tbody></table>"


def three_digits(value: float) -> str:
    """At least three significant digits, never an exponent."""
    digits = max(0, 2 - math.floor(math.log10(abs(value)))) if value else 0
    return f"{value:.{digits}f}"


def print_summary(result: DemoResult, console: Console) -> None:
    """Summary table and the report's path."""
    summary = json.loads((result.folder / "summary.json").read_text())
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("condition")
    table.add_column("")
    for _, label, _, unit in PARAMETERS:
        table.add_column(f"{label.split(' = ')[0]}\n{unit}", justify="right")
    table.add_column("J\nmm⁴", justify="right")
    table.add_column("power law\nJ, mm⁴", justify="right")
    for name, row in summary["conditions"].items():
        fitted, true = (
            [three_digits(row[which][key] * scale) for key, _, scale, _ in PARAMETERS]
            for which in ("fitted", "true")
        )
        table.add_row(
            name, "fitted", *fitted, three_digits(row["J"]), three_digits(row["J_power_law"])
        )
        table.add_row("", "true", *true, end_section=True)
    console.print()
    console.print(table)
    console.print(
        f"{len(result.bags)} bags in {result.folder / 'sessions'}, "
        f"{result.seconds['all']:.0f} s in all"
    )
    console.print(f"[bold]report:[/bold] {result.folder / 'report.html'}", soft_wrap=True)
