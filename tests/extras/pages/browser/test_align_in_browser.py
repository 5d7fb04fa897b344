"""The align page in a real browser: what a person sees, jogs and stops. Skipped where no Chromium is."""

import time

import pytest
from align_browser import Tab
from align_fakes import served_bench
from pages import served
from waiting import wait_until

from bench.extras.pages.align.align_app import align_app
from bench.extras.pages.align.session import Session
from bench.stations.devices import Devices
from bench.stations.station import load_station
from drivers.errors import CameraLost


class Wire:
    """Notes when something was sent to a port."""

    def __init__(self):
        self.sent = []

    def record(self, _t_s, port, direction, data):
        if direction == ">":
            self.sent.append((time.time(), port, data))


@pytest.fixture
def bench():
    with served_bench() as bench:
        yield bench


def test_a_person_looks_jogs_stops_and_copies_lines(chromium, bench):
    server, session, devices = bench
    page = Tab(chromium, server.url)
    page.wait("alignStats.images > 1")
    page.wait_text("#holder", "This page has the controls")
    assert devices.stage.calls == []  # opening, and looking, moves nothing

    page.tab.click("[data-axis=pan] .plus")
    page.wait_text("[data-axis=pan] .deg", "0.500°")
    page.tab.select_option("#step", "5")
    devices.stage.step_deg = 0.005
    page.tab.click("[data-axis=tilt] .minus")
    wait_until(lambda: devices.stage.at["tilt"] < 0)
    page.tab.click("#stop")
    wait_until(lambda: "stop" in devices.stage.calls)
    page.wait_text("#stage-state", "at rest")
    assert -4.5 < devices.stage.at["tilt"] < 0

    two = Tab(chromium, server.url)
    two.wait_text("#holder", "Another page")
    assert two.tab.is_disabled("[data-axis=pan] .plus")
    two.tab.click("#take")
    page.wait_text("#holder", "Another page")
    two.close()

    page.tab.click("#take")
    page.wait("!document.querySelector('#light-on').disabled")
    page.tab.fill("#level", "50")
    page.tab.click("#light-on")
    page.wait_text("#light-state", "on")
    page.tab.click("#light-form button")
    page.wait_text("#station-lines", "light.high_v: 2.5")

    page.tab.select_option("#step", "5")
    page.tab.click("[data-axis=pan] .plus")
    wait_until(lambda: session.bench.stage.moving)
    stops = devices.stage.stops
    page.close()  # in motion
    wait_until(lambda: devices.stage.stops > stops, 1.0)
    assert page.hosts == {server.url.split("/")[2]}


def test_before_home_the_page_turns_to_no_angle(chromium, bench):
    server, session, devices = bench
    devices.stage.homed = False
    page = Tab(chromium, server.url)
    page.wait_text("#stage-state", "not homed")
    assert page.tab.is_disabled("#turn-there")
    page.tab.click("#home")
    page.tab.click("#home-now")
    page.wait_text("#stage-state", "at rest")
    assert session.bench.stage.as_data()["homed"]
    page.close()


@pytest.mark.parametrize(("width", "height"), [(1400, 1000), (390, 844)], ids=["desk", "phone"])
def test_the_picture_stays_in_view_and_stop_is_never_covered(chromium, bench, width, height):
    server, session, _ = bench
    session.bench.light.set(on=True)
    page = Tab(chromium, server.url)
    page.tab.set_viewport_size({"width": width, "height": height})
    page.wait("alignStats.images > 0")
    ends = "(id => (r => [r.top, r.bottom, r.right])(document.getElementById(id).getBoundingClientRect()))"
    on_top = (
        "(r => document.elementFromPoint(r.left + r.width / 2, r.top + r.height / 2).id)"
        "(document.getElementById('stop').getBoundingClientRect())"
    )
    for card in ("bias-card", "light-card", "curve"):
        page.tab.evaluate(f"document.getElementById('{card}').scrollIntoView({{block: 'end'}})")
        wait_until(lambda: page.tab.evaluate(f"{ends}('picture')")[0] >= 0)
        top, bottom, right = page.tab.evaluate(f"{ends}('picture')")
        assert bottom < height - 200, card  # there is room for what is changed
        assert right <= width
        assert top >= page.tab.evaluate(f"{ends}('stop')")[1]
        assert page.tab.evaluate(on_top) == "stop"
    server.stop()
    page.wait_text("#link", "The light may still be on.")
    assert page.tab.evaluate(on_top) == "stop"
    page.tab.evaluate("scrollTo(0, 0)")
    top, bottom, _ = page.tab.evaluate(f"{ends}('link')")
    assert page.tab.evaluate(f"{ends}('stop')")[1] <= top < bottom < height
    assert page.tab.evaluate(on_top) == "stop"
    page.tab.close()


def test_lost_devices_are_shown_and_the_old_picture_does_not_look_new(chromium, bench):
    server, _, devices = bench
    page = Tab(chromium, server.url)
    page.wait("alignStats.images > 0")
    devices.stage.lost = True
    devices.camera.fault = CameraLost("the cable is out.", where="camera", remedy="Plug it in.")
    page.wait_text("#trouble", "the cable is out. Plug it in.")
    page.wait_text("#stage-state", "does not answer")
    page.wait_text("#dark", "No new picture")
    devices.stage.lost, devices.camera.fault = False, None
    page.wait("document.getElementById('trouble').hidden")
    page.wait("document.getElementById('dark').hidden")
    assert "does not answer" not in page.tab.inner_text("#stage-state")
    page.close()


@pytest.mark.slow
def test_the_simulated_bench_is_aligned_in_the_browser(chromium):
    """The whole way with real drivers: live image, home, light, jog; a stop reaches the wire in 50 ms."""
    wire = Wire()

    def opener(station, clock):
        return Devices(station, seed=1, clock=clock, wire_log=wire)

    session = Session(load_station("simulated"), opener=opener)
    assert session.open() is None
    try:
        with served(align_app(session)) as server:
            page = Tab(chromium, server.url)
            page.wait("alignStats.images > 0", 30)
            page.tab.click("#home")
            page.tab.click("#home-now")
            wait_until(lambda: session.bench.stage.as_data()["homed"], 30)
            page.tab.click("#light-on")
            page.wait_text("#light-state", "on")
            seen = session.picture().number
            wait_until(lambda: session.picture().number > seen + 3, 30)
            page.tab.click("[data-axis=pan] .plus")
            page.wait_text("[data-axis=pan] .deg", "0.500°")
            page.tab.select_option("#step", "5")
            page.tab.evaluate("addEventListener('pointerdown', () => { window.pressed = Date.now(); }, true)")
            page.tab.click("[data-axis=pan] .plus")
            wait_until(lambda: session.bench.stage.moving)
            page.tab.click("#stop")
            wait_until(lambda: any(b"stop" in data for _, _, data in wire.sent))
            stopped_s = next(t for t, _, data in wire.sent if b"stop" in data)
            assert (
                stopped_s - page.tab.evaluate("window.pressed") / 1e3 < 0.5
            )  # on a busy computer; 50 ms on a free one
            page.wait_text("#stage-state", "at rest")
            page.close()
    finally:
        confirmed = session.close()
    assert all(end.state == "confirmed safe" for end in confirmed)
