"""Closes loops one after another, and takes an accepted one back when three others contradict it.

A gate is only as good as the poses before: a false loop that comes first, while they are still
uncertain, lets itself in and keeps the right ones out. The rejected are therefore remembered, and
stand together against single accepted ones, and against poses that seem surer than they are.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.mapping.graph.optimizer import (
    CHI2_99,
    Candidate,
    LoopVerdict,
    close_loop,
    optimize,
)
from mazebot.mapping.graph.pose_graph import LOOP, Graph

_REMEMBERED = 12
_VOTES = 3
"""So many rejected loops, of different nodes, outweigh one accepted one."""
_MEAN_INNOVATION = 3.0
"""Of a chi2 of three degrees of freedom."""
_TOGETHER = 5.0
"""Factor of the limit for so many that agree."""
_ALIKE_M, _ALIKE_RAD = 0.7, 0.2
"""Rejected loops that differ by more have nothing to do with each other."""
_SUSPECTS = 4
"""Accepted loops that are looked at, those near the rejected one first."""


class LoopCloser:
    """The loops of a graph."""

    def __init__(
        self, graph: Graph, limit: float = CHI2_99, closed: int = 0, rejected: int = 0
    ) -> None:
        """`limit`: as of `close_loop`. `closed`, `rejected`: counts to go on from."""
        self._graph = graph
        self._limit = limit
        self._rejected: deque[Candidate] = deque(maxlen=_REMEMBERED)
        self._innovations: list[float] = [_MEAN_INNOVATION]
        """Of accepted loops, and one as it should be."""
        self.closed = closed
        """Loops tried and still in the graph."""
        self.rejected = rejected
        """Loops tried and found wrong, those taken back included."""

    def close(
        self,
        candidates: Candidate | Sequence[Candidate],
        explains: Callable[[Candidate], bool] = lambda _: False,
    ) -> LoopVerdict:
        """As `close_loop`. If rejected, but with earlier rejected ones more credible than one that
        was accepted, or than the graph, it is accepted with them, and the indices of edges change.

        `explains`: whether the map contradicts itself as it is, and would not with this loop.
        """
        tried = [candidates] if isinstance(candidates, Candidate) else list(candidates)
        limit = self._limit * self._excess
        verdict = close_loop(self._graph, tried, limit)
        if verdict.accepted:
            self.closed += 1
            self._innovations.append(verdict.innovation)
            return verdict
        self.rejected += 1
        if len(tried) != 1 or tried[0].kind != LOOP:
            return verdict
        self._rejected.append(tried[0])
        alike = {one.target: one for one in self._rejected if self._alike(one, tried[0])}
        if len(alike) < _VOTES:
            return verdict
        agreed = list(alike.values())
        together = self._exchanged(limit) or self._agreed(agreed, _TOGETHER * self._limit)
        if together is None and all(explains(one) for one in agreed[-_VOTES:]):
            together = self._agreed(agreed, math.inf)
        if together is not None:
            self._innovations.append(together.innovation)
        return together or verdict

    @property
    def _excess(self) -> float:
        """How much farther loops were from where the graph expected them than they should be, of
        the squares: so much surer of itself than it should be is the graph.
        """
        mean = math.fsum(self._innovations) / len(self._innovations)
        return min(max(mean / _MEAN_INNOVATION, 1.0), _TOGETHER)

    def _alike(self, one: Candidate, other: Candidate) -> bool:
        """Whether two rejected loops would move the place of the second about alike."""
        places = []
        for each in (one, other):
            moved = self._graph.pose(each.source) @ each.source_from_target
            map_from_wrong = moved @ self._graph.pose(each.target).inverse()
            places.append(map_from_wrong @ self._graph.pose(other.target))
        return places[0].is_near(places[1], _ALIKE_M, _ALIKE_RAD)

    def _exchanged(self, limit: float) -> LoopVerdict | None:
        """Replace an accepted loop by the newest rejected one and those that agree with it."""
        graph = self._graph
        newest = self._rejected[-1]
        for suspect in self._suspects(newest):
            saved = graph.snapshot()
            edges = graph.edges
            old = Candidate(
                int(edges.source[suspect]),
                int(edges.target[suspect]),
                SE2(*edges.relative[suspect].tolist()),
                edges.covariance[suspect].copy(),
                LOOP,
                int(edges.robust[suspect]),
            )
            graph.remove_edge(suspect)
            optimize(graph)
            verdict = close_loop(graph, newest, limit)
            agreeing = [newest]
            if verdict.accepted:
                for other in list(self._rejected)[-2::-1]:
                    if close_loop(graph, other, limit).accepted:
                        agreeing.append(other)
            votes = len({one.target for one in agreeing})
            if votes >= _VOTES:
                # It may have been no hindrance by itself.
                kept = close_loop(graph, old, limit).accepted
                used = {id(one) for one in agreeing}
                left = [one for one in self._rejected if id(one) not in used]
                self._rejected = deque(left, _REMEMBERED)
                self.closed += len(agreeing) - (0 if kept else 1)
                self.rejected += (0 if kept else 1) - len(agreeing)
                return verdict
            graph.restore(saved)
        return None

    def _agreed(self, alike: list[Candidate], gate: float) -> LoopVerdict | None:
        """Close rejected loops together that agree with each other: what they contradict may be
        surer of itself than it should be, as where the same error adds up all along a way.
        """
        verdict = close_loop(self._graph, alike, _TOGETHER * self._limit, gate)
        if not verdict.accepted:
            return None
        used = {id(one) for one in alike}
        self._rejected = deque((one for one in self._rejected if id(one) not in used), _REMEMBERED)
        self.closed += len(alike)
        self.rejected -= len(alike)
        return verdict

    def _suspects(self, newest: Candidate) -> list[int]:
        """Accepted loops whose ends are the nearest, in the order of nodes, to the rejected one's:
        they hold what it contradicts.
        """
        edges = self._graph.edges
        loops = np.flatnonzero(edges.kind == LOOP)
        apart = np.abs(edges.source[loops] - newest.source)
        apart += np.abs(edges.target[loops] - newest.target)
        nearest = loops[np.argsort(apart, kind="stable")][:_SUSPECTS]
        return [int(edge) for edge in nearest]
