"""A program that holds a stage, to be killed: ``python -m tests.hil.holder ADDRESS`` opens it, homes and moves."""

from __future__ import annotations

import sys

from drivers.clock import SystemClock
from drivers.stage import AxisLimits
from drivers.stage.zaber import ZaberAxis, ZaberStage

AXIS = ZaberAxis(
    name="pan", device=1, serial="", microsteps_per_deg=6400, limits=AxisLimits(-15.0, 15.0, 5.0, 100.0)
)


def opened(address: str) -> ZaberStage:
    """Open the stage of one axis at an address."""
    return ZaberStage.open(address, [AXIS], clock=SystemClock())


if __name__ == "__main__":
    stage = opened(sys.argv[1])
    print("open", flush=True)
    stage.home()
    print("homed", flush=True)
    stage.move_to({"pan": -14.0})
