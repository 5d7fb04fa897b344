"""The simulated line: what a port does apart from any protocol."""

import os

import pytest
import serial

from simulators.errors import SimulatorError
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice


class Parrot:
    """Says everything twice."""

    baud = 115_200

    def receive(self, data: bytes) -> bytes:
        return data + data

    def unsolicited(self) -> bytes:
        return b""


def test_what_goes_wrong_between_two_exchanges_is_raised_where_it_was_asked_for(tmp_path):
    def fail() -> None:
        raise SimulatorError("no")

    with SerialDevice(PseudoTerminal(tmp_path / "port"), Parrot()) as device:
        with pytest.raises(SimulatorError, match="no"):
            device.between_exchanges(fail)
        with serial.Serial(device.address, 115_200, timeout=5.0) as line:
            line.write(b"a")
            assert line.read(2) == b"aa"


def test_a_client_that_does_not_read_loses_bytes_and_holds_nobody_up(tmp_path):
    with (
        SerialDevice(PseudoTerminal(tmp_path / "port"), Parrot(), paced=False) as device,
        serial.Serial(device.address, 115_200, timeout=0.2, write_timeout=5.0) as line,
    ):
        for _ in range(100):
            line.write(b"x" * 400)
        line.reset_input_buffer()
        while line.read(65_536):
            pass
        line.write(b"a")
        assert line.read(2) == b"aa"


def test_a_port_in_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SimulatorError, match="Cannot create the link"):
        PseudoTerminal(tmp_path / "nowhere" / "port")


def test_a_link_that_somebody_else_has_taken_is_left_alone(tmp_path):
    first = PseudoTerminal(tmp_path / "port")
    second = PseudoTerminal(tmp_path / "port")
    first.close()
    assert os.path.lexists(second.link)
    second.close()
    assert not os.path.lexists(second.link)
