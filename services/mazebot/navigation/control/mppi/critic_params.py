"""MPPI's parameters and those of its critics, with Nav2's names."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mazebot.common.robot import waffle
from mazebot.navigation.control.controller import ControllerParams


class CriticParams(ControllerParams):
    """What every critic has: it adds (cost_weight * value) to the power of cost_power."""

    enabled: bool = Field(True, description="whether the critic is used")
    cost_power: int = Field(1, ge=1, le=4, description="power of the weighted value")
    cost_weight: float = Field(1.0, ge=0, description="weight of the value")


class ConstraintCriticParams(CriticParams):
    """Speeds beyond vx_min and vx_max."""

    cost_weight: float = Field(4.0, ge=0, description="weight of the excess speed, m")


class CostCriticParams(CriticParams):
    """Nearness of the footprint to obstacles, on the costmap."""

    cost_weight: float = Field(3.81, ge=0, description="weight of the mean cost, 0 to 1")
    collision_cost: float = Field(1e6, gt=0, description="cost of a trajectory that collides")
    critical_cost: float = Field(
        300.0, ge=0, description="cost of a point within collision_margin_distance of an obstacle"
    )
    collision_margin_distance: float = Field(
        0.03, ge=0, description="m; nearer to the footprint than this an obstacle is critical"
    )
    cost_scaling_factor: float = Field(
        10.0, gt=0, description="1/m; how fast the cost decays with the footprint's clearance"
    )
    near_goal_distance: float = Field(
        0.5, ge=0, description="m; this near to the goal only critical costs count"
    )
    trajectory_point_step: int = Field(2, ge=1, description="every how many-th point is examined")


class ObstaclesCriticParams(CriticParams):
    """The alternative to CostCritic: repulsion from obstacles by their distance."""

    enabled: bool = Field(False, description="whether the critic is used")
    repulsion_weight: float = Field(1.5, ge=0, description="weight of the mean nearness, m")
    critical_weight: float = Field(20.0, ge=0, description="weight of points within the margin, m")
    collision_cost: float = Field(1e5, gt=0, description="cost of a trajectory that collides")
    collision_margin_distance: float = Field(
        0.1, ge=0, description="m; the margin about the footprint"
    )
    inflation_radius: float = Field(0.55, gt=0, description="m; obstacles repel within this")
    near_goal_distance: float = Field(0.5, ge=0, description="m; nearer to the goal no repulsion")
    trajectory_point_step: int = Field(2, ge=1, description="every how many-th point is examined")


class GoalCriticParams(CriticParams):
    """Distance of the trajectory from the goal."""

    cost_weight: float = Field(5.0, ge=0, description="weight of the mean distance, m")
    threshold_to_consider: float = Field(
        1.4, gt=0, description="m; used where less of the path than this is left"
    )


class GoalAngleCriticParams(CriticParams):
    """Heading of the trajectory against that of the goal. Not used by default: the robot turns on
    the spot at the goal, and is more exact where it first cares for the position alone.
    """

    enabled: bool = Field(False, description="whether the critic is used")
    cost_weight: float = Field(3.0, ge=0, description="weight of the mean angle, rad")
    threshold_to_consider: float = Field(
        0.5, gt=0, description="m; used where less of the path than this is left"
    )
    symmetric_yaw_tolerance: bool = Field(False, description="the opposite heading is as good")


class PathAlignCriticParams(CriticParams):
    """Distance of the trajectory from the path, point by point."""

    cost_weight: float = Field(10.0, ge=0, description="weight of the mean distance, m")
    threshold_to_consider: float = Field(
        0.5, gt=0, description="m; used where more of the path than this is left"
    )
    offset_from_furthest: int = Field(
        20, ge=0, description="used where a trajectory reaches at least this point of the path"
    )
    max_path_occupancy_ratio: float = Field(
        0.07, ge=0, le=1, description="not used where more of the path than this share is blocked"
    )
    trajectory_point_step: int = Field(4, ge=1, description="every how many-th point is compared")


class PathFollowCriticParams(CriticParams):
    """How far along the path the trajectory comes."""

    cost_weight: float = Field(5.0, ge=0, description="weight of the distance, m")
    threshold_to_consider: float = Field(
        1.4, gt=0, description="m; used where more of the path than this is left"
    )
    offset_from_furthest: int = Field(
        6, ge=0, description="points of the path beyond the furthest that is reached"
    )


class PathAngleCriticParams(CriticParams):
    """Heading towards the path where the robot looks away from it."""

    cost_weight: float = Field(2.2, ge=0, description="weight of the angle, rad")
    threshold_to_consider: float = Field(
        0.5, gt=0, description="m; used where more of the path than this is left"
    )
    offset_from_furthest: int = Field(
        4, ge=0, description="points of the path beyond the furthest that is reached"
    )
    max_angle_to_furthest: float = Field(
        0.785, gt=0, description="rad; used where the robot looks away by more than this"
    )
    mode: Literal[0, 1] = Field(
        0, description="0: forward preference, 1: no directional preference"
    )


class PreferForwardCriticParams(CriticParams):
    """Driving backwards."""

    cost_weight: float = Field(5.0, ge=0, description="weight of the distance driven backwards, m")
    threshold_to_consider: float = Field(
        0.5, gt=0, description="m; used where more of the path than this is left"
    )


class TwirlingCriticParams(CriticParams):
    """Turning."""

    enabled: bool = Field(False, description="whether the critic is used")
    cost_weight: float = Field(10.0, ge=0, description="weight of the mean turning speed, rad/s")


class VelocityDeadbandCriticParams(CriticParams):
    """Speeds too low for the motors."""

    enabled: bool = Field(False, description="whether the critic is used")
    cost_weight: float = Field(35.0, ge=0, description="weight of the missing speed, m")
    deadband_velocities: tuple[float, float, float] = Field(
        (0.05, 0.05, 0.05), description="m/s, m/s, rad/s; speeds below these do not move the robot"
    )


class MovingObstaclesCriticParams(CriticParams):
    """Where tracked obstacles will be. Nav2 has no such critic."""

    cost_weight: float = Field(1.0, ge=0, description="weight of the costs")
    collision_cost: float = Field(
        5e3, gt=0, description="cost of a trajectory that meets an obstacle at once; later less"
    )
    margin_distance: float = Field(
        0.3, gt=0, description="m; nearer to a moving obstacle than this costs"
    )
    margin_weight: float = Field(30.0, ge=0, description="weight of the mean nearness, m")
    radius_growth: float = Field(
        0.05, ge=0, description="m/s; how fast the place of an obstacle becomes uncertain"
    )
    prediction_time: float = Field(
        2.0,
        ge=0,
        description="s; an obstacle is predicted to keep moving for this long, then to stop",
    )
    trajectory_point_step: int = Field(2, ge=1, description="every how many-th point is examined")


class MPPIParams(ControllerParams):
    """Names as in nav2_mppi_controller; the limits are the robot's own."""

    time_steps: int = Field(56, ge=4, le=400, description="steps of a trajectory")
    batch_size: int = Field(2000, ge=50, le=20_000, description="number of trajectories")
    model_dt: float = Field(0.05, gt=0, le=0.5, description="s; length of a step")
    iteration_count: int = Field(1, ge=1, le=10, description="optimisations in a control period")
    periods_per_optimisation: int = Field(
        2,
        ge=1,
        le=4,
        description="control periods that one optimisation is for where no obstacle moves; with 2 "
        "there is one for each scan, at half the computing time",
    )
    temperature: float = Field(
        0.2, gt=0, description="the lower, the more the cheapest trajectories count"
    )
    gamma: float = Field(0.015, ge=0, description="weight of the change of the control sequence")
    vx_max: float = Field(
        waffle.MAX_LINEAR_M_S, gt=0, description="m/s; highest speed; the robot's own is 0.46"
    )
    vx_min: float = Field(-0.2, le=0, description="m/s; highest speed backwards, negative")
    wz_max: float = Field(
        waffle.MAX_ANGULAR_RAD_S,
        gt=0,
        description="rad/s; highest turning speed; the robot's is 1.9",
    )
    ax_max: float = Field(
        waffle.MAX_LINEAR_ACCELERATION_M_S2,
        gt=0,
        description="m/s2; acceleration; the robot's own is 1",
    )
    ax_min: float = Field(
        -waffle.MAX_LINEAR_ACCELERATION_M_S2,
        lt=0,
        description="m/s2; deceleration; the robot's own is -1",
    )
    az_max: float = Field(
        waffle.MAX_ANGULAR_ACCELERATION_RAD_S2, gt=0, description="rad/s2; the robot's own is 2"
    )
    vx_std: float = Field(0.2, gt=0, description="m/s; standard deviation of the speeds tried")
    wz_std: float = Field(0.4, gt=0, description="rad/s; of the turning speeds tried")
    noise_correlation: float = Field(
        0.9,
        ge=0,
        lt=1,
        description="correlation of the noise of successive steps; Nav2's is 0, of which a robot "
        "that accelerates slowly follows nothing",
    )
    retry_attempt_limit: int = Field(
        1,
        ge=0,
        description="retries of the optimisation from a standstill where its result collides",
    )
    regenerate_noises: bool = Field(
        False, description="regenerate the noise in every period, which takes 20 ms"
    )
    open_loop: bool = Field(
        True, description="start from the last command, not from the measured velocity"
    )
    sgf_order: Literal[0, 2] = Field(
        2, description="order of the Savitzky-Golay filter of the sequence; 0: none"
    )
    collision_lookahead_time: float = Field(
        2.0, ge=0, description="s; the result must be free of collisions for this long"
    )
    prediction: bool = Field(True, description="predict where moving obstacles will be")
    rotate_to_heading_min_angle: float = Field(
        0.785,
        gt=0,
        description="rad; where the path's direction differs by more than this, the robot turns "
        "on the spot first, if that is free",
    )
    rotate_to_heading_angular_vel: float = Field(
        waffle.MAX_ANGULAR_RAD_S, gt=0, description="rad/s; highest speed of a turn on the spot"
    )
    rotate_to_heading_decel: float = Field(
        1.7, gt=0, description="rad/s2; deceleration at the end of a turn on the spot"
    )
    ConstraintCritic: ConstraintCriticParams = ConstraintCriticParams()
    CostCritic: CostCriticParams = CostCriticParams()
    ObstaclesCritic: ObstaclesCriticParams = ObstaclesCriticParams()
    GoalCritic: GoalCriticParams = GoalCriticParams()
    GoalAngleCritic: GoalAngleCriticParams = GoalAngleCriticParams()
    PathAlignCritic: PathAlignCriticParams = PathAlignCriticParams()
    PathFollowCritic: PathFollowCriticParams = PathFollowCriticParams()
    PathAngleCritic: PathAngleCriticParams = PathAngleCriticParams()
    PreferForwardCritic: PreferForwardCriticParams = PreferForwardCriticParams()
    TwirlingCritic: TwirlingCriticParams = TwirlingCriticParams()
    VelocityDeadbandCritic: VelocityDeadbandCriticParams = VelocityDeadbandCriticParams()
    MovingObstaclesCritic: MovingObstaclesCriticParams = MovingObstaclesCriticParams()
