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
from bench.extras.pages.align.page_requests import PageFiles, PageRequests, read_page
from bench.extras.pages.align.session import Session
from bench.extras.pages.web.pages import page_app, read_object
from bench.extras.pages.web.server_sent import EventStream, Message

PAGE = Path(__file__).parent / "page"
BEAT_S = 1.0
_FREE = frozenset({"stop", "take", "beat", "leave", "check"})
"""Requests that need no controls: they change nothing, or make the bench safer."""


def align_app(session: Session, files: PageFiles | None = None) -> Starlette:
    """Make the align page; ``files`` is where it may write, None for station file and working directory."""
    pages = _Pages(session, files or PageFiles(session.station.file))
    return page_app(
        [
            Route("/", pages.page),
            Route("/stream", pages.stream),
            Route("/image", pages.image),
            Route("/state", pages.state),
            Route("/files", pages.files),
            Route("/focus", pages.focus),
            Route("/do/{what}", pages.do, methods=["POST"]),
        ],
        assets=PAGE,
    )


class _Pages:
    def __init__(self, session: Session, files: PageFiles) -> None:
        self._session = session
        self._files = files
        self._actions = PageRequests(session, files).actions()
        # A stop has threads of its own, so that it never waits for other work.
        self._stops = ThreadPoolExecutor(4, thread_name_prefix="align-stop")
        self._work = ThreadPoolExecutor(4, thread_name_prefix="align-work")

    async def page(self, _request: Request) -> Response:
        return FileResponse(PAGE / "align.html", media_type="text/html")

    async def state(self, _request: Request) -> Response:
        return JSONResponse(self._session.state())

    async def files(self, _request: Request) -> Response:
        return JSONResponse(self._files.as_data())

    async def focus(self, _request: Request) -> Response:
        session = self._session
        widths_px = session.bench.loop.focus_curve() if session.is_open else []
        return JSONResponse({"edge_width_px": [[round(t, 3), round(w, 3)] for t, w in widths_px]})

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

    async def stream(self, request: Request) -> EventStream:
        page = read_page({"page": request.query_params.get("page", "")})
        client = request.client.host if request.client else ""
        browser = _browser(request.headers.get("user-agent", ""), client)
        return EventStream(self._messages(page, browser), heartbeat_s=BEAT_S)

    async def _messages(self, page: str, browser: str) -> AsyncIterator[Message]:
        """Tell one page. When its stream ends, the page is gone: a motion that the page started is stopped."""
        session, shown, number = self._session, "", -1
        session.owners.enter(page, browser)
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
                    yield Message(json.dumps(_picture_data(session), allow_nan=False), "picture")
                known = await session.changes.after(known)
        finally:
            if session.owners.leave(page):
                self._stops.submit(session.stop_for_lost, page)


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
        "rows": [row._asdict() for row in picture.rows],
    }


def _browser(agent: str, client: str) -> str:
    """Return browser and address, as a person reads them."""
    for name in ("Edg", "OPR", "Firefox", "Chrome", "Safari"):
        if f"{name}/" in agent:
            return f"{ {'Edg': 'Edge', 'OPR': 'Opera'}.get(name, name) } at {client}"
    return f"at {client}"
