"""Round trips a second over a pseudo-terminal: bare pyserial, our driver, the maker's own client.

The simulated controller answers without the baud rate's delay, so that what is measured is the client; the ratios
count, not the figures. (A real line of 115200 baud takes 3.8 ms a round trip, whoever asks.)
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import serial

from drivers.clock import SystemClock
from drivers.serial_port import SerialPort
from drivers.stage.zaber_chain import ZaberChain
from drivers.stage.zaber_protocol import parse_reply, request
from drivers.wire_log import WireLogFile
from simulators.axis_motion import Mechanics
from simulators.pseudo_terminal import PseudoTerminal
from simulators.serial_device import SerialDevice
from simulators.zaber import ZaberChain as SimulatedChain
from simulators.zaber_controller import ZaberController, ZaberModel

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


def main() -> None:
    """Print the table."""
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


if __name__ == "__main__":
    main()
