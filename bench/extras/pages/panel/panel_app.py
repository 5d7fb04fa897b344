"""The panel's pages: each route reads a folder or fills an inbox."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from bench.base.errors import RunFolderError, UsageError
from bench.batch.batch_summary import PAGE
from bench.extras.pages.panel.batch_view import LOOK_S, BatchView
from bench.extras.pages.panel.folder_list import FolderList
from bench.extras.pages.panel.helper_process import PictureAnswer, PictureRequest, picture_of_view
from bench.extras.pages.panel.list_changes import ListChanges
from bench.extras.pages.panel.shown_run import LogLine
from bench.extras.pages.panel.watching import Extras, Helper, RunWatch, Watcher
from bench.extras.pages.web.guard import POLICY, known_by
from bench.extras.pages.web.pages import page_app, read_object, whole_number
from bench.extras.pages.web.server_sent import EventStream, Message, last_id
from bench.record.run_folder import JOURNAL, REPORT
from bench.record.run_index import QUEUE_COPY
from bench.run.control import Command, command_text, send

ASSETS = Path(__file__).parent / "assets"
LIST_S = 1.0
"""Time between two looks at the folder while a page lists it, s: a new run appears within it, and a disk is hardly
read."""


async def _told(text: Callable[[], tuple[str, int]], every_s: float) -> AsyncIterator[Message]:
    """Tell a text with the number of its lines, and again whenever it has changed."""
    shown = ""
    while True:
        version, lines = await asyncio.to_thread(text)
        if version != shown:
            shown = version
            yield Message(version, "update", str(lines))
        await asyncio.sleep(every_s)


class Panel:
    """The panel of one folder."""

    def __init__(self, root: Path) -> None:
        self._list = FolderList(root)
        self._watcher = Watcher()
        self._helper, self._background = Helper(), Helper()
        self._extras: dict[RunWatch, asyncio.Task[None]] = {}
        self._batches: dict[Path, BatchView] = {}
        self._changes, self._listed_at_s = ListChanges(), float("-inf")
        self._list_texts: dict[int, str] = {}
        self._unread = 0
        self._list_lock = threading.Lock()

    def app(self) -> Starlette:
        """Return the application."""
        return page_app(
            [
                Route("/", self._first_page),
                Route("/run/{key:path}", _page("run.html")),
                Route("/batch/{key:path}", _page("batch.html")),
                Route("/report/{key:path}", self._report),
                Route("/api/here", lambda _request: JSONResponse({})),
                Route("/api/list", self._list_stream),
                Route("/api/list/state", self._list_state),
                Route("/api/run/{key:path}/events", self._run_stream),
                Route("/api/run/{key:path}/state", self._run_state),
                Route("/api/run/{key:path}/log", self._run_log),
                Route("/api/run/{key:path}/picture/{pose}/{attempt}", self._picture),
                Route("/api/run/{key:path}/command", self._command, methods=["POST"]),
                Route("/api/batch/{key:path}/events", self._batch_stream),
                Route("/api/batch/{key:path}/state", self._batch_state),
            ],
            assets=ASSETS,
            lifespan=self._life,
        )

    @asynccontextmanager
    async def _life(self, _app: Starlette) -> AsyncIterator[None]:
        self._watcher.start()
        try:
            yield
        finally:
            tasks = list(self._extras.values())
            for task in tasks:
                task.cancel()
            for helper in (self._helper, self._background):
                await asyncio.to_thread(helper.close)
            await asyncio.gather(*tasks, return_exceptions=True)
            await asyncio.to_thread(self._watcher.close)

    # ---------------------------------------------------------------- pages
    async def _first_page(self, _request: Request) -> Response:
        if (self._list.root / JOURNAL).is_file():  # the folder is a run or a batch itself
            return RedirectResponse(f"/{_kind_of(self._list.root)}/.", status_code=303)
        return FileResponse(ASSETS / "list.html")

    async def _report(self, request: Request) -> Response:
        """Answer with the report of a run, which may run no script here."""
        folder = self._list.folder_of(request.path_params["key"])
        path = self._list.inside(folder / (PAGE if _kind_of(folder) == "batch" else REPORT))
        if not path.is_file():
            raise RunFolderError("There is no report yet.", where=str(folder), remedy="Wait for its end.")
        policy = POLICY.replace("script-src 'self'", "script-src 'none'").replace(
            "img-src", "font-src data:; img-src"
        )
        return FileResponse(path, headers={"Content-Security-Policy": policy})

    # ---------------------------------------------------------------- the list
    async def _list_stream(self, _request: Request) -> EventStream:
        return EventStream(self._list_messages())

    async def _list_messages(self) -> AsyncIterator[Message]:
        """Tell the whole list, then the rows that change."""
        shown = 0
        while True:
            text, version, unread = await asyncio.to_thread(self._listed, shown)
            if version != shown:
                shown = version
                yield Message(text, "update", str(version))
            await asyncio.sleep(0.0 if unread else LIST_S)

    async def _list_state(self, _request: Request) -> Response:
        text, _, _ = await run_in_threadpool(self._listed, 0)
        return Response(text, media_type="application/json")

    def _listed(self, shown: int) -> tuple[str, int, int]:
        """Return what is new after a version as JSON, the version now, and how many runs are still unread.

        The folder is looked at once for all pages, so not for the server's own thread.
        """
        with self._list_lock:
            if self._unread or time.monotonic() - self._listed_at_s >= 0.9 * LIST_S:
                content = self._list.look()
                self._changes.take(content)
                self._unread = content["unread"]
                self._list_texts.clear()
                self._listed_at_s = time.monotonic()
            if shown not in self._list_texts:
                message = self._changes.since(shown)
                self._list_texts[shown] = json.dumps(message, separators=(",", ":"), allow_nan=False)
            return self._list_texts[shown], self._changes.version, self._unread

    # ---------------------------------------------------------------- a run
    def _folder(self, request: Request, kind: Literal["run", "batch"]) -> Path:
        folder = self._list.folder_of(request.path_params["key"])
        actual = _kind_of(folder)
        if actual != kind:
            raise RunFolderError(
                f"This is a {actual}, not a {kind}.", where=str(folder), remedy="Open it from the list."
            )
        return folder

    async def _run_stream(self, request: Request) -> EventStream:
        folder = self._folder(request, "run")
        return EventStream(self._run_messages(folder, whole_number(last_id(request) or "0")))

    async def _run_messages(self, folder: Path, after: int) -> AsyncIterator[Message]:
        watch = await run_in_threadpool(self._watcher.open, folder)
        if watch not in self._extras:
            self._extras[watch] = asyncio.create_task(Extras(watch, self._background).keep_up())
        generation: int | None = None
        try:
            while True:
                number = watch.changes.number
                text, after, generation = watch.message(after, generation)
                yield Message(text, "update", str(after))
                await watch.changes.after(number)
        finally:
            self._watcher.leave(watch)
            if watch.readers <= 0 and (task := self._extras.pop(watch, None)) is not None:
                task.cancel()

    async def _run_state(self, request: Request) -> Response:
        """Answer with the whole state once, for a page that joins a stream that another page has opened."""
        folder = self._folder(request, "run")

        def whole() -> str:
            with self._watcher.watched(folder) as watch:
                return watch.message(0, None)[0]

        return Response(await run_in_threadpool(whole), media_type="application/json")

    async def _run_log(self, request: Request) -> Response:
        """Answer with older lines of the log."""
        before = whole_number(request.query_params.get("before", ""))
        folder = self._folder(request, "run")

        def older() -> list[LogLine]:
            with self._watcher.watched(folder) as watch, watch.lock:
                return watch.model.log_before(before)

        return JSONResponse({"log": await run_in_threadpool(older)})

    # ---------------------------------------------------------------- pictures
    async def _picture(self, request: Request) -> Response:
        """Answer with the stars of a recording, or with its image (``?png``)."""
        folder = self._folder(request, "run")
        place = whole_number(request.path_params["pose"]), whole_number(request.path_params["attempt"])
        measure = "measure" in request.query_params
        answer, png = await run_in_threadpool(self._picture_of, folder, place, measure)
        if "png" not in request.query_params:
            return JSONResponse(answer)
        if not png:
            raise RunFolderError(answer.get("fault") or "There is no picture.", where=str(folder))
        return Response(png, media_type="image/png")

    def _picture_of(self, folder: Path, place: tuple[int, int], measure: bool) -> tuple[PictureAnswer, bytes]:
        with self._watcher.watched(folder) as watch, watch.lock:
            model = watch.model
            attempt = next((a for a in model.history.attempts_at(place[0]) if a.attempt == place[1]), None)
            row = model.rows.get(place[0])
            accepted = model.history.accepted().get(place[0])
            solved = bool(model.history.solved)
            left = watch.views.get(place)
        if attempt is None or row is None:
            return {"fault": "There is no such recording."}, b""
        is_accepted = accepted is not None and accepted.attempt == place[1]
        if left is not None and not (is_accepted and solved):
            return picture_of_view(left), left.png
        request = PictureRequest(
            folder,
            *place,
            row["name"],
            attempt.stored["capture"],
            attempt.measured.get("expected_grid"),
            accepted=is_accepted and solved,
            measure=measure,
        )
        return self._helper.picture(request)

    # ---------------------------------------------------------------- commands
    async def _command(self, request: Request) -> Response:
        """Put a command into the inbox of a run, and answer with what the run has decided."""
        folder = self._folder(request, "run")
        given = await read_object(request)
        confirmed = given.pop("confirm", None)
        if isinstance(given.get("by"), str):
            given["by"] = given["by"].strip()
        try:
            command = Command(**given, known_by=known_by(request))
        except (ValidationError, TypeError) as error:
            raise UsageError(_command_fault(given), remedy="Correct it and send it again.") from error
        if command.word == "abort" and confirmed != "abort":
            raise UsageError(
                "An abort must be confirmed.", where=str(folder), remedy="Confirm it in the second step."
            )
        answer = await run_in_threadpool(send, folder, command)
        return JSONResponse(
            {"taken": answer["taken"], "text": command_text(answer, folder), "why": answer["why"]}
        )

    # ---------------------------------------------------------------- a batch
    def _batch(self, request: Request) -> BatchView:
        folder = self._folder(request, "batch")
        return self._batches.setdefault(folder, BatchView(folder))

    async def _batch_stream(self, request: Request) -> EventStream:
        return EventStream(_told(self._batch(request).text, LOOK_S))

    async def _batch_state(self, request: Request) -> Response:
        text, _ = await run_in_threadpool(self._batch(request).text)
        return Response(text, media_type="application/json")


def _kind_of(folder: Path) -> Literal["run", "batch"]:
    return "batch" if (folder / QUEUE_COPY).is_file() else "run"


def _page(name: str) -> Callable[[Request], Response]:
    """Return what answers with a page."""
    return lambda _request: FileResponse(ASSETS / name)


def _command_fault(given: dict[str, Any]) -> str:
    """Return what is wrong with a command, in words."""
    by = given.get("by")
    if not isinstance(by, str) or not by.strip():
        return "The command does not say who gives it: write your name."
    return "This is not a command that a run understands."


def panel_app(root: Path) -> Starlette:
    """Return the panel of a folder."""
    return Panel(root).app()
