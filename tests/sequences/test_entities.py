"""Random sequences of requests for entities, several at once, against a model of the world."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from mazebot.common.messages import documents as doc
from mazebot.common.messages.topics import (
    DELETE_ENTITY,
    SET_ENTITY_STATE,
    SPAWN_ENTITY,
    WORLD,
    Query,
)
from mazebot.embedded.session import Session
from tests.sequences.machine import asked_at_once, explained, run
from tests.spawner.stage import box

NAMES = ("red", "green", "blue")
Z_M = 0.2

Place = tuple[float, float]


@dataclass(frozen=True)
class Stands:
    """One box of the model."""

    asked: Place
    """Where it was when it was asked for."""
    place: Place


World = dict[str, Stands]


@dataclass(frozen=True)
class Asked:
    """One request."""

    verb: str
    name: str
    place: Place = (0.0, 0.0)
    renames: bool = False


Outcome = tuple[bool, str, Place | None]
"""Of a request: whether it was done, the name in the reply, and the place in it."""


def applied(taken: frozenset[Place], world: World, asked: Asked) -> tuple[Outcome, World]:
    """What the model says to a request, and the world after it. `taken` is where nothing fits."""
    refused = (False, asked.name, None)
    if asked.verb == "spawn":
        names: Iterator[str] = iter((asked.name,))
        if asked.renames:
            numbered = (f"{asked.name}_{number}" for number in itertools.count(1))
            names = itertools.chain(names, numbered)
        for name in names:
            if name not in world:
                if _is_occupied(world, taken, asked.place, name):
                    return (False, name, None), world
                return (True, name, asked.place), world | {name: Stands(asked.place, asked.place)}
            if world[name].asked == asked.place:
                return (True, name, world[name].place), world
        return refused, world
    if asked.name not in world:
        return refused, world
    if asked.verb == "delete":
        left = {name: one for name, one in world.items() if name != asked.name}
        return (True, asked.name, None), left
    before = world[asked.name]
    if before.place != asked.place and _is_occupied(world, taken, asked.place, asked.name):
        return refused, world
    moved = world | {asked.name: Stands(before.asked, asked.place)}
    return (True, asked.name, asked.place), moved


def _is_occupied(world: World, taken: frozenset[Place], place: Place, name: str) -> bool:
    others = {one.place for other, one in world.items() if other != name}
    return place in others | taken


class Requests(RuleBasedStateMachine):
    """Each request is answered once, and some order of those that were sent together explains
    their answers and the world after them.
    """

    session: Session
    places: tuple[Place, ...]
    taken: frozenset[Place]

    @initialize()
    def empty(self) -> None:
        """Begin without boxes."""
        for name in self._standing():
            self.session.remove(name)
        self.worlds: list[World] = [{}]

    @rule(data=st.data(), count=st.integers(1, 4))
    def ask(self, data: st.DataObject, count: int) -> None:
        """Send requests before the first is answered."""
        batch = [self._drawn(data) for _ in range(count)]
        replies = asked_at_once(self.session, [self._request(asked) for asked in batch])
        outcomes = [_outcome(asked, reply) for asked, reply in zip(batch, replies, strict=True)]
        found: list[World] = []
        for world in self.worlds:
            found += [
                one
                for one in explained(world, batch, outcomes, partial(applied, self.taken))
                if {name: stands.place for name, stands in one.items()} == self._standing()
            ]
        assert found, (self.worlds, batch, outcomes, self._standing())
        self.worlds = found

    @rule(seconds=st.sampled_from((0.0, 0.1)))
    def reset(self, seconds: float) -> None:
        """Everything that was spawned returns to where it was last put."""
        if seconds:
            self.session.run_for(seconds)
        self.session.reset()

    @invariant()
    def stands_as_in_the_model(self) -> None:
        """Also after what was refused."""
        standing = self._standing()
        for world in getattr(self, "worlds", []):
            assert {name: stands.place for name, stands in world.items()} == standing

    def _drawn(self, data: st.DataObject) -> Asked:
        verb = data.draw(st.sampled_from(("spawn", "spawn", "move", "delete")))
        return Asked(
            verb,
            data.draw(st.sampled_from(NAMES)),
            data.draw(st.sampled_from((*self.places, *self.taken))),
            verb == "spawn" and data.draw(st.booleans()),
        )

    def _request(self, asked: Asked) -> tuple[Query[Any, doc.EntityReply], doc.Document]:
        position_m = (*asked.place, Z_M)
        if asked.verb == "spawn":
            entity = box(asked.name, position_m=position_m)
            return SPAWN_ENTITY, doc.SpawnEntity(entity=entity, allow_renaming=asked.renames)
        if asked.verb == "delete":
            return DELETE_ENTITY, doc.DeleteEntity(name=asked.name)
        return SET_ENTITY_STATE, doc.SetEntityState(name=asked.name, position_m=position_m)

    def _standing(self) -> dict[str, Place]:
        """Where the boxes are, as the spawner says."""
        return {
            one.name: (one.position_m[0], one.position_m[1])
            for one in self.session.entities().entities
        }


def _outcome(asked: Asked, reply: doc.EntityReply) -> Outcome:
    if reply.error or asked.verb == "delete":
        return not reply.error, reply.name, None
    return True, reply.name, (reply.position_m[0], reply.position_m[1])


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_each_request_is_answered_once_in_an_order_that_explains_the_world() -> None:
    with Session("original", camera=False) as session:
        world = session.latest(WORLD)
        assert world is not None

        start, wall = world.start, world.walls[0]
        locations = tuple((one.x_m, one.y_m) for one in world.locations)

        class Here(Requests):
            places = locations
            taken = frozenset(((start.x_m, start.y_m), (wall.x_m, wall.y_m)))

        Here.session = session
        run(Here)
