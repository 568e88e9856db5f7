"""The vision node's parameters, described once; segmenter and calibration made from them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from finger_common.errors import InputError
from finger_common.parameters import Parameter, ParameterTable

from .calibration import PAPER_AREA_PER_PIXEL, PlateCalibration
from .contact import ContactSegmenter, SegmenterSettings

_DEFAULTS = SegmenterSettings()

SEGMENTER_PARAMETERS = ParameterTable(
    Parameter(
        "outline",
        _DEFAULTS.outline,
        "Outline that bounds the gross area: the convex hull of the ridges, as in the paper, or a closed outline "
        "that does not bridge gaps.",
        choices=("convex", "concave"),
    ),
    Parameter(
        "polarity",
        _DEFAULTS.polarity,
        "Whether touching ridges are darker or brighter than the plate.",
        choices=("auto", "dark", "bright"),
        advice="Set it where frames are very noisy or the finger fills the image.",
    ),
    Parameter(
        "ridge_period",
        _DEFAULTS.ridge_period,
        "Distance from ridge to ridge; 0.4 to 0.6 mm in adults.",
        unit="m",
        minimum=0.2e-3,
        maximum=1.5e-3,
    ),
    Parameter(
        "minimum_contrast",
        _DEFAULTS.minimum_contrast,
        "Weakest ridge that counts, as a fraction of the plate's brightness (dark ridges) or of the grey range.",
        minimum=0.02,
        maximum=0.9,
        advice="Raise it when latent prints count; lower it when dry rims are lost.",
    ),
    Parameter(
        "minimum_area",
        _DEFAULTS.minimum_area,
        "Smallest gross area that counts as a contact.",
        unit="m²",
        minimum=0.0,
        maximum=1e-4,
    ),
    Parameter(
        "working_pixel",
        _DEFAULTS.working_pixel,
        "Frames are reduced to pixels of about this size before they are measured.",
        unit="m",
        minimum=10e-6,
        maximum=150e-6,
        advice="Larger is faster and less accurate.",
    ),
    Parameter(
        "learn_background",
        _DEFAULTS.learn_background,
        "Learn the plate's background from frames without contact as they pass.",
    ),
    Parameter(
        "background_frames",
        _DEFAULTS.background_frames,
        "Contact-free frames after which an older one counts 1/e in the background.",
        minimum=1,
        maximum=10000,
    ),
)
"""Parameters of the segmentation, the same for the node and for bags processed offline."""

CALIBRATION_PARAMETERS = ParameterTable(
    Parameter(
        "calibration_file",
        "",
        "Plate calibration (YAML) made by `finger-vision calibrate`; empty for none.",
    ),
    Parameter(
        "area_per_pixel",
        PAPER_AREA_PER_PIXEL,
        "Area on the plate of one pixel, used without a calibration file and flagged; default: the paper's.",
        unit="m²",
        minimum=1e-14,
        maximum=1e-6,
    ),
)

NODE_PARAMETERS = (
    CALIBRATION_PARAMETERS
    + SEGMENTER_PARAMETERS
    + ParameterTable(
        Parameter("frame_id", "plate", "Name of the plate frame in the headers sent."),
        Parameter(
            "opencv_threads",
            1,
            "Threads OpenCV may use; 1 leaves the other cores to the force and model nodes.",
            minimum=1,
            maximum=64,
        ),
    )
)


def segmenter_settings(values: Mapping[str, Any]) -> SegmenterSettings:
    """Settings from checked parameter values; others in `values` are ignored."""
    try:
        return SegmenterSettings(**{p.name: values[p.name] for p in SEGMENTER_PARAMETERS})
    except KeyError as error:
        raise InputError(f"parameter {error} is missing; add it") from None


def make_segmenter(values: Mapping[str, Any]) -> ContactSegmenter:
    """Segmenter with calibration from checked parameter values; raises InputError."""
    path = values["calibration_file"]
    if path:
        calibration = PlateCalibration.load(path)
    else:
        calibration = PlateCalibration.from_area_per_pixel(values["area_per_pixel"])
    return ContactSegmenter(segmenter_settings(values), calibration)
