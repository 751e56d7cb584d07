"""A client of Foxglove's websocket protocol."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, NamedTuple, Self

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

DEADLINE_S = 60.0


class Seen(NamedTuple):
    """A message as a client gets it."""

    topic: str
    log_ns: int
    data: bytes


class FoxgloveClient:
    """The other end of the websocket."""

    def __init__(self, port: int, reads_on: bool = True) -> None:
        """`reads_on`: what comes is read from the network even while no test waits for it."""
        self._connecting = connect(
            f"ws://127.0.0.1:{port}",
            subprotocols=[Subprotocol("foxglove.sdk.v1")],
            max_size=None,
            max_queue=None if reads_on else 1,
            open_timeout=30.0,
            close_timeout=0.2,
            # Who does not read answers no ping.
            ping_interval=20.0 if reads_on else None,
        )
        self.socket: ClientConnection
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.seen: list[Seen] = []
        self.times_ns: list[int] = []
        self.said: list[dict[str, Any]] = []
        self.answers: dict[int, Any] = {}
        self._topics: dict[int, str] = {}
        self._calls = 0

    def __enter__(self) -> Self:
        self.socket = self._connecting.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._connecting.__exit__(kind, error, traceback)

    def take(self, timeout_s: float = 0.2) -> None:
        """Take one frame in, if there is one."""
        try:
            frame = self.socket.recv(timeout_s)
        except TimeoutError:
            return
        if isinstance(frame, str):
            said = json.loads(frame)
            self.said.append(said)
            if said["op"] == "advertise":
                self.channels |= {one["topic"]: one for one in said["channels"]}
            elif said["op"] == "advertiseServices":
                self.services |= {one["name"]: one for one in said["services"]}
            elif said["op"] == "serviceCallFailure":
                self.answers[said["callId"]] = said["message"]
        elif frame[0] == 1:
            number, log_ns = struct.unpack_from("<IQ", frame, 1)
            self.seen.append(Seen(self._topics[number], log_ns, frame[13:]))
        elif frame[0] == 2:
            self.times_ns.append(struct.unpack_from("<Q", frame, 1)[0])
        elif frame[0] == 3:
            _, call, length = struct.unpack_from("<III", frame, 1)
            self.answers[call] = json.loads(frame[13 + length :])

    def wait_for(self, holds: Callable[[], Any], timeout_s: float = DEADLINE_S) -> Any:
        """Take frames in until a condition holds; what it gave."""
        end_s = time.monotonic() + timeout_s
        while not (found := holds()):
            assert time.monotonic() < end_s, f"it never came to pass; last: {self.said[-1]['op']}"
            self.take()
        return found

    def subscribe(self, *topics: str) -> None:
        """Subscribe, once the channels are there."""
        self.wait_for(lambda: set(topics) <= self.channels.keys())
        subscriptions = []
        for topic in topics:
            number = len(self._topics) + 1
            self._topics[number] = topic
            subscriptions.append({"id": number, "channelId": self.channels[topic]["id"]})
        self.tell(op="subscribe", subscriptions=subscriptions)

    def of(self, topic: str) -> list[Seen]:
        """What has come on a topic."""
        return [one for one in self.seen if one.topic == topic]

    def tell(self, **what: Any) -> None:
        """Send a frame of text."""
        self.socket.send(json.dumps(what))

    def publish(
        self, number: int, topic: str, kind: str, data: bytes, encoding: str = "cdr"
    ) -> None:
        """Advertise a channel of that number, and publish on it."""
        channel = {"id": number, "topic": topic, "encoding": encoding, "schemaName": kind}
        self.tell(op="advertise", channels=[channel])
        self.send(number, data)

    def send(self, number: int, data: bytes) -> None:
        """Publish on an advertised channel."""
        self.socket.send(struct.pack("<BI", 1, number) + data)

    def call(self, service: str, **request: Any) -> Any:
        """Call a service; its answer, or the text of its failure."""
        self.wait_for(lambda: service in self.services)
        self._calls += 1
        call, encoding = self._calls, b"json"
        head = struct.pack("<BIII", 2, self.services[service]["id"], call, len(encoding))
        self.socket.send(head + encoding + json.dumps(request).encode())
        self.wait_for(lambda: call in self.answers)
        return self.answers[call]

    def parameters(self, request: str, **what: Any) -> dict[str, Any]:
        """The answer to a request about parameters, by their names."""
        self.tell(id=request, **what)

        def answer() -> list[dict[str, Any]]:
            return [one for one in self.said if one.get("id") == request]

        (found,) = self.wait_for(answer)
        return {one["name"]: one.get("value") for one in found["parameters"]}

    def complaints(self) -> list[str]:
        """The lines that the server has shown."""
        return [one["message"] for one in self.said if one["op"] == "status"]
