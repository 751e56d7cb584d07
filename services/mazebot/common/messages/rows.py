"""Many points or poses in one message, as the rows of an array."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar, cast, overload

import numpy as np
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Point as Point
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Pose as Pose
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Quaternion as Quaternion

from mazebot.common.maths.frames import Array

M = TypeVar("M")


class Rows(Sequence[M]):
    """Messages of a type that has nothing but float64 numbers: an array holds them, and each is
    made when it is looked at. What encodes or draws all of them takes the array.
    """

    def __init__(self, numbers: Array, make: Callable[..., M]) -> None:
        """`numbers`: (n, k), not to be modified; `make`: makes a message of k numbers."""
        self.numbers = numbers
        self._make = make

    def __len__(self) -> int:
        return len(self.numbers)

    @overload
    def __getitem__(self, index: int) -> M: ...

    @overload
    def __getitem__(self, index: slice) -> Rows[M]: ...

    def __getitem__(self, index: int | slice) -> M | Rows[M]:
        if isinstance(index, slice):
            return Rows(self.numbers[index], self._make)
        return self._make(*self.numbers[index].tolist())

    def __iter__(self) -> Iterator[M]:
        return (self._make(*row) for row in self.numbers.tolist())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return repr(list(self))


def points_from_array(points_m: Array) -> list[Point]:
    """The (n, 3) points of a message."""
    # In a message's type hints it is a list.
    return cast("list[Point]", Rows(np.array(points_m, np.float64), Point))


def array_from_points(points: Sequence[Point]) -> Array:
    """(n, 3) the points of a message, not to be modified."""
    if isinstance(points, Rows):
        return points.numbers
    return np.array([(p.x, p.y, p.z) for p in points], np.float64).reshape(-1, 3)


def poses_from_array(poses: Array) -> list[Pose]:
    """The (n, 7) poses of a message: position and unit quaternion (x, y, z, w)."""
    return cast("list[Pose]", Rows(np.array(poses, np.float64), _pose))


def array_from_poses(poses: Sequence[Pose]) -> Array:
    """(n, 7) the poses of a message, not to be modified: position and quaternion (x, y, z, w)."""
    if isinstance(poses, Rows):
        return poses.numbers
    places = ((one.position, one.orientation) for one in poses)
    numbers = [(p.x, p.y, p.z, q.x, q.y, q.z, q.w) for p, q in places]
    return np.array(numbers, np.float64).reshape(-1, 7)


def _pose(x_m: float, y_m: float, z_m: float, qx: float, qy: float, qz: float, qw: float) -> Pose:
    return Pose(Point(x_m, y_m, z_m), Quaternion(qx, qy, qz, qw))
