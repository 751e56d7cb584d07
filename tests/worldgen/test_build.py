"""What `mazebot world build` makes of a world with a mesh before its marker."""

from __future__ import annotations

from pathlib import Path

import pytest

from mazebot.worldgen.build import figures
from mazebot.worldgen.recipe.loader import load_world
from mazebot.worldgen.world_model import world_glb
from tests.worldgen import folder

SHEET = "v -0.5 0 0\nv 0.5 0 0\nv 0.5 0 1\nv -0.5 0 1\nf 1 2 3 4\n"


@pytest.mark.parametrize(("y_m", "hanging"), [(-0.6, 0), (0.8, 1)])
def test_a_mesh_hides_a_marker_in_figures_and_model(
    tmp_path: Path, y_m: float, hanging: int
) -> None:
    sheet = {"name": "sheet", "file": "sheet.obj", "x_m": 0.5, "y_m": y_m, "material": "plain"}
    folder.make(tmp_path, folder.room() | {"meshes": [sheet]})
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "sheet.obj").write_text(SHEET)
    loaded = load_world("room", worlds_dir=tmp_path)
    found = figures(loaded)
    assert (found["markers_hanging"], found["markers_refused"]) == (hanging, 1 - hanging)
    assert (b"aruco_3" in world_glb(loaded)) is bool(hanging)
