"""The live page and its websocket."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from mazebot.common.client.robot import HOW_TO_START, Robot, RobotError
from mazebot.console.live.commands import carry_out
from mazebot.console.live.feed import MAX_PAGES, Feed, Outgoing
from mazebot.console.live.frame import text_frame
from mazebot.console.live.page_messages import (
    Drive,
    RefusedError,
    Show,
    Stop,
    read_message,
)
from mazebot.console.live.teleoperation import Teleoperation
from mazebot.console.login import OPERATOR, role_of
from mazebot.console.pages import page
from mazebot.console.viewer_assets import live_data_of, viewer_policy, viewer_version

SEND_TIMEOUT_S = 15.0
"""A page that takes nothing for so long is given up."""
_LAST_MESSAGES_S = 0.2
"""For what came before a page went, where it was the sending that found out."""
MESSAGES_PER_S, BURST = 40.0, 80.0
"""What a page may send: it repeats a velocity ten times a second."""
MAX_PENDING = 8
"""Requests of one page that wait for their answers."""
_CLOSE_POLICY, _CLOSE_TOO_MANY = 1008, 1013


def live_routes(robot: Robot, how_to_start: str = HOW_TO_START) -> list[BaseRoute]:
    """The routes of the live page of a robot; `how_to_start`: what to do where no stack is
    running, in one line.
    """
    feed = Feed(robot, how_to_start)

    async def show(request: Request) -> Response:
        live_data = live_data_of(request)
        return page(
            request,
            "live.html",
            headers={"content-security-policy": viewer_policy(live_data)},
            section="live",
            viewer=viewer_version(),
            live_data=live_data,
        )

    async def connect(websocket: WebSocket) -> None:
        await websocket.accept()
        if feed.pages >= MAX_PAGES:
            await websocket.close(_CLOSE_TOO_MANY, f"{MAX_PAGES} pages are open already")
            return
        async with feed.page() as outgoing:
            may_drive = role_of(websocket.scope) == OPERATOR
            await _Page(robot, feed, websocket, outgoing, may_drive).serve()

    return [Route("/live", show), WebSocketRoute("/live/feed", connect)]


class _Page:
    """One open page."""

    def __init__(
        self,
        robot: Robot,
        feed: Feed,
        websocket: WebSocket,
        outgoing: Outgoing,
        may_drive: bool,
    ) -> None:
        self._robot = robot
        self._feed = feed
        self._may_drive = may_drive
        self._websocket = websocket
        self._outgoing = outgoing
        self._teleoperation = Teleoperation(robot)
        self._allowance = BURST
        self._counted_s = time.monotonic()
        self._complained = False
        self._pending: set[asyncio.Task[None]] = set()

    async def serve(self) -> None:
        """Return when the page has gone."""
        receiving = asyncio.create_task(self._receive())
        tasks = [asyncio.create_task(self._send()), receiving]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            self._teleoperation.stop()
            # What a page has sent before it went counts.
            await asyncio.wait([receiving], timeout=_LAST_MESSAGES_S)
        finally:
            self._teleoperation.stop()
            for task in (*tasks, *self._pending):
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            with contextlib.suppress(WebSocketDisconnect, RuntimeError, TimeoutError):
                async with asyncio.timeout(1.0):
                    await self._websocket.close()

    async def _send(self) -> None:
        with contextlib.suppress(WebSocketDisconnect, RuntimeError, TimeoutError):
            while True:
                for frame in await self._outgoing.taken():
                    async with asyncio.timeout(SEND_TIMEOUT_S):
                        if isinstance(frame.content, bytes):
                            await self._websocket.send_bytes(frame.content)
                        else:
                            await self._websocket.send_text(frame.content)

    async def _receive(self) -> None:
        # A page that has gone, or sends bytes.
        with contextlib.suppress(WebSocketDisconnect, KeyError, RuntimeError):
            while True:
                text = await self._websocket.receive_text()
                if self._may_send():
                    self._take(text)

    def _may_send(self) -> bool:
        """Whether the page keeps to its rate; if not, it gets one error."""
        now_s = time.monotonic()
        earned = (now_s - self._counted_s) * MESSAGES_PER_S
        self._counted_s = now_s
        self._allowance = min(self._allowance + earned, BURST)
        if self._allowance >= 1.0:
            self._allowance -= 1.0
            self._complained = False
            return True
        if not self._complained:
            self._complained = True
            self._answer(
                None, "", f"message: too many: must be at most {MESSAGES_PER_S:g} a second"
            )
        return False

    def _take(self, text: str) -> None:
        try:
            message = read_message(text)
        except RefusedError as error:
            self._answer(_id_of(text), "", str(error))
            return
        action, number = message.action, message.id
        if not self._may_drive and not isinstance(action, Show | Stop):
            told = "a viewer may only look on: log in with the operator's token"
            self._answer(number, "", f"{action.do}: {told}")
            return
        match action:
            case Drive():
                try:
                    self._teleoperation.drive(action.linear_m_s, action.angular_rad_s)
                except RobotError as error:
                    self._teleoperation.stop()
                    self._answer(number, "", str(error))
            case Stop():
                self._teleoperation.stop()
            case Show():
                self._outgoing.wants_camera = action.camera
            case _ if len(self._pending) >= MAX_PENDING:
                self._answer(number, "", "too many pending requests")
            case _:
                # On a thread from now on: it is carried out also where the page goes at once.
                loop = asyncio.get_running_loop()
                done = loop.run_in_executor(None, _carried_out, self._robot, action)
                task = asyncio.create_task(self._answer_when_done(number, done))
                self._pending.add(task)
                task.add_done_callback(self._pending.discard)

    async def _answer_when_done(self, number: int, done: asyncio.Future[tuple[str, str]]) -> None:
        answer = await asyncio.shield(done)
        # What has changed by it is on the page before the page says so: a box that was spawned can
        # be removed.
        await self._feed.shown()
        self._answer(number, *answer)

    def _answer(self, number: int | None, message: str, error: str) -> None:
        content = {"id": number, "said": message, "error": " ".join(error.split())}
        self._outgoing.offer(text_frame("answer", content, is_event=True))


def _carried_out(robot: Robot, action: object) -> tuple[str, str]:
    """The message for the user, and why it was rejected; one of them is empty. It does not raise,
    because the page may have gone: nothing would catch it.
    """
    try:
        return carry_out(robot, action), ""
    except RefusedError as error:
        return "", str(error)


def _id_of(text: str) -> int | None:
    """The id of a message that is wrong otherwise, so that the page knows which one it was."""
    if len(text) > 10_000:
        return None
    try:
        number = json.loads(text)["id"]
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return number if isinstance(number, int) and 0 <= number <= 2**53 else None
