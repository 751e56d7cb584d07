"""A search over places, headings and time for the nearest place where the robot is in nobody's way:
aside at the wall, in a side room, or back along the way that it came.
"""

from __future__ import annotations

import heapq
import math
from typing import Final

import numpy as np

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Clearance
from mazebot.navigation.costmap.footprint import (
    Distance,
    footprint_clearance_m,
    footprint_in_collision,
    signed_distance_m,
)

HEADINGS: Final = 24
PIECE_S: Final = 0.4
"""Duration of a piece of a motion"""
_CELL_M: Final = 0.08
_TURN_S: Final = 0.8
"""What it takes to change from ahead to back"""
_BEGIN_S: Final = 0.2
"""What it takes to come to speed"""
_MOST: Final = 4000
"""Poses that are looked at"""
_NEARER_M: Final = 0.004
"""So much nearer to what it touches at the start it may come: rounding."""
_FAR_M: Final = 1.0
_REACH_M: Final = 10.0
"""Side of the square around the robot in which it looks"""


@kernel()
def lanes_m(
    ways: Array, radii_m: Array, shape_rows: int, shape_columns: int, resolution_m: float
) -> Distance:
    """(rows, columns) float32 distance of a cell's centre from all that is swept by discs on
    (n, steps, 2) ways, places in cells; no more than 1 m. 0 inside.
    """
    lanes = np.full((shape_rows, shape_columns), np.float32(_FAR_M))
    for k in range(ways.shape[0]):
        reach = (radii_m[k] + _FAR_M) / resolution_m
        for i in range(ways.shape[1]):
            x, y = ways[k, i, 0], ways[k, i, 1]
            if i > 0 and i < ways.shape[1] - 1:
                dx, dy = x - ways[k, i - 1, 0], y - ways[k, i - 1, 1]
                if i % 2 == 1 and dx * dx + dy * dy < 1.0:
                    continue
            for row in range(max(int(y - reach), 0), min(int(y + reach) + 2, shape_rows)):
                for column in range(max(int(x - reach), 0), min(int(x + reach) + 2, shape_columns)):
                    dx, dy = column + 0.5 - x, row + 0.5 - y
                    away_m = math.sqrt(dx * dx + dy * dy) * resolution_m - radii_m[k]
                    if away_m < lanes[row, column]:
                        lanes[row, column] = max(away_m, 0.0)
    return lanes


@kernel()
def to_refuge_m(
    distance_m: Clearance,
    lanes: Distance,
    resolution_m: float,
    radius_m: float,
    wanted_m: float,
    start_column: int,
    start_row: int,
) -> Distance:
    """(rows, columns) float32 length of the shortest way of a disc to where it is so far from all
    lanes, inf where there is none; known within reach of the start alone.
    """
    rows, columns = distance_m.shape
    reach = int(0.5 * _REACH_M / resolution_m)
    low_row, high_row = max(start_row - reach, 0), min(start_row + reach + 1, rows)
    low_column, high_column = max(start_column - reach, 0), min(start_column + reach + 1, columns)
    lengths = np.full((rows, columns), np.float32(np.inf))
    heap = [(np.float32(0.0), 0, 0)]
    heap.pop()
    for row in range(low_row, high_row):
        for column in range(low_column, high_column):
            free = distance_m[row, column] > radius_m
            if free and lanes[row, column] >= radius_m + wanted_m:
                lengths[row, column] = np.float32(0.0)
                # Inner ones lead nowhere nearer.
                for dr in range(-1, 2):
                    for dc in range(-1, 2):
                        r, c = (
                            min(max(row + dr, 0), rows - 1),
                            min(max(column + dc, 0), columns - 1),
                        )
                        if lanes[r, c] < radius_m + wanted_m:
                            heap.append((np.float32(0.0), row, column))
    while len(heap) > 0:
        length, row, column = heapq.heappop(heap)
        if length > lengths[row, column]:
            continue
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                r, c = row + dr, column + dc
                if not (low_row <= r < high_row and low_column <= c < high_column):
                    continue
                if distance_m[r, c] <= radius_m:
                    continue
                step_m = resolution_m * (math.sqrt(2.0) if dr != 0 and dc != 0 else 1.0)
                to_m = np.float32(length + step_m)
                if to_m < lengths[r, c]:
                    lengths[r, c] = to_m
                    heapq.heappush(heap, (to_m, r, c))
    return lengths


@kernel()
def _to_go_m(
    lengths: Distance, resolution_m: float, circles: Array, x: float, y: float, yaw_rad: float
) -> float:
    """From the middle of the outline."""
    c, s = portable_kernels.cos_sin(yaw_rad)
    column = int(x + (c * circles[0] - s * circles[1]) / resolution_m)
    row = int(y + (s * circles[0] + c * circles[1]) / resolution_m)
    if not (0 <= row < lengths.shape[0] and 0 <= column < lengths.shape[1]):
        return np.inf
    return float(lengths[row, column])


@kernel()
def clearance_at_m(
    distance_m: Distance, resolution_m: float, outline_m: Array, circles: Array, pose: Array
) -> float:
    """Distance of the outline from what a field is of, at a pose (x, y in cells, yaw)."""
    c, s = portable_kernels.cos_sin(pose[2])
    return footprint_clearance_m(
        distance_m, resolution_m, outline_m, circles, pose[0], pose[1], c, s
    )


@kernel()
def nearest_walker_m(
    ways: Array,
    radii_m: Array,
    resolution_m: float,
    outline_m: Array,
    pose: Array,
    time_s: float,
    step_s: float,
) -> float:
    """Distance of the outline at a pose (x, y in cells, yaw) from the discs at a time."""
    c, s = portable_kernels.cos_sin(pose[2])
    index = min(int(time_s / step_s + 0.5), ways.shape[1] - 1)
    nearest_m = np.inf
    for k in range(ways.shape[0]):
        dx = (ways[k, index, 0] - pose[0]) * resolution_m
        dy = (ways[k, index, 1] - pose[1]) * resolution_m
        if dx * dx + dy * dy > 4.0:
            continue
        away_m = signed_distance_m(outline_m, c * dx + s * dy, c * dy - s * dx) - radii_m[k]
        nearest_m = min(nearest_m, away_m)
    return nearest_m


@kernel()
def find_refuge(
    distance_m: Clearance,
    lanes: Distance,
    lengths: Distance,
    resolution_m: float,
    outline_m: Array,
    circles: Array,
    start: Array,
    direction: int,
    ways: Array,
    radii_m: Array,
    step_s: float,
    speed_m_s: float,
    wall_margin_m: float,
    walker_margin_m: float,
    wanted_m: float,
) -> tuple[Array, float]:
    """The quickest motion to a pose at least so far from all lanes, or where there is none to the
    one that is farthest.

    Args:
        distance_m: distance from what stands.
        lanes: distance from all places where things that move will be.
        lengths: as `to_refuge_m` gives them, or zeros to look everywhere.
        resolution_m: side of the cells of both.
        outline_m: the robot's.
        circles: `Footprint.circles` of it.
        start: (3,) x and y in cells, yaw.
        direction: 1 where the robot drives ahead now, -1 back, 0 where it stands.
        ways: (n, steps, 2) places of what moves, in cells.
        radii_m: (n,) of these.
        step_s: time between two places of a way.
        speed_m_s: of the robot.
        wall_margin_m: from what stands.
        walker_margin_m: from what moves, on the way.
        wanted_m: from the lanes, in the end.

    Returns (m, 6): x and y in cells, yaw, speed, turning speed of the piece that leads there, and
    time, the first being the start; and the distance from the lanes in the end.
    """
    walls_m = clearance_at_m(distance_m, resolution_m, outline_m, circles, start)
    wall_margin_m = min(wall_margin_m, walls_m - _NEARER_M)
    walker_m = nearest_walker_m(ways, radii_m, resolution_m, outline_m, start, 0.0, step_s)
    walker_margin_m = min(walker_margin_m, walker_m - _NEARER_M)
    side = int(_REACH_M / _CELL_M)
    best_cost = np.full(side * side * HEADINGS, np.inf, np.float32)
    nodes = np.empty((12 * _MOST + 1, 6))
    parent = np.empty(12 * _MOST + 1, np.int64)
    moves = np.empty(12 * _MOST + 1, np.int64)
    nodes[0, :3] = start
    nodes[0, 3:] = 0.0
    nodes[0, 5] = _BEGIN_S
    parent[0], moves[0] = -1, direction
    used, looked = 1, 0
    heap = [(0.0, 0)]
    best, best_m = 0, -np.inf
    unit = 2.0 * math.pi / HEADINGS
    per_piece = speed_m_s * PIECE_S / resolution_m
    while len(heap) > 0 and looked < _MOST:
        _, at = heapq.heappop(heap)
        looked += 1
        pose = nodes[at, :3]
        away_m = clearance_at_m(lanes, resolution_m, outline_m, circles, pose)
        if away_m > best_m + 0.01:
            best, best_m = at, away_m
        if away_m >= wanted_m:
            break
        for move in range(12):
            # Ahead and back on five curves each, and turns on the spot.
            sign, turn = 0, 0
            if move < 10:
                sign, turn = 1 - 2 * (move // 5), move % 5 - 2
            else:
                turn = 4 * (move - 10) - 2
            takes_s = PIECE_S
            if sign != moves[at] and moves[at] != 0 and sign != 0:
                takes_s += _TURN_S
            angle = turn * unit
            child = nodes[used]
            yaw = pose[2]
            half = 0.5 * angle
            c, s = portable_kernels.cos_sin(yaw + half)
            chord = sign * per_piece
            if turn != 0:
                _, sine = portable_kernels.cos_sin(half)
                chord *= sine / half
            child[0], child[1] = pose[0] + chord * c, pose[1] + chord * s
            child[2] = yaw + angle
            child[3], child[4] = sign * speed_m_s, angle / PIECE_S
            child[5] = nodes[at, 5] + takes_s
            column = int((child[0] - start[0]) * resolution_m / _CELL_M + 0.5 * side + 0.5)
            row = int((child[1] - start[1]) * resolution_m / _CELL_M + 0.5 * side + 0.5)
            if not (0 <= column < side and 0 <= row < side):
                continue
            heading = math.floor((child[2] - start[2]) / unit + 0.5) % HEADINGS
            key = (row * side + column) * HEADINGS + heading
            to_cost = child[5] + 0.02 * abs(turn)
            if np.float32(to_cost) >= best_cost[key]:
                continue
            c, s = portable_kernels.cos_sin(child[2])
            if footprint_in_collision(
                distance_m, resolution_m, outline_m, circles, child[0], child[1], c, s,
                wall_margin_m,
            ):  # fmt: skip
                continue
            # On its way as well: a turn back takes a while at the place before.
            if (
                nearest_walker_m(
                    ways, radii_m, resolution_m, outline_m, child[:3], child[5], step_s
                )
                < walker_margin_m
            ):
                continue
            if (
                takes_s > PIECE_S
                and nearest_walker_m(
                    ways, radii_m, resolution_m, outline_m, pose, nodes[at, 5] + _TURN_S, step_s
                )
                < walker_margin_m
            ):
                continue
            best_cost[key] = to_cost
            parent[used], moves[used] = at, sign if sign != 0 else moves[at]
            left_m = _to_go_m(lengths, resolution_m, circles, child[0], child[1], child[2])
            heapq.heappush(heap, (to_cost + min(left_m, _REACH_M) / speed_m_s, used))
            used += 1
    count, at = 0, best
    while at >= 0:
        count, at = count + 1, parent[at]
    found = np.empty((count, 6))
    at = best
    for i in range(count - 1, -1, -1):
        found[i] = nodes[at]
        at = parent[at]
    return found, best_m
