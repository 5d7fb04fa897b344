"""Who may use the pages: checks on every request before any page sees it, and headers on every answer.

- The ``Host`` header must name this server. Otherwise a page of another site could reach it under a name of its own
  that resolves to this computer (DNS rebinding).
- A request that changes something must carry the ``Origin`` of one of our pages. So no other site can send a command.
- Where there is a token, each request needs the cookie of a sign-in, or the token in its ``Authorization`` header.
  Pages learn from ``known_by`` whether there was one.
- Browsers send a cookie to every port of its host (RFC 6265, section 8.5). So a server of this computer only moves a
  browser to a host name that this start made, ``NAME.localhost`` (RFC 6761, section 6.3), and the cookie holds nothing
  but a random session of this start.
- The content security policy forbids every other host, and every script that is not a file of ours.
"""

from __future__ import annotations

import hmac
import secrets
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from bench.base.errors import UsageError
from bench.base.failure import Failure
from bench.extras.pages.web.pages import error_answer, read_object
from bench.extras.pages.web.token import (
    MADE_BYTES,
    NAME_BYTES,
    PageToken,
    WrongTokens,
    address_of,
    is_loopback,
)

SIGN_IN = "/sign-in"
SIGNED_IN = "starbench.signed_in"
"""Key of the ASGI scope: whether the request has shown the token or the cookie."""
ASSETS = "/assets/"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:;"
    " connect-src 'self'; worker-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
"""Content security policy. Inline styles are allowed because the plots carry them."""
_HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}
_SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
_ERROR = 400  # HTTP: this status and higher ones
_COOKIE_AGE_S = 30 * 24 * 3600  # A month: the page of a bench stays open


class Guard:
    """ASGI middleware with the checks of this module."""

    def __init__(
        self,
        app: ASGIApp,
        *,
        host: str,
        port: int,
        token: PageToken | None,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._app = app
        self._names = frozenset({"localhost", "127.0.0.1", "::1", host.lower(), *_own_names(host)})
        self._addresses_allowed = not is_loopback(host)
        self._cookie = f"starbench-{port}"  # browsers share cookies between the ports of a host
        self._token = token
        self._session = secrets.token_urlsafe(MADE_BYTES)
        self._session_host = (
            f"starbench-{secrets.token_hex(NAME_BYTES)}.localhost" if token and is_loopback(host) else ""
        )
        """The only host that gets the cookie; empty where the server has one name for all its ports."""
        self._wrong = WrongTokens(monotonic)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check a request and pass it on, or answer it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
                if not scope["path"].startswith(ASSETS):
                    headers.setdefault("Cache-Control", "no-store")
                if message["status"] >= _ERROR and not scope.get(SIGNED_IN):
                    headers["Connection"] = "close"
            await send(message)

        answer = await self._answer(Request(scope, receive))
        await (answer or self._app)(scope, receive, send_with_headers)

    async def _answer(self, request: Request) -> Response | None:
        """Return the answer of the guard itself; None if the request may pass."""
        host = request.headers.get("host", "")
        if not self._is_own(host):
            return _refusal(
                421,
                f"This server does not answer to the name {host!r}.",
                "Use the address that the command has printed.",
            )
        if request.method not in _SAFE_METHODS and not _same_origin(request.headers, host):
            return _refusal(
                403,
                "This request does not come from a page of this server.",
                "Use the buttons of the page, or the command line.",
            )
        if self._token is None or request.url.path.startswith(ASSETS):
            return None
        scheme, _, given = request.headers.get("authorization", "").partition(" ")
        refusal: Response | None = None
        if scheme.lower() == "bearer":
            refusal = self._refusal_of(given.strip(), request)
        elif self._session_host and _host_name(host) != self._session_host and _is_for_a_person(request):
            return self._move_to_session_host(request, host)
        elif request.url.path == SIGN_IN:
            return await self._sign_in(request, host)
        elif not self._has_cookie(request):
            refusal = _ask_to_sign_in(request)
        request.scope[SIGNED_IN] = refusal is None
        return refusal

    def _move_to_session_host(self, request: Request, host: str) -> Response:
        """Lead a browser to the host that gets the cookie; it keeps what stands behind the ``#`` of the address."""
        port = host.rpartition(":")[2]  # a tunnel may have another port than this server
        where = f"{self._session_host}:{port}" if port.isdigit() else self._session_host
        return RedirectResponse(str(request.url.replace(netloc=where)), status_code=307)

    def _is_own(self, host: str) -> bool:
        name = _host_name(host)
        if name in self._names or (self._session_host and name.endswith(".localhost")):
            return True
        # No other site can have an address of ours as its name.
        return self._addresses_allowed and address_of(name) is not None

    def _refusal_of(self, given: str, request: Request) -> Response | None:
        """Return the answer to a wrong token, or to any token of an address that sent many; None for the right one."""
        address = request.client.host if request.client is not None else ""
        if self._wrong.refuse(address):
            return _refusal(429, "The token was wrong 10 times.", "Wait one minute, then try again.")
        assert self._token is not None
        if hmac.compare_digest(given.encode(), self._token.text.encode()):
            return None
        if not self._token.made:  # nobody guesses 128 random bits, at any rate
            self._wrong.add(address)
        return _refusal(
            403 if request.url.path == SIGN_IN else 401,
            "This token is wrong.",
            "Use the address that the command has printed, or the token of the variable or file that was named.",
        )

    def _has_cookie(self, request: Request) -> bool:
        kept = request.cookies.get(self._cookie, "")
        return hmac.compare_digest(kept.encode(), self._session.encode())

    async def _sign_in(self, request: Request, host: str) -> Response:
        if self._session_host and _host_name(host) != self._session_host:
            return _refusal(
                421,
                "A sign-in is not possible at this address.",
                "Open the address that the command has printed in a browser.",
            )
        if request.method == "GET":
            return HTMLResponse((Path(__file__).parent / "assets" / "sign_in.html").read_text("utf-8"))
        if request.method != "POST":
            return _refusal(405, "This is not possible here.", "Use the form.")
        given: Any = None
        with suppress(UsageError):  # what is no token is a wrong one
            given = (await read_object(request)).get("token")
        refusal = self._refusal_of(given if isinstance(given, str) else "", request)
        if refusal is not None:
            return refusal
        answer = JSONResponse({"signed_in": True})
        answer.set_cookie(
            self._cookie, self._session, max_age=_COOKIE_AGE_S, httponly=True, samesite="strict", path="/"
        )
        return answer


def _host_name(host: str) -> str:
    """Return the name in a ``Host`` header, in small letters, without its port and last dot; empty if it is none."""
    with suppress(ValueError):
        return (urlsplit(f"//{host}").hostname or "").rstrip(".")
    return ""


def _is_for_a_person(request: Request) -> bool:
    """Return whether a browser asks for a page, not a program for data."""
    return "text/html" in request.headers.get("accept", "") and request.method == "GET"


def _ask_to_sign_in(request: Request) -> Response:
    if _is_for_a_person(request):
        return RedirectResponse(f"{SIGN_IN}?next={quote(request.url.path)}", status_code=303)
    return _refusal(401, "You are not signed in.", f"Open {SIGN_IN} and enter the token.")


def _own_names(host: str) -> frozenset[str]:
    """Return the names of this computer, if the server is open to others."""
    if is_loopback(host):
        return frozenset()
    name = socket.gethostname().lower()
    return frozenset({name, name.partition(".")[0], f"{name.partition('.')[0]}.local"})


def _same_origin(headers: Headers, host: str) -> bool:
    scheme, separator, netloc = headers.get("origin", "").partition("://")
    return bool(separator) and scheme in {"http", "https"} and netloc.lower() == host.lower()


def known_by(request: Request) -> Literal["token", "typed"]:
    """Return how the name of a person on a page is known: who had the token, or only what somebody typed."""
    return "token" if request.scope.get(SIGNED_IN) else "typed"


def _refusal(status: int, what: str, remedy: str) -> Response:
    return error_answer(Failure("UsageError", what, "", remedy), status)
