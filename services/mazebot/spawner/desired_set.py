"""The desired entities of a world: its markers and the requested entities, change by change.

Changes are gathered into sets, each with a revision; the physics applies a set and publishes the
entities that then exist, which settles every change of that set: it is kept, or reverted with the
reason.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from mazebot.common.messages.documents import (
    BodyEntity,
    DeleteEntity,
    Entities,
    Entity,
    EntityReply,
    FirstPose,
    Marker,
    MarkerEntity,
    Quaternion,
    SetEntityState,
    SpawnEntity,
    Vector,
    World,
)
from mazebot.common.world.assets import assets_of
from mazebot.common.world.entity_problems import entity_problems, name_problems, pose_problems
from mazebot.common.world.marker_entities import MAX_MARKERS
from mazebot.common.world.marker_picture import identity_problem, own_dictionaries
from mazebot.common.world.placement import Placement, panel_of
from mazebot.spawner.entity_assets import decoded

MAX_ASKED_FOR = 200
MAX_ENTITY_BYTES = 256 * 1024
"""Of one entity as JSON: the whole set is published with each change."""
MAX_SET_BYTES = 4 * 1024 * 1024
MAX_ASSETS = 228
"""Of all entities together: 100 and one for each marker, fewer than a late subscriber receives."""
MAX_ASSET_BYTES = 64 * 1024 * 1024

Asked = SpawnEntity | DeleteEntity | SetEntityState


@dataclass(frozen=True, eq=False)
class Waits:
    """A request is replied to when the change of this name is settled."""

    name: str


@dataclass(frozen=True, eq=False)
class Later:
    """A request has to wait for the earlier requests for this name."""

    name: str


@dataclass(frozen=True, eq=False)
class _Thing:
    entity: Entity
    """In its desired state."""
    asked: Entity
    """As first requested: the same request again changes nothing."""
    json_bytes: int
    """Size as JSON; 0: not counted, it belongs to the world."""


@dataclass(frozen=True, eq=False)
class _Change:
    before: _Thing | None
    after: _Thing | None


class DesiredSet:
    """The set of one world."""

    def __init__(
        self, world: World, placement: Placement, hung: Entities, textures: Mapping[str, bytes]
    ) -> None:
        """`hung` are the world's markers at their poses, and those that cannot be placed;
        `textures` are those markers' textures, by sha256.
        """
        self.revision = 0
        self._files = dict(textures)
        """By sha256."""
        self._world = world
        self._dictionaries = own_dictionaries(world.dictionaries)
        self._placement = placement
        self._known = set(assets_of(world))
        self.refused = hung.refused
        """Markers of the world that cannot be placed."""
        self._fixed = {wall.name for wall in world.walls} | {body.name for body in world.bodies}
        self._hung = {one.name: _Thing(one, one, 0) for one in hung.entities}
        self._things = dict(self._hung)
        self.reset_epoch = 0
        """Of the newest reset that has put the entities back."""
        self._changes: dict[str, _Change] = {}
        self._is_stale = False

    def entities(self) -> Entities:
        """The set to publish."""
        return Entities(
            world_hash=self._world.hash,
            revision=self.revision,
            entities=tuple(thing.entity for thing in self._things.values()),
            refused=self.refused,
            initial=tuple(
                FirstPose(
                    name=thing.asked.name,
                    position_m=thing.asked.position_m,
                    orientation_xyzw=thing.asked.orientation_xyzw,
                )
                for thing in self._things.values()
                if _pose_of(thing.asked) != _pose_of(thing.entity)
            ),
            deleted=self._deleted(),
            reset_epoch=self.reset_epoch,
        )

    def files(self) -> dict[str, bytes]:
        """The assets of the desired entities, by sha256, as far as the spawner has them."""
        wanted = assets_of(*self._entities(), *self._deleted())
        return {sha256: data for sha256, data in self._files.items() if sha256 in wanted}

    def take_files(self, files: Mapping[str, bytes]) -> None:
        """Take over the assets that the desired entities need and the spawner does not have."""
        wanted = assets_of(*self._entities()).keys() - self._known - self._files.keys()
        for sha256, data in files.items():
            if sha256 in wanted and hashlib.sha256(data).hexdigest() == sha256:
                self._files[sha256] = data
                # The spawner has to publish it itself.
                self._is_stale = True

    def adopt(self, standing: Entities) -> None:
        """Take over the entities that exist: those of before this spawner's start, or those that a
        reset has put back. No change may be waiting to be settled.
        """
        stands = {one.name: one for one in standing.entities}
        refused = {one.name for one in standing.refused} & self._things.keys()
        first = {one.name: one for one in standing.initial}
        mine = {**self._hung, **self._things}
        kept = [name for name in mine if name in stands or name in refused]
        published = tuple(self._entities())
        self._things = {}
        for name in dict.fromkeys([*kept, *stands]):
            own = mine.get(name)
            if own is None:
                asked = _moved(stands[name], first.get(name, stands[name]))
                own = _Thing(stands[name], asked, len(stands[name].model_dump_json()))
            self._things[name] = replace(own, entity=stands.get(name, own.entity))
        if standing.reset_epoch != self.reset_epoch:
            # The set that was published is that of before the reset.
            self.reset_epoch, self._is_stale = standing.reset_epoch, True
        # A physics that begins anew gets the set that was published last.
        self._is_stale = self._is_stale or tuple(self._entities()) != published

    def apply(self, message: Asked, held: Container[str] = ()) -> EntityReply | Waits | Later:
        """Apply a request to the set; returns the reply if it can be given at once.

        Earlier requests wait for the names in `held`.
        """
        name = _name_of(message)
        if name in held:
            return Later(name)
        try:
            if isinstance(message, SpawnEntity):
                return self._spawn(message)
            if message.name in self._fixed:
                raise _RefusedError(f"name: {message.name!r:.60}: is part of the world")
            thing, change = self._things.get(message.name), self._changes.get(message.name)
            if thing is None and change is None:
                raise _RefusedError(f"name: {message.name!r:.60}: no such entity")
            if isinstance(message, DeleteEntity):
                if change is not None:
                    return Later(message.name)
                return self._change(message.name, None)
            return self._move(message, thing, change)
        except _RefusedError as error:
            return EntityReply(error=str(error), name=name)

    def is_done_first(self, message: Asked) -> bool:
        """Whether the physics applies a change before those of this set: it deletes first."""
        is_delete = isinstance(message, DeleteEntity)
        return is_delete and any(one.after is not None for one in self._changes.values())

    def publish(self) -> bool:
        """Whether the set has changed since it was published: then it gets the next revision."""
        if not (self._changes or self._is_stale):
            return False
        self.revision += 1
        self._is_stale = False
        return True

    def settle(self, standing: Entities) -> dict[str, EntityReply]:
        """The reply for each name that the set changed, from the entities that now exist."""
        stands = {one.name: one for one in standing.entities}
        reasons = {one.name: one.reason for one in standing.refused}
        replies = {}
        for name, change in self._changes.items():
            entity = stands.get(name)
            if name in reasons and change.after is not None:
                replies[name] = EntityReply(error=reasons[name], name=name)
            elif (entity is None) == (change.after is None):
                replies[name] = EntityReply(name=name) if entity is None else reply_of(entity)
            else:
                replies[name] = EntityReply(error="not applied by physics", name=name)
            if replies[name].error:
                self._put(name, change.before)
                self._is_stale = True
        self._changes = {}
        self._files = self.files()
        return replies

    def _spawn(self, message: SpawnEntity) -> EntityReply | Waits | Later:
        _refuse(name_problems(message.entity.name))
        for name in _names(message):
            entity = message.entity.model_copy(update={"name": name})
            thing, change = self._things.get(name), self._changes.get(name)
            if thing is not None and thing.asked == entity:
                return Waits(name) if change is not None else reply_of(thing.entity)
            if thing is None and change is None and name not in self._fixed:
                break
            if change is not None:
                # Whether the name is taken is not known yet.
                return Later(name)
            if not message.allow_renaming:
                raise _RefusedError(f"name: {name!r:.60} already exists")
        size = len(entity.model_dump_json())
        self._check_room(size)
        _refuse(entity_problems(entity))
        if isinstance(entity, MarkerEntity):
            self._check_marker(entity)
        try:
            files = decoded(message.assets, entity, self._known | self._files.keys())
        except ValueError as error:
            raise _RefusedError(str(error)) from None
        if len(self._files) + len(files) > MAX_ASSETS:
            raise _RefusedError(f"assets: too many: at most {MAX_ASSETS} for all entities")
        if sum(map(len, (*self._files.values(), *files.values()))) > MAX_ASSET_BYTES:
            raise _RefusedError(
                f"assets: too large: at most {MAX_ASSET_BYTES} bytes for all entities"
            )
        self._files |= files
        return self._change(name, _Thing(entity, entity, size))

    def _move(
        self, message: SetEntityState, thing: _Thing | None, change: _Change | None
    ) -> EntityReply | Waits | Later:
        is_there = thing is not None and _pose_of(message) == _pose_of(thing.entity)
        if change is not None:
            return Waits(message.name) if is_there else Later(message.name)
        assert thing is not None
        _refuse(pose_problems(message))
        entity = thing.entity
        moved = _moved(entity, message)
        if isinstance(entity, BodyEntity):
            if is_there and entity.mass_kg == 0.0 and entity.path is None:
                return reply_of(entity)
            # A moving body is no longer at the pose where it was placed.
            moved = moved.model_copy(update={"placed": entity.placed + 1})
        elif is_there:
            return reply_of(entity)
        if isinstance(moved, MarkerEntity):
            self._check_place(moved)
        return self._change(message.name, _Thing(moved, thing.asked, thing.json_bytes))

    def _change(self, name: str, after: _Thing | None) -> Waits:
        self._changes[name] = _Change(self._things.get(name), after)
        self._put(name, after)
        return Waits(name)

    def _put(self, name: str, thing: _Thing | None) -> None:
        if thing is None:
            self._things.pop(name, None)
        else:
            self._things[name] = thing

    def _check_room(self, size: int) -> None:
        if size > MAX_ENTITY_BYTES:
            raise _RefusedError(f"entity: {size} bytes of JSON: must be at most {MAX_ENTITY_BYTES}")
        sizes = [thing.json_bytes for thing in self._things.values() if thing.json_bytes]
        if len(sizes) >= MAX_ASKED_FOR:
            raise _RefusedError(f"too many entities: at most {MAX_ASKED_FOR}")
        if sum(sizes) + size > MAX_SET_BYTES:
            raise _RefusedError(
                f"entity: {size} bytes of JSON: all entities together must have at most "
                f"{MAX_SET_BYTES}"
            )

    def _check_marker(self, entity: MarkerEntity) -> None:
        markers = [one for one in self._entities() if isinstance(one, MarkerEntity)]
        if len(markers) >= MAX_MARKERS:
            raise _RefusedError(f"too many markers: at most {MAX_MARKERS}")
        if not 0 <= entity.marker_id <= 100_000:
            raise _RefusedError(f"marker_id: {entity.marker_id}: must be 0 to 100000")
        problem = identity_problem(
            Marker(id=entity.marker_id, dictionary=entity.dictionary, wall="", side="left",
                   height_m=0.0),
            self._dictionaries.get(entity.dictionary),
        )  # fmt: skip
        same = next((one.name for one in markers if one.marker_id == entity.marker_id), "")
        if not problem and same:
            problem = f"marker_id: {entity.marker_id}: must be unique: already used by {same!r:.60}"
        if problem:
            raise _RefusedError(problem)
        self._check_place(entity)

    def _check_place(self, entity: MarkerEntity) -> None:
        hanging = [
            panel_of(one)
            for one in self._entities()
            if isinstance(one, MarkerEntity) and one.name != entity.name
        ]
        problem = self._placement.problem(panel_of(entity), hanging)
        if problem:
            raise _RefusedError(problem)

    def _entities(self) -> Iterator[Entity]:
        return (thing.entity for thing in self._things.values())

    def _deleted(self) -> tuple[MarkerEntity, ...]:
        """The world's own markers that are gone, and whose name and id nothing else has taken."""
        ids = {one.marker_id for one in self._entities() if isinstance(one, MarkerEntity)}
        return tuple(
            thing.entity
            for name, thing in self._hung.items()
            if name not in self._things
            and isinstance(thing.entity, MarkerEntity)
            and thing.entity.marker_id not in ids
        )


def _pose_of(one: Entity | FirstPose | SetEntityState) -> tuple[Vector, Quaternion]:
    return one.position_m, one.orientation_xyzw


def _moved(entity: Entity, to: Entity | FirstPose | SetEntityState) -> Entity:
    """The entity at the pose of another, or of a request."""
    position_m, orientation_xyzw = _pose_of(to)
    update = {"position_m": position_m, "orientation_xyzw": orientation_xyzw}
    return entity.model_copy(update=update)


def reply_of(entity: Entity) -> EntityReply:
    """The reply that an entity exists at its pose."""
    return EntityReply(
        name=entity.name, position_m=entity.position_m, orientation_xyzw=entity.orientation_xyzw
    )


class _RefusedError(Exception):
    """A request that is refused, with the reason in one line."""


def _name_of(message: Asked) -> str:
    return message.entity.name if isinstance(message, SpawnEntity) else message.name


def _names(message: SpawnEntity) -> Iterator[str]:
    """The requested name and, with `allow_renaming`, that name with a number appended."""
    yield message.entity.name
    if message.allow_renaming:
        for number in itertools.count(1):
            yield f"{message.entity.name}_{number}"


def _refuse(problems: Iterable[str]) -> None:
    """Raises _RefusedError with the first problem, if there is one."""
    for problem in problems:
        raise _RefusedError(problem)
