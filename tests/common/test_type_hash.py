"""Type hashes from definitions. tests/ros2 compares all of them with those of ROS 2's generator."""

from __future__ import annotations

import pytest

from mazebot.common.messages.type_hash import hash_of, type_hash

OFFICIAL = {
    "std_msgs/msg/String": (
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    ),
    "sensor_msgs/msg/LaserScan": (
        "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"
    ),
}


def test_hash_of_a_topic_type_is_the_official_one() -> None:
    assert {name: hash_of(name) for name in OFFICIAL} == OFFICIAL


def test_comments_constants_and_defaults_are_no_part_of_a_hash() -> None:
    plain = type_hash("a/msg/A", {"a/msg/A": "int32 x\nstring<=5[<=3] names"})
    text = "# What.\nint32 MAX = 5\nstring WHO='#'\nint32 x 3  # it\nstring<=5[<=3] names ['a']"
    assert type_hash("a/msg/A", {"a/msg/A": text}) == plain


@pytest.mark.parametrize(
    "text", ["int64 x", "int32 y", "int32[] x", "int32[2] x", "int32[<=2] x", "int32[3] x"]
)
def test_another_field_is_another_type(text: str) -> None:
    assert type_hash("a/msg/A", {"a/msg/A": text}) != type_hash("a/msg/A", {"a/msg/A": "int32 x"})


def test_a_hash_depends_on_the_types_inside() -> None:
    outer = {"a/msg/A": "B[] them"}
    assert type_hash("a/msg/A", {**outer, "a/msg/B": "int32 x"}) != type_hash(
        "a/msg/A", {**outer, "a/msg/B": "int64 x"}
    )


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a/msg/A", "b/B it", "a/msg/A: no definition of b/msg/B"),
        ("a/msg/A", "int32", "a/msg/A: 'int32': must be a type and a name"),
        ("a/srv/A", "int32 x", "a/srv/A: must have 2 parts, with --- between"),
        ("a/action/A", "int32 x\n---", "a/action/A: must have 3 parts, with --- between"),
    ],
)
def test_a_bad_definition_is_named(name: str, text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        type_hash(name, {name: text})
