"""Logs whose lidar is turned otherwise on the robot than said."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mazebot.cli.app import app
from mazebot.cli.logs.log import Entry, Log, LoggedScan
from mazebot.cli.logs.turned import check_turn
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from tests.cli import robot_logs

RUNNER = CliRunner()
STEP = math.pi / 180.0


@pytest.fixture(scope="module")
def carmen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(5)
    log = robot_logs.make(robot_logs.hall(rng, boxes=20, rounds=1), rng, every=8)
    return log.write_carmen(tmp_path_factory.mktemp("hall") / "hall.log")


@pytest.fixture(scope="module")
def mapped(carmen: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map of the log as it is."""
    out = tmp_path_factory.mktemp("map")
    built = RUNNER.invoke(app, ["map", "build", "--log", str(carmen), "--out", str(out)])
    assert built.exit_code == 0
    return out / "map.yaml"


@pytest.mark.parametrize(
    ("flags", "said", "remedy"),
    [
        ({"--angle-min": "0"}, "turned by 90 degrees to the right", {"--lidar": "0 0 -1.5708"}),
        ({"--lidar": "0 0 3.1416"}, "turned by 180 degrees", {"--lidar": "0 0 0.0000"}),
        (
            {"--angle-min": str(math.pi / 2), "--angle-increment": str(-STEP)},
            "mirrored beams",
            {"--angle-min": "-1.5708", "--angle-increment": "0.0174533"},
        ),
    ],
)
@pytest.mark.parametrize("command", ["map build", "localize"])
def test_a_turned_lidar_is_refused_with_what_to_give(
    carmen: Path,
    mapped: Path,
    tmp_path: Path,
    command: str,
    flags: dict[str, str],
    said: str,
    remedy: dict[str, str],
) -> None:
    out = ["--out", str(tmp_path / "out")]
    if command == "localize":
        out = ["--map", str(mapped), "--start", "0 0 0"]
    asked = [*command.split(), "--log", str(carmen), *out]
    (line,) = str(RUNNER.invoke(app, [*asked, *words(flags)]).exception).splitlines()
    assert line.startswith(f"--log: {carmen}: the scans do not fit odometry")
    assert said in line
    assert " ".join(words(remedy)) in line
    if command == "map build":
        right = RUNNER.invoke(app, [*asked, *words({**flags, **remedy})])
        assert (right.exit_code, "warning" in right.stderr) == (0, False)


def words(flags: dict[str, str]) -> list[str]:
    return [word for pair in flags.items() for word in pair]


def room(*yaws_rad: float, moves: bool = True) -> Log:
    """A drive along a room of 8 x 4 m with a pillar, by lidars at these angles, one after the
    other.
    """
    angles_rad = np.arange(0.0, math.tau, STEP)
    entries = []
    for i in range(80):
        x_m = -3.0 + 0.07 * i * moves
        yaw_rad = yaws_rad[i % len(yaws_rad)]
        u, v = np.cos(angles_rad + yaw_rad), np.sin(angles_rad + yaw_rad)
        with np.errstate(divide="ignore", invalid="ignore"):
            walls_m = np.minimum((np.sign(u) * 4.0 - x_m) / u, np.sign(v) * 2.0 / v)
            along, across = -x_m * u + 1.5 * v, x_m * v + 1.5 * u
            into = np.sqrt(0.16 - across**2)
        ranges_m = np.where((along > 0.0) & (into > 0.0), along - into, walls_m)
        scan = LoggedScan(
            ranges_m.astype(np.float32), 0.0, STEP, 0.1, 20.0, f"lidar{i % len(yaws_rad)}",
            SE2(0.0, 0.0, 0.0),
        )  # fmt: skip
        entries.append(Entry(i * 100_000_000, SE2(x_m, 0.0, 0.0), scan))
    return Log(entries)


def test_of_two_lidars_the_turned_one_is_named() -> None:
    check_turn("x", room(0.0, 0.0), None)
    with pytest.raises(ConfigError, match=r"of 'lidar1'.* 90 degrees to the left.* transforms"):
        check_turn("x", room(0.0, math.pi / 2.0), None)


def test_a_robot_that_stands_refutes_nothing() -> None:
    check_turn("x", room(math.pi / 2.0, moves=False), None)
