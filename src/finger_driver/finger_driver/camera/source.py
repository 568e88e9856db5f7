"""What every camera's driver gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..device import Device


@dataclass(frozen=True)
class Frame:
    """One image.

    stamp_ns: acquisition, ns since the epoch, before the calibrated offset of the rig is added. image (H, W)
    uint8. sequence: the camera's own number of the frame; a gap means lost frames.
    """

    stamp_ns: int
    image: np.ndarray
    sequence: int


class CameraSource(Device[Frame]):
    """A monochrome camera."""
