"""The align page in a real browser: what a person sees, jogs, stops and writes down. Skipped where no Chromium is."""

import re
import shutil
import time

import pytest
from align_browser import Tab
from align_fakes import served_bench
from pages import served
from waiting import wait_until

from bench.align.align_app import align_app
from bench.align.page_requests import PageFiles
from bench.align.session import Session
from bench.stations.devices import Devices
from bench.stations.station import SHIPPED_STATIONS, load_station
from drivers.errors import CameraLost


class Wire:
    """Notes when something was sent to a port."""

    def __init__(self):
        self.sent = []

    def record(self, _t_s, port, direction, data):
        if direction == ">":
            self.sent.append((time.time(), port, data))


@pytest.fixture
def bench(tmp_path):
    with served_bench(tmp_path) as bench:
        yield bench


def test_a_person_looks_jogs_stops_and_writes_down(chromium, bench, tmp_path):
    server, session, devices = bench
    one = Tab(chromium, server.url)
    one.wait("alignStats.images > 1")
    one.wait_text("#holder", "This page (page 1) has the controls")
    assert devices.stage.calls == []  # opening, and looking, moves nothing

    one.tab.click("[data-axis=pan] .plus")
    one.wait_text("[data-axis=pan] .deg", "0.500°")
    one.tab.select_option("#step", "5")
    devices.stage.step_deg = 0.005
    one.tab.click("[data-axis=tilt] .minus")
    wait_until(lambda: devices.stage.at["tilt"] < 0)
    one.tab.click("#stop")
    wait_until(lambda: "stop" in devices.stage.calls)
    one.wait_text("#stage-state", "at rest")
    assert -4.5 < devices.stage.at["tilt"] < 0

    two = Tab(chromium, server.url)
    two.wait_text("#holder", "Page 1")
    assert two.tab.is_disabled("[data-axis=pan] .plus")
    two.tab.click("#take")
    one.wait_text("#holder", "Page 2")
    two.close()

    one.tab.click("#take")
    one.wait("!document.querySelector('#light-on').disabled")
    one.tab.fill("#level", "50")
    one.tab.click("#light-on")
    one.wait_text("#light-state", "on")
    one.tab.uncheck("[value=biases]")
    one.tab.click("#propose")
    one.wait_text("#difference", "+  high_v: 2.5")
    assert "high_v: 5" in (tmp_path / "bench.yaml").read_text()
    one.tab.click("#write")
    wait_until(lambda: "high_v: 2.5" in (tmp_path / "bench.yaml").read_text())

    one.tab.select_option("#step", "5")
    one.tab.click("[data-axis=pan] .plus")
    wait_until(lambda: session.bench.stage.moving)
    stops = devices.stage.stops
    one.close()  # in motion
    wait_until(lambda: devices.stage.stops > stops, 1.0)
    assert one.hosts == {server.url.split("/")[2]}


@pytest.mark.parametrize(("width", "height"), [(1366, 768), (1920, 1080)])
def test_advice_and_picture_are_whole_and_together_wherever_the_page_is_scrolled(
    chromium, bench, width, height
):
    server, session, _ = bench
    session.light(on=True)
    one = Tab(chromium, server.url)
    one.tab.set_viewport_size({"width": width, "height": height})
    one.wait("alignStats.images > 0")
    box = "(id => (r => [r.top, r.bottom, r.width])(document.getElementById(id).getBoundingClientRect()))"
    for name in ("home", "check", "write-card"):
        one.tab.evaluate(f"document.getElementById('{name}').scrollIntoView({{block: 'end'}})")
        header = one.tab.evaluate(f"{box}('stop')")[1]
        wait_until(lambda edge=header: one.tab.evaluate(f"{box}('advice')")[0] >= edge)
        advice, picture = (one.tab.evaluate(f"{box}('{part}')") for part in ("advice", "picture"))
        assert header <= advice[0] < advice[1] <= picture[0] < picture[1] <= height, name
        assert picture[2] > 0.4 * width
    one.tab.focus("#check")
    on_top = "(r => document.elementFromPoint(r.left + r.width / 2, r.top + r.height / 2).id)"
    assert one.tab.evaluate(f"{on_top}(document.getElementById('check').getBoundingClientRect())") == "check"
    one.close()


def test_before_home_the_page_turns_to_no_angle_and_writes_none(chromium, bench):
    server, session, devices = bench
    devices.stage.homed = False
    one = Tab(chromium, server.url)
    one.wait_text("#stage-state", "not homed")
    one.wait_text("#advice", "Press Home")
    one.wait_text("#turn-note", "Press Home first")
    assert one.tab.is_disabled("#turn-there")
    assert one.tab.is_disabled("[name=what][value=zero]")
    assert one.tab.is_disabled("#propose-pose")
    assert not one.tab.is_disabled("#propose")  # biases and level need no angle
    one.tab.click("#home")
    one.tab.click("#home-now")
    one.wait("!document.querySelector('[name=what][value=zero]').disabled")
    assert session.bench.stage.state.homed
    one.close()


def test_stop_is_red_in_the_dark_too(chromium, bench):
    one = Tab(chromium, bench[0].url)
    one.tab.emulate_media(color_scheme="dark")
    colour = one.tab.evaluate("getComputedStyle(document.getElementById('stop')).backgroundColor")
    red, green, blue = (int(part) for part in re.findall(r"\d+", colour)[:3])
    assert red > 180
    assert max(green, blue) < 60
    one.close()


@pytest.mark.parametrize(("width", "height"), [(1400, 1000), (390, 844)], ids=["desk", "phone"])
def test_the_picture_stays_in_view_and_stop_is_never_covered(chromium, bench, width, height):
    server, session, _ = bench
    session.light(on=True)
    one = Tab(chromium, server.url)
    one.tab.set_viewport_size({"width": width, "height": height})
    one.wait("alignStats.images > 0")
    ends = "(id => (r => [r.top, r.bottom, r.right])(document.getElementById(id).getBoundingClientRect()))"
    on_top = (
        "(r => document.elementFromPoint(r.left + r.width / 2, r.top + r.height / 2).id)"
        "(document.getElementById('stop').getBoundingClientRect())"
    )
    for card in ("bias-card", "light-card", "course"):
        one.tab.evaluate(f"document.getElementById('{card}').scrollIntoView({{block: 'end'}})")
        wait_until(lambda: one.tab.evaluate(f"{ends}('picture')")[0] >= 0)
        top, bottom, right = one.tab.evaluate(f"{ends}('picture')")
        assert bottom < height - 200, card  # there is room for what is changed
        assert right <= width
        assert top >= one.tab.evaluate(f"{ends}('stop')")[1]
        assert one.tab.evaluate(on_top) == "stop"
    server.stop()
    one.wait_text("#link", "The light may still be on.")
    assert one.tab.evaluate(on_top) == "stop"
    one.tab.evaluate("scrollTo(0, 0)")
    top, bottom, _ = one.tab.evaluate(f"{ends}('link')")
    assert one.tab.evaluate(f"{ends}('stop')")[1] <= top < bottom < height
    assert one.tab.evaluate(on_top) == "stop"
    one.tab.close()


def test_lost_devices_are_shown_and_the_old_picture_does_not_look_new(chromium, bench):
    server, _, devices = bench
    one = Tab(chromium, server.url)
    one.wait("alignStats.images > 0")
    devices.stage.lost = True
    devices.camera.fault = CameraLost("the cable is out.", where="camera", remedy="Plug it in.")
    one.wait_text("#trouble", "the cable is out. Plug it in.")
    one.wait_text("#stage-state", "does not answer")
    one.wait_text("#dark", "No new picture")
    devices.stage.lost, devices.camera.fault = False, None
    one.wait("document.getElementById('trouble').hidden")
    one.wait("document.getElementById('dark').hidden")
    one.close()


def test_a_reload_in_motion_stops_the_stage_and_the_page_comes_back_with_its_controls(chromium, bench):
    server, session, devices = bench
    one = Tab(chromium, server.url)
    one.wait("alignStats.images > 0")
    devices.stage.step_deg = 0.005
    one.tab.select_option("#step", "5")
    one.tab.click("[data-axis=pan] .plus")
    wait_until(lambda: session.bench.stage.moving)
    one.tab.reload()
    wait_until(lambda: "stop" in devices.stage.calls, 1.0)
    wait_until(lambda: not session.bench.stage.moving)
    assert devices.stage.at["pan"] < 5
    one.wait_text("#holder", "This page")
    moves = [call for call in devices.stage.calls if call[0] == "move"]
    time.sleep(0.3)
    assert [call for call in devices.stage.calls if call[0] == "move"] == moves  # coming back moves nothing
    one.close()


@pytest.mark.slow
def test_the_simulated_bench_is_aligned_in_the_browser(chromium, tmp_path):
    """The whole way with real drivers: live image, home, light, jog; a stop reaches the wire in 50 ms."""
    path = tmp_path / "bench.yaml"
    shutil.copy(SHIPPED_STATIONS / "simulated.yaml", path)
    wire = Wire()

    def opener(station, seed, clock):
        return Devices(station, seed=seed, clock=clock, wire_log=wire)

    session = Session(load_station(str(path)), opener=opener)
    assert session.open() is None
    try:
        with served(align_app(session, PageFiles(str(path), tmp_path))) as server:
            one = Tab(chromium, server.url)
            one.wait("alignStats.images > 0", 30)
            one.tab.click("#home")
            one.tab.click("#home-now")
            wait_until(lambda: session.bench.stage.state.homed, 30)
            one.tab.click("#light-on")
            one.wait_text("#light-state", "on")
            seen = session.picture().number
            wait_until(lambda: session.picture().number > seen + 3, 30)
            one.tab.click("[data-axis=pan] .plus")
            one.wait_text("[data-axis=pan] .deg", "0.500°")
            one.tab.select_option("#step", "5")
            one.tab.evaluate("addEventListener('pointerdown', () => { window.pressed = Date.now(); }, true)")
            one.tab.click("[data-axis=pan] .plus")
            wait_until(lambda: session.bench.stage.moving)
            one.tab.click("#stop")
            wait_until(lambda: any(b"stop" in data for _, _, data in wire.sent))
            stopped_s = next(t for t, _, data in wire.sent if b"stop" in data)
            assert (
                stopped_s - one.tab.evaluate("window.pressed") / 1e3 < 0.5
            )  # on a busy computer; 50 ms on a free one
            one.wait_text("#stage-state", "at rest")
            one.tab.click("#check")
            one.wait_text("#check-note", "ready for a run", 60)
            one.close()
    finally:
        confirmed = session.close()
    assert all(end.state == "confirmed safe" for end in confirmed)
