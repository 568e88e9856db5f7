# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Vision node: `image_raw` in, `contact_area` out with the image's stamp.

`contact_image` shows the measured contact; it is drawn only while it has subscribers. Images are
measured in a thread of their own, always the newest: an older image that was not begun is dropped
and counted, as is one whose stamp is not after those before, and one that equals the one before. An
image that cannot be used is refused with the reason, and the next one is measured.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
from geometry_msgs.msg import Point, Point32, Vector3
from lifecycle_msgs.srv import GetState
from sensor_msgs.msg import CompressedImage, Image
from std_srvs.srv import Trigger

from finger_common.diagnostics import WARN, Health
from finger_common.errors import FingerError
from finger_common.files import await_file
from finger_common.flags import AreaFlag
from finger_common.node import FrameSettings, ManagedNode, main_of
from finger_common.settings import setting
from finger_common.stamps import NANOSECONDS, stamp_of
from finger_msgs.msg import ContactArea

from .area_sensor import AREA_SENSORS, ContactMeasurement, NoLight, SensorDefect
from .calibration import CalibrationSettings
from .camera_stream import CameraStream, LeftOut
from .messages import contact_area_fields, image_of
from .overlay import draw_overlay
from .ridge_motion import DEFAULT_RIDGE_PERIOD, RidgeMotion, RidgeMotionSettings

Picture: TypeAlias = Image | CompressedImage

SILENCE = 2.0
"""s without an image, while somebody publishes them, after which it is said."""

STILL, STILL_SDS, STILL_SHARE = 5 * NANOSECONDS, 3.0, 0.03
"""ns after which it is said that a contact does not change. One of low contrast has changed by so
many standard deviations of its area; any other, while no background was learned, by this share of
its real area: noise of 8 greys changes that of marks by 0 to 2.9 %."""

JUMP, JUMP_PERIODS = NANOSECONDS, 5
"""A step from one image's stamp to the next that is longer than both, in ns and in steps before it,
is a pause of the camera or a jump of its clock: whether a contact changed meanwhile is unknown."""

DARK_IMAGES = 100
"""16-bit images in the lower bits, and none in the upper ones, after which it is said."""

FROZEN = 3
"""Images in a row that equal the one before, from which on the camera counts as frozen."""

PALE_PRINT = AreaFlag.NO_CONTACT | AreaFlag.LOW_CONTRAST
"""Flags of an image in which no contact was found, and one may be all the same."""

DOUBTS = ("contrast", "still")
"""Faults of a measured image: a print too pale to be seen, and a contact that does not change, so
that it may be marks on the plate."""


@dataclass(frozen=True)
class VisionSettings(FrameSettings):
    """Settings of the node itself."""

    image_transport: str = setting(
        "raw",
        "How images come: raw on image_raw, or compressed on image_raw/compressed.",
        choices=("raw", "compressed"),
    )
    learn_background: bool = setting(
        True, "Learn the background from images without contact as they pass."
    )
    frame_id: str = setting("plate", "Name of the plate frame in the headers sent.")
    calibration_timeout: float = setting(
        10.0,
        "Time for the calibration file to appear when the node is configured.",
        unit="s",
        minimum=0.0,
        maximum=600.0,
    )
    opencv_threads: int = setting(
        1,
        "Threads OpenCV may use; 1 leaves the other cores to the force and model nodes.",
        minimum=1,
        maximum=64,
    )


def contact_area_message(fields: dict[str, Any]) -> ContactArea:
    """ContactArea without header from `contact_area_fields`."""
    x, y, z = fields["centroid"]
    hull = [Point32(x=float(u), y=float(v), z=0.0) for u, v in fields["hull"]]
    slip = Vector3(**dict(zip("xyz", fields["slip"])))
    return ContactArea(**{**fields, "centroid": Point(x=x, y=y, z=z), "hull": hull, "slip": slip})


class VisionNode(ManagedNode):
    """See the module's description."""

    NAME = "vision"
    SETTINGS = (CalibrationSettings, VisionSettings, RidgeMotionSettings)
    PLUGINS = AREA_SENSORS

    def configure(self) -> None:
        cv2.setNumThreads(self.values["opencv_threads"])
        if self.values["calibration_file"]:
            await_file(self.values["calibration_file"], self.values["calibration_timeout"])
        self.calibration = self.settings(CalibrationSettings).load()
        self.sensor = AREA_SENSORS.open(self.values, self.calibration)
        self._learn = self.values["learn_background"]
        following = self.settings(RidgeMotionSettings)
        period = self.values.get("ridge_period", DEFAULT_RIDGE_PERIOD)
        motion = (
            RidgeMotion(following, self.calibration, period) if following.ridge_motion else None
        )
        self._stream = CameraStream(self.sensor, motion)
        self._told_dropped = self._told_unstamped = 0
        """Numbers of images with wrong stamps, and without one, that were told until now."""
        self._still: tuple[int, ContactMeasurement] | None = None
        """Stamp (ns) of the contact that has not changed since then, and itself."""
        self._last_stamp: int | None = None
        self._step: int | None = None
        """Stamp of the newest image that was measured, and its step from the one before it (ns)."""
        self._stands = False
        """Whether a contact has not changed for long, and no background was learned."""
        self._take_plate = False
        """Whether the next image shows the plate, whatever contact is seen in it."""
        self.health = Health("vision")
        self.healths = [self.health]
        self._lock = threading.Lock()
        qos = self.stream_qos(publisher=True)
        self._areas = self.create_stream_publisher(ContactArea, "contact_area", qos)
        newest = self.stream_qos(1, publisher=True)
        self._overlays = self.create_stream_publisher(Image, "contact_image", newest)
        self._compressed = self.values["image_transport"] == "compressed"
        self._source = "image_raw/compressed" if self._compressed else "image_raw"
        # Stamps alone do not tell two cameras whose clocks are apart.
        self.expect_one_publisher(self._source)
        self.create_service(Trigger, "~/reset", self._on_reset)
        if not self.calibration.calibrated:
            self.get_logger().warning(
                "no plate calibration: a plain area per pixel is used and every area is flagged; "
                "set calibration_file"
            )

    def activate(self) -> None:
        self._newest: queue.Queue[Picture | None] = queue.Queue(1)
        self._worker = threading.Thread(
            target=self._work, args=(self._newest,), name="vision", daemon=True
        )
        self._worker.start()
        self._heard, self._first = time.monotonic(), True
        self._intervals: deque[float] = deque(maxlen=2)
        """s between the newest images."""
        self._camera: Any = None
        self._answer: Any = None
        """Client and answer of `_ask_camera`."""
        # A few images of depth, so that the node, not the middleware, drops and counts them.
        self.create_stream_subscription(
            CompressedImage if self._compressed else Image,
            self._source,
            self._on_image,
            self.stream_qos(3),
            message_lost=lambda event: self.health.count("lost", event.total_count_change),
        )

    def deactivate(self) -> None:
        self.destroy_active_interfaces()
        self.health.recovered("no_image")
        self._replace(None)
        self._worker.join(5)

    # Work ------------------------------------------------------------------------------------

    def _on_image(self, message: Picture) -> None:
        now = time.monotonic()
        if not self._first:
            self._intervals.append(now - self._heard)
        self._heard, self._first = now, False
        try:
            self._stream.order.check(stamp_of(message.header.stamp))
        except LeftOut:
            self.health.count("out_of_order")
            return
        if self._replace(message):
            self.health.count("dropped")

    def _replace(self, message: Picture | None) -> bool:
        """Hand the worker an image, or None to end; true when an image was still waiting."""
        waiting = False
        with suppress(queue.Empty):
            waiting = self._newest.get_nowait() is not None
        self._newest.put_nowait(message)
        return waiting

    def _work(self, newest: queue.Queue[Picture | None]) -> None:
        for message in iter(newest.get, None):
            try:
                self._measure(message)
            except LeftOut:
                self.health.count("repeated")
                if self._stream.repeats.in_a_row >= FROZEN:
                    text = "the camera, or its driver, repeats the same image; restart it"
                    self.log_fault(self.health, "frozen", text)
            except NoLight as error:
                self.health.count("refused")
                self.log_fault(self.health, "light", str(error))
            except SensorDefect as error:
                self.health.count("failed")
                self.log_fault(self.health, "failure", str(error))
            except FingerError as error:
                self.health.count("refused")
                self.log_fault(self.health, "frame", str(error), WARN)
            except Exception as error:
                # One image must not end the worker. After deactivation its failure is no fault.
                if self.active:
                    self.health.count("failed")
                    self.log_fault(self.health, "failure", f"{type(error).__name__}: {error}")

    def _measure(self, message: Picture) -> None:
        with self._lock:
            image = self._stream.signal(image_of(message))
            self.health.cleared("frozen")
            self._check_bits()
            if self._take_plate:
                self.sensor.learn(image)
                self._take_plate = False
            measurement = self._stream.measure(image, self._learn)
            learned = self.sensor.learned
        area = contact_area_message(contact_area_fields(measurement))
        area.header.stamp = message.header.stamp
        area.header.frame_id = self.frame
        self._areas.publish(area)
        self.health.sample()
        self.health.notes["background_frames"] = str(learned)
        self.health.cleared("light", "frame", "failure")
        if measurement.flags & AreaFlag.NO_CONTACT:
            self.health.count("without_contact")
        doubt, text = self._look_for_doubt(measurement, stamp_of(message.header.stamp))
        for key in DOUBTS:
            if key == doubt:
                self.log_fault(self.health, key, text, WARN)
            else:
                self.health.cleared(key)
        if self._overlays.get_subscription_count() > 0:
            picture = draw_overlay(image, measurement, self.calibration)
            overlay = Image(
                header=area.header,
                height=picture.shape[0],
                width=picture.shape[1],
                encoding="bgr8",
                step=picture.shape[1] * 3,
            )
            overlay.data = picture.tobytes()
            self._overlays.publish(overlay)

    def _look_for_doubt(self, measurement: ContactMeasurement, stamp: int) -> tuple[str, str]:
        """Compare an image of `stamp` (ns) with those before; which of DOUBTS there is, and what to
        say of it, both empty where there is none."""
        still, self._still = self._still, None
        self._stands = False
        jumped = self._note_stamp(stamp)
        if measurement.flags & PALE_PRINT == PALE_PRINT:
            return "contrast", (
                "no contact can be seen: the plate is too dark, a print is too pale, or an earlier "
                "one lies on the plate; check light, exposure and focus, or clean the plate (set "
                "polarity to bright for a plate that is dark by design)"
            )
        if measurement.flags & AreaFlag.NO_CONTACT:
            return "", ""
        if still is None or jumped or not _unchanged(measurement, still[1]):
            still = stamp, measurement
        self._still = still
        if stamp - still[0] <= STILL:
            return "", ""
        seconds = (stamp - still[0]) / NANOSECONDS
        self._stands = bool(measurement.flags & AreaFlag.NO_BACKGROUND)
        if self._stands:
            return "still", (
                f"a contact has not changed for {seconds:.0f} s, and no empty plate was seen; "
                "marks on the plate or its mount may count as one: clean the plate, then, with no "
                "finger on it, call ~/reset, which takes marks that stay as part of the plate"
            )
        return "still", (
            f"a contact of low contrast has not changed for {seconds:.0f} s; where no finger "
            "presses, sweat or dirt counts as one: clean the plate, then call ~/reset"
        )

    def _note_stamp(self, stamp: int) -> bool:
        """Note the stamp (ns) of the next image; whether it goes back, or far ahead, for its
        camera."""
        before, self._last_stamp = self._last_stamp, stamp
        if before is None:
            return False
        period, self._step = self._step, stamp - before
        far = period is not None and self._step > max(JUMP, JUMP_PERIODS * period)
        return self._step < 0 or far

    def _check_bits(self) -> None:
        """Warn of images that have used the lower of 16 bits only; a dark plate may do so, too."""
        if self._stream.dark_images > DARK_IMAGES:
            text = (
                f"no value of {DARK_IMAGES} 16-bit images is above {self._stream.brightest} of "
                "65535: 10- or 12-bit pixels in the lower bits, or very little light? Use the "
                "upper bits, or set the camera to 8 bits, else contacts are not seen"
            )
            self.log_fault(self.health, "bits", text, WARN)
        else:
            self.health.recovered("bits")

    def _check_stamps(self) -> None:
        """Warn of stamps that were wrong since the last call."""
        order = self._stream.order
        for key, wrong, text in (
            (
                "stamps",
                order.dropped > self._told_dropped,
                "stamps of images are not after those before, and these images are dropped; are "
                "there two cameras on this topic, or a driver that stamps wrongly?",
            ),
            (
                "no_stamp",
                order.unstamped > self._told_unstamped,
                "images have no stamp (zero), and their areas fit no force; let the camera's "
                "driver stamp them",
            ),
        ):
            if wrong:
                self.log_fault(self.health, key, text, WARN)
            else:
                self.health.recovered(key)
        self._told_dropped, self._told_unstamped = order.dropped, order.unstamped

    def publish_diagnostics(self) -> None:
        """Warn of stamps, and while images are published and none, or few, come."""
        if self.active:
            self._check_stamps()
            text = self._silence()
            if text:
                self.log_fault(self.health, "no_image", text, WARN)
            else:
                self.health.recovered("no_image")
        super().publish_diagnostics()

    def _silence(self) -> str:
        """What to say of images that do not come; empty where they do."""
        now = time.monotonic()
        if not self.count_publishers(self._source):
            self._heard, self._first = now, True
            self._intervals.clear()
        silent = now - self._heard
        # One alone may be a pause.
        period = min(self._intervals) if len(self._intervals) > 1 else 0.0
        if period > SILENCE and silent < 2 * period:
            return f"an image comes only every {period:.0f} s; check the rate of the camera"
        # Asked in time, so that the answer is there.
        name, state = self._ask_camera() if silent > SILENCE / 2 else ("", "")
        if silent <= SILENCE:
            return ""
        reason = "large images need the profile of docs/devices.md"
        if state not in ("", "active"):
            reason = f"{name} is {state}; activate it"
        return f"no image for {silent:.0f} s; {reason}"

    def _ask_camera(self) -> tuple[str, str]:
        """Ask the node that publishes images for its lifecycle state; its name, and the state by
        its answer to the last call, empty where it has given none."""
        publishers = self.get_publishers_info_by_topic(self._source)
        if not publishers:
            return "", ""
        name = f"{publishers[0].node_namespace.rstrip('/')}/{publishers[0].node_name}"
        state = ""
        if self._camera is None or self._camera.srv_name != f"{name}/get_state":
            self._camera, self._answer = self.create_client(GetState, f"{name}/get_state"), None
        if self._answer is not None and self._answer.done():
            state = self._answer.result().current_state.label
        elif self._answer is not None:
            self._camera.remove_pending_request(self._answer)
        ready = self._camera.service_is_ready()
        self._answer = self._camera.call_async(GetState.Request()) if ready else None
        return name, state

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            self._stream.reset()
            self._take_plate = self._stands
            self._still, self._stands = None, False
            for key in DOUBTS:
                self.health.recovered(key)
        response.success = True
        response.message = "background forgotten; it is learned again from " + (
            "the next image, with the contact that had not changed"
            if self._take_plate
            else "frames without contact"
        )
        return response


def _unchanged(now: ContactMeasurement, before: ContactMeasurement) -> bool:
    """Whether a contact that may be sweat, or marks on the plate, is the same as before."""
    pale, unknown = (now.flags & f for f in (AreaFlag.LOW_CONTRAST, AreaFlag.NO_BACKGROUND))
    if pale and abs(now.gross_area - before.gross_area) <= STILL_SDS * now.area_sd:
        return True
    marks = abs(now.real_area - before.real_area) <= STILL_SHARE * before.real_area
    return bool(unknown and marks)


main = main_of(VisionNode)

if __name__ == "__main__":
    main()
