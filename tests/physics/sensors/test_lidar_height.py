"""A lidar at another height than that for which worlds' maps are made."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from mazebot.common.files.root import ROOT
from mazebot.common.messages.documents import Body, Box, Geometry, Mesh, Shape
from mazebot.physics import config
from mazebot.physics.sensors.lidar_height import seen_otherwise
from tests.physics.driver import TABLE, Driver, world

WORLD = world(walls=[("High", 4.0, 0.0, -2.0, 0.0), ("Low", 4.0, 0.0, 2.0, 0.0)])
HIGH, LOW = WORLD.walls
LOW = LOW.model_copy(update={"height_m": 0.3})
WORLD = WORLD.model_copy(update={"walls": (HIGH, LOW)})
WORLD = WORLD.model_copy(update={"hash": WORLD.content_hash()})


def body(name: str, geometry: Geometry, z_m: float, solid: bool = True) -> Body:
    shape = Shape(name="all", geometry=geometry, material="plain", solid=solid)
    return Body(name=name, position_m=(1.0, 0.0, z_m), shapes=(shape,))


BODIES = (
    body("crate", Box(size_m=(0.3, 0.3, 0.2)), 0.1),
    body("shelf", Box(size_m=(0.3, 0.3, 0.2)), 0.6),
    body("curtain", Box(size_m=(0.3, 0.3, 0.2)), 0.6, solid=False),
    body("table", Mesh(sha256="table"), 0.0),
)
MESHES = {"table": TABLE}


@pytest.mark.parametrize(
    ("lidar_m", "bodies", "told"),
    [
        (0.6, (), "only that one meets Low;"),
        (0.6, BODIES, "only that one meets Low, crate; only this one meets shelf;"),
        (0.05, BODIES, ""),
        (0.9, BODIES, "only that one meets Low, crate, table;"),
        (0.145, BODIES, ""),
    ],
)
def test_what_only_one_of_two_heights_meets_is_told(
    lidar_m: float, bodies: tuple[Body, ...], told: str
) -> None:
    reason = seen_otherwise(WORLD.model_copy(update={"bodies": bodies}), MESHES, lidar_m)
    assert bool(reason) == bool(told)
    assert told in reason
    assert not reason or f"{lidar_m:.3f} m above the floor" in reason
    assert not reason or "made for one at 0.132 m" in reason


def test_a_robot_that_makes_its_map_itself_has_its_lidars_height_in_it() -> None:
    assert not seen_otherwise(WORLD.model_copy(update={"slam": True}), {}, 0.6)


def test_many_are_counted() -> None:
    walls = tuple(LOW.model_copy(update={"name": f"W{i}"}) for i in range(8))
    reason = seen_otherwise(WORLD.model_copy(update={"walls": walls}), {}, 0.6)
    assert "W0, W1, W2, W3, W4 and 3 more;" in reason


def test_a_world_that_is_loaded_is_told_of_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    urdf = (ROOT / "models" / "turtlebot3_waffle" / "model.urdf").read_text()
    assert "-0.064 0 0.122" in urdf
    (tmp_path / "models" / "mast").mkdir(parents=True)
    raised = urdf.replace("-0.064 0 0.122", "-0.064 0 0.59")
    (tmp_path / "models" / "mast" / "model.urdf").write_text(raised)
    monkeypatch.setattr(config, "ROOT", tmp_path)
    with caplog.at_level(logging.WARNING):
        driver = Driver(robot_model="mast").load(WORLD)
        driver.wait(0.1)
    (told,) = caplog.messages
    assert "only that one meets Low" in told
