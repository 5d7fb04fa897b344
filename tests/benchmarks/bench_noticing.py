"""Which faults of a move each driver notices, by what error, and after how many seconds of the bench's own time.

Runs on simulated controllers and a virtual clock: the figures do not depend on the machine. For comparison, of six
established clients none notices a move that stops short, and one (by a time-out) a controller that restarts.
"""

from __future__ import annotations

import numpy as np

from drivers.errors import DriverError
from simulators.axis_motion import MotionFault
from simulators.line_faults import LineFault
from tests.hil.direct_stages import FAMILIES, DirectStage, VirtualClock

MOTION = ("stop_short", "restart", "limit", "stall", "slip")
LINE = ("lost", "late", "truncated", "garbled", "doubled")


def befall(rig: DirectStage, fault: str) -> None:
    """Let a fault happen in the move to come."""
    axis = rig.controller.axis
    if fault in MOTION:
        axis.arm(MotionFault(fault))
    elif fault == "stuck busy":
        axis.stuck_busy = True
    elif fault == "silent line":
        rig.line.device.inject(LineFault("lost", count=None, skip=12))
    else:
        rig.line.device.inject(LineFault(fault, skip=8, delay_s=1.2))


def try_move(family: str, fault: str) -> str:
    """Make one move of 20 deg with that fault; tell how it ended."""
    clock = VirtualClock()
    rig = FAMILIES[family](clock, np.random.default_rng(1))
    rig.stage.home()
    rig.stage.move_to({"pan": 10.0})
    befall(rig, fault)
    began_s = clock.now_s
    try:
        rig.stage.move_to({"pan": -10.0})
    except DriverError as error:
        return f"{type(error).__name__} {clock.now_s - began_s:4.1f} s"
    told = rig.stage.position_deg()["pan"]
    true = axis_angle(rig, clock)
    verdict = "arrived" if abs(told - true) < 0.01 else f"NOT NOTICED ({true - told:+.2f} deg)"
    return f"{verdict} {clock.now_s - began_s:4.1f} s"


def axis_angle(rig: DirectStage, clock: VirtualClock) -> float:
    """Where the load really points, once it has settled."""
    return rig.controller.axis.pointing.angle_deg(clock.now_s + 1.0)


def main() -> None:
    """Print the table."""
    print(f"{'fault':24}" + "".join(f"{family:26}" for family in FAMILIES))
    for fault in (*MOTION, "stuck busy", *LINE, "silent line"):
        print(f"{fault:24}" + "".join(f"{try_move(family, fault):26}" for family in FAMILIES))


if __name__ == "__main__":
    main()
