"""The pages of an alignment as a web application: every request that changes something names its page.

A page makes its own id. Only the page that holds the controls may change something; a stop is accepted from every page.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from bench.base.errors import UsageError
from bench.extras.pages.align.live_loop import LivePicture
from bench.extras.pages.align.page_requests import PageRequests, read_page
from bench.extras.pages.align.session import Session
from bench.extras.pages.web.pages import page_app, read_object
from bench.extras.pages.web.server_sent import EventStream, Message

PAGE = Path(__file__).parent / "page"
BEAT_S = 1.0  # So often that a page tells a lost link within some seconds
_FREE = frozenset({"stop", "take", "beat"})
"""Requests that need no controls: they change nothing, or make the bench safer."""


def align_app(session: Session) -> Starlette:
    """Make the align page of a session."""
    pages = _Pages(session)
    return page_app(
        [
            Route("/", pages.page),
            Route("/stream", pages.stream),
            Route("/image", pages.image),
            Route("/state", pages.state),
            Route("/do/{what}", pages.do, methods=["POST"]),
        ],
        assets=PAGE,
    )


class _Pages:
    def __init__(self, session: Session) -> None:
        self._session = session
        self._actions = PageRequests(session).actions()
        # A stop has threads of its own, so that it never waits for other work.
        self._stops = ThreadPoolExecutor(4, thread_name_prefix="align-stop")
        self._work = ThreadPoolExecutor(4, thread_name_prefix="align-work")

    async def page(self, _request: Request) -> Response:
        return FileResponse(PAGE / "align.html", media_type="text/html")

    async def state(self, _request: Request) -> Response:
        return JSONResponse(self._session.state())

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
        if what not in _FREE:
            self._session.holder.require(page)
        pool = self._stops if what in _FREE else self._work
        result = await asyncio.get_running_loop().run_in_executor(pool, partial(action, page, body))
        return JSONResponse({"done": True, "result": result})

    async def stream(self, request: Request) -> EventStream:
        page = read_page({"page": request.query_params.get("page", "")})
        return EventStream(self._messages(page), heartbeat_s=BEAT_S)

    async def _messages(self, page: str) -> AsyncIterator[Message]:
        """Tell one page. When the stream of the page with the controls ends, it is gone: a motion is stopped."""
        session, shown, number = self._session, "", -1
        session.holder.enter(page)
        try:
            known = session.changes.number
            while True:
                text = json.dumps(session.state(), allow_nan=False)
                if text != shown:
                    shown = text
                    yield Message(text, "state")
                picture = session.picture()
                if picture.number != number:
                    number = picture.number
                    yield Message(json.dumps(_picture_data(picture), allow_nan=False), "picture")
                known = await session.changes.after(known)
        finally:
            if session.holder.leave(page):
                self._stops.submit(session.stop_motion)


def _picture_data(picture: LivePicture) -> dict[str, Any]:
    """Return what a page needs besides the image."""
    return {
        "number": picture.number,
        "figures": picture.figures.to_json(),
        "rows": [row._asdict() for row in picture.rows],
        "focus_curve": picture.focus_curve,
    }
