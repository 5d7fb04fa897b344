"""The simulated pan-tilt unit: its own answers, and a client that nobody here wrote (FLIR-PTU-Python, if installed)."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice
from tests.hil.direct_stages import VirtualClock, of_one_port


@pytest.mark.parametrize(
    ("sent", "answer"),
    [
        (b"PP ", b"PP * Current Pan position is 0\r\n"),
        (b"pp\r", b"pp * Current Pan position is 0\r\n"),
        (b"FT PP ", b"FT *\r\nPP * 0\r\n"),
        (b"ED TP ", b"ED *\r\n* Current Tilt position is 0\r\n"),
        (b"PN ", b"PN * Minimum Pan position is -12000\r\n"),
        (b"PP12001 ", b"PP12001 ! Maximum allowable Pan position is 12000\r\n"),
        (b"PXU800 LU PP801 ", b"PXU800 *\r\nLU *\r\nPP801 ! Maximum allowable Pan position is 800\r\n"),
        (b"PS999999 ", b"PS999999 ! Pan speed cannot exceed 80000 pos/sec\r\n"),
        (b"PR ", b"PR * 4.500000 seconds arc per position\r\n"),
        (b"XYZ ", b"XYZ ! Illegal command entered\r\n"),
        (b"VS ", b"VS * 100101\r\n"),
        (b"PD ", b"PD * Current Pan speed is 0 positions/sec\r\n"),
    ],
)
def test_the_unit_answers_as_in_the_manual(sent, answer) -> None:
    assert of_one_port("flir_ptu", VirtualClock().monotonic)[0].receive(sent) == answer


def test_a_reset_is_answered_at_its_end_and_other_commands_wait() -> None:
    clock = VirtualClock()
    unit, _ = of_one_port("flir_ptu", clock.monotonic)
    assert unit.receive(b"R PP ") == b"R "
    clock.sleep(0.1)
    assert unit.unsolicited() == b""
    clock.sleep(60.0)
    assert unit.unsolicited() == b"!T!T!P!P*\r\nPP * Current Pan position is 0\r\n"


@pytest.fixture
def port(tmp_path: Path) -> Iterator[str]:
    unit, _ = of_one_port("flir_ptu", time.monotonic)
    with SerialDevice(PseudoTerminal(tmp_path / "ptu"), unit) as device:
        yield device.address


def test_another_client_moves_and_reads_the_unit(port) -> None:
    flirptu = pytest.importorskip("flirptu.ptu", reason="pip install flirptu")
    client = flirptu.PTU(port, timeout=10)
    assert client.echo
    assert (client.panResolution, client.minPan, client.maxTilt) == (4.5, -12000, 8000)
    assert client.maxPanSpeed == 80_000
    assert client.send("RP ", strip_echo=False) == "RP !P!P*"
    assert client.setPanPosition(4000)
    while client.send("PD ") != "* Current Pan speed is 0 positions/sec":
        time.sleep(0.02)
    assert client.getPanPosition() == 4000
    with pytest.warns(RuntimeWarning, match="Maximum allowable"):
        assert not client.setPanPosition(13_000)
    if hasattr(client, "setUserPanLimits"):  # the package index has a version without it
        assert client.setUserPanLimits(-800, 800)
        client.enableUserLimits()
        with pytest.warns(RuntimeWarning, match="position is 800"):
            assert not client.setPanPosition(900)
    assert client.halt()
    del client  # it speaks to the unit once more when it is deleted
