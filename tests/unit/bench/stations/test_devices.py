"""Which driver a station file's words stand for, and that each gets its settings in its own terms."""

from pathlib import Path
from unittest.mock import create_autospec

import pytest
from filled_stations import filled_example
from station_texts import PLAIN, station_of

from bench.base.clock import BenchClock
from bench.stations.devices import Devices, simulated_truth
from bench.stations.station import Station
from drivers.camera.frame_cameras import FolderFrameCamera, OpenCvFrameCamera
from drivers.camera.metavision import MetavisionEvk4
from drivers.camera.neuromorphic_evk4 import NeuromorphicEvk4
from drivers.camera.recorded import RecordedCamera
from drivers.light.gardasoft import GardasoftLight
from drivers.light.scpi import ScpiLight
from drivers.stage import AxisLimits
from drivers.stage.esp import EspAxis, EspStage
from drivers.stage.grbl import GrblAxis, GrblStage
from drivers.stage.ximc import XimcAxis, XimcStage
from drivers.stage.zaber import ZaberAxis, ZaberStage
from sequences.script import Flicker

EXAMPLE = filled_example("example_evk4")
MOTION = "limits_deg: [-9, 8], speed_deg_s: 5, acceleration_deg_s2: 20, tolerance_deg: 0.01"
LIMITS = AxisLimits(-9, 8, 5, 20)


def station_with(section: str) -> Station:
    """The example with another stage, light or camera."""
    keys = ("stage", "light", "camera", "target")
    begin = EXAMPLE.index(f"\n{section.partition(':')[0]}:\n")
    after = EXAMPLE.index(f"\n{keys[keys.index(section.partition(':')[0]) + 1]}:\n")
    return station_of(f"{EXAMPLE[:begin]}\n{section}{EXAMPLE[after:]}")


DEVICES = [
    (
        f"stage: {{driver: zaber_ascii, port: /dev/a, axes: {{pan: {{device: 2, axis: 1, serial: 07, microsteps_per_deg: -6400, {MOTION}}}}}}}",
        ZaberStage,
        ("/dev/a", [ZaberAxis(name="pan", device=2, serial="07", microsteps_per_deg=-6400, limits=LIMITS, tolerance_deg=0.01)]),
        {"line": {"baudrate": 115_200}},
    ),
    (
        f"stage: {{driver: ximc, axes: {{tilt: {{port: /dev/b, serial: 0042, steps_per_deg: 100, zero_deg: 3, {MOTION}}}}}}}",
        XimcStage,
        ([XimcAxis(name="tilt", port="/dev/b", serial="0042", steps_per_deg=100, zero_deg=3, limits=LIMITS, tolerance_deg=0.01)],),
        {},
    ),
    (
        f"stage: {{driver: esp30x, port: /dev/c, axes: {{roll: {{number: 3, serial: SN1, direction: -1, {MOTION}}}}}}}",
        EspStage,
        ("/dev/c", [EspAxis(name="roll", number=3, serial="SN1", direction=-1, limits=LIMITS, tolerance_deg=0.01)]),
        {"line": {"baudrate": 19_200}},
    ),
    (
        f"stage: {{driver: grbl, port: /dev/d, serial: gimbal, settings: {{$3: 2, $150: 16}}, axes: {{pan: {{letter: A, steps_per_deg: 80, zero_deg: 10, {MOTION}}}}}}}",
        GrblStage,
        ("/dev/d", [GrblAxis(name="pan", letter="A", steps_per_deg=80, zero_deg=10, limits=LIMITS, tolerance_deg=0.01)]),
        {"serial": "gimbal", "settings": {"$3": 2, "$150": 16}, "line": {"baudrate": 115_200}},
    ),
    (
        "light: {driver: scpi, port: /dev/e, dialect: siglent, load: 50-ohm, serial: 09}",
        ScpiLight,
        ("/dev/e",),
        {"serial": "09", "line": {"baudrate": 9600}, "load": "50-ohm", "dialect": "siglent"},
    ),
    (
        "light: {driver: gardasoft, port: /dev/f, model: RT420F-20, channel: 3, sync_channel: 4, full_percent: 50}",
        GardasoftLight,
        ("/dev/f",),
        {"model": "RT420F-20", "channel": 3, "sync_channel": 4, "full_percent": 50, "sync_percent": 100, "line": {"baudrate": 115_200}},
    ),
    ("camera: {driver: neuromorphic_evk4, serial: 0005}", NeuromorphicEvk4, (), {"serial": "0005"}),
    (
        "camera: {driver: recorded, path: tapes/monday, serial: 0005}",
        RecordedCamera,
        (Path("tapes/monday"),),
        {"serial": "0005"},
    ),
    (
        "camera: {driver: opencv, source: /dev/video3, serial: A7}",
        OpenCvFrameCamera,
        ("/dev/video3",),
        {"serial": "A7", "shown_as": ""},
    ),
    ("camera: {driver: pictures, path: a/b, serial: A7}", FolderFrameCamera, (Path("a/b"),), {"serial": "A7"}),
]  # fmt: skip
DRIVERS = (MetavisionEvk4, *(driver for _, driver, _, _ in DEVICES))


@pytest.fixture
def opened(monkeypatch, tmp_path):
    """Open the devices of a station, of which no driver reaches hardware; each driver's ``open`` is called by its own signature."""
    monkeypatch.setenv("STARBENCH_LOCKS", str(tmp_path))
    doubles = {driver: create_autospec(driver.open) for driver in DRIVERS}
    for driver, double in doubles.items():
        monkeypatch.setattr(driver, "open", double)

    def open_devices(station):
        clock = BenchClock()
        devices = Devices(station, seed=1, clock=clock, wire_log=None)
        called = {driver: double for driver, double in doubles.items() if double.called}
        assert {devices.stage, devices.light, devices.camera} == {d.return_value for d in called.values()}
        devices.close()
        return called, clock

    return open_devices


@pytest.mark.parametrize(
    ("section", "driver", "given", "options"), DEVICES, ids=lambda value: getattr(value, "__name__", "")
)
def test_each_driver_gets_what_the_file_says(section, driver, given, options, opened):
    called, clock = opened(station_with(section))
    if not section.startswith("camera"):
        options = {**options, "wire_log": None}
    elif driver is NeuromorphicEvk4:
        options = {**options, "utc_now": clock.utc_now}
    called[driver].assert_called_once_with(*given, **options, clock=clock)


def test_the_level_of_a_strobe_controller_is_a_share_of_its_full_percent():
    light = station_with("light: {driver: gardasoft, port: /dev/f, model: RT420F-20, full_percent: 50}").light
    assert light.settings(Flicker("square", 60.0, 50.0, 40.0)).high_v == 2.0


@pytest.mark.parametrize("where", ["stage", "camera", "neither"])
def test_the_simulated_truth_is_that_of_a_simulated_camera_on_a_simulated_stage_only(where):
    elsewhere = {"stage": ("port: sim:gimbal", "port: /dev/a"), "camera": ("sim:camera", "127.0.0.1:5")}
    text = PLAIN.replace(*elsewhere[where]) if where in elsewhere else PLAIN
    truth = simulated_truth(station_of(text), 7)
    assert (truth is not None) == (where == "neither")
