"""A camera on USB that this user may not open, or that is on USB 2, is named; `devices` showed nothing."""

import os

import pytest

from drivers.camera.usb_permission import (
    connected_cameras,
    only_camera_kind,
    only_camera_mbit_s,
    slow_cameras,
    unreadable_cameras,
)


def plug(tmp_path, vendor="04b4", product="00f5", mode=0o666, speed="5000", port="1-2"):
    device = tmp_path / "sys" / port
    device.mkdir(parents=True)
    numbers = {"idVendor": vendor, "idProduct": product, "busnum": "1", "devnum": "7", "speed": speed}
    for name, text in numbers.items():
        (device / name).write_text(f"{text}\n")
    node = tmp_path / "dev" / "001" / "007"
    node.parent.mkdir(parents=True, exist_ok=True)
    node.touch(mode)
    node.chmod(mode)
    return tmp_path / "sys", tmp_path / "dev"


def test_a_camera_that_may_be_used_is_no_fault(tmp_path):
    assert unreadable_cameras(*plug(tmp_path)) == []


def test_a_camera_that_this_user_may_not_open_is_named_with_what_to_do(tmp_path, monkeypatch):
    folders = plug(tmp_path, mode=0o600)
    monkeypatch.setattr(os, "access", lambda path, _how: not str(path).endswith("001/007"))
    (said,) = unreadable_cameras(*folders)
    assert "Prophesee camera (EVK4) is connected, but this user may not use it" in said
    assert "001/007" in said
    assert "udev rules" in said


def test_an_event_camera_of_another_maker_on_usb_2_is_named(tmp_path):
    (said,) = slow_cameras(plug(tmp_path, vendor="31f7", product="0003", speed="480")[0])
    assert said.startswith("A CenturyArks camera (SilkyEvCam HD) is connected at 480 Mbit/s (USB 2)")


@pytest.mark.parametrize("vendor", ["1234", "", "zz"])
def test_other_devices_are_not_looked_at(tmp_path, vendor):
    assert unreadable_cameras(*plug(tmp_path, vendor=vendor, mode=0o000)) == []


def test_a_system_without_this_list_has_no_fault(tmp_path):
    assert unreadable_cameras(tmp_path / "none", tmp_path) == []


@pytest.mark.parametrize(
    ("speed", "read"), [("480", 480), ("12", 12), ("1.5", 1), ("5000", 5000), ("", None)]
)
def test_the_speed_of_the_only_camera_is_read(tmp_path, speed, read):
    devices, _ = plug(tmp_path, speed=speed)
    assert only_camera_mbit_s(devices) == read
    said = slow_cameras(devices)
    assert bool(said) is (read is not None and read < 5000)
    if said:
        assert f"connected at {read} Mbit/s (USB 2)" in said[0]
        assert "USB 3 port" in said[0]


def test_of_two_cameras_the_speed_belongs_to_none(tmp_path):
    plug(tmp_path)
    devices, _ = plug(tmp_path, port="1-3", speed="480")
    assert only_camera_mbit_s(devices) is None
    assert len(slow_cameras(devices)) == 1


def test_connected_cameras_are_counted_where_the_system_lists_them(tmp_path):
    assert connected_cameras(plug(tmp_path)[0]) == ["Prophesee camera (EVK4)"]
    assert connected_cameras(tmp_path / "none") is None


@pytest.mark.parametrize(
    ("numbers", "kind"),
    [
        ([("04b4", "00f5")], ("Prophesee", "EVK4")),
        ([("1409", "8E00")], ("IDS", "uEye XCP-E")),
        ([("31f7", "0003"), ("31f7", "0003")], ("CenturyArks", "SilkyEvCam HD")),
        ([("04b4", "00f5"), ("1409", "8e00")], None),
        ([("1234", "5678")], None),
    ],
)
def test_maker_and_model_are_those_of_the_only_kind_on_usb(tmp_path, numbers, kind):
    for number, (vendor, product) in enumerate(numbers):
        devices, _ = plug(tmp_path, vendor, product, port=f"1-{number}")
    assert only_camera_kind(devices) == kind
