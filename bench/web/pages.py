"""What every set of pages has: shared assets, errors in one shape, and requests with one small JSON object."""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Mount
from starlette.staticfiles import StaticFiles
from starlette.types import Message as AsgiMessage
from starlette.types import Receive, Scope, Send

from bench.base.bounded_json import parse_json
from bench.base.errors import RunFolderError, UsageError
from bench.base.failure import FORESEEN, Failure

# Server-sent events (WHATWG HTML, section 9.2): messages with ids, a heartbeat, and an end when the reader
# leaves.
#
# A reader that lost its connection names the id of the last message that it has, in ``Last-Event-ID`` or in
# ``?after=``. Its source of messages continues from there.

HEARTBEAT_S = 2.0
CLOSING = "starbench.closing"
"""Key of the ASGI scope: an event that is set when the server closes; every stream then ends."""
_RETRY_MS = 500
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

    def encoded(self) -> bytes:
        r"""Return the bytes of the message, UTF-8, with the empty line that ends it.

        >>> Message("a\nb", "state", "7").encoded()
        b'id: 7\nevent: state\ndata: a\ndata: b\n\n'
        """
        return _encoded(self.data, self.event, self.id)


@lru_cache(maxsize=32)
def _encoded(data: str, event: str, number: str) -> bytes:
    """Return the bytes of a message; the pages that get the same one share them."""
    lines = [f"id: {number}"] if number else []
    lines += [f"event: {event}"] if event != "message" else []
    lines += [f"data: {line}" for line in data.replace("\r\n", "\n").replace("\r", "\n").split("\n")]
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
        closing = scope.get(CLOSING)
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
                await _send_part(send, message.encoded())
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
        self._number = 0
        self._waiting: dict[asyncio.AbstractEventLoop, asyncio.Event] = {}

    @property
    def number(self) -> int:
        """How often there was a change."""
        return self._number

    def tell(self) -> None:
        """Raise the number and wake the streams. For any thread."""
        with self._lock:
            self._number += 1
            waiting, self._waiting = self._waiting, {}
        for loop, event in waiting.items():
            with suppress(RuntimeError):  # the loop is closed: nobody waits there any more
                loop.call_soon_threadsafe(event.set)

    async def after(self, number: int) -> int:
        """Wait until the number is another one."""
        while True:
            with self._lock:
                if self._number != number:
                    return self._number
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


ASSETS = Path(__file__).parent / "assets"
_MOST_BYTES = 16_384
BODY_S = 10.0
_WHOLE_NUMBER = re.compile(r"[0-9]{1,15}")
_NOT_FOUND, _CONFLICT, _INVALID = 404, 409, 400

Lifespan = Callable[[Starlette], AbstractAsyncContextManager[None]]


def page_app(
    routes: Sequence[BaseRoute], *, assets: Path | None = None, lifespan: Lifespan | None = None
) -> Starlette:
    """Make the application of a set of pages; every foreseen error becomes JSON with kind, what, where, remedy."""
    mounts: list[BaseRoute] = []
    if assets is not None:
        mounts.append(Mount("/assets/own", _Assets(directory=assets)))
    mounts.append(Mount("/assets", _Assets(directory=ASSETS)))
    handlers: dict[Any, Any] = dict.fromkeys(FORESEEN, _foreseen)
    handlers[HTTPException] = _http_error
    return Starlette(routes=[*routes, *mounts], exception_handlers=handlers, lifespan=lifespan)


async def read_object(request: Request) -> dict[str, Any]:
    """Read the JSON object that a request carries: at most 16 KiB, and within 10 s."""
    body = b""
    try:
        async with asyncio.timeout(BODY_S):
            async for part in request.stream():
                body += part
                if len(body) > _MOST_BYTES:
                    raise UsageError("The request is too long.", remedy="Load the page again.")
        found = parse_json(body)
    except TimeoutError as error:
        raise UsageError("The request did not end in time.", remedy="Load the page again.") from error
    except ValueError as error:
        raise UsageError("The request is not JSON.", remedy="Load the page again.") from error
    if not isinstance(found, dict):
        raise UsageError("The request is not a JSON object.", remedy="Load the page again.")
    return found


def whole_number(text: str) -> int:
    """Return a number of a request (a line, a pose, an attempt) of at most 15 digits."""
    if not _WHOLE_NUMBER.fullmatch(text):
        raise UsageError(
            "The request names no line, pose or attempt by its number.", remedy="Load the page again."
        )
    return int(text)


def error_answer(failure: Failure, status: int) -> Response:
    """Return an error as JSON, ``{"error": {"kind", "what", "where", "remedy", "message"}}``."""
    return JSONResponse({"error": {**failure.to_dict(), "message": failure.message}}, status_code=status)


class _Assets(StaticFiles):
    """Files of ours; the browser asks each time whether they are new, so that a new version is seen at once."""

    def file_response(self, *args: Any, **kwargs: Any) -> Response:
        """See `StaticFiles.file_response`."""
        response = super().file_response(*args, **kwargs)
        response.headers["Cache-Control"] = "no-cache"
        return response


async def _foreseen(_request: Request, error: Exception) -> Response:
    status = _CONFLICT
    if isinstance(error, UsageError):
        status = _INVALID
    elif isinstance(error, RunFolderError):
        status = _NOT_FOUND
    return error_answer(Failure.of(error), status)


async def _http_error(_request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    what = "There is no such page." if error.status_code == _NOT_FOUND else f"{error.detail}."
    return error_answer(Failure("HTTPException", what, "", "Go back to the first page."), error.status_code)
