"""The relations metric against values computed by hand, and files of relations."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mazebot.cli.map.relations import Relations, read_relations, relation_errors
from mazebot.common.config import ConfigError

QUARTER, TWO = math.pi / 2.0, math.radians(2.0)
TIMES = np.array([10.0, 11.0, 12.0, 13.0])
POSES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, math.pi / 2], [1.0, 2.0, 3.1]])


def relations(*rows: tuple[float, float, float, float, float]) -> Relations:
    table = np.array(rows)
    return Relations(table[:, 0], table[:, 1], table[:, 2:])


class TestErrors:
    def test_a_trajectory_as_the_relations_have_it_is_exact(self) -> None:
        errors = relation_errors(
            TIMES, POSES,
            relations((10, 11, 1, 0, 0), (10, 12, 1, 0, QUARTER), (12, 13, 2, 0, 3.1 - QUARTER)),
        )  # fmt: skip
        assert errors.used == 3
        assert errors.translation_m == pytest.approx((0.0, 0.0), abs=1e-12)
        assert errors.rotation_deg == pytest.approx((0.0, 0.0), abs=1e-9)

    def test_means_and_deviations_by_hand(self) -> None:
        # Wrong by 0.1 m and 2 degrees, and by 0.3 m and 4 degrees.
        errors = relation_errors(
            TIMES, POSES,
            relations((10, 11, 0.9, 0, -TWO), (12, 13, 1.7, 0, 3.1 - QUARTER + 2.0 * TWO)),
        )  # fmt: skip
        # (T1^-1 T2) E^-1 of the first: a turn by 2 degrees, and 1 - R(2 deg) 0.9.
        x, y = 1.0 - 0.9 * math.cos(math.radians(2)), -0.9 * math.sin(math.radians(2))
        first = math.hypot(x, y)
        x, y = 2.0 - 1.7 * math.cos(math.radians(4)), 1.7 * math.sin(math.radians(4))
        second = math.hypot(x, y)
        mean = (first + second) / 2
        assert errors.translation_m == pytest.approx((mean, abs(first - second) / math.sqrt(2)))
        squares = first**2, second**2
        assert errors.translation_squared_m2[0] == pytest.approx(sum(squares) / 2)
        assert errors.rotation_deg == pytest.approx((3.0, math.sqrt(2.0)))
        assert errors.rotation_squared_deg2 == pytest.approx((10.0, 12.0 / math.sqrt(2.0)))

    def test_poses_between_scans_are_interpolated_the_short_way_round(self) -> None:
        poses = np.array([[0.0, 0.0, 3.0], [1.0, 0.0, -3.0]])
        c, s = math.cos(3.0), math.sin(3.0)
        errors = relation_errors(
            np.array([0.0, 2.0]), poses,
            relations((0, 1, 0.5 * c, -0.5 * s, math.pi - 3.0), (0, 0, 0, 0, 0)),
        )  # fmt: skip
        assert errors.translation_m[0] == pytest.approx(0.0, abs=1e-12)
        assert errors.rotation_deg[0] == pytest.approx(0.0, abs=1e-9)

    def test_between_scans_the_pose_moves_as_odometry_does_and_is_counted(self) -> None:
        # Ahead, and back at the end; the map is turned against odometry, which is 10 % too long.
        odom_x = np.array([0.0, 1.1, 2.2, 1.1, 0.0])
        odometry = np.stack([np.arange(5.0), odom_x, np.zeros(5), np.zeros(5)], axis=1)
        poses = np.array([[5.0, 5.0, QUARTER], [5.0, 5.0, QUARTER]])
        errors = relation_errors(
            np.array([0.0, 4.0]), poses,
            relations((0, 1, 1.1, 0, 0), (1, 2, 1.1, 0, 0), (0, 4, 0, 0, 0)), odometry,
        )  # fmt: skip
        assert errors.translation_m[0] == pytest.approx(0.0, abs=1e-12)
        assert (errors.used, errors.between) == (3, 2)

    def test_relations_outside_of_the_log_are_left_out(self) -> None:
        inside = (10.0, 11.0, 1.0, 0.0, 0.0)
        errors = relation_errors(TIMES, POSES, relations(inside, inside, (10, 14, 0, 0, 0)))
        assert (errors.used, errors.left_out) == (2, 1)
        with pytest.raises(ConfigError, match="0 of 1 are within the time of the log, 10"):
            relation_errors(TIMES, POSES, relations((99, 100, 0, 0, 0)))


class TestFiles:
    def test_planar_parts_are_read(self, tmp_path: Path) -> None:
        path = tmp_path / "intel.relations"
        path.write_text("# t1 t2 x y z r p y\n1.5 2.5 0.1 -0.2 0 0 0 0.3\n\n3 4 1 2 0 0 0 -1\n")
        read = read_relations(path)
        assert read.from_s.tolist() == [1.5, 3.0]
        assert read.to_s.tolist() == [2.5, 4.0]
        assert read.relative.tolist() == [[0.1, -0.2, 0.3], [1.0, 2.0, -1.0]]

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("1 2 3\n", ":1: '1 2 3': must be 8 numbers"),
            ("1 2 0 0 0 0 0 0\n1 2 x 0 0 0 0 0\n", ":2: '1 2 x 0 0 0 0 0': must be 8"),
            ("1 2 0 0 0 0 0 nan\n", ":1:"),
            ("# nothing\n", "has no relations"),
        ],
    )
    def test_mistakes(self, tmp_path: Path, text: str, said: str) -> None:
        path = tmp_path / "wrong.relations"
        path.write_text(text)
        with pytest.raises(ConfigError) as error:
            read_relations(path)
        assert said in str(error.value)
        assert str(path) in str(error.value)

    def test_a_file_that_is_not_there(self, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match="No such file"):
            read_relations(tmp_path / "none")
