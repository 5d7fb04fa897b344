"""The light's firmware, compiled for this computer, against the description: written apart from the simulated light."""

import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from bench.stations.station_text import find_description
from bench.stations.text_descriptions import LightProtocol
from drivers.clock import SystemClock
from drivers.errors import DeviceRefused, SettingRefused, WrongDevice
from drivers.light import LightSettings
from drivers.light.text import TextLight
from sequences.reader import read_document
from simulators.lights.microcontroller import MicrocontrollerLight

HERE = Path(__file__).parent / "firmware_stub"
FIRMWARE = Path(__file__).parents[2] / "firmware" / "starbench_light"
DESCRIPTION = read_document(find_description("microcontroller_light", None), LightProtocol).value.for_driver()

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="there is no g++ on this computer")


class PipePort:
    """The compiled firmware as a port."""

    name = "firmware"

    def __init__(self, program: Path) -> None:
        pipe = subprocess.PIPE
        self.process = subprocess.Popen([program], stdin=pipe, stdout=pipe, stderr=pipe, bufsize=0)

    def write(self, data: bytes) -> None:
        self.process.stdin.write(data)

    def read(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self.process.stdout], [], [], timeout_s)
        return os.read(self.process.stdout.fileno(), 4096) if ready else b""

    def lamp(self) -> list[str]:
        """Return what the firmware has done to the light since the last call."""
        os.set_blocking(self.process.stderr.fileno(), False)
        return (self.process.stderr.read() or b"").decode().splitlines()

    def close(self) -> None:
        """The test ends the process."""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("firmware") / "light"
    flags = ["-std=c++11", "-Wall", "-Wextra", "-Werror", f"-I{FIRMWARE}", f"-I{HERE}"]
    subprocess.run(["g++", *flags, HERE / "on_a_computer.cpp", "-o", made], check=True)
    sketch = FIRMWARE / "starbench_light.ino"
    subprocess.run(["g++", *flags, "-fsyntax-only", "-x", "c++", sketch], check=True)
    return made


@pytest.fixture
def port(program: Path) -> Iterator[PipePort]:
    port = PipePort(program)
    yield port
    with port.process as process:
        process.kill()


def opened(port: PipePort, **more) -> TextLight:
    return TextLight(port, more.pop("description", DESCRIPTION), clock=SystemClock(), **more)


def test_the_firmware_is_identified_set_read_back_and_switched(port) -> None:
    light = opened(port, serial="SB0001")
    assert light.identify().firmware == "1.0"
    got = light.apply(LightSettings("square", 75.0, 40.0, 0.0, 3.0))
    assert got.frequency_hz == pytest.approx(75.0, rel=1e-4)
    assert got.duty_percent == pytest.approx(40.0, abs=0.01)
    assert got.high_v == pytest.approx(3.0, abs=1e-3)
    assert light.faults() == []
    light.on()
    assert port.lamp()[-1] == "output 1 0 1"
    light.off()
    assert port.lamp()[-1] == "output 0 0 0"
    light.apply(LightSettings("steady", high_v=5.0))
    light.on()
    assert port.lamp()[-1] == "output 1 1 0"


def test_the_firmware_goes_dark_when_the_computer_is_silent(port) -> None:
    short = tuple(
        replace(setting, constant=1.0) if setting.quantity == "constant" else setting
        for setting in DESCRIPTION.settings
    )
    light = opened(port, description=replace(DESCRIPTION, settings=short))
    light.apply(LightSettings())
    light.on()
    time.sleep(1.6)
    assert port.lamp()[-1] == "output 0 0 0"
    reported, dark = light.faults()
    assert "watchdog" in reported
    assert "is off" in dark


def test_another_serial_number_and_values_out_of_range_are_refused(port) -> None:
    with pytest.raises(WrongDevice, match="SB0001"):
        opened(port, serial="SB0002")
    with pytest.raises(SettingRefused, match="outside"):
        opened(port).apply(LightSettings(frequency_hz=6000.0))
    wide = tuple(replace(setting, highest=1e9) for setting in DESCRIPTION.settings)
    with pytest.raises((SettingRefused, DeviceRefused), match="out of range"):
        opened(port, description=replace(DESCRIPTION, settings=wide)).apply(LightSettings(frequency_hz=6e3))


def framed(text: str) -> bytes:
    value = 0
    for byte in text.encode():
        value ^= byte
    return f"{text}*{value:02X}\n".encode()


REQUESTS = (
    "ID|FREQ 0|FREQ 5001|FREQ abc|FREQ|FREQ 1.5.5|DUTY 0.5|LEVEL 101|WAVE sine|X 1|FREQ 60|FREQ?|"
    "FREQ 0.5|FREQ?|FREQ 499.9|FREQ?|DUTY 33.3|DUTY?|LEVEL 12.345|LEVEL?|SYNC maybe|SYNC off|SYNC?|DOG 0|"
    "DOG 5|DOG?|ON 1|ON|OUT?|OFF|OUT?|WAVE steady|WAVE?|FAULT?|SERIAL?"
)


def test_firmware_and_simulated_light_answer_alike(port) -> None:
    simulated = MicrocontrollerLight("SB0001", time.monotonic)
    for data in [*map(framed, REQUESTS.split("|")), b"FREQ 60\n", b"FREQ 60*00\n"]:
        port.write(data)
        answer = b""
        while not answer.endswith(b"\n"):
            answer += port.read(2.0)
        assert answer == simulated.receive(data), data
