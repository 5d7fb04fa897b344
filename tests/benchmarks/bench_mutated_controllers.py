"""Simulated controllers with one thing wrong each: what the makers' own clients do with them, and what our drivers do.

Each client opens, homes, moves and reads the position, in a process of its own that is ended after 20 s. ``--family
zaber`` or ``ximc`` asks for one of the two. A client that is not installed says so.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from simulators.axis_motion import Mechanics
from simulators.pseudo_terminal import PseudoTerminal
from simulators.serial_device import SerialDevice
from simulators.ximc import XimcController, XimcModel
from simulators.zaber import ZaberChain
from simulators.zaber_controller import ZaberController, ZaberModel
from tests.hil.mutated import XIMC, ZABER, Change, Mutated

PATIENCE_S = 20.0

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
    axis.home(); axis.move_absolute(57600); print("says", axis.get_position())
"""
LIBXIMC = """
import sys
try:
    import libximc.highlevel as ximc
except ImportError:
    sys.exit(77)
axis = ximc.Axis("xi-com://" + sys.argv[1])
axis.open_device(); axis.get_serial_number(); axis.command_home(); axis.command_wait_for_stop(10)
axis.command_move(900, 0); axis.command_wait_for_stop(10); print("says", axis.get_position().Position)
"""
OURS_ZABER = """
import sys
from drivers.clock import SystemClock
from drivers.stage import AxisLimits
from drivers.stage.zaber import ZaberAxis, ZaberStage
axis = ZaberAxis(name="pan", device=1, serial="", microsteps_per_deg=6400, limits=AxisLimits(-15, 15, 40, 200))
stage = ZaberStage.open(sys.argv[1], [axis], clock=SystemClock())
stage.home(); stage.move_to({"pan": 9.0}); print("says", stage.position_deg())
"""
OURS_XIMC = """
import sys
from drivers.clock import SystemClock
from drivers.stage import AxisLimits
from drivers.stage.ximc import XimcAxis, XimcStage
axis = XimcAxis(name="pan", port=sys.argv[1], serial="", steps_per_deg=100, limits=AxisLimits(-15, 15, 40, 200))
stage = XimcStage.open([axis], clock=SystemClock())
stage.home(); stage.move_to({"pan": 9.0}); print("says", stage.position_deg())
"""

Maker = Callable[[], object]
FAMILIES: Mapping[str, tuple[Maker, Mapping[str, Change], str, str]] = {
    "zaber": (
        lambda: ZaberChain(
            [
                ZaberController(
                    ZaberModel(Mechanics(6400, -17.0, 17.0, start_deg=1.0), "100101", -96000, 96000),
                    time.monotonic(),
                )
            ],
            time.monotonic,
        ),
        ZABER,
        ZABER_MOTION,
        OURS_ZABER,
    ),
    "ximc": (
        lambda: XimcController(
            XimcModel(Mechanics(25600, -17.0, 17.0, start_deg=1.0), 4242, -15.0, 15.0), time.monotonic
        ),
        XIMC,
        LIBXIMC,
        OURS_XIMC,
    ),
}


def verdict(script: str, address: str, folder: str) -> str:
    """Run a client, and say in one word what it made of the controller."""
    began_s = time.monotonic()
    try:
        ended = subprocess.run(
            [sys.executable, "-c", script, address, folder],
            capture_output=True,
            timeout=PATIENCE_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"HANGS (> {PATIENCE_S:.0f} s)"
    took = f"{time.monotonic() - began_s:4.1f} s"
    if ended.returncode == 77:
        return "not installed"
    if ended.returncode == 0:
        return f"ACCEPTS {took}"
    last = ended.stderr.decode(errors="replace").strip().splitlines()
    return f"refuses {took} {last[-1].split(':')[0].rsplit('.', 1)[-1][:24] if last else ''}"


def main() -> None:
    """Print a table a family."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--family", choices=[*FAMILIES], action="append")
    for family in parser.parse_args().family or FAMILIES:
        make, changes, theirs, ours = FAMILIES[family]
        print(f"{family:26}{'client of its maker':44}our driver")
        for name, change in {"nothing": lambda said: said, **changes}.items():
            told = []
            for script in (theirs, ours):
                with tempfile.TemporaryDirectory() as folder:
                    device = Mutated(make(), change)
                    with SerialDevice(PseudoTerminal(Path(folder) / "stage"), device) as port:
                        told.append(verdict(script, port.address, folder))
            print(f"  {name:24}{told[0]:44}{told[1]}", flush=True)


if __name__ == "__main__":
    main()
