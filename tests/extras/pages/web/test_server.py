"""The server of pages and its streams, over real sockets."""

import os
import socket
import time
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from pages import served
from starlette.responses import JSONResponse, PlainTextResponse
from starlette.routing import Route
from waiting import wait_until

from bench.base.errors import UsageError
from bench.extras.pages.web.pages import page_app, read_object
from bench.extras.pages.web.server import PageServer
from bench.extras.pages.web.server_sent import Changes, EventStream, Message, last_id
from bench.extras.pages.web.token import PageToken


class _Counter:
    """A source of messages that counts up; it remembers its readers."""

    def __init__(self):
        self.changes, self.open, self.closed = Changes(), 0, 0

    async def messages(self, after):
        self.open += 1
        seen = int(after or 0)
        try:
            while True:
                while seen < self.changes.number:
                    seen += 1
                    yield Message(f'{{"n": {seen}}}', "count", str(seen))
                await self.changes.after(seen)
        finally:
            self.closed += 1

    def app(self):
        def stream(request):
            return EventStream(self.messages(last_id(request)), heartbeat_s=0.05)

        return page_app([Route("/stream", stream), Route("/", lambda _: PlainTextResponse("page"))])


def _ids(lines, count):
    ids = []
    for line in lines:
        if line.startswith("id: "):
            ids.append(int(line[4:]))
        if len(ids) == count:
            break
    return ids


def test_a_stream_tells_changes_of_another_thread_and_continues_where_a_reader_stopped():
    counter = _Counter()
    with served(counter.app()) as server:
        for _ in range(3):
            counter.changes.tell()
        with httpx.stream("GET", f"{server.url}stream") as answer:
            lines = answer.iter_lines()
            assert _ids(lines, 3) == [1, 2, 3]
            counter.changes.tell()
            assert _ids(lines, 1) == [4]
        with httpx.stream("GET", f"{server.url}stream", headers={"Last-Event-ID": "2"}) as answer:
            assert _ids(answer.iter_lines(), 2) == [3, 4]
        with httpx.stream("GET", f"{server.url}stream?after=3") as answer:
            assert _ids(answer.iter_lines(), 1) == [4]


def test_a_stream_ends_when_its_reader_leaves_also_while_nothing_happens():
    counter = _Counter()
    with served(counter.app()) as server:
        with httpx.stream("GET", f"{server.url}stream") as answer:
            lines = answer.iter_lines()
            assert any(line == "event: beat" for line in lines)
            assert (counter.open, counter.closed) == (1, 0)
        wait_until(lambda: counter.closed == 1)


def test_the_server_ends_at_once_although_streams_are_open():
    counter = _Counter()
    with served(counter.app()) as server, httpx.stream("GET", f"{server.url}stream") as answer:
        assert answer.status_code == 200
        lines = answer.iter_lines()
        next(lines)
        begin = time.monotonic()
        server.stop()
        list(lines)
        assert time.monotonic() - begin < 1.5
    assert counter.closed == 1


def test_a_port_in_use_is_one_clear_error():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(UsageError, match=f"--port {port}: .*in use"):
            PageServer(_Counter().app(), port=port)


def test_an_address_of_another_computer_is_one_clear_error():
    with pytest.raises(UsageError, match="address"):
        PageServer(_Counter().app(), host="192.0.2.1", token=PageToken("0123456789abcdef"))


def test_only_a_token_that_was_made_stands_in_the_address_and_the_browser_gets_it_from_a_file(monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    with served(_Counter().app(), token=PageToken("given-by-a-person")) as server:
        assert server.address == server.url
    with served(_Counter().app(), token=PageToken("made-now-123456", made=True)) as server:
        assert server.address == f"{server.url}sign-in#token=made-now-123456"
        assert httpx.get(f"{server.url}").status_code == 401
        server.open_browser()
        wait_until(lambda: opened)
        path = Path(urlsplit(opened[0]).path)
        assert "made-now-123456" not in opened[0]
        assert server.address in path.read_text()
        if os.name == "posix":
            assert path.parent.stat().st_mode & 0o077 == 0
    assert not path.exists()


@pytest.mark.parametrize(
    "begun",
    [
        b"",
        b"GET / HTTP/1.1\r\nHost: 127",
        b"GET / HTTP/1.1\r\nHost: {host}\r\n\r\nGET /",
        b"POST /do HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nContent-Length: 9\r\n\r\n{",
    ],
)
def test_a_request_that_does_not_end_is_closed_after_a_time(monkeypatch, begun):
    monkeypatch.setattr("bench.extras.pages.web.server.REQUEST_S", 1.0)
    with (
        served(_app_that_reads()) as server,
        socket.create_connection(("127.0.0.1", server.port), timeout=5.0) as half,
    ):
        half.sendall(begun.replace(b"{host}", f"127.0.0.1:{server.port}".encode()))
        if begun.endswith(b"GET /"):
            answer = b""
            while not answer.endswith(b"page"):
                answer += half.recv(65536)
            half.sendall(b" HTT")
        begin = time.monotonic()
        assert half.recv(65536) == b""
        assert time.monotonic() - begin < 4.0


def test_who_is_signed_in_is_answered_while_strangers_hold_connections(monkeypatch, capfd):
    monkeypatch.setattr("bench.extras.pages.web.server.ACCEPTED", 8)
    monkeypatch.setattr("bench.extras.pages.web.server.MOST_CONNECTIONS", 64)
    counter, token = _Counter(), "0123456789abcdef"
    signed_in = {"Authorization": f"Bearer {token}"}
    with (
        served(counter.app(), token=PageToken(token)) as server,
        httpx.stream("GET", f"{server.url}stream", headers=signed_in) as stream,
        ExitStack() as opened,
    ):
        lines = stream.iter_lines()
        host = urlsplit(httpx.get(server.url, headers={"Accept": "text/html"}).headers["Location"]).netloc
        strangers = []
        for number in range(300):
            stranger = opened.enter_context(socket.create_connection(("127.0.0.1", server.port), timeout=5.0))
            stranger.sendall(
                f"POST /sign-in HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nContent-Length: 9\r\n\r\n".encode()
            )
            strangers.append(stranger)
            if number % 60 == 59:
                # The time it takes is that of a computer which may be busy.
                assert httpx.get(server.url, headers=signed_in, timeout=20.0).text == "page"
        assert 0 < 300 - sum(map(_is_closed, strangers)) <= 64
        counter.changes.tell()
        assert _ids(lines, 1) == [1]
    assert capfd.readouterr() == ("", "")


def test_no_header_gives_a_guesser_another_address():
    with served(_Counter().app(), token=PageToken("0123456789abcdef")) as server, httpx.Client() as client:
        guesses = [
            client.get(
                server.url, headers={"Authorization": "Bearer no", "X-Forwarded-For": f"192.0.2.{number}"}
            )
            for number in range(12)
        ]
    assert [guess.status_code for guess in guesses] == [401] * 10 + [429] * 2


def test_a_server_for_others_says_that_the_line_is_not_encrypted_and_names_a_tunnel(capsys):
    with served(_Counter().app(), host="0.0.0.0", token=PageToken("0123456789abcdef")) as server:
        server.welcome(open_browser=False)
    address, note = capsys.readouterr().out.splitlines()
    assert address == server.address
    assert "not encrypted" in note
    assert f"ssh -L {server.port}:127.0.0.1:{server.port} " in note


def _app_that_reads():
    async def read(request):
        return JSONResponse(await read_object(request))

    return page_app(
        [Route("/do", read, methods=["POST"]), Route("/", lambda _request: PlainTextResponse("page"))]
    )


def _is_closed(connection):
    connection.setblocking(False)
    try:
        return connection.recv(65536) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True
