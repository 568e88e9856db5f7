"""Random faults at random times on the whole simulated rig: is each named, and gone after its end?

`python scripts/random_faults.py --minutes 30 --record` writes tests/recorded_random_faults.json,
and docs/faults.md from it and the other recorded results.

Runs `finger-rig`'s nodes under its supervisor, with a recording and presses now and then. Measured
for each fault: time from its begin until `/diagnostics` names it, and from its end until it no
longer does. At the end the recorded bags are read: a gap in a stream during which nothing was
reported is a silent loss. Exit code 0 when there was no traceback, no silent loss, no fault
unnamed, and all times are within the bounds; 1 otherwise.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import faults as faults_page
from faults import GONE, NAMED

from finger_common.domains import free_domain
from finger_common.files import atomic_write

ROOT = Path(__file__).resolve().parent.parent
RECORDED = ROOT / "tests" / "recorded_random_faults.json"
GIVE_UP = 60.0
"""s after which a fault counts as never named, or never gone."""
LASTING = re.compile("recording was interrupted|messages lost: ")
"""Kept until the recording ends, as a reminder; says nothing about the present."""
GAPS = {"wrench": 0.1, "contact_state": 0.1, "contact_area": 0.5}
"""s between two stamps of a stream that count as a gap."""


class Diagnostics:
    """What `/diagnostics` shows, with the time at which it came."""

    def __init__(self, node: Any) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        self.now: dict[str, tuple[float, int, str, str]] = {}
        self.bad: list[float] = []
        """Wall times of reports of a fault of the present."""
        node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 100)

    def _take(self, array: Any) -> None:
        now = time.monotonic()
        for status in array.status:
            state = next((v.value for v in status.values if v.key == "state"), "")
            level, text = status.level[0], status.message
            self.now[status.name] = (now, level, text, state)
            if level and not LASTING.search(text):
                self.bad.append(time.time())

    def naming(self, pattern: str, since: float = 0.0) -> tuple[float, str] | None:
        """Time and text of a present report that fits, made after `since`."""
        oldest = max(since, time.monotonic() - 2.5)
        for name, (at, level, text, _) in list(self.now.items()):
            if level and at > oldest and re.search(pattern, f"{name} {text}"):
                return at, text
        return None

    def active_since(self, node: str, since: float) -> bool:
        """Whether a node has reported to be active after that time."""
        return any(
            at > since and state == "active" and f"/{node}:" in f"/{name}"
            for name, (at, _, _, state) in list(self.now.items())
        )


class Rig:
    """The simulated rig under the supervisor, and what can be done to it."""

    def __init__(self, folder: Path, domain: int) -> None:
        import rclpy
        from rcl_interfaces.srv import SetParameters
        from rclpy.executors import SingleThreadedExecutor

        from finger_bringup import nodes
        from finger_bringup.supervisor import Supervisor
        from finger_common.node import LATCHED_QOS
        from finger_msgs.msg import Trial

        self.folder = folder
        self.bags = folder / "bags"
        self.log = folder / "rig.log"
        self.tracebacks: list[str] = []
        topics = ["wrench", "contact_area", "contact_state", "moisture", "trial", "model_events"]
        entries = nodes.rig(
            folder,
            simulated=True,
            parameters={
                "simulated_rig": {
                    "width": 320, "height": 256, "refinement": 0.5, "reading_time": 0.3,
                    "upcoming": ["natural:1"],
                },
                "protocol": {"need_recorder": False},
                "recorder": {
                    "folder": str(self.bags), "record_at_start": True, "topics": topics,
                    "minimum_free": 1 << 20,
                },
                "page": {"port": 0},
            },
        )  # fmt: skip
        device = next(e for e in entries if e.name == "force").parameters
        self.can = {"channel": device["can_channel"], "options": device["can_options"]}
        self.spool = Path(next(e for e in entries if e.name == "camera").parameters["path"])
        self._output = self.log.open("w")
        specs = nodes.process_specs(entries, folder)
        self.supervisor = Supervisor(specs, line=self._line, longest_delay=2.0)
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = rclpy.create_node("observer", namespace="finger", context=self._context)
        self.diagnostics = Diagnostics(self.node)
        self._set = self.node.create_client(SetParameters, "simulated_rig/set_parameters")
        self._trial_type = Trial
        self._trials = self.node.create_publisher(Trial, "trial", LATCHED_QOS)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._spinning = threading.Thread(target=self._spin, daemon=True)
        self._ending = threading.Event()
        self._spinning.start()
        self.supervisor.start()

    def _spin(self) -> None:
        while not self._ending.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def _line(self, name: str, text: str) -> None:
        print(f"{time.time():.3f} {name}: {text}", file=self._output, flush=True)
        if "Traceback" in text:
            self.tracebacks.append(f"{name}: {text}")

    def close(self) -> None:
        self.supervisor.stop()
        self._ending.set()
        self._spinning.join(5)
        self.node.destroy_node()
        self._context.try_shutdown()
        self._output.close()

    def until(self, condition: Callable[[], Any], seconds: float) -> Any:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if found := condition():
                return found
            time.sleep(0.02)
        return None

    # Things to do ----------------------------------------------------------------------------

    def show(self, *faults: str) -> None:
        """Let the simulated devices show these faults."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        parameter = Parameter("faults", value=list(faults) or [""]).to_parameter_msg()
        future = self._set.call_async(SetParameters.Request(parameters=[parameter]))
        assert self.until(future.done, 30), f"no answer of the simulated rig to {faults}"
        (result,) = future.result().results
        assert result.successful, result.reason

    def press(self, number: int) -> None:
        """Have the participant press."""
        for phase in (self._trial_type.PHASE_PREPARE, self._trial_type.PHASE_PRESS):
            trial = self._trial_type(condition="natural", index=0, attempt=0, phase=phase)
            trial.subject = f"F{number}"
            self._trials.publish(trial)

    def readings(self) -> None:
        """Have the participant take moisture readings."""
        phase = self._trial_type.PHASE_MOISTURE_BEFORE
        self._trials.publish(self._trial_type(condition="natural", phase=phase))

    def send_signal(self, name: str, number: signal.Signals) -> None:
        pid = self.supervisor.process_id(name)
        if pid is not None:
            os.kill(pid, number)

    def newest_bag(self) -> Path:
        return max(self.bags.iterdir(), key=lambda p: p.stat().st_mtime)


@dataclass
class Fault:
    """One kind of fault.

    shown: regular expression of the report that names it. lasts: s at least and at most. back: node
    that must be active again before it counts as ended, for one that was killed.
    """

    name: str
    shown: str
    begin: Callable[[Rig], Any]
    end: Callable[[Rig], Any] = lambda rig: None
    lasts: tuple[float, float] = (2.5, 5.0)
    back: str = ""


def device_fault(fault: str, shown: str) -> Fault:
    return Fault(fault, shown, lambda rig: rig.show(fault), lambda rig: rig.show())


def killed(node: str) -> Fault:
    shown = f"(no answer from|not active): .*\\b{node}\\b"
    kill = signal.SIGKILL
    return Fault(f"{node} killed", shown, lambda r: r.send_signal(node, kill), back=node)


def stopped(node: str) -> Fault:
    return Fault(
        f"{node} stands still",
        f"no answer from: .*\\b{node}\\b",
        lambda rig: rig.send_signal(node, signal.SIGSTOP),
        lambda rig: rig.send_signal(node, signal.SIGCONT),
    )


class Intruder:
    """Another program on the CAN bus."""

    def __init__(self, action: Callable[[Any], None], period: float) -> None:
        self._action, self._period = action, period
        self._ending = threading.Event()

    def begin(self, rig: Rig) -> None:
        self._ending.clear()
        self._thread = threading.Thread(target=self._run, args=(rig,), daemon=True)
        self._thread.start()

    def _run(self, rig: Rig) -> None:
        from finger_driver.can_bus import open_bus

        with open_bus("udp_multicast", rig.can["channel"], options=rig.can["options"]) as bus:
            while not self._ending.wait(self._period):
                self._action(bus)

    def end(self, rig: Rig) -> None:
        self._ending.set()
        self._thread.join()


def second_board(bus: Any) -> None:
    """Answer each request as a board of the same base identifier would, with other values."""
    import numpy as np

    from finger_driver.can_bus import frame
    from finger_driver.protocols import netcanoem

    while (asked := bus.recv(0.02)) is not None:
        if asked.arbitration_id == 0x200 and asked.dlc == 0:
            first, second = netcanoem.encode_gauges(0, np.full(6, 999))
            bus.send(frame(0x200, first))
            bus.send(frame(0x201, second))


def wrong_lengths(bus: Any) -> None:
    """Frames of the board's identifier, but of other lengths."""
    from finger_driver.can_bus import frame

    for length in (3, 5, 7):
        bus.send(frame(0x200, bytes(length)))


def limit_files(rig: Rig, size: int) -> None:
    pid = rig.supervisor.process_id("recorder")
    if pid is not None:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


def faults() -> list[Fault]:
    """All kinds."""
    boards, lengths = Intruder(second_board, 0.0), Intruder(wrong_lengths, 0.01)
    silent = "force.*(no reply|no answer|no sample|no complete)"
    camera_silent = "camera.*no sample"
    found = [
        device_fault("force silent", silent),
        device_fault("force no_second", silent),
        device_fault("force wrong_length", "force.*does not belong"),
        device_fault("force duplicate", "force.*does not belong"),
        device_fault("force error_frame", "force.*error frames"),
        device_fault("force saturated", "force.*gauge 3 is saturated"),
        device_fault("force status 0x0002", "force.*DAC/ADC check too high"),
        device_fault("force status 0x0800", "force.*temperature too high"),
        device_fault("force status 0x4000", "force.*CAN bus error"),
        device_fault("camera silent", camera_silent),
        device_fault("camera frozen", "camera.*same image"),
        device_fault("camera damaged", "camera.*not an image"),
        device_fault("moisture unplugged", "moisture.*serial port"),
        Fault(
            "second board on the CAN bus", "force.*(two different replies|does not belong)",
            boards.begin, boards.end,
        ),
        Fault("frames of wrong length", "force.*does not belong", lengths.begin, lengths.end),
        Fault(
            "camera folder renamed", camera_silent + "|camera.*(folder|read)",
            lambda rig: rig.spool.rename(rig.spool.with_name("away")),
            lambda rig: rig.spool.with_name("away").rename(rig.spool),
        ),
        Fault(
            "bag removed while recording", "recorder.*NOT RECORDING",
            lambda rig: shutil.rmtree(rig.newest_bag()), lasts=(0.0, 0.0),
        ),
        Fault(
            "files cannot grow", "recorder.*NOT RECORDING",
            lambda rig: limit_files(rig, 1),
            lambda rig: limit_files(rig, resource.RLIM_INFINITY),
        ),
    ]  # fmt: skip
    nodes = ("force", "camera", "moisture", "vision", "model", "recorder", "protocol")
    found += [killed(node) for node in nodes]
    found += [stopped(node) for node in (*nodes, "simulated_rig")]
    return found


@dataclass
class Result:
    """Times in s, None for never; what was said."""

    fault: str
    named: float | None
    gone: float | None
    text: str = ""
    restart: float | None = None


@dataclass
class Run:
    """Everything found."""

    minutes: float
    seed: int
    results: list[Result] = field(default_factory=list)
    tracebacks: list[str] = field(default_factory=list)
    silent_losses: list[str] = field(default_factory=list)
    gaps: int = 0
    messages: int = 0

    def late(self, named: float, gone: float) -> list[Result]:
        """Those outside the bounds."""
        return [
            r
            for r in self.results
            if r.named is None or r.named > named or r.gone is None or r.gone > gone
        ]


def show_one(rig: Rig, fault: Fault, random_: random.Random) -> Result:
    """Begin a fault, end it after a while, and measure."""
    # What the last fault left behind must not pass for this one.
    rig.until(lambda: rig.diagnostics.naming(fault.shown) is None, GIVE_UP)
    begun = time.monotonic()
    fault.begin(rig)
    first = rig.until(lambda: rig.diagnostics.naming(fault.shown, begun), GIVE_UP)
    left = random_.uniform(*fault.lasts) - (time.monotonic() - begun)
    time.sleep(max(left, 0.0))
    fault.end(rig)
    ended, restart = time.monotonic(), None
    if fault.back:
        # Ended when the node is there again, however long its restart takes.
        rig.until(lambda: rig.diagnostics.active_since(fault.back, begun + 1.0), GIVE_UP)
        ended = time.monotonic()
        restart = ended - begun
    gone = rig.until(
        lambda: rig.diagnostics.naming(fault.shown) is None and time.monotonic(), GIVE_UP
    )
    # What is shown no longer ended with the report that came instead.
    return Result(
        fault.name,
        None if first is None else max(0.0, first[0] - begun),
        None if gone is None else max(0.0, gone - ended),
        "" if first is None else first[1],
        restart,
    )


def read_losses(rig: Rig, run: Run) -> None:
    """Gaps in the recorded streams during which nothing was reported."""
    from finger_bag.cdr_layout import stamp_of_cdr
    from finger_bag.reader import open_bag
    from finger_common.errors import InputError

    stamps: dict[str, list[int]] = {name: [] for name in GAPS}
    for path in sorted(rig.bags.iterdir()):
        try:
            with open_bag(path) as reader:
                for name, found in stamps.items():
                    for message in reader.messages([f"/finger/{name}"]):
                        found.append(stamp_of_cdr(message.raw))
        except InputError as error:
            print(f"  {path.name}: {error}")
    bad = sorted(rig.diagnostics.bad)
    for name, found in stamps.items():
        found.sort()
        run.messages += len(found)
        for a, b in itertools.pairwise(found):
            if (b - a) * 1e-9 <= GAPS[name]:
                continue
            run.gaps += 1
            if not any(a * 1e-9 - 1.0 <= t <= b * 1e-9 + 3.0 for t in bad):
                run.silent_losses.append(f"{name}: {(b - a) * 1e-9:.2f} s at {a * 1e-9:.3f}")


def measure(minutes: float, seed: int, folder: Path, only: str = "") -> Run:
    """Run the rig and show it faults, those whose name contains `only`."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    domain = free_domain()
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    random_ = random.Random(seed)
    run = Run(minutes, seed)
    rig = Rig(folder, domain)
    try:
        began = time.monotonic()
        up = rig.until(lambda: "active:" in rig.log.read_text(), 300) and rig.until(
            lambda: rig.diagnostics.active_since("recorder", 0), 60
        )
        assert up, f"the rig did not come up:\n{rig.log.read_text()[-3000:]}"
        print(f"up after {time.monotonic() - began:.1f} s", flush=True)
        rig.readings()
        time.sleep(3)
        kinds = [fault for fault in faults() if only in fault.name]
        begun, waiting, number = time.monotonic(), [], 0
        while time.monotonic() - begun < minutes * 60:
            if not waiting:
                # Each kind once before any comes again.
                waiting = random_.sample(kinds, len(kinds))
            fault = waiting.pop()
            if number % 4 == 0:
                rig.press(number)
            number += 1
            time.sleep(random_.uniform(0.5, 3.0))
            print(f"{time.monotonic() - begun:7.1f} s  {fault.name}", flush=True)
            result = show_one(rig, fault, random_)
            run.results.append(result)
            print(
                f"           named after "
                f"{seconds(result.named)}, gone after {seconds(result.gone)}"
                + (f", back after {result.restart:.1f} s" if result.restart else ""),
                flush=True,
            )
        time.sleep(3)
    finally:
        rig.close()
    run.tracebacks = rig.tracebacks
    read_losses(rig, run)
    if run.tracebacks or run.silent_losses:
        kept = Path(tempfile.gettempdir()) / f"random_faults_{os.getpid()}.log"
        shutil.copy(rig.log, kept)
        print(f"log: {kept}")
    return run


def seconds(value: float | None) -> str:
    return "never" if value is None else f"{value:.2f} s"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=20)
    parser.add_argument("--folder", type=Path, help="folder to keep the run in")
    parser.add_argument("--named", type=float, default=NAMED, help="bound in s")
    parser.add_argument("--gone", type=float, default=GONE, help="bound in s")
    parser.add_argument("--only", default="", metavar="TEXT", help="faults with this in their name")
    parser.add_argument("--record", action="store_true", help="keep the results; write the page")
    parser.add_argument("--note", default="", help="sentence for the page, such as the load")
    args = parser.parse_args()
    if not any(args.only in fault.name for fault in faults()):
        parser.error(f"no fault has '{args.only}' in its name")
    if args.only and args.record:
        parser.error("--record needs all faults, leave out --only")
    if args.folder:
        args.folder.mkdir(parents=True, exist_ok=True)
        run = measure(args.minutes, args.seed, args.folder, args.only)
    else:
        with tempfile.TemporaryDirectory(prefix="faults_") as folder:
            run = measure(args.minutes, args.seed, Path(folder), args.only)
    if args.record:
        data = {**vars(run), "note": args.note, "results": [vars(r) for r in run.results]}
        with atomic_write(RECORDED) as file:
            json.dump(data, file, ensure_ascii=False, indent=1)
            file.write("\n")
        faults_page.write()
    late = run.late(args.named, args.gone)
    print(
        f"{len(run.results)} faults, {len(late)} outside {args.named:g} s / {args.gone:g} s; "
        f"{len(run.tracebacks)} tracebacks; {run.messages} messages, {run.gaps} gaps, "
        f"{len(run.silent_losses)} silent losses"
    )
    for line in [*run.tracebacks, *run.silent_losses, *(f"late: {r}" for r in late)]:
        print(f"  {line}")
    return int(bool(late or run.tracebacks or run.silent_losses))


if __name__ == "__main__":
    sys.exit(main())
