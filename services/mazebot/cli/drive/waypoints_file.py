"""Reads waypoints: names of locations, or a YAML file of poses with tasks.

waypoints:
  - location1                                     # a location of the world
  - [0.5, -0.9, 0.0]                              # x, y (m) and yaw (rad) in the map
  - {x_m: 0.3, y_m: -0.6, yaw_rad: 1.57, wait_s: 2.0}
  - {location: location2, photo: true}
loops: 1                                          # further loops after the first

A mapping under `waypoints`, with `pose: [x, y, z]` and `orientation: [w, x, y, z]` in each, is the
file that the Nav2 panel of RViz saves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mazebot.cli.parsing.poses import are_numbers, given_pose
from mazebot.common.config import ConfigError
from mazebot.common.files.yaml_source import Source, read_source
from mazebot.common.maths.frames import yaw_from_quaternion
from mazebot.common.messages.action_documents import FollowWaypoints, WaypointTask
from mazebot.common.messages.documents import Location, Planar
from mazebot.common.problems import Problem, WorldError, field_name, shown_value
from mazebot.common.settings.known_settings import unknown_name

MOST_WAYPOINTS = 1000
_POSE = ("x_m", "y_m", "yaw_rad")
_TASK = ("wait_s", "photo", "input_timeout_s")
_FIELDS = ("location", *_POSE, *_TASK)
_MAX_COORDINATE_M = 1e6
_MAX_DURATION_S = 86_400.0
_ENDINGS = (".yaml", ".yml")


@dataclass(frozen=True)
class Waypoint:
    """A place, by its name or its pose, with what to do there."""

    place: str | Planar
    where: str
    """Place in the file, for an error; or the name of the argument."""
    task: WaypointTask | None = None


@dataclass(frozen=True)
class Mission:
    """Waypoints in their order."""

    waypoints: tuple[Waypoint, ...]
    loops: int = 0

    def goal(self, locations: Sequence[Location]) -> FollowWaypoints:
        """The action in a world with these locations. Raises ConfigError for an unknown one."""
        known = {place.name: place for place in locations}
        poses = []
        for waypoint in self.waypoints:
            place = waypoint.place
            if isinstance(place, str):
                if place not in known:
                    must = (
                        f"must be one of {', '.join(sorted(known))}"
                        if known
                        else ("the world has no locations")
                    )
                    raise ConfigError(f"{waypoint.where}: {place!r:.60}: {must}")
                place = known[place]
            poses.append(Planar(x_m=place.x_m, y_m=place.y_m, yaw_rad=place.yaw_rad))
        tasks: tuple[WaypointTask, ...] = ()
        if any(waypoint.task for waypoint in self.waypoints):
            tasks = tuple(waypoint.task or WaypointTask() for waypoint in self.waypoints)
        return FollowWaypoints(poses=tuple(poses), tasks=tasks, number_of_loops=self.loops)


def read_mission(words: Sequence[str]) -> Mission:
    """The waypoints of a command: names of locations, poses X,Y[,YAW], or the path of one file.

    Raises ConfigError, in one line, where a file is not one of waypoints.
    """
    if all(map(are_numbers, words)):
        # One pose, its numbers one by one.
        alone = len(words) > 1 and not any("," in word for word in words)
        given = [" ".join(words)] if alone else words
        return Mission(tuple(_given_waypoint(word) for word in given))
    if len(words) == 1 and (words[0].endswith(_ENDINGS) or "/" in words[0]):
        return _read_file(Path(words[0]))
    for word in words:
        if word.endswith(_ENDINGS):
            raise ConfigError(f"waypoints: {word!r:.60}: a file must be the only argument")
    return Mission(tuple(_given_waypoint(word) for word in words))


def _given_waypoint(word: str) -> Waypoint:
    """A location's name, or a pose X,Y[,YAW]. Raises ConfigError."""
    if not are_numbers(word.partition(" ")[0]):
        return Waypoint(word, "waypoints")
    x_m, y_m, yaw_rad = given_pose("waypoints", word)
    return Waypoint(Planar(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad), "waypoints")


def _read_file(path: Path) -> Mission:
    source = read_source(path, str(path))
    reader = _Reader(source)
    for name in source.content:
        if name not in ("waypoints", "loops"):
            said = unknown_name(str(name), ("waypoints", "loops"))
            raise reader.wrong((str(name),), source.content[name], f"unknown field{said}")
    listed = source.content.get("waypoints")
    loops = source.content.get("loops", 0)
    if not isinstance(loops, int) or isinstance(loops, bool) or not 0 <= loops < 2**31:
        raise reader.wrong(("loops",), loops, "must be an integer >= 0")
    if isinstance(listed, dict) and listed:
        of_rviz = [reader.of_rviz(("waypoints", name), item) for name, item in listed.items()]
        return Mission(tuple(of_rviz), loops)
    if not isinstance(listed, list | tuple) or not 0 < len(listed) <= MOST_WAYPOINTS:
        must = f"must be a list of 1 to {MOST_WAYPOINTS} waypoints"
        raise reader.wrong(("waypoints",), listed, must)
    items = [reader.waypoint(("waypoints", index), item) for index, item in enumerate(listed)]
    return Mission(tuple(items), loops)


class _Reader:
    """Turns the content of a file into waypoints, with errors that name the place."""

    def __init__(self, source: Source) -> None:
        self._source = source

    def wrong(self, at: tuple[Any, ...], value: object, must: str) -> WorldError:
        """The error to raise about a value."""
        given = "" if value is None else shown_value(value)
        line = self._source.line_of(at)
        field = field_name(at)
        return WorldError(
            [Problem(file=self._source.file, line=line, field=field, value=given, must=must)]
        )

    def waypoint(self, at: tuple[Any, ...], item: object) -> Waypoint:
        """A waypoint of a list."""
        if isinstance(item, str) and item:
            return Waypoint(item, self._place(at))
        if isinstance(item, list | tuple):
            if len(item) not in (2, 3):
                raise self.wrong(at, item, "must be [x, y] or [x, y, yaw]")
            numbers = [self._number((*at, index), one) for index, one in enumerate(item)]
            x_m, y_m, yaw_rad = [*numbers, 0.0][:3]
            return Waypoint(Planar(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad), self._place(at))
        if not isinstance(item, dict):
            must = "must be the name of a location, [x, y, yaw], or a mapping"
            raise self.wrong(at, item, must)
        for name in item:
            if name not in _FIELDS:
                said = unknown_name(str(name), _FIELDS)
                raise self.wrong((*at, str(name)), item[name], f"unknown field{said}")
        return Waypoint(self._of_fields(at, item), self._place(at), self._task(at, item))

    def of_rviz(self, at: tuple[Any, ...], item: object) -> Waypoint:
        """A waypoint that RViz has saved."""
        fields = item if isinstance(item, dict) else {}
        values = []
        for name, count, form in (
            ("pose", 3, "[x, y, z]"),
            ("orientation", 4, "[w, x, y, z]"),
        ):
            given = fields.get(name)
            if not isinstance(given, list | tuple) or len(given) != count:
                raise self.wrong((*at, name), given, f"must be {form}")
            values += [self._number((*at, name, i), one) for i, one in enumerate(given)]
        x_m, y_m, _, w, x, y, z = values
        length = math.sqrt(w * w + x * x + y * y + z * z)
        if length < 1e-6:
            raise self.wrong((*at, "orientation"), fields["orientation"], "must not be zero")
        yaw_rad = yaw_from_quaternion(x / length, y / length, z / length, w / length)
        return Waypoint(Planar(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad), self._place(at))

    def _place(self, at: tuple[Any, ...]) -> str:
        return f"{self._source.file}:{self._source.line_of(at)}: {field_name(at)}"

    def _of_fields(self, at: tuple[Any, ...], item: Mapping[str, object]) -> str | Planar:
        if "location" in item:
            for name in _POSE:
                if name in item:
                    must = "must not be given with `location`"
                    raise self.wrong((*at, name), item[name], must)
            name_of = item["location"]
            if not isinstance(name_of, str) or not name_of:
                raise self.wrong((*at, "location"), name_of, "must be the name of a location")
            return name_of
        for name in ("x_m", "y_m"):
            if name not in item:
                raise self.wrong((*at, name), None, "is missing: must be given, or `location`")
        x_m, y_m, yaw_rad = (self._number((*at, name), item.get(name, 0.0)) for name in _POSE)
        return Planar(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)

    def _task(self, at: tuple[Any, ...], item: Mapping[str, object]) -> WaypointTask | None:
        given: dict[str, Any] = {name: item[name] for name in _TASK if name in item}
        if not given:
            return None
        for name in ("wait_s", "input_timeout_s"):
            if name in given:
                given[name] = self._number((*at, name), given[name])
                if not 0.0 <= given[name] <= _MAX_DURATION_S:
                    must = f"must be 0 to {_MAX_DURATION_S:g}"
                    raise self.wrong((*at, name), given[name], must)
        if not isinstance(given.get("photo", False), bool):
            raise self.wrong((*at, "photo"), given["photo"], "must be true or false")
        return WaypointTask(**given)

    def _number(self, at: tuple[Any, ...], value: object) -> float:
        if (
            not isinstance(value, int | float)
            or isinstance(value, bool)
            or not -_MAX_COORDINATE_M <= value <= _MAX_COORDINATE_M
        ):
            raise self.wrong(at, value, f"must be a number within +-{_MAX_COORDINATE_M:g}")
        return float(value)
