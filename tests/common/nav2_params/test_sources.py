"""Observation sources of a costmap: each has its own parameters, and only the lidar's count."""

from typing import Any

import pytest

from tests.common.nav2_params.files import row_of, told

CLOUD = {
    "topic": "/camera/points", "data_type": "PointCloud2", "marking": True, "clearing": False,
    "obstacle_max_range": 0.5,
}  # fmt: skip
SCAN = {
    "topic": "/scan", "data_type": "LaserScan", "marking": True, "clearing": True,
    "obstacle_max_range": 2.0,
}  # fmt: skip
SET = {"marking": True, "clearing": True, "obstacle_max_range": 2.0}


def layer(kind: str = "ObstacleLayer", **sources: Any) -> dict[str, Any]:
    names = " ".join(sources)
    return {"plugin": f"nav2_costmap_2d::{kind}", "observation_sources": names, **sources}


def costmap(**layers: dict[str, Any]) -> dict[str, Any]:
    return {"plugins": list(layers), **layers}


def source_set(values: dict[str, Any]) -> dict[str, Any]:
    """The settings of the lidar that come of a local costmap."""
    settings: Any = told("local_costmap", values).settings
    found = settings.get("navigation", {}).get("local_costmap", {}).get("obstacle_layer", {})
    assert "depth" not in found
    return dict(found.get("scan", {}))


@pytest.mark.parametrize("kind", ["ObstacleLayer", "VoxelLayer"])
@pytest.mark.parametrize(
    "other",
    [
        CLOUD,
        {**CLOUD, "data_type": "LaserScan", "topic": "/rear/scan"},
        # Nav2's default topic is the source's name.
        {"marking": True, "clearing": False, "obstacle_max_range": 0.5},
    ],
)
def test_another_sensor_sets_nothing_of_the_lidar(kind: str, other: dict[str, Any]) -> None:
    values = costmap(obstacle_layer=layer(kind, other=other, scan=SCAN))
    assert source_set(values) == SET
    found = told("local_costmap", values)
    for name in other:
        row = row_of(found, f"obstacle_layer.other.{name}")
        assert (row.status, row.setting) == ("unsupported", "")
        assert "other is another sensor than the lidar, which is LaserScan on scan" in row.note
    for name in SET:
        assert row_of(found, f"obstacle_layer.scan.{name}").status == "used"


def test_the_lidar_is_known_by_its_topic_and_not_by_the_sources_name() -> None:
    assert source_set(costmap(o=layer(laser=SCAN))) == SET
    unsaid = {name: value for name, value in SCAN.items() if name not in {"topic", "data_type"}}
    assert source_set(costmap(o=layer(scan=unsaid))) == SET
    for topic in ("$(var scan_topic)", "<robot_namespace>/scan"):
        assert source_set(costmap(o=layer(scan={**SCAN, "topic": topic}))) == SET


def test_a_layer_of_another_sensor_does_not_displace_that_of_the_lidar() -> None:
    values = costmap(voxels=layer("VoxelLayer", cloud=CLOUD), obstacles=layer(scan=SCAN))
    assert source_set(values) == SET
    note = row_of(told("local_costmap", values), "voxels.cloud.marking").note
    assert "only obstacles, the first of its kind with the lidar in plugins, is used" in note


def test_without_the_lidar_it_is_said_that_it_marks_all_the_same() -> None:
    found = told("local_costmap", costmap(o=layer(cloud=CLOUD)))
    assert not found.settings
    row = row_of(found, "o.observation_sources")
    assert row.status == "unsupported"
    assert "the lidar is not among them: here it always is" in row.note


MARKS = {
    "topic": "scan", "marking": True, "clearing": False, "obstacle_max_range": 2.0,
    "raytrace_max_range": 2.2,
}  # fmt: skip
CLEARS = {
    "topic": "scan", "marking": False, "clearing": True, "obstacle_max_range": 1.0,
    "raytrace_max_range": 3.2,
}  # fmt: skip


@pytest.mark.parametrize("first", ["marks", "clears"])
def test_sources_that_are_the_lidar_mark_and_clear_together(first: str) -> None:
    sources = {"marks": MARKS, "clears": CLEARS}
    order: dict[str, Any] = {first: sources[first], **sources}
    values = costmap(o=layer(**order))
    assert source_set(values) == {
        "marking": True, "clearing": True, "obstacle_max_range": 2.0, "raytrace_max_range": 3.2,
    }  # fmt: skip
    found = told("local_costmap", values)
    assert row_of(found, "o.clears.marking").note == "marks, the lidar as well, marks"
    assert row_of(found, "o.marks.raytrace_max_range").note == (
        "that of clears counts, the first source of the lidar that clears"
    )


def test_sources_of_which_none_clears_clear_nothing() -> None:
    values = costmap(o=layer(a=MARKS, b={**MARKS, "obstacle_max_range": 0.7}))
    assert source_set(values)["clearing"] is False
    assert source_set(values)["obstacle_max_range"] == 2.0
