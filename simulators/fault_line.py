"""A line with faults in front of any serial device, including a real one, in its own process.

    python -m simulators.fault_line --port /dev/serial/by-id/... --baud 115200 --link DIR/NAME [--seed N]

The program creates a second port and passes all bytes between the two. When it is ready, it prints one line of
JSON. Each line on standard input is then a fault with its parameters (``late delay_s=0.8``), answered by a line of
JSON. The program ends when standard input ends, or on SIGTERM or SIGINT.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from simulators.errors import SimulatorError
from simulators.faults.catalogue import fault_order_from_text, print_answer, take_orders, told_to_stop
from simulators.faults.fault_injection import line_fault_action
from simulators.faults.line_faults import FaultLine, SerialBridge
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import SerialDevice


def main(words: Sequence[str] | None = None) -> int:
    """Run the line until it is told to stop; return 0, or 2 if it cannot start: standard error has the reason."""
    parser = argparse.ArgumentParser(
        prog="simulators.fault_line", description="Faults in front of a serial device."
    )
    parser.add_argument("--port", required=True, help="port of the device, as pyserial names it")
    parser.add_argument("--baud", type=int, required=True, help="baud rate of the device")
    parser.add_argument("--link", type=Path, required=True, help="path of the second port")
    parser.add_argument("--seed", type=int, default=1, help="seed of random faults")
    arguments = parser.parse_args(words)
    ending = told_to_stop()
    try:
        bridge = SerialBridge(arguments.port, arguments.baud)
        line = FaultLine(bridge, time.monotonic, np.random.default_rng(arguments.seed))
        # Not paced: the real line already takes its time.
        with SerialDevice(PseudoTerminal(arguments.link), line, paced=False) as device:
            print_answer({"link": device.address, "pid": os.getpid()})
            carry_out = partial(_execute, device, line)
            threading.Thread(target=take_orders, args=(carry_out, ending.set), daemon=True).start()
            ending.wait()
        bridge.close()
    except SimulatorError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


def _execute(device: SerialDevice, line: FaultLine, text: str) -> dict[str, Any]:
    """Inject a fault and return its name and parameters."""
    order = fault_order_from_text(f"gimbal {text}")
    line_fault_action(order, device, line)()
    return {"fault": order.fault, **order.parameters}


if __name__ == "__main__":
    sys.exit(main())
