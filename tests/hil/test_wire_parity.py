"""What our drivers send is what the makers' own clients send, on the same simulated controllers."""

import re
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from waiting import wait_until

from drivers.clock import SystemClock
from drivers.light import LightSettings
from drivers.light.scpi import ScpiLight
from drivers.stage import Stage
from drivers.stage.esp import EspAxis, EspStage
from drivers.stage.ximc import XimcAxis, XimcStage
from drivers.stage.zaber import ZaberAxis, ZaberStage
from simulators.lights.generators import GeneratorModel, ScpiGenerator
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice
from tests.hil.direct_stages import LIMITS, of_bench

PATIENCE_S = 60.0


class Tap:
    """A device on whose line somebody listens."""

    def __init__(self, device) -> None:
        self.device = device
        self.heard: list[bytes] = []

    @property
    def baud(self) -> int:
        return self.device.baud

    def receive(self, data: bytes) -> bytes:
        self.heard.append(data)
        return self.device.receive(data)

    def unsolicited(self) -> bytes:
        return self.device.unsolicited()

    def take(self) -> bytes:
        heard, self.heard = b"".join(self.heard), []
        return heard

    def wait_for(self, request, split: Callable[[bytes], set]) -> None:
        """Wait until a request was heard that its sender waits for no reply to."""
        wait_until(lambda: request in split(b"".join(self.heard)), PATIENCE_S)


@contextmanager
def line(device, folder: Path) -> Iterator[tuple[str, Tap]]:
    tap = Tap(device)
    with SerialDevice(PseudoTerminal(folder / "stage"), tap) as terminal:
        yield terminal.address, tap


def ours(stage: Stage, tap: Tap, split: Callable[[bytes], set]) -> dict[str, set]:
    """Return what each of our operations sends."""
    sent_for = {}
    with closing(stage):
        for name, act in {
            "home": stage.home,
            "move": lambda: stage.move_to({"pan": 5.0}),
            "position": stage.position_deg,
            "stop": stage.stop,
        }.items():
            tap.take()
            act()
            sent_for[name] = split(tap.take())
    return sent_for


def zaber_requests(data: bytes) -> set[bytes]:
    """Requests without ids and checksums."""
    return {re.sub(rb"^(/\d \d) \d\d", rb"\1", text)[:-3] for text in data.split(b"\n") if text}


def test_zaber_requests_are_those_of_zaber_motion(tmp_path) -> None:
    ascii_ = pytest.importorskip("zaber_motion.ascii", reason="the maker's client is not installed")
    from zaber_motion import Library

    Library.enable_device_db_store(str(tmp_path))
    with line(of_bench("zaber", 6400)(time.monotonic)[0], tmp_path) as (address, tap):
        axis = ZaberAxis(name="pan", device=1, serial="", microsteps_per_deg=6400, limits=LIMITS)
        sent_for = ours(ZaberStage.open(address, [axis], clock=SystemClock()), tap, zaber_requests)
        with ascii_.Connection.open_serial_port(address) as connection:
            theirs = connection.get_device(1).get_axis(1)
            for name, act, request in (
                ("home", theirs.home, b"/1 1 home"),
                ("move", lambda: theirs.move_absolute(32000), b"/1 1 move abs 32000"),
                ("position", theirs.get_position, b"/1 1 get pos"),
                ("stop", connection.stop_all, b"/0 0 stop"),
            ):
                tap.take()
                act()
                assert request in zaber_requests(tap.take())
                assert request in sent_for[name]


def ximc_requests(data: bytes) -> set[bytes]:
    """Motion commands and questions, with their data and checksums."""
    return set(re.findall(rb"move.{14}|home|sstp|gets|gpos|zero", data, re.DOTALL))


def test_ximc_requests_are_those_of_libximc(tmp_path) -> None:
    ximc = pytest.importorskip("libximc.highlevel", reason="the maker's library is not installed")
    with line(of_bench("ximc", 25_600, "4242")(time.monotonic)[0], tmp_path) as (address, tap):
        axis = XimcAxis(name="pan", port=address, serial="", steps_per_deg=100.0, limits=LIMITS)
        sent_for = ours(XimcStage.open([axis], clock=SystemClock()), tap, ximc_requests)
        theirs = ximc.Axis(f"xi-com://{address}")
        theirs.open_device()
        for name, act in {
            "home": lambda: (theirs.command_home(), theirs.command_wait_for_stop(10), theirs.command_zero()),
            "move": lambda: (theirs.command_move(500, 0), theirs.command_wait_for_stop(10)),
            "position": theirs.get_status,
            "stop": theirs.command_sstp,
        }.items():
            tap.take()
            act()
            sent = ximc_requests(tap.take())
            assert sent
            assert sent <= sent_for[name]
        theirs.close_device()


def esp_requests(data: bytes) -> set[tuple[bytes, float | None]]:
    """Commands and questions, numbers by their value."""
    requests = set()
    for text in re.split(rb"[\r;]", data):
        match = re.fullmatch(rb"(\d?[A-Z]{2}\??)(-?\d*\.?\d+)?", text.strip())
        if match:
            requests.add((match[1].removesuffix(b"?"), float(match[2]) if match[2] else None))
    return requests


@pytest.mark.filterwarnings("ignore:It is not known whether:FutureWarning")
def test_esp_requests_are_those_of_pymeasure(tmp_path) -> None:
    newport = pytest.importorskip("pymeasure.instruments.newport", reason="pymeasure is not installed")
    from pymeasure.adapters import SerialAdapter

    with line(of_bench("esp301", 10_000, "1263")(time.monotonic)[0], tmp_path) as (address, tap):
        axis = EspAxis(name="pan", number=1, serial="", limits=LIMITS)
        sent_for = ours(EspStage.open(address, [axis], clock=SystemClock()), tap, esp_requests)
        adapter = SerialAdapter(
            address, baudrate=19200, timeout=2.0, write_termination="\r", read_termination="\r\n"
        )
        theirs = newport.ESP300(adapter)
        theirs.x.enable()
        for name, act, request in (
            ("home", lambda: (theirs.x.home(1), theirs.x.wait_for_stop()), (b"1OR", 1.0)),
            ("move", lambda: theirs.x.write("PA5"), (b"1PA", 5.0)),
            ("position", lambda: theirs.x.position, (b"1TP", None)),
            ("position", lambda: theirs.x.motion_done, (b"1MD", None)),
        ):
            tap.take()
            act()
            tap.wait_for(request, esp_requests)
            assert request in sent_for[name]
        theirs.x.wait_for_stop()
        assert theirs.x.position == 5.0
        adapter.close()


def scpi_requests(data: bytes) -> set[tuple[str, str | float]]:
    """Settings and questions: headers, with numbers by their value and switches by what they mean."""
    requests: set[tuple[str, str | float]] = set()
    for text in data.decode("ascii").split("\n"):
        header, _, value = text.strip().partition(" ")
        word: str | float = {"ON": 1.0, "OFF": 0.0}.get(value, value)
        if isinstance(word, str) and re.fullmatch(r"-?\d+(\.\d*)?", word):
            word = float(word)
        requests.add((header.removesuffix(";"), word))
    return requests - {("", "")}


def test_scpi_requests_are_those_of_pymeasure(tmp_path) -> None:
    keysight = pytest.importorskip("pymeasure.instruments.keysight", reason="pymeasure is not installed")
    from pymeasure.adapters import SerialAdapter

    with line(ScpiGenerator(GeneratorModel(), time.monotonic), tmp_path) as (address, tap):
        with closing(ScpiLight.open(address, clock=SystemClock())) as light:
            tap.take()
            light.apply(LightSettings("square", 50.0, 40.0, 0.5, 3.0))
            light.on()
            light.off()
            sent_by_us = scpi_requests(tap.take())
        adapter = SerialAdapter(
            address, baudrate=9600, timeout=5, write_termination="\n", read_termination="\n"
        )
        theirs = keysight.Keysight33250A(adapter)
        for act in (
            lambda: setattr(theirs, "shape", "SQU"),
            lambda: setattr(theirs, "frequency", 50),
            lambda: setattr(theirs, "square_dutycycle", 40),
            lambda: setattr(theirs, "voltage_high", 3),
            lambda: setattr(theirs, "voltage_low", 0.5),
            lambda: setattr(theirs, "output_enabled", True),
            lambda: setattr(theirs, "output_enabled", False),
            lambda: (theirs.shape, theirs.frequency, theirs.square_dutycycle),
            lambda: (theirs.voltage_high, theirs.voltage_low, theirs.output_enabled),
            theirs.check_errors,
        ):
            tap.take()
            act()
            assert theirs.id  # a reply: all that was sent before has been heard
            sent = scpi_requests(tap.take()) - {("*IDN?", "")}
            assert sent
            assert sent <= sent_by_us
        assert theirs.id.startswith("Keysight Technologies,33250A,SG0042,")
        assert (theirs.shape, theirs.frequency, theirs.square_dutycycle) == ("SQU", 50.0, 40.0)
        assert (theirs.voltage_high, theirs.voltage_low, theirs.output_enabled) == (3.0, 0.5, False)
        adapter.close()
