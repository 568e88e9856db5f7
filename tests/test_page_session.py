"""A whole session run from the page in a real browser, with the whole simulated rig.

Two conditions, six kept trials, a redo, a fault of each device, a reload, a restart of the protocol
and of the page, an early end. Pictures at five sizes go to out/page (PAGE_SHOTS: another folder).
"""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from page_looks import OVERFLOW, SIZES, shots, violations

from finger_bringup import nodes
from finger_bringup.supervisor import Supervisor
from finger_model.geometry import Geometry

pytest.importorskip("rclpy", reason="ROS 2 is not installed")


FIGURES = os.environ.get("PAGE_FIGURES")
"""Folder for the documents' pictures, which the test makes on its way; none without it."""

BUSY = {
    "gap_limit": 1.0,
    "frame_gap_limit": 2.0,
    "stale_after": 1.5,
    "record_timeout": 60.0,
    "release_time": 2.0,
    "target_timeout": 20.0,
    "max_attempts": 20,
}
"""Limits that a loaded machine keeps; the cue to lift stands long enough for a picture."""

WIDE = {"width": 1366, "height": 900}


class Rig:
    """The suite on simulated devices, kept running by the supervisor."""

    def __init__(self, folder: Path, page_port: int, upcoming: list[str]) -> None:
        """upcoming: trials that the participant plans ahead."""
        self.sessions = folder / "sessions"
        self.log = folder / "rig.log"
        parameters = {
            "simulated_rig": {
                "width": 640,
                "height": 512,
                "refinement": 0.5,
                "reading_time": 1.0,
                "upcoming": upcoming,
            },
            # A fifth of the usual rate: the machine also runs the browser.
            "force": {"rate": 100.0},
            "protocol": BUSY,
            "page": {"port": page_port},
        }
        entries = nodes.rig(folder, simulated=True, parameters=parameters)
        specs = nodes.process_specs(entries, folder)
        self._file = self.log.open("w")
        self.supervisor = Supervisor(specs, line=self._line, longest_delay=2.0)

    def _line(self, name: str, text: str) -> None:
        print(f"{time.time():.3f} {name}: {text}", file=self._file, flush=True)

    def until_logged(self, text: str, seconds: float = 120.0) -> None:
        """Wait for a text in the log."""
        end = time.monotonic() + seconds
        while text not in self.log.read_text():
            assert time.monotonic() < end, self.log.read_text()[-3000:]
            time.sleep(0.1)

    def kill(self, name: str) -> None:
        process = self.supervisor.process_id(name)
        assert process is not None
        os.kill(process, signal.SIGKILL)


class Devices:
    """The faults that the simulated devices show."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from rcl_interfaces.srv import SetParameters

        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node("faults", namespace="finger", context=self._context)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._client = self._node.create_client(SetParameters, "simulated_rig/set_parameters")

    def show(self, *faults: str) -> None:
        """Let the devices show these faults and no others."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        parameter = Parameter("faults", value=list(faults) or [""]).to_parameter_msg()
        assert self._client.wait_for_service(60.0)
        future = self._client.call_async(SetParameters.Request(parameters=[parameter]))
        self._executor.spin_until_future_complete(future, 60.0)
        (result,) = future.result().results
        assert result.successful, result.reason

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


HISTORY = """
window.cues = [];
new MutationObserver(() => {
  const word = document.getElementById("cue-word").textContent;
  if (window.cues.at(-1) !== word) window.cues.push(word);
}).observe(document.getElementById("cue"), {subtree: true, childList: true, characterData: true});
"""
"""Keeps every word that the cue showed, also those too short for this process to see."""


class Operator:
    """An operator at the page: reads the cue, presses keys."""

    def __init__(self, page: Any, folder: Path) -> None:
        self.page = page
        self.folder = folder
        self.errors: list[str] = []
        page.on("pageerror", lambda error: self.errors.append(str(error)))

    @property
    def look(self) -> str:
        return str(self.page.get_attribute("#cue", "data-look"))

    def text(self, selector: str) -> str:
        return str(self.page.inner_text(selector))

    def until(self, condition: Callable[[], Any], what: str, seconds: float = 120.0) -> Any:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            result = condition()
            if result:
                return result
            self.page.wait_for_timeout(50)
        text = self.page.inner_text("body")
        raise AssertionError(f"waited {seconds:g} s for {what}; the page shows:\n{text}")

    def see(self, *looks: str, seconds: float = 120.0) -> str:
        """Wait, in the browser, for one of the cue's looks."""
        selector = ", ".join(f"#cue[data-look={look}]" for look in looks)
        self.page.wait_for_selector(selector, timeout=seconds * 1e3)
        return self.look

    def press(self, key: str) -> None:
        self.page.keyboard.press(key)

    def row(self, index: int) -> str:
        return " ".join(self.page.locator(f'#trials tr[data-index="{index}"]').all_inner_texts())

    def picture(self, name: str, width: int, height: int) -> None:
        """Picture of the page at a size, at which nothing may be cut."""
        self.page.set_viewport_size({"width": width, "height": height})
        self.page.wait_for_timeout(300)
        path = self.folder / f"session_{name}_{width}.png"
        self.page.screenshot(path=str(path), full_page=width <= 1024)
        assert self.page.evaluate(OVERFLOW) == [], (name, width)

    def pictures(self, name: str) -> None:
        """Pictures at all sizes."""
        for size in SIZES:
            self.picture(name, *size)
        self.page.set_viewport_size(WIDE)

    def figure(self, name: str, of: Any = None) -> None:
        """A picture for the documents, where they are wanted."""
        if FIGURES:
            (of or self.page).screenshot(path=str(Path(FIGURES) / f"page_{name}.png"))

    def step(self, index: int) -> None:
        """What takes trial `index` further: resume after a pause, or Ready."""
        if f"Trial {index + 1} of" not in self.text("#cue-trial"):
            return
        if self.look == "paused":
            self.press("p")
        elif self.look == "prepare" and self.page.is_enabled("#start"):
            self.press("Space")
        else:
            return
        # What was asked for shows before it is asked for again.
        self.page.wait_for_timeout(300)

    def trial(self, index: int) -> None:
        """A trial until it is kept, in as many attempts as a busy machine needs."""

        def kept() -> bool:
            self.step(index)
            return "kept" in self.row(index)

        self.until(kept, f"trial {index} kept", 400.0)

    def reach(self, index: int, *looks: str) -> None:
        """Begin a trial and wait for one of these looks of it.

        The browser itself watches for it: it may be over before this process has asked.
        """
        shown = """([looks, trial]) => {
          const look = document.getElementById("cue").dataset.look;
          if (!document.getElementById("cue-trial").textContent.startsWith(trial)) return "";
          if (looks.includes(look)) return "reached";
          const ready = look === "prepare" && !document.getElementById("start").disabled;
          return look === "paused" || ready ? "step" : "";
        }"""
        argument = [list(looks), f"Trial {index + 1} of"]
        for _ in range(40):
            found = self.page.wait_for_function(shown, arg=argument, timeout=400e3).json_value()
            if found == "reached":
                return
            self.step(index)
        raise AssertionError(f"no {' or '.join(looks)} of trial {index}")

    def refused(self, text: str) -> None:
        """The banner says this, and Ready is refused with the reason."""
        self.until(lambda: text in self.text("#banner"), f"the banner: {text}")
        if self.look == "prepare":
            self.until(lambda: self.page.is_disabled("#start"), "Ready off")
            self.press("Space")
            self.until(lambda: "Not ready: " in self.text("#answer"), "the reason")

    def all_well(self) -> None:
        """Nothing is wrong any more."""
        self.until(lambda: not self.page.is_visible("#banner"), "the end of the fault")

    def tare(self) -> None:
        """Zero the force, again where the plate was not at rest."""

        def tared() -> bool:
            if "N, not tared" in self.text("#force-panel h2"):
                self.press("t")
                self.page.wait_for_timeout(3000)
            return re.search(r"\d\s*N$", self.text("#force-panel h2"))

        self.until(lambda: "Tare needed" in self.text("#banner"), "the need of a tare")
        self.until(lambda: "not tared" in self.text("#force-panel h2"), "a force without zero")
        assert "±" not in self.text("#estimate-value")
        self.until(tared, "tare")

    def new_session(self) -> None:
        """Open the dialog of a new session, once the protocol has told its plan."""

        def opened() -> bool:
            if self.look == "closed" and not self.page.is_visible("#session-dialog"):
                self.press("Space")
                self.page.wait_for_timeout(300)
            return bool(self.page.is_visible("#session-dialog"))

        self.until(opened, "the dialog of a new session")

    def begin(self) -> None:
        """Type a session into the dialog and begin; a name is refused."""
        self.new_session()
        page = self.page
        page.fill("#plan-subject", "Maria")
        page.fill("#plan-conditions", "dry, natural")
        page.fill("#plan-trials", "4")
        page.fill("#plan-age", "31")
        page.select_option("#plan-finger", "index")
        page.fill("#plan-width", "155")
        page.fill("#plan-depth", "11.2")
        self.pictures("dialog")
        page.click("#plan-start")
        assert page.is_visible("#session-dialog"), "a width of 155 mm"
        page.fill("#plan-width", "15.5")
        page.click("#plan-start")
        self.until(lambda: "never a name" in self.text("#plan-error"), "the refusal")
        page.fill("#plan-subject", "S01")
        page.click("#plan-start")
        page.wait_for_selector("#session-dialog:not([open])", state="attached", timeout=60000)
        self.see("prepare")


@contextmanager
def watched(page: Any) -> Iterator[None]:
    """Keep the words of the cue of a view."""
    page.wait_for_selector("#cue-word")
    page.evaluate(HISTORY)
    yield
    # A busy machine may lose link or protocol for a moment; the cue stands there again.
    lost = ("Not connected", "No protocol", "Please wait")
    found = [word for word in page.evaluate("window.cues") if word not in lost]
    cues = [word for word, _ in itertools.groupby(found)]
    before = [cues[i - 1] for i, word in enumerate(cues) if word == "Lift"]
    assert set(before) == {"Press"}, cues


@pytest.mark.slow
@pytest.mark.timeout(2400)
def test_a_guided_session_with_a_fault_of_each_device(
    ros_domain: int, free_port: Callable[[], int], tmp_path: Path, browser: Any, project_root: Path
) -> None:
    port = free_port()
    rig = Rig(tmp_path, port, ["dry:4", "natural:4"])
    devices = Devices(ros_domain)
    page = browser.new_page()
    page.set_viewport_size(WIDE)
    operator = Operator(page, shots(project_root))
    with rig.supervisor:
        rig.until_logged("operator's page")
        page.goto(f"http://127.0.0.1:{port}/")
        participant = browser.new_page()
        participant.goto(f"http://127.0.0.1:{port}/participant")
        page.bring_to_front()
        page.click("#tab-health")
        for node in ("camera", "force", "model", "moisture", "protocol", "recorder", "vision"):
            row = page.locator("#health li", has_text=node)
            operator.until(row.count, f"health of {node}")
        page.click("#tab-trials")
        operator.until(lambda: page.is_visible("#image"), "the live image")
        operator.tare()
        operator.begin()
        operator.all_well()
        operator.until(lambda: "isopropyl" in operator.text("#cue-text"), "the preparation")
        operator.until(lambda: "Clean the plate" in operator.text("#prompt"), "the prompt")
        operator.pictures("prepare")

        # Trial 0, all of it seen by operator and participant.
        with watched(page), watched(participant):
            operator.reach(0, "press", "lift")
            full = page.locator("#moisture-before .chip.full")
            operator.until(lambda: full.count() == 3, "three readings")
            operator.see("lift")
            operator.figure("participant", participant)
            operator.figure("lift")
            operator.picture("lift", *SIZES[0])
            page.set_viewport_size(WIDE)
            operator.trial(0)
        (session,) = (p for p in rig.sessions.iterdir() if p.is_dir())
        assert Geometry.load(session / "geometry.yaml").pad_semi_axis_radial == 0.00775

        # Trial 1: the force sensor falls silent during the press, and is back before the next.
        operator.reach(1, "press")
        devices.show("force silent")
        operator.until(lambda: "failed" in operator.row(1), "the failed trial")
        operator.figure("failed")
        operator.see("prepare")
        operator.refused("No force")
        operator.until(lambda: operator.text("#force-value") == "–", "no old value")
        operator.pictures("fault")
        devices.show()
        operator.all_well()
        operator.trial(1)
        assert re.search(r"\([2-9]\sattempts\)", operator.row(1))

        # Trial 2: the camera falls silent before the press, which waits until it is back.
        waits = re.compile("camera|contact area")

        def held() -> bool:
            return operator.look == "clear" and bool(waits.search(operator.text("#cue-text")))

        while True:
            operator.reach(2, "moisture_before")
            devices.show("camera silent")
            operator.until(lambda: held() or operator.look == "failed", "the wait for the camera")
            if held():
                break
            # The readings were over before the silence counted: the attempt failed, rightly.
            devices.show()
            operator.all_well()
        operator.refused("No contact area")
        operator.picture("waits", *SIZES[1])
        devices.show()
        operator.trial(2)

        # A reload: session, trials and curves are back.
        page.reload()
        page.wait_for_selector("#last:enabled")
        operator.until(lambda: "kept" in operator.row(2), "the list of trials")
        assert "S01" in operator.text("#session")
        page.click("#last")
        operator.picture("last", *SIZES[2])
        page.click("#live")

        # Trial 3: the probe is unplugged while it is read; the readings go on when it is back.
        operator.reach(3, "moisture_before")
        devices.show("moisture unplugged")
        operator.refused("moisture probe")
        operator.picture("probe", *SIZES[3])
        devices.show()
        operator.all_well()
        operator.trial(3)

        # Trial 4: the protocol is killed during the press; the trial begins again.
        operator.reach(4, "press")
        rig.kill("protocol")
        operator.see("offline")
        operator.until(lambda: "No protocol" in operator.text("#cue-word"), "no protocol")
        assert page.is_disabled("#start")
        operator.see("paused")
        again = "Restarted. Trial 5 will begin again: press Space."
        operator.until(lambda: again in operator.text("#cue-text"), "what to do")
        operator.picture("restarted", *SIZES[4])
        page.set_viewport_size(WIDE)

        # Redo by the operator in the middle of the press.
        operator.reach(4, "press")

        def redone() -> bool:
            # What the page has not shown yet is refused: the step may have just begun.
            if operator.look in ("press", "lift", "moisture_after"):
                operator.press("r")
                page.wait_for_timeout(500)
            return "redone by the operator" in operator.row(4)

        operator.until(redone, "the reason")
        operator.trial(4)

        # Trial 5: recorder, vision and model are killed, one after the other.
        operator.reach(5, "press", "lift")
        rig.kill("recorder")
        operator.refused("The recorder is not running")
        operator.until(lambda: "failed" in operator.row(5), "the failed trial")
        operator.all_well()
        for node, said in (("vision", "area is not running"), ("model", "model is not running")):
            rig.kill(node)
            operator.refused(said)
            operator.until(lambda n=node: rig.supervisor.restarts()[n] == 1, f"restart of {node}")
            operator.all_well()

        # The page's own server: no cue and no buttons until it is back and the page has reloaded.
        page.evaluate("window.same = true")
        rig.kill("page")
        operator.see("offline")
        assert page.is_disabled("#start") and page.is_disabled("#tare")
        page.wait_for_function("() => window.same === undefined", timeout=120e3)
        operator.see("prepare", "paused")
        # The force driver loses its zero.
        rig.kill("force")
        operator.refused("force driver is not running")
        operator.tare()
        operator.all_well()
        operator.trial(5)

        # An early end, with a note.
        operator.press("n")
        page.fill("#text-input", "plate <cleaned> twice")
        page.click("#text-form .primary")
        operator.until(lambda: "plate <cleaned> twice" in operator.text("#trials"), "the note")
        operator.see("prepare")
        operator.press("x")
        page.click("#ask-buttons button:has-text('End')")
        operator.see("finished")
        summary = "6 of 8 trials kept, 2 not done"
        operator.until(lambda: summary in operator.text("#cue-text"), "the summary")
        operator.pictures("finished")
        page.set_viewport_size({"width": 820, "height": 1180})
        operator.figure("tablet")
        for view in (page, participant):
            assert violations(view) == []
        assert operator.errors == []
    devices.close()

    table = (session / "trials.csv").read_text().splitlines()[1:]
    assert sum(",done," in line for line in table) == 6
    assert sum(",failed," in line for line in table) >= 4
    assert "Traceback" not in rig.log.read_text()
    bags = [str(session / line.split(",")[9]) for line in table if ",done," in line]
    command = [sys.executable, "-m", "finger_bag.cli", "validate", "--json", *bags]
    reports = json.loads(subprocess.run(command, capture_output=True, text=True).stdout)
    unreadable = [r["bag"] for r in reports if not r["checks"]]
    assert len(reports) == 6 and not unreadable, reports
