"""Who may use the pages: names of the host, origins, the token, and the headers of every answer."""

import re

import httpx
import pytest
from pages import AppClient
from starlette.responses import PlainTextResponse
from starlette.routing import Route

from bench.base.errors import UsageError
from bench.extras.pages.web.guard import Guard
from bench.extras.pages.web.pages import page_app
from bench.extras.pages.web.token import TOKEN_VARIABLE, PageToken, page_token, require_token

TOKEN = "0123456789abcdef"

HTML = {"Accept": "text/html"}


def _app():
    return page_app(
        [
            Route("/", lambda _: PlainTextResponse("first page")),
            Route("/do", lambda _: PlainTextResponse("done"), methods=["POST"]),
        ]
    )


def _client(url="http://127.0.0.1:8800", **options) -> AppClient:
    options = {"host": "127.0.0.1", "port": 8800, "token": None, **options}
    return AppClient(Guard(_app(), **options), url)


@pytest.mark.parametrize(
    "name", ["127.0.0.1:8800", "localhost:8800", "[::1]:8800", "LOCALHOST", "localhost."]
)
def test_a_name_of_this_computer_is_answered(name):
    assert _client().get("/", headers={"Host": name}).text == "first page"


@pytest.mark.parametrize(
    "name", ["evil.example", "evil.example:8800", "192.168.1.7:8800", "127.0.0.1.evil.example", "", "["]
)
def test_another_name_is_refused(name):
    answer = _client().get("/", headers={"Host": name})
    assert answer.status_code == 421
    assert "not answer to" in answer.json()["error"]["what"]


def test_a_server_for_others_answers_to_addresses_but_not_to_foreign_names():
    client = _client(host="0.0.0.0", token=PageToken(TOKEN))
    signed = {"Authorization": f"Bearer {TOKEN}"}
    assert client.get("/", headers={"Host": "192.168.1.7:8800", **signed}).status_code == 200
    assert client.get("/", headers={"Host": "evil.example:8800", **signed}).status_code == 421


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:9999", "127.0.0.1:8800", None]
)
def test_a_command_from_another_origin_is_refused(origin):
    answer = _client().post("/do", headers={} if origin is None else {"Origin": origin})
    assert answer.status_code == 403
    assert "a page of this server" in answer.json()["error"]["what"]


def test_a_command_from_our_own_page_is_done():
    assert _client().post("/do", headers={"Origin": "http://127.0.0.1:8800"}).text == "done"


def test_every_answer_forbids_other_hosts():
    client = _client()
    for answer in (
        client.get("/"),
        client.get("/nowhere"),
        client.get("/", headers={"Host": "evil.example"}),
    ):
        policy = answer.headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy
        assert "http" not in policy
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Cache-Control"] == "no-store"


def test_assets_are_served_and_asked_for_again():
    answer = _client().get("/assets/bench.css")
    assert answer.status_code == 200
    assert answer.headers["Cache-Control"] == "no-cache"


def _session_url(client: AppClient) -> str:
    """Follow a server of this computer to the host that its session goes to."""
    moved = client.get("/", headers=HTML)
    assert moved.status_code == 307
    return moved.headers["Location"].rstrip("/")


def _at_session_host(**options) -> tuple[AppClient, dict[str, str]]:
    client = _client(**{"token": PageToken(TOKEN), **options})
    url = _session_url(client)
    client.base_url = url
    return client, {"Origin": url}


def test_without_the_token_a_page_leads_to_the_sign_in_and_a_request_is_refused():
    client, _ = _at_session_host()
    page = client.get("/", headers=HTML)
    assert (page.status_code, page.headers["Location"]) == (303, "/sign-in?next=/")
    assert client.get("/").status_code == 401
    assert 'type="password"' in client.get("/sign-in").text


def test_a_browser_is_led_to_a_host_of_this_start_alone_and_keeps_path_and_port_of_a_tunnel():
    first, second = (_client(token=PageToken(TOKEN)) for _ in range(2))
    asked = {"Host": "localhost:9911", **HTML}
    moved = [client.get("/run/x?pose=3", headers=asked).headers["Location"] for client in (first, second)]
    moved_to = r"http://starbench-[0-9a-f]{16}\.localhost:9911/run/x\?pose=3"
    assert all(re.fullmatch(moved_to, address) for address in moved)
    assert moved[0] != moved[1]


@pytest.mark.parametrize("name", ["127.0.0.1:8800", "localhost:8800", "starbench-0.localhost:8800"])
def test_a_host_that_other_servers_share_gets_no_session(name):
    client = _client(token=PageToken(TOKEN))
    headers = {"Host": name, "Origin": f"http://{name}"}
    answer = client.post("/sign-in", json={"token": TOKEN}, headers=headers)
    assert answer.status_code == 421
    assert "Set-Cookie" not in answer.headers


def test_a_sign_in_keeps_a_random_session_that_does_not_come_from_the_token():
    client, own = _at_session_host()
    answer = client.post("/sign-in", json={"token": TOKEN}, headers=own)
    cookie = answer.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    assert "Domain" not in cookie  # so it goes to this host alone
    assert client.get("/").text == "first page"
    again, _ = _at_session_host()  # the server was started again, with the same token: another session
    again.cookies = httpx.Cookies(dict(client.cookies))
    assert again.get("/").status_code == 401


@pytest.mark.parametrize(
    "body", [b'{"token": "wrong"}', b'{"token": 7}', b"[]", b"\xff", b"x" * 20_000, b'{"token": "\\ud800"}', b"9" * 5000],
)  # fmt: skip
def test_a_wrong_token_is_refused(body):
    client, own = _at_session_host()
    answer = client.post("/sign-in", content=body, headers=own)
    assert answer.status_code == 403
    assert answer.json()["error"]["what"] == "This token is wrong."
    assert "Set-Cookie" not in answer.headers


def _signs_in(client, token):
    return client.post("/sign-in", json={"token": token}, headers={"Origin": client.base_url}).status_code


def _bears(client, token):
    return client.get("/", headers={"Authorization": f"Bearer {token}"}).status_code


def test_guessing_is_slow_in_both_ways_and_shuts_out_nobody_else():
    now = [0.0]
    client, _ = _at_session_host(monotonic=lambda: now[0])
    assert [_signs_in(client, "no") for _ in range(6)] == [403] * 6
    assert [_bears(client, "no") for _ in range(6)] == [401] * 4 + [429] * 2
    assert (_signs_in(client, TOKEN), _bears(client, TOKEN)) == (429, 429)
    client.host = "192.168.1.9"
    assert (_bears(client, TOKEN), _signs_in(client, TOKEN)) == (200, 200)
    client.host = "127.0.0.1"
    assert client.get("/").text == "first page"  # who is signed in stays so
    now[0] = 61.0
    client.cookies.clear()
    assert _signs_in(client, TOKEN) == 200


def test_nobody_can_shut_out_others_by_wrong_guesses_of_a_token_that_was_made():
    client, _ = _at_session_host(token=PageToken(TOKEN, made=True))
    assert {_signs_in(client, "no") for _ in range(20)} == {403}
    assert _signs_in(client, TOKEN) == 200


# ---------------------------------------------------------------- the token


def test_the_token_comes_from_the_environment_unless_none_is_wanted():
    environ = {TOKEN_VARIABLE: "from-the-environment"}
    assert page_token(environ=environ) == PageToken("from-the-environment")
    assert page_token(none=True, environ=environ) is None


def test_without_one_each_start_makes_a_token_that_nobody_can_guess():
    made = {page_token(environ={}).text for _ in range(100)}
    assert len(made) == 100
    assert min(map(len, made)) >= 22  # 128 bits
    assert page_token(environ={}).made


@pytest.mark.parametrize("token", ["short", "with\x00control-characters"])
def test_a_weak_token_is_refused(token):
    with pytest.raises(UsageError, match="at least 12 printable"):
        page_token(environ={TOKEN_VARIABLE: token})


def test_other_computers_need_a_token():
    require_token("127.0.0.1", None)
    require_token("0.0.0.0", PageToken("0123456789abcdef"))
    with pytest.raises(UsageError, match="need a token"):
        require_token("0.0.0.0", None)
