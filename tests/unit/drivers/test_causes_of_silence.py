"""Devices that answer otherwise than the driver's family: the message names that, and does not blame the cable."""

import re
import socket
import struct
from collections.abc import Callable

import pytest

from drivers.errors import DriverError, PortLost, ReplyGarbled, ReplyTimeout
from drivers.light import LightSettings
from drivers.light.scpi import ScpiLight
from drivers.serial_port import LineSettings, SerialPort
from drivers.stage.thorlabs_controller import ThorlabsController
from drivers.stage.thorlabs_messages import INFORMATION_LAYOUT, size
from drivers.stage.zaber import ZaberStage
from tests.hil.direct_stages import TurningPort, VirtualClock
from tests.unit.drivers.light.generator_bench import Bench as GeneratorBench
from tests.unit.drivers.stage.grbl_bench import Bench as GrblBench
from tests.unit.drivers.stage.zaber_bench import Bench as ZaberBench
from tests.unit.drivers.stage.zaber_bench import axes

pytestmark = pytest.mark.usefixtures("never_late")


class OtherDevice(TurningPort):
    """A port at which each piece of bytes is answered as a function says."""

    name = "other"

    def __init__(self, clock: VirtualClock, answer: Callable[[bytes], bytes]) -> None:
        self.clock, self.answer = clock, answer
        self.ready = b""

    def write(self, data: bytes) -> None:
        self.ready += self.answer(data)


def answers_lines(answer: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
    """Return what answers each whole line."""
    held = [b""]

    def receive(data: bytes) -> bytes:
        *lines, held[0] = (held[0] + data).split(b"\n")
        return b"".join(map(answer, lines))

    return receive


@pytest.mark.parametrize(
    ("firmware", "words"),
    [
        (answers_lines(lambda line: b'echo:Unknown command: "' + line + b'"\nok\n'), "answers ok"),  # Marlin
        (answers_lines(lambda _line: b'{"r":{},"f":[1,0,5,9123]}\n'), '"r":{}'),  # TinyG
        (answers_lines(lambda _line: b"ERROR\r\n"), "ERROR"),  # a modem
    ],
)
def test_another_firmware_in_the_place_of_grbl_is_told_by_its_answer(firmware, words) -> None:
    bench = GrblBench()
    bench.line = OtherDevice(bench.clock, firmware)
    with pytest.raises(DriverError) as caught:
        bench.open()
    assert words in caught.value.what
    assert "Grbl 1.1" in caught.value.remedy


@pytest.mark.parametrize("kind", [GrblBench, ZaberBench])
def test_a_line_that_echoes_is_told_and_no_cable_is_doubted(kind) -> None:
    """Adapters of two-wire RS-485 do so (libmodbus, issue 380), and a FluidNC after its terminal (issue 617)."""
    bench = kind()

    def echo(sent: bytes) -> None:
        bench.line.ready += sent

    bench.line.before = echo
    with pytest.raises(ReplyGarbled) as caught:
        bench.open()
    assert "echo" in caught.value.remedy
    assert "cable" not in caught.value.remedy


def test_two_zaber_devices_with_one_address_are_told() -> None:
    """All devices have the address 1 when they come from the factory, and each passes on what it hears."""
    bench = ZaberBench()
    bench.line.spoil = lambda reply: reply + reply
    with pytest.raises(DriverError, match=r"second answer .* device 1") as caught:
        bench.open()
    assert "renumber" in caught.value.remedy


def test_a_silent_zaber_device_may_have_the_binary_protocol() -> None:
    clock = VirtualClock()
    with pytest.raises(ReplyTimeout, match="binary protocol"):
        ZaberStage(OtherDevice(clock, lambda _data: b""), axes(), clock=clock)


def test_a_thorlabs_controller_with_bays_is_told_by_name() -> None:
    """The report of pyLabLib, issue 49: an HDR50 at a BSC201, whose answers come from the address 0x11."""
    clock = VirtualClock()
    data = INFORMATION_LAYOUT.pack(40_330_594, b"BSC201\0\0", 44, 1, 0, 2, 0, b"", 1, 0, 1)
    message = struct.pack("<HHBB", 0x0006, len(data), 0x81, 0x11) + data
    port = OtherDevice(clock, lambda sent: message if sent[:2] == b"\x05\x00" else b"")
    with pytest.raises(ReplyGarbled, match="controller with bays") as caught:
        ThorlabsController(port, clock=clock)
    assert "BSC20x" in caught.value.remedy


def test_a_garbled_address_of_thorlabs_is_no_other_controller() -> None:
    for source in (0x11, 0x21, 0x2A):
        with pytest.raises(ReplyGarbled):
            size(struct.pack("<HHBB", 0x042A, 14, 0x81, source), "pan")


def test_a_pendant_that_has_the_control_is_named_and_no_cable_is_doubted() -> None:
    """grblHAL reports ``|MPG:1`` then, and takes no line: issues 311 of ioSender, and 339, 486 and 931 of grblHAL."""
    bench = GrblBench()
    receive = bench.line.device.receive
    bench.line.device.receive = lambda data: receive(data) if data == b"?" else b""
    bench.change(lambda line: line.replace(b">", b"|MPG:1>"))
    with pytest.raises(ReplyTimeout, match="MPG") as caught:
        bench.open()
    assert "pendant" in caught.value.remedy
    assert "cable" not in caught.value.remedy


def test_a_pendant_that_has_given_the_control_back_is_no_cause() -> None:
    """grblHAL tells both changes: issue 218 of ioSender."""
    clock = VirtualClock()
    port = OtherDevice(clock, lambda _data: b"")
    port.ready = b"<Idle|MPos:0.000|MPG:1>\r\n<Idle|MPos:0.000|MPG:0>\r\n"
    with pytest.raises(ReplyTimeout) as caught:
        ScpiLight(port, clock=clock)
    assert "pendant" not in str(caught.value)


def test_a_banner_of_a_device_server_is_no_answer_and_no_fault() -> None:
    """Of ser2net's issue 133: it comes as soon as the port is open."""
    bench = GeneratorBench()
    bench.line.ready = b"ser2net port telnet(rfc2217),tcp,5001 device serialdev,/dev/ttyDUT1\r\n\r\n"
    assert bench.open().identify().serial == "SG0042"


SAID = {"Port already in use\r\n": "in use", "\r\nmoxa login: ": "login", "Username:": "login"}


@pytest.mark.parametrize(("said", "words"), SAID.items())
@pytest.mark.parametrize("closes", [True, False])
def test_what_the_other_end_says_before_it_is_silent_or_closes_is_the_cause(said, words, closes) -> None:
    clock = VirtualClock()
    port = OtherDevice(clock, lambda _data: b"")
    port.ready, read = said.encode(), port.read

    def read_or_close(timeout_s: float) -> bytes:
        if closes and not port.ready:
            raise PortLost("the port is gone.")
        return read(timeout_s)

    port.read = read_or_close
    with pytest.raises((PortLost, ReplyTimeout), match=words) as caught:
        ScpiLight(port, clock=clock)
    assert not re.search("cable|powered|switched on|baud", caught.value.remedy)


@pytest.mark.parametrize(
    ("answer", "name", "words"),
    [
        (b"", "/dev/ttyUSB0", "switched on"),
        (b"", "socket://10.0.0.7:5025", "no other one is connected"),
        (b"Keysight", "/dev/ttyUSB0", "right driver, baud rate and frame"),
    ],
)
def test_power_is_doubted_only_where_nothing_came_another_program_on_a_network(answer, name, words) -> None:
    clock = VirtualClock()
    port = OtherDevice(clock, lambda _data: answer)
    port.name = name
    with pytest.raises(ReplyTimeout) as caught:
        ScpiLight(port, clock=clock)
    assert words in caught.value.remedy
    assert ("switched on" in caught.value.remedy) == (not answer)


@pytest.mark.parametrize(
    ("said", "words"),
    [(b"", "no other one is connected"), (b"Port already in use\r\n", "End the other program")],
)
def test_a_connection_that_is_closed_at_once_is_that_of_another_program(said, words) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = SerialPort(f"socket://127.0.0.1:{server.getsockname()[1]}", LineSettings(9600))
        line, _ = server.accept()
        line.sendall(said)
        line.close()
        with pytest.raises(PortLost) as caught:
            ZaberStage(port, axes(), clock=VirtualClock())
    assert words in caught.value.remedy


def test_a_generator_that_knows_no_such_query_is_not_told_to_be_without_power() -> None:
    """An instrument of another make answers ``*IDN?``, is silent to what it does not know, and has no queue."""
    clock = VirtualClock()
    identity = b"UNI-T Technologies,UTG962E,AWG1234567,1.08\n"
    port = OtherDevice(clock, answers_lines(lambda line: identity if line == b"*IDN?" else b""))
    light = ScpiLight(port, dialect="numbered", clock=clock)
    with pytest.raises(ReplyTimeout, match="SOUR1:VOLT:LOW") as caught:
        light.apply(LightSettings())
    assert "The line works" in caught.value.remedy
