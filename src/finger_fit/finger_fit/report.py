"""The report of a fit: one self-contained HTML file, its figures as PNG beside it."""

from __future__ import annotations

import base64
import html
import io
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from finger_common.files import atomic_write
from finger_model.geometry import Geometry
from finger_model.parameter_sets import PARAMETER_NAMES

from .bias import shifted_interval
from .figures import STYLE, all_figures, captions
from .fit import ConditionFit, FitReport
from .full_order_check import AREA_LIMIT, MODULUS_LIMIT
from .identifiability import QUANTITIES, quantity, quantity_deviation
from .problem import MM2, MM4, composite_modulus

PAPER_EVALUATIONS = "2 min a trial, 27,000 min (19 days) in COMSOL"
"""What the paper's search cost (Nam and Kuchenbecker 2021)."""

DISPLAY = {
    "E0": ("<i>E</i><sub>0</sub>", "kPa", 1e-3, 1),
    "E1": ("<i>E</i><sub>1</sub>", "kPa", 1e-3, 2),
    "tau1": ("<i>τ</i><sub>1</sub>", "s", 1.0, 3),
    "E2": ("<i>E</i><sub>2</sub>", "kPa", 1e-3, 0),
    "composite_E": ("<i>E</i>", "kPa", 1e-3, 2),
}
"""Symbol, unit, factor from SI and decimals in tables."""

CSS = """
:root{--ink:#1c1c1a;--soft:#6b6a64;--line:#dcd9d0;--paper:#fff;--accent:#2a7f62;--warn:#b03a48}
*{box-sizing:border-box}
body{font:16px/1.55 Georgia,'STIX Two Text','Times New Roman',serif;color:var(--ink);background:var(--paper);
 max-width:62rem;margin:2.5rem auto 5rem;padding:0 1.5rem}
h1{font-size:1.75rem;line-height:1.2;margin:0 0 .3rem;font-weight:600}
h2{font-size:1.2rem;margin:2.6rem 0 .7rem;padding-top:.7rem;border-top:1px solid var(--line);font-weight:600}
p{margin:.5rem 0 .8rem}.lead{color:var(--soft);margin-bottom:1.6rem}
figure{margin:1.4rem 0 1.8rem}figure img{width:100%;height:auto;display:block}
figure.narrow img{width:64%}
figcaption{font-size:.88rem;color:var(--soft);margin-top:.5rem;line-height:1.4}
figcaption b{color:var(--ink)}
.scroll{overflow-x:auto}
table{border-collapse:collapse;font-size:.9rem;margin:.6rem 0 1rem;width:100%;
 border-top:1.5px solid var(--ink);border-bottom:1.5px solid var(--ink)}
th{font-weight:600;text-align:right;padding:.4rem .6rem;border-bottom:.75px solid var(--ink);vertical-align:bottom}
td{text-align:right;padding:.3rem .6rem;font-variant-numeric:tabular-nums;vertical-align:top}
th:first-child,td:first-child{text-align:left;padding-left:0}
td.text,th.text{text-align:left}
td small{color:var(--soft);display:block;white-space:nowrap}
i.corrected{color:var(--accent);font-style:normal;white-space:nowrap}
.status{display:inline-block;padding:.05rem .5rem;border-radius:.7rem;font-size:.8rem;border:1px solid}
.final{color:var(--accent)}.bad{color:var(--warn)}
code{font:.82rem/1.4 ui-monospace,'DejaVu Sans Mono',monospace;overflow-wrap:anywhere}
ul{padding-left:1.2rem}li{margin:.2rem 0}
@media print{body{margin:0;max-width:none;font-size:11pt}h2{break-after:avoid}figure,table{break-inside:avoid}}
"""


def write_report(result: FitReport, folder: Path) -> Path:
    """Write report.html and figures/*.png into the folder; returns the path of the page."""
    model = next(iter(result.fits.values())).problem.model
    geometry = getattr(model, "geometry", None) or Geometry()
    figures = all_figures(result, geometry, full_order=True)
    pictures: dict[str, bytes] = {}
    with plt.rc_context(STYLE):
        for name, figure in figures.items():
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


def render(result: FitReport, pictures: dict[str, bytes]) -> str:
    """The page's HTML."""
    texts = captions(list(pictures))
    number = 0

    def figure(name: str) -> str:
        nonlocal number
        if name not in pictures:
            return ""
        number += 1
        data = base64.b64encode(pictures[name]).decode()
        kind = ' class="narrow"' if name in ("moisture", "convergence") else ""
        return (
            f'<figure{kind}><img alt="{html.escape(texts[name])}" src="data:image/png;base64,{data}">'
            f"<figcaption><b>Fig. {number}.</b> {html.escape(texts[name])}</figcaption></figure>"
        )

    trials = sum(len(fit.problem) for fit in result.fits.values())
    subjects = sorted(
        {t.subject for f in result.fits.values() for t in f.problem.trials if t.subject}
    )
    who = f" of {', '.join(map(html.escape, subjects))}" if subjects else ""
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8>",
        '<meta name=viewport content="width=device-width,initial-scale=1">',
        f"<title>Finger model fit</title><style>{CSS}</style>",
        "<h1>Viscoelastic finger model, fitted to contact area</h1>",
        f"<p class=lead>{trials} presses{who} in {len(result.fits)} "
        f"condition{'s' if len(result.fits) != 1 else ''}: "
        f"{', '.join(map(html.escape, result.fits))}. {html.escape(_origin(result))}</p>",
        _parameters_table(result),
        _verdict(result),
        "<h2>Data</h2>",
        figure("moisture"),
        figure("force_over_time"),
        _exclusions(result),
        "<h2>Area over force</h2>",
        figure("area_over_force"),
        _cost_table(result),
        "<h2>Trials</h2>",
        figure("example_trial"),
        figure("matched_trials"),
        figure("residuals"),
        "<h2>What the data can tell</h2>",
        figure("candidates"),
        figure("profiles"),
        _identifiability(result),
        "<h2>Search</h2>",
        _search(result),
        figure("convergence"),
        _candidates_table(result),
        _extras(result),
        "<h2>Provenance</h2>",
        _provenance(result),
    ]
    return "\n".join(part for part in parts if part) + "\n</html>\n"


def _number(value: float, name: str) -> str:
    _, _, factor, decimals = DISPLAY[name]
    return f"{value * factor:,.{decimals}f}"


def _signed(value: float) -> str:
    return f"{value:.2f}".replace("-", "−")


def _table(header: Sequence[str], rows: Sequence[Sequence[str]], text: Sequence[int] = ()) -> str:
    def cells(kind: str, row: Sequence[str]) -> str:
        return "".join(
            f"<{kind}{' class=text' if k in text else ''}>{cell}</{kind}>"
            for k, cell in enumerate(row)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f"<div class=scroll><table><tr>{cells('th', header)}</tr>{body}</table></div>"


def _interval(fit: ConditionFit, name: str) -> str:
    profile = fit.profiles.get(name)
    if profile is None:
        return ""
    if not profile.told:
        return "<small>not told by the data</small>"
    low, high = (_number(v, name) for v in profile.interval)
    return f"<small>{'≤ ' if profile.open_low else ''}{low} – {high}{' ≤' if profile.open_high else ''}</small>"


def _corrected(fit: ConditionFit, name: str) -> str:
    """The bias-corrected value and its interval; a dash for what the data cannot tell."""
    found, profile = fit.unbiased[name], fit.profiles.get(name)
    value = f"<i class=corrected>{_number(found.value, name)}</i>"
    if profile is None:
        return value
    if not profile.told:
        return "<i class=corrected>–</i>"
    low, high = (_number(v, name) for v in shifted_interval(profile, found.bias))
    return f"{value}<small>{low} – {high}</small>"


def _parameters_table(result: FitReport) -> str:
    header = ["condition", "moisture (a.u.)"]
    header += [f"{DISPLAY[n][0]} ({DISPLAY[n][1]})" for n in QUANTITIES]
    header += ["<i>J</i> (mm⁴)", "<i>J</i> power law", ""]
    rows = []
    for name, fit in result.fits.items():
        mean, deviation = fit.moisture
        row = [html.escape(name), f"{mean:.2f} ± {deviation:.2f}" if np.isfinite(mean) else "–"]
        active = fit.covariance.active if fit.covariance else {}
        for q in QUANTITIES:
            value = float(quantity(q, fit.parameters))
            mark = "<sup>†</sup>" if q in active else ""
            row.append(f"{_number(value, q)}{mark}{_interval(fit, q)}")
        kind = "final" if fit.status == "final" else "bad"
        row += [
            f"{fit.cost * MM4:,.1f}",
            f"{fit.power_law.cost * MM4:,.1f}",
            f'<span class="status {kind}">{html.escape(fit.status)}</span>',
        ]
        rows.append(row)
        if fit.unbiased:
            cells = [_corrected(fit, q) for q in QUANTITIES]
            rows.append(["<i class=corrected>bias-corrected</i>", "", *cells, "", "", ""])
    note = "<p class=lead>Small print: 95 % intervals by profile likelihood. "
    note += "<sup>†</sup> on a bound of the search box. ≤: the interval runs on to the bound."
    if any(fit.unbiased for fit in result.fits.values()):
        note += (
            " <i class=corrected>Bias-corrected</i>: the estimate and its interval without the estimate's own lean, as refits to "
            "synthetic data made at the fitted parameters measure it; they may leave the box a little. Use them to compare "
            "fingers, and the estimate, which minimises <i>J</i> inside the box, to simulate."
        )
    return _table(header, rows) + note + "</p>"


def _verdict(result: FitReport) -> str:
    lines = []
    for name, fit in result.fits.items():
        title = html.escape(name)
        if fit.status == "final":
            lines.append(
                f"<li><b>{title}</b> is final: full order and reduced order differ by "
                f"{100 * fit.full_order.rms_difference:.2f} % of the largest area (limit {100 * AREA_LIMIT:g} %), and "
                f"re-ranking the top candidates by full order changes <i>E</i> by "
                f"{100 * fit.full_order.modulus_change:.1f} % (limit {100 * MODULUS_LIMIT:g} %).</li>"
                if fit.full_order is not None
                else ""
            )
        elif fit.status == "not checked":
            lines.append(f"<li><b>{title}</b> was not checked against the full-order model.</li>")
        else:
            reasons = "; ".join(map(html.escape, fit.reasons))
            lines.append(
                f"<li><b>{title}</b> is <span class=bad>{fit.status}</span>: {reasons}.</li>"
            )
    return f"<ul>{''.join(lines)}</ul>"


def _origin(result: FitReport) -> str:
    bags = result.sources.get("bags", [])
    areas = sorted({a for bag in bags for a in bag["areas"]})
    words = {"topic": "recorded contact_area", "images": "images, measured anew"}
    made = sorted({bag["made_by"] for bag in bags if bag["made_by"]})
    text = f"Areas from {', '.join(words.get(a, a) for a in areas)}." if areas else ""
    if made:
        text += f" Recorded by: {'; '.join(made)}."
    return text


def _exclusions(result: FitReport) -> str:
    text = ""
    notes = [html.escape(note) for note in result.problems]
    if notes:
        text += f"<ul>{''.join(f'<li>{n}.</li>' for n in notes)}</ul>"
    dropped = sum(t.dropped for f in result.fits.values() for t in f.problem.trials)
    if dropped:
        text += (
            f"<p>{dropped} frames inside the window had no measurable contact and do not count.</p>"
        )
    if not result.exclusions:
        return text + "<p>No trial was excluded.</p>"
    rows = [
        [html.escape(e.label), html.escape(e.condition or "–"), html.escape(e.reason)]
        for e in result.exclusions
    ]
    return (
        text
        + f"<p>{len(rows)} trial{'s' if len(rows) != 1 else ''} excluded:</p>"
        + _table(["trial", "condition", "reason"], rows, (1, 2))
    )


def _cost_table(result: FitReport) -> str:
    rows = []
    for name, fit in result.fits.items():
        law = fit.power_law
        problem = fit.problem
        residual = problem.areas(fit.parameters)[0] - problem.measured
        full = fit.full_order
        rows.append(
            [
                html.escape(name),
                str(len(problem)),
                str(len(problem.measured)),
                f"{fit.cost * MM4:,.1f}",
                f"{full.full_costs[0] * MM4:,.1f}" if full else "–",
                f"{law.cost * MM4:,.1f}",
                f"{(law.cost - fit.cost) * MM4:,.1f}",
                f"{law.k * MM2:.2f}",
                f"{law.m:.3f}",
                f"{law.log_m:.3f}",
                f"{np.sqrt(np.mean(residual**2)) * MM2:.2f}",
            ]
        )
    header = [
        "condition", "trials", "frames", "<i>J</i> (mm⁴)", "<i>J</i> full order", "<i>J</i> power law",
        "gain", "<i>k</i> (mm²/N<sup>m</sup>)", "<i>m</i>", "log–log <i>m</i>", "RMS (mm²)",
    ]  # fmt: skip
    other = (
        "<p class=lead><i>J</i>: sum over trials of the mean squared area difference over the frames from onset "
        + (
            "to the first frame at or after the target force. "
            if result.options.window == "loading"
            else "to lift-off. "
        )
        + "The power law minimises the same <i>J</i>; log–log <i>m</i> is the slope of a regression of logarithms.</p>"
    )
    return _table(header, rows) + other + _modes(result)


def _modes(result: FitReport) -> str:
    """The other force mode's J at the fitted parameters, where it was computed."""
    modes = result.force_modes
    if not modes:
        return ""
    rows = [
        [html.escape(name), *(f"{values[m]['J']:,.1f}" for m in ("full", "paper")),
         *(f"{values[m]['composite_E'] * 1e-3:,.2f}" for m in ("full", "paper"))]
        for name, values in modes.items()
    ]  # fmt: skip
    return (
        "<p>The model driven by the force at its full rate, and low-passed and down-sampled to the frames as in the "
        "paper; each refitted:</p>"
        + _table(
            [
                "condition",
                "<i>J</i> full rate",
                "<i>J</i> as in the paper",
                "<i>E</i> (kPa) full rate",
                "<i>E</i> (kPa) as in the paper",
            ],
            rows,
        )
    )


def _identifiability(result: FitReport) -> str:
    rows, lines = [], []
    for name, fit in result.fits.items():
        if fit.covariance is None:
            continue
        c = fit.covariance
        untold = [DISPLAY[q][0] for q, p in fit.profiles.items() if not p.told]
        active = ", ".join(f"{DISPLAY[n][0]} ({end})" for n, end in c.active.items()) or "none"
        interval = fit.bootstrap_interval("composite_E")
        deviation, _ = quantity_deviation(fit.problem, "composite_E", fit.parameters, c)
        rows.append(
            [
                html.escape(name),
                active,
                _signed(c.correlation("E0", "E1")),
                _signed(c.correlation("E1", "E2")),
                f"{100 * deviation:.1f}",
                f"{interval[0] * 1e-3:.2f} – {interval[1] * 1e-3:.2f}" if interval else "–",
                f"{c.noise * MM2:.2f}",
            ]
        )
        if untold:
            lines.append(
                f"<li><b>{html.escape(name)}</b>: {', '.join(untold)} cannot be told from these trials; "
                "the value above is a place in a flat valley.</li>"
            )
    if not rows:
        return ""
    table = _table(
        ["condition", "bounds active", "corr <i>E</i><sub>0</sub>, <i>E</i><sub>1</sub>",
         "corr <i>E</i><sub>1</sub>, <i>E</i><sub>2</sub>", "SD of ln <i>E</i> (%)",
         "<i>E</i>, bootstrap 95 % (kPa)", "noise of a frame (mm²)"],
        rows, (1,),
    )  # fmt: skip
    boot = ""
    samples = next((len(f.samples) for f in result.fits.values() if f.samples is not None), 0)
    if samples:
        rows = [
            [html.escape(name)]
            + [
                f"{_number(low, q)} – {_number(high, q)}"
                for q in QUANTITIES
                for low, high in [fit.bootstrap_interval(q) or (np.nan, np.nan)]
            ]
            for name, fit in result.fits.items()
        ]
        boot = f"<p>Bootstrap over trials, {samples} samples, 95 % (percentiles):</p>" + _table(
            ["condition"] + [f"{DISPLAY[q][0]} ({DISPLAY[q][1]})" for q in QUANTITIES], rows
        )
    return table + (f"<ul>{''.join(lines)}</ul>" if lines else "") + boot


def _search(result: FitReport) -> str:
    options = result.options
    box = ", ".join(
        f"{DISPLAY[n][0]} {_number(low, n)}–{_number(high, n)} {DISPLAY[n][1]}"
        for n, (low, high) in zip(PARAMETER_NAMES, options.box())
    )
    text = (
        f"<p>Brute-force grid of {options.grid}<sup>4</sup> = {options.grid**4} points, evenly spaced in logarithm; particle "
        f"swarm of {options.particles} candidates over {options.rounds} rounds from the best grid points, seed {options.seed}. "
        f"Box: {box}{'' if not options.bounds else ' (changed from the paper)'}. "
        + (
            "A bounded local least squares follows; its share is listed apart.</p>"
            if options.polish
            else "No local polish.</p>"
        )
    )
    rows = []
    for name, fit in result.fits.items():
        polish = fit.polish
        rows.append(
            [
                html.escape(name),
                f"{fit.grid.best[1] * MM4:,.1f}",
                f"{fit.pso.best[1] * MM4:,.1f}",
                str(fit.pso.costs.size),
                f"{polish.cost * MM4:,.1f}" if polish else "–",
                str(polish.evaluations) if polish else "–",
                *(
                    [
                        "; ".join(
                            f"{r.name}: {r.cost * MM4:,.1f} → {r.polished_cost * MM4:,.1f}, "
                            + ("agrees" if r.agrees else "<b>disagrees</b>")
                            for r in fit.referees
                        )
                        or "–"
                    ]
                ),
            ]
        )
    return text + _table(
        ["condition", "<i>J</i> grid", "<i>J</i> PSO", "PSO candidates", "<i>J</i> polished",
         "polish candidates", "referees (<i>J</i> before → after polish)"],
        rows, (6,),
    )  # fmt: skip


def _candidates_table(result: FitReport) -> str:
    rows = []
    for name, fit in result.fits.items():
        for k, (p, cost) in enumerate(zip(fit.top, fit.top_costs)):
            full = fit.full_order
            rows.append(
                [
                    f"{html.escape(name)} {k + 1}",
                    *(_number(float(quantity(q, p)), q) for q in QUANTITIES),
                    f"{cost * MM4:,.1f}",
                    f"{full.full_costs[k] * MM4:,.1f}" if full else "–",
                ]
            )
    changed = [
        f"<li><b>{html.escape(name)}</b>: composite <i>E</i> "
        f"{composite_modulus(fit.correction.parameters_before) * 1e-3:.2f} → {fit.composite_E * 1e-3:.2f} kPa, areas "
        f"changed by at most {100 * fit.correction.largest_factor:.1f} %, {fit.correction.rounds} rounds.</li>"
        for name, fit in result.fits.items()
        if fit.correction is not None
    ]
    text = ""
    if changed:
        text = (
            "<p>After the search, the reduced model's areas were corrected to full order around the best candidate, frame by "
            f"frame, and the fit polished once more:</p><ul>{''.join(changed)}</ul>"
        )
    header = ["candidate"] + [f"{DISPLAY[q][0]} ({DISPLAY[q][1]})" for q in QUANTITIES]
    return (
        text
        + "<p>Top distinct candidates, by both models:</p>"
        + _table([*header, "<i>J</i> reduced", "<i>J</i> full order"], rows)
    )


def _extras(result: FitReport) -> str:
    parts = []
    if result.shared:
        shared = result.shared
        rows = [
            [html.escape(name), *(_number(v[n], n) for n in PARAMETER_NAMES), f"{v['J']:,.1f}"]
            for name, v in shared["conditions"].items()
        ]
        parts.append(
            f"<p>Joint fit with {', '.join(DISPLAY[n][0] for n in shared['parameters'])} shared by all conditions: "
            f"<i>J</i> = {shared['J']:,.1f} mm⁴, against {shared['J_separate']:,.1f} mm⁴ apart.</p>"
            + _table(["condition"] + [f"{DISPLAY[n][0]} ({DISPLAY[n][1]})" for n in PARAMETER_NAMES] + ["<i>J</i> (mm⁴)"], rows)
        )  # fmt: skip
    if result.thickness:
        rows = [
            [html.escape(name), f"{v['epidermis_thickness'] * 1e3:.3f}", f"{v['sd_log'] * 100:.0f}",
             *(_number(v[n], n) for n in PARAMETER_NAMES), f"{v['J']:,.1f}"]
            for name, v in result.thickness.items()
        ]  # fmt: skip
        parts.append(
            "<p>Epidermis thickness as a fifth parameter (full-order ratios of area at three thicknesses):</p>"
            + _table(["condition", "thickness (mm)", "SD of its ln (%)"] + [f"{DISPLAY[n][0]} ({DISPLAY[n][1]})" for n in PARAMETER_NAMES] + ["<i>J</i> (mm⁴)"], rows)
        )  # fmt: skip
    return "<h2>Further fits</h2>" + "".join(parts) if parts else ""


def _provenance(result: FitReport) -> str:
    sources = result.sources
    rows = [
        ["software", html.escape(str(sources.get("software_version", "–")))],
        ["Python, NumPy, SciPy, pymoo", html.escape(", ".join([platform.python_version(), *map(_version, ("numpy", "scipy", "pymoo"))]))],
        ["seed", str(result.options.seed)],
        ["geometry", f"<code>{html.escape(str(sources.get('geometry_hash', '–')))}</code>"],
        ["reduced model", f"<code>{html.escape(str(sources.get('reduced_model_hash', '–')))}</code>"],
        ["reduced model's measured error", _model_error(dict(sources.get("reduced_model_error", {})))],
        ["search box", "the paper's" if not result.options.bounds else html.escape(", ".join(result.options.bounds))],
        ["time", html.escape(", ".join(f"{k} {v:.1f} s" for k, v in result.seconds.items()) + f" (the paper: {PAPER_EVALUATIONS})")],
    ]  # fmt: skip
    options = {
        k: v
        for k, v in result.options.to_dict().items()
        if v != type(result.options)().to_dict()[k]
    }
    rows.append(
        [
            "options other than default",
            html.escape(", ".join(f"{k} = {v}" for k, v in options.items()) or "none"),
        ]
    )
    table = _table(["item", "value"], rows, (1,))
    bags = sources.get("bags", [])
    if bags:
        table += "<details><summary>Bags</summary>" + _table(
            ["bag", "trials", "areas", "force", "SHA-256"],
            [
                [html.escape(b["bag"]), str(b["trials"]), html.escape(", ".join(b["areas"])),
                 html.escape(b["force"]), f"<code>{b['sha256']}</code>"]
                for b in bags
            ],
            (2, 3, 4),
        ) + "</details>"  # fmt: skip
    return table


def _model_error(error: dict[str, float]) -> str:
    """The reduced model's error against full order, as its file records it."""
    if not {"pairs", "rms_p99", "worst_p99"} <= set(error):
        return "–"
    return (
        f"area {100 * error['rms_p99']:.2f} % RMS and {100 * error['worst_p99']:.2f} % at the worst instant, in % of a "
        f"history's largest area, at the 99th percentile of {error['pairs']:g} histories held out from its training"
    )


def _version(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return f"{package} –"


__all__ = ["render", "write_report"]
