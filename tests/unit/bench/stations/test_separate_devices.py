"""A camera that is open at once, and a stage and a light that come later, fail, or are tried again."""

import threading

import pytest
from fake_devices import FakeCamera, FakeLight, FakeStage
from waiting import wait_until

from bench.base.clock import BenchClock
from bench.stations import orphans as opening
from bench.stations.orphans import LateDevice, SeparateDevices
from bench.stations.station import load_station
from drivers.errors import PortNotFound, StillOpening


@pytest.fixture
def opened(monkeypatch):
    """Devices whose light opens at once, and whose stage waits for a word; and what opens the stage."""
    go, made = threading.Event(), []

    def stage(*_):
        assert go.wait(5.0)
        go.clear()
        if not made:
            made.append(None)
            raise PortNotFound("no such port.", where="gimbal", remedy="Plug it in.")
        made.append(FakeStage())
        return made[-1]

    station = load_station("example_evk4").value
    monkeypatch.setattr(opening, "open_stage", stage)
    monkeypatch.setattr(opening, "open_light", lambda *_: FakeLight())
    monkeypatch.setattr(opening, "open_camera", lambda *_: FakeCamera())
    devices = SeparateDevices(station, seed=1, clock=BenchClock())
    yield devices, go, made
    go.set()
    devices.close()


def test_the_camera_needs_nobody_and_a_stage_that_opens_knows_its_axes(opened):
    devices, _, _ = opened
    assert devices.camera.identify().serial == "00050423"
    assert set(devices.stage.axes) == set(devices.stage.limits)
    with pytest.raises(StillOpening, match="stage: The stage is still being opened"):
        devices.stage.position_deg()
    wait_until(lambda: devices.late["light"].state == "open")
    assert devices.light.is_on() is False


def test_a_device_that_failed_says_why_from_every_call_and_can_be_tried_again(opened):
    devices, go, made = opened
    ended = []
    go.set()
    wait_until(lambda: devices.late["stage"].state == "failed")
    devices.late["stage"].listen(lambda: ended.append(devices.late["stage"].state))
    assert ended == ["failed"]
    with pytest.raises(PortNotFound, match="Plug it in"):
        devices.stage.position_deg()
    devices.late["stage"].start()
    devices.late["light"].start()  # it is open: nothing is done
    go.set()
    wait_until(lambda: ended == ["failed", "open"])
    assert devices.stage.position_deg() == {"pan": 0.0, "tilt": 0.0}
    devices.close()
    assert made[-1].calls == ["close"]
    with pytest.raises(Exception, match="closed"):
        devices.stage.position_deg()


def test_closing_waits_for_a_device_that_is_being_opened():
    go, closed = threading.Event(), []

    def opener(stack):
        assert go.wait(5.0)
        stack.callback(closed.append, "closed")
        return FakeLight()

    device = LateDevice("light", opener)
    device.start()
    threading.Timer(0.1, go.set).start()
    device.close()
    assert closed == ["closed"]
    device.start()
    assert device.state == "failed"
