# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The other side of LSL for a test: receives the wrench and the markers, sends moisture readings.

The value of a reading is its time in s since `began`. Writes what it saw to the file named. With
`unix` it stamps readings with the time since 1970, which is wrong.
"""

import json
import os
import sys
import time

import pylsl


def wall_offset() -> float:
    """What to add to LSL's clock to get the wall clock, by the narrowest of 100 readings."""
    readings = []
    for _ in range(100):
        before = time.time()
        local = pylsl.local_clock()
        after = time.time()
        readings.append((after - before, (before + after) / 2 - local))
    return min(readings)[1]


offset = wall_offset()
info = pylsl.StreamInfo("Corneometer", "Moisture", 1, 0, "double64", "probe")
outlet = pylsl.StreamOutlet(info)
inlets = {}
for name in ("/left/wrench", "/left/trial"):
    while not (found := pylsl.resolve_byprop("name", name, 1, 1.0)):
        pass
    inlets[name] = pylsl.StreamInlet(found[0])
    inlets[name].open_stream(30)
element = inlets["/left/wrench"].info(30).desc().child("channels").child("channel")
labels = []
while not element.empty():
    labels.append(element.child_value("label"))
    element = element.next_sibling("channel")
marker, _ = inlets["/left/trial"].pull_sample(timeout=60)
samples = []
while len(samples) < 5:
    values, local = inlets["/left/wrench"].pull_sample(timeout=60)
    samples.append((values[2], local + offset))
began = pylsl.local_clock()
seen = {
    "labels": labels,
    "marker": json.loads(marker[0]),
    "samples": samples,
    "began": began + offset,
}
with open(sys.argv[1] + ".part", "w") as file:
    json.dump(seen, file)
os.replace(sys.argv[1] + ".part", sys.argv[1])
wrong = offset if "unix" in sys.argv else 0.0
while True:
    now = pylsl.local_clock()
    outlet.push_sample([now - began], now + wrong)
    time.sleep(0.02)
