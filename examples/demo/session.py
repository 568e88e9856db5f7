"""Records a session with the whole suite on simulated devices and reports its events."""

from __future__ import annotations

import json
import os
import queue
import signal
import threading
import time
from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from finger_bringup import nodes
from finger_bringup.supervisor import Supervisor
from finger_common.domains import free_domain
from finger_common.errors import FingerError
from finger_sim.addresses import RigAddresses

SUITE = (
    "simulated_rig",
    "force",
    "camera",
    "moisture",
    "vision",
    "model",
    "recorder",
    "protocol",
)
"""Nodes of the suite that the session needs."""

UNATTENDED = nodes.NodeEntry(
    "unattended", "demo", "unattended_node", 9, lifecycle=False, restart=False, essential=True
)
"""The node in the operator's place; the session ends with it."""

SUBJECT = "SIM1"
SESSION = "session"
LOG = "suite.log"
"""File of the output of all nodes, in the folder of a session."""


@dataclass(frozen=True)
class SessionRequest:
    """What to record.

    width, height: of a frame in pixels. reading_time: s per moisture reading. parameters: by node
    name, further ones. domain: ROS domain, None for a free one.
    """

    folder: Path
    conditions: tuple[str, ...] = ("dry", "natural", "moist")
    trials: int = 3
    seed: int = 1
    width: int = 640
    height: int = 512
    reading_time: float = 0.3
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    domain: int | None = None

    @property
    def bags(self) -> Path:
        """Folder of the recorded bags."""
        return self.folder / "sessions" / SESSION

    @property
    def truth(self) -> Path:
        """Folder of the true forces and areas, one JSON file per press."""
        return self.folder / "devices" / "truth"


def node_parameters(request: SessionRequest) -> dict[str, dict[str, Any]]:
    """Parameters of all nodes of the session, by node name."""
    addresses = RigAddresses.private(request.folder / "devices")
    parameters = nodes.simulated_devices(addresses)
    parameters["simulated_rig"] |= {
        "seed": request.seed,
        "width": request.width,
        "height": request.height,
        "reading_time": request.reading_time,
        "upcoming": [f"{name}:{request.trials}" for name in request.conditions],
    }
    parameters["protocol"] = {
        "subject": SUBJECT,
        "session": SESSION,
        "conditions": list(request.conditions),
        "trials": request.trials,
        "output": str(request.folder / "sessions"),
        "confirm_preparation": False,
        "verdict_time": 0.3,
        "stale_after": 1.0,
        "max_attempts": 20,
    }
    parameters["unattended"] = {"max_failures": 20}
    for name, values in request.parameters.items():
        parameters[name] = {**parameters.get(name, {}), **values}
    return parameters


def record_session(request: SessionRequest) -> Generator[dict[str, Any], None, None]:
    """Run the session; yields events until it is finished.

    Events are those of the unattended node ("ready", "tared", "step", "trial", "finished"), and
    "started" with the number of processes. All output goes to `LOG` in the request's folder.
    Raises FingerError when the session cannot be completed. When the iterator ends, so have all
    processes.
    """
    request.folder.mkdir(parents=True, exist_ok=True)
    os.environ["ROS_DOMAIN_ID"] = str(request.domain or free_domain())
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    examples = str(Path(__file__).resolve().parents[1])
    search = os.environ.get("PYTHONPATH", "")
    if examples not in search.split(os.pathsep):
        os.environ["PYTHONPATH"] = f"{examples}{os.pathsep}{search}".rstrip(os.pathsep)
    parameters = node_parameters(request)
    entries = nodes.select([*SUITE, UNATTENDED], parameters)
    specs = nodes.process_specs(entries, request.folder)
    events: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    errors: list[str] = []
    deaths: list[str] = []
    log_file = request.folder / LOG
    with log_file.open("w") as log:

        def line(name: str, text: str) -> None:
            log.write(f"{name}: {text}\n")
            log.flush()
            if name == "unattended" and text.startswith("{"):
                events.put(json.loads(text))
            elif name == "unattended" and "[supervisor]" not in text:
                errors.append(text.removeprefix("unattended: "))
            elif "[supervisor]" in text and " ended " in text:
                deaths.append(name)

        supervisor = Supervisor(specs, line=line)
        main, usual = threading.main_thread(), signal.getsignal(signal.SIGTERM)
        try:
            if threading.current_thread() is main:
                # A signal that ends this program ends the suite, too.
                signal.signal(signal.SIGTERM, signal.default_int_handler)
            supervisor.start()
            yield {"event": "started", "time": time.time(), "processes": len(specs)}
            finished = False
            while not finished:
                try:
                    event = events.get(timeout=0.2)
                except queue.Empty:
                    if supervisor.wait(0) and events.empty():
                        reason = errors[-1] if errors else "the session ended early"
                        if deaths:
                            reason += f" (died: {', '.join(sorted(set(deaths)))})"
                        raise FingerError(f"{reason}; log: {log_file}") from None
                    continue
                finished = event["event"] == "finished"
                yield event
        finally:
            supervisor.stop()
            if threading.current_thread() is main:
                signal.signal(signal.SIGTERM, usual)
