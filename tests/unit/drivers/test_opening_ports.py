"""Ports, and the rights to use them."""

from __future__ import annotations

import errno
import os
import pty
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import serial
import yaml
from pydantic import TypeAdapter

from bench.stations.stages_and_lights import StageConfig
from drivers import file_lock, serial_port
from drivers.camera import FoundCamera, discovery, metavision_discovery, neuromorphic_evk4
from drivers.camera.discovery import find_cameras
from drivers.camera.frame_cameras import usb_serial, video_devices
from drivers.camera.usb_permission import (
    connected_cameras,
    only_camera_kind,
    only_camera_mbit_s,
    slow_cameras,
    unreadable_cameras,
)
from drivers.clock import SystemClock
from drivers.errors import CameraSoftwareMissing, PortDenied, PortError, PortLost, PortNotFound
from drivers.file_lock import DeviceHold
from drivers.serial_port import LineSettings, SerialPort


@pytest.fixture
def terminal() -> Iterator[str]:
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


@pytest.fixture
def settings(monkeypatch) -> dict[str, object]:
    """With what pyserial opens a port; it opens none."""
    opened, port = {}, SimpleNamespace(is_open=True, open=lambda: None, close=lambda: None)
    monkeypatch.setattr(serial_port.serial, "serial_for_url", lambda _, **given: opened.update(given) or port)
    return opened


@pytest.mark.parametrize(("system", "leaves_dtr_alone"), [("posix", True), ("nt", False)])
def test_no_flow_control_is_on_whatever_the_system(monkeypatch, settings, system, leaves_dtr_alone) -> None:
    """On Windows pyserial's ``dsrdtr`` makes each byte wait for DSR, which most USB adapters never raise."""
    monkeypatch.setattr(serial_port, "SYSTEM", system)
    SerialPort("COM3", LineSettings(9600))
    assert bool(settings.get("dsrdtr")) == leaves_dtr_alone
    assert not settings.get("rtscts")
    assert not settings.get("xonxoff")


SECTIONS = {
    "esp": "{driver: esp30x, axes: {pan: {number: 1, serial: a, ",
    "zaber": "{driver: zaber_ascii, axes: {pan: {device: 1, serial: a, microsteps_per_deg: 1, ",
    "text": "{driver: text, protocol: flir_ptu, axes: {pan: {address: P, counts_per_deg: 1, ",
}


@pytest.mark.parametrize(
    ("stage", "more", "settings"),
    [
        ("esp", "", (19_200, True)),
        ("esp", ", rtscts: false, baudrate: 921600", (921_600,)),
        ("zaber", "", (115_200,)),
        ("zaber", ", rtscts: true", (115_200, True)),
        ("text", "", (9600,)),
        ("text", ", rtscts: true", (9600, True)),
        ("text", ", frame: 7E1, xonxoff: true", (9600, False, "7E1", True)),
    ],
)
def test_the_line_is_the_maker_s_unless_the_station_says_otherwise(monkeypatch, stage, more, settings):
    """A published ESP300 was silent without it."""
    limits = "limits_deg: [-1, 1], speed_deg_s: 1, acceleration_deg_s2: 1}}"
    keys = yaml.safe_load(f"{SECTIONS[stage]}{limits}, port: COM3{more}}}")
    section = TypeAdapter(StageConfig).validate_python(keys)
    opened = []

    def record(_address: str, settings: LineSettings) -> None:
        opened.append(settings)
        raise PortNotFound("enough.")

    monkeypatch.setattr(serial_port, "SerialPort", record)
    with pytest.raises(PortNotFound):
        section.open_device(str, clock=SystemClock(), wire_log=None)
    assert opened == [LineSettings(*settings)]


@pytest.mark.parametrize(
    ("frame", "stated"),
    [("8N1", (8, "N", 1)), ("7E1", (7, "E", 1)), ("7O2", (7, "O", 2)), ("8N2", (8, "N", 2))],
)
def test_data_bits_parity_and_stop_bits_are_those_of_the_frame(settings, frame, stated) -> None:
    """A 33120A has 2 stop bits, an SMC100 holds the sender by XON and XOFF, older instruments have 7 data bits."""
    SerialPort("COM3", LineSettings(9600, frame=frame, xonxoff=True))
    assert tuple(settings[name] for name in ("bytesize", "parity", "stopbits")) == stated
    assert settings["xonxoff"]


@pytest.mark.parametrize(("rtscts", "cause"), [(True, "line CTS was off"), (False, "Write timeout")])
def test_a_device_that_holds_the_line_is_told_and_gets_nothing_later(terminal, monkeypatch, rtscts, cause):
    thrown = []

    def hold(self: serial.Serial, data: bytes) -> int:
        raise serial.SerialTimeoutException("Write timeout")

    port = SerialPort(terminal, LineSettings(19_200, rtscts))
    monkeypatch.setattr(serial.Serial, "write", hold)
    monkeypatch.setattr(serial.Serial, "reset_output_buffer", lambda _self: thrown.append(True))
    with pytest.raises(PortLost, match=cause) as caught:
        port.write(b"1PA5\r")
    assert thrown
    assert ("rtscts: false" in caught.value.remedy) == rtscts
    port.close()


def test_a_computer_that_slept_while_it_sent_has_lost_no_port(terminal, monkeypatch) -> None:
    send, now, sent = serial.Serial.write, time.monotonic, []

    def sleep_in_between(self: serial.Serial, data: bytes) -> int:
        send(self, data)
        sent.append(data)
        monkeypatch.setattr(time, "monotonic", lambda: now() + 14.0)
        raise serial.SerialTimeoutException("Write timeout")

    port = SerialPort(terminal, LineSettings(19_200))
    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(serial.Serial, "write", sleep_in_between)
        port.write(b"1PA5\r")
    port.write(b"1TS\r")
    assert sent == [b"1PA5\r"]
    port.close()


@pytest.mark.parametrize("error", [ValueError("Failed to set custom baud rate (7)"), NotImplementedError()])
def test_a_baud_rate_that_the_port_cannot_do_leaves_it_closed(terminal, monkeypatch, error) -> None:
    def refuse(self: serial.Serial, force_update: bool = False) -> None:
        raise error

    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(serial.Serial, "_reconfigure_port", refuse)
        with pytest.raises(PortError) as caught:
            SerialPort(terminal, LineSettings(123_457))
    assert "baud rate" in caught.value.remedy
    SerialPort(terminal, LineSettings(9600)).close()  # nobody holds it


def test_a_folder_that_knows_no_locks_is_not_called_busy(tmp_path, monkeypatch) -> None:
    def unlockable(descriptor: int, **_how: bool) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(file_lock, "lock", unlockable)
    with pytest.raises(PortDenied, match="No locks available") as caught:
        DeviceHold("stage 1", folder=tmp_path)
    assert "STARBENCH_LOCKS" in caught.value.remedy


def test_a_link_in_the_place_of_the_locks_opens_nobody_s_folder(tmp_path, monkeypatch) -> None:
    """Another user may plant a link, or a folder, under any name in a shared folder, before the first use."""
    monkeypatch.delenv(file_lock.FOLDER_VARIABLE)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    victim = tmp_path / "of another user"
    victim.mkdir(0o700)
    planted = tmp_path / "planted"
    planted.symlink_to(victim)
    assert file_lock.locks_folder([planted, victim]) == tmp_path
    DeviceHold("stage 1", folder=planted).release()
    assert victim.stat().st_mode & 0o777 == 0o700


@pytest.mark.skipif(
    not Path("/tmp").is_dir() or Path("/tmp").stat().st_uid, reason="no folder is the system's"
)
def test_a_sticky_folder_of_the_system_is_shared_by_all_users(monkeypatch) -> None:
    monkeypatch.delenv(file_lock.FOLDER_VARIABLE)
    assert file_lock.locks_folder([Path("/nowhere"), Path("/etc"), Path("/tmp")]) == Path("/tmp")


@pytest.mark.parametrize("planted", ["link", "hard link", "pipe"])
def test_what_has_the_name_of_a_lock_file_is_neither_changed_nor_waited_for(tmp_path, planted) -> None:
    DeviceHold("stage 1", folder=tmp_path).release()
    (path,) = tmp_path.iterdir()
    victim = tmp_path / "victim"
    victim.write_text("keep me")
    victim.chmod(0o600)
    path.unlink()
    plant = {"link": path.symlink_to, "hard link": path.hardlink_to, "pipe": lambda _: os.mkfifo(path)}
    plant[planted](victim)
    with pytest.raises(PortDenied, match="something else"):
        DeviceHold("stage 1", folder=tmp_path)
    assert victim.stat().st_mode & 0o777 == 0o600
    assert victim.read_text() == "keep me"


@pytest.mark.parametrize("kind", ["spy", "SPY", "alt", "hwgrep", "loop", "cp2110", "gopher"])
def test_a_url_that_reaches_no_device_server_is_refused_before_pyserial_sees_it(tmp_path, kind) -> None:
    """``spy://`` opens the file that its URL names for writing, and so empties it."""
    victim = tmp_path / "victim.txt"
    victim.write_text("keep me")
    with pytest.raises(PortNotFound, match=f"of the kind {kind}://") as caught:
        SerialPort(f"{kind}:///dev/null?file={victim}", LineSettings(9600))
    assert "rfc2217://" in caught.value.remedy
    assert victim.read_text() == "keep me"


# ---------------------------------------------------------------- rights to a USB device


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


@pytest.mark.parametrize(
    ("vendor", "mode"),
    [("04b4", 0o666), ("1234", 0), ("", 0), ("zz", 0)],
    ids=["may be used", "other", "none", "no number"],
)
def test_a_camera_that_may_be_used_and_another_device_are_no_fault(tmp_path, vendor, mode):
    assert unreadable_cameras(*plug(tmp_path, vendor=vendor, mode=mode)) == []


def test_a_system_without_these_lists_has_no_camera_and_no_fault(tmp_path):
    assert unreadable_cameras(tmp_path / "none", tmp_path) == []
    assert connected_cameras(tmp_path / "none") is None
    assert video_devices(tmp_path, tmp_path) == []


def test_a_camera_that_this_user_may_not_open_is_named_with_what_to_do(tmp_path, monkeypatch):
    folders = plug(tmp_path, mode=0o600)
    monkeypatch.setattr(os, "access", lambda path, _how: not str(path).endswith("001/007"))
    (message,) = unreadable_cameras(*folders)
    assert "Prophesee camera (EVK4)" in message
    assert "001/007" in message
    assert "udev rules" in message


def test_an_event_camera_of_another_maker_on_usb_2_is_named(tmp_path):
    (message,) = slow_cameras(plug(tmp_path, vendor="31f7", product="0003", speed="480")[0])
    assert "CenturyArks camera (SilkyEvCam HD)" in message
    assert "480 Mbit/s (USB 2)" in message


@pytest.mark.parametrize(
    ("speed", "read"), [("480", 480), ("12", 12), ("1.5", 1), ("5000", 5000), ("", None)]
)
def test_the_speed_of_the_only_camera_is_read(tmp_path, speed, read):
    devices, _ = plug(tmp_path, speed=speed)
    assert only_camera_mbit_s(devices) == read
    messages = slow_cameras(devices)
    assert bool(messages) is (read is not None and read < 5000)
    if messages:
        assert f"connected at {read} Mbit/s (USB 2)" in messages[0]
        assert "USB 3 port" in messages[0]


def test_of_two_cameras_the_speed_belongs_to_none(tmp_path):
    plug(tmp_path)
    devices, _ = plug(tmp_path, port="1-3", speed="480")
    assert only_camera_mbit_s(devices) is None
    assert len(slow_cameras(devices)) == 1


def test_connected_cameras_are_listed(tmp_path):
    assert connected_cameras(plug(tmp_path)[0]) == ["Prophesee camera (EVK4)"]


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


# ---------------------------------------------------------------- cameras on this computer

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


def test_a_file_that_is_no_terminal_is_named_without_words_of_a_library():
    with pytest.raises(PortNotFound, match=r"/dev/null") as caught:
        SerialPort("/dev/null", LineSettings(115_200))
    assert "ioctl" not in str(caught.value)
