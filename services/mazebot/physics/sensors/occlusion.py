"""Culling for a camera: what is outside the view, and flat rectangles that are hidden behind others
on a coarse grid.

A software rasteriser tests each pixel of each rectangle; in a maze nearly all of them are hidden.
So the view is divided into cells. From near to far, a rectangle that fills a cell hides everything
farther in it, and a rectangle that is hidden in all cells that it overlaps is not drawn. Anything
that could show in a single pixel is kept, so the image is the same.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel

CELL_PX = 8
_SLACK_PX = 1.0
"""Generous bound on how far a rasteriser's rounding moves an edge."""
_SLACK = 1.0 + 1e-4
"""Generous bound on the factor by which its rounding of depths brings something nearer."""


@kernel()
def visible_quads(
    corners_m: Array,
    optical_from_map: Array,
    focal_px: Array,
    centre_px: Array,
    size_px: NDArray[np.int64],
    depth_limits_m: Array,
) -> NDArray[np.int64]:
    """Indices of the rectangles in view, front-facing and not hidden: near to far.

    `corners_m`, (n, 4, 3) in the map, run counter-clockwise as seen from the front. `focal_px` is
    (fx, fy), `centre_px` (cx, cy), `size_px` (width, height); pixel centres are whole numbers.
    `depth_limits_m` are the near and far clipping distances.
    """
    fx, fy = focal_px
    cx, cy = centre_px
    width, height = size_px
    near_m, far_m = depth_limits_m
    # Rays through the corners of the image.
    left, right = (-0.5 - cx) / fx, (width - 0.5 - cx) / fx
    top, bottom = (-0.5 - cy) / fy, (height - 0.5 - cy) / fy
    turn, shift = optical_from_map[:3, :3], optical_from_map[:3, 3]
    eye = _eye_m(optical_from_map)

    count = len(corners_m)
    seen = np.empty(count, np.int64)
    nearest_m = np.empty(count)
    corners = np.empty((count, 4, 3))
    found = 0
    for quad in range(count):
        first, second, third = corners_m[quad, 0], corners_m[quad, 1], corners_m[quad, 2]
        ax, ay, az = second[0] - first[0], second[1] - first[1], second[2] - first[2]
        bx, by, bz = third[0] - first[0], third[1] - first[1], third[2] - first[2]
        facing = (
            (eye[0] - first[0]) * (ay * bz - az * by)
            + (eye[1] - first[1]) * (az * bx - ax * bz)
            + (eye[2] - first[2]) * (ax * by - ay * bx)
        )
        if facing <= 0.0:
            continue
        leftwards = rightwards = upwards = downwards = close = distant = 0
        least = math.inf
        for corner in range(4):
            place = corners_m[quad, corner]
            x = turn[0, 0] * place[0] + turn[0, 1] * place[1] + turn[0, 2] * place[2] + shift[0]
            y = turn[1, 0] * place[0] + turn[1, 1] * place[1] + turn[1, 2] * place[2] + shift[1]
            z = turn[2, 0] * place[0] + turn[2, 1] * place[1] + turn[2, 2] * place[2] + shift[2]
            corners[found, corner, 0] = x
            corners[found, corner, 1] = y
            corners[found, corner, 2] = z
            leftwards += x < left * z
            rightwards += x > right * z
            upwards += y < top * z
            downwards += y > bottom * z
            close += z < near_m
            distant += z > far_m
            least = min(least, x * x + y * y + z * z)
        if max(leftwards, rightwards, upwards, downwards, close, distant) == 4:
            continue
        seen[found] = quad
        nearest_m[found] = least
        found += 1

    columns = (width + CELL_PX - 1) // CELL_PX
    rows = (height + CELL_PX - 1) // CELL_PX
    hidden_beyond = np.zeros((rows, columns))
    half = CELL_PX / 2.0 + _SLACK_PX
    order = np.argsort(nearest_m[:found], kind="mergesort")
    kept = 0
    result = np.empty(found, np.int64)
    for index in order:
        quad = corners[index]
        # The cells that it overlaps, and 1 / depth of its nearest corner.
        u0, u1, v0, v1, closest = math.inf, -math.inf, math.inf, -math.inf, 0.0
        crosses = False
        for corner in range(4):
            x, y, z = quad[corner]
            if z < near_m:
                crosses = True
                break
            u, v = fx * x / z + cx, fy * y / z + cy
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
            closest = max(closest, 1.0 / z)
        if crosses:
            # Part of it is before the near plane or behind the camera.
            column0, column1, row0, row1 = 0, columns - 1, 0, rows - 1
        else:
            column0 = int(min(max(u0 - _SLACK_PX + 0.5, 0.0), width - 1.0)) // CELL_PX
            column1 = int(min(max(u1 + _SLACK_PX + 0.5, 0.0), width - 1.0)) // CELL_PX
            row0 = int(min(max(v0 - _SLACK_PX + 0.5, 0.0), height - 1.0)) // CELL_PX
            row1 = int(min(max(v1 + _SLACK_PX + 0.5, 0.0), height - 1.0)) // CELL_PX
            hidden = True
            for row in range(row0, row1 + 1):
                for column in range(column0, column1 + 1):
                    if hidden_beyond[row, column] <= closest * _SLACK:
                        hidden = False
                        break
                if not hidden:
                    break
            if hidden:
                continue
        result[kept] = seen[index]
        kept += 1

        # The ray of a pixel, (x, y, 1), hits the rectangle if it is inside the planes through the
        # eye and the edges; the depth is that at which it hits the rectangle's plane. As
        # functions of u and v, planes and 1 / depth are linear, so their least value over a cell
        # is the one at its centre, less half a cell's change.
        normal_x, normal_y, normal_z = _cross(quad[1] - quad[0], quad[2] - quad[0])
        level = normal_x * quad[0, 0] + normal_y * quad[0, 1] + normal_z * quad[0, 2]
        if level >= 0.0:
            continue
        depth_u, depth_v = normal_x / level / fx, normal_y / level / fy
        depth_0 = normal_z / level - depth_u * cx - depth_v * cy
        depth_less = half * (abs(depth_u) + abs(depth_v))
        edges = np.empty((4, 3))
        for corner in range(4):
            x, y, z = _cross(quad[(corner + 1) % 4], quad[corner])
            edge_u, edge_v = x / fx, y / fy
            edges[corner, 0], edges[corner, 1] = edge_u, edge_v
            edges[corner, 2] = z - edge_u * cx - edge_v * cy - half * (abs(edge_u) + abs(edge_v))
        for row in range(row0, row1 + 1):
            v = row * CELL_PX + CELL_PX / 2.0 - 0.5
            for column in range(column0, column1 + 1):
                u = column * CELL_PX + CELL_PX / 2.0 - 0.5
                if (
                    edges[0, 0] * u + edges[0, 1] * v + edges[0, 2] >= 0.0
                    and edges[1, 0] * u + edges[1, 1] * v + edges[1, 2] >= 0.0
                    and edges[2, 0] * u + edges[2, 1] * v + edges[2, 2] >= 0.0
                    and edges[3, 0] * u + edges[3, 1] * v + edges[3, 2] >= 0.0
                ):
                    depth = depth_0 + depth_u * u + depth_v * v - depth_less
                    # Anything nearer than the near plane is not drawn, and hides nothing.
                    drawn = depth + 2.0 * depth_less <= 1.0 / near_m
                    if drawn and depth > hidden_beyond[row, column]:
                        hidden_beyond[row, column] = depth
    return result[:kept]


@kernel()
def balls_in_view(
    centres_m: Array,
    radii_m: Array,
    movers: NDArray[np.int64],
    map_from_movers: Array,
    optical_from_map: Array,
    clip_from_map: Array,
) -> NDArray[np.int64]:
    """Indices of the balls that may be partly in view: near to far.

    `centres_m`, (n, 3), are in the map, or in the frame of the mover whose index `movers` gives;
    it is -1 for static ones. Of two at the same distance the one with the lower index comes first.
    """
    eye = _eye_m(optical_from_map)
    planes = np.empty((6, 4))
    for index in range(6):
        sign = 1.0 if index < 3 else -1.0
        for column in range(4):
            planes[index, column] = (
                clip_from_map[3, column] + sign * clip_from_map[index % 3, column]
            )
        x, y, z = planes[index, 0], planes[index, 1], planes[index, 2]
        planes[index] /= math.sqrt(x * x + y * y + z * z)
    seen = np.empty(len(radii_m), np.int64)
    distances_m = np.empty(len(radii_m))
    found = 0
    for ball in range(len(radii_m)):
        x, y, z = centres_m[ball]
        if movers[ball] >= 0:
            pose = map_from_movers[movers[ball]]
            x, y, z = (
                pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
                pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
                pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
            )
        least_m = math.inf
        for plane in planes:
            least_m = min(least_m, plane[0] * x + plane[1] * y + plane[2] * z + plane[3])
        if least_m < -radii_m[ball]:
            continue
        seen[found] = ball
        x, y, z = x - eye[0], y - eye[1], z - eye[2]
        distances_m[found] = math.sqrt(x * x + y * y + z * z) - radii_m[ball]
        found += 1
    return seen[np.argsort(distances_m[:found], kind="mergesort")]


@kernel()
def _eye_m(optical_from_map: Array) -> Array:
    """Position of the camera in the map."""
    turn, shift = optical_from_map[:3, :3], optical_from_map[:3, 3]
    eye_m: Array = -(shift[0] * turn[0] + shift[1] * turn[1] + shift[2] * turn[2])
    return eye_m


@kernel()
def _cross(a: Array, b: Array) -> tuple[float, float, float]:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
