"""Things that the map has and the world has no more."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.common.messages.topics import AMCL_POSE, LOCALIZATION_STATUS
from mazebot.common.world.map_files import write_map
from mazebot.embedded.session import Session
from mazebot.localization.beam_model import HIT, THROUGH, RayMap, judge, scan_view
from mazebot.localization.gone import seen_through, without_gone
from mazebot.localization.likelihood_field import likelihood_field
from mazebot.worldgen.recipe.loader import load_world
from tests.worldgen import folder

CELL_M = 0.05


def hall(*boxes: dict[str, Any]) -> dict[str, Any]:
    """A square room that looks the same from four sides, but for boxes."""
    recipe = {**folder.room(), "boxes": list(boxes), "markers": [], "locations": {}}
    for wall in recipe["walls"]:
        wall.update(length_m=6.0, x_m=1.5 * wall["x_m"], y_m=3.0 * wall["y_m"])
    return recipe


def test_in_a_room_that_looks_the_same_from_all_sides_a_table_may_be_carried_away(
    tmp_path: Path,
) -> None:
    table = {"name": "table", "size_m": [1.0, 1.0, 1.0], "x_m": 0.0, "y_m": 1.2}
    folder.make(tmp_path, hall(table))
    old = load_world("room", worlds_dir=tmp_path)
    map_file = write_map(tmp_path, "old", old.map_cells, old.world.map_resolution_m, old.map_origin)
    folder.make(tmp_path, hall())
    with Session("room", worlds_dir=tmp_path, camera=False, map_file=map_file) as session:
        session.run_for(1.0)
        status = session.latest(LOCALIZATION_STATUS)
        assert status is not None
        assert status.state == "localized", status.reason
        assert session.goal(0.0, -2.0).error_code == 0
        truth, estimate = session.ground_truth(), session.latest(AMCL_POSE)
        assert estimate is not None
        assert math.hypot(truth.x_m, truth.y_m + 2.0) < 0.3
        assert math.hypot(estimate.pose.pose.position.x - truth.x_m, truth.y_m + 2.0) < 0.3


def room_with_a_wall() -> RayMap:
    """6 by 4 m, with a piece of wall at x = 3.5 m, seen from 1 to 3 m along y."""
    cells = np.zeros((81, 121), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[20:60, 70] = 100
    grid = SE2(0.0, 0.0, 0.0)
    field = likelihood_field(
        cells, CELL_M, grid, z_hit=0.9, z_rand=0.1, sigma_hit_m=0.04, max_distance_m=2.0,
        wall_inset_cells=0.5, range_max_m=3.5,
    )  # fmt: skip
    return RayMap.of(cells, CELL_M, grid, field, 0.5, 0.1)


def ranges_in_the_empty_room(pose: SE2, beams: int) -> NDArray[np.float32]:
    angles = pose.yaw_rad + 2.0 * math.pi * np.arange(beams) / beams
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        along_x = np.where(c > 0.0, 6.025 - pose.x_m, 0.025 - pose.x_m) / c
        along_y = np.where(s > 0.0, 4.025 - pose.y_m, 0.025 - pose.y_m) / s
    return np.minimum(along_x, along_y).astype(np.float32)


def test_beams_that_end_on_the_walls_behind_contradict_no_pose_but_a_wrong_one() -> None:
    rays, true = room_with_a_wall(), SE2(2.0, 2.0, 0.0)
    ranges_m = ranges_in_the_empty_room(true, 90)
    scan = Scan(
        stamp_ns=0, angle_min_rad=0.0, angle_increment_rad=2.0 * math.pi / 90,
        range_min_m=0.1, range_max_m=9.0, ranges_m=ranges_m, base_from_scan=SE2(0.0, 0.0, 0.0),
    )  # fmt: skip
    view = scan_view(scan, 90)
    poses = np.array([true, SE2(2.0, 2.4, 0.0)])
    counts, likelihoods = judge(rays, poses, view)
    assert counts[0, THROUGH] > 10
    assert counts[1, THROUGH] > 10
    cleared, likelier = without_gone(seen_through(rays), poses, view, counts, likelihoods)
    assert cleared[0, THROUGH] == 0
    assert cleared[0, HIT] >= 88
    assert likelier[0] > likelihoods[0] + 10.0
    assert np.array_equal(cleared[1], counts[1])
    assert likelier[1] == likelihoods[1]
