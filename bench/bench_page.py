"""Operator's page: time from the force sample that reaches the target to the cue on the screen.

page_cue_latency_p50 and _p99: a stand-in rig in this process publishes force at 500 Hz, areas at
10 Hz and readings; the protocol node, the page node and a headless browser run as separate
processes. page_cue_latency_rig_p50 and _p99: the whole simulated rig runs beside them (devices,
drivers, vision, model, recorder), which nearly fills two cores. The browser notes when the frame
with the cue to lift was given to the screen, on the same clock. Not included: the delay of the
screen, and those of a real sensor and driver.
"""

from __future__ import annotations

import importlib.util
import itertools
import os
import random
import shutil
import socket
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from finger_bag.reader import open_bag
from finger_bringup.supervisor import ProcessSpec, Supervisor
from finger_common.domains import free_domain
from finger_common.stamps import header_stamp

TARGET = 1.35  # N
NAMESPACE = ("-r", "__ns:=/finger")
OPTIONS = (
    "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync"
).split()

WATCH = """
window.shown = [];
new MutationObserver(() => {
  const look = document.getElementById("cue").dataset.look;
  requestAnimationFrame(() => {
    const channel = new MessageChannel();
    const now = () => performance.timeOrigin + performance.now();
    channel.port1.onmessage = () => window.shown.push([look, now()]);
    channel.port2.postMessage(0);
  });
}).observe(document.getElementById("cue"), {attributes: true, attributeFilter: ["data-look"]});
"""


class StandIn(threading.Thread):
    """A stand-in rig: presses at the cue to press, lifts 0.3 s after the cue to lift."""

    def __init__(self, domain: int) -> None:
        super().__init__(daemon=True)
        self.domain = domain
        self.stop = threading.Event()
        self.crossings: list[float] = []
        self.step = ""

    def run(self) -> None:
        import rclpy
        from geometry_msgs.msg import WrenchStamped
        from rclpy.qos import qos_profile_sensor_data as stream

        from finger_common.node import LATCHED_QOS
        from finger_msgs.msg import ContactArea, SessionStatus, Trial

        context = rclpy.Context()
        rclpy.init(context=context, domain_id=self.domain)
        node = rclpy.create_node("stand_in", namespace="finger", context=context)
        executor = rclpy.executors.SingleThreadedExecutor(context=context)
        executor.add_node(node)
        wrench = node.create_publisher(WrenchStamped, "wrench", stream)
        areas = node.create_publisher(ContactArea, "contact_area", stream)
        phase = [0]

        def on_status(message: SessionStatus) -> None:
            self.step = message.step

        node.create_subscription(
            Trial, "trial", lambda m: phase.__setitem__(0, m.phase), LATCHED_QOS
        )
        node.create_subscription(SessionStatus, "protocol/status", on_status, LATCHED_QOS)
        force, lifting, rising = 0.0, 0.0, True
        next_time = time.time()
        count = 0
        while not self.stop.is_set():
            executor.spin_once(timeout_sec=0.0)
            now = time.time()
            if now < next_time:
                time.sleep(max(min(next_time - now, 0.002), 0))
                continue
            next_time = max(next_time + 0.002, now - 0.02)
            if phase[0] == Trial.PHASE_PRESS and rising:
                force += 0.004 + random.random() * 0.0005
            if force >= TARGET and rising:
                self.crossings.append(now)
                rising, lifting = False, now + 0.3
            if not rising and now > lifting:
                force = max(force - 0.02, 0.0)
                if force == 0.0 and phase[0] != Trial.PHASE_LIFT:
                    rising = True
            message = WrenchStamped()
            message.header.stamp.sec = int(now)
            message.header.stamp.nanosec = int((now % 1) * 1e9)
            message.wrench.force.z = -force
            wrench.publish(message)
            count += 1
            if count % 50 == 0:
                area = ContactArea(
                    gross_area=4e-5 if force > 0.02 else 0.0, flags=0 if force > 0.02 else 1
                )
                area.header.stamp = message.header.stamp
                areas.publish(area)
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


def chromium() -> str | None:
    """Path of an installed browser."""
    return next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
    )


def node(module: str, *parameters: str) -> ProcessSpec:
    """One node of finger_operator as a process."""
    flags = [flag for p in parameters for flag in ("-p", p)]
    command = (sys.executable, "-m", f"finger_operator.{module}", "--ros-args", *NAMESPACE, *flags)
    return ProcessSpec(module, command, restart=False)


def quietly(*specs: ProcessSpec) -> Supervisor:
    """Keeps nodes running for a `with` block, without their output."""
    return Supervisor(specs, line=lambda name, text: None)


@contextmanager
def watched_page(path: str, port: int) -> Iterator[Any]:
    """The operator's page in a headless browser that notes when it shows which cue."""
    from playwright.sync_api import sync_playwright

    url = f"http://127.0.0.1:{port}/"
    end = time.monotonic() + 60
    while True:
        try:
            urllib.request.urlopen(url, timeout=1).close()
            break
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.2)
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=OPTIONS)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(url)
        page.wait_for_selector("#link.good", timeout=60000)
        page.evaluate(WATCH)
        yield page
        browser.close()


def delays(page: Any, crossings: list[float]) -> np.ndarray:
    """ms from each crossing (s) to the frame with its cue to lift; infinite where none came."""
    lifts = np.array([t / 1e3 for look, t in page.evaluate("window.shown") if look == "lift"])
    found = []
    for crossing, following in itertools.pairwise([*sorted(crossings), np.inf]):
        own = lifts[(lifts >= crossing) & (lifts < following)]
        found.append((own[0] - crossing) * 1e3 if len(own) else np.inf)
    return np.array(found)


def free_port() -> int:
    """An unused TCP port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def with_stand_in(path: str, presses: int, folder: Path) -> np.ndarray:
    """Delays (presses,) in ms with the stand-in rig."""
    domain, port = free_domain(), free_port()
    os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    protocol = node(
        "protocol_node", f"output:={folder}", "subject:=S01", "conditions:=[natural]",
        f"trials:={presses}", "readings:=0", "need_recorder:=false", "confirm_preparation:=false",
        "verdict_time:=0.2", "clear_time:=0.2", "release_time:=0.1", "gap_limit:=1.0",
        "frame_gap_limit:=2.0", "stale_after:=2.0",
    )  # fmt: skip
    rig = StandIn(domain)
    with quietly(protocol, node("page_node", f"port:={port}")):
        rig.start()
        try:
            with watched_page(path, port) as page:
                page.wait_for_selector("#cue[data-look=closed]", timeout=60000)
                page.keyboard.press("Space")
                page.fill("#plan-subject", "S01")
                page.click("#plan-start")
                last = time.monotonic() + 30 + 8 * presses
                while rig.step != "finished" and time.monotonic() < last:
                    page.wait_for_timeout(200)
                return delays(page, rig.crossings)
        finally:
            rig.stop.set()
            rig.join(3)


def with_whole_rig(path: str, presses: int, folder: Path) -> np.ndarray:
    """Delays (presses,) in ms with the whole simulated rig; its bags hold when cues were due."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))
    from demo.session import SessionRequest, record_session

    port = free_port()
    relaxed = {"readings": 0, "gap_limit": 1.0, "frame_gap_limit": 2.0, "stale_after": 2.0}
    request = SessionRequest(
        folder, conditions=("natural",), trials=presses, parameters={"protocol": relaxed}
    )
    with closing(record_session(request)) as session:
        # The session has chosen its domain when it has started.
        next(session)
        with quietly(node("page_node", f"port:={port}")), watched_page(path, port) as page:
            for _ in session:
                pass
            return delays(page, cues_to_lift(request.bags))


def cues_to_lift(bags: Path) -> list[float]:
    """Times (s) of the force samples that reached the target, from the bags of a session."""
    from finger_msgs.msg import Trial

    times = []
    for bag in sorted(p for p in bags.iterdir() if p.is_dir()):
        with open_bag(bag) as reader:
            for m in reader.messages([reader.topic("trial")]):
                if m.message.phase == Trial.PHASE_LIFT:
                    times.append(header_stamp(m.message) * 1e-9)
    return times


def run(report: Any) -> None:
    """Register the figures with the benchmark's report."""
    path = chromium()
    if path is None or importlib.util.find_spec("playwright") is None:
        report.note("page: no browser or no playwright here, cue latency not measured")
        return
    for measure, infix, presses in (
        (with_stand_in, "", 12 if report.quick else 40),
        (with_whole_rig, "rig_", 6 if report.quick else 25),
    ):
        with tempfile.TemporaryDirectory(prefix="bench_page_") as folder:
            found = measure(path, presses, Path(folder))
        seen = found[np.isfinite(found)]
        if not len(seen):
            report.note("page: no cue was seen; see whether the nodes ran")
            continue
        for q in (50, 99):
            name = f"page_cue_latency_{infix}p{q}"
            report.add(name, float(np.percentile(seen, q)), "ms", 50, "lower")
        report.note(
            f"page: {len(seen)} cues of {len(found)} presses, worst {seen.max():.1f} ms, from the "
            "stamp of the force sample to the frame with the cue in a headless browser on this "
            "machine"
        )
