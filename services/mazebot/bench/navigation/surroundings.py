"""What really stands around the robot over time: the world's solids, things put there and taken
away, and posts that move.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.bench.navigation.robot_outline import outlines
from mazebot.common.maths.frames import SE2, Array
from mazebot.recorder.judging.goals.shortest_path import ShortestPath
from mazebot.recorder.judging.obstacles import obstacles
from mazebot.worldgen.recipe.loaded_world import LoadedWorld

FAR_M = 100.0
"""Distance to the nearest thing where there is none."""


@dataclass
class PutThing:
    """A static thing that stood there for a while."""

    name: str
    polygon: shapely.Polygon
    from_s: float
    until_s: float = np.inf


@dataclass
class Post:
    """An upright cylinder that moves."""

    name: str
    radius_m: float
    times_s: list[float] = field(default_factory=list)
    places_m: list[tuple[float, float]] = field(default_factory=list)
    until_s: float = np.inf
    """When it was taken away"""

    def at(self, times_s: Array) -> Array:
        """(n, 2) of its centre."""
        x, y = np.array(self.places_m).T
        return np.stack(
            [np.interp(times_s, self.times_s, x), np.interp(times_s, self.times_s, y)], 1
        )


class Surroundings:
    """Distances from the robot's outline to what stood around it at the time."""

    def __init__(self, loaded: LoadedWorld) -> None:
        self._solid = obstacles(loaded.world, loaded.meshes)
        self._tree = shapely.STRtree(self._solid)
        self.put: list[PutThing] = []
        self.posts: dict[str, Post] = {}
        self._paths: tuple[tuple[str, ...], ShortestPath] | None = None

    @property
    def solids(self) -> NDArray[np.object_]:
        """The world's own static solids as polygons."""
        return self._solid

    def outlines(self) -> tuple[Array, ...]:
        """The outline of each of the world's own solids, (k, 2) corners."""
        return tuple(np.asarray(shapely.get_coordinates(one)) for one in self._solid)

    def shortest_m(self, start: SE2, goal: SE2, now_s: float) -> float | None:
        """Length of the shortest path around what stands still now; None: there is none."""
        return self.paths(now_s).length_m(start[:2], goal[:2])

    def paths(self, now_s: float) -> ShortestPath:
        """Shortest paths around what stands still now."""
        there = [thing for thing in self.put if thing.from_s <= now_s < thing.until_s]
        names = tuple(f"{thing.name}@{thing.from_s}" for thing in there)
        if self._paths is None or self._paths[0] != names:
            solid = np.array([*self._solid, *(thing.polygon for thing in there)], object)
            self._paths = names, ShortestPath(solid)
        return self._paths[1]

    def point_clearance_m(self, x_m: float, y_m: float) -> float:
        """Distance of a point from the world's own solids; 0 inside one."""
        return float(self._static_m(np.array([shapely.Point(x_m, y_m)], object))[0])

    def clearance_m(self, times_s: Array, poses: Array) -> Array:
        """(n,) distances from the outline at (n, 3) poses x, y, yaw to the nearest thing; 0 where
        it touches one.
        """
        best = np.full(len(times_s), FAR_M)
        for polygons in outlines(poses):
            best = np.minimum(best, self._static_m(polygons))
            for thing in self.put:
                there = (times_s >= thing.from_s) & (times_s < thing.until_s)
                best[there] = np.minimum(
                    best[there], shapely.distance(polygons[there], thing.polygon)
                )
            for post in self.posts.values():
                best = np.minimum(best, _to_post(polygons, post, times_s))
        return best

    def distance_to_m(self, name: str, time_s: float, poses: Array) -> Array:
        """(n,) distances from the outline at (n, 3) poses to the thing of this name as it stood at
        one time; of a name of the world's own things, to the nearest of these.
        """
        times_s = np.full(len(poses), time_s)
        best = np.full(len(poses), FAR_M)
        for polygons in outlines(poses):
            if name in self.posts:
                here = _to_post(polygons, self.posts[name], times_s)
            elif found := [thing for thing in self.put if thing.name == name]:
                here = np.min([shapely.distance(polygons, one.polygon) for one in found], axis=0)
            else:
                here = self._static_m(polygons)
            best = np.minimum(best, here)
        return best

    def distances_to_post_m(self, name: str, times_s: Array, poses: Array) -> Array:
        """(n,) distances from the outline at (n, 3) poses to a post as it stood at (n,) times."""
        post = self.posts[name]
        nearest_m: Array = np.min(
            [_to_post(polygons, post, times_s) for polygons in outlines(poses)], axis=0
        )
        return nearest_m

    def _static_m(self, polygons: NDArray[np.object_]) -> Array:
        found = np.full(len(polygons), FAR_M)
        if len(self._solid) and len(polygons):
            (index, _), distances_m = self._tree.query_nearest(
                polygons, return_distance=True, all_matches=False
            )
            found[index] = distances_m
        return found


def _to_post(polygons: NDArray[np.object_], post: Post, times_s: Array) -> Array:
    if not post.times_s:
        return np.full(len(polygons), FAR_M)
    centres = shapely.points(post.at(times_s))
    distances_m = np.maximum(shapely.distance(polygons, centres) - post.radius_m, 0.0)
    there = (times_s >= post.times_s[0]) & (times_s <= post.until_s)
    return np.asarray(np.where(there, distances_m, FAR_M))
