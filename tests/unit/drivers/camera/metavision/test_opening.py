"""Opening a camera behind the Metavision HAL: found or not, free or held, the one that was asked for."""

import os
import sys
from datetime import UTC, datetime
from types import ModuleType

import pytest

from drivers.camera import FoundCamera, metavision_discovery
from drivers.camera import metavision as metavision_driver
from drivers.camera.metavision import MetavisionEvk4
from drivers.camera.metavision_discovery import discover
from drivers.camera.neuromorphic_evk4 import NeuromorphicEvk4
from drivers.errors import (
    CameraBusy,
    CameraError,
    CameraNotFound,
    CameraSettingRefused,
    CameraSoftwareMissing,
    WrongDevice,
)
from tests.unit.drivers.camera.metavision.fake_hal import SERIAL, Device


def test_missing_software_is_told_with_how_to_get_it(monkeypatch, clock):
    monkeypatch.setitem(sys.modules, "metavision_hal", None)
    with pytest.raises(CameraSoftwareMissing, match="Install OpenEB"):
        MetavisionEvk4.open(serial=SERIAL, clock=clock)


def test_connected_cameras_are_listed(devices):
    assert discover() == (FoundCamera("metavision", SERIAL, "Prophesee, USB_LINK, hal_plugin_prophesee"),)


BUSY = RuntimeError("\n---\nMetavision HAL\n\nError 103000: busy\n")


@pytest.mark.parametrize(
    ("there", "serial", "error", "fact"),
    [
        (Device(), "00099999", CameraNotFound, f"camera 00099999; .* cameras: {SERIAL}"),
        (None, None, CameraNotFound, "cameras: none"),
        (BUSY, SERIAL, CameraNotFound, r"\(Error 103000: busy\)"),
        (Device("00077777"), SERIAL, WrongDevice, "camera 00077777, not 00051234"),
    ],
    ids=["others", "none", "the maker's reason", "another under that name"],
)
def test_a_camera_that_cannot_be_opened_is_told_with_what_is(devices, clock, there, serial, error, fact):
    devices.clear()
    if there is not None:
        devices[SERIAL] = there
    with pytest.raises(error, match=fact):
        MetavisionEvk4.open(serial=serial, clock=clock)


@pytest.mark.usefixtures("camera")
def test_a_second_opener_is_refused_before_the_camera_is_touched(devices, clock):
    devices[SERIAL] = RuntimeError("it was touched")
    with pytest.raises(CameraBusy, match="Another program holds it"):
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


def test_a_closed_camera_is_told_as_such(camera):
    camera.close()
    with pytest.raises(metavision_driver.CameraError, match="cannot be reached"):
        camera.identify()
    assert camera.temperature_c() is None


@pytest.mark.parametrize(
    ("stated", "refused"),
    [("480", True), ("480 Mbit/s", True), ("5000", False), ("10000", False), ("", False), ("0", False)],
)
def test_a_camera_on_usb_2_is_refused_when_it_is_opened(devices, clock, monkeypatch, stated, refused):
    identification = devices[SERIAL].facilities["hw_identification"]
    monkeypatch.setattr(type(identification), "get_system_info", lambda _self: {"EVK4 Speed": stated})
    if not refused:
        MetavisionEvk4.open(serial=SERIAL, clock=clock).close()
        return
    with pytest.raises(CameraSettingRefused, match=r"480 Mbit/s \(USB 2\)") as caught:
        MetavisionEvk4.open(serial=SERIAL, clock=clock)
    assert "USB 3" in caught.value.remedy
    monkeypatch.undo()


def test_the_connection_and_the_firmware_are_kept_in_the_identity(camera, devices, monkeypatch):
    identity = camera.identify()
    assert (identity.link_mbit_s, identity.firmware_built) == (5000, "Thu Jan  5 10:11:12 2023")
    identification = devices[SERIAL].facilities["hw_identification"]
    monkeypatch.setattr(type(identification), "get_system_info", lambda _self: {"EVK4 Speed": "0"})
    assert (camera.identify().link_mbit_s, camera.identify().firmware_built) == (None, "")


OLD = (
    b"[HAL][ERROR] The EVK camera with serial 00051234 is using an old firmware version. Please upgrade to latest"
    b" version. Check https://support.prophesee.ai for more information.\n"
)


@pytest.fixture
def old_firmware(devices, monkeypatch):
    """A camera that the maker's software leaves out, saying why on standard error, once in a process."""
    devices.clear()
    hal, written = sys.modules["metavision_hal"], []
    monkeypatch.setattr(metavision_discovery, "refused_firmware", set())

    def looked(answer):
        if not written:
            written.append(os.write(2, OLD))
        return answer

    monkeypatch.setattr(hal.DeviceDiscovery, "open", staticmethod(lambda *_: looked(None)))
    monkeypatch.setattr(hal.DeviceDiscovery, "list_available_sources", staticmethod(lambda: looked([])))


@pytest.mark.usefixtures("old_firmware")
def test_a_firmware_that_is_too_old_is_named_at_each_opening(clock, capfd):
    for serial in (None, SERIAL):
        with pytest.raises(CameraNotFound, match=r"00051234 .* 3\.8") as caught:
            MetavisionEvk4.open(serial=serial, clock=clock)
        assert "Update the camera's firmware" in caught.value.remedy
    assert capfd.readouterr().err.encode() == OLD  # the maker's words are not lost
    with pytest.raises(CameraNotFound, match="cameras: 00051234"):
        MetavisionEvk4.open(serial="00099999", clock=clock)


@pytest.mark.usefixtures("old_firmware")
def test_a_camera_with_an_old_firmware_is_listed_with_its_trouble(capfd):
    (camera,) = discover()
    assert (camera.serial, camera.trouble) == (
        SERIAL,
        "its firmware is older than 3.8. Update the camera's firmware with the maker's updater (support.prophesee.ai).",
    )
    assert capfd.readouterr().err.encode() == OLD


@pytest.mark.usefixtures("old_firmware")
@pytest.mark.parametrize(("on_usb", "listed"), [(None, 1), (["Prophesee camera (EVK4)"], 1), ([], 0)])
def test_an_old_camera_that_was_unplugged_is_not_listed(monkeypatch, on_usb, listed):
    """The maker's software says once in a process that a firmware is too old."""
    assert len(discover()) == 1
    monkeypatch.setattr(metavision_discovery, "connected_cameras", lambda: on_usb)
    assert len(discover()) == listed


def test_a_camera_that_does_not_answer_is_named_without_waiting_again(devices, clock, monkeypatch):
    """The remedy was to look for plugins, after 60 s: OpenEB 5.1.1 waits 30 s for it, at each look."""

    def mute(*_):
        looks.append(1)
        raise RuntimeError("LibUSB\n\nError fffffff9: LibUSB connection error: LIBUSB_ERROR_TIMEOUT\n")

    assert devices
    discovery, looks = sys.modules["metavision_hal"].DeviceDiscovery, []
    for name in ("open", "list_available_sources"):
        monkeypatch.setattr(discovery, name, staticmethod(mute))
    with pytest.raises(CameraNotFound, match="does not answer") as caught:
        MetavisionEvk4.open(serial=SERIAL, clock=clock)
    assert "plug it in again" in caught.value.remedy
    assert len(looks) == 1
    with pytest.raises(CameraError, match="does not answer"):
        discover()


@pytest.mark.parametrize(
    ("look", "found", "fact"),
    [
        ("connected_cameras", "Prophesee camera (EVK4)", r"\(EVK4\) .*MV_HAL_PLUGIN_PATH"),
        ("unreadable_cameras", "A camera is connected, but.", r"cameras: none\. A camera is"),
    ],
    ids=["another program may use it", "this user may not use it"],
)
def test_a_camera_that_the_maker_leaves_out_is_named(devices, clock, monkeypatch, look, found, fact):
    devices.clear()
    monkeypatch.setattr(metavision_discovery, look, lambda: [found])
    with pytest.raises(CameraNotFound, match=fact) as error:
        MetavisionEvk4.open(clock=clock)
    assert "cable" not in error.value.remedy


@pytest.mark.usefixtures("capfd")
def test_a_denial_that_only_standard_error_tells_is_named(devices, clock, monkeypatch):
    devices.clear()
    denial = b"[HAL][WARNING] Unable to open device:\nError fffffffd: LibUSB connection error: LIBUSB_ERROR_ACCESS\n"
    discovery = sys.modules["metavision_hal"].DeviceDiscovery
    monkeypatch.setattr(discovery, "list_available_sources", staticmethod(lambda: os.write(2, denial) and []))
    with pytest.raises(CameraNotFound, match=r"LIBUSB_ERROR_ACCESS.*udev"):
        MetavisionEvk4.open(clock=clock)
