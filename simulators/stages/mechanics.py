"""Mechanical properties of a simulated axis."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mechanics:
    """Mechanical properties of an axis.

    counts_per_deg: Motor counts (microsteps or encoder counts) per degree of the load.
    lowest_deg, highest_deg: End stops of the load, degrees.
    home_deg: Angle of the reference sensor, degrees; homing sets the counter to 0 there.
    start_deg: Angle at power-up, degrees. The controller does not know it: its counter starts at 0.
    settle_s: Time constant with which the load follows the motor, s; after a ramp the rest decays as exp(-t /
      settle_s).
    backlash_deg: Backlash of the gear, degrees: the load stands half of it behind the motor, on the side that
      it came from.
    stall_detection: Whether the controller notices a stalled motor and stops. Otherwise its counter
      continues.
    """

    counts_per_deg: float
    lowest_deg: float
    highest_deg: float
    home_deg: float = 0.0
    start_deg: float = 0.0
    settle_s: float = 0.02
    backlash_deg: float = 0.0
    stall_detection: bool = True
