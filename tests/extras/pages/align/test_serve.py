"""The command around the align page: the URL first, a stop from the signal itself, and a word of every device."""

import os
import signal
import threading
import time

import httpx
import pytest
from align_fakes import fake_session
from fake_devices import FakeDevices
from waiting import wait_until

from bench.base.errors import ScriptError
from bench.extras.pages.align import serve
from bench.stations.station import SHIPPED_STATIONS
from drivers.errors import CameraBusy


@pytest.fixture
def aligned(monkeypatch):
    """Serve the page of a session until a condition holds and a task is done; return the status."""

    def serve_until(session, condition, first=lambda: None):
        monkeypatch.setattr(serve, "make_session", lambda *_, **__: session)
        thread = _interrupt_when(condition, first=first)
        status = serve.align_on_page("simulated", token=None, open_browser=False)
        thread.join()
        return status

    return serve_until


def _interrupt_when(condition, *, first=lambda: None):
    """Send SIGINT to this process as soon as a condition holds."""

    def wait():
        try:
            wait_until(condition, within_s=120.0)  # loops may have to be compiled first
            first()
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    return thread


def test_ctrl_c_stops_the_stage_at_once_and_every_device_confirms(aligned, capsys):
    session, devices = fake_session()
    asked = {}

    def move():
        session.bench.light.set(on=True)
        session.bench.stage.move_by({"pan": 5.0})
        wait_until(lambda: devices.stage.at["pan"] > 0)
        asked["s"] = time.monotonic()
        real = devices.stage.stop

        def stop():
            asked.setdefault("stop_s", time.monotonic())
            asked.setdefault("by", threading.current_thread().name)
            real()

        devices.stage.stop = stop

    before = signal.getsignal(signal.SIGINT)
    assert aligned(session, lambda: session.is_open, move) == 0
    assert asked["stop_s"] - asked["s"] < 0.5
    assert asked["by"] == "align-signal-stop"  # not only when the server has ended
    assert devices.stage.at["pan"] < 5
    assert not devices.light.lit
    assert devices.closed
    assert signal.getsignal(signal.SIGINT) is before
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("http://127.0.0.1:")
    assert [line.rpartition(": ")[0] for line in lines[-3:]] == [
        f"{device}: confirmed safe" for device in ("stage", "light", "camera")
    ]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_second_signal_does_not_break_off_the_leaving(aligned, number):
    session, devices = fake_session()
    real = devices.light.off

    def off():
        os.kill(os.getpid(), number)
        real()

    devices.light.off = off
    assert aligned(session, lambda: session.is_open) == 0
    assert devices.light.calls[-1] == "off"
    assert devices.closed


def test_a_device_that_does_not_confirm_is_shouted_and_the_status_is_1(aligned, capsys):
    session, devices = fake_session()
    devices.stage.stop_fails = True
    assert aligned(session, lambda: session.is_open) == 1
    assert "stage: not confirmed" in capsys.readouterr().out


def test_a_busy_camera_is_named_and_the_page_stays(aligned, capsys):
    def opener(*_):
        raise CameraBusy("another program holds it.", where="camera", remedy="Close that program.")

    session, _ = fake_session(opener=opener)
    assert aligned(session, lambda: session.state()["devices"]["state"] == "failed") == 0
    out = capsys.readouterr().out
    assert "camera: another program" in out
    assert out.splitlines()[-1] == "No device was open."


def test_the_page_answers_while_the_devices_open(aligned, monkeypatch):
    release, answers = threading.Event(), []
    session, _ = fake_session(opener=lambda *_: release.wait(5) and FakeDevices())
    urls = []
    monkeypatch.setattr("bench.extras.pages.web.server.print_line", urls.append)

    def look():
        answers.append(httpx.get(f"{urls[0]}state").json()["devices"]["state"])
        release.set()

    aligned(session, lambda: urls and session.state()["devices"]["state"] == "opening", look)
    assert answers == ["opening"]


def test_a_station_with_a_scale_that_nobody_filled_in_is_refused(tmp_path):
    path = tmp_path / "bench.yaml"
    text = (SHIPPED_STATIONS / "simulated.yaml").read_text()
    path.write_text(text.replace("microsteps_per_deg: 6400", "microsteps_per_deg: ASK-THE-DATA-SHEET", 1))
    with pytest.raises(ScriptError, match="microsteps_per_deg"):
        serve.make_session(str(path))
