"""Reads a bag of another robot."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from mazebot.cli.bags.bag import Bag, opened, problem_of
from mazebot.cli.replay.reading.bag_definitions import Decode, UnfitError, decoder_of
from mazebot.cli.replay.reading.bag_time import BagTime, stamp_of
from mazebot.cli.replay.reading.recording import Recording
from mazebot.cli.replay.reading.replayed import CLOCK_SERVICE, Replayed
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import MAP_FRAME, ODOM_FRAME
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.documents import Document
from mazebot.common.messages.topics import (
    BY_NAME,
    CAMERA_IMAGE,
    CLOCK,
    EDGE,
    GOAL_POSE,
    INITIAL_POSE,
    MAP,
    SIMULATION_STATS,
    TF,
    WORLD,
    Topic,
)
from mazebot.common.node.node import Envelope

_HEAD_MESSAGES = 5000
"""So many tell how the bag's time is related to the stamps."""
_CLOCK_PERIOD_NS = round(1e9 / (CLOCK.rate_hz or 60.0))
_LONGEST_SILENCE_NS = 60_000_000_000
_OF_CLIENTS = (GOAL_POSE.name, INITIAL_POSE.name)
_LATEST_NS = (2**31 - 1) * 1_000_000_000
"""The seconds of builtin_interfaces/msg/Time are an int32."""
_STEP_S = 1.0 / 240.0
_MAP_TEXT = MAP_FRAME.encode() + b"\0"


class _Channel(NamedTuple):
    topic: Topic[Any]
    decode: Decode | None
    """Where the bag's definition, or the form of a document, is another one."""


def open_bag(path: Path, slam: bool = False) -> Recording:
    """A bag, with what is needed besides for Mazebot's services to run against it: the world, of
    which nothing is known, and the clock. With `slam`, the robot gets no map, though there is one.

    Raises ConfigError where it cannot be read, or nothing in it fits.
    """
    recording = Recording(path.stem, 0, 0, lambda: iter(()), is_run=False, in_one_process=False)
    with opened(path, "replay") as bag:
        channels = _channels(bag.connections, recording)
        fitting = [one for one in bag.connections if one.id in channels]
        is_empty = next(bag.messages(fitting), None) is None
        made, recording.end_ns = _timed(bag, channels)
        services = _services(bag, channels)
    if is_empty:
        others = "; ".join(recording.lines_of_unfit()) or "it has none"
        raise ConfigError(f"replay: {path}: no usable messages: {others}")
    names = {channel.topic.name for channel in channels.values()}
    recording.pictures = "raw" if CAMERA_IMAGE.name in names else "none"
    recording.services = frozenset(services - {EDGE}) | {"worldgen", CLOCK_SERVICE}
    has_map = MAP.name in names and not slam

    def read() -> Iterator[Replayed]:
        recording.unfit.clear()
        recording.clock_set_back = len(made["moves_ns"])
        messages = _read(path, recording, channels, made)
        yield from _clocked(_beginning(recording.name, not has_map), messages)

    recording.read = read
    return recording


def _channels(connections: list[Any], recording: Recording) -> dict[int, _Channel]:
    """The connections that fit, by their id; of the others the reason is kept."""
    channels = {}
    for connection in connections:
        topic = BY_NAME.get(connection.topic)
        if topic is None:
            recording.left_out[connection.topic] = "not a topic of Mazebot"
        elif topic is CLOCK:
            continue
        elif problem := problem_of(connection):
            recording.left_out[connection.topic] = problem
        elif decode := wire.decoder_of_another_version(
            topic, connection.msgtype, connection.msgdef.data
        ):
            channels[connection.id] = _Channel(topic, decode)
        elif connection.msgtype != wire.type_name(topic):
            recording.left_out[connection.topic] = (
                f"is {connection.msgtype}: must be {wire.type_name(topic)}"
            )
        else:
            try:
                channels[connection.id] = _Channel(topic, decoder_of(connection))
            except UnfitError as error:
                recording.left_out[connection.topic] = str(error)
    return channels


def _services(bag: Bag, channels: dict[int, _Channel]) -> set[str]:
    """The services that send such messages in Mazebot."""
    services = {_service_of(channel.topic, None) for channel in channels.values()}
    # /tf has transforms of several.
    transforms = [one for one in bag.connections if one.id in channels and one.topic == TF.name]
    for connection, _, data in bag.messages(transforms):
        if _MAP_TEXT not in data:
            continue
        try:
            services.add(_service_of(TF, _decoded(channels[connection.id], data)))
        except wire.WireError:
            continue
        if "localization" in services:
            break
    return services


def _timed(bag: Bag, channels: dict[int, _Channel]) -> tuple[dict[str, Any], int]:
    """What BagTime is made of, and the end of the bag in it."""
    logged: list[tuple[int, int]] = []
    clock_ns: int | None = None
    first_ns: int | None = None
    start_ns: int | None = None
    for connection, log_ns, data in itertools.islice(bag.messages(), _HEAD_MESSAGES):
        start_ns = log_ns if start_ns is None else start_ns
        if connection.topic == CLOCK.name and clock_ns is None:
            clock_ns = _clock_of(connection, data)
        if connection.id in channels:
            first_ns = log_ns if first_ns is None else first_ns
            stamp_ns = stamp_of(connection.msgtype, data)
            if stamp_ns is not None:
                logged.append((log_ns, stamp_ns))
    made = {
        "logged": logged, "clock_ns": clock_ns, "first_ns": first_ns or 0,
        "moves_ns": bag.moves_ns,
    }  # fmt: skip
    time = BagTime(logged, clock_ns, bag.moves_ns)
    time.begin(made["first_ns"])  # type: ignore[arg-type]
    if clock_ns is None:
        return made, time.at(bag.end_ns, None)
    return made, max(bag.end_ns - (start_ns or 0), 0)


def _clock_of(connection: Any, data: bytes) -> int | None:
    try:
        if connection.msgtype == wire.type_name(CLOCK):
            return msg.ns_from_time(wire.decode(CLOCK, data).clock)
    except wire.WireError:
        pass
    return None


def _read(
    path: Path, recording: Recording, channels: dict[int, _Channel], made: dict[str, Any]
) -> Iterator[Replayed]:
    time = BagTime(made["logged"], made["clock_ns"], made["moves_ns"])
    time.begin(made["first_ns"])
    sequences: Counter[tuple[str, str]] = Counter()
    with opened(path, "replay", warns=False) as bag:
        for connection, log_ns, data in bag.messages():
            if connection.topic == CLOCK.name:
                clock_ns = _clock_of(connection, data)
                if clock_ns is not None:
                    time.take_clock(clock_ns)
                    recording.clock_set_back = max(time.set_back, len(made["moves_ns"]))
                continue
            channel = channels.get(connection.id)
            if channel is None:
                continue
            topic = channel.topic
            time_ns = time.at(log_ns, stamp_of(connection.msgtype, data))
            try:
                if time_ns > _LATEST_NS:
                    raise wire.WireError("log time later than ROS can tell")
                message = _fitted(channel, data, time)
                encoded = wire.encode(topic, message)
            except wire.WireError as error:
                recording.unfit[connection.topic, error.reason] += 1
                continue
            service = _service_of(topic, message)
            envelope = Envelope(service, sequences[service, topic.name], time_ns, "")
            sequences[service, topic.name] += 1
            yield Replayed(topic, encoded, service, envelope, time_ns)
        recording.left_out |= bag.damaged


def _decoded(channel: _Channel, data: bytes) -> Any:
    """A bag's message. Raises WireError where it cannot be read."""
    if channel.decode is None:
        return wire.decode(channel.topic, data)
    try:
        message = channel.decode(data)
    except wire.WireError:
        raise
    except Exception as error:
        raise wire.WireError("malformed", str(error)) from error
    if issubclass(channel.topic.type, Document) and not isinstance(message, Document):
        return wire.document_of(channel.topic.type, message)
    return message


def _fitted(channel: _Channel, data: bytes, time: BagTime) -> Any:
    """A bag's message, valid, with its stamps from 0, and frames as in ROS 2.

    Raises WireError where it is not valid.
    """
    message = _decoded(channel, data)
    _name_frames(message)
    wire.validate(channel.topic, message)
    time.shift(message, wire.type_name(channel.topic))
    return message


def _name_frames(message: Any) -> None:
    """In ROS 1 the names of frames may begin with a slash, in ROS 2 they must not."""
    for one in (message, *getattr(message, "transforms", ())):
        header = getattr(one, "header", None)
        if isinstance(header, msg.Header):
            header.frame_id = header.frame_id.lstrip("/")
        if isinstance(getattr(one, "child_frame_id", None), str):
            one.child_frame_id = one.child_frame_id.lstrip("/")


def _service_of(topic: Topic[Any], message: Any) -> str:
    """The service that sends such a message in Mazebot."""
    if topic is TF and message is not None:
        frames = {(one.header.frame_id, one.child_frame_id) for one in message.transforms}
        return "localization" if frames == {(MAP_FRAME, ODOM_FRAME)} else CLOCK_SERVICE
    return EDGE if topic.name in _OF_CLIENTS else topic.owners[0]


def _beginning(name: str, slam: bool) -> Iterator[Replayed]:
    """A world of which nothing is known, and that its simulation has begun."""
    world = doc.World(
        name=name, recipe="", hash="", walls=(), materials=(), slam=slam,
        start=doc.Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0),
    )  # fmt: skip
    world = world.model_copy(update={"hash": world.content_hash()})
    stats = doc.SimulationStats(
        world_hash=world.hash, sim_time_s=0.0, iterations=0, step_size_s=_STEP_S, renderer="none",
        state_hash="",
    )  # fmt: skip
    messages: tuple[tuple[Topic[Any], Any, str], ...] = (
        (WORLD, world, "worldgen"),
        (SIMULATION_STATS, stats, CLOCK_SERVICE),
    )
    for topic, message, service in messages:
        yield Replayed(topic, wire.encode(topic, message), service, Envelope(service, 0, 0, ""), 0)


def _clocked(beginning: Iterator[Replayed], messages: Iterator[Replayed]) -> Iterator[Replayed]:
    """All messages, and those of the clock among them; where nothing comes for long, it jumps."""
    yield from beginning
    ticks = sequence = 0
    for message in messages:
        if message.time_ns - ticks * _CLOCK_PERIOD_NS > _LONGEST_SILENCE_NS:
            # A stamp may be years off.
            ticks = message.time_ns // _CLOCK_PERIOD_NS
        while (time_ns := ticks * _CLOCK_PERIOD_NS) <= message.time_ns:
            data = wire.encode(CLOCK, msg.Clock(clock=msg.time_from_ns(time_ns)))
            envelope = Envelope(CLOCK_SERVICE, sequence, time_ns, "")
            yield Replayed(CLOCK, data, CLOCK_SERVICE, envelope, time_ns)
            ticks += 1
            sequence += 1
        yield message
