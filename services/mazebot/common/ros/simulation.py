"""simulation_interfaces: services and an action, by the queries of physics and the spawner."""

from __future__ import annotations

import re
from collections.abc import Generator, Sequence
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from mazebot.common.config import one_line
from mazebot.common.maths.frames import MAP_FRAME
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import (
    CLOCK,
    DELETE_ENTITY,
    GET_ENTITIES,
    GET_ENTITY_BOUNDS,
    READ_MODEL,
    SET_ENTITY_STATE,
    SIMULATION_CONTROL,
    SPAWN_ENTITY,
    Query,
)
from mazebot.common.node.node import Node
from mazebot.common.ros.action import (
    Action,
    Ask,
    Course,
    Ended,
    Feedback,
    GoalError,
    GoalStatus,
    Running,
)
from mazebot.common.ros.call import Response, Service, Steps, answered
from mazebot.common.ros.entity_bounds import EMPTY, box, overlaps
from mazebot.common.ros.entity_filters import filtered, info_of, problem_of

FEATURE_UNSUPPORTED, OK, NOT_FOUND, INCORRECT_STATE, OPERATION_FAILED = range(5)
NAME_NOT_UNIQUE, NAME_INVALID, UNSUPPORTED_FORMAT, NO_RESOURCE = 101, 102, 103, 104
NAMESPACE_UNSUPPORTED, PARSE_ERROR, INVALID_POSE = 105, 106, 109
ALREADY_IN_TARGET_STATE = 101
_STATES = {0: "STOPPED", 1: "PLAYING", 2: "PAUSED", 3: "QUITTING"}
_PLAYING, _PAUSED, _NO_WORLD = 1, 2, 4
_RESETS = {0: "fresh", 7: "fresh", 255: "fresh", 3: "all", 1: "time"}
"""By the bits of the scope: 1 time, 2 state, 4 what was spawned; 0 is 255, all."""
_FEATURES: Final = {
    "SPAWNING": 0, "DELETING": 1, "NAMED_POSES": 2, "ENTITY_TAGS": 4, "ENTITY_BOUNDS": 5,
    "ENTITY_BOUNDS_BOX": 6, "ENTITY_BOUNDS_CONVEX": 7, "ENTITY_CATEGORIES": 8,
    "SPAWNING_RESOURCE_STRING": 9, "ENTITY_STATE_GETTING": 10, "ENTITY_STATE_SETTING": 11,
    "ENTITY_INFO_GETTING": 12, "SPAWNABLES": 14, "SIMULATION_RESET": 20,
    "SIMULATION_RESET_TIME": 21, "SIMULATION_STATE_GETTING": 24, "SIMULATION_STATE_SETTING": 25,
    "SIMULATION_STATE_PAUSE": 26, "STEP_SIMULATION_SINGLE": 31, "STEP_SIMULATION_MULTIPLE": 32,
    "STEP_SIMULATION_ACTION": 33, "WORLD_LOADING": 40, "WORLD_INFO_GETTING": 44,
    "AVAILABLE_WORLDS": 45,
}  # fmt: skip
_WORLD_FRAMES = ("", "world", MAP_FRAME)
_MOST_STEPS = 10_000_000
_MODEL_URI = re.compile(r"(?:model://)?([\w-][\w.-]*)")
_ENTITY: TypeAdapter[doc.Entity] = TypeAdapter(doc.Entity)


def result(code: int = OK, error: str = "") -> Response:
    """What every response begins with; `error` is empty where `code` is OK."""
    return {"result": {"result": code, "error_message": error}}


def _of_error(error: str, code: int = OPERATION_FAILED) -> Response:
    return result(code, error) if error else result()


def _features(_: Any, __: Node) -> Response:
    info = (
        "SpawnEntity: resource_string is SDF, URDF or an entity of /spawn_entity in JSON, uri is "
        "model://NAME; LoadWorld: uri is the name of a world, and the simulation goes on playing "
        "or paused as it was"
    )
    return {
        "features": {
            "features": sorted(_FEATURES.values()),
            "spawn_formats": ["sdf", "urdf", "mazebot_json"],
            "custom_info": info,
        }
    }


def _state_of(stats: doc.SimulationStats | None) -> int:
    if stats is None:
        return _NO_WORLD
    return _PAUSED if stats.paused else _PLAYING


def _get_state(_: Any, __: Node) -> Steps:
    reply = yield SIMULATION_CONTROL, doc.SimulationControl()
    return {"state": {"state": _state_of(reply.stats)}, **result()}


def _set_state(request: Any, _: Node) -> Steps:
    wanted = request.state.state
    if wanted not in (_PLAYING, _PAUSED):
        name = _STATES.get(wanted, str(wanted))
        return result(FEATURE_UNSUPPORTED, f"state: {name}: must be PLAYING or PAUSED")
    reply = yield SIMULATION_CONTROL, doc.SimulationControl()
    now = _state_of(reply.stats)
    if now == _NO_WORLD:
        return result(INCORRECT_STATE, "no world is loaded yet")
    if now == wanted:
        return result(ALREADY_IN_TARGET_STATE, f"the simulation is {_STATES[now]} already")
    reply = yield SIMULATION_CONTROL, doc.SimulationControl(pause=wanted == _PAUSED)
    return _of_error(reply.error)


def _reset(request: Any, _: Node) -> Steps:
    scope = _RESETS.get(request.scope)
    if scope is None:
        return result(
            FEATURE_UNSUPPORTED,
            f"scope: {request.scope}: must be SCOPE_ALL, SCOPE_TIME, or 3, time and state: then "
            "what was spawned is where it was spawned",
        )
    control = doc.SimulationControl.model_validate({"reset": scope})
    reply = yield SIMULATION_CONTROL, control
    return _of_error(reply.error)


def _problem_of_steps(steps: int, reply: doc.SimulationControlReply) -> str:
    """Why the simulation, by its reply to an empty request, does not do some steps; empty: it
    does.
    """
    if not 1 <= steps <= _MOST_STEPS:
        return f"steps: {steps}: must be 1 .. {_MOST_STEPS}"
    return "" if _state_of(reply.stats) == _PAUSED else "the simulation must be PAUSED"


def _step(request: Any, _: Node) -> Steps:
    reply = yield SIMULATION_CONTROL, doc.SimulationControl()
    problem = _problem_of_steps(request.steps, reply)
    if problem:
        return result(OPERATION_FAILED, problem)
    reply = yield SIMULATION_CONTROL, doc.SimulationControl(step=int(request.steps))
    return _of_error(reply.error)


def _simulate_steps(goal: Any, _: str) -> Course:
    """One run of steps; the clock tells how far it is."""
    steps = int(goal.steps)
    reply = yield SIMULATION_CONTROL, doc.SimulationControl()
    problem = _problem_of_steps(steps, reply)
    if problem:
        raise GoalError(OPERATION_FAILED, problem)
    began: doc.SimulationStats = reply.stats
    told = 0

    def feedback(completed: int) -> Feedback:
        nonlocal told
        told = completed
        return Feedback({"completed_steps": completed, "remaining_steps": steps - completed})

    def heard(clock: msg.Clock) -> Feedback | None:
        passed_s = msg.ns_from_time(clock.clock) * 1e-9 - began.sim_time_s
        completed = round(passed_s / began.step_size_s)
        return feedback(completed) if told < completed <= steps else None

    yield Running(heard)
    reply = yield SIMULATION_CONTROL, doc.SimulationControl(step=steps)
    if reply.error:
        raise GoalError(OPERATION_FAILED, reply.error)
    if told < steps:
        # The clock does not tell of each step.
        yield feedback(steps)
    return Ended(GoalStatus.SUCCEEDED, result())


def _failed(code: int | None, message: str) -> Response:
    return result(OPERATION_FAILED if code is None else code, message)


def _pause(_: str) -> Ask:
    """It ends a run of steps."""
    return SIMULATION_CONTROL, doc.SimulationControl(pause=True)


def _pose(position_m: Sequence[float], orientation_xyzw: Sequence[float]) -> dict[str, Any]:
    return {
        "position": dict(zip("xyz", map(float, position_m), strict=True)),
        "orientation": dict(zip("xyzw", map(float, orientation_xyzw), strict=True)),
    }


def _placed(pose: msg.Pose) -> dict[str, Any]:
    """The fields of an entity's document that say where it is."""
    at, turn = pose.position, pose.orientation
    return {
        "position_m": (at.x, at.y, at.z),
        "orientation_xyzw": (turn.x, turn.y, turn.z, turn.w),
    }


def _names() -> Generator[tuple[Query[Any, Any], Any], Any, set[str]]:
    """The names of all entities."""
    found = yield GET_ENTITIES, doc.GetEntities()
    return {one.name for one in found.entities}


def _entity_state(entity: doc.Entity) -> dict[str, Any]:
    """Its pose; how fast it moves is not known."""
    pose = _pose(entity.position_m, entity.orientation_xyzw)
    return {"header": {"frame_id": MAP_FRAME}, "pose": pose}


def _filtered(request: Any, _: Node) -> Steps:
    problem = problem_of(request.filters)
    if problem:
        return result(FEATURE_UNSUPPORTED, problem)
    reply = yield GET_ENTITIES, doc.GetEntities()
    found = filtered(reply.entities, request.filters)
    bounds = request.filters.bounds
    within = []
    for entity in found if bounds.type != EMPTY else ():
        reply = yield GET_ENTITY_BOUNDS, doc.GetEntityBounds(name=entity.name)
        if not reply.error:
            if overlaps(entity, reply.low_m, reply.high_m, bounds):
                within.append(entity)
        elif entity.name in (yield from _names()):
            # Else it has been deleted meanwhile.
            return result(OPERATION_FAILED, reply.error)
    return {"found": found if bounds.type == EMPTY else within, **result()}


def _get_entities(request: Any, node: Node) -> Steps:
    response = dict((yield from _filtered(request, node)))
    response["entities"] = [one.name for one in response.pop("found", ())]
    return response


def _get_entities_states(request: Any, node: Node) -> Steps:
    response = dict((yield from _filtered(request, node)))
    found = response.pop("found", ())
    response["entities"] = [one.name for one in found]
    response["states"] = [_entity_state(one) for one in found]
    return response


def _named(name: str) -> Generator[tuple[Query[Any, Any], Any], Any, doc.Entity | None]:
    found = yield GET_ENTITIES, doc.GetEntities()
    return next((one for one in found.entities if one.name == name), None)


def _get_entity_state(request: Any, _: Node) -> Steps:
    entity = yield from _named(request.entity)
    if entity is None:
        return _missing(request.entity)
    return {"state": _entity_state(entity), **result()}


def _get_entity_info(request: Any, _: Node) -> Steps:
    entity = yield from _named(request.entity)
    if entity is None:
        return _missing(request.entity)
    return {"info": info_of(entity), **result()}


def _get_entity_bounds(request: Any, _: Node) -> Steps:
    if (yield from _named(request.entity)) is None:
        return _missing(request.entity)
    reply = yield GET_ENTITY_BOUNDS, doc.GetEntityBounds(name=request.entity)
    if reply.error:
        return result(OPERATION_FAILED, reply.error)
    return {"bounds": box(reply.low_m, reply.high_m), **result()}


def _missing(name: str) -> Response:
    return result(NOT_FOUND, f"entity: {name!r:.80}: no such entity")


def _set_entity_state(request: Any, _: Node) -> Steps:
    """Both forms of the request: that of 1.x, and that of 2.x, which says what to set."""
    state = request.state
    if state.header.frame_id not in _WORLD_FRAMES:
        return result(
            INVALID_POSE, f"state.header.frame_id: {state.header.frame_id!r:.40}: must be map"
        )
    # 1.x has no flags.
    for flag in ("set_twist", "set_acceleration"):
        if getattr(request, flag, False):
            return result(FEATURE_UNSUPPORTED, f"{flag}: must be false: only the pose can be set")
    if not getattr(request, "set_pose", True):
        return result(OPERATION_FAILED, "set_pose: must be true: nothing else can be set")
    parts = () if hasattr(request, "set_twist") else ("twist", "acceleration")
    for part in parts:
        both = getattr(state, part)
        if any((one.x, one.y, one.z) != (0.0, 0.0, 0.0) for one in (both.linear, both.angular)):
            return result(
                FEATURE_UNSUPPORTED, f"state.{part}: must be zero: only the pose can be set"
            )
    if request.entity not in (yield from _names()):
        return _missing(request.entity)
    wanted = doc.SetEntityState(name=request.entity, **_placed(state.pose))
    reply = yield SET_ENTITY_STATE, wanted
    return _of_error(reply.error, INVALID_POSE)


def _delete(request: Any, _: Node) -> Steps:
    if request.entity not in (yield from _names()):
        return _missing(request.entity)
    reply = yield DELETE_ENTITY, doc.DeleteEntity(name=request.entity)
    return _of_error(reply.error)


def _spawn(request: Any, _: Node) -> Steps:
    """Both forms of the request: that of 1.x, and that of 2.x with a Resource."""
    resource = getattr(request, "entity_resource", request)
    text, model = resource.resource_string, _MODEL_URI.fullmatch(resource.uri)
    if resource.uri and (text or model is None):
        return result(
            UNSUPPORTED_FORMAT,
            f"uri: {resource.uri!r:.80}: must be model://NAME, or empty beside a resource_string",
        )
    if not (text or model):
        return result(NO_RESOURCE, "resource_string: must be SDF, URDF, or an entity in JSON")
    if request.entity_namespace:
        return result(NAMESPACE_UNSUPPORTED, "entity_namespace: must be empty")
    frame = request.initial_pose.header.frame_id
    if frame not in _WORLD_FRAMES:
        return result(INVALID_POSE, f"initial_pose.header.frame_id: {frame!r:.40}: must be map")
    read = act.ReadModelReply()
    if model is not None or text.lstrip().startswith("<"):
        named = "" if model is None else model[1]
        read = yield READ_MODEL, act.ReadModel(model=named, text=text)
        if read.error:
            return result(NO_RESOURCE if named else PARSE_ERROR, read.error)
    try:
        entity = read.entity or _ENTITY.validate_json(text)
        changes = _placed(request.initial_pose.pose)
        if request.name:
            changes["name"] = request.name
        wanted = doc.SpawnEntity(
            entity=entity.model_copy(update=changes), allow_renaming=request.allow_renaming,
            assets=read.assets,
        )  # fmt: skip
    except ValidationError as error:
        return result(PARSE_ERROR, f"resource_string: {one_line(error)}")
    if not request.allow_renaming and wanted.entity.name in (yield from _names()):
        return result(NAME_NOT_UNIQUE, f"name: {wanted.entity.name!r:.80}: is in use")
    reply = yield SPAWN_ENTITY, wanted
    if reply.error:
        return result(OPERATION_FAILED, reply.error)
    return {"entity_name": reply.name, **result()}


def _service(name: str, kind: str, owner: str, handle: Any, about: str) -> Service:
    return Service(name, f"simulation_interfaces/srv/{kind}", owner, handle, about)


SIMULATION_SERVICES: Final = (
    _service(
        "/get_simulator_features", "GetSimulatorFeatures", "physics", answered(_features),
        "what of simulation_interfaces there is",
    ),
    _service(
        "/get_simulation_state", "GetSimulationState", "physics", _get_state,
        "whether the simulation is playing or paused",
    ),
    _service(
        "/set_simulation_state", "SetSimulationState", "physics", _set_state, "play or pause"
    ),
    _service(
        "/reset_simulation", "ResetSimulation", "physics", _reset,
        "back to time 0: with everything, without what was spawned, or only the clock",
    ),
    _service(
        "/step_simulation", "StepSimulation", "physics", _step,
        "advance the paused simulation by some steps",
    ),
    _service(
        "/spawn_entity", "SpawnEntity", "spawner", _spawn,
        "spawn an entity: SDF, URDF, the name of a model, or the JSON of the query `/spawn_entity`",
    ),
    _service("/delete_entity", "DeleteEntity", "spawner", _delete, "delete an entity"),
    _service(
        "/get_entities", "GetEntities", "spawner", _get_entities, "the names of the entities"
    ),
    _service(
        "/get_entities_states", "GetEntitiesStates", "spawner", _get_entities_states,
        "the names and poses of the entities",
    ),
    _service(
        "/get_entity_state", "GetEntityState", "spawner", _get_entity_state,
        "the pose of an entity",
    ),
    _service(
        "/get_entity_info", "GetEntityInfo", "spawner", _get_entity_info,
        "whether an entity moves by itself, can be pushed or stays, and what it is",
    ),
    _service(
        "/get_entity_bounds", "GetEntityBounds", "spawner", _get_entity_bounds,
        "the box around an entity, in its own frame",
    ),
    _service(
        "/set_entity_state", "SetEntityState", "spawner", _set_entity_state,
        "move an entity to a pose",
    ),
)  # fmt: skip

SIMULATION_ACTIONS: Final = (
    Action(
        "/simulate_steps", "simulation_interfaces/action/SimulateSteps", "physics",
        _simulate_steps, (CLOCK,), _pause, _failed, "advance the paused simulation by some steps",
    ),
)  # fmt: skip
