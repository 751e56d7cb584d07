import numpy as np

from mazebot.common.maths.frames import SE2, Array
from mazebot.mapping.graph.optimizer import Candidate
from mazebot.mapping.graph.pose_graph import ODOMETRY, Graph
from mazebot.mapping.loops.loop_closing import explains
from mazebot.mapping.matching.scan_points import ScanPoints
from mazebot.mapping.params import SlamParams
from tests.mapping.simulated import box
from tests.mapping.synthetic import scan

TWINS_M = np.concatenate([box(0.0, 0.0, 4.0, 3.0), box(0.0, 5.0, 4.0, 8.0)])
"""Two rooms that look the same, the second 5 m from the first."""
OLDER = [SE2(1.0 + 0.4 * i, 1.5, 0.0) for i in range(4)]
AWAY = SE2(30.0, 0.0, 0.0)


class Walk:
    """Four scans in the first room, a long way, and four scans more."""

    def __init__(self, newer: list[SE2], placed: list[SE2], walls: Array = TWINS_M) -> None:
        random = np.random.default_rng(1)
        self.graph = Graph()
        self.seen = []
        poses = [*OLDER, AWAY, *placed]
        for i, (pose, true) in enumerate(zip(poses, [*OLDER, AWAY, *newer], strict=True)):
            self.graph.add_node(pose)
            self.seen.append(ScanPoints(scan(true, random, walls), np.zeros((0, 2)), SE2(0, 0, 0)))
            if i:
                step = poses[i - 1].inverse() @ pose
                self.graph.add_edge(ODOMETRY, i - 1, i, step, np.eye(3) * 1e-4)

    def explained(self, source_from_target: SE2) -> bool:
        loop = Candidate(1, 6, source_from_target, np.eye(3) * 1e-4)
        return explains(self.graph, self.seen, loop, SlamParams())


def test_a_loop_explains_walls_that_stand_where_the_older_part_saw_open_floor() -> None:
    off = SE2(0.6, -0.5, 0.05)
    walk = Walk(OLDER, [off @ pose for pose in OLDER])
    assert walk.explained(SE2(0.0, 0.0, 0.0))
    assert not walk.explained(OLDER[1].inverse() @ off @ OLDER[1])


def test_a_loop_to_a_room_that_only_looks_the_same_explains_nothing() -> None:
    twins = [SE2(pose.x_m, pose.y_m + 5.0, 0.0) for pose in OLDER]
    assert not Walk(twins, twins).explained(SE2(0.0, 0.0, 0.0))


def test_a_loop_where_all_is_seen_the_same_explains_nothing() -> None:
    assert not Walk(OLDER, OLDER).explained(SE2(0.0, 0.0, 0.0))
