"""Virtual devices take the time and refuse the commands that real devices would."""

from datetime import UTC, datetime

import numpy as np
import pytest
from filled_stations import filled_example
from station_texts import PLAIN, station_of

from bench.base.clock import VirtualClock
from bench.batch.virtual_devices import FIRST_LINE, VirtualDevices, read_view
from bench.plan.plan import RECORD_EXTRA_S
from calib.target import StarTarget
from drivers.camera import CameraSettings
from drivers.errors import NotHomed, OutsideLimits, RecordingFailed, WrongDevice
from drivers.light import LightSettings


@pytest.fixture
def clock():
    return VirtualClock(datetime(2026, 3, 1, 20, tzinfo=UTC))


def devices(clock, simulation="simulation: {}"):
    station = station_of(PLAIN.replace("simulation: {}", simulation))
    return VirtualDevices(station, seed=1, clock=clock)


def test_nothing_moves_before_homing_or_beyond_a_limit(clock):
    stage = devices(clock).stage
    assert not stage.is_homed()
    with pytest.raises(NotHomed):
        stage.move_to({"pan": 1.0})
    stage.home()
    before_s = clock.monotonic()
    with pytest.raises(OutsideLimits, match="tilt"):
        stage.move_to({"pan": 1.0, "tilt": 11.0})
    assert (stage.position_deg(), clock.monotonic()) == ({"pan": 0.0, "tilt": 0.0}, before_s)


def test_a_recording_takes_its_duration_and_holds_its_stars(clock, tmp_path):
    held = devices(clock)
    held.stage.home()
    held.light.apply(LightSettings(frequency_hz=100.0))
    held.light.on()
    held.camera.apply(CameraSettings(biases={"bias_fo": 3}))
    begin_s = clock.monotonic()
    facts = held.camera.record(tmp_path / "r", 0.05)
    assert clock.monotonic() - begin_s == pytest.approx(0.05 + RECORD_EXTRA_S)
    assert (facts.serial, facts.biases, facts.triggers, facts.events) == ("00050423", {"bias_fo": 3}, 10, 0)
    assert (tmp_path / "r").read_bytes().startswith(FIRST_LINE)
    view, edges = read_view(tmp_path / "r", "middle", StarTarget())
    assert (view.name, view.image_size, edges) == ("middle", (1280, 720), 5)
    assert len(view) > 100
    assert np.allclose(view.covariances_px2, 0.03**2 * np.eye(2))


def test_a_rehearsed_fault_raises_the_error_of_a_camera(clock, tmp_path):
    held = devices(clock, "simulation: {rehearsal: {lost_share: 1}}")
    held.stage.home()
    with pytest.raises(RecordingFailed, match="rehearsed fault"):
        held.camera.record(tmp_path / "r", 0.05)


def test_a_camera_other_than_the_station_s_is_refused_at_opening(clock):
    with pytest.raises(WrongDevice, match="the camera has 7"):
        devices(clock, "simulation: {camera_serial: '7'}")


def test_a_station_of_real_devices_is_rehearsed_by_its_expected_section(clock):
    text = filled_example("example_evk4") + "expected: {focal_px: 3300, r_mm: 255, half_angle_deg: 12}\n"
    real = station_of(text)
    held = VirtualDevices(real, seed=1, clock=clock)
    assert held.truth()["camera"]["fx"] == real.expected.focal_px
    assert held.camera.identify().serial == "00051234"
