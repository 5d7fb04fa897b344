"""Cameras behind the Metavision HAL, against a strict fake of its Python API.

The fake knows the calls of OpenEB 5.1 and nothing else: an attribute that the vendor's objects do not have is an
error, the calls that block are forbidden, and the log is written as the vendor writes it.
"""

import enum
import sys
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType
from typing import ClassVar

import numpy as np
import pytest

from drivers.camera import CameraSettings, FoundCamera
from drivers.camera import metavision as metavision_driver
from drivers.camera.metavision import MetavisionEvk4, discover
from drivers.camera.neuromorphic_evk4 import NeuromorphicEvk4
from drivers.camera.raw_file import RawFile
from drivers.errors import (
    CameraBusy,
    CameraLost,
    CameraNotFound,
    CameraSettingRefused,
    CameraSoftwareMissing,
    RecordingFailed,
    WrongDevice,
)

SERIAL = "00051234"
HEADER = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% serial_number 00051234\n% end\n"


def words_of(step):
    t = 9_000_000 + 2000 * step
    words = [0x8000 | t >> 12 & 0xFFF, 0x6000 | t & 0xFFF, step % 720, 0x2800 | step % 1280, 0xA001]
    t += 1999
    return np.array([*words, 0x8000 | t >> 12 & 0xFFF, 0x6000 | t & 0xFFF], "<u2").tobytes()


class Channel(enum.Enum):
    MAIN = 0
    AUX = 1
    LOOPBACK = 2


class TrailType(enum.Enum):
    TRAIL = 0
    STC_CUT_TRAIL = 1
    STC_KEEP_TRAIL = 2


class Switch:
    """A facility with enable and is_enabled, such as ERC, anti-flicker and the region of interest."""

    def __init__(self, on):
        self._on = on
        self.sticks = False

    def enable(self, on):
        if not self.sticks:
            self._on = bool(on)
        return True

    def is_enabled(self):
        return self._on


class RoiMode(enum.Enum):
    ROI = 0
    RONI = 1


class Window:
    def __init__(self, x, y, width, height):
        self.place = (x, y, width, height)


class Region:
    def __init__(self):
        self.on = True
        self.mode = None
        self.window = None
        self.takes = True

    def set_mode(self, mode):
        self.mode = RoiMode(mode)
        return self.takes

    def set_window(self, window):
        self.window = window.place
        return self.takes

    def enable(self, on):
        self.on = on
        return self.takes


class Trail(Switch):
    def __init__(self, on, kind):
        super().__init__(on)
        self._kind = kind

    def get_type(self):
        return self._kind


class Trigger:
    def __init__(self):
        self._on = set()
        self.deaf = False

    def enable(self, channel):
        if not self.deaf:
            self._on.add(Channel(channel))
        return not self.deaf

    def disable(self, channel):
        self._on.discard(Channel(channel))
        return True

    def is_enabled(self, channel):
        return Channel(channel) in self._on


class BiasInfo:
    def __init__(self, low, high):
        self._range = (low, high)

    def get_bias_range(self):
        return self._range


class Biases:
    RANGES: ClassVar = {
        "bias_diff": (-25, 23),
        "bias_diff_on": (-85, 140),
        "bias_diff_off": (-35, 190),
        "bias_fo": (-35, 55),
        "bias_hpf": (0, 120),
        "bias_refr": (-20, 235),
    }

    def __init__(self):
        self.values = dict.fromkeys(self.RANGES, 0)
        self.values["bias_fo"] = 12
        self.deaf_to = set()

    def get_all_biases(self):
        return dict(self.values)

    def get(self, name):
        return self.values[name]

    def set(self, name, value):
        low, high = self.RANGES[name]
        if not low <= value <= high:
            raise RuntimeError("Error 102001: outside recommended range")
        if name not in self.deaf_to:
            self.values[name] = value
        return True

    def get_bias_info(self, name):
        return BiasInfo(*self.RANGES[name])


class Monitoring:
    def get_temperature(self):
        return 43

    def get_illumination(self):
        raise RuntimeError("Error 101202: not implemented")


class SensorInfo:
    name = "IMX636"
    major_version = 4
    minor_version = 2


class Identification:
    def __init__(self, serial):
        self._serial = serial
        self.encoding = "EVT3"

    def get_serial(self):
        return self._serial

    def get_sensor_info(self):
        return SensorInfo()

    def get_integrator(self):
        return "Prophesee"

    def get_system_info(self):
        return {"EVK4 Release Version": "3.9.0", "EVK4 Speed": "5000"}

    def get_current_data_encoding_format(self):
        return self.encoding


class Geometry:
    def get_width(self):
        return 1280

    def get_height(self):
        return 720


class RawBuffer:
    def __init__(self, data):
        self._data = data

    def size(self):
        return len(self._data)


class Stream:
    """Logs inside get_latest_raw_data, as the vendor's does; every second poll finds nothing."""

    def __init__(self):
        self.running = False
        self.log = None
        self.step = 0
        self.polls = 0
        self.hook = {}
        self.buffers = 10**9
        self.ends_with = 0
        self.may_log = True
        self.log_takes = 10**9

    def log_raw_data(self, path):
        assert not self.running, "its first buffers would be lost"
        if not self.may_log:
            return False
        self.log = Path(path).open("wb")  # noqa: SIM115 - closed by stop_log_raw_data
        self.log.write(HEADER)
        return True

    def stop_log_raw_data(self):
        if self.log is not None:
            self.log.close()
        self.log = None

    def start(self):
        self.running = True

    def stop(self):
        self.running = False

    def poll_buffer(self):
        assert self.running
        self.polls += 1
        if self.step >= self.buffers:
            return self.ends_with
        return self.polls % 2

    def get_latest_raw_data(self):
        self.hook.get(self.step, lambda: None)()
        data = words_of(self.step)
        self.step += 1
        if self.log is not None and self.step <= self.log_takes:
            self.log.write(data)
        return RawBuffer(data)

    def wait_next_buffer(self):
        pytest.fail("this call blocks all of Python")


class Decoder:
    def __init__(self):
        self._last = -1

    def decode(self, buffer):
        t = int.from_bytes(buffer._data[-4:-2], "little") & 0xFFF
        self._last = t << 12 | int.from_bytes(buffer._data[-2:], "little") & 0xFFF

    def get_last_timestamp(self):
        return self._last


class Device:
    """All facilities; a test takes some away by setting them to None."""

    def __init__(self, serial=SERIAL):
        self.facilities = {
            "events_stream": Stream(),
            "events_stream_decoder": Decoder(),
            "hw_identification": Identification(serial),
            "geometry": Geometry(),
            "ll_biases": Biases(),
            "antiflicker_module": Switch(True),
            "event_trail_filter_module": Trail(True, TrailType.STC_CUT_TRAIL),
            "erc_module": Switch(True),
            "roi": Region(),
            "trigger_in": Trigger(),
            "monitoring": Monitoring(),
        }

    def __getattr__(self, getter):
        if not getter.startswith("get_i_"):
            raise AttributeError(getter)
        return lambda: self.facilities[getter.removeprefix("get_i_")]


class Description:
    serial = SERIAL
    integrator_name = "Prophesee"
    plugin_name = "hal_plugin_prophesee"
    connection = "ConnectionType.USB_LINK"


class DeviceConfig:
    def __init__(self):
        self.encoding = ""

    def set_format(self, encoding):
        self.encoding = encoding


class Hal(ModuleType):
    def __init__(self, devices):
        super().__init__("metavision_hal")

        class DeviceDiscovery:
            @staticmethod
            def open(serial, config):
                assert config.encoding == "EVT3"
                found = devices.get(serial or SERIAL)
                if isinstance(found, Exception):
                    raise found
                return found

            @staticmethod
            def list_available_sources():
                return [Description()] if SERIAL in devices else []

        self.DeviceDiscovery = DeviceDiscovery
        self.DeviceConfig = DeviceConfig
        self.I_ROI = type("I_ROI", (), {"Mode": RoiMode, "Window": Window})
        self.I_TriggerIn = type("I_TriggerIn", (), {"Channel": Channel})
        self.I_EventTrailFilterModule = type("I_EventTrailFilterModule", (), {"Type": TrailType})


class VirtualClock:
    def __init__(self):
        self.now = 0.0
        self.error = None

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds
        if self.error:
            raise self.error


@pytest.fixture
def device():
    return Device()


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def devices(monkeypatch, device):
    found = {SERIAL: device}
    monkeypatch.setitem(sys.modules, "metavision_hal", Hal(found))
    return found


@pytest.fixture
def camera(devices, clock):
    return MetavisionEvk4.open(serial=SERIAL, clock=clock)


def test_missing_software_is_told_with_how_to_get_it(monkeypatch, clock):
    monkeypatch.setitem(sys.modules, "metavision_hal", None)
    with pytest.raises(CameraSoftwareMissing, match="Install OpenEB"):
        MetavisionEvk4.open(serial=SERIAL, clock=clock)


def test_importing_the_driver_needs_no_vendor_software():
    assert "metavision_hal" not in vars(metavision_driver)


def test_connected_cameras_are_listed(devices):
    assert discover() == (FoundCamera("metavision", SERIAL, "Prophesee, USB_LINK, hal_plugin_prophesee"),)


@pytest.mark.usefixtures("devices")
def test_a_camera_that_is_not_there_is_told_with_those_that_are(clock):
    with pytest.raises(CameraNotFound, match=f"00099999 cannot be opened; connected cameras: {SERIAL}"):
        MetavisionEvk4.open(serial="00099999", clock=clock)


def test_no_camera_at_all_is_told(devices, clock):
    devices.clear()
    with pytest.raises(CameraNotFound, match="connected cameras: none"):
        MetavisionEvk4.open(clock=clock)


def test_the_vendors_reason_for_not_opening_is_passed_on(devices, clock):
    devices[SERIAL] = RuntimeError("\n------\nMetavision HAL exception\n\nError 103000: device busy\n")
    with pytest.raises(CameraNotFound, match=r"cannot be opened \(Error 103000: device busy\)"):
        MetavisionEvk4.open(serial=SERIAL, clock=clock)


def test_another_camera_under_that_name_is_refused(devices, clock):
    devices[SERIAL] = Device("00077777")
    with pytest.raises(WrongDevice, match="camera 00077777, not 00051234"):
        MetavisionEvk4.open(serial=SERIAL, clock=clock)


@pytest.mark.usefixtures("camera")
def test_a_second_opener_is_refused_before_the_camera_is_touched(devices, clock):
    devices[SERIAL] = RuntimeError("it was touched")
    with pytest.raises(CameraBusy, match="Another program of this bench holds it"):
        MetavisionEvk4.open(serial=SERIAL, clock=clock)


def test_a_camera_is_free_again_after_closing_and_after_a_failed_opening(devices, device, camera, clock):
    camera.close()
    devices[SERIAL] = RuntimeError("Error 103000: device busy")
    with pytest.raises(CameraNotFound):
        MetavisionEvk4.open(serial=SERIAL, clock=clock)
    devices[SERIAL] = device
    MetavisionEvk4.open(serial=SERIAL, clock=clock).close()
    first_found = MetavisionEvk4.open(clock=clock)
    with pytest.raises(CameraBusy):
        MetavisionEvk4.open(serial=SERIAL, clock=clock)
    first_found.close()


def test_the_other_driver_of_the_same_camera_is_kept_out_too(camera, clock, monkeypatch):
    monkeypatch.setitem(sys.modules, "neuromorphic_drivers", ModuleType("neuromorphic_drivers"))
    with pytest.raises(CameraBusy):
        NeuromorphicEvk4.open(serial=SERIAL, clock=clock, utc_now=lambda: datetime.now(UTC))


def test_a_camera_that_does_not_send_evt3_is_refused(device, devices, clock):
    device.facilities["hw_identification"].encoding = "EVT21"
    with pytest.raises(CameraSettingRefused, match="EVT21, not EVT3"):
        MetavisionEvk4.open(serial=SERIAL, clock=clock)


def test_identity_is_what_the_camera_says(camera):
    identity = camera.identify()
    assert (identity.maker, identity.model, identity.sensor) == ("Prophesee", "EVK4", "IMX636")
    assert (identity.serial, identity.firmware, identity.width) == (SERIAL, "3.9.0", 1280)


def test_settings_are_set_and_read_back_with_all_filters_off(device, camera):
    found = camera.apply(CameraSettings({"bias_diff_on": 20}, trigger_in=True))
    assert found.biases == {
        "bias_diff_on": 20,
        "bias_diff_off": 0,
        "bias_fo": 0,
        "bias_hpf": 0,
        "bias_refr": 0,
    }
    assert found.trigger_in
    assert device.facilities["trigger_in"].is_enabled(Channel.MAIN)
    assert camera.filters() == {"afk": False, "stc": False, "trail": False, "erc": False}
    assert device.facilities["roi"].on is False


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (TrailType.TRAIL, {"stc": False, "trail": True}),
        (TrailType.STC_CUT_TRAIL, {"stc": True, "trail": True}),
        (TrailType.STC_KEEP_TRAIL, {"stc": True, "trail": False}),
    ],
)
def test_the_trail_filter_is_told_as_what_it_does(device, camera, kind, expected):
    device.facilities["event_trail_filter_module"] = Trail(True, kind)
    assert camera.filters() == {"afk": True, "erc": True, **expected}


def test_a_filter_that_stays_on_is_noticed(device, camera):
    device.facilities["antiflicker_module"].sticks = True
    with pytest.raises(CameraSettingRefused, match="afk stays on"):
        camera.apply(CameraSettings())


def test_a_region_of_interest_is_set_and_taken_away_again(device, camera):
    region = device.facilities["roi"]
    assert camera.apply(CameraSettings(roi=(320, 180, 640, 360))).roi == (320, 180, 640, 360)
    assert (region.on, region.mode, region.window) == (True, RoiMode.ROI, (320, 180, 640, 360))
    camera.apply(CameraSettings())
    assert not region.on


def test_a_region_beyond_the_sensor_is_refused_before_it_is_set(device, camera):
    with pytest.raises(CameraSettingRefused, match="beyond its 1280 x 720 px"):
        camera.apply(CameraSettings(roi=(640, 0, 641, 720)))
    assert device.facilities["roi"].window is None


def test_a_region_that_is_not_taken_or_that_there_is_none_of_is_told(device, camera):
    device.facilities["roi"].takes = False
    for roi in ((0, 0, 10, 10), None):
        with pytest.raises(CameraSettingRefused, match="did not take the region of interest"):
            camera.apply(CameraSettings(roi=roi))
    device.facilities["roi"] = None
    with pytest.raises(CameraSettingRefused, match="has no region of interest"):
        camera.apply(CameraSettings(roi=(0, 0, 10, 10)))


def test_a_bias_out_of_range_is_refused_with_the_range(device, camera):
    with pytest.raises(CameraSettingRefused, match="bias_fo from -35 to 55, not 60"):
        camera.apply(CameraSettings({"bias_fo": 60}))
    assert device.facilities["ll_biases"].values["bias_fo"] != 60


@pytest.mark.parametrize("value", [-35, 55])
def test_biases_reach_the_ends_of_their_range(device, camera, value):
    camera.apply(CameraSettings({"bias_fo": value}))
    assert device.facilities["ll_biases"].values["bias_fo"] == value


def test_a_bias_that_does_not_stick_is_noticed(device, camera):
    device.facilities["ll_biases"].deaf_to.add("bias_hpf")
    with pytest.raises(CameraSettingRefused, match="bias_hpf was set to 7, but reads back 0"):
        camera.apply(CameraSettings({"bias_hpf": 7}))


def test_an_unknown_bias_is_refused(camera):
    with pytest.raises(CameraSettingRefused, match="no bias bias_pr"):
        camera.apply(CameraSettings({"bias_pr": 1}))


def test_a_trigger_input_that_stays_off_is_noticed(device, camera):
    device.facilities["trigger_in"].deaf = True
    with pytest.raises(CameraSettingRefused, match="trigger input stays off"):
        camera.apply(CameraSettings(trigger_in=True))


def test_a_camera_without_optional_facilities_works(device, camera, tmp_path):
    for name in (
        "ll_biases",
        "antiflicker_module",
        "event_trail_filter_module",
        "erc_module",
        "roi",
        "trigger_in",
        "monitoring",
    ):
        device.facilities[name] = None
    assert camera.apply(CameraSettings(trigger_in=False)) == CameraSettings({}, trigger_in=False)
    assert camera.temperature_c() is None
    facts = camera.record(tmp_path / "pose.raw", 0.01)
    assert (facts.filters, facts.biases, facts.complete) == ({}, {}, True)


def test_a_trigger_input_that_is_missing_is_told_when_needed(device, camera):
    device.facilities["trigger_in"] = None
    with pytest.raises(CameraSettingRefused, match="no trigger input"):
        camera.apply(CameraSettings(trigger_in=True))


def test_biases_that_are_missing_are_told_when_needed(device, camera):
    device.facilities["ll_biases"] = None
    with pytest.raises(CameraSettingRefused, match="no biases"):
        camera.apply(CameraSettings({"bias_fo": 3}, trigger_in=False))


@pytest.mark.parametrize("name", ["events_stream", "events_stream_decoder", "geometry", "hw_identification"])
def test_a_camera_without_what_every_camera_has_is_told(device, camera, tmp_path, name):
    device.facilities[name] = None
    with pytest.raises(metavision_driver.CameraError, match="cannot be reached"):
        camera.record(tmp_path / "pose.raw", 0.01)


def test_what_the_camera_cannot_measure_is_left_out(camera, tmp_path):
    assert camera.temperature_c() == 43.0
    assert camera.record(tmp_path / "pose.raw", 0.01).illumination_lux is None


def test_a_recording_holds_all_buffers_and_covers_the_time(device, camera, tmp_path):
    path = tmp_path / "pose.raw"
    facts = camera.record(path, 0.033)
    recording = RawFile.open(path)
    scan = recording.scan()
    assert path.read_bytes() == HEADER + b"".join(
        words_of(k) for k in range(device.facilities["events_stream"].step)
    )
    assert 0.033 <= facts.duration_s < 0.038
    assert (facts.events, facts.triggers, facts.bytes) == (scan.events, scan.triggers, path.stat().st_size)
    assert recording.serial == SERIAL


def test_the_stream_and_the_log_are_stopped_after_a_recording(device, camera, tmp_path):
    camera.record(tmp_path / "pose.raw", 0.01)
    stream = device.facilities["events_stream"]
    assert not stream.running
    assert stream.log is None


def test_a_clock_that_starts_anew_between_recordings_does_not_end_one_early(device, camera, tmp_path):
    camera.record(tmp_path / "a.raw", 0.5)
    device.facilities["events_stream"].step = 0
    assert camera.record(tmp_path / "b.raw", 0.02).duration_s >= 0.02


def test_a_clock_that_has_gone_on_between_recordings_does_not_end_one_early(device, camera, tmp_path):
    camera.record(tmp_path / "a.raw", 0.02)
    device.facilities["events_stream"].step += 1000
    assert camera.record(tmp_path / "b.raw", 0.02).duration_s >= 0.02


def test_an_existing_file_is_never_overwritten(camera, tmp_path):
    path = tmp_path / "pose.raw"
    path.write_bytes(b"precious")
    with pytest.raises(RecordingFailed, match="such a file already"):
        camera.record(path, 0.01)
    assert path.read_bytes() == b"precious"


def test_a_missing_folder_is_told(camera, tmp_path):
    with pytest.raises(RecordingFailed, match="no such folder"):
        camera.record(tmp_path / "none" / "pose.raw", 0.01)


def test_a_log_that_cannot_be_opened_is_told(device, camera, tmp_path):
    device.facilities["events_stream"].may_log = False
    with pytest.raises(RecordingFailed, match="cannot write"):
        camera.record(tmp_path / "pose.raw", 0.01)


def test_bytes_that_did_not_reach_the_file_are_noticed(device, camera, tmp_path):
    device.facilities["events_stream"].log_takes = 5
    with pytest.raises(RecordingFailed, match=r"covers only 0\.009999 s"):
        camera.record(tmp_path / "pose.raw", 0.033)


def test_a_full_disk_is_told_as_such(device, camera, tmp_path, monkeypatch):
    device.facilities["events_stream"].log_takes = 5
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 0})())
    with pytest.raises(RecordingFailed, match="disk is full"):
        camera.record(tmp_path / "pose.raw", 0.033)


def test_unplugging_is_told_with_the_partial_file(device, camera, tmp_path):
    def unplug():
        raise RuntimeError("HalConnectionException: device disconnected")

    device.facilities["events_stream"].hook[4] = unplug
    path = tmp_path / "pose.raw"
    with pytest.raises(CameraLost, match=r"device disconnected.*pose\.raw"):
        camera.record(path, 1.0)
    assert RawFile.open(path).scan().events == 4
    assert not device.facilities["events_stream"].running


def test_a_silent_camera_is_given_up(device, camera, clock, tmp_path):
    device.facilities["events_stream"].buffers = 3
    with pytest.raises(CameraLost, match=r"sent nothing for 5 s.*pose\.raw"):
        camera.record(tmp_path / "pose.raw", 1.0)
    assert clock.now < 10


def test_a_stream_that_ends_by_itself_is_not_complete(device, camera, tmp_path):
    device.facilities["events_stream"].buffers = 3
    device.facilities["events_stream"].ends_with = -1
    facts = camera.record(tmp_path / "pose.raw", 1.0)
    assert not facts.complete
    assert facts.events == 3


def test_stop_ends_a_recording_early(device, camera, tmp_path):
    device.facilities["events_stream"].hook[4] = camera.stop
    assert not camera.record(tmp_path / "pose.raw", 1.0).complete


def test_an_interrupt_stops_the_stream_and_leaves_a_readable_file(device, camera, clock, tmp_path):
    device.facilities["events_stream"].hook[4] = lambda: setattr(clock, "error", KeyboardInterrupt())
    path = tmp_path / "pose.raw"
    with pytest.raises(KeyboardInterrupt):
        camera.record(path, 1.0)
    assert not device.facilities["events_stream"].running
    assert RawFile.open(path).scan().events == 5


def test_garbled_words_fail_the_recording(device, camera, tmp_path):
    stream = device.facilities["events_stream"]
    stream.hook[2] = lambda: stream.log.write(b"\x00\x90")
    with pytest.raises(RecordingFailed, match="0x9000"):
        camera.record(tmp_path / "pose.raw", 0.01)


def test_a_closed_camera_is_told_as_such(camera):
    camera.close()
    with pytest.raises(metavision_driver.CameraError, match="cannot be reached"):
        camera.identify()
    assert camera.temperature_c() is None


@pytest.mark.parametrize("duration_s", [0.0, -1.0, float("nan"), float("inf")])
def test_no_time_at_all_is_refused(camera, tmp_path, duration_s):
    with pytest.raises(RecordingFailed):
        camera.record(tmp_path / "pose.raw", duration_s)
