"""Each file of examples/ works, and its page lists it."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from mazebot.common.files.root import ROOT

EXAMPLES = ROOT / "examples"
FILES = sorted(path for path in EXAMPLES.iterdir() if path.is_file())
CELLS = [
    "".join(cell["source"])
    for cell in json.loads((EXAMPLES / "first_run.ipynb").read_text())["cells"]
    if cell["cell_type"] == "code"
]


def run(*command: str, folder: Path, code: int = 0) -> str:
    """What a program says that is started where examples/ is."""
    examples = folder / "examples"
    if not examples.is_symlink():
        examples.symlink_to(EXAMPLES)
    done = subprocess.run(
        [sys.executable, "-W", "error", *command],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT / "services"), "COLUMNS": "200"},
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout


def goal_of(*options: str, folder: Path) -> dict[str, object]:
    """The first goal of the summary of a demo."""
    said = run(
        "-m", "mazebot.cli", "demo", "--world", "original", "--no-camera", "--no-record",
        "--json", "--out", "run", *options, folder=folder,
    )  # fmt: skip
    goal: dict[str, object] = json.loads(said)["goals"][0]
    return goal


def test_the_page_lists_every_file() -> None:
    page = (EXAMPLES / "README.md").read_text()
    for path in FILES:
        assert path.name == "README.md" or f"]({path.name})" in page, f"list {path.name}"


def test_every_python_file_says_how_it_is_started() -> None:
    for path in FILES:
        if path.suffix == ".py":
            text = path.read_text()
            assert re.search(rf"^    .*examples/{path.stem}\.", text, re.MULTILINE), path.name


@pytest.mark.slow
def test_the_planner_leads_to_a_goal(tmp_path: Path) -> None:
    goal = goal_of(
        "--config", "examples/a_star_planner.yaml", "--goal", "0.5", "-0.9", "0", folder=tmp_path
    )
    assert goal["reached"] is True
    assert goal["contacts"] == 0


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map of the original world."""
    folder = tmp_path_factory.mktemp("map")
    run("-m", "mazebot.cli", "world", "build", "original", "--out", "built", folder=folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("goal", "error"),
    [("0.5,-0.9", ""), ("0.75,-0.38", "206"), ("9,9", "204")],
    ids=["free", "occupied", "outside"],
)
def test_the_planner_finds_paths_on_a_map(goal: str, error: str, built: Path) -> None:
    said = run(
        "-m", "mazebot.cli", "plan", "--map", "built/map.yaml", "--start", "0,0", "--goal", goal,
        "--planner", "examples/a_star_planner.py:AStarPlanner", "--json",
        folder=built, code=1 if error else 0,
    )  # fmt: skip
    plan = json.loads(said)
    if error:
        assert plan["error_code"] == int(error)
    else:
        assert 1.0 < plan["length_m"] < 1.3


@pytest.mark.slow
def test_pure_pursuit_drives_to_a_goal(tmp_path: Path) -> None:
    goal = goal_of(
        "--controller", "examples/pure_pursuit.py:PurePursuit", "--goal", "0.5", "-0.9", "0",
        folder=tmp_path,
    )  # fmt: skip
    assert goal["reached"] is True
    assert goal["contacts"] == 0


@pytest.mark.slow
def test_the_patrol_reaches_every_location(tmp_path: Path) -> None:
    lines = run("examples/patrol.py", folder=tmp_path).splitlines()
    assert lines == [f"round 1: location{number}: SUCCEEDED" for number in (1, 2, 3, 4)]


@pytest.mark.parametrize(("options", "words"), [
    (("--rounds", "0"), "argument --rounds: '0': must be a whole number of at least 1"),
    (("--world", "nope"), "error: world_name: 'nope': must be one of "),
])  # fmt: skip
def test_a_mistake_in_the_patrols_options_is_one_line(options: tuple[str, ...], words: str) -> None:
    done = subprocess.run(
        [sys.executable, EXAMPLES / "patrol.py", *options],
        env={**os.environ, "PYTHONPATH": str(ROOT / "services"), "COLUMNS": "200"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode != 0
    assert words in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_the_gazebo_world_is_imported(tmp_path: Path) -> None:
    said = run(
        "-m", "mazebot.cli", "world", "import", "examples/office.sdf", "--out", "office.yaml",
        folder=tmp_path,
    )  # fmt: skip
    assert "ignored:    plugin gz-sim-physics-system" in said
    assert (tmp_path / "office.yaml").is_file()
    assert "no problems" in run(
        "-m", "mazebot.cli", "world", "check", "office.yaml", folder=tmp_path
    )


def test_the_notebook_holds_no_outputs() -> None:
    for cell in json.loads((EXAMPLES / "first_run.ipynb").read_text())["cells"]:
        assert not cell.get("outputs"), "clear all outputs before saving"


@pytest.mark.slow
def test_the_notebook_runs_from_its_first_cell_to_its_last(tmp_path: Path) -> None:
    said = run("-c", "\n".join(CELLS), folder=tmp_path)
    assert "error code 0" in said
    assert "\nTrue\n" in said
    (folder,) = (tmp_path / "recordings").glob("*_notebook")
    assert (folder / "thumbnail.png").is_file()
