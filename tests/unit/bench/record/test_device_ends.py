"""How a run left each device: only what a device answered is called safe."""

from unittest.mock import create_autospec

import pytest

from bench.base.clock import BenchClock
from bench.record.device_end import DeviceEnd, all_ends
from bench.stations import devices
from bench.stations.station import load_station
from drivers.errors import PortNotFound, ReplyTimeout
from drivers.stage.zaber import ZaberStage


@pytest.mark.parametrize(
    ("device", "state", "reason", "text"),
    [
        ("light", "confirmed safe", "it was read back as off", "it was read back as off."),
        ("light", "not confirmed", "no reply.", "no reply. The light may be on."),
        ("light", "never opened", "", "This run did not switch it. The light may be on."),
        ("stage", "not confirmed", "no reply", "no reply. The stage may be moving."),
        ("stage", "never opened", "", "This run did not move it."),
        ("camera", "never opened", "", ""),
    ],
)
def test_the_text_says_what_may_be_the_case(device, state, reason, text):
    end = DeviceEnd(device, state, reason)
    assert end.text == f"{device}: {state}{':' if reason else '.'} {text}".rstrip()


def test_a_device_that_nobody_mentions_was_never_opened():
    light = DeviceEnd("light", "confirmed safe", "off")
    assert [end.state for end in all_ends([light])] == ["never opened", "confirmed safe", "never opened"]


@pytest.mark.parametrize(
    ("stop", "state", "reason"),
    [
        (None, "confirmed safe", "it confirmed the stop and reads pan 1.250 deg"),
        (
            ReplyTimeout("no complete reply within 2 s."),
            "not confirmed",
            "the stage did not confirm its stop: no complete reply within 2 s.",
        ),
    ],
)
def test_a_light_that_cannot_be_opened_leaves_a_stopped_stage_and_says_so(monkeypatch, stop, state, reason):
    """The run said "nothing was moved or switched", whatever had been opened before."""
    station = load_station("example_evk4").value
    stage = create_autospec(ZaberStage, instance=True)
    stage.stop.side_effect, stage.position_deg.return_value = stop, {"pan": 1.25}
    monkeypatch.setattr(type(station.stage), "open_device", lambda *_, **__: stage)
    monkeypatch.setattr(devices, "hold_devices", lambda _devices: devices.ExitStack())

    def missing(*_, **__):
        raise PortNotFound("there is no such port.", where="/dev/lamp")

    monkeypatch.setattr(type(station.light), "open_device", missing)
    with pytest.raises(PortNotFound) as caught:
        devices.Devices(station, seed=1, clock=BenchClock(), wire_log=None)
    (left,) = devices.left_devices(caught.value)
    assert (left.device, left.state, left.said) == ("stage", state, reason)
    stage.close.assert_called_once()
    assert devices.left_devices(ValueError()) == []
