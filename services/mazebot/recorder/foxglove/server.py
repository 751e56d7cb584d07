"""A run live in Foxglove: the channels of `run.mcap`, and what the app may ask for."""

from __future__ import annotations

import logging
import queue
import threading
from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from foxglove import Channel, Context, Schema, StatusLevel, start_server
from foxglove.websocket import (
    Capability,
    ChannelView,
    Client,
    ClientChannel,
    Parameter,
    ServerListener,
)

from mazebot.common.client.robot import Robot
from mazebot.common.config import ConfigError, printable
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import (
    GOAL_POSE,
    NAVIGATION_RESULT,
    PARAMETERS,
    SIMULATION_STATS,
    Topic,
    read_by,
)
from mazebot.common.recordings.mcap.mcap_channels import definition_of
from mazebot.recorder.foxglove.graph import connection_graph
from mazebot.recorder.foxglove.parameters import RunParameters
from mazebot.recorder.foxglove.published import (
    CDR,
    JSON,
    PublishedError,
    message_of,
    topic_of,
)
from mazebot.recorder.foxglove.services import services_of
from mazebot.recorder.stream.latched import Latched
from mazebot.recorder.stream.message_log import Compressed, Pieces, Taken

_LOG = logging.getLogger("recorder")
LAYOUT = Path(__file__).with_name("layout.json")
"""A layout for the app, by its menu `Import from file`."""
BACKLOG = 256
"""Messages that wait for a slow client before its oldest ones are dropped."""
_MOST_WAITING = 2000
"""Messages that wait for this server's thread before further ones are dropped."""
_MOST_GOALS = 100
_END_TIMEOUT_S = 1.0
_Task = Callable[[], None]


class FoxgloveServer:
    """Serves any number of clients. Everything that takes long, as an image that is still being
    rendered, is done in a thread, and only for what a client has subscribed to.
    """

    def __init__(self, bind: str, port: int, robot: Robot | None = None) -> None:
        """`robot`: what the app publishes and asks for goes there; None: it only looks on.

        Raises ConfigError where the port is in use.
        """
        self._robot = robot
        self._parameters = RunParameters(robot)
        self._latched = Latched()
        self._services: set[str] = set()
        self._complaint = ""
        # The stamps of the latest goals that clients have sent.
        self._goals: deque[int] = deque(maxlen=_MOST_GOALS)
        self._subscribers: Counter[str] = Counter()
        self._advertised: dict[tuple[int, int], ClientChannel] = {}
        self._tasks: queue.SimpleQueue[_Task | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="foxglove", daemon=True)
        # The SDK lets go of a context that nobody holds, and of its channels.
        self._context = context = Context()
        self._channels = {topic.name: _channel(topic, context) for topic in read_by("recorder")}
        can = [Capability.Time, Capability.Parameters, Capability.ConnectionGraph]
        if robot is not None:
            can += [Capability.ClientPublish, Capability.Services]
        try:
            self._server = start_server(
                name="mazebot",
                host=bind,
                port=port,
                capabilities=can,
                server_listener=_Listener(self),
                supported_encodings=[CDR, JSON],
                services=[] if robot is None else services_of(robot),
                context=context,
                message_backlog_size=BACKLOG,
            )
        except (RuntimeError, OSError, ValueError) as error:
            raise ConfigError(f"foxglove_port: port {port} on {bind}: {error}") from error
        self.port = self._server.port
        """On which it listens."""
        self._thread.start()

    def wants(self, name: str) -> bool:
        """Whether a client has subscribed to a topic."""
        return self._subscribers[name] > 0

    def keep(self, topic: Topic[Any], taken: Taken, now_ns: int) -> None:
        """Send a message on a latched topic, and keep it for clients to come."""
        if topic is PARAMETERS:
            self._parameters.take(taken.message)
            self._put(lambda: self._announce(taken.message))
        elif topic is SIMULATION_STATS:
            self._parameters.take_stats(taken.message)
        self._put(lambda: self._latched.keep(topic, taken), always=True)
        self.add(topic, taken, now_ns)

    def add(
        self, topic: Topic[Any], taken: Taken, now_ns: int, compressed: Compressed | None = None
    ) -> None:
        """Send a message, and what is recorded in its place."""
        time_ns = taken.envelope.sent_ns or now_ns
        if compressed is not None and self.wants(compressed.topic_name):
            self._send(compressed.topic_name, compressed.make, time_ns)
        if self.wants(topic.name):
            self._send(topic.name, taken.pieces, time_ns)
        if topic is NAVIGATION_RESULT:
            self._put(lambda: self._judge(taken.message), always=True)

    def set_time(self, now_ns: int) -> None:
        """Tell the clients the simulation's time."""
        self._put(lambda: self._server.broadcast_time(max(now_ns, 0)))

    def begin(self) -> None:
        """The simulation begins again: clients forget what they have."""
        self._put(self._server.clear_session, always=True)

    def forget(self, topic: Topic[Any]) -> None:
        """Drop the messages that are kept of a topic."""
        self._put(lambda: self._latched.forget(topic), always=True)

    def close(self) -> None:
        """End all connections."""
        self._server.stop()
        self._put(None, always=True)
        self._thread.join(_END_TIMEOUT_S)

    def subscribed(self, name: str) -> None:
        """A client has subscribed; called on a thread of the server."""
        self._subscribers[name] += 1
        self._put(lambda: self._send_latched(name), always=True)

    def unsubscribed(self, name: str) -> None:
        """A client has left a topic."""
        self._subscribers[name] -= 1

    def advertised(self, client: int, channel: ClientChannel) -> None:
        """A client is about to publish."""
        try:
            topic_of(channel.topic, channel.schema_name)
            if channel.encoding not in (CDR, JSON):
                raise PublishedError(
                    f"{channel.topic}: {channel.encoding}: must be {CDR} or {JSON}"
                )
        except PublishedError as error:
            self._complain(str(error))
        else:
            self._advertised[client, channel.id] = channel

    def unadvertised(self, client: int, channel: int) -> None:
        """A client publishes no more."""
        self._advertised.pop((client, channel), None)

    def published(self, client: int, number: int, data: bytes) -> None:
        """A client has published."""
        channel = self._advertised.get((client, number))
        if channel is None or self._robot is None:
            return
        try:
            topic = topic_of(channel.topic, channel.schema_name)
            message = message_of(
                topic, channel.schema_name, data, channel.encoding, self._robot.now_ns()
            )
            if topic is GOAL_POSE:
                self._goals.append(msg.ns_from_time(message.header.stamp))
            self._robot.publish(topic, message)
        except ConfigError as error:
            self._complain(str(error))

    def parameters(self, names: list[str]) -> list[Parameter]:
        """The parameters of some names; of none: all."""
        return self._parameters.get(names)

    def set_parameters(self, wanted: list[Parameter]) -> list[Parameter]:
        """Set what can be set at run time; returns all these parameters as they are afterwards."""
        for parameter in wanted:
            try:
                self._parameters.set(parameter)
            except ConfigError as error:
                self._complain(str(error))
        return self._parameters.get([parameter.name for parameter in wanted])

    def _judge(self, result: doc.NavigationResult) -> None:
        """Tell why a client's goal was refused, or not reached."""
        wanted = result.error_code not in (
            ErrorCode.NONE, ErrorCode.PREEMPTED, ErrorCode.CANCELED
        )  # fmt: skip
        if wanted and result.goal_stamp_ns in self._goals:
            self._complain(f"{GOAL_POSE.name}: error {result.error_code}: {result.error_msg}")

    def _complain(self, line: str) -> None:
        """Tell the app, and the log: a client that repeats itself, once."""
        line = printable(line)
        self._server.publish_status(line, StatusLevel.Error)
        if line != self._complaint:
            self._complaint = line
            _LOG.warning("Foxglove: %s", line)

    def _announce(self, parameters: doc.Parameters) -> None:
        """A service has told its parameters."""
        self._services.add(parameters.service)
        self._server.publish_parameter_values(self._parameters.of(parameters.service))
        self._server.publish_connection_graph(connection_graph(self._services))

    def _send(self, name: str, pieces: Pieces | Callable[[], Pieces], time_ns: int) -> None:
        channel = self._channels[name]

        def send() -> None:
            made = pieces() if callable(pieces) else pieces
            channel.log(b"".join(made), log_time=max(time_ns, 0))

        self._put(send)

    def _send_latched(self, name: str) -> None:
        for topic, taken in self._latched:
            if topic.name == name:
                made = taken.pieces() if callable(taken.pieces) else taken.pieces
                self._channels[name].log(b"".join(made), log_time=max(taken.envelope.sent_ns, 0))

    def _put(self, task: _Task | None, always: bool = False) -> None:
        """Have the thread do something; unless `always`, only where it is not far behind."""
        if always or self._tasks.qsize() < _MOST_WAITING:
            self._tasks.put(task)

    def _run(self) -> None:
        while (task := self._tasks.get()) is not None:
            task()


def _channel(topic: Topic[Any], context: Context) -> Channel:
    kind = wire.type_name(topic)
    schema = Schema(name=kind, encoding="ros2msg", data=definition_of(kind).encode())
    return Channel(topic.name, schema=schema, message_encoding=CDR, context=context)


class _Listener(ServerListener):
    """What the clients do. See ServerListener."""

    def __init__(self, server: FoxgloveServer) -> None:
        self._server = server

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self._server.subscribed(channel.topic)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        self._server.unsubscribed(channel.topic)

    def on_client_advertise(self, client: Client, channel: ClientChannel) -> None:
        self._server.advertised(client.id, channel)

    def on_client_unadvertise(self, client: Client, client_channel_id: int) -> None:
        self._server.unadvertised(client.id, client_channel_id)

    def on_message_data(self, client: Client, client_channel_id: int, data: bytes) -> None:
        self._server.published(client.id, client_channel_id, data)

    def on_get_parameters(
        self, client: Client, param_names: list[str], request_id: str | None = None
    ) -> list[Parameter]:
        return self._server.parameters(param_names)

    def on_set_parameters(
        self, client: Client, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        return self._server.set_parameters(parameters)
