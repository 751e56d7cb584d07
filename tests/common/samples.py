"""One message of every topic."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import slam_documents as slam
from mazebot.common.messages import topics as table
from mazebot.common.messages.topics import Topic

STAMP_NS = 12_345_678_901
POSE = msg.pose_from_se2(SE2(1.0, -2.0, 0.5))
HEADER = msg.header(STAMP_NS, "map")
COVARIANCE = np.eye(6).reshape(36)
POSE_STAMPED = msg.PoseWithCovarianceStamped(HEADER, msg.PoseWithCovariance(POSE, COVARIANCE))
TWIST = msg.Twist(linear=msg.Vector3(0.1, 0.0, 0.0), angular=msg.Vector3(0.0, 0.0, -0.2))
ODOMETRY = msg.Odometry(
    HEADER,
    "base_footprint",
    msg.PoseWithCovariance(POSE, COVARIANCE),
    msg.TwistWithCovariance(TWIST, COVARIANCE),
)
GRID = msg.occupancy_grid(STAMP_NS, 0.05, SE2(0.0, 0.0, 0.0), np.array([[0, 100, -1]], np.int8))
DETECTION = msg.Detection3D(
    HEADER,
    [
        msg.ObjectHypothesisWithPose(
            msg.ObjectHypothesis("60", 0.9), msg.PoseWithCovariance(POSE, COVARIANCE)
        )
    ],
    msg.BoundingBox3D(POSE, msg.Vector3(0.3, 0.3, 0.0)),
    "DICT_4X4_100:60",
)
DETECTIONS = msg.Detection3DArray(HEADER, [DETECTION])
TRANSFORMS = msg.TFMessage([msg.transform_stamped(STAMP_NS, "map", "odom", np.eye(4))])
ENTITIES = doc.Entities(
    world_hash="0123456789abcdef",
    entities=(
        doc.MarkerEntity(
            name="marker_60",
            position_m=(0.0, 1.0, 0.3),
            orientation_xyzw=(0.0, 0.0, 0.0, 1.0),
            panel_side_m=0.4,
            texture_sha256="ab",
            marker_id=60,
            marker_size_m=0.3,
            dictionary="DICT_4X4_100",
        ),
    ),
    refused=(doc.Refusal(name="marker_80", reason="buried"),),
)
CAMERA_INFO = msg.CameraInfo(
    HEADER,
    2,
    3,
    "plumb_bob",
    np.zeros(5),
    np.eye(3).reshape(9),
    np.eye(3).reshape(9),
    np.eye(3, 4).reshape(12),
    0,
    0,
    msg.RegionOfInterest(0, 0, 0, 0, False),
)
PLANAR = doc.Planar(x_m=1.0, y_m=2.0, yaw_rad=0.0)
SHAPES = (
    doc.Box(size_m=(0.1, 0.2, 0.3)),
    doc.Cylinder(radius_m=0.1, length_m=0.2),
    doc.Cone(radius_m=0.1, length_m=0.2),
    doc.Capsule(radius_m=0.1, length_m=0.2),
    doc.Sphere(radius_m=0.1),
    doc.Ellipsoid(radii_m=(0.1, 0.2, 0.3)),
    doc.Plane(size_m=(0.1, 0.2)),
    doc.Polyline(polygons_m=(((0.0, 0.0), (0.2, 0.0), (0.0, 0.2)),), height_m=0.2),
)
WORLD = doc.World(
    name="tiny",
    recipe="tiny.yaml",
    hash="0123456789abcdef",
    walls=(
        doc.Wall(
            name="Wall_0", length_m=2.0, thickness_m=0.15, height_m=1.0, x_m=3.0, y_m=0.0,
            yaw_rad=1.0, material="plain",
            coverings=(doc.Covering(side="left", from_m=-0.5, to_m=0.5, material="poster"),),
        ),
    ),
    materials=(
        doc.Material(name="plain"),
        doc.Material(name="poster", texture_sha256="cd", texture_name="p.png", texture_side_m=0.0),
    ),
    bodies=(
        doc.Body(
            name="everything", position_m=(3.0, 3.0, 0.5),
            shapes=tuple(
                doc.Shape(
                    name=geometry.kind, geometry=geometry, position_m=(0.1, 0.2, 0.3),
                    orientation_xyzw=(0.0, 0.0, 0.6, 0.8), material="plain",
                )
                for geometry in SHAPES
            ),
        ),
        doc.Body(
            name="of a mesh", position_m=(-3.0, 3.0, 0.5),
            shapes=(doc.Shape(name="mesh", geometry=doc.Mesh(sha256="ef"), material="poster"),),
        ),
        doc.Body(
            name="ball", position_m=(0.0, 3.0, 0.1), mass_kg=0.5,
            shapes=(
                doc.Shape(name="solid", geometry=doc.Sphere(radius_m=0.1)),
                doc.Shape(
                    name="seen", geometry=doc.Sphere(radius_m=0.1), material="plain", solid=False
                ),
            ),
        ),
    ),
    rooms=(
        doc.Room(
            name="hall", polygon_m=((-1.0, -1.0), (1.0, -1.0), (0.0, 1.0)), floor_material="plain"
        ),
    ),
    floor_material="plain",
    ceiling=doc.Ceiling(height_m=2.5, material="plain"),
    lights=(doc.PointLight(name="lamp", position_m=(0.0, 0.0, 2.0), quadratic=0.1),),
    markers=(doc.Marker(id=60, wall="Wall_0", side="left", height_m=0.3),),
    locations=(doc.Location(name="location1", x_m=1.0, y_m=2.0, yaw_rad=0.0),),
    start=doc.Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0),
)  # fmt: skip
REQUEST = doc.WorldRequest(world_name="tiny", overrides=("maze.seed=3",))

BODY = doc.BodyCheckpoint(
    name="ball",
    position_m=(1.0, 2.0, 0.1),
    orientation_xyzw=(0.0, 0.0, 0.0, 1.0),
    velocity_m_s=(0.1, 0.0, 0.0),
    angular_velocity_rad_s=(0.0, 0.0, 0.1),
)
SAMPLES: dict[Topic[Any], Any] = {
    table.CLOCK: msg.Clock(msg.time_from_ns(STAMP_NS)),
    table.WORLD_REQUEST: REQUEST,
    table.WORLD_STATUS: doc.WorldStatus(request=REQUEST, error="unknown"),
    table.ASSETS: msg.CompressedImage(HEADER, "png", np.arange(9, dtype=np.uint8)),
    table.WORLD: WORLD,
    table.MAP: GRID,
    table.DESIRED_ENTITIES: ENTITIES,
    table.ENTITIES: ENTITIES,
    table.TF: TRANSFORMS,
    table.TF_STATIC: TRANSFORMS,
    table.ODOM: ODOMETRY,
    table.JOINT_STATES: msg.JointState(HEADER, ["wheel"], np.ones(1), np.ones(1), np.ones(0)),
    table.IMU: msg.Imu(
        HEADER,
        POSE.orientation,
        np.zeros(9),
        TWIST.angular,
        np.zeros(9),
        TWIST.linear,
        np.zeros(9),
    ),
    table.SCAN: msg.LaserScan(
        HEADER,
        0.0,
        msg.float32(6.28),
        msg.float32(0.0175),
        0.0,
        msg.float32(0.1),
        msg.float32(0.12),
        3.5,
        np.array([1.0, np.inf], np.float32),
        np.zeros(0, np.float32),
    ),
    table.DEPTH_SCAN: msg.LaserScan(
        HEADER,
        msg.float32(-0.5),
        msg.float32(0.5),
        msg.float32(0.5),
        0.0,
        0.0,
        msg.float32(0.27),
        3.5,
        np.array([1.0, np.inf, -np.inf], np.float32),
        np.zeros(0, np.float32),
    ),
    table.CAMERA_IMAGE: msg.Image(HEADER, 2, 3, "rgb8", 0, 9, np.arange(18, dtype=np.uint8)),
    table.CAMERA_COMPRESSED: msg.CompressedImage(HEADER, "jpeg", np.arange(9, dtype=np.uint8)),
    table.DEPTH_IMAGE: msg.Image(
        HEADER, 2, 3, "32FC1", 0, 12, np.arange(6, dtype=np.float32).view(np.uint8)
    ),
    table.DEPTH_INFO: CAMERA_INFO,
    table.CAMERA_INFO: CAMERA_INFO,
    table.GROUND_TRUTH_ODOM: ODOMETRY,
    table.CONTACTS: doc.Contact(
        time_s=1.0,
        robot_link="base_link",
        body="Wall_0",
        position_m=(0.0, 0.0, 0.1),
        impulse_n_s=0.5,
    ),
    table.SIMULATION_STATS: doc.SimulationStats(
        world_hash="ab",
        sim_time_s=1.0,
        iterations=240,
        step_size_s=1 / 240,
        renderer="none",
        state_hash="cd",
    ),
    table.SIMULATION_CHECKPOINT: doc.SimulationCheckpoint(
        world_hash="ab",
        epoch=2,
        run_epoch=1,
        seed=7,
        iterations=240,
        paused=False,
        speed=1.0,
        robot=BODY,
        wheel_angles_rad=(1.0, 2.0),
        odom_from_base=PLANAR,
        odom_covariance=(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-5),
        movers=(BODY,),
    ),
    table.LOCALIZATION_CHECKPOINT: doc.LocalizationCheckpoint(
        world_hash="ab",
        epoch=1,
        state="localized",
        odom_from_base=PLANAR,
        map_from_base=PLANAR,
        covariance=(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-5),
    ),
    table.NAVIGATION_CHECKPOINT: act.NavigationCheckpoint(
        world_hash="ab", epoch=1, goal=act.NavigateToPose(pose=PLANAR), goal_id="a", start_ns=5
    ),
    table.DETECTIONS: DETECTIONS,
    table.MAP_DETECTIONS: DETECTIONS,
    table.INITIAL_POSE: msg.PoseWithCovarianceStamped(
        HEADER, msg.PoseWithCovariance(POSE, COVARIANCE)
    ),
    table.GOAL_POSE: msg.PoseStamped(HEADER, POSE),
    table.GOAL_UPDATE: msg.PoseStamped(HEADER, POSE),
    table.CONTROLLER_SELECTOR: msg.String(data="regulated_pure_pursuit"),
    table.PLANNER_SELECTOR: msg.String(data="a_star"),
    table.SPEED_LIMIT: msg.SpeedLimit(HEADER, percentage=True, speed_limit=50.0),
    table.AMCL_POSE: msg.PoseWithCovarianceStamped(
        HEADER, msg.PoseWithCovariance(POSE, COVARIANCE)
    ),
    table.BATTERY_STATE: msg.BatteryState(
        HEADER,
        12.0,
        math.nan,
        -0.5,
        1.5,
        1.8,
        1.8,
        0.75,
        power_supply_status=2,
        power_supply_health=1,
        power_supply_technology=3,
        present=True,
        cell_voltage=np.full(3, 4.0, np.float32),
        cell_temperature=np.zeros(0, np.float32),
        location="",
        serial_number="",
    ),
    table.PARTICLE_CLOUD: msg.PoseArray(HEADER, [POSE, POSE]),
    table.GLOBAL_COSTMAP: GRID,
    table.GLOBAL_COSTMAP_UPDATES: msg.OccupancyGridUpdate(
        HEADER, 3, 1, 2, 1, np.array([100, -1], np.int8)
    ),
    table.LOCAL_COSTMAP: GRID,
    table.PUBLISHED_FOOTPRINT: msg.PolygonStamped(
        HEADER,
        msg.Polygon([msg.Point32(x, y, 0.0) for x, y in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))]),
    ),
    table.ROBOT_DESCRIPTION: msg.String(data="<robot name='waffle'/>"),
    table.ENTITY_MARKERS: msg.marker_array(
        [msg.line_strip(STAMP_NS, "map", "box", 1, np.zeros((3, 3)), 1.0, (1.0, 0.5, 0.0, 1.0))]
    ),
    table.KEEPOUT_FILTER_MASK: GRID,
    table.SPEED_FILTER_MASK: GRID,
    table.CMD_VEL_TELEOP: msg.TwistStamped(HEADER, TWIST),
    table.COLLISION_MONITOR_STATE: act.CollisionMonitorState(
        action="approach",
        polygon_name="FootprintApproach",
        source="scan",
        points=7,
        nearest_m=(0.2, 0.0),
        reason="7 points of scan 0.20 m away",
    ),
    table.BEHAVIOR_TREE: act.BehaviorTreeLog(
        action="navigate_to_pose",
        nodes=(
            act.BehaviorTreeNode(name="NavigateRecovery", kind="RecoveryNode", status="RUNNING"),
            act.BehaviorTreeNode(name="FollowPath", kind="FollowPath", status="FAILURE", depth=1),
        ),
    ),
    table.POSE_GRAPH: slam.PoseGraph(
        world_hash="0123456789abcdef",
        nodes=tuple(
            slam.GraphNode(
                id=number,
                stamp_ns=STAMP_NS,
                pose=doc.Planar(x_m=float(number), y_m=0.0, yaw_rad=0.5),
                scan=slam.GraphScan(
                    points_mm="6AMAAAAAAAA=",
                    sensor=doc.Planar(x_m=-0.06, y_m=0.0, yaw_rad=0.0),
                ),
            )
            for number in range(2)
        ),
        landmarks=(
            slam.GraphLandmark(
                dictionary="DICT_4X4_100",
                marker_id=60,
                position_m=(0.0, 1.0, 0.3),
                orientation_xyzw=(0.5, -0.5, -0.5, 0.5),
                std_m=0.01,
                sightings=3,
            ),
        ),
        edges=(
            slam.GraphEdge(
                kind="odometry",
                source=0,
                target=1,
                relative=doc.Planar(x_m=1.0, y_m=0.0, yaw_rad=0.0),
                covariance=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01),
                residual=0.1,
            ),
            slam.GraphEdge(
                kind="marker",
                source=1,
                target=0,
                relative=doc.Planar(x_m=-1.0, y_m=1.0, yaw_rad=0.0),
                covariance=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01),
                residual=0.2,
            ),
        ),
        loops=1,
    ),
    table.EXPLORATION_STATUS: slam.ExplorationStatus(
        state="exploring",
        frontiers=3,
        reachable=2,
        set_aside=1,
        free_m2=12.5,
        seen_share=0.6,
        driven_m=4.2,
        goals=2,
    ),
    table.FRONTIERS: msg.marker_array(
        [
            msg.line_strip(
                STAMP_NS,
                "map",
                "frontier",
                0,
                np.array([[0.0, 0.0, 0.1], [1.0, 0.0, 0.1]]),
                0.02,
                (0.2, 0.8, 0.2, 1.0),
            )
        ]
    ),
    table.EXPLORE_RESUME: msg.Bool(data=False),
    table.TRAJECTORIES: msg.marker_array(
        [
            msg.line_strip(
                STAMP_NS,
                "map",
                "rollouts",
                3,
                np.array([[0.0, 0.0, 0.1], [1.0, 0.5, 0.1]]),
                0.01,
                (1.0, 0.5, 0.0, 1.0),
            )
        ]
    ),
    table.ACTION_FEEDBACK: act.ActionFeedback(
        goal_id="a-1", action="navigate_to_pose", distance_remaining_m=2.0
    ),
    table.PHOTO_REQUEST: act.PhotoRequest(waypoint=1, stamp_ns=1_500_000_000),
    table.PHOTO: msg.CompressedImage(HEADER, "rgb8; png compressed", np.arange(9, dtype=np.uint8)),
    table.ACTION_RESULT: act.ActionResult(
        goal_id="a-1", action="spin", status="succeeded", start_time_s=0.0, end_time_s=1.0
    ),
    table.GLOBAL_LOCALIZATION_REQUEST: act.Empty(),
    table.PLAN: msg.Path(HEADER, [msg.PoseStamped(HEADER, POSE)]),
    table.CMD_VEL: msg.TwistStamped(HEADER, TWIST),
    table.LOCALIZATION_STATUS: doc.LocalizationStatus(state="localized", quality=0.97, epoch=1),
    table.NAVIGATION_STATUS: doc.NavigationStatus(
        localization_active=True, navigation_active=False, goal=PLANAR
    ),
    table.NAVIGATION_RESULT: doc.NavigationResult(
        goal=PLANAR,
        goal_stamp_ns=5,
        error_code=204,
        error_msg="outside",
        start_time_s=0.0,
        end_time_s=1.0,
    ),
    table.EVALUATION: doc.Evaluation(
        goals=(
            doc.GoalReport(
                name="home",
                reached=True,
                time_s=1.0,
                path_length_m=2.0,
                shortest_path_m=None,
                goal_error_m=0.1,
                goal_error_rad=0.1,
                recoveries=0,
                error_code=0,
            ),
        ),
        markers_seen={"60": 3},
    ),
    table.PARAMETERS: doc.Parameters(service="physics", values={"seed": 7}),
    table.DIAGNOSTICS: msg.DiagnosticArray(
        HEADER, [msg.DiagnosticStatus(0, "physics", "ok", "", [msg.KeyValue("a", "b")])]
    ),
    table.PARAMETER_EVENTS: msg.ParameterEvent(HEADER.stamp, "/navigation", [], [], []),
    table.ROSOUT: msg.Log(HEADER.stamp, 20, "bringup", "hello", "a.py", "f", 3),
}
