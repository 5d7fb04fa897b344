"""A program that holds a stage, to be killed: ``python -m tests.hil.holder FAMILY ADDRESS`` opens it, homes and moves."""

from __future__ import annotations

import sys
from collections.abc import Callable

from drivers.clock import SystemClock
from drivers.stage import AxisLimits, Stage
from drivers.stage.esp import EspAxis, EspStage
from drivers.stage.grbl import GrblAxis, GrblStage
from drivers.stage.ximc import XimcAxis, XimcStage
from drivers.stage.zaber import ZaberAxis, ZaberStage

LIMITS = AxisLimits(-15.0, 15.0, 5.0, 100.0)
CLOCK = SystemClock()

OPENED: dict[str, Callable[[str], Stage]] = {
    "zaber": lambda address: ZaberStage.open(
        address,
        [ZaberAxis(name="pan", device=1, serial="", microsteps_per_deg=6400, limits=LIMITS)],
        clock=CLOCK,
    ),
    "ximc": lambda address: XimcStage.open(
        [XimcAxis(name="pan", port=address, serial="", steps_per_deg=100.0, limits=LIMITS)], clock=CLOCK
    ),
    "grbl": lambda address: GrblStage.open(
        address,
        [GrblAxis(name="pan", letter="X", steps_per_deg=640.0, zero_deg=16.0, limits=LIMITS)],
        clock=CLOCK,
    ),
    "esp": lambda address: EspStage.open(
        address, [EspAxis(name="pan", number=1, serial="", limits=LIMITS)], clock=CLOCK
    ),
}

if __name__ == "__main__":
    stage = OPENED[sys.argv[1]](sys.argv[2])
    print("open", flush=True)
    stage.home()
    print("homed", flush=True)
    stage.move_to({"pan": -14.0})
