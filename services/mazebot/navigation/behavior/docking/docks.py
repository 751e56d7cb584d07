"""The docks of a world: before each marker, the nearest place from which the camera sees all of
it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, pose_matrix
from mazebot.common.messages.documents import MarkerEntity
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.context import Dock, planar_marker
from mazebot.navigation.errors import NavigationError


@dataclass(frozen=True)
class CameraView:
    """What a pinhole camera without distortion sees."""

    base_from_camera: Array
    """(4, 4), the camera's optical frame: x right, y down, z forward."""
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    size_px: tuple[int, int]

    def whole_view_m(self, height_m: float, side_m: float, margin: float) -> float:
        """Least distance from which all of an upright square is in the picture, while the robot
        stands straight before it.

        Args:
            height_m: of the square's centre above the floor.
            side_m: its side.
            margin: share of the picture's width and height that is left free at each edge.

        Returns inf where there is no such distance.
        """
        half_m = side_m / 2.0
        rotation, at = self.base_from_camera[:3, :3], self.base_from_camera[:3, 3]
        least_m = 0.0
        limits = []
        for y_m in (-half_m, half_m):
            for z_m in (height_m - half_m, height_m + half_m):
                here = portable.product(rotation.T, -at + (0.0, y_m, z_m))
                # In the camera's frame, a corner at the distance d is at here + d * forward.
                forward = rotation[0]
                for axis, sign, room in self._edges(margin):
                    focal = self.focal_px[axis]
                    fixed = room * here[2] - sign * focal * here[axis]
                    grows = room * forward[2] - sign * focal * forward[axis]
                    limits.append((float(fixed), float(grows)))
                limits.append((float(here[2]), float(forward[2])))
        for fixed, grows in limits:
            if grows > 0.0:
                least_m = max(least_m, -fixed / grows)
        seen = all(fixed + least_m * grows >= -1e-9 for fixed, grows in limits)
        return least_m if seen else math.inf

    def half_view_rad(self, margin: float) -> float:
        """Angle from straight ahead to where a level direction leaves the picture, whichever way
        round the camera is mounted, less the margin, a share of its width and height; 0 where it
        does not look ahead.
        """
        forward, left, _ = self.base_from_camera[:3, :3]
        least_rad = math.pi
        for axis, sign, room in self._edges(margin):
            # A level direction is within an edge while ahead * cos + aside * sin >= 0.
            ahead = float(room * forward[2] - sign * self.focal_px[axis] * forward[axis])
            aside = float(room * left[2] - sign * self.focal_px[axis] * left[axis])
            least_rad = min(least_rad, portable.atan2(ahead, abs(aside)))
        return max(least_rad, 0.0)

    def _edges(self, margin: float) -> Iterator[tuple[int, float, float]]:
        """Of each edge of the picture: the axis across it, its side, and how far it is from the
        centre, in pixels.
        """
        for axis in (0, 1):
            centre, size = self.centre_px[axis], self.size_px[axis]
            yield axis, -1.0, centre - margin * size
            yield axis, 1.0, (1.0 - margin) * size - centre


@dataclass(frozen=True, slots=True)
class DockPlaces:
    """Where the robot docks before a marker."""

    least_m: float = 0.4
    """Never nearer to a marker than this: the robot's front is 0.07 m ahead of its pose."""
    most_m: float = 2.5
    """A marker that is seen whole only from further away is no dock."""
    picture_margin: float = 0.02
    """Share of the picture left free at each edge: the docked robot is a little off."""
    most_bearing_rad: float = 0.35
    """A pose given for docking faces a marker if the marker is this near to its heading."""
    most_aslant_rad: float = 0.8
    """... and it looks at the marker's face within this angle of its normal."""


@dataclass
class Docks:
    """The docks of a world, by name and by id of their markers."""

    places: DockPlaces = field(default_factory=DockPlaces)
    known: dict[str, Dock] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    """Why a name or id is that of no dock."""
    unknown: dict[str, str] = field(default_factory=dict)
    """Why the robot does not know the marker of a name or id."""

    def __len__(self) -> int:
        """Number of names, of docks and of markers that are none."""
        return len(self.known) + len(self.refused)

    def docked(self) -> dict[str, SE2]:
        """Pose of the docked robot in the map, by the dock's name."""
        return {name: dock.map_from_dock for name, dock in self.known.items()}

    def learn(
        self,
        markers: Iterable[MarkerEntity],
        camera: CameraView | None,
        unknown: Mapping[str, str] | None = None,
    ) -> None:
        """Forget the docks before, and make each of these markers a dock, if it can be one.

        Ids come first: where a name is also another marker's id, it is never that of the name's.

        Args:
            markers: those that the robot knows, at their poses in its map.
            camera: None while it is not known, or there is none.
            unknown: by name or id, why the robot does not know a marker.
        """
        by_id = {str(marker.marker_id): marker for marker in markers}
        made = {marker_id: self._dock_or_why(one, camera) for marker_id, one in by_id.items()}
        called = dict(made)
        for marker_id, marker in by_id.items():
            other = by_id.get(marker.name, marker)
            if other is marker:
                called[marker.name] = made[marker_id]
            elif isinstance(made[marker_id], Dock) and isinstance(made[marker.name], Dock):
                called[marker.name] = (
                    f"the id of marker {other.name!r:.60}, and the name of the marker with id "
                    f"{marker_id}: a name must not be another marker's id"
                )
        self.known = {name: dock for name, dock in called.items() if isinstance(dock, Dock)}
        self.refused = {name: why for name, why in called.items() if isinstance(why, str)}
        self.unknown = dict(unknown or {})

    def _dock_or_why(self, marker: MarkerEntity, camera: CameraView | None) -> Dock | str:
        """The dock before a marker, or why there is none."""
        try:
            return self._dock(marker, camera)
        except ValueError as error:
            return str(error)

    def _dock(self, marker: MarkerEntity, camera: CameraView | None) -> Dock:
        map_from_marker = planar_marker(pose_matrix(marker))
        if camera is None:
            raise ValueError("docking needs the camera: nothing received from it yet")
        places, height_m = self.places, marker.position_m[2]
        seen_m = camera.whole_view_m(height_m, marker.panel_side_m, places.picture_margin)
        if math.isinf(seen_m):
            raise ValueError(
                f"the camera does not look ahead at the height of the marker, {height_m:.2f} m: it "
                f"sees all of it, {marker.panel_side_m:.2f} m wide, from no distance"
            )
        if seen_m > places.most_m:
            raise ValueError(
                f"the camera sees the whole marker, {marker.panel_side_m:.2f} m wide at a height "
                f"of {height_m:.2f} m, only from {seen_m:.2f} m away: must be at most "
                f"{places.most_m} m"
            )
        # In whole centimetres: the same for cameras that differ in the last bit.
        away_m = max(places.least_m, math.ceil(seen_m * 100.0 - 1e-6) / 100.0)
        return Dock(
            str(marker.marker_id), map_from_marker, SE2(away_m, 0.0, math.pi), seen_m,
            marker.panel_side_m, camera.half_view_rad(places.picture_margin),
        )  # fmt: skip

    def by_name(self, name: str) -> Dock:
        """A dock by its marker's name or id.

        Raises NavigationError with DOCK_NOT_IN_DB where the robot knows no such marker, and
        DOCK_NOT_VALID where the robot cannot dock at it, or two markers are called so.
        """
        if name in self.refused:
            raise NavigationError(
                ErrorCode.DOCK_NOT_VALID, f"dock {name!r:.60}: {self.refused[name]}"
            )
        if name not in self.known:
            why = f"{self.unknown[name]}; " if name in self.unknown else ""
            raise NavigationError(
                ErrorCode.DOCK_NOT_IN_DB, f"dock {name!r:.60}: {why}{_must_be(self.known)}"
            )
        return self.known[name]

    def at(self, map_from_dock: SE2) -> Dock:
        """The dock whose docked robot has this pose: it faces the dock's marker.

        Raises NavigationError with DOCK_NOT_VALID where it faces none.
        """
        places = self.places
        faced = []
        for dock in self.known.values():
            seen = map_from_dock.inverse() @ dock.map_from_marker
            away_m = math.hypot(seen.x_m, seen.y_m)
            bearing_rad = abs(portable.atan2(seen.y_m, seen.x_m))
            back = dock.map_from_marker.inverse() @ map_from_dock
            aslant_rad = abs(portable.atan2(back.y_m, back.x_m))
            if (
                away_m <= places.most_m
                and bearing_rad <= places.most_bearing_rad
                and aslant_rad <= places.most_aslant_rad
            ):
                faced.append((away_m, dock.marker_id, dock, back))
        if not faced:
            x_m, y_m, yaw_rad = map_from_dock
            raise NavigationError(
                ErrorCode.DOCK_NOT_VALID,
                f"dock_pose ({x_m:.2f}, {y_m:.2f}, {yaw_rad:.2f}): must face a marker within "
                f"{places.most_m} m; {_must_be(self.known)}",
            )
        _, _, dock, back = min(faced, key=lambda one: one[:2])
        return replace(dock, marker_from_dock=back)


def _must_be(docks: Mapping[str, Dock]) -> str:
    if not docks:
        return "there is no marker that the robot knows"
    return f"must be one of {', '.join(sorted(docks))}"
