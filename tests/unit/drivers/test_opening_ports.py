"""How a port is opened: what its line is set to on which system, and what every refusal says."""

from __future__ import annotations

import errno
import os
import pty
import tty
from collections.abc import Iterator

import pytest
import serial

from drivers import file_lock, serial_port
from drivers.device_hold import DeviceHold
from drivers.errors import DriverError, PortDenied, PortError, PortNotFound
from drivers.serial_port import SerialPort


@pytest.fixture
def terminal() -> Iterator[str]:
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


class Recorder:
    """Stands where pyserial opens a port."""

    def __init__(self) -> None:
        self.settings: dict[str, object] = {}

    def __call__(self, address: str, **settings: object) -> Recorder:
        self.settings = settings
        return self

    is_open = True

    def open(self) -> None:
        """Open nothing."""

    def close(self) -> None:
        """Close nothing."""


@pytest.mark.parametrize(("system", "leaves_dtr_alone"), [("posix", True), ("nt", False)])
def test_no_flow_control_is_on_whatever_the_system(monkeypatch, system, leaves_dtr_alone) -> None:
    """On Windows pyserial's ``dsrdtr`` makes each byte wait for DSR, which most USB adapters never raise."""
    recorder = Recorder()
    monkeypatch.setattr(serial_port, "SYSTEM", system)
    monkeypatch.setattr(serial_port.serial, "serial_for_url", recorder)
    SerialPort("COM3", baudrate=9600)
    assert bool(recorder.settings.get("dsrdtr")) == leaves_dtr_alone
    assert not recorder.settings.get("rtscts")
    assert not recorder.settings.get("xonxoff")


@pytest.mark.parametrize("error", [ValueError("Failed to set custom baud rate (7)"), NotImplementedError()])
def test_a_baud_rate_that_the_port_cannot_do_is_a_port_error_and_leaves_it_closed(
    terminal, monkeypatch, error
) -> None:
    def refuse(self: serial.Serial, force_update: bool = False) -> None:
        raise error

    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(serial.Serial, "_reconfigure_port", refuse)
        with pytest.raises(PortError) as caught:
            SerialPort(terminal, baudrate=123_457)
    assert "baud rate" in caught.value.remedy
    SerialPort(terminal, baudrate=9600).close()  # nobody holds it


def test_a_folder_that_knows_no_locks_is_not_called_busy(tmp_path, monkeypatch) -> None:
    def unlockable(descriptor: int, **_how: bool) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(file_lock, "lock", unlockable)
    with pytest.raises(PortDenied, match="No locks available") as caught:
        DeviceHold("stage 1", folder=tmp_path)
    assert "STARBENCH_LOCKS" in caught.value.remedy


@pytest.mark.parametrize("kind", ["spy", "SPY", "alt", "hwgrep", "loop", "cp2110"])
def test_a_url_that_reaches_no_device_server_is_refused_before_pyserial_sees_it(tmp_path, kind) -> None:
    """``spy://`` opens the file that its URL names for writing, and so empties it."""
    victim = tmp_path / "victim.txt"
    victim.write_text("keep me")
    with pytest.raises(PortNotFound, match=f"of the kind {kind}://") as caught:
        SerialPort(f"{kind}:///dev/null?file={victim}", baudrate=9600)
    assert "rfc2217://" in caught.value.remedy
    assert victim.read_text() == "keep me"


def test_a_url_of_no_known_kind_is_refused_with_what_to_give() -> None:
    with pytest.raises(PortNotFound) as caught:
        SerialPort("gopher://somewhere", baudrate=9600)
    assert isinstance(caught.value, DriverError)
    assert "socket://" in caught.value.remedy
