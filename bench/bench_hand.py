"""Fingers of a hand: delay and losses of `contact_state`, processor time, start-up.

Simulated boards, one process each, on the wire of the CAN bus; force and model of every finger in
one process, as `finger-rig up --fingers … --compose` runs them; a process that publishes
`contact_area` of each finger at 10 Hz; one that listens to all wrenches and contact states; and a
niced process that computes without end. For one finger at 500 Hz the vision node runs besides, on
images of 1280 × 1024 at 10 Hz.

The delay is from the stamp of the sample (its acquisition) to the arrival of its contact state in
the listening process, as the middleware there notes it. A sample is lost when its wrench arrived
and its contact state did not, or when the board's reply to a poll was lost. Processor time is that
of the nodes.

Nodes, boards (which stand for hardware) and listener (which stands for a controller) have
real-time priority, as `finger-rig up --compose --realtime` gives it; beside it stands the same
without. What the machine itself adds is measured too: how late a process wakes that does nothing
but sleep 2 ms again and again (clock_nanosleep), or wait 2 ms for a file (timerfd and epoll).

The start is that of the command `finger-rig up`, from its call to the arrival of the first contact
state; that of the estimator alone is a Python that makes one and gives it a sample.

`python bench/bench_hand.py --fingers 5 --rate 500 --duration 60 [--separate] [--realtime]` runs one
case; --separate gives each node a process of its own, --own-lengths each finger a geometry file.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import json
import os
import select
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from finger_bringup import nodes
from finger_bringup.bring_up import ALL_ACTIVE
from finger_bringup.parameter_files import ParameterFile
from finger_bringup.supervisor import Supervisor
from finger_common.domains import free_domain
from finger_common.priority import PRIORITY, run_in_real_time
from finger_common.stamps import fill_time
from finger_common.subject_code import FINGERS
from finger_model.geometry import Geometry

sys.path.insert(0, str(Path(__file__).parent))
from bench_contact_state import photograph
from rig_load import process_time

NAMESPACE = "hand"
PERIOD = 0.002
"""s from sample to sample at 500 Hz."""
SETTLING = 3.0
"""s after all nodes are active, before the figures count."""


def listen(fingers: list[str], result: Path, realtime: bool) -> None:
    """Collect stamps and times of arrival until SIGTERM; writes them."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import WrenchStamped
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    from finger_bag.cdr_layout import stamp_of_cdr
    from finger_common.node import PolledSubscription
    from finger_msgs.msg import ContactState

    rclpy.init()
    node = rclpy.create_node("listener", namespace=f"/{NAMESPACE}")
    qos = QoSProfile(depth=5000, reliability=ReliabilityPolicy.BEST_EFFORT)
    streams = {
        (finger, topic): PolledSubscription(node, kind, f"{finger}/{topic}", qos)
        for finger in fingers
        for topic, kind in (("contact_state", ContactState), ("wrench", WrenchStamped))
    }
    found: dict[tuple[str, str], list[tuple[int, int]]] = {key: [] for key in streams}
    figures: dict[str, dict[str, str]] = {}

    def diagnose(message: Any) -> None:
        for status in message.status:
            figures[status.name] = {v.key: v.value for v in status.values}

    node.create_subscription(DiagnosticArray, "/diagnostics", diagnose, 50)
    ending = False

    def end(*_: Any) -> None:
        nonlocal ending
        ending = True

    signal.signal(signal.SIGTERM, end)
    if realtime:
        run_in_real_time()
    first = None
    while not ending:
        rclpy.spin_once(node, timeout_sec=0.02)
        for key, stream in streams.items():
            for raw, info in stream.take():
                found[key].append((stamp_of_cdr(raw), info["received_timestamp"]))
        if first is None and any(found[f, "contact_state"] for f in fingers):
            first = time.time()
            result.with_suffix(".first").write_text(repr(first))
    tables = {f"{f} {t}": pairs for (f, t), pairs in found.items()}
    result.write_text(json.dumps({"tables": tables, "figures": figures}))
    os._exit(0)


def measure_areas(fingers: list[str]) -> None:
    """Publish `contact_area` of each finger at 10 Hz, 60 ms old, until SIGTERM."""
    import rclpy
    from rclpy.qos import QoSProfile

    from finger_msgs.msg import ContactArea, Moisture

    rclpy.init()
    node = rclpy.create_node("areas", namespace=f"/{NAMESPACE}")
    areas = [node.create_publisher(ContactArea, f"{f}/contact_area", QoSProfile(depth=5))
             for f in fingers]  # fmt: skip
    readings = [node.create_publisher(Moisture, f"{f}/moisture", QoSProfile(depth=5))
                for f in fingers]  # fmt: skip
    area, reading = ContactArea(gross_area=40e-6, area_stddev=1.5e-6), Moisture(value=69.0)
    for number in range(1_000_000):
        time.sleep(0.1)
        now = time.time_ns()
        fill_time(area.header.stamp, now - 60_000_000)
        for publisher in areas:
            publisher.publish(area)
        if number % 50 == 0:
            fill_time(reading.header.stamp, now)
            for publisher in readings:
                publisher.publish(reading)


class _Timer(ctypes.Structure):
    """struct itimerspec: interval and first, s and ns."""

    _fields_ = [(name, ctypes.c_long) for name in ("every_s", "every_ns", "first_s", "first_ns")]


def wake(duration: float, result: Path) -> None:
    """Sleep PERIOD again and again, then wait for a timer as long; writes by how much it was late.

    ms; p50, p99, p99.9 and the largest of each.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    timer = libc.timerfd_create(time.CLOCK_MONOTONIC, 0)
    queue = select.epoll()
    queue.register(timer, select.EPOLLIN)

    def await_timer(seconds: float) -> None:
        libc.timerfd_settime(timer, 0, ctypes.byref(_Timer(0, 0, 0, int(seconds * 1e9) or 1)), None)
        queue.poll()
        os.read(timer, 8)

    found = {}
    for name, pause in (("sleep", time.sleep), ("timer", await_timer)):
        late = []
        end = time.monotonic() + duration / 2
        while (now := time.monotonic()) < end:
            pause(PERIOD)
            late.append((time.monotonic() - now - PERIOD) * 1e3)
        found[name] = np.percentile(late, [50, 99, 99.9, 100]).tolist()
    result.write_text(json.dumps(found))


def lateness(duration: float, loaded: bool, realtime: bool) -> dict[str, list[float]]:
    """What `wake` finds in a process of its own, beside a niced one that computes, or alone."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "late.json"
        load = _niced_load() if loaded else None
        try:
            command = [sys.executable, __file__, "--role", "wake", "--result", str(result)]
            command += ["--duration", str(duration), *["--realtime"] * realtime]
            subprocess.run(command, check=True)
        finally:
            if load is not None:
                load.kill()
                load.wait()
        found: dict[str, list[float]] = json.loads(result.read_text())
        return found


def _niced_load() -> subprocess.Popen[bytes]:
    command = ["nice", "-n", "19", sys.executable, "-c", "while True: pass"]
    load = subprocess.Popen(command, start_new_session=True)
    # Linux weighs sessions (autogroups) first: a niced process alone in its own is not low.
    with contextlib.suppress(OSError):
        Path(f"/proc/{load.pid}/autogroup").write_text("19")
    return load


class Case:
    """One run. `result` has what the processes found."""

    def __init__(
        self,
        fingers: int,
        rate: float,
        separate: bool = False,
        realtime: bool = False,
        own_lengths: bool = False,
    ) -> None:
        self.fingers = list(FINGERS[:fingers])
        self.own_lengths = own_lengths
        self.rate = rate
        self.separate = separate
        self.realtime = realtime
        self.vision = fingers == 1 and rate <= 500
        self._children: list[subprocess.Popen[bytes]] = []

    def _start(self, *arguments: Any) -> subprocess.Popen[bytes]:
        command = [sys.executable, *map(str, arguments)]
        child = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        self._children.append(child)
        return child

    def run(self, duration: float, start_only: bool = False) -> dict[str, Any]:
        """Bring all up, measure for some seconds, end all."""
        os.environ["ROS_DOMAIN_ID"] = str(free_domain())
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        os.environ["OMP_NUM_THREADS"] = "1"
        with tempfile.TemporaryDirectory() as folder:
            try:
                return self._run(Path(folder), duration, start_only)
            finally:
                for child in self._children:
                    if child.poll() is None:
                        os.killpg(child.pid, signal.SIGKILL)
                    child.wait()

    def _run(self, folder: Path, duration: float, start_only: bool) -> dict[str, Any]:
        boards, devices = nodes.simulated_boards(self.fingers)
        for board in boards:
            started = self._start(*board.command[1:])
            if self.realtime:
                with contextlib.suppress(OSError):
                    os.sched_setscheduler(started.pid, os.SCHED_FIFO, os.sched_param(PRIORITY))
        result = folder / "found.json"
        names = ",".join(self.fingers)
        listener = self._start(
            *(__file__, "--role", "listen", "--names", names, "--result", result),
            *["--realtime"] * self.realtime,
        )
        if not start_only:
            self._start(__file__, "--role", "areas", "--names", names)
            self._children.append(_niced_load())
        if self.vision and not start_only:
            here = f"/{NAMESPACE}/{self.fingers[0]}"
            self._start(
                *("-m", "finger_vision.vision_node", "--ros-args", "-r", f"__ns:={here}"),
                *("-r", "contact_area:=contact_area_seen", "-p", "area_per_pixel:=9.86e-10"),
            )
            self._start(__file__, "--role", "photograph", "--names", f"{here}/image_raw")
        time.sleep(8.0)  # the other processes have started
        own = folder / "hand.yaml"
        values: dict[str, Any] = {"/**/force": {"rate": self.rate}}
        if self.own_lengths:
            for number, finger in enumerate(self.fingers):
                file = folder / f"{finger}.yaml"
                pad = Geometry().pad_semi_axis_radial * (0.9 + 0.04 * number)
                lengths = replace(Geometry(), pad_semi_axis_radial=pad)
                file.write_text(yaml.safe_dump(lengths.to_dict()))
                values[f"/**/{finger}/model"] = {"geometry_file": str(file)}
        own.write_text(yaml.safe_dump({k: {"ros__parameters": v} for k, v in values.items()}))
        if start_only:
            return {"start": self._command_start(folder, own, devices, result)}
        entries = nodes.hand(self.fingers, parameters=devices)
        specs = nodes.process_specs(
            entries,
            folder,
            NAMESPACE,
            ParameterFile(own),
            compose=not self.separate,
            realtime=self.realtime,
        )
        lines: list[str] = []
        began = time.time()
        supervisor = Supervisor(specs, lambda name, text: lines.append(text))
        supervisor.start()
        try:
            end = time.monotonic() + 240
            while not any(ALL_ACTIVE in text for text in lines):
                if time.monotonic() > end:
                    raise RuntimeError("the nodes did not come up: " + "\n".join(lines[-20:]))
                time.sleep(0.05)
            first = result.with_suffix(".first")
            while not first.exists():
                if time.monotonic() > end:
                    raise RuntimeError("no contact state came: " + "\n".join(lines[-20:]))
                time.sleep(0.05)
            start = float(first.read_text()) - began
            time.sleep(SETTLING)
            pids = [supervisor.process_id(spec.name) for spec in specs]
            cpu, window = _total(pids), [time.time_ns(), 0]
            time.sleep(duration)
            cpu = (_total(pids) - cpu) / duration
            window[1] = time.time_ns()
            time.sleep(1.0)
        finally:
            supervisor.stop()
        time.sleep(1.0)
        listener.terminate()
        listener.wait(60)
        return {**self._evaluate(json.loads(result.read_text()), window), "cpu": cpu,
                "start": start}  # fmt: skip

    def _command_start(
        self, folder: Path, own: Path, devices: dict[str, Any], result: Path
    ) -> float:
        """Seconds from the call of `finger-rig up` to the first contact state."""
        known = yaml.safe_load(own.read_text())
        for path, values in devices.items():
            known[f"/{NAMESPACE}/{path}"] = {"ros__parameters": values}
        own.write_text(yaml.safe_dump(known))
        began = time.time()
        rig = self._start(
            *("-m", "finger_bringup.cli", "up", "--fingers", *self.fingers, "--compose"),
            *("--parameters", own, "--folder", folder / "rig"),
        )
        first = result.with_suffix(".first")
        end = time.monotonic() + 240
        while not (first.exists() and first.read_text()):
            if time.monotonic() > end or rig.poll() is not None:
                raise RuntimeError("no contact state came")
            time.sleep(0.05)
        rig.terminate()
        rig.wait(60)
        return float(first.read_text()) - began

    def _evaluate(self, found: dict[str, Any], window: list[int]) -> dict[str, Any]:
        delays, lost, samples, overruns = [], 0, 0, 0
        for finger in self.fingers:
            states = np.array(found["tables"][f"{finger} contact_state"], np.int64).reshape(-1, 2)
            wrenches = np.array(found["tables"][f"{finger} wrench"], np.int64).reshape(-1, 2)
            # A sample in the window, and its state whenever that came.
            stamps = wrenches[:, 0]
            stamps = stamps[(stamps > window[0]) & (stamps < window[1])]
            lost += len(np.setdiff1d(stamps, states[:, 0]))
            samples += len(stamps)
            inside = (states[:, 0] > window[0]) & (states[:, 0] < window[1])
            delays.append((states[inside, 1] - states[inside, 0]) * 1e-6)
        for name, values in found["figures"].items():
            if name.endswith(": force"):
                lost += int(values.get("lost", 0))
                overruns += int(values.get("overrun", 0))
        model = {
            name: (values.get("age_p50_ms"), values.get("age_p99_ms"))
            for name, values in found["figures"].items()
            if name.endswith("contact state")
        }
        every = np.concatenate(delays)
        share = samples / (len(self.fingers) * self.rate * (window[1] - window[0]) * 1e-9)
        quantiles = np.percentile(every, [50, 99, 99.9, 100])
        return {
            **dict(zip(("p50", "p99", "p999", "max"), quantiles)),
            "lost": lost,
            "samples": samples,
            "share": share,
            "overruns": overruns,
            "age": model,
        }


def _total(pids: list[int | None]) -> float:
    return sum(process_time(pid) or 0.0 for pid in pids if pid is not None)


def in_words(case: Case, found: dict[str, Any]) -> str:
    """One line of a run."""
    how = "each node a process" if case.separate else "one process"
    how += ", in real time" if case.realtime else ""
    how += ", fingers of their own lengths" if case.own_lengths else ""
    return (
        f"{len(case.fingers)} × {case.rate:.0f} Hz, {how}: p50 {found['p50']:.2f} p99 "
        f"{found['p99']:.2f} p99.9 {found['p999']:.2f} max {found['max']:.1f} ms, lost "
        f"{found['lost']} of {found['samples']}, {found['share']:.1%} of the polls "
        f"({found['overruns']} left out), {found['cpu']:.2f} cores, first estimate after "
        f"{found['start']:.1f} s" + (", vision node running" if case.vision else "")
    )


def estimator_start(runs: int) -> float:
    """Median of the seconds from the call of Python to a first estimate, without ROS.

    What Python does afterwards to end, some 0.2 s, is not counted.
    """
    code = (
        "from finger_model.estimator import ContactEstimator; "
        "from finger_model.finger import load_reduced; "
        "found = ContactEstimator(load_reduced()).add_wrench(1, (0.0, 0.0, 0.0)); "
        "assert found; print('found', flush=True)"
    )
    took = []
    for _ in range(runs + 1):
        began = time.perf_counter()
        with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
            said = process.stdout.readline() if process.stdout else b""
            took.append(time.perf_counter() - began)
        if not said or process.returncode:
            raise RuntimeError("no estimate")
    return statistics.median(took[1:])


def run(report: Any) -> None:
    """Benchmark entry point."""
    duration = 10.0 if report.quick else 60.0
    for loaded in (False, True):
        for realtime in (False, True):
            found = lateness(duration / 3, loaded, realtime)
            report.note(
                f"a process that only sleeps 2 ms, {'beside a niced load' if loaded else 'alone'}"
                f"{', in real time' if realtime else ''}: late by "
                + "; ".join(
                    f"p50 {v[0]:.2f} p99 {v[1]:.2f} p99.9 {v[2]:.2f} max {v[3]:.1f} ms ({name})"
                    for name, v in found.items()
                )
            )
            if loaded:
                name = "realtime_wake_late_p99" if realtime else "wake_late_p99"
                report.add(name, found["sleep"][1], "ms")
    five = Case(5, 500.0, realtime=True)
    found = five.run(duration)
    report.note(in_words(five, found))
    report.add("five_fingers_p99", found["p99"], "ms", 2.0)
    report.add("five_fingers_p999", found["p999"], "ms", 6.0)
    report.add("five_fingers_lost", found["lost"], "count", 0)
    report.add("five_fingers_cpu", found["cpu"], "cores", 1.2)
    own = Case(5, 500.0, realtime=True, own_lengths=True)
    found = own.run(duration)
    report.note(in_words(own, found))
    report.add("five_own_fingers_p99", found["p99"], "ms", 2.0)
    report.add("five_own_fingers_p999", found["p999"], "ms", 6.0)
    for name, rate, goal in (("one_khz", 1000.0, 1.0), ("one_finger", 500.0, 0.7)):
        case = Case(1, rate, realtime=True)
        found = case.run(duration)
        report.note(in_words(case, found))
        report.add(f"{name}_p99", found["p99"], "ms", goal)
        report.add(f"{name}_lost", found["lost"], "count", 0)
    usual = Case(5, 500.0)
    report.note(in_words(usual, usual.run(duration)))
    starts = [Case(5, 500.0).run(0.0, start_only=True)["start"] for _ in range(3)]
    report.add("start_to_estimate", statistics.median(starts), "s", 5.0)
    report.add("estimator_start", estimator_start(5), "s", 1.0)


def main() -> None:
    """Run one role, or one case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--role", choices=("listen", "areas", "photograph", "wake"))
    parser.add_argument("--names", default="")
    parser.add_argument("--result", type=Path)
    parser.add_argument("--fingers", type=int, default=5)
    parser.add_argument("--rate", type=float, default=500.0)
    parser.add_argument("--duration", type=float, default=10.0)
    parser.add_argument("--separate", action="store_true")
    parser.add_argument("--realtime", action="store_true")
    parser.add_argument("--own-lengths", action="store_true")
    args = parser.parse_args()
    names = args.names.split(",")
    if args.role == "listen":
        listen(names, args.result, args.realtime)
    elif args.role == "wake":
        if args.realtime:
            run_in_real_time()
        wake(args.duration, args.result)
    elif args.role == "areas":
        measure_areas(names)
    elif args.role == "photograph":
        photograph(args.names)
    else:
        case = Case(args.fingers, args.rate, args.separate, args.realtime, args.own_lengths)
        found = case.run(args.duration)
        print(in_words(case, found), found["age"])


if __name__ == "__main__":
    main()
