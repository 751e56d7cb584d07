"""Camera views of worlds from random poses, and the markers truly in view there, by geometry."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, CAMERA_OPTICAL_FRAME, SE2, Array
from mazebot.common.messages.documents import MarkerEntity
from mazebot.common.settings.load import load
from mazebot.common.world.marker_entities import marker_entities
from mazebot.common.world.placement import panel_of
from mazebot.physics.bodies.robot_model import robot_model_from_urdf
from mazebot.physics.camera.camera import Intrinsics
from mazebot.physics.camera.camera_noise import CameraNoise
from mazebot.physics.camera.cpu_camera import CpuCamera
from mazebot.physics.camera.scene import build_scene
from mazebot.physics.config import PhysicsConfig
from mazebot.worldgen.markers.visibility import reachable
from mazebot.worldgen.recipe.loader import load_world

NEAREST_M, FARTHEST_M = 0.6, 4.0
WIDEST_RAD = math.radians(60.0)
"""Markers in this range from the camera, and within this angle to their normal, must be found."""

_RAYS_ALONG = 7
_INSIDE = 1.0 - 1e-6
"""Of a side: rays to the very edge would be judged by rounding."""
_TOUCH = 1e-3
"""Share of a ray's length at its end that may lie in the wall that carries the panel."""
_TRIES = 200


@dataclass(frozen=True)
class TrueMarker:
    """A marker in view: its black square is in the picture and nothing hides any of it.

    `range_m` is from the camera to its centre, and `angle_rad` between its normal and the ray to
    the camera. `whole_panel` is whether its white quiet zone is in view as well.
    """

    marker: MarkerEntity
    camera_from_marker: Array
    range_m: float
    angle_rad: float
    whole_panel: bool


@dataclass(frozen=True)
class View:
    """A picture, (height, width, 3) rgb8, and the markers in view."""

    rgb: NDArray[np.uint8]
    in_view: tuple[TrueMarker, ...]
    partly: frozenset[int]
    """Ids of markers of which any point is in view: detecting one is no mistake."""


class Viewer:
    """Renders one world as the robot's camera sees it from poses on its floor.

    `with_markers` False takes all markers off the walls.
    """

    def __init__(
        self, name: str, overrides: tuple[str, ...] = (), *, with_markers: bool = True,
        noise: float = 0.0, seed: int = 0,
    ) -> None:  # fmt: skip
        config = load(PhysicsConfig, "physics", ["--camera-noise", str(noise)])
        loaded = load_world(name, overrides=overrides)
        width, height = config.camera_width_px, config.camera_height_px
        self.intrinsics = Intrinsics.from_horizontal_fov(
            width, height, config.camera_horizontal_fov_rad
        )
        model = robot_model_from_urdf(config.robot_urdf())
        self.base_from_optical = model.transform(BASE_FOOTPRINT_FRAME, CAMERA_OPTICAL_FRAME)
        entities, textures = marker_entities(loaded.world, meshes=loaded.meshes)
        self.markers: tuple[MarkerEntity, ...] = entities.markers if with_markers else ()
        assets = {**loaded.assets, **textures}
        bare = build_scene(loaded.world, assets)
        self._triangles_m = bare.vertices_m[bare.triangles]
        self._renderer = CpuCamera(self.intrinsics)
        self._renderer.set_scene(build_scene(loaded.world, assets, self.markers))
        values = 3 * width * height
        self._noise = CameraNoise(config.camera_noise, values, np.random.default_rng(seed))
        self._resolution_m = loaded.world.map_resolution_m
        self._origin = loaded.map_origin
        self._free = reachable(
            loaded.map_cells, self._resolution_m, self._origin, loaded.world.start
        )

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()

    def random_pose(self, generator: np.random.Generator) -> SE2:
        """A pose anywhere on the floor that the robot can reach."""
        rows, columns = np.nonzero(self._free)
        cell = int(generator.integers(len(rows)))
        step = generator.random(2)
        at = self._origin @ SE2(
            float(columns[cell] + step[0]) * self._resolution_m,
            float(rows[cell] + step[1]) * self._resolution_m,
            0.0,
        )
        return SE2(at.x_m, at.y_m, float(generator.uniform(-math.pi, math.pi)))

    def pose_before_a_marker(
        self,
        generator: np.random.Generator,
        range_m: tuple[float, float] = (NEAREST_M, FARTHEST_M),
        angle_rad: tuple[float, float] = (0.0, WIDEST_RAD),
    ) -> SE2 | None:
        """A pose on the floor with a marker in view in an interval of ranges and one of angles.

        None where no such pose is found in a number of tries.
        """
        half_fov_rad = math.atan(self.intrinsics.width / 2.0 / self.intrinsics.fx)
        ahead_m, left_m, _ = self.base_from_optical[:3, 3].tolist()
        for _ in range(_TRIES):
            marker = self.markers[int(generator.integers(len(self.markers)))]
            panel = panel_of(marker)
            off_m = float(generator.uniform(*range_m))
            aside_rad = float(generator.uniform(*angle_rad)) * float(generator.choice((-1.0, 1.0)))
            bearing_rad = math.atan2(panel.normal[1], panel.normal[0]) + aside_rad
            camera = SE2(
                float(panel.centre_m[0]) + off_m * math.cos(bearing_rad),
                float(panel.centre_m[1]) + off_m * math.sin(bearing_rad),
                bearing_rad + math.pi + half_fov_rad * float(generator.uniform(-0.9, 0.9)),
            )
            pose = camera @ SE2(ahead_m, left_m, 0.0).inverse()
            if self._is_free(pose):
                seen = self._seen(marker, pose.matrix() @ self.base_from_optical)
                if isinstance(seen, TrueMarker):
                    return pose
        return None

    def look(self, map_from_base: SE2) -> View:
        """The picture from a pose, and the markers in view."""
        map_from_optical = map_from_base.matrix() @ self.base_from_optical
        rgb = self._renderer.render(map_from_optical).rgb
        self._noise.add_to(rgb)
        in_view: list[TrueMarker] = []
        partly: set[int] = set()
        for marker in self.markers:
            seen = self._seen(marker, map_from_optical)
            if seen is not None:
                partly.add(marker.marker_id)
                in_view += [seen] if isinstance(seen, TrueMarker) else []
        return View(rgb, tuple(in_view), frozenset(partly))

    def _is_free(self, pose: SE2) -> bool:
        cell = self._origin.inverse() @ pose
        row = math.floor(cell.y_m / self._resolution_m)
        column = math.floor(cell.x_m / self._resolution_m)
        rows, columns = self._free.shape
        return 0 <= row < rows and 0 <= column < columns and bool(self._free[row, column])

    def _seen(self, marker: MarkerEntity, map_from_optical: Array) -> TrueMarker | str | None:
        """The truth of a marker in view; `partly` where it is cut off, hidden in part, too far, too
        near or too oblique; None where nothing of it is in the picture.
        """
        panel = panel_of(marker)
        camera_from_marker = np.linalg.inv(map_from_optical) @ panel.map_from_panel
        place, normal = camera_from_marker[:3, 3], camera_from_marker[:3, 2]
        range_m = float(np.linalg.norm(place))
        cosine = -float(normal @ place) / range_m
        if cosine <= 0.0:
            return None
        sides_m = _INSIDE * panel.side_m, _INSIDE * marker.marker_size_m
        along = np.concatenate([np.linspace(-0.5, 0.5, _RAYS_ALONG) * side for side in sides_m])
        across, up = (axis.ravel() for axis in np.meshgrid(along, along))
        grid = np.stack([across, up, np.zeros_like(up), np.ones_like(up)], axis=1)
        seen = self._in_picture(grid @ camera_from_marker[:3].T)
        if seen.any():
            targets_m = grid[seen] @ panel.map_from_panel[:3].T
            seen[seen] = ~hidden(map_from_optical[:3, 3], targets_m, self._triangles_m)
        if not seen.any():
            return None
        on_black = np.maximum(np.abs(across), np.abs(up)) <= marker.marker_size_m / 2.0
        in_range = NEAREST_M <= range_m <= FARTHEST_M and cosine >= math.cos(WIDEST_RAD)
        if not (seen[on_black].all() and in_range):
            return "partly"
        angle_rad = math.acos(min(cosine, 1.0))
        return TrueMarker(marker, camera_from_marker, range_m, angle_rad, bool(seen.all()))

    def _pixels(self, points: Array) -> Array:
        of = self.intrinsics
        rays = points[:, :2] / points[:, 2:]
        return np.asarray(rays * (of.fx, of.fy) + (of.cx, of.cy), np.float64)

    def _in_picture(self, points: Array) -> NDArray[np.bool_]:
        ahead = points[:, 2] > 1e-3
        pixels = self._pixels(np.where(ahead[:, None], points, 1.0))
        limits = self.intrinsics.width - 0.5, self.intrinsics.height - 0.5
        inside = (pixels >= -0.5).all(axis=1) & (pixels <= limits).all(axis=1)
        return np.asarray(ahead & inside, np.bool_)


def hidden(from_m: Array, targets_m: Array, triangles_m: Array) -> NDArray[np.bool_]:
    """(n,) whether one of the (m, 3, 3) triangles is between a point and each of (n, 3) targets.

    After Moeller and Trumbore, Fast, Minimum Storage Ray/Triangle Intersection (1997).
    """
    least = np.minimum(targets_m.min(axis=0), from_m)
    most = np.maximum(targets_m.max(axis=0), from_m)
    near = (triangles_m.max(axis=1) >= least) & (triangles_m.min(axis=1) <= most)
    triangles_m = triangles_m[near.all(axis=1)]
    first = triangles_m[:, 0]
    one, two = triangles_m[:, 1] - first, triangles_m[:, 2] - first
    rays = (targets_m - from_m)[:, None]
    away = from_m - first
    side, turned = np.cross(rays, two), np.cross(away, one)
    volume = (side * one).sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (side * away).sum(axis=2) / volume
        v = (rays * turned).sum(axis=2) / volume
        length = (two * turned).sum(axis=1) / volume
        hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (length > 0.0) & (length < 1.0 - _TOUCH)
    return np.asarray(hit.any(axis=1), np.bool_)
