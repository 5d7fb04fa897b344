"""Cameras that fail half way: nothing is waited for twice, nothing stays open, no byte goes astray."""

from __future__ import annotations

import weakref
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.camera import CameraSettings, frame_cameras, metavision_discovery, neuromorphic_evk4
from drivers.camera.frame_cameras import FolderFrameCamera, OpenCvFrameCamera
from drivers.camera.frames import read_frames, write_frames
from drivers.camera.metavision import MetavisionEvk4
from drivers.errors import CameraError, CameraLost, RecordingFailed


# ---------------------------------------------------------------- frame cameras
class Stalled:
    """A video device that is there, and sends nothing: OpenCV waits ten seconds for each picture."""

    WAIT_S = 10.0

    def __init__(self, clock) -> None:
        self.clock = clock

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's name
        return True

    def get(self, what) -> float:
        return 64.0

    def grab(self) -> bool:
        self.clock.now_s += self.WAIT_S
        return False

    def read(self):
        return self.grab(), None

    def release(self) -> None:
        """Release nothing."""


def test_a_video_device_that_has_stalled_is_waited_for_once(clock, monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(frame_cameras.cv2, "VideoCapture", lambda *_: Stalled(clock))
    camera = OpenCvFrameCamera.open("/dev/video7", clock=clock, system=tmp_path / "none")
    with pytest.raises(CameraLost, match="sends no more frames"):
        camera.capture(tmp_path / "a.tiff", 4)
    camera.close()
    assert clock.now_s == Stalled.WAIT_S


# ---------------------------------------------------------------- Metavision
class Dumb:
    """A HAL device whose facilities cannot be reached."""

    def get_i_hw_identification(self) -> None:
        return None


def test_a_camera_that_turns_out_wrong_is_let_go_before_its_lock(clock, monkeypatch) -> None:
    opened = []

    def open_device(serial: str, config: object) -> Dumb:
        device = Dumb()
        opened.append(weakref.ref(device))
        return device

    hal = SimpleNamespace(
        DeviceConfig=lambda: SimpleNamespace(set_format=lambda _: None),
        DeviceDiscovery=SimpleNamespace(open=open_device, list_available_sources=list),
    )
    monkeypatch.setattr(metavision_discovery.importlib, "import_module", lambda _: hal)
    for serial in ("50423", None, "50423"):  # the lock has been given back as well
        with pytest.raises(CameraError, match="identification cannot be reached") as caught:
            MetavisionEvk4.open(serial=serial, clock=clock)
        assert caught.tb is not None  # the error still holds where it was raised
        assert opened[-1]() is None


# ---------------------------------------------------------------- neuromorphic-drivers
def test_half_a_word_before_the_first_clock_word_shifts_nothing() -> None:
    ring = SimpleNamespace(dropped_packets=0, overflow_indices=None, system_time=0.0)
    packets = [b"", b"\x05\x00", b"\x03\x28\x05", b"\x00\x01\x80\x02\x60", b"\x05\x00\x03\x28"]
    device = iter([(SimpleNamespace(ring=ring), packet) for packet in packets])
    stream = neuromorphic_evk4.PacketStream(device, lambda error: CameraLost(str(error)))
    words = b"".join(filter(None, (stream.next_words() for _ in packets)))
    assert words == b"\x01\x80\x02\x60\x05\x00\x03\x28"


class Unplugged:
    """A HAL device that is pulled out after it has said who it is: every further call ends in a RuntimeError."""

    def __init__(self) -> None:
        identity = SimpleNamespace(
            get_system_info=dict,
            get_integrator=lambda: "Prophesee",
            get_sensor_info=lambda: SimpleNamespace(name="IMX636"),
            get_serial=lambda: "50423",
        )
        self.get_i_hw_identification = lambda: identity
        self.get_i_geometry = lambda: SimpleNamespace(get_width=lambda: 1280, get_height=lambda: 720)

    def __getattr__(self, getter: str) -> object:
        calls = CALLS.get(getter)
        facility = SimpleNamespace(**dict.fromkeys(calls, self.gone)) if calls else None
        return lambda: facility

    @staticmethod
    def gone(*_arguments: object) -> None:
        raise RuntimeError("Error 0x101: the device is disconnected")


CALLS = {
    "get_i_events_stream": ("log_raw_data", "start", "stop", "stop_log_raw_data", "poll_buffer"),
    "get_i_ll_biases": ("get_all_biases", "get_bias_info", "set", "get"),
    "get_i_monitoring": ("get_temperature", "get_illumination"),
}


def test_a_camera_that_goes_before_its_first_byte_is_lost_in_our_words(clock, tmp_path) -> None:
    device = Unplugged()
    hal = SimpleNamespace()
    camera = MetavisionEvk4(device, hal, serial="50423", clock=clock)
    assert camera.temperature_c() is None
    with pytest.raises(CameraLost, match="disconnected"):
        camera.apply(CameraSettings(trigger_in=False))
    device.get_i_ll_biases = lambda: None
    with pytest.raises(CameraLost, match="disconnected"):
        camera.record(tmp_path / "a.raw", 0.1)


# ---------------------------------------------------------------- pictures played again
def test_every_page_of_a_file_is_a_picture(clock, tmp_path) -> None:
    """A capture of ours is one file of many pages: the pages of a pose are not those of the next one."""
    folder = tmp_path / "poses"
    folder.mkdir()
    for pose in range(2):
        write_frames(
            folder / f"pose-{pose}.tiff", [np.full((4, 6), 10 * pose + page, "u1") for page in range(3)]
        )
    camera = FolderFrameCamera.open(folder, clock=clock)
    for pose in range(2):
        camera.capture(tmp_path / f"{pose}.tiff", 3)
        assert [int(page[0, 0]) for page in read_frames(tmp_path / f"{pose}.tiff")] == [
            10 * pose + page for page in range(3)
        ]
    with pytest.raises(RecordingFailed, match="All 6 images have been used"):
        camera.capture(tmp_path / "more.tiff", 1)
