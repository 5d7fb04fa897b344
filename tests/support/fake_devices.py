"""Devices that take time and fail when told: a stage, a light, and a camera whose recordings hold nothing."""

import threading
import time

from drivers.camera import CameraIdentity, CameraSettings, RecordingFacts
from drivers.errors import LightFault, MoveFailed, NotHomed, PortLost
from drivers.light import LightIdentity, LightSettings
from drivers.stage import AxisIdentity, AxisLimits


class FakeStage:
    """Two axes, 10 degrees a second; every call that reaches the controllers is in ``calls``."""

    axes = ("pan", "tilt")

    def __init__(self):
        self.limits = {"pan": AxisLimits(-15, 15, 10, 100), "tilt": AxisLimits(-10, 10, 10, 100)}
        self.at = {"pan": 0.0, "tilt": 0.0}
        self.step_deg = 0.05  # in 5 ms; a test of a stop in motion makes it smaller
        self.homed = True
        self.calls = []
        self.stops = 0
        self.lost = False
        self.fault = ""
        self.stop_fails = False

    def identify(self):
        return [AxisIdentity(name, "Fake", "stage", f"F-{name}", "1") for name in self.axes]

    def is_homed(self):
        return self.homed

    def home(self):
        self.calls.append("home")
        self._go({"pan": 0.0, "tilt": 0.0})
        self.homed = True

    def move_to(self, target_deg):
        if not self.homed:
            raise NotHomed("not homed.", where="stage", remedy="Home it.")
        self.calls.append(("move", dict(target_deg)))
        self._go(target_deg)

    def _go(self, target_deg):
        stops = self.stops
        while self.at | dict(target_deg) != self.at:
            time.sleep(0.005)
            if self.stops != stops:
                raise MoveFailed("stopped on request.", where="stage")
            for name, goal in target_deg.items():
                most = self.step_deg
                step = max(-most, min(most, goal - self.at[name]))
                self.at[name] = goal if abs(goal - self.at[name]) <= most else self.at[name] + step
        if self.fault:
            raise MoveFailed(f"{self.fault}.", where="pan", remedy="Free the axis.")

    def position_deg(self):
        self._require()
        return dict(self.at)

    def faults(self):
        self._require()
        return [self.fault] if self.fault else []

    def stop(self):
        self.calls.append("stop")
        self.stops += 1
        if self.stop_fails:
            raise PortLost("the port is gone.", where="stage", remedy="Cut the stage's power.")

    def close(self):
        self.calls.append("close")

    def _require(self):
        if self.lost:
            raise PortLost("the port is gone.", where="stage", remedy="Plug it in.")


class FakeLight:
    """A light that does what it is told; every call is in ``calls``."""

    def __init__(self):
        self.calls = []
        self.lit = False
        self.settings = LightSettings()
        self.lost = False

    def identify(self):
        return LightIdentity("Fake", "light", "L-1", "1")

    def apply(self, settings):
        self._require()
        self.calls.append(settings)
        self.settings = settings
        return settings

    def read(self):
        self._require()
        return self.settings

    def on(self):
        self._require()
        self.calls.append("on")
        self.lit = True

    def off(self):
        self._require()
        self.calls.append("off")
        self.lit = False

    def is_on(self):
        self._require()
        return self.lit

    def faults(self):
        return []

    def close(self):
        self.calls.append("close")

    def _require(self):
        if self.lost:
            raise LightFault("it does not answer.", where="light", remedy="Plug it in.")


class FakeCamera:
    """Records files that hold nothing, one in 20 ms."""

    def __init__(self):
        self.paths = []
        self.settings = CameraSettings()
        self.stopped = threading.Event()
        self.recording = False
        self.fault = None

    def identify(self):
        assert not self.recording, "asked while it records"
        return CameraIdentity("Fake", "camera", "F", "00050423", "1", 64, 36)

    def apply(self, settings):
        assert not self.recording, "set while it records"
        self.settings = settings
        return settings

    def filters(self):
        return {}

    def temperature_c(self):
        return 30.0

    def record(self, path, duration_s):
        if self.fault is not None:
            raise self.fault
        self.recording = True
        self.stopped.clear()
        path.write_bytes(b"x")
        self.paths.append(path)
        complete = not self.stopped.wait(0.02)
        self.recording = False
        return RecordingFacts("00050423", "camera", 64, 36, 1, duration_s, 0, 0, {}, {}, complete=complete)

    def stop(self):
        self.stopped.set()

    def close(self):
        pass


class FakeDevices:
    """The three fakes, as `bench.stations.devices.Devices` holds real ones."""

    simulation = None

    def __init__(self):
        self.stage, self.light, self.camera = FakeStage(), FakeLight(), FakeCamera()
        self.closed = False

    def close(self):
        self.closed = True
