"""Pictures of a marker on a wall, rendered from a known pose."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array

WIDTH, HEIGHT = 640, 480
FOCAL_PX = 554.0
CAMERA = np.array([[FOCAL_PX, 0.0, 319.5], [0.0, FOCAL_PX, 239.5], [0.0, 0.0, 1.0]])
MARKER_ID = 60
MARKER_SIDE_M = 0.3

_SUPERSAMPLING = 3
_WALL_PX_PER_M = 240
_MODULE_PX = 30


def rotation_about(axis: str, angle_rad: float) -> Array:
    """(3, 3) rotation about `x`, `y` or `z`."""
    vector = np.array([axis == name for name in "xyz"], np.float64) * angle_rad
    return np.asarray(cv2.Rodrigues(vector)[0], np.float64)


def camera_from_marker(
    distance_m: float,
    turn_rad: float = 0.0,
    tilt_rad: float = 0.0,
    bearing_rad: float = 0.0,
    up_m: float = 0.0,
) -> Array:
    """(4, 4) pose of a marker `distance_m` away.

    Its face looks at the camera where `turn_rad` (about the vertical) and `tilt_rad` are zero.
    """
    pose = np.eye(4)
    # A face seen head-on: x right, y up, z towards the camera.
    facing = np.diag([1.0, -1.0, -1.0])
    pose[:3, :3] = (
        rotation_about("y", bearing_rad + turn_rad) @ rotation_about("x", tilt_rad) @ facing
    )
    pose[:3, 3] = (
        distance_m * math.sin(bearing_rad),
        -up_m,
        distance_m * math.cos(bearing_rad),
    )
    return pose


def render(
    pose: Array,
    background: str = "plain",
    marker_id: int = MARKER_ID,
    seed: int = 0,
    noise: float = 2.0,
) -> NDArray[np.uint8]:
    """(480, 640, 3) rgb8 picture of a marker with a quiet zone of one module on a wall.

    `background` is `plain`, `bricks` or `noise`; the camera's noise is in grey levels.
    """
    rng = np.random.default_rng(seed)
    size = (WIDTH * _SUPERSAMPLING, HEIGHT * _SUPERSAMPLING)
    wall = {"plain": plain_wall, "bricks": brick_wall, "noise": noise_wall}[background](rng)
    image = _warp(wall, 1.0 / _WALL_PX_PER_M, pose, size, border=150)
    module_m = MARKER_SIDE_M / 6.0
    panel = marker_panel(marker_id)
    face = _warp(panel, module_m / _MODULE_PX, pose, size)
    mask = _warp(np.full_like(panel, 255), module_m / _MODULE_PX, pose, size)
    image = np.where(mask[..., None] > 127, face[..., None], image).astype(np.uint8)
    small = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    noisy = small + rng.normal(0.0, noise, small.shape)
    picture: NDArray[np.uint8] = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return picture


def marker_panel(marker_id: int) -> NDArray[np.uint8]:
    """Square grey texture of a marker with its quiet zone, top row first."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    black = cv2.aruco.generateImageMarker(dictionary, marker_id, 6 * _MODULE_PX)
    return np.pad(np.asarray(black, np.uint8), _MODULE_PX, constant_values=255)


def plain_wall(_: np.random.Generator) -> NDArray[np.uint8]:
    """A grey wall."""
    return np.full((4 * _WALL_PX_PER_M, 6 * _WALL_PX_PER_M, 3), 170, np.uint8)


def noise_wall(rng: np.random.Generator) -> NDArray[np.uint8]:
    """A wall of blotches of every size up to 0.2 m."""
    shape = (4 * _WALL_PX_PER_M, 6 * _WALL_PX_PER_M)
    wall = np.full(shape, 128.0)
    for cell_px in (3, 12, 48):
        blotches = rng.normal(0.0, 25.0, (shape[0] // cell_px, shape[1] // cell_px))
        wall += cv2.resize(blotches, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.repeat(np.clip(wall, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def brick_wall(rng: np.random.Generator) -> NDArray[np.uint8]:
    """A wall of bricks of 0.2 m by 0.07 m with light mortar."""
    wall = np.empty((4 * _WALL_PX_PER_M, 6 * _WALL_PX_PER_M, 3))
    wall[:] = (175, 170, 165)
    course_px, brick_px, mortar_px = 17, 48, 3
    for row, top in enumerate(range(0, wall.shape[0], course_px)):
        for left in range(-brick_px, wall.shape[1], brick_px):
            x = max(left + (row % 2) * brick_px // 2, 0)
            end = left + (row % 2) * brick_px // 2 + brick_px - mortar_px
            if end > x:
                colour = np.array((150, 80, 65)) + rng.normal(0.0, 14.0)
                wall[top : top + course_px - mortar_px, x:end] = colour
    wall += rng.normal(0.0, 9.0, wall.shape[:2])[..., None]
    return np.clip(wall, 0, 255).astype(np.uint8)


def _warp(
    texture: NDArray[np.uint8], texel_m: float, pose: Array, size: tuple[int, int], border: int = 0
) -> NDArray[np.uint8]:
    """The picture of a texture that lies centred in the marker's plane."""
    rows, columns = texture.shape[:2]
    plane_from_texture = np.array(
        [
            [texel_m, 0.0, (0.5 - columns / 2) * texel_m],
            [0.0, -texel_m, (rows / 2 - 0.5) * texel_m],
            [0.0, 0.0, 1.0],
        ]
    )
    s = float(_SUPERSAMPLING)
    # The centre of a picture's pixel is the centre of its block of samples.
    samples_from_pixels = np.array([[s, 0.0, (s - 1) / 2], [0.0, s, (s - 1) / 2], [0.0, 0.0, 1.0]])
    image_from_plane = samples_from_pixels @ CAMERA @ pose[:3][:, [0, 1, 3]]
    warped = cv2.warpPerspective(
        texture, image_from_plane @ plane_from_texture, size, borderValue=(border,) * 3
    )
    return np.asarray(warped, np.uint8)


def project(pose: Array) -> Array:
    """(4, 2) where a marker's corners truly are in the picture, in ArUco's order."""
    half_m = MARKER_SIDE_M / 2
    signs = np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)])
    corners = half_m * signs @ pose[:3, :2].T + pose[:3, 3]
    pixels: Array = (corners / corners[:, 2:]) @ CAMERA.T
    return pixels[:, :2]


def turn_between(first: Array, second: Array) -> Array:
    """(3,) rotation vector of `first` seen from `second`, both (4, 4)."""
    return np.asarray(cv2.Rodrigues(first[:3, :3] @ second[:3, :3].T)[0], np.float64)[:, 0]
