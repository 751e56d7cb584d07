"""A spawner and a physics of a few lines on one transport, and requests put to them."""

from __future__ import annotations

from typing import Any

from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import (
    ASSETS,
    DELETE_ENTITY,
    DESIRED_ENTITIES,
    ENTITIES,
    GET_ENTITIES,
    SET_ENTITY_STATE,
    SPAWN_ENTITY,
    TF,
    WORLD,
    Query,
)
from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.common.node.node import ClockNode, Envelope, Inbox, Node, Outbox
from mazebot.spawner.config import SpawnerConfig
from mazebot.spawner.node import SpawnerNode
from tests.common.house import marker, wall, world

STEP_NS = 4_166_667
HOUSE = world([wall(length_m=4.0)], [marker(id=7)])
FORBIDDEN_X_M = 100.0
"""What is farther along x is refused here."""


def box(name: str = "box", x_m: float = 1.0, **changes: Any) -> doc.BodyEntity:
    shape = doc.Shape(name="box", geometry=doc.Box(size_m=(0.2, 0.3, 0.4)), material="red")
    red = doc.Material(name="red", diffuse=(1.0, 0.0, 0.0, 1.0))
    values: dict[str, Any] = {
        "name": name, "position_m": (x_m, 2.0, 0.2), "shapes": (shape,), "materials": (red,)
    }  # fmt: skip
    return doc.BodyEntity(**values | changes)


class Worldgen(Node):
    name = "worldgen"
    period_ns = 1_000_000_000_000
    _config = SpawnerConfig()

    def __init__(self) -> None:
        self.waiting = [HOUSE]
        self.assets: list[msg.CompressedImage] = []

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Nothing: the stage puts what it has."""


class Physics(ClockNode):
    """Lets everything stand that is not too far away, as the contract has it."""

    name = "physics"
    _config = SpawnerConfig()
    wakes = (DESIRED_ENTITIES, WORLD)

    def __init__(self) -> None:
        self.now_ns = 0
        self.paused = False
        self.is_away = False
        self.standing: doc.Entities | None = None
        self.sets: list[doc.Entities] = []
        self.moved: list[msg.TransformStamped] = []

    def next_step_ns(self) -> int | None:
        return None if self.paused else self.now_ns + STEP_NS

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        self.now_ns = now_ns
        if self.is_away:
            return
        for house in inbox.new(WORLD):
            if house.hash != self.world_hash:
                self.world_hash, self.standing = house.hash, None
        if self.moved:
            outbox.put(TF, msg.TFMessage(transforms=self.moved))
        new = inbox.new(DESIRED_ENTITIES)
        self.sets += new
        if new:
            self.take(new[-1], outbox)

    def take(self, desired: doc.Entities, outbox: Outbox) -> None:
        before = self.standing.entities if self.standing is not None else ()
        wanted = desired.entities
        if desired.revision == 0 and self.standing is not None:
            wanted = before
        old = {one.name: one for one in before}
        stands: list[doc.Entity] = []
        refused = []
        for one in wanted:
            if one.position_m[0] > FORBIDDEN_X_M:
                refused.append(doc.Refusal(name=one.name, reason="too far"))
                if one.name in old:
                    stands.append(old[one.name])
            else:
                stands.append(one)
        self.standing = doc.Entities(
            world_hash=desired.world_hash, revision=desired.revision, entities=tuple(stands),
            refused=tuple(refused),
        )  # fmt: skip
        outbox.put(ENTITIES, self.standing)


class Stage:
    """The nodes in lockstep, with a world to begin with."""

    def __init__(self, house: doc.World | None = HOUSE) -> None:
        self.physics, self.spawner = Physics(), SpawnerNode(SpawnerConfig())
        self.worldgen = Worldgen()
        self.start()
        if house is not None:
            self.load(house)

    def start(self) -> None:
        self.transport = MemoryTransport()
        nodes = [self.worldgen, self.physics, self.spawner]
        self.executive = Executive(nodes, self.transport)
        self.worldgen_outbox = Outbox(self.worldgen, self.transport._send)

    def load(self, house: doc.World) -> None:
        self.worldgen.world_hash = house.hash
        self.worldgen_outbox.put(WORLD, house)
        self.turn()

    def turn(self, times: int = 3) -> None:
        for _ in range(times):
            self.executive.turn()

    def ask_all(self, query: Query[Any, Any], *messages: Any) -> list[Any]:
        """Ask at once; the answers in the order of the questions, None where there is none."""
        answers: list[Any] = [None] * len(messages)

        def keep(number: int) -> Any:
            def respond(answer: Any) -> None:
                assert answers[number] is None, "answered twice"
                answers[number] = answer

            return respond

        for number, message in enumerate(messages):
            assert self.transport.ask(query, message, keep(number))
        self.turn()
        return answers

    def ask(self, query: Query[Any, Any], message: Any) -> Any:
        return self.ask_all(query, message)[0]

    def spawn(self, entity: doc.Entity, **more: Any) -> doc.EntityReply | None:
        return self.ask(SPAWN_ENTITY, doc.SpawnEntity(entity=entity, **more))  # type: ignore[no-any-return]

    def delete(self, name: str) -> doc.EntityReply | None:
        return self.ask(DELETE_ENTITY, doc.DeleteEntity(name=name))  # type: ignore[no-any-return]

    def move(self, name: str, x_m: float, y_m: float = 2.0) -> doc.EntityReply | None:
        state = doc.SetEntityState(name=name, position_m=(x_m, y_m, 0.2))
        return self.ask(SET_ENTITY_STATE, state)  # type: ignore[no-any-return]

    def names(self) -> list[str]:
        """Of what stands, by the spawner's word."""
        found = self.ask(GET_ENTITIES, doc.GetEntities())
        assert isinstance(found, doc.Entities)
        return [one.name for one in found.entities]

    def restart_physics(self) -> None:
        """Another one in its place, which is given what is latched."""
        latched = self.physics.sets[-1]
        self.physics = Physics()
        self.start()
        Outbox(self.spawner, self.transport._send).put(DESIRED_ENTITIES, latched)
        self.turn()

    def waiting_sets(self) -> list[doc.Entities]:
        """Those that the physics has not taken in."""
        return self.transport._inboxes["physics"].new(DESIRED_ENTITIES)

    def sent_assets(self) -> list[str]:
        """A list that grows by the sha256 of each asset that reaches the physics."""
        sent: list[str] = []
        inbox = self.transport._inboxes["physics"]
        deliver = inbox.deliver

        def listen(topic: Any, message: Any, envelope: Envelope) -> None:
            if topic is ASSETS:
                sent.append(message.header.frame_id)
            deliver(topic, message, envelope)

        inbox.deliver = listen  # type: ignore[method-assign]
        return sent

    def latest_set(self) -> list[str]:
        return [one.name for one in self.physics.sets[-1].entities]
