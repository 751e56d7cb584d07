"""Planar and spatial transforms; `a_from_b` maps coordinates in b to coordinates in a."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable

Array = NDArray[np.float64]


def wrap_angle(angle_rad: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def wrap_angles(angles_rad: Array) -> Array:
    """The same angles in [-pi, pi)."""
    return np.asarray((angles_rad + math.pi) % (2.0 * math.pi) - math.pi)


class SE2(NamedTuple):
    """A planar pose or transform `a_from_b`: the origin and heading of b, in metres and radians in
    a.
    """

    x_m: float
    y_m: float
    yaw_rad: float

    def __matmul__(self, other: SE2) -> SE2:
        """`a_from_b @ b_from_c` is `a_from_c`."""
        c, s = portable.cos_sin(self.yaw_rad)
        return SE2(
            self.x_m + c * other.x_m - s * other.y_m,
            self.y_m + s * other.x_m + c * other.y_m,
            wrap_angle(self.yaw_rad + other.yaw_rad),
        )

    def inverse(self) -> SE2:
        """`b_from_a`."""
        c, s = portable.cos_sin(self.yaw_rad)
        return SE2(
            -c * self.x_m - s * self.y_m, s * self.x_m - c * self.y_m, wrap_angle(-self.yaw_rad)
        )

    def matrix(self, z_m: float = 0.0) -> Array:
        """The (4, 4) homogeneous matrix of this transform at height z_m."""
        c, s = portable.cos_sin(self.yaw_rad)
        return np.array(
            [[c, -s, 0, self.x_m], [s, c, 0, self.y_m], [0, 0, 1, z_m], [0, 0, 0, 1]], np.float64
        )

    def distance_m(self, other: SE2) -> float:
        """Distance between the two origins."""
        return math.hypot(self.x_m - other.x_m, self.y_m - other.y_m)

    def is_near(self, other: SE2, within_m: float, within_rad: float) -> bool:
        """Whether another pose is within a distance and a turn of this one."""
        turned_rad = abs(wrap_angle(self.yaw_rad - other.yaw_rad))
        return self.distance_m(other) <= within_m and turned_rad <= within_rad


class PlanarCovariance(NamedTuple):
    """The six distinct elements of a (3, 3) covariance of (x, y, yaw), as plain numbers: for a
    single covariance several times as fast as matrices.
    """

    x_x: float = 0.0
    x_y: float = 0.0
    x_yaw: float = 0.0
    y_y: float = 0.0
    y_yaw: float = 0.0
    yaw_yaw: float = 0.0

    @classmethod
    def from_matrix(cls, covariance: Array) -> PlanarCovariance:
        """From a symmetric (3, 3) matrix."""
        (x_x, x_y, x_yaw), (_, y_y, y_yaw), (_, _, yaw_yaw) = covariance.tolist()
        return cls(x_x, x_y, x_yaw, y_y, y_yaw, yaw_yaw)

    def matrix(self) -> Array:
        """(3, 3), symmetric."""
        return np.array(
            [
                [self.x_x, self.x_y, self.x_yaw],
                [self.x_y, self.y_y, self.y_yaw],
                [self.x_yaw, self.y_yaw, self.yaw_yaw],
            ]
        )

    def moved(self, x_by_yaw: float, y_by_yaw: float) -> PlanarCovariance:
        """Propagated through a motion, to first order; `x_by_yaw` and `y_by_yaw` are derivatives of
        the end position by the heading at the start.
        """
        x_x, x_y, x_yaw, y_y, y_yaw, yaw_yaw = self
        return PlanarCovariance(
            x_x + x_by_yaw * (2.0 * x_yaw + x_by_yaw * yaw_yaw),
            x_y + x_by_yaw * y_yaw + y_by_yaw * x_yaw + x_by_yaw * y_by_yaw * yaw_yaw,
            x_yaw + x_by_yaw * yaw_yaw,
            y_y + y_by_yaw * (2.0 * y_yaw + y_by_yaw * yaw_yaw),
            y_yaw + y_by_yaw * yaw_yaw,
            yaw_yaw,
        )

    def spread(self, variance: float, x: float, y: float, yaw: float) -> PlanarCovariance:
        """With an independent error of this variance added; one unit of the error moves the pose by
        (x, y, yaw).
        """
        return PlanarCovariance(
            self.x_x + variance * x * x,
            self.x_y + variance * x * y,
            self.x_yaw + variance * x * yaw,
            self.y_y + variance * y * y,
            self.y_yaw + variance * y * yaw,
            self.yaw_yaw + variance * yaw * yaw,
        )


class SE3(NamedTuple):
    """A spatial pose or transform `a_from_b`: the origin of b in metres in a, and its rotation, a
    unit quaternion, as plain numbers: for a single pose several times as fast as matrices.
    """

    position_m: tuple[float, float, float]
    orientation_xyzw: tuple[float, float, float, float]

    @classmethod
    def from_matrix(cls, a_from_b: Array) -> SE3:
        """From a rigid (4, 4) matrix."""
        return cls(*position_and_quaternion(a_from_b))

    def __matmul__(self, other: SE3) -> SE3:
        """`a_from_b @ b_from_c` is `a_from_c`."""
        x, y, z = self.position_m
        dx, dy, dz = self.rotate(*other.position_m)
        ax, ay, az, aw = self.orientation_xyzw
        bx, by, bz, bw = other.orientation_xyzw
        turn = (
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        )
        return SE3((x + dx, y + dy, z + dz), turn)

    def rotate(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """A vector given in b, expressed in a."""
        return _turned(*self.orientation_xyzw, x, y, z)

    def rotate_back(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """A vector given in a, expressed in b."""
        qx, qy, qz, qw = self.orientation_xyzw
        return _turned(-qx, -qy, -qz, qw, x, y, z)


def _turned(
    qx: float, qy: float, qz: float, qw: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """A vector v rotated by a unit quaternion: v + w t + q x t with t = 2 q x v."""
    tx, ty, tz = 2 * (qy * z - qz * y), 2 * (qz * x - qx * z), 2 * (qx * y - qy * x)
    return (
        x + qw * tx + qy * tz - qz * ty,
        y + qw * ty + qz * tx - qx * tz,
        z + qw * tz + qx * ty - qy * tx,
    )


def quaternion_from_yaw(yaw_rad: float) -> tuple[float, float, float, float]:
    """Unit quaternion (x, y, z, w) of a rotation about z."""
    c, s = portable.cos_sin(yaw_rad / 2.0)
    return 0.0, 0.0, s, c


def yaw_from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Heading of a unit quaternion, as in REP 103 (x forward, z up)."""
    return portable.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def rotation_from_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """(3, 3) rotation of fixed-axis roll, pitch, yaw, as URDF and SDFormat define it."""
    cr, sr = portable.cos_sin(roll_rad)
    cp, sp = portable.cos_sin(pitch_rad)
    cy, sy = portable.cos_sin(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ],
        np.float64,
    )


def rotation_from_vector(x_rad: float, y_rad: float, z_rad: float) -> Array:
    """(3, 3) rotation by a rotation vector (axis times angle), by Rodrigues's formula."""
    angle_rad = math.sqrt(x_rad * x_rad + y_rad * y_rad + z_rad * z_rad)
    c, s = portable.cos_sin(angle_rad)
    # (1 - cos) / angle^2 by the half angle, which loses no digits for small angles.
    half = portable.sin(angle_rad / 2.0)
    sine = s / angle_rad if angle_rad > 0.0 else 1.0
    versine = 2.0 * half * half / (angle_rad * angle_rad) if angle_rad > 1e-150 else 0.5
    x, y, z = x_rad, y_rad, z_rad
    return np.array(
        [
            [c + versine * x * x, versine * x * y - sine * z, versine * x * z + sine * y],
            [versine * x * y + sine * z, c + versine * y * y, versine * y * z - sine * x],
            [versine * x * z - sine * y, versine * y * z + sine * x, c + versine * z * z],
        ],
        np.float64,
    )


def rotation_from_quaternion(x: float, y: float, z: float, w: float) -> Array:
    """(3, 3) rotation of a unit quaternion."""
    return rigid_matrix(0.0, 0.0, 0.0, x, y, z, w)[:3, :3].copy()


def quaternion_from_rotation(rotation: Array) -> tuple[float, float, float, float]:
    """Unit quaternion (x, y, z, w) with w >= 0 of a (3, 3) rotation, by Shepperd's method."""
    m = rotation
    trace = float(m[0, 0] + m[1, 1] + m[2, 2])
    q = [0.0, 0.0, 0.0, 0.0]
    if trace > 0.0:
        s = 2.0 * math.sqrt(trace + 1.0)
        q = [(m[2, 1] - m[1, 2]) / s, (m[0, 2] - m[2, 0]) / s, (m[1, 0] - m[0, 1]) / s, s / 4.0]
    else:
        i = int(np.argmax(np.diagonal(m)))
        j, k = (i + 1) % 3, (i + 2) % 3
        s = 2.0 * math.sqrt(max(1.0 + float(m[i, i] - m[j, j] - m[k, k]), 1e-18))
        q[i] = s / 4.0
        q[j] = (m[j, i] + m[i, j]) / s
        q[k] = (m[k, i] + m[i, k]) / s
        q[3] = (m[k, j] - m[j, k]) / s
    sign = -1.0 if q[3] < 0.0 else 1.0
    return sign * float(q[0]), sign * float(q[1]), sign * float(q[2]), sign * float(q[3])


def transform_matrix(rotation: Array, translation_m: tuple[float, float, float]) -> Array:
    """(4, 4) homogeneous matrix of a (3, 3) rotation and a translation."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation_m
    return matrix


class Posed(Protocol):
    """Anything with a pose: a body, a shape, an entity, the state of a moving body."""

    @property
    def position_m(self) -> tuple[float, float, float]:
        """Position of its origin in the parent frame."""

    @property
    def orientation_xyzw(self) -> tuple[float, float, float, float]:
        """A unit quaternion."""


def rigid_matrix(
    x_m: float, y_m: float, z_m: float, qx: float, qy: float, qz: float, qw: float
) -> Array:
    """(4, 4) of a position and a unit quaternion; made at once, as it is made for each message."""
    return np.array(
        [
            [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw), x_m],
            [2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw), y_m],
            [2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy), z_m],
            [0.0, 0.0, 0.0, 1.0],
        ],
        np.float64,
    )


def pose_matrix(posed: Posed) -> Array:
    """(4, 4) parent_from_self."""
    return rigid_matrix(*posed.position_m, *posed.orientation_xyzw)


def position_and_quaternion(
    a_from_b: Array,
) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Position and unit quaternion (x, y, z, w) of a (4, 4) matrix."""
    x, y, z = a_from_b[:3, 3].tolist()
    return (x, y, z), quaternion_from_rotation(a_from_b[:3, :3])


def se2_from_matrix(a_from_b: Array) -> SE2:
    """Planar part of a rigid (4, 4) pose."""
    return SE2(
        float(a_from_b[0, 3]),
        float(a_from_b[1, 3]),
        portable.atan2(float(a_from_b[1, 0]), float(a_from_b[0, 0])),
    )


def inverse_matrix(a_from_b: Array) -> Array:
    """`b_from_a` of a rigid (4, 4) matrix."""
    (xx, xy, xz, x), (yx, yy, yz, y), (zx, zy, zz, z), _ = a_from_b.tolist()
    return np.array(
        [
            [xx, yx, zx, 0.0 - xx * x - yx * y - zx * z],
            [xy, yy, zy, 0.0 - xy * x - yy * y - zy * z],
            [xz, yz, zz, 0.0 - xz * x - yz * y - zz * z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


# An optical frame (x right, y down, z forward) in its camera link (x forward, z up): REP 103.
LINK_FROM_OPTICAL = transform_matrix(
    rotation_from_rpy(-math.pi / 2, 0.0, -math.pi / 2), (0.0, 0.0, 0.0)
)


MAP_FRAME = "map"
ODOM_FRAME = "odom"
BASE_FOOTPRINT_FRAME = "base_footprint"
BASE_LINK_FRAME = "base_link"
SCAN_FRAME = "base_scan"
IMU_FRAME = "imu_link"
CAMERA_FRAME = "camera_link"
CAMERA_OPTICAL_FRAME = "camera_rgb_optical_frame"
