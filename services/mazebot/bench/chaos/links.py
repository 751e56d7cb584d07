"""A proxy between services and their router, on whose links things go wrong."""

from __future__ import annotations

import asyncio
import contextlib
import math
import threading
from collections import deque
from pathlib import Path
from typing import NamedTuple, Self

from mazebot.bench.parts.loopback_router import free_port
from mazebot.common.node.node import random_generator

_CHUNK_BYTES = 65536
_MOST_WAITING_BYTES = 262144
"""On a slow link the sender waits, as with TCP's own buffers."""
_HOST = "127.0.0.1"
_BEGIN_S = 10.0


class Shape(NamedTuple):
    """How a link passes on what it gets, in both directions."""

    delay_s: float = 0.0
    jitter_s: float = 0.0
    """Evenly distributed, on top of the delay; the order stays, as with TCP."""
    rate_bytes_s: float = math.inf
    is_open: bool = True
    """False: the connection stands, and all that is sent is lost without a word."""


class _Link:
    """The connection of one service."""

    def __init__(self, service: str, ends: tuple[asyncio.StreamWriter, ...]) -> None:
        self.service = service
        self.has_lost = False
        self._ends = ends

    def close(self) -> None:
        """Break it at once."""
        for end in self._ends:
            end.transport.abort()


class Links:
    """Listens on a port of its own, and passes on to the router."""

    def __init__(self, router_port: int, seed: int) -> None:
        self.port = free_port()
        self._router_port = router_port
        self._shapes: dict[str, Shape] = {}
        self._links: set[_Link] = set()
        self._random = random_generator(seed, "chaos/links")
        self._loop = asyncio.new_event_loop()
        self._listens = threading.Event()
        self._thread = threading.Thread(target=self._run, name="links", daemon=True)

    def __enter__(self) -> Self:
        """Begin to listen. Raises TimeoutError where that does not succeed."""
        self._thread.start()
        if not self._listens.wait(_BEGIN_S):
            raise TimeoutError(f"the proxy does not listen on port {self.port}")
        return self

    def __exit__(self, *_: object) -> None:
        """Break all links."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_BEGIN_S)

    def shape(self, service: str, shape: Shape) -> None:
        """Give the links of a service a shape; an empty name stands for all services."""
        self._loop.call_soon_threadsafe(self._shapes.__setitem__, service, shape)

    def clear(self, service: str) -> None:
        """Take a shape back. A connection on which something was lost cannot go on: it breaks."""

        def clear() -> None:
            self._shapes.pop(service, None)
            for link in self._links:
                if link.has_lost and self._shape_of(link).is_open:
                    link.close()

        self._loop.call_soon_threadsafe(clear)

    def services(self) -> set[str]:
        """Those that are connected."""
        return {link.service for link in list(self._links)}

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        server = self._loop.run_until_complete(
            asyncio.start_server(self._serve, _HOST, self.port, limit=_CHUNK_BYTES)
        )
        self._listens.set()
        self._loop.run_forever()
        server.close()
        for task in asyncio.all_tasks(self._loop):
            task.cancel()
        for link in self._links:
            link.close()
        self._loop.run_until_complete(asyncio.sleep(0.0))
        self._loop.close()

    def _shape_of(self, link: _Link) -> Shape:
        return self._shapes.get(link.service) or self._shapes.get("") or Shape()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        service = service_behind(writer.get_extra_info("peername")[1])
        try:
            far_reader, far_writer = await asyncio.open_connection(
                _HOST, self._router_port, limit=_CHUNK_BYTES
            )
        except OSError:
            writer.close()
            return
        link = _Link(service, (writer, far_writer))
        self._links.add(link)
        ways = [
            asyncio.create_task(self._pass(link, *way))
            for way in ((reader, far_writer), (far_reader, writer))
        ]
        try:
            # Where one way has ended, nothing more is said on the other.
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            self._links.discard(link)
            link.close()

    async def _pass(
        self, link: _Link, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """One direction of a link, until it ends."""
        waiting: deque[tuple[float, bytes]] = deque()
        changed, size, last_s = asyncio.Event(), 0, 0.0

        async def send() -> None:
            nonlocal size
            while True:
                while not waiting:
                    changed.clear()
                    await changed.wait()
                due_s, data = waiting[0]
                await asyncio.sleep(max(due_s - self._loop.time(), 0.0))
                waiting.popleft()
                size -= len(data)
                changed.set()
                if not self._shape_of(link).is_open:
                    link.has_lost = True
                    continue
                writer.write(data)
                await writer.drain()

        sender = asyncio.create_task(send())
        try:
            while data := await reader.read(_CHUNK_BYTES):
                shape = self._shape_of(link)
                if not shape.is_open:
                    link.has_lost = True
                    continue
                delay_s = shape.delay_s + shape.jitter_s * float(self._random.random())
                last_s = max(last_s, self._loop.time() + delay_s) + len(data) / shape.rate_bytes_s
                waiting.append((last_s, data))
                size += len(data)
                changed.set()
                while size > _MOST_WAITING_BYTES and not sender.done():
                    changed.clear()
                    await changed.wait()
                if sender.done():
                    return
        except OSError:
            return
        finally:
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError, OSError):
                await sender


def service_behind(port: int) -> str:
    """The service of this machine whose connection comes from a port; empty: it is none."""
    wanted = f":{port:04X}"
    inode = next(
        (
            fields[9]
            for fields in map(str.split, Path("/proc/net/tcp").read_text().splitlines()[1:])
            if fields[1].endswith(wanted)
        ),
        None,
    )
    for process in Path("/proc").glob("[0-9]*"):
        # It may end meanwhile, or be another user's.
        with contextlib.suppress(OSError):
            of_it = (str(one.readlink()) for one in (process / "fd").iterdir())
            if f"socket:[{inode}]" in of_it:
                words = (process / "cmdline").read_bytes().split(b"\0")
                module = words[words.index(b"-m") + 1].decode() if b"-m" in words else ""
                return module.removeprefix("mazebot.") if module.startswith("mazebot.") else ""
    return ""
