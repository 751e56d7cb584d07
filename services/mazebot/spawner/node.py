"""Spawner: keeps the set of desired entities, the world's ArUco markers and the requested ones, and
replies to requests with the result from the physics.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Sequence
from typing import Any

from mazebot.common.maths.frames import MAP_FRAME
from mazebot.common.messages.documents import (
    BodyEntity,
    Entities,
    Entity,
    EntityBoundsReply,
    EntityReply,
    GetEntities,
    GetEntityBounds,
    Quaternion,
    SpawnEntity,
    Vector,
    World,
)
from mazebot.common.messages.messages import TFMessage
from mazebot.common.messages.topics import (
    ASSETS,
    DELETE_ENTITY,
    DESIRED_ENTITIES,
    ENTITIES,
    GET_ENTITIES,
    GET_ENTITY_BOUNDS,
    SET_ENTITY_STATE,
    SPAWN_ENTITY,
    TF,
    WORLD,
)
from mazebot.common.node.node import Inbox, Node, Outbox, Request
from mazebot.common.world.assets import asset_message, mesh_sha256s
from mazebot.common.world.geometry import mesh_from_bytes
from mazebot.common.world.marker_entities import PanelStyle, marker_entities
from mazebot.common.world.placement import Placement
from mazebot.spawner.config import SpawnerConfig
from mazebot.spawner.desired_set import DesiredSet, Later, Waits
from mazebot.spawner.entity_bounds import bounds_m

MAX_WAITING = 1000
"""Requests that wait for the physics; more are refused."""
MAX_WAITING_BYTES = 64 * 1024 * 1024
"""Of the assets, in base64, of all requests that wait."""

_Waiting = Request[Any, EntityReply]
"""A request to spawn, delete or move an entity."""

_log = logging.getLogger("spawner")


class SpawnerNode(Node):
    """Latches the set of desired entities of the running world.

    The physics applies one set at a time; requests received meanwhile make the next. So the reply
    to each request is its result, and a refused one leaves the set as it was.
    """

    name = "spawner"
    _config: SpawnerConfig
    wakes = (WORLD, ASSETS, ENTITIES)

    def __init__(self, config: SpawnerConfig) -> None:
        self._config = config
        self._style = PanelStyle(config.panel_gap_m, config.module_px)
        self._next_world: World | None = None
        self._files: dict[str, bytes] = {}
        """Assets received, by sha256, until the world's set has been settled once."""
        self._desired: DesiredSet | None = None
        self._latched: deque[str] = deque(maxlen=ASSETS.depth)
        """The assets that a late subscriber receives."""
        self._in_use: set[str] = set()
        """The assets of the set that was published last."""
        self._standing: Entities | None = None
        """The existing entities; None before the physics has published those of this world."""
        self._poses: dict[str, tuple[Vector, Quaternion]] = {}
        """Poses of the entities that have moved since."""
        self._is_settled = False
        """Whether the physics has published the result of the newest set."""
        self._waiting: list[_Waiting] = []
        self._in_flight: list[tuple[str, _Waiting]] = []
        self._getting: list[Request[GetEntities, Entities]] = []
        self._measuring: list[Request[GetEntityBounds, EntityBoundsReply]] = []

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Process new messages, reply where possible, and publish a changed set."""
        self._take_in_world(inbox, outbox)
        for standing in inbox.new(ENTITIES):
            if standing.world_hash == self.world_hash:
                self._take_in_standing(standing, inbox)
        self._take_in_requests(inbox)
        if self._desired is not None and self._is_settled:
            self._desired.take_files(self._files)
            if self._next_world is None:
                self._files = {}
            self._gather(self._desired, outbox)
        self._take_poses(inbox)
        self._measure()

    def waiting_for(self) -> str | None:
        """The missing part of a world and its meshes."""
        if self.world_hash:
            return None
        if self._next_world is None:
            return "a world"
        return f"meshes of the world on {ASSETS.name}"

    def _take_in_world(self, inbox: Inbox, outbox: Outbox) -> None:
        worlds = inbox.new(WORLD)
        if worlds:
            newest = worlds[-1]
            self._next_world = newest if newest.hash != self.world_hash else None
        for asset in inbox.new(ASSETS):
            self._files[asset.header.frame_id] = asset.data.tobytes()
        world = self._next_world
        if world is not None and all(
            sha256 in self._files for sha256 in mesh_sha256s(world.bodies)
        ):
            self._furnish(world, outbox)
            self._next_world = None

    def _furnish(self, world: World, outbox: Outbox) -> None:
        """Start a world's set with its markers."""
        if self.world_hash:
            self._refuse_all(f"the world was replaced by '{world.name}'")
        meshes = {}
        for sha256 in mesh_sha256s(world.bodies):
            try:
                meshes[sha256] = mesh_from_bytes(self._files[sha256])
            except ValueError as error:
                # The physics reports it too, and keeps the running world.
                _log.error("mesh %.12s: %s", sha256, error)
        placement = Placement(world, meshes)
        hung, textures = marker_entities(world, self._style, placement=placement)
        self.world_hash = world.hash
        self._desired = DesiredSet(world, placement, hung, textures)
        self._standing, self._poses, self._is_settled = None, {}, False
        self._send(self._desired, outbox)
        for refusal in hung.refused:
            _log.error("%s rejected: %s", refusal.name, refusal.reason)
        _log.info("Spawned %d of %d markers", len(hung.entities), len(world.markers))

    def _take_in_standing(self, standing: Entities, inbox: Inbox) -> None:
        desired = self._desired
        if desired is None:
            return
        is_answer = not self._is_settled and standing.revision == desired.revision
        self._standing = standing
        self._follow(inbox)
        if is_answer:
            self._settle(desired, standing)
        is_reset = standing.reset_epoch > desired.reset_epoch
        if self._is_settled and (is_reset or (is_answer and desired.revision == 0)):
            desired.adopt(standing)

    def _settle(self, desired: DesiredSet, standing: Entities) -> None:
        """Reply to the requests of the set that the physics has answered."""
        self._is_settled = True
        replies = desired.settle(standing)
        for name in replies:
            self._poses.pop(name, None)
        for name, request in self._in_flight:
            request.respond(replies[name])
        self._in_flight = []

    def _take_in_requests(self, inbox: Inbox) -> None:
        self._queue(inbox.requests(SPAWN_ENTITY))
        self._queue(inbox.requests(DELETE_ENTITY))
        self._queue(inbox.requests(SET_ENTITY_STATE))
        self._getting = [*self._getting, *inbox.requests(GET_ENTITIES)][-MAX_WAITING:]
        measuring = [*self._measuring, *inbox.requests(GET_ENTITY_BOUNDS)]
        self._measuring = measuring[-MAX_WAITING:]

    def _queue(self, requests: Sequence[_Waiting]) -> None:
        waiting_bytes = sum(_asset_bytes(request) for request in self._waiting)
        for request in requests:
            waiting_bytes += _asset_bytes(request)
            if len(self._waiting) >= MAX_WAITING:
                request.respond(EntityReply(error=f"too many requests: {MAX_WAITING} are pending"))
            elif waiting_bytes > MAX_WAITING_BYTES:
                waiting_bytes -= _asset_bytes(request)
                request.respond(
                    EntityReply(
                        error=f"assets: too large: at most {MAX_WAITING_BYTES} bytes for "
                        "all pending requests"
                    )
                )
            else:
                self._waiting.append(request)

    def _gather(self, desired: DesiredSet, outbox: Outbox) -> None:
        """Make the next set from all requests that can go into one."""
        later: list[_Waiting] = []
        held: set[str] = set()
        for index, request in enumerate(self._waiting):
            if desired.is_done_first(request.message):
                # In this set it would be done before what was requested earlier.
                later += self._waiting[index:]
                break
            outcome = desired.apply(request.message, held)
            if isinstance(outcome, Waits):
                self._in_flight.append((outcome.name, request))
            elif isinstance(outcome, Later):
                held.add(outcome.name)
                later.append(request)
            else:
                request.respond(outcome)
        self._waiting = later
        if desired.publish():
            self._is_settled = False
            self._send(desired, outbox)

    def _send(self, desired: DesiredSet, outbox: Outbox) -> None:
        """Publish the set, and before it the assets that a late subscriber would not receive."""
        files = desired.files()
        # Assets that were unused for a while may have been dropped by subscribers.
        missing = [sha256 for sha256 in files if sha256 not in self._in_use]
        self._in_use = set(files)
        # Publishing one may displace another from the latched ones.
        while missing or (missing := [one for one in files if one not in self._latched]):
            for sha256 in missing:
                outbox.put(ASSETS, asset_message(sha256, files[sha256]))
                self._latched.append(sha256)
            missing = []
        outbox.put(DESIRED_ENTITIES, desired.entities())

    def _take_poses(self, inbox: Inbox) -> None:
        if self._standing is None or self._desired is None or not self._getting:
            return
        self._follow(inbox)
        entities = [
            one.model_copy(update={"position_m": pose[0], "orientation_xyzw": pose[1]})
            if (pose := self._poses.get(one.name)) is not None
            else one
            for one in self._standing.entities
        ]
        refused = (*self._desired.refused, *self._standing.refused)
        found = self._standing.model_copy(update={"entities": tuple(entities), "refused": refused})
        for request in self._getting:
            request.respond(found)
        self._getting = []

    def _measure(self) -> None:
        if self._standing is None or self._desired is None:
            return
        stands = {one.name: one for one in self._standing.entities}
        for request in self._measuring:
            request.respond(self._bounds_of(stands.get(request.message.name), self._desired))
        self._measuring = []

    @staticmethod
    def _bounds_of(entity: Entity | None, desired: DesiredSet) -> EntityBoundsReply:
        if entity is None:
            return EntityBoundsReply(error="no such entity")
        bodies = (entity,) if isinstance(entity, BodyEntity) else ()
        files = desired.files()
        try:
            meshes = {sha256: mesh_from_bytes(files[sha256]) for sha256 in mesh_sha256s(bodies)}
            low, high = bounds_m(entity, meshes)
        except KeyError as error:
            return EntityBoundsReply(error=f"{entity.name}: the mesh {error} is not known here")
        except ValueError as error:
            return EntityBoundsReply(error=f"{entity.name}: {error}")
        return EntityBoundsReply(low_m=tuple(low.tolist()), high_m=tuple(high.tolist()))

    def _follow(self, inbox: Inbox) -> None:
        """Update the poses of the moving entities."""
        names = {one.name for one in self._standing.entities} if self._standing else set()
        self._poses = {name: pose for name, pose in self._poses.items() if name in names}
        for message in inbox.new(TF):
            self._poses |= _poses_in_map(message, names)

    def _refuse_all(self, error: str) -> None:
        for request in (*self._waiting, *(request for _, request in self._in_flight)):
            request.respond(EntityReply(error=error))
        self._waiting, self._in_flight = [], []


def _asset_bytes(request: _Waiting) -> int:
    message = request.message
    return sum(map(len, message.assets.values())) if isinstance(message, SpawnEntity) else 0


def _poses_in_map(message: TFMessage, names: set[str]) -> dict[str, tuple[Vector, Quaternion]]:
    poses: dict[str, tuple[Vector, Quaternion]] = {}
    for entry in message.transforms:
        if entry.header.frame_id == MAP_FRAME and entry.child_frame_id in names:
            t, q = entry.transform.translation, entry.transform.rotation
            poses[entry.child_frame_id] = (t.x, t.y, t.z), (q.x, q.y, q.z, q.w)
    return poses
