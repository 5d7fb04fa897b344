"""The simulated EVK4 over its socket: commands, refusals and notifications."""

import json
import select
import struct
import threading

import pytest

from simulators.cameras.evk4 import SimulatedEvk4
from simulators.cameras.streaming import StreamFault
from simulators.pixels.sensor_stream import SensorStream
from simulators.world.truth_config import truth_from_config
from simulators.world.world import World
from tests.hil.evk4_host import COMPUTING, Host, bench


@pytest.fixture
def camera():
    camera = SimulatedEvk4(bench(), serial="00050423", paced=False)
    camera.start()
    yield camera
    camera.close()


def test_the_camera_reports_its_serial_number_sensor_format_and_size(camera):
    with Host(camera) as host:
        answer = host.ask("identify")
    assert answer["ok"]
    assert answer["id"] == 7
    assert (answer["serial"], answer["sensor"], answer["format"]) == ("00050423", "IMX636", "EVT3")
    assert (answer["width"], answer["height"]) == (320, 180)


def test_the_camera_reports_that_it_computes_only_while_a_frame_takes_long(camera, monkeypatch):
    compute, go_on = SensorStream.next_frame, threading.Event()
    monkeypatch.setattr(SensorStream, "next_frame", lambda self: (go_on.wait(60), compute(self))[1])
    with Host(camera) as host:
        assert host.ask("start")["ok"]
        assert host.any_frame() == (b"N", COMPUTING)
        assert host.any_frame() == (b"N", COMPUTING)
        go_on.set()
        assert host.frame()[0] == b"D"
        assert host.ask("stop")["ok"]


def test_the_camera_reports_nothing_while_its_stream_is_silenced(camera):
    with Host(camera) as host:
        host.record(1)  # all that is to be compiled is
        camera.stream_faults.inject(StreamFault("silence"))
        assert host.ask("start")["ok"]
        assert not select.select([host.link], [], [], 1.2)[0]


def test_settings_are_held_and_forgotten_at_the_next_connect(camera):
    with Host(camera) as host:
        assert host.ask("set_bias", name="bias_fo", value=-20)["ok"]
        assert host.ask("set_filter", name="erc", enabled=True)["ok"]
        assert host.ask("get_bias", name="bias_fo")["value"] == -20
        assert host.ask("get_filters")["erc"] is True
        assert host.ask("get_trigger_in")["enabled"] is False
        with Host(camera) as second:
            kind, payload = second.frame()
            assert (kind, json.loads(payload)["event"]) == (b"N", "fault")
    camera.unplug()
    with Host(camera) as host:
        assert set(host.ask("get_biases")["biases"].values()) == {0}
        assert not any(host.ask("get_filters")[name] for name in ("afk", "stc", "trail", "erc"))


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ({"cmd": "dance"}, "unknown_command"),
        ({"cmd": ["start"]}, "unknown_command"),
        ({"cmd": "set_bias", "name": "bias_x", "value": 1}, "unknown_bias"),
        ({"cmd": "set_bias", "name": "bias_fo", "value": 56}, "out_of_range"),
        ({"cmd": "set_bias", "name": "bias_fo", "value": 1.5}, "bad_value"),
        ({"cmd": "set_bias", "name": "bias_fo", "value": True}, "bad_value"),
        ({"cmd": "set_filter", "name": "nfl", "enabled": True}, "unknown_filter"),
        ({"cmd": "set_filter", "name": "afk", "enabled": 1}, "bad_value"),
        ({"cmd": "stop"}, "not_streaming"),
        ({"cmd": "stop", "frames": -1}, "bad_value"),
        ({"cmd": "stop", "frames": True}, "bad_value"),
    ],
)
def test_an_invalid_request_is_refused_with_a_code_and_a_message(camera, request_, code):
    with Host(camera) as host:
        answer = host.ask(**request_)
        assert (answer["ok"], answer["error"]) == (False, code)
        assert answer["message"]
        assert host.ask("identify")["ok"]  # and it goes on


def test_a_request_that_is_no_json_is_answered(camera):
    with Host(camera) as host:
        for payload in (b"{", b"[1]", b"\xff\xfe", b"[" * 50_000):
            host.send(b"Q", payload)
            kind, answer = host.frame()
            assert kind == b"A"
            assert json.loads(answer)["error"] == "bad_request"


@pytest.mark.parametrize("header", [struct.pack("<cI", b"X", 2), struct.pack("<cI", b"Q", 1 << 30)])
def test_a_frame_that_is_no_request_ends_the_connection(camera, header):
    with Host(camera) as host:
        host.link.sendall(header)
        assert host.frame()[0] == b"N"
        with pytest.raises(ConnectionError):
            host.frame()
    with Host(camera) as host:
        assert host.ask("identify")["ok"]


def test_settings_and_a_second_start_are_refused_while_it_streams(camera):
    with Host(camera) as host:
        assert host.ask("start")["ok"]
        assert host.ask("start")["error"] == "streaming"
        assert host.ask("set_bias", name="bias_fo", value=1)["error"] == "streaming"
        assert host.ask("stop")["ok"]
        assert host.ask("set_bias", name="bias_fo", value=1)["ok"]


def test_a_pulled_cable_is_noticed_and_the_camera_can_be_opened_again(camera):
    with Host(camera) as host:
        host.record(2)
        host.ask("start")
        camera.unplug()
        with pytest.raises(ConnectionError):
            host.drain()
    with Host(camera) as host:
        assert host.ask("start")["ok"]
        assert host.ask("stop")["ok"]


def test_a_fault_reaches_the_host(camera):
    with Host(camera) as host:
        host.ask("identify")
        camera.report_fault("over temperature")
        kind, payload = host.frame()
    assert kind == b"N"
    assert json.loads(payload) == {"event": "fault", "message": "over temperature"}


def test_a_world_that_cannot_be_drawn_is_reported_to_the_host():
    camera = SimulatedEvk4(World(truth_from_config({"camera": {"k1": -50.0}})), paced=False)
    camera.start()
    with Host(camera) as host:
        assert host.ask("start")["ok"]
        kind, payload = host.frame()
        assert kind == b"N"
        assert "camera" in json.loads(payload)["message"]
        assert host.ask("stop")["ok"]
    camera.close()
