"""Which cameras are connected."""

from drivers.camera import FoundCamera, discovery, metavision, neuromorphic_evk4
from drivers.camera.discovery import find_cameras, video_devices
from drivers.errors import CameraSoftwareMissing

EVK4 = FoundCamera("metavision", "00051234", "Prophesee")


def test_cameras_of_all_drivers_are_listed_and_missing_software_is_told(monkeypatch):
    def missing():
        raise CameraSoftwareMissing("It is not installed.", remedy="Install it.")

    monkeypatch.setattr(metavision, "discover", lambda: (EVK4,))
    monkeypatch.setattr(neuromorphic_evk4, "discover", missing)
    monkeypatch.setattr(discovery, "video_devices", list)
    assert find_cameras() == ([EVK4], ["It is not installed. Install it."])


def test_video_devices_are_listed_by_path_and_name(tmp_path):
    (tmp_path / "video0").touch()
    (tmp_path / "video1").touch()
    (tmp_path / "vcs").touch()
    (tmp_path / "v4l" / "by-id").mkdir(parents=True)
    (tmp_path / "v4l" / "by-id" / "usb-Maker_Camera").symlink_to(tmp_path / "video1")
    assert [found.description for found in video_devices(tmp_path)] == [
        f"{tmp_path}/video0",
        f"{tmp_path}/video1 usb-Maker_Camera",
    ]


def test_a_computer_without_video_devices_has_none(tmp_path):
    assert video_devices(tmp_path) == []
