"""A small simulated study, from the finger on the plate to fitted parameters and a report.

    python examples/demo -o out/demo

The simulated rig, drivers, vision, model, recorder and protocol run as processes over DDS. Each
press is recorded into a bag; while the next one is recorded, the bag is replayed through vision and
model from its images alone. Then the parameters are fitted and compared with the true ones of the
simulated finger.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from rich.console import Console

from finger_bringup.nodes import OWN_PARAMETERS
from finger_common.cli import Parser, run
from finger_common.errors import FingerError, InputError
from finger_common.processes import begin_worker, worker_pool
from finger_fit.cli import Screen

from .report import print_summary, write_report
from .results import DemoResult
from .session import LOG, SessionRequest, record_session

STAGES = {
    "prepare": "preparing the finger",
    "moisture_before": "moisture readings before",
    "clear": "waiting for an empty frame",
    "press": "press",
    "lift": "lift",
    "moisture_after": "moisture readings after",
    "closing": "closing the bag",
    "done": "done",
    "failed": "to be redone",
    "finished": "finished",
}


def parser() -> Parser:
    """Arguments."""
    arguments = Parser(
        prog="python examples/demo",
        description="Record, replay and fit a small simulated study; write report.html.",
        example="python examples/demo -o out/demo",
    )
    arguments.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    arguments.add_argument(
        "--trials", type=int, default=3, help="presses per condition, at least 3 (default: 3)"
    )
    arguments.add_argument(
        "--conditions",
        nargs="+",
        default=["dry", "natural", "moist"],
        help="moisture conditions (default: all three)",
    )
    arguments.add_argument("--seed", type=int, default=1, help="seed of the simulated study")
    arguments.add_argument("--domain", type=int, help="ROS domain (default: a free one)")
    arguments.add_argument(
        "--quick", action="store_true", help="leave out profiles, bias and the full-order check"
    )
    return arguments


# Replay --------------------------------------------------------------------------------------


def _begin_worker() -> None:
    import signal

    begin_worker()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Live nodes come first.
    os.nice(10)


def replay(bag: Path, target: Path) -> tuple[Path, int, int]:
    """Run vision and model over a bag's images; returns target, number of states and of areas."""
    from finger_offline.process import process
    from finger_offline.process_options import ProcessOptions

    result = process(bag, target, ProcessOptions(images="yes"))
    return target, result.states, result.areas


# The job -------------------------------------------------------------------------------------


class Demo:
    """Runs the study and shows its progress."""

    def __init__(self, arguments: Any, console: Console) -> None:
        if arguments.trials < 3:
            raise InputError(
                f"--trials is {arguments.trials}; a fit needs at least 3 presses per condition"
            )
        folder = arguments.output.absolute()
        self.console = console
        self.arguments = arguments
        self.result = DemoResult(folder)
        self.request = SessionRequest(
            folder,
            tuple(arguments.conditions),
            arguments.trials,
            arguments.seed,
            domain=arguments.domain,
        )
        self._presses = len(self.request.conditions) * self.request.trials
        self.progress = Screen()
        self.clock = time.monotonic()

    def log(self, text: str) -> None:
        """Print a line above the progress bars."""
        seconds = time.monotonic() - self.clock
        self.console.print(f"[dim]{seconds:5.0f} s[/dim]  {text}", soft_wrap=True)

    def run(self) -> DemoResult:
        """All stages; raises FingerError."""
        clear_folder(self.result.folder)
        with self.progress:
            self._record_and_replay()
            self._fit()
            self._write()
        self.result.seconds["all"] = time.monotonic() - self.clock
        return self.result

    def _record_and_replay(self) -> None:
        self._recorded, self._state = 0, "starting"
        self._show_recorded()
        target = self.result.folder / "processed"
        start = time.monotonic()
        with worker_pool(1, _begin_worker) as pool:
            futures: list[Future[Any]] = []

            def replay_next(bag: Path) -> None:
                self.result.bags.append(bag)
                futures.append(pool.submit(replay, bag, target / bag.name))

            # Closed also after an error, so that no process outlives the demo.
            with contextlib.closing(record_session(self.request)) as events:
                for event in events:
                    self._on_event(event, replay_next)
            self.result.seconds["record"] = time.monotonic() - start
            for future in self.progress.track(futures, "replay bags", self._presses):
                path, _, _ = future.result()
                self.result.processed.append(path)
        self.result.seconds["replay after recording"] = (
            time.monotonic() - start - self.result.seconds["record"]
        )
        self.log(f"{len(self.result.processed)} bags replayed through vision and model")

    def _show_recorded(self) -> None:
        self.progress.update("record presses", self._recorded, self._presses, self._state)

    def _on_event(self, event: dict[str, Any], replay_next: Callable[[Path], None]) -> None:
        kind = event["event"]
        if kind == "started":
            self.log(f"{event['processes']} processes started")
            self._state = "waiting for all topics"
        elif kind == "ready":
            self.log("force, images, areas and contact states arrive")
        elif kind == "tared":
            self.log(event["message"])
        elif kind == "step":
            stage = event["waiting_for"] or STAGES.get(event["step"], event["step"])
            self._state = f"{event['condition']} {event['index'] + 1}: {stage}"
        elif kind == "trial" and event["verdict"] == "done":
            self._recorded += 1
            self.log(
                f"press {event['index'] + 1} ({event['condition']}): "
                f"{event['time_to_target']:.2f} s to the cue, {event['peak_force']:.2f} N at most"
            )
            name = f"{event['index']:03d}_{event['condition']}_{event['attempts'] - 1}"
            replay_next(self.request.bags / name)
        elif kind == "trial" and event["reason"]:
            self.result.repeated += 1
            self.log(
                f"press {event['index'] + 1} ({event['condition']}) is redone: {event['reason']}"
            )
        self._show_recorded()

    def _fit(self) -> None:
        from finger_fit.fingers import ALL, Fingers
        from finger_fit.options import FitOptions
        from finger_fit.study import fit_bags
        from finger_model.geometry import Geometry

        quick = self.arguments.quick
        options = FitOptions(
            full_order=not quick,
            top=1,
            profiles=not quick,
            bias_pairs=0 if quick else FitOptions.bias_pairs,
            bootstrap=0,
            seed=self.arguments.seed,
        )
        # The simulated participant has the default finger, as calipers would tell.
        measured = Fingers.load({ALL: Geometry()})
        start = time.monotonic()
        self.result.fit = fit_bags(
            self.result.processed,
            options,
            self.result.folder / "fit",
            model=measured,
            report=self.progress,
        )
        self.result.seconds["fit"] = time.monotonic() - start
        self.log(f"{len(self.result.fit.fits)} conditions fitted")

    def _write(self) -> None:
        start = time.monotonic()
        write_report(self.result, self.request)
        self.result.seconds["report"] = time.monotonic() - start


def clear_folder(folder: Path) -> None:
    """Remove what an earlier demo left; raises InputError for a folder that holds anything else,
    and for one without the log that every demo begins with."""
    known = {
        "devices", "sessions", "processed", "fit", "figures", "report.html", LOG,
        str(OWN_PARAMETERS.parent), "parameters.yaml", "summary.json",
    }  # fmt: skip
    found = sorted(p.name for p in folder.iterdir()) if folder.exists() else []
    if not found:
        return
    foreign = [name for name in found if name not in known]
    if foreign or LOG not in found:
        raise InputError(
            f"{folder}: '{(foreign or found)[0]}' was not written by the demo; choose another "
            "folder with -o"
        )
    shutil.rmtree(folder)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point with the conventions of all commands."""
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> int:
    arguments = parser().parse_args(argv)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    console = Console(highlight=False)
    demo = Demo(arguments, console)
    try:
        result = demo.run()
    except FingerError as error:
        raise type(error)(f"{error}; all output is in {demo.result.folder}") from None
    print_summary(result, console)
    return 0
