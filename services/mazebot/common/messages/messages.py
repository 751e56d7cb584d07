"""The ROS 2 (Jazzy) message types under their own names, and helper functions that fill them.

The classes of standard packages come from `rosbags`; those of vision_msgs and map_msgs, which it
does not ship, are declared here.
Stamps are simulation time. Lengths are metres, angles radians, unless a name says otherwise.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, cast

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.stores.ros2_jazzy import builtin_interfaces__msg__Duration as Duration
from rosbags.typesys.stores.ros2_jazzy import builtin_interfaces__msg__Time as Time
from rosbags.typesys.stores.ros2_jazzy import (
    diagnostic_msgs__msg__DiagnosticArray as DiagnosticArray,
)
from rosbags.typesys.stores.ros2_jazzy import (
    diagnostic_msgs__msg__DiagnosticStatus as DiagnosticStatus,
)
from rosbags.typesys.stores.ros2_jazzy import diagnostic_msgs__msg__KeyValue as KeyValue
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Point as Point
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Point32 as Point32
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Polygon as Polygon
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__PolygonStamped as PolygonStamped,
)
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Pose as Pose
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__PoseArray as PoseArray
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__PoseStamped as PoseStamped
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__PoseWithCovariance as PoseWithCovariance,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__PoseWithCovarianceStamped as PoseWithCovarianceStamped,
)
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Quaternion as Quaternion
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Transform as Transform
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__TransformStamped as TransformStamped,
)
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Twist as Twist
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__TwistStamped as TwistStamped
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__TwistWithCovariance as TwistWithCovariance,
)
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Vector3 as Vector3
from rosbags.typesys.stores.ros2_jazzy import nav_msgs__msg__MapMetaData as MapMetaData
from rosbags.typesys.stores.ros2_jazzy import nav_msgs__msg__OccupancyGrid as OccupancyGrid
from rosbags.typesys.stores.ros2_jazzy import nav_msgs__msg__Odometry as Odometry
from rosbags.typesys.stores.ros2_jazzy import nav_msgs__msg__Path as Path
from rosbags.typesys.stores.ros2_jazzy import rcl_interfaces__msg__Log as Log
from rosbags.typesys.stores.ros2_jazzy import rcl_interfaces__msg__ParameterEvent as ParameterEvent
from rosbags.typesys.stores.ros2_jazzy import rosgraph_msgs__msg__Clock as Clock
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__BatteryState as BatteryState
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__CameraInfo as CameraInfo
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__CompressedImage as CompressedImage
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__Image as Image
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__Imu as Imu
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__JointState as JointState
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__LaserScan as LaserScan
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__RegionOfInterest as RegionOfInterest
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__Bool as Bool
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__ColorRGBA as ColorRGBA
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__Header as Header
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__String as String
from rosbags.typesys.stores.ros2_jazzy import tf2_msgs__msg__TFMessage as TFMessage
from rosbags.typesys.stores.ros2_jazzy import visualization_msgs__msg__Marker as Marker
from rosbags.typesys.stores.ros2_jazzy import visualization_msgs__msg__MarkerArray as MarkerArray
from rosbags.typesys.stores.ros2_jazzy import visualization_msgs__msg__MeshFile as MeshFile

from mazebot.common.maths import portable
from mazebot.common.maths.frames import (
    SE2,
    SE3,
    Array,
    PlanarCovariance,
    position_and_quaternion,
    quaternion_from_yaw,
    rigid_matrix,
    yaw_from_quaternion,
)
from mazebot.common.messages.rows import points_from_array

__all__ = [
    "BatteryState",
    "Bool",
    "CameraInfo",
    "Clock",
    "ColorRGBA",
    "CompressedImage",
    "Detection3D",
    "Detection3DArray",
    "DiagnosticArray",
    "DiagnosticStatus",
    "Header",
    "Image",
    "Imu",
    "JointState",
    "KeyValue",
    "LaserScan",
    "Log",
    "MapMetaData",
    "Marker",
    "MarkerArray",
    "OccupancyGrid",
    "Odometry",
    "ParameterEvent",
    "Path",
    "Point",
    "Point32",
    "Polygon",
    "PolygonStamped",
    "Pose",
    "PoseArray",
    "PoseStamped",
    "PoseWithCovariance",
    "PoseWithCovarianceStamped",
    "Quaternion",
    "RegionOfInterest",
    "String",
    "TFMessage",
    "Time",
    "Transform",
    "TransformStamped",
    "Twist",
    "TwistStamped",
    "TwistWithCovariance",
    "Vector3",
]


class RosMessage(Protocol):
    """Anything with a ROS type name."""

    __msgtype__: ClassVar[str]


@dataclass
class ObjectHypothesis:
    """vision_msgs/ObjectHypothesis: the object's class, and the score (0 to 1)."""

    class_id: str
    score: float
    __msgtype__: ClassVar[str] = "vision_msgs/msg/ObjectHypothesis"


@dataclass
class ObjectHypothesisWithPose:
    """vision_msgs/ObjectHypothesisWithPose: one hypothesis of identity and pose in the array's
    frame.
    """

    hypothesis: ObjectHypothesis
    pose: PoseWithCovariance
    __msgtype__: ClassVar[str] = "vision_msgs/msg/ObjectHypothesisWithPose"


@dataclass
class BoundingBox3D:
    """vision_msgs/BoundingBox3D: centre pose and full side lengths in metres."""

    center: Pose
    size: Vector3
    __msgtype__: ClassVar[str] = "vision_msgs/msg/BoundingBox3D"


@dataclass
class Detection3D:
    """vision_msgs/Detection3D: the hypotheses of one object, best first."""

    header: Header
    results: list[ObjectHypothesisWithPose]
    bbox: BoundingBox3D
    id: str
    __msgtype__: ClassVar[str] = "vision_msgs/msg/Detection3D"


@dataclass
class Detection3DArray:
    """vision_msgs/Detection3DArray: all objects detected in one image."""

    header: Header
    detections: list[Detection3D]
    __msgtype__: ClassVar[str] = "vision_msgs/msg/Detection3DArray"


@dataclass
class OccupancyGridUpdate:
    """map_msgs/OccupancyGridUpdate: cells of a part of a grid that was published before, row by
    row; x and y are the column and the row of its first cell.
    """

    header: Header
    x: int
    y: int
    width: int
    height: int
    data: NDArray[np.int8]
    __msgtype__: ClassVar[str] = "map_msgs/msg/OccupancyGridUpdate"


@dataclass
class SpeedLimit:
    """nav2_msgs/SpeedLimit: the highest speed, in m/s or in percent of the robot's; 0: none."""

    header: Header
    percentage: bool
    speed_limit: float
    __msgtype__: ClassVar[str] = "nav2_msgs/msg/SpeedLimit"


OTHER_MESSAGES: dict[type[RosMessage], str] = {
    SpeedLimit: "std_msgs/Header header\nbool percentage\nfloat64 speed_limit\n",
    OccupancyGridUpdate: (
        "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data\n"
    ),
    ObjectHypothesis: "string class_id\nfloat64 score\n",
    ObjectHypothesisWithPose: (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    BoundingBox3D: "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    Detection3D: (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id\n"
    ),
    Detection3DArray: "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}


TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
REGISTERING = threading.RLock()
"""Held while a type is added to it: services do so on several threads."""
for _class, _text in OTHER_MESSAGES.items():
    TYPESTORE.register(get_types_from_msg(_text, _class.__msgtype__))
    # Decoding then yields the classes above, which the type checker knows.
    TYPESTORE.types[_class.__msgtype__] = _class


def float32(value: float) -> float:
    """The value of a float32 field after serialization, so that a run in one process sees the same
    value as one over the bus.
    """
    return float(np.float32(value))


def time_from_ns(stamp_ns: int) -> Time:
    """ROS time of a simulation time in nanoseconds."""
    return Time(sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000)


def ns_from_time(time: Time) -> int:
    """Simulation time in nanoseconds of a ROS time."""
    return time.sec * 1_000_000_000 + time.nanosec


def header(stamp_ns: int, frame_id: str) -> Header:
    """Header at a simulation time in a frame."""
    return Header(stamp=time_from_ns(stamp_ns), frame_id=frame_id)


def pose_from_se2(pose: SE2, z_m: float = 0.0) -> Pose:
    """Pose message of a planar pose."""
    return Pose(
        position=Point(x=pose.x_m, y=pose.y_m, z=z_m),
        orientation=Quaternion(*quaternion_from_yaw(pose.yaw_rad)),
    )


def se2_from_pose(pose: Pose) -> SE2:
    """Planar part of a pose message."""
    q = pose.orientation
    return SE2(pose.position.x, pose.position.y, yaw_from_quaternion(q.x, q.y, q.z, q.w))


UNIT_WITHIN = 1e-3
"""How far from 1 the square of a rotation's norm may be."""


def is_unit(q: Quaternion) -> bool:
    """Whether a quaternion is a rotation, as far as its numbers go: only then has it a heading."""
    return abs(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w - 1.0) < UNIT_WITHIN


def pose_from_se3(pose: SE3) -> Pose:
    """Pose message of a spatial pose."""
    return Pose(position=Point(*pose.position_m), orientation=Quaternion(*pose.orientation_xyzw))


def pose_from_matrix(matrix: Array) -> Pose:
    """Pose message of a rigid (4, 4) matrix."""
    position_m, orientation_xyzw = position_and_quaternion(matrix)
    return Pose(position=Point(*position_m), orientation=Quaternion(*orientation_xyzw))


def matrix_from_pose(pose: Pose) -> Array:
    """Rigid (4, 4) matrix of a pose message."""
    q, p = pose.orientation, pose.position
    return rigid_matrix(p.x, p.y, p.z, q.x, q.y, q.z, q.w)


def transform_stamped(
    stamp_ns: int, parent_frame: str, child_frame: str, parent_from_child: Array
) -> TransformStamped:
    """TF entry of a rigid (4, 4) matrix."""
    return _transform_stamped(
        stamp_ns, parent_frame, child_frame, pose_from_matrix(parent_from_child)
    )


def planar_transform_stamped(
    stamp_ns: int, parent_frame: str, child_frame: str, parent_from_child: SE2
) -> TransformStamped:
    """TF entry of a planar pose."""
    return _transform_stamped(stamp_ns, parent_frame, child_frame, pose_from_se2(parent_from_child))


def _transform_stamped(
    stamp_ns: int, parent_frame: str, child_frame: str, pose: Pose
) -> TransformStamped:
    return TransformStamped(
        header=header(stamp_ns, parent_frame),
        child_frame_id=child_frame,
        transform=Transform(
            translation=Vector3(pose.position.x, pose.position.y, pose.position.z),
            rotation=pose.orientation,
        ),
    )


def matrix_from_transform(transform: Transform) -> Array:
    """Rigid (4, 4) matrix of a TF transform."""
    q, t = transform.rotation, transform.translation
    return rigid_matrix(t.x, t.y, t.z, q.x, q.y, q.z, q.w)


def se2_from_transform(transform: Transform) -> SE2:
    """Planar part of a TF transform."""
    q, t = transform.rotation, transform.translation
    return SE2(t.x, t.y, yaw_from_quaternion(q.x, q.y, q.z, q.w))


def chain_transforms(
    transforms: Iterable[TransformStamped], parent_frame: str, child_frame: str
) -> Array | None:
    """Rigid (4, 4) `parent_from_child` through TF entries; None where they are not connected."""
    parents = {entry.child_frame_id: entry for entry in transforms}
    parent_from_child = np.eye(4)
    frame = child_frame
    for _ in range(len(parents) + 1):
        if frame == parent_frame:
            return parent_from_child
        if frame not in parents:
            return None
        parent_from_child = portable.product(
            matrix_from_transform(parents[frame].transform), parent_from_child
        )
        frame = parents[frame].header.frame_id
    return None


def has_ring(parents: Mapping[str, str]) -> bool:
    """Whether frames, each given with its parent frame, form a cycle."""
    hung: set[str] = set()
    for first in parents:
        frame, way = first, set[str]()
        while frame in parents and frame not in hung:
            if frame in way:
                return True
            way.add(frame)
            frame = parents[frame]
        hung |= way
    return False


_HERE = pose_from_se2(SE2(0.0, 0.0, 0.0))
_NO_TEXTURE = CompressedImage(header(0, ""), "", np.empty(0, np.uint8))
_NO_MESH = MeshFile("", np.empty(0, np.uint8))


def line_strip(
    stamp_ns: int, frame_id: str, name: str, number: int, points_m: Array, width_m: float,
    color: tuple[float, float, float, float],
) -> Marker:  # fmt: skip
    """Marker of a line through (n, 3) points; `name` and `number` identify it, and its colour is
    red, green, blue and opacity, 0 to 1.
    """
    return Marker(
        header=header(stamp_ns, frame_id),
        ns=name,
        id=number,
        type=Marker.LINE_STRIP,
        action=Marker.ADD,
        pose=_HERE,
        scale=Vector3(width_m, 0.0, 0.0),
        color=ColorRGBA(*map(float32, color)),
        lifetime=Duration(0, 0),
        frame_locked=False,
        points=points_from_array(points_m),
        colors=[],
        texture_resource="",
        texture=_NO_TEXTURE,
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=_NO_MESH,
        mesh_use_embedded_materials=False,
    )


def marker_array(markers: list[Marker]) -> MarkerArray:
    """Markers in one message."""
    # The type hints of rosbags name the same class of another distribution.
    return MarkerArray(cast("Any", markers))


_PLANAR_OF_36 = np.array([0, 1, 5, 6, 7, 11, 30, 31, 35])
_OTHER_VARIANCES_OF_36 = np.array([14, 21, 28])


def planar_covariance(covariance_3x3: Array, unused: float = 0.0) -> NDArray[np.float64]:
    """ROS (36,) row-major covariance of (x, y, z, roll, pitch, yaw) from one of (x, y, yaw).

    `unused` is the diagonal value for z, roll and pitch.
    """
    full = np.zeros(36)
    full[_PLANAR_OF_36] = np.asarray(covariance_3x3).reshape(9)
    full[_OTHER_VARIANCES_OF_36] = unused
    return full


def covariance_36(covariance: PlanarCovariance, unused: float = 0.0) -> NDArray[np.float64]:
    """As `planar_covariance`, of plain numbers."""
    x_x, x_y, x_yaw, y_y, y_yaw, yaw_yaw = covariance
    return np.array(
        (
            *(x_x, x_y, 0.0, 0.0, 0.0, x_yaw),
            *(x_y, y_y, 0.0, 0.0, 0.0, y_yaw),
            *(0.0, 0.0, unused, 0.0, 0.0, 0.0),
            *(0.0, 0.0, 0.0, unused, 0.0, 0.0),
            *(0.0, 0.0, 0.0, 0.0, unused, 0.0),
            *(x_yaw, y_yaw, 0.0, 0.0, 0.0, yaw_yaw),
        )
    )


def occupancy_grid(
    stamp_ns: int, resolution_m: float, origin: SE2, cells: NDArray[np.int8], frame_id: str = "map"
) -> OccupancyGrid:
    """Grid message of (height, width) cells, row 0 at the smallest y; -1 unknown, 0 free to 100
    occupied.
    """
    rows, columns = cells.shape
    return OccupancyGrid(
        header=header(stamp_ns, frame_id),
        info=MapMetaData(
            map_load_time=time_from_ns(0),
            resolution=float32(resolution_m),
            width=columns,
            height=rows,
            origin=pose_from_se2(origin),
        ),
        data=np.ascontiguousarray(cells, np.int8).reshape(-1),
    )


def cells_from_grid(grid: OccupancyGrid) -> NDArray[np.int8]:
    """(height, width) cells of a grid message, row 0 at the smallest y."""
    return grid.data.reshape(grid.info.height, grid.info.width)


def same_grid(one: OccupancyGrid, other: OccupancyGrid | None) -> bool:
    """Whether two grids have the same cells at the same place; their stamps may differ."""
    return (
        other is not None
        and one.info.resolution == other.info.resolution
        and one.info.width == other.info.width
        and se2_from_pose(one.info.origin) == se2_from_pose(other.info.origin)
        and np.array_equal(one.data, other.data)
    )


def grid_contains(grid: OccupancyGrid, x_m: float, y_m: float) -> bool:
    """Whether a point of the grid's frame lies in the grid."""
    in_grid = se2_from_pose(grid.info.origin).inverse() @ SE2(x_m, y_m, 0.0)
    width_m = grid.info.width * grid.info.resolution
    height_m = grid.info.height * grid.info.resolution
    return 0.0 <= in_grid.x_m < width_m and 0.0 <= in_grid.y_m < height_m
