# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The shipped definitions are those of finger_msgs; plain data survives the way to CDR and back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from finger_bag.definitions import (
    Decoder,
    decoder,
    definition_text,
    encode,
    fields_of,
    own_definition,
    own_types,
    type_hash,
)
from finger_bag.schema import TOPICS
from finger_common.errors import InputError


def test_shipped_definitions_equal_the_interface_files(project_root: Path) -> None:
    files = {f.stem: f.read_text() for f in (project_root / "src/finger_msgs/msg").glob("*.msg")}
    shipped = {t.rpartition("/")[2]: own_definition(t) for t in own_types()}
    assert shipped == files


@pytest.mark.parametrize("message_type", sorted({s.type for s in TOPICS.values()}))
def test_definition_text_stands_alone(message_type: str) -> None:
    text = definition_text(message_type)
    again = Decoder(message_type, text)
    assert again.standard
    raw = encode(message_type, {})
    assert repr(again(raw)) == repr(decoder(message_type)(raw))


@pytest.mark.parametrize("message_type", [TOPICS["wrench"].type, "finger_msgs/msg/Trial"])
@pytest.mark.parametrize(
    "changed",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("=" * 80 + "\n", "=" * 80 + "\r\n"),
        lambda text: text.replace("\n", "  \n"),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("=" * 80, "=" * 40),
        lambda text: text + "\0",
        lambda text: text.replace("\nMSG:", "\n\nMSG:"),
    ],
)
def test_definitions_are_read_as_other_systems_write_them(message_type: str, changed) -> None:
    text = changed(definition_text(message_type))
    assert text != definition_text(message_type)
    assert Decoder(message_type, text).standard
    assert fields_of(message_type, text, "ros2msg") == fields_of(
        message_type, definition_text(message_type), "ros2msg"
    )


def test_type_hashes_equal_those_of_the_built_interfaces() -> None:
    finger_msgs = pytest.importorskip("finger_msgs")
    shares = [p / "share" / "finger_msgs" / "msg" for p in Path(finger_msgs.__file__).parents]
    folder = next((s for s in shares if s.is_dir()), None)
    if folder is None:
        pytest.skip("the built interfaces carry no type descriptions here")
    for message_type in own_types():
        described = json.loads((folder / f"{message_type.rpartition('/')[2]}.json").read_text())
        hashes = {h["type_name"]: h["hash_string"] for h in described["type_hashes"]}
        assert type_hash(message_type) == hashes[message_type]


def test_cdr_equals_that_of_the_middleware() -> None:
    serialization = pytest.importorskip("rclpy.serialization")
    messages = pytest.importorskip("finger_msgs.msg")
    geometry = pytest.importorskip("geometry_msgs.msg")
    area = messages.ContactArea(gross_area=5e-5, area_stddev=1e-6, flags=3)
    area.header.frame_id = "plate"
    area.header.stamp.sec = 12
    area.hull = [geometry.Point32(x=0.5, y=1.0, z=2.0)] * 3
    fields = {
        "header": {"stamp": 12_000_000_000, "frame_id": "plate"},
        "gross_area": 5e-5,
        "area_stddev": 1e-6,
        "flags": 3,
        "hull": [{"x": 0.5, "y": 1.0, "z": 2.0}] * 3,
    }
    own = encode("finger_msgs/msg/ContactArea", fields)
    theirs = serialization.serialize_message(area)
    # Padding bytes are not defined: they hold what was in the middleware's buffer.
    assert len(own) == len(theirs) or 0 <= len(theirs) - len(own) < 4
    decode = decoder("finger_msgs/msg/ContactArea")
    assert repr(decode(theirs)) == repr(decode(own))
    assert serialization.deserialize_message(own, messages.ContactArea) == area


def test_plain_data_comes_back() -> None:
    data = np.arange(12, dtype=np.uint8)
    image = {"header": {"stamp": -1_500_000_000}, "height": 3, "width": 4, "step": 4, "data": data}
    message = decoder("sensor_msgs/msg/Image")(encode("sensor_msgs/msg/Image", image))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (-2, 500_000_000)
    assert np.array_equal(message.data, data) and message.height == 3


@pytest.mark.parametrize(
    ("message_type", "fields", "word"),
    [
        ("finger_msgs/msg/Nothing", {}, "finger_msgs/msg/Nothing"),
        ("finger_msgs/msg/Moisture", {"valu": 1.0}, "'valu'"),
        ("finger_msgs/msg/Moisture", {"index": -1}, "Moisture"),
        ("sensor_msgs/msg/CameraInfo", {"k": [1.0]}, "9"),
    ],
)
def test_data_that_do_not_fit_are_refused(message_type: str, fields: dict, word: str) -> None:
    with pytest.raises(InputError, match=word):
        encode(message_type, fields)


@pytest.mark.parametrize(
    "text",
    [
        "this is no definition !",
        "float64",
        "pkg/Missing field\n",
        "finger_msgs/Moisture again\n",
        "x" * 300_000,
        "string[3000000] many\n",
        "builtin_interfaces/Time[3000000] many\n",
        "".join(f"float64 a{i}\n" for i in range(5000)),
    ],
)
def test_hostile_definitions_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="finger_msgs/msg/Moisture"):
        Decoder("finger_msgs/msg/Moisture", text)


def test_definition_of_another_version_is_decoded_with_its_own_fields() -> None:
    older = Decoder("finger_msgs/msg/Moisture", "builtin_interfaces/Time stamp\nfloat32 value\n")
    assert not older.standard
    raw = b"\x00\x01\x00\x00" + np.array([7, 8], "<u4").tobytes() + np.float32(69.5).tobytes()
    message = older(raw)
    assert message.value == 69.5 and message.stamp.sec == 7
