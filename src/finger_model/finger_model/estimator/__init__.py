"""The streaming estimator of the contact state."""

from .estimator import (
    ContactEstimate,
    ContactEstimator,
    EstimateBlock,
    EstimatorEvent,
    EventType,
    replay,
)
from .settings import EstimatorSettings

__all__ = [
    "ContactEstimate",
    "ContactEstimator",
    "EstimateBlock",
    "EstimatorEvent",
    "EstimatorSettings",
    "EventType",
    "replay",
]
