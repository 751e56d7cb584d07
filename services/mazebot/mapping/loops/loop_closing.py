"""Loops by lidar: a keyframe matched to keyframes near by estimate, but not by the graph's ways."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.mapping.graph.optimizer import Candidate, relative_covariance
from mazebot.mapping.graph.pose_graph import Graph, Ints, information_of
from mazebot.mapping.loops.loop_search import loop_search, search_map
from mazebot.mapping.matching.local_map import local_map
from mazebot.mapping.matching.occupancy import coarse_grid, share_contradicted
from mazebot.mapping.matching.refine import Refined, refine
from mazebot.mapping.matching.scan_points import ScanPoints, joined_cloud, moved, thinned
from mazebot.mapping.params import SlamParams

_SIGMAS = 6.0
"""A loop is looked for within so many standard deviations of where it is expected."""
_CLOSE_M, _CLOSE_RAD = 0.15, 0.1
"""Within this the refinement finds it without a search."""
_APART = 0.1
"""The second best pose, elsewhere, must have a score so much lower."""
_CORRIDOR_FIT = 0.85
"""Along a corridor, where a search finds many poses, the estimate may still be corrected across."""
_NEWEST = 6
"""Keyframes at most of the newer part of a loop."""
_CONTRADICTS, _RESOLVED = 0.5, 0.5
"""Share of the returns that contradict the older part, and what is left of it with the loop: where
right loops were rejected, in thinned logs of a SICK, 0.5 to 1.6 did, and with them 0.02 to 0.4.
"""
LOOSE = np.diag([4.0, 4.0, 10.0])
"""Information of the start of a refinement: the place is to be measured, not assumed."""
_STD_M, _STD_RAD = 5e-3, 3e-3
"""Of both parts in themselves."""


def find_loop(
    graph: Graph,
    clouds: Sequence[Array],
    seen: Sequence[ScanPoints],
    node: int,
    params: SlamParams,
    scatter: float,
) -> Candidate | None:
    """A loop from a node to an older part of the map, if the scans there fit.

    `clouds`: of each node, as `local_map` takes them; `seen`: the scan that made it one.
    `scatter`: factor of the variances by the parameters, as the scans show it.
    """
    p = params
    _, candidates = graph.trusted_and_candidates(node, p.loop_search_maximum_distance)
    if not len(candidates):
        return None
    near = int(candidates[0])
    trusted, candidates, old, new_radius_m = _parts(graph, seen, near, node, p)
    chain = p.loop_match_minimum_chain_size
    new = trusted[_within(graph, trusted, node, new_radius_m / 2.0)][:_NEWEST]
    if min(len(candidates), len(old)) < chain or len(new) < min(chain, _NEWEST):
        return None
    covariance = relative_covariance(graph, near, node)
    window_m = _SIGMAS * float(np.sqrt(max(covariance[0, 0], covariance[1, 1])))
    window_rad = _SIGMAS * float(np.sqrt(covariance[2, 2]))
    here = graph.pose(node)
    cloud = joined_cloud(
        [graph.pose(one) for one in new.tolist()], [clouds[one] for one in new.tolist()], here
    )
    old = np.sort(old)
    old_clouds = [clouds[one] for one in old.tolist()]
    old_poses = [graph.pose(one) for one in old.tolist()]
    start, ambiguous = here, False
    if window_m > _CLOSE_M or window_rad > _CLOSE_RAD:
        walls = np.concatenate(
            [moved(one[:, :2], pose) for one, pose in zip(old_clouds, old_poses, strict=True)]
        )
        if not len(walls):
            return None
        found = loop_search(
            search_map(walls, p.loop_search_space_resolution),
            thinned(cloud[:, :2], 0.1, 200), here,
            min(max(window_m, _CLOSE_M), p.loop_search_space_dimension / 2.0),
            min(max(window_rad, _CLOSE_RAD), p.coarse_search_angle_offset * 1.5),
            p.loop_match_minimum_response_coarse,
        )  # fmt: skip
        ambiguous = found is None or found.score - found.elsewhere < _APART
        if found is not None and not ambiguous:
            start = found.pose
    known = local_map(old_poses, old_clouds, p.line_cell_m)
    std_m = p.scan_match_std_m * math.sqrt(scatter)

    def fitted_from(start: SE2) -> Refined:
        return refine(
            known, start, LOOSE, cloud[:, :2], seen[node].sensor, std_m, views=cloud[:, 2:4]
        )

    fitted = fitted_from(start)
    if fitted.open_direction and start != here:
        # Along a wall the search has found any place.
        fitted = fitted_from(here)
    if fitted.fit < p.loop_match_minimum_response_fine:
        return None
    if ambiguous and not (fitted.open_direction and fitted.fit >= _CORRIDOR_FIT):
        return None
    near_pose = graph.pose(near)
    c, s = portable.cos_sin(near_pose.yaw_rad)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    of_map = information_of(fitted.information + LOOSE)
    measured = portable.product(turn, of_map, turn.T)
    measured += scatter * np.diag([_STD_M * _STD_M, _STD_M * _STD_M, _STD_RAD * _STD_RAD])
    return Candidate(near, node, near_pose.inverse() @ fitted.map_from_base, measured)


def explains(graph: Graph, seen: Sequence[ScanPoints], loop: Candidate, params: SlamParams) -> bool:
    """Whether the map contradicts itself at a loop's newer end, and would not with the loop: what
    is seen there stands where the older part saw open floor, or behind its walls.

    So a loop that is right is told from a place that only looks the same: at its own place, which
    the older part does not see or sees the same, nothing contradicts.
    """
    p = params
    _, _, old, _ = _parts(graph, seen, loop.source, loop.target, p)
    older = ((graph.pose(one), seen[one]) for one in np.sort(old).tolist())
    grid = coarse_grid(older, p.resolution)
    without, with_it = (
        share_contradicted(grid, pose, seen[loop.target])
        for pose in (graph.pose(loop.target), graph.pose(loop.source) @ loop.source_from_target)
    )
    return without >= _CONTRADICTS and with_it <= _RESOLVED * without


def _parts(
    graph: Graph, seen: Sequence[ScanPoints], near: int, node: int, params: SlamParams
) -> tuple[Ints, Ints, Ints, float]:
    """Of a loop between an older node and a newer one: the nodes that the newer one trusts, its
    candidates, the older part, the nearest first, and how far the newer one sees.
    """
    p = params
    old_radius_m, new_radius_m = (
        graph.radius_m(one, p.link_scan_maximum_distance, seen[one].reach_m, p.scan_buffer_size)
        for one in (near, node)
    )
    around_m = max(p.loop_search_maximum_distance, old_radius_m, new_radius_m)
    trusted, candidates = graph.trusted_and_candidates(node, around_m)
    old, _ = graph.trusted_and_candidates(near, old_radius_m)
    most = max(p.scan_buffer_size, p.loop_match_minimum_chain_size)
    return trusted, candidates, old[~np.isin(old, trusted)][:most], new_radius_m


def _within(graph: Graph, nodes: Ints, node: int, radius_m: float) -> Ints:
    """Indices into nodes of those within a radius of a node."""
    x, y = (graph.poses[nodes, :2] - graph.poses[node, :2]).T
    return np.flatnonzero(portable.hypot_each(x, y) <= radius_m)
