"""The requests of the align page: who may ask what, and what a wrong request ends in."""

import json
import threading
import time

import httpx
import pytest
from align_fakes import served_bench
from waiting import wait_until

ONE, TWO = "page-one", "page-two"


class Page:
    """A client that behaves as a page: it keeps a stream open, and beats."""

    def __init__(self, url, name):
        self.url, self.name = url, name
        self.client = httpx.Client(base_url=url, headers={"Origin": url.rstrip("/")}, timeout=10)
        self.events = []
        self.open = threading.Event()
        self.closing = False
        self.thread = threading.Thread(target=self._listen, daemon=True)
        self.thread.start()
        assert self.open.wait(5)

    def _listen(self):
        event = ""
        with httpx.stream("GET", f"{self.url}stream?page={self.name}", timeout=10) as stream:
            for line in stream.iter_lines():
                if line.startswith("event: "):
                    event = line[7:]
                elif line.startswith("data: ") and event in ("state", "picture"):
                    self.events.append((event, json.loads(line[6:])))
                    self.open.set()
                if self.closing:
                    return

    def do(self, what, /, **body):
        return self.client.post(f"do/{what}", json={"page": self.name, **body})

    def refused(self, what, /, **body):
        answer = self.do(what, **body)
        assert answer.status_code in (400, 409), answer.text
        error = answer.json()["error"]
        assert error["what"]
        assert error["remedy"]
        return error["what"]

    def state(self):
        return next(data for event, data in reversed(self.events) if event == "state")

    def close(self):
        self.closing = True
        self.thread.join(5)
        self.client.close()


@pytest.fixture
def bench():
    with served_bench() as (server, session, devices):
        yield server.url, session, devices


@pytest.fixture
def page(bench):
    bench[2].stage.step_deg = 0.02
    first_page = Page(bench[0], ONE)
    yield first_page
    first_page.close()


def test_a_stream_shows_state_and_pictures_and_the_image_is_fetched(bench, page):
    wait_until(lambda: any(event == "picture" and data["number"] > 1 for event, data in page.events))
    state = page.state()
    assert state["station"]["name"] == "Simulated bench"
    assert state["holder"] == ONE
    image = httpx.get(bench[0] + "image")
    assert image.headers["content-type"] == "image/jpeg"
    assert image.content[:2] == b"\xff\xd8"


def test_one_page_holds_the_controls_and_another_may_take_them(bench, page):
    _, session, devices = bench
    two = Page(bench[0], TWO)
    assert page.do("jog", steps_deg={"pan": 0.1}).status_code == 200
    assert "has the controls" in two.refused("jog", steps_deg={"pan": 0.1})
    assert "Another page" in two.refused("light", on=True)
    assert devices.light.calls == []
    wait_until(lambda: not session.bench.stage.moving)
    assert devices.stage.at["pan"] == pytest.approx(0.1)
    assert two.do("take").status_code == 200
    assert two.do("jog", steps_deg={"pan": 0.1}).status_code == 200
    assert "Another page" in page.refused("jog", steps_deg={"pan": 0.1})
    wait_until(lambda: page.state()["holder"] == TWO)
    two.close()


def test_taking_over_stops_the_motion_of_the_other_page(bench, page):
    _, session, devices = bench
    page.do("jog", steps_deg={"pan": 5.0})
    two = Page(bench[0], TWO)
    two.do("take")
    assert "stop" in devices.stage.calls
    wait_until(lambda: not session.bench.stage.moving)
    assert devices.stage.at["pan"] < 5
    two.close()


def test_every_page_may_stop(bench, page):
    _, session, devices = bench
    page.do("jog", steps_deg={"pan": 5.0})
    there = bench[0] + "do/stop", {"Origin": bench[0].rstrip("/")}
    answer = httpx.post(there[0], json={"page": "page-other"}, headers=there[1])
    assert answer.status_code == 200
    assert "stop" in devices.stage.calls
    assert not session.bench.stage.moving


def test_the_end_of_a_stream_is_enough_even_while_heartbeats_come(bench, page):
    """A proxy or a worker may go on beating for a page that nobody sees any more."""
    _, session, devices = bench
    page.do("jog", steps_deg={"pan": 5.0})
    page.do("jog", steps_deg={"pan": 5.0})
    for _ in range(5):
        session.holder.beat(ONE)
        time.sleep(0.1)
    assert "stop" not in devices.stage.calls
    page.close()
    wait_until(lambda: "stop" in devices.stage.calls, 1.0)


@pytest.mark.parametrize(
    ("what", "body", "words"),
    [
        ("jog", {}, "names no axis"),
        ("jog", {"steps_deg": {"pan": "1"}}, "pan is not a number"),
        ("light", {"on": "yes"}, "true or false"),
        ("light", {"frequency_hz": None}, "not a number"),
        ("dance", {}, "cannot ask for 'dance'"),
    ],
)
def test_a_wrong_request_is_refused_in_words_and_changes_nothing(bench, page, what, body, words):
    assert words in page.refused(what, **body)
    assert bench[2].stage.calls == []
    assert bench[2].light.calls == []


def test_a_request_without_page_foreign_host_or_origin_is_refused(bench):
    url, _, devices = bench
    origin = {"Origin": url.rstrip("/")}
    assert httpx.post(url + "do/stop", json={}, headers=origin).status_code == 400
    assert httpx.post(url + "do/stop", content=b"no json", headers=origin).status_code == 400
    assert httpx.post(url + "do/stop", json={"page": ONE}).status_code == 403
    answer = httpx.post(url + "do/stop", json={"page": ONE}, headers={"Origin": "http://x.org"})
    assert answer.status_code == 403
    assert httpx.get(url + "state", headers={"Host": "bench.example.org"}).status_code == 421
    assert devices.stage.calls == []


def test_clearing_the_curve_reaches_the_live_picture(bench, page):
    curve = bench[1].bench.loop.curve
    assert page.do("forget").status_code == 200
    assert bench[1].bench.loop.curve is not curve
