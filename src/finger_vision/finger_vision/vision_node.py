"""Vision node: `image_raw` in, `contact_area` out with the image's stamp; `contact_image` when somebody listens.

Frames are measured in a thread of their own, always the newest one: an older frame that was not begun is dropped
and counted. A frame that cannot be used is refused with the reason, and the next one is taken.
"""

from __future__ import annotations

import threading
from typing import Any

import cv2
from geometry_msgs.msg import Point, Point32
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from finger_common.diagnostics import WARN, Health
from finger_common.errors import FingerError
from finger_common.node import ManagedNode, main_of
from finger_msgs.msg import ContactArea

from .contact import ContactSegmenter
from .flags import ContactFlag
from .latest import LatestSlot
from .messages import contact_area_fields, image_of
from .settings import NODE_PARAMETERS, make_segmenter


def contact_area_message(fields: dict[str, Any]) -> ContactArea:
    """ContactArea without header from `contact_area_fields`."""
    x, y, z = fields["centroid"]
    message = ContactArea(centroid=Point(x=x, y=y, z=z))
    message.hull = [Point32(x=float(u), y=float(v), z=0.0) for u, v in fields["hull"]]
    for name, value in fields.items():
        if name not in ("centroid", "hull"):
            setattr(message, name, value)
    return message


class VisionNode(ManagedNode):
    """See the module's description."""

    NAME = "vision"
    TABLE = NODE_PARAMETERS

    def configure(self) -> None:
        cv2.setNumThreads(self.values["opencv_threads"])
        self.segmenter: ContactSegmenter = make_segmenter(self.values)
        self.health = Health("vision")
        self.healths = [self.health]
        self._lock = threading.Lock()
        self._areas = self.create_stream_publisher(ContactArea, "contact_area", self.stream_qos())
        self._overlays = self.create_stream_publisher(Image, "contact_image", self.stream_qos(1))
        self._reset = self.create_service(Trigger, "~/reset", self._on_reset)
        self._slot: LatestSlot[Image] | None = None
        self._images: Any = None
        if not self.segmenter.calibration.calibrated:
            self.get_logger().warning(
                "no plate calibration: a plain area per pixel is used and every area is flagged; "
                "set calibration_file"
            )

    def activate(self) -> None:
        self._slot = LatestSlot()
        self._worker = threading.Thread(
            target=self._work, args=(self._slot,), name="vision", daemon=True
        )
        self._worker.start()
        # A few frames of depth, so that the slot, not the middleware, drops and counts.
        self._images = self.create_stream_subscription(
            Image, "image_raw", self._on_image, self.stream_qos(3)
        )

    def deactivate(self) -> None:
        if getattr(self, "_images", None) is not None:
            self.destroy_subscription(self._images)
            self._images = None
        slot = getattr(self, "_slot", None)
        if slot is not None:
            slot.close()
            self._worker.join(5)
            self._slot = None

    def cleanup(self) -> None:
        for name in ("_areas", "_overlays"):
            publisher = self.__dict__.pop(name, None)
            if publisher is not None:
                self.destroy_publisher(publisher)
        service = self.__dict__.pop("_reset", None)
        if service is not None:
            self.destroy_service(service)

    # Work ------------------------------------------------------------------------------------

    def _on_image(self, message: Image) -> None:
        slot = self._slot
        if slot is not None and slot.put(message):
            self.health.count("dropped")

    def _work(self, slot: LatestSlot[Image]) -> None:
        while not slot.closed:
            message = slot.take(1.0)
            if message is not None:
                try:
                    self._measure(message)
                except FingerError as error:
                    self.health.count("refused")
                    self.log_fault(self.health, "frame", str(error), WARN)
                except Exception as error:
                    # The worker must outlive any one frame.
                    if slot.closed:
                        return
                    self.health.count("failed")
                    self.log_fault(self.health, "failure", f"{type(error).__name__}: {error}")

    def _measure(self, message: Image) -> None:
        image = image_of(message)
        with self._lock:
            measurement = self.segmenter.process(image)
            learned = self.segmenter.background.count
        area = contact_area_message(contact_area_fields(measurement))
        area.header.stamp = message.header.stamp
        area.header.frame_id = self.values["frame_id"]
        self._areas.publish(area)
        self.health.sample()
        self.health.notes["background_frames"] = str(learned)
        self.health.recovered("frame")
        self.health.recovered("failure")
        if measurement.flags & ContactFlag.NO_CONTACT:
            self.health.count("without_contact")
        if self._overlays.get_subscription_count() > 0:
            picture = self.segmenter.overlay(image, measurement)
            overlay = Image(
                header=area.header,
                height=picture.shape[0],
                width=picture.shape[1],
                encoding="bgr8",
                step=picture.shape[1] * 3,
            )
            overlay.data = picture.tobytes()
            self._overlays.publish(overlay)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            self.segmenter.reset()
        response.success = True
        response.message = "background forgotten; it is learned again from frames without contact"
        return response


main = main_of(VisionNode)

if __name__ == "__main__":
    main()
