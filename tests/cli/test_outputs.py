"""Files that a command would write over those that it reads, under their names or by a link."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

from mazebot.common.files.root import ROOT
from tests.cli.test_app import assert_one_line, mazebot
from tests.cli.test_plan import house
from tests.common.recordings.made_run import listed_run

YARD = """<sdf version="1.9"><world name="yard"><model name="stone"><static>true</static>
<link name="link"><visual name="v"><geometry><mesh><uri>yard.glb</uri></mesh></geometry></visual>
<collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision></link></model>
</world></sdf>
"""
LOG = "time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0,range_1,range_2\n" + "".join(
    f"{i / 10},{i / 50},0,0,2,2.5,3\n" for i in range(30)
)
SCANS = ("--angle-min", "0", "--angle-increment", "0.1")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(option: str, *arguments: str) -> None:
    """A mistake in one line, and nothing here has changed."""
    before = contents()
    assert_one_line(mazebot(*arguments), f"{option}: ", "is a file that this command reads")
    assert contents() == before


def contents() -> dict[Path, bytes]:
    return {file: file.read_bytes() for file in Path().rglob("*") if file.is_file()}


def test_a_path_is_not_drawn_over_a_map(here: Path) -> None:
    chart = house(here, suffix="png")
    Path("link.png").symlink_to("house.png")
    Path("twin.png").hardlink_to("house.png")
    places = ("--start", "-0.2,-1", "--goal", "3,-1")
    for name in ("house.png", "link.png", "twin.png"):
        refused("--draw", "plan", "--map", chart, *places, "--draw", name)
    for _ in range(2):
        # What the command has written itself, it writes again.
        assert mazebot("plan", "--map", chart, *places, "--draw", "path.png").returncode == 0


def test_a_picture_that_finds_no_room_leaves_the_one_before(here: Path) -> None:
    plan = f"plan --map {house(here)} --start=-0.2,-1 --goal=3,-1 --draw path.png"
    assert mazebot(*plan.split()).returncode == 0
    before = contents()
    done = subprocess.run(
        ["sh", "-c", f"ulimit -f 0; exec {sys.executable} -m mazebot.cli {plan}"],
        capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT / "services"), "MAZEBOT_PROGRESS": "false"},
    )  # fmt: skip
    assert done.stderr == "error: --draw: path.png: cannot be written: File too large\n"
    assert done.returncode == 2
    assert contents() == before
    # A link is written through, and a device is no file to be replaced.
    Path("link.png").symlink_to("path.png")
    Path("null.png").symlink_to(os.devnull)
    for name in ("link.png", "null.png"):
        assert mazebot(*plan.replace("path.png", name).split()).returncode == 0
        assert Path(name).is_symlink()
    assert Path(os.devnull).is_char_device()


def test_a_log_is_not_overwritten_by_the_map_that_is_made_of_it(here: Path) -> None:
    log = here / "trajectory.csv"
    log.write_text(LOG)
    build = ("map", "build", "--log", str(log), *SCANS)
    refused("--out", *build, "--out", ".")
    refused("--draw", *build, "--out", "map", "--draw", "trajectory.csv")
    assert not Path("map").exists()
    assert_one_line(mazebot(*build, "--out", "map", "--draw", "map/map.pgm"), "--draw", "map.pgm")
    chart = house(here)
    for name in ("trajectory.csv", "house.yaml", "house.pgm"):
        refused(
            "--draw", "localize", "--map", chart, "--log", str(log), *SCANS, "--draw", name,
        )  # fmt: skip


def test_a_model_is_not_overwritten_by_its_preview(here: Path) -> None:
    trimesh.creation.box((1.0, 1.0, 1.0)).export("yard.glb")
    Path("yard.sdf").write_text(YARD)
    refused("--glb", "world", "preview", "yard.sdf")
    assert mazebot("world", "preview", "yard.sdf", "--glb", "plan.glb").returncode == 0


def test_a_world_is_not_exported_over_itself(here: Path) -> None:
    assert mazebot("world", "export", "original", "--out", "sdf").returncode == 0
    # That of an earlier export, edited since.
    (file,) = Path("sdf").glob("*.sdf")
    file.write_text(file.read_text().replace("</world>", "<!-- mine --></world>"))
    refused("--out", "world", "export", str(file), "--out", "sdf")
    assert mazebot("world", "export", "original", "--out", "sdf").returncode == 0


def test_a_run_is_not_overwritten_by_a_table_of_it(here: Path) -> None:
    run = listed_run(here / "recordings", "2026-01-01_10-00-00_house", {"world": "house"})
    summary = run / "summary.json"
    refused("--out", "recordings", "export", "--out", str(summary))
