"""Each critic prefers what it should, in scenes made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.navigation.control.collision import Surroundings
from mazebot.navigation.control.mppi import critics_of_motion, critics_of_obstacles, critics_of_path
from mazebot.navigation.control.mppi.clearance_window import ClearanceWindow, covering_discs
from mazebot.navigation.control.mppi.critic_params import (
    ConstraintCriticParams,
    CostCriticParams,
    GoalAngleCriticParams,
    GoalCriticParams,
    MovingObstaclesCriticParams,
    ObstaclesCriticParams,
    PathAlignCriticParams,
    PathAngleCriticParams,
    PathFollowCriticParams,
    PreferForwardCriticParams,
    TwirlingCriticParams,
    VelocityDeadbandCriticParams,
)
from mazebot.navigation.control.mppi.critics import Scene
from mazebot.navigation.control.mppi.critics_of_path import furthest_reached, travel
from mazebot.navigation.control.mppi.rollouts import Floats, Limits, Rollouts, roll_out
from mazebot.navigation.control.track import Track
from mazebot.navigation.costmap.footprint import WAFFLE, Footprint
from mazebot.navigation.costmap.layered_costmap import (
    Costmap,
    InflationParams,
    frame_of,
    inflate,
)

F = np.float32
STEPS, DT = 56, 0.05
LIMITS = Limits(F(-0.4), F(0.46), F(1.9), F(9.0), F(9.0), F(9.0), F(DT))
STRAIGHT, LEFT, STAND, BACK, SPIN = (0.4, 0.0), (0.4, 0.5), (0.0, 0.0), (-0.3, 0.0), (0.0, 1.0)
FAR = SE2(3.0, 0.0, 0.0)
ALL = (STRAIGHT, LEFT, STAND, BACK, SPIN)


def costmap(*lethal_m: tuple[float, float, float, float]) -> Costmap:
    """Six metres square about the origin, with boxes (x0, y0, x1, y1) in it."""
    cells = np.zeros((120, 120), np.int8)
    for box in lethal_m:
        x0, y0, x1, y1 = (round((value + 3.0) / 0.05) for value in box)
        cells[y0:y1, x0:x1] = 100
    frame = frame_of(0.05, SE2(-3.0, -3.0, 0.0), cells)
    return inflate(
        frame,
        cells >= 100,
        cells < 0,
        InflationParams(
            custom_inscribed_radius=0.153, inflation_radius=0.7, cost_scaling_factor=10.0
        ),
    )


def scene(
    controls: tuple[tuple[float, float], ...] = ALL,
    grid: Costmap | None = None,
    path: tuple[tuple[float, float], ...] = ((0.0, 0.0), (1.7, 0.0)),
    remaining_m: float = 3.0,
    goal: SE2 = FAR,
    tracks: Floats | None = None,
    echoes_m: Floats | None = None,
) -> Scene:
    """What rollouts of constant controls from the origin see."""
    count = len(controls)
    rollouts = Rollouts.empty(STEPS, count)
    rollouts.cos_yaw[0] = 1.0
    rollouts.linear_m_s[0], rollouts.angular_rad_s[0] = np.array(controls, F).T
    still = np.zeros((STEPS, count), F)
    roll_out(still[:, 0], still[:, 0], still, still, 0, np.array(controls, F), LIMITS, rollouts)
    window = ClearanceWindow(1.7)
    echoes = np.empty((0, 2)) if echoes_m is None else echoes_m.astype(np.float64)
    window.update(Surroundings(SE2(0.0, 0.0, 0.0), grid or costmap(), echoes), True)
    line = np.linspace(path[0], path[1], 35).astype(F)
    travelled = np.zeros((STEPS + 1, count), F)
    travel(rollouts.linear_m_s, F(DT), travelled)
    made = Scene(
        rollouts=rollouts, step_s=DT, costs=np.zeros(count, F), collides=np.zeros(count, np.bool_),
        path_x_m=line[:, 0].copy(), path_y_m=line[:, 1].copy(),
        path_free=np.ones(len(line), np.bool_), spacing_m=0.05, remaining_m=remaining_m,
        goal_x_m=goal.x_m, goal_y_m=goal.y_m, goal_turn_rad=goal.yaw_rad, window=window,
        discs=covering_discs(WAFFLE), start_clearance_m=0.5,
        tracks=np.empty((0, 6), F) if tracks is None else tracks, travelled_m=travelled,
    )  # fmt: skip
    made.furthest = furthest(made)
    return made


def furthest(made: Scene) -> int:
    rollouts = made.rollouts
    return int(
        furthest_reached(
            rollouts.x_m[-1], rollouts.y_m[-1], made.travelled_m[-1], made.collides,
            made.path_x_m, made.path_y_m, F(made.spacing_m),
        )
    )  # fmt: skip


def test_the_discs_are_inside_the_footprint_and_leave_out_little() -> None:
    discs = covering_discs(WAFFLE)
    points = WAFFLE.points_m
    for x, y, radius in discs:
        assert WAFFLE.padded(1e-3).points_m[:, 0].min() <= x - radius
        assert x + radius <= points[:, 0].max() + 1e-3
        assert abs(y) + radius <= points[:, 1].max() + 1e-3
    for corner in points:
        beyond = np.hypot(*(discs[:, :2] - corner).T) - discs[:, 2]
        assert beyond.min() < 0.03


def test_a_round_robot_needs_few_discs() -> None:
    assert len(covering_discs(Footprint.circle(0.2))) == 1


def test_speeds_outside_the_range_cost_the_constraint_critic() -> None:
    made = scene(((0.46, 0.0), (0.4, 0.0), (-0.3, 0.0)))
    critics_of_motion.ConstraintCritic(ConstraintCriticParams(), -0.2, 0.4).score(made)
    assert made.costs == pytest.approx(
        [4.0 * 56 * 0.05 * 0.06, 0.0, 4.0 * 56 * 0.05 * 0.1], rel=1e-4
    )


def test_a_power_is_that_of_the_weighted_value() -> None:
    made = scene((BACK,))
    critics_of_motion.PreferForwardCritic(PreferForwardCriticParams(cost_power=3)).score(made)
    assert made.costs[0] == pytest.approx((5.0 * 56 * 0.05 * 0.3) ** 3, rel=1e-4)


def test_driving_backwards_costs_where_the_goal_is_far() -> None:
    made, near = scene(), scene(remaining_m=0.3)
    critic = critics_of_motion.PreferForwardCritic(PreferForwardCriticParams())
    critic.score(made)
    critic.score(near)
    assert np.flatnonzero(made.costs).tolist() == [3]
    assert not near.costs.any()


def test_turning_costs_the_twirling_critic() -> None:
    made = scene()
    critics_of_motion.TwirlingCritic(TwirlingCriticParams(enabled=True)).score(made)
    assert made.costs == pytest.approx([0.0, 5.0, 0.0, 0.0, 10.0])


def test_speeds_in_the_dead_band_cost() -> None:
    made = scene(((0.4, 0.4), (0.02, 0.4), (0.02, 0.0)))
    params = VelocityDeadbandCriticParams(enabled=True)
    critics_of_motion.VelocityDeadbandCritic(params).score(made)
    assert made.costs[0] == 0.0
    assert 0.0 < made.costs[1] < made.costs[2]


@pytest.mark.parametrize(
    "critic",
    [
        critics_of_obstacles.CostCritic(CostCriticParams()),
        critics_of_obstacles.ObstaclesCritic(ObstaclesCriticParams(enabled=True)),
    ],
)
def test_trajectories_into_an_obstacle_collide_and_near_ones_cost(
    critic: critics_of_obstacles.CostCritic | critics_of_obstacles.ObstaclesCritic,
) -> None:
    made = scene((STRAIGHT, LEFT, STAND, BACK), costmap((0.9, -0.5, 1.1, 0.05)))
    critic.score(made)
    assert made.collides.tolist() == [True, False, False, False]
    assert made.costs[0] > 1e4
    assert made.costs[1] > made.costs[2] >= made.costs[3] >= 0.0
    assert not made.failed


def test_the_corners_of_the_robot_are_judged_and_not_a_circle() -> None:
    # A passage 0.46 m wide between two boxes: it fits along it, and not across.
    grid = costmap((0.3, -1.0, 1.5, -0.25), (0.3, 0.25, 1.5, 1.0))
    made = scene((STRAIGHT, (0.4, 0.25)), grid)
    critics_of_obstacles.CostCritic(CostCriticParams()).score(made)
    assert made.collides.tolist() == [False, True]


def test_a_robot_that_touches_may_leave_and_not_come_nearer() -> None:
    made = scene((STRAIGHT, STAND, BACK), costmap((0.05, -0.1, 0.3, 0.1)))
    made.start_clearance_m = -0.02
    critics_of_obstacles.CostCritic(CostCriticParams()).score(made)
    assert made.collides[0]
    assert not made.collides[2]


def test_all_collisions_fail_the_scene() -> None:
    made = scene((STRAIGHT,), costmap((0.9, -0.5, 1.1, 0.5)))
    critics_of_obstacles.CostCritic(CostCriticParams()).score(made)
    assert made.failed


def test_echoes_that_the_costmap_does_not_explain_are_obstacles() -> None:
    echoes = np.array([(0.9, 0.0), (0.9, 0.1)])
    made = scene((STRAIGHT, STAND), echoes_m=echoes)
    critics_of_obstacles.CostCritic(CostCriticParams()).score(made)
    assert made.collides.tolist() == [True, False]


def test_echoes_of_a_tracked_obstacle_are_left_to_its_critic() -> None:
    echoes, track = np.array([(0.9, 0.0)]), Track(1, 1.0, 0.0, 0.3, 0.0, 0.1)
    around = Surroundings(SE2(0.0, 0.0, 0.0), costmap(), echoes, tracks=(track,))
    window = ClearanceWindow(1.7)
    window.update(around, without_tracks=True)
    assert window.distance_m.min() > 0.5
    window.update(around, without_tracks=False)
    assert window.distance_m.min() < 0.02


def test_where_a_moving_obstacle_will_be_collides_and_not_where_it_is() -> None:
    # It comes from the left and reaches the straight way, 0.8 m ahead, when the robot does.
    crossing = np.array([(0.8, 0.8, 0.0, -0.4, 0.15, np.inf)], F)
    standing = np.array([(0.8, 0.8, 0.0, 0.0, 0.15, np.inf)], F)
    critic = critics_of_obstacles.MovingObstaclesCritic(MovingObstaclesCriticParams())
    for tracks, hits in ((crossing, [True, False]), (standing, [False, False])):
        made = scene((STRAIGHT, BACK), tracks=tracks)
        critic.score(made)
        assert made.collides.tolist() == hits
        assert (made.costs[0] > 100.0) == hits[0]
    assert made.costs[0] >= 0.0


def test_a_robot_that_is_too_near_to_a_moving_obstacle_may_leave() -> None:
    beside = np.array([(0.3, 0.0, 0.0, 0.0, 0.12, np.inf)], F)
    made = scene((STRAIGHT, BACK), tracks=beside)
    critics_of_obstacles.MovingObstaclesCritic(MovingObstaclesCriticParams()).score(made)
    assert made.collides.tolist() == [True, False]


def test_a_later_meeting_costs_less_than_a_sooner_one() -> None:
    ahead = np.array([(1.0, 0.0, -0.1, 0.0, 0.15, np.inf)], F)
    made = scene(((0.4, 0.0), (0.3, 0.0)), tracks=ahead)
    critics_of_obstacles.MovingObstaclesCritic(MovingObstaclesCriticParams()).score(made)
    assert made.collides.all()
    assert made.costs[1] < made.costs[0]


def test_a_moving_obstacle_turns_back_at_a_wall() -> None:
    # It meets a wall after 0.5 s and is back on the way after 1.5 s.
    back = np.array([(0.5, 0.4, 0.0, 0.4, 0.15, 0.5)], F)
    made = scene((STRAIGHT,), tracks=back)
    critics_of_obstacles.MovingObstaclesCritic(MovingObstaclesCriticParams()).score(made)
    assert made.collides[0]


def test_the_window_knows_when_a_moving_disc_meets_a_wall() -> None:
    window = ClearanceWindow(1.7)
    grid = costmap((0.95, -3.0, 1.2, 3.0))
    window.update(Surroundings(SE2(0.0, 0.0, 0.0), grid, np.empty((0, 2))), True)
    # The wall's first cell is lethal from its centre at 0.975 m on.
    assert window.time_to_wall_s(0.0, 0.0, 0.4, 0.0, 0.15, 3.0) == pytest.approx(2.1, abs=0.1)
    assert window.time_to_wall_s(0.0, 0.0, -0.4, 0.0, 0.15, 3.0) == np.inf


def test_the_goal_critic_prefers_what_comes_nearer() -> None:
    made, far = scene(remaining_m=1.0, goal=SE2(1.0, 0.0, 0.0)), scene()
    critic = critics_of_path.GoalCritic(GoalCriticParams())
    critic.score(made)
    critic.score(far)
    assert made.costs.argsort(kind="stable")[:2].tolist() == [0, 1]
    assert made.costs[2] == pytest.approx(5.0)
    assert not far.costs.any()


@pytest.mark.parametrize(("symmetric", "opposite"), [(False, 3.0 * (np.pi - 0.2)), (True, 0.6)])
def test_the_goals_heading_counts_near_it(symmetric: bool, opposite: float) -> None:
    critic = critics_of_path.GoalAngleCritic(
        GoalAngleCriticParams(enabled=True, symmetric_yaw_tolerance=symmetric)
    )
    for yaw, cost in ((0.2, 0.6), (np.pi - 0.2, opposite)):
        made = scene((STAND,), remaining_m=0.3, goal=SE2(0.3, 0.0, yaw))
        critic.score(made)
        assert made.costs[0] == pytest.approx(cost, abs=1e-4)


def test_what_leaves_the_path_costs_the_align_critic() -> None:
    made = scene((STRAIGHT, LEFT, STAND))
    critics_of_path.PathAlignCritic(PathAlignCriticParams()).score(made)
    assert made.costs[0] == pytest.approx(0.0, abs=0.2)
    assert made.costs[1] > 1.0
    assert made.costs[2] == pytest.approx(0.0, abs=1e-5)


def test_a_path_that_is_blocked_is_not_aligned_to() -> None:
    made = scene((STRAIGHT, LEFT))
    made.path_free[5:15] = False
    critics_of_path.PathAlignCritic(PathAlignCriticParams()).score(made)
    assert not made.costs.any()


def test_what_comes_far_along_the_path_is_preferred() -> None:
    made = scene()
    critics_of_path.PathFollowCritic(PathFollowCriticParams()).score(made)
    assert made.costs.argsort(kind="stable")[0] == 0
    assert made.costs[3] > made.costs[2] > made.costs[0]


def test_trajectories_that_collide_are_not_the_furthest() -> None:
    made = scene((STRAIGHT, (0.2, 0.0)))
    assert made.furthest == 22
    made.collides[0] = True
    assert furthest(made) == 11


def test_a_path_that_comes_back_is_not_reached_across() -> None:
    made = scene((STAND,))
    # The last point of the path is where the robot stands.
    made.path_x_m[-1] = made.path_y_m[-1] = 0.0
    assert furthest(made) == 0


@pytest.mark.parametrize(("mode", "aligned"), [(0, [1]), (1, [])])
def test_a_robot_that_looks_away_is_turned_to_the_path(mode: int, aligned: list[int]) -> None:
    turn = (0.0, np.pi / (STEPS * DT))
    critic = critics_of_path.PathAngleCritic(PathAngleCriticParams(mode=mode))
    made = scene((STAND, turn, (0.0, 0.5)), path=((0.0, 0.0), (-1.7, 0.0)))
    critic.score(made)
    assert made.costs.any() == (mode == 0)
    assert [i for i in aligned if made.costs[i] < 0.1] == aligned
    ahead = scene((STAND, turn))
    critic.score(ahead)
    assert not ahead.costs.any()
