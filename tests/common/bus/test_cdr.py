"""CDR bytes, held against those of rosbags."""

from __future__ import annotations

import copy
import struct
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype

from mazebot.common.messages import cdr, wire
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.common.messages.documents import Document
from mazebot.common.messages.topics import TOPICS, Topic
from tests.common.samples import SAMPLES

TYPES = sorted({wire.type_name(topic) for topic in TOPICS})


def made(type_name: str, random: np.random.Generator) -> Any:
    """A message with anything in it: texts, lists and arrays of any length, also none."""
    values: list[Any] = []
    fields: Any = msg.TYPESTORE.fielddefs[type_name][1]
    for _, (kind, what) in fields:
        is_list = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
        item_kind, item = what[0] if is_list else (kind, what)
        count = what[1] if kind is Nodetype.ARRAY else int(random.integers(0, 4))
        if item_kind is Nodetype.NAME:
            several: list[Any] = [made(item, random) for _ in range(count if is_list else 1)]
        elif item[0] == "string":
            several = ["é" * int(random.integers(0, 7)) for _ in range(count if is_list else 1)]
        elif is_list:
            values.append(random.integers(0, 2, count).astype(item[0]))
            continue
        else:
            several = [np.dtype(item[0]).type(random.integers(0, 2)).item()]
        values.append(several if is_list else several[0])
    return msg.TYPESTORE.types[type_name](*values)


@pytest.mark.parametrize("type_name", TYPES)
def test_they_are_the_same_whatever_is_in_a_message(type_name: str) -> None:
    random = np.random.default_rng(7)
    for _ in range(30):
        message = made(type_name, random)
        expected = bytes(msg.TYPESTORE.serialize_cdr(message, type_name))
        assert cdr.encode(type_name, message) == expected


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_they_are_the_same_in_pieces(topic: Topic[Any]) -> None:
    message = SAMPLES[topic]
    data = wire.encode(topic, message)
    assert b"".join(wire.encode_in_pieces(topic, message)) == data
    if not isinstance(message, Document):
        assert data == bytes(msg.TYPESTORE.serialize_cdr(message, wire.type_name(topic)))


@pytest.mark.parametrize(
    ("topic", "path", "value"),
    [
        (table.SCAN, "ranges", np.zeros(3, np.float64)),
        (table.SCAN, "ranges", [1.0, 2.0]),
        (table.SCAN, "angle_min", "0"),
        (table.SCAN, "header", None),
        (table.IMU, "orientation_covariance", np.zeros(8)),
        (table.TF, "transforms", None),
        (table.CAMERA_IMAGE, "data", "pixels"),
        (table.CAMERA_IMAGE, "height", -1),
        (table.JOINT_STATES, "name", [1, 2]),
    ],
)
def test_what_is_not_of_its_type_is_refused(topic: Topic[Any], path: str, value: object) -> None:
    message = copy.deepcopy(SAMPLES[topic])
    setattr(message, path, value)
    for encode in (wire.encode, wire.encode_in_pieces):
        with pytest.raises(wire.WireError, match="wrong type"):
            encode(topic, message)
    with pytest.raises((AttributeError, TypeError, ValueError, struct.error)):
        cdr.encode(wire.type_name(topic), message)
