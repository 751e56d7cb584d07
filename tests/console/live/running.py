"""A run with its console, and a page that speaks its protocol."""

from __future__ import annotations

import itertools
import json
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from mazebot.common.node.executive import Executive
from mazebot.console.config import ConsoleConfig
from mazebot.embedded.beside import Beside, BusBeside
from mazebot.embedded.demo import DemoOptions, build_nodes

DEADLINE_S = 60.0


class Run:
    """The console of a run, and the run's executive."""

    def __init__(self, beside: Beside, executive: Executive) -> None:
        self.beside = beside
        self.executive = executive
        self.robot = beside.robot

    def page(self, takes_all: bool = True) -> Page:
        """A page; it is open while its context lasts."""
        return Page(self.beside.url, takes_all)


@contextmanager
def running(options: DemoOptions, open_bus: Callable[[], BusBeside] | None = None) -> Iterator[Run]:
    """A run that goes on, on a thread of its own, with its console on any free port."""
    beside = Beside(ConsoleConfig(port=0), open_bus)
    executive = Executive(build_nodes(options), beside.transport)
    stopped = threading.Event()
    thread = threading.Thread(target=lambda: beside.play(executive, stopped.is_set))
    thread.start()
    try:
        wait_until(lambda: bool(beside.robot.alive()))
        yield Run(beside, executive)
    finally:
        stopped.set()
        thread.join()
        beside.close()
        executive.close()


def wait_until(holds: Callable[[], Any], timeout_s: float = DEADLINE_S) -> None:
    """Return as soon as a condition holds. Raises AssertionError where it never does."""
    end_s = time.monotonic() + timeout_s
    while not holds():
        assert time.monotonic() < end_s, "it never came to pass"
        time.sleep(0.01)


class Page:
    """The other end of the websocket."""

    def __init__(self, url: str, takes_all: bool = True) -> None:
        """`takes_all`: what comes is read from the network even while no test waits for it."""
        address = url.rstrip("/").replace("http:", "ws:") + "/live/feed"
        self._connecting = connect(
            address,
            origin=Origin(url.rstrip("/")),
            max_size=None,
            # With a limit, a client of websockets 17 that has stopped reading may never go on.
            max_queue=None if takes_all else 16,
            open_timeout=20.0,
            close_timeout=0.5,
        )
        self.socket: ClientConnection
        self.newest: dict[str, Any] = {}
        self.events: list[tuple[str, Any]] = []
        self.answers: dict[int | None, dict[str, Any]] = {}
        self._numbers = itertools.count(1)

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

    def take(self, timeout_s: float = 5.0) -> str:
        """Take one frame in; its kind, or "" where none came."""
        try:
            data = self.socket.recv(timeout_s)
        except TimeoutError:
            return ""
        if isinstance(data, bytes):
            (length,) = struct.unpack_from("<I", data)
            head = json.loads(data[4 : 4 + length])
            self.newest[head["kind"]] = head | {"data": data[4 + length :]}
            return str(head["kind"])
        frame = json.loads(data)
        kind, content = frame["kind"], frame["content"]
        self.newest[kind] = content
        if kind == "answer":
            self.answers[content["id"]] = content
        elif kind in ("log", "action_result", "navigation_result", "contact"):
            self.events.append((kind, content))
        return str(kind)

    def wait_for(self, holds: Callable[[], Any], timeout_s: float = DEADLINE_S) -> Any:
        """Take frames in until a condition holds; what it gave."""
        end_s = time.monotonic() + timeout_s
        while not (found := holds()):
            assert time.monotonic() < end_s, f"it never came to pass; newest: {self.newest.keys()}"
            self.take(0.2)
        return found

    def wait_kind(self, kind: str) -> Any:
        """The newest frame of a kind, once there is one."""
        self.wait_for(lambda: kind in self.newest)
        return self.newest[kind]

    def tell(self, **action: Any) -> int:
        """Send what the page wants; the message's id."""
        number = next(self._numbers)
        self.socket.send(json.dumps({"id": number, "action": action}))
        return number

    def ask(self, **action: Any) -> dict[str, Any]:
        """Send what the page wants; the answer."""
        number = self.tell(**action)
        self.wait_for(lambda: number in self.answers)
        return self.answers[number]

    def ask_quietly(self, **action: Any) -> dict[str, Any] | None:
        """As `ask`; None where no answer comes within a second."""
        number = self.tell(**action)
        end_s = time.monotonic() + 1.0
        while number not in self.answers and time.monotonic() < end_s:
            self.take(0.1)
        return self.answers.get(number)

    def done(self, **action: Any) -> str:
        """As `ask`; it must not be refused."""
        answer = self.ask(**action)
        assert answer["error"] == "", answer
        return str(answer["said"])
