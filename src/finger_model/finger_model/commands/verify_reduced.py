"""`finger-model verify --reduced`: error of a reduced model against full-order runs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finger_common.errors import InputError

if TYPE_CHECKING:
    from ..reduced.error import ErrorTable
    from ..reduced.model import ReducedModel
    from ..reduced.training_runs import Case, Run

SEED = 64075
"""Not that of any build: pairs that no training saw and no choice was made on."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `verify` that belong to `--reduced`."""
    parser.add_argument(
        "--reduced", action="store_true", help="measure the reduced model's error instead"
    )
    parser.add_argument("--reduced-model", metavar="FILE", help="file to verify (default: shipped)")
    parser.add_argument(
        "--pairs", type=int, default=204, help="pairs of parameters and history (default: 204)"
    )
    parser.add_argument(
        "--wide", action="store_true", help="over the whole range of parameters and 0–3 N instead"
    )
    parser.add_argument("--workers", type=int, default=2, help="processes (default: 2)")
    parser.add_argument(
        "--error-plot", metavar="PNG", help="draw the distribution and the worst pair"
    )


def wide_case(seed: int, index: int) -> Case:
    """A pair over the whole range of parameters, to a peak of 0.15–3 N."""
    import numpy as np

    from ..laws.standard_linear_solid import PARAMETERS
    from ..reduced.force_histories import KINDS, random_history, random_parameters
    from ..reduced.training_runs import Case

    rng = np.random.default_rng([seed, index, 2])
    peak = float(np.exp(rng.uniform(np.log(0.15), np.log(3.0))))
    kind = KINDS[index % len(KINDS)]
    return Case(random_parameters(rng, PARAMETERS.range), *random_history(rng, kind, peak), kind)


def run(arguments: argparse.Namespace) -> int:
    """Print the distribution; exit code 0 when it is within the limits stated in `reduction_error`, else 1."""
    from rich.console import Console
    from rich.progress import Progress

    from ..reduced.error import error_table
    from ..reduced.model import ReducedModel
    from ..reduced.training_runs import held_out_case, pool, run_all

    if arguments.checks or arguments.output:
        raise InputError("--reduced runs no other check and writes no page: leave out CHECK and -o")
    if arguments.pairs < 6:
        raise InputError(f"--pairs is {arguments.pairs}, 6 or more are needed")
    model = ReducedModel.load(arguments.reduced_model)
    make = wide_case if arguments.wide else held_out_case
    cases = [make(SEED, i) for i in range(arguments.pairs)]
    refinement = float(model.settings.get("refinement", 1.0))
    runs: list[Run] = []
    console = Console(stderr=True)
    with (
        pool(arguments.workers, model.geometry, refinement, model.friction, None) as executor,
        Progress(console=console, transient=True, disable=not console.is_terminal) as progress,
    ):
        results = run_all(executor, cases)
        for found, _ in progress.track(results, total=len(cases), description="full-order runs"):
            runs.append(found)
    table = error_table(model, runs)
    print(table.text())
    if arguments.error_plot:
        plot(model, runs, table, arguments.error_plot)
    if arguments.wide:
        return 0
    return 0 if table.share_within() >= 0.99 and table.none_beyond() else 1


def plot(model: ReducedModel, runs: list[Run], table: ErrorTable, path: str | Path) -> None:
    """Distribution of the errors over the pairs, and the worst pair over time, as PNG."""
    import numpy as np
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    share = np.linspace(0, 100, len(table.pairs))
    left.plot(share, np.sort([100 * p.rms for p in table.pairs]), label="RMS over the history")
    left.plot(share, np.sort([100 * p.worst for p in table.pairs]), label="worst instant")
    left.axhline(1, color="C0", ls=":")
    left.axhline(2, color="C1", ls=":")
    left.set(xlabel="share of the pairs (%)", ylabel="error of area (% of the largest)", ylim=0)
    left.legend()
    worst = max(table.pairs, key=lambda p: p.worst)
    run = next(r for r in runs if np.array_equal(r.parameters, worst.parameters))
    found = model.simulate(run.parameters, run.time, np.minimum(run.force, model.range["force"][1]))
    right.plot(run.time, run.area * 1e6, "k", label="full order")
    right.plot(run.time, found.area * 1e6, "C3--", label="reduced")
    right.set(xlabel="time (s)", ylabel="area (mm²)", title=f"worst pair ({run.kind})")
    right.legend()
    figure.savefig(path, dpi=130)
