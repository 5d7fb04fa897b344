"""The simulated XIMC controller, driven by the maker's own library, and byte by byte."""

import struct
import time

import pytest

from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice
from simulators.stages.axis_motion import MotionFault
from simulators.stages.ximc import crc16
from tests.hil.direct_stages import of_bench

simulated = of_bench("ximc", 25_600, "4242")


class Status(tuple):
    """An answer to ``gets``, by the names of the fields that matter."""

    __slots__ = ()
    moving = property(lambda self: bool(self[0] & 0x01))
    running = property(lambda self: bool(self[1] & 0x80))
    failed = property(lambda self: bool(self[1] & 0x40))
    command = property(lambda self: self[1] & 0x3F)
    position = property(lambda self: self[5] * 256 + self[6])
    encoder = property(lambda self: self[7])
    flags = property(lambda self: self[15])
    edges = property(lambda self: self[16])


class Controller:
    """The controller on a clock that the test advances."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.device, _ = simulated(lambda: self.now_s)

    def ask(self, letters: bytes, data: bytes = b"") -> bytes:
        """Send a command, check the CRC of its answer, and return the answer's data."""
        answer = self.device.receive(letters + (data + struct.pack("<H", crc16(data)) if data else b""))
        assert answer[:4] == letters
        content = answer[4:]
        if content:
            assert struct.unpack("<H", content[-2:])[0] == crc16(content[:-2])
        return content[:-2]

    def move(self, steps: int, fraction: int = 0) -> None:
        self.ask(b"move", struct.pack("<ih6x", steps, fraction))

    def status(self) -> Status:
        return Status(struct.unpack("<BBBBBihqihhhhhhIIB4x", self.ask(b"gets")))

    def wait(self, seconds: float = 60.0) -> None:
        self.now_s += seconds


@pytest.fixture
def controller() -> Controller:
    return Controller()


@pytest.fixture
def homed(controller: Controller) -> Controller:
    controller.ask(b"home")
    controller.wait()
    controller.ask(b"zero")
    return controller


def test_the_makers_library_identifies_homes_moves_stops_and_reads(tmp_path):
    ximc = pytest.importorskip("libximc.highlevel", reason="the maker's library is not installed")
    controller, _ = simulated(time.monotonic)
    with SerialDevice(PseudoTerminal(tmp_path / "pan"), controller) as device:
        axis = ximc.Axis(f"xi-com://{device.address}")
        axis.open_device()
        assert axis.get_serial_number() == 4242
        axis.command_home()
        axis.command_wait_for_stop(10)
        axis.command_zero()
        axis.command_move(300, 17)
        axis.command_wait_for_stop(10)
        position = axis.get_position()
        assert (position.Position, position.uPosition, position.EncPosition) == (300, 17, 6001)
        axis.command_move(-1000, 0)
        axis.command_sstp()
        axis.command_wait_for_stop(10)
        assert -1000 < axis.get_position().Position <= 300
        assert axis.get_edges_settings().RightBorder == 1500
        left = axis.get_sync_in_settings()
        left.SyncInFlags, left.Position = 5, -77
        axis.set_sync_in_settings(left)
        assert controller.settings["sni"] == (5, 4, -77, 0, 0, 0)
        power = axis.get_power_settings()
        power.PowerFlags, power.PowerOffDelay = 7, 61
        axis.set_power_settings(power)
        assert controller.settings["pwr"] == (50, 1000, 61, 100, 7)
        home = axis.get_home_settings()
        home.HomeDelta, home.uHomeDelta = -30, -5
        axis.set_home_settings(home)
        assert controller.settings["hom"][4:6] == (-30, -5)
        engine = axis.get_engine_settings()
        engine.EngineFlags = 0x09
        axis.set_engine_settings(engine)
        assert controller.settings["eng"][4] == 0x09
        axis.close_device()


def test_a_wrong_checksum_is_refused_and_nothing_moves(homed: Controller):
    data = struct.pack("<ih6x", 100, 0)
    assert homed.device.receive(b"move" + data + struct.pack("<H", crc16(data) ^ 1)) == b"errd"
    status = homed.status()
    assert not status.moving
    assert status.flags & 0x02
    assert not homed.status().flags & 0x02


def test_a_border_stops_a_move_which_then_has_failed(homed: Controller):
    homed.move(2000)
    homed.wait()
    status = homed.status()
    assert (status.position, status.failed, status.edges) == (1500 * 256, True, 0x01)
    settings = bytearray(homed.ask(b"geds"))
    settings[0] = 0
    homed.ask(b"seds", bytes(settings))
    homed.move(1600)
    homed.wait()
    assert (homed.status().position, homed.status().failed) == (1600 * 256, False)


def test_a_soft_stop_keeps_the_reference_a_harsh_one_does_not(homed: Controller):
    homed.move(1000)
    homed.wait(0.2)
    homed.ask(b"sstp")
    assert homed.status().moving
    homed.wait()
    assert homed.status().flags & 0x20
    homed.move(0)
    homed.wait(0.2)
    homed.ask(b"stop")
    assert not homed.status().moving
    assert not homed.status().flags & 0x20


def test_a_stall_is_an_alarm_in_which_moves_are_ignored_until_stop(homed: Controller):
    homed.device.axis.arm(MotionFault("stall"))
    homed.move(1000)
    homed.wait()
    status = homed.status()
    assert status.failed
    assert status.flags & 0xC0 == 0xC0
    assert not status.flags & 0x20
    homed.move(0)
    homed.wait()
    assert homed.status().position == status.position
    homed.ask(b"stop")
    homed.move(0)
    homed.wait()
    assert homed.status().position == 0
