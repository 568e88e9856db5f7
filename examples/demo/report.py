"""The demo's report: figures, one HTML page that needs nothing else, a summary for the terminal."""

from __future__ import annotations

import base64
import html
import json
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from finger_common.files import atomic_write
from finger_fit.report.provenance import model_error
from finger_fit.report_units import three_digits

from . import figures
from .results import PARAMETERS, ConditionResult, DemoResult, gather, live_press, true_trials
from .session import SessionRequest


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
body{font:15px/1.55 system-ui,sans-serif;color:#222;max-width:960px}
body{margin:2.2em auto;padding:0 1.2em}
h1{font-size:1.7em;margin:0 0 .2em} h2{font-size:1.15em;margin:2em 0 .4em}
p.lead{color:#555;margin:.2em 0 1.4em} img{max-width:100%;height:auto}
table{border-collapse:collapse;margin:.6em 0;font-variant-numeric:tabular-nums}
th,td{padding:.28em .55em;text-align:right;border-bottom:1px solid #e2e2e2}
th:first-child,td:first-child{text-align:left}
thead th{border-bottom:2px solid #999;font-weight:600}
td.c{font-weight:600;padding-left:.5em} .note{color:#555;font-size:.92em} figure{margin:.8em 0}
figure.narrow img{max-width:68%} td{white-space:nowrap}
td small{display:block;color:#555;white-space:nowrap}
@media screen{table{display:block;overflow-x:auto}}
@media screen and (max-width:60em){table{font-size:.86em} th,td{padding:.28em .4em}}
@page{size:A4;margin:16mm 14mm 18mm}
@media print{
 body{margin:0;padding:0;max-width:none;font-size:9.5pt;line-height:1.4}
 h1{font-size:15pt} h2{font-size:12pt;margin:5mm 0 2mm} h1,h2{break-after:avoid}
 figure,table,tr{break-inside:avoid} img{max-height:112mm;display:block}
 table{font-size:8pt;width:100%} th,td{padding:.8mm 1.2mm} p{orphans:3;widows:3}
}
"""


def page_of(results: list[ConditionResult], result: DemoResult, folder: Path) -> str:
    """The HTML page with its pictures inside."""

    def picture(name: str, text: str) -> str:
        data = base64.b64encode((folder / f"{name}.png").read_bytes()).decode()
        kind = ' class="narrow"' if name in ("cost", "moisture") else ""
        source = f"data:image/png;base64,{data}"
        return f'<figure{kind}><img alt="{html.escape(text)}" src="{source}"></figure>'

    trials = sum(len(r.curves) for r in results)
    day = result.fit.sources.get("date")
    date = f" Fitted on {html.escape(day)}." if day else ""
    conditions = f"{len(results)} moisture condition{'s' * (len(results) != 1)}"
    bars = (
        "Bars are 95 % intervals by profile likelihood; for a parameter that is not identifiable "
        "from these data, the bar extends to the ends of the search box. "
        if any(r.intervals for r in results)
        else ""
    )
    seconds, sources = result.seconds, result.fit.sources
    excluded = "".join(
        f"<li>{html.escape(e.label)}: {html.escape(e.reason)}</li>" for e in result.fit.exclusions
    )
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>A finger on glass: demo report</title>
<meta name="viewport" content="width=device-width,initial-scale=1">
<style>{CSS}</style></head><body><main>
<h1>A finger on glass</h1>
<p class="lead">{trials} presses of a simulated finger in {conditions},
recorded over DDS by the whole suite, replayed from their bags and fitted. The estimates receive the
finger only through CAN frames, camera images and lines of a moisture probe.{date}</p>
{picture("live", "One press as it was published live")}
<p class="note">One press as it was published live: the frame at the largest contact with its
measured outline (print pixelated), the force with the cue at 1.35 N, and the contact area: measured
in images, estimated at the force rate with the shipped parameters, and true.</p>
<h2>Area over force and over time</h2>
{picture("area", "Measured area against the fitted model")}
<h2>Fitted parameters beside the true ones</h2>
{parameter_table(results)}
{picture("parameters", "Fitted over true value of each parameter")}
<p class="note">{bars}So few presses tell little of a single parameter, although the model describes
their areas well: E2, E1 and E0 can replace one another in part, and a small τ1 has no visible
effect. More presses make the intervals narrower.</p>
<h2>J of the model and of the power law</h2>
{picture("cost", "J of model, truth and power law")}
<p class="note">J is the sum over presses of the mean squared difference of area, on the same frames
for all three (Nam and Kuchenbecker 2021). The power law A = kF<sup>m</sup> has one k and m per
condition.</p>
<h2>Moisture</h2>
{picture("moisture", "Moisture readings by condition")}
<h2>How it was made</h2>
<ul>
<li>recording {seconds.get("record", 0):.0f} s, fit {seconds.get("fit", 0):.0f} s;
presses repeated during the session: {result.repeated}</li>
<li>reduced model: {html.escape(model_error(sources["reduced_model_error"]))}</li>
{f"<li>presses excluded from the fit:<ul>{excluded}</ul></li>" if excluded else ""}
<li>the fit's own report with grid, swarm, profiles and residuals:
<a href="fit/report.html">fit/report.html</a></li>
</ul>
<p class="note">The geometry is the default one, an assumption; the true parameters are those of the
simulated study, not of measured fingers. <a href="suite.log">suite.log</a> lists what the simulated
rig does not model.</p>
</main></body></html>
"""


def parameter_table(results: list[ConditionResult]) -> str:
    """HTML table of fitted and true parameters."""
    head = "".join(
        f"<th>{html.escape(label)} ({unit})<br>fitted / true</th>"
        for _, label, _, unit in PARAMETERS
    )
    rows = ""
    for r in results:
        cells = "".join(
            f"<td>{three_digits(r.fitted[key] * scale)} / {three_digits(r.true[key] * scale)}"
            f"{interval_text(r, key, scale)}</td>"
            for key, _, scale, _ in PARAMETERS
        )
        tint = figures.colour(r.name)
        costs = (r.cost, r.power_law_cost, r.power_law_cost - r.cost)
        cells += "".join(f"<td>{three_digits(cost)}</td>" for cost in costs)
        name = f'<td class="c" style="border-left:5px solid {tint}">{html.escape(r.name)}</td>'
        rows += f"<tr>{name}{cells}</tr>"
    head += "<th>J model<br>(mm⁴)</th><th>J power law<br>(mm⁴)</th><th>ΔJ<br>(mm⁴)</th>"
    return f"<table><thead><tr><th>condition</th>{head}</tr></thead><tbody>{rows}</tbody></table>"


def interval_text(result: ConditionResult, key: str, scale: float) -> str:
    """95 % interval of a fitted parameter, on a line of its own; nothing without one."""
    found = result.intervals.get(key)
    if found is None:
        return ""
    low, high = (three_digits(end * scale) for end in found)
    return f"<small>{low} – {high}</small>"


def print_summary(result: DemoResult, console: Console) -> None:
    """Summary table, narrow enough for 80 columns, and the report's path."""
    summary = json.loads((result.folder / "summary.json").read_text())
    (best, _, scale, unit), *others = PARAMETERS
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("condition")
    table.add_column(f"E\n{unit}", justify="right")
    table.add_column(f"E, 95 %\n{unit}", justify="right")
    for _, label, _, other_unit in others:
        table.add_column(f"{label}\n{other_unit}", justify="right")
    table.add_column("J\nmm⁴", justify="right")
    table.add_column("J, kFᵐ\nmm⁴", justify="right")
    for name, row in summary["conditions"].items():
        fitted, true = (
            [three_digits(row[which][key] * factor) for key, _, factor, _ in PARAMETERS]
            for which in ("fitted", "true")
        )
        ends = row["intervals_95"].get(best)
        interval = "–".join(three_digits(end * scale) for end in ends) if ends else ""
        costs = (three_digits(row["J"]), three_digits(row["J_power_law"]))
        table.add_row(f"{name}, fit", fitted[0], interval, *fitted[1:], *costs)
        table.add_row("true", true[0], "", *true[1:], end_section=True)
    console.print()
    console.print(table)
    console.print(
        f"{len(result.bags)} bags in {result.folder / 'sessions'}, "
        f"{result.seconds['all']:.0f} s in all"
    )
    console.print(f"[bold]report:[/bold] {result.folder / 'report.html'}", soft_wrap=True)
