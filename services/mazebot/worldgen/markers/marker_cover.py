"""The fewest markers such that at least one can be read from most of the reachable floor."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse, spatial

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import Marker, World
from mazebot.common.world import marker_picture
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.marker_entities import MAX_MARKERS, PanelStyle, marker_entities
from mazebot.common.world.placement import Panel, Placement, hang, panel_of
from mazebot.worldgen.markers.visibility import FARTHEST_M, WIDEST_RAD, Bits, Sight
from mazebot.worldgen.recipe_model import MarkerCoverRecipe

SPACING_M = 0.25
"""Between candidate positions on a wall's face, unless there would be too many."""
MAX_PLACES = 1500

_SAMPLE_M = 0.2
"""Between the floor samples, unless there would be too many."""
_MAX_SAMPLES = 20_000
_MAX_ENTRIES = 60_000
_MAX_VARIABLES = 1200
"""Limits of the integer program: beyond either, positions are chosen greedily. Its time grows with
the cube of the variables and more: two seconds with this many, minutes with three times as many.
"""
_MAX_NODES = 60
"""Limit of the search: a count, not a time, so that the same world gets the same markers."""
_ROUNDS = 2
"""Attempts with a slightly higher share, if the sample overestimated the cover."""
_TRIED = 40
"""Positions tested on the whole floor for each marker that completes a cover."""


@dataclass(frozen=True)
class Cover:
    """Markers that cover a share of the floor."""

    markers: tuple[Marker, ...]
    share: float
    """Share of the reachable floor from which a marker can be read, including the world's existing
    markers."""
    proven_fewest: bool
    """No choice of the candidate positions needs fewer, by the floor's sample."""


def cover(
    world: World,
    map_cells: NDArray[np.int8],
    origin: SE2,
    recipe: MarkerCoverRecipe,
    meshes: Mapping[str, TriangleMesh] | None = None,
) -> tuple[Marker, ...]:
    """The markers of `best_cover`."""
    return best_cover(world, map_cells, origin, recipe, meshes).markers


def best_cover(
    world: World,
    map_cells: NDArray[np.int8],
    origin: SE2,
    recipe: MarkerCoverRecipe,
    meshes: Mapping[str, TriangleMesh] | None = None,
) -> Cover:
    """Markers to add to a world: same input, same markers.

    The fewest by integer programming, on sampled positions and floor; chosen greedily if the
    problem is too large, or the search does not end.

    Raises ValueError with a short phrase about `share` if it cannot be reached.
    """
    sight = Sight(world, map_cells, origin, meshes)
    hanging = [panel_of(one) for one in marker_entities(world, meshes=meshes)[0].markers]
    covered = np.zeros(map_cells.shape, np.bool_)
    for panel in hanging:
        rows, columns, seen = sight.window(panel)
        covered[rows, columns] |= seen
    floor = max(int(sight.reachable.sum()), 1)
    if covered.sum() >= recipe.share * floor:
        return Cover((), float(covered.sum() / floor), True)
    most = min(recipe.max_markers, MAX_MARKERS - len(hanging))
    seen_by_one = WIDEST_RAD * portable.square(FARTHEST_M) / portable.square(world.map_resolution_m)
    if covered.sum() + most * seen_by_one < recipe.share * floor:
        # Reported before the search: a large maze would take minutes.
        raise _too_few(covered.sum() / floor + most * seen_by_one / floor, hanging, most, recipe)
    identities = _identities(world, recipe, most)
    places = _places(world, identities[0], hanging, meshes)
    every = max(
        1,
        round(_SAMPLE_M / world.map_resolution_m),
        math.ceil(math.sqrt(floor / _MAX_SAMPLES)),
    )
    sees = _seen_samples(sight, [panel for _, panel in places], covered, every)
    samples = max(int(sight.reachable[::every, ::every].sum()), 1)
    overlapping = _overlapping([panel for _, panel in places])
    best: list[int] = []
    asked, least, share = recipe.share, 0, 0.0
    for _ in range(_ROUNDS):
        wanted = math.ceil(asked * samples - 1e-9) - (samples - sees.shape[1])
        chosen, proven = _chosen(sees, overlapping, wanted, most)
        if proven and not least:
            least = len(chosen)
        at_once = _covered_cells(sight, covered, [places[number][1] for number in chosen])
        asked += max(recipe.share - at_once.sum() / floor, 0.0) + 0.002
        chosen, seen = _completed(
            sight, places, sees, overlapping, chosen, at_once, recipe.share * floor, most
        )
        share = max(share, float(seen.sum() / floor))
        if seen.sum() >= recipe.share * floor and not 0 < len(best) <= len(chosen):
            best = chosen
        if len(best) == least or _covered(sees, chosen) < wanted:
            break
    if not best:
        raise _too_few(share, hanging, most, recipe)
    markers = [places[number][0] for number in sorted(best)]
    seen = _covered_cells(sight, covered, [places[number][1] for number in best])
    return Cover(
        tuple(
            marker.model_copy(update={"id": identity.id})
            for marker, identity in zip(markers, identities, strict=False)
        ),
        float(seen.sum() / floor),
        len(best) == least,
    )


def _too_few(
    share: float, hanging: Sequence[Panel], most: int, recipe: MarkerCoverRecipe
) -> ValueError:
    return ValueError(
        f"must be at most {math.floor(share * 100.0) / 100.0:.2f}: {len(hanging) + most} "
        f"markers reach no more (max_markers: {recipe.max_markers})"
    )


def _covered_cells(sight: Sight, covered: Bits, panels: Sequence[Panel]) -> Bits:
    """The cells that are covered with additional panels."""
    found = covered.copy()
    for panel in panels:
        rows, columns, seen = sight.window(panel)
        found[rows, columns] |= seen
    return found


def _completed(
    sight: Sight,
    places: Sequence[tuple[Marker, Panel]],
    sees: sparse.csr_array,
    overlapping: NDArray[np.int64],
    chosen: Sequence[int],
    covered: Bits,
    wanted: float,
    most: int,
) -> tuple[list[int], Bits]:
    """The chosen positions, and more one by one if they cover less than the sample predicted."""
    chosen, covered = list(chosen), covered.copy()
    while covered.sum() < wanted and len(chosen) < most:
        left = np.ones(sees.shape[1])
        left[sees[chosen].indices] = 0.0
        gain = sees @ left
        gain[overlapping[np.isin(overlapping, chosen).any(1)].ravel()] = -1.0
        gain[chosen] = -1.0
        best, best_gain = -1, 0
        for number in np.argsort(-gain, kind="stable")[:_TRIED].tolist():
            if gain[number] > 0.0:
                rows, columns, seen = sight.window(places[number][1])
                more = int((seen & ~covered[rows, columns]).sum())
                if more > best_gain:
                    best, best_gain = number, more
        if best < 0:
            break
        chosen.append(best)
        covered = _covered_cells(sight, covered, [places[best][1]])
    return chosen, covered


def _identities(world: World, recipe: MarkerCoverRecipe, most: int) -> list[Marker]:
    """As many markers as are wanted at most, and as there are unused ids."""
    taken = {marker.id for marker in world.markers}
    own = marker_picture.own_dictionaries(world.dictionaries)
    found: list[Marker] = []
    for number in range(recipe.first_id, recipe.first_id + most + len(taken)):
        if number not in taken and len(found) < most:
            marker = Marker(
                id=number, dictionary=recipe.dictionary, size_m=recipe.size_m, wall="",
                side="left", height_m=recipe.height_m,
            )  # fmt: skip
            problem = marker_picture.identity_problem(marker, own.get(marker.dictionary))
            if problem and not found:
                raise ValueError(problem)
            if problem:
                break
            found.append(marker)
    return found


def _places(
    world: World,
    like: Marker,
    hanging: Sequence[Panel],
    meshes: Mapping[str, TriangleMesh] | None,
) -> list[tuple[Marker, Panel]]:
    """Possible marker positions, wall by wall."""
    style = PanelStyle()
    placement = Placement(world, meshes)
    own = marker_picture.own_dictionaries(world.dictionaries)
    side_m = marker_picture.panel_side_m(like, own.get(like.dictionary))
    room_m = [wall.length_m - side_m for wall in world.walls]
    total_m = 2.0 * sum(room for room in room_m if room > 0.0)
    spacing_m = max(SPACING_M, total_m / MAX_PLACES)
    places = []
    for wall, room in zip(world.walls, room_m, strict=True):
        if room < 0.0:
            continue
        count = math.floor(room / spacing_m) + 1
        offsets = (np.arange(count) - (count - 1) / 2.0) * spacing_m
        for side, offset_m in itertools.product(("left", "right"), offsets.tolist()):
            marker = like.model_copy(
                update={"wall": wall.name, "side": side, "offset_m": round(offset_m, 6)}
            )
            panel = hang("", marker, wall, side_m, style.gap_m)
            if not placement.problem(panel, hanging, wall.name):
                places.append((marker, panel))
    return places


def _seen_samples(
    sight: Sight, panels: Sequence[Panel], covered: Bits, every: int
) -> sparse.csr_array:
    """(panels, samples): 1.0 if a panel can be read from a sample that is not covered yet."""
    open_floor = (sight.reachable & ~covered)[::every, ::every]
    number = (np.cumsum(open_floor) - 1).reshape(open_floor.shape)
    rows_of: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    columns_of: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    for place, panel in enumerate(panels):
        rows, columns, seen = sight.window(panel, every)
        part = (
            slice(rows.start // every, rows.start // every + seen.shape[0]),
            slice(columns.start // every, columns.start // every + seen.shape[1]),
        )
        samples = number[part][seen & open_floor[part]]
        rows_of.append(np.full(len(samples), place))
        columns_of.append(samples)
    row, column = np.concatenate(rows_of), np.concatenate(columns_of)
    return sparse.csr_array(
        (np.ones(len(row)), (row, column)), shape=(len(panels), int(open_floor.sum()))
    )


def _overlapping(panels: Sequence[Panel]) -> NDArray[np.int64]:
    """(n, 2): pairs of panels that would overlap."""
    if len(panels) < 2:
        return np.zeros((0, 2), np.int64)
    tree = spatial.KDTree(np.array([panel.centre_m for panel in panels]))
    pairs = tree.query_pairs(panels[0].side_m, output_type="ndarray")
    normals = np.array([panel.normal for panel in panels])
    same_way = (normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(1) > 0.5
    return np.asarray(pairs[same_way][np.lexsort(pairs[same_way].T[::-1])], np.int64)


def _covered(sees: sparse.csr_array, chosen: list[int]) -> int:
    """Number of samples from which at least one of the chosen is visible."""
    return len(np.unique(sees[chosen].indices)) if len(chosen) else 0


def _chosen(
    sees: sparse.csr_array, overlapping: NDArray[np.int64], wanted: int, most: int
) -> tuple[list[int], bool]:
    """Positions that cover as many samples as wanted, and whether fewer cannot; if `most` do not
    suffice, those that cover the most, chosen one by one.
    """
    chosen, proven = _greedy(sees, overlapping, wanted), False
    if _covered(sees, chosen) < wanted:
        return chosen[:most], False
    if len(chosen) > 1 and sees.nnz <= _MAX_ENTRIES:
        fewest, proven = _fewest(sees, overlapping, wanted, len(chosen))
        if fewest and len(fewest) <= most:
            return fewest, proven
    return chosen[:most], proven or len(chosen) <= 1


def _greedy(sees: sparse.csr_array, overlapping: NDArray[np.int64], wanted: int) -> list[int]:
    """Positions, each the one that covers the most remaining samples, until as many as wanted are
    covered, or no more can be.
    """
    by_sample = sees.tocsc()
    gain = np.diff(sees.indptr).astype(np.int64)
    allowed = np.ones(len(gain), np.bool_)
    left = np.ones(sees.shape[1], np.bool_)
    chosen: list[int] = []
    while wanted > 0 and allowed.any():
        place = int(np.where(allowed, gain, -1).argmax())
        if gain[place] <= 0:
            break
        chosen.append(place)
        wanted -= int(gain[place])
        samples = sees.indices[sees.indptr[place] : sees.indptr[place + 1]]
        samples = samples[left[samples]]
        left[samples] = False
        gain -= np.asarray(by_sample[:, samples].sum(1)).astype(np.int64).ravel()
        allowed[place] = False
        allowed[overlapping[(overlapping == place).any(1)].ravel()] = False
    return chosen


def _fewest(
    sees: sparse.csr_array, overlapping: NDArray[np.int64], wanted: int, enough: int
) -> tuple[list[int], bool]:
    """The fewest positions that cover as many samples as wanted, and whether it is proven; none if
    there is too much to search, or the search ends before it finds any. `enough` of them are known
    to suffice.

    Samples visible from the same positions count as one, with a weight; positions that see nothing
    that another one does not see too are left out.
    """
    places = _worth_trying(sees)
    if len(places) + _kinds(sees[places]) > _MAX_VARIABLES:
        return [], False
    matrix = sees[places].toarray().astype(np.bool_)
    columns, weight = np.unique(np.packbits(matrix, axis=0), axis=1, return_counts=True)
    kinds = np.unpackbits(columns, axis=0, count=len(places)).astype(np.float64)
    some = kinds.any(0)
    kinds, weight = kinds[:, some], weight[some]
    count, groups = kinds.shape
    number = np.full(sees.shape[0], -1)
    number[places] = np.arange(count)
    pairs = number[overlapping]
    pairs = pairs[(pairs >= 0).all(1)]
    apart = sparse.csr_array(
        (np.ones(pairs.size), (np.repeat(np.arange(len(pairs)), 2), pairs.ravel())),
        shape=(len(pairs), count),
    )
    nothing = sparse.csr_array((1, count))
    constraints = [
        # A kind of sample counts if a position that sees it is chosen.
        optimize.LinearConstraint(
            sparse.hstack([sparse.csr_array(kinds.T), -sparse.eye_array(groups)]), 0.0, np.inf
        ),
        optimize.LinearConstraint(
            sparse.hstack([nothing, sparse.csr_array(weight[None].astype(float))]), wanted, np.inf
        ),
        optimize.LinearConstraint(
            np.concatenate([np.ones(count), np.zeros(groups)])[None], 1.0, enough
        ),
    ]
    if len(pairs):
        zeros = sparse.csr_array((len(pairs), groups))
        constraints.append(optimize.LinearConstraint(sparse.hstack([apart, zeros]), 0.0, 1.0))
    result = optimize.milp(
        np.concatenate([np.ones(count), np.zeros(groups)]),
        integrality=np.concatenate([np.ones(count), np.zeros(groups)]),
        bounds=optimize.Bounds(0.0, 1.0),
        constraints=constraints,
        options={"node_limit": _MAX_NODES},
    )
    if result.x is None:
        return [], False
    return places[result.x[:count] > 0.5].tolist(), result.status == 0


def _kinds(sees: sparse.csr_array) -> int:
    """Number of kinds of samples, which are visible from the same positions, without those visible
    from none: by a sum of one random number per position, which two kinds practically never share.
    """
    of_place = np.random.default_rng(0).integers(1, 2**62, size=sees.shape[0])
    seen = sparse.csr_array((sees.data.astype(np.int64), sees.indices, sees.indptr), sees.shape)
    return len(np.setdiff1d(seen.T @ of_place, [0]))


def _worth_trying(sees: sparse.csr_array) -> NDArray[np.int64]:
    """The positions whose samples are not a proper subset of another's; of positions with the same
    samples the first.
    """
    size = np.diff(sees.indptr)
    common = (sees @ sees.T).tocoo()
    i, j = common.coords
    within = (common.data >= size[i]) & (i != j) & ((size[j] > size[i]) | (j < i))
    worth = size > 0
    worth[i[within]] = False
    return np.flatnonzero(worth)
