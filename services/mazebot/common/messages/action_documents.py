"""What the robot can be asked to do: the goals, feedback and results of Nav2's actions."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, JsonValue

from mazebot.common.messages.documents import Document, Entity, Finite, Location, Planar

NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
_ALLOWANCE = "longest duration; 0: no limit"


class NavigateToPose(Document):
    """Drive to a pose."""

    action: Literal["navigate_to_pose"] = "navigate_to_pose"
    pose: Planar
    behavior_tree: str = Field("", description="name or XML file of the tree; empty: the default")


class NavigateThroughPoses(Document):
    """Drive through poses in their order, without stopping, to the last one."""

    action: Literal["navigate_through_poses"] = "navigate_through_poses"
    poses: tuple[Planar, ...]
    behavior_tree: str = Field("", description="name or XML file of the tree; empty: the default")


class WaypointTask(Document):
    """What to do at one waypoint; the robot drives on when all of it is done."""

    wait_s: NonNegative = Field(0.2, description="wait for this time")
    photo: bool = Field(False, description="take an image, published on `/waypoint_photo`")
    input_timeout_s: NonNegative | None = Field(
        None, description="wait for an input, at most for this time; null: do not wait"
    )


class FollowWaypoints(Document):
    """Drive to each pose, stop there and run the waypoint task."""

    action: Literal["follow_waypoints"] = "follow_waypoints"
    poses: tuple[Planar, ...]
    tasks: tuple[WaypointTask, ...] = Field(
        (), description="one for each pose; empty: wait for 0.2 s at each"
    )
    number_of_loops: int = Field(0, ge=0, description="further rounds after the first")
    goal_index: int = Field(0, ge=0, description="pose to begin with")


class FollowPath(Document):
    """Drive along a given path."""

    action: Literal["follow_path"] = "follow_path"
    path: tuple[Planar, ...]
    controller_id: str = ""
    goal_checker_id: str = ""
    progress_checker_id: str = ""
    path_handler_id: str = ""


class Spin(Document):
    """Turn on the spot."""

    action: Literal["spin"] = "spin"
    target_yaw_rad: Finite = Field(1.57, description="angle to turn; positive: counter-clockwise")
    time_allowance_s: NonNegative = Field(10.0, description=_ALLOWANCE)
    disable_collision_checks: bool = False


class BackUp(Document):
    """Drive straight back."""

    action: Literal["backup"] = "backup"
    distance_m: Finite = 0.15
    speed_m_s: Finite = 0.1
    time_allowance_s: NonNegative = Field(10.0, description=_ALLOWANCE)
    disable_collision_checks: bool = False


class DriveOnHeading(Document):
    """Drive straight on, or back where both numbers are negative."""

    action: Literal["drive_on_heading"] = "drive_on_heading"
    distance_m: Finite = 0.15
    speed_m_s: Finite = 0.1
    time_allowance_s: NonNegative = Field(10.0, description=_ALLOWANCE)
    disable_collision_checks: bool = False


class Wait(Document):
    """Stand still."""

    action: Literal["wait"] = "wait"
    duration_s: NonNegative = 5.0


class AssistedTeleop(Document):
    """Follow `/cmd_vel_teleop`, slowed before obstacles."""

    action: Literal["assisted_teleop"] = "assisted_teleop"
    time_allowance_s: NonNegative = Field(30.0, description=_ALLOWANCE)


class DockRobot(Document):
    """Dock at a marker."""

    action: Literal["dock_robot"] = "dock_robot"
    dock_id: str = Field("", description="name of a dock or id of a marker; empty: by `dock_pose`")
    dock_pose: Planar | None = Field(None, description="pose of the docked robot in the map")
    navigate_to_staging_pose: bool = True
    max_staging_time_s: NonNegative = 1000.0


class UndockRobot(Document):
    """Leave the dock for its staging pose."""

    action: Literal["undock_robot"] = "undock_robot"
    max_undocking_time_s: NonNegative = 30.0


ActionGoal = Annotated[
    NavigateToPose
    | NavigateThroughPoses
    | FollowWaypoints
    | FollowPath
    | Spin
    | BackUp
    | DriveOnHeading
    | Wait
    | AssistedTeleop
    | DockRobot
    | UndockRobot,
    Field(discriminator="action"),
]


class SendGoal(Document):
    """Requests an action. It preempts the one before it."""

    goal_id: str = Field(
        description="chosen by the client, as in ROS 2: names the goal in feedback and result",
        min_length=1, max_length=64,
    )  # fmt: skip
    goal: ActionGoal


class SendGoalReply(Document):
    """Whether the goal was accepted; if not, why, by Nav2's error codes."""

    accepted: bool
    error_code: int = 0
    error_msg: str = ""
    nearest_free: Planar | None = Field(
        None, description="if the goal is occupied: the nearest free pose"
    )


class WaypointStatus(Document):
    """One waypoint's status."""

    status: Literal["pending", "completed", "skipped", "failed"]
    index: int
    error_code: int = 0
    error_msg: str = ""


class SpeedLimit(Document):
    """The highest speed of the controllers, as nav2_msgs/msg/SpeedLimit has it."""

    percentage: bool = Field(False, description="of the controllers' `max_linear_vel`; else m/s")
    speed_limit: Finite = Field(0.0, description="0: none")

    def highest_m_s(self, max_linear_vel_m_s: float) -> float:
        """The limit in m/s of a robot whose highest speed is `max_linear_vel_m_s`; inf: none."""
        if not self.speed_limit:
            return math.inf
        share = max_linear_vel_m_s / 100.0 if self.percentage else 1.0
        return self.speed_limit * share

    def __str__(self) -> str:
        if not self.speed_limit:
            return "none"
        unit = "% of max_linear_vel" if self.percentage else "m/s"
        return f"{self.speed_limit:g} {unit}"


class NavigationCheckpoint(Document):
    """What a navigation that is started again needs to go on with the goal of the one before."""

    world_hash: str
    epoch: int | None = Field(description="the simulation's, in which the run began")
    parameters: dict[str, JsonValue] = Field(
        default_factory=dict, description="those that were set while it ran, by dotted name"
    )
    speed_limit: SpeedLimit = Field(SpeedLimit(), description="heard on /speed_limit")
    goal: ActionGoal | None = Field(description="what is still to be done; null: no goal")
    goal_id: str = Field("", description="empty: it came on /goal_pose")
    goal_stamp_ns: int | None = Field(None, description="stamp of the message on /goal_pose")
    start_ns: int = 0
    resumed: int = Field(0, description="times in a row that navigation ended soon on its way")
    missed: tuple[WaypointStatus, ...] = Field((), description="waypoints missed so far")
    paused: bool = False
    explores: bool = Field(False, description="whether it is the explorer's")


class ComputePath(Document):
    """Requests a path through all goals to the last one. The robot does not move."""

    goals: tuple[Planar, ...]
    start: Planar | None = Field(None, description="null: the robot's pose")
    planner_id: str = ""


class ComputePathReply(Document):
    """The path, or why there is none."""

    path: tuple[Planar, ...] = ()
    length_m: Finite = 0.0
    error_code: int = 0
    error_msg: str = ""
    nearest_free: Planar | None = None


class SmoothPath(Document):
    """Requests that a path be smoothed. The robot does not move."""

    path: tuple[Planar, ...]
    smoother_id: str = Field("", description="empty or Nav2's `simple_smoother`, the only smoother")
    check_for_collisions: bool = False


class SmoothPathReply(Document):
    """The smoothed path, or why there is none."""

    path: tuple[Planar, ...] = ()
    error_code: int = 0
    error_msg: str = ""


class LoadMap(Document):
    """Requests that a map take the place of the world's own, for localisation and navigation."""

    resolution_m: Annotated[float, Field(ge=1e-3, le=100.0, allow_inf_nan=False)]
    origin: Planar = Field(description="map_from_grid, of the corner of cell (0, 0)")
    rows: int = Field(ge=1)
    columns: int = Field(ge=1)
    cells_base64: str = Field(
        description="zlib in base64 of int8 cells, row by row, row 0 at the smallest y: "
        "0 free to 100 occupied, -1 unknown"
    )


class LoadMapReply(Document):
    """The result, with the numbers of nav2_msgs/srv/LoadMap."""

    result: Literal[0, 1, 2, 3, 255] = Field(
        0,
        description="0 success, 1 map does not exist, 2 invalid map data, 3 invalid map metadata, "
        "255 undefined failure",
    )
    error: str = ""


class LoadWorld(Document):
    """Requests that another world take the place of the one that is running. A robot that makes its
    map makes one of the new world.
    """

    world_name: str = Field(description="as in a world request")
    use_aruco: bool = Field(True, description="as in a world request")
    overrides: tuple[str, ...] = Field((), description="as in a world request")


class LoadWorldReply(Document):
    """The world that is running now: the new one, or with an error the one before."""

    world_name: str = ""
    world_hash: str = ""
    is_new: bool = Field(False, description="false: the same world was running already")
    error: str = Field("", description="one line: what is wrong, and what is allowed")


class ReadModel(Document):
    """Requests a model as an entity that can be spawned: by its name, or from its text."""

    model: str = Field(
        "", pattern=r"^[\w-][\w.-]*$|^$",
        description="name of a folder of a model: among those that are shipped, or in `models` in "
        "the folder of the worlds",
    )  # fmt: skip
    text: str = Field("", description="SDF or URDF")


class ReadModelReply(Document):
    """The entity at the origin, with its textures (PNG) and meshes (npz) in base64 by sha256."""

    error: str = Field("", description="one line; empty: read")
    entity: Entity | None = None
    assets: dict[str, str] = Field(default_factory=dict)


class GetWorldsReply(Document):
    """The worlds that there are, and the one that is running."""

    names: tuple[str, ...] = ()
    running: str = Field("", description="its name; empty: none is running yet")
    running_hash: str = ""
    start: Planar | None = Field(None, description="where the robot begins in it")
    locations: tuple[Location, ...] = Field((), description="its named places")


class GetModelsReply(Document):
    """The models that can be spawned by their names."""

    error: str = Field("", description="one line; empty: these are all")
    names: tuple[str, ...] = ()


class SaveMap(Document):
    """Requests that the map be written as map_server reads it, in the folder of the run; where the
    robot makes the map, with its pose graph and markers.
    """

    topic: str = Field("/map", description="no other is written")
    name: str = Field(description="of the YAML file, without folders and without its ending")
    image_format: str = Field("pgm", description="pgm, png or bmp")
    mode: str = Field("trinary", description="trinary, scale or raw")
    free_thresh: float = Field(0.25, description="trinary: occupancy up to which a cell is free")
    occupied_thresh: float = Field(
        0.65, description="trinary: occupancy from which a cell is occupied"
    )
    needs_pose_graph: bool = Field(False, description="nothing is written where there is none")


class SaveMapReply(Document):
    """The files where the recorder sees them, the YAML file first; or why there are none, with the
    numbers of slam_toolbox/srv/SaveMap.
    """

    files: tuple[str, ...] = ()
    result: Literal[0, 1, 255] = Field(
        0, description="0 success, 1 no map received, 255 undefined failure"
    )
    error: str = ""


class ActionFeedback(Document):
    """Progress of the current action; fields of other actions are null."""

    goal_id: str
    action: str
    navigation_time_s: Finite = 0.0
    current_pose: Planar | None = None
    distance_remaining_m: Finite | None = None
    estimated_time_remaining_s: Finite | None = None
    number_of_recoveries: int | None = None
    number_of_poses_remaining: int | None = None
    current_waypoint: int | None = None
    angular_distance_traveled_rad: Finite | None = None
    distance_traveled_m: Finite | None = None
    time_left_s: Finite | None = None
    speed_m_s: Finite | None = None
    position_tracking_error_m: Finite | None = Field(
        None, description="distance from the path; positive: the robot is left of it"
    )
    heading_tracking_error_rad: Finite | None = Field(
        None, description="from the robot's heading to that of the path there"
    )
    current_path_index: int | None = Field(
        None, description="of the point of the path nearest to the robot"
    )
    waypoints: tuple[WaypointStatus, ...] = Field(
        (), description="of `navigate_through_poses`: what has become of each pose"
    )
    docking_state: str | None = None
    num_retries: int | None = None
    paused: bool = False
    goal: Planar | None = Field(None, description="where it ends; null: it has no goal in the map")
    stopped_at: tuple[tuple[Finite, Finite], ...] = Field(
        (),
        description="m; places in the map where something that no sensor shows stopped the robot "
        "since navigation began: they are obstacles of the costmaps",
    )


class ActionResult(Document):
    """How an action ended: `succeeded`, `canceled` or `aborted`, with Nav2's error codes."""

    goal_id: str
    action: str
    status: Literal["succeeded", "canceled", "aborted"]
    error_code: int = 0
    error_msg: str = ""
    start_time_s: Finite
    end_time_s: Finite
    number_of_recoveries: int = 0
    num_retries: int = Field(0, description="of docking: approaches after the first one")
    waypoints: tuple[WaypointStatus, ...] = Field(
        (),
        description="of `navigate_through_poses`: what has become of each pose; of "
        "`follow_waypoints`: those that were missed",
    )
    goal: Planar | None = Field(
        None, description="where it should end; null: it has no goal in the map"
    )
    displacement: Planar | None = Field(
        None,
        description="of an action without a goal in the map: where it should end, relative "
        "to where "
        "it began; null: not given",
    )


class BehaviorTreeNode(Document):
    """One node of a behaviour tree."""

    name: str
    kind: str = Field(description="its type, as in the XML: `FollowPath`")
    status: Literal["IDLE", "RUNNING", "SUCCESS", "FAILURE", "SKIPPED"] = Field(
        description="latest status since the previous log; `IDLE`: not ticked"
    )
    depth: Annotated[int, Field(ge=0, le=1000)] = Field(0, description="0: the root")


class BehaviorTreeLog(Document):
    """The behaviour tree of the current action."""

    action: str = Field("", description="empty: no action runs")
    nodes: tuple[BehaviorTreeNode, ...] = Field(
        (), description="each node before its children, in their order"
    )


class PhotoRequest(Document):
    """A picture that is wanted at a waypoint: the next one of the camera, not older than this."""

    waypoint: int = Field(description="its index")
    stamp_ns: int = Field(description="time of the request")


class CollisionMonitorState(Document):
    """What the collision monitor does to the commands; names as in Nav2."""

    action: Literal["do_nothing", "stop", "slowdown", "approach", "limit"]
    polygon_name: str = ""
    source: str = ""
    points: int = Field(0, description="of the source within the polygon")
    nearest_m: tuple[Finite, Finite] | None = Field(
        None, description="the nearest of them, x and y in base_footprint"
    )
    reason: str = ""


class PauseGoal(Document):
    """Requests that the current action pause, with the robot stopped, or resume."""

    pause: bool


class ClearCostmap(Document):
    """Requests that a costmap forget obstacles; the map and what the lidar sees now stay."""

    costmap: Literal["all", "local", "global"] = "all"
    area: Literal["entirely", "except_region", "around_robot", "around_pose"] = "entirely"
    reset_distance_m: NonNegative = Field(1.0, description="side of the square of a region")
    pose: Planar | None = Field(None, description="centre of `around_pose`")
    plugins: tuple[str, ...] = Field(
        (), description="layers to clear, `obstacle_layer` or `voxel_layer`; empty: all"
    )


class Reply(Document):
    """The answer to a request that gives nothing back: empty, or the error."""

    error: str = ""


class Toggle(Document):
    """Requests that something be switched on or off."""

    enable: bool


class Empty(Document):
    """A request without parameters."""
