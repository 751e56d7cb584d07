"""The feed: what arrives from the stack is drawn once, and offered to each page that is open.

A page that does not keep up gets the newest of each kind; it costs the others, and the robot,
nothing. Without a page nothing is received or drawn, but for a moment: a page that is loaded again
misses nothing.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import threading
from collections import OrderedDict, deque
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any

from mazebot.common.client.robot import Robot
from mazebot.common.messages.topics import CAMERA_IMAGE, Delivery, Topic
from mazebot.common.node.node import Envelope
from mazebot.console.live.frame import Frame, text_frame
from mazebot.console.live.history import MOST_LINES, History
from mazebot.console.live.view import CAMERA, WATCHED, View

_LOG = logging.getLogger("console")

PERIOD_S = 0.07
"""Between two pictures: about 14 a second."""
CAMERA_EVERY = 3
"""Pictures of the feed for one of the camera."""
_CAMERA_LASTS_S = 1.0
"""Simulation time, after which a picture shows nothing of now."""
_SHOWN_S = 1.0
"""For so long an answer waits for the frames before it."""
MAX_PAGES = 32
LINGER_S = 60.0
"""For so long it goes on without a page."""
MAX_EVENTS = 2 * MOST_LINES
"""Events that wait for a page: beyond it the oldest are dropped."""
_MAX_WAITING = 500
"""Events that wait to be drawn; and messages of all other kinds and sources."""
RESTARTED = "restarted"
"""The kind of the frame after which a page begins anew."""
_LASTING = {"world", "map", "entities", "stack", "stats", "global_costmap"}
"""Kinds that stay valid when the simulation restarts, or may have come again already."""


class Outgoing:
    """What waits to be sent to one page."""

    def __init__(self) -> None:
        self._waiting: OrderedDict[str | int, Frame] = OrderedDict()
        """In the order in which they came: states by their kind, events by their number."""
        self._events: deque[int] = deque()
        """The numbers of the events that wait."""
        self._numbers = itertools.count()
        self._news = asyncio.Event()
        self.wants_camera = False
        self.has_camera = False
        """Whether it has got a picture since it wants them."""
        self.dropped = 0
        """Frames that were replaced or dropped before they were sent."""

    def offer(self, frame: Frame) -> None:
        """Queue a frame. A state replaces the older one of its kind, and a restart all states that
        have ended with it.
        """
        if frame.kind == RESTARTED:
            for kind in [kind for kind in self._waiting if isinstance(kind, str)]:
                if kind not in _LASTING:
                    del self._waiting[kind]
        if not frame.is_event:
            self.dropped += self._waiting.pop(frame.kind, None) is not None
            self._waiting[frame.kind] = frame
        else:
            if len(self._events) == MAX_EVENTS:
                self.dropped += 1
                del self._waiting[self._events.popleft()]
            self._events.append(next(self._numbers))
            self._waiting[self._events[-1]] = frame
        self._news.set()

    async def taken(self) -> list[Frame]:
        """Wait for frames, and take all of them."""
        await self._news.wait()
        self._news.clear()
        frames = [*self._waiting.values()]
        self._waiting.clear()
        self._events.clear()
        return frames


class Feed:
    """Shared by all pages. Its methods run on the event loop, except `_receive`."""

    def __init__(self, robot: Robot, how_to_start: str) -> None:
        """`how_to_start`: what to do where no stack is running, in one line."""
        self._robot = robot
        self._how_to_start = how_to_start
        self._pages: set[Outgoing] = set()
        self._begun: set[Outgoing] = set()
        """Those that have got nothing yet: they begin with all that is known."""
        self._lock = threading.Lock()
        self._states: dict[tuple[str, str], tuple[Topic[Any], Any]] = {}
        self._events: deque[tuple[Topic[Any], Any]] = deque(maxlen=_MAX_WAITING)
        self._history = History()
        self._view = View(self._history)
        self._newest: dict[str, Frame] = {}
        self._beat: asyncio.Task[None] | None = None
        self._offered = asyncio.Event()
        """Set with the next frames."""
        self._rest: asyncio.TimerHandle | None = None
        self._ends: list[Callable[[], None]] = []
        self._camera_ends: Callable[[], None] | None = None
        self._camera: tuple[float, Frame] | None = None
        """The last picture, and the simulation's time when it came, s."""
        self._pictures = 0
        self._was_there = False
        self._told: set[str] = set()
        """Kinds that pages have been told since the services came."""

    @property
    def pages(self) -> int:
        """How many pages are open."""
        return len(self._pages)

    @contextlib.asynccontextmanager
    async def page(self) -> AsyncIterator[Outgoing]:
        """The queue of one page while the context lasts."""
        outgoing = Outgoing()
        self._pages.add(outgoing)
        self._begun.add(outgoing)
        if self._rest is not None:
            self._rest.cancel()
            self._rest = None
        if self._beat is None:
            self._beat = asyncio.create_task(self._run())
        try:
            yield outgoing
        finally:
            self._pages.discard(outgoing)
            self._begun.discard(outgoing)
            if not self._pages:
                self._rest = asyncio.get_running_loop().call_later(LINGER_S, self._end)

    async def shown(self) -> None:
        """Return when all that was received before is offered, or after a second at the latest."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_SHOWN_S):
                # Those that are being drawn may have been taken before.
                for _ in range(2):
                    await self._offered.wait()

    def _end(self) -> None:
        """No page has come back."""
        if self._beat is not None and not self._pages:
            self._beat.cancel()
            self._beat = None

    async def _run(self) -> None:
        """Draw and offer, as long as a page is open."""
        end = await asyncio.to_thread(self._robot.watch, WATCHED, self._receive)
        try:
            while True:
                await asyncio.sleep(PERIOD_S)
                await self._watch_camera()
                try:
                    frames = await asyncio.to_thread(self._drawn)
                except Exception as error:
                    # What cannot be drawn must not end the feed of all pages.
                    _LOG.error("live page: %s: %s", type(error).__name__, error)
                    continue
                for page in self._begun:
                    for frame in (*self._newest.values(), *self._history.frames()):
                        page.offer(frame)
                for frame in frames:
                    for page in self._pages - self._begun:
                        if frame.kind != "camera":
                            page.offer(frame)
                self._offer_camera(frames)
                self._begun.clear()
                self._offered.set()
                self._offered = asyncio.Event()
        finally:
            end()
            if self._camera_ends is not None:
                self._camera_ends()
                self._camera_ends = None
            with self._lock:
                self._states.clear()
                self._events.clear()
            # The history stays: it belongs to the run that a later page may find.
            self._view, self._newest = View(self._history), {}

    def _offer_camera(self, frames: Sequence[Frame]) -> None:
        """Offer a picture to the pages that want it: the newest, and to one that has none yet the
        last, which is what the camera sees while the simulation is paused.
        """
        new = [frame for frame in frames if frame.kind == "camera"]
        if new:
            self._camera = self._history.time_s, new[-1]
        last = self._camera
        if last is not None and abs(self._history.time_s - last[0]) > _CAMERA_LASTS_S:
            last = self._camera = None
        for page in self._pages:
            if page.wants_camera and last is not None and (new or not page.has_camera):
                page.offer(last[1])
                page.has_camera = True
            page.has_camera &= page.wants_camera

    async def _watch_camera(self) -> None:
        wanted = any(page.wants_camera for page in self._pages)
        if wanted and self._camera_ends is None:
            self._camera_ends = await asyncio.to_thread(self._robot.watch, CAMERA, self._receive)
        elif not wanted and self._camera_ends is not None:
            self._camera_ends()
            self._camera_ends = None

    def _receive(self, topic: Topic[Any], message: Any, envelope: Envelope) -> None:
        """Store a message; on a thread of the robot."""
        with self._lock:
            if topic.delivery is Delivery.EVERY:
                self._events.append((topic, message))
                return
            key = topic.name, envelope.source
            if key in self._states or len(self._states) < _MAX_WAITING:
                self._states[key] = topic, message

    def _drawn(self) -> list[Frame]:
        """The frames of what has arrived since the last call."""
        self._pictures += 1
        with self._lock:
            arrived = [*self._states.values(), *self._events]
            kept: list[tuple[tuple[str, str], tuple[Topic[Any], Any]]] = []
            if self._pictures % CAMERA_EVERY:
                kept = [
                    (key, one)
                    for key, one in self._states.items()
                    if one[0].name == CAMERA_IMAGE.name
                ]
                arrived = [one for one in arrived if one[0].name != CAMERA_IMAGE.name]
            self._states = dict(kept)
            self._events.clear()
        frames = self._view.frames(arrived)
        services = sorted(self._robot.alive())
        frames.append(_stack_frame(services, self._how_to_start))
        has_gone, self._was_there = self._was_there and not services, bool(services)
        if has_gone:
            # Of the stack that comes next a page is told all, also what is as before.
            self._told.clear()
        if self._view.restarted:
            # What was latched has come again, or comes soon.
            self._newest = {kind: one for kind, one in self._newest.items() if kind in _LASTING}
            self._camera = None
            frames.insert(0, text_frame(RESTARTED, {}, is_event=True))
        changed = []
        for frame in frames:
            if frame.is_event:
                self._history.add_event(frame)
            elif frame.kind != "camera":
                if frame.kind in self._told and self._newest.get(frame.kind) == frame:
                    continue
                if frame.kind in self._newest or len(self._newest) < _MAX_WAITING:
                    self._newest[frame.kind] = frame
                    self._told.add(frame.kind)
            changed.append(frame)
        return changed


def _stack_frame(services: list[str], how_to_start: str) -> Frame:
    return text_frame(
        "stack", {"services": services, "how_to_start": "" if services else how_to_start}
    )
