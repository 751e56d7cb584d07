"""The answer that sends a file, or the part of it that was asked for."""

from __future__ import annotations

import asyncio
import os
import re
import stat
from collections.abc import Callable
from email.utils import formatdate, parsedate_to_datetime
from urllib.parse import quote

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

_CHUNK = 256 * 1024
_LOOK_S = 0.2
"""How often a file is looked at that grows."""
_RANGE = re.compile(r"bytes=(\d{0,18})-(\d{0,18})", re.ASCII)


class FileAnswer(Response):
    """Sends an open file, as long as it was when asked for, even if it still grows; closes it.

    Knows conditional requests, and ranges of one part (RFC 9110, 13 and 14).
    """

    def __init__(
        self,
        file: int,
        media_type: str,
        *,
        headers: dict[str, str] | None = None,
        download_name: str = "",
    ) -> None:
        self._file = file
        state = os.fstat(file)
        self._size = state.st_size
        self._changed_s = int(state.st_mtime)
        tag = f'"{state.st_ino:x}-{state.st_mtime_ns:x}-{state.st_size:x}"'
        sent = {
            "accept-ranges": "bytes",
            "cache-control": "no-cache",
            "etag": tag,
            "last-modified": formatdate(self._changed_s, usegmt=True),
            **(headers or {}),
        }
        if download_name:
            sent["content-disposition"] = f"attachment; filename*=utf-8''{quote(download_name)}"
        assert stat.S_ISREG(state.st_mode)
        super().__init__(headers=sent, media_type=media_type)
        del self.headers["content-length"]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file as an ASGI application does."""
        try:
            await self._answer(scope, Headers(scope=scope), send)
        finally:
            os.close(self._file)

    async def _answer(self, scope: Scope, asked: Headers, send: Send) -> None:
        first, end = 0, self._size
        if self._is_unchanged(asked):
            self.status_code = 304
            end = 0
        else:
            part = self._part(asked)
            if part is not None:
                first, end = part
                self.status_code = 206
                self.headers["content-range"] = f"bytes {first}-{end - 1}/{self._size}"
            self.headers["content-length"] = str(end - first)
        await send(
            {
                "type": "http.response.start",
                "status": self.status_code,
                "headers": self.raw_headers,
            }
        )
        if scope["method"] != "HEAD":
            while first < end:
                size = min(_CHUNK, end - first)
                chunk = await asyncio.to_thread(os.pread, self._file, size, first)
                if not chunk:
                    # The file was cut meanwhile: the client notices that bytes are missing.
                    return
                first += len(chunk)
                await send({"type": "http.response.body", "body": chunk, "more_body": True})
        await send({"type": "http.response.body", "body": b""})

    def _is_unchanged(self, asked: Headers) -> bool:
        tags = asked.get("if-none-match")
        if tags is not None:
            known = {tag.strip().removeprefix("W/") for tag in tags.split(",")}
            return "*" in known or self.headers["etag"] in known
        since = asked.get("if-modified-since")
        if since is None:
            return False
        try:
            return self._changed_s <= parsedate_to_datetime(since).timestamp()
        except (ValueError, OverflowError):
            return False

    def _part(self, asked: Headers) -> tuple[int, int] | None:
        """First byte and end of the range; None: the whole file. Raises HTTPException 416."""
        only_if = asked.get("if-range")
        if only_if is not None and only_if not in (
            self.headers["etag"],
            self.headers["last-modified"],
        ):
            return None
        match = _RANGE.fullmatch(asked.get("range", "").replace(" ", ""))
        if match is None or not (match[1] or match[2]):
            # Other units and several ranges may be ignored.
            return None
        if match[1]:
            first = int(match[1])
            end = min(int(match[2]) + 1, self._size) if match[2] else self._size
            if match[2] and int(match[2]) < first:
                return None
        else:
            first, end = max(self._size - int(match[2]), 0), self._size
        if first >= end:
            headers = {"content-range": f"bytes */{self._size}"}
            raise HTTPException(416, "the range starts after the end of the file", headers)
        return first, end


class GrowingAnswer(Response):
    """Sends an open file, and what is appended to it, until it grows no more or the client has
    gone; closes it.
    """

    def __init__(self, file: int, grows: Callable[[], bool]) -> None:
        """`grows()`: whether something may still be appended. Called on a thread."""
        self._file = file
        self._grows = grows
        super().__init__(
            headers={"cache-control": "no-store"}, media_type="application/octet-stream"
        )
        del self.headers["content-length"]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file as an ASGI application does."""
        gone = asyncio.create_task(_gone(receive))
        try:
            await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
            if scope["method"] != "HEAD":
                await self._send_all(gone, send)
            await send({"type": "http.response.body", "body": b""})
        finally:
            gone.cancel()
            os.close(self._file)

    async def _send_all(self, gone: asyncio.Task[None], send: Send) -> None:
        first = 0
        while not gone.done():
            # Asked before the end is read: what was appended until then is sent, too.
            grows = await asyncio.to_thread(self._grows)
            while chunk := await asyncio.to_thread(os.pread, self._file, _CHUNK, first):
                first += len(chunk)
                await send({"type": "http.response.body", "body": chunk, "more_body": True})
                if gone.done():
                    return
            if not grows:
                return
            await asyncio.wait([gone], timeout=_LOOK_S)


async def _gone(receive: Receive) -> None:
    """Return when the client has gone."""
    while (await receive())["type"] != "http.disconnect":
        pass
