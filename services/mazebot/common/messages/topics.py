"""The topic table, one row a topic: the single source for subscriptions, publications, access,
documentation and recording.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, Generic, TypeVar

from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import slam_documents as slam

M = TypeVar("M")

SERVICES = (
    "worldgen",
    "physics",
    "spawner",
    "perception",
    "localization",
    "mapping",
    "navigation",
    "explorer",
    "recorder",
    "bringup",
)
"""The services in table order: the order in which they step within one instant."""

EDGE = "cli"
"""Publisher name of the user's tools."""


class Delivery(Enum):
    """The quality of service of a topic."""

    LATEST = "latest"
    """Dropped under congestion; a reader keeps the newest `depth`."""
    EVERY = "every"
    """Small messages; resent to a reader that has missed one. A reader keeps all."""
    LATCHED = "latched"
    """As EVERY, and a late reader gets the last `depth` messages of each publisher, or from the
    other readers if the publisher is gone.
    """


# Inside the class below, `type` is a field.
_Twist = type[msg.Twist]


@dataclass(frozen=True, eq=False)
class Topic(Generic[M]):
    """One row: a ROS topic, its type, its rate in simulation time, its publishers and subscribers,
    and its delivery.
    """

    name: str
    type: type[M]
    owners: tuple[str, ...]
    readers: tuple[str, ...]
    delivery: Delivery
    about: str
    rate_hz: float | None = None
    depth: int = 1
    returned: bool = False
    """Whether its owner gets its last message back from the readers and keepers after a restart."""
    keepers: tuple[str, ...] = ()
    """Services that keep its last message for its owner, and make no use of it themselves."""
    large: bool = False
    """Whether a message may be so large that replies to a late reader must block, not drop."""
    in_turn: bool = False
    """Whether only one of its owners publishes in a run."""
    truth: bool = False
    """Whether it tells what a real robot cannot know."""
    also: tuple[_Twist, ...] = ()
    """Other types that its readers take: see `of_own_type` in wire.py."""


Q = TypeVar("Q")
A = TypeVar("A")


@dataclass(frozen=True, eq=False)
class Query(Generic[Q, A]):
    """One row: a request that the user's tools may send to a service, as a Zenoh query on the
    name's key. Services do not query each other: they share state by topics. Only what a request of
    ROS 2 needs of another service is asked of it (`asked_by`).
    """

    name: str
    request: type[Q]
    response: type[A]
    owner: str
    about: str
    asked_by: tuple[str, ...] = ()
    """Services whose services of ROS 2 ask it."""


_LATEST, _EVERY, _LATCHED = Delivery.LATEST, Delivery.EVERY, Delivery.LATCHED

CLOCK = Topic(
    "/clock",
    msg.Clock,
    ("physics",),
    ("recorder",),
    _LATEST,
    "simulation time; the loop of every service follows it",
    rate_hz=60,
)
WORLD_REQUEST = Topic(
    "/world/request", doc.WorldRequest, ("bringup",), ("worldgen", "recorder"), _LATCHED,
    "the requested world",
)  # fmt: skip
WORLD_STATUS = Topic(
    "/world/status", doc.WorldStatus, ("worldgen",), ("bringup", "recorder"), _LATCHED,
    "the result of the request", returned=True, keepers=("physics",),
)  # fmt: skip
ASSETS = Topic(
    "/world/assets", msg.CompressedImage, ("worldgen", "spawner", "physics"),
    ("physics", "spawner", "recorder"), _LATCHED,
    "a texture (`png`) or a mesh (`npz`); `frame_id` is the sha256 of its bytes; from `physics`: "
    "those of the entities in the world, for a restarted spawner", depth=256, large=True,
)  # fmt: skip
WORLD = Topic(
    "/world", doc.World, ("worldgen",),
    (
        "physics", "spawner", "perception", "localization", "mapping", "navigation", "explorer",
        "recorder", "bringup",
    ),
    _LATCHED,
    "the resolved world", large=True,
)  # fmt: skip
MAP = Topic(
    "/map", msg.OccupancyGrid, ("worldgen", "mapping"),
    ("localization", "navigation", "explorer", "recorder", "bringup"), _LATCHED,
    "occupancy map: rasterised from the walls, or as mapping has made it so far", large=True,
    in_turn=True,
)  # fmt: skip
DESIRED_ENTITIES = Topic(
    "/entities/desired", doc.Entities, ("spawner",), ("physics", "recorder"), _LATCHED,
    "the entities that should exist, and those rejected because of their placement",
)  # fmt: skip
ENTITIES = Topic(
    "/entities", doc.Entities, ("physics",),
    ("spawner", "perception", "localization", "navigation", "recorder"), _LATCHED,
    "the entities that exist, and those that physics rejected",
)  # fmt: skip
TF = Topic(
    "/tf", msg.TFMessage, ("physics", "localization", "mapping"),
    ("spawner", "perception", "navigation", "recorder"), _LATEST,
    "odom from base_footprint, map from odom, map from each body that moves; the wheels at 10 Hz",
    rate_hz=30, depth=100,
)  # fmt: skip
TF_STATIC = Topic(
    "/tf_static", msg.TFMessage, ("physics",),
    ("perception", "localization", "mapping", "navigation", "recorder"), _LATCHED,
    "the robot's fixed frames",
)  # fmt: skip
ROBOT_DESCRIPTION = Topic(
    "/robot_description", msg.String, ("physics",), ("recorder",), _LATCHED, "the robot's URDF",
)  # fmt: skip
ENTITY_MARKERS = Topic(
    "/entities/markers", msg.MarkerArray, ("physics",), ("recorder",), _LATCHED,
    "the entities that exist, as RViz draws them: what moves in the frame of its name", large=True,
)  # fmt: skip
ODOM = Topic(
    "/odom", msg.Odometry, ("physics",),
    ("localization", "mapping", "navigation", "recorder"), _LATEST,
    "wheel odometry: odom from base_footprint", rate_hz=30, depth=30,
)  # fmt: skip
JOINT_STATES = Topic(
    "/joint_states", msg.JointState, ("physics",), ("recorder",), _LATEST,
    "wheel angles and speeds", rate_hz=30,
)  # fmt: skip
BATTERY_STATE = Topic(
    "/battery_state", msg.BatteryState, ("physics",), ("navigation", "recorder"), _LATEST,
    "charge of the battery, 0 to 1 in `percentage`, as in ROS", rate_hz=1,
)  # fmt: skip
IMU = Topic(
    "/imu", msg.Imu, ("physics",), ("perception", "recorder"), _LATEST,
    "gyroscope and accelerometer", rate_hz=120, depth=60,
)  # fmt: skip
SCAN = Topic(
    "/scan", msg.LaserScan, ("physics",),
    ("localization", "mapping", "navigation", "recorder"), _LATEST,
    "lidar, counter-clockwise from straight ahead", rate_hz=10,
)  # fmt: skip
CAMERA_IMAGE = Topic(
    "/camera/color/image_raw", msg.Image, ("physics",), ("perception", "recorder"), _LATEST,
    "rgb8 image", rate_hz=10,
)  # fmt: skip
CAMERA_INFO = Topic(
    "/camera/color/camera_info", msg.CameraInfo, ("physics",),
    ("perception", "navigation", "recorder"), _LATEST,
    "intrinsics of the image with the same stamp", rate_hz=10,
)  # fmt: skip
CAMERA_COMPRESSED = Topic(
    "/camera/color/image_raw/compressed", msg.CompressedImage, ("physics",), ("recorder",), _LATEST,
    "the image as JPEG, if it is enabled", rate_hz=10,
)  # fmt: skip
DEPTH_IMAGE = Topic(
    "/camera/depth/image_rect_raw", msg.Image, ("physics",), ("perception", "recorder"), _LATEST,
    "32FC1, metres along the optical axis, same render as the colour image; NaN: nothing in range",
    rate_hz=10,
)  # fmt: skip
DEPTH_INFO = Topic(
    "/camera/depth/camera_info", msg.CameraInfo, ("physics",), ("perception", "recorder"), _LATEST,
    "intrinsics of the depth image with the same stamp", rate_hz=10,
)  # fmt: skip
DEPTH_SCAN = Topic(
    "/camera/depth/scan", msg.LaserScan, ("perception",), ("navigation", "recorder"), _LATEST,
    "nearest thing between floor and the robot's top in each part of the depth image; inf: only "
    "floor, -inf: nothing measured; `intensities`: how far it reaches behind that, as far as it is "
    "seen, m", rate_hz=10,
)  # fmt: skip
GROUND_TRUTH_ODOM = Topic(
    "/ground_truth/odom", msg.Odometry, ("physics",), ("recorder",), _LATEST,
    "true pose: map from base_footprint", rate_hz=30, depth=30, truth=True,
)  # fmt: skip
CONTACTS = Topic(
    "/contacts", doc.Contact, ("physics",), ("recorder",), _EVERY,
    "the start of a contact of the robot", truth=True,
)  # fmt: skip
SIMULATION_STATS = Topic(
    "/simulation/stats", doc.SimulationStats, ("physics",),
    ("perception", "localization", "mapping", "navigation", "explorer", "recorder"), _LATCHED,
    "time, steps, pause, epoch, hashes", rate_hz=5, returned=True,
)  # fmt: skip
SIMULATION_CHECKPOINT = Topic(
    "/simulation/checkpoint", doc.SimulationCheckpoint, ("physics",), (), _LATCHED,
    "what a simulator that is started again needs to go on where it was", rate_hz=10,
    returned=True, keepers=("worldgen", "spawner", "perception"), truth=True,
)  # fmt: skip
DETECTIONS = Topic(
    "/aruco/detections", msg.Detection3DArray, ("perception",),
    ("localization", "mapping", "navigation", "recorder"), _LATEST,
    "markers in the camera's optical frame; a second result is the other IPPE solution", rate_hz=10,
    depth=10,
)  # fmt: skip
MAP_DETECTIONS = Topic(
    "/aruco/detections_map", msg.Detection3DArray, ("perception",), ("recorder",), _LATEST,
    "the same markers in the map frame, by the estimated pose of the robot", rate_hz=10, depth=10,
)  # fmt: skip
INITIAL_POSE = Topic(
    "/initialpose", msg.PoseWithCovarianceStamped, (EDGE,), ("localization", "recorder"), _EVERY,
    "the initial pose set by the user",
)  # fmt: skip
GOAL_POSE = Topic(
    "/goal_pose", msg.PoseStamped, ("bringup", "explorer", EDGE), ("navigation", "recorder"),
    _EVERY,
    "the goal pose",
)  # fmt: skip
GOAL_UPDATE = Topic(
    "/goal_update", msg.PoseStamped, (EDGE,), ("navigation", "recorder"), _EVERY,
    "where the goal of the task has moved to, for `GoalUpdater` in a behaviour tree",
)  # fmt: skip
CONTROLLER_SELECTOR = Topic(
    "/controller_selector", msg.String, (EDGE,), ("navigation", "recorder"), _LATCHED,
    "name of a controller, for `ControllerSelector` in a behaviour tree; empty: the tree's default",
)  # fmt: skip
PLANNER_SELECTOR = Topic(
    "/planner_selector", msg.String, (EDGE,), ("navigation", "recorder"), _LATCHED,
    "name of a planner, for `PlannerSelector` in a behaviour tree; empty: the tree's default",
)  # fmt: skip
SPEED_LIMIT = Topic(
    "/speed_limit", msg.SpeedLimit, (EDGE,), ("navigation", "recorder"), _EVERY,
    "the highest speed of the controllers, in m/s or in percent of `max_linear_vel`; 0: no limit",
)  # fmt: skip
AMCL_POSE = Topic(
    "/amcl_pose", msg.PoseWithCovarianceStamped, ("localization", "mapping"),
    ("navigation", "explorer", "recorder"), _LATEST,
    "estimated pose: map from base_footprint", rate_hz=10,
)  # fmt: skip
PARTICLE_CLOUD = Topic(
    "/particle_cloud", msg.PoseArray, ("localization",), ("recorder",), _LATEST,
    "particles of the localisation", rate_hz=2,
)  # fmt: skip
LOCALIZATION_STATUS = Topic(
    "/localization/status", doc.LocalizationStatus, ("localization", "mapping"),
    ("navigation", "recorder"), _LATCHED, "whether the pose can be trusted, and why not", rate_hz=2,
)  # fmt: skip
LOCALIZATION_CHECKPOINT = Topic(
    "/localization/checkpoint", doc.LocalizationCheckpoint, ("localization",), (), _LATCHED,
    "what a localization that is started again needs to go on where it was", rate_hz=2,
    returned=True, keepers=("navigation", "perception"),
)  # fmt: skip
GLOBAL_LOCALIZATION_REQUEST = Topic(
    "/navigation/global_localization", act.Empty, ("navigation",), ("localization", "recorder"),
    _EVERY, "a behaviour tree requests global localisation on the whole map",
)  # fmt: skip
POSE_GRAPH = Topic(
    "/pose_graph", slam.PoseGraph, ("mapping",), ("recorder",), _LATCHED,
    "keyframes with their scans, markers and all measurements between them; the map is "
    "built from it",
    rate_hz=0.2, returned=True, large=True,
)  # fmt: skip
EXPLORATION_STATUS = Topic(
    "/explore/status", slam.ExplorationStatus, ("explorer",),
    ("navigation", "bringup", "recorder"), _LATCHED,
    "progress of the exploration, and the goal that it has sent last", rate_hz=1, returned=True,
)  # fmt: skip
FRONTIERS = Topic(
    "/explore/frontiers", msg.MarkerArray, ("explorer",), ("recorder",), _LATEST,
    "frontiers to go to, those set aside, and the view point chosen", rate_hz=1,
)  # fmt: skip
EXPLORE_RESUME = Topic(
    "/explore/resume", msg.Bool, (EDGE,), ("explorer", "recorder"), _EVERY,
    "false: pause the exploration, true: resume it",
)  # fmt: skip
GLOBAL_COSTMAP = Topic(
    "/global_costmap/costmap", msg.OccupancyGrid, ("navigation",), ("recorder",), _LATCHED,
    "cost of each cell, 100 lethal, 99 inscribed", rate_hz=1,
)  # fmt: skip
GLOBAL_COSTMAP_UPDATES = Topic(
    "/global_costmap/costmap_updates", msg.OccupancyGridUpdate, ("navigation",), ("recorder",),
    _EVERY, "the part of the global costmap that has changed since it was published", rate_hz=5,
)  # fmt: skip
KEEPOUT_FILTER_MASK = Topic(
    "/keepout_filter_mask", msg.OccupancyGrid, ("navigation",), ("recorder",), _LATCHED,
    "where the robot must not drive: 100; only where there are keepout zones", large=True,
)  # fmt: skip
SPEED_FILTER_MASK = Topic(
    "/speed_filter_mask", msg.OccupancyGrid, ("navigation",), ("recorder",), _LATCHED,
    "reduction of the maximum speed in percent; only where there are speed limits",
    large=True,
)  # fmt: skip
LOCAL_COSTMAP = Topic(
    "/local_costmap/costmap", msg.OccupancyGrid, ("navigation",), ("recorder",), _LATEST,
    "the obstacles around the robot, in the odom frame", rate_hz=2,
)  # fmt: skip
PUBLISHED_FOOTPRINT = Topic(
    "/local_costmap/published_footprint", msg.PolygonStamped, ("navigation",), ("recorder",),
    _LATEST, "the robot's outline with its padding, in the odom frame", rate_hz=2,
)  # fmt: skip
PLAN = Topic(
    "/plan", msg.Path, ("navigation",), ("recorder",), _LATEST, "the path being followed", rate_hz=1
)
CMD_VEL = Topic(
    "/cmd_vel", msg.TwistStamped, ("navigation", EDGE), ("physics", "recorder"), _LATEST,
    "velocity of base_footprint", rate_hz=20, also=(msg.Twist,),
)  # fmt: skip
CMD_VEL_TELEOP = Topic(
    "/cmd_vel_teleop", msg.TwistStamped, (EDGE,), ("navigation", "recorder"), _LATEST,
    "velocity commanded by a user; the collision monitor limits it near obstacles",
    also=(msg.Twist,),
)  # fmt: skip
COLLISION_MONITOR_STATE = Topic(
    "/collision_monitor_state", act.CollisionMonitorState, ("navigation",), ("recorder",),
    _LATCHED, "action of the collision monitor, its cause and its position",
)  # fmt: skip
ACTION_FEEDBACK = Topic(
    "/navigation/feedback", act.ActionFeedback, ("navigation",), ("recorder",), _LATEST,
    "progress of the current action", rate_hz=5,
)  # fmt: skip
ACTION_RESULT = Topic(
    "/navigation/action_result", act.ActionResult, ("navigation",), ("recorder",), _EVERY,
    "how an action ended",
)  # fmt: skip
PHOTO_REQUEST = Topic(
    "/waypoint_photo/request", act.PhotoRequest, ("navigation",), ("perception", "recorder"),
    _EVERY, "an image is requested at a waypoint",
)  # fmt: skip
PHOTO = Topic(
    "/waypoint_photo", msg.CompressedImage, ("perception",), ("navigation", "recorder"), _EVERY,
    "the image taken at a waypoint, as PNG",
)  # fmt: skip
BEHAVIOR_TREE = Topic(
    "/behavior_tree", act.BehaviorTreeLog, ("navigation",), ("recorder",), _LATCHED,
    "the behaviour tree that runs, with the status of each node, when one has changed",
)  # fmt: skip
TRAJECTORIES = Topic(
    "/trajectories", msg.MarkerArray, ("navigation",), ("recorder",), _LATEST,
    "rollouts of the MPPI controller, from green (low cost) to red (high cost), and the chosen one",
    rate_hz=2,
)  # fmt: skip
NAVIGATION_STATUS = Topic(
    "/navigation/status", doc.NavigationStatus, ("navigation",),
    ("explorer", "bringup", "recorder"), _LATCHED,
    "state of navigation, and of localisation as it sees it", rate_hz=2,
)  # fmt: skip
NAVIGATION_CHECKPOINT = Topic(
    "/navigation/checkpoint", act.NavigationCheckpoint, ("navigation",), (), _LATCHED,
    "the goal, and the parameters, that a navigation that is started again goes on with",
    returned=True, keepers=("localization", "mapping", "perception"),
)  # fmt: skip
NAVIGATION_RESULT = Topic(
    "/navigation/result", doc.NavigationResult, ("navigation",),
    ("explorer", "bringup", "recorder"), _EVERY,
    "the result of a goal",
)  # fmt: skip
EVALUATION = Topic(
    "/evaluation", doc.Evaluation, ("recorder",), ("bringup",), _LATCHED,
    "the run evaluated against the ground truth", rate_hz=1, truth=True,
)  # fmt: skip
PARAMETERS = Topic(
    "/parameters", doc.Parameters, SERVICES, ("navigation", "recorder"), _LATCHED,
    "the configuration of each service",
)  # fmt: skip
PARAMETER_EVENTS = Topic(
    "/parameter_events", msg.ParameterEvent, ("navigation",), ("recorder",), _EVERY,
    "parameters were set while it runs",
)  # fmt: skip
DIAGNOSTICS = Topic(
    "/diagnostics", msg.DiagnosticArray, SERVICES, ("recorder", "bringup"), _LATEST,
    "state of each service, what it is waiting for, what it rejected and lost", rate_hz=1, depth=20,
)  # fmt: skip
ROSOUT = Topic(
    "/rosout", msg.Log, SERVICES, ("recorder",), _EVERY, "the log of every service"
)  # fmt: skip

SPAWN_ENTITY = Query(
    "/spawn_entity", doc.SpawnEntity, doc.EntityReply, "spawner", "spawn an entity"
)
DELETE_ENTITY = Query(
    "/delete_entity", doc.DeleteEntity, doc.EntityReply, "spawner", "delete an entity"
)
SET_ENTITY_STATE = Query(
    "/set_entity_state", doc.SetEntityState, doc.EntityReply, "spawner", "move an entity to a pose"
)
GET_ENTITIES = Query(
    "/get_entities", doc.GetEntities, doc.Entities, "spawner", "the entities in the world"
)
GET_ENTITY_BOUNDS = Query(
    "/get_entity_bounds", doc.GetEntityBounds, doc.EntityBoundsReply, "spawner",
    "the box around an entity",
)  # fmt: skip
SIMULATION_CONTROL = Query(
    "/simulation/control", doc.SimulationControl, doc.SimulationControlReply, "physics",
    "pause, resume, step, reset, seed, speed, run until",
)  # fmt: skip
EMERGENCY_STOP = Query(
    "/emergency_stop", doc.EmergencyStop, act.Reply, "physics",
    "stop the robot and hold it at rest, or let it move again",
)  # fmt: skip
CANCEL_GOAL = Query(
    "/navigate_to_pose/_action/cancel_goal", doc.CancelGoal, doc.CancelGoalReply, "navigation",
    "cancel the current goal",
)  # fmt: skip
SEND_GOAL = Query(
    "/navigation/send_goal", act.SendGoal, act.SendGoalReply, "navigation",
    "start one of Nav2's actions: navigate_to_pose, follow_waypoints, spin, dock_robot, ...",
)  # fmt: skip
INPUT_AT_WAYPOINT = Query(
    "/input_at_waypoint/input", act.Empty, act.Reply, "navigation",
    "the input that the robot is waiting for at a waypoint",
)  # fmt: skip
PAUSE_GOAL = Query(
    "/navigation/pause", act.PauseGoal, act.Reply, "navigation", "pause or resume the action"
)
COMPUTE_PATH = Query(
    "/compute_path_to_pose", act.ComputePath, act.ComputePathReply, "navigation",
    "compute a path without driving it",
)  # fmt: skip
SMOOTH_PATH = Query(
    "/smooth_path", act.SmoothPath, act.SmoothPathReply, "navigation", "smooth a path"
)
SET_PARAMETERS = Query(
    "/navigation/set_parameters", doc.SetParameters, doc.SetParametersReply, "navigation",
    "set parameters while the robot drives",
)  # fmt: skip
LOAD_WORLD = Query(
    "/world/load", act.LoadWorld, act.LoadWorldReply, "worldgen",
    "load another world in place of the one that is running",
)  # fmt: skip
GET_WORLDS = Query(
    "/world/list", act.Empty, act.GetWorldsReply, "worldgen",
    "the names of the worlds, and the one that is running",
)  # fmt: skip
GET_MODELS = Query(
    "/world/models", act.Empty, act.GetModelsReply, "worldgen",
    "the models that can be spawned by their names",
)  # fmt: skip
READ_MODEL = Query(
    "/world/read_model", act.ReadModel, act.ReadModelReply, "worldgen",
    "a model of SDF or URDF as a body that can be spawned", asked_by=("spawner",),
)  # fmt: skip
LOAD_MAP = Query(
    "/map_server/load_map", act.LoadMap, act.LoadMapReply, "worldgen",
    "load a map and publish it on `/map`",
)  # fmt: skip
SAVE_MAP = Query(
    "/map_saver/save_map", act.SaveMap, act.SaveMapReply, "recorder",
    "write the map to the folder of the run",
)  # fmt: skip
CLEAR_COSTMAP = Query(
    "/clear_costmap", act.ClearCostmap, act.Reply, "navigation", "clear obstacles from a costmap"
)
TOGGLE_COLLISION_MONITOR = Query(
    "/collision_monitor/toggle", act.Toggle, act.Reply, "navigation",
    "enable or disable the collision monitor",
)  # fmt: skip
REINITIALIZE_GLOBAL_LOCALIZATION = Query(
    "/reinitialize_global_localization", act.Empty, act.Reply, "localization",
    "global localisation: search for the robot on the whole map",
)  # fmt: skip

QUERIES: tuple[Query[Any, Any], ...] = tuple(
    value for value in list(globals().values()) if isinstance(value, Query)
)
TOPICS: tuple[Topic[object], ...] = tuple(
    value for value in list(globals().values()) if isinstance(value, Topic)
)
BY_NAME: dict[str, Topic[object]] = {topic.name: topic for topic in TOPICS}


def owned_by(service: str) -> list[Topic[object]]:
    """The topics a service may write."""
    return [topic for topic in TOPICS if service in topic.owners]


def asked_of(service: str) -> list[Query[Any, Any]]:
    """The queries a service answers."""
    return [query for query in QUERIES if query.owner == service]


def read_by(service: str) -> list[Topic[object]]:
    """The topics a service reads."""
    return [topic for topic in TOPICS if service in topic.readers]


def kept_by(service: str) -> list[Topic[object]]:
    """The topics whose last message a service keeps for their owners."""
    return [topic for topic in TOPICS if service in topic.keepers]
