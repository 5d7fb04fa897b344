"""What every set of pages has: shared assets, errors in one shape, and requests with one small JSON object."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Mount
from starlette.staticfiles import StaticFiles

from bench.base.bounded_json import canonical_json, parse_json
from bench.base.errors import RunFolderError, UsageError
from bench.base.failure import FORESEEN, Failure

ASSETS = Path(__file__).parent / "assets"
_MOST_BYTES = 16_384  # Requests of the pages have some hundred
_WHOLE_NUMBER = re.compile(r"[0-9]{1,15}")
_NOT_FOUND, _CONFLICT, _INVALID = 404, 409, 400  # HTTP

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
    """Read the JSON object that a request carries: at most 16 KiB, finite numbers, and text that UTF-8 can hold."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _MOST_BYTES:
            raise UsageError("The request is too long.", remedy="Load the page again.")
    try:
        content = parse_json(body)
        canonical_json(content, ascii_only=False)  # not of infinity, nor of half a surrogate pair
    except ValueError as error:
        raise UsageError("The request is not valid JSON.", remedy="Load the page again.") from error
    if not isinstance(content, dict):
        raise UsageError("The request is not a JSON object.", remedy="Load the page again.")
    return content


def whole_number(text: str) -> int:
    """Return a number of a request (a line, a pose, an attempt) of at most 15 digits."""
    if not _WHOLE_NUMBER.fullmatch(text):
        raise UsageError("The request names nothing by its number.", remedy="Load the page again.")
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
