"""A strict fake of the Metavision HAL's Python API.

It knows the calls of OpenEB 5.1 and nothing else: an attribute that the vendor's objects do not have is an error,
the calls that block are forbidden, and the log is written as the vendor writes it.
"""

import enum
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import pytest
from camera_words import words_of

SERIAL = "00051234"
RISING = 0xA001
"""A word: an edge at the trigger input."""


HEADER = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% serial_number 00051234\n% end\n"


class Channel(enum.Enum):
    MAIN = 0


class TrailType(enum.Enum):
    TRAIL = 0
    STC_CUT_TRAIL = 1
    STC_KEEP_TRAIL = 2


class Geometry:
    def __init__(self, size):
        self.get_width, self.get_height = (lambda: size[0]), (lambda: size[1])


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
        self.window = window
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


#: Other sensors: size, and biases at power-up with their ranges. They are register values, so that 0 is no default.
OTHER_SENSORS = {
    "GenX320": ((320, 320), {name: (value, 0, 127) for name, value in
                {"bias_diff": 51, "bias_diff_on": 25, "bias_diff_off": 28, "bias_fo": 34, "bias_hpf": 40,
                 "bias_refr": 10}.items()}),
    "Gen3.1": ((640, 480), {name: (value, 0, 1800) for name, value in
               {"bias_diff": 299, "bias_diff_on": 384, "bias_diff_off": 222, "bias_fo": 1477, "bias_hpf": 1499,
                "bias_pr": 1250, "bias_refr": 1500}.items()}),
}  # fmt: skip


class Biases:
    RANGES: ClassVar = {
        "bias_diff": (-25, 23),
        "bias_diff_on": (-85, 140),
        "bias_diff_off": (-35, 190),
        "bias_fo": (-35, 55),
        "bias_hpf": (0, 120),
        "bias_refr": (-20, 235),
    }

    def __init__(self, stated=None):
        if stated is None:
            self.values = dict.fromkeys(self.RANGES, 0) | {"bias_fo": 12}
        else:
            self.RANGES = {name: (low, high) for name, (_, low, high) in stated.items()}
            self.values = {name: value for name, (value, _, _) in stated.items()}
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
        return SimpleNamespace(get_bias_range=lambda: self.RANGES[name])


class Monitoring:
    def get_temperature(self):
        return 43

    def get_illumination(self):
        raise RuntimeError("Error 101202: not implemented")


class Identification:
    def __init__(self, serial, sensor="IMX636"):
        self._serial, self._sensor = serial, sensor
        self.encoding = "EVT3"

    def get_serial(self):
        return self._serial

    def get_sensor_info(self):
        return SimpleNamespace(name=self._sensor)

    def get_integrator(self):
        return "Prophesee"

    def get_system_info(self):
        build = {"EVK4 Release Version": "3.9.0", "EVK4 Build Date": "Thu Jan  5 10:11:12 2023"}
        return build | {"EVK4 Speed": "5000"}

    def get_current_data_encoding_format(self):
        return self.encoding


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
        data = words_of(self.step, RISING)
        self.step += 1
        if self.log is not None and self.step <= self.log_takes:
            self.log.write(data)
        return data

    def wait_next_buffer(self):
        pytest.fail("this call blocks all of Python")


class Decoder:
    def __init__(self):
        self._last = -1

    def decode(self, buffer):
        t = int.from_bytes(buffer[-4:-2], "little") & 0xFFF
        self._last = t << 12 | int.from_bytes(buffer[-2:], "little") & 0xFFF

    def get_last_timestamp(self):
        return self._last


class Device:
    """All facilities; a test takes some away by setting them to None."""

    def __init__(self, serial=SERIAL, sensor="IMX636"):
        size, biases = OTHER_SENSORS.get(sensor, ((1280, 720), None))
        self.facilities = {
            "events_stream": Stream(),
            "events_stream_decoder": Decoder(),
            "hw_identification": Identification(serial, sensor),
            "geometry": Geometry(size),
            "ll_biases": Biases(biases),
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
                device = devices.get(serial or SERIAL)
                if isinstance(device, Exception):
                    raise device
                return device

            @staticmethod
            def list_available_sources():
                return [Description()] if SERIAL in devices else []

        self.DeviceDiscovery = DeviceDiscovery
        self.DeviceConfig = DeviceConfig
        self.I_ROI = type("I_ROI", (), {"Mode": RoiMode, "Window": lambda *place: place})
        self.I_TriggerIn = type("I_TriggerIn", (), {"Channel": Channel})
        self.I_EventTrailFilterModule = type("I_EventTrailFilterModule", (), {"Type": TrailType})
