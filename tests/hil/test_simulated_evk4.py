"""The simulated EVK4 on its socket: settings, stream, temperature."""

import json
import math
import threading

import numpy as np
import pytest

from simulators.cameras.evk4 import SimulatedEvk4
from simulators.pixels import sensor_stream
from simulators.pixels.sensor import Sensor
from simulators.pixels.sensor_stream import CameraState, SensorStream, sync_edges
from simulators.world.truth_config import truth_from_config
from simulators.world.world import AxisMotion, LightState, World
from tests.hil.evk4_host import COMPUTING, FLICKER, SMALL, Host, bench


@pytest.fixture
def camera():
    camera = SimulatedEvk4(bench(), serial="00050423", paced=False)
    camera.start()
    yield camera
    camera.close()


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
        ({"cmd": "set_bias", "name": "bias_x", "value": 1}, "unknown_bias"),
        ({"cmd": "set_bias", "name": "bias_fo", "value": 56}, "out_of_range"),
        ({"cmd": "set_bias", "name": "bias_fo", "value": 1.5}, "bad_value"),
        ({"cmd": "set_filter", "name": "nfl", "enabled": True}, "unknown_filter"),
        ({"cmd": "set_filter", "name": "erc", "enabled": 1}, "bad_value"),
        ({"cmd": "stop"}, "not_streaming"),
        ({"cmd": "stop", "frames": -1}, "bad_value"),
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


def test_settings_and_a_second_start_are_refused_while_it_streams(camera):
    with Host(camera) as host:
        assert host.ask("start")["ok"]
        assert host.ask("start")["error"] == "streaming"
        assert host.ask("set_bias", name="bias_fo", value=1)["error"] == "streaming"
        assert host.ask("stop")["ok"]
        assert host.ask("set_bias", name="bias_fo", value=1)["ok"]


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


# ---------------------------------------------------------------- the stream


def began_us(words):
    """Return the sensor time of the first words."""
    high, low = np.frombuffer(words[:4], "<u2")
    assert (high >> 12, low >> 12) == (0x8, 0x6)
    return ((int(high) & 0xFFF) << 12) | (int(low) & 0xFFF)


def test_the_sensors_clock_goes_on_from_recording_to_recording(camera):
    with Host(camera) as host:
        assert [began_us(host.record(frames)) for frames in (60, 1, 52)] == [0, 204_800, 307_200]
    with Host(camera) as host:  # another one at once, the same camera
        assert began_us(host.record(1)) == 512_000


def listen_to_edges(monkeypatch, edges):
    """Note the edges of the light, each time with the time at which its period began, microseconds."""
    monkeypatch.setattr(
        sensor_stream,
        "sync_edges",
        lambda light, began_us, *span: (
            edges.append((began_us, sync_edges(light, began_us, *span))) or edges[-1][1]
        ),
    )


def taken_by(stream, taken, *, frames):
    """Note the sensor's events of some frames."""
    run = Sensor.run
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Sensor, "run", lambda *args: (taken.append(run(*args)), taken[-1])[1])
        for _ in range(frames):
            stream.next_frame()


def test_the_light_stays_one_clock_over_recordings(monkeypatch):
    """The phase drawn for a recording is the light's own phase at the moment the sensor starts."""
    now = [3.1]
    world = World(SMALL, clock=lambda: now[0])
    world.set_light(LightState(output=True, sync=True, origin_s=0.123))
    counts, edges = {}, []
    listen_to_edges(monkeypatch, edges)
    for moment in (3.1, 3.107, 17.4):
        now[0] = moment
        stream = SensorStream(world, CameraState(trigger_in=True), counts)
        stream.next_frame()
        assert 0.0 <= stream.start_s - moment <= 1.0 / 60.0 + 1e-9
        phase = -edges[-1][0] / world.light(moment).period_us
        turns = (stream.start_s - 0.123) * 60.0 - phase
        assert math.isclose(turns, round(turns), abs_tol=1e-6)


def test_a_moving_axis_smears_the_stars():
    def fired(motion):
        """Correlation of the stream's first and second period, pixel by pixel, and the stream."""
        world = World(SMALL, clock=lambda: 10.0)
        world.set_light(FLICKER, since_s=0.0)
        world.set_axis("pan", motion, since_s=0.0)
        stream = SensorStream(world, CameraState(), {})
        taken = []
        taken_by(stream, taken, frames=17)
        counts = np.zeros((2, 180, 320))
        for k, events in enumerate(taken[1:]):
            np.add.at(counts[k // 8], (events.y, events.x), 1.0)
        return np.corrcoef(counts.reshape(2, -1))[0, 1], stream

    resting, _ = fired(AxisMotion.resting(0.1, 640))
    again, _ = fired(AxisMotion(lambda _t: 0.1, math.inf, 640))
    asked_s = []
    slewing, stream = fired(AxisMotion(lambda t: asked_s.append(t) or 0.1 + 20.0 * (t - 10.0), math.inf, 640))
    assert asked_s[-1] == pytest.approx(stream.covered_s - 2e-3, abs=1e-9)  # the middle of the last frame
    assert again == pytest.approx(resting, abs=0.06)
    assert slewing < resting - 0.3  # the stars are elsewhere by then


def test_switching_the_light_off_ends_events_and_triggers():
    now = [10.0]
    world = World(SMALL, clock=lambda: now[0])
    world.set_light(FLICKER, since_s=0.0)
    stream = SensorStream(world, CameraState(trigger_in=True), {})
    before = sum(len(stream.next_frame()) for _ in range(17))
    world.set_light(LightState(output=False), since_s=stream.covered_s)
    stream.next_frame()
    after = [np.frombuffer(stream.next_frame(), "<u2") for _ in range(17)]
    assert sum(2 * len(words) for words in after) < before / 4
    assert not any((words >> 12 == 0xA).any() for words in after)


def fired_in(stream, frames=9):
    """Return which pixels fired in a recording of some frames."""
    taken = []
    taken_by(stream, taken, frames=frames)
    fired = np.zeros((180, 320))
    for events in taken:
        fired[events.y, events.x] = 1.0
    return fired


def test_a_preview_is_in_phase_with_the_light_and_sees_a_turn(monkeypatch):
    now = [10.0]
    world = World(SMALL, clock=lambda: now[0])
    world.set_light(FLICKER, since_s=0.0)
    camera, edges = CameraState(trigger_in=True), []
    listen_to_edges(monkeypatch, edges)
    preview = SensorStream(world, camera, {}, preview=True)
    before = fired_in(preview)
    now[0] = 12.345
    world.set_axis("pan", AxisMotion.resting(0.5, 3200), since_s=0.0)
    assert preview.go_on(camera, preview.clock_us)
    assert 0.0 <= preview.covered_s - now[0] <= 1.0 / 60.0 + 1e-9
    after = fired_in(preview)
    began_s = preview.start_s + 1e-6 * edges[-1][0]
    turns = world.light(now[0]).phase_at(began_s)
    assert math.isclose(turns, round(turns), abs_tol=1e-6)
    there = fired_in(SensorStream(world, camera, {}))
    assert np.corrcoef(after.ravel(), there.ravel())[0, 1] > 0.9
    assert np.corrcoef(after.ravel(), before.ravel())[0, 1] < 0.7


def test_a_preview_cannot_go_on_under_another_light_or_with_other_settings():
    world, camera = bench(), CameraState()
    preview = SensorStream(world, camera, {}, preview=True)
    preview.next_frame()
    assert not preview.go_on(CameraState(trigger_in=True), preview.clock_us)
    assert not preview.go_on(camera, preview.clock_us + 1)  # the clock has run on since
    world.set_light(LightState(output=True, sync=True, frequency_hz=75.0))
    assert not preview.go_on(camera, preview.clock_us)
