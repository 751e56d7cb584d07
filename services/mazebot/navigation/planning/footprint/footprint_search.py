"""A search over places and headings for narrow passages, where a path for a point is not enough."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Clearance
from mazebot.navigation.costmap.layered_costmap import Costs
from mazebot.navigation.planning.footprint.footprint_check import (
    can_turn,
    difference_rad,
    hits,
    turn_hits,
)
from mazebot.navigation.planning.grid.a_star import FOUND, GAVE_UP, NO_WAY, CostToCome
from mazebot.navigation.planning.grid.search_grid import SOLID, Prices

HEADINGS: Final = 16
AHEAD: Final = np.array(
    [(1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (-1, 2), (-1, 1), (-2, 1),
     (-1, 0), (-2, -1), (-1, -1), (-1, -2), (0, -1), (1, -2), (1, -1), (2, -1)],
    np.int64,
)  # fmt: skip
"""(HEADINGS, 2) steps in x and y, in half cells: each ends in the middle of a cell or of a side."""
TURN_CELLS: Final = 1.5
"""A turn to the next heading costs as much as this many cells."""
REVERSE_FACTOR: Final = 2.0
"""A step backwards costs this many times one ahead (Nav2's reverse_penalty of Smac Hybrid)."""
_MOST_BEFORE_GOAL: Final = 3000
"""With more poses than these that lead to the goal, it counts as no closed pocket."""

Keys = NDArray[np.int64]


@kernel()
def _slot(keys: Keys, key: int) -> int:
    """Where a key is in a table, or where it would be put (linear probing)."""
    mask = keys.size - 1
    at = ((key * 0x9E3779B1) >> 7) & mask
    while keys[at] != key and keys[at] >= 0:
        at = (at + 1) & mask
    return at


@kernel()
def _step_hits(
    distance_m: Clearance,
    resolution_m: float,
    outline_m: Array,
    circles: Array,
    from_x: int,
    from_y: int,
    to_x: int,
    to_y: int,
    yaw_rad: float,
) -> bool:
    """Whether the polygon touches an obstacle on a step, its end included; places in half cells."""
    if hits(distance_m, resolution_m, outline_m, circles, 0.5 * to_x, 0.5 * to_y, yaw_rad):
        return True
    return abs(to_x - from_x) + abs(to_y - from_y) > 2 and hits(
        distance_m, resolution_m, outline_m, circles, 0.25 * (from_x + to_x),
        0.25 * (from_y + to_y), yaw_rad,
    )  # fmt: skip


@kernel()
def _closed_off(
    cells: Costs,
    to_goal: CostToCome,
    distance_m: Clearance,
    resolution_m: float,
    outline_m: Array,
    circles: Array,
    headings_rad: Array,
    ahead: NDArray[np.int64],
    first_start: Array,
    goal_x: int,
    goal_y: int,
    reverse_within: float,
    ends: NDArray[np.bool_],
    seeds: Keys,
) -> bool:
    """Whether the poses from which it gets to the goal are few, and no start is among them: the
    search would know that only after it has been everywhere else.

    Args as of `drive_through`; the goal's place in half cells; (HEADINGS,) with which headings
    there a way may end; and the table of the keys of the starts' poses.
    """
    flat = cells.ravel()
    stride, count = cells.shape[1], headings_rad.size
    width = 2 * stride
    table = 1
    while table < 4 * _MOST_BEFORE_GOAL:
        table *= 2
    keys = np.full(table, -1, np.int64)
    queue = np.empty(_MOST_BEFORE_GOAL + 4 + count, np.int64)
    used, done = 0, 0
    for h in range(count):
        if ends[h]:
            queue[used] = (goal_y * width + goal_x) * count + h
            keys[_slot(keys, queue[used])] = queue[used]
            used += 1
    while done < used:
        key = queue[done]
        done += 1
        if used > _MOST_BEFORE_GOAL or seeds[_slot(seeds, key)] == key:
            return False
        h, place = key % count, key // count
        ix, iy = place % width, place // width
        for move in range(4):
            from_x, from_y, from_h = ix, iy, h
            if move < 2:
                sign = 1 - 2 * move
                from_x -= sign * ahead[h, 0]
                from_y -= sign * ahead[h, 1]
                if move == 1 and not (
                    abs(0.5 * ix - first_start[0]) <= reverse_within
                    and abs(0.5 * iy - first_start[1]) <= reverse_within
                ):
                    continue
                cell = (from_y + 1) // 2 * stride + (from_x + 1) // 2
                if flat[cell] >= SOLID or not np.isfinite(to_goal[cell]):
                    continue
                if _step_hits(
                    distance_m, resolution_m, outline_m, circles, ix, iy, from_x, from_y,
                    headings_rad[h],
                ):  # fmt: skip
                    continue
            else:
                from_h = (h + 2 * move - 5 + count) % count
                by = difference_rad(headings_rad[from_h], headings_rad[h])
                if turn_hits(
                    distance_m, resolution_m, outline_m, circles, 0.5 * ix, 0.5 * iy,
                    headings_rad[h], by,
                ):  # fmt: skip
                    continue
            from_key = (from_y * width + from_x) * count + from_h
            slot = _slot(keys, from_key)
            if keys[slot] != from_key:
                keys[slot] = from_key
                queue[used] = from_key
                used += 1
    return True


@kernel()
def drive_through(
    cells: Costs,
    price: Prices,
    to_goal: CostToCome,
    distance_m: Clearance,
    resolution_m: float,
    outline_m: Array,
    circles: Array,
    headings_rad: Array,
    ahead: NDArray[np.int64],
    starts: Array,
    goal: Array,
    reverse_within: float,
    exact: bool,
    max_states: int,
) -> tuple[int, Array, int]:
    """Cheapest way of the polygon by steps ahead, turns on the spot and, where allowed, steps back.

    Args:
        cells: the search grid; the middle of the axle stays out of SOLID cells.
        price: half the cost of a step by the value of its cell.
        to_goal: per cell the least cost to the goal for a point; infinite: not searched.
        distance_m: of the costmap.
        resolution_m: of the costmap.
        outline_m: the footprint's points.
        circles: the footprint's circles.
        headings_rad: (HEADINGS,) of the steps `ahead`.
        ahead: AHEAD.
        starts: (k, 4) x, y, yaw and what it costs to get there, in cells: it begins at one of them.
        goal: (x, y, yaw), in cells.
        reverse_within: it may drive backwards to places this near to the first start, in cells.
        exact: whether it must be able to turn at a start itself, not only at a place of the lattice
            beside it.
        max_states: gives up after expanding this many.

    Returns (status, (n, 4) poses: x, y, the heading, and 1 where it arrived backwards, and which
    start it begins at).
    """
    stride = cells.shape[1]
    flat = cells.ravel()
    width = 2 * stride
    count = headings_rad.size
    table = 4096
    while table < 4 * max_states:
        table *= 2
    keys = np.full(table, -1, np.int64)
    cost_to_come = np.empty(table, np.float32)
    parent = np.empty(table, np.int64)
    closed = np.zeros(table, np.bool_)
    backwards = np.zeros(table, np.bool_)
    per_cell, ring = 4.0, 4096
    head = np.full(ring, -1, np.int64)
    capacity = 4096
    entry_next = np.empty(capacity, np.int64)
    entry_slot = np.empty(capacity, np.int64)
    used, waiting, bucket = 0, 0, -1
    goal_x, goal_y = math.floor(2.0 * goal[0] + 0.5), math.floor(2.0 * goal[1] + 0.5)
    lowest, seeded = np.inf, 0
    for one in range(9 * len(starts)):
        start, aside = starts[one // 9], one % 9
        if aside == 0:
            seeded = waiting
        ix, iy = math.floor(2.0 * start[0] + 0.5), math.floor(2.0 * start[1] + 0.5)
        if aside > 0:
            # The place of the lattice nearest to the start may just touch: one beside it may not.
            ix += (aside % 3) - 1
            iy += (aside // 3) - 1
        x, y = 0.5 * ix, 0.5 * iy
        cell = (iy + 1) // 2 * stride + (ix + 1) // 2
        if not np.isfinite(to_goal[cell]) or waiting > seeded:
            continue
        for h in range(count):
            by = difference_rad(headings_rad[h], start[2])
            if abs(by) > 0.5 or hits(
                distance_m, resolution_m, outline_m, circles, x, y, headings_rad[h]
            ):
                continue
            if turn_hits(distance_m, resolution_m, outline_m, circles, x, y, start[2], by):
                continue
            if exact and turn_hits(
                distance_m, resolution_m, outline_m, circles, start[0], start[1], start[2], by
            ):
                continue
            key = (iy * width + ix) * count + h
            slot = _slot(keys, key)
            cost = start[3] + abs(by) * count / math.tau * TURN_CELLS
            if keys[slot] == key and np.float32(cost) >= cost_to_come[slot]:
                continue
            keys[slot] = key
            cost_to_come[slot] = cost
            parent[slot] = -1 - one // 9
            at = int((cost_to_come[slot] + to_goal[cell]) * per_cell)
            lowest = min(lowest, at)
            entry_slot[used], entry_next[used] = slot, head[at % ring]
            head[at % ring] = used
            used += 1
            waiting += 1
    if waiting == 0:
        return NO_WAY, np.empty((0, 4)), 0
    ends = np.zeros(count, np.bool_)
    for h in range(count):
        x, y = 0.5 * goal_x, 0.5 * goal_y
        ends[h] = not hits(
            distance_m, resolution_m, outline_m, circles, x, y, headings_rad[h]
        ) and can_turn(distance_m, resolution_m, outline_m, circles, x, y, headings_rad[h], goal[2])
    if _closed_off(
        cells, to_goal, distance_m, resolution_m, outline_m, circles, headings_rad, ahead,
        starts[0], goal_x, goal_y, reverse_within, ends, keys,
    ):  # fmt: skip
        return NO_WAY, np.empty((0, 4)), 0
    bucket = int(lowest)
    states = 0
    found = -1
    while waiting > 0 and found < 0:
        entry = head[bucket % ring]
        if entry < 0:
            bucket += 1
            continue
        head[bucket % ring] = entry_next[entry]
        waiting -= 1
        slot = entry_slot[entry]
        if closed[slot]:
            continue
        closed[slot] = True
        states += 1
        if states > max_states:
            return GAVE_UP, np.empty((0, 4)), 0
        key = keys[slot]
        h = key % count
        place = key // count
        ix, iy = place % width, place // width
        x, y = 0.5 * ix, 0.5 * iy
        if ix == goal_x and iy == goal_y and ends[h]:
            found = slot
            break
        here = cost_to_come[slot]
        for move in range(4):
            to_x, to_y, to_h = ix, iy, h
            if move < 2:
                sign = 1 - 2 * move
                to_x += sign * ahead[h, 0]
                to_y += sign * ahead[h, 1]
                if move == 1 and not (
                    abs(0.5 * to_x - starts[0, 0]) <= reverse_within
                    and abs(0.5 * to_y - starts[0, 1]) <= reverse_within
                ):
                    continue
            else:
                to_h = (h + 2 * move - 5 + count) % count
            # A place on a side belongs to the cell above it or to its right.
            cell = (to_y + 1) // 2 * stride + (to_x + 1) // 2
            if flat[cell] >= SOLID or not np.isfinite(to_goal[cell]):
                continue
            to_key = (to_y * width + to_x) * count + to_h
            to = _slot(keys, to_key)
            if keys[to] == to_key and closed[to]:
                continue
            if move < 2:
                dx, dy = 0.5 * ahead[h, 0], 0.5 * ahead[h, 1]
                cost = here + 2.0 * price[flat[cell]] * math.sqrt(dx * dx + dy * dy)
                if move == 1:
                    cost += (REVERSE_FACTOR - 1.0) * (cost - here)
            else:
                by = difference_rad(headings_rad[to_h], headings_rad[h])
                cost = here + TURN_CELLS
            if keys[to] == to_key and np.float32(cost) >= cost_to_come[to]:
                continue
            if move < 2:
                if _step_hits(
                    distance_m, resolution_m, outline_m, circles, ix, iy, to_x, to_y,
                    headings_rad[h],
                ):  # fmt: skip
                    continue
            elif turn_hits(distance_m, resolution_m, outline_m, circles, x, y, headings_rad[h], by):
                continue
            keys[to] = to_key
            cost_to_come[to] = cost
            parent[to] = slot
            backwards[to] = move == 1
            at = int((cost + to_goal[cell]) * per_cell)
            # The heuristic may fall by more than a step costs: no key goes behind the queue.
            at = min(max(at, bucket), bucket + ring - 1)
            if used == capacity:
                entry_next = np.concatenate((entry_next, np.empty(capacity, np.int64)))
                entry_slot = np.concatenate((entry_slot, np.empty(capacity, np.int64)))
                capacity *= 2
            entry_slot[used], entry_next[used] = to, head[at % ring]
            head[at % ring] = used
            used += 1
            waiting += 1
    if found < 0:
        return NO_WAY, np.empty((0, 4)), 0
    length, slot = 1, found
    while parent[slot] >= 0:
        slot = parent[slot]
        length += 1
    poses = np.empty((length, 4))
    slot, begin = found, 0
    for i in range(length - 1, -1, -1):
        place = keys[slot] // count
        poses[i, 0], poses[i, 1] = 0.5 * (place % width), 0.5 * (place // width)
        poses[i, 2] = headings_rad[keys[slot] % count]
        poses[i, 3] = 0.0
        if backwards[slot]:
            poses[i, 3] = 1.0
        begin = -1 - parent[slot]
        slot = parent[slot]
    return FOUND, poses, begin
