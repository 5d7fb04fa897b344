"""Ask pages in a test: without a server, or served in a thread."""

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx

from bench.extras.pages.web.server import PageServer


@contextmanager
def served(app: Any, **options: Any) -> Iterator[PageServer]:
    """Serve ``app`` on a free port until the block ends; the server has ended when this returns."""
    server = PageServer(app, **options)
    ready = threading.Event()
    thread = threading.Thread(target=server.serve, args=(ready.set,), daemon=True)
    thread.start()
    assert ready.wait(10.0)
    try:
        yield server
    finally:
        server.stop()
        thread.join(10.0)
        assert not thread.is_alive()


class AppClient:
    """Sends requests to an application without a server; keeps cookies."""

    def __init__(self, app: Any, base_url: str = "http://127.0.0.1:8800") -> None:
        self._app, self.base_url = app, base_url
        self.cookies, self.host = httpx.Cookies(), "127.0.0.1"

    def request(self, method: str, path: str, **options: Any) -> httpx.Response:
        """Send one request and return its answer, which must end."""

        async def ask() -> httpx.Response:
            transport = httpx.ASGITransport(self._app, client=(self.host, 4711))
            async with httpx.AsyncClient(
                transport=transport, base_url=self.base_url, cookies=self.cookies
            ) as client:
                answer = await client.request(method, path, **options)
                self.cookies = client.cookies
                return answer

        return asyncio.run(ask())

    def get(self, path: str, **options: Any) -> httpx.Response:
        """Send a GET request."""
        return self.request("GET", path, **options)

    def post(self, path: str, **options: Any) -> httpx.Response:
        """Send a POST request."""
        return self.request("POST", path, **options)
