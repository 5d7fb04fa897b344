"""A camera on USB that this user may not open is named; `devices` showed nothing."""

import os

import pytest

from drivers.camera.usb_permission import unreadable_cameras


def plug(tmp_path, vendor="04b4", product="00f5", mode=0o666):
    device = tmp_path / "sys" / "1-2"
    device.mkdir(parents=True)
    for name, text in (("idVendor", vendor), ("idProduct", product), ("busnum", "1"), ("devnum", "7")):
        (device / name).write_text(f"{text}\n")
    node = tmp_path / "dev" / "001" / "007"
    node.parent.mkdir(parents=True)
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


@pytest.mark.parametrize("vendor", ["1234", "", "zz"])
def test_other_devices_are_not_looked_at(tmp_path, vendor):
    assert unreadable_cameras(*plug(tmp_path, vendor=vendor, mode=0o000)) == []


def test_a_system_without_this_list_has_no_fault(tmp_path):
    assert unreadable_cameras(tmp_path / "none", tmp_path) == []
