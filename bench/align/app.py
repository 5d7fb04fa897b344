"""The align page's server side: its requests, and the stream that shows state and picture.

Every request that changes something names the page that sends it, by the id that the page made for itself. Only the
page that holds the controls may change something; a stop is accepted from every page. This module calls the session
and moves nothing itself.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route
from starlette.types import Receive, Scope, Send

from bench.align.live_loop import LivePicture
from bench.align.page_requests import PageFiles, actions, read_page
from bench.align.session import Session
from bench.base.errors import UsageError
from bench.web.pages import page_app, read_object
from bench.web.stream import EventStream, Message

PAGE = Path(__file__).parent / "page"
BEAT_S = 1.0
_FREE = frozenset({"stop", "take", "beat", "leave", "propose", "check"})
"""Requests that need no controls: they change nothing, or make the bench safer."""


def align_app(session: Session, files: PageFiles | None = None) -> Starlette:
    """Make the application of the align page.

    files: Where the page may write; None for the session's station file and the working directory.
    Returns: The application, to be served by `bench.web.server`.
    """
    pages = _Pages(session, files or PageFiles(session.station.file))
    return page_app(
        [
            Route("/", pages.page),
            Route("/stream", pages.stream),
            Route("/image", pages.image),
            Route("/state", pages.state),
            Route("/files", pages.files),
            Route("/course", pages.course),
            Route("/do/{what}", pages.do, methods=["POST"]),
        ],
        assets=PAGE,
    )


class _Pages:
    def __init__(self, session: Session, files: PageFiles) -> None:
        self._session = session
        self._files = files
        self._actions: Mapping[str, Callable[[str, Mapping[str, Any]], Any]] = actions(session, files)
        # A stop has threads of its own, so that it never waits for other work.
        self._stops = ThreadPoolExecutor(4, thread_name_prefix="align-stop")
        self._work = ThreadPoolExecutor(4, thread_name_prefix="align-work")
        self._texts = _Texts(session)

    async def page(self, _request: Request) -> Response:
        return FileResponse(PAGE / "align.html", media_type="text/html")

    async def state(self, _request: Request) -> Response:
        return JSONResponse(self._session.state())

    async def files(self, _request: Request) -> Response:
        return JSONResponse(self._files.as_data())

    async def course(self, _request: Request) -> Response:
        session = self._session
        found = session.bench.loop.course() if session.is_open else []
        return JSONResponse({"edge_width_px": [[round(t, 3), round(w, 3)] for t, w in found]})

    async def image(self, _request: Request) -> Response:
        picture = self._session.picture()
        if not picture.number or not picture.jpeg:
            return Response(status_code=204)
        return Response(picture.jpeg, media_type="image/jpeg", headers={"X-Number": str(picture.number)})

    async def do(self, request: Request) -> Response:
        what = request.path_params["what"]
        action = self._actions.get(what)
        if action is None:
            raise UsageError(f"The page cannot ask for {what!r}.", remedy="Load the page again.")
        body = await read_object(request)
        page = read_page(body)
        owners = self._session.owners
        owners.beat(page)
        if what not in _FREE:
            owners.require(page)
        if what == "beat":
            return JSONResponse({"done": True})
        pool = self._stops if what in ("stop", "leave", "take") else self._work
        result = await asyncio.get_running_loop().run_in_executor(pool, partial(action, page, body))
        return JSONResponse({"done": True, "result": result})

    async def stream(self, request: Request) -> Response | _Stream:
        page = request.query_params.get("page", "")
        page = read_page({"page": page})
        client = request.client.host if request.client else ""
        browser = _browser(request.headers.get("user-agent", ""), client)
        return _Stream(self._session, page, browser, self._stops, self._texts)


class _Texts:
    """What the pages are sent, made once for all of them. Used by the server's own thread."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._state = -1, ""
        self._picture = LivePicture(), ""

    def state(self) -> str:
        """Return the state, made after the last change at the earliest."""
        known = self._session.changes.number
        if known != self._state[0]:
            self._state = known, json.dumps(self._session.state(), allow_nan=False)
        return self._state[1]

    def picture(self) -> str:
        """Return the newest picture's figures."""
        picture = self._session.picture()
        if picture is not self._picture[0]:
            self._picture = picture, json.dumps(_picture_data(self._session), allow_nan=False)
        return self._picture[1]


class _Stream:
    """The stream of one page. When it ends, the page is gone: a motion that the page started is stopped."""

    def __init__(
        self, session: Session, page: str, what: str, stops: ThreadPoolExecutor, texts: _Texts
    ) -> None:
        self._session = session
        self._page = page
        self._what = what
        self._stops = stops
        self._texts = texts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the stream, as the ASGI specification defines it."""
        session = self._session
        session.owners.enter(self._page, self._what)
        try:
            await EventStream(self._messages(), heartbeat_s=BEAT_S)(scope, receive, send)
        finally:
            if session.owners.leave(self._page):
                self._stops.submit(session.stop_for_lost, self._page)

    async def _messages(self) -> AsyncIterator[Message]:
        session, shown, number = self._session, "", -1
        known = session.changes.number
        while True:
            text = self._texts.state()
            if text != shown:
                shown = text
                yield Message(text, "state")
            picture = session.picture()
            if picture.number != number:
                number = picture.number
                yield Message(self._texts.picture(), "picture")
            known = await session.changes.after(known)


def _picture_data(session: Session) -> dict[str, Any]:
    """Return what a page needs besides the image."""
    picture = session.picture()
    loop = session.bench.loop if session.is_open else None
    return {
        "number": picture.number,
        "made_s": picture.made_s,
        "record_ms": round(picture.record_ms, 1),
        "measure_ms": round(picture.measure_ms, 1),
        "images_per_s": round(loop.images_per_s(), 2) if loop else 0.0,
        "stars_per_s": round(loop.stars_per_s(), 2) if loop else 0.0,
        "figures": picture.figures.to_json(),
    }


def _browser(agent: str, client: str) -> str:
    """Return browser and address, as a person reads them."""
    for name in ("Edg", "OPR", "Firefox", "Chrome", "Safari"):
        if f"{name}/" in agent:
            return f"{ {'Edg': 'Edge', 'OPR': 'Opera'}.get(name, name) } at {client}"
    return f"at {client}"
