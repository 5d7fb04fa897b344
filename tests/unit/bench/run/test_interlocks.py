"""Single interlocks: when each holds, when it clears, and what a station file may contain."""

import os
from datetime import UTC, datetime
from types import SimpleNamespace

import pytest
from refusals import faults_of
from station_texts import PLAIN, station_of

from bench.base.clock import Interrupted, VirtualClock
from bench.run.interlocks import CameraTemperature, DiskSpace, Door, EventRate, Interlocks
from bench.run.run_context import interlocks_of
from bench.stations.station_fields import (
    CameraTemperatureConfig,
    DiskSpaceConfig,
    DoorConfig,
    EventRateConfig,
    InterlocksConfig,
)

NOW = datetime(2026, 3, 1, 20, tzinfo=UTC)


def test_a_door_is_closed_only_if_its_sensor_reports_so(tmp_path):
    sensor = tmp_path / "value"
    door = Door(DoorConfig(path=str(sensor)))
    assert "cannot be read" in door.why(held=False)
    for text, is_open in ((b"1\n", False), (b"0\n", True), (b"", True), (b"\xff", True), (b"1" * 99, True)):
        sensor.write_bytes(text)
        assert bool(door.why(held=False)) is is_open, text


@pytest.mark.parametrize(
    ("max_age_s", "later_s", "why"),
    [
        (10, 10.0, ""),
        (10, 11.0, "reported nothing for 11 s"),
        (10, -10.0, ""),
        (10, -3600.0, "clock of this computer was set back"),
        (None, -3600.0, ""),
    ],
)
def test_a_silent_sensor_and_a_report_from_the_future_count_as_an_open_door(
    tmp_path, max_age_s, later_s, why
):
    sensor = tmp_path / "value"
    sensor.write_text("closed")
    os.utime(sensor, (5000.0, 5000.0))
    words = DoorConfig(path=str(sensor), closed="closed", max_age_s=max_age_s)
    reason = Door(words, utc_s=lambda: 5000.0 + later_s).why(held=False)
    assert why in reason
    assert bool(reason) == bool(why)


def test_a_pipe_in_place_of_a_sensor_is_an_open_door_and_does_not_block(tmp_path):
    os.mkfifo(tmp_path / "value")
    assert "not a regular file" in Door(DoorConfig(path=str(tmp_path / "value"))).why(held=False)
    assert "cannot be read" in Door(DoorConfig(path=str(tmp_path))).why(held=False)


def test_each_interlock_clears_at_a_stricter_limit(tmp_path):
    celsius = [54.0]
    warm = CameraTemperature(CameraTemperatureConfig(max_c=55, release_c=50), lambda: celsius[0])
    assert [warm.why(held=held) != "" for held in (False, True)] == [False, True]
    celsius[0] = 56.0
    assert "56 C" in warm.why(held=False)
    celsius[0] = 49.0
    assert warm.why(held=True) == ""
    assert CameraTemperature(warm.config, lambda: None).why(held=False) == ""
    limits = EventRateConfig(max_mev_s=50, release_mev_s=5, probe_ms=200)
    rate = EventRate(limits, lambda: 60.0, lambda probe_s: 30.0 * probe_s)
    assert "60 Mev/s" in rate.why(held=False)
    assert "6 Mev/s in the dark" in rate.why(held=True)
    at_the_limits = EventRate(limits, lambda: 50.0, lambda probe_s: 25.0 * probe_s)
    assert [at_the_limits.why(held=held) for held in (False, True)] == ["", ""]
    just_above = EventRate(limits, lambda: 50.004, lambda probe_s: 25.0 * probe_s)
    assert just_above.why(held=False).startswith("50.004 Mev/s")
    huge = DiskSpace(DiskSpaceConfig(min_free_gb=1e-6, release_gb=1e9), tmp_path)
    assert [huge.why(held=held) != "" for held in (False, True)] == [False, True]


def test_an_open_door_interrupts_devices_at_work_and_nothing_else(tmp_path):
    clock = VirtualClock(NOW)
    interlocks = Interlocks([Door(DoorConfig(path=str(tmp_path / "gone")))], clock)
    for state in ("checking", "solving", "holding", "preflight"):
        interlocks.entering(state)
        interlocks.check_door()
        clock.check()
    interlocks.entering("slewing")
    interlocks.check_door()
    with pytest.raises(Interrupted, match="door interlock"):
        clock.sleep(1)
    interlocks.entering("")
    clock.check()
    assert interlocks.take_interruption().interlock.name == "door"


@pytest.mark.parametrize(
    ("limits", "wrong"),
    [
        ("{door: {path: /x, closed: 1, max_hold_s: 0}}", "max_hold_s"),
        ("{window: {path: /x}}", "window"),
        ("{camera_temperature: {max_c: 50, release_c: 50}}", "release_c must be below"),
        ("{event_rate: {max_mev_s: 5, release_mev_s: 6}}", "release_mev_s must be below"),
        ("{disk_space: {min_free_gb: 5, release_gb: 4}}", "release_gb must not"),
        ("{device_lost: {retry: 5}}", "retry"),
    ],
)
def test_a_station_file_with_contradictory_interlock_limits_is_refused(limits, wrong):
    assert any(wrong in fault for fault in faults_of(station_of, f"{PLAIN}\ninterlocks: {limits}\n"))


def test_a_station_has_the_interlocks_that_it_names(tmp_path):
    text = "{door: {path: /x}, device_lost: {retry_s: 7}, disk_space: {min_free_gb: 1, release_gb: 2, max_hold_s: 90}}"
    configured = station_of(f"{PLAIN}\ninterlocks: {text}\n").interlocks
    sensors = SimpleNamespace(camera_c=None, last_mev_s=None, dark_mev_s=None, reopen=None)
    door, space, lost = interlocks_of(configured, tmp_path, sensors)
    assert [i.name for i in (door, space, lost)] == ["door", "disk_space", "device_lost"]
    assert (door.poll_s, lost.poll_s, space.config.max_hold_s) == (0.1, 7, 90)
    assert interlocks_of(InterlocksConfig(), tmp_path, sensors) == []
