"""Round trips a second over a pseudo-terminal: bare pyserial, our driver, the maker's own client; and how fast a stop is.

The simulated controller answers without the baud rate's delay, so that what is measured is the client; the ratios
count, not the figures. (A real line of 115200 baud takes 3.8 ms a round trip, whoever asks.) The stop is one of a
move that another thread watches, on a line paced by its baud rate: from the call until the controller has it.
"""

from __future__ import annotations

import contextlib
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import serial

from drivers.clock import SystemClock
from drivers.errors import MoveFailed
from drivers.serial_port import SerialPort
from drivers.stage import Stage
from drivers.stage.zaber import ZaberChain
from drivers.stage.zaber_protocol import parse_reply, request
from drivers.wire_log import WireLogFile
from simulators.assembly import make_stage
from simulators.config import bench_config
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import Dialect, SerialDevice
from simulators.stages.axis_motion import Mechanics
from simulators.stages.zaber import ZaberChain as SimulatedChain
from simulators.stages.zaber import ZaberController, ZaberModel
from tests.hil.holder import OPENED

ROUNDS = 2000


def rate(ask: Callable[[], object]) -> float:
    """Return the best of three: round trips a second."""
    best = 0.0
    for _ in range(3):
        began_s = time.perf_counter()
        for _ in range(ROUNDS):
            ask()
        best = max(best, ROUNDS / (time.perf_counter() - began_s))
    return best


def bare(address: str) -> float:
    """Nothing but writing and reading a line."""
    with serial.Serial(address, 115200, timeout=2.0) as port:
        sent = request(1, 1, 7, "get pos")

        def ask() -> None:
            port.write(sent)
            parse_reply(port.read_until(b"\n"))

        return rate(ask)


def ours(address: str, log: WireLogFile | None) -> float:
    """Ids, checksums, deadline, lock, strays, and every byte logged or not."""
    chain = ZaberChain(SerialPort(address, baudrate=115200), [1], clock=SystemClock(), wire_log=log)
    try:
        return rate(lambda: chain.query(1, 1, "get pos"))
    finally:
        chain.close()


def makers(address: str, folder: Path) -> float | None:
    """The maker's own client, where it is installed."""
    try:
        from zaber_motion import Library
        from zaber_motion.ascii import Connection
    except ImportError:
        return None
    Library.enable_device_db_store(str(folder))
    with Connection.open_serial_port(address) as connection:
        axis = connection.get_device(1).get_axis(1)
        return rate(lambda: axis.generic_command("get pos"))


STOPS = {"zaber": b" stop:", "ximc": b"sstp", "grbl": b"\x85", "esp": b"ST"}
"""What a controller hears when it is stopped."""


class Listener:
    """A device that notes when it hears a stop."""

    def __init__(self, device: Dialect, word: bytes) -> None:
        self.device = device
        self.word = word
        self.heard_s: list[float] = []

    @property
    def baud(self) -> int:
        """Baud rate of the device."""
        return self.device.baud

    def receive(self, data: bytes) -> bytes:
        """Note the time of a stop, and pass everything on."""
        if self.word in data:
            self.heard_s.append(time.perf_counter())
        return self.device.receive(data)

    def unsolicited(self) -> bytes:
        """Pass on what it says of its own accord."""
        return self.device.unsolicited()


def stop_ms(family: str, folder: Path) -> list[float]:
    """Stop ten moves that another thread watches; return the times to the controller, in ms, sorted."""
    kind = "esp301" if family == "esp" else family
    stage = make_stage(kind, bench_config({"stage": {"kind": kind}}).axes, time.monotonic, lambda *_: None)
    dialect = Listener(next(iter(stage.dialects.values())), STOPS[family])
    found = []
    with SerialDevice(PseudoTerminal(folder / family), dialect) as port:
        driver = OPENED[family](port.address)
        driver.home()
        for number in range(10):
            goal = {"pan": 14.0 if number % 2 else -14.0}
            mover = threading.Thread(target=lambda goal=goal: suppressed(driver, goal))
            before = driver.position_deg()
            mover.start()
            while driver.position_deg() == before:
                time.sleep(0.01)
            dialect.heard_s.clear()
            called_s = time.perf_counter()
            driver.stop()
            mover.join()
            found.append(1e3 * (dialect.heard_s[0] - called_s))
        driver.close()
    return sorted(found)


def suppressed(driver: Stage, goal: dict[str, float]) -> None:
    """Move until somebody stops it."""
    with contextlib.suppress(MoveFailed):
        driver.move_to(goal)


def main() -> None:
    """Print the tables."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        now_s = time.monotonic()
        controller = ZaberController(ZaberModel(Mechanics(6400, -17.0, 17.0), "100101", -96000, 96000), now_s)
        chain = SimulatedChain([controller], time.monotonic)
        with SerialDevice(PseudoTerminal(folder / "stage"), chain, paced=False) as device:
            base = bare(device.address)
            rows = {
                "bare pyserial": base,
                "our driver": ours(device.address, None),
                "our driver, every byte logged": ours(device.address, WireLogFile(folder / "wire.jsonl")),
                "zaber-motion": makers(device.address, folder),
            }
    for label, figure in rows.items():
        told = "not installed" if figure is None else f"{figure:7.0f} /s   {figure / base:5.2f} x"
        print(f"{label:32}{told}")
    print("stop, from the call until the controller has it")
    with tempfile.TemporaryDirectory() as name:
        for family in STOPS:
            times = stop_ms(family, Path(name))
            print(f"{family:32}{times[len(times) // 2]:6.1f} ms   at most {times[-1]:.1f} ms")


if __name__ == "__main__":
    main()
