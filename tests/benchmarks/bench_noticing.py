"""Which faults of a move each driver notices, by what error, and after how many seconds of the bench's own time.

Runs on simulated controllers and a virtual clock: the figures do not depend on the machine.
"""

import measured
import numpy as np

from drivers.errors import DriverError
from tests.hil.direct_stages import FAMILIES, DirectStage, VirtualClock

FAULTS = {
    "stops short, no flag": "pan stop_short",
    "controller restarts": "pan restart",
    "limit switch": "pan limit",
    "twist": "pan twist",
    "motor blocked": "pan stall",
    "motor slips, counter continues": "pan slip",
    "creeps after its arrival": "pan creep creep_deg_s=0.05",
    "emergency stop": "pan press_stop",
    "busy without progress": "pan no_progress",
    "another baud rate": "gimbal baud rate=4800",
    "line silent": "gimbal lost skip=12 count=0",
}


def try_move(family: str, order: str) -> str:
    """Make one move of 20 deg with that fault; tell how it ended, and what the readings then show."""
    clock = VirtualClock()
    rig = FAMILIES[family](clock, np.random.default_rng(1))
    rig.stage.home()
    rig.stage.move_to({"pan": 10.0})
    rig.order(order)
    began_s = clock.now_s
    try:
        rig.stage.move_to({"pan": -10.0})
    except DriverError as error:
        return f"{type(error).__name__} {clock.now_s - began_s:4.1f} s"
    took_s = clock.now_s - began_s
    clock.sleep(2.0)
    return f"{arrival(rig)} {took_s:4.1f} s"


def arrival(rig: DirectStage) -> str:
    """Tell whether the readings, encoder before counter, are where the load points, and at the target."""
    read_deg = {**rig.stage.position_deg(), **rig.stage.encoder_deg()}["pan"]
    off_deg = rig.true_deg() - read_deg
    if abs(off_deg) > 0.06:
        return f"NOT NOTICED ({off_deg:+.2f} deg)"
    return "arrived" if abs(read_deg + 10.0) < 0.01 else f"seen by encoder {read_deg + 10.0:+.2f} deg"


def main() -> None:
    """Print the table."""
    print(f"{'fault':30}" + "".join(f"{family:30}" for family in FAMILIES))
    for name, order in FAULTS.items():
        print(f"{name:30}" + "".join(f"{try_move(family, order):30}" for family in FAMILIES))


if __name__ == "__main__":
    measured.run(main, "faults", "Faults that a stage notices")
