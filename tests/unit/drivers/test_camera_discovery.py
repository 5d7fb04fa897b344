"""Which cameras are connected."""

import pytest

from drivers.camera import FoundCamera, discovery, metavision_discovery, neuromorphic_evk4
from drivers.camera.discovery import find_cameras
from drivers.camera.frame_cameras import usb_serial, video_devices
from drivers.errors import CameraSoftwareMissing

EVK4 = FoundCamera("metavision", "00051234", "Prophesee")


def test_cameras_of_all_drivers_are_listed_and_missing_software_is_told(monkeypatch):
    def missing():
        raise CameraSoftwareMissing("It is not installed.", remedy="Install it.")

    monkeypatch.setattr(metavision_discovery, "discover", lambda: (EVK4,))
    monkeypatch.setattr(neuromorphic_evk4, "discover", missing)
    monkeypatch.setattr(discovery, "video_devices", list)
    assert find_cameras() == ([EVK4], ["It is not installed. Install it."])


@pytest.fixture
def system(tmp_path):
    """Linux's own list of two devices of one USB camera, of which the second carries metadata."""
    usb = tmp_path / "devices" / "usb1" / "1-2"
    (usb / "1-2:1.0").mkdir(parents=True)
    (usb / "idVendor").write_text("046d\n")
    (usb / "serial").write_text("8A0A3C5F\n")
    for number in (1, 2):
        entry = tmp_path / "sys" / f"video{number}"
        entry.mkdir(parents=True)
        (entry / "device").symlink_to(usb / "1-2:1.0")
        (entry / "index").write_text(f"{number - 1}\n")
    return tmp_path / "sys"


@pytest.fixture
def dev(tmp_path):
    dev = tmp_path / "dev"
    (dev / "v4l" / "by-id").mkdir(parents=True)
    for name in ("video0", "video1", "video2", "vcs"):
        (dev / name).touch()
    (dev / "v4l" / "by-id" / "usb-Maker_Camera").symlink_to(dev / "video1")
    return dev


def test_video_devices_are_listed_by_the_name_that_lasts_and_their_serial_number(dev, system):
    assert video_devices(dev, system) == [
        FoundCamera("opencv", "", f"video device {dev}/video0", source=f"{dev}/video0"),
        FoundCamera(
            "opencv", "8A0A3C5F", f"video device {dev}/video1", source=f"{dev}/v4l/by-id/usb-Maker_Camera"
        ),
    ]


def test_a_camera_that_gave_usb_no_serial_number_has_none(dev, system, tmp_path):
    (tmp_path / "devices" / "usb1" / "1-2" / "serial").unlink()
    assert usb_serial(dev / "video1", system) == ""


def test_a_computer_without_video_devices_has_none(tmp_path):
    assert video_devices(tmp_path, tmp_path) == []
