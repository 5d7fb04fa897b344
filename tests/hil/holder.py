"""A program that holds a stage, to be killed: ``python -m tests.hil.holder FAMILY ADDRESS`` opens it, homes and moves."""

from __future__ import annotations

import sys
from collections.abc import Callable

from bench.stations.station_text import find_description, read_stage_protocol
from drivers.clock import SystemClock
from drivers.stage import AxisLimits, Stage
from drivers.stage.dynamixel import DynamixelAxis, DynamixelStage
from drivers.stage.esp import EspAxis, EspStage
from drivers.stage.grbl import GrblAxis, GrblStage
from drivers.stage.text import TextAxis, TextStage
from drivers.stage.thorlabs import ThorlabsAxis, ThorlabsStage
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
    "flir": lambda address: TextStage.open(
        address,
        [TextAxis(name="pan", address="P", counts_per_deg=800.0, limits=LIMITS)],
        read_stage_protocol(find_description("flir_ptu", None)).value.for_driver(),
        baudrate=9600,
        clock=CLOCK,
    ),
    "thorlabs": lambda address: ThorlabsStage.open(
        [ThorlabsAxis(name="pan", port=address, serial="", counts_per_deg=409_600 / 3, limits=LIMITS)],
        clock=CLOCK,
    ),
    "dynamixel": lambda address: DynamixelStage.open(
        address,
        [
            DynamixelAxis(
                name="pan", id=1, model="XL430-W250", counts_per_deg=100.0, limits=LIMITS, tolerance_deg=0.02
            )
        ],
        baudrate=57_600,
        clock=CLOCK,
    ),
}

if __name__ == "__main__":
    stage = OPENED[sys.argv[1]](sys.argv[2])
    print("open", flush=True)
    stage.home()
    print("homed", flush=True)
    stage.move_to({"pan": -14.0})
