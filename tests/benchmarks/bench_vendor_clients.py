"""What the makers' own clients notice, and what our drivers do: controllers with one thing wrong, moves that go wrong.

Each client opens, homes, moves to 9 degrees and reads the position, in a process of its own that is ended after 15 s.
Clients: zaber-motion, libximc, pymeasure (for the ESP). One that is not installed says so. ``--family`` and
``--table`` ask for a part.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import measured
import numpy as np

from simulators.faults.catalogue import fault_order_from_text
from simulators.faults.fault_injection import AxisController, BenchParts, fault_action
from simulators.faults.line_faults import FaultLine
from simulators.ports.pseudo_terminal import PseudoTerminal
from simulators.ports.serial_device import Dialect, SerialDevice
from tests.hil.direct_stages import of_bench
from tests.hil.mutated import XIMC, ZABER, Change, Mutated

PATIENCE_S = 15.0
TARGET_DEG = 9.0

ZABER_MOTION = """
import sys
try:
    from zaber_motion import Library
    from zaber_motion.ascii import Connection
except ImportError:
    sys.exit(77)
Library.enable_device_db_store(sys.argv[2])
with Connection.open_serial_port(sys.argv[1]) as connection:
    axis = connection.get_device(1).get_axis(1)
    axis.home(); axis.move_absolute(57600); print(axis.get_position() / 6400)
"""
LIBXIMC = """
import sys
try:
    import libximc.highlevel as ximc
except ImportError:
    sys.exit(77)
axis = ximc.Axis("xi-com://" + sys.argv[1])
axis.open_device(); axis.get_serial_number(); axis.command_home(); axis.command_wait_for_stop(10)
axis.command_zero(); axis.command_move(900, 0); axis.command_wait_for_stop(10)
print(axis.get_position().Position / 100)
"""
PYMEASURE = """
import sys
try:
    from pymeasure.adapters import SerialAdapter
    from pymeasure.instruments.newport import ESP300
except ImportError:
    sys.exit(77)
line = SerialAdapter(sys.argv[1], baudrate=19200, timeout=2, write_termination="\\r", read_termination="\\r\\n")
x = ESP300(line).x
x.enable(); x.home(); x.wait_for_stop(); x.position = 9; x.wait_for_stop(); print(x.position)
"""
OURS = """
import sys
from drivers.clock import SystemClock
from drivers.stage import AxisLimits
from drivers.stage.esp import EspAxis, EspStage
from drivers.stage.ximc import XimcAxis, XimcStage
from drivers.stage.zaber import ZaberAxis, ZaberStage
port, clock = sys.argv[1], SystemClock()
same = dict(name="pan", serial="", limits=AxisLimits(-15, 15, 20, 100))
stage = {
    "zaber": lambda: ZaberStage.open(port, [ZaberAxis(device=1, microsteps_per_deg=6400, **same)], clock=clock),
    "ximc": lambda: XimcStage.open(
        [XimcAxis(port=port, steps_per_deg=100, encoder_counts_per_deg=2000, **same)], clock=clock
    ),
    "esp": lambda: EspStage.open(port, [EspAxis(number=1, **same)], clock=clock),
}[sys.argv[3]]()
stage.home(); stage.move_to({"pan": 9.0}); print(stage.position_deg()["pan"])
"""

FAULTS = {
    "stops short, no flag": "pan stop_short skip=1",
    "restarts in mid-move": "pan restart skip=1",
    "stalls": "pan stall skip=1",
    "slips, counter goes on": "pan slip skip=1",
    "stuck busy in mid-move": "pan no_progress skip=1",
    "cable pulled in mid-move": "pan unplug skip=1",
    "one reply late by 3 s": "gimbal late skip=40 delay_s=3",
    "one reply truncated": "gimbal truncated skip=40",
    "the reply of before": "gimbal stale skip=40",
}
"""Orders; the first motion, homing, is let pass."""


class Family(NamedTuple):
    """How to make a controller on a clock, what is wrong with it in turn, and its maker's client."""

    make: Callable[[Callable[[], float]], tuple[Dialect, AxisController]]
    changes: Mapping[str, Change]
    client: str
    script: str


SLOW = {"start_deg": 1.0, "speed_deg_s": 20.0, "acceleration_deg_s2": 100.0}
FAMILIES: Mapping[str, Family] = {
    "zaber": Family(of_bench("zaber", 6400, **SLOW), ZABER, "zaber-motion", ZABER_MOTION),
    "ximc": Family(of_bench("ximc", 25_600, "4242", **SLOW), XIMC, "libximc", LIBXIMC),
    "esp": Family(of_bench("esp301", 10_000, "1263", start_deg=1.0), {}, "pymeasure", PYMEASURE),
}


def verdict(words: list[str], axis: AxisController) -> str:
    """Run a client, and say what it made of the controller."""
    began_s = time.monotonic()
    try:
        ended = subprocess.run(words, capture_output=True, timeout=PATIENCE_S, check=False)
    except subprocess.TimeoutExpired:
        return f"HANGS (> {PATIENCE_S:.0f} s)"
    took = f"{time.monotonic() - began_s:4.1f} s"
    if ended.returncode == 77:
        return "not installed"
    if ended.returncode != 0:
        last = ended.stderr.decode(errors="replace").strip().splitlines()
        return f"refuses {took} {last[-1].split(':')[0].rsplit('.', 1)[-1][:24] if last else ''}"
    read_deg = float(ended.stdout.split()[-1])
    true = axis.axis.pointing.angle_deg(time.monotonic())
    if abs(true - TARGET_DEG) < 0.01 and abs(read_deg - true) < 0.01:
        return f"arrives {took}"
    return f"RETURNS {took} says {read_deg:.2f}, is {true:.2f}"


def both(family: str, wrap: Callable[[Dialect, AxisController], tuple[Dialect, list[str]]]) -> list[str]:
    """Try a controller, wrapped, with its maker's client and with our driver."""
    verdicts = []
    for script in (FAMILIES[family].script, OURS):
        with tempfile.TemporaryDirectory() as folder:
            dialect, axis = FAMILIES[family].make(time.monotonic)
            dialect, orders = wrap(dialect, axis)
            with SerialDevice(PseudoTerminal(Path(folder) / "stage"), dialect) as port:
                for order in orders:
                    parts = {"pan": axis}, {"gimbal": port}, {"gimbal": dialect}, {"pan": "gimbal"}
                    bench = BenchParts(*parts, light=None, lamp=None, camera=None, clock=time.monotonic)
                    fault_action(fault_order_from_text(order), bench)()
                verdicts.append(verdict([sys.executable, "-c", script, port.address, folder, family], axis))
    return verdicts


def mutations(family: str) -> None:
    """Print what becomes of controllers with one thing wrong."""
    for name, change in {"nothing wrong": lambda answer: answer, **FAMILIES[family].changes}.items():
        verdicts = both(family, lambda dialect, _axis, change=change: (Mutated(dialect, change), []))
        print(f"  {name:28}{verdicts[0]:46}{verdicts[1]}", flush=True)


def faults(family: str) -> None:
    """Print what becomes of moves that go wrong."""
    for name, order in FAULTS.items():

        def wrap(dialect: Dialect, _axis: AxisController, order: str = order) -> tuple[Dialect, list[str]]:
            return FaultLine(dialect, time.monotonic, np.random.default_rng(1)), [order]

        verdicts = both(family, wrap)
        print(f"  {name:28}{verdicts[0]:46}{verdicts[1]}", flush=True)


def main() -> None:
    """Print the tables."""
    parser = measured.options(__doc__)
    parser.add_argument("--family", choices=[*FAMILIES], action="append")
    parser.add_argument("--table", choices=["mutations", "faults"], action="append")
    asked = parser.parse_args()
    for family in asked.family or FAMILIES:
        print(f"{family:30}{FAMILIES[family].client:46}our driver")
        for table in asked.table or ("mutations", "faults"):
            {"mutations": mutations, "faults": faults}[table](family)


if __name__ == "__main__":
    measured.run(main, "faults", "Controllers with one permanent fault")
