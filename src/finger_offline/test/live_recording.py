# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What recordings of a live model node have in common, in tests that process them."""

from __future__ import annotations

from finger_bag.writer import BagWriter
from finger_model.estimator import EstimatorEvent
from finger_model.messages import event_fields


class EventLog:
    """Writes events into a bag, numbered as the model node numbers them."""

    def __init__(self, bag: BagWriter) -> None:
        self.bag, self.sequence = bag, 0

    def write(self, event: EstimatorEvent, log_ns: int, behind_ns: int = 0) -> None:
        """One event. behind_ns: how much later than `log_ns` the node sent it."""
        fields = event_fields(event, self.sequence)
        self.bag.write("model_events", fields, log_ns + behind_ns)
        self.sequence += 1
