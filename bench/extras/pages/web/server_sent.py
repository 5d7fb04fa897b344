"""Server-sent events (WHATWG HTML, section 9.2): messages with ids, a heartbeat, an end when the reader leaves.

A reader that lost its connection names the id of the last message that it has, in ``Last-Event-ID`` or in
``?after=``. Its source of messages continues from there.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from starlette.requests import Request
from starlette.types import Message as AsgiMessage
from starlette.types import Receive, Scope, Send

HEARTBEAT_S = 2.0  # So often that a page tells a lost link within some seconds
CLOSING = "starbench.closing"
"""Key of the state in an ASGI scope: an event that is set when the server closes; every stream then ends."""
_RETRY_MS = 500  # A page is back soon after a restart
_HEADERS = [
    (b"content-type", b"text/event-stream; charset=utf-8"),
    (b"cache-control", b"no-store"),
    (b"x-accel-buffering", b"no"),
]


@dataclass(frozen=True)
class Message:
    """One message of a stream."""

    data: str
    event: str = "message"  # Name of the event; a page listens for it
    id: str = ""  # Id; empty if a reader that reconnects need not name this message


@lru_cache(maxsize=32)
def encoded(message: Message) -> bytes:
    r"""Return the bytes of a message, UTF-8, with the empty line that ends it; pages that get the same one share them.

    >>> encoded(Message("a\nb", "state", "7"))
    b'id: 7\nevent: state\ndata: a\ndata: b\n\n'
    """
    lines = [f"id: {message.id}"] if message.id else []
    lines += [f"event: {message.event}"] if message.event != "message" else []
    lines += [f"data: {line}" for line in message.data.replace("\r\n", "\n").replace("\r", "\n").split("\n")]
    return ("\n".join(lines) + "\n\n").encode()


def last_id(request: Request) -> str:
    """Return the last message's id from header ``Last-Event-ID``, or else query ``after``; empty for none."""
    return request.headers.get("last-event-id") or request.query_params.get("after", "")


class EventStream:
    """Response that sends messages until they end, the reader leaves, or the server closes.

    The source is asked when the last message has gone, so a slow reader gets the latest state; it is closed at the end.
    After ``heartbeat_s`` without a message an event ``beat`` shows that the link works.
    """

    def __init__(self, messages: AsyncIterator[Message], *, heartbeat_s: float = HEARTBEAT_S) -> None:
        self._messages = messages
        self._heartbeat_s = heartbeat_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the stream."""
        await send({"type": "http.response.start", "status": 200, "headers": _HEADERS})
        await _send_part(send, f"retry: {_RETRY_MS}\n\n".encode())
        closing = scope.get("state", {}).get(CLOSING)
        ends = {asyncio.ensure_future(_gone(receive))}
        if closing is not None:
            ends.add(asyncio.ensure_future(closing.wait()))
        following: asyncio.Future[Any] = asyncio.ensure_future(_next(self._messages))
        try:
            while True:
                done, _ = await asyncio.wait(
                    {*ends, following}, timeout=self._heartbeat_s, return_when=asyncio.FIRST_COMPLETED
                )
                if done & ends:
                    break
                if following not in done:
                    await _send_part(send, b"event: beat\ndata:\n\n")
                    continue
                message = following.result()
                if message is None:
                    break
                await _send_part(send, encoded(message))
                following = asyncio.ensure_future(_next(self._messages))
        finally:
            await _cancelled({*ends, following})
            if hasattr(self._messages, "aclose"):
                await self._messages.aclose()
        with suppress(OSError):
            await send({"type": "http.response.body", "body": b"", "more_body": False})


class Changes:
    """A number that any thread raises, and that streams wait for. One change wakes every stream."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.number = 0
        """How often there was a change."""
        self._waiting: dict[asyncio.AbstractEventLoop, asyncio.Event] = {}

    def tell(self) -> None:
        """Raise the number and wake the streams. For any thread."""
        with self._lock:
            self.number += 1
            waiting, self._waiting = self._waiting, {}
        for loop, event in waiting.items():
            with suppress(RuntimeError):  # the loop is closed: nobody waits there any more
                loop.call_soon_threadsafe(event.set)

    async def after(self, number: int) -> int:
        """Wait until the number is another one."""
        while True:
            with self._lock:
                if self.number != number:
                    return self.number
                event = self._waiting.setdefault(asyncio.get_running_loop(), asyncio.Event())
            await event.wait()


async def _send_part(send: Send, part: bytes) -> None:
    await send({"type": "http.response.body", "body": part, "more_body": True})


async def _next(messages: AsyncIterator[Message]) -> Message | None:
    return await anext(messages, None)


async def _gone(receive: Receive) -> None:
    """Return when the reader has left."""
    message: AsgiMessage = {"type": ""}
    while message["type"] != "http.disconnect":
        message = await receive()


async def _cancelled(tasks: set[asyncio.Future[Any]]) -> None:
    """Cancel tasks and wait for their end; what they raise then concerns nobody."""
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
