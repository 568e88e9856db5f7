# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Installed definitions describe the types completely."""

from __future__ import annotations

import pytest

pytest.importorskip("std_msgs", reason="ROS 2 is not installed")

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from finger_bag.definitions import definition_text
from finger_common.errors import InputError
from finger_common.interface_text import message_text, service_texts

TYPES = (
    "finger_msgs/msg/ContactState",
    "finger_msgs/msg/ContactArea",
    "sensor_msgs/msg/Image",
    "diagnostic_msgs/msg/DiagnosticArray",
    "std_msgs/msg/String",
)


@pytest.mark.parametrize("kind", TYPES)
def test_a_definition_has_the_fields_of_the_type_and_of_all_it_refers_to(kind: str) -> None:
    standard = get_typestore(Stores.ROS2_JAZZY)
    alone = Typestore()
    alone.register(get_types_from_msg(message_text(kind), kind))
    known = Typestore()
    known.register(get_types_from_msg(definition_text(kind), kind))
    assert alone.fielddefs[kind][1] == known.fielddefs[kind][1]
    assert alone.fielddefs.keys() == known.fielddefs.keys()
    for name in alone.fielddefs.keys() & standard.fielddefs.keys():
        assert alone.fielddefs[name][1] == standard.fielddefs[name][1], name


def test_a_service_has_both_texts_with_the_messages_that_each_refers_to() -> None:
    request, response = service_texts("finger_msgs/srv/Record")
    types = get_types_from_msg(request, "finger_msgs/msg/Record_Request")
    assert {"finger_msgs/msg/Trial", "std_msgs/msg/Header"} <= types.keys()
    assert "MSG:" not in response
    fields = get_types_from_msg(response, "finger_msgs/msg/Record_Response")
    names = [name for name, _ in fields["finger_msgs/msg/Record_Response"][1]]
    assert names[:2] == ["success", "message"]


def test_an_absent_type_is_named() -> None:
    with pytest.raises(InputError, match=r"msg/Absent\.msg of package 'std_msgs' is not found"):
        message_text("std_msgs/msg/Absent")
    with pytest.raises(InputError, match="package 'no_such_msgs'"):
        message_text("no_such_msgs/msg/Thing")
